// Every bundled sandwich as it is compiled for every target, run on the device that is there: through buffers, as a CPU driver
// has it, and through images and samplers, as a GPU has it. Networks are equal to the interpreter bit for bit in both forms;
// what is shown may differ by the sampler's weights alone.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "ir/reference/interpreter.h"
#include "tests/support/tool_device_test.h"
#include "tests/support/vulkan_fixture.h"
#include "tools/scene/scene.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 5;

struct Model {
  const char* folder;
  const char* network;  ///< "" for a sandwich without one
  Extent render, output;
  bool samples =
      false;  ///< a pass uses the device's sampler, so codes of the network's input may differ
  bool all_targets = true;
  bool codes_return = false;  ///< histories hold codes: one that is rounded otherwise comes back

  friend void PrintTo(const Model& model, std::ostream* out) { *out << model.folder; }
};

const Model kModels[] = {
    {"nss_v1_high", "model.tosa", {30, 22}, {60, 44}, true},
    {"nss_v1_low", "model.tosa", {30, 22}, {60, 44}, true},
    {"nss_v0_1", "model.tosa", {30, 22}, {60, 44}, true},
    {"nss_v1_high",
     "model.tosa",
     {25, 18},
     {43, 31},
     true,
     false},  // no whole ratio: each pixel by itself
    {"nss_v0_1", "model.tosa", {25, 18}, {43, 31}, true, false},
    {"qrisp_s_x2", "model.tosa", {20, 14}, {40, 28}, true},
    {"qrisp_s_x2", "model.tosa", {25, 19}, {50, 38}, true, false},
    {"mnss_x2", "model.tosa", {20, 14}, {40, 28}, true, true, true},
    {"mnss_x2", "model.tosa", {25, 19}, {50, 38}, true, false, true},
    {"srpo_x2", "model.tosa", {20, 14}, {40, 28}},
    {"srpo_x3", "model.tosa", {20, 14}, {60, 42}},
    {"baselines/nearest", "", {25, 18}, {43, 31}},
    {"baselines/bilinear", "", {25, 18}, {43, 31}},
    {"baselines/catmull_rom", "", {25, 18}, {43, 31}},
    {"baselines/lanczos", "", {25, 18}, {43, 31}},
    {"baselines/mob_fgsr", "", {25, 18}, {43, 31}},
    {"baselines/tss", "", {25, 18}, {43, 31}},
    {"baselines/mob_fgsr_sr_interpolation", "", {25, 18}, {43, 31}},
    {"baselines/mob_fgsr_extrapolation", "", {25, 18}, {25, 18}},
    {"baselines/motion_and_flow", "", {35, 22}, {35, 22}},
};

/// Noise in colour and depth; motion of up to 3 render pixels in patches.
SourceFrame frame_of(const Model& model, uint32_t index, bool is_display) {
  std::mt19937_64 random(kSeed + index);
  std::uniform_real_distribution<float> unit(0, 1);
  const Extent render = model.render;
  SourceFrame frame;
  frame.camera.fov_x = 1.2f;
  frame.camera.fov_y = 0.8f;
  frame.camera.far_plane = 100;
  frame.camera.jitter = scene_jitter(index, render, model.output);
  const size_t pixels = size_t{render.width} * render.height;
  const auto fill = [&](uint32_t channels, auto&& value) {
    FloatImage image{render.width, render.height, channels, {}};
    for (size_t i = 0; i < pixels * channels; ++i) image.values.push_back(value(i));
    return image;
  };
  frame.color = fill(3, [&](size_t) { return (is_display ? 1.0f : 2.0f) * unit(random); });
  frame.depth = fill(1, [&](size_t) { return 0.9f + 0.1f * unit(random); });
  frame.motion = fill(2, [&](size_t i) {
    const size_t patch = i / 2 % render.width / 8 + index;
    return (static_cast<float>(patch % 3) - 1.0f) * 2.6f /
           static_cast<float>(i % 2 == 0 ? render.width : render.height);
  });
  return frame;
}

class FrameForms : public ToolDeviceTest<testing::TestWithParam<Model>> {
 protected:
  static Compiled compiled_for(const std::string& target, const Model& model) {
    const std::string folder = std::string(SHALE_SOURCE_DIR) + "/models/" + model.folder + "/";
    CompileOptions options;
    options.frame = must(parse_frame(must(read_text(folder + "frame.json"))));
    options.load_shader = [folder](const std::string& path) { return read_text(folder + path); };
    options.load_model = [folder](const std::string& path) { return read_file(folder + path); };
    options.sizes = {FrameExtent{model.render.width, model.render.height},
                     FrameExtent{model.output.width, model.output.height}};
    options.targets = {target};
    // spirv-opt, which GPUs' modules pass, joins float constants: that rounds otherwise.
    options.optimize_spirv = model.samples;
    // Drivers compile the fast kernels of a CPU for long; other tests run them.
    if (target == "lavapipe") options.kernels = {"conv2d_s8_loop", "generic"};
    std::vector<uint8_t> bytes;
    if (model.network[0] != '\0') bytes = must(read_file(folder + model.network));
    Compiled compiled = must(compile(bytes, options));
    EXPECT_EQ(compiled.warnings, std::vector<std::string>{}) << target;
    return compiled;
  }

