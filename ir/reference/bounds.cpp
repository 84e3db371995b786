#include "ir/reference/bounds.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "ir/base/float_format.h"
#include "ir/reference/precision.h"
#include "ir/reference/real.h"

namespace shale {
namespace {

constexpr double kUnit = 0x1p-23;   // relative error of a rounding whose direction is open
constexpr double kTiny = 0x1p-126;  // below it float32 is subnormal
constexpr double kLargest = static_cast<double>(std::numeric_limits<float>::max());
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kSecondOrder = 1.01;  // covers products of errors, which are below 1e-3 each

double gamma(double operations) {
  return operations * kUnit / (1.0 - std::min(operations * kUnit, 0.5));
}

bool is_nan(const Bound& bound) { return std::isnan(bound.low); }

/// The largest float that is not above x.
double float_below(double x) {
  const float near = static_cast<float>(x);
  return static_cast<double>(static_cast<double>(near) > x
                                 ? std::nextafterf(near, -std::numeric_limits<float>::infinity())
                                 : near);
}
double float_above(double x) { return -float_below(-x); }

/// Subnormals of the interval may become 0.
Bound flushed(Bound bound) {
  if ((bound.low < kTiny && bound.high > 0) || (bound.high > -kTiny && bound.low < 0))
    return {std::min(bound.low, 0.0), std::max(bound.high, 0.0)};
  return bound;
}

/// Bounds in float32 as the end of an operator leaves them in `dtype`.
Bound ended(Bound bound, DType dtype) {
  if (bound.is_anything() || is_nan(bound)) return bound;
  bound = flushed(bound);
  if (dtype == DType::kFp32) return bound;
  const auto narrow = [&](double x) {
    return static_cast<double>(bits_real(dtype, real_bits(dtype, x)));
  };
  bound = {narrow(float_below(bound.low)), narrow(float_above(bound.high))};
  // Without an infinity what is too large is a NaN.
  if (std::isnan(bound.low) == std::isnan(bound.high)) return bound;
  return Bound::anything();
}

/// An exact interval rounded once.
Bound rounded(Bound exact, DType dtype) {
  if (exact.is_anything() || is_nan(exact)) return exact;
  return ended({float_below(exact.low), float_above(exact.high)}, dtype);
}

/// Sum of two floats as an interval of doubles: a point where it is exact.
Bound two_sum(double a, double b) {
  const double sum = a + b;
  if (!std::isfinite(sum)) return {sum, sum};
  const double part = sum - a, rest = (a - (sum - part)) + (b - part);
  return {rest < 0 ? std::nextafter(sum, -kInfinity) : sum,
          rest > 0 ? std::nextafter(sum, kInfinity) : sum};
}

/// The range of a function that is monotone in each operand, from its values at the corners.
template <typename Function>
Bound corners(const Bound& a, const Bound& b, const Function& function) {
  Bound result{kInfinity, -kInfinity};
  for (const double x : {a.low, a.high})
    for (const double y : {b.low, b.high}) {
      const Bound value = function(x, y);
      if (std::isnan(value.low))
        return a.is_point() && b.is_point() ? Bound{kNan, kNan} : Bound::anything();
      result = {std::min(result.low, value.low), std::max(result.high, value.high)};
    }
  return result;
}

Bound arithmetic(Op op, Bound a, Bound b, DType dtype) {
  if (a.is_anything() || b.is_anything()) return Bound::anything();
  if (is_nan(a) || is_nan(b)) return {kNan, kNan};
  a = flushed(a), b = flushed(b);
  return rounded(corners(a, b,
                         [&](double x, double y) {
                           if (op == Op::kMul) return Bound{x * y, x * y};
                           return two_sum(x, op == Op::kAdd ? y : -y);
                         }),
                 dtype);
}

Bound larger(const Bound& a, const Bound& b, bool ignore_nan) {
  if (a.is_anything() || b.is_anything()) return Bound::anything();
  if (is_nan(a)) return ignore_nan ? b : a;
  if (is_nan(b)) return ignore_nan ? a : b;
  return flushed({std::max(a.low, b.low), std::max(a.high, b.high)});
}

Bound negated(const Bound& a) { return a.is_anything() ? a : Bound{-a.high, -a.low}; }

Bound smaller(const Bound& a, const Bound& b, bool ignore_nan) {
  return negated(larger(negated(a), negated(b), ignore_nan));
}

Bound compared(Op op, const Bound& a, const Bound& b) {
  if (a.is_anything() || b.is_anything()) return {0, 1};
  if (is_nan(a) || is_nan(b)) return {0, 0};
  const Bound x = flushed(a), y = flushed(b);
  bool surely = false, never = false;
  switch (op) {
    case Op::kEqual:
      surely = x.is_point() && y.is_point() && x.low == y.low;
      never = x.low > y.high || x.high < y.low;
      break;
    case Op::kGreater:
      surely = x.low > y.high;
      never = x.high <= y.low;
      break;
    default: surely = x.low >= y.high; never = x.high < y.low;
  }
  return {surely ? 1.0 : 0.0, never ? 0.0 : 1.0};
}

/// What TOSA allows around a value of float32: nothing beyond it, and 0 for what is subnormal; then rounded to `dtype`.
Bound allowed(double low, double high, DType dtype) {
  if (std::isnan(low) || std::isnan(high))
    return std::isnan(low) && std::isnan(high) ? Bound{kNan, kNan} : Bound::anything();
  const auto bounded = [](double x) {
    return std::fabs(x) > kLargest ? std::copysign(kInfinity, x) : x;
  };
  return ended({bounded(low), bounded(high)}, dtype);
}

/// A function of a number. The errors are largest at an end of the interval; all but sine, cosine and the reciprocal
/// across 0 are monotone.
Bound function(Op op, Bound x, DType dtype) {
  if (x.is_anything() || is_nan(x)) return x;
  x = flushed(x);
  const auto value = [&](double at) { return real_function(op, at); };
  const auto error = [&](double at) { return function_error(op, DType::kFp32, at, value(at)); };
  const double most = std::max(error(x.low), error(x.high));
  if (op == Op::kSin || op == Op::kCos) {
    if (x.is_point()) return allowed(value(x.low) - most, value(x.low) + most, dtype);
    if (!std::isfinite(x.low) || !std::isfinite(x.high)) return Bound::anything();
    const double centre = value(x.low / 2 + x.high / 2), reach = (x.high - x.low) / 2 + most;
    return allowed(std::max(centre - reach, -1 - most), std::min(centre + reach, 1 + most), dtype);
  }
  // -0 and +0 look alike here, and have different results.
  if ((op == Op::kReciprocal || op == Op::kRsqrt) && x.low <= 0 && x.high >= 0)
    return Bound::anything();
  if (op == Op::kLog && x.low < 0 && x.high >= 0) return Bound::anything();
  const double a = value(x.low), b = value(x.high);
  return allowed(std::min(a, b) - most, std::max(a, b) + most, dtype);
}

Bound power(Bound x, Bound y, DType dtype) {
  if (x.is_anything() || y.is_anything()) return Bound::anything();
  if (is_nan(x) || is_nan(y)) return {kNan, kNan};
  x = flushed(x), y = flushed(y);
  if (!(x.is_point() && y.is_point()) && x.low <= 0) return Bound::anything();
  Bound result{kInfinity, -kInfinity};
  for (const double base : {x.low, x.high})
    for (const double exponent : {y.low, y.high}) {
      const double value = real_pow(base, exponent);
      const double error = pow_error(DType::kFp32, base, exponent, value);
      if (std::isnan(value)) return {kNan, kNan};
      if (base == 0 && exponent < 0) return Bound::anything();  // the sign of the 0 decides
      result = {std::min(result.low, value - error), std::max(result.high, value + error)};
    }
  return allowed(result.low, result.high, dtype);
}

Bound cast(const Bound& x, DType from, DType to) {
  if (is_float(to)) return is_float(from) ? rounded(flushed(x), to) : rounded(x, to);
  const IntRange range = dtype_range(to);
  if (x.is_anything()) return {static_cast<double>(range.min), static_cast<double>(range.max)};
  return {static_cast<double>(real_to_int(x.low, to)),
          static_cast<double>(real_to_int(x.high, to))};
}

Bounds points(const Tensor& tensor) {
  Bounds bounds(static_cast<size_t>(tensor.count()));
  for (size_t i = 0; i < bounds.size(); ++i) {
    const int64_t at = static_cast<int64_t>(i);
    const double value = is_float(tensor.type.dtype) ? static_cast<double>(tensor.real(at))
                                                     : static_cast<double>(tensor.get(at));
    bounds[i] = {value, value};
  }
  return bounds;
}

bool all_points(const Bounds& bounds) {
  return std::ranges::all_of(bounds, [](const Bound& bound) { return bound.is_point(); });
}

/// A tensor of the only values that the bounds leave.
Tensor only_values(const TensorType& type, const Bounds& bounds) {
  Tensor tensor = Tensor::zeros(type);
  for (size_t i = 0; i < bounds.size(); ++i) {
    const int64_t at = static_cast<int64_t>(i);
    if (is_float(type.dtype))
      tensor.set_real(at, static_cast<float>(bounds[i].low));
    else
      tensor.set(at, static_cast<int64_t>(bounds[i].low));
  }
  return tensor;
}

/// One node between bounds of its operands and of its result.
class NodeBounds {
 public:
  NodeBounds(const Graph& graph, NodeId id, std::span<const Tensor* const> constants,
             std::span<const Bounds* const> operands)
      : graph_(graph),
        id_(id),
        node_(graph.node(id)),
        constants_(constants),
        operands_(operands),
        type_(graph.value(node_.output).type) {}

