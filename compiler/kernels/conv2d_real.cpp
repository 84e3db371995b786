// conv2d_real: conv2d of FP32 or FP16 on CPU drivers, weights in a texel buffer.
//
// Meaning of a workgroup: invocations of a row; one makes four output channels of `pixels` neighbouring pixels, its sums
// in registers. Four input channels of a pixel are one fetch (eight of FP16), and so are four weights. The order
// of a sum is the interpreter's, kernel rows, columns, then channels, each operation rounded alone: on a driver that
// keeps subnormal numbers the result has the interpreter's bits.
//
// Weights as literals, which serve int8, are no faster here: they hardly repeat, so that LLVM keeps each as 32 bytes on
// the stack, and the driver compiles for half a minute. Source: ours.
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "compiler/kernels/codegen.h"

namespace shale {
namespace {

constexpr int64_t kLocal = 8;     ///< invocations of a workgroup, along x
constexpr int64_t kChannels = 4;  ///< output channels of an invocation

int64_t groups(int64_t extent, int64_t each) { return (extent + each - 1) / each; }

class RealEmitter {
 public:
  RealEmitter(const GroupProblem& problem, const DeviceProfile& profile)
      : problem_(problem),
        graph_(*problem.graph),
        node_(graph_.node(*problem.group.head)),
        codegen_(problem),
        out_(graph_.value(node_.output).type.shape),
        taps_(graph_.value(node_.inputs[1]).type.shape),
        parts_{node_.inputs[0]},
        pixels_(std::min(2 * profile.live_sums / kChannels, out_[2])) {
    codegen_.read_as_texels(profile.caps.max_texel_elements);
    const std::optional<NodeId> producer = graph_.producers()[node_.inputs[0].index];
    if (!producer || !problem.group.contains(*producer)) return;
    const Node& view = graph_.node(*producer);
    if (view.op == Op::kConcat && view.attrs.get(Attr::kAxis) == 3) parts_ = view.inputs;
  }

  bool fits() const {
    return out_[0] * blocks() <= kMaxWorkgroups && out_[1] <= kMaxWorkgroups &&
           workgroups_x() <= kMaxWorkgroups;
  }

  /// Products, with those that fill tiles and blocks.
  double macs() const {
    return static_cast<double>(out_[0] * out_[1] * workgroups_x() * kLocal * pixels_) *
           static_cast<double>(blocks() * kChannels * taps_[1] * taps_[2] * taps_[3]);
  }

  KernelSource emit() {
    weights_ = codegen_.bind_constant(packed_weights(), BindingType::kUniformTexelBuffer);
    std::string text = fmt::format(
        "  int x = int(gl_GlobalInvocationID.x) * {};\n  int y = int(gl_GlobalInvocationID.y);\n"
        "  int n = int(gl_GlobalInvocationID.z) / {}, block = int(gl_GlobalInvocationID.z) % {};\n"
        "  if (x >= {}) return;\n  uint none = uint(x >= {});\n",
        pixels_, blocks(), blocks(), out_[2], INT32_MAX);
    for (int64_t p = 0; p < pixels_; ++p)
      text += fmt::format("  precise vec4 a{} = vec4(0.0);\n", p);
    text += fmt::format("  int w = block * {};\n", taps_[1] * taps_[2] * taps_[3]);
    text += loop("ky", taps_[1], loop("kx", taps_[2], tap()));
    for (int64_t p = 0; p < pixels_; ++p) text += results(p);
    KernelSource source;
    source.glsl = codegen_.finish(fmt::format("local_size_x = {}", kLocal), text);
    source.workgroups = {static_cast<uint32_t>(workgroups_x()), static_cast<uint32_t>(out_[1]),
                         static_cast<uint32_t>(out_[0] * blocks())};
    source.bindings = codegen_.bindings();
    return source;
  }

