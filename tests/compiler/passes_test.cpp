#include "compiler/passes/op_kind.h"
#include "compiler/passes/pass.h"
#include "ir/reference/precision.h"
#include "tests/compiler/graph_support.h"

namespace shale {

void PrintTo(Change change, std::ostream* out) {
  *out << (change == Change::kNone ? "kNone" : "kChanged");
}

namespace {

struct PassOutput {
  Change change;
  std::string text;
  bool operator==(const PassOutput&) const = default;
};
void PrintTo(const PassOutput& output, std::ostream* out) {
  *out << (output.change == Change::kNone ? "unchanged\n" : "changed\n") << output.text;
}

class PassTest : public testing::Test {
 protected:
  /// Runs one pass. Whatever it does, its claim must be true, the graph must stay legal and compute
  /// the same, and a second run must find nothing left to do.
  static PassOutput run_pass(std::string_view name, const std::string& text) {
    const Graph before = graph_of(text);
    Graph after = before;
    const Change change = run(name, after);
    EXPECT_EQ(change == Change::kNone, print_text(after) == print_text(before))
        << "the claim is wrong";
    const auto verified = verify(after);
    EXPECT_TRUE(verified) << error_text(verified) << "\n" << print_text(after);
    if (verified) expect_same_results(before, after);
    Graph again = after;
    EXPECT_EQ(run(name, again), Change::kNone) << "a second run changes the graph again";
    EXPECT_EQ(print_text(again), print_text(after));
    return {change, print_text(after)};
  }

  static Change run(std::string_view name, Graph& graph) {
    const PassInfo* pass = find_pass(name);
    EXPECT_NE(pass, nullptr) << name;
    return must(shale::run_pass(*pass, graph, {}));
  }

  /// Values that nothing uses may stand in `after` too.
  static void expect_change(std::string_view name, const std::string& before,
                            const std::string& after) {
    Graph expected = graph_of(after);
    expected.compact();
    EXPECT_EQ(run_pass(name, before), (PassOutput{Change::kChanged, print_text(expected)}));
  }
  static void expect_untouched(std::string_view name, const std::string& text) {
    EXPECT_EQ(run_pass(name, text), (PassOutput{Change::kNone, normal_text(text)}));
  }
};

// expand-fft

TEST(ExpandFft, WritesTransformsAsProductsWithinTheBounds) {
  const Graph before = graph_of(
      "graph g { input %x : f32[2,4,8] input %y : f32[2,4,8] "
      "%re = fft2d %x, %y {part=real} : f32[2,4,8] %im = fft2d %x, %y {part=imag} : f32[2,4,8] "
      "%back = fft2d %y, %x {inverse=true, local_bound=true, part=real} : f32[2,4,8] "
      "%half = rfft2d %x {local_bound=true, part=imag} : f32[2,4,5] return %re, %im, %back, %half "
      "}");
  Graph after = before;
  EXPECT_EQ(must(shale::run_pass(*find_pass("expand-fft"), after, {})), Change::kChanged);
  EXPECT_TRUE(verify(after)) << print_text(after);
  size_t products = 0;
  for (const Node& node : after.nodes) products += node.op == Op::kMatmul ? 1 : 0;
  EXPECT_EQ(products, 3u + 4u) << "rows once for both parts, columns for each";
  std::vector<Tensor> inputs(2, Tensor::zeros({DType::kFp32, {2, 4, 8}}));
  for (int64_t i = 0; i < 128; ++i)
    inputs[static_cast<size_t>(i % 2)].set_real(i / 2, static_cast<double>(i * 37 % 101) / 25 - 2);
  const std::vector<Tensor> found = must(interpret(after, inputs));
  for (uint32_t i = 0; i < before.nodes.size(); ++i) {
    const Tensor* const operands[] = {&inputs[before.nodes[i].inputs[0].index],
                                      &inputs[before.nodes[i].inputs.back().index]};
    const auto expected =
        must(node_precision(before, {i}, {operands, before.nodes[i].inputs.size()}));
    EXPECT_EQ(first_imprecise(found[i], expected).value_or(""), "") << i;
  }
  Graph large = graph_of(
      "graph g { input %x : f32[1,1,2048] %y = rfft2d %x {part=real} : f32[1,1,1025] return %y }");
  EXPECT_NE(error_text(shale::run_pass(*find_pass("expand-fft"), large, {}))
                .find("transforms 2048 elements on an axis, the limit is 1024"),
            std::string::npos);
}

TEST(PassTable, FindsPassesByName) {
  for (const PassInfo& pass : all_passes()) EXPECT_EQ(find_pass(pass.name), &pass);
  EXPECT_EQ(find_pass("fuse-everything"), nullptr);
}

// infer-shapes

class InferShapesTest : public testing::Test {
 protected:
  static Result<Change> run(Graph& graph, std::map<std::string, Shape> shapes) {
    return run_pass(*find_pass("infer-shapes"), graph, {.input_shapes = std::move(shapes)});
  }
  static std::string error_of(const std::string& text, std::map<std::string, Shape> shapes) {
    Graph graph = must(parse_text(text));
    return error_text(run(graph, std::move(shapes)));
  }
};

constexpr const char* kDoubler = R"(graph main {
  input %x : i8[1,4,6,2]
  const %scale : shape[4] = [2,1,2,1]
  const %offset : shape[2] = [0,0]
  const %border : shape[2] = [1,1]
  %big = resize %x, %scale, %offset, %border {mode=nearest} : i8[1,8,12,2]
  return %big
})";

