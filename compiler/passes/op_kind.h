// compiler/passes/op_kind.h -- how an operator may take part in a fusion group.
#pragma once

#include <span>

#include "ir/graph/graph.h"

namespace shale {

enum class OpKind {
  kElementwise,  ///< element i of the result needs only element i of each operand (after broadcast)
  kView,         ///< every element of the result is one element of an operand, or a constant
  kHead,         ///< everything else: sums, searches, several reads for an element
};

/// RESIZE is a view in nearest mode and a head in bilinear mode.
OpKind op_kind(const Node& node);

/// A group as codegen sees it: views feed the head (or the first elementwise nodes), elementwise
/// nodes follow. Nodes are in graph order; the last one's result is the group's only result in
/// memory.
struct Group {
  std::vector<NodeId> nodes;
  std::optional<NodeId> head;
  ValueId result;

  bool contains(NodeId id) const {
    for (const NodeId node : nodes)
      if (node == id) return true;
    return false;
  }
};

/// Most buffers that a dispatch of these nodes binds, its result among them: a value is counted for
/// each node that reads it, since kernels may view it by words for one and by elements for another.
/// Constants of one element and shapes become literals.
size_t buffer_count(const Graph& graph, std::span<const NodeId> nodes);

/// The groups of a graph in an order in which they can run; a node of group 0 stands alone, and so
/// do the nodes of a group that binds more than `max_buffers`, a limit of devices.
std::vector<Group> collect_groups(const Graph& graph, size_t max_buffers = SIZE_MAX);

}  // namespace shale
