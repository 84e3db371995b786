// compiler/kernels/heads.h -- code of a group's head, for the families that take every operator.
#pragma once

#include "compiler/kernels/codegen.h"

namespace shale {

/// Code that leaves the head's result in the locals head_result(0), head_result(1), ..., one for each element of a run of
/// the result. What the elements share is written for each, and found to be equal by the driver.
std::string emit_head(Codegen& codegen, const Node& node, const std::vector<Position>& run);
std::string head_result(size_t element);

}  // namespace shale
