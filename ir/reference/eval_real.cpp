// ir/reference/eval_real.cpp -- floating-point operators other than convolutions and matmul.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "ir/reference/real.h"

namespace shale {
namespace {

/// For parallel_for.
constexpr int64_t kElementCost = 32;

bool ignores_nan(const Eval& node) { return node.attrs().get(Attr::kNanMode) == kIgnoreNan; }

double binary(Op op, float a, float b, bool ignore_nan) {
  switch (op) {
    case Op::kAdd: return a + b;
    case Op::kSub: return a - b;
    case Op::kMul: return a * b;
    case Op::kPow: return real_pow(a, b);
    case Op::kMaximum: return real_max(a, b, ignore_nan);
    case Op::kMinimum: return real_min(a, b, ignore_nan);
    default: SHALE_CHECK(false && "no binary operator of floats");
  }
}

bool compare(Op op, float a, float b) {
  switch (op) {
    case Op::kEqual: return a == b;
    case Op::kGreater: return a > b;
    case Op::kGreaterEqual: return a >= b;
    default: SHALE_CHECK(false && "no comparison");
  }
}

/// The coordinates of an element of a row-major tensor.
Shape coordinates(const Shape& shape, int64_t element) {
  Shape at(shape.size());
  for (size_t axis = shape.size(); axis-- > 0;) {
    at[axis] = element % shape[axis];
    element /= shape[axis];
  }
  return at;
}

struct Near {
  int64_t position;
  float weight;
};

/// The two rows (axis 1) or columns (axis 2) that a bilinear RESIZE mixes at an output coordinate.
std::array<Near, 2> neighbours(const Eval& node, size_t axis, int64_t out) {
  const int64_t i = static_cast<int64_t>(axis - 1);
  const int64_t scale = node.in(1).get(2 * i), step = node.in(1).get(2 * i + 1);
  const int64_t position = out * step + node.in(2).get(i);
  const int64_t at = (position + scale) / scale - 1;  // position >= -scale: a floor
  const float distance = static_cast<float>(position - at * scale) / static_cast<float>(scale);
  return {{{std::max<int64_t>(at, 0), 1.0f - distance},
           {std::min(at + 1, node.shape(0)[axis] - 1), distance}}};
}

/// The radix-2 transform of `count` numbers, in place, a power of two. sign -1 is forward.
void transform(std::span<std::complex<double>> x, int64_t sign) {
  const size_t count = x.size();
  for (size_t i = 1, j = 0; i < count; ++i) {  // bits in reverse
    size_t bit = count / 2;
    for (; (j & bit) != 0; bit /= 2) j ^= bit;
    j ^= bit;
    if (i < j) std::swap(x[i], x[j]);
  }
  std::vector<std::complex<double>> roots(count / 2);
  for (size_t k = 0; k < roots.size(); ++k)
    roots[k] = root_of_unity(sign * static_cast<int64_t>(k), static_cast<int64_t>(count));
  for (size_t half = 1; half < count; half *= 2)
    for (size_t first = 0; first < count; first += 2 * half)
      for (size_t k = 0; k < half; ++k) {
        const std::complex<double> even = x[first + k],
                                   odd = x[first + half + k] * roots[k * (count / (2 * half))];
        x[first + k] = even + odd;
        x[first + half + k] = even - odd;
      }
}

/// Stores compute(element) for each element of the result.
template <typename Compute>
Tensor each_element(const Eval& node, const Compute& compute) {
  Tensor result = Tensor::zeros(node.result_type());
  const auto range = [&](int64_t begin, int64_t end) -> Result<void> {
    std::vector<RealTerm> terms;
    for (int64_t i = begin; i < end; ++i) result.set_real(i, compute(i, terms));
    return {};
  };
  static_cast<void>(parallel_for(result.count(), kElementCost, range));
  return result;
}

}  // namespace

float real_max(float a, float b, bool ignore_nan) {
  if (std::isnan(a)) return ignore_nan ? b : a;
  if (std::isnan(b)) return ignore_nan ? a : b;
  return std::max(a, b);
}

float real_min(float a, float b, bool ignore_nan) { return -real_max(-a, -b, ignore_nan); }

int64_t real_to_int(double value, DType to) {
  if (std::isnan(value)) return 0;
  const IntRange range = dtype_range(to);
  const double whole = std::nearbyint(value);
  if (whole <= static_cast<double>(range.min)) return range.min;
  if (whole >= static_cast<double>(range.max)) return range.max;
  return static_cast<int64_t>(whole);
}

bool is_function(Op op) {
  switch (op) {
    case Op::kAbs:
    case Op::kCeil:
    case Op::kCos:
    case Op::kErf:
    case Op::kExp:
    case Op::kFloor:
    case Op::kLog:
    case Op::kNegate:
    case Op::kReciprocal:
    case Op::kRsqrt:
    case Op::kSigmoid:
    case Op::kSin:
    case Op::kTanh: return true;
    default: return false;
  }
}

double real_function(Op op, double x) {
  switch (op) {
    case Op::kAbs: return std::fabs(x);
    case Op::kCeil: return std::ceil(x);
    case Op::kCos: return std::cos(x);
    case Op::kErf: return std::erf(x);
    case Op::kExp: return std::exp(x);
    case Op::kFloor: return std::floor(x);
    case Op::kLog: return std::log(x);
    case Op::kNegate: return -x;
    case Op::kReciprocal: return 1.0 / x;
    case Op::kRsqrt: return x == 0 ? 1.0 / x : 1.0 / std::sqrt(x);
    case Op::kSigmoid: return 1.0 / (1.0 + std::exp(-x));
    case Op::kSin: return std::sin(x);
    case Op::kTanh: return std::tanh(x);
    default: SHALE_CHECK(false && "no function of a number");
  }
}

double real_pow(double x, double y) {
  return std::isnan(x) || std::isnan(y) ? std::numeric_limits<double>::quiet_NaN() : std::pow(x, y);
}

std::complex<double> root_of_unity(int64_t k, int64_t n) {
  const int64_t turn = (k % n + n) % n;
  if (4 * turn % n == 0) {
    constexpr double kCosines[] = {1, 0, -1, 0};
    const int64_t quarter = 4 * turn / n;
    return {kCosines[quarter], kCosines[(quarter + 3) % 4]};
  }
  return std::polar(1.0, 2 * std::numbers::pi * static_cast<double>(turn) / static_cast<double>(n));
}

std::vector<double> real_fft(const Eval& node, const std::vector<double>& real,
                             const std::vector<double>& imaginary) {
  const Shape& shape = node.shape(0);
  const size_t batches = static_cast<size_t>(shape[0]), height = static_cast<size_t>(shape[1]),
               width = static_cast<size_t>(shape[2]);
  const size_t kept = static_cast<size_t>(node.result_type().shape[2]);
  const int64_t sign = node.attrs().flag(Attr::kInverse) ? 1 : -1;
  std::vector<double> result;
  for (size_t n = 0; n < batches; ++n) {
    std::vector<std::complex<double>> rows(height * width), column(height);
    for (size_t i = 0; i < rows.size(); ++i)
      rows[i] = {real[n * rows.size() + i], imaginary.empty() ? 0 : imaginary[n * rows.size() + i]};
    for (size_t y = 0; y < height; ++y) transform({rows.data() + y * width, width}, sign);
    for (size_t x = 0; x < kept; ++x) {
      for (size_t y = 0; y < height; ++y) column[y] = rows[y * width + x];
      transform(column, sign);
      for (size_t y = 0; y < height; ++y) rows[y * width + x] = column[y];
    }
    for (size_t y = 0; y < height; ++y)
      for (size_t x = 0; x < kept; ++x) {
        const std::complex<double> value = rows[y * width + x];
        result.push_back(node.attrs().flag(Attr::kPart) ? value.imag() : value.real());
      }
  }
  return result;
}

Result<Tensor> eval_real_fft(const Eval& node) {
  const auto doubles = [&](size_t operand) {
    const std::vector<float> reals = node.in(operand).reals();
    return std::vector<double>(reals.begin(), reals.end());
  };
  const std::vector<double> values =
      real_fft(node, doubles(0), node.operand_count() > 1 ? doubles(1) : std::vector<double>{});
  Tensor result = Tensor::zeros(node.result_type());
  for (size_t i = 0; i < values.size(); ++i) result.set_real(static_cast<int64_t>(i), values[i]);
  return result;
}

void real_terms(const Eval& node, int64_t element, std::vector<RealTerm>& terms) {
  terms.clear();
  const Shape& shape = node.shape(0);
  const Shape at = coordinates(node.result_type().shape, element);
  const Shape strides = row_major_strides(shape);
  if (node.op() == Op::kAvgPool2d || node.op() == Op::kMaxPool2d) {
    const auto kernel = node.attrs().list(Attr::kKernel), stride = node.attrs().list(Attr::kStride),
               pad = node.attrs().list(Attr::kPad);
    for (int64_t ky = 0; ky < kernel[0]; ++ky)
      for (int64_t kx = 0; kx < kernel[1]; ++kx) {
        const int64_t y = at[1] * stride[0] - pad[0] + ky, x = at[2] * stride[1] - pad[2] + kx;
        if (in_range(y, {0, shape[1] - 1}) && in_range(x, {0, shape[2] - 1}))
          terms.push_back({at[0] * strides[0] + y * strides[1] + x * strides[2] + at[3]});
      }
  } else if (node.op() == Op::kResize) {
    for (const auto& [y, weight_y] : neighbours(node, 1, at[1]))
      for (const auto& [x, weight_x] : neighbours(node, 2, at[2]))
        terms.push_back(
            {at[0] * strides[0] + y * strides[1] + x * strides[2] + at[3], weight_y, weight_x});
  } else {
    const size_t axis = static_cast<size_t>(node.attrs().get(Attr::kAxis));
    int64_t first = 0;  // the result has 1 on the axis
    for (size_t i = 0; i < at.size(); ++i) first += at[i] * strides[i];
    for (int64_t k = 0; k < shape[axis]; ++k) terms.push_back({first + k * strides[axis]});
  }
}

Result<Tensor> eval_real_terms(const Eval& node) {
  const Tensor& input = node.in(0);
  const bool ignore = ignores_nan(node);
  return each_element(node, [&](int64_t i, std::vector<RealTerm>& terms) -> double {
    real_terms(node, i, terms);
    const auto fold = [&](float start, const auto& combine, bool skip_first) {
      for (size_t k = skip_first ? 1 : 0; k < terms.size(); ++k) start = combine(start, terms[k]);
      return start;
    };
    const float first = input.real(terms[0].element);
    switch (node.op()) {
      case Op::kMaxPool2d:
      case Op::kReduceMax:
        return fold(
            first,
            [&](float a, const RealTerm& t) { return real_max(a, input.real(t.element), ignore); },
            true);
      case Op::kReduceMin:
        return fold(
            first,
            [&](float a, const RealTerm& t) { return real_min(a, input.real(t.element), ignore); },
            true);
      case Op::kResize:
        return fold(
            0.0f,
            [&](float a, const RealTerm& t) {
              return a + input.real(t.element) * t.weight_y * t.weight_x;
            },
            false);
      case Op::kReduceProduct: {
        double product = 1;
        for (const RealTerm& term : terms) product *= input.real(term.element);
        return product;
      }
      default: {
        const float sum = fold(
            0.0f, [&](float a, const RealTerm& t) { return a + input.real(t.element); }, false);
        return node.op() == Op::kAvgPool2d ? sum / static_cast<float>(terms.size()) : sum;
      }
    }
  });
}

Result<Tensor> eval_real_argmax(const Eval& node) {
  const AxisView view(node.shape(0), static_cast<size_t>(node.attrs().get(Attr::kAxis)));
  const bool ignore = ignores_nan(node);
  Tensor result = Tensor::zeros(node.result_type());
  for (int64_t i = 0; i < result.count(); ++i) {
    const int64_t first = i / view.inner * view.dim * view.inner + i % view.inner;
    int64_t best = 0;
    float largest = node.in(0).real(first);
    for (int64_t k = 1; k < view.dim; ++k) {
      const float x = node.in(0).real(first + k * view.inner);
      // The first NaN wins, or any number wins over it.
      const bool wins = std::isnan(largest) ? ignore && !std::isnan(x)
                                            : x > largest || (!ignore && std::isnan(x));
      if (wins) best = k, largest = x;
    }
    result.set(i, best);
  }
  return result;
}

Result<Tensor> eval_real_unary(const Eval& node) {
  const Tensor& input = node.in(0);
  const DType from = input.type.dtype, to = node.result_type().dtype;
  if (node.op() == Op::kCast && is_float(from) && !is_float(to)) {
    Tensor result = Tensor::zeros(node.result_type());
    for (int64_t i = 0; i < result.count(); ++i)
      result.set(i, real_to_int(static_cast<double>(input.real(i)), to));
    return result;
  }
  const bool ignore = ignores_nan(node);
  const float low = bits_real(from, node.attrs().get(Attr::kMinVal)),
              high = bits_real(from, node.attrs().get(Attr::kMaxVal));
  return each_element(node, [&](int64_t i, std::vector<RealTerm>&) -> double {
    if (!is_float(from)) return static_cast<double>(input.get(i));
    const float x = input.real(i);
    switch (node.op()) {
      // A NaN that is ignored leaves the lower bound, then the upper one is no larger.
      case Op::kClamp: return real_min(real_max(x, low, ignore), high, ignore);
      case Op::kCast: return x;
      default: return real_function(node.op(), x);
    }
  });
}

Result<Tensor> eval_real_binary(const Eval& node) {
  const Tensor& a = node.in(0);
  const Tensor& b = node.in(1);
  const bool ignore = ignores_nan(node), compares = node.result_type().dtype == DType::kBool;
  Tensor result = Tensor::zeros(node.result_type());
  for_each_index<2>(result.type.shape,
                    {broadcast_strides(a.type.shape), broadcast_strides(b.type.shape)}, {},
                    [&](int64_t element, const std::array<int64_t, 2>& at) {
                      const float x = a.real(at[0]), y = b.real(at[1]);
                      if (compares)
                        result.set(element, compare(node.op(), x, y));
                      else
                        result.set_real(element, binary(node.op(), x, y, ignore));
                      return true;
                    });
  return result;
}

}  // namespace shale