  Result<Bounds> compute() {
    const bool real = is_float(type_.dtype) || is_float(dtype(0));
    switch (node_.op) {
      case Op::kConcat:
      case Op::kGather:
      case Op::kIdentity:
      case Op::kPad:
      case Op::kReshape:
      case Op::kReverse:
      case Op::kScatter:
      case Op::kSlice:
      case Op::kTile:
      case Op::kTranspose: return moved();
      case Op::kSelect: return select();
      case Op::kResize:
        if (node_.attrs.get(Attr::kMode) == kNearest) return moved();
        break;
      default: break;
    }
    if (!real) return exact();
    switch (node_.op) {
      case Op::kConv2d:
      case Op::kConv3d:
      case Op::kDepthwiseConv2d:
      case Op::kTransposeConv2d:
      case Op::kMatmul: return sums();
      case Op::kAvgPool2d:
      case Op::kMaxPool2d:
      case Op::kReduceMax:
      case Op::kReduceMin:
      case Op::kReduceProduct:
      case Op::kReduceSum:
      case Op::kResize: return terms();
      case Op::kFft2d:
      case Op::kRfft2d: return transform();
      case Op::kArgmax: return argmax();
      case Op::kCast:
      case Op::kClamp: return unary();
      default: return is_function(node_.op) ? unary() : binary();
    }
  }

