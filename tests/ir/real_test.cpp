// Floats through the IR: conversion, text, files, rules, arithmetic, and the bounds of what devices give.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "ir/base/half.h"
#include "ir/binary/tosa.h"
#include "ir/reference/bounds.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr DType kF16 = DType::kFp16, kF32 = DType::kFp32;

Graph parsed(const std::string& text) {
  Result<Graph> graph = parse_text(text);
  EXPECT_TRUE(graph) << graph.error().text() << "\n" << text;
  return graph ? *std::move(graph) : Graph{};
}

/// "graph g { <lines> }", verified.
Graph legal(const std::string& lines) {
  Graph graph = parsed("graph g {\n" + lines + "\n}");
  const Result<void> verified = verify(graph);
  EXPECT_TRUE(verified) << verified.error().text();
  return graph;
}

/// Why the graph is refused, or "accepted".
std::string refusal(const std::string& lines) {
  const Result<void> verified = verify(parsed("graph g {\n" + lines + "\n}"));
  return verified ? "accepted" : verified.error().message;
}

std::vector<float> run(const Graph& graph, const std::vector<Tensor>& inputs) {
  const Result<std::vector<Tensor>> outputs = interpret(graph, inputs);
  EXPECT_TRUE(outputs) << outputs.error().text();
  if (!outputs) return {};
  const Tensor& output = outputs->front();
  if (is_float(output.type.dtype)) return output.reals();
  std::vector<float> values;
  for (const int64_t value : output.ints()) values.push_back(static_cast<float>(value));
  return values;
}

Tensor reals(DType dtype, Shape shape, std::vector<float> values) {
  return Tensor::from_reals({dtype, std::move(shape)}, values);
}

void expect_same(const std::vector<float>& found, const std::vector<float>& expected) {
  ASSERT_EQ(found.size(), expected.size());
  for (size_t i = 0; i < found.size(); ++i) {
    if (std::isnan(expected[i]))
      EXPECT_TRUE(std::isnan(found[i])) << i << ": " << found[i];
    else
      EXPECT_EQ(found[i], expected[i]) << i;
  }
}

TEST(Half, RoundTripsEveryPattern) {
  for (uint32_t bits = 0; bits < 65536; ++bits) {
    const float value = half_to_float(static_cast<uint16_t>(bits));
    if (std::isnan(value)) {
      EXPECT_GT(bits & 0x7fffu, 0x7c00u);
      EXPECT_GT(float_to_half(value) & 0x7fffu, 0x7c00u);
      continue;
    }
    EXPECT_EQ(float_to_half(value), bits);
    // By definition: sign, exponent, mantissa.
    const int exponent = static_cast<int>(bits >> 10 & 31u);
    const float mantissa = static_cast<float>(bits & 1023u);
    const float magnitude = exponent == 31  ? kInf
                            : exponent == 0 ? std::ldexp(mantissa, -24)
                                            : std::ldexp(1024.0f + mantissa, exponent - 25);
    EXPECT_EQ(value, (bits & 0x8000u) != 0 ? -magnitude : magnitude) << bits;
  }
}

TEST(Half, RoundsToNearestEven) {
  // Around every boundary between neighbours: the tie, and one float to either side.
  for (uint32_t bits = 0; bits < 0x7bffu; ++bits) {
    const float low = half_to_float(static_cast<uint16_t>(bits));
    const float high = half_to_float(static_cast<uint16_t>(bits + 1));
    const float middle = (low + high) / 2;
    EXPECT_EQ(float_to_half(middle), bits + (bits & 1u)) << bits;
    EXPECT_EQ(float_to_half(std::nextafterf(middle, 0.0f)), bits);
    EXPECT_EQ(float_to_half(std::nextafterf(middle, kInf)), bits + 1);
    EXPECT_EQ(float_to_half(-middle), 0x8000u | (bits + (bits & 1u)));
  }
  EXPECT_EQ(float_to_half(65519.99f), 0x7bffu);
  EXPECT_EQ(float_to_half(65520.0f), 0x7c00u);
  EXPECT_EQ(float_to_half(1e30f), 0x7c00u);
  EXPECT_EQ(float_to_half(0x1p-149f), 0u);
  EXPECT_EQ(float_to_half(-0.0f), 0x8000u);
}

