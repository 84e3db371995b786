// compiler/spirv/check.h -- SPIR-V modules: optimized, validated, listed, and read for what they
// need.
#pragma once

#include <string>

#include "ir/package/package.h"

namespace shale {

/// Runs spirv-opt's performance passes.
/// Errors: kBadInput if the words are no module.
Result<Spirv> optimize_spirv(const Spirv& words, const std::string& where);

/// How much of a module the validator could judge.
enum class Validity {
  kValid,
  /// The module has instructions newer than the validator. It is valid in their older form, which
  /// says the same but for details; those were checked by hand (cooperative_matrix.h).
  kNewerThanValidator,
};

/// Errors: kBadInput with the validator's message.
Result<Validity> validate_spirv(const Spirv& words, const std::string& where);

/// Assembly text; instructions newer than the disassembler in their older form, under a comment.
/// Errors: kBadInput if the words are no module.
Result<std::string> disassemble_spirv(const Spirv& words);

/// Device features behind the module's OpCapability instructions, its workgroup's invocations and
/// shared memory, products of cooperative matrices.
/// Errors: kUnsupported for a capability that has no Feature; kBadInput for broken words.
struct SpirvNeeds {
  FeatureSet features;
  uint32_t workgroup_invocations = 1;
  uint32_t shared_bytes = 0;
  std::vector<MatrixProduct> matrix_products;  ///< ascending
};
Result<SpirvNeeds> spirv_needs(const Spirv& words, const std::string& where);

}  // namespace shale