 private:
  const Bounds& in(size_t i) const { return *operands_[i]; }
  const TensorType& type(size_t i) const { return graph_.value(node_.inputs[i]).type; }
  DType dtype(size_t i) const { return type(i).dtype; }
  bool ignores_nan() const { return node_.attrs.get(Attr::kNanMode) == kIgnoreNan; }
  size_t count() const { return static_cast<size_t>(*element_count(type_.shape)); }

  /// Operands as tensors, for those that have no open element.
  Result<std::vector<Tensor>> tensors() const {
    std::vector<Tensor> result;
    for (size_t i = 0; i < node_.inputs.size(); ++i) {
      if (constants_[i])
        result.push_back(*constants_[i]);
      else
        result.push_back(only_values(type(i), in(i)));
    }
    return result;
  }

  static Result<Tensor> evaluate(const Graph& graph, NodeId id,
                                 const std::vector<Tensor>& operands) {
    std::vector<const Tensor*> pointers;
    for (const Tensor& operand : operands) pointers.push_back(&operand);
    return evaluate_node(graph, id, pointers);
  }

  /// Integers of integers: exact, or anything where an operand is open.
  Result<Bounds> exact() const {
    for (size_t i = 0; i < node_.inputs.size(); ++i)
      if (!constants_[i] && !all_points(in(i))) return Bounds(count(), Bound::anything());
    SHALE_TRY(const std::vector<Tensor> operands, tensors());
    SHALE_TRY(const Tensor result, evaluate(graph_, id_, operands));
    return points(result);
  }

