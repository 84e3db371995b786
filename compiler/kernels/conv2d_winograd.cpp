// conv2d_s8_winograd: F(2x2, 3x3) with transformed weights as literals, two tiles packed in a double.
//
// One invocation makes two 2x2 tiles of output pixels next to each other from the 4x4 texels under
// each, so a pixel takes 4 products a channel in place of 9. All of it is linear in the texels d, so it
// is done on P = d + 2^22 d', where d' belongs to the second tile: P and V are exact in 32-bit integers,
// the products and their sums in doubles, which hold multiples of 1/4 below 2^51. At the end
// y + 2^22 y' is taken apart, for which y has to lie in a range of 2^22; where it may not, the input
// channels are summed up in parts. All is proven here from the actual weights.
// Source: winograd.h; packing and proof are ours, shown in tests/compiler/kernels_test.
//
// Two things in the code are there for the driver's compiler, which would keep too many values alive:
// each row of positions is a loop that is left at once, so that its scheduler does not begin all positions
// together (a loop for each position is no faster, and Mesa's front end takes longer for each loop), and
// each pass adds a zero of its own, so that values are made again and not kept.
#include <algorithm>

#include "compiler/kernels/winograd.h"

namespace shale {
namespace {

using namespace winograd;

/// Bits between the two tiles: V of the second one, up to 1020, ends at bit 31.
constexpr int kSpacing = 22;
/// Both tiles' share of a number that is the same in both.
constexpr int64_t kBoth = (int64_t{1} << kSpacing) + 1;
constexpr int64_t kMostParts = 4;
/// Most products in a module: bounds the driver's compile time.
constexpr int64_t kProducts = 32768;

class Winograd {
 public:
  Winograd(const GroupProblem& problem, const DeviceProfile& profile)
      : conv_(problem, profile), parts_(find_parts()), tiling_(tiling(conv_, 2)) {}

  bool applies() const {
    return winograd::applies(conv_) && products(conv_) <= kProducts && conv_.fits_grid(tiling_);
  }

  /// Each pass transforms the input anew, so there are few, and equal ones.
  int64_t passes() const {
    const int64_t channels = conv_.out()[3], step = conv_.channels_per_loop(channels);
    return (channels + step - 1) / step;
  }

  /// In parts a product takes as many times longer, the driver for its code too (measured in two
  /// parts): the results of all parts are live together, and spilled.
  int64_t literals() const { return products(conv_) * std::max<int64_t>(parts_, 1); }

  WorkTable work() const {
    const Shape& out = conv_.out();
    const auto [height, width] = conv_.tiles(tiling_);
    const double tiles = static_cast<double>(out[0] * height * literal_lanes(width));
    const int64_t in_channels = conv_.weight_shape()[3];
    WorkTable work{};
    work[Work::kDispatch] = 1;
    work[Work::kCode] = static_cast<double>(products(conv_));
    work[Work::kPairProduct] = tiles * static_cast<double>(literals());
    // Each pass makes its 16 values a channel anew; an output channel adds 16 sums to 4 results.
    work[Work::kTransform] =
        tiles *
        static_cast<double>(16 * (in_channels * passes() + out[3] * std::max<int64_t>(parts_, 1)));
    work[Work::kFetch] = tiles * conv_.fetches(tiling_, {0, conv_.weight_shape()[3]});
    // Each part is taken apart into its eight results a channel.
    work[Work::kResult] = tiles * static_cast<double>(8 * out[3] * std::max<int64_t>(parts_, 1));
    return work;
  }

  /// Results can be taken apart, and no sum on the way reaches what a double holds.
  bool is_exact() const {
    if (parts_ == 0) return false;
    for (int64_t oc = 0; oc < conv_.weight_shape()[0]; ++oc) {
      // Largest sum of one tile over all positions, times four as the weights are.
      int64_t bound = 0;
      for (size_t i = 0; i < 4; ++i)
        for (size_t j = 0; j < 4; ++j)
          for (int64_t c = 0; c < conv_.weight_shape()[3]; ++c)
            bound += std::abs(transformed(conv_, oc, i, j, c)) * largest_input(i, j);
      if (bound >= (int64_t{1} << 53) / (2 * kBoth)) return false;
    }
    return true;
  }

