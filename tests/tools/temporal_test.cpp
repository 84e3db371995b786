// Measures over time on sequences whose answer is known.
#include "tools/eval/temporal.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "tools/eval/sequence.h"

namespace shale {
namespace {

constexpr uint32_t kSide = 64;

FloatImage plane(uint32_t channels, const std::function<float(uint32_t x, uint32_t y)>& value) {
  FloatImage image{kSide, kSide, channels, {}};
  for (uint32_t y = 0; y < kSide; ++y)
    for (uint32_t x = 0; x < kSide; ++x)
      for (uint32_t c = 0; c < channels; ++c) image.values.push_back(value(x, y));
  return image;
}
FloatImage grey(float codes) {
  return plane(3, [&](uint32_t, uint32_t) { return codes / 255; });
}

/// A sequence of one method. The frame's truth, and the picture, in [0, 1].
struct Frame {
  FloatImage truth, output;
  FloatImage motion = plane(2, [](uint32_t, uint32_t) { return 0.0f; });
  FloatImage depth = plane(1, [](uint32_t, uint32_t) { return 0.5f; });
  bool cut = false, reverse_depth = false, has_depth = true;
};

SequenceMetrics measure(uint32_t frames, uint32_t period,
                        const std::function<Frame(uint32_t)>& make) {
  SequenceOptions options;
  options.frame.ssim = options.frame.flip = false;
  options.grid_period = period;
  ReferenceTrack track(options);
  SequenceEvaluator evaluator(options);
  for (uint32_t t = 0; t < frames; ++t) {
    Frame frame = make(t);
    EXPECT_TRUE(track.advance({.display = std::move(frame.truth),
                               .motion = &frame.motion,
                               .depth = frame.has_depth ? &frame.depth : nullptr,
                               .reverse_depth = frame.reverse_depth,
                               .cut = frame.cut,
                               .camera_still = t > 0}));
    EXPECT_TRUE(evaluator.add(std::move(frame.output), track));
  }
  return evaluator.finish();
}

/// Light that steps from 40 to 160 codes in frame 4; what the method shows k frames later.
SequenceMetrics step(const std::function<float(int k)>& shown) {
  return measure(26, 2, [&](uint32_t t) {
    const int k = static_cast<int>(t) - 4;
    return Frame{grey(k < 0 ? 40 : 160), grey(k < 0 ? 40 : shown(k))};
  });
}

TEST(Temporal, LagIsTheFramesUntilNineTenthsAreMade) {
  constexpr uint64_t kInside = (kSide - 4) * (kSide - 4);  // the window of brightness lies inside
  const auto at_once = step([](int) { return 160.0f; }).temporal.lag;
  ASSERT_TRUE(at_once);
  EXPECT_EQ(at_once->events, kInside);
  EXPECT_EQ(at_once->frames, 0);
  EXPECT_EQ(step([](int k) { return k < 3 ? 40.0f : 160.0f; }).temporal.lag->frames, 3);
  // Half of what is left in each frame: 0.875 after three, 0.9375 after four.
  EXPECT_EQ(step([](int k) {
              return 160 - 120 * std::exp2(-1 - static_cast<float>(k));
            }).temporal.lag->frames,
            3);
  const auto never = step([](int) { return 130.0f; }).temporal.lag;
  EXPECT_EQ(never->frames, kLagFrames);
  EXPECT_EQ(never->open_fraction, 1);
  // To be past it for a moment is enough: what flickers is measured elsewhere.
  EXPECT_EQ(step([](int k) { return k == 1 ? 170.0f : 100.0f; }).temporal.lag->frames, 1);
}

TEST(Temporal, LagSeesSlowChangesAndNoSteadyLight) {
  EXPECT_FALSE(measure(20, 2, [](uint32_t) { return Frame{grey(90), grey(20)}; }).temporal.lag);
  // Eight codes a frame from frame 2 on: an event every third frame; a method that is two frames late has each
  // two frames later.
  const auto ramp = [](int t) { return 30 + 8.0f * static_cast<float>(std::max(t - 1, 0)); };
  const auto lag = measure(21, 2, [&](uint32_t t) {
                     const int at = static_cast<int>(t);
                     return Frame{grey(ramp(at)), grey(ramp(at - 2))};
                   }).temporal.lag;
  ASSERT_TRUE(lag);
  EXPECT_GE(lag->frames, 1.5);
  EXPECT_LE(lag->frames, 2);
  // Behind a cut everything is new.
  EXPECT_FALSE(measure(8, 2, [](uint32_t t) {
                 Frame frame{grey(t < 4 ? 40 : 160), grey(40)};
                 frame.cut = t == 4;
                 return frame;
               }).temporal.lag);
}

TEST(Temporal, BrightnessIsSigned) {
  EXPECT_NEAR(*measure(3, 2,
                       [](uint32_t) {
                         return Frame{grey(90), grey(85)};
                       })
                   .temporal.brightness_codes,
              -5, 1e-3);
  const SequenceMetrics both = measure(14, 2, [](uint32_t t) {
    return Frame{grey(90), grey(t < 10 ? 93 : 97)};
  });
  EXPECT_NEAR(*both.first.brightness_codes, 3, 1e-3);
  EXPECT_NEAR(*both.later.brightness_codes, 7, 1e-3);
  EXPECT_EQ(both.first.frames, 10u);
  EXPECT_EQ(both.later.frames, 4u);
  EXPECT_NEAR(*both.first.psnr_db, 20 * std::log10(255.0 / 3), 1e-3);
  EXPECT_NEAR(*both.later.psnr_db, 20 * std::log10(255.0 / 7), 1e-3);
}

/// A square of 12 pixels that moves by 4 a frame in front of a ground above and sky below; errors of 16 codes on what was
/// uncovered up to one frame ago, of 4 three frames ago on the ground alone.
Frame passing(uint32_t t, bool reverse) {
  const uint32_t left = 4 + 4 * t, right = left + 12;
  const auto inside = [=](uint32_t x, uint32_t y) {
    return x >= left && x < right && y >= 10 && y < 54;
  };
  const auto is_sky = [](uint32_t y) { return y >= 32; };
  Frame frame;
  frame.reverse_depth = reverse;
  frame.motion = FloatImage{kSide, kSide, 2, {}};
  frame.truth = plane(3, [&](uint32_t x, uint32_t y) {
    return inside(x, y) ? 0.8f : is_sky(y) ? 0.6f : 0.4f;
  });
  frame.depth = plane(1, [&](uint32_t x, uint32_t y) {
    const float closeness = inside(x, y) ? 0.5f : is_sky(y) ? 0.0f : 0.1f;
    return reverse ? closeness : 1 - closeness;
  });
  frame.output = frame.truth;
  for (uint32_t y = 0; y < kSide; ++y)
    for (uint32_t x = 0; x < kSide; ++x) {
      frame.motion.values.push_back(inside(x, y) ? 4.0f / kSide : 0);
      frame.motion.values.push_back(0);
      if (x >= left || x < 4 || y < 10 || y >= 54) continue;
      const uint32_t age = (left - 1 - x) / 4;
      const float codes = age <= 1 ? 16.0f : age == 3 && !is_sky(y) ? 4.0f : 0.0f;
      for (size_t c = 0; c < 3; ++c) frame.output.at(x, y)[c] += codes / 255;
    }
  return frame;
}

TEST(Temporal, TrailIsByFramesSinceAndSkyApart) {
  for (const bool reverse : {false, true}) {
    const TemporalMetrics found =
        measure(12, 2, [&](uint32_t t) { return passing(t, reverse); }).temporal;
    ASSERT_TRUE(found.trail && found.sky_trail);
    for (uint32_t age = 0; age < kTrailFrames; ++age) {
      EXPECT_NEAR(found.trail->codes[age], age <= 1 ? 16 : age == 3 ? 4 : 0, 1e-3) << age;
      EXPECT_NEAR(found.sky_trail->codes[age], age <= 1 ? 16 : 0, 1e-3) << age;
      EXPECT_EQ(found.trail->pixels[age], uint64_t{11 - age} * 4 * 22) << age;
      EXPECT_EQ(found.sky_trail->pixels[age], uint64_t{11 - age} * 4 * 22) << age;
    }
    EXPECT_NEAR(*found.sky_trail->mean(3), 0, 1e-3);
    EXPECT_GT(*found.trail->mean(3), 0);
    EXPECT_FALSE(found.lag) << "what moves by is no change of light";
  }
  const TemporalMetrics none = measure(3, 2, [&](uint32_t t) {
                                 Frame frame = passing(t, false);
                                 frame.has_depth = false;
                                 return frame;
                               }).temporal;
  EXPECT_FALSE(none.trail);
  EXPECT_FALSE(none.sky_trail);
}

TEST(Temporal, GridIsTheDeviationOfThePhasesInSmoothPlaces) {
  // A slope is smooth and no grid.
  const auto slope = [](uint32_t x, uint32_t y) {
    return (100 + 0.4f * static_cast<float>(x) - 0.3f * static_cast<float>(y)) / 255;
  };
  const auto grid = [&](uint32_t period, const std::function<float(uint32_t, uint32_t)>& codes) {
    return *measure(2, period, [&](uint32_t) {
              return Frame{plane(3, slope), plane(3, [&](uint32_t x, uint32_t y) {
                             return slope(x, y) + codes(x, y) / 255;
                           })};
            }).temporal.grid;
  };
  const Grid none = grid(2, [](uint32_t, uint32_t) { return 3.0f; });
  EXPECT_EQ(none.windows, 2u * 64);
  EXPECT_NEAR(none.output_codes, 0, 1e-3);
  EXPECT_NEAR(none.truth_codes, 0, 1e-3);
  const Grid two = grid(2, [](uint32_t x, uint32_t y) { return (x + y) % 2 == 0 ? 2.0f : -2.0f; });
  EXPECT_NEAR(two.output_codes, 2, 1e-3);
  EXPECT_NEAR(two.truth_codes, 0, 1e-3);
  // One phase of nine is 9 codes brighter: 8 above the mean, the others 1 below.
  const Grid three =
      grid(3, [](uint32_t x, uint32_t y) { return x % 3 == 1 && y % 3 == 1 ? 9.0f : 0.0f; });
  EXPECT_NEAR(three.output_codes, std::sqrt(8.0), 1e-3);
  // Where the truth is not smooth there is nothing to see.
  EXPECT_FALSE(measure(2, 2, [](uint32_t) {
                 const FloatImage stripes =
                     plane(3, [](uint32_t x, uint32_t) { return x % 4 < 2 ? 0.4f : 0.6f; });
                 return Frame{stripes, stripes};
               }).temporal.grid);
}

TEST(Temporal, GridPeriodIsThatOfWholeRenderPixels) {
  EXPECT_EQ(grid_period({960, 540}, {1920, 1080}), 2u);
  EXPECT_EQ(grid_period({640, 360}, {1920, 1080}), 3u);
  EXPECT_EQ(grid_period({1280, 720}, {1920, 1080}), 3u);
  EXPECT_EQ(grid_period({1440, 810}, {1920, 1080}), 4u);
  EXPECT_EQ(grid_period({768, 432}, {1920, 1080}), 5u);
}

TEST(Temporal, RestLeavesOutWhatChangesInTheTruth) {
  // On the left nothing happens and the method alternates by a code; on the right both change by 20.
  const SequenceMetrics found = measure(24, 2, [](uint32_t t) {
    const float odd = static_cast<float>(t % 2);
    const auto truth = [=](uint32_t x, uint32_t) {
      return (100 + (x < kSide / 2 ? 0.0f : 20 * odd)) / 255;
    };
    const auto output = [=](uint32_t x, uint32_t) {
      return (100 + (x < kSide / 2 ? odd : 20 * odd)) / 255;
    };
    return Frame{plane(3, truth), plane(3, output)};
  });
  ASSERT_TRUE(found.still && found.still->rest_code_values);
  EXPECT_NEAR(*found.still->rest_code_values, 0.5, 1e-9);
  EXPECT_NEAR(found.still->code_values, (0.5 + 10) / 2, 1e-9);
}

}  // namespace
}  // namespace shale
