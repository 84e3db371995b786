// ir/verify/rules_elementwise.cpp -- operators that compute each element on its own.
// Source: TOSA 1.0, activation, elementwise, comparison and type conversion operators.
#include "ir/verify/rule.h"

namespace shale {

Result<TensorType> rule_unary(const RuleContext& node) { return node.type(0); }

Result<TensorType> rule_binary(const RuleContext& node) {
  SHALE_TRY_VOID(node.expect_same_dtype(0));
  SHALE_TRY(Shape shape, node.broadcast(0));
  return TensorType{node.dtype(0), std::move(shape)};
}

Result<TensorType> rule_shift(const RuleContext& node) {
  SHALE_TRY(TensorType result, rule_binary(node));
  SHALE_TRY_VOID(node.expect_elements(1, 0, dtype_info(node.dtype(0)).bits - 1));
  return result;
}

Result<TensorType> rule_intdiv(const RuleContext& node) {
  SHALE_TRY(TensorType result, rule_binary(node));
  if (node.operand(1).is_constant()) {
    const Tensor& divisor = *node.operand(1).constant;
    for (int64_t i = 0; i < divisor.count(); ++i)
      if (divisor.get(i) == 0)
        return node.bad("{} has 0 at element {}: division by zero", node.describe(1), i);
  }
  return result;
}

Result<TensorType> rule_compare(const RuleContext& node) {
  SHALE_TRY(TensorType result, rule_binary(node));
  result.dtype = DType::kBool;
  return result;
}

Result<TensorType> rule_mul(const RuleContext& node) {
  SHALE_TRY_VOID(node.expect_dtype(1, dtype_bit(node.dtype(0))));
  SHALE_TRY_VOID(node.expect_type(2, {DType::kInt8, {1}}));
  SHALE_TRY_VOID(node.expect_elements(2, 0, node.dtype(0) == DType::kInt32 ? 63 : 0));
  SHALE_TRY(Shape shape, node.broadcast(0, 2));
  return TensorType{is_float(node.dtype(0)) ? node.dtype(0) : DType::kInt32, std::move(shape)};
}

Result<TensorType> rule_negate(const RuleContext& node) {
  SHALE_TRY_VOID(node.expect_zero_point(1, node.dtype(0)));
  SHALE_TRY_VOID(node.expect_zero_point(2, node.dtype(0)));
  return node.type(0);
}

Result<TensorType> rule_select(const RuleContext& node) {
  SHALE_TRY_VOID(node.expect_dtype(1, kBool | kI8 | kI16 | kI32 | kFloat));
  SHALE_TRY_VOID(node.expect_same_dtype(1));
  SHALE_TRY(Shape shape, node.broadcast(0));
  return TensorType{node.dtype(1), std::move(shape)};
}

Result<TensorType> rule_clamp(const RuleContext& node) {
  const int64_t min = node.attrs().get(Attr::kMinVal), max = node.attrs().get(Attr::kMaxVal);
  if (is_float(node.dtype(0))) {
    const float low = bits_real(node.dtype(0), min), high = bits_real(node.dtype(0), max);
    if (!(low <= high))
      return node.bad("min_val {} and max_val {}: expected numbers in order", low, high);
    return node.type(0);
  }
  if (max < min) return node.bad("min_val {} is above max_val {}", min, max);
  return node.type(0);
}

Result<TensorType> rule_table(const RuleContext& node) {
  if (node.dtype(0) == DType::kInt8) {
    SHALE_TRY_VOID(node.expect_type(1, {DType::kInt8, {256}}));
    return node.type(0);
  }
  SHALE_TRY_VOID(node.expect_type(1, {DType::kInt16, {513}}));
  const IntRange range = dtype_range(DType::kInt16);
  const std::vector<int64_t> table = node.operand(1).constant->ints();
  for (size_t i = 0; i + 1 < table.size(); ++i)
    if (const int64_t slope = table[i + 1] - table[i]; slope < range.min || slope > range.max)
      return node.bad("{} has a slope of {} from element {} on, expected {} to {}",
                      node.describe(1), slope, i, range.min, range.max);
  return TensorType{DType::kInt32, node.shape(0)};
}

Result<TensorType> rule_cast(const RuleContext& node) {
  constexpr DTypeSet kInts = kI8 | kI16 | kI32;
  const DType from = node.dtype(0), to = node.declared_result().dtype;
  DTypeSet targets = kInts | kFloat | kBool;
  switch (from) {
    case DType::kBool: targets = kInts; break;
    case DType::kFp8E4M3:
    case DType::kFp8E5M2: targets = kFloat; break;
    case DType::kFp16:
    case DType::kBf16: targets = kInts | kF8 | kF32; break;
    case DType::kFp32: targets = kInts | kF8 | kF16 | kBF16; break;
    default: break;
  }
  targets &= ~dtype_bit(from);
  if (!contains(targets, to))
    return node.bad("casts {} to {}, expected {}", node.describe(0), dtype_info(to).name,
                    set_text(targets));
  return TensorType{to, node.shape(0)};
}

namespace {

/// The stored zero point of a RESCALE side: free for int8, 0 or 32768 for unsigned int16, else 0.
Result<void> expect_rescale_zero_point(const RuleContext& node, size_t i, DType of,
                                       bool is_unsigned) {
  if (!(is_unsigned && of == DType::kInt16)) return node.expect_zero_point(i, of);
  SHALE_TRY_VOID(node.expect_type(i, {of, {1}}));
  const int64_t bits = node.operand(i).constant->get(0);
  if (bits == 0 || bits == dtype_range(DType::kInt16).min) return {};
  return node.bad("{} is {} unsigned, expected 0 or 32768", node.describe(i), bits & 0xffff);
}

}  // namespace

Result<TensorType> rule_rescale(const RuleContext& node) {
  enum : size_t { kInput, kMultiplier, kShift, kInputZp, kOutputZp };
  const bool scale32 = node.attrs().flag(Attr::kScale32);
  const bool input_unsigned = node.attrs().flag(Attr::kInputUnsigned);
  const bool output_unsigned = node.attrs().flag(Attr::kOutputUnsigned);
  const bool per_channel = node.attrs().flag(Attr::kPerChannel);
  const DType from = node.dtype(kInput), to = node.dtype(kOutputZp);
  SHALE_TRY_VOID(node.expect_dtype(kOutputZp, kI8 | kI16 | kI32));

  if (scale32 && from == DType::kInt48)
    return node.bad("{} needs scale32 = 0", node.describe(kInput));
  if (!scale32 && node.attrs().get(Attr::kRoundingMode) == kDoubleRound)
    return node.bad("rounding_mode double needs scale32 = 1");
  if (input_unsigned && output_unsigned)
    return node.bad("input_unsigned and output_unsigned are both set, expected at most one");
  if ((input_unsigned || output_unsigned) &&
      (!contains(kI8 | kI16, from) || !contains(kI8 | kI16, to)))
    return node.bad("rescales {} to {} with an unsigned side, expected i8 and i16 only",
                    dtype_info(from).name, dtype_info(to).name);
  if (per_channel && node.shape(kInput).empty())
    return node.bad("per_channel is set, but {} has rank 0", node.describe(kInput));

  const int64_t channels = per_channel ? node.shape(kInput).back() : 1;
  const DType scale_dtype = scale32 ? DType::kInt32 : DType::kInt16;
  SHALE_TRY_VOID(node.expect_type(kMultiplier, {scale_dtype, {channels}}));
  SHALE_TRY_VOID(node.expect_elements(kMultiplier, 0, dtype_range(scale_dtype).max));
  SHALE_TRY_VOID(node.expect_type(kShift, {DType::kInt8, {channels}}));
  SHALE_TRY_VOID(node.expect_elements(kShift, 2, 62));
  SHALE_TRY_VOID(expect_rescale_zero_point(node, kInputZp, from, input_unsigned));
  SHALE_TRY_VOID(expect_rescale_zero_point(node, kOutputZp, to, output_unsigned));
  return TensorType{to, node.shape(kInput)};
}

}  // namespace shale
