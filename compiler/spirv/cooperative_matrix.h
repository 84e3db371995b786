// compiler/spirv/cooperative_matrix.h -- modules of SPV_KHR_cooperative_matrix, which the SPIRV-Tools
// and glslang of 2023 do not know.
#pragma once

#include "ir/package/package.h"

namespace shale {

/// True if the module declares the capability CooperativeMatrixKHR.
bool uses_cooperative_matrices(const Spirv& words);

/// Completes what glslang makes of shaders/include/coopmat.glsl: it cannot hand a type to
/// OpTypeCooperativeMatrixKHR, so the number of bits of a signed integer stands there, in whose
/// place comes the integer's type. Names and sources go. Other modules stay as they are.
/// Errors: kBadInput if an instruction is broken, or the number is neither 8 nor 32.
Result<void> complete_cooperative_matrices(Spirv& words, const std::string& where);

/// The same module in SPV_NV_cooperative_matrix, whose instructions say the same but for the use of
/// a matrix (A, B, accumulator), which is checked here: tools that know only the older extension
/// can then read everything else.
/// Errors: kBadInput if an instruction is broken, if a layout is no constant 0 or 1, or if a
/// product's operands do not have the uses A, B, accumulator and the sign of all.
Result<Spirv> with_older_matrices(const Spirv& words, const std::string& where);

}  // namespace shale
