#include "compiler/plan/memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace shale {
namespace {

bool live_together(const LiveInterval& a, const LiveInterval& b) {
  return a.first <= b.last && b.first <= a.last;
}

/// What must hold for every plan: no overlap in memory of what is live together, alignment, an
/// arena that is exactly as large as the plan needs, and a lower bound that is one.
void expect_sound(const std::vector<LiveInterval>& intervals, uint64_t alignment,
                  const MemoryPlan& plan) {
  ASSERT_EQ(plan.offsets.size(), intervals.size());
  uint64_t end = 0;
  for (size_t i = 0; i < intervals.size(); ++i) {
    EXPECT_EQ(plan.offsets[i] % alignment, 0u) << i;
    const uint64_t aligned = (intervals[i].size_bytes + alignment - 1) / alignment * alignment;
    end = std::max(end, plan.offsets[i] + aligned);
    for (size_t j = 0; j < i; ++j) {
      if (!live_together(intervals[i], intervals[j])) continue;
      const bool apart = plan.offsets[i] + intervals[i].size_bytes <= plan.offsets[j] ||
                         plan.offsets[j] + intervals[j].size_bytes <= plan.offsets[i];
      EXPECT_TRUE(apart) << "intervals " << j << " and " << i;
    }
  }
  EXPECT_EQ(plan.arena_bytes, end);
  uint64_t most = 0;
  for (const LiveInterval& at : intervals) {
    uint64_t live = 0;
    for (const LiveInterval& other : intervals)
      if (other.first <= at.first && at.first <= other.last)
        live += (other.size_bytes + alignment - 1) / alignment * alignment;
    most = std::max(most, live);
  }
  EXPECT_EQ(plan.lower_bound_bytes, most);
  EXPECT_GE(plan.arena_bytes, plan.lower_bound_bytes);
}

MemoryPlan checked_plan(const std::vector<LiveInterval>& intervals, uint64_t alignment) {
  MemoryPlan plan = plan_memory(intervals, alignment);
  expect_sound(intervals, alignment, plan);
  return plan;
}

TEST(Planner, NeedsNothingForNothing) {
  const MemoryPlan plan = checked_plan({}, 256);
  EXPECT_EQ(plan.arena_bytes, 0u);
  EXPECT_EQ(plan.lower_bound_bytes, 0u);
}

TEST(Planner, RoundsSizesUpToTheAlignment) {
  EXPECT_EQ(checked_plan({{0, 1, 1}}, 256).arena_bytes, 256u);
  EXPECT_EQ(checked_plan({{0, 1, 256}}, 256).arena_bytes, 256u);
  EXPECT_EQ(checked_plan({{0, 1, 257}}, 256).arena_bytes, 512u);
  EXPECT_EQ(checked_plan({{0, 1, 1}, {1, 2, 1}}, 64).arena_bytes, 128u);
}

TEST(Planner, ReusesMemoryAfterTheLastReader) {
  EXPECT_EQ(checked_plan({{0, 1, 512}, {2, 3, 512}}, 256).arena_bytes, 512u);
  // A tensor that a dispatch reads and one that it writes are live together.
  EXPECT_EQ(checked_plan({{0, 1, 512}, {1, 2, 512}}, 256).arena_bytes, 1024u);
}

TEST(Planner, FindsTheOptimumOfAChain) {
  // Ping and pong: two buffers, whatever the length.
  std::vector<LiveInterval> chain;
  for (uint32_t i = 0; i < 50; ++i) chain.push_back({i, i + 1, 4096});
  EXPECT_EQ(checked_plan(chain, 256).arena_bytes, 8192u);
}

TEST(Planner, FindsTheOptimumOfAnHourglass) {
  // An encoder and a decoder without skips: the largest neighbours decide.
  const std::vector<LiveInterval> intervals{
      {0, 1, 8192}, {1, 2, 4096}, {2, 3, 1024}, {3, 4, 4096}, {4, 5, 8192}};
  EXPECT_EQ(checked_plan(intervals, 256).arena_bytes, 12288u);
}

TEST(Planner, PutsShortLivesIntoTheGapsOfALongOne) {
  // A skip connection lives through; the small ones share what is left.
  const std::vector<LiveInterval> intervals{{0, 5, 4096}, {1, 2, 2048}, {3, 4, 2048}, {2, 3, 1024}};
  EXPECT_EQ(checked_plan(intervals, 256).arena_bytes, 4096u + 2048u + 1024u);
}

TEST(Planner, TakesAGapThatFitsExactly) {
  // The largest first: A below, B above it; C is live with B only and fits where A was.
  const MemoryPlan plan = checked_plan({{0, 1, 1024}, {1, 3, 768}, {2, 3, 1024}}, 256);
  EXPECT_EQ(plan.offsets, (std::vector<uint64_t>{0, 1024, 0}));
  EXPECT_EQ(plan.arena_bytes, 1792u);
}

TEST(Planner, GivesEqualPlansForEqualInput) {
  std::mt19937_64 random(3);
  std::vector<LiveInterval> intervals;
  for (int i = 0; i < 100; ++i) {
    const uint32_t first = static_cast<uint32_t>(random() % 50);
    intervals.push_back({first, first + static_cast<uint32_t>(random() % 8), 1000});
  }
  EXPECT_EQ(plan_memory(intervals, 256).offsets, plan_memory(intervals, 256).offsets);
}

TEST(Planner, NeverOverlapsOnRandomIntervals) {
  std::mt19937_64 random(20240607);
  for (int round = 0; round < 300; ++round) {
    SCOPED_TRACE(round);
    const uint64_t alignment = uint64_t{1} << (random() % 10);
    const uint32_t length = 1 + static_cast<uint32_t>(random() % 40);
    std::vector<LiveInterval> intervals(random() % 60);
    for (LiveInterval& interval : intervals) {
      interval.first = static_cast<uint32_t>(random() % length);
      interval.last = interval.first + static_cast<uint32_t>(random() % (length - interval.first));
      interval.size_bytes = random() % 8 == 0 ? 0 : random() % (random() % 2 == 0 ? 100 : 100000);
    }
    checked_plan(intervals, alignment);
    if (testing::Test::HasFailure()) return;
  }
}

/// Intervals of networks as they are built for images: a level is half as high and wide, twice as
/// deep.
std::vector<LiveInterval> encoder_decoder(uint32_t levels, uint32_t convs, uint64_t bytes) {
  std::vector<LiveInterval> intervals;
  std::vector<size_t> skips;
  uint32_t dispatch = 0;
  const auto add = [&](uint64_t size) {
    intervals.push_back({dispatch, dispatch + 1, size});
    ++dispatch;
  };
  for (uint32_t level = 0; level < levels; ++level) {
    for (uint32_t i = 0; i < convs; ++i) add(bytes >> level);
    skips.push_back(intervals.size() - 1);
    add(bytes >> (level + 1));
  }
  for (uint32_t level = levels; level-- > 0;) {
    for (uint32_t i = 0; i < convs; ++i) add(bytes >> level);
    intervals[skips[level]].last = dispatch;  // joined here
    add(bytes >> level);
  }
  return intervals;
}

std::vector<LiveInterval> residual_blocks(uint32_t blocks, uint64_t bytes) {
  std::vector<LiveInterval> intervals{{0, 0, bytes}};
  size_t trunk = 0;
  uint32_t dispatch = 1;
  for (uint32_t i = 0; i < blocks; ++i) {
    intervals.push_back({dispatch, dispatch + 1, bytes});
    intervals.push_back({dispatch + 1, dispatch + 2, bytes});
    intervals[trunk].last = dispatch + 2;
    trunk = intervals.size();
    intervals.push_back({dispatch + 2, dispatch + 3, bytes});
    dispatch += 3;
  }
  return intervals;
}

std::vector<LiveInterval> dense_block(uint32_t layers, uint64_t bytes) {
  std::vector<LiveInterval> intervals;
  for (uint32_t i = 0; i < layers; ++i) intervals.push_back({i, layers, bytes});
  return intervals;
}

TEST(Planner, StaysWithinAQuarterOfTheLowerBoundOnTypicalNetworks) {
  const std::vector<std::vector<LiveInterval>> networks{
      encoder_decoder(2, 1, 1 << 20),  encoder_decoder(3, 2, 1 << 20),
      encoder_decoder(5, 2, 16588800), residual_blocks(4, 1 << 18),
      residual_blocks(32, 3110400),    dense_block(12, 65536)};
  for (size_t i = 0; i < networks.size(); ++i) {
    SCOPED_TRACE(i);
    const MemoryPlan plan = checked_plan(networks[i], 256);
    EXPECT_LE(4 * plan.arena_bytes, 5 * plan.lower_bound_bytes)
        << plan.arena_bytes << " bytes, the lower bound is " << plan.lower_bound_bytes;
  }
}

}  // namespace
}  // namespace shale
