// Small graphs under every way in which a program may say the same: strides, tilings, bindings, modules, hints. Data and
// graphs are those that the public conformance suite describes: ramps through pairs of sums, pools and convolutions.
#include <cmath>

#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

constexpr double kFirstInput = 7, kFirstWeight = 1.5, kFirstBias = 2.3;

/// Values that count up from `first`, in text.
std::string ramp(double first, int64_t count) {
  std::string text;
  for (int64_t i = 0; i < count; ++i)
    text += fmt::format("{}{}", i ? "," : "", first + static_cast<double>(i));
  return text;
}

std::string sums(const std::string& type) {
  return fmt::format(
      "graph main {{\n  input %x : {0}[1,8,16,4]\n  input %y : {0}[1,8,16,4]\n"
      "  %s = add %x, %y : {0}[1,8,16,4]\n  %d = sub %s, %y : {0}[1,8,16,4]\n  return %d\n}}\n",
      type);
}

std::string pools(const std::string& type, bool twice) {
  const char* mode = type == "i8" ? "" : ", nan_mode=propagate";
  std::string text = fmt::format(
      "graph main {{\n  input %x : {0}[1,8,16,4]\n"
      "  %a = max_pool2d %x {{kernel=[2,2], stride=[2,2], pad=[0,0,0,0]{1}}} : {0}[1,4,8,4]\n",
      type, mode);
  if (twice)
    text += fmt::format(
        "  %b = max_pool2d %a {{kernel=[2,2], stride=[2,2], pad=[0,0,0,0]{}}} : {}[1,2,4,4]\n",
        mode, type);
  return text + fmt::format("  return %{}\n}}\n", twice ? "b" : "a");
}

/// Of int8 with int32 sums, which a cast makes int8 in between; or of one type.
std::string convolutions(const std::string& type, bool twice) {
  const bool integers = type == "i8";
  const std::string sum = integers ? "i32" : type;
  const auto layer = [&](const char* from, const char* to, int rows, int columns) {
    return fmt::format(
        "  %{1} = conv2d %{0}, %w, %b, %z, %z {{pad=[0,0,0,0], stride=[2,2], dilation=[1,1], "
        "acc_type={2}}} : {2}[1,{3},{4},4]\n",
        from, to, sum, rows, columns);
  };
  std::string text = fmt::format(
      "graph main {{\n  input %x : {0}[1,8,16,4]\n  const %w : {0}[4,2,2,4] = [{1}]\n"
      "  const %b : {2}[4] = [{3}]\n  const %z : {0}[1] = [0]\n",
      type, ramp(integers ? 1 : kFirstWeight, 64), sum, ramp(integers ? 2 : kFirstBias, 4));
  text += layer("x", "a", 4, 8);
  if (twice) {
    if (integers) text += "  %n = cast %a : i8[1,4,8,4]\n";
    text += layer(integers ? "n" : "a", "c", 2, 4);
  }
  return text + fmt::format("  return %{}\n}}\n", twice ? "c" : "a");
}

class SwitchesLayerTest : public LayerTest {
 protected:
  /// Runs the graph under every combination of the options, or one of `step`, and compares with the interpreter.
  void expect_all(const std::string& text, int step = 1) {
    const Graph graph = graph_of(text);
    std::vector<Tensor> inputs;
    for (const ValueId id : graph.inputs) {
      Tensor tensor = Tensor::zeros(graph.value(id).type);
      for (int64_t i = 0; i < tensor.count(); ++i)
        if (is_float(tensor.type.dtype))
          tensor.set_real(i, static_cast<float>(kFirstInput) + static_cast<float>(i));
        else
          tensor.set(i, (static_cast<int64_t>(kFirstInput) + i) % 128);
      inputs.push_back(std::move(tensor));
    }
    const std::vector<Tensor> expected = must(interpret(graph, inputs));
    VkDataGraphPipelineCompilerControlCreateInfoARM control{};
    control.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_COMPILER_CONTROL_CREATE_INFO_ARM;
    control.pVendorOptions = "";
    for (int bits = 0; bits < 3 * 2 * 2 * 2 * 2 * 2; bits += step) {
      int rest = bits;
      const auto take = [&](int count) {
        const int value = rest % count;
        rest /= count;
        return value;
      };
      GraphOptions options;
      const int strides = take(3);
      options.strides = strides > 0;
      options.padding = strides == 2 ? 3 : 0;
      options.tiling = take(2) ? VK_TENSOR_TILING_OPTIMAL_ARM : VK_TENSOR_TILING_LINEAR_ARM;
      options.unordered = take(2) == 1;
      options.chained = take(2) == 1;
      options.sparse = take(2) == 1;
      options.next = take(2) ? &control : nullptr;
      SCOPED_TRACE(
          fmt::format("{}: strides {}, tiling {}, unordered {}, chained {}, sparse {}, control {}",
                      text, strides, static_cast<int>(options.tiling), options.unordered,
                      options.chained, options.sparse, options.next != nullptr));
      ClientRun run;
      ASSERT_EQ(run.create(client, graph, options), VK_SUCCESS) << client.last_message;
      EXPECT_GT(run.graph.session_bytes, 0u);
      EXPECT_EQ(run.run(inputs), expected);
    }
  }
};

TEST_F(SwitchesLayerTest, Sums) {
  expect_all(sums("i32"));
  expect_all(sums("f32"), 7);
  expect_all(sums("f16"), 7);
}
TEST_F(SwitchesLayerTest, Pools) {
  expect_all(pools("i8", false));
  expect_all(pools("i8", true));
  expect_all(pools("f32", true), 7);
  expect_all(pools("f16", false), 7);
}
TEST_F(SwitchesLayerTest, Convolutions) {
  expect_all(convolutions("i8", false));
  expect_all(convolutions("i8", true));
  expect_all(convolutions("f32", false), 7);
  expect_all(convolutions("f32", true), 7);
  expect_all(convolutions("f16", false), 7);
}

}  // namespace
}  // namespace shale
