#include "compiler/plan/memory.h"

#include <algorithm>
#include <map>
#include <numeric>

namespace shale {

MemoryPlan plan_memory(std::span<const LiveInterval> intervals, uint64_t alignment) {
  const auto aligned = [&](uint64_t size) {
    return (size + alignment - 1) / alignment * alignment;
  };
  std::vector<size_t> order(intervals.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return intervals[a].size_bytes > intervals[b].size_bytes;
  });
  MemoryPlan plan;
  plan.offsets.resize(intervals.size());
  std::vector<size_t> placed;  // sorted by offset
  for (const size_t i : order) {
    uint64_t offset = 0;
    for (const size_t other : placed) {
      const bool together = intervals[i].first <= intervals[other].last &&
                            intervals[other].first <= intervals[i].last;
      if (!together) continue;
      if (offset + aligned(intervals[i].size_bytes) <= plan.offsets[other]) break;
      offset = std::max(offset, plan.offsets[other] + aligned(intervals[other].size_bytes));
    }
    plan.offsets[i] = offset;
    plan.arena_bytes = std::max(plan.arena_bytes, offset + aligned(intervals[i].size_bytes));
    const auto at = std::upper_bound(placed.begin(), placed.end(), i, [&](size_t a, size_t b) {
      return plan.offsets[a] < plan.offsets[b];
    });
    placed.insert(at, i);
  }
  std::map<uint32_t, int64_t> changes;
  for (const LiveInterval& interval : intervals) {
    changes[interval.first] += static_cast<int64_t>(aligned(interval.size_bytes));
    changes[interval.last + 1] -= static_cast<int64_t>(aligned(interval.size_bytes));
  }
  int64_t live = 0;
  for (const auto& [dispatch, change] : changes) {
    live += change;
    plan.lower_bound_bytes = std::max(plan.lower_bound_bytes, static_cast<uint64_t>(live));
  }
  return plan;
}

}  // namespace shale
