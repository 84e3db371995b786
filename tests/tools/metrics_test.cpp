#include "tools/eval/metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>

#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

FloatImage image(uint32_t width, uint32_t height, uint32_t channels, float value = 0) {
  return {width, height, channels, std::vector<float>(size_t{width} * height * channels, value)};
}

FloatImage grey(uint32_t width, uint32_t height, int code) {
  return image(width, height, 3, static_cast<float>(code) / 255);
}

/// Smooth waves with some noise on top: 8-bit codes.
FloatImage texture(uint32_t width, uint32_t height, uint32_t seed, int64_t shift = 0) {
  FloatImage result = image(width, height, 3);
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      for (uint32_t c = 0; c < 3; ++c) {
        const int64_t at = int64_t{x} - shift;
        const auto hash = static_cast<uint32_t>((at + 1000) * 73856093) ^ (y * 19349663u) ^
                          ((c + seed) * 83492791u);
        const double wave =
            std::sin(0.21 * static_cast<double>(at) + c) * std::cos(0.17 * y + seed);
        result.at(x, y)[c] =
            static_cast<float>(std::lround(120 + 60 * wave + ((hash * 2654435761u) >> 27))) / 255;
      }
  return result;
}

FloatImage with_noise(FloatImage picture, double deviation, uint32_t seed) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> noise(0, deviation);
  for (float& value : picture.values)
    value =
        static_cast<float>(std::clamp(std::lround(value * 255 + noise(generator)), 0l, 255l)) / 255;
  return picture;
}

// Against published programs.

TEST(Metrics, AgreeWithTheOriginalPrograms) {
  const std::string folder = SHALE_SOURCE_DIR "/tests/golden/metrics/";
  const nlohmann::json values = nlohmann::json::parse(std::ifstream(folder + "values.json"));
  ASSERT_GE(values["cases"].size(), 8u);
  for (const nlohmann::json& entry : values["cases"]) {
    const std::string name = entry["case"];
    SCOPED_TRACE(name);
    const Result<Picture> reference_file =
        load_picture(folder + name + "/" + entry["reference"].get<std::string>());
    const Result<Picture> test_file =
        load_picture(folder + name + "/" + entry["test"].get<std::string>());
    ASSERT_TRUE(reference_file && test_file);
    const FloatImage test = to_float_image(*test_file);
    const PreparedReference reference(to_float_image(*reference_file), {});
    const FrameMetrics metrics = compare(reference, test);
    if (entry["psnr_db"].is_null())
      EXPECT_TRUE(std::isinf(*metrics.psnr_db));
    else
      EXPECT_NEAR(*metrics.psnr_db, entry["psnr_db"].get<double>(), 1e-5);
    EXPECT_NEAR(*metrics.ssim->valid, entry["ssim_valid_region"].get<double>(), 5e-6);
    EXPECT_NEAR(*metrics.flip, entry["flip_mean_ppd67"].get<double>(), 5e-6);
  }
}

// One pair.

TEST(Metrics, EqualPicturesHaveNoError) {
  for (const auto& [width, height] : {std::pair{64u, 48u}, {13u, 11u}, {5u, 3u}, {1u, 1u}}) {
    const FloatImage picture = texture(width, height, 1);
    FloatImage map;
    const FrameMetrics metrics = compare(PreparedReference(picture, {}), picture, &map);
    EXPECT_TRUE(std::isinf(*metrics.psnr_db));
    EXPECT_EQ(metrics.ssim->full, 1);
    EXPECT_EQ(metrics.ssim->luma, 1);
    EXPECT_EQ(metrics.ssim->valid.has_value(), width > 10 && height > 10);
    EXPECT_EQ(metrics.ssim->valid.value_or(1), 1);
    EXPECT_EQ(*metrics.flip, 0);
    EXPECT_EQ(map.values, std::vector<float>(size_t{width} * height));
  }
}

TEST(Metrics, PsnrFollowsItsFormula) {
  EXPECT_NEAR(psnr_db(grey(9, 7, 100), grey(9, 7, 110)), 20 * std::log10(25.5), 1e-4);
  FloatImage one = grey(10, 10, 0);
  one.at(3, 4)[1] = 1;  // one of 300 values
  EXPECT_NEAR(psnr_db(grey(10, 10, 0), one), 10 * std::log10(300.0), 1e-9);
  const double values[] = {30, std::numeric_limits<double>::infinity()};
  EXPECT_EQ(mean_psnr_db(values), 65) << "equal frames count as 100 dB";
}