  KernelSource emit() {
    const int64_t out_channels = conv_.out()[3];
    std::string text;
    const int64_t step = conv_.channels_per_loop(out_channels);
    for (int64_t first = 0; first < out_channels; first += step)
      text += pass(first, std::min(out_channels, first + step));
    return conv_.finish(tiling_, conv_.over_rows(tiling_, text, {0, conv_.weight_shape()[3]}));
  }

 private:
  static constexpr size_t kColumns = 6;  ///< of texels under two tiles

  /// What sums of w * u over input channels [from, to) can be.
  IntRange range(int64_t oc, int64_t from, int64_t to) const {
    IntRange sums{0, 0};
    const Shape& taps = conv_.weight_shape();
    for (int64_t ky = 0; ky < taps[1]; ++ky)
      for (int64_t kx = 0; kx < taps[2]; ++kx)
        for (int64_t c = from; c < to; ++c) {
          const int64_t w = conv_.weight(oc, ky, kx, c);
          (w > 0 ? sums.max : sums.min) += 255 * w;
        }
    return sums;
  }
  static int64_t middle(const IntRange& sums) { return (sums.min + sums.max) / 2; }

  /// The fewest parts whose sums can be taken apart when they are brought around 0; 0 if too many.
  int64_t find_parts() const {
    const auto fit = [&](int64_t parts) {
      for (int64_t oc = 0; oc < conv_.weight_shape()[0]; ++oc)
        for (int64_t part = 0; part < parts; ++part) {
          const IntRange sums =
              range(oc, part_start(conv_, part, parts), part_start(conv_, part + 1, parts));
          if (sums.max - sums.min >= (int64_t{1} << kSpacing) - 2) return false;
        }
      return true;
    };
    for (int64_t parts = 1; parts <= kMostParts; ++parts)
      if (fit(parts)) return parts;
    return 0;
  }

  /// Output channels [first, last).
  std::string pass(int64_t first, int64_t last) {
    std::string text = fmt::format("  {{\n  uint zero = uint(x >= {});\n", INT32_MAX - first);
    std::vector<int64_t> less(static_cast<size_t>(last));
    for (int64_t part = 0; part < parts_; ++part) text += sums(first, last, part, less);
    for (int64_t pixel = 0; pixel < 4; ++pixel)
      for (int64_t side = 0; side < 2; ++side) {
        const auto sum = [&](int64_t oc) {
          std::string terms = output(0, pixel, oc, side);
          for (int64_t part = 1; part < parts_; ++part)
            terms += " + " + output(part, pixel, oc, side);
          return "(" + terms + ")";
        };
        conv_.results(text, first, last, fmt::format("(row * 2 + {})", pixel / 2),
                      fmt::format("(x * 4 + {})", 2 * side + pixel % 2),
                      {.expression = sum, .floating = true, .less = less},
                      fmt::format("_{}_{}", side, pixel));
      }
    return text + "  }\n";
  }

  /// Variable of an output of a tile, by split().
  static std::string output(int64_t part, int64_t pixel, int64_t oc, int64_t side) {
    return fmt::format("y{}_{}_{}_{}", part, pixel, oc, side);
  }