TEST_F(InferShapesTest, LeavesAClosedGraphAlone) {
  Graph graph = graph_of(kDoubler);
  EXPECT_EQ(must(run(graph, {})), Change::kNone);
  EXPECT_EQ(must(run(graph, {{"x", {1, 4, 6, 2}}})), Change::kNone);
  EXPECT_EQ(print_text(graph), normal_text(kDoubler));
}

TEST_F(InferShapesTest, GivesAnInputAnotherShape) {
  Graph graph = graph_of(kDoubler);
  EXPECT_EQ(must(run(graph, {{"x", {1, 5, 7, 2}}})), Change::kChanged);
  EXPECT_EQ(print_text(graph), normal_text(replaced(replaced(kDoubler, "[1,4,6,2]", "[1,5,7,2]"),
                                                    "[1,8,12,2]", "[1,10,14,2]")));
  EXPECT_TRUE(verify(graph));
}

TEST_F(InferShapesTest, ClosesOpenDimensions) {
  Graph graph = must(parse_text(
      replaced(replaced(kDoubler, "[1,4,6,2]", "[1,?,?,2]"), "[1,8,12,2]", "[1,?,?,2]")));
  EXPECT_EQ(must(run(graph, {{"x", {1, 4, 6, 2}}})), Change::kChanged);
  EXPECT_EQ(print_text(graph), normal_text(kDoubler));
}

TEST_F(InferShapesTest, ClosesAResultWhoseOperandsAreClosed) {
  Graph graph = must(parse_text(replaced(kDoubler, "[1,8,12,2]", "[1,?,12,?]")));
  EXPECT_EQ(must(run(graph, {})), Change::kChanged);
  EXPECT_EQ(print_text(graph), normal_text(kDoubler));
}

TEST_F(InferShapesTest, RefusesWhatCannotBe) {
  EXPECT_EQ(error_of(kDoubler, {{"y", {1, 4, 6, 2}}}),
            "--input-shape: the graph has no input \"y\"");
  EXPECT_EQ(error_of(kDoubler, {{"big", {1, 8, 12, 2}}}),
            "--input-shape: the graph has no input \"big\"");
  EXPECT_EQ(error_of(kDoubler, {{"x", {4, 6, 2}}}),
            "--input-shape: input \"x\" has rank 4, found [4,6,2]");
  EXPECT_EQ(error_of(kDoubler, {{"x", {1, 0, 6, 2}}}),
            "--input-shape: [1,0,6,2] is no shape for input \"x\"");
  EXPECT_EQ(error_of(kDoubler, {{"x", {1, 65536, 65536, 2}}}),
            "--input-shape: [1,65536,65536,2] is no shape for input \"x\"");
  EXPECT_EQ(error_of(replaced(kDoubler, "[1,4,6,2]", "[1,?,6,2]"), {}),
            "input \"x\": its shape [1,?,6,2] is open; give it with --input-shape x=N,H,W,C");
  EXPECT_EQ(error_of(replaced(kDoubler, "[1,8,12,2]", "[1,8,13,2]"), {}),
            "node %0 \"big\" (resize): declares its result as i8[1,8,13,2], its operands give "
            "i8[1,8,12,2]");
  EXPECT_EQ(error_of(replaced(kDoubler, "i8[1,8,12,2]", "i32[1,8,12,2]"), {{"x", {1, 5, 6, 2}}}),
            "node %0 \"big\" (resize): declares its result as i32, its operands give i8");
}

TEST_F(InferShapesTest, NamesTheNodeThatANewShapeBreaks) {
  const std::string text = R"(graph main {
  input %x : i32[1,4,4,3]
  const %c : i32[1,4,4,3] = [0,1,2,3,4,5,6,7,8,9,0,1,2,3,4,5,6,7,8,9,0,1,2,3,4,5,6,7,8,9,0,1,2,3,4,5,6,7,8,9,0,1,2,3,4,5,6,7]
  %sum = add %x, %c : i32[1,4,4,3]
  return %sum
})";
  EXPECT_NE(error_of(text, {{"x", {1, 5, 4, 3}}}).find("node %0 \"sum\" (add)"), std::string::npos);
}

// fold-constants

TEST_F(PassTest, FoldConstantsComputesChains) {
  expect_change("fold-constants", R"(graph main {
  input %x : i32[2]
  const %a : i32[2] = [1,2]
  const %b : i32[2] = [10,-20]
  %sum = add %a, %b : i32[2]
  %twice = add %sum, %sum : i32[2]
  %y = add %x, %twice : i32[2]
  return %y
})",
                R"(graph main {
  input %x : i32[2]
  const %twice : i32[2] = [22,-36]
  %y = add %x, %twice : i32[2]
  return %y
})");
}

TEST_F(PassTest, FoldConstantsMakesAnOutputConstant) {
  expect_change("fold-constants", R"(graph main {
  const %a : i32[2] = [1,2]
  %y = abs %a : i32[2]
  return %y
})",
                R"(graph main {
  const %y : i32[2] = [1,2]
  return %y
})");
}

TEST_F(PassTest, FoldConstantsKeepsNodesThatReadAnInput) {
  expect_untouched("fold-constants", R"(graph main {
  input %x : i32[2]
  const %a : i32[2] = [1,2]
  %y = add %x, %a : i32[2]
  return %y
})");
}