  /// The node moves elements about: it is run on their numbers in place of their values.
  Result<Bounds> moved() const {
    Graph numbered = graph_;
    Bounds all;
    SHALE_TRY(std::vector<Tensor> operands, tensors());
    const bool indexed = node_.op == Op::kGather || node_.op == Op::kScatter;
    if (indexed && !constants_[1] && !all_points(in(1))) return Bounds(count(), Bound::anything());
    for (size_t i = 0; i < operands.size(); ++i) {
      if (dtype(i) == DType::kShape || (indexed && i == 1) || (node_.op == Op::kResize && i > 0))
        continue;
      Tensor numbers = Tensor::zeros({DType::kInt32, type(i).shape});
      for (int64_t k = 0; k < numbers.count(); ++k)
        numbers.set(k, static_cast<int64_t>(all.size()) + k);
      all.insert(all.end(), in(i).begin(), in(i).end());
      operands[i] = std::move(numbers);
    }
    numbered.value(node_.output).type.dtype = DType::kInt32;
    SHALE_TRY(const Tensor from, evaluate(numbered, id_, operands));
    Bounds result(count());
    for (size_t i = 0; i < result.size(); ++i)
      result[i] = all[static_cast<size_t>(from.get(static_cast<int64_t>(i)))];
    return result;
  }

  Bounds select() const {
    Bounds result(count());
    for_each_index<3>(type_.shape,
                      {broadcast_strides(type(0).shape), broadcast_strides(type(1).shape),
                       broadcast_strides(type(2).shape)},
                      {}, [&](int64_t element, const std::array<int64_t, 3>& at) {
                        const auto bound = [&](size_t i) {
                          return in(i)[static_cast<size_t>(at[i])];
                        };
                        const Bound condition = bound(0), yes = bound(1), no = bound(2);
                        Bound& to = result[static_cast<size_t>(element)];
                        if (condition.is_point())
                          to = condition.low != 0 ? yes : no;
                        else if (yes.is_anything() || no.is_anything() || is_nan(yes) || is_nan(no))
                          to = Bound::anything();
                        else
                          to = {std::min(yes.low, no.low), std::max(yes.high, no.high)};
                        return true;
                      });
    return result;
  }

  Bounds unary() const {
    Bounds result = in(0);
    const auto limit = [&](Attr attr) {
      const double value = static_cast<double>(bits_real(dtype(0), node_.attrs.get(attr)));
      return Bound{value, value};
    };
    for (Bound& x : result) {
      switch (node_.op) {
        case Op::kAbs:
          if (!x.is_anything() && !is_nan(x))
            x = flushed(
                {x.low <= 0 && x.high >= 0 ? 0 : std::min(std::fabs(x.low), std::fabs(x.high)),
                 std::max(std::fabs(x.low), std::fabs(x.high))});
          break;
        case Op::kNegate: x = is_nan(x) ? x : flushed(negated(x)); break;
        case Op::kClamp:
          x = smaller(larger(x, limit(Attr::kMinVal), ignores_nan()), limit(Attr::kMaxVal),
                      ignores_nan());
          break;
        case Op::kCast: x = cast(x, dtype(0), type_.dtype); break;
        default: x = function(node_.op, x, type_.dtype);
      }
    }
    return result;
  }

