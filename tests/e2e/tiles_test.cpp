// Networks that work by tiles give what the whole network gives, bit for bit, whatever changed: on the kernels of every family,
// with strides, resizes, concats, several readers and several inputs, and in the loop of a sandwich.
#include <gtest/gtest.h>

#include <algorithm>

#include "compiler/driver/compile.h"
#include "ir/base/file.h"
#include "tests/compiler/graph_support.h"
#include "tests/support/source_folder.h"
#include "tests/support/tool_device_test.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 5;

/// Convolutions with what follows them, line by line.
class GraphText {
 public:
  explicit GraphText(const std::string& inputs) : text_("graph main {\n" + inputs) {
    text_ +=
        "  const %zp : i8[1] = [-3]\n  const %none : i8[1] = [0]\n  const %zp32 : i32[1] = [0]\n"
        "  const %m : i32[1] = [1400000000]\n  const %s : i8[1] = [40]\n"
        "  const %scale : shape[4] = [2,1,2,1]\n  const %offset : shape[2] = [0,0]\n"
        "  const %border : shape[2] = [1,1]\n";
  }

  /// A 3x3 window of `from`, i8[1,?,?,in], requantized to i8[1,h,w,out].
  void conv(const std::string& name, const std::string& from, int64_t in, Shape shape,
            int64_t stride, int64_t after = 1) {
    std::string weights, bias;
    for (int64_t i = 0; i < shape[3] * 9 * in; ++i)
      weights += fmt::format("{}{}", i ? "," : "", static_cast<int64_t>(random_() % 61) - 30);
    for (int64_t i = 0; i < shape[3]; ++i)
      bias += fmt::format("{}{}", i ? "," : "", static_cast<int64_t>(random_() % 2001) - 1000);
    const std::string size = shape_text(shape);
    text_ += fmt::format(
        "  const %{0}_w : i8[{1},3,3,{2}] = [{3}]\n  const %{0}_b : i32[{1}] = [{4}]\n"
        "  %{0}_a = conv2d %{5}, %{0}_w, %{0}_b, %zp, %none {{pad=[1,{6},1,{6}], "
        "stride=[{7},{7}], dilation=[1,1], acc_type=i32}} : i32{8}\n"
        "  %{0} = rescale %{0}_a, %m, %s, %zp32, %zp {{scale32=true, rounding_mode=single}} : "
        "i8{8}\n",
        name, shape[3], in, weights, bias, from, after, stride, size);
  }
  void add(const std::string& line) { text_ += "  " + line + "\n"; }
  Graph finish(const std::string& results) const {
    return graph_of(text_ + "  return " + results + "\n}");
  }

 private:
  std::string text_;
  std::mt19937_64 random_{kSeed};
};

/// Down and up again with a bridge: `skip` has three readers, one of them the result. Sides are even.
Graph bridge(int64_t h, int64_t w) {
  GraphText text(fmt::format("  input %x : i8[1,{},{},4]\n", h, w));
  text.conv("skip", "x", 4, {1, h, w, 8}, 1);
  text.conv("down", "skip", 8, {1, h / 2, w / 2, 8}, 2, 0);
  text.conv("low", "down", 8, {1, h / 2, w / 2, 8}, 1);
  text.add(fmt::format(
      "%up = resize %low, %scale, %offset, %border {{mode=nearest}} : i8[1,{},{},8]", h, w));
  text.conv("phase", "up", 8, {1, h, w, 4}, 1);
  text.add(fmt::format("%all = concat %up, %skip {{axis=3}} : i8[1,{},{},16]", h, w));
  text.conv("y", "all", 16, {1, h, w, 4}, 1);
  return text.finish("%y, %low, %phase, %skip");
}

