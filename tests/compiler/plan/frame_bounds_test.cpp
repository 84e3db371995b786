// Bounds of a network's values and of a frame's histories: sound, tight where they can be, and a fixed point.
#include "compiler/plan/frame_bounds.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/compiler/frame_support.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

using Channels = std::vector<IntRange>;

std::string constant(const std::string& name, const std::string& type, int count,
                     std::mt19937_64& random, int low, int high) {
  std::string values;
  for (int i = 0; i < count; ++i)
    values += fmt::format("{}{}", i ? "," : "",
                          low + static_cast<int>(random() % static_cast<uint64_t>(high - low + 1)));
  return fmt::format("  const %{} : {} = [{}]\n", name, type, values);
}

/// Every operator that is followed: convolutions with padding, a rescale a channel, table, clamp, pool, resize, concat, pad.
std::string network(uint64_t seed) {
  std::mt19937_64 random(seed);
  return "graph main {\n  input %x : i8[1,4,6,3]\n" +
         constant("w", "i8[4,3,3,3]", 108, random, -128, 127) +
         constant("b", "i32[4]", 4, random, -20000, 20000) +
         constant("dw", "i8[3,3,4,2]", 72, random, -127, 127) +
         constant("db", "i32[8]", 8, random, -3000, 3000) +
         constant("t", "i8[256]", 256, random, -128, 127) +
         "  const %zp : i8[1] = [-7]\n  const %wzp : i8[1] = [0]\n  const %azp : i32[1] = [0]\n  "
         "const %ozp : i8[1] = [11]\n" +
         constant("m", "i32[4]", 4, random, 1 << 29, 1 << 30) +
         "  const %s : i8[4] = [38,40,39,41]\n" +
         "  const %m1 : i32[1] = [1173741824]\n  const %s1 : i8[1] = [43]\n"
         "  const %edge : shape[8] = [0,0,1,1,0,1,0,0]\n  const %fill : i8[1] = [90]\n"
         "  const %scale : shape[4] = [2,1,2,1]\n  const %none : shape[2] = [0,0]\n"
         "  %p = pad %x, %edge, %fill : i8[1,6,7,3]\n"
         "  %a = conv2d %p, %w, %b, %zp, %wzp {pad=[1,1,1,1], stride=[1,1], dilation=[1,1], "
         "acc_type=i32} : i32[1,6,7,4]\n"
         "  %r = rescale %a, %m, %s, %azp, %ozp {scale32=true, rounding_mode=single, "
         "per_channel=true} : i8[1,6,7,4]\n"
         "  %u = resize %r, %scale, %none, %none {mode=nearest} : i8[1,11,13,4]\n"
         "  %d = depthwise_conv2d %u, %dw, %db, %ozp, %wzp {pad=[1,1,1,1], stride=[1,1], "
         "dilation=[1,1], acc_type=i32} : i32[1,11,13,8]\n"
         "  %e = rescale %d, %m1, %s1, %azp, %ozp {scale32=true, rounding_mode=double, "
         "per_channel=false} : i8[1,11,13,8]\n"
         "  %k = clamp %e {min_val=-60, max_val=90, nan_mode=propagate} : i8[1,11,13,8]\n"
         "  %l = table %u, %t : i8[1,11,13,4]\n"
         "  %y = concat %k, %l {axis=3} : i8[1,11,13,12]\n  return %y, %r\n}";
}

TEST(GraphBounds, HoldWhateverTheInputs) {
  for (uint64_t seed = 1; seed <= 12; ++seed) {
    const Graph graph = graph_of(network(seed));
    std::mt19937_64 random(seed);
    Channels input;
    for (int c = 0; c < 3; ++c) {
      const int64_t a = static_cast<int64_t>(random() % 256) - 128,
                    b = static_cast<int64_t>(random() % 256) - 128;
      input.push_back({std::min(a, b), std::max(a, b)});
    }
    const std::vector<Channels> bounds = graph_bounds(graph, std::vector<Channels>{input});
    ASSERT_EQ(bounds.size(), 2u);
    ASSERT_EQ(bounds[0].size(), 12u);
    for (int round = 0; round < 20; ++round) {
      Tensor x = Tensor::zeros(graph.value(graph.inputs[0]).type);
      for (int64_t i = 0; i < x.count(); ++i) {
        const IntRange& range = input[static_cast<size_t>(i) % 3];
        // Mostly the ends: those give the largest sums.
        x.set(i, random() % 4 == 0
                     ? range.min + static_cast<int64_t>(
                                       random() % static_cast<uint64_t>(range.max - range.min + 1))
                 : random() % 2 == 0 ? range.min
                                     : range.max);
      }
      const std::vector<Tensor> outputs = must(interpret(graph, std::vector{x}));
      for (size_t o = 0; o < outputs.size(); ++o)
        for (int64_t i = 0; i < outputs[o].count(); ++i) {
          const IntRange& range = bounds[o][static_cast<size_t>(i) % bounds[o].size()];
          ASSERT_TRUE(outputs[o].get(i) >= range.min && outputs[o].get(i) <= range.max)
              << "seed " << seed << " output " << o << " element " << i;
        }
    }
  }
}