  Bounds binary() const {
    Bounds result(count());
    for_each_index<2>(type_.shape,
                      {broadcast_strides(type(0).shape), broadcast_strides(type(1).shape)}, {},
                      [&](int64_t element, const std::array<int64_t, 2>& at) {
                        const Bound& a = in(0)[static_cast<size_t>(at[0])];
                        const Bound& b = in(1)[static_cast<size_t>(at[1])];
                        Bound& to = result[static_cast<size_t>(element)];
                        switch (node_.op) {
                          case Op::kAdd:
                          case Op::kSub:
                          case Op::kMul: to = arithmetic(node_.op, a, b, type_.dtype); break;
                          case Op::kPow: to = power(a, b, type_.dtype); break;
                          case Op::kMaximum: to = larger(a, b, ignores_nan()); break;
                          case Op::kMinimum: to = smaller(a, b, ignores_nan()); break;
                          default: to = compared(node_.op, a, b);
                        }
                        return true;
                      });
    return result;
  }

  Bounds argmax() const {
    const AxisView view(type(0).shape, static_cast<size_t>(node_.attrs.get(Attr::kAxis)));
    Bounds result(count());
    for (size_t i = 0; i < result.size(); ++i) {
      const int64_t at = static_cast<int64_t>(i);
      const int64_t first = at / view.inner * view.dim * view.inner + at % view.inner;
      std::vector<Bound> row;
      for (int64_t k = 0; k < view.dim; ++k)
        row.push_back(in(0)[static_cast<size_t>(first + k * view.inner)]);
      result[i] = largest_of(row);
    }
    return result;
  }

  /// The first and the last that may be the largest.
  Bound largest_of(const std::vector<Bound>& row) const {
    const double last = static_cast<double>(row.size() - 1);
    if (std::ranges::any_of(row, [](const Bound& x) { return x.is_anything(); })) return {0, last};
    const auto nan = std::ranges::find_if(row, is_nan);
    if (nan != row.end() && !ignores_nan()) {
      const double at = static_cast<double>(nan - row.begin());
      return {at, at};
    }
    double bar = -kInfinity;
    for (const Bound& x : row)
      if (!is_nan(x)) bar = std::max(bar, flushed(x).low);
    Bound found{last, 0};
    bool sure = false;  // the first that surely reaches the bar ends the search: ties go to it
    for (size_t k = 0; k < row.size() && !sure; ++k) {
      if (is_nan(row[k]) || flushed(row[k]).high < bar) continue;
      found.low = std::min(found.low, static_cast<double>(k));
      found.high = static_cast<double>(k);
      sure = row[k].is_point() && flushed(row[k]).is_point() && row[k].low == bar &&
             std::ranges::all_of(
                 row, [&](const Bound& x) { return is_nan(x) || flushed(x).high <= bar; });
    }
    return found.low > found.high ? Bound{0, 0} : found;  // all are NaN
  }

  Bounds terms() const {
    std::vector<const Tensor*> shapes;
    for (const Tensor* constant : constants_) shapes.push_back(constant);
    Tensor shape_only{type(0), {}};  // real_terms reads shapes and parameters, no element
    shapes[0] = &shape_only;
    const Eval node(graph_, id_, shapes);
    Bounds result(count());
    std::vector<RealTerm> found;
    for (size_t i = 0; i < result.size(); ++i) {
      real_terms(node, static_cast<int64_t>(i), found);
      result[i] = fold(found);
    }
    return result;
  }