  /// The share of a part of the input channels in the pass's sums; `less` is what they lack. Every
  /// variable that several blocks use is stored once, which the compilers like best.
  std::string sums(int64_t first, int64_t last, int64_t part, std::vector<int64_t>& less) {
    std::string text;
    const int64_t from = part_start(conv_, part, parts_), to = part_start(conv_, part + 1, parts_);
    const auto packed = [&](size_t row, size_t column, int64_t c) {
      return fmt::format("p{}_{}_{}", row, column, c);
    };
    for (size_t row = 0; row < 4; ++row)
      for (size_t column = 0; column < 4; ++column)
        for (int64_t c = from; c < to; ++c) {
          const size_t texel = kColumns * row + column;
          text += fmt::format("  uint {} = {};\n", packed(row, column, c),
                              conv_.byte_pair({texel, texel + 2}, c, kSpacing));
        }
    const auto position = [&](size_t i, size_t j, int64_t oc) {
      return fmt::format("m{}_{}{}_{}", part, i, j, oc);
    };
    // The outputs as far as the rows of positions up to here make them, by output channel and pixel.
    std::vector<std::array<std::string, 4>> outputs(static_cast<size_t>(last));
    for (size_t i = 0; i < 4; ++i) {
      std::string row;
      for (size_t j = 0; j < 4; ++j) {
        std::string after;
        row += "  {\n  double v;\n";
        for (int64_t oc = first; oc < last; ++oc) {
          text += fmt::format("  double {};\n", position(i, j, oc));
          row += fmt::format("  double a{} = 0.0lf;\n", oc);
          after += fmt::format("  {} = a{} * {:.2f}lf;\n", position(i, j, oc), oc,
                               0.25 * multiple(i, j));
        }
        for (int64_t c = from; c < to; ++c) row += products_of(first, last, i, j, c, packed);
        row += after + "  }\n";
      }
      text += "  for (;;) {\n" + row + "  if (x >= 0) break;\n  }\n";
      for (int64_t oc = first; oc < last; ++oc)
        for (size_t pixel = 0; pixel < 4; ++pixel) {
          const int sign = kAt[pixel / 2][i];
          if (sign == 0) continue;
          std::string& so_far = outputs[static_cast<size_t>(oc)][pixel];
          const std::string next = fmt::format("r{}_{}{}_{}", part, pixel, i, oc);
          text +=
              fmt::format("  double {} = {}{};\n", next,
                          so_far.empty() ? "" : so_far + (sign > 0 ? " + " : " - "),
                          combine(kAt[pixel % 2], [&](size_t j) { return position(i, j, oc); }));
          so_far = next;
        }
    }
    for (int64_t oc = first; oc < last; ++oc) {
      const int64_t centre = middle(range(oc, from, to));
      less[static_cast<size_t>(oc)] += centre;
      for (size_t pixel = 0; pixel < 4; ++pixel) {
        const std::string own = fmt::format("y{}_{}_{}", part, pixel, oc);
        text += fmt::format("  double {} = {} - {}.0lf;\n", own,
                            outputs[static_cast<size_t>(oc)][pixel], centre * kBoth) +
                conv_.split(own, kSpacing);
      }
    }
    return text;
  }

  /// What input channel `c` adds to the sums at position (i, j).
  template <typename Packed>
  std::string products_of(int64_t first, int64_t last, size_t i, size_t j, int64_t c,
                          const Packed& packed) const {
    std::string sums;
    for (int64_t oc = first; oc < last; ++oc) {
      const int64_t u = transformed(conv_, oc, i, j, c) / multiple(i, j);
      if (u != 0) sums += fmt::format("  a{} += v * {}.0lf;\n", oc, u);
    }
    if (sums.empty()) return sums;
    const std::string value = combine(kBt[i], [&](size_t row) {
      return combine(kBt[j], [&](size_t column) { return packed(row, column, c); });
    });
    // Where all signs are plus the value may reach bit 31.
    return fmt::format("  v = double({}({}{}));\n", i == 1 && j == 1 ? "" : "int", value,
                       first > 0 ? " + zero" : "") +
           sums;
  }

  LiteralConv conv_;
  int64_t parts_;  ///< of the input channels, to be summed up apart
  Tiling tiling_;
};

}  // namespace

bool conv2d_winograd_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!LiteralConv::supports(problem, profile) || !profile.caps.features.has(Feature::kFloat64))
    return false;
  const Winograd winograd(problem, profile);
  return winograd.applies() && winograd.is_exact();
}

int64_t conv2d_winograd_literals(const GroupProblem& problem, const DeviceProfile& profile) {
  return Winograd(problem, profile).literals();
}

WorkTable conv2d_winograd_work(const GroupProblem& problem, const DeviceProfile& profile) {
  WorkTable work = Winograd(problem, profile).work();
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

Result<std::vector<KernelSource>> conv2d_winograd_emit(const GroupProblem& problem,
                                                       const DeviceProfile& profile) {
  std::vector<KernelSource> sources;
  sources.push_back(Winograd(problem, profile).emit());
  return sources;
}

}  // namespace shale
