#include "ir/reference/precision.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "ir/base/float_format.h"
#include "ir/reference/interpreter.h"
#include "ir/reference/real.h"

namespace shale {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// 2^(-fraction / divisor) * value, at least that of the smallest normal number or of `lower`, times `factor`.
double relative(FloatFormat format, double value, double factor, double lower = 0,
                double divisor = 1) {
  const double magnitude =
      std::max({std::fabs(value), format.smallest_normal(), lower > 0 ? lower / factor : 0});
  return std::exp2(-format.fraction_bits / divisor) * magnitude * factor;
}

/// So many units in the last place of a value.
double units(FloatFormat format, double value, double count) {
  if (value == 0 || !std::isfinite(value)) return 0;
  return count *
         FloatFormat::power(std::max(std::ilogb(value), format.lowest()) - format.fraction_bits);
}

/// The error of a sum of `count` products of which `bound` is the sum of the magnitudes.
double sum_error(FloatFormat format, DType accumulator, double count, bool has_bias, double bound) {
  const double lost = (float_format(accumulator).fraction_bits - format.fraction_bits) / 2.0;
  const double roundings = 2 * (std::ceil(count / std::exp2(lost)) + (has_bias ? 1 : 0));
  const double unit = std::exp2(-1 - format.fraction_bits);
  if (std::isnan(bound) || bound * (1 + roundings * unit) > format.largest()) return kInfinity;
  return bound == 0 ? 0 : roundings * std::max(bound * unit, format.smallest_normal());
}

std::vector<double> doubles(const Tensor& tensor) {
  const std::vector<float> reals = tensor.reals();
  return {reals.begin(), reals.end()};
}

double largest(const std::vector<double>& values) {
  double found = 0;
  for (const double value : values)
    found = std::isnan(value) || std::isnan(found) ? std::numeric_limits<double>::quiet_NaN()
                                                   : std::max(found, std::fabs(value));
  return found;
}

/// Magnitudes of an operand as the bound of a sum takes them: each its own, or the largest for all.
std::vector<double> magnitudes(std::vector<double> values, bool local) {
  const double most = local ? 0 : largest(values);
  for (double& value : values) value = local ? std::fabs(value) : most;
  return values;
}

class NodePrecision {
 public:
  NodePrecision(const Eval& node, const Tensor& result)
      : node_(node), result_(result), format_(float_format(result.type.dtype)) {}

  std::vector<Precision> compute() const {
    const bool real = is_float(result_.type.dtype);
    switch (node_.op()) {
      case Op::kConv2d:
      case Op::kConv3d:
      case Op::kDepthwiseConv2d:
      case Op::kTransposeConv2d:
      case Op::kMatmul: return real ? sums() : exact();
      case Op::kFft2d:
      case Op::kRfft2d: return transform();
      case Op::kAvgPool2d:
      case Op::kReduceSum:
      case Op::kReduceProduct: return real ? terms() : exact();
      case Op::kResize:
        return real && node_.attrs().get(Attr::kMode) == kBilinear ? terms() : exact();
      case Op::kAdd:
      case Op::kSub:
      case Op::kMul:
      case Op::kPow: return real ? binary() : exact();
      case Op::kCast: return real ? cast() : exact();
      default: return real && is_function(node_.op()) ? function() : exact();
    }
  }

 private:
  bool is_local() const { return node_.attrs().flag(Attr::kLocalBound); }
  DType accumulator() const {
    const DType own = static_cast<DType>(node_.attrs().get(Attr::kAccType));
    return own == DType::kUnknown ? result_.type.dtype : own;
  }
  template <typename Compute>
  std::vector<Precision> each(const Compute& compute) const {
    std::vector<Precision> all(static_cast<size_t>(result_.count()));
    for (size_t i = 0; i < all.size(); ++i) all[i] = compute(static_cast<int64_t>(i));
    return all;
  }

  std::vector<Precision> exact() const {
    return each([&](int64_t i) {
      const bool real = is_float(result_.type.dtype);
      return Precision{real ? result_.real(i) : static_cast<double>(result_.get(i)), 0};
    });
  }

  std::vector<Precision> function() const {
    return each([&](int64_t i) {
      const double x = node_.in(0).real(i), value = real_function(node_.op(), x);
      return Precision{value, function_error(node_.op(), result_.type.dtype, x, value)};
    });
  }

