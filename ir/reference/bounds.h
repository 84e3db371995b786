// ir/reference/bounds.h -- what a device may give for a floating-point graph: an interval an element.
//
// Floating-point results differ between devices, in the order of a sum, in exp, in what happens to
// subnormals. The bounds follow from what Vulkan promises of each operation, never from what some
// device was seen to give; they are carried through the graph as intervals, so that an error of one
// operator widens what the next may give. Source: Vulkan 1.3, Precision and Operation of SPIR-V
// Instructions; Higham, Accuracy and Stability of Numerical Algorithms, 3.1 (gamma_n).
//
//   u = 2^-23       an operation is correctly rounded, but up or down is left open
//   add, sub, mul   one rounding of the exact result
//   a sum           |found - exact| <= gamma_(n+4) * sum |w||x| + sum |w| * (error of x) + 2n * 2^-126,
//                   gamma_k = k u / (1 - k u), in any order, with fused multiply-adds or without, and
//                   with weights that were added beforehand (four roundings are for those)
//   division        2.5 units in the last place
//   functions       EXP, POW, SIN, ...: what TOSA allows in float32 (precision.h), in which shaders compute them
//   subnormal       operands and results of arithmetic below 2^-126 may become 0
//   narrower types  rounded to nearest even where an operator ends: shaders do that in integers
//   NaN, infinity   as IEEE 754 has them, where no wider interval leaves them open
#pragma once

#include <span>
#include <string>
#include <vector>

#include "ir/reference/interpreter.h"

namespace shale {

/// The values that an element may have.
struct Bound {
  double low = 0, high = 0;  ///< both NaN: a NaN; low > high: anything

  static Bound anything() { return {1, -1}; }
  bool is_anything() const { return low > high; }
  bool is_point() const { return low == high || (low != low && high != high); }
  bool holds(double value) const;
};
using Bounds = std::vector<Bound>;  ///< of a tensor, row-major

/// The bounds of the outputs of a verified graph for inputs in graph order. Integers are exact, but
/// where they come from a float whose bounds leave them open.
/// Errors: as interpret.
Result<std::vector<Bounds>> interpret_bounds(const Graph& graph, std::span<const Tensor> inputs,
                                             const InterpreterProgress& progress = {});

/// True if a tensor of the graph is of a floating-point type, so that its results are bounded and not exact.
bool has_reals(const Graph& graph);

/// The widest of the intervals, in the tensor's values; infinite where one bounds nothing.
double widest(const Bounds& bounds);

/// "element 17 at [0,1,1,1]: found 4, expected 4.5 to 4.6", or nothing if all elements are in bounds.
std::optional<std::string> first_outside(const Tensor& found, const Bounds& bounds);

}  // namespace shale