/// Section 2 as it is written, in two dimensions and double.
std::pair<double, double> ssim_by_definition(const FloatImage& p, const FloatImage& q) {
  double weights[11][11], weight_sum = 0;
  for (int j = 0; j < 11; ++j)
    for (int i = 0; i < 11; ++i)
      weight_sum += weights[j][i] =
          std::exp(-((i - 5) * (i - 5) + (j - 5) * (j - 5)) / (2 * 1.5 * 1.5));
  double full = 0, valid = 0, inside = 0;
  const int width = static_cast<int>(p.width), height = static_cast<int>(p.height);
  for (uint32_t c = 0; c < 3; ++c)
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
        for (int j = 0; j < 11; ++j)
          for (int i = 0; i < 11; ++i) {
            const int px = x + i - 5, py = y + j - 5;
            if (px < 0 || py < 0 || px >= width || py >= height) continue;
            const double w = weights[j][i] / weight_sum;
            const double a = p.at(static_cast<uint32_t>(px), static_cast<uint32_t>(py))[c];
            const double b = q.at(static_cast<uint32_t>(px), static_cast<uint32_t>(py))[c];
            mx += w * a, my += w * b, xx += w * a * a, yy += w * b * b, xy += w * a * b;
          }
        const double value = (2 * mx * my + 1e-4) * (2 * (xy - mx * my) + 9e-4) /
                             ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
        full += value;
        if (x >= 5 && y >= 5 && x + 5 < width && y + 5 < height) valid += value, ++inside;
      }
  return {full / (3.0 * width * height), valid / inside};
}

TEST(Metrics, SsimFollowsItsDefinitionUpToTheBorder) {
  const FloatImage reference = texture(37, 70, 3);
  for (const FloatImage& test :
       {with_noise(reference, 10, 1), texture(37, 70, 9), grey(37, 70, 9)}) {
    const SsimValues values = ssim(reference, test);
    const auto [full, valid] = ssim_by_definition(reference, test);
    EXPECT_NEAR(values.full, full, 2e-6);
    EXPECT_NEAR(*values.valid, valid, 2e-6);
  }
}

TEST(Metrics, SsimOfFlatPicturesIsTheLuminanceTerm) {
  const SsimValues values = ssim(image(32, 32, 3, 0.2f), image(32, 32, 3, 0.4f));
  EXPECT_NEAR(*values.valid, (2 * 0.2 * 0.4 + 1e-4) / (0.04 + 0.16 + 1e-4), 1e-5);
  EXPECT_NEAR(*values.luma_valid, *values.valid, 1e-5);
}

TEST(Metrics, FlipOfGreenAndBlueIsOne) {
  FloatImage green = image(24, 24, 3), blue = green;
  for (size_t i = 0; i < green.values.size(); i += 3) green.values[i + 1] = blue.values[i + 2] = 1;
  EXPECT_NEAR(flip(green, blue).mean, 1, 1e-5) << "the largest distance in sRGB";
}

TEST(Metrics, FlipGrowsWithTheErrorAndWithTheViewersDistanceItShrinks) {
  const FloatImage reference = texture(80, 60, 4);
  double last = 0;
  for (const double deviation : {2.0, 8.0, 32.0}) {
    const double value = flip(reference, with_noise(reference, deviation, 5)).mean;
    EXPECT_GT(value, last);
    last = value;
  }
  const FloatImage noisy = with_noise(reference, 16, 5);
  EXPECT_GT(flip(reference, noisy, 30).mean, flip(reference, noisy, 200).mean);
}

TEST(Metrics, AThreadMoreChangesNoBit) {
  const FloatImage reference = texture(150, 201, 6), test = with_noise(reference, 12, 2);
  MetricOptions one, many;
  one.threads = 1;
  many.threads = 5;
  FloatImage map_one, map_many;
  const FrameMetrics a = compare(PreparedReference(reference, one), test, &map_one);
  const FrameMetrics b = compare(PreparedReference(reference, many), test, &map_many);
  EXPECT_EQ(*a.psnr_db, *b.psnr_db);
  EXPECT_EQ(a.ssim->full, b.ssim->full);
  EXPECT_EQ(*a.ssim->valid, *b.ssim->valid);
  EXPECT_EQ(*a.flip, *b.flip);
  EXPECT_EQ(map_one.values, map_many.values);
  EXPECT_EQ(flip(reference, test).map.values, map_one.values) << "prepared or not";
}

TEST(Metrics, OnlyWhatIsAskedForIsThere) {
  MetricOptions options;
  options.flip = options.ssim = false;
  const FrameMetrics metrics =
      compare(PreparedReference(grey(20, 20, 9), options), grey(20, 20, 7));
  EXPECT_TRUE(metrics.psnr_db);
  EXPECT_FALSE(metrics.ssim);
  EXPECT_FALSE(metrics.flip);
}

