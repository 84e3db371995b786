// Computes nodes whose operands are all constant, by the reference interpreter.
#include "compiler/passes/pass.h"
#include "ir/reference/interpreter.h"

namespace shale {
namespace {

/// A broadcast of a small constant must not bloat the package.
constexpr int64_t kMaxFoldedElements = int64_t{1} << 20;

}  // namespace

Result<Change> fold_constants(Graph& graph, const PassContext&) {
  Change change = Change::kNone;
  std::vector<Node> kept;
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    Value& result = graph.value(node.output);
    std::vector<const Tensor*> operands;
    for (const ValueId id : node.inputs)
      if (graph.value(id).is_constant()) operands.push_back(&*graph.value(id).constant);
    if (operands.size() < node.inputs.size() ||
        element_count(result.type.shape) > kMaxFoldedElements) {
      kept.push_back(node);
      continue;
    }
    // The result becomes a constant in place: its name and its users stay.
    SHALE_TRY(result.constant, evaluate_node(graph, {i}, operands));
    change = Change::kChanged;
  }
  graph.nodes = std::move(kept);
  return change;
}

}  // namespace shale
