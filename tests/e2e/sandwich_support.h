// tests/e2e/sandwich_support.h -- sandwiches with stand-in networks in place of the trained ones, so that any size is cheap, and
// frames for them. Their results are random tables of the input's channels: any code in [-127, 127] occurs, and the picture
// changes them.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "ir/text/text.h"
#include "tests/support/source_folder.h"
#include "tests/support/tool_device_test.h"
#include "tests/support/vulkan_fixture.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/player.h"

namespace shale {

inline constexpr uint64_t kSeed = 11;

struct Output {
  const char* name;
  uint32_t divide;  ///< of the input's sides
  int channels;     ///< a multiple of 4
};

struct Kind {
  const char* model;
  std::vector<Output> outputs;  ///< none: a sandwich without a network
  double reach;  ///< output pixels, per axis, between a pixel's middle and a sample that it takes

  friend void PrintTo(const Kind& kind, std::ostream* out) { *out << kind.model; }
};

// A kernel offset of 3 (HIGH) or 2 and a sample anywhere in that cell: half a pixel more.
inline const Kind kKinds[] = {
    {"nss_v1_high", {{"temporal", 1, 4}, {"kernel", 4, 36}}, 3.5},
    {"nss_v1_low", {{"temporal", 1, 4}, {"kernel", 4, 16}}, 2.5},
    {"nss_v0_1",
     {{"k0", 1, 4},
      {"k1", 1, 4},
      {"k2", 1, 4},
      {"k3", 1, 4},
      {"temporal", 1, 4},
      {"feedback", 1, 4}},
     2.5},
    // Two render texels, at a ratio of 3.
    {"baselines/tss", {}, 6},
};

/// Same outputs as the trained network, for an input of this size.
inline Graph stand_in(const Kind& kind, uint64_t seed, FrameExtent size) {
  std::mt19937_64 random(seed);
  std::string text =
      fmt::format("graph main {{\n  input %input : i8[1,{},{},12]\n", size.height, size.width);
  std::string results;
  for (const Output& output : kind.outputs) {
    const uint32_t rows = size.height / output.divide, columns = size.width / output.divide;
    std::string table;
    for (int i = 0; i < 256; ++i)
      table += fmt::format("{}{}", i ? "," : "", static_cast<int>(random() % 255) - 127);
    const auto shape = [&](int channels) {
      return fmt::format("i8[1,{},{},{}]", rows, columns, channels);
    };
    const std::string n = output.name;
    std::string from = "%input";
    text += fmt::format("  const %{}.t : i8[256] = [{}]\n", n, table);
    if (output.divide > 1) {
      text += fmt::format(
          "  %{}.p = max_pool2d %input {{kernel=[{},{}], stride=[{},{}], "
          "pad=[0,0,0,0]}} : {}\n",
          n, output.divide, output.divide, output.divide, output.divide, shape(12));
      from = fmt::format("%{}.p", n);
    }
    // 12 channels, several times, then the first ones of them.
    const int copies = (output.channels + 11) / 12;
    std::string many = from;
    for (int i = 1; i < copies; ++i) many += ", " + from;
    text += fmt::format("  %{}.c = concat {} {{axis=3}} : {}\n", n, many, shape(12 * copies));
    text += fmt::format("  const %{}.at : shape[4] = [0,0,0,0]\n", n);
    text += fmt::format("  const %{}.size : shape[4] = [1,{},{},{}]\n", n, rows, columns,
                        output.channels);
    text += fmt::format("  %{}.s = table %{}.c, %{}.t : {}\n", n, n, n, shape(12 * copies));
    text += fmt::format("  %{} = slice %{}.s, %{}.at, %{}.size : {}\n", n, n, n, n,
                        shape(output.channels));
    results += fmt::format("{}%{}", results.empty() ? "" : ", ", n);
  }
  return must(parse_text(text + "  return " + results + "\n}\n"));
}

/// QRISP x2 with a table of random alphas and features for each set; the candidate is the frame's
/// colour, channels 0 to 2 of the input, in all four phases; or the last code, white.
inline std::string qrisp_stand_in(uint64_t seed, FrameExtent size, bool white) {
  std::mt19937_64 random(seed);
  const auto table = [&] {
    std::string values;
    for (int i = 0; i < 256; ++i)
      values += fmt::format("{}{}", i ? "," : "", static_cast<int>(random() % 255) - 127);
    return values;
  };
  const auto shape = [&](int channels) {
    return fmt::format("[1,{},{},{}]", size.height, size.width, channels);
  };
  std::string text = fmt::format(
      "graph main {{\n  input %input : i8{}\n  const %size : shape[4] = {}\n"
      "  const %four : shape[4] = {}\n  const %zero : shape[4] = [0,0,0,0]\n"
      "  const %past : shape[4] = [0,0,0,6]\n  const %ta : i8[256] = [{}]\n"
      "  const %tf : i8[256] = [{}]\n",
      shape(22), shape(1), shape(4), table(), table());
  std::string colors;
  for (int c = 0; c < 3; ++c) {
    text += fmt::format("  const %at{0} : shape[4] = [0,0,0,{0}]\n", c);
    text += fmt::format("  %c{0} = slice %input, %at{0}, %size : i8{1}\n", c, shape(1));
    for (int i = 0; i < 4; ++i) colors += fmt::format("{}%c{}", colors.empty() ? "" : ", ", c);
  }
  return text + fmt::format(
                    "  %plain = concat {0} {{axis=3}} : i8{1}\n"
                    "  %candidate = clamp %plain {{min_val={3}, max_val=127}} : i8{1}\n"
                    "  %a = slice %input, %past, %four : i8{2}\n"
                    "  %f = slice %input, %zero, %four : i8{2}\n"
                    "  %alpha = table %a, %ta : i8{2}\n  %feature = table %f, %tf : i8{2}\n"
                    "  return %alpha, %candidate, %feature\n}}\n",
                    colors, shape(12), shape(4), white ? 127 : -128);
}

class SandwichTest : public ToolDeviceTest<testing::Test> {
 protected:
  static CompileOptions options_of(const std::string& folder, Extent render, Extent output) {
    CompileOptions options;
    options.frame = must(parse_frame(must(read_text(folder + "/frame.json"))));
    options.load_shader = [folder](const std::string& path) {
      return read_text(folder + "/" + path);
    };
    options.sizes = {FrameExtent{render.width, render.height},
                     FrameExtent{output.width, output.height}};
    // Drivers take long for the fast ones, which pay at other sizes.
    options.kernels = {"conv2d_s8_loop", "generic"};
    return options;
  }
  /// Size of the tensor "input".
  static FrameExtent input_size(const CompileOptions& options) {
    for (const FrameTensor& tensor : options.frame->tensors)
      if (tensor.name == "input")
        return (*tensor.size)(*options.sizes.render, *options.sizes.output);
    return {};
  }
  static std::unique_ptr<Player> player_of(const std::string& folder, std::optional<Graph> graph,
                                           Extent render, Extent output) {
    const Compiled compiled = must(
        compile_graph(graph ? *std::move(graph) : Graph{}, 0, options_of(folder, render, output)));
    return must(Player::create(*device_, compiled.package));
  }
  static std::unique_ptr<Player> player_of(const Kind& kind, uint64_t seed, Extent render,
                                           Extent output) {
    const std::string folder = models() + kind.model;
    std::optional<Graph> graph;
    if (!kind.outputs.empty())
      graph = stand_in(kind, seed, input_size(options_of(folder, render, output)));
    return player_of(folder, std::move(graph), render, output);
  }
  static std::unique_ptr<Player> qrisp_player(Extent render, Extent output, bool white = false) {
    CompileOptions options = options_of(models() + "qrisp_s_x2", render, output);
    const auto network = [size = input_size(options), white](uint64_t seed) {
      const std::string text = qrisp_stand_in(seed, size, white);
      return std::vector<uint8_t>(text.begin(), text.end());
    };
    options.load_model = [&](const std::string& path) -> Result<std::vector<uint8_t>> {
      return network(path[path.size() - 6] + kSeed);  // sets/NN.tosa
    };
    const Compiled compiled = must(compile(network(kSeed), options));
    return must(Player::create(*device_, compiled.package));
  }
  static std::string models() { return source_folder() + "/models/"; }
};

using Color = std::array<float, 3>;

/// A frame without motion whose samples see `color` at their scene position, in uv of the picture.
inline SourceFrame frame_of(Extent render, Extent output, uint32_t index,
                            const std::function<Color(double u, double v)>& color) {
  SourceFrame frame;
  frame.camera.fov_x = 1.2f;
  frame.camera.fov_y = 0.8f;
  frame.camera.far_plane = 100;
  frame.camera.jitter = scene_jitter(index, render, output);
  frame.color = {render.width, render.height, 3, {}};
  frame.depth = {render.width, render.height, 1,
                 std::vector<float>(size_t{render.width} * render.height, 0.5f)};
  frame.motion = {render.width, render.height, 2,
                  std::vector<float>(size_t{render.width} * render.height * 2, 0.0f)};
  for (uint32_t y = 0; y < render.height; ++y)
    for (uint32_t x = 0; x < render.width; ++x) {
      const Color c = color((x + 0.5 + frame.camera.jitter[0]) / render.width,
                            (y + 0.5 + frame.camera.jitter[1]) / render.height);
      frame.color.values.insert(frame.color.values.end(), c.begin(), c.end());
    }
  return frame;
}

/// Noise in colour, depth and motion, which is up to 3 render pixels long.
inline SourceFrame noise_frame(Extent render, Extent output, uint32_t index, uint64_t seed) {
  std::mt19937_64 random(seed + index);
  std::uniform_real_distribution<float> unit(0, 1);
  SourceFrame frame = frame_of(render, output, index, [&](double, double) {
    return Color{2 * unit(random), 2 * unit(random), 2 * unit(random)};
  });
  for (float& d : frame.depth.values) d = 0.9f + 0.1f * unit(random);
  for (size_t i = 0; i < frame.motion.values.size(); ++i)
    frame.motion.values[i] =
        (6 * unit(random) - 3) / static_cast<float>(i % 2 == 0 ? render.width : render.height);
  return frame;
}

inline bool all_finite(const FloatImage& image) {
  return std::all_of(image.values.begin(), image.values.end(),
                     [](float v) { return std::isfinite(v) && v >= 0; });
}

}  // namespace shale