/// Two inputs of different sizes, and sides that nothing divides.
Graph pair(int64_t h, int64_t w) {
  GraphText text(fmt::format("  input %x : i8[1,{},{},3]\n  input %far : i8[1,{},{},4]\n", h, w,
                             (h + 1) / 2, (w + 1) / 2));
  text.conv("a", "x", 3, {1, (h + 1) / 2, (w + 1) / 2, 4}, 2);
  text.add(fmt::format("%sum = bitwise_xor %a, %far : i8[1,{},{},4]", (h + 1) / 2, (w + 1) / 2));
  text.conv("y", "sum", 4, {1, (h + 1) / 2, (w + 1) / 2, 5}, 1);
  return text.finish("%y");
}

struct Case {
  std::string target, prefer;
  std::vector<std::string> kernels;  ///< the convolutions take one of these
  bool is_pair = false;

  friend void PrintTo(const Case& c, std::ostream* out) { *out << c.target << " " << c.prefer; }
};

class Tiles : public ToolDeviceTest<testing::TestWithParam<Case>> {};

/// Sets a rectangle of the input to other values.
void change(Tensor& input, std::mt19937_64& random, int64_t height, int64_t width) {
  const Shape& shape = input.type.shape;
  const int64_t top = static_cast<int64_t>(random() % static_cast<uint64_t>(shape[1])),
                left = static_cast<int64_t>(random() % static_cast<uint64_t>(shape[2]));
  for (int64_t y = top; y < std::min(top + height, shape[1]); ++y)
    for (int64_t x = left; x < std::min(left + width, shape[2]); ++x)
      for (int64_t c = 0; c < shape[3]; ++c)
        input.set((y * shape[2] + x) * shape[3] + c, static_cast<int64_t>(random() % 256) - 128);
}

CompileOptions options_of(const Case& c) {
  CompileOptions options;
  options.targets = {c.target};
  options.prefer = c.prefer;
  // Small pictures are faster by runs, which take or leave the whole grid.
  options.kernels = c.kernels;
  options.kernels.emplace_back("generic");
  options.optimize_spirv = false;
  return options;
}

TEST_P(Tiles, GiveTheWholeResultWhateverChanged) {
  const Case& c = GetParam();
  for (const auto& [h, w] : {std::pair<int64_t, int64_t>{44, 150}, {70, 102}, {6, 10}}) {
    const Graph graph = c.is_pair ? pair(h + 1, w + 1) : bridge(h, w);
    CompileOptions options = options_of(c);
    const Compiled whole = must(compile_graph(graph, 0, options));
    options.tiles = 0;
    const Compiled tiles = must(compile_graph(graph, 0, options));
    EXPECT_EQ(tiles.warnings, std::vector<std::string>());
    for (const Dispatch& dispatch : tiles.package.variants[0].segments[0].dispatches)
      EXPECT_TRUE(dispatch.cost.macs == 0 ||
                  std::find(c.kernels.begin(), c.kernels.end(), dispatch.kernel) != c.kernels.end())
          << dispatch.kernel;
    for (const std::string& line :
         missing(device_->context().caps, tiles.package.variants[0].requirements))
      GTEST_SKIP() << line;

    std::vector<Tensor> inputs = random_inputs(graph, kSeed);
    NetworkRun all = must(NetworkRun::create(*device_, whole.package, inputs));
    NetworkRun parts = must(NetworkRun::create(*device_, tiles.package, inputs));
    std::mt19937_64 random(kSeed);
    bool ran_a_part = false;
    for (int turn = 0; turn < 8; ++turn) {
      // A texel, a rectangle, nothing, everything, in one input or in both.
      for (size_t i = 0; i < inputs.size(); ++i) {
        if (turn % 4 == 1) change(inputs[i], random, 1, 1);
        if (turn % 4 == 2 && (i == 0 || turn == 6)) change(inputs[i], random, 13, 21);
        if (turn == 7) inputs[i] = random_inputs(graph, kSeed + 1)[i];
      }
      ASSERT_TRUE(all.set_inputs(inputs));
      ASSERT_TRUE(parts.set_inputs(inputs));
      ASSERT_TRUE(all.run());
      const NetworkRun::ChangesRun ran = must(parts.run_changes());
      ran_a_part = ran_a_part || ran.share < 0.9;
      if (turn == 0 || turn == 7) {
        EXPECT_DOUBLE_EQ(ran.share, 1);
      }
      const std::vector<Tensor> expected = all.outputs(), found = parts.outputs();
      for (size_t i = 0; i < expected.size(); ++i)
        if (const auto difference = first_difference(found[i], expected[i]))
          FAIL() << h << "x" << w << " turn " << turn << ", output " << i << ": " << *difference;
    }
    EXPECT_TRUE(ran_a_part || h < 10);
  }
}

