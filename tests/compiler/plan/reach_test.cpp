// What a part of a value is made from, against the interpreter: inputs are changed row by row and column by column, and
// whatever changes in the result has to lie where the reach says that it may.
#include "compiler/plan/reach.h"

#include <gtest/gtest.h>

#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 3;

/// Positions of `axis` of the tensor at which the two differ.
std::vector<bool> differing(const Tensor& a, const Tensor& b, size_t axis) {
  const Shape& shape = a.type.shape;
  std::vector<bool> result(static_cast<size_t>(shape[axis]));
  for (int64_t i = 0; i < a.count(); ++i) {
    const int64_t at =
        axis == kRowAxis ? i / (shape[2] * shape[3]) % shape[1] : i / shape[3] % shape[2];
    if (a.get(i) != b.get(i)) result[static_cast<size_t>(at)] = true;
  }
  return result;
}

/// How often a change got to a position, of how many that the reach allows.
struct Counts {
  size_t changed = 0, allowed = 0;
};

Counts expect_inside(const Graph& graph) {
  Counts counts;
  const std::vector<Tensor> inputs = random_inputs(graph, kSeed);
  const std::vector<Tensor> before = must(interpret(graph, inputs));
  for (size_t input = 0; input < inputs.size(); ++input)
    for (const size_t axis : {kRowAxis, kColumnAxis}) {
      const Shape& shape = inputs[input].type.shape;
      for (int64_t position = 0; position < shape[axis]; ++position) {
        std::vector<Tensor> changed = inputs;
        for (int64_t i = 0; i < changed[input].count(); ++i) {
          const int64_t at =
              axis == kRowAxis ? i / (shape[2] * shape[3]) % shape[1] : i / shape[3] % shape[2];
          if (at == position) changed[input].set(i, ~changed[input].get(i));
        }
        const std::vector<Tensor> after = must(interpret(graph, changed));
        for (size_t output = 0; output < after.size(); ++output) {
          const std::vector<bool> differs = differing(before[output], after[output], axis);
          for (size_t at = 0; at < differs.size(); ++at) {
            const int64_t from = static_cast<int64_t>(at);
            const Stretch reached =
                reach(graph, graph.outputs[output], axis, {from, from + 1})[input];
            const bool is_inside = position >= reached.begin && position < reached.end;
            counts.changed += differs[at];
            counts.allowed += is_inside;
            EXPECT_TRUE(is_inside || !differs[at])
                << "axis " << axis << ", input " << input << " at " << position << ", output "
                << output << " at " << at;
          }
        }
      }
    }
  return counts;
}

TEST(Reach, OfAWindowWithStrideDilationAndPadding) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,9,13,1]
  const %zp : i8[1] = [0]
  const %w : i8[1,3,3,1] = [1,2,3, 4,5,6, 7,8,9]
  const %b : i32[1] = [0]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[1,1,2,2], stride=[2,3], dilation=[1,2], acc_type=i32} : i32[1,5,5,1]
  return %y
})");
  EXPECT_EQ(reach(graph, graph.outputs[0], kRowAxis, {0, 1})[0], (Stretch{0, 2}));
  EXPECT_EQ(reach(graph, graph.outputs[0], kRowAxis, {1, 3})[0], (Stretch{1, 6}));
  EXPECT_EQ(reach(graph, graph.outputs[0], kColumnAxis, {1, 2})[0], (Stretch{1, 6}));
  const Counts counts = expect_inside(graph);
  EXPECT_GT(counts.changed, 0u);
}

TEST(Reach, OfANetworkWithSeveralReadersConcatsAndResizes) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,8,12,2]
  input %far : i8[1,4,6,2]
  const %zp : i8[1] = [0]
  const %w : i8[2,3,3,2] = [1,-2,3,4,5,-6, 7,8,9,1,2,3, 1,2,-3,4,5,6, 1,2,3,-4,5,6, 7,8,9,1,2,3, 1,-2,3,4,5,6]
  const %b : i32[2] = [0, 5]
  const %scale : shape[4] = [2,1,2,1]
  const %offset : shape[2] = [0,0]
  const %border : shape[2] = [1,1]
  %half = max_pool2d %x {kernel=[2,2], stride=[2,2], pad=[0,0,0,0]} : i8[1,4,6,2]
  %both = bitwise_xor %half, %far : i8[1,4,6,2]
  %up = resize %both, %scale, %offset, %border {mode=nearest} : i8[1,8,12,2]
  %sum = conv2d %up, %w, %b, %zp, %zp {pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,8,12,2]
  %direct = conv2d %x, %w, %b, %zp, %zp {pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,8,12,2]
  %all = concat %sum, %direct {axis=3} : i32[1,8,12,4]
  return %all, %both
})");
  const Counts counts = expect_inside(graph);
  EXPECT_GT(counts.changed, 0u);
  // Not everything is said to reach everything.
  EXPECT_LT(counts.allowed, 2 * counts.changed);
}

TEST(Reach, OfWhatMixesPositionsIsTheWholeAxis) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,4,6,2]
  %rows = reverse %x {axis=1} : i8[1,4,6,2]
  %most = reduce_max %rows {axis=2} : i8[1,4,1,2]
  return %most
})");
  EXPECT_EQ(reach(graph, graph.outputs[0], kRowAxis, {1, 2})[0], (Stretch{0, 4}));
  EXPECT_EQ(reach(graph, graph.outputs[0], kColumnAxis, {0, 1})[0], (Stretch{0, 6}));
  expect_inside(graph);
}

}  // namespace
}  // namespace shale
