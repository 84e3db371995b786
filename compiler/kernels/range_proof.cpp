// Bounds of accumulators from the actual weights: which kernels are exact is decided here.
#include <algorithm>

#include "compiler/kernels/kernel.h"

namespace shale {
namespace {

IntRange join(IntRange a, IntRange b) { return {std::min(a.min, b.min), std::max(a.max, b.max)}; }

IntRange constant_range(const Tensor& tensor) {
  IntRange range{tensor.get(0), tensor.get(0)};
  for (int64_t i = 1; i < tensor.count(); ++i) range = join(range, {tensor.get(i), tensor.get(i)});
  return range;
}

/// `producers` once for the whole walk; views and clamps lead on to their operands.
IntRange range_of(const Graph& graph, ValueId id,
                  const std::vector<std::optional<NodeId>>& producers) {
  const Value& value = graph.value(id);
  if (value.is_constant()) return constant_range(*value.constant);
  const IntRange whole = dtype_range(value.type.dtype);
  if (!producers[id.index]) return whole;
  const Node& node = graph.node(*producers[id.index]);
  switch (node.op) {
    case Op::kClamp: {
      const IntRange in = range_of(graph, node.inputs[0], producers);
      const int64_t low = node.attrs.get(Attr::kMinVal), high = node.attrs.get(Attr::kMaxVal);
      return {std::clamp(in.min, low, high), std::clamp(in.max, low, high)};
    }
    case Op::kTable:
      return value.type.dtype == DType::kInt8
                 ? constant_range(*graph.value(node.inputs[1]).constant)
                 : whole;
    case Op::kIdentity:
    case Op::kReshape:
    case Op::kReverse:
    case Op::kSlice:
    case Op::kTile:
    case Op::kTranspose:
    case Op::kMaxPool2d: return range_of(graph, node.inputs[0], producers);
    case Op::kResize:
      return node.attrs.get(Attr::kMode) == kNearest ? range_of(graph, node.inputs[0], producers)
                                                     : whole;
    case Op::kPad:
      return join(range_of(graph, node.inputs[0], producers),
                  range_of(graph, node.inputs[2], producers));
    case Op::kConcat: {
      IntRange all = range_of(graph, node.inputs[0], producers);
      for (const ValueId part : node.inputs) all = join(all, range_of(graph, part, producers));
      return all;
    }
    default: return whole;
  }
}

}  // namespace

IntRange value_range(const Graph& graph, ValueId id) {
  return range_of(graph, id, graph.producers());
}

std::optional<RangeProof> prove_ranges(const Graph& graph, const Group& group) {
  if (!group.head) return std::nullopt;
  const Node& node = graph.node(*group.head);
  const bool depthwise = node.op == Op::kDepthwiseConv2d;
  if (!depthwise && node.op != Op::kConv2d && node.op != Op::kConv3d &&
      node.op != Op::kTransposeConv2d)
    return std::nullopt;
  if (is_float(graph.value(node.output).type.dtype)) return std::nullopt;
  const Value& weight = graph.value(node.inputs[1]);
  const Value& bias = graph.value(node.inputs[2]);
  if (!weight.is_constant() || !bias.is_constant()) return std::nullopt;
  const int64_t zp = graph.value(node.inputs[3]).constant->get(0);
  const int64_t weight_zp = graph.value(node.inputs[4]).constant->get(0);
  const IntRange raw = value_range(graph, node.inputs[0]);
  // A padded tap contributes 0, so 0 belongs to the range of x - zp.
  const IntRange centred = join({raw.min - zp, raw.max - zp}, {0, 0});
  // Kernels of int8 multiply codes as unsigned bytes, u = q + 128, and take what that adds off the
  // bias; a padded tap reads the zero point.
  const int64_t largest = std::max(raw.max, zp) + 128;
  const size_t channels = static_cast<size_t>(graph.value(node.output).type.shape.back());
  RangeProof proof;
  proof.name = graph.value(node.output).name;
  proof.min.resize(channels);
  proof.max.resize(channels);
  proof.magnitude.resize(channels);
  std::vector<int64_t> down(channels);  // what negative weights add, as a magnitude
  for (size_t c = 0; c < channels; ++c)
    proof.min[c] = proof.max[c] =
        bias.constant->get(bias.constant->count() == 1 ? 0 : static_cast<int64_t>(c));
  const int64_t elements = weight.constant->count();
  for (int64_t i = 0; i < elements; ++i) {
    const size_t c =
        static_cast<size_t>(depthwise ? i % static_cast<int64_t>(channels)
                                      : i / (elements / static_cast<int64_t>(channels)));
    const int64_t w = weight.constant->get(i) - weight_zp;
    proof.min[c] += std::min(w * centred.min, w * centred.max);
    proof.max[c] += std::max(w * centred.min, w * centred.max);
    (w > 0 ? proof.magnitude[c] : down[c]) += std::abs(w) * largest;
  }
  for (size_t c = 0; c < channels; ++c) proof.magnitude[c] = std::max(proof.magnitude[c], down[c]);
  return proof;
}

}  // namespace shale
