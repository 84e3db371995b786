// Convolutions as sums over the texels of a TapMap: their code, and what it does.
#include <algorithm>

#include "compiler/kernels/literal_conv.h"

namespace shale {

void TapMap::finish(Arithmetic own) {
  arithmetic = own;
  const std::vector<std::array<int64_t, 2>> one = texels;
  for (size_t i = 0; i < one.size(); ++i) {
    taps.push_back({i, i});
    if (sides() == 1) continue;
    const std::array<int64_t, 2> right{one[i][0], one[i][1] + step_x};
    const auto at = std::find(texels.begin(), texels.end(), right);
    taps[i][1] = static_cast<size_t>(at - texels.begin());
    if (at == texels.end()) texels.push_back(right);
  }
  tile_width *= sides();
  step_x *= sides();
}

int64_t TapMap::products(const LiteralConv& conv) const {
  int64_t count = 0;
  for (int64_t pixel = 0; pixel < pixels(); ++pixel)
    for (size_t tap = 0; tap < taps.size(); ++tap)
      for (int64_t oc = 0; oc < conv.out()[3]; ++oc) {
        const auto [from, to] = conv.read_by(oc, oc + 1);
        for (int64_t c = from; c < to; ++c) count += weight(pixel, tap, oc, c) != 0;
      }
  return count;
}

namespace {

/// Output channels of a module: as many live sums as fit, or a part of them, in fours so that
/// results make words; 0 if not even four channels fit.
int64_t channels_per_module(const LiteralConv& conv, const TapMap& map, int64_t most_products) {
  const int64_t channels = conv.out()[3];
  const int64_t fit = most_products / map.products_per_channel;
  if (fit >= channels) return channels;
  return fit >= conv.live_sums() ? fit / conv.live_sums() * conv.live_sums() : fit / 4 * 4;
}

/// Pixels whose sums for so many output channels are live together.
int64_t pixels_per_pass(const LiteralConv& conv, int64_t channels) {
  return std::max<int64_t>(conv.live_sums() / channels, 1);
}

class TapEmitter {
 public:
  TapEmitter(const GroupProblem& problem, const DeviceProfile& profile, const TapMap& map)
      : conv_(problem, profile), map_(map), pair_(map.arithmetic == Arithmetic::kDoublePair) {
    switch (map.arithmetic) {
      case Arithmetic::kInt32:
        type_ = "int";
        point_ = "";
        break;
      case Arithmetic::kFloat32:
        type_ = "float";
        point_ = ".0";
        break;
      case Arithmetic::kDoublePair:
      case Arithmetic::kDouble:
        type_ = "double";
        point_ = ".0lf";
        break;
    }
  }

  KernelSource module(int64_t first, int64_t last) {
    std::string body;
    const int64_t step = conv_.channels_per_loop(last - first);
    for (int64_t oc = first; oc < last; oc += step) {
      const int64_t end = std::min(last, oc + step), together = pixels_per_pass(conv_, end - oc);
      std::string passes;
      for (int64_t pixel = 0; pixel < map_.pixels(); pixel += together)
        passes += pass(oc, end, pixel, std::min(map_.pixels(), pixel + together));
      body += conv_.over_rows(map_, passes, conv_.read_by(oc, end));
    }
    return conv_.finish(map_, body);
  }

 private:
  /// Channels [first, last) of the tile's pixels [pixel, end).
  std::string pass(int64_t first, int64_t last, int64_t pixel, int64_t end) {
    std::string text = fmt::format("  {{\n  {} v;\n", type_);
    for (int64_t p = pixel; p < end; ++p)
      for (int64_t oc = first; oc < last; ++oc)
        text += fmt::format("  {} {} = 0{};\n", type_, sum(p, oc), point_);
    const auto [from, to] = conv_.read_by(first, last);
    for (size_t i = 0; i < map_.taps.size(); ++i)
      for (int64_t c = from; c < to; ++c) text += products(first, last, pixel, end, i, c);
    const int64_t width = map_.tile_width / map_.sides();
    for (int64_t p = pixel; p < end; ++p) {
      if (pair_)
        for (int64_t oc = first; oc < last; ++oc) text += conv_.split(sum(p, oc), kPairSpacing);
      for (int64_t side = 0; side < map_.sides(); ++side)
        conv_.results(text, first, last,
                      fmt::format("(row * {} + {})", map_.tile_height, p / width),
                      fmt::format("(x * {} + {})", map_.tile_width, side * width + p % width),
                      {.expression =
                           [&](int64_t oc) {
                             return pair_ ? fmt::format("{}_{}", sum(p, oc), side) : sum(p, oc);
                           },
                       .floating = map_.arithmetic != Arithmetic::kInt32},
                      fmt::format("_{}_{}", side, p));
    }
    return text + "  }\n";
  }