TEST(GraphBounds, AreReachedByOneConvolution) {
  const Graph graph = graph_of(R"(graph main {
  input %x : i8[1,1,1,2]
  const %w : i8[2,1,1,2] = [3,-2,-5,0]
  const %b : i32[2] = [10,-1]
  const %zp : i8[1] = [0]
  %y = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,1,1,2]
  return %y
})");
  // Without padding the ranges that hold 0 are met at their ends.
  EXPECT_EQ(graph_bounds(graph, std::vector<Channels>{Channels{{-4, 6}, {-1, 2}}})[0],
            (Channels{{10 - 12 - 4, 10 + 18 + 2}, {-1 - 30, -1 + 20}}));
}

TEST(GraphBounds, WhatIsNotFollowedIsItsType) {
  const Graph graph = graph_of(
      "graph main {\n input %x : i8[1,2,2,2]\n %y = bitwise_not %x : i8[1,2,2,2]\n return %y\n}");
  EXPECT_EQ(graph_bounds(graph, std::vector<Channels>{Channels{{0, 0}}})[0],
            (Channels{{-128, 127}, {-128, 127}}));
}

/// kFrame with contracts of its passes, around a network that clamps.
Result<Compiled> compiled_with(const std::string& pre, const std::string& post,
                               const std::string& clamp) {
  std::string json = replaced(kFrame, "\"writes\": [\"x\"]", "\"writes\": [\"x\"]" + pre);
  json = replaced(json, "\"writes\": [\"kept\"]", "\"writes\": [\"kept\"]" + post);
  return compile_frame(frame_options(json),
                       "graph main {\n input %x : i8[1,6,10,4]\n %y = clamp %x {" + clamp +
                           ", nan_mode=propagate} : i8[1,6,10,4]\n return %y\n}");
}

std::string bounds_text(const Variant& variant) {
  std::string text;
  for (const ValueBounds& bounds : variant.bounds) {
    text += variant.resources[bounds.resource].name;
    for (size_t c = 0; c < bounds.low.size(); ++c)
      text += fmt::format(" {:g}..{:g}", bounds.low[c], bounds.high[c]);
    text += "; ";
  }
  return text;
}

TEST(FrameBounds, FollowTheRecurrenceToAFixedPoint) {
  // x is kept, as codes of scale 0.5 and zero point -3; y clamps them; kept is what y was, or 0 to 4.
  const Compiled compiled =
      must(compiled_with(", \"bounds\": {\"x\": [\"old\", [0, 3]]}",
                         ", \"bounds\": {\"kept\": [\"y\", [0, 4]]}", "min_val=-20, max_val=50"));
  // kept grows with each round until the clamp holds: y -20 to 50,
  // kept too, x 2 * -20 - 3 to 2 * 50 - 3.
  EXPECT_EQ(bounds_text(compiled.package.variants[0]), "x -43..97; y -20..50; kept -20..50; ");
  EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
  EXPECT_NE(dump_package(compiled.package).find("\"kept\": -20..50\n"), std::string::npos);
}

TEST(FrameBounds, AreOfChannelsWhereContractsAre) {
  const Compiled compiled = must(compiled_with(
      ", \"bounds\": {\"x\": [[0, 1], [0, 2], [[0, 0], \"old.1\"], [-1, 0]]}",
      ", \"bounds\": {\"kept\": [[0, 1], [0, 5], [0, 1], [1, 1]]}", "min_val=-128, max_val=127"));
  EXPECT_EQ(bounds_text(compiled.package.variants[0]),
            "x -3..0 -3..1 -3..7 -5..0; y -3..0 -3..1 -3..7 -5..0; kept 0..1 0..5 0..1 0..1; ");
}

TEST(FrameBounds, WhatNobodyPromisesIsNotBounded) {
  // Codes have the range of their type, halves have none.
  EXPECT_EQ(bounds_text(must(compiled_with("", "", "min_val=-5, max_val=9")).package.variants[0]),
            "x -128..127; y -5..9; ");
}

TEST(FrameBounds, BadContractsAreRefused) {
  const auto error = [](const std::string& pre) {
    return error_text(compiled_with(", \"bounds\": " + pre, "", "min_val=0, max_val=9"));
  };
  EXPECT_EQ(error("{\"x\": \"marks_\"}"),
            "pass \"pre\": the bounds name \"marks_\", which the pass does not read");
  EXPECT_EQ(error("{\"x\": \"color\"}"),
            "pass \"pre\": the bounds name \"color\", of which none are known");
  EXPECT_EQ(error("{\"x\": \"old.4\"}"),
            "pass \"pre\": the bounds name channel 4 of \"old\", which has 4");
  EXPECT_EQ(error("{\"x\": [[[0, 1]], [[0, 1]]]}"),
            "pass \"pre\": the bounds of \"x\" are of 2 channels, expected 1 or 4");
  const auto bad = [](const std::string& bounds) {
    return error_text(parse_frame(
        replaced(kFrame, "\"writes\": [\"x\"]", "\"writes\": [\"x\"], \"bounds\": " + bounds)));
  };
  EXPECT_EQ(bad("{\"y\": [0, 1]}"),
            "frame.passes[0].bounds.y: the pass writes nothing of that name");
  EXPECT_EQ(bad("{\"x\": [2, 1]}"), "frame.passes[0].bounds.x: 2 to 1 is no range");
  EXPECT_EQ(bad("{\"x\": \"old.a\"}"),
            "frame.passes[0].bounds.x: \"old.a\" has no channel behind its point");
  EXPECT_EQ(bad("{\"x\": true}"),
            "frame.passes[0].bounds.x: must hold ranges [low, high] and names");
  EXPECT_EQ(bad("[]"), "frame.passes[0]: \"bounds\" must be at most 64 names with ranges");
}

}  // namespace
}  // namespace shale
