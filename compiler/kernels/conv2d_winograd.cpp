// conv2d_s8_winograd: F(2x2, 3x3) in float32 with transformed weights as literals, exact.
//
// One invocation makes a 2x2 tile of output pixels from the 4x4 texels under it. With
//   V = B^T d B (input),  U = (2G) g (2G)^T (weights, four times the usual so that all are integers)
//   4 y = A^T [sum over channels of U * V, position by position] A
// a pixel takes 4 products a channel in place of 9. Everything is an integer in float32; it is exact
// if every partial sum stays below 2^24 in magnitude, which is proven here from the actual weights:
// for the sums at a position, and for the running output sums as linear forms in the texels, in the
// very order in which the code adds. Source: Lavin and Gray, "Fast Algorithms for Convolutional
// Neural Networks", 2015; the proof is ours, shown in tests/compiler/kernels_test.
//
// The input transform works on pairs of bytes in 32-bit words: each is at most 1020 in magnitude, so
// two fit a word with a bias that keeps the lower one from borrowing.
#include <algorithm>

#include "compiler/kernels/literal_conv.h"

namespace shale {
namespace {

constexpr int kBt[4][4] = {{1, 0, -1, 0}, {0, 1, 1, 0}, {0, -1, 1, 0}, {0, 1, 0, -1}};
constexpr int kG2[4][3] = {{2, 0, 0}, {1, 1, 1}, {1, -1, 1}, {0, 0, 2}};
constexpr int kAt[2][4] = {{1, 1, 1, 0}, {0, 1, -1, -1}};
/// Differences of two pairs of bytes are above -512.
constexpr int kBias = 512;
/// Most output channels of a pass.
constexpr int64_t kMostSums = 20;
/// Most products in a module: bounds the driver's compile time.
constexpr int64_t kProducts = 32768;

class Winograd {
 public:
  explicit Winograd(const GroupProblem& problem)
      : conv_(problem),
        largest_(std::max(value_range(conv_.graph(), conv_.node().inputs[0]).max,
                          conv_.input_zero_point()) +
                 128) {
    tiling_.source = conv_.node().inputs[0];
    tiling_.outside = conv_.input_zero_point();
    tiling_.tile_height = tiling_.tile_width = tiling_.step_y = tiling_.step_x = 2;
    const std::span<const int64_t> pad = conv_.ints(Attr::kPad);
    for (int64_t row = 0; row < 4; ++row)
      for (int64_t column = 0; column < 4; ++column)
        tiling_.texels.push_back({row - pad[0], column - pad[2]});
  }

  bool applies() const {
    const Shape& taps = conv_.weight_shape();
    const auto all_one = [&](Attr attr) {
      return conv_.ints(attr)[0] == 1 && conv_.ints(attr)[1] == 1;
    };
    return taps[1] == 3 && taps[2] == 3 && all_one(Attr::kStride) && all_one(Attr::kDilation) &&
           conv_.lanes() >= 4 && products() <= kProducts && conv_.fits_grid(tiling_);
  }

  /// Each pass transforms the input anew, so there are few, and equal ones.
  int64_t passes() const { return (conv_.weight_shape()[0] + kMostSums - 1) / kMostSums; }

  int64_t products() const { return 16 * conv_.weight_shape()[0] * conv_.weight_shape()[3]; }

  WorkTable work() const {
    const Shape& out = conv_.out();
    const auto [height, width] = conv_.tiles(tiling_);
    const double tiles = static_cast<double>(out[0] * height * literal_lanes(width));
    const int64_t in_channels = conv_.weight_shape()[3];
    WorkTable work{};
    work[Work::kDispatch] = 1;
    work[Work::kCode] = static_cast<double>(products());
    work[Work::kWinogradProduct] = tiles * static_cast<double>(products());
    // Each pass makes its 16 values a channel anew; an output channel adds 16 sums to 4 results.
    work[Work::kTransform] = tiles * static_cast<double>(16 * (in_channels * passes() + out[3]));
    work[Work::kFetch] = tiles * conv_.fetches(tiling_);
    work[Work::kResult] = tiles * static_cast<double>(4 * out[3]);
    return work;
  }

