// The bundled networks compiled for GPUs, run on whatever device is there and compared bit for bit
// with the interpreter.
#include <gtest/gtest.h>

#include "compiler/driver/compile.h"
#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tests/compiler/graph_support.h"
#include "tests/support/source_folder.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

struct Network {
  const char* name;
  Shape input;
  size_t convolutions;
};

void PrintTo(const Network& network, std::ostream* out) { *out << network.name; }

class GpuTarget : public testing::TestWithParam<Network> {};

TEST_P(GpuTarget, ComputesWhatTheInterpreterDoesInADispatchPerConvolution) {
  const Network& network = GetParam();
  const std::vector<uint8_t> bytes =
      must(read_file(source_folder() + "/models/" + network.name + "/model.tosa"));
  CompileOptions options;
  options.targets = {"dot8-gpu"};
  options.passes.input_shapes["input"] = network.input;
  const Compiled compiled = must(compile(bytes, options));
  EXPECT_EQ(compiled.warnings, std::vector<std::string>());
  // No resize, concat or table of its own, but where several convolutions read it.
  std::vector<std::string> others;
  size_t convolutions = 0;
  for (const Dispatch& dispatch : compiled.package.variants[0].segments[0].dispatches) {
    if (dispatch.kernel == "conv2d_s8_dot8")
      ++convolutions;
    else
      others.push_back(dispatch.kernel);
  }
  EXPECT_EQ(convolutions, network.convolutions);
  EXPECT_EQ(others, std::vector<std::string>()) << "what no convolution takes in";

  Result<ToolDevice> device = ToolDevice::open({.name = {}, .cache = {}, .validation = true});
  if (!device) device = ToolDevice::open({});
  if (!device) GTEST_SKIP() << error_text(device);
  for (const std::string& line :
       missing(device->context().caps, compiled.package.variants[0].requirements))
    GTEST_SKIP() << line;
  const std::vector<Tensor> inputs = random_inputs(compiled.graph, 1);
  const std::vector<Tensor> expected = must(interpret(compiled.graph, inputs));
  const std::vector<Tensor> found = must(run_network(*device, compiled.package, inputs));
  for (size_t i = 0; i < expected.size(); ++i)
    if (const auto difference = first_difference(found[i], expected[i]))
      ADD_FAILURE() << "output " << i << ": " << *difference;
  for (const std::string& message : device->take_validation_messages()) ADD_FAILURE() << message;
}

INSTANTIATE_TEST_SUITE_P(Networks, GpuTarget,
                         testing::Values(Network{"nss_v1_high", {1, 64, 64, 12}, 14},
                                         Network{"nss_v1_low", {1, 64, 64, 12}, 14},
                                         Network{"nss_v0_1", {1, 40, 48, 12}, 18},
                                         Network{"qrisp_s_x2", {1, 22, 36, 22}, 5},
                                         Network{"mnss_x2", {1, 21, 35, 3}, 4},
                                         Network{"srpo_x2", {1, 21, 35, 3}, 3},
                                         Network{"srpo_x3", {1, 21, 35, 3}, 3}),
                         [](const testing::TestParamInfo<Network>& test) {
                           return std::string(test.param.name);
                         });

}  // namespace
}  // namespace shale
