#include "compiler/passes/op_kind.h"

#include <map>

namespace shale {

OpKind op_kind(const Node& node) {
  switch (node.op) {
    case Op::kConcat:
    case Op::kPad:
    case Op::kReshape:
    case Op::kReverse:
    case Op::kSlice:
    case Op::kTile:
    case Op::kTranspose:
    case Op::kIdentity: return OpKind::kView;
    case Op::kResize:
      return node.attrs.get(Attr::kMode) == kNearest ? OpKind::kView : OpKind::kHead;
    case Op::kArgmax:
    case Op::kAvgPool2d:
    case Op::kConv2d:
    case Op::kConv3d:
    case Op::kDepthwiseConv2d:
    case Op::kMatmul:
    case Op::kMaxPool2d:
    case Op::kTransposeConv2d:
    case Op::kReduceAll:
    case Op::kReduceAny:
    case Op::kReduceMax:
    case Op::kReduceMin:
    case Op::kReduceSum:
    case Op::kGather:
    case Op::kScatter: return OpKind::kHead;
    default: return OpKind::kElementwise;
  }
}

std::vector<Group> collect_groups(const Graph& graph) {
  std::map<uint32_t, uint32_t> last_node;  // group number to its last node
  for (uint32_t i = 0; i < graph.nodes.size(); ++i)
    if (graph.nodes[i].group != 0) last_node[graph.nodes[i].group] = i;
  std::map<uint32_t, Group>
      by_last;  // a consumer's last node comes after its producers' last nodes
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    Group& group = by_last[node.group == 0 ? i : last_node[node.group]];
    group.nodes.push_back({i});
    group.result = node.output;
    if (op_kind(node) == OpKind::kHead) group.head = NodeId{i};
  }
  std::vector<Group> groups;
  for (auto& [last, group] : by_last) groups.push_back(std::move(group));
  return groups;
}

}  // namespace shale
