#include "compiler/kernels/gpu_conv.h"

#include <algorithm>

namespace shale {
namespace {

const Node& head_of(const GroupProblem& problem) {
  return problem.graph->node(*problem.group.head);
}

/// True if only pads, resizes and concats of the axes that `GpuConv::walk` knows lie between the
/// value and memory.
bool views_are_known(const GroupProblem& problem, ValueId id,
                     const std::vector<std::optional<NodeId>>& producers) {
  const Graph& graph = *problem.graph;
  const std::optional<NodeId> producer = producers[id.index];
  if (!producer || !problem.group.contains(*producer)) return true;
  const Node& node = graph.node(*producer);
  if (node.op == Op::kPad) {
    const std::vector<int64_t> padding = graph.value(node.inputs[1]).constant->ints();
    for (const size_t i : {0u, 1u, 6u, 7u})
      if (padding[i] != 0) return false;
    if (!graph.value(node.inputs[2]).is_constant()) return false;
  } else if (node.op == Op::kConcat) {
    if (node.attrs.get(Attr::kAxis) != 3) return false;
  } else if (node.op != Op::kResize) {
    return false;
  }
  const size_t sources = node.op == Op::kConcat ? node.inputs.size() : 1;
  return std::all_of(node.inputs.begin(),
                     node.inputs.begin() + static_cast<std::ptrdiff_t>(sources),
                     [&](ValueId source) { return views_are_known(problem, source, producers); });
}

/// Four equal bytes as a GLSL word.
std::string word_of(int64_t code) {
  return fmt::format("{:#010x}u", static_cast<uint32_t>(code & 255) * 0x01010101u);
}

}  // namespace

bool GpuConv::supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return !profile.literal_weights && takes(problem);
}

bool GpuConv::takes(const GroupProblem& problem) {
  if (!problem.group.head) return false;
  const Graph& graph = *problem.graph;
  const Node& node = head_of(problem);
  if (node.op != Op::kConv2d) return false;
  for (const size_t operand : {0u, 1u})
    if (graph.value(node.inputs[operand]).type.dtype != DType::kInt8) return false;
  if (!graph.value(node.inputs[1]).is_constant() || !graph.value(node.inputs[2]).is_constant())
    return false;
  if (op_kind(graph.node(problem.group.nodes.back())) == OpKind::kView) return false;
  return views_are_known(problem, node.inputs[0], graph.producers());
}

GpuConv::GpuConv(const GroupProblem& problem)
    : problem_(problem),
      graph_(*problem.graph),
      node_(head_of(problem)),
      producers_(graph_.producers()) {
  walk(node_.inputs[0], fmt::format("  fill = {};\n", word_of(input_zp())), false);
  int64_t channel = 0;
  for (Part& part : parts_) {
    part.first_word = words();
    for (int64_t c = 0; c < 4 * part.words(); ++c)
      channel_of_slot_.push_back(c < part.channels ? channel + c : -1);
    channel += part.channels;
  }
}

void GpuConv::walk(ValueId id, std::string steps, bool checked) {
  const Shape& shape = graph_.value(id).type.shape;
  if (!checked)
    steps +=
        fmt::format("  if (uint(y) >= {}u || uint(x) >= {}u) return -1;\n", shape[1], shape[2]);
  const std::optional<NodeId> producer = producers_[id.index];
  if (!producer || !problem_.group.contains(*producer)) {
    parts_.push_back({.value = id, .channels = shape[3], .first_word = 0, .steps = steps});
    return;
  }
  const Node& node = graph_.node(*producer);
  const auto ints = [&](size_t index) { return graph_.value(node.inputs[index]).constant->ints(); };
  if (node.op == Op::kConcat) {
    for (const ValueId part : node.inputs) walk(part, steps, true);
    return;
  }
  if (node.op == Op::kPad) {
    const std::vector<int64_t> padding = ints(1);
    steps += fmt::format("  y -= {};\n  x -= {};\n  fill = {};\n", padding[2], padding[4],
                         word_of(graph_.value(node.inputs[2]).constant->get(0)));
  } else {
    const Shape& from = graph_.value(node.inputs[0]).type.shape;
    const std::vector<int64_t> scale = ints(1), offset = ints(2);
    for (const size_t axis : {0u, 1u})
      steps += fmt::format("  {0} = nearest({0}, {1}, {2}, {3}, {4});\n", axis == 0 ? "y" : "x",
                           scale[2 * axis], scale[2 * axis + 1], Codegen::literal(offset[axis]),
                           from[axis + 1]);
  }
  walk(node.inputs[0], steps, false);
}

int64_t GpuConv::stored_weight(int64_t oc, int64_t tap, int64_t slot) const {
  const int64_t channel = channel_of_slot_[static_cast<size_t>(slot)];
  if (channel < 0 || oc >= weight()[0]) return 0;
  return graph_.value(node_.inputs[1]).constant->get((oc * taps() + tap) * weight()[3] + channel);
}

int64_t GpuConv::centred_weight(int64_t oc, int64_t tap, int64_t slot) const {
  const bool fills = channel_of_slot_[static_cast<size_t>(slot)] < 0 || oc >= weight()[0];
  return fills ? 0 : stored_weight(oc, tap, slot) - weight_zp();
}

