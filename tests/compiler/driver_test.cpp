#include <gtest/gtest.h>

#include <algorithm>

#include "compiler/driver/compile.h"
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
  EXPECT_EQ(compiled.package.provenance.options, "optimize=true kernels=[generic] spirv_opt=false");
}

TEST(Driver, RefusesWhatItDoesNotKnow) {
  CompileOptions options = fast_options();
  options.targets = {"lavapipe", "abacus"};
  EXPECT_EQ(error_text(compile_text(kSmall, options)),
            "--target: \"abacus\" is unknown, expected one of: lavapipe, generic-gpu, "
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
  const Compiled both = must(compile_graph(ConvCase{.name = "plain"}.graph(), 0, options));
  ASSERT_EQ(both.package.variants.size(), 2u);
  EXPECT_EQ(both.package.variants[0].target, "generic-gpu");
  EXPECT_EQ(both.package.variants[1].target, "lavapipe");
  EXPECT_EQ(graph_dispatches(both, 0)[0].kernel, "generic");
  // Which of them is select_test's business.
  EXPECT_TRUE(graph_dispatches(both, 1)[0].kernel.starts_with("conv2d_s8_"));
  options.targets = {"generic-gpu"};
  const Compiled one = must(compile_graph(ConvCase{.name = "plain"}.graph(), 0, options));
  EXPECT_TRUE(one.package.variants[0] == both.package.variants[0]);
  // The second variant adds no weights: its own are in the code or lie there already.
  EXPECT_EQ(one.package.weights, both.package.weights);
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
            "optimize=true kernels=[] spirv_opt=false x=[1,6,8,3]");
}

// frame.json

constexpr const char* kFrame = R"({
  "schema": "shale-frame/1",
  "render": [10, 6],
  "output": [20, 12],
  "ratio": [1.5, 3],
  "params": [
    {"name": "near", "type": "float", "default": [0.5]},
    {"name": "jitter", "type": "vec2"},
    {"name": "fresh", "type": "int", "reset": true}
  ],
  "images": [
    {"name": "color", "role": "input", "format": "rgba8_unorm", "size": "render"},
    {"name": "shown", "role": "output", "format": "rgba8_unorm", "size": "output"},
    {"name": "kept", "role": "history", "format": "rgba16_float", "size": {"of": "render", "divide": 4, "multiple": 8}, "depth": 3}
  ],
  "tensors": [{"name": "x", "scale": 0.5, "zero_point": -3, "size": "render"}],
  "views": [{"title": "input", "of": "x", "first": 1, "channels": 3}],
  "passes": [
    {"name": "pre", "shader": "pre.comp", "over": "color", "workgroup": [8, 4], "defines": {"SIDE": 2, "LEAST": 0.25}, "bindings": [
      {"binding": 0, "image": "color", "access": "read"},
      {"binding": 1, "image": "kept", "access": "read", "frames_back": 2},
      {"binding": 2, "tensor": "x", "access": "write"}]},
    {"graph": "main"},
    {"name": "post", "shader": "post.comp", "over": "shown", "bindings": [
      {"binding": 0, "tensor": "y", "access": "read"},
      {"binding": 1, "image": "shown", "access": "write"},
      {"binding": 2, "image": "kept", "access": "write"}]}
  ]
})";

