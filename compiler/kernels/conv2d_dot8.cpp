// conv2d_s8_dot8: direct convolution by int8 dot products of four channels (OpSDotKHR), weights in
// a storage buffer.
//
// Meaning of a workgroup: 8 x 8 tiles of output pixels; an invocation makes a block of output
// channels for a tile of neighbouring pixels of a row, its sums in registers. Workgroups along z are
// images times blocks of channels. Weights lie as [block][tap][word][oc] words of four input
// channels, so one uvec4 read serves four output channels; the folded bias follows them. Input is
// read as words where channel counts allow, else by bytes; taps outside read the code that means
// zero, so there is no border to copy.
//
// Exact for all weights: sums are int32, and TOSA's legal results wrap back into range. Source:
// ours; the order of weights and the folded zero point as in nss.md section 8. Run on lavapipe
// only, not on a GPU.
#include <algorithm>

#include "compiler/kernels/gpu_conv.h"

namespace shale {
namespace {

constexpr int64_t kLocal = 8;  ///< tiles of a workgroup along x and y

/// What an invocation makes. Pixels times channels are the sums live at once.
struct Tile {
  int64_t pixels, channels;
};
/// In order of preference where none fits better: more channels share an input word, more pixels a
/// weight.
constexpr Tile kTiles[] = {{4, 8}, {3, 12}, {8, 4}};

/// The tile that fills up channels with the fewest that nobody needs.
Tile tile_for(int64_t channels) {
  return *std::min_element(std::begin(kTiles), std::end(kTiles), [&](Tile a, Tile b) {
    return ceil_div(channels, a.channels) * a.channels <
           ceil_div(channels, b.channels) * b.channels;
  });
}

class Dot8Emitter {
 public:
  explicit Dot8Emitter(const GroupProblem& problem)
      : conv_(problem),
        codegen_(problem),
        tile_(tile_for(conv_.out()[3])),
        blocks_(ceil_div(conv_.out()[3], tile_.channels)) {}

  KernelSource emit() {
    const int64_t vectors = blocks_ * conv_.taps() * conv_.words() * quads();
    weights_ = codegen_.bind_constant(pack());
    codegen_.add_function("#include \"dot8.glsl\"\n\n");
    conv_.declare_inputs(codegen_);
    conv_.declare_finish(codegen_, weights_, vectors);
    KernelSource source;
    source.workgroups = workgroups();
    const auto column = [&](int64_t i) {
      const int64_t width = tile_.pixels * kLocal;
      return Stretch{i * width, std::min((i + 1) * width, conv_.out()[2])};
    };
    codegen_.take_cells(source, column, kLocal);
    source.glsl = codegen_.finish(fmt::format("local_size_x = {0}, local_size_y = {0}", kLocal),
                                  sums() + results());
    source.bindings = codegen_.bindings();
    return source;
  }

  std::array<uint32_t, 3> workgroups() const {
    const Shape& out = conv_.out();
    return {static_cast<uint32_t>(ceil_div(out[2], tile_.pixels * kLocal)),
            static_cast<uint32_t>(ceil_div(out[1], kLocal)),
            static_cast<uint32_t>(out[0] * blocks_)};
  }

  /// Multiply-accumulates with those that fill blocks and words; not what hangs over the borders.
  double macs() const {
    const Shape& out = conv_.out();
    return static_cast<double>(out[0] * out[1] * out[2]) *
           static_cast<double>(blocks_ * tile_.channels * conv_.taps() * conv_.words() * 4);
  }

 private:
  int64_t quads() const { return tile_.channels / 4; }

  std::vector<uint8_t> pack() const {
    std::vector<uint8_t> bytes;
    for (int64_t block = 0; block < blocks_; ++block)
      for (int64_t tap = 0; tap < conv_.taps(); ++tap)
        for (int64_t word = 0; word < conv_.words(); ++word)
          for (int64_t oc = 0; oc < tile_.channels; ++oc)
            for (int64_t lane = 0; lane < 4; ++lane)
              bytes.push_back(static_cast<uint8_t>(
                  conv_.stored_weight(block * tile_.channels + oc, tap, 4 * word + lane)));
    conv_.append_bias(bytes, blocks_ * tile_.channels);
    return bytes;
  }