  /// Every partial sum of every output channel stays below 2^24, and four times the result too.
  bool is_exact() const {
    const int64_t channels = conv_.weight_shape()[3];
    for (int64_t oc = 0; oc < conv_.weight_shape()[0]; ++oc) {
      // Coefficients of the texels in each running output sum.
      std::vector<int64_t> sums[2][2];
      for (auto& row : sums)
        for (auto& sum : row) sum.assign(static_cast<size_t>(16 * channels), 0);
      for (size_t i = 0; i < 4; ++i)
        for (size_t j = 0; j < 4; ++j) {
          int64_t bound = 0;
          for (int64_t c = 0; c < channels; ++c)
            bound += std::abs(transformed(oc, i, j, c)) * largest_ * (i == 1 && j == 1 ? 4 : 2);
          if (bound >= kFloatExact) return false;
          for (size_t m = 0; m < 2; ++m)
            for (size_t n = 0; n < 2; ++n) {
              const int sign = kAt[m][i] * kAt[n][j];
              if (sign == 0) continue;
              add(sums[m][n], oc, i, j, sign);
              if (magnitude(sums[m][n]) >= kFloatExact) return false;
            }
        }
    }
    return true;
  }

  KernelSource emit() {
    const int64_t out_channels = conv_.out()[3];
    std::string text;
    const int64_t live = (out_channels + passes() - 1) / passes();
    const int64_t step = (live + 3) / 4 * 4;  // results make words
    for (int64_t first = 0; first < out_channels; first += step)
      text += pass(first, std::min(out_channels, first + step));
    return conv_.finish(tiling_, conv_.over_rows(tiling_, text));
  }

 private:
  int64_t transformed(int64_t oc, size_t i, size_t j, int64_t c) const {
    int64_t sum = 0;
    for (int64_t ky = 0; ky < 3; ++ky)
      for (int64_t kx = 0; kx < 3; ++kx)
        sum += kG2[i][ky] * kG2[j][kx] * conv_.weight(oc, ky, kx, c);
    return sum;
  }

  /// Adds sign * (sum over channels of U * V) at position (i, j), as coefficients of the texels.
  void add(std::vector<int64_t>& coefficients, int64_t oc, size_t i, size_t j, int sign) const {
    const int64_t channels = conv_.weight_shape()[3];
    for (int64_t c = 0; c < channels; ++c) {
      const int64_t u = sign * transformed(oc, i, j, c);
      for (size_t row = 0; row < 4; ++row)
        for (size_t column = 0; column < 4; ++column)
          coefficients[(4 * row + column) * static_cast<size_t>(channels) +
                       static_cast<size_t>(c)] += u * kBt[i][row] * kBt[j][column];
    }
  }

  /// Largest magnitude of the form for texels in [0, largest].
  int64_t magnitude(const std::vector<int64_t>& coefficients) const {
    int64_t up = 0, down = 0;
    for (const int64_t k : coefficients) (k > 0 ? up : down) += std::abs(k);
    return largest_ * std::max(up, down);
  }

  /// V at position (i, j) for channels c .. c+3, in v0 .. v3.
  std::string input(size_t i, size_t j, int64_t c) const {
    std::string even, odd, minus_even, minus_odd;
    bool negative = false;
    for (size_t row = 0; row < 4; ++row)
      for (size_t column = 0; column < 4; ++column) {
        const int sign = kBt[i][row] * kBt[j][column];
        if (sign == 0) continue;
        std::string word = conv_.texel(4 * row + column, c);
        if (conv_.lanes() == 16)
          word += fmt::format(".{}", "xyzw"[static_cast<size_t>(c % 16 / 4)]);
        negative = negative || sign < 0;
        (sign > 0 ? even : minus_even) +=
            fmt::format(" {} ({} & 0xff00ffu)", sign > 0 ? '+' : '-', word);
        (sign > 0 ? odd : minus_odd) +=
            fmt::format(" {} (({} >> 8) & 0xff00ffu)", sign > 0 ? '+' : '-', word);
      }
    const std::string bias = negative ? fmt::format("{}u", kBias * 0x10001) : "0u";
    const std::string off = negative ? fmt::format(" - {}.0", kBias) : "";
    return fmt::format(
        "  e = {0}{2}{3};\n  o = {0}{4}{5};\n  v0 = float(e & 0xffffu){1};\n  v1 = float(o & "
        "0xffffu){1};\n  v2 = float(e >> 16){1};\n  v3 = float(o >> 16){1};\n",
        bias, off, even, minus_even, odd, minus_odd);
  }

