#include "compiler/plan/tiles.h"

#include <algorithm>

namespace shale {
namespace {

/// Input positions that tiles of `size` read to make `outputs` positions along an axis.
int64_t tiled_input(int64_t outputs, int64_t size, const TapWindow& window) {
  const int64_t whole = outputs / size, rest = outputs % size;
  return whole * window_input(size, window) + (rest > 0 ? window_input(rest, window) : 0);
}

}  // namespace

Tile choose_tile(const TiledPicture& picture, double cache_bytes) {
  const double all = static_cast<double>(window_input(picture.height, picture.rows)) *
                     static_cast<double>(window_input(picture.width, picture.columns));
  const auto tile_of = [&](int64_t height, int64_t width) {
    const double read = static_cast<double>(tiled_input(picture.height, height, picture.rows)) *
                        static_cast<double>(tiled_input(picture.width, width, picture.columns));
    return Tile{height, width, read / all};
  };
  const auto fits = [&](const Tile& tile) {
    const double input = static_cast<double>(window_input(tile.height, picture.rows)) *
                         static_cast<double>(window_input(tile.width, picture.columns)),
                 output = static_cast<double>(tile.height) * static_cast<double>(tile.width);
    return input * picture.input_bytes + output * picture.output_bytes + picture.fixed_bytes <=
           cache_bytes;
  };
  Tile best = tile_of(1, 1);
  const auto consider = [&](const Tile& tile) {
    const bool larger = tile.height * tile.width > best.height * best.width;
    if (fits(tile) && (tile.halo < best.halo || (tile.halo == best.halo && larger))) best = tile;
  };
  for (int64_t side = 1;; side *= 2) {
    const int64_t height = std::min(side, picture.height), width = std::min(side, picture.width);
    consider(tile_of(height, picture.width));
    consider(tile_of(height, width));
    if (height == picture.height && width == picture.width) return best;
  }
}

}  // namespace shale