const std::vector<std::string> kAny{
    "conv2d_s8_f64pair",    "conv2d_s8_f32exact", "conv2d_s8_winograd",
    "conv2d_s8_winograd32", "conv2d_s8_phase",    "conv2d_s8_phase32",
    "conv2d_s8_i32",        "conv2d_s8_loop",     "generic"};

INSTANTIATE_TEST_SUITE_P(
    Kernels, Tiles,
    testing::Values(Case{"lavapipe", "conv2d_s8_winograd", kAny},
                    Case{"lavapipe", "conv2d_s8_phase", kAny},
                    Case{"lavapipe", "conv2d_s8_f64pair", kAny},
                    Case{"lavapipe-avx2", "conv2d_s8_winograd32", kAny},
                    Case{"lavapipe", "conv2d_s8_loop", {"conv2d_s8_loop"}},
                    Case{"lavapipe", "conv2d_s8_loop", {"conv2d_s8_loop"}, true},
                    Case{"lavapipe", "conv2d_s8_f32exact", kAny, true},
                    Case{"dot8-gpu", "", {"conv2d_s8_dot8"}},
                    Case{"dot8-gpu", "", {"conv2d_s8_dot8"}, true},
                    Case{"dot8-gpu", "generic", {"generic"}}));

class TilesTest : public ToolDeviceTest<testing::Test> {};

TEST_F(TilesTest, RunAllAgainBehindABindingAndWhereAskedTo) {
  CompileOptions options = options_of({"dot8-gpu", "", {}});
  options.tiles = 0;
  const Graph graph = bridge(40, 70);
  const Compiled compiled = must(compile_graph(graph, 0, options));
  for (const std::string& line :
       missing(device_->context().caps, compiled.package.variants[0].requirements))
    GTEST_SKIP() << line;
  const std::vector<Tensor> inputs = random_inputs(graph, kSeed);
  NetworkRun run = must(NetworkRun::create(*device_, compiled.package, inputs));
  EXPECT_DOUBLE_EQ(must(run.run_changes()).share, 1);
  EXPECT_LT(must(run.run_changes()).share, 0.5);
  ASSERT_TRUE(run.run());  // all of it
  EXPECT_LT(must(run.run_changes()).share, 0.5);
}

TEST_F(TilesTest, KeepWhatLiesWithinTheToleranceAndDoNotDriftAway) {
  CompileOptions options = options_of({"dot8-gpu", "", {}});
  options.tiles = 2;
  const Graph graph = bridge(40, 70);
  const Compiled compiled = must(compile_graph(graph, 0, options));
  for (const std::string& line :
       missing(device_->context().caps, compiled.package.variants[0].requirements))
    GTEST_SKIP() << line;
  std::vector<Tensor> inputs{Tensor::zeros(graph.value(graph.inputs[0]).type)};
  NetworkRun run = must(NetworkRun::create(*device_, compiled.package, inputs));
  must(run.run_changes());
  const std::vector<Tensor> first = run.outputs();
  for (int code = 1; code <= 3; ++code) {  // a step at a time, which is each within the tolerance
    inputs[0].set(1000, code);
    ASSERT_TRUE(run.set_inputs(inputs));
    const double share = must(run.run_changes()).share;
    const std::vector<Tensor> expected = code <= 2 ? first : must(interpret(graph, inputs));
    for (size_t i = 0; i < expected.size(); ++i)
      EXPECT_EQ(first_difference(run.outputs()[i], expected[i]), std::nullopt) << code;
    if (code <= 2) {
      EXPECT_LT(share, 0.5);
    }
  }
}

