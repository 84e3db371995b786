// conv2d_s8_loop: direct convolution on CPU drivers with the weights in a texel buffer, for layers
// that are not worth code of their own: many weights on few pixels, or few runs.
//
// Meaning of a workgroup: 8 invocations of a row; an invocation makes four output channels of up to
// kPixels neighbouring pixels, its sums in registers. Blocks of channels are neighbours, so lanes
// are busy on pictures of a few pixels too. Weights lie as [block][tap][word] texels of 4 output by
// 4 input channels; inputs are texels of 16 or 4 channels, or bytes.
//
// Exact for all weights: products of bytes are summed in float32 while the largest possible sum,
// 128 * sum(|w|), stays below 2^24, for a whole output channel or for a run of input channels; runs
// are summed in int32, and TOSA's legal results wrap back into range. Source: ours.
#include <algorithm>
#include <cstdlib>

#include "compiler/kernels/gpu_conv.h"
#include "compiler/kernels/literal_conv.h"

namespace shale {
namespace {

constexpr int64_t kLocal = 8;     ///< invocations of a workgroup, along x
constexpr int64_t kChannels = 4;  ///< output channels of an invocation
constexpr int64_t kPixels = 4;    ///< most output pixels of one

class LoopEmitter {
 public:
  explicit LoopEmitter(const GroupProblem& problem)
      : conv_(problem),
        codegen_(problem),
        input_(problem.graph->node(*problem.group.head).inputs[0]),
        pixels_(std::min(kPixels, conv_.out()[2])),
        blocks_(ceil_div(conv_.out()[3], kChannels)) {
    for (int64_t oc = 0; oc < conv_.out()[3]; ++oc) {
      int64_t sum = 0;
      for (int64_t tap = 0; tap < conv_.taps(); ++tap)
        for (int64_t slot = 0; slot < 4 * conv_.words(); ++slot) {
          const int64_t weight = std::abs(conv_.centred_weight(oc, tap, slot));
          sum += weight;
          largest_ = std::max(largest_, weight);
        }
      largest_sum_ = std::max(largest_sum_, sum);
    }
  }

  bool fits(const DeviceCaps& caps) const {
    const auto is_texels = [&](const GpuConv::Part& part) {
      return element_count(codegen_.value(part.value).type.shape).value_or(0) / texel_bytes(part) <=
             static_cast<int64_t>(caps.max_texel_elements);
    };
    return conv_.centred_weights_are_int8() && workgroups_x() <= kMaxWorkgroups &&
           conv_.out()[1] <= kMaxWorkgroups && conv_.out()[0] <= kMaxWorkgroups &&
           blocks_ * conv_.taps() * conv_.words() <=
               static_cast<int64_t>(caps.max_texel_elements) &&
           std::all_of(conv_.parts().begin(), conv_.parts().end(), is_texels);
  }

  /// Multiply-accumulates with those that fill tiles, blocks and words.
  double macs() const {
    return static_cast<double>(conv_.out()[0] * conv_.out()[1] * workgroups_x() * kLocal) *
           static_cast<double>(pixels_ * kChannels * conv_.taps() * conv_.words() * 4);
  }

  KernelSource emit() {
    weights_ = codegen_.bind_constant(pack(), BindingType::kUniformTexelBuffer);
    std::vector<uint8_t> bias;
    conv_.append_bias(bias, blocks_ * kChannels);
    const size_t bias_at = codegen_.bind_constant(std::move(bias));
    for (size_t i = 0; i < conv_.parts().size(); ++i) declare_part(i);
    conv_.declare_finish(codegen_, bias_at, 0);
    KernelSource source;
    source.workgroups = {static_cast<uint32_t>(workgroups_x()),
                         static_cast<uint32_t>(conv_.out()[1]),
                         static_cast<uint32_t>(conv_.out()[0])};
    const auto column = [&](int64_t i) {
      return Stretch{i * kLocal / blocks_ * pixels_,
                     std::min((((i + 1) * kLocal - 1) / blocks_ + 1) * pixels_, conv_.out()[2])};
    };
    codegen_.take_cells(source, column, 1);
    source.glsl = codegen_.finish(fmt::format("local_size_x = {}", kLocal), body());
    source.bindings = codegen_.bindings();
    return source;
  }

 private:
  int64_t tiles() const { return ceil_div(conv_.out()[2], pixels_); }
  int64_t workgroups_x() const { return ceil_div(tiles() * blocks_, kLocal); }
  /// One float sum serves the whole of an output channel.
  bool sums_fit() const { return 128 * largest_sum_ < kFloatExact; }
  /// Words of four channels that one float sum may take.
  int64_t run_words() const {
    return (kFloatExact - 1) / (4 * 128 * std::max<int64_t>(largest_, 1));
  }
  /// Words of a texel of the part's input.
  static int64_t texel_words(const GpuConv::Part& part) { return part.channels % 16 == 0 ? 4 : 1; }