const char* const kNetwork = R"(  input %x : f16[1,4,4,2]
  const %w : f16[2,1,1,2] = [0.5,-2,1e-07,65504]
  const %b : f16[2] = [-0,inf]
  const %zero : f16[1] = [0]
  const %nan : f32[2] = [0x7fc00001,-1.5e-42]
  const %odd : f16[1] = [0xfe12]
  %c = conv2d %x, %w, %b, %zero, %zero {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=f32} : f16[1,4,4,2]
  %r = clamp %c {min_val=-0.1, max_val=inf, nan_mode=propagate} : f16[1,4,4,2]
  %s = sigmoid %r : f16[1,4,4,2]
  return %s, %nan, %odd)";

TEST(RealText, PrintsTheShortestDecimalsThatReadBack) {
  const Graph graph = legal(kNetwork);
  const std::string text = print_text(graph);
  EXPECT_TRUE(parsed(text) == graph) << text;
  EXPECT_NE(text.find("[-0,inf]"), std::string::npos) << text;
  EXPECT_NE(text.find("[0x7fc00001,-1.5e-42]"), std::string::npos) << text;
  EXPECT_NE(text.find("[0xfe12]"), std::string::npos) << text;
  EXPECT_NE(text.find("max_val=inf"), std::string::npos) << text;
  EXPECT_EQ(graph.value(*graph.find_value("b")).constant->get(0), INT16_MIN);
}

TEST(RealText, RoundTripsRandomBits) {
  std::mt19937 generator(1);
  for (const DType dtype : {kF16, kF32}) {
    Graph graph;
    for (int i = 0; i < 200; ++i) {
      Tensor tensor = Tensor::zeros({dtype, {16}});
      for (uint8_t& byte : tensor.bytes) byte = static_cast<uint8_t>(generator());
      graph.outputs.push_back(graph.add_constant("c" + std::to_string(i), std::move(tensor)));
    }
    EXPECT_TRUE(parsed(print_text(graph)) == graph);
  }
}

TEST(RealText, RefusesWhatIsNoNumber) {
  for (const char* values : {"[one]", "[1,]", "[0x1ffff]", "[0x]", "[1e99]", "[1 2]"})
    EXPECT_FALSE(
        parse_text(std::string("graph g { const %c : f16[1] = ") + values + " return %c }"))
        << values;
}

TEST(RealBinary, RoundTrips) {
  const Graph graph = legal(kNetwork);
  const Result<Graph> again = read_tosa(write_tosa(graph));
  ASSERT_TRUE(again) << again.error().text();
  EXPECT_TRUE(*again == graph) << print_text(*again);
}

TEST(RealVerify, RefusesWhatTheFloatingPointProfileHasNot) {
  const auto says = [](const std::string& lines, const std::string& message) {
    const std::string found = refusal(lines);
    EXPECT_NE(found.find(message), std::string::npos) << lines << "\n" << found;
  };
  says("input %x : f32[2] input %y : f16[2] %z = add %x, %y : f32[2] return %z",
       "has the wrong element type, expected f32");
  says("input %x : f8e4m3[2] %z = abs %x : f8e4m3[2] return %z", "expected i32, f32, f16 or bf16");
  says("input %x : f16[2] %z = cast %x : bf16[2] return %z", "expected i8, i16, i32, f32, f8e4m3");
  says("input %x : f32[1,3,4] %z = rfft2d %x {part=real} : f32[1,3,3] return %z",
       "has 3 on axis 1, expected a power of two");
  says("input %x : f32[1,2,16384] %z = rfft2d %x {part=imag} : f32[1,2,8193] return %z",
       "level 8K ends at 8192");
  says("input %x : f32[2] %z = clz %x : f32[2] return %z", "expected i32");
  says("input %x : i8[2] %z = sigmoid %x : i8[2] return %z", "expected f32, f16 or bf16");
  says("input %x : f32[2] %z = clamp %x {min_val=2, max_val=1, nan_mode=ignore} : f32[2] return %z",
       "numbers in order");
  says(
      "input %x : f32[2] %z = clamp %x {min_val=nan, max_val=1, nan_mode=ignore} : f32[2] return "
      "%z",
      "numbers in order");
  says("input %x : f32[2] %z = clamp %x {min_val=0, max_val=1} : f32[2] return %z",
       "nan_mode is 0, expected 1 to 2");
  says("input %x : f32[2] %z = cast %x : bool[2] return %z", "to bool, expected i8");
  says("input %x : bool[2] %z = cast %x : f32[2] return %z", "to f32, expected i8, i16 or i32");
  says(
      "input %x : f16[1,1,1] input %y : f16[1,1,1] const %o : f16[1] = [1] "
      "%z = matmul %x, %y, %o, %o : f16[1,1,1] return %z",
      "is 1, expected 0: only int8 tensors have a zero point");
  says(
      "input %x : f32[1,1,1,1] const %o : f32[1] = [0] const %b : f32[1] = [0] "
      "const %w : f32[1,1,1,1] = [1] "
      "%z = conv2d %x, %w, %b, %o, %o {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=f16} "
      ": f32[1,1,1,1] return %z",
      "acc_type is FP16, expected FP32");
  says("input %x : f32[2] const %s : i8[1] = [1] %z = mul %x, %x, %s : f32[2] return %z",
       "expected 0 to 0");
  // A zero point may be -0, and FP16 gives an FP32 matmul.
  EXPECT_EQ(refusal("input %x : f16[1,1,1] input %y : f16[1,1,1] const %o : f16[1] = [-0] "
                    "%z = matmul %x, %y, %o, %o : f32[1,1,1] return %z"),
            "accepted");
}

