#include "tools/scene/bvh.h"

#include <algorithm>
#include <numeric>

namespace shale {
namespace {

constexpr uint32_t kBins = 16;
constexpr uint32_t kMaxSahDepth = 36;  ///< below that halves: 24 levels more for 2^24 boxes

float area(const Box& b) {
  const float x = b.high[0] - b.low[0], y = b.high[1] - b.low[1], z = b.high[2] - b.low[2];
  return x < 0 ? 0 : x * y + y * z + z * x;
}

class Builder {
 public:
  Builder(std::span<const Box> boxes, uint32_t leaf) : boxes_(boxes), leaf_(leaf) {
    tree_.order.resize(boxes.size());
    std::iota(tree_.order.begin(), tree_.order.end(), 0u);
    tree_.nodes.reserve(2 * boxes.size() / leaf + 1);
  }

  Bvh build() {
    if (!boxes_.empty()) split(0, static_cast<uint32_t>(boxes_.size()), 1);
    return std::move(tree_);
  }

 private:
  /// Twice the middle.
  float middle(uint32_t box, size_t axis) const {
    return boxes_[box].low[axis] + boxes_[box].high[axis];
  }

  void split(uint32_t first, uint32_t end, uint32_t depth) {
    tree_.depth = std::max(tree_.depth, depth);
    const size_t own = tree_.nodes.size();
    tree_.nodes.emplace_back();
    Box box, middles;
    for (uint32_t i = first; i < end; ++i) {
      const uint32_t b = tree_.order[i];
      box.add(boxes_[b]);
      for (size_t a = 0; a < 3; ++a) {
        middles.low[a] = std::min(middles.low[a], middle(b, a));
        middles.high[a] = std::max(middles.high[a], middle(b, a));
      }
    }
    tree_.nodes[own].box = box;
    if (end - first <= leaf_) {
      tree_.nodes[own].first = first;
      tree_.nodes[own].count = end - first;
    } else {
      const uint32_t cut = partition(first, end, middles, depth);
      split(first, cut, depth + 1);
      split(cut, end, depth + 1);
    }
    tree_.nodes[own].next = static_cast<uint32_t>(tree_.nodes.size());
  }

  /// Sorts the range so that the two halves are those of the cheapest split by bins.
  uint32_t partition(uint32_t first, uint32_t end, const Box& middles, uint32_t depth) {
    const auto begin = tree_.order.begin();
    size_t best_axis = 3;
    uint32_t best_bin = 0;
    float best = 3e38f;
    if (depth < kMaxSahDepth) {
      for (size_t axis = 0; axis < 3; ++axis) {
        if (!(middles.high[axis] > middles.low[axis])) continue;
        std::array<Box, kBins> bins;
        std::array<uint32_t, kBins> counts{};
        for (uint32_t i = first; i < end; ++i) {
          const uint32_t bin = bin_of(tree_.order[i], axis, middles);
          bins[bin].add(boxes_[tree_.order[i]]);
          ++counts[bin];
        }
        std::array<float, kBins> right{};
        Box box;
        uint32_t count = 0;
        for (uint32_t bin = kBins - 1; bin > 0; --bin) {
          box.add(bins[bin]);
          count += counts[bin];
          right[bin] = area(box) * static_cast<float>(count);
        }
        box = {};
        count = 0;
        for (uint32_t bin = 0; bin + 1 < kBins; ++bin) {
          box.add(bins[bin]);
          count += counts[bin];
          const float cost = area(box) * static_cast<float>(count) + right[bin + 1];
          if (count == 0 || count == end - first || !(cost < best)) continue;
          best = cost;
          best_axis = axis;
          best_bin = bin;
        }
      }
    }
    if (best_axis < 3) {
      const auto cut = std::stable_partition(begin + first, begin + end, [&](uint32_t b) {
        return bin_of(b, best_axis, middles) <= best_bin;
      });
      return static_cast<uint32_t>(cut - begin);
    }
    // Too deep, or all in one place: halves along the longest side.
    size_t axis = 0;
    for (size_t a = 1; a < 3; ++a)
      if (middles.high[a] - middles.low[a] > middles.high[axis] - middles.low[axis]) axis = a;
    const uint32_t half = first + (end - first) / 2;
    std::nth_element(begin + first, begin + half, begin + end, [&](uint32_t a, uint32_t b) {
      return middle(a, axis) < middle(b, axis) || (middle(a, axis) == middle(b, axis) && a < b);
    });
    return half;
  }

  uint32_t bin_of(uint32_t box, size_t axis, const Box& middles) const {
    const float part =
        (middle(box, axis) - middles.low[axis]) / (middles.high[axis] - middles.low[axis]);
    return std::min(static_cast<uint32_t>(part * kBins), kBins - 1);
  }

  std::span<const Box> boxes_;
  const uint32_t leaf_;
  Bvh tree_;
};

}  // namespace

void Box::add(const Box& other) {
  for (size_t a = 0; a < 3; ++a) {
    low[a] = std::min(low[a], other.low[a]);
    high[a] = std::max(high[a], other.high[a]);
  }
}

Bvh build_bvh(std::span<const Box> boxes, uint32_t leaf) { return Builder(boxes, leaf).build(); }

}  // namespace shale