TEST(FrameJson, ReadsEveryField) {
  const Frame frame = must(parse_frame(kFrame));
  ASSERT_EQ(frame.images.size(), 3u);
  EXPECT_EQ(frame.images[0].name, "color");
  EXPECT_EQ(frame.images[0].category, Category::kImageInput);
  EXPECT_EQ(frame.images[0].format, ImageFormat::kRgba8Unorm);
  EXPECT_EQ(frame.images[1].category, Category::kImageOutput);
  EXPECT_TRUE(frame.images[1].size.of_output);
  EXPECT_EQ(frame.images[2].size({10, 6}, {20, 12}), (FrameExtent{8, 8}));
  EXPECT_EQ(frame.images[2].size({33, 32}, {66, 64}), (FrameExtent{16, 8}));
  EXPECT_EQ(frame.images[2].category, Category::kImageHistory);
  EXPECT_EQ(frame.images[2].history_depth, 3u);
  ASSERT_EQ(frame.tensors.size(), 1u);
  EXPECT_EQ(frame.tensors[0].quantization, (Quantization{0.5f, -3}));
  ASSERT_TRUE(frame.tensors[0].size);
  EXPECT_EQ(frame.render, (FrameExtent{10, 6}));
  EXPECT_EQ(frame.max_ratio, 3.0);
  ASSERT_EQ(frame.params.size(), 3u);
  EXPECT_EQ(frame.params[0].default_values, std::vector<float>{0.5f});
  EXPECT_EQ(frame.params[1].offset_bytes, 8u);
  EXPECT_EQ(frame.params[2].offset_bytes, 16u);
  EXPECT_EQ(frame.params[2].source, ParamSource::kReset);
  ASSERT_EQ(frame.views.size(), 1u);
  EXPECT_EQ(frame.views[0].view.first_channel, 1u);
  ASSERT_EQ(frame.passes[0].defines.size(), 2u);
  ASSERT_EQ(frame.passes.size(), 3u);
  EXPECT_EQ(frame.passes[0].workgroup[0], 8u);
  EXPECT_EQ(frame.passes[0].workgroup[1], 4u);
  ASSERT_EQ(frame.passes[0].bindings.size(), 3u);
  EXPECT_EQ(frame.passes[0].bindings[1].frames_back, 2u);
  EXPECT_TRUE(frame.passes[0].bindings[1].is_image && frame.passes[0].bindings[1].reads &&
              !frame.passes[0].bindings[1].writes);
  EXPECT_TRUE(!frame.passes[0].bindings[2].is_image && frame.passes[0].bindings[2].writes);
  EXPECT_TRUE(frame.passes[1].is_graph);
}

