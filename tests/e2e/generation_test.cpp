// Pictures between rendered frames, and beyond them: what every method keeps, whatever the frames hold, and what the splat,
// the parabola and the choice between two frames do to pictures whose truth is known.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "ir/base/file.h"
#include "tests/support/source_folder.h"
#include "tests/support/tool_device_test.h"
#include "tests/support/vulkan_fixture.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 5;

const char* const kBetween[] = {"mob_fgsr_interpolation",
                                "mob_fgsr_sr_interpolation",
                                "motion_and_flow",
                                "generation/linear",
                                "generation/unrefined",
                                "generation/unfilled",
                                "generation/backward",
                                "generation/blend",
                                "generation/repeat",
                                "generation/nfru_by_hand",
                                "../nfru"};
const char* const kAhead[] = {"mob_fgsr_extrapolation",    "mob_fgsr_sr_extrapolation",
                              "generation/linear_ahead",   "generation/unrefined_ahead",
                              "generation/backward_ahead", "generation/repeat_ahead"};

bool is_upscaler(const std::string& name) { return name.find("_sr_") != std::string::npos; }
std::vector<std::string> all_methods() {
  std::vector<std::string> names(std::begin(kBetween), std::end(kBetween));
  names.insert(names.end(), std::begin(kAhead), std::end(kAhead));
  return names;
}

class GenerationTest : public ToolDeviceTest<testing::Test> {
 protected:
  using Edit = std::function<std::string(const std::string& path, std::string text)>;

  static std::unique_ptr<Player> player_of(const std::string& name, Extent size,
                                           const Edit& edit = {}) {
    const std::string folder = source_folder() + "/models/baselines/" + name;
    const ModelFiles model = must(load_model(folder, "", "int8"));
    CompileOptions options;
    options.frame = model.frame;
    options.kernels = {"generic"};
    options.load_shader = [folder, edit](const std::string& path) -> Result<std::string> {
      SHALE_TRY(std::string text, read_text(folder + "/" + path));
      return edit ? edit(path, std::move(text)) : text;
    };
    options.sizes = {FrameExtent{size.width, size.height}, FrameExtent{size.width, size.height}};
    const Compiled compiled = must(compile_model(model, options));
    return must(Player::create(*device_, compiled.package));
  }

  /// A picture halfway behind the previous frame, or half a frame ahead.
  static FloatImage half(Player& player) {
    return must(player.generate(player.variant().generator->waits() ? 0.5f : 1.5f));
  }
};

using Color = std::array<float, 3>;
struct Pixel {
  Color color{};
  float depth = 0.99f;                ///< near at 0
  std::array<float, 2> motion{0, 0};  ///< pixels
};

SourceFrame frame_of(Extent size, const std::function<Pixel(int x, int y)>& pixel) {
  SourceFrame frame;
  frame.camera.fov_x = 1.2f;
  frame.camera.fov_y = 0.8f;
  frame.color = {size.width, size.height, 3, {}};
  frame.depth = {size.width, size.height, 1, {}};
  frame.motion = {size.width, size.height, 2, {}};
  for (int y = 0; y < static_cast<int>(size.height); ++y)
    for (int x = 0; x < static_cast<int>(size.width); ++x) {
      const Pixel p = pixel(x, y);
      frame.color.values.insert(frame.color.values.end(), p.color.begin(), p.color.end());
      frame.depth.values.push_back(p.depth);
      frame.motion.values.push_back(p.motion[0] / static_cast<float>(size.width));
      frame.motion.values.push_back(p.motion[1] / static_cast<float>(size.height));
    }
  return frame;
}

/// Noise without motion; colours are halves, so that images hold them as they are.
Color noise(int x, int y, uint64_t seed) {
  std::mt19937_64 random(seed * 1000003 + static_cast<uint64_t>(y + 1000) * 4099 +
                         static_cast<uint64_t>(x + 1000));
  Color color;
  for (float& c : color) c = static_cast<float>(random() % 512) / 128;
  return color;
}
SourceFrame still_frame(Extent size, uint64_t seed) {
  return frame_of(size, [&](int x, int y) { return Pixel{noise(x, y, seed)}; });
}

