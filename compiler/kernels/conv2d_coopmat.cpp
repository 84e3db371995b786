// conv2d_s8_coopmat: convolution as products of int8 matrices (VK_KHR_cooperative_matrix), M pixels
// by N output channels by K input bytes at a time, of a shape that the device has.
//
// Meaning of a workgroup: one subgroup makes neighbouring pixels of a row, 16 of them or M if that
// is more, and as many blocks of N output channels as its accumulators have room for. The taps'
// words of channels form one line of bytes; chunks of it are staged for the pixels in shared memory
// by plain code, which knows borders, views and channel counts. Chunks alternate between two
// halves, so one barrier a chunk is enough: nobody writes a half before all have passed the barrier
// after its last reading. Weights lie as [step of K bytes][block of N oc] matrices, by rows or by
// columns, whichever fill lines of 16 bytes better; the folded bias follows them. Sums go through
// shared memory into the fused nodes.
//
// Exact for all weights that are int8 without their zero point: sums are int32. Source: ours; one
// subgroup per 16 pixels and the small shared memory as in nss.md section 8. Run on lavapipe of
// Mesa 26 (8x8x8 in subgroups of 8), not on a GPU; tests/compiler/coopmat_test runs the code around
// the matrix instructions for other shapes on any device.
#include <algorithm>
#include <optional>
#include <tuple>

#include "compiler/kernels/gpu_conv.h"

namespace shale {
namespace {

constexpr int64_t kLeastPixels = 16;    ///< of a workgroup
constexpr int64_t kLeastChunk = 32;     ///< bytes staged between barriers
constexpr int64_t kMostSums = 32;       ///< of an invocation
constexpr int64_t kLeastChannels = 16;  ///< below, too much of a matrix is filled with nothing
constexpr int64_t kLine = 16;           ///< bytes of an element of the weight buffer

/// A matrix product and what a workgroup makes of it.
struct Tile {
  int64_t m, n, k, subgroup;
  int64_t rows;    ///< of matrices: their pixels lie next to each other
  int64_t steps;   ///< products along K to a chunk
  int64_t blocks;  ///< most blocks of channels at once
  bool by_columns;

  Tile(const MatrixProduct& product, uint32_t subgroup_size)
      : m(product.m),
        n(product.n),
        k(product.k),
        subgroup(subgroup_size),
        rows(std::max<int64_t>(1, kLeastPixels / m)),
        steps(std::max<int64_t>(1, kLeastChunk / k)),
        blocks(std::max<int64_t>(1, kMostSums * subgroup / (rows * m * n))),
        by_columns(n * ceil_div(k, kLine) < k * ceil_div(n, kLine)) {}

  int64_t pixels() const { return rows * m; }
  int64_t chunk_words() const { return steps * k / 4; }
  int64_t half_words() const { return pixels() * chunk_words(); }
  int64_t stage_words() const { return std::max(2 * half_words(), m * n); }
  /// uvec4 from one row or column of B to the next, and of all of B.
  int64_t line() const { return ceil_div(by_columns ? k : n, kLine); }
  int64_t lines() const { return line() * (by_columns ? n : k); }
};

/// Extents beyond this no device has; products of them stay far from overflow.
constexpr uint32_t kMostExtent = 256;

bool is_usable(const MatrixProduct& product, const DeviceCaps& caps) {
  const auto is_extent = [](uint32_t extent) { return extent > 0 && extent <= kMostExtent; };
  if (!is_extent(product.m) || !is_extent(product.n) || !is_extent(product.k)) return false;
  if (product.n % 4 != 0 || product.k % 4 != 0) return false;  // words of four channels
  const Tile tile(product, caps.subgroup_size);
  return 4 * tile.stage_words() <= caps.max_shared_bytes;
}

/// Workgroups for the channels of the same pixels, and blocks of each.
struct Slices {
  int64_t count, blocks;
};

Slices slices_of(int64_t channels, const Tile& tile) {
  const int64_t blocks = ceil_div(channels, tile.n);
  const int64_t count = ceil_div(blocks, tile.blocks);
  return {count, ceil_div(blocks, count)};
}

class CoopmatEmitter {
 public:
  CoopmatEmitter(const GroupProblem& problem, const Tile& tile)
      : conv_(problem),
        codegen_(problem),
        tile_(tile),
        slices_(slices_of(conv_.out()[3], tile)),
        chunks_(ceil_div(conv_.taps() * conv_.words(), tile.chunk_words())) {}