  std::vector<Precision> cast() const {
    const Tensor& input = node_.in(0);
    return each([&](int64_t i) {
      const double value =
          is_float(input.type.dtype) ? input.real(i) : static_cast<double>(input.get(i));
      return Precision{value, units(format_, value, 0.5)};
    });
  }

  std::vector<Precision> binary() const {
    std::vector<Precision> all(static_cast<size_t>(result_.count()));
    for_each_index<2>(
        result_.type.shape, {broadcast_strides(node_.shape(0)), broadcast_strides(node_.shape(1))},
        {}, [&](int64_t element, const std::array<int64_t, 2>& at) {
          const double x = node_.in(0).real(at[0]), y = node_.in(1).real(at[1]);
          double value = 0;
          switch (node_.op()) {
            case Op::kAdd: value = x + y; break;
            case Op::kSub: value = x - y; break;
            case Op::kMul: value = x * y; break;
            default: value = real_pow(x, y);
          }
          all[static_cast<size_t>(element)] = {
              value, node_.op() == Op::kPow ? pow_error(result_.type.dtype, x, y, value)
                                            : units(format_, value, 0.5)};
          return true;
        });
    return all;
  }

  std::vector<Precision> terms() const {
    const Tensor& input = node_.in(0);
    const double most = largest(doubles(input));
    std::vector<RealTerm> found;
    return each([&](int64_t i) {
      real_terms(node_, i, found);
      double sum = 0, bound = 0, product = 1;
      for (const RealTerm& term : found) {
        const double x = input.real(term.element),
                     weight = static_cast<double>(term.weight_y) * term.weight_x;
        sum += x * weight;
        bound += std::fabs(x) * weight;
        product *= x;
      }
      const double n = static_cast<double>(found.size());
      switch (node_.op()) {
        case Op::kReduceProduct:
          if (!std::isfinite(product)) return Precision{product, 0};
          return Precision{
              product,
              std::fabs(product) * (std::pow(1 + std::exp2(-format_.fraction_bits - 1), n) - 1)};
        case Op::kResize:
          return Precision{sum, std::max(relative(format_, most, 20), most * 0.006)};
        case Op::kAvgPool2d: {
          const auto kernel = node_.attrs().list(Attr::kKernel);
          const double taps = static_cast<double>(kernel[0] * kernel[1]);
          return Precision{sum / n, sum_error(format_, accumulator(), taps, false, bound / n)};
        }
        default: return Precision{sum, sum_error(format_, accumulator(), n, false, bound)};
      }
    });
  }

  std::vector<Precision> sums() const {
    const bool matmul = node_.op() == Op::kMatmul;
    const std::vector<double> a = doubles(node_.in(0)), b = doubles(node_.in(1));
    const std::vector<double> bias = matmul ? std::vector<double>{} : doubles(node_.in(2));
    const std::vector<double> value = real_sums(node_, a, b, bias);
    const std::vector<double> bound = real_sums(node_, magnitudes(a, matmul || is_local()),
                                                magnitudes(b, true), magnitudes(bias, true));
    const Shape& weight = node_.shape(1);
    double count = 1;
    if (matmul)
      count = static_cast<double>(weight[1]);
    else if (node_.op() == Op::kDepthwiseConv2d)
      count = static_cast<double>(weight[0] * weight[1]);
    else
      for (size_t i = 1; i < weight.size(); ++i) count *= static_cast<double>(weight[i]);
    const bool has_bias = !(largest(bias) == 0);
    return each([&](int64_t i) {
      const size_t at = static_cast<size_t>(i);
      return Precision{value[at], sum_error(format_, accumulator(), count, has_bias, bound[at])};
    });
  }

  /// Each element is a sum over the whole input, of cosines and sines.
  std::vector<Precision> transform() const {
    const Shape& shape = node_.shape(0);
    const bool complex = node_.op() == Op::kFft2d, imaginary = node_.attrs().flag(Attr::kPart);
    const std::vector<double> real = doubles(node_.in(0));
    const std::vector<double> imag = complex ? doubles(node_.in(1)) : std::vector<double>{};
    const std::vector<double> value = real_fft(node_, real, imag);
    const double most = std::max(largest(real), largest(imag));
    const Shape& to = result_.type.shape;
    const double count = static_cast<double>(shape[1] * shape[2] * (complex ? 2 : 1));
    return each([&](int64_t i) {
      const int64_t n = i / (to[1] * to[2]), oy = i / to[2] % to[1], ox = i % to[2];
      double bound = 0;
      for (int64_t iy = 0; iy < shape[1]; ++iy)
        for (int64_t ix = 0; ix < shape[2]; ++ix) {
          const std::complex<double> root =
              root_of_unity(iy * oy * shape[2] + ix * ox * shape[1], shape[1] * shape[2]);
          const double cosine = std::fabs(root.real()), sine = std::fabs(root.imag());
          const size_t at = static_cast<size_t>((n * shape[1] + iy) * shape[2] + ix);
          const auto reach = [&](const std::vector<double>& values) {
            return is_local() ? std::fabs(values[at]) : most;
          };
          bound += reach(real) * (imaginary ? sine : cosine);
          if (complex) bound += reach(imag) * (imaginary ? cosine : sine);
        }
      return Precision{value[static_cast<size_t>(i)],
                       sum_error(format_, result_.type.dtype, count, false, bound)};
    });
  }

