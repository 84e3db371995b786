// The worst inputs that `shale stress` found, as they were before the repair: lights of up to 65504 beside bright edges.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/e2e/sandwich_support.h"

namespace shale {
namespace {

/// What passes keep in halves, x / (1 + x) of exposed colours: some steps of 2^-11.
constexpr double kOvershoot = 4.0 / 2048;

using Extremes = SandwichTest;

double mapped(double exposed) { return exposed / (1 + exposed); }

float largest(const FloatImage& image) { return std::ranges::max(image.values); }

/// A light of 20 in the dark, whose edge goes on by a part of a pixel a frame, as the motion vectors say.
SourceFrame lamp_frame(Extent render, Extent output, uint32_t index) {
  constexpr double kStep = 0.3;  // render pixels
  SourceFrame frame = frame_of(render, output, index, [&](double u, double v) {
    const double along = u - kStep * index / render.width;
    const bool is_lit = along > 0.3 && along < 0.55 && v > 0.3 && v < 0.7;
    return is_lit ? Color{20, 16, 8} : Color{0.02f, 0.02f, 0.02f};
  });
  for (size_t i = 0; i < frame.motion.values.size(); i += 2)
    frame.motion.values[i] = static_cast<float>(kStep / render.width);
  return frame;
}

TEST_F(Extremes, NoPictureIsBrighterThanTheLampInIt) {
  // Catmull-Rom of the history, and Lanczos of the frame, rise above 1 beside such an edge, where the inverse of x / (1 + x) ends
  // at 65504.
  const Extent render{24, 20}, output{48, 40};
  std::vector<std::pair<std::string, std::unique_ptr<Player>>> players;
  for (const size_t kind : {0u, 1u, 3u})
    players.emplace_back(kKinds[kind].model, player_of(kKinds[kind], kSeed, render, output));
  for (const char* name : {"baselines/lanczos", "baselines/catmull_rom"})
    players.emplace_back(name, player_of(models() + name, {}, render, output));
  for (const auto& [name, player] : players)
    for (uint32_t t = 0; t < 10; ++t) {
      SourceFrame frame = lamp_frame(render, output, t);
      // A flash of one frame that a cut ends.
      if (t == 6)
        for (size_t i = 0; i < frame.color.values.size(); i += 2) frame.color.values[i] = 65504;
      frame.camera.cut = t == 7;
      const FloatImage shown = must(player->play(frame));
      ASSERT_TRUE(all_finite(shown)) << name << " frame " << t;
      EXPECT_LE(mapped(largest(shown)), mapped(largest(frame.color)) + kOvershoot)
          << name << " frame " << t << " goes up to " << largest(shown);
    }
}

TEST_F(Extremes, WhiteCodesOfANetworkAreNoLight) {
  // QRISP's network shows the last code everywhere, on a frame that is almost white itself: a picture of 7.5, to a half of
  // the root that is kept, which beside 1 is 2^-11 * 2 / (1 - 0.88) of it.
  const Extent render{24, 20}, output{48, 40};
  const auto player = qrisp_player(render, output, true);
  for (uint32_t t = 0; t < 4; ++t) {
    const FloatImage shown = must(player->play(frame_of(render, output, t, [](double u, double) {
      return u < 0.5 ? Color{7.5f, 7.5f, 7.5f} : Color{0.5f, 0.5f, 0.5f};
    })));
    ASSERT_TRUE(all_finite(shown));
    EXPECT_LE(largest(shown), 7.5 * (1 + std::exp2(-10) / 0.12)) << "frame " << t;
    EXPECT_GE(largest(shown), 7) << "frame " << t;
  }
}

}  // namespace
}  // namespace shale