TEST_F(PassTest, FoldConstantsKeepsResultsThatWouldBloatThePackage) {
  const std::string text = R"(graph main {
  const %a : i8[2] = [1,2]
  const %times : shape[1] = [524289]
  %y = tile %a, %times : i8[1048578]
  return %y
})";
  expect_untouched("fold-constants", text);
  EXPECT_EQ(
      run_pass("fold-constants", replaced(replaced(text, "524289", "524288"), "1048578", "1048576"))
          .change,
      Change::kChanged);
}

TEST_F(PassTest, FoldConstantsNamesANodeWithoutResult) {
  Graph graph = graph_of(R"(graph main {
  const %a : i32[1] = [2147483647]
  %y = add %a, %a : i32[1]
  return %y
})");
  const auto result = shale::run_pass(*find_pass("fold-constants"), graph, {});
  EXPECT_NE(error_text(result).find("node %0 \"y\" (add)"), std::string::npos)
      << error_text(result);
}

// remove-identity

std::string identity_graph(const std::string& constants, const std::string& node,
                           const std::string& type = "i8[1,2,3,4]") {
  return "graph main {\n  input %x : " + type + "\n" + constants + "  %same = " + node + " : " +
         type + "\n  %y = bitwise_not %same : " + type + "\n  return %y\n}";
}

TEST_F(PassTest, RemoveIdentityDropsEveryNodeThatOnlyPassesOn) {
  const std::string after =
      "graph main {\n  input %x : i8[1,2,3,4]\n  %y = bitwise_not %x : i8[1,2,3,4]\n  return %y\n}";
  const std::pair<const char*, const char*> rows[] = {
      {"", "identity %x"},
      {"  const %s : shape[4] = [1,2,3,4]\n", "reshape %x, %s"},
      {"  const %a : shape[4] = [0,0,0,0]\n  const %b : shape[4] = [1,2,3,4]\n",
       "slice %x, %a, %b"},
      {"  const %m : shape[4] = [1,1,1,1]\n", "tile %x, %m"},
      {"", "concat %x {axis=3}"},
      {"  const %p : shape[8] = [0,0,0,0,0,0,0,0]\n  const %v : i8[1] = [5]\n", "pad %x, %p, %v"},
      {"", "transpose %x {perms=[0,1,2,3]}"},
      {"", "clamp %x {min_val=-128, max_val=127}"},
  };
  for (const auto& [constants, node] : rows) {
    SCOPED_TRACE(node);
    expect_change("remove-identity", identity_graph(constants, node), after);
  }
}

TEST_F(PassTest, RemoveIdentityFollowsChains) {
  expect_change("remove-identity", R"(graph main {
  input %x : i8[2]
  %a = identity %x : i8[2]
  %b = identity %a : i8[2]
  %y = bitwise_and %b, %a : i8[2]
  return %y
})",
                R"(graph main {
  input %x : i8[2]
  %y = bitwise_and %x, %x : i8[2]
  return %y
})");
}

TEST_F(PassTest, RemoveIdentityKeepsNodesThatDoSomething) {
  const std::pair<const char*, const char*> rows[] = {
      {"", "clamp %x {min_val=-127, max_val=127}"},
      {"", "clamp %x {min_val=-128, max_val=126}"},
      {"", "reverse %x {axis=0}"},
      {"", "transpose %x {perms=[1,0]}"},  // equal sizes: the type does not tell
  };
  for (const auto& [constants, node] : rows) {
    SCOPED_TRACE(node);
    expect_untouched("remove-identity", identity_graph(constants, node, "i8[3,3]"));
  }
  expect_untouched("remove-identity", R"(graph main {
  input %x : i8[2,2]
  const %p : shape[4] = [0,0,0,1]
  const %v : i8[1] = [5]
  %a = pad %x, %p, %v : i8[2,3]
  const %s : shape[1] = [6]
  %y = reshape %a, %s : i8[6]
  return %y
})");
}

TEST_F(PassTest, RemoveIdentityKeepsGraphOutputs) {
  expect_untouched("remove-identity", R"(graph main {
  input %x : i8[2]
  %y = identity %x : i8[2]
  return %y
})");
}

// merge-equal

TEST_F(PassTest, MergeEqualJoinsNodesAndWhatFollowsFromThem) {
  expect_change("merge-equal", R"(graph main {
  input %x : i32[2]
  %a = abs %x : i32[2]
  %b = abs %x : i32[2]
  %c = clz %a : i32[2]
  %d = clz %b : i32[2]
  %y = add %c, %d : i32[2]
  return %y
})",
                R"(graph main {
  input %x : i32[2]
  %a = abs %x : i32[2]
  %c = clz %a : i32[2]
  %y = add %c, %c : i32[2]
  return %y
})");
}

TEST_F(PassTest, MergeEqualJoinsConstants) {
  expect_change("merge-equal", R"(graph main {
  input %x : i32[2]
  const %a : i32[2] = [1,2]
  const %b : i32[2] = [1,2]
  %c = add %x, %a : i32[2]
  %y = sub %c, %b : i32[2]
  return %y
})",
                R"(graph main {
  input %x : i32[2]
  const %a : i32[2] = [1,2]
  %c = add %x, %a : i32[2]
  %y = sub %c, %a : i32[2]
  return %y
})");
}

