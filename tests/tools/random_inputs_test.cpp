#include "tools/shale/random_inputs.h"

#include <gtest/gtest.h>

#include <set>

#include "ir/reference/interpreter.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

Graph graph_of(const std::string& text) {
  Result<Graph> graph = parse_text("graph main {\n" + text + "}\n");
  EXPECT_TRUE(graph) << graph.error().text();
  const Result<void> verified = verify(*graph);
  EXPECT_TRUE(verified) << verified.error().text();
  return *std::move(graph);
}

std::vector<RandomRange> ranges_of(const Graph& graph, const GivenRanges& given = {}) {
  const Result<std::vector<RandomRange>> ranges = legal_ranges(graph, given);
  EXPECT_TRUE(ranges) << ranges.error().text();
  return ranges ? *ranges : std::vector<RandomRange>(graph.inputs.size());
}

/// Values of these ranges, which the interpreter takes without a word for several seeds.
void expect_defined(const Graph& graph) {
  const std::vector<RandomRange> ranges = ranges_of(graph);
  for (uint64_t seed = 0; seed < 5; ++seed) {
    std::mt19937_64 generator(seed);
    std::vector<Tensor> inputs;
    for (size_t i = 0; i < ranges.size(); ++i)
      inputs.push_back(random_tensor(graph.value(graph.inputs[i]).type, ranges[i], generator));
    const auto results = interpret(graph, inputs);
    ASSERT_TRUE(results) << results.error().text();
  }
}

TEST(RandomInputs, AreOfTheWholeTypeWhereAnyValueIsLegal) {
  const Graph graph = graph_of(R"(
    input %a : bool[4]
    input %b : i4[4]
    input %c : i8[4]
    input %d : i48[4]
    return %a, %b, %c, %d
)");
  const std::vector<RandomRange> ranges = ranges_of(graph);
  EXPECT_EQ(ranges[0].low, 0);
  EXPECT_EQ(ranges[0].high, 1);
  EXPECT_EQ(ranges[1].low, -7);
  EXPECT_EQ(ranges[1].high, 7);
  EXPECT_EQ(ranges[2].low, -128);
  EXPECT_EQ(ranges[3].high, 140737488355327.0);
  expect_defined(graph);
}

TEST(RandomInputs, IndicesLieInsideAndScatterTakesNoneTwice) {
  const Graph graph = graph_of(R"(
    input %values : i8[2,5,3]
    input %g : i32[2,4]
    input %flat : i32[8]
    input %data : i8[2,4,3]
    const %shape : shape[2] = [2,4]
    %indices = reshape %flat, %shape : i32[2,4]
    %y = gather %values, %g : i8[2,4,3]
    %z = scatter %values, %indices, %data : i8[2,5,3]
    return %y, %z
)");
  EXPECT_EQ(ranges_of(graph)[1].high, 4);
  EXPECT_EQ(ranges_of(graph)[1].distinct, 0);
  EXPECT_EQ(ranges_of(graph)[2].distinct, 4);
  expect_defined(graph);
}

TEST(RandomInputs, ShiftsAndDivisorsAreLegal) {
  expect_defined(graph_of(R"(
    input %a : i32[64]
    input %s : i32[64]
    input %b : i8[64]
    input %t : i8[64]
    input %d : i32[64]
    %x = arithmetic_right_shift %a, %s {round=true} : i32[64]
    %y = logical_left_shift %b, %t : i8[64]
    %z = intdiv %a, %d : i32[64]
    return %x, %y, %z
)"));
}

TEST(RandomInputs, SumsAndProductsStayInTheirType) {
  expect_defined(graph_of(R"(
    input %a : i32[64,8]
    input %b : i32[64,8]
    const %shift : i8[1] = [4]
    %s = add %a, %b : i32[64,8]
    %t = sub %s, %a : i32[64,8]
    %r = reduce_sum %t {axis=1} : i32[64,1]
    %m = mul %a, %b, %shift : i32[64,8]
    %n = abs %a : i32[64,8]
    return %r, %m, %n
)"));
}

TEST(RandomInputs, WideValuesFitTheirRescale) {
  expect_defined(graph_of(R"(
    input %a : i48[64]
    input %b : i32[64]
    const %m16 : i16[1] = [32767]
    const %shift : i8[1] = [14]
    const %m32 : i32[1] = [1073741824]
    const %small : i8[1] = [20]
    const %zero48 : i48[1] = [0]
    const %zero32 : i32[1] = [0]
    const %zp : i8[1] = [5]
    %y = rescale %a, %m16, %shift, %zero48, %zero32 {scale32=false, rounding_mode=single} : i32[64]
    %z = rescale %b, %m32, %small, %zero32, %zp {scale32=true, rounding_mode=single} : i8[64]
    return %y, %z
)"));
}

TEST(RandomInputs, GivenRangesAreTaken) {
  const Graph graph = graph_of(R"(
    input %a : i8[64]
    input %b : f32[4]
    return %a, %b
)");
  const std::vector<RandomRange> ranges = ranges_of(graph, {{"a", {-3, 4}}, {"b", {0.5, 0.75}}});
  std::mt19937_64 generator(1);
  const Tensor a = random_tensor({DType::kInt8, {64}}, ranges[0], generator);
  const std::vector<int64_t> values = a.ints();
  EXPECT_EQ(std::set<int64_t>(values.begin(), values.end()),
            (std::set<int64_t>{-3, -2, -1, 0, 1, 2, 3, 4}));
  const Tensor b = random_tensor({DType::kFp32, {4}}, ranges[1], generator);
  for (const float value : b.reals()) {
    EXPECT_GE(value, 0.5f);
    EXPECT_LE(value, 0.75f);
  }
  const auto refused = [&](const std::string& name, double low, double high) {
    const auto found = legal_ranges(graph, {{name, {low, high}}});
    return found ? "taken" : found.error().text();
  };
  EXPECT_EQ(refused("c", 0, 1), "--range: \"c\" names no input of the network");
  EXPECT_EQ(refused("a", 0, 128), "--range: 0 to 128 is no range of i8 for input \"a\"");
  EXPECT_EQ(refused("a", 1, 0), "--range: 1 to 0 is no range of i8 for input \"a\"");
  EXPECT_EQ(refused("a", 0, 0.5), "--range: 0 to 0.5 is no range of i8 for input \"a\"");
}

}  // namespace
}  // namespace shale
