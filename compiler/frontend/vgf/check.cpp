// What the parts of a VGF file must mean to each other.
#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <set>

#include "compiler/frontend/vgf/layout.h"
#include "ir/graph/tensor.h"

namespace shale {
namespace {

constexpr uint32_t kSpirvMagic = 0x07230203;
constexpr size_t kSpirvHeaderWords = 5;

using vgf_layout::label;

Result<void> check_module(const std::string& where, const VgfModule& module) {
  if (module.type > VgfModuleType::kGraph)
    return bad_input(where, "module type {} does not exist", static_cast<uint32_t>(module.type));
  if (module.code > VgfCode::kHlsl)
    return bad_input(where, "code type {} does not exist", static_cast<uint32_t>(module.code));
  const bool is_text = module.code == VgfCode::kGlsl || module.code == VgfCode::kHlsl;
  if ((!module.words.empty() && module.code != VgfCode::kSpirv) ||
      (!module.source.empty() && !is_text))
    return bad_input(where, "holds code of another kind than {}", vgf_name(module.code));
  if (module.words.empty()) return {};
  if (module.words.size() < kSpirvHeaderWords || module.words[0] != kSpirvMagic)
    return bad_input(where, "holds no SPIR-V: found {} words, the first {:#010x}",
                     module.words.size(), module.words[0]);
  return {};
}

/// Bytes of the packed tensor, or nothing if a dimension is open or the size is above 2^63.
std::optional<uint64_t> packed_bytes(const std::vector<int64_t>& shape, uint32_t element_bytes) {
  uint64_t bytes = element_bytes;
  bool is_empty = false;
  for (const int64_t dim : shape) {
    if (dim < 0) return std::nullopt;
    is_empty |= dim == 0;
    if (dim > 0 && bytes > static_cast<uint64_t>(INT64_MAX) / static_cast<uint64_t>(dim))
      return std::nullopt;
    bytes *= static_cast<uint64_t>(std::max<int64_t>(dim, 1));
  }
  return is_empty ? 0 : bytes;
}

/// Bytes from the first to the last of a buffer or tensor, where they are known.
std::optional<uint64_t> storage_bytes(const VgfResource& resource) {
  // Uniform and storage texel buffers, uniform and storage buffers.
  const bool is_linear = resource.descriptor_type == kVkDescriptorTensor ||
                         (resource.descriptor_type >= 4 && resource.descriptor_type <= 7);
  const uint32_t element = vk_format_bytes(resource.format);
  if (!is_linear || element == 0) return std::nullopt;
  const std::optional<uint64_t> packed = packed_bytes(resource.shape, element);
  if (!packed || *packed == 0 || resource.strides.empty()) return packed;
  uint64_t bytes = element;
  for (size_t i = 0; i < resource.shape.size(); ++i) {
    const uint64_t steps = static_cast<uint64_t>(resource.shape[i]) - 1;
    const int64_t stride = resource.strides[i];
    if (stride < 0 || (steps > 0 && static_cast<uint64_t>(stride) > (INT64_MAX - bytes) / steps))
      return std::nullopt;
    bytes += steps * static_cast<uint64_t>(stride);
  }
  return bytes;
}

Result<void> check_resource(const std::string& where, const VgfResource& resource) {
  if (resource.category > VgfCategory::kConstant)
    return bad_input(where, "category {} does not exist", static_cast<uint32_t>(resource.category));
  if (!resource.strides.empty() && resource.strides.size() != resource.shape.size())
    return bad_input(where, "has {} strides, expected none or {}", resource.strides.size(),
                     resource.shape.size());
  if (resource.category == VgfCategory::kConstant && resource.alias_group != kVgfNone)
    return bad_input(where, "is a constant in alias group {}, constants share no storage",
                     resource.alias_group);
  return {};
}

Result<void> check_alias_groups(const Vgf& vgf) {
  struct First {
    size_t index;
    uint64_t bytes;
  };
  std::map<uint32_t, First> groups;
  for (size_t i = 0; i < vgf.resources.size(); ++i) {
    const VgfResource& resource = vgf.resources[i];
    if (resource.alias_group == kVgfNone) continue;
    const std::optional<uint64_t> bytes = storage_bytes(resource);
    if (!bytes) continue;
    const First& first = groups.try_emplace(resource.alias_group, First{i, *bytes}).first->second;
    if (first.bytes != *bytes)
      return bad_input(fmt::format("resource {}", i),
                       "has {} bytes, resource {} of the same alias group {} has {}", *bytes,
                       first.index, resource.alias_group, first.bytes);
  }
  return {};
}

Result<void> check_slots(const std::string& where, const Vgf& vgf,
                         const std::vector<VgfSlot>& slots) {
  for (size_t i = 0; i < slots.size(); ++i) {
    const std::string at = fmt::format("{} {}", where, i);
    if (slots[i].resource >= vgf.resources.size())
      return bad_input(at, "resource {} does not exist, there are {}", slots[i].resource,
                       vgf.resources.size());
    if (vgf.resources[slots[i].resource].category == VgfCategory::kConstant)
      return bad_input(at, "binds resource {}, a constant", slots[i].resource);
  }
  return {};
}

/// Slots of the sets, each binding number once.
Result<std::vector<VgfSlot>> check_sets(const std::string& where, const Vgf& vgf,
                                        const VgfSegment& segment) {
  std::vector<VgfSlot> all;
  std::set<uint32_t> numbers;
  for (size_t i = 0; i < segment.sets.size(); ++i) {
    const std::string at = fmt::format("{}, set {}", where, i);
    if (!numbers.insert(segment.set_number(i)).second)
      return bad_input(at, "the set number {} is taken already", segment.set_number(i));
    const std::vector<VgfSlot>& slots = segment.sets[i].bindings;
    SHALE_TRY_VOID(check_slots(at + ", slot", vgf, slots));
    std::set<uint32_t> bindings;
    for (const VgfSlot& slot : slots)
      if (!bindings.insert(slot.binding).second)
        return bad_input(at, "the binding number {} is taken already", slot.binding);
    all.insert(all.end(), slots.begin(), slots.end());
  }
  return all;
}

Result<void> check_segment(const std::string& where, const Vgf& vgf, const VgfSegment& segment) {
  if (segment.module >= vgf.modules.size())
    return bad_input(where, "module {} does not exist, there are {}", segment.module,
                     vgf.modules.size());
  if (segment.type > VgfModuleType::kGraph)
    return bad_input(where, "segment type {} does not exist", static_cast<uint32_t>(segment.type));
  const VgfModuleType type = vgf.modules[segment.module].type;
  if (segment.type != type)
    return bad_input(where, "has the type {}, its module {} is {}", vgf_name(segment.type),
                     segment.module, vgf_name(type));
  SHALE_TRY(std::vector<VgfSlot> bound, check_sets(where, vgf, segment));
  const auto less = [](const VgfSlot& a, const VgfSlot& b) {
    return std::pair(a.binding, a.resource) < std::pair(b.binding, b.resource);
  };
  std::sort(bound.begin(), bound.end(), less);
  for (const bool is_input : {true, false}) {
    const std::string what = fmt::format("{}, {}", where, is_input ? "input" : "output");
    const std::vector<VgfSlot>& slots = is_input ? segment.inputs : segment.outputs;
    SHALE_TRY_VOID(check_slots(what, vgf, slots));
    for (size_t i = 0; i < slots.size(); ++i) {
      const std::string at = fmt::format("{} {}", what, i);
      if (!std::binary_search(bound.begin(), bound.end(), slots[i], less))
        return bad_input(at, "binding {} of resource {} is in no set of the segment",
                         slots[i].binding, slots[i].resource);
      if (!is_input && vgf.resources[slots[i].resource].category == VgfCategory::kInput)
        return bad_input(at, "writes resource {}, an input of the model", slots[i].resource);
    }
  }
  for (const uint32_t constant : segment.constants)
    if (constant >= vgf.constants.size())
      return bad_input(where, "constant {} does not exist, there are {}", constant,
                       vgf.constants.size());
  for (const VgfPushConstants& range : segment.push_constants)
    if (range.offset % 4 != 0 || range.size % 4 != 0 || range.size > UINT32_MAX - range.offset)
      return bad_input(where, "the push constants, {} bytes at {}, are no range of 32-bit words",
                       range.size, range.offset);
  return {};
}

Result<void> check_model_slots(const char* what, const Vgf& vgf, const std::vector<VgfSlot>& slots,
                               const std::vector<std::string>& names, VgfCategory category) {
  SHALE_TRY_VOID(check_slots(what, vgf, slots));
  for (size_t i = 0; i < slots.size(); ++i) {
    const VgfCategory found = vgf.resources[slots[i].resource].category;
    if (found != category)
      return bad_input(fmt::format("{} {}", what, i), "resource {} is {}, expected {}",
                       slots[i].resource, vgf_name(found), vgf_name(category));
  }
  if (!names.empty() && names.size() != slots.size())
    return bad_input(what, "has {} names for {} slots", names.size(), slots.size());
  return {};
}

Result<void> check_constant(const std::string& where, const Vgf& vgf, const VgfConstant& constant) {
  if (constant.resource >= vgf.resources.size())
    return bad_input(where, "resource {} does not exist, there are {}", constant.resource,
                     vgf.resources.size());
  const VgfResource& resource = vgf.resources[constant.resource];
  if (resource.category != VgfCategory::kConstant)
    return bad_input(where, "resource {} is {}, expected CONSTANT", constant.resource,
                     vgf_name(resource.category));
  const int64_t rank = static_cast<int64_t>(resource.shape.size());
  if (constant.sparsity_dimension < -1 || constant.sparsity_dimension >= rank)
    return bad_input(where, "the sparsity dimension {} is no dimension of rank {}",
                     constant.sparsity_dimension, rank);
  const uint32_t element = vk_format_bytes(resource.format);
  if (element == 0) return {};
  const std::optional<uint64_t> bytes = packed_bytes(resource.shape, element);
  if (!bytes)
    return bad_input(where, "the shape {} of resource {} has no size", shape_text(resource.shape),
                     constant.resource);
  if (*bytes != constant.bytes.size())
    return bad_input(where, "holds {} bytes, {}{} of resource {} makes {}", constant.bytes.size(),
                     vk_format_name(resource.format), shape_text(resource.shape), constant.resource,
                     *bytes);
  return {};
}

}  // namespace

Result<void> check_vgf(const Vgf& vgf) {
  for (size_t i = 0; i < vgf.modules.size(); ++i)
    SHALE_TRY_VOID(check_module(label("module", i, vgf.modules[i].name), vgf.modules[i]));
  for (size_t i = 0; i < vgf.resources.size(); ++i)
    SHALE_TRY_VOID(check_resource(fmt::format("resource {}", i), vgf.resources[i]));
  SHALE_TRY_VOID(check_alias_groups(vgf));
  for (size_t i = 0; i < vgf.constants.size(); ++i)
    SHALE_TRY_VOID(check_constant(fmt::format("constant {}", i), vgf, vgf.constants[i]));
  for (size_t i = 0; i < vgf.segments.size(); ++i)
    SHALE_TRY_VOID(check_segment(label("segment", i, vgf.segments[i].name), vgf, vgf.segments[i]));
  SHALE_TRY_VOID(
      check_model_slots("model input", vgf, vgf.inputs, vgf.input_names, VgfCategory::kInput));
  return check_model_slots("model output", vgf, vgf.outputs, vgf.output_names,
                           VgfCategory::kOutput);
}

Result<void> check_sparsity(const Vgf& vgf, size_t index) {
  const VgfConstant& constant = vgf.constants[index];
  const VgfResource& resource = vgf.resources[constant.resource];
  const size_t element = vk_format_bytes(resource.format);
  if (constant.sparsity_dimension < 0 || element == 0 || constant.bytes.empty()) return {};
  const size_t dimension = static_cast<size_t>(constant.sparsity_dimension);
  const std::string where = fmt::format("constant {}", index);
  const size_t extent = static_cast<size_t>(resource.shape[dimension]);
  if (extent % 4 != 0)
    return bad_input(where,
                     "is marked 2:4 sparse along dimension {}, whose {} elements are no "
                     "multiple of 4",
                     dimension, extent);
  size_t inner = 1;  // elements from one to the next along the dimension
  for (size_t i = dimension + 1; i < resource.shape.size(); ++i)
    inner *= static_cast<size_t>(resource.shape[i]);
  const size_t count = constant.bytes.size() / element;
  for (size_t first = 0; first < count; ++first) {
    if (first / inner % 4 != 0) continue;  // no first of four
    size_t used = 0;
    for (size_t k = 0; k < 4; ++k) {
      const auto begin =
          constant.bytes.begin() + static_cast<ptrdiff_t>((first + k * inner) * element);
      used += std::any_of(begin, begin + static_cast<ptrdiff_t>(element),
                          [](uint8_t byte) { return byte != 0; });
    }
    if (used <= 2) continue;
    std::vector<size_t> position(resource.shape.size());
    for (size_t i = position.size(), rest = first; i-- > 0;) {
      position[i] = rest % static_cast<size_t>(resource.shape[i]);
      rest /= static_cast<size_t>(resource.shape[i]);
    }
    return bad_input(where,
                     "is marked 2:4 sparse along dimension {}, but {} of the four elements from "
                     "[{}] on are not zero",
                     dimension, used, fmt::join(position, ","));
  }
  return {};
}

}  // namespace shale