TEST(Metrics, PicturesOfAnotherSizeAreRefused) {
  const Result<void> result = check_comparable(grey(20, 10, 1), grey(10, 20, 1));
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().message.find("10x20"), std::string::npos) << result.error().text();
  EXPECT_FALSE(check_comparable(image(4, 4, 1), image(4, 4, 1)));
  EXPECT_FALSE(check_comparable(FloatImage{}, FloatImage{}));
}

// What a display shows.

TEST(Tonemap, EndsAreBlackAndWhite) {
  const float infinity = std::numeric_limits<float>::infinity();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const float black : {0.0f, -0.0f, -1.0f, -infinity, nan}) EXPECT_EQ(display_value(black), 0);
  EXPECT_EQ(display_value(infinity), 1);
  EXPECT_NEAR(display_value(1e30f), 1, 1e-6);
  EXPECT_NEAR(display_value(1), 0.7353569831, 1e-6) << "sRGB of a half";
}

TEST(Tonemap, PicturesAreTheRoundedValuesOfEachPixel) {
  std::mt19937 generator(7);
  FloatImage linear = image(333, 41, 4);
  for (float& value : linear.values)
    value = std::exp(std::uniform_real_distribution<float>(-14, 14)(generator));
  linear.at(3, 3)[0] = std::numeric_limits<float>::quiet_NaN();
  linear.at(4, 3)[1] = std::numeric_limits<float>::infinity();
  linear.at(5, 3)[2] = -3;
  const float exposure = 0.7f;
  const FloatImage display = display_image(linear, exposure);
  ASSERT_EQ(display.channels, 3u);
  const Picture picture = to_picture(display);
  for (uint32_t y = 0; y < linear.height; ++y)
    for (uint32_t x = 0; x < linear.width; ++x)
      for (uint32_t c = 0; c < 3; ++c) {
        const float code = std::round(255 * display_value(linear.at(x, y)[c] * exposure));
        ASSERT_EQ(display.at(x, y)[c], code / 255) << linear.at(x, y)[c];
        ASSERT_EQ(picture.at(x, y)[c], static_cast<uint8_t>(code));
      }
  EXPECT_EQ(to_float_image(picture).values, display.values);
}

// Sequences.

/// A scene whose frame t and method's frame t come from functions; motion and depth from others.
struct Scene {
  std::function<FloatImage(uint32_t)> truth, output;
  std::function<FloatImage(uint32_t)> motion = nullptr, depth = nullptr;
  std::function<bool(uint32_t)> cut = [](uint32_t) { return false; };
  std::function<bool(uint32_t)> still = [](uint32_t) { return false; };
};

SequenceMetrics play(const Scene& scene, uint32_t frames) {
  ReferenceTrack track;
  SequenceEvaluator evaluator;
  for (uint32_t t = 0; t < frames; ++t) {
    const FloatImage motion = scene.motion ? scene.motion(t) : FloatImage{};
    const FloatImage depth = scene.depth ? scene.depth(t) : FloatImage{};
    EXPECT_TRUE(track.advance({.display = scene.truth(t),
                               .motion = scene.motion ? &motion : nullptr,
                               .depth = scene.depth ? &depth : nullptr,
                               .cut = scene.cut(t),
                               .camera_still = scene.still(t)}));
    EXPECT_TRUE(evaluator.add(scene.output(t), track));
  }
  return evaluator.finish();
}

constexpr uint32_t kWidth = 90, kHeight = 71;

FloatImage no_motion(uint32_t) { return image(kWidth, kHeight, 2); }
FloatImage flat_depth(uint32_t) { return image(kWidth, kHeight, 1, 0.4f); }

TEST(Sequence, AStillPictureIsExactlyStable) {
  const auto picture = [](uint32_t) { return texture(kWidth, kHeight, 1); };
  const auto other = [](uint32_t) { return texture(kWidth, kHeight, 2); };
  const SequenceMetrics metrics = play({picture, other, no_motion, flat_depth}, 4);
  ASSERT_TRUE(metrics.if_ssim);
  EXPECT_EQ(metrics.if_ssim->pairs, 3u);
  EXPECT_TRUE(metrics.if_ssim->disocclusion_mask);
  for (const IfSsimValue& value :
       {metrics.if_ssim->at_t, metrics.if_ssim->at_half_t, metrics.if_ssim->at_double_t}) {
    EXPECT_EQ(value.value, 1) << "though it is far from the reference";
    EXPECT_EQ(value.valid_centres, 1);
    EXPECT_EQ(value.masked_fraction, 0);
  }
}

