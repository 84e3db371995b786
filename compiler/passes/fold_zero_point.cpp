// Folds the zero points of int8 convolutions into bias and weights, so that kernels multiply raw
// bytes:
//
//   sum (x - zp) * (w - wzp) + b  =  sum x * w' + (b - zp * sum w'),   w' = w - wzp
//
// A padded tap contributes nothing, that is, it reads zp; so the pads become a PAD node with that
// value, which fuse-views folds into the convolution's addressing again.
#include <algorithm>

#include "compiler/passes/pass.h"

namespace shale {
namespace {

constexpr size_t kInput = 0, kWeight = 1, kBias = 2, kInputZp = 3, kWeightZp = 4;

struct Folded {
  std::vector<int64_t> weight, bias;
};

/// Output channel of a weight element: OHWI for conv2d, [KH,KW,C,M] for depthwise.
size_t channel_of(Op op, size_t element, size_t elements, size_t channels) {
  return op == Op::kDepthwiseConv2d ? element % channels : element / (elements / channels);
}

/// Nothing if the new weights or biases leave their types.
std::optional<Folded> fold(const Graph& graph, const Node& node, int64_t zp, int64_t weight_zp) {
  const size_t channels = static_cast<size_t>(graph.value(node.output).type.shape.back());
  Folded folded{graph.value(node.inputs[kWeight]).constant->ints(),
                graph.value(node.inputs[kBias]).constant->ints()};
  if (folded.bias.size() == 1) folded.bias.resize(channels, folded.bias[0]);
  std::vector<int64_t> sums(channels);
  for (size_t i = 0; i < folded.weight.size(); ++i) {
    folded.weight[i] -= weight_zp;
    if (folded.weight[i] < -128 || folded.weight[i] > 127) return std::nullopt;
    sums[channel_of(node.op, i, folded.weight.size(), channels)] += folded.weight[i];
  }
  const IntRange range = dtype_range(DType::kInt32);
  for (size_t c = 0; c < channels; ++c) {
    folded.bias[c] -= zp * sums[c];
    if (folded.bias[c] < range.min || folded.bias[c] > range.max) return std::nullopt;
  }
  return folded;
}

bool is_candidate(const Graph& graph, const Node& node) {
  if (node.op != Op::kConv2d && node.op != Op::kDepthwiseConv2d) return false;
  if (graph.value(node.inputs[kInput]).type.dtype != DType::kInt8) return false;
  if (graph.value(node.inputs[kWeight]).type.dtype != DType::kInt8) return false;
  for (const size_t operand : {kWeight, kBias, kInputZp, kWeightZp})
    if (!graph.value(node.inputs[operand]).is_constant()) return false;
  return true;
}

}  // namespace

Result<Change> fold_zero_point(Graph& graph, const PassContext&) {
  Change change = Change::kNone;
  std::vector<Node> result;
  std::vector<Node> nodes = std::move(graph.nodes);
  graph.nodes.clear();
  for (Node& node : nodes) {
    if (!is_candidate(graph, node)) {
      result.push_back(std::move(node));
      continue;
    }
    const int64_t zp = graph.value(node.inputs[kInputZp]).constant->get(0);
    const int64_t weight_zp = graph.value(node.inputs[kWeightZp]).constant->get(0);
    const std::optional<Folded> folded =
        zp == 0 && weight_zp == 0 ? std::nullopt : fold(graph, node, zp, weight_zp);
    if (!folded) {
      result.push_back(std::move(node));
      continue;
    }
    change = Change::kChanged;
    const std::string name = graph.value(node.output).name;
    const std::span<const int64_t> pad = node.attrs.list(Attr::kPad);
    if (zp != 0 && std::any_of(pad.begin(), pad.end(), [](int64_t p) { return p != 0; })) {
      const TensorType input = graph.value(node.inputs[kInput]).type;
      TensorType padded = input;
      padded.shape[1] += pad[0] + pad[1];
      padded.shape[2] += pad[2] + pad[3];
      const ValueId padding =
          graph.add_shape(name + ".padding", {0, 0, pad[0], pad[1], pad[2], pad[3], 0, 0});
      const ValueId value = graph.add_constant(
          name + ".pad_value", Tensor::from_ints({input.dtype, {1}}, std::vector<int64_t>{zp}));
      const ValueId pad_result = graph.add_value(name + ".padded", padded);
      result.push_back({Op::kPad, {}, {node.inputs[kInput], padding, value}, pad_result, 0});
      node.inputs[kInput] = pad_result;
      node.attrs.set(Attr::kPad, std::vector<int64_t>{0, 0, 0, 0});
    }
    const auto constant = [&](const char* suffix, TensorType type,
                              const std::vector<int64_t>& values) {
      return graph.add_constant(name + suffix, Tensor::from_ints(std::move(type), values));
    };
    const Shape weight_shape = graph.value(node.inputs[kWeight]).type.shape;
    const int64_t channels = static_cast<int64_t>(folded->bias.size());
    if (weight_zp != 0)
      node.inputs[kWeight] = constant(".weight", {DType::kInt8, weight_shape}, folded->weight);
    node.inputs[kBias] = constant(".bias", {DType::kInt32, {channels}}, folded->bias);
    node.inputs[kInputZp] = node.inputs[kWeightZp] = constant(".zero", {DType::kInt8, {1}}, {0});
    result.push_back(std::move(node));
  }
  graph.nodes = std::move(result);
  return change;
}

}  // namespace shale
