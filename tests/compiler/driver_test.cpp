#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "compiler/driver/compile.h"
#include "compiler/spirv/check.h"
#include "compiler/spirv/forward.h"
#include "ir/base/hash.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

CompileOptions fast_options() {
  CompileOptions options;
  options.optimize_spirv = false;
  return options;
}

Result<Compiled> compile_text(const std::string& text,
                              const CompileOptions& options = fast_options()) {
  return compile({reinterpret_cast<const uint8_t*>(text.data()), text.size()}, options);
}

const std::vector<Dispatch>& graph_dispatches(const Compiled& compiled, size_t variant = 0) {
  for (const Segment& segment : compiled.package.variants[variant].segments)
    if (segment.kind == SegmentKind::kGraph) return segment.dispatches;
  static const std::vector<Dispatch> none;
  return none;
}

/// "name:category" of every input and output.
std::vector<std::string> interface_of(const Variant& variant) {
  std::vector<std::string> names;
  for (const Resource& resource : variant.resources)
    if (resource.category == Category::kInput || resource.category == Category::kOutput)
      names.push_back(resource.name + (resource.category == Category::kInput ? ":in" : ":out"));
  return names;
}

constexpr const char* kSmall = R"(graph main {
  input %x : i32[2,3]
  const %c : i32[2,3] = [1,2,3,4,5,6]
  %sum = add %x, %c : i32[2,3]
  %top = reduce_max %sum {axis=0} : i32[1,3]
  return %top
})";

TEST(Driver, GivesTheSameBytesTwice) {
  CompileOptions options;
  options.targets = {"lavapipe", "generic-gpu", "dot8-gpu", "coopmat-gpu"};
  for (const ConvCase& row : edge_conv_cases()) {
    if (row.name != "table_oc17" && row.name != "pad_of_concat_of_resize" &&
        row.name != "residual_oc5")
      continue;
    for (const bool optimize : {true, false}) {
      options.pass_options.optimize = optimize;
      const Compiled first = must(compile_graph(row.graph(), 1, options)),
                     second = must(compile_graph(row.graph(), 1, options));
      EXPECT_EQ(write_package(first.package), write_package(second.package)) << row.name;
    }
  }
}

TEST(Driver, WritesPackagesThatReadBackEqual) {
  CompileOptions options = fast_options();
  options.targets = {"lavapipe", "generic-gpu", "dot8-gpu", "coopmat-gpu"};
  for (const ConvCase& row : edge_conv_cases()) {
    if (row.name == "several_modules" || row.name == "beyond_float")
      continue;  // large, and no different here
    const Compiled compiled = must(compile_graph(row.graph(), 7, options), row.name);
    EXPECT_TRUE(check_package(compiled.package)) << error_text(check_package(compiled.package));
    EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package)
        << row.name;
  }
}

TEST(Driver, RecordsWhereAPackageComesFrom) {
  CompileOptions options = fast_options();
  options.model_name = "small";
  options.kernels = {"generic"};
  const Compiled compiled = must(compile_text(kSmall, options));
  const std::string text = kSmall;
  EXPECT_EQ(compiled.package.provenance.model_hash,
            stable_hash({reinterpret_cast<const uint8_t*>(text.data()), text.size()}));
  EXPECT_EQ(compiled.package.provenance.model_name, "small");
  EXPECT_EQ(compiled.package.provenance.options,
            "targets=[lavapipe] optimize=true kernels=[generic] spirv_opt=false");
}

TEST(Driver, RefusesWhatItDoesNotKnow) {
  CompileOptions options = fast_options();
  options.targets = {"lavapipe", "abacus"};
  EXPECT_EQ(error_text(compile_text(kSmall, options)),
            "--target: \"abacus\" is unknown, expected one of: lavapipe, lavapipe-avx2, "
            "lavapipe-sse, lavapipe-neon, generic-gpu, "
            "dot8-gpu, coopmat-gpu");
  options = fast_options();
  options.kernels = {"generic", "conv2d_s8_abacus"};
  EXPECT_EQ(error_text(compile_text(kSmall, options)),
            "--kernels: \"conv2d_s8_abacus\" is no kernel family");
  EXPECT_NE(error_text(compile_text("a picture of a graph")).find("is no model"),
            std::string::npos);
  EXPECT_NE(error_text(compile_text("graph main {")).find("line 1"), std::string::npos);
}

TEST(Driver, StopsWhenAsked) {
  CompileOptions options = fast_options();
  options.pass_options.optimize = false;
  // Work runs on several threads; it is reported as it gets done, and the end always.
  size_t last = 0;
  options.progress = [&](size_t done, size_t total) {
    EXPECT_GE(done, last);
    last = done;
    EXPECT_EQ(total, 2u);
    return true;
  };
  ASSERT_TRUE(compile_text(kSmall, options));
  EXPECT_EQ(last, 2u);
  size_t calls = 0;
  options.progress = [&](size_t, size_t) { return ++calls < 1; };
  EXPECT_EQ(error_text(compile_text(kSmall, options)), "interrupted");
  EXPECT_EQ(calls, 1u);
}

