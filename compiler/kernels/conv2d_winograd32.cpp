// conv2d_s8_winograd32: F(2x2, 3x3) in float32 with transformed weights as literals, for processors
// with 16 vector registers of 256 bits.
//
// One invocation makes a 2x2 tile of output pixels. V is made once for all output channels, in 32-bit
// integers, and lies in memory as float32; sums of as many output channels as the processor has
// registers for are then made position by position. Every sum is a multiple of 1/4 and exact while it
// stays below 2^22; where it may not, the input channels are summed up in parts, which integers join.
// Source: winograd.h; the proof is ours, shown in tests/compiler/kernels_test.
//
// No loop around each position as in conv2d_winograd.cpp: with eight sums live the code is as fast without,
// and Mesa's front end, which takes such loops apart one by one, makes a pipeline in a tenth of the time.
#include <algorithm>

#include "compiler/kernels/winograd.h"

namespace shale {
namespace {

using namespace winograd;

constexpr int64_t kMostParts = 4;
/// Most products in a module: bounds the driver's compile time.
constexpr int64_t kProducts = 32768;

class Winograd32 {
 public:
  Winograd32(const GroupProblem& problem, const DeviceProfile& profile)
      : conv_(problem, profile), parts_(find_parts()), tiling_(tiling(conv_, 1)) {}

  bool supported() const {
    return applies(conv_) && products(conv_) <= kProducts && conv_.fits_grid(tiling_) && parts_ > 0;
  }

  WorkTable work() const {
    const Shape& out = conv_.out();
    const auto [height, width] = conv_.tiles(tiling_);
    const double tiles = static_cast<double>(out[0] * height * literal_lanes(width));
    WorkTable work{};
    work[Work::kDispatch] = 1;
    work[Work::kCode] = static_cast<double>(products(conv_));
    work[Work::kFloatProduct] = tiles * static_cast<double>(products(conv_));
    work[Work::kTransform] =
        tiles * static_cast<double>(16 * (conv_.weight_shape()[3] + out[3] * parts_));
    work[Work::kFetch] = tiles * conv_.fetches(tiling_, {0, conv_.weight_shape()[3]});
    work[Work::kResult] = tiles * static_cast<double>(4 * out[3]);
    return work;
  }

  KernelSource emit() {
    const int64_t channels = conv_.out()[3], step = conv_.channels_per_loop(channels);
    std::string text = inputs();
    for (int64_t first = 0; first < channels; first += step)
      text += pass(first, std::min(channels, first + step));
    return conv_.finish(tiling_, conv_.over_rows(tiling_, text, {0, conv_.weight_shape()[3]}));
  }

 private:
  /// The fewest parts whose sums are exact; 0 if too many.
  int64_t find_parts() const {
    if (!applies(conv_)) return 0;
    for (int64_t parts = 1; parts <= kMostParts; ++parts)
      if (largest_sum(parts) < kFloatExact) return parts;
    return 0;
  }

  /// Bound of all sums of a part on the way to a result, times four as the weights are.
  int64_t largest_sum(int64_t parts) const {
    int64_t largest = 0;
    for (int64_t part = 0; part < parts; ++part)
      for (int64_t oc = 0; oc < conv_.weight_shape()[0]; ++oc) {
        int64_t bounds[4][4] = {};
        for (size_t i = 0; i < 4; ++i)
          for (size_t j = 0; j < 4; ++j)
            for (int64_t c = part_start(conv_, part, parts); c < part_start(conv_, part + 1, parts);
                 ++c)
              bounds[i][j] += std::abs(transformed(conv_, oc, i, j, c)) * largest_input(i, j);
        for (const auto& rows : kAt)
          for (const auto& columns : kAt) {
            int64_t bound = 0;
            for (size_t i = 0; i < 4; ++i)
              for (size_t j = 0; j < 4; ++j)
                if (rows[i] != 0 && columns[j] != 0) bound += bounds[i][j];
            largest = std::max(largest, bound);
          }
      }
    return largest;
  }

  static std::string input(size_t i, size_t j, int64_t c) {
    return fmt::format("v{}{}_{}", i, j, c);
  }
  static std::string output(size_t pixel, int64_t oc) { return fmt::format("y{}_{}", pixel, oc); }

