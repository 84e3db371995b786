// Drops nodes that no graph output needs.
#include <algorithm>

#include "compiler/passes/pass.h"

namespace shale {

Result<Change> remove_dead(Graph& graph, const PassContext&) {
  std::vector<bool> needed(graph.values.size());
  for (const ValueId id : graph.outputs) needed[id.index] = true;
  std::vector<Node> kept;
  for (size_t i = graph.nodes.size(); i-- > 0;) {
    Node& node = graph.nodes[i];
    if (!needed[node.output.index]) continue;
    for (const ValueId id : node.inputs) needed[id.index] = true;
    kept.push_back(std::move(node));
  }
  std::reverse(kept.begin(), kept.end());
  const Change change = kept.size() == graph.nodes.size() ? Change::kNone : Change::kChanged;
  graph.nodes = std::move(kept);
  return change;
}

}  // namespace shale
