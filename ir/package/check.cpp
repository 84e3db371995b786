// What read_package and the runtime ask of a package, beyond what the FlatBuffers verifier can see.
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <set>

#include "ir/base/names.h"
#include "ir/package/package.h"

namespace shale {
namespace {

constexpr uint32_t kSpirvMagic = 0x07230203;
constexpr size_t kSpirvHeaderWords = 5;
constexpr size_t kMaxRank = 6;  // TOSA 1.0, level 8K

/// A name goes into messages, tables and JSON as it stands.
Result<void> check_name(const std::string& where, const char* what, const std::string& name) {
  if (name.empty()) return bad_input(where, "the {} is empty", what);
  if (const std::string_view fault = name_fault(name); !fault.empty())
    return bad_input(where, "the {} has {}", what, fault);
  return {};
}

Result<void> check_unique_name(const std::string& where, const char* what, const std::string& name,
                               std::set<std::string_view>& taken) {
  SHALE_TRY_VOID(check_name(where, what, name));
  if (!taken.insert(name).second)
    return bad_input(where, "the {} \"{}\" is taken already", what, name);
  return {};
}

/// Of a history of images or tensors.
Result<void> check_depth(const std::string& where, uint32_t depth, uint32_t least) {
  if (depth < least || depth > kMaxHistoryDepth)
    return bad_input(where, "history depth {} is outside {}..{}", depth, least, kMaxHistoryDepth);
  return {};
}

Result<void> check_range(const std::string& where, const Resource& tensor, const char* pool,
                         uint64_t pool_bytes) {
  if (tensor.offset_bytes % kBufferAlignment != 0)
    return bad_input(where, "offset {} is no multiple of {}", tensor.offset_bytes,
                     kBufferAlignment);
  if (tensor.offset_bytes > pool_bytes || tensor.size_bytes > pool_bytes - tensor.offset_bytes)
    return bad_input(where, "bytes {} to {} + {} leave the {} of {} bytes", tensor.offset_bytes,
                     tensor.offset_bytes, tensor.size_bytes, pool, pool_bytes);
  return {};
}

Result<void> check_tensor(const std::string& where, const Resource& tensor, const Variant& variant,
                          uint64_t weight_bytes) {
  if (!is_dtype(static_cast<uint32_t>(tensor.dtype)))
    return bad_input(where, "element type {} does not exist", static_cast<uint32_t>(tensor.dtype));
  if (tensor.dtype == DType::kUnknown || tensor.dtype == DType::kShape)
    return bad_input(where, "a tensor cannot have the element type {}",
                     dtype_info(tensor.dtype).wire);
  if (tensor.shape.size() > kMaxRank)
    return bad_input(where, "rank {} is above {}", tensor.shape.size(), kMaxRank);
  uint64_t bytes = dtype_info(tensor.dtype).host_bytes;
  for (const int64_t extent : tensor.shape) {
    if (extent < 1) return bad_input(where, "extent {} is below 1", extent);
    if (static_cast<uint64_t>(extent) > kMaxTensorBytes / bytes)
      return bad_input(where, "the tensor is larger than {} bytes", kMaxTensorBytes);
    bytes *= static_cast<uint64_t>(extent);
  }
  if (tensor.size_bytes != bytes)
    return bad_input(where, "size is {} bytes, the shape makes {}", tensor.size_bytes, bytes);
  if (tensor.quantization &&
      !(std::isfinite(tensor.quantization->scale) && tensor.quantization->scale > 0))
    return bad_input(where, "scale {} is not a positive number", tensor.quantization->scale);
  if (tensor.format != ImageFormat::kNone || tensor.width != 0 || tensor.height != 0)
    return bad_input(where, "a tensor has image fields");
  if (tensor.history_depth != 0) {
    if (tensor.category != Category::kInput && tensor.category != Category::kOutput)
      return bad_input(where, "only inputs and outputs can be histories");
    SHALE_TRY_VOID(check_depth(where, tensor.history_depth, 2));
  }
  if (tensor.category == Category::kIntermediate)
    return check_range(where, tensor, "arena", variant.arena_bytes);
  if (tensor.category == Category::kWeights)
    return check_range(where, tensor, "weights", weight_bytes);
  if (tensor.offset_bytes != 0)
    return bad_input(where, "a tensor bound by the caller has offset {}", tensor.offset_bytes);
  return {};
}

Result<void> check_image(const std::string& where, const Resource& image) {
  if (static_cast<uint32_t>(image.format) >= kImageFormatCount)
    return bad_input(where, "image format {} does not exist", static_cast<uint32_t>(image.format));
  if (image.format == ImageFormat::kNone || image.format == ImageFormat::kRgba8Sint ||
      image.format == ImageFormat::kR8Sint || image.format == ImageFormat::kRg32Uint ||
      image.format == ImageFormat::kR16Uint)
    return bad_input(where, "an image cannot have the format {}",
                     image_format_info(image.format).name);
  if (image.width < 1 || image.height < 1 || image.width > kMaxImageExtent ||
      image.height > kMaxImageExtent)
    return bad_input(where, "extent {}x{} is outside 1..{}", image.width, image.height,
                     kMaxImageExtent);
  if (image.dtype != DType::kUnknown || !image.shape.empty() || image.quantization ||
      image.offset_bytes != 0)
    return bad_input(where, "an image has tensor fields");
  if (image.size_bytes != 0) {
    if (image.category != Category::kImageInternal && image.category != Category::kImageHistory)
      return bad_input(where, "an image of the host has a size of {} bytes", image.size_bytes);
    const uint64_t bytes = uint64_t{linear_pitch(image.format, image.width)} *
                           image_format_info(image.format).texel_bytes * image.height;
    if (image.size_bytes != bytes)
      return bad_input(where, "size is {} bytes, the extent makes {}", image.size_bytes, bytes);
  }
  const bool history = image.category == Category::kImageHistory;
  if (history) SHALE_TRY_VOID(check_depth(where, image.history_depth, 1));
  if (!history && image.history_depth != 0)
    return bad_input(where, "history depth {} of an image that is no history", image.history_depth);
  return {};
}

/// Of a tensor or a linear image.
Result<void> check_buffer_binding(const std::string& where, const Binding& binding,
                                  const Resource& resource) {
  if (binding.type != BindingType::kStorageBuffer &&
      binding.type != BindingType::kUniformTexelBuffer)
    return bad_input(where, "an image descriptor leads to the {} \"{}\"",
                     is_image(resource.category) ? "linear image" : "tensor", resource.name);
  if (binding.type == BindingType::kStorageBuffer) {
    if (binding.view_format != ImageFormat::kNone)
      return bad_input(where, "a storage buffer has a view format");
    return {};
  }
  if (binding.writes) return bad_input(where, "a uniform texel buffer is written");
  const auto views = {ImageFormat::kRgba8Sint, ImageFormat::kR8Sint,     ImageFormat::kR32Uint,
                      ImageFormat::kRg32Uint,  ImageFormat::kRgba32Uint, ImageFormat::kR16Uint};
  if (std::find(views.begin(), views.end(), binding.view_format) == views.end())
    return bad_input(where, "a texel buffer cannot have the view format {}",
                     image_format_info(binding.view_format).name);
  const uint32_t texel_bytes = image_format_info(binding.view_format).texel_bytes;
  if (resource.size_bytes % texel_bytes != 0)
    return bad_input(where, "{} bytes of \"{}\" are no whole number of {} byte texels",
                     resource.size_bytes, resource.name, texel_bytes);
  return {};
}

Result<void> check_tensor_binding(const std::string& where, const Binding& binding,
                                  const Resource& tensor, SegmentKind segment) {
  SHALE_TRY_VOID(check_buffer_binding(where, binding, tensor));
  if (binding.writes && tensor.category == Category::kWeights)
    return bad_input(where, "weights \"{}\" are written", tensor.name);
  if (binding.writes && tensor.category == Category::kInput && segment == SegmentKind::kGraph)
    return bad_input(where, "the graph segment writes its input \"{}\"", tensor.name);
  if (binding.type != BindingType::kUniformTexelBuffer) return {};
  const uint32_t bytes = dtype_info(tensor.dtype).host_bytes;
  const bool of_bytes = binding.view_format == ImageFormat::kR8Sint ||
                        binding.view_format == ImageFormat::kRgba8Sint,
             of_pairs = binding.view_format == ImageFormat::kR16Uint;
  if (of_bytes ? bytes != 1 : of_pairs ? bytes != 2 : bytes > 4)
    return bad_input(where, "a texel buffer of {} views a tensor of type {}",
                     image_format_info(binding.view_format).name, dtype_info(tensor.dtype).wire);
  return {};
}

Result<void> check_image_binding(const std::string& where, const Binding& binding,
                                 const Resource& image, SegmentKind segment) {
  if (segment == SegmentKind::kGraph)
    return bad_input(where, "the graph segment uses the image \"{}\"", image.name);
  if (is_linear(image) && segment == SegmentKind::kCompute) {
    SHALE_TRY_VOID(check_buffer_binding(where, binding, image));
  } else {
    const bool shaders = is_sampled(binding.type) || binding.type == BindingType::kStorageImage;
    if (segment == SegmentKind::kCompute && !shaders)
      return bad_input(where, "a buffer descriptor leads to the image \"{}\"", image.name);
    if (binding.view_format != ImageFormat::kNone)
      return bad_input(where, "an image descriptor has a view format");
    if (binding.writes && is_sampled(binding.type))
      return bad_input(where, "a sampled image is written");
    const ImageFormatInfo& format = image_format_info(image.format);
    if (binding.type == BindingType::kSampler && !format.filtered)
      return bad_input(where, "not every device filters the format {} of \"{}\"", format.name,
                       image.name);
  }
  if (binding.writes && image.category == Category::kImageInput)
    return bad_input(where, "the input image \"{}\" is written", image.name);
  return {};
}

/// Only a history has frames to go back to, and only its newest one may change.
Result<void> check_frames_back(const std::string& where, const Binding& binding,
                               const Resource& resource) {
  const uint32_t depth = std::max(resource.history_depth, 1u);
  if (binding.frames_back >= depth)
    return bad_input(where, "frames_back is {}, \"{}\" holds {} frame(s)", binding.frames_back,
                     resource.name, depth);
  if (binding.writes && binding.frames_back != 0)
    return bad_input(where, "an earlier frame's \"{}\" is written", resource.name);
  return {};
}

Result<void> check_binding(const std::string& where, const Binding& binding, const Variant& variant,
                           SegmentKind segment) {
  if (binding.binding >= kMaxBindings)
    return bad_input(where, "the binding number is not below {}", kMaxBindings);
  if (static_cast<uint32_t>(binding.type) >= kBindingTypeCount)
    return bad_input(where, "binding type {} does not exist", static_cast<uint32_t>(binding.type));
  if (static_cast<uint32_t>(binding.view_format) >= kImageFormatCount)
    return bad_input(where, "view format {} does not exist",
                     static_cast<uint32_t>(binding.view_format));
  if (binding.resource >= variant.resources.size())
    return bad_input(where, "resource {} does not exist, there are {}", binding.resource,
                     variant.resources.size());
  if (!binding.reads && !binding.writes) return bad_input(where, "neither reads nor writes");
  if ((binding.type == BindingType::kTransfer) != (segment == SegmentKind::kTransfer))
    return bad_input(where, "transfer segments have transfer bindings, and no others do");
  const Resource& resource = variant.resources[binding.resource];
  SHALE_TRY_VOID(is_image(resource.category)
                     ? check_image_binding(where, binding, resource, segment)
                     : check_tensor_binding(where, binding, resource, segment));
  return check_frames_back(where, binding, resource);
}

/// Behind check_binding of each binding.
Result<void> check_transfer(const std::string& where, const Dispatch& transfer,
                            const Variant& variant) {
  const bool copies = transfer.kernel == kCopyKernel;
  if (!copies && transfer.kernel != kClearKernel)
    return bad_input(where, "\"{}\" is no transfer", transfer.kernel);
  if (transfer.module != 0 || transfer.workgroups != std::array<uint32_t, 3>{1, 1, 1})
    return bad_input(where, "a transfer has a module or a grid");
  const auto end = [&](size_t i) -> const Resource& {
    return variant.resources[transfer.bindings[i].resource];
  };
  for (size_t i = 0; i < transfer.bindings.size(); ++i) {
    const Binding& binding = transfer.bindings[i];
    if (!is_image(end(i).category)) return bad_input(where, "\"{}\" is no image", end(i).name);
    const bool is_source = copies && i == 0;
    if (binding.binding != i || binding.reads != is_source || binding.writes == is_source)
      return bad_input(where, "the ends of a transfer are out of order");
  }
  if (transfer.bindings.size() != (copies ? 2 : 1))
    return bad_input(where, "has {} ends, expected {}", transfer.bindings.size(), copies ? 2 : 1);
  if (!copies) return {};
  if (end(0).format != end(1).format || end(0).width != end(1).width ||
      end(0).height != end(1).height)
    return bad_input(where, "copies \"{}\" to \"{}\", which has another format or extent",
                     end(0).name, end(1).name);
  if (is_linear(end(0)) == is_linear(end(1)))
    return bad_input(where, "copies \"{}\" to \"{}\", of which one must be linear", end(0).name,
                     end(1).name);
  return {};
}

Result<void> check_indirect(const std::string& where, const IndirectGrid& grid,
                            const Variant& variant, const Segment& segment) {
  if (segment.kind == SegmentKind::kTransfer)
    return bad_input(where, "has a grid of the device, and is a transfer");
  if (grid.resource >= variant.resources.size())
    return bad_input(where, "grid: resource {} does not exist, there are {}", grid.resource,
                     variant.resources.size());
  const Resource& words = variant.resources[grid.resource];
  const bool is_work = segment.tiles && grid.resource == segment.tiles->work;
  if (segment.kind == SegmentKind::kGraph && !is_work)
    return bad_input(where, "grid: \"{}\" is not the work of its segment's tiles", words.name);
  if (!is_work && (!is_linear(words) || words.category != Category::kImageInternal ||
                   words.format != ImageFormat::kR32Uint))
    return bad_input(where, "grid: \"{}\" is no linear r32_uint image of the frame loop's own",
                     words.name);
  if (words.size_bytes < 12 || grid.first > words.size_bytes / 4 - 3)
    return bad_input(where, "grid: words {} to {} leave the {} of \"{}\"", grid.first,
                     uint64_t{grid.first} + 2, words.size_bytes / 4, words.name);
  return {};
}

Result<void> check_dispatch(const std::string& where, const Dispatch& dispatch,
                            const Variant& variant, const Segment& of) {
  const SegmentKind segment = of.kind;
  SHALE_TRY_VOID(check_name(where, "kernel name", dispatch.kernel));
  if (segment != SegmentKind::kTransfer && dispatch.module >= variant.modules.size())
    return bad_input(where, "module {} does not exist, there are {}", dispatch.module,
                     variant.modules.size());
  for (const uint32_t count : dispatch.workgroups)
    if (count < 1 || count > kMaxWorkgroups)
      return bad_input(where, "a grid of {} workgroups is outside 1..{}", count, kMaxWorkgroups);
  uint64_t used = 0;
  uint32_t samplers = 0;
  for (const Binding& binding : dispatch.bindings) {
    const std::string at = fmt::format("{}, binding {}", where, binding.binding);
    SHALE_TRY_VOID(check_binding(at, binding, variant, segment));
    const uint64_t bit = uint64_t{1} << binding.binding;
    if (used & bit) return bad_input(at, "the binding number is taken already");
    used |= bit;
    samplers += binding.type == BindingType::kSampler;
  }
  if (samplers > kMaxSamplers)
    return bad_input(where, "has {} samplers, more than {}", samplers, kMaxSamplers);
  if (dispatch.indirect) SHALE_TRY_VOID(check_indirect(where, *dispatch.indirect, variant, of));
  if (segment == SegmentKind::kTransfer) SHALE_TRY_VOID(check_transfer(where, dispatch, variant));
  if (!(std::isfinite(dispatch.cost.time_us) && dispatch.cost.time_us >= 0))
    return bad_input(where, "predicted time {} is not a duration", dispatch.cost.time_us);
  return {};
}

/// What a segment finds out about its inputs.
Result<void> check_tiles(const std::string& where, const Segment& segment, const Variant& variant) {
  if (!segment.tiles) return {};
  if (segment.kind != SegmentKind::kGraph)
    return bad_input(where, "works by tiles, which only graph segments can");
  if (segment.tiles->tolerance > kMaxTileTolerance)
    return bad_input(where, "a tolerance of {} codes is above {}", segment.tiles->tolerance,
                     kMaxTileTolerance);
  for (const uint32_t index : {segment.tiles->changes, segment.tiles->work}) {
    if (index >= variant.resources.size())
      return bad_input(where, "resource {} of its tiles does not exist, there are {}", index,
                       variant.resources.size());
    const Resource& resource = variant.resources[index];
    if (resource.category != Category::kIntermediate || resource.dtype != DType::kInt32)
      return bad_input(where, "\"{}\" of its tiles is no intermediate tensor of INT32",
                       resource.name);
  }
  return {};
}

/// The tensors that a dispatch binds and that are no weights, with what it does to them, in order.
std::vector<std::array<uint32_t, 3>> touched_tensors(const Dispatch& dispatch,
                                                     const Variant& variant) {
  std::vector<std::array<uint32_t, 3>> touched;
  for (const Binding& binding : dispatch.bindings)
    if (variant.resources[binding.resource].category != Category::kWeights)
      touched.push_back({binding.resource, binding.reads, binding.writes});
  std::sort(touched.begin(), touched.end());
  touched.erase(std::unique(touched.begin(), touched.end()), touched.end());
  return touched;
}

/// Behind check_dispatch of each dispatch.
Result<void> check_start_forms(const std::string& where, const Segment& segment,
                               const Variant& variant) {
  for (size_t i = 0; i < segment.start_forms.size(); ++i) {
    const auto& [index, form] = segment.start_forms[i];
    if (segment.kind != SegmentKind::kGraph || segment.tiles)
      return bad_input(where, "has start forms, which only graph segments without tiles can");
    if (index >= segment.dispatches.size() ||
        (i > 0 && index <= segment.start_forms[i - 1].dispatch))
      return bad_input(where, "start form {}: dispatch {} does not exist, or is out of order", i,
                       index);
    const Dispatch& own = segment.dispatches[index];
    const std::string at = fmt::format("{}, start form of \"{}\"", where, own.name);
    if (form.name != own.name || form.indirect)
      return bad_input(at, "has another name, or a grid of the device");
    SHALE_TRY_VOID(check_dispatch(at, form, variant, segment));
    if (touched_tensors(form, variant) != touched_tensors(own, variant))
      return bad_input(at, "reads or writes other tensors than the dispatch");
  }
  return {};
}

Result<void> check_proof(const std::string& where, const RangeProof& proof) {
  if (proof.min.size() != proof.max.size() || proof.min.size() != proof.magnitude.size())
    return bad_input(where, "{} minima, {} maxima and {} magnitudes, expected as many of each",
                     proof.min.size(), proof.max.size(), proof.magnitude.size());
  for (size_t i = 0; i < proof.min.size(); ++i)
    if (proof.min[i] > proof.max[i] || proof.magnitude[i] < 0)
      return bad_input(where, "channel {} has the range {}..{} and the magnitude {}", i,
                       proof.min[i], proof.max[i], proof.magnitude[i]);
  return {};
}

Result<void> check_param(const std::string& where, const Param& param) {
  if (param.components < 1 || param.components > 4)
    return bad_input(where, "{} components are outside 1..4", param.components);
  if (static_cast<uint32_t>(param.source) >= kParamSourceCount)
    return bad_input(where, "source {} does not exist", static_cast<uint32_t>(param.source));
  if (param.source == ParamSource::kReset && (!param.is_integer || param.components != 1))
    return bad_input(where, "the reset flag must be one integer");
  if (param.source == ParamSource::kFrames && (!param.is_integer || param.components != 1))
    return bad_input(where, "the number of frames must be one integer");
  if (param.source == ParamSource::kTime && (param.is_integer || param.components != 1))
    return bad_input(where, "the time must be one float");
  const uint32_t alignment = param.components == 1 ? 4 : param.components == 2 ? 8 : 16;
  if (param.offset_bytes % alignment != 0 ||
      param.offset_bytes > kMaxParamBytes - 4 * param.components)
    return bad_input(where, "offset {} is no multiple of {}, or leaves the {} bytes",
                     param.offset_bytes, alignment, kMaxParamBytes);
  if (param.default_values.size() != param.components)
    return bad_input(where, "{} default values, expected {}", param.default_values.size(),
                     param.components);
  for (const float value : param.default_values)
    if (!std::isfinite(value) ||
        (param.is_integer && (value != std::floor(value) || std::abs(value) > 16777216.0f)))
      return bad_input(where, "the default value {} is no {}", value,
                       param.is_integer ? "exact integer" : "finite number");
  return {};
}

Result<void> check_params(const std::string& where, const Variant& variant) {
  std::set<std::string_view> names;
  std::array<bool, kMaxParamBytes / 4> used{};
  for (const Param& param : variant.params) {
    const std::string at = fmt::format("{}, parameter \"{}\"", where, param.name);
    SHALE_TRY_VOID(check_unique_name(at, "parameter name", param.name, names));
    SHALE_TRY_VOID(check_param(at, param));
    for (uint32_t i = 0; i < param.components; ++i) {
      if (used[param.offset_bytes / 4 + i])
        return bad_input(at, "shares byte {} with another", param.offset_bytes + 4 * i);
      used[param.offset_bytes / 4 + i] = true;
    }
  }
  return {};
}

/// What chooses among the programs. The parameters are sound.
Result<void> check_choices(const std::string& where, const Variant& variant) {
  if (variant.chosen_by.empty()) {
    if (variant.choices.empty()) return {};
    return bad_input(where, "has {} values that choose programs, and no parameter",
                     variant.choices.size());
  }
  const auto param =
      std::find_if(variant.params.begin(), variant.params.end(), [&](const Param& each) {
        return each.name == variant.chosen_by && each.source == ParamSource::kHost;
      });
  if (param == variant.params.end())
    return bad_input(where, "programs are chosen by \"{}\", which is no parameter of the host",
                     variant.chosen_by);
  const size_t expected = variant.programs.size() * param->components;
  if (variant.choices.size() != expected)
    return bad_input(where, "{} values choose programs, expected {} for each of {}",
                     variant.choices.size(), param->components, variant.programs.size());
  for (const float value : variant.choices)
    if (!std::isfinite(value)) return bad_input(where, "{} chooses no program", value);
  return {};
}

/// The program that makes pictures leaves nothing that another finds. The programs are sound.
Result<void> check_generator(const std::string& where, const Variant& variant) {
  if (!variant.generator) {
    for (const Param& param : variant.params)
      if (param.source == ParamSource::kTime || param.source == ParamSource::kFrames)
        return bad_input(where, "parameter \"{}\" is for a program that generates, and none does",
                         param.name);
    return {};
  }
  const Generator& generator = *variant.generator;
  if (variant.programs.size() != 2 || !variant.chosen_by.empty())
    return bad_input(where, "a program that generates needs one other beside it, there are {}{}",
                     variant.programs.size() - 1,
                     variant.chosen_by.empty() ? "" : ", chosen by a parameter");
  if (generator.program >= 2)
    return bad_input(where, "program {} generates, there are 2", generator.program);
  if (!(generator.after >= 0 && generator.after < generator.until && generator.until <= kMaxTime))
    return bad_input(where, "generates at times above {} up to {}, expected a range in 0 to {}",
                     generator.after, generator.until, kMaxTime);
  std::set<uint32_t> rendered;  // what the other program binds
  for (const Segment& segment : program_segments(variant, 1 - generator.program))
    for (const Dispatch& dispatch : segment.dispatches)
      for (const Binding& binding : dispatch.bindings) rendered.insert(binding.resource);
  for (const Segment& segment : program_segments(variant, generator.program))
    for (const Dispatch& dispatch : segment.dispatches)
      for (const Binding& binding : dispatch.bindings) {
        const Resource& resource = variant.resources[binding.resource];
        if (!binding.writes) continue;
        const bool is_tensor =
            resource.category == Category::kInput || resource.category == Category::kOutput;
        if (resource.history_depth != 0 || (is_tensor && rendered.contains(binding.resource)))
          return bad_input(fmt::format("{}, dispatch \"{}\"", where, dispatch.name),
                           "generates pictures, and writes \"{}\", which the next rendered frame "
                           "would find",
                           resource.name);
      }
  return {};
}

Result<void> check_promise(const std::string& where, const Variant& variant) {
  if (!variant.promise) return {};
  SHALE_TRY_VOID(check_name(where, "text of the promise", variant.promise->text));
  if (variant.promise->broken >= variant.resources.size())
    return bad_input(where, "promise: resource {} does not exist, there are {}",
                     variant.promise->broken, variant.resources.size());
  const Resource& broken = variant.resources[variant.promise->broken];
  if (broken.category != Category::kImageInternal || broken.format != ImageFormat::kR32Uint ||
      broken.width != 1 || broken.height != 1)
    return bad_input(where, "promise: \"{}\" is no r32_uint image of 1x1 of the frame loop's own",
                     broken.name);
  return {};
}

Result<void> check_bounds(const std::string& where, const Variant& variant) {
  for (size_t i = 0; i < variant.bounds.size(); ++i) {
    const ValueBounds& bounds = variant.bounds[i];
    const std::string at = fmt::format("{}, bounds {}", where, i);
    if (bounds.resource >= variant.resources.size() ||
        (i > 0 && bounds.resource <= variant.bounds[i - 1].resource))
      return bad_input(at, "resource {} does not exist, or is out of order", bounds.resource);
    const Resource& resource = variant.resources[bounds.resource];
    const uint64_t channels =
        is_image(resource.category) ? image_format_info(resource.format).channels
        : resource.shape.empty()    ? 1
                                    : static_cast<uint64_t>(resource.shape.back());
    if (bounds.low.size() != bounds.high.size() ||
        (bounds.low.size() != 1 && bounds.low.size() != channels))
      return bad_input(at, "{} and {} values, expected one, or one for each of {} channels",
                       bounds.low.size(), bounds.high.size(), channels);
    for (size_t c = 0; c < bounds.low.size(); ++c)
      if (!(bounds.low[c] <= bounds.high[c]))
        return bad_input(at, "{}..{} is no range", bounds.low[c], bounds.high[c]);
  }
  return {};
}

Result<void> check_view(const std::string& where, const View& view, const Variant& variant) {
  SHALE_TRY_VOID(check_name(where, "title", view.title));
  if (view.resource >= variant.resources.size())
    return bad_input(where, "resource {} does not exist, there are {}", view.resource,
                     variant.resources.size());
  const Resource& resource = variant.resources[view.resource];
  const bool shown =
      is_image(resource.category) ||
      ((resource.category == Category::kInput || resource.category == Category::kOutput) &&
       resource.shape.size() == 4 && resource.shape[0] == 1 && resource.dtype == DType::kInt8);
  if (!shown) return bad_input(where, "\"{}\" cannot be viewed", resource.name);
  const uint64_t channels = is_image(resource.category)
                                ? image_format_info(resource.format).channels
                                : static_cast<uint64_t>(resource.shape[3]);
  if (view.channels < 1 || view.channels > 3 || view.first_channel >= channels ||
      view.channels > channels - view.first_channel)
    return bad_input(where, "{} channels from {} on are not in the {} of \"{}\"", view.channels,
                     view.first_channel, channels, resource.name);
  if (!std::isfinite(view.low) || !std::isfinite(view.high) || view.low == view.high)
    return bad_input(where, "{}..{} is no range", view.low, view.high);
  return {};
}

Result<void> check_requirements(const std::string& where, const Variant& variant) {
  if (variant.requirements.features.bits >> kFeatureCount)
    return bad_input(where, "feature bits {:#x} do not exist",
                     variant.requirements.features.bits >> kFeatureCount << kFeatureCount);
  const std::vector<MatrixProduct>& products = variant.requirements.matrix_products;
  if (products.empty() == variant.requirements.features.has(Feature::kCooperativeMatrix))
    return bad_input(where, "requirements name {} products of matrices, and {} {}", products.size(),
                     products.empty() ? "need" : "do not need",
                     feature_name(Feature::kCooperativeMatrix));
  if (std::adjacent_find(products.begin(), products.end(), std::greater_equal<>()) !=
      products.end())
    return bad_input(where, "requirements name products of matrices out of order");
  const Requirements bindings = binding_requirements(variant);
  Result<void> result;
  const auto covers = [&](const char* what, uint64_t stated, uint64_t used) {
    if (result && stated < used)
      result = bad_input(where, "{} is {}, the bindings need {}", what, stated, used);
  };
  const Requirements& stated = variant.requirements;
  for (uint32_t i = 0; i < kFeatureCount; ++i)
    if (const auto feature = static_cast<Feature>(i);
        bindings.features.has(feature) && !stated.features.has(feature))
      return bad_input(where, "the requirements lack {}, which the bindings need",
                       feature_name(feature));
  covers("storage_range_bytes", stated.storage_range_bytes, bindings.storage_range_bytes);
  covers("texel_elements", stated.texel_elements, bindings.texel_elements);
  covers("storage_buffers", stated.storage_buffers, bindings.storage_buffers);
  covers("texel_buffers", stated.texel_buffers, bindings.texel_buffers);
  covers("storage_images", stated.storage_images, bindings.storage_images);
  return result;
}

bool is_identifier(std::string_view text) {
  const auto letter = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
  };
  const auto digit = [](char c) { return c >= '0' && c <= '9'; };
  return !text.empty() && letter(text[0]) &&
         std::all_of(text.begin(), text.end(), [&](char c) { return letter(c) || digit(c); });
}

Result<void> check_programs(const std::string& where, const Variant& variant) {
  if (variant.programs.empty()) return bad_input(where, "has no program");
  std::set<std::string_view> names;
  for (size_t i = 0; i < variant.programs.size(); ++i) {
    const std::string& name = variant.programs[i];
    const std::string at = fmt::format("{}, program {}", where, i);
    SHALE_TRY_VOID(check_unique_name(at, "program name", name, names));
    if (!is_identifier(name)) return bad_input(at, "\"{}\" is no identifier", name);
  }
  uint32_t program = 0;
  for (size_t s = 0; s < variant.segments.size(); ++s) {
    const std::string at = fmt::format("{}, segment {}", where, s);
    const uint32_t next = variant.segments[s].program;
    if (next >= variant.programs.size())
      return bad_input(at, "program {} does not exist, there are {}", next,
                       variant.programs.size());
    if (next < program || next > program + (s == 0 ? 0 : 1))
      return bad_input(at, "program {} does not follow program {}", next, program);
    program = next;
  }
  if (variant.segments.empty() || program + 1 < variant.programs.size())
    return bad_input(where, "program \"{}\" has no segment",
                     variant.programs[variant.segments.empty() ? 0 : program + 1]);
  return {};
}

Result<void> check_variant(const std::string& where, const Variant& variant,
                           uint64_t weight_bytes) {
  SHALE_TRY_VOID(check_name(where, "target name", variant.target));
  if (static_cast<uint32_t>(variant.device_class) >= kDeviceClassCount)
    return bad_input(where, "device class {} does not exist",
                     static_cast<uint32_t>(variant.device_class));
  if (variant.arena_bytes >= kMaxTensorBytes)
    return bad_input(where, "an arena of {} bytes is not below {}", variant.arena_bytes,
                     kMaxTensorBytes);
  std::set<std::string_view> names;
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    SHALE_TRY_VOID(check_unique_name(fmt::format("{}, resource {}", where, i), "resource name",
                                     resource.name, names));
    const std::string at = fmt::format("{}, resource \"{}\"", where, resource.name);
    if (static_cast<uint32_t>(resource.category) >= kCategoryCount)
      return bad_input(at, "category {} does not exist", static_cast<uint32_t>(resource.category));
    SHALE_TRY_VOID(is_image(resource.category) ? check_image(at, resource)
                                               : check_tensor(at, resource, variant, weight_bytes));
  }
  for (size_t i = 0; i < variant.modules.size(); ++i) {
    const Spirv& words = variant.modules[i];
    if (words.size() < kSpirvHeaderWords || words[0] != kSpirvMagic)
      return bad_input(fmt::format("{}, module {}", where, i), "holds no SPIR-V");
  }
  std::set<std::string_view> segment_names;
  std::set<std::string_view> dispatch_names;
  for (size_t s = 0; s < variant.segments.size(); ++s) {
    const Segment& segment = variant.segments[s];
    const std::string at = fmt::format("{}, segment {}", where, s);
    SHALE_TRY_VOID(check_unique_name(at, "segment name", segment.name, segment_names));
    if (segment.kind > SegmentKind::kTransfer)
      return bad_input(at, "segment kind {} does not exist", static_cast<uint32_t>(segment.kind));
    SHALE_TRY_VOID(check_tiles(at, segment, variant));
    for (size_t d = 0; d < segment.dispatches.size(); ++d) {
      const Dispatch& dispatch = segment.dispatches[d];
      SHALE_TRY_VOID(check_unique_name(fmt::format("{}, dispatch {}", at, d), "dispatch name",
                                       dispatch.name, dispatch_names));
      SHALE_TRY_VOID(check_dispatch(fmt::format("{}, dispatch \"{}\"", where, dispatch.name),
                                    dispatch, variant, segment));
    }
    SHALE_TRY_VOID(check_start_forms(at, segment, variant));
  }
  SHALE_TRY_VOID(check_programs(where, variant));
  SHALE_TRY_VOID(check_params(where, variant));
  SHALE_TRY_VOID(check_choices(where, variant));
  SHALE_TRY_VOID(check_generator(where, variant));
  SHALE_TRY_VOID(check_promise(where, variant));
  SHALE_TRY_VOID(check_bounds(where, variant));
  for (size_t i = 0; i < variant.views.size(); ++i)
    SHALE_TRY_VOID(check_view(fmt::format("{}, view {}", where, i), variant.views[i], variant));
  for (size_t i = 0; i < variant.proofs.size(); ++i) {
    const std::string at = fmt::format("{}, proof {}", where, i);
    SHALE_TRY_VOID(check_name(at, "name", variant.proofs[i].name));
    SHALE_TRY_VOID(check_proof(at, variant.proofs[i]));
  }
  return check_requirements(where, variant);
}

}  // namespace

