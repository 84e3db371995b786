// Which kernel a group gets: by name, without a device.
#include "compiler/kernels/select.h"

#include <gtest/gtest.h>

#include "compiler/cost/cost.h"
#include "compiler/passes/pass.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

/// The groups after the passes; `graph` has to outlive them.
std::vector<GroupProblem> problems_of(Graph& graph) {
  must(run_pipeline(graph, {}, {}));
  std::vector<GroupProblem> problems;
  for (Group& group : collect_groups(graph)) {
    GroupProblem problem{.graph = &graph, .group = std::move(group), .proof = {}, .cost = {}};
    problem.proof = prove_ranges(graph, problem.group);
    problem.cost = group_cost(graph, problem.group);
    problems.push_back(std::move(problem));
  }
  return problems;
}

/// The kernel of the group that holds the convolution, after the passes, for a frame's runs.
std::string selected(Graph graph, std::string_view target = "lavapipe",
                     std::vector<std::string> allowed = {}, double runs = kRunsOfFrame) {
  const std::vector<GroupProblem> problems = problems_of(graph);
  const Selection selection = must(select_kernels(
      problems, *find_profile(target), {.expected_runs = runs, .allowed = std::move(allowed)}));
  for (size_t i = 0; i < problems.size(); ++i)
    if (problems[i].group.head) return std::string(selection.families[i]->name);
  return "no head";
}

TEST(Select, TakesDoublesForProvenConvolutionsOnLavapipe) {
  for (ConvCase row : edge_conv_cases()) {
    // Pictures of a few pixels are not worth code of their own.
    if (row.stride_y > 8 || row.stride_x > 8) continue;
    row.h += 120 * row.stride_y;
    row.w += 120 * row.stride_x;
    // Among those with weights in the code.
    const std::string kernel =
        selected(row.graph(), "lavapipe",
                 {"conv2d_s8_winograd", "conv2d_s8_phase", "conv2d_s8_f64pair",
                  "conv2d_s8_f32exact", "conv2d_s8_i32"});
    if (row.name == "beyond_float") {
      EXPECT_EQ(kernel, "conv2d_s8_i32");
    } else if (row.name == "beyond_pair" || row.name == "beyond_winograd") {
      EXPECT_EQ(kernel, "conv2d_s8_f32exact");
    } else {
      EXPECT_TRUE(kernel == "conv2d_s8_f64pair" || kernel == "conv2d_s8_winograd" ||
                  kernel == "conv2d_s8_phase")
          << row.name << ": " << kernel;
    }
  }
}

TEST(Select, TakesWinogradWhereItsProductsOutweighItsTransforms) {
  const auto kernel_for = [](int64_t ic, int64_t oc, int64_t height, int64_t width,
                             Source source = Source::kPlain) {
    return selected(ConvCase{.name = "layer",
                             .h = height,
                             .w = width,
                             .ic = ic,
                             .oc = oc,
                             .input_zp = -128,
                             .source = source,
                             .weight_min = -30,
                             .weight_max = 30}
                        .graph());
  };
  EXPECT_EQ(kernel_for(32, 32, 272, 480), "conv2d_s8_winograd");
  EXPECT_EQ(kernel_for(48, 16, 272, 480), "conv2d_s8_winograd");
  EXPECT_EQ(kernel_for(16, 16, 272, 480), "conv2d_s8_winograd");
  EXPECT_EQ(kernel_for(64, 64, 68, 120), "conv2d_s8_f64pair");  // too much for one module
  EXPECT_EQ(kernel_for(32, 16, 272, 480, Source::kUpsample), "conv2d_s8_phase");
}

/// A 1x1 layer of a classifier: many weights on few pixels.
Graph classifier_layer(int64_t side, int64_t ic, int64_t oc) {
  return ConvCase{.name = "layer",
                  .h = side,
                  .w = side,
                  .ic = ic,
                  .oc = oc,
                  .kh = 1,
                  .kw = 1,
                  .pad = {0, 0, 0, 0},
                  .weight_min = -30,
                  .weight_max = 30}
      .graph();
}

