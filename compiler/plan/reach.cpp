#include "compiler/plan/reach.h"

#include <algorithm>

namespace shale {
namespace {

int64_t floor_div(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

bool is_empty(const Stretch& part) { return part.begin >= part.end; }

Stretch join(const Stretch& a, const Stretch& b) {
  if (is_empty(a)) return b;
  if (is_empty(b)) return a;
  return {std::min(a.begin, b.begin), std::max(a.end, b.end)};
}

/// What a node's operand `index` gives to positions `part` of its result, borders not cut off.
Stretch operand_part(const Graph& graph, const Node& node, size_t index, size_t axis,
                     const Stretch& part) {
  const ValueId from = node.inputs[index];
  const Stretch whole{0, extent_along(graph, from, axis)};
  if (graph.value(from).type.shape.size() != 4 || graph.value(node.output).type.shape.size() != 4)
    return whole;
  const int64_t to_extent = extent_along(graph, node.output, axis);
  const auto along = [&](Attr attr) { return node.attrs.list(attr)[axis - 1]; };
  const auto ints = [&](size_t operand) {
    return graph.value(node.inputs[operand]).constant->ints();
  };
  const auto window = [&](int64_t taps, int64_t dilation) {
    const int64_t first = -node.attrs.list(Attr::kPad)[2 * (axis - 1)];
    return Stretch{first + part.begin * along(Attr::kStride),
                   first + (part.end - 1) * along(Attr::kStride) + (taps - 1) * dilation + 1};
  };
  const auto taps_along = [&](size_t first_axis) {
    return graph.value(node.inputs[1]).type.shape[first_axis + axis - 1];
  };
  switch (node.op) {
    case Op::kConv2d: return index == 0 ? window(taps_along(1), along(Attr::kDilation)) : whole;
    case Op::kDepthwiseConv2d:
      return index == 0 ? window(taps_along(0), along(Attr::kDilation)) : whole;
    case Op::kAvgPool2d:
    case Op::kMaxPool2d: return index == 0 ? window(along(Attr::kKernel), 1) : whole;
    case Op::kTransposeConv2d: {
      if (index != 0) return whole;
      // Input p makes results p * stride + pad + k of all taps k.
      const int64_t stride = along(Attr::kStride),
                    pad = node.attrs.list(Attr::kOutPad)[2 * (axis - 1)];
      return {floor_div(part.begin - pad - taps_along(1), stride),
              floor_div(part.end - 1 - pad, stride) + 1};
    }
    case Op::kResize: {
      if (index != 0) return whole;
      const int64_t n = ints(1)[2 * (axis - 1)], d = ints(1)[2 * (axis - 1) + 1],
                    offset = ints(2)[axis - 1], last = whole.end - 1;
      // The nearest of two neighbours, or both; those outside are the border's.
      return {std::clamp<int64_t>(floor_div(part.begin * d + offset, n), 0, last),
              std::clamp<int64_t>(floor_div((part.end - 1) * d + offset, n) + 1, 0, last) + 1};
    }
    case Op::kPad: {
      if (index != 0) return whole;
      const int64_t before = ints(1)[2 * axis];
      return {part.begin - before, part.end - before};
    }
    case Op::kSlice: {
      if (index != 0) return whole;
      const int64_t start = ints(1)[axis];
      return {part.begin + start, part.end + start};
    }
    case Op::kConcat:
    case Op::kReverse:
    case Op::kReduceSum:
    case Op::kReduceProduct:
    case Op::kReduceMax:
    case Op::kReduceMin:
    case Op::kReduceAny:
    case Op::kReduceAll:
      return node.attrs.get(Attr::kAxis) == static_cast<int64_t>(axis) ? whole : part;
    case Op::kTranspose:
      return node.attrs.list(Attr::kPerms)[axis] == static_cast<int64_t>(axis) ? part : whole;
    case Op::kIdentity: return part;
    case Op::kTile: return whole.end == to_extent ? part : whole;
    default: return op_kind(node) == OpKind::kElementwise && whole.end == to_extent ? part : whole;
  }
}

}  // namespace

int64_t extent_along(const Graph& graph, ValueId value, size_t axis) {
  const Shape& shape = graph.value(value).type.shape;
  return shape.size() == 4 ? shape[axis] : 1;
}

std::vector<Stretch> reach(const Graph& graph, ValueId value, size_t axis, Stretch part) {
  std::vector<Stretch> parts(graph.values.size());
  parts[value.index] = part;
  for (size_t n = graph.nodes.size(); n-- > 0;) {
    const Node& node = graph.nodes[n];
    const Stretch made = parts[node.output.index];
    if (is_empty(made)) continue;
    for (size_t i = 0; i < node.inputs.size(); ++i) {
      if (graph.value(node.inputs[i]).is_constant()) continue;
      Stretch read = operand_part(graph, node, i, axis, made);
      read.begin = std::max<int64_t>(read.begin, 0);
      read.end = std::min(read.end, extent_along(graph, node.inputs[i], axis));
      Stretch& all = parts[node.inputs[i].index];
      all = join(all, read);
    }
  }
  std::vector<Stretch> result;
  for (const ValueId input : graph.inputs) {
    const Stretch& read = parts[input.index];
    result.push_back(is_empty(read) ? Stretch{} : read);
  }
  return result;
}

}  // namespace shale
