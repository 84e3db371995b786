// tools/eval/ssim_map.h -- the SSIM map of one channel, row by row; what is done with it is up to the
// caller. metrics.h and sequence.h have the public faces.
#pragma once

#include <cstdint>
#include <functional>

namespace shale {

/// Half of the 11x11 window.
inline constexpr uint32_t kSsimRadius = 5;

/// Writes row y of the first picture and of the second less the first, in [0, 1].
using SsimSource = std::function<void(uint32_t y, float* first, float* difference)>;
/// Takes row y of the map.
using SsimSink = std::function<void(uint32_t y, const float* map)>;

/// Zero padding, so the map has the pictures' size. Both functions are called from several threads,
/// with rows in any order; the sink exactly once a row. Equal pictures give exactly 1 everywhere.
/// Source: metrics.md section 2.
void ssim_map(uint32_t width, uint32_t height, uint32_t threads, const SsimSource& source,
              const SsimSink& sink);

}  // namespace shale
