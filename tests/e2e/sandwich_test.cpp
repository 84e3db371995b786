// What every temporal sandwich must keep, whatever its network says: with stand-in networks.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <tuple>

#include "tests/e2e/sandwich_support.h"
#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"
#include "tools/scene/scene.h"

namespace shale {
namespace {

TEST_F(SandwichTest, ConstantColourStaysWhateverTheNetworkSays) {
  // Every result is a weighted mean of equal colours. What is lost is the rounding of the stored
  // half floats, 2^-10 at most, once a frame.
  const Extent render{24, 20}, output{48, 40};
  const Color color{0.3f, 1.5f, 7.0f};
  for (const Kind& kind : kKinds) {
    for (uint64_t seed = 1; seed <= 2; ++seed) {
      const auto player = player_of(kind, seed, render, output);
      for (uint32_t t = 0; t < 6; ++t) {
        const FloatImage shown =
            must(player->play(frame_of(render, output, t, [&](double, double) { return color; })));
        double worst = 0;
        for (size_t i = 0; i < shown.values.size(); ++i)
          worst = std::max(worst, std::abs(shown.values[i] / color[i % 3] - 1.0));
        EXPECT_LE(worst, (t + 1) * std::exp2(-10))
            << kind.model << " seed " << seed << " frame " << t;
      }
    }
  }
}

/// As QRISP keeps pictures.
double displayed(double x) { return std::sqrt(x / (1 + x)); }

TEST_F(SandwichTest, QrispKeepsAConstantColour) {
  // The candidate is a code, half a step of 1/255 away at most; the blend of equal colours in the
  // half floats of two histories stays there, to their rounding.
  const Extent render{24, 20}, output{48, 40};
  const Color color{0.3f, 1.5f, 7.0f};
  const auto player = qrisp_player(render, output);
  for (uint32_t t = 0; t < 6; ++t) {
    const FloatImage shown =
        must(player->play(frame_of(render, output, t, [&](double, double) { return color; })));
    double worst = 0;
    for (size_t i = 0; i < shown.values.size(); ++i)
      worst = std::max(worst, std::abs(displayed(shown.values[i]) - displayed(color[i % 3])));
    EXPECT_LE(worst, 0.5 / 255 + (t + 2) * std::exp2(-11)) << "frame " << t;
  }
}

TEST_F(SandwichTest, QrispPutsPhasesInPlaceAtAnySize) {
  // Without a past each output pixel is the code of its texel's colour; with one, it lies between
  // that and what the history holds.
  for (const Extent render : {Extent{24, 20}, Extent{25, 19}, Extent{1, 1}, Extent{7, 3}}) {
    const Extent output{2 * render.width, 2 * render.height};
    const auto player = qrisp_player(render, output);
    const SourceFrame frame = noise_frame(render, output, 0, kSeed);
    const FloatImage shown = must(player->play(frame));
    double worst = 0;
    for (uint32_t y = 0; y < output.height; ++y)
      for (uint32_t x = 0; x < output.width; ++x)
        for (size_t c = 0; c < 3; ++c)
          worst = std::max(worst, std::abs(displayed(shown.at(x, y)[c]) -
                                           displayed(frame.color.at(x / 2, y / 2)[c])));
    EXPECT_LE(worst, 0.5 / 255 + 3 * std::exp2(-11)) << render.width << "x" << render.height;
    EXPECT_TRUE(all_finite(must(player->play(noise_frame(render, output, 1, kSeed)))));
  }
}

TEST_F(SandwichTest, TheJitterChoosesTheSet) {
  const Extent render{24, 20}, output{48, 40};
  const auto player = qrisp_player(render, output);
  for (uint32_t t = 0; t < 18; ++t) {
    SourceFrame frame = noise_frame(render, output, t, kSeed);
    if (t == 17)
      frame.camera.jitter = {0.42f, 0.1f};  // none of the offsets: that of set 6 is nearest
    must(player->play(frame));
    if (t != 16) {
      EXPECT_EQ(player->program(), t == 17 ? 6u : t);
    }
  }
}

TEST_F(SandwichTest, ResetForgetsThePast) {
  const Extent render{24, 20}, output{48, 40};
  std::vector<std::pair<std::string, std::function<std::unique_ptr<Player>()>>> makers;
  for (const Kind& kind : kKinds)
    makers.emplace_back(kind.model, [&, kind] { return player_of(kind, kSeed, render, output); });
  makers.emplace_back(
      "mob_fgsr", [&] { return player_of(models() + "baselines/mob_fgsr", {}, render, output); });
  makers.emplace_back("qrisp", [&] { return qrisp_player(render, output); });
  SourceFrame last = noise_frame(render, output, 9, 77);
  last.camera.cut = true;
  for (const auto& [name, make] : makers) {
    const auto fresh = make();
    const FloatImage expected = must(fresh->play(last));
    const auto used = make();
    for (uint32_t t = 0; t < 3; ++t) must(used->play(noise_frame(render, output, t, kSeed)));
    EXPECT_EQ(must(used->play(last)).values, expected.values) << name;
    // And the past counts where there is no cut.
    SourceFrame next = last;
    next.camera.cut = false;
    must(used->play(noise_frame(render, output, 4, kSeed)));
    EXPECT_NE(must(used->play(next)).values, expected.values) << name;
  }
}

TEST_F(SandwichTest, AnyRatioAndSizeShowsASlopeWithoutLines) {
  // The picture is a slope in the domain in which samples are averaged. A result is a mean of
  // samples within `reach` output pixels; at a border, of a texel that stands for one as far
  // outside. So it is off by the slope times that distance at most, on each axis, and by 2^-10 a
  // frame for half floats. A line of missing or misplaced samples would be off by far more.
  const std::pair<Extent, Extent> kSizes[] = {
      {{60, 40}, {60, 40}},      {{60, 40}, {90, 60}},  {{60, 40}, {120, 80}},
      {{60, 40}, {180, 120}},    {{61, 37}, {100, 71}}, {{31, 17}, {62, 51}},
      {{853, 479}, {1706, 958}}, {{1, 1}, {3, 3}},      {{2, 3}, {3, 5}}};
  constexpr double kLow = 0.2, kSlope = 0.3;
  const auto mapped = [&](double u, double v) { return kLow + kSlope * (u + v); };
  for (const auto& [render, output] : kSizes) {
    for (const Kind& kind : kKinds) {
      const auto player = player_of(kind, kSeed, render, output);
      for (uint32_t t = 0; t < 3; ++t) {
        const FloatImage shown =
            must(player->play(frame_of(render, output, t, [&](double u, double v) {
              const float x = static_cast<float>(mapped(u, v) / (1 - mapped(u, v)));
              return Color{x, x, x};
            })));
        ASSERT_TRUE(all_finite(shown));
        const double off_x =
            kSlope / output.width * (2 * kind.reach + 2.0 * output.width / render.width);
        const double off_y =
            kSlope / output.height * (2 * kind.reach + 2.0 * output.height / render.height);
        double worst = 0;
        for (uint32_t y = 0; y < output.height; ++y)
          for (uint32_t x = 0; x < output.width; ++x) {
            const double value = *shown.at(x, y);
            worst =
                std::max(worst, std::abs(value / (1 + value) - mapped((x + 0.5) / output.width,
                                                                      (y + 0.5) / output.height)));
          }
        EXPECT_LE(worst, off_x + off_y + (t + 1) * std::exp2(-10))
            << kind.model << " " << render.width << "x" << render.height << " to " << output.width
            << "x" << output.height << " frame " << t;
      }
    }
  }
}

FloatImage flipped(const FloatImage& image) {
  FloatImage result = image;
  for (uint32_t y = 0; y < image.height; ++y)
    for (uint32_t x = 0; x < image.width; ++x)
      std::copy_n(image.at(x, y), image.channels, result.at(image.width - 1 - x, y));
  return result;
}

SourceFrame flipped(const SourceFrame& frame) {
  SourceFrame result = frame;
  result.color = flipped(frame.color);
  result.depth = flipped(frame.depth);
  result.motion = flipped(frame.motion);
  for (size_t i = 0; i < result.motion.values.size(); i += 2) result.motion.values[i] *= -1;
  result.camera.jitter[0] *= -1;
  return result;
}

TEST_F(SandwichTest, SymmetricPassesFlipWithThePicture) {
  // Float rounding of mirrored positions moves a result by some 2^-20 of the values around it, and
  // then to another half float at most; a choice (a texel, the depth test) may fall the other way
  // where a position lies that close to a border, which few pixels do.
  const Extent render{32, 24}, output{64, 48};
  for (const char* name : {"nearest", "bilinear", "catmull_rom", "lanczos", "mob_fgsr", "tss"}) {
    const std::string folder = models() + "baselines/" + name;
    const auto one = player_of(folder, {}, render, output);
    const auto other = player_of(folder, {}, render, output);
    for (uint32_t t = 0; t < 4; ++t) {
      const SourceFrame frame = noise_frame(render, output, t, kSeed);
      const FloatImage a = flipped(must(one->play(frame)));
      const FloatImage b = must(other->play(flipped(frame)));
      size_t wrong = 0;
      for (size_t i = 0; i < a.values.size(); ++i)
        if (std::abs(a.values[i] - b.values[i]) > std::exp2(-9) * std::abs(a.values[i]) + 1e-4)
          ++wrong;
      EXPECT_LE(wrong, a.values.size() / 500) << name << " frame " << t;
    }
  }
  // NSS chooses among depths and kernels that are not centred; but it sees a mirrored frame's
  // colours mirrored, to a code.
  for (const Kind& kind : kKinds) {
    if (kind.outputs.empty()) continue;
    const auto one = player_of(kind, kSeed, render, output);
    const auto other = player_of(kind, kSeed, render, output);
    const SourceFrame frame = noise_frame(render, output, 0, kSeed);
    must(one->play(frame));
    must(other->play(flipped(frame)));
    const FloatImage a = flipped(must(one->read("input", false)));
    const FloatImage b = must(other->read("input", false));
    double worst = 0;
    for (size_t i = 0; i < a.values.size(); ++i)
      if (i % 12 >= 3 && i % 12 < 6)
        worst = std::max(worst, std::abs(double{a.values[i]} - b.values[i]));
    EXPECT_LE(worst, 1) << kind.model;
  }
}

/// noise_frame without motion.
SourceFrame resting_frame(Extent render, Extent output, uint32_t index) {
  SourceFrame frame = noise_frame(render, output, index, kSeed);
  std::fill(frame.motion.values.begin(), frame.motion.values.end(), 0.0f);
  return frame;
}

TEST_F(SandwichTest, WhatAPromiseLeavesOutChangesNoBit) {
  const std::vector<Kind> kinds{kKinds[0], kKinds[1], kKinds[3], {"baselines/mob_fgsr", {}, 2}};
  // At twice the size and at others, even and odd, wide enough for places to be rounded; in buffers and in images.
  const std::tuple<const char*, Extent, Extent> kForms[] = {{"lavapipe", {24, 20}, {48, 40}},
                                                            {"lavapipe", {325, 9}, {650, 18}},
                                                            {"lavapipe", {61, 37}, {100, 71}},
                                                            {"dot8-gpu", {24, 20}, {48, 40}}};
  for (const Kind& kind : kinds)
    for (const auto& [target, render, output] : kForms) {
      CompileOptions options = options_of(models() + kind.model, render, output);
      options.targets = {target};
      std::optional<Graph> graph;
      if (!kind.outputs.empty()) graph = stand_in(kind, kSeed, input_size(options));
      const auto player = [&] {
        return must(Player::create(
            *device_, must(compile_graph(graph.value_or(Graph{}), 0, options)).package));
      };
      const auto full = player();
      options.needs = SceneNeeds{.motion_pixels = 0.0};
      const auto needed = player();
      for (uint32_t t = 0; t < 9; ++t) {
        SourceFrame frame = resting_frame(render, output, t);
        frame.camera.reverse_depth = t > 6;
        frame.camera.cut = t == 7;
        const bool breaks = t == 3 || t == 5;
        if (t == 3) frame.motion = noise_frame(render, output, t, kSeed).motion;
        if (t == 5) frame.motion.values.back() = std::numeric_limits<float>::quiet_NaN();
        const FloatImage expected = must(full->play(frame)), shown = must(needed->play(frame));
        size_t differ = 0;
        for (size_t i = 0; i < shown.values.size(); ++i)
          differ += shown.values[i] != expected.values[i];
        EXPECT_EQ(differ, 0u) << kind.model << " on " << target << " " << render.width << "x"
                              << render.height << " to " << output.width << "x" << output.height
                              << " frame " << t << " of " << shown.values.size();
        EXPECT_EQ(needed->kept_promise(), !breaks) << t;
        EXPECT_EQ(full->kept_promise(), std::nullopt);
      }
    }
}

TEST_F(SandwichTest, TheDeviceChoosesBetweenTheFormsOfAPassInTheSameFrame) {
  constexpr const char* kJson =
      R"({"schema": "shale-frame/2", "render": [40, 24], "output": [40, 24],
    "params": [{"name": "motion_scale", "type": "vec2", "default": [1, 1]}],
    "images": [
      {"name": "color", "role": "input", "format": "rgba16_float", "size": "render"},
      {"name": "motion", "role": "input", "format": "rg16_float", "size": "render"},
      {"name": "output", "role": "output", "format": "rgba16_float", "size": "output"}],
    "promises": [{"name": "slow", "needs": {"motion_pixels": 2},
      "check": {"name": "check", "shader": "still.comp", "over": {"of": "render", "divide": [16, 4]}, "reads": ["motion"]}}],
    "passes": [{"name": "show", "shader": "show.comp", "over": "output", "defines": {"FORM": 1}, "reads": ["color"],
      "writes": ["output"], "when": {"slow": {"defines": {"FORM": 2}}}}]})";
  CompileOptions options;
  options.frame = must(parse_frame(kJson));
  options.load_shader = [](const std::string& path) -> Result<std::string> {
    if (path == "still.comp") return read_text(source_folder() + "/shaders/frame/needs/still.comp");
    return std::string(R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
SHALE_PARAMS;
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x < OUTPUT_WIDTH && at.y < OUTPUT_HEIGHT) store_output(at, half4(rgb_of(fetch_color(at)) * float(FORM)));
})");
  };
  options.needs = SceneNeeds{.motion_pixels = 4.0, .render = std::array{80.0, 48.0}};
  for (const char* target : {"lavapipe", "dot8-gpu"}) {
    options.targets = {target};
    const Compiled compiled = must(compile_graph(Graph{}, 0, options));
    EXPECT_EQ(must(read_package(write_package(compiled.package))), compiled.package);
    const auto player = must(Player::create(*device_, compiled.package));
    const Extent size{40, 24};
    for (uint32_t t = 0; t < 12; ++t) {
      SourceFrame frame = frame_of(size, size, t, [](double, double) { return Color{1, 1, 1}; });
      // The last texel alone, in pixels across or down.
      const float pixels = static_cast<float>(t) / 4;
      frame.motion.values[frame.motion.values.size() - (t % 2 == 0 ? 2 : 1)] =
          t % 2 == 0 ? pixels / 40 : pixels / 24;
      const FloatImage shown = must(player->play(frame));
      const bool kept = t <= 8;
      EXPECT_EQ(player->kept_promise(), kept) << t;
      for (const float value : shown.values) ASSERT_EQ(value, kept ? 2.0f : 1.0f) << t;
    }
  }
}