TEST(FrameJson, NamesTheFieldThatIsWrong) {
  struct Row {
    const char *from, *to, *message;
  };
  const Row rows[] = {
      {"\"schema\": \"shale-frame/1\"", "\"schema\": \"shale-frame/2\"",
       "frame: schema \"shale-frame/2\" is unknown"},
      {"\"schema\": \"shale-frame/1\",", "", "frame: \"schema\" must be a text"},
      {"\"name\": \"color\"", "\"name\": \"\"", "frame.images[0]: \"name\" must be a text"},
      {"\"name\": \"color\"", "\"name\": \"2color\"",
       "frame.images[0]: the name \"2color\" is no identifier"},
      {"\"name\": \"color\"", "\"name\": \"col or\"",
       "frame.images[0]: the name \"col or\" is no identifier"},
      {"\"role\": \"input\"", "\"role\": \"in\"", "frame.images[0]: role \"in\" is none of"},
      {"\"role\": \"input\",", "", "frame.images[0]: \"role\" must be a text"},
      {"\"rgba8_unorm\", \"size\": \"render\"}", "\"rgba9\", \"size\": \"render\"}",
       "frame.images[0]: format \"rgba9\" is no image format"},
      {"\"rgba8_unorm\", \"size\": \"render\"}", "\"rgba8_sint\", \"size\": \"render\"}",
       "frame.images[0]: format \"rgba8_sint\" is no image format"},
      {"\"rgba8_unorm\", \"size\": \"output\"}", "\"rgba8_unorm\", \"size\": \"window\"}",
       "frame.images[1]: \"size\" must be"},
      {"\"divide\": 4", "\"divide\": 0", "frame.images[2].size: \"divide\" is 0"},
      {"\"multiple\": 8", "\"multiple\": 1.5", "frame.images[2].size: \"multiple\" is 1.5"},
      {"\"render\": [10, 6]", "\"render\": [10, 0]", "frame: \"render\" has the side 0"},
      {"\"output\": [20, 12]", "\"output\": 20", "frame: \"output\" must be a width and a height"},
      {"\"output\": [20, 12]", "\"output\": [20, 20]", "is a ratio outside 1.5 to 3"},
      {"[1.5, 3]", "[0.5, 3]", "frame: \"ratio\" is 0.5 to 3, expected a range within 1 to 16"},
      {"[1.5, 3]", "[\"1\", 3]", "frame: \"ratio\" must be the least and the largest ratio"},
      {"\"type\": \"vec2\"", "\"type\": \"mat2\"",
       "frame.params[1]: type \"mat2\" is none of float, vec2..4, int, ivec2..4"},
      {"\"default\": [0.5]", "\"default\": 0.5",
       "frame.params[0]: \"default\" must be a list of 1"},
      {"\"default\": [0.5]", "\"default\": [\"a\"]",
       "frame.params[0]: \"default\" must be a list of numbers"},
      {"\"reset\": true", "\"reset\": 1", "frame.params[2]: \"reset\" must be true or false"},
      {"\"of\": \"x\"", "\"of\": 3", "frame.views[0]: \"of\" must be a text"},
      {"\"channels\": 3", "\"channels\": 4", "frame.views[0]: \"channels\" is 4"},
      {"\"SIDE\": 2", "\"SI DE\": 2", "frame.passes[0]: the definition \"SI DE\" is no name"},
      {"\"SIDE\": 2", "\"SIDE\": \"2\"", "frame.passes[0]: the definition \"SIDE\" is no name"},
      {"\"tensor\": \"x\", \"access\": \"write\"",
       "\"tensor\": \"x\", \"access\": \"write\", \"texels\": \"r8_sint\"",
       "frame.passes[0].bindings[2]: \"texels\" is for tensors and linear images that are read"},
      {"\"depth\": 3", "\"depth\": 1", "frame.images[2]: \"depth\" is 1"},
      {"\"depth\": 3", "\"depth\": 2.5", "frame.images[2]: \"depth\" is 2.5, expected an integer"},
      {"\"scale\": 0.5", "\"scale\": 0", "frame.tensors[0]: \"scale\" is 0"},
      {"\"scale\": 0.5,", "", "frame.tensors[0]: \"scale\" must be a number"},
      {"\"zero_point\": -3", "\"zero_point\": 65536", "frame.tensors[0]: \"zero_point\" is 65536"},
      {"{\"name\": \"x\",", "{", "frame.tensors[0]: \"name\" must be a text"},
      {"\"name\": \"pre\"", "\"name\": \"p-r-e\"",
       "frame.passes[0]: the name \"p-r-e\" is no identifier"},
      {"\"shader\": \"pre.comp\",", "", "frame.passes[0]: \"shader\" must be a text"},
      {"\"over\": \"color\",", "", "frame.passes[0]: \"over\" must be a text"},
      {"[8, 4]", "[8]", "frame.passes[0]: \"workgroup\" must be two whole numbers"},
      {"[8, 4]", "[8, -4]", "frame.passes[0]: \"workgroup\" must be two whole numbers"},
      {"[8, 4]", "[8, 33]", "frame.passes[0]: workgroup size 33 is outside 1..32"},
      {"[8, 4]", "[0, 4]", "frame.passes[0]: workgroup size 0 is outside 1..32"},
      {"\"binding\": 1, \"image\": \"kept\"", "\"binding\": 64, \"image\": \"kept\"",
       "frame.passes[0].bindings[1]: \"binding\" is 64"},
      {"\"binding\": 1, \"image\": \"kept\"", "\"binding\": 0, \"image\": \"kept\"",
       "frame.passes[0].bindings[1]: binding 0 is used twice"},
      {"\"image\": \"kept\", \"access\": \"read\"", "\"access\": \"read\"",
       "frame.passes[0].bindings[1]: \"tensor\" must be a text"},
      {"\"image\": \"kept\", \"access\": \"read\"", "\"image\": 5, \"access\": \"read\"",
       "frame.passes[0].bindings[1]: \"image\" must be a text"},
      {"\"access\": \"read\", \"frames_back\"", "\"access\": \"both\", \"frames_back\"",
       "frame.passes[0].bindings[1]: access \"both\" is none of"},
      {"\"frames_back\": 2", "\"frames_back\": 8",
       "frame.passes[0].bindings[1]: \"frames_back\" is 8"},
      {"\"access\": \"read\", \"frames_back\"", "\"access\": \"write\", \"frames_back\"",
       "only this frame's image can be written"},
      {"{\"graph\": \"main\"},", "{\"graph\": \"a\"}, {\"graph\": \"b\"},",
       "frame.passes: only one entry may be {\"graph\": ...}"},
      {"\"images\": [", "\"images\": 3, \"other\": [",
       "frame: \"images\" must be a list of at most 64 entries"},
      {"\"passes\": [", "\"passes\": {}, \"other\": [",
       "frame: \"passes\" must be a list of at most 64 entries"},
      {"{\"graph\": \"main\"},", "7, {\"graph\": \"main\"},",
       "frame.passes[1]: \"name\" must be a text"},
  };
  for (const Row& row : rows) {
    const std::string text = replaced(kFrame, row.from, row.to);
    ASSERT_NE(text, kFrame) << row.from;
    const std::string error = error_text(parse_frame(text));
    EXPECT_NE(error.find(row.message), std::string::npos)
        << "expected: " << row.message << "\nfound:    " << error;
  }
  EXPECT_EQ(error_text(parse_frame("")), "is not valid JSON");
  EXPECT_EQ(error_text(parse_frame("[]")), "is not valid JSON");
  EXPECT_EQ(error_text(parse_frame(std::string(kFrame, 300))), "is not valid JSON");
}

