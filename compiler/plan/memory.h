// compiler/plan/memory.h -- live intervals of intermediate tensors to offsets in one arena.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace shale {

/// A tensor is live from the dispatch that writes it to the last one that reads it, both included.
struct LiveInterval {
  uint32_t first = 0;
  uint32_t last = 0;
  uint64_t size_bytes = 0;
};

struct MemoryPlan {
  std::vector<uint64_t> offsets;  ///< of each interval, multiples of the alignment
  uint64_t arena_bytes = 0;
  uint64_t lower_bound_bytes = 0;  ///< most bytes live at one dispatch, aligned sizes
};

/// Greedy by size: the largest interval first, each at the lowest offset where nothing that is live
/// with it lies. Pure and deterministic.
/// Source: Pisarchyk and Lee, "Efficient Memory Management
/// for Deep Neural Net Inference", 2020.
MemoryPlan plan_memory(std::span<const LiveInterval> intervals, uint64_t alignment);

}  // namespace shale