TEST_F(SandwichTest, StaysFiniteOnAnyInput) {
  constexpr float kInf = std::numeric_limits<float>::infinity();
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  const Extent render{24, 20}, output{48, 40};
  const float colors[] = {kNan, kInf, -kInf, -5, 65504, 1e-45f, 6e-8f, 0};
  const float depths[] = {kNan, kInf, -kInf, 0, 1, 2, -1, 1e-40f};
  const float motions[] = {kNan, kInf, -kInf, 5, -300, 1e-8f, 0.9999f, 0};
  const auto spoil = [&](SourceFrame frame, uint64_t seed) {
    std::mt19937_64 random(seed);
    for (float& c : frame.color.values)
      if (random() % 8 == 0) c = colors[random() % 8];
    for (float& d : frame.depth.values)
      if (random() % 8 == 0) d = depths[random() % 8];
    for (float& m : frame.motion.values)
      if (random() % 8 == 0) m = motions[random() % 8];
    return frame;
  };
  for (const Kind& kind : kKinds) {
    const auto player = player_of(kind, kSeed, render, output);
    for (const bool reverse : {false, true}) {
      for (const float far_plane : {0.0f, 100.0f}) {
        for (uint32_t t = 0; t < 4; ++t) {
          SourceFrame frame = spoil(noise_frame(render, output, t, kSeed), kSeed + t);
          frame.camera.cut = t == 0;
          frame.camera.reverse_depth = reverse;
          frame.camera.far_plane = far_plane;
          EXPECT_TRUE(all_finite(must(player->play(frame)))) << kind.model << " frame " << t;
        }
      }
    }
  }
  for (const bool reverse : {false, true}) {
    const auto player = qrisp_player(render, output);
    for (uint32_t t = 0; t < 4; ++t) {
      SourceFrame frame = spoil(noise_frame(render, output, t, kSeed), kSeed + t);
      frame.camera.reverse_depth = reverse;
      EXPECT_TRUE(all_finite(must(player->play(frame)))) << "qrisp frame " << t;
    }
  }
  for (const char* name : {"nearest", "bilinear", "catmull_rom", "lanczos", "mob_fgsr"}) {
    const auto player = player_of(models() + "baselines/" + name, {}, render, output);
    for (uint32_t t = 0; t < 4; ++t)
      EXPECT_TRUE(all_finite(must(player->play(spoil(noise_frame(render, output, t, kSeed), t)))))
          << name;
  }
}

