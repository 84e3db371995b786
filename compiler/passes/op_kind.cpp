#include "compiler/passes/op_kind.h"

#include <map>
#include <set>

#include "ir/base/result.h"

namespace shale {

OpKind op_kind(const Node& node) {
  switch (node.op) {  // no default: a new operator has to say what it is
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
    case Op::kReduceProduct:
    case Op::kReduceSum:
    case Op::kFft2d:
    case Op::kRfft2d:
    case Op::kGather:
    case Op::kScatter: return OpKind::kHead;
    case Op::kClamp:
    case Op::kErf:
    case Op::kSigmoid:
    case Op::kTanh:
    case Op::kPow:
    case Op::kCeil:
    case Op::kCos:
    case Op::kExp:
    case Op::kFloor:
    case Op::kLog:
    case Op::kReciprocal:
    case Op::kRsqrt:
    case Op::kSin:
    case Op::kAdd:
    case Op::kArithmeticRightShift:
    case Op::kBitwiseAnd:
    case Op::kBitwiseOr:
    case Op::kBitwiseXor:
    case Op::kIntDiv:
    case Op::kLogicalAnd:
    case Op::kLogicalLeftShift:
    case Op::kLogicalRightShift:
    case Op::kLogicalOr:
    case Op::kLogicalXor:
    case Op::kMaximum:
    case Op::kMinimum:
    case Op::kMul:
    case Op::kSub:
    case Op::kTable:
    case Op::kAbs:
    case Op::kBitwiseNot:
    case Op::kClz:
    case Op::kLogicalNot:
    case Op::kNegate:
    case Op::kSelect:
    case Op::kEqual:
    case Op::kGreater:
    case Op::kGreaterEqual:
    case Op::kCast:
    case Op::kRescale: return OpKind::kElementwise;
  }
  SHALE_CHECK(false && "an operator of ops.def has no kind");
}

size_t buffer_count(const Graph& graph, std::span<const NodeId> nodes) {
  std::set<ValueId> made, constants;
  std::set<std::pair<ValueId, NodeId>> reads;
  for (const NodeId id : nodes) made.insert(graph.node(id).output);
  for (const NodeId id : nodes)
    for (const ValueId input : graph.node(id).inputs) {
      const Value& value = graph.value(input);
      if (made.contains(input) || value.type.dtype == DType::kShape) continue;
      if (!value.is_constant())
        reads.emplace(input, id);
      else if (value.constant->count() != 1)
        constants.insert(input);
    }
  return reads.size() + constants.size() + 1;
}

std::vector<Group> collect_groups(const Graph& graph, size_t max_buffers) {
  std::map<uint32_t, std::vector<NodeId>> members;  // by group number
  for (uint32_t i = 0; i < graph.nodes.size(); ++i)
    if (graph.nodes[i].group != 0) members[graph.nodes[i].group].push_back({i});
  std::map<uint32_t, uint32_t> last_node;  // of groups that stay whole
  for (const auto& [number, nodes] : members)
    if (buffer_count(graph, nodes) <= max_buffers) last_node[number] = nodes.back().index;
  std::map<uint32_t, Group>
      by_last;  // a consumer's last node comes after its producers' last nodes
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    const auto last = last_node.find(node.group);
    Group& group = by_last[last == last_node.end() ? i : last->second];
    group.nodes.push_back({i});
    group.result = node.output;
    if (op_kind(node) == OpKind::kHead) group.head = NodeId{i};
  }
  std::vector<Group> groups;
  for (auto& [last, group] : by_last) groups.push_back(std::move(group));
  return groups;
}

}  // namespace shale
