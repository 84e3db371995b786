// ir/reference/precision.h -- how far TOSA lets a floating-point operator be from its exact value.
//
// A value in double precision and the error that an element may have, both of the type of the result. Where TOSA 1.0
// gives a number of units in the last place, a formula or the bound of a dot product, that is the error; what has to be
// exact has an error of 0. Source: TOSA 1.0, precision requirements of the operators, dot product accuracy
// requirements (the bound of each element; the variance over a whole test set is not looked at), tosa_reference_check_fp_bnd.
#pragma once

#include "ir/reference/eval.h"

namespace shale {

struct Precision {
  double value = 0;  ///< NaN: has to be one; may be beyond the type's largest number
  double error = 0;  ///< infinite: anything will do
};

/// Of an operator that is_function(), at x, in a result of type `dtype`. `value` is real_function(op, x).
double function_error(Op op, DType dtype, double x, double value);
/// Of POW; `value` is real_pow(x, y).
double pow_error(DType dtype, double x, double y, double value);

/// Of each element of the result of a legal node, in row-major order.
/// Errors: as evaluate_node.
Result<std::vector<Precision>> node_precision(const Graph& graph, NodeId id,
                                              std::span<const Tensor* const> operands);

/// True if an element of this type may be `found`: within the error; infinite where that reaches beyond the type; 0
/// where it reaches a subnormal of another type than FP8, which may be flushed.
bool is_precise(DType dtype, double found, const Precision& expected);

/// "element 17 at [0,1,1,1]: found 4, expected 4.5 within 0.1", or nothing. The tensor has as many elements.
std::optional<std::string> first_imprecise(const Tensor& found,
                                           std::span<const Precision> expected);

/// With subnormals of FP32, FP16 and BF16 as 0 of their sign, as an operator may take its operands.
Tensor flush_subnormals(Tensor tensor);

}  // namespace shale
