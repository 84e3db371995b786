// Packages as VGF files of compute segments.
#include <algorithm>

#include "compiler/frontend/vgf/convert.h"
#include "compiler/frontend/vgf/formats.h"

namespace shale {
namespace {

// Numbers of VkDescriptorType and VkShaderStageFlagBits.
constexpr uint32_t kSampledImage = 2, kStorageImage = 3, kUniformTexelBuffer = 4;
constexpr uint32_t kStorageBuffer = 7;
constexpr uint32_t kComputeStage = 0x20;

uint32_t vk_format(ImageFormat format) {
  switch (format) {
    case ImageFormat::kNone: return 0;
    case ImageFormat::kRgba8Unorm: return 37;
    case ImageFormat::kRgba16Float: return 97;
    case ImageFormat::kRg16Float: return 83;
    case ImageFormat::kR32Float: return 100;
    case ImageFormat::kR8Unorm: return 9;
    case ImageFormat::kR32Uint: return 98;
    case ImageFormat::kRgba32Float: return 109;
    case ImageFormat::kR16Float: return 76;
    case ImageFormat::kRgba8Sint: return 42;
    case ImageFormat::kR8Sint: return 14;
    case ImageFormat::kRg8Unorm: return 16;
    case ImageFormat::kRgba8Snorm: return 38;
    case ImageFormat::kRgba32Uint: return 107;
    case ImageFormat::kRg32Uint: return 101;
    case ImageFormat::kR16Uint: return 74;
  }
  return 0;
}

class Converter {
 public:
  Converter(const Package& package, const Variant& variant, bool weights_as_inputs)
      : package_(package), variant_(variant), weights_as_inputs_(weights_as_inputs) {}

  Result<Vgf> convert() {
    if (variant_.programs.size() > 1)
      return unsupported("", "has {} programs, VGF has one sequence of segments only",
                         variant_.programs.size());
    if (variant_.promise)
      return unsupported("",
                         "has passes that the device chooses between, which VGF does not have; "
                         "compile without needs");
    for (const Segment& segment : variant_.segments) {
      if (segment.tiles)
        return unsupported(fmt::format("segment \"{}\"", segment.name),
                           "works by tiles, by commands of the device that VGF does not have");
      if (!segment.start_forms.empty())
        return unsupported(fmt::format("segment \"{}\"", segment.name),
                           "has kernels for the start, of which VGF has none; compile with "
                           "--prefer throughput");
    }
    for (const Param& param : variant_.params)
      if (param.source != ParamSource::kHost)
        return unsupported(fmt::format("parameter \"{}\"", param.name),
                           "follows the history of frames, which VGF does not have");
    for (const Spirv& words : variant_.modules)
      vgf_.modules.push_back({VgfModuleType::kCompute,
                              fmt::format("module_{}", vgf_.modules.size()), "main",
                              VgfCode::kSpirv, words, ""});
    classify();
    entries_.resize(variant_.resources.size());
    for (uint32_t i = 0; i < variant_.resources.size(); ++i) SHALE_TRY_VOID(add_resource(i));
    add_interface();
    for (const Segment& segment : variant_.segments)
      for (const Dispatch& dispatch : segment.dispatches) add_dispatch(segment, dispatch);
    add_weights();
    return std::move(vgf_);
  }

 private:
  struct Use {
    BindingType type = BindingType::kStorageBuffer;
    ImageFormat view_format = ImageFormat::kNone;
    bool operator==(const Use&) const = default;
  };
  struct Entry {
    Use use;
    uint32_t resource;  ///< in the file
  };

  /// Every way in which a resource is bound, in order of first use, and what VGF calls it: the
  /// network's tensors that a pass fills or reads belong to no one outside.
  void classify() {
    categories_.resize(variant_.resources.size());
    uses_.resize(variant_.resources.size());
    for (size_t i = 0; i < categories_.size(); ++i) {
      switch (variant_.resources[i].category) {
        case Category::kInput:
        case Category::kWeights:
        case Category::kImageInput: categories_[i] = VgfCategory::kInput; break;
        case Category::kOutput:
        case Category::kImageOutput: categories_[i] = VgfCategory::kOutput; break;
        default: categories_[i] = VgfCategory::kIntermediate;
      }
    }
    for (const Segment& segment : variant_.segments)
      for (const Dispatch& dispatch : segment.dispatches)
        for (const Binding& binding : dispatch.bindings) {
          const Category category = variant_.resources[binding.resource].category;
          if ((category == Category::kInput && binding.writes) ||
              (category == Category::kOutput && binding.reads &&
               segment.kind == SegmentKind::kCompute))
            categories_[binding.resource] = VgfCategory::kIntermediate;
          std::vector<Use>& uses = uses_[binding.resource];
          const Use use{binding.type, binding.view_format};
          if (std::find(uses.begin(), uses.end(), use) == uses.end()) uses.push_back(use);
        }
  }

