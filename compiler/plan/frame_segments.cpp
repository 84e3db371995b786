#include "compiler/plan/frame_segments.h"

#include <set>

namespace shale {
namespace {

uint64_t touched_bytes(const Resource& resource) {
  return is_image(resource.category) ? uint64_t{resource.width} * resource.height *
                                           image_format_info(resource.format).texel_bytes
                                     : resource.size_bytes;
}

/// Each resource once for reading and once for writing, whole, at the memory's rate.
void set_cost(Dispatch& dispatch, const Variant& variant, const DeviceProfile& profile) {
  std::set<std::pair<uint32_t, uint32_t>> read, written;  // with frames back
  for (const Binding& binding : dispatch.bindings) {
    const uint64_t bytes = touched_bytes(variant.resources[binding.resource]);
    if (binding.reads && read.emplace(binding.resource, binding.frames_back).second)
      dispatch.cost.bytes_read += bytes;
    if (binding.writes && written.emplace(binding.resource, 0).second)
      dispatch.cost.bytes_written += bytes;
  }
  dispatch.cost.time_us =
      1e-3 * (static_cast<double>(dispatch.cost.bytes_read + dispatch.cost.bytes_written) *
                  profile.ns[Work::kByte] +
              profile.ns[Work::kDispatch]);
}

}  // namespace

void add_segment(Plan& plan, SegmentKind kind, uint32_t program, const std::string& name,
                 Dispatch dispatch, const DeviceProfile& profile) {
  dispatch.name = unused_dispatch_name(plan, name);
  set_cost(dispatch, plan.variant, profile);
  Segment segment;
  segment.name = dispatch.name;
  segment.kind = kind;
  segment.program = program;
  segment.dispatches.push_back(std::move(dispatch));
  plan.variant.segments.push_back(std::move(segment));
}

Binding transfer_end(uint32_t number, uint32_t resource, bool writes) {
  return {.binding = number,
          .type = BindingType::kTransfer,
          .resource = resource,
          .view_format = ImageFormat::kNone,
          .reads = !writes,
          .writes = writes,
          .frames_back = 0};
}

void add_copy(Plan& plan, uint32_t program, uint32_t from, uint32_t to,
              const DeviceProfile& profile) {
  Dispatch copy;
  copy.kernel = kCopyKernel;
  copy.bindings = {transfer_end(0, from, false), transfer_end(1, to, true)};
  const bool is_output = plan.variant.resources[to].category == Category::kImageOutput;
  add_segment(plan, SegmentKind::kTransfer, program,
              (is_output ? "show_" : "take_") + plan.variant.resources[is_output ? to : from].name,
              std::move(copy), profile);
}

}  // namespace shale
