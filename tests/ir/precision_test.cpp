// Floating-point types by their definition, and every operator of the interpreter against TOSA's bounds.
#include "ir/reference/precision.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "ir/base/float_format.h"
#include "ir/base/half.h"
#include "ir/binary/tosa.h"
#include "ir/reference/bounds.h"
#include "ir/reference/interpreter.h"
#include "ir/text/text.h"
#include "tests/support/float_cases.h"

namespace shale {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

TEST(FloatFormat, RoundsEveryCodeToItselfAndWhatLiesBetweenToTheNearest) {
  for (const DType dtype : {DType::kFp16, DType::kBf16, DType::kFp8E4M3, DType::kFp8E5M2}) {
    const FloatFormat format = float_format(dtype);
    for (uint32_t code = 0; code < 2 * format.sign(); ++code) {
      const double value = decode_float(format, code);
      const uint32_t magnitude = code & (format.sign() - 1);
      if (std::isnan(value)) {
        EXPECT_GE(magnitude, format.top()) << dtype_info(dtype).name << " " << code;
        EXPECT_TRUE(std::isnan(decode_float(format, encode_float(format, value))));
        continue;
      }
      ASSERT_EQ(encode_float(format, value), code) << dtype_info(dtype).name << " " << value;
      if (magnitude + 1 >= format.top() || code != magnitude) continue;
      const double next = decode_float(format, code + 1), middle = (value + next) / 2;
      ASSERT_EQ(encode_float(format, middle), code + (code & 1)) << "a tie goes to the even code";
      ASSERT_EQ(encode_float(format, std::nextafter(middle, 0)), code);
      ASSERT_EQ(encode_float(format, std::nextafter(middle, next)), code + 1);
    }
  }
}

TEST(FloatFormat, EndsWhereTheSpecificationsSay) {
  const FloatFormat e4m3 = float_format(DType::kFp8E4M3), e5m2 = float_format(DType::kFp8E5M2);
  EXPECT_EQ(e4m3.largest(), 448);
  EXPECT_EQ(e5m2.largest(), 57344);
  EXPECT_EQ(encode_float(e4m3, 464), 0x7eu);  // a tie, to even
  EXPECT_EQ(encode_float(e4m3, 465), 0x7fu);  // no infinity: a NaN
  EXPECT_EQ(encode_float(e4m3, -kInf), 0xffu);
  EXPECT_EQ(encode_float(e5m2, 61440), 0x7cu);  // infinity
  EXPECT_EQ(encode_float(e5m2, 61439), 0x7bu);
  EXPECT_EQ(decode_float(e4m3, 1), 0x1p-9);
  EXPECT_EQ(decode_float(e5m2, 1), 0x1p-16);
  std::mt19937 random(5);
  for (int i = 0; i < 100000; ++i) {
    const float x = std::bit_cast<float>(static_cast<uint32_t>(random()));
    ASSERT_EQ(encode_float(float_format(DType::kFp16), x), float_to_half(x)) << x;
    // A bfloat16 is the upper half of a float32.
    const uint32_t code = encode_float(float_format(DType::kBf16), x);
    const uint32_t bits = std::bit_cast<uint32_t>(x);
    if (std::isnan(x)) continue;
    ASSERT_EQ(code, (bits + 0x7fffu + (bits >> 16 & 1)) >> 16) << x;
  }
}

TEST(Precision, HoldsForTheInterpreterOnEveryOperator) {
  for (const FloatCase& each : float_cases()) {
    const Result<std::vector<Tensor>> found = interpret(each.graph, each.inputs);
    ASSERT_TRUE(found) << each.name << ": " << found.error().text();
    const auto expected = output_precision(each.graph, each.inputs);
    const Result<std::vector<Bounds>> bounds = interpret_bounds(each.graph, each.inputs);
    ASSERT_TRUE(bounds) << each.name;
    for (size_t i = 0; i < found->size(); ++i) {
      const std::string where = each.name + ", " + each.graph.value(each.graph.outputs[i]).name;
      EXPECT_EQ(first_imprecise((*found)[i], expected[i]).value_or(""), "") << where;
      EXPECT_EQ(first_outside((*found)[i], (*bounds)[i]).value_or(""), "") << where;
    }
    const std::vector<uint8_t> file = write_tosa(each.graph);
    const Result<Graph> again = read_tosa(file);
    ASSERT_TRUE(again) << each.name << ": " << again.error().text();
    EXPECT_EQ(print_text(*parse_text(print_text(*again))), print_text(*again)) << each.name;
    EXPECT_EQ(print_text(*read_tosa(write_tosa(*again))), print_text(*again)) << each.name;
    for (size_t i = 0; i < again->outputs.size(); ++i)
      EXPECT_EQ(again->value(again->outputs[i]).name, each.graph.value(each.graph.outputs[i]).name);
  }
}

/// The result of a function at x, in FP32.
float at(const std::string& op, float x) {
  const Graph graph =
      *parse_text("graph g { input %x : f32[1] %y = " + op + " %x : f32[1] return %y }");
  return (*interpret(
      graph, std::vector<Tensor>{Tensor::from_reals({DType::kFp32, {1}}, std::vector{x})}))[0]
      .real(0);
}

TEST(Precision, SpecialValuesAreThoseOfTheTables) {
  struct Row {
    const char* op;
    float minus_infinity, infinity, minus_zero, zero;
  };
  for (const Row& row : {Row{"abs", kInf, kInf, 0, 0},
                         {"ceil", -kInf, kInf, -0.0f, 0},
                         {"cos", kNan, kNan, 1, 1},
                         {"erf", -1, 1, -0.0f, 0},
                         {"exp", 0, kInf, 1, 1},
                         {"floor", -kInf, kInf, -0.0f, 0},
                         {"log", kNan, kInf, -kInf, -kInf},
                         {"reciprocal", -0.0f, 0, -kInf, kInf},
                         {"rsqrt", kNan, 0, -kInf, kInf},
                         {"sigmoid", 0, 1, 0.5f, 0.5f},
                         {"sin", kNan, kNan, -0.0f, 0},
                         {"tanh", -1, 1, -0.0f, 0}}) {
    const auto same = [&](float x, float expected) {
      const float found = at(row.op, x);
      EXPECT_TRUE(std::isnan(expected)
                      ? std::isnan(found)
                      : std::bit_cast<uint32_t>(found) == std::bit_cast<uint32_t>(expected))
          << row.op << "(" << x << ") is " << found << ", expected " << expected;
    };
    same(-kInf, row.minus_infinity);
    same(kInf, row.infinity);
    same(-0.0f, row.minus_zero);
    same(0, row.zero);
    same(kNan, kNan);
  }
}

TEST(Precision, TellsAUnitTooMuch) {
  // RECIPROCAL may be off by one unit in the last place, LOG by five, ADD by half a one.
  const Precision third{1.0 / 3, function_error(Op::kReciprocal, DType::kFp32, 3, 1.0 / 3)};
  const float near = 1.0f / 3, up = std::nextafterf(near, 1);
  EXPECT_TRUE(is_precise(DType::kFp32, near, third));
  EXPECT_TRUE(is_precise(DType::kFp32, std::nextafterf(near, 0), third)) << "0.67 units below";
  EXPECT_FALSE(is_precise(DType::kFp32, up, third)) << "1.33 units above";
  EXPECT_EQ(function_error(Op::kLog, DType::kFp16, 8, 2), 5 * 0x1p-9);
  // Beyond the type lies infinity, in E4M3 a NaN; what is subnormal may be 0, but not in FP8.
  EXPECT_TRUE(is_precise(DType::kFp16, static_cast<double>(kInf), {70000, 0}));
  EXPECT_FALSE(is_precise(DType::kFp16, 65504, {70000, 0}));
  EXPECT_TRUE(is_precise(DType::kFp8E4M3, static_cast<double>(kNan), {500, 0}));
  EXPECT_FALSE(is_precise(DType::kFp8E4M3, static_cast<double>(kNan), {400, 0}));
  EXPECT_TRUE(is_precise(DType::kFp16, 0, {0x1p-15, 0}));
  EXPECT_FALSE(is_precise(DType::kFp8E5M2, 0, {0x1p-15, 0}));
}

TEST(Precision, TheTransformIsThatOfTheSum) {
  // A wave of one period a row has all its power in one column; a delta has it everywhere.
  const Graph graph = *parse_text(
      "graph g { input %x : f32[1,2,4] %r = rfft2d %x {part=real} : f32[1,2,3] "
      "%i = rfft2d %x {part=imag} : f32[1,2,3] return %r, %i }");
  const auto run = [&](std::vector<float> x) {
    return *interpret(graph, std::vector<Tensor>{Tensor::from_reals({DType::kFp32, {1, 2, 4}}, x)});
  };
  EXPECT_EQ(run({0, 1, 0, -1, 0, 1, 0, -1})[1].reals(), (std::vector<float>{0, -4, 0, 0, 0, 0}));
  EXPECT_EQ(run({1, 0, 0, 0, 0, 0, 0, 0})[0].reals(), std::vector<float>(6, 1));
  EXPECT_EQ(run({1, 2, 3, 4, 5, 6, 7, 8})[0].reals(), (std::vector<float>{36, -4, -4, -16, 0, 0}));
}

}  // namespace
}  // namespace shale