// kFrame with what a pass does not do itself, and a history in a buffer.
std::string linear_frame() {
  std::string text =
      replaced(kFrame, "\"depth\": 3}",
               "\"depth\": 3, \"linear\": true},\n"
               "{\"name\": \"raw\", \"role\": \"internal\", \"format\": \"rgba8_unorm\", "
               "\"size\": \"render\", \"linear\": true}");
  text = replaced(text, "\"passes\": [",
                  "\"passes\": [{\"name\": \"take\", \"copy\": \"color\", \"to\": \"raw\"},\n"
                  "{\"name\": \"empty\", \"clear\": \"kept\"},");
  text =
      replaced(text, "\"over\": \"color\"", "\"over\": {\"of\": \"render\", \"divide\": [4, 2]}");
  return replaced(text, "\"access\": \"read\", \"frames_back\"",
                  "\"access\": \"read\", \"texels\": \"rg32_uint\", \"frames_back\"");
}

TEST(FrameJson, ReadsTransfersAndLinearImages) {
  const Frame frame = must(parse_frame(linear_frame()));
  EXPECT_TRUE(frame.images[2].is_linear);
  EXPECT_FALSE(frame.images[0].is_linear);
  ASSERT_EQ(frame.passes.size(), 5u);
  EXPECT_EQ(frame.passes[0].transfer, kCopyKernel);
  ASSERT_EQ(frame.passes[0].bindings.size(), 2u);
  EXPECT_EQ(frame.passes[0].bindings[0].name, "color");
  EXPECT_TRUE(frame.passes[0].bindings[0].reads && !frame.passes[0].bindings[0].writes);
  EXPECT_EQ(frame.passes[0].bindings[1].name, "raw");
  EXPECT_TRUE(frame.passes[0].bindings[1].writes);
  EXPECT_EQ(frame.passes[1].transfer, kClearKernel);
  ASSERT_TRUE(frame.passes[2].over_size);
  EXPECT_EQ((*frame.passes[2].over_size)({10, 6}, {20, 12}), (FrameExtent{3, 3}));
  EXPECT_EQ(frame.passes[2].bindings[1].texels, ImageFormat::kRg32Uint);
  const auto error = [](const char* from, const char* to) {
    const std::string text = replaced(linear_frame(), from, to);
    EXPECT_NE(text, linear_frame()) << from;
    return error_text(parse_frame(text));
  };
  EXPECT_EQ(error("\"linear\": true}", "\"linear\": 1}"),
            "frame.images[2]: \"linear\" must be true or false");
  EXPECT_EQ(error("\"role\": \"internal\"", "\"role\": \"input\""),
            "frame.images[3]: the host's images are not linear: copy them");
  EXPECT_EQ(error(", \"to\": \"raw\"", ""), "frame.passes[0]: \"to\" must be a text");
  EXPECT_EQ(error("\"clear\": \"kept\"", "\"clear\": 1"),
            "frame.passes[1]: \"clear\" must be a text");
  EXPECT_EQ(error("[4, 2]", "[4]"),
            "frame.passes[2].over: \"divide\" must be one or two whole numbers from 1 to 64");
  EXPECT_EQ(error("[4, 2]", "[4, 0]"),
            "frame.passes[2].over: \"divide\" must be one or two whole numbers from 1 to 64");
}

TEST(FrameJson, SurvivesEveryCut) {
  const std::string text = kFrame;
  for (size_t length = 0; length < text.size(); ++length)
    EXPECT_FALSE(parse_frame(text.substr(0, length))) << length;
}