/// Everything is noise, motion up to a few pixels.
SourceFrame wild_frame(Extent size, uint64_t seed) {
  return frame_of(size, [&](int x, int y) {
    const Color a = noise(x, y, seed), b = noise(x, y, seed + 99);
    return Pixel{a, 0.9f + b[0] / 50, {b[1] * 2 - 4, b[2] * 2 - 4}};
  });
}

bool all_finite(const FloatImage& image) {
  return std::all_of(image.values.begin(), image.values.end(),
                     [](float v) { return std::isfinite(v) && v >= 0; });
}

double worst(const FloatImage& a, const FloatImage& b, uint32_t border = 0) {
  double most = 0;
  for (uint32_t y = border; y + border < a.height; ++y)
    for (uint32_t x = border; x + border < a.width; ++x)
      for (uint32_t c = 0; c < 3; ++c)
        most = std::max(most, std::abs(double{a.at(x, y)[c]} - b.at(x, y)[c]));
  return most;
}

TEST_F(GenerationTest, WhatStandsStillStaysAsItIs) {
  for (const std::string& name : all_methods()) {
    const auto player = player_of(name, {21, 14});
    const SourceFrame frame = still_frame({21, 14}, kSeed);
    for (int i = 0; i < 4; ++i) {
      const FloatImage shown = must(player->play(frame));
      // Bilinear or blended colours go through a root and back.
      const double allowed = name.find("ward") + 1 || name.find("blend") + 1 ? 0.01 : 0.0;
      // Super resolution still gathers samples: then the picture between two frames is between them.
      if (is_upscaler(name) && i < 3) continue;
      if (!is_upscaler(name)) {
        EXPECT_EQ(shown.values, frame.color.values) << name;
      }
      EXPECT_LE(worst(half(*player), shown), is_upscaler(name) ? 0.02 : allowed)
          << name << " frame " << i;
    }
  }
}

TEST_F(GenerationTest, ASingleFrameIsShown) {
  for (const std::string& name : all_methods()) {
    const auto player = player_of(name, {12, 9});
    for (uint64_t i = 0; i < 3; ++i) must(player->play(wild_frame({12, 9}, i)));
    half(*player);
    for (const bool by_cut : {true, false}) {
      SourceFrame frame = wild_frame({12, 9}, 7);
      frame.camera.cut = by_cut;
      if (!by_cut) player->reset();
      const FloatImage shown = must(player->play(frame));
      EXPECT_EQ(half(*player).values, shown.values) << name << (by_cut ? " cut" : " reset");
    }
  }
}

TEST_F(GenerationTest, PicturesLeaveTheFramesAlone) {
  for (const char* name : {"mob_fgsr_sr_interpolation", "mob_fgsr_sr_extrapolation"}) {
    const auto with = player_of(name, {16, 10}), without = player_of(name, {16, 10});
    for (uint64_t i = 0; i < 5; ++i) {
      const SourceFrame frame = wild_frame({16, 10}, i);
      const FloatImage expected = must(without->play(frame));
      EXPECT_EQ(must(with->play(frame)).values, expected.values) << name << " frame " << i;
      half(*with);
      half(*with);
    }
  }
}

TEST_F(GenerationTest, TheTimeOfTheNewestFrameShowsIt) {
  const auto player = player_of("mob_fgsr_interpolation", {20, 12});
  // Whole pixels of even motion: sampled at their middles.
  for (int i = 0; i < 4; ++i) {
    const SourceFrame frame = frame_of({20, 12}, [&](int x, int y) {
      return Pixel{noise(x - 2 * i, y, kSeed), 0.99f, {2, 0}};
    });
    const FloatImage shown = must(player->play(frame));
    EXPECT_EQ(must(player->generate(1)).values, shown.values);
  }
}

/// Frame at time t of a picture that moves by `shift(t)` pixels to the right.
SourceFrame panned(Extent size, const std::function<double(double)>& shift, double t) {
  const double at = shift(t);
  return frame_of(size, [&](int x, int y) {
    const double u = x - at;
    const float grey = static_cast<float>(1 + 0.5 * std::sin(0.3 * u) + 0.2 * std::sin(0.4 * y));
    return Pixel{{grey, grey, grey}, 0.99f, {static_cast<float>(at - shift(t - 1)), 0}};
  });
}

