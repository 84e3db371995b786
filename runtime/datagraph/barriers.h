// runtime/datagraph/barriers.h -- which dispatches must wait for earlier ones, as a pure function.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "ir/package/package.h"

namespace shale {

/// Bytes that a dispatch touches. `memory` tells apart what cannot overlap; within one memory,
/// ranges may.
struct Access {
  uint64_t memory = 0;
  uint64_t begin = 0;  ///< bytes
  uint64_t end = 0;    ///< behind the last byte
  bool reads = false;
  bool writes = false;
};

/// True for each dispatch of the list that needs a barrier before it: one of execution and memory,
/// from all earlier dispatches to all later ones. There is one only where a hazard demands it (RAW,
/// WAR, WAW on overlapping bytes, unless a barrier lies between already), and no plan has fewer:
/// each stands as late as its first hazard allows. Nothing is assumed about what ran before the
/// list.
/// Source: Vulkan 1.3, 7.1 (execution and memory dependencies); interval stabbing for the count.
std::vector<bool> plan_barriers(std::span<const std::vector<Access>> dispatches);

/// What a dispatch touches: tensors of the arena by their bytes in one common memory, so that
/// tensors which share bytes are seen; any other tensor or image, and each image of a history, as a
/// memory of its own. Weights never change and are left out. An indirect grid is read, too. The
/// variant must pass check_package.
std::vector<Access> accesses(const Variant& variant, const Dispatch& dispatch);

}  // namespace shale
