// Static bounds of accumulators: sound, tight, and what follows from them.
#include <gtest/gtest.h>

#include <algorithm>

#include "compiler/driver/compile.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

constexpr int64_t kFloatExact = int64_t{1} << 24;

/// The proof of the only group with a convolution.
RangeProof proof_of(const Graph& graph) {
  for (const Group& group : collect_groups(graph))
    if (const auto proof = prove_ranges(graph, group)) return *proof;
  ADD_FAILURE() << "no proof";
  return {};
}

/// A convolution of any kind over `x` whose accumulator is the output; zero points as given.
std::string conv_text(const std::string& op, const std::string& input, const std::string& weight,
                      const std::string& bias, const std::string& attributes,
                      const std::string& result, int zp, int wzp) {
  return "graph main {\n  input %x : " + input + "\n  const %w : " + weight +
         "\n  const %b : " + bias +
         fmt::format("\n  const %zp : i8[1] = [{}]\n  const %wzp : i8[1] = [{}]\n", zp, wzp) +
         "  %y = " + op + " %x, %w, %b, %zp, %wzp {" + attributes + ", acc_type=i32} : " + result +
         "\n  return %y\n}";
}

std::vector<Graph> all_convolutions() {
  std::vector<Graph> graphs;
  for (const auto& [zp, wzp] : {std::pair{0, 0}, {-128, 0}, {127, 3}, {5, -128}}) {
    graphs.push_back(graph_of(conv_text(
        "conv2d", "i8[2,4,3,2]", "i8[2,2,1,2] = [1,-2,3,127,-128,0,5,6]", "i32[2] = [1000,-7]",
        "pad=[1,0,0,1], stride=[1,1], dilation=[1,1]", "i32[2,4,4,2]", zp, wzp)));
    graphs.push_back(graph_of(conv_text(
        "depthwise_conv2d", "i8[1,3,3,2]", "i8[1,2,2,2] = [1,-2,3,127,-128,0,5,6]", "i32[1] = [9]",
        "pad=[0,0,1,1], stride=[1,1], dilation=[1,1]", "i32[1,3,4,4]", zp, wzp)));
    graphs.push_back(graph_of(
        conv_text("transpose_conv2d", "i8[1,3,3,2]", "i8[2,2,1,2] = [1,-2,3,127,-128,0,5,6]",
                  "i32[2] = [9,-9]", "out_pad=[0,-1,0,2], stride=[2,1]", "i32[1,5,5,2]", zp, wzp)));
    graphs.push_back(graph_of(conv_text(
        "conv3d", "i8[1,3,2,2,2]", "i8[1,2,2,1,2] = [1,-2,3,127,-128,0,5,6]", "i32[1] = [9]",
        "pad=[0,1,0,0,0,0], stride=[1,1,1], dilation=[1,1,1]", "i32[1,3,1,2,1]", zp, wzp)));
  }
  return graphs;
}

TEST(RangeProof, IsSound) {
  for (const Graph& graph : all_convolutions()) {
    const RangeProof proof = proof_of(graph);
    const size_t channels = static_cast<size_t>(graph.value(graph.outputs[0]).type.shape.back());
    ASSERT_EQ(proof.min.size(), channels);
    for (uint64_t seed = 1; seed <= 20; ++seed) {
      std::vector<Tensor> inputs = random_inputs(graph, seed);
      if (seed > 5)  // only limits: the largest sums
        for (int64_t i = 0; i < inputs[0].count(); ++i)
          inputs[0].set(i, inputs[0].get(i) < 0 ? -128 : 127);
      const std::vector<Tensor> outputs = must(interpret(graph, inputs));
      for (int64_t i = 0; i < outputs[0].count(); ++i) {
        const size_t c = static_cast<size_t>(i) % channels;
        ASSERT_GE(outputs[0].get(i), proof.min[c]) << print_text(graph);
        ASSERT_LE(outputs[0].get(i), proof.max[c]) << print_text(graph);
      }
    }
  }
}

TEST(RangeProof, BoundsEveryPartialSumOfRawProducts) {
  // Kernels multiply raw bytes, in any order; a padded tap reads the zero point.
  std::mt19937_64 random(5);
  for (const int zp : {-128, 0, 90}) {
    const Graph graph = graph_of(
        conv_text("conv2d", "i8[1,1,1,8]", "i8[1,1,1,8] = [1,-2,3,127,-128,0,5,6]", "i32[1] = [77]",
                  "pad=[0,0,0,0], stride=[1,1], dilation=[1,1]", "i32[1,1,1,1]", zp, 3));
    const int64_t magnitude = proof_of(graph).magnitude[0];
    const std::vector<int64_t> weights = graph.value(*graph.find_value("w")).constant->ints();
    int64_t reached = 0;
    for (int round = 0; round < 3000; ++round) {
      int64_t sum = 0;
      for (size_t i = 0; i < weights.size(); ++i) {
        const int64_t w = weights[i] - 3;
        // One of: left out so far, the limits, anything.
        const int64_t x = random() % 4 == 0   ? 0
                          : random() % 2 == 0 ? (w < 0 ? 127 : -128)
                                              : static_cast<int8_t>(random());
        sum += x * w;
      }
      reached = std::max(reached, std::abs(sum));
      ASSERT_LE(std::abs(sum), magnitude);
    }
    EXPECT_GT(reached, magnitude / 2);
  }
}

