// ir/reference/eval_elementwise.cpp -- operators that compute each element on its own.
#include <algorithm>
#include <bit>

#include "ir/reference/eval.h"

namespace shale {
namespace {

/// What the operators need beside their elements, looked up once a node.
struct Params {
  DType from;              ///< element type of operand 0
  DType to;                ///< of the result
  int64_t bits;            ///< width of `from`
  bool round;              ///< of ARITHMETIC_RIGHT_SHIFT
  int64_t shift;           ///< of MUL
  int64_t zero_point_sum;  ///< of NEGATE
  IntRange limits;         ///< of CLAMP
  const Tensor* table;     ///< of TABLE
};

/// For parallel_for.
constexpr int64_t kElementCost = 16;

/// Result of one element; nothing where TOSA leaves it unpredictable.
using Element = std::optional<int64_t>;

bool shift_is_legal(int64_t b, const Params& p) { return in_range(b, {0, p.bits - 1}); }

Element checked(int64_t value) { return fits_int32(value) ? Element(value) : std::nullopt; }

Element multiply(int64_t a, int64_t b, const Params& p) {
  if (p.from != DType::kInt32) return a * b;
  if (p.shift == 0) return static_cast<int32_t>(a * b);  // the low bits, by definition
  // 128 bits for one case: -2^31 squared, plus the round of shift 63, is 2^63.
  const __int128 sum = static_cast<__int128>(a) * b + (static_cast<__int128>(1) << (p.shift - 1));
  return checked(static_cast<int64_t>(sum >> p.shift));
}

Element arithmetic_right_shift(int64_t a, int64_t b, const Params& p) {
  if (!shift_is_legal(b, p)) return std::nullopt;
  return (a >> b) + (p.round && b > 0 ? (a >> (b - 1)) & 1 : 0);
}

Element logical_left_shift(int64_t a, int64_t b, const Params& p) {
  return shift_is_legal(b, p) ? Element(a * (int64_t{1} << b)) : std::nullopt;
}

Element logical_right_shift(int64_t a, int64_t b, const Params& p) {
  const int64_t pattern = a & ((int64_t{1} << p.bits) - 1);
  return shift_is_legal(b, p) ? Element(pattern >> b) : std::nullopt;
}

Element divide(int64_t a, int64_t b, const Params&) {
  return b == 0 ? std::nullopt : checked(a / b);
}

struct BinaryRow {
  Op op;
  Element (*compute)(int64_t a, int64_t b, const Params& p);
};
constexpr BinaryRow kBinary[] = {
    {Op::kAdd, [](int64_t a, int64_t b, const Params&) { return checked(a + b); }},
    {Op::kSub, [](int64_t a, int64_t b, const Params&) { return checked(a - b); }},
    {Op::kMul, multiply},
    {Op::kIntDiv, divide},
    {Op::kMaximum, [](int64_t a, int64_t b, const Params&) { return Element(std::max(a, b)); }},
    {Op::kMinimum, [](int64_t a, int64_t b, const Params&) { return Element(std::min(a, b)); }},
    {Op::kArithmeticRightShift, arithmetic_right_shift},
    {Op::kLogicalLeftShift, logical_left_shift},
    {Op::kLogicalRightShift, logical_right_shift},
    {Op::kBitwiseAnd, [](int64_t a, int64_t b, const Params&) { return Element(a & b); }},
    {Op::kBitwiseOr, [](int64_t a, int64_t b, const Params&) { return Element(a | b); }},
    {Op::kBitwiseXor, [](int64_t a, int64_t b, const Params&) { return Element(a ^ b); }},
    {Op::kLogicalAnd, [](int64_t a, int64_t b, const Params&) { return Element(a & b); }},
    {Op::kLogicalOr, [](int64_t a, int64_t b, const Params&) { return Element(a | b); }},
    {Op::kLogicalXor, [](int64_t a, int64_t b, const Params&) { return Element(a ^ b); }},
    {Op::kEqual, [](int64_t a, int64_t b, const Params&) { return Element(a == b); }},
    {Op::kGreater, [](int64_t a, int64_t b, const Params&) { return Element(a > b); }},
    {Op::kGreaterEqual, [](int64_t a, int64_t b, const Params&) { return Element(a >= b); }},
};

Element negate(int64_t a, const Params& p) {
  const int64_t value = p.zero_point_sum - a;
  const IntRange range = dtype_range(p.from);
  return p.from == DType::kInt32 ? checked(value) : std::clamp(value, range.min, range.max);
}

Element clamp(int64_t a, const Params& p) { return std::clamp(a, p.limits.min, p.limits.max); }

Element look_up(int64_t a, const Params& p) {
  if (p.from == DType::kInt8) return p.table->get(a + 128);
  const int64_t index = (a >> 7) + 256, base = p.table->get(index);
  const int64_t slope = p.table->get(index + 1) - base;
  if (!in_range(slope, dtype_range(DType::kInt16))) return std::nullopt;
  return base * 128 + slope * (a & 127);
}

Element cast(int64_t a, const Params& p) {
  return p.to == DType::kBool ? a != 0 : a;  // storing keeps the low bits
}

struct UnaryRow {
  Op op;
  Element (*compute)(int64_t a, const Params& p);
};
constexpr UnaryRow kUnary[] = {
    {Op::kAbs, [](int64_t a, const Params&) { return checked(a < 0 ? -a : a); }},
    {Op::kBitwiseNot, [](int64_t a, const Params&) { return Element(~a); }},
    {Op::kLogicalNot, [](int64_t a, const Params&) { return Element(a ^ 1); }},
    {Op::kClz,
     [](int64_t a, const Params&) { return Element(std::countl_zero(static_cast<uint32_t>(a))); }},
    {Op::kNegate, negate},
    {Op::kClamp, clamp},
    {Op::kTable, look_up},
    {Op::kCast, cast},
    {Op::kIdentity, [](int64_t a, const Params&) { return Element(a); }},
};

template <typename Row>
const Row& row_for(Op op, std::span<const Row> rows) {
  const auto row = std::ranges::find(rows, op, &Row::op);
  SHALE_CHECK(row != rows.end());
  return *row;
}

Params params(const Eval& node) {
  const DType from = node.in(0).type.dtype;
  return {
      .from = from,
      .to = node.result_type().dtype,
      .bits = dtype_info(from).bits,
      .round = node.attrs().flag(Attr::kRound),
      .shift = node.op() == Op::kMul ? node.scalar(2) : 0,
      .zero_point_sum = node.op() == Op::kNegate ? node.scalar(1) + node.scalar(2) : 0,
      .limits = {node.attrs().get(Attr::kMinVal), node.attrs().get(Attr::kMaxVal)},
      .table = node.op() == Op::kTable ? &node.in(1) : nullptr,
  };
}

}  // namespace

Result<Tensor> eval_unary(const Eval& node) {
  const Params p = params(node);
  const UnaryRow& row = row_for<UnaryRow>(node.op(), kUnary);
  const Tensor& input = node.in(0);
  Tensor result = Tensor::zeros(node.result_type());
  SHALE_TRY_VOID(
      parallel_for(result.count(), kElementCost, [&](int64_t begin, int64_t end) -> Result<void> {
        for (int64_t i = begin; i < end; ++i) {
          const Element value = row.compute(input.get(i), p);
          if (!value) return node.unpredictable(i, "no result for {}", input.get(i));
          result.set(i, *value);
        }
        return {};
      }));
  return result;
}

Result<Tensor> eval_binary(const Eval& node) {
  const Params p = params(node);
  const BinaryRow& row = row_for<BinaryRow>(node.op(), kBinary);
  Tensor result = Tensor::zeros(node.result_type());
  std::optional<Error> error;
  for_each_index<2>(result.type.shape,
                    {broadcast_strides(node.shape(0)), broadcast_strides(node.shape(1))}, {},
                    [&](int64_t element, const std::array<int64_t, 2>& at) {
                      const int64_t a = node.in(0).get(at[0]), b = node.in(1).get(at[1]);
                      const Element value = row.compute(a, b, p);
                      if (value)
                        result.set(element, *value);
                      else
                        error = node.unpredictable(element, "no result for {} and {}", a, b);
                      return value.has_value();
                    });
  if (error) return *std::move(error);
  return result;
}

Result<Tensor> eval_select(const Eval& node) {
  Tensor result = Tensor::zeros(node.result_type());
  for_each_index<3>(result.type.shape,
                    {broadcast_strides(node.shape(0)), broadcast_strides(node.shape(1)),
                     broadcast_strides(node.shape(2))},
                    {}, [&](int64_t element, const std::array<int64_t, 3>& at) {
                      const size_t side = node.in(0).get(at[0]) != 0 ? 1 : 2;
                      result.set(element, node.in(side).get(at[side]));
                      return true;
                    });
  return result;
}

Result<Tensor> eval_rescale(const Eval& node) {
  const Tensor& input = node.in(0);
  const TensorType& type = node.result_type();
  const bool scale32 = node.attrs().flag(Attr::kScale32);
  const bool double_round = node.attrs().get(Attr::kRoundingMode) == kDoubleRound;
  // The bits that stay of a stored element: all, or those of its type read as unsigned.
  const auto mask = [&](DType dtype, Attr is_unsigned) {
    if (!node.attrs().flag(is_unsigned)) return int64_t{-1};
    return (int64_t{1} << dtype_info(dtype).bits) - 1;
  };
  const int64_t input_mask = mask(input.type.dtype, Attr::kInputUnsigned);
  const int64_t output_mask = mask(type.dtype, Attr::kOutputUnsigned);
  const int64_t input_zp = node.scalar(3) & input_mask;
  const int64_t output_zp = node.scalar(4) & output_mask;
  const IntRange range = output_mask < 0 ? dtype_range(type.dtype) : IntRange{0, output_mask};
  const std::vector<int64_t> multiplier = node.in(1).ints(), shift = node.in(2).ints();

  Tensor result = Tensor::zeros(type);
  const auto compute = [&](int64_t begin, int64_t end) -> Result<void> {
    for (int64_t i = begin; i < end; ++i) {
      const size_t channel = static_cast<size_t>(i) % multiplier.size();
      const int64_t m = multiplier[channel], s = shift[channel];
      const int64_t value = (input.get(i) & input_mask) - input_zp;
      Element scaled =
          scale32 ? apply_scale_32(value, m, s, double_round) : apply_scale_16(value, m, s);
      if (scaled) scaled = checked(*scaled + output_zp);
      if (!scaled)
        return node.unpredictable(i, "no result for {} with multiplier {}, shift {}, output_zp {}",
                                  value, m, s, output_zp);
      result.set(i, std::clamp(*scaled, range.min, range.max));
    }
    return {};
  };
  SHALE_TRY_VOID(parallel_for(result.count(), kElementCost, compute));
  return result;
}

}  // namespace shale
