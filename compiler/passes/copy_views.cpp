// Gives each convolution over a nearest upsampling a RESIZE of its own, so that fuse-views can fold it:
// kernels then read the small tensor, with fewer products where taps fall on the same texel, and the
// large one is never stored.
#include <algorithm>

#include "compiler/passes/op_kind.h"
#include "compiler/passes/pass.h"

namespace shale {
namespace {

/// Who reads a value; `leaves` if the graph returns it.
struct Readers {
  std::vector<NodeId> nodes;
  bool leaves = false;
};

std::vector<Readers> readers_of(const Graph& graph) {
  std::vector<Readers> readers(graph.values.size());
  for (uint32_t i = 0; i < graph.nodes.size(); ++i)
    for (const ValueId id : graph.nodes[i].inputs) readers[id.index].nodes.push_back({i});
  for (const ValueId id : graph.outputs) readers[id.index].leaves = true;
  return readers;
}

/// True for a convolution over `id`, or its padding alone.
bool takes_view(const Graph& graph, const std::vector<Readers>& readers, const Node& node,
                ValueId id) {
  if (node.inputs[0] != id) return false;
  if (node.op == Op::kConv2d) return true;
  if (node.op != Op::kPad) return false;
  const Readers& next = readers[node.output.index];
  return !next.leaves && next.nodes.size() == 1 && graph.node(next.nodes[0]).op == Op::kConv2d &&
         graph.node(next.nodes[0]).inputs[0] == node.output;
}

}  // namespace

Result<Change> copy_views(Graph& graph, const PassContext&) {
  const std::vector<Readers> readers = readers_of(graph);
  Change change = Change::kNone;
  std::vector<Node> nodes;
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node node = graph.nodes[i];
    nodes.push_back(node);
    const Readers& own = readers[node.output.index];
    if (node.op != Op::kResize || op_kind(node) != OpKind::kView || own.leaves ||
        own.nodes.size() < 2 ||
        !std::all_of(own.nodes.begin(), own.nodes.end(), [&](NodeId reader) {
          return takes_view(graph, readers, graph.node(reader), node.output);
        }))
      continue;
    change = Change::kChanged;
    for (size_t r = 1; r < own.nodes.size(); ++r) {
      Node copy = node;
      copy.output = graph.add_value(graph.value(node.output).name, graph.value(node.output).type);
      // Readers follow: they are copied to `nodes` later.
      graph.node(own.nodes[r]).inputs[0] = copy.output;
      nodes.push_back(std::move(copy));
    }
  }
  graph.nodes = std::move(nodes);
  return change;
}

}  // namespace shale