TEST(RangeProof, IsTight) {
  // One window over the whole input: every product can be at its limit at once.
  for (const auto& [zp, wzp] : {std::pair{0, 0}, {-128, 0}, {127, 3}, {5, -128}}) {
    const Graph graph =
        graph_of(conv_text("conv2d", "i8[1,2,1,3]",
                           "i8[2,2,1,3] = [1,-2,3,127,-128,0,5,6,-7,8,9,-10]", "i32[2] = [1000,-7]",
                           "pad=[0,0,0,0], stride=[1,1], dilation=[1,1]", "i32[1,1,1,2]", zp, wzp));
    const RangeProof proof = proof_of(graph);
    const std::vector<int64_t> weights = graph.value(*graph.find_value("w")).constant->ints();
    for (size_t c = 0; c < 2; ++c) {
      for (const bool largest : {false, true}) {
        Tensor input = Tensor::zeros({DType::kInt8, {1, 2, 1, 3}});
        // A product of (x - zp): x at the limit, or at the zero point, whichever is the extreme
        // one.
        for (size_t i = 0; i < 6; ++i) {
          const int64_t w = weights[c * 6 + i] - wzp;
          input.set(static_cast<int64_t>(i), (w > 0) == largest ? 127 : -128);
        }
        const int64_t found =
            must(interpret(graph, std::vector{input}))[0].get(static_cast<int64_t>(c));
        EXPECT_EQ(found, largest ? proof.max[c] : proof.min[c])
            << "channel " << c << ", zero points " << zp << " and " << wzp;
      }
    }
  }
}

TEST(RangeProof, UsesWhatIsKnownOfTheInput) {
  const std::string text = R"(graph main {
  input %x : i8[1,1,1,2]
  const %w : i8[1,1,1,2] = [10,-10]
  const %b : i32[1] = [0]
  const %zp : i8[1] = [0]
  %c = clamp %x {min_val=-5, max_val=7} : i8[1,1,1,2]
  %y = conv2d %c, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,1,1,1]
  return %y
})";
  const RangeProof proof = proof_of(graph_of(text));
  EXPECT_EQ(proof.min[0], -120);
  EXPECT_EQ(proof.max[0], 120);
  EXPECT_EQ(proof.magnitude[0], 10 * (7 + 128));
}

TEST(RangeProof, NeedsConstantWeightsAndBias) {
  for (const char* inputs : {"input %w : i8[1,1,1,2]\n const %b : i32[1] = [0]",
                             "const %w : i8[1,1,1,2] = [1,2]\n input %b : i32[1]"}) {
    const Graph graph = graph_of(
        std::string("graph main {\n input %x : i8[1,1,1,2]\n const %zp : i8[1] = [0]\n ") + inputs +
        "\n %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], "
        "acc_type=i32}"
        " : i32[1,1,1,1]\n return %y\n}");
    EXPECT_FALSE(prove_ranges(graph, collect_groups(graph)[0]));
  }
  const Graph pool = graph_of(
      "graph main {\n input %x : i8[1,2,2,1]\n %y = max_pool2d %x {kernel=[2,2], stride=[1,1], "
      "pad=[0,0,0,0]} : i8[1,1,1,1]\n return %y\n}");
  EXPECT_FALSE(prove_ranges(pool, collect_groups(pool)[0]));
}

TEST(ValueRange, FollowsViewsClampsAndTables) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,2,2,1]
  input %i : i16[3]
  const %zp : i8[1] = [20]
  const %p : shape[8] = [0,0,1,0,0,0,0,0]
  const %r : shape[4] = [2,1,2,1]
  const %o : shape[2] = [0,0]
  const %e : shape[2] = [1,1]
  const %known : i8[1,1,2,1] = [-100,3]
  %c = clamp %x {min_val=-5, max_val=7} : i8[1,2,2,1]
  %outer = clamp %c {min_val=0, max_val=100} : i8[1,2,2,1]
  %above = clamp %c {min_val=50, max_val=60} : i8[1,2,2,1]
  %padded = pad %c, %p, %zp : i8[1,3,2,1]
  %near = resize %c, %r, %o, %e {mode=nearest} : i8[1,4,4,1]
  %linear = resize %c, %r, %o, %e {mode=bilinear} : i32[1,4,4,1]
  %joined = concat %c, %known {axis=1} : i8[1,3,2,1]
  %top = max_pool2d %c {kernel=[2,2], stride=[1,1], pad=[0,0,0,0]} : i8[1,1,1,1]
  %wide = clamp %i {min_val=-32768, max_val=300} : i16[3]
  %not = bitwise_not %c : i8[1,2,2,1]
  return %outer, %above, %padded, %near, %linear, %joined, %top, %wide, %not
})");
  const auto range = [&](const char* name) { return value_range(graph, *graph.find_value(name)); };
  EXPECT_EQ(range("x"), (IntRange{-128, 127}));
  EXPECT_EQ(range("known"), (IntRange{-100, 3}));
  EXPECT_EQ(range("c"), (IntRange{-5, 7}));
  EXPECT_EQ(range("outer"), (IntRange{0, 7}));
  EXPECT_EQ(range("above"), (IntRange{50, 50}));
  EXPECT_EQ(range("padded"), (IntRange{-5, 20}));
  EXPECT_EQ(range("near"), (IntRange{-5, 7}));
  EXPECT_EQ(range("linear"), dtype_range(DType::kInt32));
  EXPECT_EQ(range("joined"), (IntRange{-100, 7}));
  EXPECT_EQ(range("top"), (IntRange{-5, 7}));
  EXPECT_EQ(range("wide"), (IntRange{-32768, 300}));
  EXPECT_EQ(range("not"), (IntRange{-128, 127}));
}