TEST_F(SandwichTest, DamageStaysLocal) {
  // One frame with a bad texel, then clean ones, against a run without it. The texel reaches 2
  // texels through the depth window, a block of 4 through the kernel, 1 through bilinear reads, and
  // the kernel's reach in the output: within 12 render texels. State and history are read
  // bilinearly or with 4 taps where the picture stands still: 2 texels more in each frame.
  const Extent render{96, 72}, output{192, 144};
  const int kX = 48, kY = 36;
  for (const Kind& kind : kKinds) {
    const auto clean = player_of(kind, kSeed, render, output);
    const auto damaged = player_of(kind, kSeed, render, output);
    for (uint32_t t = 0; t < 6; ++t) {
      SourceFrame frame = frame_of(render, output, t, [](double u, double v) {
        const float x = static_cast<float>(1 + std::sin(40 * u) * std::cos(30 * v));
        return Color{x, 0.5f * x, 0.1f};
      });
      const FloatImage expected = must(clean->play(frame));
      if (t == 2) {
        frame.color.at(kX, kY)[0] = std::numeric_limits<float>::quiet_NaN();
        frame.color.at(kX, kY)[1] = std::numeric_limits<float>::infinity();
        *frame.depth.at(kX, kY) = std::numeric_limits<float>::quiet_NaN();
        frame.motion.at(kX, kY)[0] = std::numeric_limits<float>::quiet_NaN();
      }
      const FloatImage found = must(damaged->play(frame));
      ASSERT_TRUE(all_finite(found));
      const int reach = t < 2 ? -1 : 2 * (12 + 2 * static_cast<int>(t - 2));
      for (uint32_t y = 0; y < output.height; ++y)
        for (uint32_t x = 0; x < output.width; ++x) {
          const int distance = std::max(std::abs(static_cast<int>(x) - 2 * kX),
                                        std::abs(static_cast<int>(y) - 2 * kY));
          if (distance <= reach) continue;
          ASSERT_TRUE(std::equal(found.at(x, y), found.at(x, y) + 3, expected.at(x, y)))
              << kind.model << " frame " << t << " at " << x << ", " << y;
        }
    }
  }
}