TEST(RealInterpreter, FollowsTheNanModes) {
  const std::vector<float> a{1, kNan, 2, kNan, -kInf}, b{kNan, 3, -2, kNan, kInf};
  const auto result = [&](const std::string& op, const std::string& mode) {
    return run(legal("input %a : f32[5] input %b : f32[5] %z = " + op +
                     " %a, %b {nan_mode=" + mode + "} : f32[5] return %z"),
               {reals(kF32, {5}, a), reals(kF32, {5}, b)});
  };
  expect_same(result("maximum", "propagate"), {kNan, kNan, 2, kNan, kInf});
  expect_same(result("maximum", "ignore"), {1, 3, 2, kNan, kInf});
  expect_same(result("minimum", "propagate"), {kNan, kNan, -2, kNan, -kInf});
  expect_same(result("minimum", "ignore"), {1, 3, -2, kNan, -kInf});
  const auto reduced = [&](const std::string& op, const std::string& mode, const std::string& type,
                           const std::vector<float>& x) {
    return run(legal("input %a : f32[4] %z = " + op + " %a {axis=0, nan_mode=" + mode +
                     "} : " + type + " return %z"),
               {reals(kF32, {4}, x)});
  };
  expect_same(reduced("reduce_max", "propagate", "f32[1]", {1, kNan, 4, 2}), {kNan});
  expect_same(reduced("reduce_max", "ignore", "f32[1]", {1, kNan, 4, 2}), {4});
  expect_same(reduced("reduce_min", "ignore", "f32[1]", {kNan, kNan, kNan, kNan}), {kNan});
  expect_same(reduced("argmax", "propagate", "i32[]", {1, kNan, 4, kNan}), {1});
  expect_same(reduced("argmax", "ignore", "i32[]", {kNan, 3, 4, 4}), {2});
}

TEST(RealInterpreter, CastsToNearestEvenAndSaturates) {
  const Graph to_int8 = legal("input %x : f32[8] %z = cast %x : i8[8] return %z");
  expect_same(
      run(to_int8, {reals(kF32, {8}, {0.5f, 1.5f, -2.5f, 127.6f, -1e9f, kInf, kNan, -0.4f})}),
      {0, 2, -2, 127, -128, 127, 0, 0});
  const Graph to_half = legal("input %x : f32[4] %z = cast %x : f16[4] return %z");
  expect_same(run(to_half, {reals(kF32, {4}, {2049, 2051, 65520, 0x1p-25f})}),
              {2048, 2052, kInf, 0});
  const Graph from_int = legal("input %x : i32[2] %z = cast %x : f32[2] return %z");
  expect_same(run(from_int, {Tensor::from_ints({DType::kInt32, {2}},
                                               std::vector<int64_t>{16777217, INT32_MIN})}),
              {16777216, -0x1p31f});
}

