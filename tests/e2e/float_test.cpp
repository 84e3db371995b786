// Functions of floating-point numbers on the device where they are hardest: subnormals, zeros of both signs, large angles,
// the ends of exponents. The other cases are those that `shale conform` runs (tests/golden/make_float_cases.cpp).
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "compiler/driver/compile.h"
#include "tests/compiler/graph_support.h"
#include "tests/support/float_cases.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Of float32; narrower types round them.
constexpr double kValues[] = {0.0,
                              -0.0,
                              0x1p-149,
                              -0x1p-149,
                              0x1.8p-130,
                              -0x1p-127,
                              0x1.fffffcp-127,
                              0x1p-126,
                              -0x1p-126,
                              0x1p-24,
                              -0x1p-24,
                              0x1.8p-20,
                              0x1p-14,
                              -0x1p-12,
                              1,
                              -1,
                              0.5,
                              -0.5,
                              1.5,
                              -1.5,
                              2.5,
                              0.75,
                              0x1.921fb6p-1,
                              0x1.921fb6p0,
                              0x1.921fb6p1,
                              -0x1.921fb6p2,
                              355,
                              103993,
                              1e5,
                              -1e6,
                              33554432,
                              1e22,
                              -0x1.8p100,
                              0x1.fffffep127,
                              0x1.6a09e6p0,
                              0x1.6a09e8p-1,
                              0.625,
                              -0.624,
                              0.99999994,
                              1.0000001,
                              3.9,
                              4.1,
                              -5,
                              9,
                              16,
                              17,
                              -87.3,
                              -87.4,
                              -103.9,
                              -104.1,
                              88.7,
                              88.8,
                              104,
                              kInfinity,
                              -kInfinity,
                              std::numeric_limits<double>::quiet_NaN()};

class FloatDevice : public testing::TestWithParam<std::tuple<const char*, const char*>> {};

TEST_P(FloatDevice, IsWithinTheBoundsAndKeepsTheSignOfZero) {
  const auto& [type, kernel] = GetParam();
  Graph graph;
  for (FloatCase& each : float_cases())
    if (each.name == std::string("functions_") + type) graph = std::move(each.graph);
  ASSERT_FALSE(graph.nodes.empty());
  Tensor input = Tensor::zeros(graph.value(graph.inputs[0]).type);
  ASSERT_GE(input.count(), static_cast<int64_t>(std::size(kValues)));
  for (int64_t i = 0; i < input.count(); ++i)
    input.set_real(i, kValues[static_cast<size_t>(i) % std::size(kValues)]);

  Result<ToolDevice> device = ToolDevice::open({.name = {}, .cache = {}, .validation = true});
  if (!device) device = ToolDevice::open({});
  if (!device) GTEST_SKIP() << error_text(device);
  CompileOptions options;
  options.kernels = {kernel};
  const Compiled compiled = must(compile_graph(graph, 0, options));
  const std::vector<Tensor> found = must(run_network(*device, compiled.package, {input}));

  // Subnormal operands may be taken as 0.
  const auto expected = output_precision(graph, {input});
  const auto flushed = output_precision(graph, {flush_subnormals(input)});
  for (size_t o = 0; o < found.size(); ++o)
    for (int64_t i = 0; i < found[o].count(); ++i) {
      const Precision& own = expected[o][static_cast<size_t>(i)];
      const double value = found[o].real(i);
      const DType dtype = found[o].type.dtype;
      EXPECT_TRUE(is_precise(dtype, value, own) ||
                  is_precise(dtype, value, flushed[o][static_cast<size_t>(i)]))
          << graph.value(graph.outputs[o]).name << "(" << input.real(i) << ") is " << value
          << ", expected " << own.value << " within " << own.error;
      if (input.real(i) == 0 && own.value == 0) {
        EXPECT_EQ(std::signbit(value), std::signbit(own.value))
            << graph.value(graph.outputs[o]).name << "(" << input.real(i) << ")";
      }
    }
  for (const std::string& message : device->take_validation_messages()) ADD_FAILURE() << message;
}

INSTANTIATE_TEST_SUITE_P(Functions, FloatDevice,
                         testing::Values(std::tuple{"f32", "generic"}, std::tuple{"f32", "runs"},
                                         std::tuple{"f16", "runs"}, std::tuple{"bf16", "generic"}),
                         [](const testing::TestParamInfo<FloatDevice::ParamType>& test) {
                           return std::string(std::get<0>(test.param)) + "_" +
                                  std::get<1>(test.param);
                         });

}  // namespace
}  // namespace shale
