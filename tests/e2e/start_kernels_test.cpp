// Kernels of the start, as the compiler gives them to a network, against the interpreter: alone, while the fast ones replace
// them, and behind that. Every family with weights in its code, with every family that can stand in.
#include <gtest/gtest.h>

#include <algorithm>

#include "compiler/driver/compile.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"
#include "tests/support/tool_device_test.h"

namespace shale {
namespace {

using StartKernels = ToolDeviceTest<testing::Test>;

/// Every convolution has a start form where there is a family for one.
CompileOptions options_for(std::string_view kernel, std::string_view start, bool is_narrow) {
  CompileOptions options;
  options.targets = {is_narrow ? "lavapipe-avx2" : "lavapipe"};
  options.prefer = kernel;
  options.kernels = {std::string(start)};
  options.start_us = 0;
  return options;
}

/// True if the case has a start form: then both kernels gave what the interpreter gives.
class Pairs : public StartKernels {
 protected:
  static bool holds(const ConvCase& row, const std::string& kernel, const std::string& start) {
    const Graph graph = row.graph();
    const bool is_narrow = kernel == "conv2d_s8_f32exact" || kernel.ends_with("32");
    const Compiled compiled = must(compile_graph(graph, 0, options_for(kernel, start, is_narrow)));
    const Segment& segment = compiled.package.variants[0].segments[0];
    const auto is_pair = [&](const StartForm& form) {
      return segment.dispatches[form.dispatch].kernel == kernel && form.form.kernel == start;
    };
    if (std::none_of(segment.start_forms.begin(), segment.start_forms.end(), is_pair)) return false;
    const std::vector<Tensor> inputs = random_inputs(graph, 1),
                              expected = must(interpret(graph, inputs));
    // What the runtime gets is what a file holds.
    const Package package = must(read_package(write_package(compiled.package)));
    NetworkRun network =
        must(NetworkRun::create(*device_, package, inputs, nullptr, Compile::kByHost));
    for (const char* when : {"at the start", "in the end"}) {
      EXPECT_TRUE(network.run());
      const std::vector<Tensor> found = network.outputs();
      for (size_t i = 0; i < expected.size(); ++i)
        EXPECT_EQ(first_difference(found[i], expected[i]), std::nullopt)
            << row.name << " by " << kernel << " and " << start << " " << when;
      EXPECT_TRUE(network.finish());
    }
    return true;
  }
};

TEST_F(Pairs, GiveTheSameBits) {
  constexpr size_t kCasesOfAPair = 3;
  size_t turn = 0;
  for (const KernelFamily& family : all_kernels()) {
    if (!family.literals) continue;
    const bool is_int16 = family.name == "conv2d_s16_f64";
    const std::vector<ConvCase> cases = edge_cases_of(is_int16 ? DType::kInt16 : DType::kInt8);
    for (const char* start : {"conv2d_s8_loop", "runs", "generic"}) {
      if (is_int16 && std::string_view(start) == "conv2d_s8_loop") continue;
      size_t found = 0;
      ++turn;  // other cases for each pair
      for (size_t i = 0; i < cases.size() && found < kCasesOfAPair; ++i)
        found += holds(cases[(i + 7 * turn) % cases.size()], std::string(family.name), start);
      EXPECT_GT(found, 0u) << family.name << " by " << start;
    }
  }
}

TEST_F(StartKernels, AreThereWhereTheDriverTakesLong) {
  ConvCase row{.name = "heavy", .h = 24, .w = 24, .ic = 32, .oc = 32};
  row.weight_min = -20, row.weight_max = 20;  // proven for floats
  CompileOptions options;
  options.expected_runs = kRunsOfFrame;
  const auto forms = [&](const CompileOptions& own) {
    const Compiled compiled = must(compile_graph(row.graph(), 0, own));
    return compiled.package.variants[0].segments[0].start_forms;
  };
  ASSERT_EQ(forms(options).size(), 1u);
  EXPECT_EQ(forms(options)[0].form.kernel, "conv2d_s8_loop");
  options.start_us = 1e9;
  EXPECT_TRUE(forms(options).empty());
  options.start_us = 0;
  options.tiles = 0;  // cells of one kernel are not those of another
  EXPECT_TRUE(forms(options).empty());
  options.tiles.reset();
  options.expected_runs = kRunsOfOne;  // whose kernels are those of the start
  EXPECT_TRUE(forms(options).empty());
}

}  // namespace
}  // namespace shale