TEST(RealInterpreter, SumsInFloatAndRoundsHalvesAtTheEnd) {
  // In FP16 steps 2048 + 1 + 1 would stay 2048.
  const Graph sum = legal("input %x : f16[3] %z = reduce_sum %x {axis=0} : f16[1] return %z");
  expect_same(run(sum, {reals(kF16, {3}, {2048, 1, 1})}), {2050});
  const Graph mean = legal(
      "input %x : f32[1,2,2,1] const %o : f32[1] = [0] %z = avg_pool2d %x, %o, %o {kernel=[2,2], "
      "stride=[2,2], pad=[0,0,1,1], acc_type=f32} : f32[1,1,2,1] return %z");
  expect_same(run(mean, {reals(kF32, {1, 2, 2, 1}, {1, 2, 3, 6})}), {2, 4});
  const Graph resize = legal(
      "input %x : f32[1,1,2,1] const %s : shape[4] = [1,1,4,1] const %o : shape[2] = [0,0] "
      "const %b : shape[2] = [0,0] %z = resize %x, %s, %o, %b {mode=bilinear} : f32[1,1,5,1] "
      "return %z");
  expect_same(run(resize, {reals(kF32, {1, 1, 2, 1}, {1, 3})}), {1, 1.5f, 2, 2.5f, 3});
  // Taps outside the input are left out, even of a weight that is no number.
  const Graph conv = legal(
      "input %x : f32[1,1,2,1] const %w : f32[1,1,2,1] = [inf,1] const %b : f32[1] = [0.5] "
      "const %o : f32[1] = [0] %z = conv2d %x, %w, %b, %o, %o {pad=[0,0,1,0], stride=[1,1], "
      "dilation=[1,1], acc_type=f32} : f32[1,1,2,1] return %z");
  expect_same(run(conv, {reals(kF32, {1, 1, 2, 1}, {2, 3})}), {2.5f, kInf});
}

TEST(RealInterpreter, AllConvolutionsAgreeWithPlainSums) {
  // Small integers, so that every order is exact; the integer convolutions are tested on their own.
  std::mt19937 generator(3);
  struct Case {
    const char* op;
    const char* input;
    const char* weight;
    const char* result;
    const char* attributes;
  };
  for (const Case& row :
       std::initializer_list<Case>{{"conv2d", "[1,5,4,3]", "[2,3,2,3]", "[1,4,5,2]",
                                    "pad=[1,0,1,1], stride=[1,1], dilation=[1,1]"},
                                   {"conv2d", "[1,5,5,3]", "[4,2,2,3]", "[1,2,2,4]",
                                    "pad=[0,0,0,0], stride=[2,2], dilation=[2,2]"},
                                   {"depthwise_conv2d", "[2,4,4,1]", "[2,1,1,2]", "[2,3,4,2]",
                                    "pad=[0,0,0,0], stride=[1,1], dilation=[1,1]"},
                                   {"depthwise_conv2d", "[1,4,4,3]", "[2,3,3,2]", "[1,4,4,6]",
                                    "pad=[1,0,1,1], stride=[1,1], dilation=[1,1]"},
                                   {"conv3d", "[1,3,3,3,2]", "[3,2,2,2,2]", "[1,2,2,2,3]",
                                    "pad=[0,0,0,0,0,0], stride=[1,1,1], dilation=[1,1,1]"},
                                   {"transpose_conv2d", "[1,3,2,2]", "[3,2,3,2]", "[1,6,5,3]",
                                    "out_pad=[0,0,0,0], stride=[2,2]"}}) {
    const auto network = [&](const char* in, const char* weight, const char* acc) {
      return legal(fmt::format(
          "input %x : {0}{3} input %w : {1}{4} const %b : {2}[1] = [7] const %o : {0}[1] = [0] "
          "const %p : {1}[1] = [0] %z = {5} %x, %w, %b, %o, %p {{{6}, acc_type={2}}} : {2}{7} "
          "return %z",
          in, weight, acc, row.input, row.weight, row.op, row.attributes, row.result));
    };
    const Graph real = network("f32", "f32", "f32"), integer = network("i8", "i8", "i32");
    std::vector<Tensor> reals_in, ints_in;
    for (const ValueId id : integer.inputs) {
      Tensor tensor = Tensor::zeros(integer.value(id).type);
      for (uint8_t& byte : tensor.bytes) byte = static_cast<uint8_t>(generator());
      Tensor same = Tensor::zeros({kF32, tensor.type.shape});
      for (int64_t i = 0; i < tensor.count(); ++i)
        same.set_real(i, static_cast<float>(tensor.get(i)));
      ints_in.push_back(std::move(tensor));
      reals_in.push_back(std::move(same));
    }
    SCOPED_TRACE(row.op);
    expect_same(run(real, reals_in), run(integer, ints_in));
  }
}

