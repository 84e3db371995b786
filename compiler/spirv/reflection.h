// compiler/spirv/reflection.h -- what a module declares, compared with what a plan binds.
#pragma once

#include <string>
#include <vector>

#include "ir/package/package.h"

namespace shale {

/// Numbers that a texel has in a shader.
enum class NumericClass : uint8_t { kNone, kFloat, kInt, kUint };

/// A descriptor of set 0 that a module declares.
struct DeclaredBinding {
  uint32_t set = 0, binding = 0;
  BindingType type = BindingType::kStorageBuffer;
  NumericClass numbers = NumericClass::kNone;  ///< of texels
  ImageFormat format = ImageFormat::kNone;     ///< of storage images; kNone if it is unknown
  uint32_t array_size = 1;
};

struct Interface {
  std::vector<DeclaredBinding> bindings;  ///< by set and binding
  uint32_t push_constant_bytes = 0;
};

/// Reads the interface of a module.
/// Errors: kBadInput for broken words; kUnsupported for descriptors that no plan has.
Result<Interface> reflect(const Spirv& words, const std::string& where);

/// The interface of a dispatch's module against its bindings: each descriptor that the module declares is bound, as what it
/// is: kind, numeric class, format. What is bound and not declared is allowed: code that the optimizer took away.
/// `param_bytes`: push constants of the variant.
/// Errors: kBadInput naming dispatch, binding, found and expected.
Result<void> check_interface(const Interface& interface, const Dispatch& dispatch,
                             const Variant& variant, uint32_t param_bytes);

}  // namespace shale
