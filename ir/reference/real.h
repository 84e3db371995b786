// ir/reference/real.h -- what the interpreter's floating-point side shares with the bounds of its results.
//
// Sums are float32, each operation rounded to nearest even; their order is the order of the loops, kernel
// height, width, then input channel, the bias last. Functions (EXP, POW, ...), products of many elements
// and Fourier transforms are computed in double. A narrower operand is widened, and a result rounded to
// its type once, at the end of the operator. So an FP16 accumulator is one of float32: finer than asked,
// which TOSA's tolerance allows.
#pragma once

#include <complex>

#include "ir/reference/eval.h"

namespace shale {

/// Sums of a convolution or matmul in T, float or double, over operand 0 and 1; `bias` has one
/// element or one a channel, and is not read by matmul.
template <typename T>
std::vector<T> real_sums(const Eval& node, const std::vector<T>& a, const std::vector<T>& b,
                         const std::vector<T>& bias);

/// max or min of two numbers; by TOSA's NaN modes, a NaN wins or is left out.
float real_max(float a, float b, bool ignore_nan);
float real_min(float a, float b, bool ignore_nan);

/// CAST to an integer: to nearest even, saturated. TOSA gives a NaN no result; ours is 0.
int64_t real_to_int(double value, DType to);

/// An operator of one operand that is a function of a number: SIGMOID, EXP, ... ABS and NEGATE among them.
bool is_function(Op op);
double real_function(Op op, double x);
/// POW. A NaN in either operand gives one, a number below 0 to the power of no integer too.
double real_pow(double x, double y);

/// e^(2 pi i k / n), exact at quarter turns.
std::complex<double> root_of_unity(int64_t k, int64_t n);

/// An FFT2D or RFFT2D over operands in double: the elements of its part.
std::vector<double> real_fft(const Eval& node, const std::vector<double>& real,
                             const std::vector<double>& imaginary);

/// One element that a pooling, a reduction or a bilinear RESIZE reads for an element of its result.
struct RealTerm {
  int64_t element = 0;  ///< of operand 0
  float weight_y = 1;   ///< of RESIZE
  float weight_x = 1;
};

/// Replaces `terms` by those of an element of the result, in the order of the sum.
void real_terms(const Eval& node, int64_t element, std::vector<RealTerm>& terms);

// The evaluation functions of nodes with a float operand or result; copies of elements are those of
// eval.h.
Result<Tensor> eval_real_sums(const Eval& node);   ///< convolutions, matmul
Result<Tensor> eval_real_terms(const Eval& node);  ///< pools, REDUCE_*, bilinear RESIZE
Result<Tensor> eval_real_argmax(const Eval& node);
Result<Tensor> eval_real_fft(const Eval& node);
Result<Tensor> eval_real_unary(const Eval& node);   ///< CAST from an integer too
Result<Tensor> eval_real_binary(const Eval& node);  ///< comparisons too

}  // namespace shale