  Result<void> add_resource(uint32_t index) {
    const Resource& resource = variant_.resources[index];
    std::vector<Use> uses = uses_[index];
    const std::string where = fmt::format("resource \"{}\"", resource.name);
    if (resource.history_depth != 0)
      return unsupported(where, "is a history of earlier frames, VGF has one frame only");
    if (std::any_of(uses.begin(), uses.end(),
                    [](const Use& use) { return use.type == BindingType::kSampler; }))
      return unsupported(where, "is read with a sampler, which cannot be converted");
    if (is_linear(resource))
      return unsupported(where, "is a linear image, which the segments of a VGF cannot fill");
    if (resource.category == Category::kWeights && !weights_as_inputs_)
      return unsupported(where,
                         "is a constant, which VGF binds to no compute segment; "
                         "--weights-as-inputs makes it an input of the model");
    if (uses.empty()) {
      // Who uses the package still gives and takes what no dispatch touches.
      if (categories_[index] == VgfCategory::kIntermediate) return {};
      uses.push_back(
          {is_image(resource.category) ? BindingType::kStorageImage : BindingType::kStorageBuffer,
           ImageFormat::kNone});
    }
    for (const Use& use : uses) {
      VgfResource entry = described(resource, use);
      entry.category = categories_[index];
      if (uses.size() > 1) entry.alias_group = alias_groups_;
      entries_[index].push_back({use, static_cast<uint32_t>(vgf_.resources.size())});
      vgf_.resources.push_back(std::move(entry));
    }
    alias_groups_ += uses.size() > 1;
    return {};
  }

  static VgfResource described(const Resource& resource, const Use& use) {
    VgfResource entry;
    const int64_t bytes = static_cast<int64_t>(bound_bytes(resource));
    switch (use.type) {
      case BindingType::kStorageBuffer:
        entry.descriptor_type = kStorageBuffer;
        entry.format = vk_format_of_dtype(resource.dtype);
        entry.shape = resource.shape;
        if (resource.size_bytes != bound_bytes(resource))
          entry.shape = {bytes / dtype_info(resource.dtype).host_bytes};
        break;
      case BindingType::kUniformTexelBuffer:
        entry.descriptor_type = kUniformTexelBuffer;
        entry.format = vk_format(use.view_format);
        entry.shape = {bytes / image_format_info(use.view_format).texel_bytes};
        break;
      case BindingType::kSampledImage:
      case BindingType::kStorageImage:
        entry.descriptor_type =
            use.type == BindingType::kSampledImage ? kSampledImage : kStorageImage;
        entry.format = vk_format(resource.format);
        entry.shape = {1, resource.height, resource.width,
                       image_format_info(resource.format).channels};
        break;
      case BindingType::kTransfer:        // one end is a linear image, which is refused
      case BindingType::kSampler: break;  // refused
    }
    return entry;
  }

  /// The outer interface numbers its slots through, inputs first.
  void add_interface() {
    uint32_t binding = 0;
    const auto add = [&](VgfCategory category, std::vector<VgfSlot>& slots,
                         std::vector<std::string>& names) {
      for (size_t i = 0; i < entries_.size(); ++i) {
        if (categories_[i] != category || entries_[i].empty()) continue;
        slots.push_back({binding++, entries_[i].front().resource});
        names.push_back(variant_.resources[i].name);
      }
    };
    add(VgfCategory::kInput, vgf_.inputs, vgf_.input_names);
    add(VgfCategory::kOutput, vgf_.outputs, vgf_.output_names);
  }

  void add_dispatch(const Segment& from, const Dispatch& dispatch) {
    VgfSegment segment;
    segment.name = dispatch.name;
    segment.module = dispatch.module;
    segment.dispatch = dispatch.workgroups;
    VgfDescriptorSet& set = segment.sets.emplace_back();
    set.set_index = 0;
    for (const Binding& binding : dispatch.bindings) {
      const std::vector<Entry>& entries = entries_[binding.resource];
      const Use use{binding.type, binding.view_format};
      const auto entry = std::find_if(entries.begin(), entries.end(),
                                      [&](const Entry& e) { return e.use == use; });
      const VgfSlot slot{binding.binding, entry->resource};
      set.bindings.push_back(slot);
      if (binding.reads) segment.inputs.push_back(slot);
      if (binding.writes) segment.outputs.push_back(slot);
    }
    const uint32_t bytes = from.kind == SegmentKind::kCompute ? param_bytes(variant_) : 0;
    if (bytes > 0) segment.push_constants.push_back({kComputeStage, 0, bytes});
    vgf_.segments.push_back(std::move(segment));
  }

  void add_weights() {
    for (const Resource& resource : variant_.resources) {
      if (resource.category != Category::kWeights) continue;
      const auto begin = package_.weights.begin() + static_cast<ptrdiff_t>(resource.offset_bytes);
      vgf_.constants.push_back({static_cast<uint32_t>(vgf_.resources.size()),
                                -1,
                                {begin, begin + static_cast<ptrdiff_t>(resource.size_bytes)}});
      VgfResource entry;
      entry.format = vk_format_of_dtype(resource.dtype);
      entry.category = VgfCategory::kConstant;
      entry.shape = resource.shape;
      vgf_.resources.push_back(std::move(entry));
    }
  }

  const Package& package_;
  const Variant& variant_;
  const bool weights_as_inputs_;
  std::vector<VgfCategory> categories_;      ///< by resource
  std::vector<std::vector<Use>> uses_;       ///< by resource
  std::vector<std::vector<Entry>> entries_;  ///< by resource
  uint32_t alias_groups_ = 0;
  Vgf vgf_;
};

}  // namespace

Result<Vgf> package_to_vgf(const Package& package, const PackageToVgfOptions& options) {
  if (options.variant >= package.variants.size())
    return bad_input("--variant", "found {}, the package has {}", options.variant,
                     package.variants.size());
  return Converter(package, package.variants[options.variant], options.weights_as_inputs).convert();
}

}  // namespace shale
