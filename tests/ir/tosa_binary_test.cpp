#include <gtest/gtest.h>

#include <random>

#include "ir/binary/tosa.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"
#include "tests/ir/golden_files.h"
#include "tests/ir/node_case.h"

namespace shale {
namespace {

/// A model with constants of several types, a shape, lists and scalars among its attributes.
Graph small_model() {
  Result<Graph> graph = parse_text(R"(graph main {
  input %x : i8[1,4,4,2]
  const %w : i8[2,1,1,2] = [1,-2,3,4]
  const %w4 : i4[3] = [-7,7,0]
  const %b : i32[2] = [5,-6]
  const %big : i48[1] = [-140737488355328]
  const %flag : bool[2] = [1,0]
  const %zp : i8[1] = [0]
  const %p : shape[8] = [0,0,1,1,1,1,0,0]
  %y = pad %x, %p, %zp : i8[1,6,6,2]
  %c = conv2d %y, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,6,6,2]
  %d = clamp %y {min_val=-100, max_val=100, nan_mode=propagate} : i8[1,6,6,2]
  %e = identity %w4 : i4[3]
  return %c, %d, %e, %big, %flag
})");
  EXPECT_TRUE(graph) << graph.error().text();
  EXPECT_TRUE(verify(*graph)) << verify(*graph).error().text();
  return *std::move(graph);
}

TEST(TosaBinary, RoundTripsAllGoldenGraphs) {
  size_t count = 0;
  for (const GoldenFile& file : golden_files()) {
    const Result<Graph> graph = read_tosa(file.bytes);
    if (!graph) {
      EXPECT_FALSE(is_legal(file)) << file.name << ": " << graph.error().text();
      continue;
    }
    const Result<Graph> again = read_tosa(write_tosa(*graph));
    ASSERT_TRUE(again) << file.name << ": " << again.error().text();
    EXPECT_TRUE(*again == *graph) << file.name;
    // Written once, constants are first; from then on the bytes stay.
    const std::vector<uint8_t> bytes = write_tosa(*again);
    const Result<Graph> third = read_tosa(bytes);
    ASSERT_TRUE(third) << file.name;
    EXPECT_TRUE(write_tosa(*third) == bytes) << file.name;
    ++count;
  }
  EXPECT_GT(count, 0u);
  EXPECT_GE(count, 715u);
}

TEST(TosaBinary, RoundTripsASmallModel) {
  const Graph graph = small_model();
  const std::vector<uint8_t> bytes = write_tosa(graph);
  EXPECT_TRUE(is_tosa(bytes));
  const Result<Graph> again = read_tosa(bytes);
  ASSERT_TRUE(again) << again.error().text();
  EXPECT_TRUE(*again == graph) << print_text(*again);
}

TEST(TosaBinary, LosesOnlyTheGroups) {
  Graph graph = small_model();
  graph.nodes[1].group = 3;
  const Result<Graph> again = read_tosa(write_tosa(graph));
  ASSERT_TRUE(again);
  EXPECT_FALSE(*again == graph);
  graph.nodes[1].group = 0;
  EXPECT_TRUE(*again == graph);
}

TEST(TosaBinary, KeepsNamesOfAnyCharacters) {
  Graph graph;
  const ValueId x = graph.add_input("a \"b\"\n\xff%", {DType::kInt8, {2}});
  graph.outputs = {graph.add_node(Op::kBitwiseNot, {}, {x}, "d\xc3\xbcne", {DType::kInt8, {2}})};
  const Result<Graph> again = read_tosa(write_tosa(graph));
  ASSERT_TRUE(again) << again.error().text();
  EXPECT_TRUE(*again == graph);
}

TEST(TosaBinary, RefusesEveryCut) {
  std::vector<uint8_t> bytes = write_tosa(small_model());
  // The last string may be followed by zeros up to the alignment, which carry nothing.
  while (bytes.size() > 8) {
    const Result<Graph> shorter = read_tosa(std::span(bytes).first(bytes.size() - 1));
    if (!shorter) break;
    ASSERT_EQ(bytes.back(), 0);
    EXPECT_TRUE(*shorter == small_model());
    bytes.pop_back();
  }
  EXPECT_GT(bytes.size() + 8, write_tosa(small_model()).size());
  for (size_t length = 0; length < bytes.size(); ++length) {
    // A copy of its own, so that reading behind the end is seen by the tools that look for it.
    const std::vector<uint8_t> cut(bytes.begin(),
                                   bytes.begin() + static_cast<std::ptrdiff_t>(length));
    const Result<Graph> graph = read_tosa(cut);
    ASSERT_FALSE(graph) << "cut to " << length << " of " << bytes.size() << " bytes";
    EXPECT_EQ(graph.error().code, ErrorCode::kBadInput) << length;
  }
}

TEST(TosaBinary, RefusesOtherFiles) {
  std::vector<uint8_t> bytes = write_tosa(small_model());
  bytes[4] = 'X';
  EXPECT_FALSE(is_tosa(bytes));
  const Result<Graph> graph = read_tosa(bytes);
  ASSERT_FALSE(graph);
  EXPECT_EQ(graph.error().text(),
            "offset 4: found the file identifier \"XOSA\", expected \"TOSA\"");
}

/// Reads damaged bytes: an error, or a graph that the rest of the program can work with.
bool survives(const std::vector<uint8_t>& bytes) {
  const Result<Graph> graph = read_tosa(bytes);
  if (!graph) return !graph.error().text().empty();
  (void)verify(*graph);
  const Result<Graph> parsed = parse_text(print_text(*graph));
  if (parsed && !(*parsed == *graph)) return false;
  const Result<Graph> again = read_tosa(write_tosa(*graph));
  return !again || *again == *graph;
}

TEST(TosaBinary, SurvivesDamageOfEveryByte) {
  const std::vector<uint8_t> bytes = write_tosa(small_model());
  for (size_t at = 0; at < bytes.size(); ++at)
    for (const int change : {0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x40, 0x80, 0xff}) {
      std::vector<uint8_t> damaged = bytes;
      damaged[at] = static_cast<uint8_t>(damaged[at] ^ change);
      ASSERT_TRUE(survives(damaged)) << "byte " << at << " xor " << change;
    }
}

TEST(TosaBinary, SurvivesRandomDamageOfGoldenFiles) {
  std::mt19937_64 random(99);
  size_t count = 0;
  for (const GoldenFile& file : golden_files()) {
    if (file.bytes.size() > 3000 || file.bytes.size() < 16) continue;
    for (int round = 0; round < 8; ++round) {
      std::vector<uint8_t> damaged = file.bytes;
      for (uint64_t edits = 1 + random() % 6; edits > 0; --edits) {
        const size_t at = random() % damaged.size();
        damaged[at] = static_cast<uint8_t>(random() % 2 == 0 ? random() : damaged[at] + 1);
      }
      ASSERT_TRUE(survives(damaged)) << file.name << ", round " << round;
    }
    ++count;
  }
  EXPECT_GT(count, 0u);
}

}  // namespace
}  // namespace shale
