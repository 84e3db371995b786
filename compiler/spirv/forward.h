// compiler/spirv/forward.h -- local variables of straight-line code to values.
#pragma once

#include "ir/package/package.h"

namespace shale {

/// Replaces loads of function-local variables by the value stored last in the same block, or by the
/// only one that is ever stored where that comes before every load, and drops stores that nothing
/// reads. glslang writes every expression through variables; in code of ten
/// thousand products they are more than half of a module, and the driver pays for each. One pass over
/// the words, where spirv-opt takes seconds. A module with an instruction that is not known here comes
/// back as it is. The result computes the same.
Spirv forward_locals(const Spirv& words);

}  // namespace shale