bool GpuConv::centred_weights_are_int8() const {
  if (weight_zp() == 0) return true;
  const std::vector<int64_t> stored = graph_.value(node_.inputs[1]).constant->ints();
  return std::all_of(stored.begin(), stored.end(), [&](int64_t w) {
    return w - weight_zp() >= INT8_MIN && w - weight_zp() <= INT8_MAX;
  });
}

int32_t GpuConv::folded_bias(int64_t oc) const {
  if (oc >= weight()[0]) return 0;
  const Tensor& bias = *graph_.value(node_.inputs[2]).constant;
  const Tensor& weights = *graph_.value(node_.inputs[1]).constant;
  const int64_t products = taps() * weight()[3];
  int64_t sum = 0;
  for (int64_t i = 0; i < products; ++i) sum += weights.get(oc * products + i) - weight_zp();
  const int64_t folded = bias.get(bias.count() == 1 ? 0 : oc) - input_zp() * sum;
  return static_cast<int32_t>(static_cast<uint64_t>(folded));
}

void GpuConv::append_bias(std::vector<uint8_t>& bytes, int64_t channels) const {
  for (int64_t oc = 0; oc < channels; ++oc) {
    const uint32_t bias = static_cast<uint32_t>(folded_bias(oc));
    for (const int shift : {0, 8, 16, 24}) bytes.push_back(static_cast<uint8_t>(bias >> shift));
  }
}

void GpuConv::declare_inputs(Codegen& codegen) const {
  for (size_t i = 0; i < parts_.size(); ++i) {
    const Part& part = parts_[i];
    const Shape& shape = graph_.value(part.value).type.shape;
    const bool words = part.in_words();
    const size_t binding = codegen.bind(part.value, BindingType::kStorageBuffer,
                                        words ? ImageFormat::kR32Uint : ImageFormat::kNone, false);
    codegen.add_function(fmt::format(
        "int locate{}(int n, int y, int x, out uint fill) {{\n{}  return ((n * {} + y) * {} + x) * "
        "{};\n}}\n\n",
        i, part.steps, shape[1], shape[2], words ? part.words() : part.channels));
    std::string body;
    if (words) {
      body = fmt::format("  return b{}.d[at + k];\n", binding);
    } else {
      body = "  at += 4 * k;\n";
      for (int64_t lane = 0; lane < 4; ++lane) {
        // The last word holds what is left, and must not reach beyond the tensor.
        const bool always = lane < part.channels - 4 * (part.words() - 1);
        const std::string byte =
            fmt::format("(uint(int(b{}.d[at + {}])) & 255u) << {}", binding, lane, 8 * lane);
        body += lane == 0 ? fmt::format("  uint w = {};\n", byte)
                : always  ? fmt::format("  w |= {};\n", byte)
                          : fmt::format("  if (k < {}) w |= {};\n", part.words() - 1, byte);
      }
      body += "  return w;\n";
    }
    codegen.add_function(fmt::format("uint word{}(int at, int k) {{\n{}}}\n\n", i, body));
  }
}

void GpuConv::declare_finish(Codegen& codegen, size_t binding, int64_t first) const {
  const Shape& shape = out();
  const Value& result = graph_.value(problem_.group.result);
  const Position at{{"n", "y", "x", "c"}, {}};
  std::string body;
  codegen.locals()[node_.output] = "h";
  codegen.epilogue(body, at, "");
  body += fmt::format("  return {};\n", codegen.load(problem_.group.result, at));
  const char* type = Codegen::register_type(result.type.dtype);
  codegen.add_function(
      fmt::format("{} value(int h, int n, int y, int x, int c) {{\n{}}}\n\n", type, body));

  std::string stores;
  // Four int8 results make a word of the result buffer where channels allow it.
  if (result.type.dtype == DType::kInt8 && shape[3] % 4 == 0) {
    const size_t to = codegen.bind(problem_.group.result, BindingType::kStorageBuffer,
                                   ImageFormat::kR32Uint, true);
    std::string word;
    for (int lane = 0; lane < 4; ++lane)
      word += fmt::format("{}(value(h[{}], n, y, x, c + {}) & 255) << {}", lane > 0 ? " | " : "",
                          lane, lane, 8 * lane);
    stores = fmt::format("  b{}.d[((n * {} + y) * {} + x) * {} + c / 4] = uint({});\n", to,
                         shape[1], shape[2], shape[3] / 4, word);
  } else {
    for (int lane = 0; lane < 4; ++lane) {
      const std::string c = fmt::format("(c + {})", lane);
      stores += fmt::format("  if ({} >= {}) return;\n{}", c, shape[3],
                            codegen.store(problem_.group.result, {{"n", "y", "x", c}, {}},
                                          fmt::format("value(h[{}], n, y, x, {})", lane, c)));
    }
  }
  codegen.add_function(
      fmt::format("void finish(ivec4 h, int n, int y, int x, int c) {{\n  if (x >= {} || c >= {}) "
                  "return;\n  h += ivec4(b{}.d[{} + c / 4]);\n{}}}\n\n",
                  shape[2], shape[3], binding, first, stores));
}

WorkTable gpu_conv_work(const GroupProblem& problem, Work kind, double macs) {
  WorkTable work{};
  work[Work::kDispatch] = 1;
  work[kind] = macs;
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

}  // namespace shale