// What the driver makes of it.

CompileOptions plain_options() {
  CompileOptions options;
  options.optimize_spirv = false;
  return options;
}

TEST(RangeProof, NamesTheChannelThatMayLeaveInt32) {
  const Graph graph = graph_of(conv_text(
      "conv2d", "i8[1,1,1,1]", "i8[3,1,1,1] = [1,1,1]", "i32[3] = [0,2147483521,-2147483648]",
      "pad=[0,0,0,0], stride=[1,1], dilation=[1,1]", "i32[1,1,1,3]", 0, 0));
  CompileOptions options = plain_options();
  const Compiled compiled = must(compile_graph(graph, 0, options));
  ASSERT_EQ(compiled.warnings.size(), 1u);
  EXPECT_EQ(
      compiled.warnings[0],
      "node %0 \"y\" (conv2d): channel 1 may leave int32: its accumulator is only known to lie in "
      "2147483393..2147483648");
  options.require_proof = true;
  EXPECT_EQ(error_text(compile_graph(graph, 0, options)),
            "--require-proof: " + compiled.warnings[0]);
}

TEST(RangeProof, AcceptsBoundsAtTheLimitsOfInt32) {
  CompileOptions options = plain_options();
  options.require_proof = true;
  const Graph graph = graph_of(
      conv_text("conv2d", "i8[1,1,1,1]", "i8[2,1,1,1] = [1,1]", "i32[2] = [2147483520,-2147483520]",
                "pad=[0,0,0,0], stride=[1,1], dilation=[1,1]", "i32[1,1,1,2]", 0, 0));
  EXPECT_TRUE(must(compile_graph(graph, 0, options)).warnings.empty());
}

TEST(RangeProof, NamesAConvolutionThatCannotBeBounded) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,1,1,2]
  input %w : i8[1,1,1,2]
  const %b : i32[1] = [0]
  const %zp : i8[1] = [0]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,1,1,1]
  return %y
})");
  CompileOptions options = plain_options();
  EXPECT_EQ(must(compile_graph(graph, 0, options)).warnings.size(), 1u);
  options.require_proof = true;
  EXPECT_EQ(error_text(compile_graph(graph, 0, options)),
            "--require-proof: node %0 \"y\" (conv2d): weights or bias are no constants, so its "
            "accumulators cannot be bounded");
}

TEST(RangeProof, GoesIntoThePackage) {
  const Compiled compiled =
      must(compile_graph(ConvCase{.name = "plain"}.graph(), 0, plain_options()));
  const std::vector<RangeProof>& proofs = compiled.package.variants[0].proofs;
  ASSERT_EQ(proofs.size(), 1u);
  EXPECT_EQ(proofs[0].name, "acc");
  const RangeProof expected = proof_of(compiled.graph);
  EXPECT_EQ(proofs[0].min, expected.min);
  EXPECT_EQ(proofs[0].max, expected.max);
  EXPECT_EQ(proofs[0].magnitude, expected.magnitude);
}

TEST(RangeProof, DecidesBetweenFloatAndInteger) {
  // channels * 128 * 255 reaches 2^24 with 515 channels.
  for (const int64_t ic : {514, 515}) {
    const Graph graph = ConvCase{.name = "limit",
                                 .h = 1,
                                 .w = 1,
                                 .ic = ic,
                                 .oc = 1,
                                 .kh = 1,
                                 .kw = 1,
                                 .pad = {0, 0, 0, 0},
                                 .epilogue = Epilogue::kNone,
                                 .weight_min = -128,
                                 .weight_max = -128}
                            .graph();
    const int64_t magnitude = proof_of(graph).magnitude[0];
    EXPECT_EQ(magnitude, ic * 128 * 255);
    EXPECT_EQ(magnitude < kFloatExact, ic == 514);
    CompileOptions options = plain_options();
    options.kernels = {"conv2d_s8_f32exact"};
    const Compiled compiled = must(compile_graph(graph, 0, options));
    EXPECT_EQ(compiled.package.variants[0].segments[0].dispatches[0].kernel,
              ic == 514 ? "conv2d_s8_f32exact" : "generic");
  }
}

}  // namespace
}  // namespace shale
