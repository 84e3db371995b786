// The worst inputs that `shale stress` found, as they were before the repair: lights of up to 65504 beside bright edges.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tests/e2e/sandwich_support.h"
#include "tools/eval/tonemap.h"
#include "tools/shale/stress_frames.h"

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

TEST_F(Extremes, NoGeneratedPictureIsBrighterThanTheLampInItsFrames) {
  const Extent size{48, 40};
  for (const char* name : {"baselines/mob_fgsr_interpolation", "baselines/mob_fgsr_extrapolation",
                           "baselines/motion_and_flow"}) {
    const auto player = player_of(models() + name, {}, size, size);
    for (uint32_t t = 0; t < 6; ++t) {
      const SourceFrame frame = lamp_frame(size, size, t);
      must(player->play(frame));
      for (uint32_t k = 1; k < 4; ++k) {
        const FloatImage shown =
            must(player->generate(generated_time(*player->variant().generator, k, 4)));
        ASSERT_TRUE(all_finite(shown)) << name << " frame " << t;
        EXPECT_LE(mapped(largest(shown)), mapped(largest(frame.color)) + kOvershoot)
            << name << " frame " << t << " picture " << k << " goes up to " << largest(shown);
      }
    }
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

/// What a display shows of the frames, one after the other, from a start without a past.
std::vector<float> shown_of(Player& player, std::span<const SourceFrame> frames) {
  std::vector<float> values;
  for (const SourceFrame& frame : frames) {
    const FloatImage picture = must(player.play(frame));
    EXPECT_TRUE(all_finite(picture));
    const FloatImage shown =
        player.is_display() ? picture : display_image(picture, frame.camera.exposure);
    values.insert(values.end(), shown.values.begin(), shown.values.end());
  }
  return values;
}

double psnr(std::span<const float> a, std::span<const float> b) {
  double squares = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const double d = static_cast<double>(a[i] - b[i]);
    squares += d * d;
  }
  return -10 * std::log10(squares / static_cast<double>(a.size()));
}

TEST_F(Extremes, Int8PartsFromFloatsAsFarAsTheSearchFoundAndStaysExact) {
  // What `shale stress MODEL --render 16x16 --search 400 --seed 7` found: blocks of light, over frames of its course.
  for (const char* name : {"nss_v1_low", "srpo_x2"}) {
    SCOPED_TRACE(name);
    const auto find = nlohmann::json::parse(
        must(read_text(source_folder() + "/tests/e2e/finds/" + name + ".json")));
    CompileArguments compile;
    compile.render = "16x16";
    compile.kernels = {"generic"};
    const Sandwich int8 = must(load_sandwich(models() + name, compile, {}, {}));
    const auto quantized = must(Player::create(*device_, int8.package));
    compile.precision = "fp32";
    const auto real = must(
        Player::create(*device_, must(load_sandwich(models() + name, compile, {}, {})).package));
    const StressFrames course(quantized->render_size(), quantized->output_size(), int8.pattern,
                              quantized->is_display());
    std::vector<SourceFrame> frames;
    for (uint32_t i = 0; i < 3; ++i) frames.push_back(course.frame(Course::kMoving, i));
    const auto parted = [&] {
      quantized->reset();
      real->reset();
      return psnr(shown_of(*quantized, frames), shown_of(*real, frames));
    };
    // Other drivers round floats otherwise.
    EXPECT_NEAR(parted(), find["start_psnr_db"].get<double>(), 1);
    for (const auto& step : find["relights"]) {
      Relight relight{.x = step["x"], .y = step["y"], .stops = step["stops"]};
      if (!step["frame"].is_null()) relight.frame = step["frame"];
      relight.apply(frames, quantized->is_display());
    }
    EXPECT_NEAR(parted(), find["psnr_db"].get<double>(), 1);
    EXPECT_EQ(must(network_difference(*quantized, int8.graphs)), std::nullopt);
  }
}

}  // namespace
}  // namespace shale
