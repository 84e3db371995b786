// Common subexpressions: equal nodes are computed once, equal constants stored once.
#include <algorithm>
#include <map>
#include <tuple>

#include "compiler/passes/pass.h"
#include "ir/base/hash.h"

namespace shale {

Result<Change> merge_equal(Graph& graph, const PassContext&) {
  std::vector<ValueId> renamed(graph.values.size());
  for (uint32_t i = 0; i < renamed.size(); ++i) renamed[i] = {i};
  Change change = Change::kNone;

  const std::vector<uint32_t> uses = graph.use_counts();
  std::multimap<uint64_t, ValueId> constants;
  for (uint32_t i = 0; i < graph.values.size(); ++i) {
    const Value& value = graph.values[i];
    if (!value.is_constant() || uses[i] == 0) continue;
    const uint64_t hash = stable_hash(value.constant->bytes);
    const auto [first, last] = constants.equal_range(hash);
    const auto same = std::find_if(first, last, [&](const auto& entry) {
      return graph.value(entry.second).constant == value.constant;
    });
    if (same == last)
      constants.emplace(hash, ValueId{i});
    else
      renamed[i] = same->second;
  }

  // The element type of the result is part of what a node computes: CAST has its target type only
  // there.
  std::map<std::tuple<Op, std::vector<ValueId>, Attrs, DType, uint32_t>, ValueId> seen;
  std::erase_if(graph.nodes, [&](Node& node) {
    for (ValueId& input : node.inputs) {
      if (renamed[input.index] != input) change = Change::kChanged;
      input = renamed[input.index];
    }
    const DType result = graph.value(node.output).type.dtype;
    const auto [entry, is_new] =
        seen.try_emplace({node.op, node.inputs, node.attrs, result, node.group}, node.output);
    // A graph output keeps its own node, since outputs are told apart by their values.
    const bool is_output =
        std::find(graph.outputs.begin(), graph.outputs.end(), node.output) != graph.outputs.end();
    if (is_new || is_output) return false;
    renamed[node.output.index] = entry->second;
    change = Change::kChanged;
    return true;
  });
  for (ValueId& output : graph.outputs)
    if (!graph.value(output).is_constant()) output = renamed[output.index];
  return change;
}

}  // namespace shale