  const Eval& node_;
  const Tensor& result_;
  const FloatFormat format_;
};

}  // namespace

double function_error(Op op, DType dtype, double x, double value) {
  if (!std::isfinite(x) || !std::isfinite(value)) return 0;
  const FloatFormat format = float_format(dtype);
  switch (op) {
    case Op::kCeil:
    case Op::kFloor: return units(format, value, 0.5);
    case Op::kCos: return relative(format, 1 + std::fabs(x), 1, 0, 2);
    case Op::kErf:
    case Op::kLog: return units(format, value, 5);
    case Op::kExp: return relative(format, value, 1 + std::fabs(x));
    case Op::kReciprocal: return units(format, value, 1);
    case Op::kRsqrt: return units(format, value, 2);
    case Op::kSigmoid: return relative(format, value, 2 * (1 + std::fabs(x)));
    case Op::kSin:
      return std::max(relative(format, x, 1, 0, 2), std::numbers::pi * format.smallest_normal());
    case Op::kTanh: return relative(format, value, 4 * (1 + std::fabs(x)), 0.5);
    default: return 0;
  }
}

double pow_error(DType dtype, double x, double y, double value) {
  if (!std::isfinite(x) || !std::isfinite(y) || !std::isfinite(value) || x == 0) return 0;
  return relative(float_format(dtype), value, 2 * (1 + std::fabs(y * std::log(std::fabs(x)))));
}

Result<std::vector<Precision>> node_precision(const Graph& graph, NodeId id,
                                              std::span<const Tensor* const> operands) {
  SHALE_TRY(const Tensor result, evaluate_node(graph, id, operands));
  return NodePrecision(Eval(graph, id, operands), result).compute();
}

bool is_precise(DType dtype, double found, const Precision& expected) {
  if (!is_float(dtype)) return found == expected.value;
  if (std::isnan(expected.value)) return std::isnan(found);
  if (!std::isfinite(expected.error)) return true;
  const FloatFormat format = float_format(dtype);
  const double side = expected.value < 0 ? -1 : 1;
  const auto bounded = [&](double x) {
    return std::fabs(x) > format.largest() ? std::copysign(kInfinity, x) : x;
  };
  const double low = bounded(side * expected.value - expected.error),
               high = bounded(side * expected.value + expected.error);
  if (found == 0 && !is_float8(dtype)) return low < format.smallest_normal();
  if (std::isnan(found)) return !format.has_infinity && high == kInfinity;
  return low <= side * found && side * found <= high;
}

std::optional<std::string> first_imprecise(const Tensor& found,
                                           std::span<const Precision> expected) {
  for (size_t i = 0; i < expected.size(); ++i) {
    const int64_t at = static_cast<int64_t>(i);
    const DType dtype = found.type.dtype;
    const double value = is_float(dtype) ? found.real(at) : static_cast<double>(found.get(at));
    if (!is_precise(dtype, value, expected[i]))
      return fmt::format("element {} at {}: found {:.9g}, expected {:.9g} within {:.3g}", i,
                         coordinates_text(found.type.shape, at), value, expected[i].value,
                         expected[i].error);
  }
  return std::nullopt;
}

Tensor flush_subnormals(Tensor tensor) {
  const DType dtype = tensor.type.dtype;
  if (!is_float(dtype) || is_float8(dtype)) return tensor;
  const double smallest = float_format(dtype).smallest_normal();
  for (int64_t i = 0; i < tensor.count(); ++i)
    if (const float x = tensor.real(i); std::fabs(x) < smallest)
      tensor.set_real(i, std::copysign(0.0, x));
  return tensor;
}

}  // namespace shale
