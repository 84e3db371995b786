#include "compiler/cost/fit.h"

#include <algorithm>
#include <cmath>

namespace shale {
namespace {

/// Far more than the few columns of real data need; a pass over the columns costs next to nothing.
constexpr int kMostPasses = 200000;
constexpr double kSettled = 1e-12;  ///< relative change of every constant in a pass

}  // namespace

WorkTable fit_constants(std::span<const MeasuredWork> measured, const WorkTable& start) {
  // Rows scaled by 1 / sqrt(measured): gram = A^T A and right = A^T b, times in nanoseconds.
  std::array<WorkTable, kWorkCount> gram{};
  WorkTable right{};
  for (const MeasuredWork& row : measured) {
    const double time_ns = 1e3 * row.time_us;
    for (size_t i = 0; i < kWorkCount; ++i) {
      right.at(i) += row.amounts.at(i);  // times measured, divided by it
      for (size_t j = 0; j < kWorkCount; ++j)
        gram.at(i).at(j) += row.amounts.at(i) * row.amounts.at(j) / time_ns;
    }
  }
  WorkTable ns = start;
  const auto is_free = [&](size_t i) {
    return static_cast<Work>(i) != Work::kByte && gram.at(i).at(i) > 0;
  };
  for (int pass = 0; pass < kMostPasses; ++pass) {
    bool settled = true;
    for (size_t i = 0; i < kWorkCount; ++i) {
      if (!is_free(i)) continue;
      double rest = right.at(i);
      for (size_t j = 0; j < kWorkCount; ++j)
        if (j != i && is_free(j)) rest -= gram.at(i).at(j) * ns.at(j);
      const double next = std::max(rest / gram.at(i).at(i), 0.0);
      settled = settled && std::abs(next - ns.at(i)) <= kSettled * std::max(next, ns.at(i));
      ns.at(i) = next;
    }
    if (settled) break;
  }
  return ns;
}

}  // namespace shale
