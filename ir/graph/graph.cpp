#include "ir/graph/graph.h"

#include <unordered_set>

namespace shale {

std::string Graph::unique_name(const std::string& wanted) const {
  std::unordered_set<std::string> taken;
  for (const Value& value : values) taken.insert(value.name);
  if (!taken.contains(wanted)) return wanted;
  for (uint32_t suffix = 1;; ++suffix) {
    std::string candidate = fmt::format("{}.{}", wanted, suffix);
    if (!taken.contains(candidate)) return candidate;
  }
}

ValueId Graph::add_value(std::string wanted, TensorType type) {
  values.push_back({unique_name(wanted), std::move(type), std::nullopt});
  return {static_cast<uint32_t>(values.size() - 1)};
}

ValueId Graph::add_input(std::string wanted, TensorType type) {
  inputs.push_back(add_value(std::move(wanted), std::move(type)));
  return inputs.back();
}

ValueId Graph::add_constant(std::string wanted, Tensor tensor) {
  const ValueId id = add_value(std::move(wanted), tensor.type);
  value(id).constant = std::move(tensor);
  return id;
}

ValueId Graph::add_shape(std::string wanted, std::vector<int64_t> elements) {
  const TensorType type{DType::kShape, {static_cast<int64_t>(elements.size())}};
  return add_constant(std::move(wanted), Tensor::from_ints(type, elements));
}

ValueId Graph::add_node(Op op, Attrs attrs, std::vector<ValueId> operands, std::string result_name,
                        TensorType result_type) {
  const ValueId result = add_value(std::move(result_name), std::move(result_type));
  nodes.push_back({op, std::move(attrs), std::move(operands), result, 0});
  return result;
}

std::optional<ValueId> Graph::find_value(const std::string& wanted) const {
  for (uint32_t i = 0; i < values.size(); ++i)
    if (values[i].name == wanted) return ValueId{i};
  return std::nullopt;
}

std::vector<std::optional<NodeId>> Graph::producers() const {
  std::vector<std::optional<NodeId>> result(values.size());
  for (uint32_t i = 0; i < nodes.size(); ++i) result[nodes[i].output.index] = NodeId{i};
  return result;
}

std::vector<uint32_t> Graph::use_counts() const {
  std::vector<uint32_t> counts(values.size());
  for (const Node& node : nodes)
    for (const ValueId input : node.inputs) ++counts[input.index];
  for (const ValueId output : outputs) ++counts[output.index];
  return counts;
}

void Graph::replace_uses(ValueId from, ValueId to) {
  for (Node& node : nodes)
    for (ValueId& input : node.inputs)
      if (input == from) input = to;
  for (ValueId& output : outputs)
    if (output == from) output = to;
}

std::optional<NodeId> Graph::other_part(NodeId id, const std::vector<bool>& taken) const {
  const Node& own = node(id);
  Attrs wanted = own.attrs;
  wanted.set(Attr::kPart, 1 - own.attrs.get(Attr::kPart));
  for (uint32_t i = id.index + 1; i < nodes.size(); ++i)
    if (!taken[i] && nodes[i].op == own.op && nodes[i].inputs == own.inputs &&
        nodes[i].attrs == wanted)
      return NodeId{i};
  return std::nullopt;
}

void Graph::compact() {
  std::vector<bool> used(values.size());
  for (const ValueId id : inputs) used[id.index] = true;
  for (const ValueId id : outputs) used[id.index] = true;
  for (const Node& node : nodes) {
    used[node.output.index] = true;
    for (const ValueId id : node.inputs) used[id.index] = true;
  }
  std::vector<ValueId> renamed(values.size());
  std::vector<Value> kept;
  for (uint32_t i = 0; i < values.size(); ++i) {
    if (!used[i]) continue;
    renamed[i] = {static_cast<uint32_t>(kept.size())};
    kept.push_back(std::move(values[i]));
  }
  values = std::move(kept);
  const auto rename = [&](ValueId& id) { id = renamed[id.index]; };
  for (ValueId& id : inputs) rename(id);
  for (ValueId& id : outputs) rename(id);
  for (Node& node : nodes) {
    rename(node.output);
    for (ValueId& id : node.inputs) rename(id);
  }
}

bool operator==(const Graph& a, const Graph& b) {
  const auto names = [](const Graph& graph, const std::vector<ValueId>& ids) {
    std::vector<std::string> result;
    for (const ValueId id : ids) result.push_back(graph.value(id).name);
    return result;
  };
  const auto same_values = [&](const std::vector<ValueId>& x, const std::vector<ValueId>& y) {
    if (names(a, x) != names(b, y)) return false;
    for (size_t i = 0; i < x.size(); ++i) {
      const Value& u = a.value(x[i]);
      const Value& v = b.value(y[i]);
      if (u.type != v.type || u.constant != v.constant) return false;
    }
    return true;
  };
  if (a.name != b.name || a.nodes.size() != b.nodes.size()) return false;
  if (!same_values(a.inputs, b.inputs) || !same_values(a.outputs, b.outputs)) return false;
  for (size_t i = 0; i < a.nodes.size(); ++i) {
    const Node& x = a.nodes[i];
    const Node& y = b.nodes[i];
    if (x.op != y.op || x.attrs != y.attrs || x.group != y.group) return false;
    if (!same_values(x.inputs, y.inputs) || !same_values({x.output}, {y.output})) return false;
  }
  return true;
}

std::string node_label(const Graph& graph, NodeId id) {
  const Node& node = graph.node(id);
  return fmt::format("node %{} \"{}\" ({})", id.index, graph.value(node.output).name,
                     op_info(node.op).name);
}

}  // namespace shale
