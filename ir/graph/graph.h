// ir/graph/graph.h -- a network as nodes and values that are named by ids, never by pointers.
#pragma once

#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "ir/graph/op.h"
#include "ir/graph/tensor.h"

namespace shale {

struct ValueId {
  uint32_t index = UINT32_MAX;
  auto operator<=>(const ValueId&) const = default;
};

struct NodeId {
  uint32_t index = UINT32_MAX;
  auto operator<=>(const NodeId&) const = default;
};

/// A graph input, a constant (`constant` is set), or the result of one node.
struct Value {
  std::string name;  ///< unique in the graph
  TensorType type;   ///< a shape value has dtype kShape and shape [number of elements]
  std::optional<Tensor> constant;

  bool is_constant() const { return constant.has_value(); }
};

struct Node {
  Op op = Op::kIdentity;
  Attrs attrs;
  std::vector<ValueId> inputs;  ///< operand order of TOSA 1.0, constants and shapes included
  ValueId output;
  /// Nodes with the same number above 0 become one dispatch; values between them never reach
  /// memory. An annotation: it does not change what the graph computes.
  uint32_t group = 0;
};

/// Nodes are listed so that producers come first. Ids stay valid until the next compact().
class Graph {
 public:
  std::string name = "main";
  std::vector<Node> nodes;
  std::vector<Value> values;
  std::vector<ValueId> inputs;
  std::vector<ValueId> outputs;

  Value& value(ValueId id) { return values[id.index]; }
  const Value& value(ValueId id) const { return values[id.index]; }
  Node& node(NodeId id) { return nodes[id.index]; }
  const Node& node(NodeId id) const { return nodes[id.index]; }

  /// The name is made unique by a suffix if it is taken.
  ValueId add_value(std::string name, TensorType type);
  ValueId add_input(std::string name, TensorType type);
  ValueId add_constant(std::string name, Tensor tensor);
  /// A constant of dtype kShape.
  ValueId add_shape(std::string name, std::vector<int64_t> elements);
  /// Appends a node and its result value.
  ValueId add_node(Op op, Attrs attrs, std::vector<ValueId> operands, std::string result_name,
                   TensorType result_type);

  std::optional<ValueId> find_value(const std::string& name) const;
  std::string unique_name(const std::string& wanted) const;

  /// Producer of each value, or nothing for inputs and constants; indexed by value.
  std::vector<std::optional<NodeId>> producers() const;
  /// Number of uses of each value, graph outputs counted; indexed by value.
  std::vector<uint32_t> use_counts() const;
  /// Replaces every use of `from`, graph outputs included, by `to`.
  void replace_uses(ValueId from, ValueId to);
  /// The first node after `id` that is its other part: the same operator of two results over the same operands. Of
  /// those in `taken` none is it.
  std::optional<NodeId> other_part(NodeId id, const std::vector<bool>& taken) const;
  /// Drops values that nothing mentions (graph inputs stay) and renumbers the rest in order.
  void compact();
};

/// Equal in meaning and order: names, types, constants, nodes, groups.
bool operator==(const Graph& a, const Graph& b);

/// `node %14 "up2/conv" (conv2d)`: how messages name a node.
std::string node_label(const Graph& graph, NodeId id);

}  // namespace shale