/// MNSS at a scale, with plain small networks: every weight of the inpainting one is 0.1, the anti-aliasing one hands the sample on.
class MnssTest : public SandwichTest, public testing::WithParamInterface<uint32_t> {
 protected:
  static constexpr Extent kRender{24, 20};
  static Extent output_of(Extent render) {
    return {render.width * GetParam(), render.height * GetParam()};
  }
  /// The network corrects nothing, or with a seed at random.
  static std::unique_ptr<Player> player(Extent render, uint64_t seed = 0) {
    std::mt19937_64 random(seed);
    std::string table;
    for (int i = -128; i < 128; ++i)
      table += fmt::format("{}{}", i > -128 ? "," : "",
                           seed ? static_cast<int>(random() % 256) - 128 : 0);
    CompileOptions options = options_of(models() + "mnss_x2", render, output_of(render));
    options.frame->min_ratio = options.frame->max_ratio = GetParam();
    for (FramePass& pass : options.frame->programs[0].passes)
      for (auto& [name, value] : pass.defines) {
        const bool diagonal = name[0] == 'W' && std::stoi(name.substr(1)) % 7 == 0;
        if (pass.name == "weight")
          value = name == "BIAS" ? "-2.0" : "0.1";
        else
          value = diagonal ? "1.0" : "0.0";
      }
    Graph graph = must(parse_text(
        fmt::format("graph main {{\n  input %input : i8[1,8,8,3]\n  const %t : i8[256] = [{}]\n"
                    "  %correction = table %input, %t : i8[1,8,8,3]\n  return %correction\n}}\n",
                    table)));
    const Compiled compiled = must(compile_graph(std::move(graph), 0, options));
    return must(Player::create(*device_, compiled.package));
  }
  /// Noise, colours as a display shows them, with the pattern's jitter.
  static SourceFrame noise(Extent render, uint32_t index) {
    SourceFrame frame = noise_frame(render, output_of(render), index, kSeed);
    for (float& c : frame.color.values) c = std::round(c * 127) / 255;
    frame.camera.jitter =
        scene_jitter(index, render, output_of(render), must(parse_pattern("mnss")));
    return frame;
  }
};