TEST(Select, SpreadsTheDriversTimeOverTheExpectedRuns) {
  const auto kernel_for = [](int64_t side, int64_t ic, int64_t oc, double runs) {
    return selected(classifier_layer(side, ic, oc), "lavapipe", {}, runs);
  };
  // 150,000 weights on 49 pixels are never worth code of their own.
  for (const double runs : {kRunsOfOne, kRunsOfNetwork, kRunsOfFrame})
    EXPECT_EQ(kernel_for(7, 960, 160, runs), "conv2d_s8_loop") << runs;
  // 1,024 weights on 14,400 pixels are for a thousand runs, and not for one.
  EXPECT_EQ(kernel_for(120, 32, 32, kRunsOfOne), "conv2d_s8_loop");
  EXPECT_EQ(kernel_for(120, 32, 32, kRunsOfNetwork), "conv2d_s8_f64pair");
  EXPECT_EQ(kernel_for(120, 32, 32, kRunsOfFrame), "conv2d_s8_f64pair");
}

TEST(Select, BoundsTheCodeOfTheWholeNetwork) {
  // Layers on ever smaller pictures, each of which alone is worth its code.
  std::vector<Graph> graphs;
  for (const int64_t side : {256, 128, 64}) graphs.push_back(classifier_layer(side, 128, 128));
  std::vector<GroupProblem> problems;
  for (Graph& graph : graphs)
    for (GroupProblem& problem : problems_of(graph)) problems.push_back(std::move(problem));
  ASSERT_EQ(problems.size(), 3u);
  DeviceProfile profile = *find_profile("lavapipe");
  const auto names = [&](int64_t most_products) {
    profile.most_products = most_products;
    const Selection selection =
        must(select_kernels(problems, profile, {.expected_runs = kRunsOfFrame}));
    EXPECT_LE(selection.products, std::max<int64_t>(most_products, 0));
    std::vector<std::string> taken;
    for (const KernelFamily* family : selection.families) taken.emplace_back(family->name);
    return taken;
  };
  const std::string code = "conv2d_s8_f64pair", loop = "conv2d_s8_loop";
  EXPECT_EQ(names(1 << 18), (std::vector<std::string>{code, code, code}));
  // The code goes first that gains least for a product: that of the smallest picture.
  EXPECT_EQ(names(2 * 128 * 128), (std::vector<std::string>{code, code, loop}));
  EXPECT_EQ(names(128 * 128), (std::vector<std::string>{code, loop, loop}));
  EXPECT_EQ(names(0), (std::vector<std::string>{loop, loop, loop}));
}

TEST(Select, SaysWhatTheDriverWillTake) {
  Graph graph = classifier_layer(120, 32, 32);
  const std::vector<GroupProblem> problems = problems_of(graph);
  const DeviceProfile& profile = *find_profile("lavapipe");
  const Selection code = must(select_kernels(problems, profile, {.expected_runs = kRunsOfFrame})),
                  loop = must(select_kernels(problems, profile, {.expected_runs = kRunsOfOne}));
  EXPECT_GT(code.products, 900);
  EXPECT_LE(code.products, 1024);
  EXPECT_GE(code.driver_us, profile.driver_us_per_product * static_cast<double>(code.products));
  EXPECT_EQ(loop.products, 0);
  EXPECT_EQ(loop.driver_us, profile.driver_us_per_module);
  EXPECT_LT(code.run_us, loop.run_us);
}

TEST(Select, ObeysChoicesAndPreferences) {
  Graph graph = classifier_layer(8, 16, 16);
  const std::vector<GroupProblem> problems = problems_of(graph);
  const DeviceProfile& profile = *find_profile("lavapipe");
  const std::string name = graph.value(problems[0].group.result).name;
  const auto kernel = [&](SelectOptions options) {
    return must(select_kernels(problems, profile, options)).families[0]->name;
  };
  EXPECT_EQ(kernel({.prefer = "conv2d_s8_i32"}), "conv2d_s8_i32");
  EXPECT_EQ(kernel({.prefer = "conv2d_s8_i32", .choices = {{name, "generic"}}}), "generic");
  EXPECT_NE(kernel({.prefer = "conv2d_s8_phase"}), "conv2d_s8_phase");  // it cannot
  // A choice that the profile cannot follow is told, and left to selection.
  const Selection refused =
      must(select_kernels(problems, profile, {.choices = {{name, "conv2d_s8_phase"}}}));
  EXPECT_NE(refused.refused.at(name).find("conv2d_s8_phase"), std::string::npos);
  EXPECT_EQ(refused.families[0]->name, kernel({}));
  EXPECT_FALSE(select_kernels(problems, profile, {.choices = {{name, "nonsense"}}}));
}

