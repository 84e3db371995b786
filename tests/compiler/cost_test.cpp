#include "compiler/cost/cost.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/ir/node_case.h"

namespace shale {
namespace {

constexpr DType kS8 = DType::kInt8, kS32 = DType::kInt32;

Operand zeros(DType dtype, Shape shape) {
  const int64_t count = *element_count(shape);
  return constant(dtype, std::move(shape), Ints(static_cast<size_t>(count)));
}
Operand zero() { return constant(kS8, {0}); }

uint64_t macs(const NodeCase& node) {
  const Graph graph = node.graph();
  return node_macs(graph, graph.nodes[0]);
}
uint64_t ops(const NodeCase& node) {
  const Graph graph = node.graph();
  return node_ops(graph, graph.nodes[0]);
}

NodeCase conv(Operand bias) {
  return {"conv2d",
          Op::kConv2d,
          conv_attrs({1, 1, 1, 1}, {1, 1}, {1, 1}),
          {input(kS8, {1, 4, 5, 3}), zeros(kS8, {8, 3, 3, 3}), std::move(bias), zero(), zero()},
          {kS32, {1, 4, 5, 8}}};
}

TEST(Cost, CountsProductsOfEveryConvolution) {
  EXPECT_EQ(macs(conv(zeros(kS32, {8}))), 4u * 5 * 8 * 3 * 3 * 3);
  EXPECT_EQ(
      macs({"conv2d of two pictures, stride 2",
            Op::kConv2d,
            conv_attrs({0, 0, 0, 0}, {2, 2}, {1, 1}),
            {input(kS8, {2, 4, 6, 3}), zeros(kS8, {8, 2, 2, 3}), zeros(kS32, {8}), zero(), zero()},
            {kS32, {2, 2, 3, 8}}}),
      2u * 2 * 3 * 8 * 2 * 2 * 3);
  EXPECT_EQ(macs({"conv3d",
                  Op::kConv3d,
                  conv_attrs({0, 0, 0, 0, 0, 0}, {1, 1, 1}, {1, 1, 1}),
                  {input(kS8, {1, 3, 4, 5, 2}), zeros(kS8, {4, 2, 3, 3, 2}), zeros(kS32, {4}),
                   zero(), zero()},
                  {kS32, {1, 2, 2, 3, 4}}}),
            2u * 2 * 3 * 4 * 2 * 3 * 3 * 2);
  EXPECT_EQ(
      macs({"depthwise_conv2d, two filters a channel",
            Op::kDepthwiseConv2d,
            conv_attrs({1, 1, 1, 1}, {1, 1}, {1, 1}),
            {input(kS8, {1, 4, 4, 6}), zeros(kS8, {3, 3, 6, 2}), zeros(kS32, {12}), zero(), zero()},
            {kS32, {1, 4, 4, 12}}}),
      4u * 4 * 12 * 3 * 3);
  EXPECT_EQ(macs({"matmul",
                  Op::kMatmul,
                  {},
                  {input(kS8, {2, 3, 4}), input(kS8, {2, 4, 5}), zero(), zero()},
                  {kS32, {2, 3, 5}}}),
            2u * 3 * 5 * 4);
}

NodeCase transpose_conv() {
  return {"transpose_conv2d",
          Op::kTransposeConv2d,
          transpose_conv_attrs({-2, -1, -2, -1}, {2, 2}),
          {input(kS8, {1, 3, 4, 2}), zeros(kS8, {4, 5, 5, 2}), zeros(kS32, {4}), zero(), zero()},
          {kS32, {1, 6, 8, 4}}};
}

TEST(Cost, CountsTransposedConvolutionAtItsInput) {
  EXPECT_EQ(macs(transpose_conv()), 3u * 4 * 5 * 5 * 2 * 4);
  const Graph graph = transpose_conv().graph();
  EXPECT_EQ(counter_operations(graph), 6u * 8 * 5 * 5 * 2 * 4 + 6 * 8 * 4)
      << "the counter charges output positions";
}

TEST(Cost, GivesNoProductsToOtherOperators) {
  for (const OpInfo& info : all_ops()) {
    if (info.name.find("conv") != std::string_view::npos ||
        info.name.find("fft") != std::string_view::npos || info.op == Op::kMatmul)
      continue;
    const Operand operand = input(kS8, {1, 2, 2, 4});
    EXPECT_EQ(macs({"", info.op, {}, {operand, operand}, {kS8, {1, 2, 2, 4}}}), 0u) << info.name;
  }
}

TEST(Cost, CountsOperationsThatAreNoProducts) {
  const TensorType i32{kS32, {1, 2, 3, 4}};
  const Operand x = input(kS32, {1, 2, 3, 4});
  EXPECT_EQ(ops({"add", Op::kAdd, {}, {x, input(kS32, {1, 1, 1, 4})}, i32}), 24u);
  EXPECT_EQ(ops({"reduce_sum", Op::kReduceSum, axis_attrs(3), {x}, {kS32, {1, 2, 3, 1}}}), 24u);
  EXPECT_EQ(ops({"transpose",
                 Op::kTranspose,
                 Attrs().set(Attr::kPerms, {0, 2, 1, 3}),
                 {x},
                 {kS32, {1, 3, 2, 4}}}),
            0u);
  EXPECT_EQ(ops({"max_pool2d",
                 Op::kMaxPool2d,
                 max_pool_attrs({2, 3}, {1, 1}, {0, 0, 0, 0}),
                 {input(kS8, {1, 3, 4, 5})},
                 {kS8, {1, 2, 2, 5}}}),
            2u * 2 * 5 * 2 * 3);
  const auto resize = [](int64_t mode) {
    return NodeCase{"resize",
                    Op::kResize,
                    Attrs().set(Attr::kMode, mode),
                    {input(kS8, {1, 2, 2, 3}), dims({4, 2, 4, 2}), dims({-1, -1}), dims({1, 1})},
                    {mode == kBilinear ? kS32 : kS8, {1, 4, 4, 3}}};
  };
  EXPECT_EQ(ops(resize(kNearest)), 0u) << "moves bytes, computes nothing";
  EXPECT_EQ(ops(resize(kBilinear)), 7u * 4 * 4 * 3);
  EXPECT_EQ(counter_operations(resize(kNearest).graph()), 4u * 4 * 3)
      << "one an output in SRPO's table";
  EXPECT_EQ(ops(conv(zeros(kS32, {8}))), 0u);
}

TEST(Cost, CountsParametersWithoutAMissingBias) {
  EXPECT_EQ(parameter_count(conv(zeros(kS32, {8})).graph()), 8u * 27 + 8);
  EXPECT_EQ(parameter_count(conv(constant(kS32, {0})).graph()), 8u * 27)
      << "a single zero is no bias";
  EXPECT_EQ(parameter_count(conv(constant(kS32, {5})).graph()), 8u * 27 + 1);
  EXPECT_EQ(counter_operations(conv(constant(kS32, {0})).graph()), 4u * 5 * 8 * 27);
  EXPECT_EQ(counter_operations(conv(constant(kS32, {5})).graph()), 4u * 5 * 8 * 27 + 4 * 5 * 8);
}

TEST(Cost, CountsSharedParametersOnce) {
  Graph graph = conv(zeros(kS32, {8})).graph();
  const Node node = graph.nodes[0];
  graph.outputs.push_back(
      graph.add_node(node.op, node.attrs, node.inputs, "again", graph.value(node.output).type));
  EXPECT_EQ(parameter_count(graph), 8u * 27 + 8);
  const std::map<std::string, OpCost> table = cost_by_operator(graph);
  EXPECT_EQ(table.at("conv2d").nodes, 2u);
  EXPECT_EQ(table.at("conv2d").parameters, 8u * 27 + 8);
  EXPECT_EQ(table.at("conv2d").macs, 2u * 4 * 5 * 8 * 27);
}

/// conv2d -> rescale -> clamp.
Graph small_network() {
  Graph graph = conv(zeros(kS32, {8})).graph();
  const ValueId multiplier =
      graph.add_constant("multiplier", Tensor::from_ints({kS32, {1}}, Ints{1 << 30}));
  const ValueId shift = graph.add_constant("shift", Tensor::from_ints({kS8, {1}}, Ints{38}));
  const ValueId zp32 = graph.add_constant("zp32", Tensor::from_ints({kS32, {1}}, Ints{0}));
  const ValueId zp8 = graph.add_constant("zp8", Tensor::from_ints({kS8, {1}}, Ints{0}));
  const TensorType type{kS8, {1, 4, 5, 8}};
  const ValueId narrow =
      graph.add_node(Op::kRescale, RescaleAttrs{}, {graph.outputs[0], multiplier, shift, zp32, zp8},
                     "narrow", type);
  graph.outputs = {graph.add_node(Op::kClamp, clamp_attrs(0, 127), {narrow}, "relu", type)};
  return graph;
}

TEST(Cost, CountsOnlyBytesThatLeaveAGroup) {
  const Graph graph = small_network();
  const Group fused{{{0}, {1}, {2}}, NodeId{0}, graph.outputs[0]};
  const Cost cost = group_cost(graph, fused);
  EXPECT_EQ(cost.bytes_read, 4u * 5 * 3 + 8 * 27 + 8 * 4)
      << "input, weights, bias; single elements are literals";
  EXPECT_EQ(cost.bytes_written, 4u * 5 * 8);
  EXPECT_EQ(cost.macs, 4u * 5 * 8 * 27);
  EXPECT_EQ(cost.ops, 2u * 4 * 5 * 8) << "rescale and clamp";
  EXPECT_EQ(cost.time_us, 0);
}

TEST(Cost, CountsEachOperatorOnItsOwnInTheTable) {
  const std::map<std::string, OpCost> table = cost_by_operator(small_network());
  ASSERT_EQ(table.size(), 3u);
  EXPECT_EQ(table.at("conv2d").bytes_written, 4u * 4 * 5 * 8) << "int32";
  EXPECT_EQ(table.at("rescale").bytes_read, 4u * 4 * 5 * 8);
  EXPECT_EQ(table.at("rescale").bytes_written, 4u * 5 * 8);
  EXPECT_EQ(table.at("clamp").ops, 4u * 5 * 8);
  EXPECT_EQ(counter_operations(small_network()), 4u * 5 * 8 * (27 + 1 + 1))
      << "products, bias, ReLU";
}

TEST(Budget, LeavesTwentySixGopForTheNetwork) {
  const Verdict verdict = judge(5'000'000'000, Budget{});
  EXPECT_DOUBLE_EQ(verdict.available_gop, 26.0) << "(4.0 - 1.4) ms at 10 TOP/s";
  EXPECT_NEAR(verdict.required_efficiency, 10.0 / 26.0, 1e-12) << "10 GOP";
  EXPECT_EQ(std::lround(1000 * verdict.required_efficiency), 385) << "38.5 %";
  EXPECT_EQ(10 * std::lround(10 * verdict.required_efficiency), 40) << "about 40 %";
  EXPECT_DOUBLE_EQ(verdict.network_ms, 2.0) << "10 GOP at half of 10 TOP/s";
  EXPECT_NEAR(verdict.headroom_ms, 0.6, 1e-12);
  EXPECT_NEAR(verdict.required_tops, 10.0 / (2.6 * 0.5), 1e-12);
  EXPECT_TRUE(verdict.fits);
}

TEST(Budget, RefusesWhatIsTooSlow) {
  const Verdict slow = judge(7'000'000'000, Budget{});
  EXPECT_LT(slow.required_efficiency, 1);
  EXPECT_NEAR(slow.headroom_ms, 2.6 - 2.8, 1e-12);
  EXPECT_FALSE(slow.fits) << "14 GOP need 54 %, 50 % are assumed";
  const Verdict never = judge(14'000'000'000, Budget{});
  EXPECT_GT(never.required_efficiency, 1);
  EXPECT_FALSE(never.fits);
}

TEST(Budget, SaysSoWhenThePassesLeaveNoTime) {
  const Verdict verdict =
      judge(1'000'000, Budget{.frame_ms = 4.0, .passes_ms = 5.0, .tops = 10.0, .efficiency = 0.5});
  EXPECT_TRUE(std::isinf(verdict.required_efficiency));
  EXPECT_TRUE(std::isinf(verdict.required_tops));
  EXPECT_LT(verdict.available_gop, 0);
  EXPECT_FALSE(verdict.fits);
}

}  // namespace
}  // namespace shale
