// Figures of generated pictures on pictures whose answer is known.
#include "tools/eval/generated.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "tools/eval/metrics.h"

namespace shale {
namespace {

constexpr uint32_t kWidth = 40, kHeight = 20;

FloatImage image(uint32_t channels,
                 const std::function<float(uint32_t x, uint32_t y, uint32_t c)>& value) {
  FloatImage result{kWidth, kHeight, channels, {}};
  for (uint32_t y = 0; y < kHeight; ++y)
    for (uint32_t x = 0; x < kWidth; ++x)
      for (uint32_t c = 0; c < channels; ++c) result.values.push_back(value(x, y, c));
  return result;
}

constexpr float kNear = 0.5f, kFar = 0.9f;

/// At the moment of the truth a near thing covers columns 16 to 23; it moves 4 pixels to the right from the frame before to
/// the moment, and 4 more to the frame behind it. The far picture stands still.
struct Sliding {
  static FloatImage depth_with(uint32_t first) {
    return image(1, [=](uint32_t x, uint32_t, uint32_t) {
      return x >= first && x < first + 8 ? kNear : kFar;
    });
  }
  static FloatImage motion_of(float pixels) {
    return image(2, [=](uint32_t x, uint32_t, uint32_t c) {
      return c == 0 && x >= 16 && x < 24 ? pixels / kWidth : 0.0f;
    });
  }
  static FloatImage color_with(uint32_t first) {
    return image(3, [=](uint32_t x, uint32_t y, uint32_t c) {
      return x >= first && x < first + 8 ? 0.75f + 0.05f * static_cast<float>(c)
                                         : static_cast<float>((x * 7 + y * 3 + c) % 8) / 16;
    });
  }
  FloatImage depth = depth_with(16), before_depth = depth_with(12), after_depth = depth_with(20);
  FloatImage to_before = motion_of(4), to_after = motion_of(-4);
  FloatImage still = image(2, [](uint32_t, uint32_t, uint32_t) { return 0.0f; });
  FloatImage display = color_with(16), before = color_with(12), after = color_with(20);
  PictureTruth truth{&display, nullptr, &depth, &to_before, &still, false};
  std::array<SourceView, 2> views{SourceView{&to_before, &before_depth},
                                  SourceView{&to_after, &after_depth}};
};

bool has(uint8_t kinds, PixelKind kind) { return kinds >> static_cast<uint32_t>(kind) & 1; }

TEST(Generated, KindsFollowWhatTheFramesSaw) {
  const Sliding s;
  const std::vector<uint8_t> kinds = pixel_kinds(s.truth, s.views);
  for (uint32_t x = 0; x < kWidth; ++x) {
    const uint8_t own = kinds[5 * kWidth + x];
    // 12 to 15 the thing has left since the frame before, 24 to 27 it is about to cover.
    const bool covered_once = (x >= 12 && x < 16) || (x >= 24 && x < 28);
    EXPECT_EQ(has(own, PixelKind::kSeenInSome), covered_once) << x;
    EXPECT_EQ(has(own, PixelKind::kSeenInAll), !covered_once) << x;
    EXPECT_FALSE(has(own, PixelKind::kSeenInNone)) << x;
    EXPECT_EQ(has(own, PixelKind::kMoving), x >= 16 && x < 24) << x;
    EXPECT_FALSE(has(own, PixelKind::kBorder) || has(own, PixelKind::kMotionless)) << x;
  }
  // Of one frame alone.
  const std::vector<uint8_t> alone = pixel_kinds(s.truth, std::span(s.views).first(1));
  EXPECT_TRUE(has(alone[5 * kWidth + 13], PixelKind::kSeenInNone));
  EXPECT_TRUE(has(alone[5 * kWidth + 25], PixelKind::kSeenInAll));
}

TEST(Generated, ReversedDepthHasTheSameKinds) {
  Sliding s;
  const std::vector<uint8_t> kinds = pixel_kinds(s.truth, s.views);
  for (FloatImage* depth : {&s.depth, &s.before_depth, &s.after_depth})
    for (float& d : depth->values) d = 1 - d;
  s.truth.reverse_depth = true;
  EXPECT_EQ(pixel_kinds(s.truth, s.views), kinds);
}

TEST(Generated, BordersAndParticlesAreFound) {
  Sliding s;
  const FloatImage pan =
      image(2, [](uint32_t, uint32_t, uint32_t c) { return c == 0 ? 5.0f / kWidth : 0.0f; });
  FloatImage bare = s.display;
  bare.at(30, 4)[1] += 0.1f;
  bare.at(31, 4)[1] += 0.001f;
  s.truth.bare = &bare;
  const std::vector<uint8_t> kinds =
      pixel_kinds(s.truth, std::array{SourceView{&pan, &s.before_depth}});
  for (uint32_t x = 0; x < kWidth; ++x) EXPECT_EQ(has(kinds[x], PixelKind::kBorder), x < 5) << x;
  EXPECT_TRUE(has(kinds[4 * kWidth + 30], PixelKind::kMotionless));
  EXPECT_FALSE(has(kinds[4 * kWidth + 31], PixelKind::kMotionless));
}

TEST(Generated, TrueMotionMakesTheTruthOfWhatWasSeen) {
  const Sliding s;
  const std::array<const FloatImage*, 2> colors{&s.before, &s.after};
  const std::array<float, 2> weights{0.5f, 0.5f};
  const FloatImage made = warped_by_truth(s.truth, s.views, colors, weights);
  double worst = 0;
  for (size_t i = 0; i < made.values.size(); ++i)
    worst = std::max(worst, std::abs(double{made.values[i]} - s.display.values[i]));
  EXPECT_LT(worst, 1e-4);
}

TEST(Generated, FiguresArePooledByKind) {
  KindSums sums;
  const FloatImage truth = image(3, [](uint32_t, uint32_t, uint32_t) { return 0.5f; });
  FloatImage off = truth;
  std::vector<uint8_t> kinds(size_t{kWidth} * kHeight, 1);
  for (size_t i = 0; i < 80; ++i) {
    kinds[i] = 2 | 16;
    for (size_t c = 0; c < 3; ++c) off.values[3 * i + c] += 0.1f;
  }
  sums.add(truth, off, kinds);
  sums.add(truth, truth, kinds);
  const auto found = sums.finish();
  EXPECT_EQ(found[0].psnr_db, kPsnrCapDb);
  EXPECT_NEAR(found[0].share, 0.9, 1e-9);
  EXPECT_NEAR(found[1].share, 0.1, 1e-9);
  EXPECT_NEAR(*found[1].psnr_db, 20 + 10 * std::log10(2.0), 1e-4);  // half of them are right
  EXPECT_NEAR(*found[4].psnr_db, *found[1].psnr_db, 1e-9);
  EXPECT_FALSE(found[2].psnr_db);
  EXPECT_EQ(found[2].share, 0);
}

TEST(Generated, JudderIsTheSwingBetweenNeighbours) {
  EXPECT_EQ(judder_db(std::array{30.0, 30.0, 30.0, 30.0}), 0.0);
  EXPECT_NEAR(*judder_db(std::array{30.0, 31.0, 32.0, 33.0, 34.0}), 0, 1e-9);  // grows evenly
  EXPECT_NEAR(*judder_db(std::array{32.0, 28.0, 32.0, 28.0, 32.0, 28.0}), 4, 1e-9);
  EXPECT_FALSE(judder_db(std::array{30.0, 30.0}));
  EXPECT_FALSE(judder_db(std::array{kPsnrCapDb, 30.0, kPsnrCapDb, 30.0}));
}

}  // namespace
}  // namespace shale