TEST(Driver, CopiesConstantsInputsAndRepeatsThatAreOutputs) {
  const Compiled compiled = must(compile_text(R"(graph main {
  input %x : i8[2]
  const %c : i8[3] = [1,2,3]
  %y = bitwise_not %x : i8[2]
  return %x, %c, %y, %y, %c
})"));
  EXPECT_EQ(
      interface_of(compiled.package.variants[0]),
      (std::vector<std::string>{"x:in", "x.1:out", "c.1:out", "y:out", "y.1:out", "c.2:out"}));
  EXPECT_EQ(graph_dispatches(compiled).size(), 5u);
  EXPECT_TRUE(check_package(compiled.package)) << error_text(check_package(compiled.package));
}

TEST(Driver, KeepsInputsThatNothingReads) {
  const Compiled compiled =
      must(compile_text("graph main {\n input %x : i8[2]\n input %unused : i48[5]\n %y = "
                        "bitwise_not %x : i8[2]\n return %y\n}"));
  EXPECT_EQ(interface_of(compiled.package.variants[0]),
            (std::vector<std::string>{"x:in", "unused:in", "y:out"}));
}

TEST(Driver, MakesAVariantForEachTarget) {
  CompileOptions options = fast_options();
  options.targets = {"generic-gpu", "lavapipe"};
  options.expected_runs = 1e9;  // weights in the code are worth any compile time
  const Graph graph = ConvCase{.name = "plain", .h = 64, .w = 64}.graph();
  const Compiled both = must(compile_graph(graph, 0, options));
  ASSERT_EQ(both.package.variants.size(), 2u);
  EXPECT_EQ(both.package.variants[0].target, "generic-gpu");
  EXPECT_EQ(both.package.variants[1].target, "lavapipe");
  EXPECT_EQ(graph_dispatches(both, 0)[0].kernel, "generic");
  // Which of them is select_test's business.
  EXPECT_TRUE(graph_dispatches(both, 1)[0].kernel.starts_with("conv2d_s8_"));
  options.targets = {"generic-gpu"};
  const Compiled one = must(compile_graph(graph, 0, options));
  EXPECT_TRUE(one.package.variants[0] == both.package.variants[0]);
  // The second variant adds no weights: its own are in the code or lie there already.
  EXPECT_EQ(one.package.weights, both.package.weights);
}

TEST(Driver, OptimizesWhatDriversOfGpusGet) {
  CompileOptions options = fast_options();
  options.kernels = {"generic"};
  options.targets = {"lavapipe", "generic-gpu"};
  const Compiled plain = must(compile_text(kSmall, options));
  options.optimize_spirv = true;
  const Compiled optimized = must(compile_text(kSmall, options));
  for (size_t i = 0; i < plain.package.variants.size(); ++i) {
    const std::vector<Spirv>&from = plain.package.variants[i].modules,
          &to = optimized.package.variants[i].modules;
    ASSERT_EQ(from.size(), to.size());
    for (size_t m = 0; m < from.size(); ++m) {
      EXPECT_NE(from[m], to[m]);
      EXPECT_EQ(to[m], i == 0 ? forward_locals(from[m]) : must(optimize_spirv(from[m], "module")));
    }
  }
}

TEST(Driver, PacksWeightsForTheKernelsThatWantThem) {
  CompileOptions options = fast_options();
  options.targets = {"dot8-gpu"};
  Graph graph = graph_of(R"(graph main {
  input %x : i8[1,1,1,1]
  const %zp : i8[1] = [3]
  const %w : i8[2,1,1,1] = [5,-7]
  const %b : i32[2] = [100,200]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,1,1,2]
  return %y
})");
  // A value has the name that the packed weights would have.
  graph.values[graph.inputs[0].index].name = "y#packed";
  options.pass_options.optimize = false;
  const Compiled compiled = must(compile_graph(std::move(graph), 0, options));
  const Variant& variant = compiled.package.variants[0];
  const Dispatch& dispatch = graph_dispatches(compiled)[0];
  EXPECT_EQ(dispatch.kernel, "conv2d_s8_dot8");
  const Resource& packed = variant.resources[dispatch.bindings[0].resource];
  EXPECT_EQ(packed.name, "y#packed#");
  EXPECT_EQ(packed.category, Category::kWeights);
  // A word of four input channels for each of four output channels, then the bias less
  // 3 * (w - 3); what is not there is 0. The weights as they came are not in the package.
  std::vector<uint8_t> expected(32);
  expected[0] = 5;
  expected[4] = static_cast<uint8_t>(-7);
  expected[16] = 100 - 3 * (5 - 3);
  expected[20] = 200 - 3 * (-7 - 3);
  EXPECT_EQ(compiled.package.weights, expected);
}

