// compiler/spirv/operations.h -- how much arithmetic a shader does, for models of devices.
#pragma once

#include <string>

#include "ir/package/package.h"

namespace shale {

/// Turns that a loop is taken to make where the optimizer did not unroll it.
inline constexpr double kAssumedTurns = 8;

/// Operations of one invocation of an optimized compute module: an instruction that computes counts
/// one for each component of its result (a dot product one for each product and sum, functions that
/// hardware makes at a quarter of the rate four), a texel read or an atomic one; moving values is
/// free. Both sides of a branch count, and what stands in a loop counts kAssumedTurns times. An
/// estimate, not a measurement.
/// Errors: kBadInput for broken words.
Result<double> spirv_operations(const Spirv& words, const std::string& where);

}  // namespace shale