class SandwichTest : public testing::Test {
 protected:
  static CompileOptions options(const std::string& json) {
    CompileOptions options = fast_options();
    options.frame = must(parse_frame(json));
    options.load_shader = [](const std::string& path) -> Result<std::string> {
      if (path == "pre.comp")
        return std::string(R"(#version 450
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1) uniform texture2D kept;
layout(set = 0, binding = 2, std430) writeonly buffer X { int d[]; } x;
SHALE_PARAMS;
void main() {
  if (gl_GlobalInvocationID.x >= X_WIDTH || gl_GlobalInvocationID.y >= X_HEIGHT) return;
  x.d[0] = int(X_SCALE * float(X_ZERO_POINT + X_CHANNELS + COLOR_WIDTH + SIDE) * LEAST * params.near) + params.fresh;
})");
      if (path == "post.comp")
        return std::string(R"(#version 450
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, std430) readonly buffer Y { int d[]; } y;
layout(set = 0, binding = 1, rgba8) uniform writeonly image2D shown;
layout(set = 0, binding = 2, rgba16f) uniform writeonly image2D kept;
void main() { imageStore(shown, ivec2(gl_GlobalInvocationID.xy), vec4(y.d[0])); imageStore(kept, ivec2(0), vec4(0)); })");
      return io_error(path, "cannot be read");
    };
    return options;
  }
  static constexpr const char* kNetwork =
      "graph main {\n input %x : i8[1,6,10,4]\n %y = bitwise_not %x : i8[1,6,10,4]\n return %y\n}";
  static std::string error_of(const std::string& from, const std::string& to) {
    const std::string text = replaced(kFrame, from, to);
    EXPECT_NE(text, kFrame);
    return error_text(compile_text(kNetwork, options(text)));
  }
};

TEST_F(SandwichTest, KeepsLinearImagesInBuffers) {
  CompileOptions with_buffers = options(linear_frame());
  with_buffers.load_shader = [](const std::string& path) {
    return Result<std::string>(path == "pre.comp" ? R"(#version 450
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1) uniform utextureBuffer kept;
layout(set = 0, binding = 2, std430) writeonly buffer X { int d[]; } x;
void main() { x.d[0] = int(texelFetch(kept, KEPT_PITCH * (KEPT_HEIGHT - 1)).x) + SHALE_ON_CPU; })"
                                                  : R"(#version 450
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, std430) readonly buffer Y { int d[]; } y;
layout(set = 0, binding = 1, rgba8) uniform writeonly image2D shown;
layout(set = 0, binding = 2, std430) writeonly buffer Kept { uvec2 d[]; } kept;
void main() { imageStore(shown, ivec2(0), vec4(y.d[0])); kept.d[0] = uvec2(0); })");
  };
  const Compiled compiled = must(compile_text(kNetwork, with_buffers));
  const Variant& variant = compiled.package.variants[0];
  ASSERT_EQ(variant.segments.size(), 5u);
  EXPECT_EQ(variant.segments[0].kind, SegmentKind::kTransfer);
  EXPECT_EQ(variant.segments[0].dispatches[0].kernel, "copy");
  EXPECT_EQ(variant.segments[1].dispatches[0].kernel, "clear");
  const Dispatch& pre = variant.segments[2].dispatches[0];
  EXPECT_EQ(pre.bindings[1].type, BindingType::kUniformTexelBuffer);
  EXPECT_EQ(pre.bindings[1].view_format, ImageFormat::kRg32Uint);
  EXPECT_EQ(variant.segments[4].dispatches[0].bindings[2].type, BindingType::kStorageBuffer);
  const Resource& kept = variant.resources[pre.bindings[1].resource];
  EXPECT_TRUE(is_linear(kept));
  EXPECT_EQ(kept.size_bytes, 8u * 8 * 8);  // rows of 8 texels of 8 bytes are 64 bytes
  const auto error = [&](const char* from, const char* to) {
    CompileOptions changed = with_buffers;
    changed.frame = must(parse_frame(replaced(linear_frame(), from, to)));
    return error_text(compile_text(kNetwork, changed));
  };
  EXPECT_EQ(error("\"depth\": 3, \"linear\": true", "\"depth\": 3"),
            "pass \"pre\": reads texels of \"kept\", which is not linear");
  EXPECT_EQ(error("\"access\": \"read\", \"texels\": \"rg32_uint\"", "\"access\": \"load\""),
            "pass \"pre\": loads \"kept\", which is linear: read its texels");
  EXPECT_NE(error("\"to\": \"raw\"", "\"to\": \"kept\"").find("has another format or extent"),
            std::string::npos);
}

TEST_F(SandwichTest, PutsPassesAroundTheNetwork) {
  const Compiled compiled = must(compile_text(kNetwork, options(kFrame)));
  const Variant& variant = compiled.package.variants[0];
  ASSERT_EQ(variant.segments.size(), 3u);
  EXPECT_EQ(variant.segments[0].kind, SegmentKind::kCompute);
  EXPECT_EQ(variant.segments[1].kind, SegmentKind::kGraph);
  EXPECT_EQ(variant.segments[2].name, "post");
  EXPECT_EQ(variant.segments[0].dispatches[0].workgroups,
            (std::array<uint32_t, 3>{2, 2, 1}));  // 10x6 by 8x4
  EXPECT_EQ(variant.segments[2].dispatches[0].workgroups,
            (std::array<uint32_t, 3>{3, 2, 1}));  // 20x12 by 8x8
  EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
}