  /// Output channels [first, last): position by position, the sums over the input channels, then
  /// their share in the four outputs.
  std::string pass(int64_t first, int64_t last) {
    std::string text = "  {\n  uint e, o;\n  float v0, v1, v2, v3;\n";
    for (int64_t oc = first; oc < last; ++oc) {
      text += fmt::format("  float m{};\n", oc);
      for (int pixel = 0; pixel < 4; ++pixel) text += fmt::format("  float y{}_{};\n", pixel, oc);
    }
    bool started[4] = {};
    for (size_t i = 0; i < 4; ++i)
      for (size_t j = 0; j < 4; ++j) {
        for (int64_t oc = first; oc < last; ++oc) text += fmt::format("  m{} = 0.0;\n", oc);
        for (int64_t c = 0; c < conv_.weight_shape()[3]; c += 4)
          text += products(first, last, i, j, c);
        for (size_t m = 0; m < 2; ++m)
          for (size_t n = 0; n < 2; ++n) {
            const int sign = kAt[m][i] * kAt[n][j];
            const size_t pixel = 2 * m + n;
            if (sign == 0) continue;
            for (int64_t oc = first; oc < last; ++oc)
              text += fmt::format("  y{}_{} {}= {}m{};\n", pixel, oc,
                                  !started[pixel] ? ""
                                  : sign > 0      ? "+"
                                                  : "-",
                                  !started[pixel] && sign < 0 ? "-" : "", oc);
            started[pixel] = true;
          }
      }
    for (int64_t pixel = 0; pixel < 4; ++pixel)
      conv_.results(
          text, first, last, fmt::format("(row * 2 + {})", pixel / 2),
          fmt::format("(x * 2 + {})", pixel % 2),
          [&](int64_t oc) { return fmt::format("(int(y{}_{}) >> 2)", pixel, oc); },
          fmt::format("_{}", pixel));
    return text + "  }\n";
  }

  /// What channels c .. c+3 add to the sums at position (i, j).
  std::string products(int64_t first, int64_t last, size_t i, size_t j, int64_t c) const {
    std::string text;
    for (int64_t lane = 0; lane < 4; ++lane)
      for (int64_t oc = first; oc < last; ++oc) {
        const int64_t u = transformed(oc, i, j, c + lane);
        if (u != 0)
          text += fmt::format("  m{} {}= v{} * {}.0;\n", oc, u < 0 ? '-' : '+', lane, std::abs(u));
      }
    return text.empty() ? text : input(i, j, c) + text;
  }

  LiteralConv conv_;
  Tiling tiling_;
  int64_t largest_;  ///< of any u
};

}  // namespace

bool conv2d_winograd_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!LiteralConv::supports(problem, profile)) return false;
  const Winograd winograd(problem);
  return winograd.applies() && winograd.is_exact();
}

int64_t conv2d_winograd_literals(const GroupProblem& problem, const DeviceProfile&) {
  return Winograd(problem).products();
}

WorkTable conv2d_winograd_work(const GroupProblem& problem) {
  WorkTable work = Winograd(problem).work();
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

Result<std::vector<KernelSource>> conv2d_winograd_emit(const GroupProblem& problem,
                                                       const DeviceProfile&) {
  std::vector<KernelSource> sources;
  sources.push_back(Winograd(problem).emit());
  return sources;
}

}  // namespace shale
