// conv2d_s8_coopmat: convolution as products of int8 matrices (VK_KHR_cooperative_matrix), 16
// pixels by 16 output channels by 32 input bytes at a time. Not run on hardware.
//
// Meaning of a workgroup: one subgroup of 32 makes 16 neighbouring pixels of a row, up to 64 output
// channels in four accumulators. The taps' words of channels form one line of bytes; chunks of 32
// of them are staged for the 16 pixels in shared memory by plain code, which knows borders, views
// and channel counts. Chunks alternate between two halves, so one barrier a chunk is enough: nobody
// writes a half before all have passed the barrier after its last reading. Weights lie as
// [chunk][block of 16 oc][byte][oc], the folded bias follows them. Sums go through shared memory
// into the fused nodes.
//
// Exact for all weights that are int8 without their zero point: sums are int32. Source: ours; one
// subgroup per 16 pixels and the small shared memory as in nss.md section 8. The code around the
// matrix instructions runs on any device in tests/compiler/coopmat_test.
#include <algorithm>

#include "compiler/kernels/gpu_conv.h"

namespace shale {
namespace {

constexpr int64_t kM = 16, kN = 16, kK = 32;
constexpr uint32_t kSubgroup = 32;
constexpr int64_t kMostBlocks = 4;  ///< accumulators live at once
constexpr int64_t kLeastChannels = 16;

int64_t groups(int64_t extent, int64_t each) { return (extent + each - 1) / each; }

/// Workgroups for the channels of the same pixels, and blocks of each.
struct Slices {
  int64_t count, blocks;
};

Slices slices_of(int64_t channels) {
  const int64_t blocks = groups(channels, kN);
  const int64_t count = groups(blocks, kMostBlocks);
  return {count, groups(blocks, count)};
}

class CoopmatEmitter {
 public:
  explicit CoopmatEmitter(const GroupProblem& problem)
      : conv_(problem),
        codegen_(problem),
        slices_(slices_of(conv_.out()[3])),
        chunks_(groups(conv_.taps() * conv_.words() * 4, kK)) {}

  KernelSource emit() {
    const int64_t rows = chunks_ * blocks() * kK;
    const size_t weights = codegen_.bind_constant(pack());
    codegen_.add_function(
        fmt::format("#define WEIGHTS b{}.d\n#include \"coopmat.glsl\"\n\n", weights));
    conv_.declare_inputs(codegen_);
    declare_stage();
    conv_.declare_finish(codegen_, weights, rows);
    KernelSource source;
    source.glsl = codegen_.finish(fmt::format("local_size_x = {}", kSubgroup), body());
    const Shape& out = conv_.out();
    source.workgroups = {static_cast<uint32_t>(groups(out[2], kM)), static_cast<uint32_t>(out[1]),
                         static_cast<uint32_t>(out[0] * slices_.count)};
    source.bindings = codegen_.bindings();
    source.optimize = OptimizeBy::kNothing;  // spirv-opt does not know the instructions
    return source;
  }

  /// Multiply-accumulates with those that fill blocks and chunks.
  double macs() const {
    const Shape& out = conv_.out();
    return static_cast<double>(out[0] * out[1] * out[2]) *
           static_cast<double>(chunks_ * kK * blocks() * kN);
  }

 private:
  int64_t blocks() const { return slices_.count * slices_.blocks; }

  std::vector<uint8_t> pack() const {
    std::vector<uint8_t> bytes;
    const int64_t slots = 4 * conv_.words();
    for (int64_t chunk = 0; chunk < chunks_; ++chunk)
      for (int64_t block = 0; block < blocks(); ++block)
        for (int64_t k = chunk * kK; k < (chunk + 1) * kK; ++k)
          for (int64_t oc = block * kN; oc < (block + 1) * kN; ++oc)
            bytes.push_back(static_cast<uint8_t>(
                k < conv_.taps() * slots ? conv_.centred_weight(oc, k / slots, k % slots) : 0));
    conv_.append_bias(bytes, blocks() * kN);
    return bytes;
  }

  /// Words that lie together in one tensor wherever a lane's four begin.
  int64_t run() const {
    return std::all_of(conv_.parts().begin(), conv_.parts().end(),
                       [](const GpuConv::Part& part) { return part.words() % 4 == 0; })
               ? 4
               : 1;
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

  std::string body() const {
    std::string text = fmt::format(
        "  int lane = int(gl_LocalInvocationID.x);\n  int pixel = lane / 2, side = lane % 2;\n"
        "  int x = int(gl_WorkGroupID.x) * {} + pixel;\n  int y = int(gl_WorkGroupID.y);\n"
        "  int n = int(gl_WorkGroupID.z) / {};\n"
        "  int block = int(gl_WorkGroupID.z) % {} * {};\n",
        kM, slices_.count, slices_.count, slices_.blocks);
    for (int64_t b = 0; b < slices_.blocks; ++b)
      text += fmt::format("  MatrixC c{} = MATRIX_ZERO;\n", b);
    text +=
        fmt::format("  for (int chunk = 0; chunk < {}; ++chunk) {{\n    int at = chunk % 2 * {};\n",
                    chunks_, kM * kK / 4);
    for (int64_t j = 0; j < 4; j += run())
      text += fmt::format(
          "    stage_input(n, y, x, chunk * 8 + side * 4 + {0}, at + pixel * 8 + side * 4 + "
          "{0});\n",
          j);
    text += fmt::format(
        "    barrier();\n    MatrixA a = MATRIX_LOAD_A(at);\n"
        "    int w = (chunk * {} + block) * {};\n",
        blocks(), kK);
    for (int64_t b = 0; b < slices_.blocks; ++b)
      text += fmt::format("    c{0} = MATRIX_MULTIPLY_ADD(a, MATRIX_LOAD_B(w + {1}), c{0});\n", b,
                          b * kK);
    text += "  }\n  int from = pixel * 16 + side * 8;\n";
    for (int64_t b = 0; b < slices_.blocks; ++b) {
      text += fmt::format("  barrier();\n  MATRIX_STORE_C(0, c{});\n  barrier();\n", b);
      for (int64_t i = 0; i < 8; i += 4)
        text += fmt::format(
            "  finish(ivec4(stage[from + {}], stage[from + {}], stage[from + {}], stage[from + "
            "{}]), n, y, x, (block + {}) * {} + side * 8 + {});\n",
            i, i + 1, i + 2, i + 3, b, kN, i);
    }
    return text;
  }

  GpuConv conv_;
  Codegen codegen_;
  Slices slices_;
  int64_t chunks_;
};

}  // namespace

bool conv2d_coopmat_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!profile.caps.features.has(Feature::kCooperativeMatrix) ||
      profile.caps.subgroup_size != kSubgroup || !GpuConv::supports(problem, profile))
    return false;
  const Shape& out = problem.graph->value(problem.group.result).type.shape;
  return out[3] >= kLeastChannels && GpuConv(problem).centred_weights_are_int8() &&
         groups(out[2], kM) <= kMaxWorkgroups && out[1] <= kMaxWorkgroups &&
         out[0] * slices_of(out[3]).count <= kMaxWorkgroups;
}

WorkTable conv2d_coopmat_work(const GroupProblem& problem) {
  return gpu_conv_work(problem, Work::kMatrixMac, CoopmatEmitter(problem).macs());
}

Result<std::vector<KernelSource>> conv2d_coopmat_emit(const GroupProblem& problem,
                                                      const DeviceProfile&) {
  return std::vector<KernelSource>{CoopmatEmitter(problem).emit()};
}

}  // namespace shale