  std::string sums() {
    const Shape& out = conv_.out();
    const Shape& weight = conv_.weight();
    const std::span<const int64_t> pad = conv_.list(Attr::kPad), stride = conv_.list(Attr::kStride),
                                   dilation = conv_.list(Attr::kDilation);
    std::string text = fmt::format(
        "  int x = int({0}.x) * {1};\n  int y = int({0}.y);\n  int n = int({0}.z) / {2};\n"
        "  int block = int({0}.z) % {2};\n  if (x >= {3} || y >= {4}) return;\n",
        codegen_.invocation(), tile_.pixels, blocks_, out[2], out[1]);
    for (int64_t p = 0; p < tile_.pixels; ++p) {
      for (int64_t q = 0; q < quads(); ++q)
        text += fmt::format("  ivec4 a{}_{} = ivec4(0);\n", p, q);
      // The weights' zero point takes its share of the sum of the inputs.
      if (conv_.weight_zp() != 0) text += fmt::format("  int s{} = 0;\n", p);
    }
    text += fmt::format(
        "  int w = block * {};\n  for (int ky = 0; ky < {}; ++ky)\n"
        "  for (int kx = 0; kx < {}; ++kx) {{\n"
        "    int iy = y * {} - {} + ky * {}, ix = x * {} - {} + kx * {};\n",
        conv_.taps() * conv_.words() * quads(), weight[1], weight[2], stride[0], pad[0],
        dilation[0], stride[1], pad[2], dilation[1]);
    for (size_t i = 0; i < conv_.parts().size(); ++i) text += part(i, stride[1]);
    return text + "  }\n";
  }

  /// What one tensor adds at a tap.
  std::string part(size_t index, int64_t stride) const {
    const GpuConv::Part& part = conv_.parts()[index];
    std::string text = "    {\n";
    for (int64_t p = 0; p < tile_.pixels; ++p)
      text += fmt::format("    uint f{0}; int p{0} = locate{1}(n, iy, ix + {2}, f{0});\n", p, index,
                          p * stride);
    text += fmt::format("    for (int k = 0; k < {}; ++k, w += {}) {{\n", part.words(), quads());
    for (int64_t q = 0; q < quads(); ++q)
      text += fmt::format("      uvec4 w{0} = b{1}.d[w + {0}];\n", q, weights_);
    for (int64_t p = 0; p < tile_.pixels; ++p) {
      text += fmt::format("      uint t{0} = p{0} < 0 ? f{0} : word{1}(p{0}, k);\n", p, index);
      for (int64_t q = 0; q < quads(); ++q)
        text += fmt::format("      a{0}_{1} += dot4_s8(t{0}, w{1});\n", p, q);
      if (conv_.weight_zp() != 0) text += fmt::format("      s{0} += {1};\n", p, sum_of(part, p));
    }
    return text + "    }\n    }\n";
  }

  /// Sum of the channels of an input word; what fills the last word does not count.
  static std::string sum_of(const GpuConv::Part& part, int64_t p) {
    if (part.in_words()) return fmt::format("dot_s8(t{}, 0x01010101u)", p);
    return fmt::format("dot_s8(t{}, k < {} ? 0x01010101u : {:#010x}u)", p, part.words() - 1,
                       0x01010101u >> (8 * (4 * part.words() - part.channels)));
  }

  std::string results() const {
    std::string text;
    for (int64_t p = 0; p < tile_.pixels; ++p)
      for (int64_t q = 0; q < quads(); ++q) {
        std::string sum = fmt::format("a{}_{}", p, q);
        if (conv_.weight_zp() != 0)
          sum += fmt::format(" - {} * s{}", Codegen::literal(conv_.weight_zp()), p);
        text += fmt::format("  finish({}, n, y, x + {}, block * {} + {});\n", sum, p,
                            tile_.channels, 4 * q);
      }
    return text;
  }

  GpuConv conv_;
  Codegen codegen_;
  Tile tile_;
  int64_t blocks_;
  size_t weights_ = 0;
};

}  // namespace

bool conv2d_dot8_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!profile.caps.features.has(Feature::kDotProduct8) || !GpuConv::supports(problem, profile))
    return false;
  const Shape& out = problem.graph->value(problem.group.result).type.shape;
  const Tile tile = tile_for(out[3]);
  return ceil_div(out[2], tile.pixels * kLocal) <= kMaxWorkgroups &&
         ceil_div(out[1], kLocal) <= kMaxWorkgroups &&
         out[0] * ceil_div(out[3], tile.channels) <= kMaxWorkgroups;
}

WorkTable conv2d_dot8_work(const GroupProblem& problem, const DeviceProfile&) {
  return gpu_conv_work(problem, Work::kDotMac, Dot8Emitter(problem).macs());
}

Result<std::vector<KernelSource>> conv2d_dot8_emit(const GroupProblem& problem,
                                                   const DeviceProfile&) {
  return std::vector<KernelSource>{Dot8Emitter(problem).emit()};
}

}  // namespace shale