  Bound fold(const std::vector<RealTerm>& found) const {
    const auto bound = [&](const RealTerm& term) {
      return in(0)[static_cast<size_t>(term.element)];
    };
    if (node_.op == Op::kMaxPool2d || node_.op == Op::kReduceMax || node_.op == Op::kReduceMin) {
      Bound best = bound(found[0]);
      for (const RealTerm& term : found)
        best = node_.op == Op::kReduceMin ? smaller(best, bound(term), ignores_nan())
                                          : larger(best, bound(term), ignores_nan());
      return best;
    }
    if (node_.op == Op::kReduceProduct) return product(found);
    // A weight of RESIZE is a quotient or one less a quotient: three roundings and a half.
    const double weight_error = node_.op == Op::kResize ? 3.5 * kUnit : 0;
    Bound sum{0, 0};
    double magnitude = 0, beside = 0;
    bool nan = false, points_only = true, zero_weight = false, infinite = false;
    for (const RealTerm& term : found) {
      if (bound(term).is_anything()) return Bound::anything();
      nan = nan || is_nan(bound(term));
      const Bound x = flushed(bound(term));
      points_only = points_only && x.is_point();
      const double y = static_cast<double>(term.weight_y), w = static_cast<double>(term.weight_x);
      const double weight = y * w;
      const double largest = std::max(std::fabs(x.low), std::fabs(x.high));
      if (!std::isfinite(largest)) {
        infinite = true;
        zero_weight = zero_weight || weight == 0;
      }
      sum = {sum.low + x.low * weight, sum.high + x.high * weight};
      magnitude += largest * weight;
      beside += largest * ((y + weight_error) * (w + weight_error) - weight);
    }
    if (infinite) {
      if (zero_weight || !points_only) return Bound::anything();
      return nan || std::isnan(sum.low) ? Bound{kNan, kNan} : sum;
    }
    const double n = static_cast<double>(found.size());
    // A product of RESIZE is two roundings more; the mean divides.
    double error = gamma(n + 4) * magnitude + beside + 2 * n * kTiny;
    if (magnitude + error > kLargest) return Bound::anything();
    if (node_.op == Op::kAvgPool2d) {
      sum = {sum.low / n, sum.high / n};
      error = kSecondOrder * (error + 2.5 * kUnit * magnitude) / n;
    }
    return ended({sum.low - error, sum.high + error}, type_.dtype);
  }

  /// In any order, so nothing is known once a part of the product may leave the range of float32.
  Bound product(const std::vector<RealTerm>& found) const {
    const auto bound = [&](const RealTerm& term) {
      return in(0)[static_cast<size_t>(term.element)];
    };
    if (std::ranges::any_of(found, [&](const RealTerm& term) { return is_nan(bound(term)); }))
      return {kNan, kNan};
    Bound result{1, 1};
    double largest = 1, smallest = 1;  // of the parts
    for (const RealTerm& term : found) {
      if (!is_plain(bound(term))) return Bound::anything();
      const Bound x = flushed(bound(term));
      largest *= std::max(reach(x), 1.0);
      if (x.low > 0 || x.high < 0) smallest *= std::min({std::fabs(x.low), std::fabs(x.high), 1.0});
      result = corners(result, x, [](double a, double b) { return Bound{a * b, a * b}; });
    }
    if (largest > kLargest || smallest < kTiny) return Bound::anything();
    const double error = gamma(static_cast<double>(found.size())) * reach(result);
    return ended({result.low - error, result.high + error}, type_.dtype);
  }

  /// Two sums, each of cosines and sines that are rounded once, over the rows and then over the columns.
  Bounds transform() const {
    Bounds result(count(), Bound::anything());
    const bool complex = node_.op == Op::kFft2d;
    double magnitude = 0, spread = 0;
    std::vector<double> middles[2];
    for (size_t part = 0; part < (complex ? 2u : 1u); ++part)
      for (const Bound& x : in(part)) {
        if (!is_plain(x)) return result;
        middles[part].push_back(middle(flushed(x)));
        magnitude += reach(flushed(x));
        spread += radius(flushed(x));
      }
    const Shape& shape = type(0).shape;
    const double n = 2 * static_cast<double>(shape[1] + shape[2]) + 4;
    const double error = kSecondOrder * gamma(n) * 2 * magnitude + spread +
                         4 * static_cast<double>(shape[1] * shape[2]) * kTiny;
    if (2 * magnitude + error > kLargest) return result;
    const Tensor stand_in{type(0), {}};
    const Tensor* const operands[] = {&stand_in, &stand_in};
    const std::vector<double> value =
        real_fft(Eval(graph_, id_, {operands, node_.inputs.size()}), middles[0], middles[1]);
    for (size_t i = 0; i < result.size(); ++i)
      result[i] = ended({value[i] - error, value[i] + error}, type_.dtype);
    return result;
  }