  KernelSource emit() {
    const size_t weights = codegen_.bind_constant(pack());
    codegen_.add_function(
        fmt::format("#define WEIGHTS b{}.d\n#define SUBGROUP {}\n#define MATRIX_M {}\n"
                    "#define MATRIX_N {}\n#define MATRIX_K {}\n#define STAGE_WORDS {}\n"
                    "#define A_STRIDE {}\n#define B_LAYOUT {}\n#define B_STRIDE {}\n"
                    "#include \"coopmat.glsl\"\n\n",
                    weights, tile_.subgroup, tile_.m, tile_.n, tile_.k, tile_.stage_words(),
                    tile_.chunk_words(), tile_.by_columns ? 1 : 0, tile_.line()));
    conv_.declare_inputs(codegen_);
    declare_stage();
    conv_.declare_finish(codegen_, weights, chunks_ * tile_.steps * blocks() * tile_.lines());
    KernelSource source;
    const std::array<int64_t, 3> grid = workgroups();
    std::transform(grid.begin(), grid.end(), source.workgroups.begin(),
                   [](int64_t extent) { return static_cast<uint32_t>(extent); });
    const auto column = [&](int64_t i) {
      return Stretch{i * tile_.pixels(), std::min((i + 1) * tile_.pixels(), conv_.out()[2])};
    };
    codegen_.take_cells(source, column, 1);
    source.glsl = codegen_.finish(fmt::format("local_size_x = {}", tile_.subgroup), body());
    source.bindings = codegen_.bindings();
    source.optimize = OptimizeBy::kNothing;  // spirv-opt does not know the instructions
    return source;
  }

  std::array<int64_t, 3> workgroups() const {
    const Shape& out = conv_.out();
    return {ceil_div(out[2], tile_.pixels()), out[1], out[0] * slices_.count};
  }

  /// Multiply-accumulates with those that fill pixels, blocks and chunks.
  double macs() const {
    const Shape& out = conv_.out();
    return static_cast<double>(out[0] * out[1] * ceil_div(out[2], tile_.pixels()) *
                               tile_.pixels()) *
           static_cast<double>(chunks_ * 4 * tile_.chunk_words() * blocks() * tile_.n);
  }

 private:
  int64_t blocks() const { return slices_.count * slices_.blocks; }

  std::vector<uint8_t> pack() const {
    std::vector<uint8_t> bytes;
    const int64_t slots = 4 * conv_.words(), products = conv_.taps() * slots;
    const int64_t lines = tile_.by_columns ? tile_.n : tile_.k;
    for (int64_t step = 0; step < chunks_ * tile_.steps; ++step)
      for (int64_t block = 0; block < blocks(); ++block)
        for (int64_t line = 0; line < lines; ++line)
          for (int64_t byte = 0; byte < tile_.line() * kLine; ++byte) {
            const int64_t k = tile_.by_columns ? byte : line, n = tile_.by_columns ? line : byte;
            const int64_t product = step * tile_.k + k;
            const bool fills = k >= tile_.k || n >= tile_.n || product >= products;
            bytes.push_back(static_cast<uint8_t>(
                fills
                    ? 0
                    : conv_.centred_weight(block * tile_.n + n, product / slots, product % slots)));
          }
    conv_.append_bias(bytes, blocks() * tile_.n);
    return bytes;
  }

  /// Words that a lane stages at once: they lie together in one tensor wherever they begin.
  int64_t run() const {
    for (const int64_t words : {4, 2})
      if (tile_.chunk_words() % words == 0 &&
          std::all_of(conv_.parts().begin(), conv_.parts().end(),
                      [&](const GpuConv::Part& part) { return part.words() % words == 0; }))
        return words;
    return 1;
  }

  /// void stage_input(...): words k to k + run() - 1 of the line of a pixel's taps, into shared
  /// memory from `to` on. Past the last tap something is read, which has no weight.
  void declare_stage() {
    const std::span<const int64_t> pad = conv_.list(Attr::kPad), stride = conv_.list(Attr::kStride),
                                   dilation = conv_.list(Attr::kDilation);
    std::string text = fmt::format(
        "void stage_input(int n, int y, int x, int k, int to) {{\n"
        "  int tap = k / {0}, word = k % {0};\n"
        "  int iy = y * {1} - {2} + tap / {3} * {4}, ix = x * {5} - {6} + tap % {3} * {7};\n"
        "  uint fill;\n",
        conv_.words(), stride[0], pad[0], conv_.weight()[2], dilation[0], stride[1], pad[2],
        dilation[1]);
    for (size_t i = 0; i < conv_.parts().size(); ++i) {
      const GpuConv::Part& part = conv_.parts()[i];
      const int64_t end = part.first_word + part.words();
      text += end < conv_.words() ? fmt::format("  if (word < {}) {{\n", end) : "  {\n";
      text += fmt::format("    int at = locate{}(n, iy, ix, fill);\n", i);
      for (int64_t j = 0; j < run(); ++j)
        text += fmt::format("    stage[to + {0}] = at < 0 ? fill : word{1}(at, word + {2});\n", j,
                            i, j - part.first_word);
      text += "    return;\n  }\n";
    }
    codegen_.add_function(text + "}\n\n");
  }

  /// `statement` for every one of `count` things, named `i`, a lane at a time.
  std::string spread(int64_t count, const std::string& statement) const {
    return fmt::format("  for (int i = lane; i < {}; i += {}) {}\n", count, tile_.subgroup,
                       statement);
  }