TEST(Select, KeepsWeightsInBuffersOnGpus) {
  for (const ConvCase& row : edge_conv_cases())
    EXPECT_EQ(selected(row.graph(), "generic-gpu"), "generic") << row.name;
}

TEST(Select, TakesDotProductsWhereAGpuHasThem) {
  for (const ConvCase& row : edge_conv_cases())
    EXPECT_EQ(selected(row.graph(), "dot8-gpu"), "conv2d_s8_dot8") << row.name;
}

TEST(Select, TakesMatricesFromSixteenChannelsOnWhereAGpuHasThem) {
  const auto kernel = [](const ConvCase& row) {
    return selected(row.graph(), "coopmat-gpu", {"conv2d_s8_coopmat"});
  };
  for (ConvCase row : edge_conv_cases()) {
    EXPECT_EQ(kernel(row), row.oc >= 16 ? "conv2d_s8_coopmat" : "generic") << row.name;
    // Weights of full range leave int8 without their zero point.
    row.oc = 16;
    EXPECT_EQ(kernel(row), row.weight_zp == 0 ? "conv2d_s8_coopmat" : "generic") << row.name;
  }
  EXPECT_EQ(kernel({.name = "small_zp", .oc = 16, .weight_zp = 7, .weight_min = -121}),
            "conv2d_s8_coopmat");
}

TEST(Select, PrefersMatricesWhereTheyAreFull) {
  const auto kernel = [](int64_t ic, int64_t oc) {
    return selected(ConvCase{.name = "", .h = 64, .w = 64, .ic = ic, .oc = oc}.graph(),
                    "coopmat-gpu");
  };
  EXPECT_EQ(kernel(32, 16), "conv2d_s8_coopmat");
  EXPECT_EQ(kernel(12, 32), "conv2d_s8_coopmat");
  EXPECT_EQ(kernel(32, 15), "conv2d_s8_dot8");
  EXPECT_EQ(kernel(4, 17), "conv2d_s8_dot8");  // 36 bytes in chunks of 32, 17 channels of 32
}

TEST(Select, ObeysTheListOfAllowedFamilies) {
  const Graph graph = ConvCase{.name = "plain", .w = 64}.graph();
  EXPECT_EQ(selected(graph, "lavapipe", {"conv2d_s8_i32"}), "conv2d_s8_i32");
  EXPECT_EQ(selected(graph, "lavapipe", {"generic"}), "generic");
  EXPECT_EQ(selected(graph, "lavapipe", {"conv2d_s8_i32", "conv2d_s8_f32exact"}),
            "conv2d_s8_f32exact");
  EXPECT_EQ(selected(graph, "lavapipe", {"conv2d_s8_f32exact", "conv2d_s8_f64pair"}),
            "conv2d_s8_f64pair");
  // The generic kernel serves where no allowed family can.
  EXPECT_EQ(selected(graph, "generic-gpu", {"conv2d_s8_i32"}), "generic");
}

TEST(Select, TakesLiteralsForDepthwiseConvolutions) {
  const std::string kernel = selected(
      ConvCase{.name = "", .h = 120, .w = 120, .ic = 32, .oc = 32, .multiplier = 1}.graph());
  EXPECT_EQ(kernel, "conv2d_s8_f64pair");
}

TEST(Select, LeavesOtherHeadsToRuns) {
  const char* const rows[] = {
      "const %w : i8[1,1,1,2] = [1,2]\n const %b : i32[1] = [0]\n"
      "%y = transpose_conv2d %x, %w, %b, %zp, %zp {out_pad=[0,0,0,0], stride=[1,1], acc_type=i32} "
      ": i32[1,4,4,1]",
      "%y = max_pool2d %x {kernel=[2,2], stride=[1,1], pad=[0,0,0,0]} : i8[1,3,3,2]",
      "%y = reduce_max %x {axis=1} : i8[1,1,4,2]",
  };
  for (const char* row : rows)
    EXPECT_EQ(selected(graph_of(
                  std::string("graph main {\n input %x : i8[1,4,4,2]\n const %zp : i8[1] = [0]\n") +
                  row + "\n return %y\n}")),
              "runs")
        << row;
}