TEST_F(PassTest, MergeEqualKeepsNodesThatDiffer) {
  expect_untouched("merge-equal", R"(graph main {
  input %x : i8[2,3]
  const %a : i8[1] = [1]
  const %b : i16[1] = [1]
  const %c : i8[1,1] = [1]
  %p = reverse %x {axis=0} : i8[2,3]
  %q = reverse %x {axis=1} : i8[2,3]
  %r = bitwise_and %p, %q : i8[2,3]
  %s = bitwise_or %p, %q : i8[2,3]
  %t = bitwise_and %q, %p : i8[2,3]
  return %r, %s, %t, %a, %b, %c
})");
}

TEST_F(PassTest, MergeEqualKeepsCastsToDifferentTypes) {
  expect_untouched("merge-equal", R"(graph main {
  input %x : i8[2]
  %a = cast %x : i16[2]
  %b = cast %x : i32[2]
  %c = bitwise_not %a : i16[2]
  %d = bitwise_not %b : i32[2]
  return %c, %d
})");
}

TEST_F(PassTest, MergeEqualKeepsGraphOutputs) {
  expect_untouched("merge-equal", R"(graph main {
  input %x : i32[2]
  %a = abs %x : i32[2]
  %b = abs %x : i32[2]
  return %a, %b
})");
  expect_untouched("merge-equal", R"(graph main {
  const %a : i32[2] = [1,2]
  const %b : i32[2] = [1,2]
  return %a, %b
})");
}

TEST_F(PassTest, MergeEqualReadsAnOutputInsteadOfItsTwin) {
  expect_change("merge-equal", R"(graph main {
  input %x : i32[2]
  %a = abs %x : i32[2]
  %b = abs %x : i32[2]
  %y = clz %b : i32[2]
  return %a, %y
})",
                R"(graph main {
  input %x : i32[2]
  %a = abs %x : i32[2]
  %y = clz %a : i32[2]
  return %a, %y
})");
}

// remove-dead

TEST_F(PassTest, RemoveDeadDropsWhatNoOutputNeeds) {
  expect_change("remove-dead", R"(graph main {
  input %x : i32[2]
  input %unused : i8[3]
  const %c : i32[1] = [7]
  %a = abs %x : i32[2]
  %b = add %a, %c : i32[2]
  %d = clz %b : i32[2]
  return %a
})",
                R"(graph main {
  input %x : i32[2]
  input %unused : i8[3]
  %a = abs %x : i32[2]
  return %a
})");
}

TEST_F(PassTest, RemoveDeadKeepsWhatIsNeededIndirectly) {
  expect_untouched("remove-dead", R"(graph main {
  input %x : i32[2]
  %a = abs %x : i32[2]
  %b = clz %a : i32[2]
  return %b
})");
}

// fold-zero-point

/// A convolution of [1,3,4,2] to two channels with 1x2 kernels.
std::string conv_graph(const std::string& pad, const std::string& shape, const std::string& zp,
                       const std::string& wzp, const std::string& weight = "[1,2,3,4,-5,6,-7,8]",
                       const std::string& bias = "i32[2] = [100,-100]") {
  return "graph main {\n  input %x : i8[1,3,4,2]\n  const %w : i8[2,1,2,2] = " + weight +
         "\n  const %b : " + bias + "\n  const %zp : i8[1] = [" + zp +
         "]\n  const %wzp : i8[1] = [" + wzp +
         "]\n  %acc = conv2d %x, %w, %b, %zp, %wzp {pad=" + pad +
         ", stride=[1,1], dilation=[1,1], acc_type=i32} : i32" + shape + "\n  return %acc\n}";
}

TEST_F(PassTest, FoldZeroPointMovesTheInputZeroPointIntoTheBias) {
  // 100 - 3 * (1 + 2 + 3 + 4) and -100 - 3 * (-5 + 6 - 7 + 8).
  expect_change("fold-zero-point", conv_graph("[0,0,0,0]", "[1,3,3,2]", "3", "0"), R"(graph main {
  input %x : i8[1,3,4,2]
  const %w : i8[2,1,2,2] = [1,2,3,4,-5,6,-7,8]
  const %acc.bias : i32[2] = [70,-106]
  const %acc.zero : i8[1] = [0]
  %acc = conv2d %x, %w, %acc.bias, %acc.zero, %acc.zero {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,3,3,2]
  return %acc
})");
}

TEST_F(PassTest, FoldZeroPointMakesPadsExplicit) {
  expect_change("fold-zero-point", conv_graph("[1,0,0,2]", "[1,4,5,2]", "-128", "0"),
                R"(graph main {
  input %x : i8[1,3,4,2]
  const %w : i8[2,1,2,2] = [1,2,3,4,-5,6,-7,8]
  const %acc.padding : shape[8] = [0,0,1,0,0,2,0,0]
  const %acc.pad_value : i8[1] = [-128]
  const %acc.bias : i32[2] = [1380,156]
  const %acc.zero : i8[1] = [0]
  %acc.padded = pad %x, %acc.padding, %acc.pad_value : i8[1,4,6,2]
  %acc = conv2d %acc.padded, %w, %acc.bias, %acc.zero, %acc.zero {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,4,5,2]
  return %acc
})");
}

TEST_F(PassTest, FoldZeroPointMovesTheWeightZeroPointIntoTheWeights) {
  // Without an input zero point the pads may stay: a padded tap is 0 anyway.
  expect_change("fold-zero-point", conv_graph("[1,0,0,2]", "[1,4,5,2]", "0", "-3"), R"(graph main {
  input %x : i8[1,3,4,2]
  const %acc.weight : i8[2,1,2,2] = [4,5,6,7,-2,9,-4,11]
  const %acc.bias : i32[2] = [100,-100]
  const %acc.zero : i8[1] = [0]
  %acc = conv2d %x, %acc.weight, %acc.bias, %acc.zero, %acc.zero {pad=[1,0,0,2], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,4,5,2]
  return %acc
})");
}

