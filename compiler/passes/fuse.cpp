// The two fusion passes. Both only write group numbers: what the graph computes stays as it is.
#include <algorithm>
#include <map>
#include <set>

#include "compiler/passes/op_kind.h"
#include "compiler/passes/pass.h"

namespace shale {
namespace {

/// Most buffers of a fused dispatch, its result among them.
constexpr size_t kMaxGroupBuffers = 13;

/// Groups under construction, as disjoint sets of nodes.
class Grouping {
 public:
  explicit Grouping(Graph& graph) : graph_(graph), consumers_(graph.values.size()) {
    std::map<uint32_t, uint32_t> first;
    for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
      const uint32_t number = graph.nodes[i].group;
      owner_.push_back(number == 0 ? i : first.try_emplace(number, i).first->second);
      for (const ValueId id : graph.nodes[i].inputs) consumers_[id.index].insert(i);
    }
    // A value that leaves the graph is consumed by someone who is in no group.
    for (const ValueId id : graph.outputs) consumers_[id.index].insert(UINT32_MAX);
    producers_ = graph.producers();
  }

  /// Producer of a value that exactly one node reads.
  std::optional<uint32_t> private_producer(ValueId id) const {
    if (!producers_[id.index] || consumers_[id.index].size() != 1) return std::nullopt;
    return producers_[id.index]->index;
  }

  /// True if at most one of the two groups has a head and the union binds few enough buffers.
  bool may_merge(uint32_t a, uint32_t b) const {
    if (owner_[a] == owner_[b]) return false;
    int heads = 0;
    std::vector<NodeId> nodes;
    for (uint32_t i = 0; i < owner_.size(); ++i) {
      if (owner_[i] != owner_[a] && owner_[i] != owner_[b]) continue;
      nodes.push_back({i});
      if (op_kind(graph_.nodes[i]) == OpKind::kHead) ++heads;
    }
    return heads <= 1 && buffer_count(graph_, nodes) <= kMaxGroupBuffers;
  }

  void merge(uint32_t a, uint32_t b) {
    const uint32_t from = std::max(owner_[a], owner_[b]), to = std::min(owner_[a], owner_[b]);
    std::replace(owner_.begin(), owner_.end(), from, to);
    merged_ = true;
  }

  Change finish() {
    if (!merged_) return Change::kNone;
    std::map<uint32_t, uint32_t> sizes, numbers;
    for (const uint32_t owner : owner_) ++sizes[owner];
    for (uint32_t i = 0; i < owner_.size(); ++i) {
      const bool alone = sizes[owner_[i]] == 1;
      graph_.nodes[i].group =
          alone ? 0
                : numbers.try_emplace(owner_[i], static_cast<uint32_t>(numbers.size() + 1))
                      .first->second;
    }
    return Change::kChanged;
  }

 private:
  Graph& graph_;
  std::vector<uint32_t> owner_;  ///< lowest node of each node's group
  std::vector<std::set<uint32_t>> consumers_;
  std::vector<std::optional<NodeId>> producers_;
  bool merged_ = false;
};

/// Views that convolution kernels take into their addressing; others would cost index arithmetic
/// for every tap.
bool folds_into_convolution(const Node& view) {
  return view.op == Op::kPad || view.op == Op::kConcat || view.op == Op::kResize;
}

}  // namespace

/// Joins an elementwise node with the producer of an operand of the same shape, if nobody else
/// reads that operand: the value then stays in registers. Since the operand is the producer group's
/// only result and has one reader, no cycle can arise.
Result<Change> fuse_elementwise(Graph& graph, const PassContext&) {
  Grouping groups(graph);
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    if (op_kind(node) != OpKind::kElementwise) continue;
    const Shape& shape = graph.value(node.output).type.shape;
    for (const ValueId id : node.inputs) {
      if (graph.value(id).type.shape != shape) continue;
      const std::optional<uint32_t> producer = groups.private_producer(id);
      if (!producer || op_kind(graph.nodes[*producer]) == OpKind::kView) continue;
      if (groups.may_merge(i, *producer)) groups.merge(i, *producer);
    }
  }
  return groups.finish();
}

/// Joins a view with its only reader, so that the reader addresses the view's operand directly.
Result<Change> fuse_views(Graph& graph, const PassContext&) {
  Grouping groups(graph);
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    const OpKind kind = op_kind(node);
    for (size_t operand = 0; operand < node.inputs.size(); ++operand) {
      const std::optional<uint32_t> producer = groups.private_producer(node.inputs[operand]);
      if (!producer || op_kind(graph.nodes[*producer]) != OpKind::kView) continue;
      const bool addresses = node.op == Op::kConv2d || node.op == Op::kDepthwiseConv2d;
      if (kind == OpKind::kHead &&
          (!addresses || operand != 0 || !folds_into_convolution(graph.nodes[*producer])))
        continue;
      if (groups.may_merge(i, *producer)) groups.merge(i, *producer);
    }
  }
  return groups.finish();
}

}  // namespace shale
