// Drops nodes that only pass their first operand on: same type, same elements, same order.
#include <algorithm>

#include "compiler/passes/pass.h"

namespace shale {
namespace {

bool passes_through(const Graph& graph, const Node& node) {
  const TensorType& from = graph.value(node.inputs[0]).type;
  const TensorType& to = graph.value(node.output).type;
  if (from != to) return false;
  switch (node.op) {
    case Op::kIdentity:
    case Op::kReshape:
    case Op::kSlice:  // with the operand's shape it takes all of it
    case Op::kTile: return true;
    case Op::kConcat: return node.inputs.size() == 1;
    case Op::kPad: {
      const std::vector<int64_t> padding = graph.value(node.inputs[1]).constant->ints();
      return std::all_of(padding.begin(), padding.end(), [](int64_t p) { return p == 0; });
    }
    case Op::kTranspose: {
      const auto perms = node.attrs.list(Attr::kPerms);
      return std::is_sorted(perms.begin(), perms.end());
    }
    case Op::kClamp: {
      if (!is_integer(from.dtype)) return false;
      const IntRange range = dtype_range(from.dtype);
      return node.attrs.get(Attr::kMinVal) <= range.min &&
             node.attrs.get(Attr::kMaxVal) >= range.max;
    }
    default: return false;
  }
}

}  // namespace

Result<Change> remove_identity(Graph& graph, const PassContext&) {
  Change change = Change::kNone;
  std::vector<bool> dropped(graph.nodes.size());
  for (size_t i = 0; i < graph.nodes.size(); ++i) {
    const ValueId result = graph.nodes[i].output;
    // A graph output keeps its name and its own memory.
    if (std::find(graph.outputs.begin(), graph.outputs.end(), result) != graph.outputs.end())
      continue;
    if (!passes_through(graph, graph.nodes[i])) continue;
    graph.replace_uses(result, graph.nodes[i].inputs[0]);
    dropped[i] = true;
    change = Change::kChanged;
  }
  size_t at = 0;
  std::erase_if(graph.nodes, [&](const Node&) { return dropped[at++]; });
  return change;
}

}  // namespace shale
