// tests/support/float_cases.h -- graphs of every floating-point operator, with inputs, and what TOSA lets their outputs be.
#pragma once

#include "ir/reference/precision.h"

namespace shale {

/// Each node reads inputs and constants alone, so that its bound needs no other's.
struct FloatCase {
  std::string name;  ///< "functions_f16"
  Graph graph;
  std::vector<Tensor> inputs;
};

/// A fixed set: all operators for FP32, FP16 and BF16, those that FP8 has for FP8. The values are of all magnitudes, with
/// infinities, NaN, zeros of both signs and large angles, but no subnormals.
std::vector<FloatCase> float_cases();

/// Of each output of a graph whose nodes read inputs and constants alone.
std::vector<std::vector<Precision>> output_precision(const Graph& graph,
                                                     const std::vector<Tensor>& inputs);

}  // namespace shale
