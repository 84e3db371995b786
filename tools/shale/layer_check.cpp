#include "tools/shale/layer_check.h"

#include <map>

#include "compiler/passes/op_kind.h"

namespace shale {
namespace {

/// A group as a graph, its operands from outside as inputs; `outside` gains those, in input order.
Graph graph_of(const Graph& graph, const Group& group, std::vector<ValueId>& outside) {
  Graph own;
  own.name = graph.name;
  std::map<ValueId, ValueId> moved;
  for (const NodeId id : group.nodes) {
    Node node = graph.node(id);
    for (ValueId& operand : node.inputs) {
      const auto [entry, is_new] = moved.try_emplace(operand);
      const Value& value = graph.value(operand);
      if (is_new && value.is_constant()) {
        entry->second = own.add_constant(value.name, *value.constant);
      } else if (is_new) {
        entry->second = own.add_input(value.name, value.type);
        outside.push_back(operand);
      }
      operand = entry->second;
    }
    const Value& result = graph.value(node.output);
    node.output = moved[node.output] = own.add_value(result.name, result.type);
    own.nodes.push_back(std::move(node));
  }
  own.outputs = {moved.at(group.result)};
  return own;
}

}  // namespace

Result<std::vector<LayerCheck>> check_layers(const ToolDevice& device, const Graph& graph,
                                             const CompileOptions& options,
                                             const std::vector<Tensor>& inputs,
                                             const InterpreterProgress& progress) {
  CompileOptions alone = options;
  alone.frame.reset();
  alone.passes.input_shapes.clear();
  alone.pass_options.optimize = false;  // the graph has been through the passes
  alone.pass_options.after = {};
  std::map<ValueId, Tensor> values;
  std::vector<uint32_t> uses = graph.use_counts();
  for (size_t i = 0; i < inputs.size(); ++i) values[graph.inputs[i]] = inputs[i];
  std::vector<LayerCheck> checks;
  const std::vector<Group> groups = collect_groups(graph);
  for (uint32_t i = 0; i < groups.size(); ++i) {
    if (progress && !progress(i, static_cast<uint32_t>(groups.size())))
      return bad_input("", "interrupted");
    std::vector<ValueId> outside;
    const Graph own = graph_of(graph, groups[i], outside);
    std::vector<Tensor> operands;
    for (const ValueId id : outside) operands.push_back(values.at(id));
    SHALE_TRY(const Compiled compiled, compile_graph(own, 0, alone));
    SHALE_TRY(const std::vector<Tensor> found, run_network(device, compiled.package, operands));
    SHALE_TRY(const std::vector<OutputCheck> check, check_outputs(own, operands, found, {}));
    checks.push_back({graph.value(groups[i].result).name, check.front()});
    SHALE_TRY(std::vector<Tensor> expected, interpret(own, operands));
    values[groups[i].result] = std::move(expected.front());
    for (const NodeId id : groups[i].nodes)
      for (const ValueId operand : graph.node(id).inputs)
        if (--uses[operand.index] == 0) values.erase(operand);
  }
  return checks;
}

}  // namespace shale