 private:
  const Shape& in() const { return graph_.value(node_.inputs[0]).type.shape; }
  int64_t blocks() const { return groups(out_[3], kChannels); }
  int64_t workgroups_x() const { return groups(groups(out_[2], pixels_), kLocal); }

  /// [block][tap][input channel] texels of the weights of four output channels.
  std::vector<uint8_t> packed_weights() const {
    const Value& weight = graph_.value(node_.inputs[1]);
    std::vector<uint8_t> bytes;
    const int64_t size = taps_[1] * taps_[2] * taps_[3];
    for (int64_t block = 0; block < blocks(); ++block)
      for (int64_t i = 0; i < size; ++i)
        for (int64_t lane = 0; lane < kChannels; ++lane) {
          const int64_t oc = block * kChannels + lane;
          const float w = oc < out_[3]
                              ? bits_real(weight.type.dtype, weight.constant->get(oc * size + i))
                              : 0.0f;
          const auto bits = std::bit_cast<std::array<uint8_t, 4>>(w);
          bytes.insert(bytes.end(), bits.begin(), bits.end());
        }
    return bytes;
  }

  /// A loop that is left at its end: after a condition at its start CPU drivers run the body once more, for no lane.
  static std::string loop(const std::string& name, int64_t end, const std::string& body,
                          int64_t step = 1) {
    return fmt::format(
        "  {{\n  int {0} = 0;\n  for (;;) {{\n{1}  {0} += {2};\n  if ({0} >= {3}) break;\n  }}\n  "
        "}}\n",
        name, body, step, end);
  }

  /// What a tap adds to all sums.
  std::string tap() {
    const auto ints = [&](Attr attr) { return node_.attrs.list(attr); };
    const auto pad = ints(Attr::kPad), stride = ints(Attr::kStride),
               dilation = ints(Attr::kDilation);
    // A place outside reads another and counts as 0, without a branch, both sides of which run anyway.
    std::string text = fmt::format(
        "  int iy = y * {} - {} + ky * {}, ix = x * {} - {} + kx * {};\n"
        "  bool in_y = uint(iy) < {}u;\n  iy = in_y ? iy : 0;\n",
        stride[0], pad[0], dilation[0], stride[1], pad[2], dilation[1], in()[1]);
    for (int64_t p = 0; p < pixels_; ++p)
      text += fmt::format(
          "  int x{0} = ix + {1};\n  bool in{0} = in_y && uint(x{0}) < {2}u;\n"
          "  x{0} = in{0} ? x{0} : 0;\n",
          p, p * stride[1], in()[2]);
    for (const ValueId part : parts_) text += products(part);
    return text;
  }

  /// What one of the tensors adds that are read as one.
  std::string products(ValueId part) {
    const TensorType& type = graph_.value(part).type;
    int64_t step = 16 / dtype_info(type.dtype).host_bytes;  // channels of a turn: those of a fetch
    while (type.shape[3] % step != 0) step /= 2;
    std::string turn;
    for (int64_t p = 0; p < pixels_; ++p)
      for (const Position& c : Position::run_at({"n", "iy", fmt::format("x{}", p), ""}, "c", step))
        turn += fmt::format("  float v{0}_{1} = {2};\n  v{0}_{1} = in{0} ? v{0}_{1} : 0.0;\n", p,
                            c.lane, codegen_.load(part, c));
    for (int64_t lane = 0; lane < step; ++lane) {
      turn += fmt::format("  vec4 w{0} = uintBitsToFloat(texelFetch(t{1}, w + {0}));\n", lane,
                          weights_);
      for (int64_t p = 0; p < pixels_; ++p)
        turn += fmt::format("  a{0} += v{0}_{1} * w{1};\n", p, lane);
    }
    turn += fmt::format("  w += {};\n", step);
    return loop("c", type.shape[3], turn, step);
  }