  std::string body() const {
    const int64_t words = tile_.chunk_words(), pieces = words / run(), quads = tile_.n / 4;
    std::string text = fmt::format(
        "  int lane = int(gl_LocalInvocationID.x);\n"
        "  int x = int({0}.x) * {1};\n  int y = int({0}.y);\n  int n = int({0}.z) / {2};\n"
        "  int block = int({0}.z) % {2} * {3};\n",
        codegen_.group(), tile_.pixels(), slices_.count, slices_.blocks);
    // The same for all of the subgroup, whose barriers are for all.
    if (codegen_.has_cells()) text += fmt::format("  if (y >= {}) return;\n", conv_.out()[1]);
    const auto each = [&](auto write) {
      for (int64_t row = 0; row < tile_.rows; ++row)
        for (int64_t b = 0; b < slices_.blocks; ++b) text += write(row, b);
    };
    each([](int64_t row, int64_t b) {
      return fmt::format("  MatrixC c{}_{} = MATRIX_ZERO;\n", row, b);
    });
    text +=
        fmt::format("  for (int chunk = 0; chunk < {}; ++chunk) {{\n    int at = chunk % 2 * {};\n",
                    chunks_, tile_.half_words());
    text += spread(
        tile_.pixels() * pieces,
        fmt::format("stage_input(n, y, x + i / {0}, chunk * {1} + i % {0} * {2}, at + i * {2});",
                    pieces, words, run()));
    text += "    barrier();\n";
    for (int64_t step = 0; step < tile_.steps; ++step) {
      text += "    {\n";
      for (int64_t row = 0; row < tile_.rows; ++row)
        text += fmt::format("      MatrixA a{} = MATRIX_LOAD_A(at + {});\n", row,
                            row * tile_.m * words + step * tile_.k / 4);
      text += fmt::format("      int w = ((chunk * {} + {}) * {} + block) * {};\n", tile_.steps,
                          step, blocks(), tile_.lines());
      for (int64_t b = 0; b < slices_.blocks; ++b) {
        text += fmt::format("      MatrixB b_{} = MATRIX_LOAD_B(w + {});\n", b, b * tile_.lines());
        for (int64_t row = 0; row < tile_.rows; ++row)
          text +=
              fmt::format("      c{0}_{1} = MATRIX_MULTIPLY_ADD(a{0}, b_{1}, c{0}_{1});\n", row, b);
      }
      text += "    }\n";
    }
    text += "  }\n";
    each([&](int64_t row, int64_t b) {
      return fmt::format("  barrier();\n  MATRIX_STORE_C(0, c{}_{});\n  barrier();\n", row, b) +
             spread(tile_.m * quads,
                    fmt::format("finish(ivec4(stage[4 * i], stage[4 * i + 1], stage[4 * i + 2], "
                                "stage[4 * i + 3]), n, y, x + {} + i / {}, (block + {}) * {} + i % "
                                "{} * 4);",
                                row * tile_.m, quads, b, tile_.n, quads));
    });
    return text;
  }

  GpuConv conv_;
  Codegen codegen_;
  Tile tile_;
  Slices slices_;
  int64_t chunks_;
};

/// Of the products that the device has, the one that takes the fewest MACs with what fills it; of
/// equals the largest. Nothing if none is fit.
std::optional<Tile> best_tile(const GroupProblem& problem, const DeviceCaps& caps) {
  std::optional<Tile> best;
  std::tuple<double, int64_t> best_rank;
  for (const MatrixProduct& product : caps.matrix_products) {
    if (!is_usable(product, caps)) continue;
    const Tile tile(product, caps.subgroup_size);
    const CoopmatEmitter emitter(problem, tile);
    const std::array<int64_t, 3> grid = emitter.workgroups();
    if (*std::max_element(grid.begin(), grid.end()) > kMaxWorkgroups) continue;
    const std::tuple rank{emitter.macs(), -tile.m * tile.n * tile.k};
    if (!best || rank < best_rank) best = tile, best_rank = rank;
  }
  return best;
}

}  // namespace

bool conv2d_coopmat_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!profile.caps.features.has(Feature::kCooperativeMatrix) || profile.caps.subgroup_size == 0 ||
      !GpuConv::supports(problem, profile))
    return false;
  const Shape& out = problem.graph->value(problem.group.result).type.shape;
  return out[3] >= kLeastChannels && GpuConv(problem).centred_weights_are_int8() &&
         best_tile(problem, profile.caps);
}

WorkTable conv2d_coopmat_work(const GroupProblem& problem, const DeviceProfile& profile) {
  return gpu_conv_work(problem, Work::kMatrixMac,
                       CoopmatEmitter(problem, *best_tile(problem, profile.caps)).macs());
}

Result<std::vector<KernelSource>> conv2d_coopmat_emit(const GroupProblem& problem,
                                                      const DeviceProfile& profile) {
  return std::vector<KernelSource>{
      CoopmatEmitter(problem, *best_tile(problem, profile.caps)).emit()};
}

}  // namespace shale
