// compiler/spirv/check.h -- SPIR-V modules: optimized, validated, listed, and read for what they
// need.
#pragma once

#include <string>

#include "ir/package/package.h"

namespace shale {

/// Runs spirv-opt's performance passes.
/// Errors: kBadInput if the words are no module.
Result<Spirv> optimize_spirv(const Spirv& words, const std::string& where);

/// Errors: kBadInput with the validator's message.
Result<void> validate_spirv(const Spirv& words, const std::string& where);

/// Assembly text.
/// Errors: kBadInput if the words are no module.
Result<std::string> disassemble_spirv(const Spirv& words);

/// Device features behind the module's OpCapability instructions, and its workgroup's invocations.
/// Errors: kUnsupported for a capability that has no Feature.
struct SpirvNeeds {
  FeatureSet features;
  uint32_t workgroup_invocations = 1;
};
Result<SpirvNeeds> spirv_needs(const Spirv& words, const std::string& where);

}  // namespace shale