  static std::string sum(int64_t pixel, int64_t oc) { return fmt::format("a{}_{}", pixel, oc); }

  /// What channel `c` of a tap adds to the sums. One product a statement: the order in which the
  /// fewest values are live at once.
  std::string products(int64_t first, int64_t last, int64_t pixel, int64_t end, size_t tap,
                       int64_t c) const {
    std::string sums;
    for (int64_t p = pixel; p < end; ++p)
      for (int64_t oc = first; oc < last; ++oc) {
        const int64_t w = map_.weight(p, tap, oc, c);
        if (w != 0) sums += fmt::format("  {} += v * {}{};\n", sum(p, oc), w, point_);
      }
    if (sums.empty()) return sums;
    const std::array<size_t, 2>& texels = map_.taps[tap];
    return fmt::format(
               "  v = {}({});\n", type_,
               pair_ ? conv_.byte_pair(texels, c, kPairSpacing) : conv_.number(texels[0], c)) +
           sums;
  }

  LiteralConv conv_;
  const TapMap& map_;
  bool pair_;
  const char* type_;   ///< of sums
  const char* point_;  ///< after the digits of a literal of that type
};

}  // namespace

std::vector<KernelSource> emit_taps(const GroupProblem& problem, const DeviceProfile& profile,
                                    const TapMap& map, int64_t most_products) {
  const LiteralConv conv(problem, profile);
  const int64_t channels = conv.out()[3], step = channels_per_module(conv, map, most_products);
  std::vector<KernelSource> sources;
  for (int64_t first = 0; first < channels; first += step)
    sources.push_back(
        TapEmitter(problem, profile, map).module(first, std::min(channels, first + step)));
  return sources;
}

WorkTable tap_work(const GroupProblem& problem, const DeviceProfile& profile, const TapMap& map,
                   int64_t most_products) {
  const LiteralConv conv(problem, profile);
  const int64_t channels = conv.out()[3],
                step = std::max<int64_t>(channels_per_module(conv, map, most_products), 1);
  const auto [height, width] = conv.tiles(map);
  const double tiles = static_cast<double>(literal_lanes(width) * height * conv.out()[0]);
  WorkTable work{};
  double unpacked = 0;  // channels, over all passes
  for (int64_t first = 0; first < channels; first += step) {
    const int64_t last = std::min(channels, first + step),
                  loop = conv.channels_per_loop(last - first);
    for (int64_t oc = first; oc < last; oc += loop) {
      const int64_t end = std::min(last, oc + loop);
      const std::array<int64_t, 2> read = conv.read_by(oc, end);
      work[Work::kFetch] += tiles * conv.fetches(map, read);
      unpacked += static_cast<double>(ceil_div(map.pixels(), pixels_per_pass(conv, end - oc)) *
                                      (read[1] - read[0]));
    }
    work[Work::kDispatch] += 1;
  }
  work[Work::kCode] = static_cast<double>(map.products(conv));
  const bool in_doubles =
      map.arithmetic == Arithmetic::kDoublePair || map.arithmetic == Arithmetic::kDouble;
  const Work product = in_doubles                             ? Work::kPairProduct
                       : map.arithmetic == Arithmetic::kInt32 ? Work::kIntProduct
                                                              : Work::kFloatProduct;
  work[product] = work[Work::kCode] * tiles;
  work[Work::kUnpack] = tiles * unpacked * static_cast<double>(map.taps.size());
  work[Work::kResult] = tiles * static_cast<double>(map.tile_height * map.tile_width * channels);
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

std::optional<int64_t> count_tap_modules(const LiteralConv& conv, const TapMap& map,
                                         int64_t most_products) {
  const int64_t step = channels_per_module(conv, map, most_products);
  if (step == 0 || !conv.fits_grid(map)) return std::nullopt;
  return ceil_div(conv.out()[3], step);
}

}  // namespace shale