TEST(Sequence, WholePixelMotionIsStableAwayFromTheBorder) {
  const auto moving = [](uint32_t t) { return texture(kWidth, kHeight, 1, 3 * int64_t{t}); };
  const auto motion = [](uint32_t) {
    FloatImage result = image(kWidth, kHeight, 2);
    for (size_t i = 0; i < result.values.size(); i += 2) result.values[i] = 3.0f / kWidth;
    return result;
  };
  const SequenceMetrics metrics = play({moving, moving, motion, flat_depth}, 5);
  ASSERT_TRUE(metrics.if_ssim);
  EXPECT_NEAR(metrics.if_ssim->at_t.value, 1, 1e-6);
  EXPECT_NEAR(*metrics.if_ssim->at_t.valid_centres, 1, 1e-6);
  // What was outside, 3 of 90 columns, is in 2 of 45 pooled ones.
  EXPECT_NEAR(metrics.if_ssim->at_t.masked_fraction, 2.0 / 45, 1e-9);

  // Motion the wrong way finds other colours, which are taken for a change of shading.
  const auto wrong = [&](uint32_t t) {
    FloatImage result = motion(t);
    for (float& value : result.values) value = -value;
    return result;
  };
  const SequenceMetrics lost = play({moving, moving, wrong, flat_depth}, 5);
  EXPECT_GT(lost.if_ssim->at_t.masked_fraction, 0.5);
}

TEST(Sequence, IndependentNoiseLowersStabilityMonotonically) {
  const auto truth = [](uint32_t) { return texture(kWidth, kHeight, 1); };
  double last = 1;
  for (const double deviation : {1.0, 2.0, 4.0, 8.0, 16.0}) {
    const auto noisy = [&](uint32_t t) { return with_noise(truth(t), deviation, 10 + t); };
    const SequenceMetrics metrics = play({truth, noisy, no_motion, flat_depth}, 4);
    EXPECT_LT(metrics.if_ssim->at_t.value, last) << deviation;
    last = metrics.if_ssim->at_t.value;
  }
}

TEST(Sequence, ChangesOfShadingAreMaskedByTheThreshold) {
  // At code 100 the threshold is 6 + 12 * 100 / 255 = 10.7: a step of 8 lies above its half.
  const auto steps = [](uint32_t t) { return grey(kWidth, kHeight, t % 2 ? 100 : 92); };
  const auto output = [](uint32_t t) { return grey(kWidth, kHeight, t % 2 ? 200 : 50); };
  const SequenceMetrics metrics = play({steps, output, no_motion, flat_depth}, 2);
  EXPECT_EQ(metrics.if_ssim->at_t.masked_fraction, 0);
  EXPECT_EQ(metrics.if_ssim->at_double_t.masked_fraction, 0);
  EXPECT_EQ(metrics.if_ssim->at_half_t.masked_fraction, 1);
  EXPECT_LT(metrics.if_ssim->at_t.value, 0.6);
  EXPECT_EQ(metrics.if_ssim->at_half_t.value, 1) << "what is masked counts as 1";
  EXPECT_FALSE(metrics.if_ssim->at_half_t.valid_centres) << "there is none";
}

TEST(Sequence, DisocclusionsAreMaskedIfThereIsDepth) {
  const auto truth = [](uint32_t) { return texture(kWidth, kHeight, 1); };
  const auto uncovered = [](uint32_t t) {
    FloatImage depth = flat_depth(t);
    for (uint32_t y = 0; y < kHeight; ++y)
      for (uint32_t x = 0; x < kWidth / 2; ++x) *depth.at(x, y) += 0.02f * static_cast<float>(t);
    return depth;
  };
  const SequenceMetrics masked = play({truth, truth, no_motion, uncovered}, 3);
  EXPECT_NEAR(masked.if_ssim->at_t.masked_fraction, 0.5, 0.02);
  EXPECT_TRUE(masked.if_ssim->disocclusion_mask);
  const SequenceMetrics open = play({truth, truth, no_motion}, 3);
  EXPECT_EQ(open.if_ssim->at_t.masked_fraction, 0);
  EXPECT_FALSE(open.if_ssim->disocclusion_mask);
}

TEST(Sequence, CutsAndFramesWithoutMotionMakeNoPair) {
  const auto truth = [](uint32_t) { return texture(kWidth, kHeight, 1); };
  Scene scene{truth, truth, no_motion, flat_depth};
  scene.cut = [](uint32_t t) { return t == 2; };
  EXPECT_EQ(play(scene, 5).if_ssim->pairs, 3u);
  scene.motion = nullptr;
  EXPECT_FALSE(play(scene, 5).if_ssim);
}