Requirements binding_requirements(const Variant& variant) {
  Requirements needs;
  const auto add = [&](const Dispatch& dispatch) {
    uint32_t storage_buffers = 0;
    uint32_t texel_buffers = 0;
    uint32_t storage_images = 0;
    for (const Binding& binding : dispatch.bindings) {
      const Resource& resource = variant.resources[binding.resource];
      switch (binding.type) {
        case BindingType::kStorageBuffer:
          ++storage_buffers;
          needs.storage_range_bytes = std::max(needs.storage_range_bytes, bound_bytes(resource));
          break;
        case BindingType::kUniformTexelBuffer:
          ++texel_buffers;
          needs.texel_elements =
              std::max(needs.texel_elements,
                       resource.size_bytes / image_format_info(binding.view_format).texel_bytes);
          break;
        case BindingType::kSampledImage:
        case BindingType::kSampler: ++texel_buffers; break;
        case BindingType::kStorageImage:
          ++storage_images;
          if (image_format_info(resource.format).extended)
            needs.features.add(Feature::kStorageImageExtended);
          break;
        case BindingType::kTransfer: break;
      }
    }
    needs.storage_buffers = std::max(needs.storage_buffers, storage_buffers);
    needs.texel_buffers = std::max(needs.texel_buffers, texel_buffers);
    needs.storage_images = std::max(needs.storage_images, storage_images);
  };
  for (const Segment& segment : variant.segments) {
    for (const Dispatch& dispatch : segment.dispatches) add(dispatch);
    for (const StartForm& start : segment.start_forms) add(start.form);
  }
  return needs;
}

Result<void> check_package(const Package& package) {
  const Provenance& provenance = package.provenance;
  if (has_control_characters(provenance.model_name) ||
      has_control_characters(provenance.compiler) || has_control_characters(provenance.options))
    return bad_input("provenance", "has control characters");
  if (package.variants.empty()) return bad_input("", "the package has no variant");
  for (size_t i = 0; i < package.variants.size(); ++i)
    SHALE_TRY_VOID(
        check_variant(fmt::format("variant {}", i), package.variants[i], package.weights.size()));
  return {};
}

}  // namespace shale