  using Doubles = std::vector<double>;
  template <typename Function>
  static Doubles each(const Bounds& bounds, const Function& function) {
    Doubles result(bounds.size());
    for (size_t i = 0; i < result.size(); ++i) result[i] = function(flushed(bounds[i]));
    return result;
  }
  static double middle(const Bound& x) { return x.is_point() ? x.low : x.low / 2 + x.high / 2; }
  static double reach(const Bound& x) { return std::max(std::fabs(x.low), std::fabs(x.high)); }
  static double radius(const Bound& x) {
    return x.is_point() ? 0 : std::nextafter(x.high / 2 - x.low / 2, kInfinity);
  }
  static bool is_plain(const Bound& x) {
    return !x.is_anything() && std::isfinite(x.low) && std::isfinite(x.high);
  }
  static double plain_reach(const Bound& x) { return is_plain(x) ? reach(x) : 0; }

  Bounds sums() const {
    std::vector<const Tensor*> shapes;
    std::vector<Tensor> stand_ins;
    for (size_t i = 0; i < node_.inputs.size(); ++i) stand_ins.push_back({type(i), {}});
    for (const Tensor& each_one : stand_ins) shapes.push_back(&each_one);
    const Eval node(graph_, id_, shapes);
    const bool matmul = node_.op == Op::kMatmul;
    const Bounds none{{0, 0}};
    const Bounds& a = in(0);
    const Bounds& b = in(1);
    const Bounds& c = matmul ? none : in(2);
    const auto total = [&](const auto& of_a, const auto& of_b, const auto& of_c) {
      return real_sums(node, each(a, of_a), each(b, of_b), each(c, of_c));
    };
    const auto nothing = [](const Bound&) { return 0.0; };
    // An operand that is no plain number is left out here and looked at below.
    const auto plain_middle = [](const Bound& x) { return is_plain(x) ? middle(x) : 0; };
    const auto plain_radius = [](const Bound& x) { return is_plain(x) ? radius(x) : 0; };
    const Doubles centre = total(plain_middle, plain_middle, plain_middle);
    const Doubles magnitude = total(plain_reach, plain_reach, plain_reach);
    Doubles spread = total(plain_radius, plain_reach, plain_radius);
    if (!all_points(b)) {
      const Doubles more = total(plain_reach, plain_radius, nothing);
      for (size_t i = 0; i < spread.size(); ++i) spread[i] += more[i];
    }
    const Shape& weight = type(1).shape;
    double n = 1;
    if (matmul)
      n = static_cast<double>(weight[1]);
    else if (node_.op == Op::kDepthwiseConv2d)
      n = static_cast<double>(weight[0] * weight[1]);
    else
      for (size_t i = 1; i < weight.size(); ++i) n *= static_cast<double>(weight[i]);

    Bounds result(centre.size());
    for (size_t i = 0; i < result.size(); ++i) {
      const double error =
          kSecondOrder * gamma(n + 4) * (magnitude[i] + spread[i]) + spread[i] + 2 * n * kTiny;
      result[i] = magnitude[i] + error > kLargest
                      ? Bound::anything()
                      : ended({centre[i] - error, centre[i] + error}, type_.dtype);
    }
    const auto plain = [](const Bounds& bounds) { return std::ranges::all_of(bounds, is_plain); };
    if (plain(a) && plain(b) && plain(c)) return result;

    // NaN and infinity go through a sum in any order, unless they meet a factor that may be 0 (kernels
    // may leave it out) or an interval.
    const auto exact_value = [](const Bound& x) { return x.low; };
    const auto is_strange = [](const Bound& x) { return is_plain(x) ? 0.0 : 1.0; };
    const auto is_open = [](const Bound& x) { return is_plain(x) || x.is_point() ? 0.0 : 1.0; };
    const auto may_be_zero = [](const Bound& x) { return x.low <= 0 && x.high >= 0 ? 1.0 : 0.0; };
    const auto one = [](const Bound&) { return 1.0; };
    const Doubles strange = total(is_strange, one, is_strange),
                  other = total(one, is_strange, nothing);
    const Doubles open = total(is_open, one, is_open), other_open = total(one, is_open, nothing);
    const Doubles zero = total(is_strange, may_be_zero, nothing),
                  other_zero = total(may_be_zero, is_strange, nothing);
    const Doubles value = total(exact_value, exact_value, exact_value);
    for (size_t i = 0; i < result.size(); ++i) {
      if (strange[i] + other[i] == 0) continue;
      if (open[i] + other_open[i] + zero[i] + other_zero[i] > 0 || magnitude[i] > kLargest / 2 ||
          std::isfinite(value[i]))
        result[i] = Bound::anything();
      else
        result[i] = {value[i], value[i]};
    }
    return result;
  }