TEST(Sequence, StillDeviationStartsWhenTheHistoryHasSettled) {
  const auto truth = [](uint32_t) { return grey(kWidth, kHeight, 102); };
  // Wild until frame 20, then 100 and 104 in turns: a deviation of 2 codes.
  const auto output = [](uint32_t t) {
    return grey(kWidth, kHeight, t < 20 ? static_cast<int>(10 * t) : t % 2 ? 100 : 104);
  };
  Scene scene{truth, output};
  scene.still = [](uint32_t t) { return t > 4; };  // it stands from frame 4 on
  EXPECT_FALSE(play(scene, 20).still) << "16 frames later is frame 20";
  EXPECT_FALSE(play(scene, 21).still) << "one frame has no deviation";
  const SequenceMetrics metrics = play(scene, 28);
  ASSERT_TRUE(metrics.still);
  EXPECT_EQ(metrics.still->frames, 8u);
  EXPECT_DOUBLE_EQ(metrics.still->code_values, 2);
  EXPECT_NEAR(*metrics.still->psnr_db, 20 * std::log10(255 / 2.0), 1e-4);

  // A second stretch counts with its frames: 8 with 2, then 3 that are equal.
  scene.output = [&](uint32_t t) { return t >= 28 ? grey(kWidth, kHeight, 77) : output(t); };
  scene.still = [](uint32_t t) { return t > 4 && t != 28; };
  const SequenceMetrics two = play(scene, 28 + 16 + 3);
  EXPECT_EQ(two.still->frames, 11u);
  EXPECT_DOUBLE_EQ(two.still->code_values, 2 * 8 / 11.0);
}

TEST(Sequence, MeansAreThoseOfTheFrames) {
  const auto truth = [](uint32_t t) { return texture(kWidth, kHeight, t); };
  const auto output = [&](uint32_t t) { return t == 1 ? truth(t) : with_noise(truth(t), 5, t); };
  ReferenceTrack track;
  SequenceEvaluator evaluator;
  double psnr = 0, ssim_sum = 0, flip_sum = 0;
  for (uint32_t t = 0; t < 3; ++t) {
    ASSERT_TRUE(track.advance({.display = truth(t)}));
    FloatImage map;
    const Result<FrameMetrics> metrics = evaluator.add(output(t), track, 2.0 * t, &map);
    ASSERT_TRUE(metrics);
    EXPECT_EQ(map.values.size(), size_t{kWidth} * kHeight);
    psnr += std::min(*metrics->psnr_db, 100.0) / 3;
    ssim_sum += metrics->ssim->full / 3;
    flip_sum += *metrics->flip / 3;
  }
  const SequenceMetrics means = evaluator.finish();
  EXPECT_EQ(means.frames, 3u);
  EXPECT_DOUBLE_EQ(*means.psnr_db, psnr);
  EXPECT_DOUBLE_EQ(*means.ssim, ssim_sum);
  EXPECT_DOUBLE_EQ(*means.flip, flip_sum);
  EXPECT_DOUBLE_EQ(*means.time_ms, 2);
}

TEST(Sequence, SizesAndOrderAreChecked) {
  ReferenceTrack track;
  SequenceEvaluator evaluator;
  EXPECT_FALSE(evaluator.add(grey(8, 8, 1), track)) << "there is no frame yet";
  ASSERT_TRUE(track.advance({.display = grey(8, 8, 1)}));
  EXPECT_FALSE(evaluator.add(grey(8, 9, 1), track));
  EXPECT_TRUE(evaluator.add(grey(8, 8, 1), track));
  EXPECT_FALSE(evaluator.add(grey(8, 8, 1), track)) << "the same frame again";
  const FloatImage motion = image(4, 4, 2);
  const Result<void> small = track.advance({.display = grey(8, 8, 1), .motion = &motion});
  ASSERT_FALSE(small);
  EXPECT_NE(small.error().text().find("4x4"), std::string::npos) << small.error().text();
  EXPECT_FALSE(track.advance({.display = grey(9, 8, 1)})) << "the size changes";
}

TEST(Sequence, ViewsAreTheSameIfBothAreKnownAndEqual) {
  FrameCamera a, b;
  EXPECT_FALSE(same_view(a, b)) << "unknown";
  a.view_projection[0] = b.view_projection[0] = 2;
  b.jitter = {0.25f, 0};
  EXPECT_TRUE(same_view(a, b));
  b.view_projection[12] = 0.5f;
  EXPECT_FALSE(same_view(a, b));
}

}  // namespace
}  // namespace shale
