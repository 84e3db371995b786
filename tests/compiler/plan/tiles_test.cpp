#include "compiler/plan/tiles.h"

#include <gtest/gtest.h>

namespace shale {
namespace {

/// Positions that any of `outputs` outputs reads along an axis, by enumeration.
int64_t span(int64_t outputs, const TapWindow& window) {
  int64_t last = 0;
  for (int64_t out = 0; out < outputs; ++out)
    for (int64_t tap = 0; tap < window.taps; ++tap)
      last = std::max(last, out * window.stride + tap * window.dilation);
  return last + 1;
}

TEST(Tile, WindowInputSpansWhatTheTapsReach) {
  for (int64_t taps = 1; taps <= 5; ++taps)
    for (int64_t stride = 1; stride <= 3; ++stride)
      for (int64_t dilation = 1; dilation <= 3; ++dilation)
        for (int64_t outputs = 1; outputs <= 9; ++outputs) {
          const TapWindow window{taps, stride, dilation};
          EXPECT_EQ(window_input(outputs, window), span(outputs, window))
              << taps << " " << stride << " " << dilation << " " << outputs;
        }
}

TiledPicture picture(int64_t height, int64_t width, int64_t taps) {
  return {.height = height,
          .width = width,
          .rows = {taps, 1, 1},
          .columns = {taps, 1, 1},
          .input_bytes = 32,
          .output_bytes = 32,
          .fixed_bytes = 9216};
}

TEST(Tile, TakesTheWholePictureWhereItFits) {
  const Tile tile = choose_tile(picture(60, 80, 3), 1 << 20);
  EXPECT_EQ(tile.height, 60);
  EXPECT_EQ(tile.width, 80);
  EXPECT_EQ(tile.halo, 1.0);
}

TEST(Tile, CountsHalosOfSmallerTiles) {
  const TiledPicture big = picture(540, 960, 3);
  const Tile tile = choose_tile(big, 1 << 19);
  const double bytes = 32.0 * static_cast<double>((tile.height + 2) * (tile.width + 2)) +
                       32.0 * static_cast<double>(tile.height * tile.width) + 9216;
  EXPECT_LE(bytes, 1 << 19);
  EXPECT_GT(tile.halo, 1.0);
  // By hand: the tiles' inputs one after the other.
  double read = 0;
  for (int64_t y = 0; y < 540; y += tile.height)
    for (int64_t x = 0; x < 960; x += tile.width)
      read += static_cast<double>((std::min<int64_t>(tile.height, 540 - y) + 2) *
                                  (std::min<int64_t>(tile.width, 960 - x) + 2));
  EXPECT_DOUBLE_EQ(tile.halo, read / (542.0 * 962.0));
  EXPECT_LT(choose_tile(big, 1 << 22).halo, tile.halo) << "more memory, less read twice";
}

TEST(Tile, HasNoHaloWithoutNeighbours) {
  EXPECT_EQ(choose_tile(picture(540, 960, 1), 1 << 16).halo, 1.0);
}

TEST(Tile, FallsBackToOnePositionWhereNothingFits) {
  const Tile tile = choose_tile(picture(8, 8, 3), 100);
  EXPECT_EQ(tile.height, 1);
  EXPECT_EQ(tile.width, 1);
  EXPECT_DOUBLE_EQ(tile.halo, 9.0 * 64 / 100);
}

}  // namespace
}  // namespace shale