TEST_F(GenerationTest, AParabolaIsFollowedBetweenAndAhead) {
  // Beside the border there is no motion of the frame before, and then nothing at all.
  const Extent size{64, 40};
  constexpr uint32_t kBorder = 16;
  const auto shift = [](double t) { return 2.5 * t + 0.6 * t * t; };
  double error[2][2] = {};
  for (const bool ahead : {false, true})
    for (const bool even : {false, true}) {
      const auto player =
          player_of(ahead ? (even ? "generation/linear_ahead" : "mob_fgsr_extrapolation")
                          : (even ? "generation/linear" : "mob_fgsr_interpolation"),
                    size);
      for (int t = 0; t <= 4; ++t) must(player->play(panned(size, shift, t)));
      const FloatImage truth = panned(size, shift, ahead ? 4.5 : 3.5).color;
      error[ahead][even] = worst(half(*player), truth, kBorder);
    }
  for (const int ahead : {0, 1}) {
    EXPECT_LT(error[ahead][0], 0.01) << ahead;
    EXPECT_GT(error[ahead][1], 2 * error[ahead][0]) << ahead;
  }
}

TEST_F(GenerationTest, AStopIsAStop) {
  const Extent size{48, 12};
  const auto shift = [](double t) { return 4 * std::min(t, 3.0); };  // even motion, then none
  for (const char* name : {"mob_fgsr_interpolation", "mob_fgsr_extrapolation"}) {
    const auto player = player_of(name, size);
    FloatImage shown;
    for (int t = 0; t <= 4; ++t) shown = must(player->play(panned(size, shift, t)));
    EXPECT_EQ(half(*player).values, shown.values) << name;
  }
}

/// A near square that moves over a far picture that stands still. Time 0 has it at x = 20.
Pixel square(int x, int y, double t) {
  const int left = static_cast<int>(20 + 8 * t);
  if (x >= left && x < left + 10 && y >= 8 && y < 18) return {{3, 0.2f, 0.2f}, 0.5f, {8, 0}};
  return {{0.2f, 0.3f + static_cast<float>((x / 4 + y / 4) % 2), 0.4f}, 0.99f, {0, 0}};
}

TEST_F(GenerationTest, WhatWasCoveredComesFromTheFrameThatSawIt) {
  const Extent size{64, 26};
  const auto player = player_of("mob_fgsr_interpolation", size);
  for (int t = 0; t <= 3; ++t)
    must(player->play(frame_of(size, [&](int x, int y) { return square(x, y, t); })));
  const FloatImage truth = frame_of(size, [&](int x, int y) { return square(x, y, 2.5); }).color;
  const FloatImage made = half(*player);
  for (uint32_t y = 0; y < size.height; ++y)
    for (uint32_t x = 0; x < size.width; ++x) {
      // The square takes a pixel around it with it: depth and motion are dilated.
      const bool edge = x >= 39 && x <= 50 && y >= 7 && y <= 18;
      const bool inside = x >= 40 && x <= 49 && y >= 8 && y <= 17;
      if (inside || !edge) {
        EXPECT_NEAR(made.at(x, y)[1], truth.at(x, y)[1], 0.01f) << x << ", " << y;
      }
    }
}

/// A picture that moves 8 pixels a frame over another one that stands still, without motion vectors. Time 0 has it at x = 16.
Pixel unmoved(int x, int y, double t) {
  const double left = 16 + 8 * t;
  const auto wave = [](double a, double b) {
    return static_cast<float>(std::sin(a) * std::cos(b));
  };
  if (x >= left && x < left + 48 && y >= 16 && y < 64)
    return {{1.5f + wave(0.35 * (x - left), 0.3 * y), 1, 0.3f}};
  return {{0.3f, 0.5f + 0.3f * wave(0.21 * x + 1, 0.26 * y), 0.6f}};
}