  static int64_t texel_bytes(const GpuConv::Part& part) {
    return part.in_words() ? 4 * texel_words(part) : 1;
  }

  std::vector<uint8_t> pack() const {
    std::vector<uint8_t> bytes;
    for (int64_t block = 0; block < blocks_; ++block)
      for (int64_t tap = 0; tap < conv_.taps(); ++tap)
        for (int64_t word = 0; word < conv_.words(); ++word)
          for (int64_t oc = 0; oc < kChannels; ++oc)
            for (int64_t lane = 0; lane < 4; ++lane)
              bytes.push_back(static_cast<uint8_t>(
                  conv_.centred_weight(block * kChannels + oc, tap, 4 * word + lane)));
    return bytes;
  }

  /// int locate<i>(n, y, x, out fill), as GpuConv has it but in texels; texel<i>(at, k, fill) is the
  /// k-th texel there, of the code `fill` outside.
  void declare_part(size_t index) {
    const GpuConv::Part& part = conv_.parts()[index];
    const Shape& shape = codegen_.value(part.value).type.shape;
    const int64_t wide = texel_words(part);
    const ImageFormat format = wide == 4         ? ImageFormat::kRgba32Uint
                               : part.in_words() ? ImageFormat::kR32Uint
                                                 : ImageFormat::kR8Sint;
    const size_t binding =
        codegen_.bind(part.value, BindingType::kUniformTexelBuffer, format, false);
    const int64_t texels = part.in_words() ? part.words() / wide : part.channels;
    // Where no view is folded, without a branch, both sides of which a CPU driver runs anyway.
    const std::string place =
        fmt::format("((n * {} + y) * {} + x) * {}", shape[1], shape[2], texels);
    const std::string body = part.value == input_
                                 ? fmt::format(
                                       "  fill = {:#010x}u;\n  int at = {};\n"
                                       "  bool inside = uint(y) < {}u && uint(x) < {}u;\n"
                                       "  return inside ? at : -1;\n",
                                       static_cast<uint32_t>(conv_.input_zp() & 255) * 0x01010101u,
                                       place, shape[1], shape[2])
                                 : fmt::format("{}  return {};\n", part.steps, place);
    codegen_.add_function(
        fmt::format("int locate{}(int n, int y, int x, out uint fill) {{\n{}}}\n\n", index, body));
    std::string fetch;
    if (part.in_words()) {
      fetch = fmt::format("  {} word = texelFetch(t{}, max(at, 0) + k){};\n", type(wide), binding,
                          wide == 4 ? "" : ".x");
    } else {
      fetch = "  uint word = 0u;\n";
      for (int64_t lane = 0; lane < 4; ++lane) {
        const std::string byte =
            fmt::format("(uint(texelFetch(t{}, max(at, 0) + 4 * k + {}).x) & 255u) << {}", binding,
                        lane, 8 * lane);
        const bool always = lane < part.channels - 4 * (part.words() - 1);
        fetch += always ? fmt::format("  word |= {};\n", byte)
                        : fmt::format("  if (k < {}) word |= {};\n", part.words() - 1, byte);
      }
    }
    // What fills the last word of an odd number of channels meets weights of 0.
    codegen_.add_function(fmt::format(
        "{0} texel{1}(int at, int k, uint fill) {{\n{2}  return at < 0 ? {0}(fill) : word;\n}}\n\n",
        type(wide), index, fetch));
  }

  static const char* type(int64_t words) { return words == 4 ? "uvec4" : "uint"; }

  std::string body() const {
    const Shape& out = conv_.out();
    const std::span<const int64_t> pad = conv_.list(Attr::kPad), stride = conv_.list(Attr::kStride),
                                   dilation = conv_.list(Attr::kDilation);
    std::string text = fmt::format(
        "  int id = int({0}.x);\n  int block = id % {1};\n  int x = id / {1} * "
        "{2};\n  int y = int({0}.y);\n  int n = int({0}.z);\n"
        "  if (x >= {3}) return;\n",
        codegen_.invocation(), blocks_, pixels_, out[2]);
    if (codegen_.has_cells()) text += fmt::format("  if (y >= {}) return;\n", out[1]);
    text += declare_sums(sums_fit() ? "vec4" : "ivec4", "a");
    std::string taps =
        fmt::format("  int iy = y * {} - {} + ky * {}, ix = x * {} - {} + kx * {};\n", stride[0],
                    pad[0], dilation[0], stride[1], pad[2], dilation[1]);
    for (size_t i = 0; i < conv_.parts().size(); ++i) taps += part(i, stride[1]);
    text += fmt::format("  int w = block * {};\n", conv_.taps() * conv_.words());
    text += loop("ky", "0", conv_.weight()[1], loop("kx", "0", conv_.weight()[2], taps));
    for (int64_t p = 0; p < pixels_; ++p)
      text += fmt::format("  finish(ivec4(a{0}), n, y, x + {0}, block * {1});\n", p, kChannels);
    return text;
  }

