// compiler/plan/tiles.h -- tiles of an output picture and the input that they need: pure functions.
#pragma once

#include <cstdint>

namespace shale {

/// How output positions map to input positions along one axis.
struct TapWindow {
  int64_t taps = 1, stride = 1, dilation = 1;
};

/// Input positions that `outputs` neighbouring output positions read, border included.
constexpr int64_t window_input(int64_t outputs, const TapWindow& window) {
  return (outputs - 1) * window.stride + (window.taps - 1) * window.dilation + 1;
}

/// A picture made in tiles that stay on chip.
struct TiledPicture {
  int64_t height = 0, width = 0;  ///< output positions
  TapWindow rows, columns;
  double input_bytes = 0;   ///< an input position, all channels
  double output_bytes = 0;  ///< an output position
  double fixed_bytes = 0;   ///< what every tile needs: the weights
};

struct Tile {
  int64_t height = 0, width = 0;  ///< output positions
  /// Input positions that all tiles read together, of those that one tile for the whole picture
  /// would read: 1 without a halo.
  double halo = 1;
};

/// The tile that reads least, of full rows and of squares of powers of two, among those whose input,
/// output and fixed bytes fit `cache_bytes`; the larger one at a tie. A single position where nothing
/// fits.
Tile choose_tile(const TiledPicture& picture, double cache_bytes);

}  // namespace shale
