#include "compiler/spirv/reflection.h"

#include <algorithm>
#include <map>
#include <spirv/unified1/spirv.hpp>

namespace shale {
namespace {

/// What is known of an id.
struct Id {
  uint32_t opcode = 0;
  std::vector<uint32_t> operands;  ///< behind the result id; for types and constants
  uint32_t set = 0, binding = UINT32_MAX;
  bool is_block = false;                 ///< decorated Block
  std::map<uint32_t, uint32_t> offsets;  ///< of members
  uint32_t array_stride = 0, matrix_stride = 0;
};

class Reflector {
 public:
  Reflector(const Spirv& words, std::string where) : words_(words), where_(std::move(where)) {}

  Result<Interface> run() {
    for (size_t at = 5; at < words_.size();) {
      const uint32_t opcode = words_[at] & 0xffff, length = words_[at] >> 16;
      if (length == 0 || at + length > words_.size())
        return bad_input(where_, "word {}: broken instruction", at);
      if (opcode == spv::OpFunction) break;  // declarations are over
      collect(opcode, std::span(words_).subspan(at + 1, length - 1));
      at += length;
    }
    Interface interface;
    for (const uint32_t id : variables_) SHALE_TRY_VOID(add(interface, id));
    std::sort(interface.bindings.begin(), interface.bindings.end(),
              [](const DeclaredBinding& a, const DeclaredBinding& b) {
                return std::pair(a.set, a.binding) < std::pair(b.set, b.binding);
              });
    return interface;
  }

 private:
  void collect(uint32_t opcode, std::span<const uint32_t> operands) {
    const auto keep = [&](size_t result) {
      if (operands.size() <= result) return;
      Id& id = ids_[operands[result]];
      id.opcode = opcode;
      id.operands.assign(operands.begin() + static_cast<std::ptrdiff_t>(result) + 1,
                         operands.end());
    };
    switch (opcode) {
      case spv::OpDecorate:
        if (operands.size() < 2) return;
        if (operands[1] == spv::DecorationBlock) ids_[operands[0]].is_block = true;
        if (operands.size() < 3) return;
        if (operands[1] == spv::DecorationDescriptorSet) ids_[operands[0]].set = operands[2];
        if (operands[1] == spv::DecorationBinding) ids_[operands[0]].binding = operands[2];
        if (operands[1] == spv::DecorationArrayStride) ids_[operands[0]].array_stride = operands[2];
        return;
      case spv::OpMemberDecorate:
        if (operands.size() >= 4 && operands[2] == spv::DecorationOffset)
          ids_[operands[0]].offsets[operands[1]] = operands[3];
        return;
      case spv::OpTypeInt:
      case spv::OpTypeFloat:
      case spv::OpTypeVector:
      case spv::OpTypeArray:
      case spv::OpTypeRuntimeArray:
      case spv::OpTypeStruct:
      case spv::OpTypeImage:
      case spv::OpTypeSampledImage:
      case spv::OpTypePointer: keep(0); return;
      case spv::OpConstant: keep(1); return;
      case spv::OpVariable:
        if (operands.size() < 3) return;
        variables_.push_back(operands[1]);
        ids_[operands[1]].opcode = opcode;
        ids_[operands[1]].operands = {operands[0], operands[2]};  // pointer type, storage class
        return;
      default: return;
    }
  }

  uint32_t operand(const Id& id, size_t index) const {
    return index < id.operands.size() ? id.operands[index] : 0;
  }

  /// Bytes of a type as std430 lays it out; 0 for what has no size.
  uint32_t bytes_of(uint32_t type) {
    const Id& id = ids_[type];
    switch (id.opcode) {
      case spv::OpTypeInt:
      case spv::OpTypeFloat: return operand(id, 0) / 8;
      case spv::OpTypeVector: return bytes_of(operand(id, 0)) * operand(id, 1);
      case spv::OpTypeArray: return id.array_stride * operand(ids_[operand(id, 1)], 0);
      case spv::OpTypeStruct: {
        uint32_t end = 0;
        for (const auto& [member, offset] : id.offsets)
          end = std::max(end, offset + bytes_of(operand(id, member)));
        return end;
      }
      default: return 0;
    }
  }

  NumericClass numbers_of(uint32_t type) {
    const Id& id = ids_[type];
    if (id.opcode == spv::OpTypeFloat) return NumericClass::kFloat;
    if (id.opcode != spv::OpTypeInt) return NumericClass::kNone;
    return operand(id, 1) != 0 ? NumericClass::kInt : NumericClass::kUint;
  }

  static ImageFormat format_of(uint32_t format) {
    switch (format) {
      case spv::ImageFormatRgba32f: return ImageFormat::kRgba32Float;
      case spv::ImageFormatRgba16f: return ImageFormat::kRgba16Float;
      case spv::ImageFormatR32f: return ImageFormat::kR32Float;
      case spv::ImageFormatRgba8: return ImageFormat::kRgba8Unorm;
      case spv::ImageFormatRgba8Snorm: return ImageFormat::kRgba8Snorm;
      case spv::ImageFormatRg16f: return ImageFormat::kRg16Float;
      case spv::ImageFormatR16f: return ImageFormat::kR16Float;
      case spv::ImageFormatRg8: return ImageFormat::kRg8Unorm;
      case spv::ImageFormatR8: return ImageFormat::kR8Unorm;
      case spv::ImageFormatR32ui: return ImageFormat::kR32Uint;
      default: return ImageFormat::kNone;
    }
  }