TEST_P(MnssTest, ConstantColourStaysWhateverMoves) {
  // Means of equal codes round to the code.
  const auto sandwich = player(kRender);
  for (uint32_t t = 0; t < 4; ++t) {
    SourceFrame frame = noise(kRender, t);
    const Color color{20.0f / 255, 131.0f / 255, 1};
    for (size_t i = 0; i < frame.color.values.size(); ++i) frame.color.values[i] = color[i % 3];
    const FloatImage shown = must(sandwich->play(frame));
    for (size_t i = 0; i < shown.values.size(); ++i)
      ASSERT_EQ(shown.values[i], color[i % 3]) << "frame " << t << " value " << i;
  }
}

TEST_P(MnssTest, ResetForgetsThePast) {
  SourceFrame last = noise(kRender, 9);
  last.camera.cut = true;
  const FloatImage expected = must(player(kRender)->play(last));
  const auto used = player(kRender);
  for (uint32_t t = 0; t < 3; ++t) must(used->play(noise(kRender, t)));
  EXPECT_EQ(must(used->play(last)).values, expected.values);
  last.camera.cut = false;
  must(used->play(noise(kRender, 4)));
  EXPECT_NE(must(used->play(last)).values, expected.values);
}

TEST_P(MnssTest, EveryFrameShowsItsSamplesAtAnySize) {
  for (const Extent render : {Extent{1, 1}, Extent{2, 3}, Extent{61, 37}, Extent{129, 71}}) {
    const auto sandwich = player(render);
    for (uint32_t t = 0; t < 3; ++t) {
      const SourceFrame frame = noise(render, t);
      const FloatImage shown = must(sandwich->play(frame));
      const auto cell = [&](size_t axis) {
        return static_cast<uint32_t>((frame.camera.jitter[axis] + 0.5f) *
                                     static_cast<float>(GetParam()));
      };
      for (uint32_t y = 0; y < render.height; ++y)
        for (uint32_t x = 0; x < render.width; ++x)
          for (uint32_t c = 0; c < 3; ++c)
            ASSERT_EQ(shown.at(GetParam() * x + cell(0), GetParam() * y + cell(1))[c],
                      frame.color.at(x, y)[c])
                << render.width << "x" << render.height << " frame " << t << " at " << x << ", "
                << y;
    }
  }
}