TEST_F(PassTest, FoldZeroPointGivesAOneElementBiasAllChannels) {
  const PassOutput output = run_pass(
      "fold-zero-point",
      conv_graph("[0,0,0,0]", "[1,3,3,2]", "1", "0", "[1,2,3,4,-5,6,-7,8]", "i32[1] = [7]"));
  EXPECT_EQ(output.change, Change::kChanged);
  EXPECT_NE(output.text.find("const %acc.bias : i32[2] = [-3,5]"), std::string::npos)
      << output.text;
}

TEST_F(PassTest, FoldZeroPointTakesDepthwiseConvolutions) {
  const PassOutput output = run_pass("fold-zero-point", R"(graph main {
  input %x : i8[1,3,3,2]
  const %w : i8[1,2,2,2] = [1,2,3,4,5,6,7,8]
  const %b : i32[4] = [0,0,0,0]
  const %zp : i8[1] = [10]
  const %wzp : i8[1] = [1]
  %acc = depthwise_conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,1,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,3,3,4]
  return %acc
})");
  EXPECT_EQ(output.change, Change::kChanged);
  EXPECT_NE(output.text.find("const %acc.weight : i8[1,2,2,2] = [0,1,2,3,4,5,6,7]"),
            std::string::npos)
      << output.text;
  EXPECT_NE(output.text.find("const %acc.bias : i32[4] = [-40,-60,-80,-100]"), std::string::npos)
      << output.text;
  EXPECT_NE(output.text.find("%acc.padded = pad"), std::string::npos) << output.text;
}

TEST_F(PassTest, FoldZeroPointStaysOutWhereItCannotOrNeedNot) {
  expect_untouched("fold-zero-point", conv_graph("[1,0,0,2]", "[1,4,5,2]", "0", "0"));
  // -128 - 1 and 127 + 1 are no int8 weights.
  expect_untouched("fold-zero-point",
                   conv_graph("[0,0,0,0]", "[1,3,3,2]", "5", "1", "[-128,0,0,0,0,0,0,0]"));
  expect_untouched("fold-zero-point",
                   conv_graph("[0,0,0,0]", "[1,3,3,2]", "5", "-1", "[0,0,0,0,0,0,0,127]"));
  // A bias of int32 plus or minus 128 * 10 does not fit.
  const std::string low_bias = conv_graph("[0,0,0,0]", "[1,3,3,2]", "127", "0", "[1,2,3,4,0,0,0,0]",
                                          "i32[2] = [-2147482400,0]");
  Graph graph = graph_of(low_bias);
  EXPECT_EQ(run("fold-zero-point", graph), Change::kNone);
  EXPECT_EQ(print_text(graph), normal_text(low_bias));
}

TEST_F(PassTest, FoldZeroPointKeepsConvolutionsWithDynamicWeights) {
  expect_untouched("fold-zero-point", R"(graph main {
  input %x : i8[1,3,4,2]
  input %w : i8[2,1,2,2]
  const %b : i32[2] = [1,2]
  const %zp : i8[1] = [5]
  const %wzp : i8[1] = [0]
  %acc = conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,3,3,2]
  return %acc
})");
  expect_untouched("fold-zero-point", R"(graph main {
  input %x : i8[1,3,4,2]
  input %b : i32[2]
  const %w : i8[2,1,2,2] = [1,2,3,4,5,6,7,8]
  const %zp : i8[1] = [5]
  const %wzp : i8[1] = [0]
  %acc = conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,3,3,2]
  return %acc
})");
}

TEST_F(PassTest, FoldZeroPointKeepsOtherTypes) {
  expect_untouched("fold-zero-point", R"(graph main {
  input %x : i8[1,3,4,2]
  const %w : i4[2,1,2,2] = [1,2,3,4,5,6,7,-7]
  const %b : i32[2] = [1,2]
  const %zp : i8[1] = [5]
  const %wzp : i4[1] = [0]
  %acc = conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,3,3,2]
  return %acc
})");
  expect_untouched("fold-zero-point", R"(graph main {
  input %x : i16[1,3,4,2]
  const %w : i8[2,1,2,2] = [1,2,3,4,5,6,7,8]
  const %b : i48[2] = [1,2]
  const %zp : i16[1] = [0]
  const %wzp : i8[1] = [3]
  %acc = conv2d %x, %w, %b, %zp, %wzp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i48} : i48[1,3,3,2]
  return %acc
})");
}

// The fusion passes: `after` is `before` with group marks.

constexpr const char* kConstants = R"(  const %w : i8[2,1,1,2] = [1,2,3,4]
  const %b : i32[2] = [5,6]
  const %zp : i8[1] = [0]
  const %m : i32[1] = [1073741824]
  const %s : i8[1] = [38]
  const %z : i32[1] = [0]
)";

