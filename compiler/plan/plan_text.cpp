#include <fmt/ranges.h>

#include "compiler/plan/plan.h"

namespace shale {
namespace {

std::string resource_line(const Resource& resource) {
  if (!is_image(resource.category)) {
    std::string text =
        fmt::format("{}{}", dtype_info(resource.dtype).name, shape_text(resource.shape));
    if (resource.quantization)
      text += fmt::format(" {:.9g} * (q - {})", resource.quantization->scale,
                          resource.quantization->zero_point);
    if (resource.history_depth != 0) text += fmt::format(" ring {}", resource.history_depth);
    return text;
  }
  std::string text = fmt::format("{} {}x{}", image_format_info(resource.format).name,
                                 resource.width, resource.height);
  if (resource.history_depth != 0) text += fmt::format(" ring {}", resource.history_depth);
  if (is_linear(resource)) text += fmt::format(" in a buffer of {} bytes", resource.size_bytes);
  return text;
}

const char* category_name(Category category) {
  switch (category) {
    case Category::kInput: return "input";
    case Category::kOutput: return "output";
    case Category::kIntermediate: return "arena";
    case Category::kWeights: return "weights";
    case Category::kImageInput: return "host image, read";
    case Category::kImageOutput: return "host image, written";
    case Category::kImageInternal: return "image";
    case Category::kImageHistory: return "history";
  }
  return "?";
}

std::string binding_kind(const Binding& binding) {
  switch (binding.type) {
    case BindingType::kStorageBuffer: return "buffer";
    case BindingType::kUniformTexelBuffer:
      return fmt::format("texels {}", image_format_info(binding.view_format).name);
    case BindingType::kSampledImage: return "sampled image";
    case BindingType::kStorageImage: return "storage image";
    case BindingType::kTransfer: return "transfer";
    case BindingType::kSampler: return "sampled image, filtered";
  }
  return "?";
}

std::string bindings_text(const Dispatch& dispatch, const Plan& plan) {
  std::string text;
  for (const Binding& binding : dispatch.bindings)
    text += fmt::format(
        "      {} {} {}{} as {}\n", binding.binding,
        binding.reads && binding.writes ? "updates" : (binding.writes ? "writes" : "reads"),
        plan.variant.resources[binding.resource].name,
        binding.frames_back == 0 ? "" : fmt::format(", {} back", binding.frames_back),
        binding_kind(binding));
  return text;
}

std::string dispatch_text(const Dispatch& dispatch, const Segment& segment, const Plan& plan,
                          size_t number) {
  const auto& [x, y, z] = dispatch.workgroups;
  std::string text = fmt::format("  {} {}: {}", number, dispatch.name, dispatch.kernel);
  if (segment.kind != SegmentKind::kTransfer) text += fmt::format(" {}x{}x{}", x, y, z);
  if (dispatch.indirect)
    text += fmt::format(" at most, by words {} to {} of {}", dispatch.indirect->first,
                        dispatch.indirect->first + 2,
                        plan.variant.resources[dispatch.indirect->resource].name);
  text += '\n';
  text += bindings_text(dispatch, plan);
  for (const auto& [index, form] : segment.start_forms)
    if (&segment.dispatches[index] == &dispatch)
      text += fmt::format("    at first: {} {}\n{}", form.kernel, fmt::join(form.workgroups, "x"),
                          bindings_text(form, plan));
  return text;
}

}  // namespace

std::string print_plan(const Plan& plan) {
  const Variant& variant = plan.variant;
  std::string text = fmt::format("plan for {}: {} resources, {} sources\n", variant.target,
                                 variant.resources.size(), plan.sources.size());
  for (const Param& param : variant.params)
    text += fmt::format("  param {} at {}: {} of {}\n", param.name, param.offset_bytes,
                        param.components, param.is_integer ? "int" : "float");
  if (variant.promise) text += fmt::format("  promised: {}\n", variant.promise->text);
  text += "resources\n";
  for (uint32_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    text += fmt::format("  {}: {} {}", resource.name, category_name(resource.category),
                        resource_line(resource));
    if (const auto live = plan.live.find(i); live != plan.live.end())
      text += live->second.last == kAlways
                  ? fmt::format(", at {}, kept", resource.offset_bytes)
                  : fmt::format(", at {}, live {} to {}", resource.offset_bytes, live->second.first,
                                live->second.last);
    text += '\n';
  }
  text += fmt::format("arena {} bytes\n", variant.arena_bytes);
  size_t number = 0;
  std::vector<size_t> first;
  for (const Segment& segment : variant.segments) {
    first.push_back(number);
    number += segment.dispatches.size();
  }
  for (uint32_t program = 0; program < variant.programs.size(); ++program) {
    const size_t values = variant.choices.size() / variant.programs.size();
    text += fmt::format("program {}", variant.programs[program]);
    if (values != 0)
      text +=
          fmt::format(", {} nearest {}", variant.chosen_by,
                      fmt::join(std::span(variant.choices).subspan(program * values, values), ","));
    text += '\n';
    for (size_t s = 0; s < variant.segments.size(); ++s) {
      if (variant.segments[s].program != program) continue;
      if (const std::optional<Tiles>& tiles = variant.segments[s].tiles)
        text += fmt::format("  {} by tiles, tolerance {}\n", variant.segments[s].name,
                            tiles->tolerance);
      for (size_t d = 0; d < variant.segments[s].dispatches.size(); ++d)
        text += dispatch_text(variant.segments[s].dispatches[d], variant.segments[s], plan,
                              first[s] + d);
    }
  }
  return text;
}

}  // namespace shale