TEST_P(MnssTest, ShowsASlopeWithoutLines) {
  // Without a past: bilinear between the samples, so off by rounding alone, sample and result, but at the borders, where a
  // texel stands for one as far outside: by less than a texel on each axis.
  const Extent render{61, 37}, output = output_of(render);
  const auto sandwich = player(render);
  constexpr double kSlope = 0.3;
  for (uint32_t t = 0; t < 3; ++t) {
    SourceFrame frame = noise(render, t);
    frame.camera.cut = true;
    for (uint32_t y = 0; y < render.height; ++y)
      for (uint32_t x = 0; x < render.width; ++x)
        for (uint32_t c = 0; c < 3; ++c)
          frame.color.at(x, y)[c] = static_cast<float>(
              0.2 + kSlope * ((x + 0.5 + frame.camera.jitter[0]) / render.width +
                              (y + 0.5 + frame.camera.jitter[1]) / render.height));
    const FloatImage shown = must(sandwich->play(frame));
    const uint32_t rim = GetParam();
    for (uint32_t y = 0; y < output.height; ++y)
      for (uint32_t x = 0; x < output.width; ++x) {
        const bool inner =
            x >= rim && y >= rim && x + rim < output.width && y + rim < output.height;
        const double wanted = 0.2 + kSlope * ((x + 0.5) / output.width + (y + 0.5) / output.height);
        const double border = inner ? 0 : kSlope / render.width + kSlope / render.height;
        ASSERT_NEAR(*shown.at(x, y), wanted, border + 1.01 / 255) << x << ", " << y;
      }
  }
}