  Result<void> add(Interface& interface, uint32_t variable) {
    const Id& id = ids_[variable];
    const uint32_t storage = operand(id, 1);
    uint32_t type = operand(ids_[operand(id, 0)], 1);  // what the pointer points to
    if (storage == spv::StorageClassPushConstant) {
      interface.push_constant_bytes = bytes_of(type);
      return {};
    }
    if (storage != spv::StorageClassUniformConstant && storage != spv::StorageClassStorageBuffer &&
        storage != spv::StorageClassUniform)
      return {};
    DeclaredBinding declared;
    declared.set = id.set;
    declared.binding = id.binding;
    if (ids_[type].opcode == spv::OpTypeArray) {
      declared.array_size = operand(ids_[operand(ids_[type], 1)], 0);
      type = operand(ids_[type], 0);
    }
    if (storage == spv::StorageClassStorageBuffer) {
      declared.type = BindingType::kStorageBuffer;
      interface.bindings.push_back(declared);
      return {};
    }
    const bool is_combined = ids_[type].opcode == spv::OpTypeSampledImage;
    if (is_combined) type = operand(ids_[type], 0);
    const Id& image = ids_[type];
    const std::string at = fmt::format("{}, binding {}", where_, declared.binding);
    if (storage == spv::StorageClassUniform || image.opcode != spv::OpTypeImage)
      return unsupported(at,
                         "the shader declares a descriptor that is no image and no storage buffer");
    // Sampled type, dimension, depth, arrayed, multisampled, sampled, format.
    declared.numbers = numbers_of(operand(image, 0));
    const bool is_storage = operand(image, 5) == 2;
    if (operand(image, 1) == spv::DimBuffer && !is_storage)
      declared.type = BindingType::kUniformTexelBuffer;
    else if (operand(image, 1) != spv::Dim2D || operand(image, 3) != 0 || operand(image, 4) != 0)
      return unsupported(at, "the shader declares an image that is no plain 2D image");
    else if (is_storage)
      declared.type = BindingType::kStorageImage;
    else
      declared.type = is_combined ? BindingType::kSampler : BindingType::kSampledImage;
    if (is_storage) declared.format = format_of(operand(image, 6));
    interface.bindings.push_back(declared);
    return {};
  }

  const Spirv& words_;
  std::string where_;
  std::map<uint32_t, Id> ids_;
  std::vector<uint32_t> variables_;
};

const char* kind_name(BindingType type) {
  switch (type) {
    case BindingType::kStorageBuffer: return "a storage buffer";
    case BindingType::kUniformTexelBuffer: return "a texel buffer";
    case BindingType::kSampledImage: return "a sampled image";
    case BindingType::kStorageImage: return "a storage image";
    case BindingType::kTransfer: return "an end of a transfer";
    case BindingType::kSampler: return "an image with a sampler";
  }
  return "?";
}

const char* class_name(NumericClass numbers) {
  switch (numbers) {
    case NumericClass::kNone: return "no numbers";
    case NumericClass::kFloat: return "floats";
    case NumericClass::kInt: return "ints";
    case NumericClass::kUint: return "uints";
  }
  return "?";
}

NumericClass class_of(ImageFormat format) {
  switch (format) {
    case ImageFormat::kRgba8Sint:
    case ImageFormat::kR8Sint: return NumericClass::kInt;
    case ImageFormat::kR16Uint:
    case ImageFormat::kR32Uint:
    case ImageFormat::kRg32Uint:
    case ImageFormat::kRgba32Uint: return NumericClass::kUint;
    case ImageFormat::kNone: return NumericClass::kNone;
    default: return NumericClass::kFloat;
  }
}

}  // namespace

Result<Interface> reflect(const Spirv& words, const std::string& where) {
  return Reflector(words, where).run();
}

Result<void> check_interface(const Interface& interface, const Dispatch& dispatch,
                             const Variant& variant, uint32_t param_bytes) {
  const std::string label = fmt::format("pass \"{}\"", dispatch.name);
  if (interface.push_constant_bytes > param_bytes)
    return bad_input(label,
                     "the shader declares {} bytes of push constants, the parameters have {}",
                     interface.push_constant_bytes, param_bytes);
  for (const DeclaredBinding& declared : interface.bindings) {
    const std::string where = fmt::format("{}, binding {}", label, declared.binding);
    if (declared.set != 0)
      return bad_input(where, "the shader declares it in set {}, expected set 0", declared.set);
    if (declared.array_size != 1)
      return bad_input(where, "the shader declares an array of {}, expected one descriptor",
                       declared.array_size);
    const auto bound =
        std::find_if(dispatch.bindings.begin(), dispatch.bindings.end(),
                     [&](const Binding& each) { return each.binding == declared.binding; });
    if (bound == dispatch.bindings.end())
      return bad_input(where, "the shader declares {}, and nothing is bound there",
                       kind_name(declared.type));
    const Resource& resource = variant.resources[bound->resource];
    if (bound->type != declared.type)
      return bad_input(where, "the shader declares {}, but \"{}\" is bound as {}",
                       kind_name(declared.type), resource.name, kind_name(bound->type));
    if (declared.type == BindingType::kStorageBuffer) continue;
    const ImageFormat format =
        declared.type == BindingType::kUniformTexelBuffer ? bound->view_format : resource.format;
    if (declared.numbers != class_of(format))
      return bad_input(where, "the shader reads {}, but \"{}\" has {} ({})",
                       class_name(declared.numbers), resource.name, class_name(class_of(format)),
                       image_format_info(format).name);
    if (declared.format != ImageFormat::kNone && declared.format != format)
      return bad_input(where, "the shader declares the format {}, but \"{}\" has {}",
                       image_format_info(declared.format).name, resource.name,
                       image_format_info(format).name);
  }
  return {};
}

}  // namespace shale