  /// V of all input channels.
  std::string inputs() const {
    std::string text;
    for (int64_t c = 0; c < conv_.weight_shape()[3]; ++c) {
      std::string block;
      for (size_t texel = 0; texel < 16; ++texel)
        block +=
            fmt::format("  int d{}{} = int({});\n", texel / 4, texel % 4, conv_.byte(texel, c));
      for (size_t i = 0; i < 4; ++i)
        for (size_t column = 0; column < 4; ++column)
          block += fmt::format("  int e{}{} = {};\n", i, column, combine(kBt[i], [&](size_t row) {
                                 return fmt::format("d{}{}", row, column);
                               }));
      for (size_t i = 0; i < 4; ++i)
        for (size_t j = 0; j < 4; ++j) {
          text += fmt::format("  float {};\n", input(i, j, c));
          block += fmt::format(
              "  {} = float({});\n", input(i, j, c),
              combine(kBt[j], [&](size_t column) { return fmt::format("e{}{}", i, column); }));
        }
      text += "  {\n" + block + "  }\n";
    }
    return text;
  }

  /// Output channels [first, last).
  std::string pass(int64_t first, int64_t last) {
    std::string text = "  {\n";
    const char* type = parts_ > 1 ? "int" : "float";
    for (int64_t oc = first; oc < last; ++oc)
      for (size_t pixel = 0; pixel < 4; ++pixel)
        text += fmt::format("  {} {} = {}(0);\n", type, output(pixel, oc), type);
    for (int64_t part = 0; part < parts_; ++part) text += sums(first, last, part, type);
    for (size_t pixel = 0; pixel < 4; ++pixel)
      conv_.results(text, first, last, fmt::format("(row * 2 + {})", pixel / 2),
                    fmt::format("(x * 2 + {})", pixel % 2),
                    {.expression = [&](int64_t oc) { return output(pixel, oc); }, .floating = true},
                    fmt::format("_{}", pixel));
    return text + "  }\n";
  }

  /// Adds a part of the input channels to the pass's outputs.
  std::string sums(int64_t first, int64_t last, int64_t part, const char* type) const {
    std::string text = "  {\n";
    for (size_t i = 0; i < 4; ++i)
      for (size_t j = 0; j < 4; ++j) text += position(first, last, part, i, j);
    for (int64_t oc = first; oc < last; ++oc) {
      const auto column = [&](size_t i, size_t b) { return fmt::format("n{}{}_{}", i, b, oc); };
      for (size_t i = 0; i < 4; ++i)
        for (size_t b = 0; b < 2; ++b)
          text += fmt::format("  float {} = {};\n", column(i, b), combine(kAt[b], [&](size_t j) {
                                return fmt::format("m{}{}_{}", i, j, oc);
                              }));
      for (size_t pixel = 0; pixel < 4; ++pixel)
        text +=
            fmt::format("  {} += {}({});\n", output(pixel, oc), type,
                        combine(kAt[pixel / 2], [&](size_t i) { return column(i, pixel % 2); }));
    }
    return text + "  }\n";
  }

  /// The sums over a part's input channels at position (i, j).
  std::string position(int64_t first, int64_t last, int64_t part, size_t i, size_t j) const {
    std::string before, after, products;
    for (int64_t oc = first; oc < last; ++oc) {
      before += fmt::format("  float m{}{}_{};\n", i, j, oc);
      after += fmt::format("  m{0}{1}_{2} = a{2} * {3:.2f};\n", i, j, oc, 0.25 * multiple(i, j));
    }
    before += "  {\n";
    for (int64_t oc = first; oc < last; ++oc) before += fmt::format("  float a{} = 0.0;\n", oc);
    for (int64_t c = part_start(conv_, part, parts_); c < part_start(conv_, part + 1, parts_); ++c)
      for (int64_t oc = first; oc < last; ++oc) {
        const int64_t u = transformed(conv_, oc, i, j, c) / multiple(i, j);
        if (u != 0) products += fmt::format("  a{} += {} * {}.0;\n", oc, input(i, j, c), u);
      }
    return before + products + after + "  }\n";
  }

  LiteralConv conv_;
  int64_t parts_;  ///< of the input channels, to be summed up apart
  Tiling tiling_;
};

}  // namespace

bool conv2d_winograd32_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return LiteralConv::supports(problem, profile) && Winograd32(problem, profile).supported();
}

int64_t conv2d_winograd32_literals(const GroupProblem& problem, const DeviceProfile& profile) {
  return products(LiteralConv(problem, profile));
}

WorkTable conv2d_winograd32_work(const GroupProblem& problem, const DeviceProfile& profile) {
  WorkTable work = Winograd32(problem, profile).work();
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

Result<std::vector<KernelSource>> conv2d_winograd32_emit(const GroupProblem& problem,
                                                         const DeviceProfile& profile) {
  std::vector<KernelSource> sources;
  sources.push_back(Winograd32(problem, profile).emit());
  return sources;
}

}  // namespace shale