TEST_F(GenerationTest, WhatHasNoMotionVectorsIsFoundByItsLooks) {
  const Extent size{144, 80};
  const FloatImage truth = frame_of(size, [&](int x, int y) { return unmoved(x, y, 2.5); }).color;
  const auto error = [&](const char* name) {
    const auto player = player_of(name, size);
    for (int t = 0; t <= 3; ++t)
      must(player->play(frame_of(size, [&](int x, int y) { return unmoved(x, y, t); })));
    const FloatImage made = half(*player);
    double sum = 0;
    for (size_t i = 0; i < made.values.size(); ++i)
      sum += std::abs(double{made.values[i]} - truth.values[i]);
    return sum;
  };
  // Without motion vectors, motion alone mixes the frames where they are.
  const double by_motion = error("generation/blend");
  for (const char* name : {"motion_and_flow", "generation/nfru_by_hand", "../nfru"})
    EXPECT_LT(error(name), 0.52 * by_motion) << name;
}

/// A text of 2x2 squares on a panel on the screen, over a checkered wall that the camera turns away from by 6 pixels a frame.
Pixel overlaid(int x, int y, double t) {
  const bool is_letter = (x / 2 + y / 2 * 3) % 5 < 2;
  if (x >= 20 && x < 60 && y >= 10 && y < 22)
    return {is_letter ? Color{1.2f, 1.0f, 0.4f} : Color{0.05f, 0.05f, 0.05f}, 0.9f, {6, 0}};
  const double at = x - 6 * t + 600;
  const bool is_light = (static_cast<int>(at / 7) + y / 7) % 2 != 0;
  return {{0.2f, is_light ? 0.3f : 0.2f, 0.3f}, 0.9f, {6, 0}};
}

TEST_F(GenerationTest, ATextOnTheScreenStaysWhileTheCameraTurns) {
  const Extent size{80, 32};
  for (const auto& [name, time] :
       {std::pair{"mob_fgsr_interpolation", 2.5}, {"mob_fgsr_extrapolation", 3.5}}) {
    const FloatImage truth =
        frame_of(size, [&, t = time](int x, int y) { return overlaid(x, y, t); }).color;
    const auto player = player_of(name, size);
    for (int t = 0; t <= 3; ++t)
      must(player->play(frame_of(size, [&](int x, int y) { return overlaid(x, y, t); })));
    const FloatImage made = half(*player);
    int letters = 0, broken = 0;
    for (int y = 11; y < 21; ++y)
      for (int x = 22; x < 58; ++x) {
        const bool is_letter = overlaid(x, y, 0).color[0] > 1;
        const auto at = [&](const FloatImage& image) {
          return image.at(static_cast<uint32_t>(x), static_cast<uint32_t>(y))[0];
        };
        letters += is_letter;
        broken += is_letter && std::abs(at(made) - at(truth)) > 0.1f;
      }
    EXPECT_GT(letters, 100) << name;
    EXPECT_LT(broken, letters / 10) << name;
  }
}

TEST_F(GenerationTest, TheOrderOfInvocationsDoesNotMatter) {
  const Extent size{33, 21};  // 693 texels, prime to the step
  const auto turned = [](const char* expression) {
    return [expression](const std::string& path, std::string text) {
      if (path.find("splat.comp") == std::string::npos) return text;
      const std::string before = "ivec2(gl_GlobalInvocationID.xy)";
      const size_t at = text.find(before);
      EXPECT_NE(at, std::string::npos);
      return text.replace(at, before.size(), expression);
    };
  };
  // The same texels from other invocations: backwards, and scattered; those outside of the picture stay there.
  const char* const kBackwards =
      "(any(greaterThanEqual(gl_GlobalInvocationID.xy, uvec2(33, 21))) ? ivec2(1000) : "
      "ivec2(32, 20) - ivec2(gl_GlobalInvocationID.xy))";
  const char* const kScattered =
      "(any(greaterThanEqual(gl_GlobalInvocationID.xy, uvec2(33, 21))) ? ivec2(1000) : "
      "ivec2((gl_GlobalInvocationID.y * 33 + gl_GlobalInvocationID.x) * 331 % 693 % 33, "
      "(gl_GlobalInvocationID.y * 33 + gl_GlobalInvocationID.x) * 331 % 693 / 33))";
  for (const char* name : {"mob_fgsr_interpolation", "mob_fgsr_extrapolation"}) {
    const auto forwards = player_of(name, size),
               backwards = player_of(name, size, turned(kBackwards)),
               scattered = player_of(name, size, turned(kScattered));
    for (uint64_t i = 0; i < 4; ++i) {
      const SourceFrame frame = wild_frame(size, i);
      for (Player* player : {forwards.get(), backwards.get(), scattered.get()})
        must(player->play(frame));
      const FloatImage expected = half(*forwards);
      for (Player* player : {backwards.get(), scattered.get()}) {
        EXPECT_EQ(half(*player).values, expected.values) << name;
        EXPECT_EQ(must(player->read_words("splat")).bytes,
                  must(forwards->read_words("splat")).bytes)
            << name;
      }
    }
  }
}