TEST(Driver, SharesModulesOfEqualContent) {
  // Four nodes of one shape: two sources in all. Names of values do not reach the words.
  CompileOptions options = fast_options();
  options.pass_options.optimize = false;
  const Compiled compiled = must(compile_text(R"(graph main {
  input %x : i32[5]
  %a = abs %x : i32[5]
  %b = clz %a : i32[5]
  %c = abs %b : i32[5]
  %d = clz %c : i32[5]
  return %d
})",
                                              options));
  const std::vector<Dispatch>& dispatches = graph_dispatches(compiled);
  ASSERT_EQ(dispatches.size(), 4u);
  EXPECT_EQ(compiled.package.variants[0].modules.size(), 2u);
  EXPECT_EQ(dispatches[0].module, dispatches[2].module);
  EXPECT_EQ(dispatches[1].module, dispatches[3].module);
  EXPECT_NE(dispatches[0].module, dispatches[1].module);
}

TEST(Driver, StoresEqualWeightsOnce) {
  CompileOptions options = fast_options();
  options.pass_options.optimize = false;
  options.kernels = {"generic"};
  const Compiled compiled = must(compile_text(R"(graph main {
  input %x : i32[3]
  const %a : i32[3] = [1,2,3]
  const %b : i32[3] = [1,2,3]
  %c = add %x, %a : i32[3]
  %d = sub %c, %b : i32[3]
  return %d
})",
                                              options));
  EXPECT_EQ(compiled.package.weights.size(), 12u);
}

TEST(Driver, ReusesTheArena) {
  CompileOptions options = fast_options();
  options.pass_options.optimize = false;
  std::string text = "graph main {\n  input %v0 : i32[100]\n";
  for (int i = 1; i <= 6; ++i)
    text += fmt::format("  %v{} = {} %v{} : i32[100]\n", i, i % 2 == 0 ? "abs" : "clz", i - 1);
  const Compiled compiled = must(compile_text(text + "  return %v6\n}", options));
  EXPECT_EQ(compiled.package.variants[0].arena_bytes, 1024u);  // two of five at a time
  EXPECT_EQ(compiled.arena_lower_bound_bytes, 1024u);
}

TEST(Driver, RefusesNamesThatNoPackageMayHave) {
  EXPECT_NE(error_text(compile_text("graph main {\n input %\"a\\x0ab\" : i8[2]\n %y = bitwise_not "
                                    "%\"a\\x0ab\" : i8[2]\n return %y\n}"))
                .find("control characters"),
            std::string::npos);
}

TEST(Driver, KeepsNamesOfPartsApartFromNamesOfValues) {
  // A convolution in four modules is called y, y#1, y#2 and y#3.
  for (const ConvCase& row : edge_conv_cases()) {
    if (row.name != "several_modules") continue;
    Graph graph = row.graph();
    const ValueId x = graph.inputs[0];
    graph.outputs.push_back(
        graph.add_node(Op::kBitwiseNot, {}, {x}, "clamped#1", graph.value(x).type));
    CompileOptions options = fast_options();
    options.kernels = {"conv2d_s8_i32"};
    const Compiled compiled = must(compile_graph(graph, 0, options));
    ASSERT_EQ(graph_dispatches(compiled).size(), 5u);
    EXPECT_TRUE(check_package(compiled.package)) << error_text(check_package(compiled.package));
  }
}

TEST(Driver, AppliesInputShapes) {
  CompileOptions options = fast_options();
  options.passes.input_shapes = {{"x", {1, 6, 8, 3}}};
  const Compiled compiled = must(compile_text(
      "graph main {\n input %x : i8[1,?,?,3]\n %y = bitwise_not %x : i8[1,?,?,3]\n return %y\n}",
      options));
  EXPECT_EQ(compiled.package.variants[0].resources[1].shape, (Shape{1, 6, 8, 3}));
  EXPECT_EQ(compiled.package.provenance.options,
            "targets=[lavapipe] optimize=true kernels=[] spirv_opt=false x=[1,6,8,3]");
}

TEST(Driver, NamesAllThatShapesAPackage) {
  // Two packages that differ have different provenances.
  std::set<std::string> seen;
  const auto add = [&](const CompileOptions& options) {
    const Compiled compiled = must(compile_text(kSmall, options));
    EXPECT_TRUE(seen.insert(compiled.package.provenance.options).second)
        << compiled.package.provenance.options;
  };
  CompileOptions options = fast_options();
  add(options);
  options.targets = {"generic-gpu"};
  add(options);
  options.targets = {"generic-gpu", "lavapipe"};
  add(options);
  options.prefer = "generic";
  add(options);
  options.choices = {{"sum", "generic"}};
  add(options);
  options.constants["lavapipe"].ns[Work::kByte] = 0.25;
  add(options);
  options.constants["lavapipe"].ns[Work::kByte] = 0.5;
  add(options);
}

}  // namespace
}  // namespace shale