/// `lines` between inputs %x, %x2 : i8[1,4,4,2] with the constants above and `return`.
std::string network(const std::string& lines, const std::string& outputs) {
  return std::string("graph main {\n  input %x : i8[1,4,4,2]\n  input %x2 : i8[1,4,4,2]\n") +
         kConstants + lines + "  return " + outputs + "\n}";
}
std::string conv(const std::string& result, const std::string& operand,
                 const std::string& group = "") {
  return "  " + result + " = conv2d " + operand +
         ", %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : "
         "i32[1,4,4,2]" +
         group + "\n";
}
std::string rescale(const std::string& result, const std::string& operand,
                    const std::string& group = "") {
  return "  " + result + " = rescale " + operand +
         ", %m, %s, %z, %zp {scale32=true, rounding_mode=single} : i8[1,4,4,2]" + group + "\n";
}
std::string node(const std::string& line, const std::string& group = "") {
  return "  " + line + group + "\n";
}

// copy-views

/// An upsampling, and what reads it: `lines` and results.
std::string upsampled(const std::string& lines, const std::string& results) {
  return std::string("graph main {\n  input %x : i8[1,2,2,2]\n") + kConstants +
         "  const %scale : shape[4] = [2,1,2,1]\n  const %offset : shape[2] = [0,0]\n"
         "  const %border : shape[2] = [1,1]\n  const %none : shape[8] = [0,0,0,0,0,0,0,0]\n" +
         lines + "  return " + results + "\n}";
}
std::string upsample(const std::string& result) {
  return node(result + " = resize %x, %scale, %offset, %border {mode=nearest} : i8[1,4,4,2]");
}

TEST_F(PassTest, CopyViewsGivesEachConvolutionAnUpsamplingOfItsOwn) {
  const std::string pad = node("%p = pad %big.1, %none, %zp : i8[1,4,4,2]");
  expect_change(
      "copy-views",
      upsampled(upsample("%big") + conv("%a", "%big") +
                    node("%p = pad %big, %none, %zp : i8[1,4,4,2]") + conv("%c", "%p"),
                "%a, %c"),
      upsampled(upsample("%big") + upsample("%big.1") + conv("%a", "%big") + pad + conv("%c", "%p"),
                "%a, %c"));
}

TEST_F(PassTest, CopyViewsKeepsAnUpsamplingThatSomebodyElseNeeds) {
  const std::string two = upsample("%big") + conv("%a", "%big") + conv("%c", "%big");
  expect_untouched("copy-views", upsampled(two, "%a, %c, %big"));
  expect_untouched("copy-views",
                   upsampled(two + node("%n = abs %c : i32[1,4,4,2]") +
                                 node("%d = clamp %big {min_val=0, max_val=5} : i8[1,4,4,2]"),
                             "%a, %n, %d"));
  // A padding that two convolutions read.
  expect_untouched("copy-views", upsampled(upsample("%big") + conv("%a", "%big") +
                                               node("%p = pad %big, %none, %zp : i8[1,4,4,2]") +
                                               conv("%c", "%p") + conv("%d", "%p"),
                                           "%a, %c, %d"));
  expect_untouched("copy-views", upsampled(upsample("%big") + conv("%a", "%big"), "%a"));
}

TEST_F(PassTest, FuseElementwiseTakesTheWholeEpilogue) {
  const auto text = [](const std::string& g) {
    return network(conv("%acc", "%x", g) + rescale("%q", "%acc", g) +
                       node("%y = clamp %q {min_val=0, max_val=127} : i8[1,4,4,2]", g),
                   "%y");
  };
  expect_change("fuse-elementwise", text(""), text(" @1"));
}

TEST_F(PassTest, FuseElementwiseKeepsAValueWithTwoUsers) {
  expect_untouched("fuse-elementwise", network(conv("%acc", "%x") + rescale("%q", "%acc") +
                                                   node("%n = abs %acc : i32[1,4,4,2]"),
                                               "%q, %n"));
}

TEST_F(PassTest, FuseElementwiseTakesAValueThatOneNodeReadsTwice) {
  const auto text = [](const std::string& g) {
    return network(conv("%acc", "%x", g) + node("%y = add %acc, %acc : i32[1,4,4,2]", g), "%y");
  };
  expect_change("fuse-elementwise", text(""), text(" @1"));
}

TEST_F(PassTest, FuseElementwiseKeepsGraphOutputs) {
  expect_untouched("fuse-elementwise",
                   network(conv("%acc", "%x") + rescale("%q", "%acc"), "%acc, %q"));
}

TEST_F(PassTest, FuseElementwiseJoinsOneOfTwoHeads) {
  expect_change(
      "fuse-elementwise",
      network(conv("%a", "%x") + conv("%c", "%x2") + node("%y = add %a, %c : i32[1,4,4,2]"), "%y"),
      network(conv("%a", "%x", " @1") + conv("%c", "%x2") +
                  node("%y = add %a, %c : i32[1,4,4,2]", " @1"),
              "%y"));
}

TEST_F(PassTest, FuseElementwiseJoinsChainsWithoutAHead) {
  const auto text = [](const std::string& g) {
    return network(node("%a = cast %x : i32[1,4,4,2]", g) +
                       node("%c = cast %x2 : i32[1,4,4,2]", g) +
                       node("%y = add %a, %c : i32[1,4,4,2]", g),
                   "%y");
  };
  expect_change("fuse-elementwise", text(""), text(" @1"));
}

TEST_F(PassTest, FuseElementwiseKeepsBroadcastOperands) {
  expect_untouched("fuse-elementwise", R"(graph main {
  input %x : i32[4,3]
  input %row : i32[1,3]
  %r = abs %row : i32[1,3]
  %y = add %x, %r : i32[4,3]
  return %y
})");
}