  /// Bias, the nodes behind and the stores of a pixel.
  std::string results(int64_t pixel) {
    std::string text = fmt::format("  if (x + {} < {}) {{\n", pixel, out_[2]);
    const ValueId bias = node_.inputs[2];
    const bool is_one = graph_.value(bias).type.shape[0] == 1;
    const DType dtype = graph_.value(node_.output).type.dtype;
    const bool whole = out_[3] % kChannels == 0;
    const int64_t length = whole ? codegen_.run_length(kChannels) : 1;
    const std::string first = fmt::format("(block * {})", kChannels);
    std::vector<std::string> values;
    Position run_start;
    for (const Position& at :
         Position::run_at({"n", "y", fmt::format("(x + {})", pixel), ""}, first, kChannels)) {
      const std::string own = fmt::format("{}_{}", pixel, at.lane);
      if (!whole) text += fmt::format("  if ({} < {}) {{\n", at.coords[3], out_[3]);
      Position channel = at;
      channel.coords = {at.coords[3]};
      text += fmt::format(
          "  {} = {};\n", Codegen::declare(dtype, "h" + own),
          Codegen::rounded(fmt::format("(a{}[{}] + {})", pixel, at.lane,
                                       is_one  ? codegen_.load(bias, {.coords = {"0"}})
                                       : whole ? codegen_.load(bias, channel)
                                               : codegen_.load(bias, {.coords = channel.coords})),
                           dtype));
      codegen_.locals()[node_.output] = "h" + own;
      const Position place = whole ? at : Position{.coords = at.coords};
      codegen_.epilogue(text, place, own);
      const std::string value = codegen_.load(problem_.group.result, place);
      if (!whole) {
        text += codegen_.store(problem_.group.result, place, value) + "  }\n";
        continue;
      }
      if (values.empty()) run_start = at;
      values.push_back(value);
      if (static_cast<int64_t>(values.size()) < length) continue;
      // A run shorter than the block begins where its own first element is.
      run_start.base = run_start.coords[3];
      text += codegen_.store_run(run_start, values);
      values.clear();
    }
    return text + "  }\n";
  }

  const GroupProblem& problem_;
  const Graph& graph_;
  const Node& node_;
  Codegen codegen_;
  const Shape& out_;
  const Shape& taps_;
  std::vector<ValueId> parts_;  ///< what is read, one after the other along the channels
  int64_t pixels_;
  size_t weights_ = 0;
};

}  // namespace

bool conv2d_real_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!profile.literal_weights || !problem.group.head) return false;
  const Graph& graph = *problem.graph;
  const Node& node = graph.node(*problem.group.head);
  if (node.op != Op::kConv2d || !is_float(graph.value(node.inputs[0]).type.dtype) ||
      op_kind(graph.node(problem.group.nodes.back())) == OpKind::kView)
    return false;
  const Value& weight = graph.value(node.inputs[1]);
  if (!weight.is_constant()) return false;
  // What is multiplied with the zeros around a picture has to be finite.
  for (int64_t i = 0; i < weight.constant->count(); ++i)
    if (!std::isfinite(bits_real(weight.type.dtype, weight.constant->get(i)))) return false;
  return static_cast<uint64_t>(weight.constant->count()) < profile.caps.max_texel_elements &&
         buffer_count(graph, problem.group.nodes) <
             std::min<uint64_t>({profile.caps.max_storage_buffers, profile.caps.max_texel_buffers,
                                 kMaxBindings}) &&
         RealEmitter(problem, profile).fits();
}

WorkTable conv2d_real_work(const GroupProblem& problem, const DeviceProfile& profile) {
  WorkTable work{};
  work[Work::kDispatch] = 1;
  work[Work::kRealMac] = RealEmitter(problem, profile).macs();
  work[Work::kRunResult] = static_cast<double>(
      element_count(problem.graph->value(problem.group.result).type.shape).value_or(0));
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

Result<std::vector<KernelSource>> conv2d_real_emit(const GroupProblem& problem,
                                                   const DeviceProfile& profile) {
  return std::vector<KernelSource>{RealEmitter(problem, profile).emit()};
}

}  // namespace shale