TEST_P(MnssTest, FlipsWithThePicture) {
  // As SymmetricPassesFlipWithThePicture: rounding of mirrored positions may choose another code, few pixels fall elsewhere.
  const auto one = player(kRender), other = player(kRender);
  for (uint32_t t = 0; t < 4; ++t) {
    const SourceFrame frame = noise(kRender, t);
    const FloatImage a = flipped(must(one->play(frame))), b = must(other->play(flipped(frame)));
    size_t wrong = 0;
    for (size_t i = 0; i < a.values.size(); ++i)
      if (std::abs(a.values[i] - b.values[i]) > 1.01f / 255) ++wrong;
    EXPECT_LE(wrong, a.values.size() / 200) << "frame " << t;
  }
}

TEST_P(MnssTest, AnyInputGivesAPictureAndFades) {
  constexpr float kInf = std::numeric_limits<float>::infinity();
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  const float bad[] = {kNan, kInf, -kInf, -5, 65504, 1e-40f, 2, 1};
  const auto clean = player(kRender), damaged = player(kRender), wild = player(kRender, kSeed);
  for (uint32_t t = 0; t < 30; ++t) {
    SourceFrame frame = noise(kRender, t);
    // At rest and equal from frame to frame, so that the history is believed.
    if (t > 0) frame.color = noise(kRender, 1).color;
    std::fill(frame.depth.values.begin(), frame.depth.values.end(), 0.5f);
    std::fill(frame.motion.values.begin(), frame.motion.values.end(), 0.0f);
    const FloatImage expected = must(clean->play(frame));
    if (t == 2) {
      std::mt19937_64 random(kSeed);
      for (FloatImage* image : {&frame.color, &frame.depth, &frame.motion})
        for (float& value : image->values)
          if (random() % 8 == 0) value = bad[random() % 8];
    }
    const FloatImage found = must(damaged->play(frame)), strange = must(wild->play(frame));
    EXPECT_TRUE(all_finite(found) && all_finite(strange)) << "frame " << t;
    if (t == 2) {
      EXPECT_NE(found.values, expected.values);
    }
    // The pattern has renewed every pixel 12 frames later. What is left in what lies between, and in the weights, dies out;
    // where 8 bits round, a code of it stays longer.
    if (t >= 2 + 12) {
      float worst = 0;
      for (size_t i = 0; i < found.values.size(); ++i)
        worst = std::max(worst, std::abs(found.values[i] - expected.values[i]));
      EXPECT_LE(worst, (t < 2 + 24 ? 2.01f : 1.01f) / 255) << "frame " << t;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Scales, MnssTest, testing::Values(2u, 3u));

/// Nothing moves; edges, wires and texture at all angles.
constexpr const char* kStillLife = R"({
  "schema": "shale-scene/1", "frames": 40, "seed": 5, "exposure": 0.8,
  "camera": {"fov_y": 50, "near": 0.1, "far": 100, "path": [
    {"frame": 0, "eye": [0.4, 1.7, 5], "target": [0, 0.9, 0]}]},
  "sun": {"direction": [0.4, 0.7, 0.5], "color": [3, 2.9, 2.6]},
  "sky": {"zenith": [0.2, 0.4, 0.8], "horizon": [0.7, 0.8, 0.9], "ambient": [0.3, 0.33, 0.4]},
  "materials": {
    "floor": {"pattern": "checker", "color": [0.7, 0.68, 0.6], "color_b": [0.2, 0.2, 0.25], "cell": [0.4, 0.4]},
    "brick": {"pattern": "bricks", "color": [0.5, 0.2, 0.12], "color_b": [0.7, 0.68, 0.6], "cell": [0.24, 0.08], "width": 0.02},
    "iron": {"color": [0.08, 0.08, 0.09]}},
  "objects": [
    {"shape": "plane", "size": [40, 40], "material": "floor"},
    {"shape": "box", "at": [-0.9, 0.6, 0], "rotate": [0, 25, 0], "size": [1, 1.2, 1], "material": "brick"},
    {"shape": "sphere", "at": [0.8, 0.6, 0.2], "radius": 0.6, "material": "floor"},
    {"shape": "wire", "from": [-3, 2.2, 0], "to": [3, 1.6, 0], "radius": 0.01, "sag": 0.3, "segments": 8, "material": "iron"}]
})";