TEST_F(SandwichTest, NamesWhatDoesNotFitTogether) {
  EXPECT_NE(error_of("\"over\": \"color\"", "\"over\": \"colour\"")
                .find("pass \"pre\": there is no image, graph input or output \"colour\""),
            std::string::npos);
  EXPECT_NE(error_of("\"tensor\": \"y\"", "\"tensor\": \"z\"")
                .find("there is no graph input or output \"z\""),
            std::string::npos);
  EXPECT_NE(error_of("\"image\": \"color\", \"access\": \"read\"",
                     "\"image\": \"color\", \"access\": \"write\"")
                .find("writes \"color\""),
            std::string::npos);
  EXPECT_NE(error_of("\"frames_back\": 2", "\"frames_back\": 3")
                .find("3 frames back, its history is 3 deep"),
            std::string::npos);
  EXPECT_NE(error_of("\"name\": \"shown\"", "\"name\": \"color\"")
                .find("the name \"color\" is used twice"),
            std::string::npos);
  EXPECT_NE(error_of("pre.comp", "missing.comp").find("missing.comp: cannot be read"),
            std::string::npos);
}

TEST_F(SandwichTest, NeedsAnImageNetwork) {
  EXPECT_NE(error_text(compile_text(kSmall, options(kFrame)))
                .find("frame.tensors: the network has no NHWC input \"x\""),
            std::string::npos);
}

TEST_F(SandwichTest, TakesTheSizesThatAreAskedFor) {
  CompileOptions sized = options(kFrame);
  sized.sizes.render = FrameExtent{12, 8};
  const auto size = [](const Compiled& compiled, const char* name) {
    for (const Resource& resource : compiled.package.variants[0].resources)
      if (resource.name == name) return FrameExtent{resource.width, resource.height};
    return FrameExtent{};
  };
  Compiled compiled = must(compile_text(kNetwork, sized));
  EXPECT_EQ(compiled.package.variants[0].resources[0].shape, (Shape{1, 8, 12, 4}));
  EXPECT_EQ(size(compiled, "shown"), (FrameExtent{24, 16}));
  EXPECT_EQ(compiled.package.variants[0].params.size(), 3u);
  EXPECT_EQ(compiled.package.variants[0].views.size(), 1u);
  sized.sizes.output = FrameExtent{36, 13};
  compiled = must(compile_text(kNetwork, sized));
  EXPECT_EQ(size(compiled, "shown"), (FrameExtent{36, 13}));
  sized.sizes.output = FrameExtent{12, 8};
  EXPECT_NE(
      error_text(compile_text(kNetwork, sized)).find("12x8 to 12x8 is a ratio outside 1.5 to 3"),
      std::string::npos);
  sized.sizes.output.reset();
  sized.passes.input_shapes = {{"x", {1, 6, 8, 4}}};
  EXPECT_NE(error_text(compile_text(kNetwork, sized)).find("use --render and --output-size"),
            std::string::npos);
}

TEST_F(SandwichTest, MayHaveNoNetwork) {
  const std::string json =
      R"({"schema": "shale-frame/1", "render": [4, 4], "output": [8, 8], "ratio": [2, 2],
    "images": [{"name": "color", "role": "input", "format": "rgba8_unorm", "size": "render"},
               {"name": "shown", "role": "output", "format": "rgba8_unorm", "size": "output"}],
    "passes": [{"name": "grow", "shader": "grow.comp", "over": "shown", "bindings": [
      {"binding": 0, "image": "color", "access": "read"}, {"binding": 1, "image": "shown", "access": "write"}]}]})";
  CompileOptions alone = options(json);
  alone.load_shader = [](const std::string& path) -> Result<std::string> {
    if (path == "half.glsl") return std::string("ivec2 half_of(ivec2 at) { return at / 2; }\n");
    return std::string(R"(#version 450
#extension GL_EXT_samplerless_texture_functions : require
#include "half.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1, rgba8) uniform writeonly image2D shown;
void main() { const ivec2 at = ivec2(gl_GlobalInvocationID.xy); imageStore(shown, at, texelFetch(color, half_of(at), 0)); })");
  };
  const Compiled compiled = must(compile({}, alone));
  ASSERT_EQ(compiled.package.variants[0].segments.size(), 1u);
  EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
}

}  // namespace
}  // namespace shale