  /// A loop that is left at its end: after a condition at its start CPU drivers run the body once
  /// more, for no lane. None where there is one turn.
  static std::string loop(const std::string& name, const std::string& from, const std::string& end,
                          const std::string& body, int64_t step = 1) {
    return fmt::format(
        "  {{\n  int {0} = {1};\n  for (;;) {{\n{2}  {0} += {3};\n  if ({0} >= {4}) break;\n  }}\n "
        " }}\n",
        name, from, body, step, end);
  }
  static std::string loop(const std::string& name, const std::string& from, int64_t end,
                          const std::string& body, int64_t step = 1) {
    if (end <= step) return fmt::format("  {{\n  const int {} = {};\n{}  }}\n", name, from, body);
    return loop(name, from, std::to_string(end), body, step);
  }

  std::string declare_sums(const char* type, const char* name) const {
    std::string text;
    for (int64_t p = 0; p < pixels_; ++p)
      text += fmt::format("  {0} {1}{2} = {0}(0);\n", type, name, p);
    return text;
  }

  /// What one tensor adds at a tap.
  std::string part(size_t index, int64_t stride) const {
    const GpuConv::Part& part = conv_.parts()[index];
    const int64_t wide = texel_words(part), count = part.words() / wide;
    std::string text = "    {\n";
    for (int64_t p = 0; p < pixels_; ++p)
      text += fmt::format("    uint f{0}; int p{0} = locate{1}(n, iy, ix + {2}, f{0});\n", p, index,
                          p * stride);
    if (sums_fit()) {
      text += loop("k", "0", count, step(index, wide, "a"));
    } else {
      // As many texels as a float32 sum may take, of each run one after the other.
      const int64_t run = std::clamp<int64_t>(run_words() / wide, 1, count);
      std::string sums = declare_sums("vec4", "s");
      sums +=
          loop("k", "from", fmt::format("min(from + {}, {})", run, count), step(index, wide, "s"));
      for (int64_t p = 0; p < pixels_; ++p) sums += fmt::format("  a{0} += ivec4(s{0});\n", p);
      text += loop("from", "0", count, sums, run);
    }
    return text + "    }\n";
  }

  /// The products of one texel of each pixel.
  std::string step(size_t index, int64_t wide, const char* sums) const {
    std::string text;
    for (int64_t p = 0; p < pixels_; ++p)
      text += fmt::format("      {} q{} = texel{}(p{}, k, f{});\n", type(wide), p, index, p, p);
    for (int64_t word = 0; word < wide; ++word) {
      text += fmt::format("      {{\n      ivec4 v = ivec4(texelFetch(t{}, w + {}));\n", weights_,
                          word);
      for (int64_t p = 0; p < pixels_; ++p)
        text += fmt::format("      int u{0} = int(q{0}{1});\n", p,
                            wide == 4 ? fmt::format("[{}]", word) : "");
      for (const int lane : {0, 1, 2, 3}) {
        const auto byte = [&](const std::string& of) {
          return lane == 3 ? of + " >> 24" : fmt::format("({} << {}) >> 24", of, 24 - 8 * lane);
        };
        text += fmt::format("      vec4 v{} = vec4({});\n", lane, byte("v"));
        for (int64_t p = 0; p < pixels_; ++p)
          text += fmt::format("      {0}{1} += v{2} * float({3});\n", sums, p, lane,
                              byte(fmt::format("u{}", p)));
      }
      text += "      }\n";
    }
    return text + fmt::format("      w += {};\n", wide);
  }

  GpuConv conv_;
  Codegen codegen_;
  ValueId input_;
  int64_t pixels_, blocks_;
  int64_t largest_ = 0, largest_sum_ = 0;  ///< of |weight|, and of their sums by output channel
  size_t weights_ = 0;
};

}  // namespace

bool conv2d_loop_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!profile.literal_weights || !GpuConv::takes(problem)) return false;
  return LoopEmitter(problem).fits(profile.caps);
}

WorkTable conv2d_loop_work(const GroupProblem& problem, const DeviceProfile&) {
  WorkTable work = gpu_conv_work(problem, Work::kLoopMac, LoopEmitter(problem).macs());
  // An element is made as by the kernel of runs, and finding the place of a tap takes as long.
  const Node& head = problem.graph->node(*problem.group.head);
  const Shape& taps = problem.graph->value(head.inputs[1]).type.shape;
  work[Work::kRunResult] = static_cast<double>(
      element_count(problem.graph->value(problem.group.result).type.shape).value_or(0) *
      (1 + taps[1] * taps[2]));
  return work;
}

Result<std::vector<KernelSource>> conv2d_loop_emit(const GroupProblem& problem,
                                                   const DeviceProfile&) {
  return std::vector<KernelSource>{LoopEmitter(problem).emit()};
}

}  // namespace shale
