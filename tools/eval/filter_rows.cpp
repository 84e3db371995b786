#include "tools/eval/filter_rows.h"

#include <algorithm>

#include "tools/eval/wide.h"

namespace shale {
namespace {

/// Sums stay in the first-level cache while the taps pass over them.
constexpr uint32_t kBlock = 256;

/// Adds two taps at once: half the traffic on the sums.
SHALE_WIDE void add_even(float* __restrict sums, uint32_t count, float w0, const float* a0,
                         const float* b0, float w1, const float* a1, const float* b1) {
  for (uint32_t i = 0; i < count; ++i) sums[i] += w0 * (a0[i] + b0[i]) + w1 * (a1[i] + b1[i]);
}

SHALE_WIDE void add_odd(float* __restrict sums, uint32_t count, float w0, const float* a0,
                        const float* b0, float w1, const float* a1, const float* b1) {
  for (uint32_t i = 0; i < count; ++i) sums[i] += w0 * (a0[i] - b0[i]) + w1 * (a1[i] - b1[i]);
}

/// `tap(k)` points at the input for distance k of the block's first output.
template <typename Tap>
void filter_block(const HalfFilter& filter, uint32_t count, float* __restrict out, const Tap& tap) {
  const int radius = static_cast<int>(filter.radius());
  const float* const weights = filter.weights.data();
  const float* const middle = tap(0);
  for (uint32_t i = 0; i < count; ++i) out[i] = weights[0] * middle[i];
  for (int k = 1; k <= radius; k += 2) {
    const int next = std::min(k + 1, radius);
    const float w1 = next > k ? weights[next] : 0;
    (filter.odd ? add_odd : add_even)(out, count, weights[k], tap(k), tap(-k), w1, tap(next),
                                      tap(-next));
  }
}

}  // namespace

void filter_along(const float* centre, uint32_t width, const HalfFilter& filter, float* out) {
  for (uint32_t x = 0; x < width; x += kBlock)
    filter_block(filter, std::min(kBlock, width - x), out + x,
                 [&](int k) { return centre + x + k; });
}

void filter_across(const float* const* rows, uint32_t width, const HalfFilter& filter, float* out) {
  const float* const* const middle = rows + filter.radius();
  for (uint32_t x = 0; x < width; x += kBlock)
    filter_block(filter, std::min(kBlock, width - x), out + x,
                 [&](int k) { return middle[k] + x; });
}

}  // namespace shale