/// The pictures of both, and how much of the second one's network ran.
void expect_same_pictures(const ToolDevice& device, const std::string& model,
                          const std::string& target, FrameExtent render) {
  const std::string folder = source_folder() + "/models/" + model;
  CompileOptions options;
  options.targets = {target};
  options.frame = must(parse_frame(must(read_text(folder + "/frame.json"))));
  options.load_shader = [folder](const std::string& path) {
    return read_text(folder + "/" + path);
  };
  options.load_model = [folder](const std::string& path) { return read_file(folder + "/" + path); };
  options.sizes.render = render;
  const std::vector<uint8_t> bytes = must(read_file(folder + "/model.tosa"));
  const Compiled whole = must(compile(bytes, options));
  options.tiles = 0;
  const Compiled tiles = must(compile(bytes, options));
  for (const std::string& line :
       missing(device.context().caps, tiles.package.variants[0].requirements))
    GTEST_SKIP() << line;
  const std::unique_ptr<Player> all = must(Player::create(device, whole.package)),
                                parts = must(Player::create(device, tiles.package));
  const Extent size = all->render_size();
  std::mt19937_64 random(kSeed);
  SourceFrame frame;
  frame.camera.fov_x = 1.2f;
  frame.camera.fov_y = 0.8f;
  frame.camera.far_plane = 100;
  const auto image = [&](uint32_t channels, float value) {
    return FloatImage{size.width, size.height, channels,
                      std::vector<float>(size_t{size.width} * size.height * channels, value)};
  };
  frame.color = image(3, 0);
  frame.depth = image(1, 0.5f);
  frame.motion = image(2, 0);
  for (float& value : frame.color.values) value = static_cast<float>(random() % 1000) / 1000;
  double least = 1;
  for (uint32_t i = 0; i < 9; ++i) {
    frame.camera.cut = i == 6;
    frame.camera.jitter = scene_jitter(i / 2, size, all->output_size());  // may choose the program
    if (i >= 3)  // first it comes to rest, then a few texels change
      for (uint32_t x = 0; x < 5; ++x)
        frame.color.values[3 * ((i + 2) * size.width + 3 + x)] = static_cast<float>(i) / 8;
    SourceFrame one = frame, other = frame;
    EXPECT_EQ(must(all->show(one)).values, must(parts->show(other)).values) << "frame " << i;
    EXPECT_FALSE(all->share_run());
    const double share = parts->share_run().value_or(-1);
    if (i == 0 || i == 6) {
      EXPECT_DOUBLE_EQ(share, 1) << "frame " << i;
    }
    least = std::min(least, share);
    for (const Resource& resource : all->variant().resources)
      if (resource.category == Category::kOutput) {
        EXPECT_EQ(first_difference(must(parts->read_tensor(resource.name)),
                                   must(all->read_tensor(resource.name))),
                  std::nullopt)
            << resource.name << " of frame " << i;
      }
  }
  EXPECT_GT(least, 0);
  EXPECT_LE(least, 1);
}

TEST_F(TilesTest, OfARecurrentSandwichGiveTheSamePictures) {
  expect_same_pictures(*device_, "nss_v1_low", "dot8-gpu", {50, 34});
}

TEST_F(TilesTest, OfASandwichWithSeveralProgramsGiveTheSamePictures) {
  expect_same_pictures(*device_, "qrisp_s_x2", "dot8-gpu", {42, 22});
}

}  // namespace
}  // namespace shale
