// conv2d_s8_winograd: F(2x2, 3x3) with transformed weights as literals, two tiles packed in a double.
//
// One invocation makes two 2x2 tiles of output pixels next to each other from the 4x4 texels under
// each. With
//   V = B^T d B (input),  U = G g G^T (weights, multiples of 1/4)
//   y = A^T [sum over channels of U * V, position by position] A
// a pixel takes 4 products a channel in place of 9. All of it is linear in the texels d, so it is
// done on P = d + 2^22 d', where d' belongs to the second tile: P and V are exact in 32-bit integers,
// the products and their sums in doubles, which hold multiples of 1/4 below 2^51. At the end y + 2^22 y'
// is taken apart, for which y has to lie within 2^21. Both are proven here from the actual weights.
// Source: Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", 2015; packing and
// proof are ours, shown in tests/compiler/kernels_test.
//
// Sums over the positions run on without a new start, and the output transform takes differences:
// then there is one order for all products of an output channel, and the driver's scheduler cannot
// begin all positions at once and spill what it began.
#include <algorithm>

#include "compiler/kernels/literal_conv.h"

namespace shale {
namespace {

constexpr int kBt[4][4] = {{1, 0, -1, 0}, {0, 1, 1, 0}, {0, -1, 1, 0}, {0, 1, 0, -1}};
constexpr int kG2[4][3] = {{2, 0, 0}, {1, 1, 1}, {1, -1, 1}, {0, 0, 2}};
/// Bits between the two tiles: V of the second one, up to 1020, ends at bit 31.
constexpr int kSpacing = 22;
/// Most products in a module: bounds the driver's compile time.
constexpr int64_t kProducts = 32768;

class Winograd {
 public:
  explicit Winograd(const GroupProblem& problem)
      : problem_(problem), conv_(problem) {
    tiling_.source = conv_.node().inputs[0];
    tiling_.outside = conv_.input_zero_point();
    tiling_.tile_height = tiling_.step_y = 2;
    tiling_.tile_width = tiling_.step_x = 4;
    const std::span<const int64_t> pad = conv_.ints(Attr::kPad);
    for (int64_t row = 0; row < 4; ++row)
      for (int64_t column = 0; column < int64_t{kColumns}; ++column)
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
    work[Work::kPairProduct] = tiles * static_cast<double>(products());
    // Each pass makes its 16 values a channel anew; an output channel adds 16 sums to 4 results.
    work[Work::kTransform] = tiles * static_cast<double>(16 * (in_channels * passes() + out[3]));
    work[Work::kFetch] = tiles * conv_.fetches(tiling_);
    work[Work::kResult] = tiles * static_cast<double>(8 * out[3]);
    return work;
  }