TEST_F(PassTest, FuseElementwiseLeavesViewsToTheOtherPass) {
  expect_untouched("fuse-elementwise", network(node("%r = reverse %x {axis=1} : i8[1,4,4,2]") +
                                                   node("%y = bitwise_not %r : i8[1,4,4,2]"),
                                               "%y"));
}

TEST_F(PassTest, FuseElementwiseBindsATwelfthBufferButNoThirteenth) {
  const auto text = [](int operands) {
    std::string inputs, lines, previous = "%x0";
    for (int i = 0; i < operands; ++i) inputs += fmt::format("  input %x{} : i32[2]\n", i);
    for (int i = 1; i < operands; ++i) {
      lines += fmt::format("  %v{} = maximum {}, %x{} : i32[2]\n", i, previous, i);
      previous = fmt::format("%v{}", i);
    }
    return "graph main {\n" + inputs + lines + "  return " + previous + "\n}";
  };
  const auto groups = [](const std::string& after) {
    return collect_groups(graph_of(after)).size();
  };
  EXPECT_EQ(groups(run_pass("fuse-elementwise", text(12)).text), 1u);
  EXPECT_EQ(groups(run_pass("fuse-elementwise", text(13)).text), 2u);
}

TEST_F(PassTest, FuseViewsFoldsIntoTheAddressingOfAConvolution) {
  const auto padded = [](const std::string& g) {
    return network("  const %p : shape[8] = [0,0,0,1,1,0,0,0]\n" +
                       node("%v = pad %x, %p, %zp : i8[1,5,5,2]", g) +
                       node("%y = conv2d %v, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], "
                            "dilation=[1,1], acc_type=i32} : i32[1,5,5,2]",
                            g),
                   "%y");
  };
  expect_change("fuse-views", padded(""), padded(" @1"));
  const auto resized = [](const std::string& g) {
    return network(
        "  const %r : shape[4] = [2,1,2,1]\n  const %o : shape[2] = [0,0]\n  const %e : shape[2] = "
        "[1,1]\n" +
            node("%v = resize %x, %r, %o, %e {mode=nearest} : i8[1,8,8,2]", g) +
            node("%y = conv2d %v, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], "
                 "acc_type=i32} : i32[1,8,8,2]",
                 g),
        "%y");
  };
  expect_change("fuse-views", resized(""), resized(" @1"));
  const auto joined = [](const std::string& g) {
    return network("  const %w4 : i8[2,1,1,4] = [1,2,3,4,5,6,7,8]\n" +
                       node("%v = concat %x, %x2 {axis=3} : i8[1,4,4,4]", g) +
                       node("%y = conv2d %v, %w4, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], "
                            "dilation=[1,1], acc_type=i32} : i32[1,4,4,2]",
                            g),
                   "%y");
  };
  expect_change("fuse-views", joined(""), joined(" @1"));
}

TEST_F(PassTest, FuseViewsFoldsViewsOfViewsAndElementwiseReaders) {
  const auto text = [](const std::string& g) {
    return network(node("%r = reverse %x {axis=1} : i8[1,4,4,2]", g) +
                       node("%t = transpose %r {perms=[0,2,1,3]} : i8[1,4,4,2]", g) +
                       node("%y = bitwise_not %t : i8[1,4,4,2]", g),
                   "%y");
  };
  expect_change("fuse-views", text(""), text(" @1"));
}

TEST_F(PassTest, FuseViewsFoldsIntoAnEpilogue) {
  const auto text = [](const std::string& conv_group, const std::string& g) {
    return network(conv("%acc", "%x", conv_group) + rescale("%q", "%acc", conv_group) +
                       node("%r = reverse %x2 {axis=1} : i8[1,4,4,2]", g) +
                       node("%y = bitwise_and %q, %r : i8[1,4,4,2]", conv_group),
                   "%y");
  };
  expect_change("fuse-views", text(" @1", ""), text(" @1", " @1"));
}

TEST_F(PassTest, FuseViewsKeepsOtherHeadsAndOtherViews) {
  // A pool reads every element several times; index arithmetic would repeat.
  expect_untouched(
      "fuse-views",
      network(
          "  const %p : shape[8] = [0,0,0,1,1,0,0,0]\n" +
              node("%v = pad %x, %p, %zp : i8[1,5,5,2]") +
              node("%y = max_pool2d %v {kernel=[2,2], stride=[1,1], pad=[0,0,0,0]} : i8[1,4,4,2]"),
          "%y"));
  expect_untouched(
      "fuse-views",
      network(node("%v = reverse %x {axis=1} : i8[1,4,4,2]") + conv("%y", "%v"), "%y"));
}

TEST_F(PassTest, FuseViewsKeepsAViewOfTheWeights) {
  expect_untouched("fuse-views", R"(graph main {
  input %x : i8[1,4,4,2]
  input %w1 : i8[1,1,1,2]
  const %b : i32[2] = [5,6]
  const %zp : i8[1] = [0]
  %w = concat %w1, %w1 {axis=0} : i8[2,1,1,2]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,4,4,2]
  return %y
})");
}

TEST_F(PassTest, FuseViewsKeepsViewsThatOthersSee) {
  expect_untouched("fuse-views", network(node("%r = reverse %x {axis=1} : i8[1,4,4,2]") +
                                             node("%y = bitwise_not %r : i8[1,4,4,2]") +
                                             node("%z2 = bitwise_and %r, %x2 : i8[1,4,4,2]"),
                                         "%y, %z2"));
  expect_untouched("fuse-views", network(node("%r = reverse %x {axis=1} : i8[1,4,4,2]") +
                                             node("%y = bitwise_not %r : i8[1,4,4,2]"),
                                         "%r, %y"));
}