/// The words of the splat in plain C++, in another order: of a target the largest.
TEST_F(GenerationTest, TheNearestTexelArrives) {
  const Extent size{40, 8};
  const auto player = player_of("mob_fgsr_extrapolation", size);
  // Three columns meet at x = 20 after half a frame; the middle one is nearest.
  const auto column = [](int x, int) {
    Pixel p{{1, 1, 1}, 1.0f, {0, 0}};
    if (x == 10) p = {{0, 2, 0}, 0.9f, {20, 0}};
    if (x == 16) p = {{2, 0, 0}, 0.5f, {8, 0}};
    if (x == 26) p = {{0, 0, 2}, 0.8f, {-12, 0}};
    return p;
  };
  must(player->play(frame_of(size, column)));
  must(player->play(frame_of(size, column)));
  const FloatImage made = half(*player);
  for (uint32_t y = 1; y + 1 < size.height; ++y) {
    EXPECT_GT(made.at(20, y)[0], 1.5f) << y;
    EXPECT_LT(made.at(20, y)[2], 0.5f) << y;
  }
}

TEST_F(GenerationTest, AnyFrameAndSizeGivesAPicture) {
  const float nan = std::numeric_limits<float>::quiet_NaN(),
              inf = std::numeric_limits<float>::infinity();
  for (const Extent size : {Extent{1, 1}, Extent{1, 7}, Extent{17, 5}})
    for (const std::string& name : all_methods()) {
      const auto player = player_of(name, size);
      for (uint64_t i = 0; i < 3; ++i) {
        must(player->play(wild_frame(size, i)));
        EXPECT_TRUE(all_finite(half(*player))) << name;
      }
      SourceFrame broken = wild_frame(size, 3);
      const float kBad[] = {nan, -nan, inf, -inf, 1e30f, -5, 0.5f};
      size_t k = 0;
      for (FloatImage* image : {&broken.color, &broken.depth, &broken.motion})
        for (float& value : image->values)
          if (++k % 3 == 0) value = kBad[k / 3 % std::size(kBad)];
      for (int i = 0; i < 3; ++i) {
        must(player->play(broken));
        EXPECT_TRUE(all_finite(half(*player))) << name << " broken";
      }
      // Motion of a whole picture, and of more than the splat reaches.
      SourceFrame far = frame_of(size, [&](int x, int y) {
        return Pixel{noise(x, y, 3),
                     0.9f,
                     {static_cast<float>(x % 2 ? 4000 : -4000), static_cast<float>(size.height)}};
      });
      for (int i = 0; i < 3; ++i) {
        must(player->play(far));
        EXPECT_TRUE(all_finite(half(*player))) << name << " far";
      }
    }
}

TEST_F(GenerationTest, ReversedDepthIsTheSame) {
  const Extent size{24, 16};
  for (const char* name : {"mob_fgsr_interpolation", "mob_fgsr_extrapolation"}) {
    const auto forward = player_of(name, size), reversed = player_of(name, size);
    for (uint64_t i = 0; i < 3; ++i) {
      // Quarters, which 1 - depth keeps.
      SourceFrame frame = frame_of(size, [&](int x, int y) {
        const Color c = noise(x, y, i);
        return Pixel{
            c, static_cast<float>(static_cast<int>(c[0] * 63)) / 256, {c[1] - 2, c[2] - 2}};
      });
      frame.camera.far_plane = 100;
      must(forward->play(frame));
      frame.camera.reverse_depth = true;
      for (float& d : frame.depth.values) d = 1 - d;
      must(reversed->play(frame));
      EXPECT_EQ(half(*reversed).values, half(*forward).values) << name << " frame " << i;
    }
  }
}

}  // namespace
}  // namespace shale
