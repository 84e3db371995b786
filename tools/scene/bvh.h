// tools/scene/bvh.h -- trees of boxes, for rays: built by the surface area heuristic.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace shale {

struct Box {
  std::array<float, 3> low{1e30f, 1e30f, 1e30f}, high{-1e30f, -1e30f, -1e30f};
  void add(const Box& other);
};

/// Depth first: the first child follows its parent, the second one follows the first one's part.
struct BvhNode {
  Box box;
  uint32_t next = 0;   ///< node behind this one's part of the tree
  uint32_t first = 0;  ///< of a leaf, in `order`
  uint32_t count = 0;  ///< boxes of a leaf; 0 if it is none
};

struct Bvh {
  std::vector<BvhNode> nodes;   ///< empty without boxes
  std::vector<uint32_t> order;  ///< the boxes, those of a leaf together
  uint32_t depth = 0;           ///< most nodes from the root to a leaf
};

/// Leaves hold at most `leaf` boxes. The tree is at most 60 nodes deep.
/// Source: Wald, On fast Construction of SAH-based Bounding Volume Hierarchies, 2007 (binning).
Bvh build_bvh(std::span<const Box> boxes, uint32_t leaf);

}  // namespace shale