TEST_F(PassTest, FuseViewsLeavesProducersOfViewsAlone) {
  // The reverse could only read the convolution's result from memory.
  expect_untouched(
      "fuse-views",
      network(conv("%acc", "%x") + node("%y = reverse %acc {axis=1} : i32[1,4,4,2]"), "%y"));
}

// Groups and pipeline

TEST(Groups, ComeInAnOrderInWhichTheyCanRun) {
  // Group 2 begins before group 1 ends, and reads its result.
  const Graph graph = graph_of(R"(graph main {
  input %x : i32[2]
  input %z : i32[2]
  %a = abs %z : i32[2] @2
  %b = abs %x : i32[2] @1
  %c = clz %b : i32[2] @1
  %d = abs %c : i32[2]
  %y = add %a, %d : i32[2] @2
  return %y
})");
  const std::vector<Group> groups = collect_groups(graph);
  ASSERT_EQ(groups.size(), 3u);
  EXPECT_EQ(groups[0].nodes, (std::vector<NodeId>{{1}, {2}}));
  EXPECT_EQ(groups[1].nodes, (std::vector<NodeId>{{3}}));
  EXPECT_EQ(groups[2].nodes, (std::vector<NodeId>{{0}, {4}}));
  EXPECT_EQ(graph.value(groups[2].result).name, "y");
  EXPECT_FALSE(groups[0].head);
}

std::string two_layers() {
  return network("  const %dead : i8[1] = [3]\n" + conv("%a", "%x") + rescale("%q", "%a") +
                     node("%i = identity %q : i8[1,4,4,2]") +
                     "  const %p : shape[8] = [0,0,1,1,1,1,0,0]\n" +
                     node("%pad = pad %i, %p, %zp : i8[1,6,6,2]") +
                     "  const %w3 : i8[2,3,3,2] = "
                     "[1,-2,3,-4,5,-6,7,-8,9,1,-2,3,-4,5,-6,7,-8,9,1,-2,3,-4,5,-6,7,-8,9,1,-2,3,-4,"
                     "5,-6,7,-8,9]\n"
                     "  const %zp5 : i8[1] = [5]\n" +
                     node("%c = conv2d %pad, %w3, %b, %zp5, %zp {pad=[0,0,0,0], stride=[1,1], "
                          "dilation=[1,1], acc_type=i32} : i32[1,4,4,2]") +
                     rescale("%r", "%c") + node("%unused = bitwise_not %dead : i8[1]") +
                     node("%y = clamp %r {min_val=-100, max_val=100} : i8[1,4,4,2]"),
                 "%y");
}

TEST(Pipeline, RunsItsPassesInOrderAndReportsEach) {
  Graph graph = graph_of(two_layers());
  const Graph before = graph;
  std::vector<std::string> seen;
  const auto timings = must(run_pipeline(
      graph, {},
      {.optimize = true, .verify_each = true, .after = [&](std::string_view pass, const Graph&) {
         seen.emplace_back(pass);
       }}));
  const std::vector<std::string> order{"infer-shapes",     "expand-fft",  "fold-constants",
                                       "remove-identity",  "merge-equal", "fold-zero-point",
                                       "fold-constants",   "remove-dead", "copy-views",
                                       "fuse-elementwise", "fuse-views"};
  EXPECT_EQ(seen, order);
  ASSERT_EQ(timings.size(), order.size());
  for (size_t i = 0; i < order.size(); ++i) EXPECT_EQ(timings[i].pass, order[i]);
  expect_same_results(before, graph);
  const std::vector<Group> groups = collect_groups(graph);
  ASSERT_EQ(groups.size(), 2u) << print_text(graph);
  EXPECT_EQ(groups[0].nodes.size(), 2u);
  EXPECT_EQ(groups[1].nodes.size(), 4u);  // pad, conv2d, rescale, clamp
}

TEST(Pipeline, WithoutOptimizationOnlyDoesWhatIsNeeded) {
  Graph graph = graph_of(two_layers());
  const std::string before = print_text(graph);
  const auto timings =
      must(run_pipeline(graph, {}, {.optimize = false, .verify_each = false, .after = {}}));
  ASSERT_EQ(timings.size(), 2u);
  EXPECT_EQ(timings[0].pass, "infer-shapes");
  EXPECT_EQ(timings[0].change, Change::kNone);
  EXPECT_EQ(timings[1].pass, "expand-fft");
  EXPECT_EQ(print_text(graph), before);
}

TEST(Pipeline, ReachesAFixedPoint) {
  Graph graph = graph_of(two_layers());
  must(run_pipeline(graph, {}, {}));
  // The second run may still merge constants that fold-zero-point made; the third finds nothing.
  must(run_pipeline(graph, {}, {}));
  const std::string text = print_text(graph);
  for (const PassTiming& timing : must(run_pipeline(graph, {}, {})))
    EXPECT_EQ(timing.change, Change::kNone) << timing.pass;
  EXPECT_EQ(print_text(graph), text);
}

TEST(Pipeline, RefusesAnIllegalGraph) {
  Graph graph = must(
      parse_text("graph main {\n  input %x : i8[2]\n  %y = add %x, %x : i8[2]\n  return %y\n}"));
  EXPECT_NE(error_text(run_pipeline(graph, {}, {})).find("node %0 \"y\" (add)"), std::string::npos);
}

}  // namespace
}  // namespace shale
