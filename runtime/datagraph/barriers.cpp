#include "runtime/datagraph/barriers.h"

#include <algorithm>

namespace shale {
namespace {

bool is_hazard(const Access& earlier, const Access& later) {
  return earlier.memory == later.memory && earlier.begin < later.end && later.begin < earlier.end &&
         (earlier.writes || later.writes);
}

}  // namespace

std::vector<bool> plan_barriers(std::span<const std::vector<Access>> dispatches) {
  std::vector<bool> plan;
  std::vector<Access> unordered;  // since the last barrier
  for (const std::vector<Access>& dispatch : dispatches) {
    const bool barrier = std::any_of(dispatch.begin(), dispatch.end(), [&](const Access& later) {
      return std::any_of(unordered.begin(), unordered.end(),
                         [&](const Access& earlier) { return is_hazard(earlier, later); });
    });
    if (barrier) unordered.clear();
    unordered.insert(unordered.end(), dispatch.begin(), dispatch.end());
    plan.push_back(barrier);
  }
  return plan;
}

std::vector<Access> accesses(const Variant& variant, const Dispatch& dispatch) {
  constexpr uint64_t kArena = 0;
  std::vector<Access> result;
  std::vector<Binding> bindings = dispatch.bindings;
  if (dispatch.indirect)
    bindings.push_back({.resource = dispatch.indirect->resource, .reads = true});
  for (const Binding& binding : bindings) {
    const Resource& resource = variant.resources[binding.resource];
    if (resource.category == Category::kWeights) continue;
    Access access{kArena, 0, 1, binding.reads, binding.writes};
    if (resource.category == Category::kIntermediate) {
      access.begin = resource.offset_bytes;
      access.end = resource.offset_bytes + bound_bytes(resource);
    } else {
      access.memory = (uint64_t{binding.resource} + 1) * kMaxHistoryDepth + binding.frames_back;
    }
    result.push_back(access);
  }
  return result;
}

}  // namespace shale