  /// Results can be taken apart, and no sum on the way reaches what a double holds.
  bool is_exact() const {
    if (!problem_.proof) return false;
    for (int64_t oc = 0; oc < conv_.weight_shape()[0]; ++oc) {
      if (problem_.proof->magnitude[static_cast<size_t>(oc)] >= int64_t{1} << (kSpacing - 1))
        return false;
      // Largest running sum of one tile, times four as the weights are; the output transform takes
      // less than four of them together at any time.
      int64_t bound = 0;
      for (size_t i = 0; i < 4; ++i)
        for (size_t j = 0; j < 4; ++j)
          for (int64_t c = 0; c < conv_.weight_shape()[3]; ++c)
            bound += std::abs(transformed(oc, i, j, c)) * (i == 1 && j == 1 ? 1020 : 510);
      if (4 * bound >= int64_t{1} << (53 - kSpacing - 1)) return false;
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
  static constexpr size_t kColumns = 6;  ///< of texels under two tiles

  /// Four times U.
  int64_t transformed(int64_t oc, size_t i, size_t j, int64_t c) const {
    int64_t sum = 0;
    for (int64_t ky = 0; ky < 3; ++ky)
      for (int64_t kx = 0; kx < 3; ++kx)
        sum += kG2[i][ky] * kG2[j][kx] * conv_.weight(oc, ky, kx, c);
    return sum;
  }

  /// Sum of terms {0} with the signs of a row of B^T.
  template <typename Term>
  static std::string combine(const int (&signs)[4], const Term& term) {
    std::string plus, minus;
    for (size_t k = 0; k < 4; ++k)
      if (signs[k] > 0) plus += (plus.empty() ? "" : " + ") + term(k);
      else if (signs[k] < 0) minus += " - " + term(k);
    return "(" + plus + minus + ")";
  }

  /// Output channels [first, last): position by position, the sums over the input channels, then
  /// their share in the four outputs.
  std::string pass(int64_t first, int64_t last) {
    const int64_t channels = conv_.weight_shape()[3];
    std::string text = "  {\n  double v;\n";
    const auto packed = [](size_t row, size_t column, int64_t c) {
      return fmt::format("p{}_{}_{}", row, column, c);
    };
    for (size_t row = 0; row < 4; ++row)
      for (size_t column = 0; column < 4; ++column)
        for (int64_t c = 0; c < channels; ++c) {
          const size_t texel = kColumns * row + column;
          text += fmt::format("  uint {} = {};\n", packed(row, column, c),
                              conv_.byte_pair({texel, texel + 2}, c, kSpacing));
        }
    const auto each = [&](auto&& line) {
      for (int64_t oc = first; oc < last; ++oc) text += line(oc);
    };
    each([](int64_t oc) {
      std::string lines = fmt::format("  double m{0}, z0_{0}, z1_{0};\n", oc);
      for (int pixel = 0; pixel < 4; ++pixel) lines += fmt::format("  double y{}_{};\n", pixel, oc);
      return lines;
    });
    for (size_t i = 0; i < 4; ++i) {
      for (size_t j = 0; j < 4; ++j) {
        text += "  for (;;) {\n";
        each([](int64_t oc) { return fmt::format("  m{0} = 0.0lf;\n", oc); });
        for (int64_t c = 0; c < channels; ++c) {
          const std::string value = combine(kBt[i], [&](size_t row) {
            return combine(kBt[j], [&](size_t column) { return packed(row, column, c); });
          });
          // Where all signs are plus the value may reach bit 31.
          text += fmt::format("  v = double({}({}));\n", i == 1 && j == 1 ? "" : "int", value);
          each([&](int64_t oc) {
            const int64_t u = transformed(oc, i, j, c);
            return u == 0 ? std::string()
                          : fmt::format("  m{} {}= v * {:.2f}lf;\n", oc, u < 0 ? '-' : '+',
                                        0.25 * static_cast<double>(std::abs(u)));
          });
        }
        text += "  if (x >= 0) break;\n  }\n";
        // Of a row of positions M: z0 = M0 + M1 + M2, z1 = M1 - M2 - M3.
        each([&](int64_t oc) {
          switch (j) {
            case 0: return fmt::format("  z0_{0} = m{0};\n", oc);
            case 1: return fmt::format("  z0_{0} += m{0};\n  z1_{0} = m{0};\n", oc);
            case 2: return fmt::format("  z0_{0} += m{0};\n  z1_{0} -= m{0};\n", oc);
            default: return fmt::format("  z1_{0} -= m{0};\n", oc);
          }
        });
      }
      each([&](int64_t oc) {
        std::string lines;
        for (int n = 0; n < 2; ++n) {
          if (i == 0) lines += fmt::format("  y{0}_{1} = z{0}_{1};\n", n, oc);
          if (i == 1) lines += fmt::format("  y{0}_{1} += z{0}_{1};\n  y{2}_{1} = z{0}_{1};\n", n, oc, n + 2);
          if (i == 2) lines += fmt::format("  y{0}_{1} += z{0}_{1};\n  y{2}_{1} -= z{0}_{1};\n", n, oc, n + 2);
          if (i == 3) lines += fmt::format("  y{2}_{1} -= z{0}_{1};\n", n, oc, n + 2);
        }
        return lines;
      });
    }
    for (int64_t pixel = 0; pixel < 4; ++pixel) {
      each([&](int64_t oc) { return conv_.split(fmt::format("y{}_{}", pixel, oc), kSpacing); });
      for (int64_t side = 0; side < 2; ++side)
        conv_.results(
            text, first, last, fmt::format("(row * 2 + {})", pixel / 2),
            fmt::format("(x * 4 + {})", 2 * side + pixel % 2),
            [&](int64_t oc) {
              return fmt::format("y{}_{}_{}", pixel, oc, side);
            },
            true, fmt::format("_{}_{}", side, pixel));
    }
    return text + "  }\n";
  }

  const GroupProblem& problem_;
  LiteralConv conv_;
  Tiling tiling_;
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
