#include "runtime/datagraph/barriers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <random>

#include "tests/support/small_packages.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 11;

using Plan = std::vector<bool>;
using Dispatches = std::vector<std::vector<Access>>;

Access reads(uint64_t memory, uint64_t begin, uint64_t end) {
  return {memory, begin, end, true, false};
}
Access writes(uint64_t memory, uint64_t begin, uint64_t end) {
  return {memory, begin, end, false, true};
}

TEST(PlanBarriers, FirstDispatchNeedsNone) {
  EXPECT_EQ(plan_barriers(Dispatches{}), Plan{});
  EXPECT_EQ(plan_barriers(Dispatches{{writes(0, 0, 4), reads(0, 0, 4)}}), Plan{false});
}

TEST(PlanBarriers, EachKindOfHazardNeedsOne) {
  EXPECT_EQ(plan_barriers(Dispatches{{writes(0, 0, 8)}, {reads(0, 4, 12)}}),
            (Plan{false, true}));  // RAW
  EXPECT_EQ(plan_barriers(Dispatches{{reads(0, 0, 8)}, {writes(0, 4, 12)}}),
            (Plan{false, true}));  // WAR
  EXPECT_EQ(plan_barriers(Dispatches{{writes(0, 0, 8)}, {writes(0, 4, 12)}}),
            (Plan{false, true}));  // WAW
  EXPECT_EQ(plan_barriers(Dispatches{{reads(0, 0, 8)}, {reads(0, 4, 12)}}), (Plan{false, false}));
}

TEST(PlanBarriers, NeighboursAndOtherMemoriesNeedNone) {
  EXPECT_EQ(plan_barriers(Dispatches{{writes(0, 0, 8)}, {reads(0, 8, 16)}, {reads(1, 0, 8)}}),
            (Plan{false, false, false}));
}

TEST(PlanBarriers, OneBarrierServesAllBeforeIt) {
  EXPECT_EQ(plan_barriers(Dispatches{
                {writes(0, 0, 8)}, {writes(0, 8, 16)}, {reads(0, 0, 8)}, {reads(0, 8, 16)}}),
            (Plan{false, false, true, false}));
}

TEST(PlanBarriers, BarrierIsForgottenNeitherTooEarlyNorTooLate) {
  EXPECT_EQ(plan_barriers(Dispatches{{writes(0, 0, 8)},
                                     {reads(0, 0, 8), writes(0, 8, 16)},
                                     {reads(0, 0, 8)},
                                     {writes(0, 0, 8)},
                                     {reads(0, 8, 16)}}),
            (Plan{false, true, false, true, false}));
}

/// Brute force over all plans: every hazard has a barrier between its two ends.
bool is_sound(const Dispatches& dispatches, uint32_t plan) {
  for (size_t later = 0; later < dispatches.size(); ++later) {
    for (size_t earlier = 0; earlier < later; ++earlier) {
      bool hazard = false;
      for (const Access& a : dispatches[earlier])
        for (const Access& b : dispatches[later])
          hazard |= a.memory == b.memory && std::max(a.begin, b.begin) < std::min(a.end, b.end) &&
                    (a.writes || b.writes);
      bool barrier = false;
      for (size_t i = earlier + 1; i <= later; ++i) barrier |= (plan >> i) & 1u;
      if (hazard && !barrier) return false;
    }
  }
  return true;
}

TEST(PlanBarriers, IsSoundAndHasTheFewestBarriers) {
  std::mt19937_64 random(kSeed);
  for (int round = 0; round < 300; ++round) {
    Dispatches dispatches(7);
    for (auto& dispatch : dispatches) {
      for (uint64_t k = 0; k < 1 + random() % 2; ++k) {
        const uint64_t begin = random() % 12;
        const bool write = random() % 2;
        dispatch.push_back({random() % 2, begin, begin + 1 + random() % 4, !write, write});
      }
    }
    const Plan plan = plan_barriers(dispatches);
    uint32_t bits = 0;
    for (size_t i = 0; i < plan.size(); ++i) bits |= uint32_t{plan[i]} << i;
    ASSERT_TRUE(is_sound(dispatches, bits)) << "seed " << kSeed << " round " << round;
    for (uint32_t other = 0; other < 128; ++other)
      ASSERT_FALSE(std::popcount(other) < std::popcount(bits) && is_sound(dispatches, other))
          << "seed " << kSeed << " round " << round;
  }
}

Plan plan_of(const Variant& variant) {
  Dispatches touched;
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches)
      touched.push_back(accesses(variant, dispatch));
  return plan_barriers(touched);
}

TEST(PlanBarriers, SeesTensorsThatShareTheArena) {
  Package package = small_graph();
  Variant& variant = package.variants[0];
  EXPECT_EQ(plan_of(variant), (Plan{false, true, true, true}));
  // "double" overwrites "a", which "pair" read. Were they apart and "b" not its input, nothing
  // would wait.
  Dispatch& twice = variant.segments[0].dispatches[2];
  twice.bindings[0].resource = twice.bindings[1].resource = 0;
  EXPECT_EQ(plan_of(variant), (Plan{false, true, true, true}));
  variant.arena_bytes = 3 * kSmallBytes;
  variant.resources[4].offset_bytes = 2 * kSmallBytes;
  EXPECT_EQ(plan_of(variant), (Plan{false, true, false, true}));
}

TEST(PlanBarriers, SeesImagesTensorsAndNoWeights) {
  Package package = small_frame();
  EXPECT_EQ(plan_of(package.variants[0]), (Plan{false, true, true}));
}

TEST(PlanBarriers, TellsTheFramesOfAHistoryApart) {
  Package package = small_frame();
  Variant& variant = package.variants[0];
  // "post" alone writes this frame's history; "pre" reads earlier ones. Without the other ties
  // between them:
  std::erase_if(variant.segments[2].dispatches[0].bindings,
                [](const Binding& binding) { return binding.binding < 2; });
  std::erase_if(variant.segments, [](const Segment& s) { return s.kind == SegmentKind::kGraph; });
  EXPECT_EQ(plan_of(variant), (Plan{false, false}));
  variant.segments[0].dispatches[0].bindings[1].frames_back = 0;
  EXPECT_EQ(plan_of(variant), (Plan{false, true}));
}

}  // namespace
}  // namespace shale