  static std::string input_of(const Graph& graph) { return graph.value(graph.inputs[0]).name; }

  /// The outputs of the last frame's network are what the interpreter makes of its input.
  static void expect_exact(const Compiled& compiled, const Player& player) {
    const size_t set = player.program();
    const Graph& graph = set ? compiled.further_graphs[set - 1] : compiled.graph;
    const std::vector<Tensor> expected =
        must(interpret(graph, std::vector<Tensor>{must(player.read_tensor(input_of(graph)))}));
    for (size_t i = 0; i < expected.size(); ++i) {
      const std::string& name = graph.value(graph.outputs[i]).name;
      EXPECT_EQ(must(player.read_tensor(name)).bytes, expected[i].bytes) << name;
    }
  }
};

TEST_P(FrameForms, ImagesAndBuffersShowTheSame) {
  const Model& model = GetParam();
  const Compiled in_buffers = compiled_for("lavapipe", model);
  const auto cpu = must(Player::create(*device_, in_buffers.package));
  for (const char* target : {"generic-gpu", "dot8-gpu", "coopmat-gpu"}) {
    if (!model.all_targets && std::string(target) != "dot8-gpu") continue;
    const Compiled in_images = compiled_for(target, model);
    for (const Segment& segment : in_images.package.variants[0].segments)
      for (const Dispatch& dispatch : segment.dispatches)
        EXPECT_NE(dispatch.kernel, kCopyKernel) << target << " " << dispatch.name;
    if (!meets(device_->context().caps, in_images.package.variants[0].requirements)) {
      EXPECT_STREQ(target, "coopmat-gpu");  // the one that not every device runs
      continue;
    }
    const auto gpu = must(Player::create(*device_, in_images.package));
    cpu->reset();
    for (uint32_t t = 0; t < 3; ++t) {
      const SourceFrame frame = frame_of(model, t, cpu->is_display());
      FloatImage expected = must(cpu->play(frame)), found = must(gpu->play(frame));
      ASSERT_EQ(found.values.size(), expected.values.size());
      if (const std::optional<Generator>& generator = gpu->variant().generator) {
        const float time = generated_time(*generator, 1, 2);
        const FloatImage a = must(cpu->generate(time)), b = must(gpu->generate(time));
        expected.values.insert(expected.values.end(), a.values.begin(), a.values.end());
        found.values.insert(found.values.end(), b.values.begin(), b.values.end());
      }
      double worst = 0, sum = 0;
      for (size_t i = 0; i < expected.values.size(); ++i) {
        const double difference = std::abs(found.values[i] - expected.values[i]);
        worst = std::max(worst, difference);
        sum += difference * difference;
      }
      if (!model.samples) {
        EXPECT_EQ(worst, 0.0) << target << " frame " << t;
      } else {
        // The sampler feeds the network's input alone: what the network makes of codes that change.
        EXPECT_LE(std::sqrt(sum / static_cast<double>(expected.values.size())), 0.01)
            << target << " frame " << t << ", at most " << worst;
      }
      if (model.network[0] == '\0') continue;
      expect_exact(in_images, *gpu);
      if (t != 2) continue;
      expect_exact(in_buffers, *cpu);
      // The network's input, code by code. Weights in float32 are 2^-22 off at most, so that one code in 8,000 is close enough to
      // its rounding to change; weights of 4 bits of fraction, Vulkan's minimum, are 2^-5 off, which is eight codes.
      const std::string name = input_of(in_images.graph);
      const Tensor a = must(cpu->read_tensor(name)), b = must(gpu->read_tensor(name));
      const int64_t most_off =
          model.samples && !device_->context().caps.cpu ? 8 : (model.codes_return ? 1 : 0);
      size_t apart = 0;
      for (int64_t i = 0; i < a.count(); ++i) apart += std::abs(a.get(i) - b.get(i)) > most_off;
      EXPECT_LE(apart, model.samples ? static_cast<size_t>(a.count() / 1000) : 0) << target;
    }
    // Without its past the last frame is another one: histories are read in images, too.
    const bool has_past = std::any_of(
        in_images.package.variants[0].resources.begin(),
        in_images.package.variants[0].resources.end(),
        [](const Resource& resource) { return resource.category == Category::kImageHistory; });
    if (!has_past) continue;
    const SourceFrame last = frame_of(model, 3, gpu->is_display());
    // Where pictures are generated it shows in these.
    const auto shown = [&] {
      const FloatImage played = must(gpu->play(last));
      const std::optional<Generator>& generator = gpu->variant().generator;
      return generator ? must(gpu->generate(generated_time(*generator, 1, 1))) : played;
    };
    const FloatImage continued = shown();
    gpu->reset();
    EXPECT_NE(shown().values, continued.values) << target;
  }
}

INSTANTIATE_TEST_SUITE_P(Bundled, FrameForms, testing::ValuesIn(kModels),
                         [](const testing::TestParamInfo<Model>& test) {
                           std::string name = test.param.folder;
                           std::replace(name.begin(), name.end(), '/', '_');
                           return fmt::format("{}_{}x{}", name, test.param.output.width,
                                              test.param.output.height);
                         });

}  // namespace
}  // namespace shale