  const Graph& graph_;
  NodeId id_;
  const Node& node_;
  std::span<const Tensor* const> constants_;
  std::span<const Bounds* const> operands_;
  const TensorType& type_;
};

}  // namespace

bool Bound::holds(double value) const {
  if (is_anything()) return true;
  if (std::isnan(low)) return std::isnan(value);
  return low <= value && value <= high;
}

bool has_reals(const Graph& graph) {
  return std::ranges::any_of(graph.values,
                             [](const Value& value) { return is_float(value.type.dtype); });
}

double widest(const Bounds& bounds) {
  double width = 0;
  for (const Bound& bound : bounds)
    width = bound.is_anything() ? kInfinity
                                : std::max(width, bound.is_point() ? 0 : bound.high - bound.low);
  return width;
}

std::optional<std::string> first_outside(const Tensor& found, const Bounds& bounds) {
  const Bounds values = points(found);
  if (values.size() != bounds.size())
    return fmt::format("found {} elements, expected {}", values.size(), bounds.size());
  for (size_t i = 0; i < values.size(); ++i) {
    const Bound& bound = bounds[i];
    if (bound.holds(values[i].low)) continue;
    const std::string where =
        fmt::format("element {} at {}: found {:.9g}, expected", i,
                    coordinates_text(found.type.shape, static_cast<int64_t>(i)), values[i].low);
    if (bound.low == bound.high || std::isnan(bound.low))
      return fmt::format("{} {:.9g}", where, bound.low);
    return fmt::format("{} {:.9g} to {:.9g}", where, bound.low, bound.high);
  }
  return std::nullopt;
}

Result<std::vector<Bounds>> interpret_bounds(const Graph& graph, std::span<const Tensor> inputs,
                                             const InterpreterProgress& progress) {
  SHALE_TRY_VOID(check_inputs(graph, inputs));
  std::vector<Bounds> bounds(graph.values.size());
  for (size_t i = 0; i < inputs.size(); ++i) bounds[graph.inputs[i].index] = points(inputs[i]);
  for (size_t i = 0; i < graph.values.size(); ++i)
    if (graph.values[i].is_constant() && graph.values[i].type.dtype != DType::kShape)
      bounds[i] = points(*graph.values[i].constant);
  std::vector<uint32_t> uses = graph.use_counts();
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    if (progress && !progress(i, static_cast<uint32_t>(graph.nodes.size())))
      return bad_input(node_label(graph, {i}), "the run was stopped before this node");
    std::vector<const Tensor*> constants;
    std::vector<const Bounds*> operands;
    for (const ValueId id : node.inputs) {
      const Value& value = graph.value(id);
      constants.push_back(value.is_constant() ? &*value.constant : nullptr);
      operands.push_back(&bounds[id.index]);
    }
    SHALE_TRY(bounds[node.output.index], NodeBounds(graph, {i}, constants, operands).compute());
    for (const ValueId id : node.inputs)
      if (--uses[id.index] == 0) bounds[id.index] = Bounds{};
  }
  std::vector<Bounds> outputs;
  for (const ValueId id : graph.outputs) outputs.push_back(bounds[id.index]);
  return outputs;
}

}  // namespace shale