/// Bounds of a graph's first output.
Bounds bounds_of(const Graph& graph, const std::vector<Tensor>& inputs) {
  const Result<std::vector<Bounds>> bounds = interpret_bounds(graph, inputs);
  EXPECT_TRUE(bounds) << bounds.error().text();
  return bounds ? bounds->front() : Bounds{};
}

TEST(Bounds, AreTightWhereArithmeticIsExact) {
  const Graph graph = legal(
      "input %x : f32[6] const %c : f32[1] = [0.5] const %s : i8[1] = [0] %y = mul %x, %c, %s : "
      "f32[6] "
      "%z = add %y, %c : f32[6] return %z");
  const Bounds bounds = bounds_of(graph, {reals(kF32, {6}, {1, -3, 0x1p-126f, kInf, kNan, 0.1f})});
  EXPECT_EQ(bounds[0].low, 1.0);
  EXPECT_EQ(bounds[0].high, 1.0);
  EXPECT_EQ(bounds[1].low, -1.0);
  EXPECT_LT(bounds[2].high - bounds[2].low, 1e-7);
  EXPECT_TRUE(bounds[3].holds(static_cast<double>(kInf)));
  EXPECT_FALSE(bounds[3].holds(1e30));
  EXPECT_TRUE(bounds[4].holds(static_cast<double>(kNan)));
  EXPECT_FALSE(bounds[4].holds(0));
  EXPECT_LE(bounds[5].high - bounds[5].low, 0x1p-24);
}

TEST(Bounds, GrowWithTheLengthOfASumAndNoFurther) {
  for (const int64_t n : {4, 1000}) {
    const Graph graph = legal(
        fmt::format("input %x : f32[{0}] %z = reduce_sum %x {{axis=0}} : f32[1] return %z", n));
    const Bounds bounds =
        bounds_of(graph, {reals(kF32, {n}, std::vector<float>(static_cast<size_t>(n), 0.1f))});
    const double width = bounds[0].high - bounds[0].low, sum = 0.1 * static_cast<double>(n);
    const double one = static_cast<double>(n) * 0x1p-23 * sum;
    EXPECT_GT(width, one);
    EXPECT_LT(width, 5 * one);
  }
}

TEST(Bounds, CarryErrorsThroughCastsAndComparisons) {
  // 0.3 * 5 is near 1.5: a device may round it to either side, so the code is 1 or 2.
  const Graph graph = legal(
      "input %x : f32[2] const %c : f32[1] = [5] const %s : i8[1] = [0] %y = mul %x, %c, %s : "
      "f32[2] "
      "%z = cast %y : i8[2] return %z");
  const Bounds bounds = bounds_of(graph, {reals(kF32, {2}, {0.3f, 0.4f})});
  EXPECT_TRUE(bounds[0].holds(2));
  EXPECT_FALSE(bounds[0].holds(3));
  EXPECT_EQ(bounds[1].low, 2.0);
  EXPECT_EQ(bounds[1].high, 2.0);
  const Graph choice = legal(
      "input %x : f32[1] const %c : f32[1] = [3] const %d : f32[1] = [0.3] const %s : i8[1] = [0] "
      "const %far : f32[1] = [100] %y = mul %x, %c, %s : f32[1] %g = greater_equal %y, %d : "
      "bool[1] "
      "%z = select %g, %far, %d : f32[1] return %z");
  const Bounds either = bounds_of(choice, {reals(kF32, {1}, {0.1f})});
  EXPECT_TRUE(either[0].holds(100));
  EXPECT_TRUE(either[0].holds(static_cast<double>(0.3f)));
}

TEST(Bounds, FindAWrongElement) {
  const Graph graph = legal("input %x : f16[1,2,2,1] %z = sigmoid %x : f16[1,2,2,1] return %z");
  const std::vector<Tensor> inputs{reals(kF16, {1, 2, 2, 1}, {-3, 0, 5, 100})};
  const Bounds bounds = bounds_of(graph, inputs);
  Tensor result = *interpret(graph, inputs)->begin();
  EXPECT_EQ(first_outside(result, bounds), std::nullopt);
  result.set(2, result.get(2) + 2);  // two units in the last place
  const std::optional<std::string> found = first_outside(result, bounds);
  ASSERT_TRUE(found);
  EXPECT_NE(found->find("element 2 at [0,1,0,0]"), std::string::npos) << *found;
}

}  // namespace
}  // namespace shale