// The trained network, at a small size: error and flicker of a still picture, and how long a bad
// texel is seen.
class TrainedTest : public SandwichTest {
 protected:
  static constexpr Extent kRender{128, 72}, kOutput{256, 144};

  static std::unique_ptr<Player> player() {
    const Graph graph = must(import_model(must(read_file(models() + "nss_v1_high/model.tosa"))));
    return player_of(models() + "nss_v1_high", graph, kRender, kOutput);
  }
  static std::unique_ptr<SceneSource> still_life() {
    SceneOptions options;
    options.render = kRender;
    options.output = kOutput;
    return must(SceneSource::create(device_->context(), must(parse_scene(kStillLife)), options));
  }
};

TEST_F(TrainedTest, ConvergesWhereNothingMoves) {
  const auto network = player();
  const auto scene = still_life();
  ReferenceTrack track;
  SequenceEvaluator evaluator;
  std::vector<double> psnr_db;
  for (uint32_t t = 0; t < 34; ++t) {
    SourceFrame frame = must(scene->frame(t, true));
    must(track.advance({.display = display_image(frame.truth, frame.camera.exposure),
                        .motion = &frame.truth_motion,
                        .depth = &frame.truth_depth,
                        .cut = frame.camera.cut,
                        .camera_still = t > 0}));
    psnr_db.push_back(*must(evaluator.add(must(network->show(frame)), track)).psnr_db);
  }
  const double last = (psnr_db[30] + psnr_db[31] + psnr_db[32] + psnr_db[33]) / 4;
  EXPECT_GE(last, psnr_db[0] + 2) << "dB, after 32 frames";
  const SequenceMetrics metrics = evaluator.finish();
  ASSERT_TRUE(metrics.still);
  EXPECT_LE(metrics.still->code_values, 3) << "of 255";
  RecordProperty("psnr_first", std::to_string(psnr_db[0]));
  RecordProperty("psnr_last", std::to_string(last));
  RecordProperty("still_deviation", std::to_string(metrics.still->code_values));
}

TEST_F(TrainedTest, DamageIsGoneAfterSixteenFrames) {
  constexpr uint32_t kBad = 6, kGone = 16;
  const auto clean = player(), damaged = player();
  const auto scene = still_life();
  for (uint32_t t = 0; t <= kBad + kGone; ++t) {
    SourceFrame frame = must(scene->frame(t, false));
    SourceFrame other = frame;
    if (t == kBad) {
      for (uint32_t y = 30; y < 33; ++y)
        for (uint32_t x = 60; x < 63; ++x) {
          other.color.at(x, y)[0] = std::numeric_limits<float>::quiet_NaN();
          other.color.at(x, y)[1] = std::numeric_limits<float>::infinity();
          *other.depth.at(x, y) = std::numeric_limits<float>::infinity();
          other.motion.at(x, y)[0] = std::numeric_limits<float>::quiet_NaN();
        }
    }
    const FloatImage expected = must(clean->show(frame));
    const FloatImage found = must(damaged->show(other));
    if (t < kBad + kGone) continue;
    float worst = 0;
    for (size_t i = 0; i < found.values.size(); ++i)
      worst = std::max(worst, std::abs(found.values[i] - expected.values[i]));
    // Four codes, and one since both pictures are rounded to 8 bits.
    EXPECT_LE(worst, 5.5f / 255) << "what is left of nine bad texels, " << kGone << " frames later";
  }
}

}  // namespace
}  // namespace shale