TEST(Select, LeavesConvolutionsWithoutConstantWeightsToRuns) {
  const char* const rows[] = {
      "input %x : i8[1,4,4,2]\n input %w : i8[1,1,1,2]\n const %b : i32[1] = [0]\n const %wzp : "
      "i8[1] = [0]",
      "input %x : i8[1,4,4,2]\n const %w : i8[1,1,1,2] = [1,2]\n input %b : i32[1]\n const %wzp : "
      "i8[1] = [0]",
      "input %x : i8[1,4,4,2]\n const %w : i4[1,1,1,2] = [1,2]\n const %b : i32[1] = [0]\n const "
      "%wzp : i4[1] = [0]",
  };
  for (const char* row : rows)
    EXPECT_EQ(selected(graph_of(std::string("graph main {\n const %zp : i8[1] = [0]\n ") + row +
                                "\n %y = conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,0,0], "
                                "stride=[1,1], dilation=[1,1], acc_type=i32}"
                                " : i32[1,4,4,1]\n return %y\n}")),
              "runs")
        << row;
}

TEST(Select, LeavesOtherPadsToRuns) {
  // A pad of the channels has no place in four-channel fetches.
  EXPECT_EQ(selected(graph_of(R"(graph main {
  input %x : i8[1,4,4,2]
  const %zp : i8[1] = [0]
  const %w : i8[1,1,1,4] = [1,2,3,4]
  const %b : i32[1] = [0]
  const %p : shape[8] = [0,0,0,0,0,0,1,1]
  %v = pad %x, %p, %zp : i8[1,4,4,4]
  %y = conv2d %v, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,4,4,1]
  return %y
})")),
            "runs");
}

/// A 1x1 convolution of [n,h,w,1]; nothing of that size is allocated.
std::string kernel_for_shape(int64_t n, int64_t h, int64_t w, int64_t oc,
                             std::string_view target = "lavapipe",
                             const std::vector<std::string>& allowed = {}) {
  return selected(
      graph_of(fmt::format(
          R"(graph main {{
  input %x : i8[{0},{1},{2},1]
  const %zp : i8[1] = [0]
  const %w : i8[{3},1,1,1] = [{4}1]
  const %b : i32[1] = [0]
  %y = conv2d %x, %w, %b, %zp, %zp {{pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32}} : i32[{0},{1},{2},{3}]
  return %y
}})",
          n, h, w, oc, replaced(std::string(static_cast<size_t>(oc - 1), '1'), "1", "1,"))),
      target, allowed);
}

TEST(Select, KeepsGridsAndTexelBuffersWithinTheirLimits) {
  EXPECT_EQ(kernel_for_shape(1, 65535, 4, 16), "conv2d_s8_f32exact");
  EXPECT_EQ(kernel_for_shape(1, 65536, 4, 16), "runs");  // rows are workgroups
  EXPECT_EQ(kernel_for_shape(65536, 1, 4, 16), "runs");
  // With 16 channels an invocation has two pixels side by side.
  EXPECT_EQ(kernel_for_shape(1, 1, 65535 * 128, 16), "conv2d_s8_f64pair");
  EXPECT_EQ(kernel_for_shape(1, 1, 65535 * 128 + 1, 16), "runs");
  const std::vector<std::string> pairs{"conv2d_s8_f64pair"};
  EXPECT_EQ(kernel_for_shape(1, 8192, 16384, 1, "lavapipe", pairs), pairs[0]);  // 2^27 texels
  EXPECT_EQ(kernel_for_shape(1, 8192, 16385, 1, "lavapipe", pairs), "generic");
}

TEST(Select, KeepsGridsOfDotProductsWithinTheirLimits) {
  const auto kernel = [](int64_t n, int64_t h, int64_t w, int64_t oc) {
    return kernel_for_shape(n, h, w, oc, "dot8-gpu");
  };
  // A workgroup has 8 rows of 8 tiles: four pixels by 8 channels, or eight pixels by 4.
  EXPECT_EQ(kernel(1, 65535 * 8, 4, 16), "conv2d_s8_dot8");
  EXPECT_EQ(kernel(1, 65535 * 8 + 1, 4, 16), "generic");
  EXPECT_EQ(kernel(1, 1, 65535 * 64, 4), "conv2d_s8_dot8");
  EXPECT_EQ(kernel(1, 1, 65535 * 64 + 1, 4), "generic");
  EXPECT_EQ(kernel(65535, 1, 1, 8), "conv2d_s8_dot8");
  EXPECT_EQ(kernel(65535, 1, 1, 13), "generic");  // two blocks of channels an image
}

}  // namespace
}  // namespace shale
