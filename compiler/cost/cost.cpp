#include "compiler/cost/cost.h"

#include <limits>
#include <set>

namespace shale {
namespace {

bool is_convolution(Op op) {
  return op == Op::kConv2d || op == Op::kConv3d || op == Op::kDepthwiseConv2d ||
         op == Op::kTransposeConv2d;
}

bool is_transform(Op op) { return op == Op::kFft2d || op == Op::kRfft2d; }

uint64_t elements(const Graph& graph, ValueId id) {
  return static_cast<uint64_t>(element_count(graph.value(id).type.shape).value_or(0));
}

uint64_t bytes(const Graph& graph, ValueId id) {
  return elements(graph, id) * dtype_info(graph.value(id).type.dtype).host_bytes;
}

/// Products per position of a convolution: the weight's elements without those that other positions
/// use.
uint64_t products(const Graph& graph, const Node& node) { return elements(graph, node.inputs[1]); }

uint64_t positions(const Graph& graph, ValueId id) {
  return elements(graph, id) / static_cast<uint64_t>(graph.value(id).type.shape.back());
}

/// A bias of a single zero is how TOSA writes "no bias".
bool has_bias(const Graph& graph, const Node& node) {
  const Value& bias = graph.value(node.inputs[2]);
  return !bias.is_constant() || bias.constant->count() > 1 || bias.constant->get(0) != 0;
}

/// A constant that several nodes use is one set of parameters, charged to the first of them.
uint64_t node_parameters(const Graph& graph, const Node& node, std::set<ValueId>& counted) {
  uint64_t count = 0;
  const auto add = [&](ValueId id) {
    if (graph.value(id).is_constant() && counted.insert(id).second) count += elements(graph, id);
  };
  if (is_convolution(node.op)) {
    add(node.inputs[1]);
    if (has_bias(graph, node)) add(node.inputs[2]);
  } else if (node.op == Op::kMatmul) {
    add(node.inputs[0]);
    add(node.inputs[1]);
  }
  return count;
}

}  // namespace

uint64_t node_macs(const Graph& graph, const Node& node) {
  // A transposed convolution multiplies its kernel at every input position, the others at every
  // output.
  if (node.op == Op::kTransposeConv2d)
    return products(graph, node) * positions(graph, node.inputs[0]);
  if (is_convolution(node.op)) return products(graph, node) * positions(graph, node.output);
  if (node.op == Op::kMatmul)
    return elements(graph, node.output) *
           static_cast<uint64_t>(graph.value(node.inputs[0]).type.shape[2]);
  if (is_transform(node.op)) {
    // As matrix products over the rows, which the two parts share, and over the columns of both parts.
    const Shape& in = graph.value(node.inputs[0]).type.shape;
    const uint64_t row = static_cast<uint64_t>(in[2]) * node.inputs.size(),
                   column = 2 * static_cast<uint64_t>(in[1]);
    return elements(graph, node.output) * (row + column);
  }
  return 0;
}

uint64_t node_ops(const Graph& graph, const Node& node) {
  switch (op_kind(node)) {
    case OpKind::kElementwise: return elements(graph, node.output);
    case OpKind::kView: return 0;
    case OpKind::kHead: break;
  }
  if (is_convolution(node.op) || is_transform(node.op) || node.op == Op::kMatmul ||
      node.op == Op::kGather || node.op == Op::kScatter)
    return 0;
  if (node.op == Op::kResize) return 7 * elements(graph, node.output);  // four products, three sums
  if (node.op == Op::kAvgPool2d || node.op == Op::kMaxPool2d) {
    const std::span<const int64_t> kernel = node.attrs.list(Attr::kKernel);
    return elements(graph, node.output) * static_cast<uint64_t>(kernel[0] * kernel[1]);
  }
  return elements(graph, node.inputs[0]);  // reductions and searches
}

Cost group_cost(const Graph& graph, const Group& group) {
  Cost cost;
  std::set<ValueId> made, read;
  for (const NodeId id : group.nodes) {
    const Node& node = graph.node(id);
    cost.macs += node_macs(graph, node);
    cost.ops += node_ops(graph, node);
    for (const ValueId input : node.inputs) {
      const Value& value = graph.value(input);
      const bool is_literal = value.type.dtype == DType::kShape ||
                              (value.is_constant() && value.constant->count() == 1);
      if (!made.contains(input) && !is_literal) read.insert(input);
    }
    made.insert(node.output);
  }
  for (const ValueId id : read) cost.bytes_read += bytes(graph, id);
  cost.bytes_written = bytes(graph, group.result);
  return cost;
}

uint64_t parameter_count(const Graph& graph) {
  uint64_t count = 0;
  std::set<ValueId> counted;
  for (const Node& node : graph.nodes) count += node_parameters(graph, node, counted);
  return count;
}

std::map<std::string, OpCost> cost_by_operator(const Graph& graph) {
  std::map<std::string, OpCost> table;
  std::set<ValueId> counted;
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    const Cost cost = group_cost(graph, {{NodeId{i}}, std::nullopt, node.output});
    OpCost& row = table[std::string(op_info(node.op).name)];
    ++row.nodes;
    row.parameters += node_parameters(graph, node, counted);
    row.macs += cost.macs;
    row.ops += cost.ops;
    row.bytes_read += cost.bytes_read;
    row.bytes_written += cost.bytes_written;
  }
  return table;
}

uint64_t counter_operations(const Graph& graph) {
  uint64_t count = 0;
  for (const Node& node : graph.nodes) {
    if (is_convolution(node.op)) {
      count += products(graph, node) * positions(graph, node.output);
      if (has_bias(graph, node)) count += elements(graph, node.output);
    } else if (node.op == Op::kClamp || node.op == Op::kResize) {  // exporters write ReLU as CLAMP
      count += elements(graph, node.output);
    } else if (node.op == Op::kAvgPool2d || node.op == Op::kMaxPool2d) {
      count += elements(graph, node.inputs[0]);
    }
  }
  return count;
}

Verdict judge(uint64_t macs, const Budget& budget) {
  const double gop = 2e-9 * static_cast<double>(macs);
  const double network_budget_ms = budget.frame_ms - budget.passes_ms;
  Verdict verdict;
  verdict.available_gop = network_budget_ms * budget.tops;  // ms times TOP/s is GOP
  verdict.network_ms = gop / (budget.tops * budget.efficiency);
  constexpr double kNever = std::numeric_limits<double>::infinity();
  verdict.required_efficiency = network_budget_ms > 0 ? gop / verdict.available_gop : kNever;
  verdict.required_tops =
      network_budget_ms > 0 ? gop / (network_budget_ms * budget.efficiency) : kNever;
  verdict.headroom_ms = network_budget_ms - verdict.network_ms;
  verdict.fits = verdict.headroom_ms >= 0;
  return verdict;
}

}  // namespace shale
