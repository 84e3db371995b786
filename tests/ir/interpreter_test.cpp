#include "ir/reference/interpreter.h"

#include <gtest/gtest.h>

#include <numeric>

#include "ir/reference/arith.h"
#include "ir/verify/verify.h"
#include "tests/ir/node_case.h"

namespace shale {
namespace {

constexpr DType kBool = DType::kBool, kI4 = DType::kInt4, kI8 = DType::kInt8, kI16 = DType::kInt16,
                kI32 = DType::kInt32, kI48 = DType::kInt48;
constexpr int64_t kMin32 = INT32_MIN, kMax32 = INT32_MAX;
const Operand kZero8 = constant(kI8, {0}), kZero16 = constant(kI16, {0}),
              kZero32 = constant(kI32, {0});

TEST(Arith, AppliesScale32) {
  struct Row {
    int64_t value, multiplier, shift;
    bool double_round;
    std::optional<int64_t> result;
  };
  constexpr auto none = std::nullopt;
  const Row rows[] = {
      {3, int64_t{1} << 30, 31, false, 2},  // 1.5: ties toward plus infinity
      {-3, int64_t{1} << 30, 31, false, -1},
      {3, int64_t{1} << 30, 31, true, 2},  // both modes agree up to shift 31
      {-3, int64_t{1} << 30, 31, true, -1},
      {6, int64_t{1} << 30, 32, true, 2},  // 1.5 and a bit
      {-6, int64_t{1} << 30, 32, true, -2},
      {-6, int64_t{1} << 30, 32, false, -1},
      {1, 1, 2, false, 0},  // shift 2 takes -2..1
      {-2, 2, 2, false, -1},
      {2, 1, 2, false, none},
      {-3, 1, 2, false, none},
      {1, 1, 1, false, none},
      {1, 1, 63, false, none},
      {1, -1, 20, false, none},
      {0, 0, 62, true, 0},
      {kMax32, kMax32, 62, false, 1},
      {kMin32, kMax32, 62, true, -1},
      {kMin32, kMax32, 32, false, -1073741823},
      {kMax32, 1, 32, false, 0},
      {kMax32, 1, 31, false, none},  // value is 2^30 at most for shift 31
      {kMax32 + 1, 1, 40, false, none},
      {(int64_t{1} << 30) - 1, kMax32, 31, false, (int64_t{1} << 30) - 1},
      {100, kMax32, 8, false, 838860800},
      {127, kMax32, 8, false, 1065353216},
      {128, kMax32, 8, false, none},
      {511, kMax32, 10, false, 1071644672},
  };
  for (const Row& row : rows)
    EXPECT_EQ(apply_scale_32(row.value, row.multiplier, row.shift, row.double_round), row.result)
        << row.value << " * " << row.multiplier << " >> " << row.shift << " " << row.double_round;
}

TEST(Arith, AppliesEveryShiftAtTheEndsOfMultiplierAndValue) {
  // Scales from 2^-32 to almost 2^29, against whole numbers that hold every product.
  using Wide = __int128;
  for (int64_t shift = 2; shift <= 62; ++shift)
    for (const int64_t multiplier : {int64_t{1} << 30, kMax32})
      for (const bool double_round : {false, true}) {
        const int64_t most = shift < 32 ? (int64_t{1} << (shift - 1)) - 1 : kMax32;
        for (const int64_t value : {-most - 1, -most, int64_t{-1}, int64_t{0}, int64_t{1}, most}) {
          const int64_t twice = double_round && shift > 31 ? int64_t{1} << 30 : 0;
          const Wide sum =
              Wide{value} * multiplier + (Wide{1} << (shift - 1)) + (value >= 0 ? twice : -twice);
          const auto expected = static_cast<int64_t>(sum >> shift);
          EXPECT_EQ(
              apply_scale_32(value, multiplier, shift, double_round),
              expected >= kMin32 && expected <= kMax32 ? std::optional(expected) : std::nullopt)
              << value << " * " << multiplier << " >> " << shift << " " << double_round;
        }
        for (const int64_t value : {-most - 2, most + 1}) {
          EXPECT_EQ(apply_scale_32(value, multiplier, shift, double_round), std::nullopt);
        }
      }
}

TEST(Arith, AppliesScale16WithoutBoundOnTheValue) {
  constexpr int64_t max48 = (int64_t{1} << 47) - 1;
  EXPECT_EQ(apply_scale_16(1000, 1, 2), 250);
  EXPECT_EQ(apply_scale_16(-2, 1, 2), 0);  // -0.5 goes up
  EXPECT_EQ(apply_scale_16(max48, 32767, 62), 1);
  EXPECT_EQ(apply_scale_16(-max48 - 1, 32767, 30), std::nullopt);
  EXPECT_EQ(apply_scale_16(max48, 32767, 32), 1073709056);
  EXPECT_EQ(apply_scale_16(1, -1, 20), std::nullopt);
  EXPECT_EQ(apply_scale_16(1, 1, 1), std::nullopt);
  EXPECT_EQ(apply_scale_16(1, 1, 63), std::nullopt);
}

TEST(Arith, GivesReciprocals) {
  const auto pair = [](int64_t n) {
    const Scale scale = reciprocal_scale(n);
    return std::pair(scale.multiplier, scale.shift);
  };
  EXPECT_EQ(pair(1), std::pair(int64_t{1073741825}, int64_t{30}));
  EXPECT_EQ(pair(2), std::pair(int64_t{1073741825}, int64_t{31}));
  EXPECT_EQ(pair(3), std::pair(int64_t{1431655766}, int64_t{32}));
  EXPECT_EQ(pair(4), std::pair(int64_t{1073741825}, int64_t{32}));
  EXPECT_EQ(pair(9), std::pair(int64_t{1908874355}, int64_t{34}));
  for (const int64_t n : {1, 5, 64, 1024 * 1024})
    for (const int64_t value : {-128, -1, 0, 1, 127})
      EXPECT_EQ(apply_scale_32(value * n, reciprocal_scale(n).multiplier, reciprocal_scale(n).shift,
                               false),
                value);
}

/// A node with data in all operands, and the elements of its result or a part of its error.
struct EvalCase {
  NodeCase node;
  Ints expected;
  std::string error;
};

Result<Tensor> evaluate(const NodeCase& node) {
  std::vector<Tensor> tensors;
  for (const Operand& operand : node.operands)
    tensors.push_back(Tensor::from_ints(operand.type, *operand.data));
  std::vector<const Tensor*> operands;
  for (const Tensor& tensor : tensors) operands.push_back(&tensor);
  return evaluate_node(node.graph(), {0}, operands);
}

void expect(const std::vector<EvalCase>& cases) {
  for (const auto& [node, expected, error] : cases) {
    const std::string label = fmt::format("{} {}", op_info(node.op).name, node.name);
    const auto result = evaluate(node);
    if (!error.empty()) {
      ASSERT_FALSE(result) << label;
      EXPECT_NE(result.error().text().find(error), std::string::npos)
          << label << " should say: " << error << "\nbut says: " << result.error().text();
      continue;
    }
    ASSERT_TRUE(result) << label << ": " << result.error().text();
    const auto inferred = infer_result(node.graph(), {0});
    ASSERT_TRUE(inferred) << label << ": " << inferred.error().text();
    EXPECT_EQ(type_text(*inferred), type_text(result->type)) << label;
    EXPECT_EQ(result->ints(), expected) << label;
  }
}

EvalCase unary(Op op, DType from, DType to, Ints in, Ints expected, Attrs attrs = {},
               std::vector<Operand> more = {}) {
  const Shape shape{static_cast<int64_t>(in.size())};
  std::vector<Operand> operands{constant(from, std::move(in))};
  operands.insert(operands.end(), more.begin(), more.end());
  return {{"", op, std::move(attrs), std::move(operands), {to, shape}}, std::move(expected), ""};
}

EvalCase binary(Op op, DType from, DType to, Ints a, Ints b, Ints expected, Attrs attrs = {}) {
  return unary(op, from, to, std::move(a), std::move(expected), std::move(attrs),
               {constant(from, std::move(b))});
}

EvalCase mul(DType from, Ints a, Ints b, int64_t shift, Ints expected) {
  return unary(Op::kMul, from, kI32, std::move(a), std::move(expected), {},
               {constant(from, std::move(b)), constant(kI8, {shift})});
}

EvalCase fails(EvalCase row, std::string error) {
  row.error = std::move(error);
  return row;
}

TEST(Interpreter, ComputesElementwiseBinaryOperators) {
  const Attrs round = Attrs().set(Attr::kRound, 1), floor = Attrs().set(Attr::kRound, 0);
  expect({
      binary(Op::kAdd, kI32, kI32, {kMax32, kMin32}, {0, kMax32}, {kMax32, -1}),
      fails(binary(Op::kAdd, kI32, kI32, {0, kMax32}, {0, 1}, {}), "element 1 [1]: no result"),
      fails(binary(Op::kAdd, kI32, kI32, {kMin32}, {-1}, {}), "no result for -2147483648 and -1"),
      binary(Op::kSub, kI32, kI32, {-1, 5}, {kMax32, 7}, {kMin32, -2}),
      fails(binary(Op::kSub, kI32, kI32, {0}, {kMin32}, {}), "element 0 [0]"),
      binary(Op::kMaximum, kI32, kI32, {1, -5}, {2, kMin32}, {2, -5}, nan_attrs()),
      binary(Op::kMinimum, kI32, kI32, {1, -5}, {2, kMin32}, {1, kMin32}, nan_attrs()),
      binary(Op::kArithmeticRightShift, kI8, kI8, {-128, -1, 3, 3, 127}, {7, 1, 1, 0, 7},
             {-1, 0, 2, 3, 1}, round),
      binary(Op::kArithmeticRightShift, kI8, kI8, {-128, -1, 3}, {7, 1, 1}, {-1, -1, 1}, floor),
      binary(Op::kArithmeticRightShift, kI32, kI32, {kMin32, kMax32}, {31, 31}, {-1, 1}, round),
      fails(binary(Op::kArithmeticRightShift, kI8, kI8, {1}, {8}, {}, floor), "no result"),
      fails(binary(Op::kArithmeticRightShift, kI32, kI32, {1}, {-1}, {}, floor), "no result"),
      binary(Op::kLogicalLeftShift, kI8, kI8, {1, 3, -1}, {7, 7, 4}, {-128, -128, -16}),
      binary(Op::kLogicalLeftShift, kI32, kI32, {kMin32, -1}, {31, 31}, {0, kMin32}),
      fails(binary(Op::kLogicalLeftShift, kI16, kI16, {1}, {16}, {}), "no result"),
      binary(Op::kLogicalRightShift, kI8, kI8, {-128, -1}, {7, 0}, {1, -1}),
      binary(Op::kLogicalRightShift, kI32, kI32, {-1, kMin32}, {1, 31}, {kMax32, 1}),
      fails(binary(Op::kLogicalRightShift, kI32, kI32, {1}, {32}, {}), "no result"),
      binary(Op::kBitwiseAnd, kI16, kI16, {-1, 12}, {-32768, 10}, {-32768, 8}),
      binary(Op::kBitwiseOr, kI8, kI8, {-128, 12}, {127, 10}, {-1, 14}),
      binary(Op::kBitwiseXor, kI32, kI32, {-1, 12}, {kMax32, 10}, {kMin32, 6}),
      binary(Op::kIntDiv, kI32, kI32, {7, -7, kMin32}, {-2, 2, 1}, {-3, -3, kMin32}),
      fails(binary(Op::kIntDiv, kI32, kI32, {1, 1}, {1, 0}, {}), "element 1 [1]"),
      fails(binary(Op::kIntDiv, kI32, kI32, {kMin32}, {-1}, {}), "no result"),
      binary(Op::kLogicalAnd, kBool, kBool, {0, 0, 1, 1}, {0, 1, 0, 1}, {0, 0, 0, 1}),
      binary(Op::kLogicalOr, kBool, kBool, {0, 0, 1, 1}, {0, 1, 0, 1}, {0, 1, 1, 1}),
      binary(Op::kLogicalXor, kBool, kBool, {0, 0, 1, 1}, {0, 1, 0, 1}, {0, 1, 1, 0}),
      binary(Op::kEqual, kI32, kBool, {1, kMin32}, {2, kMin32}, {0, 1}),
      binary(Op::kGreater, kI32, kBool, {1, 2, -1}, {1, 1, 1}, {0, 1, 0}),
      binary(Op::kGreaterEqual, kI32, kBool, {1, 2, -1}, {1, 1, 1}, {1, 1, 0}),
      mul(kI8, {-128, 127}, {-128, -1}, 0, {16384, -127}),
      mul(kI16, {-32768}, {-32768}, 0, {1 << 30}),
      mul(kI32, {65536, 65537}, {65536, 65537}, 0, {0, 131073}),
      mul(kI32, {3, -3, kMin32}, {1, 1, kMin32}, 63, {0, 0, 1}),
      mul(kI32, {3, -3}, {1, 1}, 1, {2, -1}),
      mul(kI32, {kMax32}, {kMax32}, 31, {kMax32 - 1}),
      fails(mul(kI32, {0, kMin32}, {0, kMin32}, 31, {}), "element 1 [1]: no result"),
  });
}

TEST(Interpreter, BroadcastsElementwiseOperands) {
  expect({
      {{"",
        Op::kSub,
        {},
        {constant(kI32, {2, 1, 2}, {1, 2, 3, 4}), constant(kI32, {1, 3, 1}, {10, 20, 30})},
        {kI32, {2, 3, 2}}},
       {-9, -8, -19, -18, -29, -28, -7, -6, -17, -16, -27, -26},
       ""},
      {{"", Op::kAdd, {}, {constant(kI32, {}, {2}), constant(kI32, {}, {3})}, {kI32, {}}}, {5}, ""},
      {{"",
        Op::kSelect,
        {},
        {constant(kBool, {2, 1}, {1, 0}), constant(kI8, {1, 3}, {1, 2, 3}),
         constant(kI8, {1, 1}, {-9})},
        {kI8, {2, 3}}},
       {1, 2, 3, -9, -9, -9},
       ""},
      {{"in three dimensions",
        Op::kAdd,
        {},
        {constant(kI32, {2, 1, 1}, {0, kMax32}), constant(kI32, {1, 2, 2}, {0, 0, 0, 1})},
        {kI32, {2, 2, 2}}},
       {},
       "element 7 [1,1,1]"},
  });
}

TEST(Interpreter, ComputesElementwiseUnaryOperators) {
  Ints identity_table(256);
  std::iota(identity_table.begin(), identity_table.end(), -128);
  Ints ramp(513, 0);
  for (int64_t i = 0; i < 513; ++i) ramp[static_cast<size_t>(i)] = i * 10 - 2560;
  Ints cliff(513, 0);
  cliff[256] = -32768;
  cliff[257] = 32767;
  const auto negate = [](DType type, Ints in, int64_t in_zp, int64_t out_zp, Ints expected) {
    return unary(Op::kNegate, type, type, std::move(in), std::move(expected), {},
                 {constant(type, {in_zp}), constant(type, {out_zp})});
  };
  expect({
      unary(Op::kAbs, kI32, kI32, {-5, kMax32, kMin32 + 1}, {5, kMax32, kMax32}),
      fails(unary(Op::kAbs, kI32, kI32, {1, kMin32}, {}), "element 1 [1]: no result"),
      unary(Op::kBitwiseNot, kI8, kI8, {0, -1, 127}, {-1, 0, -128}),
      unary(Op::kClz, kI32, kI32, {0, 1, -1, kMax32}, {32, 31, 0, 1}),
      unary(Op::kLogicalNot, kBool, kBool, {0, 1}, {1, 0}),
      unary(Op::kIdentity, kI48, kI48, {1 - (int64_t{1} << 47)}, {1 - (int64_t{1} << 47)}),
      unary(Op::kIdentity, kI4, kI4, {-7, 7}, {-7, 7}),
      negate(kI8, {-128, 127, 0}, 0, 0, {127, -127, 0}),
      negate(kI8, {-128, 127, 0}, -128, 127, {127, -128, -1}),
      negate(kI8, {-128, 127, 0}, 127, -128, {127, -128, -1}),
      negate(kI16, {-32768, 5}, 0, 0, {32767, -5}),
      negate(kI32, {kMax32}, 0, 0, {-kMax32}),
      fails(negate(kI32, {kMin32}, 0, 0, {}), "no result"),
      unary(Op::kClamp, kI8, kI8, {-128, 0, 127}, {-5, 0, 6}, clamp_attrs(-5, 6)),
      unary(Op::kTable, kI8, kI8, {-128, -1, 127}, {-128, -1, 127}, {},
            {constant(kI8, identity_table)}),
      unary(Op::kTable, kI16, kI32, {-32768, 0, 1, 127, 128, 32767},
            {-2560 * 128, 0, 10, 1270, 1280, 2550 * 128 + 1270}, {}, {constant(kI16, ramp)}),
      fails(unary(Op::kTable, kI16, kI32, {-1000, 0}, {}, {}, {constant(kI16, cliff)}),
            "element 1 [1]"),
      unary(Op::kCast, kBool, kI32, {0, 1}, {0, 1}),
      unary(Op::kCast, kI16, kBool, {0, -256}, {0, 1}),
      unary(Op::kCast, kI8, kI32, {-128, 127}, {-128, 127}),
      unary(Op::kCast, kI32, kI8, {128, -129, 511}, {-128, 127, -1}),
      unary(Op::kCast, kI32, kI16, {65535, kMin32}, {-1, 0}),
  });
}

EvalCase rescale(RescaleAttrs attrs, DType from, DType to, Ints in, Ints multiplier, Ints shift,
                 int64_t in_zp, int64_t out_zp, Ints expected) {
  return unary(Op::kRescale, from, to, std::move(in), std::move(expected), attrs,
               {constant(attrs.scale32 ? kI32 : kI16, std::move(multiplier)),
                constant(kI8, std::move(shift)), constant(from, {in_zp}), constant(to, {out_zp})});
}

TEST(Interpreter, Rescales) {
  constexpr int64_t kOne = int64_t{1} << 30;  // with shift 30: times 1
  const RescaleAttrs plain;
  const RescaleAttrs narrow{.scale32 = false};
  expect({
      rescale(plain, kI8, kI8, {-128, 0, 127}, {kOne}, {30}, 0, 0, {-128, 0, 127}),
      rescale(plain, kI8, kI8, {-128, 0, 127}, {kOne}, {30}, -128, 127, {127, 127, 127}),
      rescale(plain, kI8, kI8, {-128, 0, 127}, {kOne}, {30}, 127, -128, {-128, -128, -128}),
      rescale(plain, kI32, kI8, {1000, -1000, 5}, {kOne}, {31}, 0, 3, {127, -128, 6}),
      rescale(plain, kI32, kI32, {kMax32, kMin32}, {kMax32}, {62}, 0, 0, {1, -1}),
      rescale(plain, kI8, kI32, {1, -2}, {3}, {2}, 0, 0, {1, -1}),
      fails(rescale(plain, kI8, kI32, {1, 2}, {3}, {2}, 0, 0, {}),
            "element 1 [1]: no result for 2"),
      fails(rescale(plain, kI32, kI32, {0, 1 << 21}, {kMax32}, {22}, 0, 0, {}), "element 1"),
      fails(rescale(plain, kI8, kI32, {127}, {kMax32}, {7}, -128, 0, {}), "no result for 255"),
      rescale({.rounding_mode = kDoubleRound}, kI32, kI32, {6, -6}, {kOne}, {32}, 0, 0, {2, -2}),
      rescale({.rounding_mode = kInexactRound}, kI32, kI32, {6, -6}, {kOne}, {32}, 0, 0, {2, -1}),
      rescale({.per_channel = true}, kI32, kI16, {8, 8, 1}, {kOne, kOne, 0}, {30, 32, 2}, 0, 0,
              {8, 2, 0}),
      rescale(narrow, kI16, kI8, {1000, -6}, {1 << 14}, {16}, 0, 0, {127, -1}),
      rescale(narrow, kI48, kI32, {int64_t{1} << 45}, {1 << 14}, {30}, 0, 0, {1 << 29}),
      fails(rescale(narrow, kI48, kI32, {int64_t{1} << 46}, {1 << 14}, {29}, 0, 0, {}),
            "no result"),
      rescale({.input_unsigned = true}, kI8, kI8, {-56, 0, -1}, {kOne}, {30}, -128, 0,
              {72, -128, 127}),
      rescale({.output_unsigned = true}, kI8, kI8, {-128, 0, 127}, {kOne}, {30}, 0, -128,
              {0, -128, -1}),
      rescale({.output_unsigned = true}, kI8, kI16, {-128, 127}, {kOne}, {30}, 0, -32768,
              {32640, -32641}),
      rescale({.input_unsigned = true}, kI16, kI16, {0, -32768, -1}, {kOne}, {30}, -32768, 0,
              {-32768, 0, 32767}),
  });
}

TEST(Interpreter, ComputesConvolutions) {
  const Ints pixels{1, 2, 3, 4, 5, 6, 7, 8, 9};
  const Operand image = constant(kI8, {1, 3, 3, 1}, pixels);
  const auto conv = [&](std::string name, Attrs attrs, Operand weight, Operand bias, int64_t in_zp,
                        int64_t weight_zp, Shape result, Ints expected) {
    const DType weight_type = weight.type.dtype;
    return EvalCase{{std::move(name),
                     Op::kConv2d,
                     std::move(attrs),
                     {image, std::move(weight), std::move(bias), constant(kI8, {in_zp}),
                      constant(weight_type, {weight_zp})},
                     {kI32, std::move(result)}},
                    std::move(expected),
                    ""};
  };
  const Attrs valid = conv_attrs({0, 0, 0, 0}, {1, 1}, {1, 1});
  const Operand corner = constant(kI8, {1, 2, 2, 1}, {1, 10, 100, -1});
  const Operand corner4 = constant(kI4, {1, 2, 2, 1}, {1, 7, -7, -1});
  expect({
      conv("no padding", valid, corner, kZero32, 0, 0, {1, 2, 2, 1}, {416, 526, 746, 856}),
      conv("bias", valid, corner, constant(kI32, {-416}), 0, 0, {1, 2, 2, 1}, {0, 110, 330, 440}),
      conv("int4 weights", valid, corner4, kZero32, 0, 0, {1, 2, 2, 1}, {-18, -18, -18, -18}),
      // Padding reads the zero point: every tap outside contributes 0 whatever the weights' is.
      conv("padding", conv_attrs({1, 0, 1, 0}, {2, 2}, {1, 1}), corner, kZero32, 1, 1, {1, 2, 2, 1},
           {0, 1 * 99 - 2 * 2, 3 * 9 - 6 * 2, 5 * 9 + 7 * 99 - 8 * 2}),
      conv("dilation", conv_attrs({0, 0, 0, 0}, {1, 1}, {2, 2}), corner, kZero32, 0, 0,
           {1, 1, 1, 1}, {1 + 30 + 700 - 9}),
      conv("two channels out", conv_attrs({0, 0, 0, 0}, {2, 2}, {1, 1}),
           constant(kI8, {2, 1, 1, 1}, {1, -1}), constant(kI32, {100, 200}), 0, 0, {1, 2, 2, 2},
           {101, 199, 103, 197, 107, 193, 109, 191}),
      {{"",
        Op::kDepthwiseConv2d,
        valid,
        {constant(kI8, {1, 2, 1, 2}, {1, 2, 3, 4}),
         constant(kI8, {2, 1, 2, 2}, {1, 10, 100, -1, 2, 20, 3, -2}), constant(kI32, {0, 0, 0, 1}),
         kZero8, kZero8},
        {kI32, {1, 1, 1, 4}}},
       {7, 70, 212, -9},
       ""},
      {{"",
        Op::kConv3d,
        conv_attrs({1, 0, 0, 0, 0, 0}, {1, 1, 1}, {1, 1, 1}),
        {constant(kI8, {1, 2, 1, 1, 2}, {1, 2, 3, 4}), constant(kI8, {1, 2, 1, 1, 2}, {1, 2, 3, 4}),
         kZero32, kZero8, kZero8},
        {kI32, {1, 2, 1, 1, 1}}},
       {11, 5 + 25},
       ""},
      {{"",
        Op::kTransposeConv2d,
        transpose_conv_attrs({0, 0, -1, 1}, {1, 2}),
        {constant(kI8, {1, 1, 2, 1}, {1, 2}), constant(kI8, {1, 1, 3, 1}, {10, 20, 30}),
         constant(kI32, {5}), kZero8, kZero8},
        {kI32, {1, 1, 5, 1}}},
       {25, 55, 45, 65, 5},
       ""},
      {{"int16",
        Op::kConv2d,
        conv_attrs({0, 0, 0, 0}, {1, 1}, {1, 1}, kI48),
        {constant(kI16, {1, 1, 1, 2}, {-32768, 32767}), constant(kI8, {1, 1, 1, 2}, {-128, 127}),
         constant(kI48, {1}), kZero16, constant(kI8, {-128})},
        {kI48, {1, 1, 1, 1}}},
       {32767 * 255 + 1},
       ""},
  });
}

/// One output of `count` input channels, all at the largest difference from their zero points.
EvalCase largest_sum(int64_t count, int64_t bias, Ints expected) {
  const size_t size = static_cast<size_t>(count);
  return {{fmt::format("{} products", count),
           Op::kConv2d,
           conv_attrs({0, 0, 0, 0}, {1, 1}, {1, 1}),
           {constant(kI8, {1, 1, 1, count}, Ints(size, 127)),
            constant(kI8, {1, 1, 1, count}, Ints(size, 127)), constant(kI32, {bias}),
            constant(kI8, {-128}), constant(kI8, {-128})},
           {kI32, {1, 1, 1, 1}}},
          std::move(expected),
          ""};
}

TEST(Interpreter, SumsConvolutionsExactlyUpToTheLimitOfInt32) {
  constexpr int64_t kProduct = 255 * 255;  // 33025 of them fit int32, 33026 do not
  expect({
      largest_sum(33025, 0, {33025 * kProduct}),
      fails(largest_sum(33026, 0, {}),
            "element 0 [0,0,0,0]: the result 2147515650 is outside INT32"),
      largest_sum(33026, -(33026 * kProduct - kMax32), {kMax32}),
      largest_sum(66000, kMin32, {66000 * kProduct + kMin32}),
  });
}

TEST(Interpreter, ChecksInt48Accumulators) {
  const int64_t max48 = (int64_t{1} << 47) - 1;
  const auto conv = [](int64_t in, int64_t weight, int64_t bias, Ints expected) {
    return EvalCase{{"",
                     Op::kConv2d,
                     conv_attrs({0, 0, 0, 0}, {1, 1}, {1, 1}, kI48),
                     {constant(kI16, {1, 1, 1, 1}, {in}), constant(kI8, {1, 1, 1, 1}, {weight}),
                      constant(kI48, {bias}), kZero16, kZero8},
                     {kI48, {1, 1, 1, 1}}},
                    std::move(expected),
                    ""};
  };
  expect({conv(1, 1, max48 - 1, {max48}), fails(conv(1, 1, max48, {}), "is outside INT48"),
          conv(-1, 1, -max48, {-max48 - 1}),
          fails(conv(-1, 1, -max48 - 1, {}), "is outside INT48")});
}

TEST(Interpreter, ComputesMatmul) {
  const size_t many = 33026;
  const Operand long_row = constant(kI8, {1, 1, 33026}, Ints(many, 127));
  const Operand long_column = constant(kI8, {1, 33026, 1}, Ints(many, 127));
  const Operand low = constant(kI8, {-128});
  expect({
      {{"",
        Op::kMatmul,
        {},
        {constant(kI8, {2, 1, 2}, {1, 2, 3, 4}),
         constant(kI8, {2, 2, 3}, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}), constant(kI8, {1}),
         constant(kI8, {-1})},
        {kI32, {2, 1, 3}}},
       {5, 6, 7, 2 * 8 + 3 * 11, 2 * 9 + 3 * 12, 2 * 10 + 3 * 13},
       ""},
      {{"int16",
        Op::kMatmul,
        {},
        {constant(kI16, {1, 1, 3}, {-32768, -32768, -32768}),
         constant(kI16, {1, 3, 1}, {-32768, -32768, -32768}), kZero16, kZero16},
        {kI48, {1, 1, 1}}},
       {3 * (int64_t{1} << 30)},
       ""},
      fails({{"", Op::kMatmul, {}, {long_row, long_column, low, low}, {kI32, {1, 1, 1}}}, {}, ""},
            "the result 2147515650 is outside INT32"),
  });
}

TEST(Interpreter, ComputesPools) {
  const Operand image = constant(kI8, {1, 2, 3, 1}, {1, 2, 3, -4, -5, 127});
  const auto average = [&](Ints kernel, Ints pad, int64_t in_zp, int64_t out_zp, Shape result,
                           Ints expected) {
    return EvalCase{{"",
                     Op::kAvgPool2d,
                     avg_pool_attrs(std::move(kernel), {1, 1}, std::move(pad)),
                     {image, constant(kI8, {in_zp}), constant(kI8, {out_zp})},
                     {kI8, std::move(result)}},
                    std::move(expected),
                    ""};
  };
  expect({
      average({1, 1}, {0, 0, 0, 0}, -128, 127, {1, 2, 3, 1}, {127, 127, 127, 127, 127, 127}),
      average({1, 1}, {0, 0, 0, 0}, 127, -128, {1, 2, 3, 1}, {-128, -128, -128, -128, -128, -128}),
      average({2, 3}, {0, 0, 0, 0}, 0, 0, {1, 1, 1, 1}, {21}),  // 124 / 6 = 20.67
      // A window counts what lies inside. -3 / 2 is -2: the multiplier is a little above a half.
      average({2, 2}, {1, 0, 1, 0}, 0, 10, {1, 2, 3, 1}, {11, 12, 13, 8, 8, 42}),
      {{"",
        Op::kMaxPool2d,
        max_pool_attrs({2, 2}, {1, 1}, {1, 0, 1, 0}),
        {image},
        {kI8, {1, 2, 3, 1}}},
       {1, 2, 3, 1, 2, 127},
       ""},
      {{"",
        Op::kMaxPool2d,
        max_pool_attrs({2, 1}, {1, 1}, {1, 1, 0, 0}),
        {constant(kI16, {1, 1, 1, 1}, {-32768})},
        {kI16, {1, 2, 1, 1}}},
       {-32768, -32768},
       ""},
  });
}

TEST(Interpreter, Resizes) {
  const auto resize = [](int64_t mode, DType from, DType to, Shape in, Ints data, Ints scale,
                         Ints offset, Ints border, Shape out, Ints expected) {
    return EvalCase{{"",
                     Op::kResize,
                     Attrs().set(Attr::kMode, mode),
                     {constant(from, std::move(in), std::move(data)), dims(std::move(scale)),
                      dims(std::move(offset)), dims(std::move(border))},
                     {to, std::move(out)}},
                    std::move(expected),
                    ""};
  };
  expect({
      resize(kNearest, kI8, kI8, {1, 1, 2, 1}, {1, 2}, {1, 1, 2, 1}, {0, 0}, {0, 1}, {1, 1, 4, 1},
             {1, 2, 2, 2}),  // ties take the higher index
      resize(kNearest, kI8, kI8, {1, 1, 2, 1}, {1, 2}, {1, 1, 4, 2}, {0, -1}, {0, 1}, {1, 1, 4, 1},
             {1, 1, 2, 2}),
      resize(kBilinear, kI8, kI32, {1, 2, 1, 1}, {-128, 127}, {4, 2, 1, 1}, {-1, 0}, {1, 0},
             {1, 4, 1, 1}, {-512, -257, 253, 508}),
      resize(kBilinear, kI16, kI48, {1, 1, 1, 1}, {-32768}, {2048, 8, 2048, 8}, {0, 0}, {8, 0},
             {1, 2, 1, 1}, {-137438953472, -137438953472}),
      resize(kBilinear, kI8, kI32, {1, 2, 2, 1}, {0, 2, 4, 8}, {2, 1, 2, 1}, {0, 0}, {0, 0},
             {1, 3, 3, 1}, {0, 4, 8, 8, 14, 20, 16, 24, 32}),
      resize(kNearest, kI8, kI8, {1, 1, 4, 1}, {1, 2, 3, 4}, {1, 1, 1, 3}, {0, 0}, {0, 0},
             {1, 1, 2, 1}, {1, 4}),
  });
}

TEST(Interpreter, Reduces) {
  const auto reduce = [](Op op, DType type, Ints data, int64_t axis, Shape result, Ints expected) {
    Attrs attrs = axis_attrs(axis);
    if (op == Op::kReduceMax || op == Op::kReduceMin) attrs = nan_attrs(attrs);
    return EvalCase{
        {"", op, attrs, {constant(type, {2, 3}, std::move(data))}, {type, std::move(result)}},
        std::move(expected),
        ""};
  };
  const auto argmax = [](Ints data, int64_t axis, Shape result, Ints expected) {
    return EvalCase{{"",
                     Op::kArgmax,
                     nan_attrs(axis_attrs(axis)),
                     {constant(kI8, {2, 3}, std::move(data))},
                     {kI32, std::move(result)}},
                    std::move(expected),
                    ""};
  };
  expect({
      reduce(Op::kReduceSum, kI32, {1, 2, 3, 4, 5, 6}, 0, {1, 3}, {5, 7, 9}),
      reduce(Op::kReduceSum, kI32, {kMax32, 1, -1, 4, 5, 6}, 1, {2, 1}, {kMax32, 15}),
      fails(reduce(Op::kReduceSum, kI32, {0, 0, 0, kMin32, 0, -1}, 1, {2, 1}, {}),
            "element 1 [1,0]: the result -2147483649 is outside INT32"),
      reduce(Op::kReduceMax, kI8, {-128, -128, -128, 4, 127, 6}, 1, {2, 1}, {-128, 127}),
      reduce(Op::kReduceMin, kI16, {1, 2, 3, 4, -32768, 6}, 1, {2, 1}, {1, -32768}),
      reduce(Op::kReduceAll, kBool, {1, 1, 1, 1, 0, 1}, 1, {2, 1}, {1, 0}),
      reduce(Op::kReduceAny, kBool, {0, 0, 0, 1, 0, 0}, 1, {2, 1}, {0, 1}),
      argmax({-128, -128, -128, 4, 127, 127}, 1, {2}, {0, 1}),
      argmax({1, 2, 3, 1, 3, 2}, 0, {3}, {0, 1, 0}),
  });
}

TEST(Interpreter, MovesData) {
  const Operand block = constant(kI16, {2, 3}, {1, 2, 3, 4, 5, 6});
  const Operand cube = constant(kI8, {1, 2, 3}, {1, 2, 3, 4, 5, 6});
  expect({
      {{"",
        Op::kConcat,
        axis_attrs(1),
        {block, constant(kI16, {2, 1}, {7, 8}), block},
        {kI16, {2, 7}}},
       {1, 2, 3, 7, 1, 2, 3, 4, 5, 6, 8, 4, 5, 6},
       ""},
      {{"", Op::kPad, {}, {block, dims({1, 0, 0, 2}), constant(kI16, {-9})}, {kI16, {3, 5}}},
       {-9, -9, -9, -9, -9, 1, 2, 3, -9, -9, 4, 5, 6, -9, -9},
       ""},
      {{"", Op::kReshape, {}, {block, dims({3, 2})}, {kI16, {3, 2}}}, {1, 2, 3, 4, 5, 6}, ""},
      {{"", Op::kReshape, {}, {constant(kI32, {1, 1}, {5}), dims({})}, {kI32, {}}}, {5}, ""},
      {{"", Op::kReverse, axis_attrs(1), {block}, {kI16, {2, 3}}}, {3, 2, 1, 6, 5, 4}, ""},
      {{"", Op::kReverse, axis_attrs(0), {block}, {kI16, {2, 3}}}, {4, 5, 6, 1, 2, 3}, ""},
      {{"", Op::kSlice, {}, {block, dims({0, 1}), dims({2, 2})}, {kI16, {2, 2}}}, {2, 3, 5, 6}, ""},
      {{"", Op::kTile, {}, {block, dims({2, 2})}, {kI16, {4, 6}}},
       {1, 2, 3, 1, 2, 3, 4, 5, 6, 4, 5, 6, 1, 2, 3, 1, 2, 3, 4, 5, 6, 4, 5, 6},
       ""},
      {{"", Op::kTranspose, Attrs().set(Attr::kPerms, Ints{2, 0, 1}), {cube}, {kI8, {3, 1, 2}}},
       {1, 4, 2, 5, 3, 6},
       ""},
      {{"", Op::kGather, {}, {cube, constant(kI32, {1, 3}, {1, 1, 0})}, {kI8, {1, 3, 3}}},
       {4, 5, 6, 4, 5, 6, 1, 2, 3},
       ""},
      {{"", Op::kGather, {}, {cube, constant(kI32, {1, 2}, {0, 2})}, {kI8, {1, 2, 3}}},
       {},
       "the indices have 2 at [0,1], expected 0 to 1"},
      {{"",
        Op::kScatter,
        {},
        {cube, constant(kI32, {1, 1}, {1}), constant(kI8, {1, 1, 3}, {7, 8, 9})},
        {kI8, {1, 2, 3}}},
       {1, 2, 3, 7, 8, 9},
       ""},
      {{"", Op::kScatter, {}, {cube, constant(kI32, {1, 2}, {1, 1}), cube}, {kI8, {1, 2, 3}}},
       {},
       "element 3 [0,1,0]: written by more than one index"},
      {{"", Op::kScatter, {}, {cube, constant(kI32, {1, 2}, {1, -1}), cube}, {kI8, {1, 2, 3}}},
       {},
       "the indices have -1 at [0,1]"},
  });
}

/// x, y: i32[2]; s = x + y, p = x * s (low bits), unused = |x|; outputs p, s, x and a constant.
Graph diamond() {
  Graph graph;
  const TensorType type{kI32, {2}};
  const ValueId x = graph.add_input("x", type), y = graph.add_input("y", type);
  const ValueId shift = graph.add_constant("shift", Tensor::zeros({kI8, {1}}));
  const ValueId s = graph.add_node(Op::kAdd, {}, {x, y}, "s", type);
  const ValueId p = graph.add_node(Op::kMul, {}, {x, s, shift}, "p", type);
  graph.add_node(Op::kAbs, {}, {x}, "unused", type);
  const ValueId twice = graph.add_node(Op::kAdd, {}, {s, s}, "twice", type);
  graph.outputs = {p, s, x, shift, twice, s};
  return graph;
}

TEST(Interpreter, RunsGraphsWithSharedUnusedAndPassedThroughValues) {
  const Graph graph = diamond();
  ASSERT_TRUE(verify(graph)) << verify(graph).error().text();
  const TensorType type{kI32, {2}};
  const std::vector<Tensor> inputs{Tensor::from_ints(type, Ints{2, 3}),
                                   Tensor::from_ints(type, Ints{10, 20})};
  const auto outputs = interpret(graph, inputs);
  ASSERT_TRUE(outputs) << outputs.error().text();
  std::vector<Ints> values;
  for (const Tensor& tensor : *outputs) values.push_back(tensor.ints());
  EXPECT_EQ(values, (std::vector<Ints>{{24, 69}, {12, 23}, {2, 3}, {0}, {24, 46}, {12, 23}}));
}

TEST(Interpreter, ReportsProgressAndStopsWhenAsked) {
  const Graph graph = diamond();
  const std::vector<Tensor> inputs(2, Tensor::zeros({kI32, {2}}));
  std::vector<uint32_t> seen;
  ASSERT_TRUE(interpret(graph, inputs, [&](uint32_t node, uint32_t count) {
    EXPECT_EQ(count, 4u);
    seen.push_back(node);
    return true;
  }));
  EXPECT_EQ(seen, (std::vector<uint32_t>{0, 1, 2, 3}));
  const auto stopped = interpret(graph, inputs, [](uint32_t node, uint32_t) { return node < 1; });
  ASSERT_FALSE(stopped);
  EXPECT_EQ(stopped.error().text(), "node %1 \"p\" (mul): the run was stopped before this node");
}

TEST(Interpreter, NamesTheNodeAndElementOfUnpredictableResults) {
  const std::vector<Tensor> inputs(2, Tensor::from_ints({kI32, {2}}, Ints{0, kMax32}));
  const auto outputs = interpret(diamond(), inputs);
  ASSERT_FALSE(outputs);
  EXPECT_EQ(outputs.error().text(),
            "node %0 \"s\" (add): element 1 [1]: no result for 2147483647 and 2147483647");
}

TEST(Interpreter, RefusesInputsThatAreNotOfTheGraphsTypes) {
  const auto run = [](TensorType type, const Tensor& tensor) {
    Graph graph;
    graph.outputs = {graph.add_input("x", std::move(type))};
    const auto outputs = interpret(graph, std::span(&tensor, 1));
    return outputs ? "accepted" : outputs.error().text();
  };
  EXPECT_EQ(run({kI4, {2}}, Tensor::from_ints({kI4, {2}}, Ints{-7, 7})), "accepted");
  EXPECT_EQ(run({kI4, {2}}, Tensor::from_ints({kI4, {2}}, Ints{-8, 7})),
            "input \"x\": has -8 at [0], INT4 is -7 to 7");
  EXPECT_EQ(run({kBool, {2}}, Tensor::from_ints({kBool, {2}}, Ints{1, 2})),
            "input \"x\": has 2 at [1], BOOL is 0 to 1");
  EXPECT_EQ(run({kI48, {1}}, Tensor::from_ints({kI48, {1}}, Ints{int64_t{1} << 47})),
            "input \"x\": has 140737488355328 at [0], "
            "INT48 is -140737488355328 to 140737488355327");
  EXPECT_EQ(run({kI8, {2}}, Tensor::zeros({kI8, {3}})), "input \"x\": is i8[3], expected i8[2]");
  EXPECT_EQ(run({kI8, {2}}, Tensor{{kI8, {2}}, {1}}), "input \"x\": has 1 bytes, expected 2");
  const auto none = interpret(diamond(), {});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().text(), "graph \"main\": got 0 inputs, expected 2");
}

TEST(Interpreter, ReportsTheFirstErrorHoweverManyThreadsRun) {
  const int64_t size = 1 << 18;
  Ints data(static_cast<size_t>(size), 1);
  data[1000] = data[200000] = kMin32;
  const NodeCase node{"", Op::kAbs, {}, {constant(kI32, {size}, data)}, {kI32, {size}}};
  for (int run = 0; run < 8; ++run) {
    const auto result = evaluate(node);
    ASSERT_FALSE(result);
    EXPECT_NE(result.error().message.find("element 1000 "), std::string::npos)
        << result.error().message;
  }
}

}  // namespace
}  // namespace shale
