#include "tools/eval/ssim_map.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "tools/eval/filter_rows.h"
#include "tools/eval/parallel.h"

namespace shale {
namespace {

constexpr float kC1 = 1e-4f, kC2 = 9e-4f;

HalfFilter gaussian_window() {
  constexpr double kSigma = 1.5;
  const auto weight = [](double k) { return std::exp(-k * k / (2 * kSigma * kSigma)); };
  double sum = weight(0);
  for (uint32_t k = 1; k <= kSsimRadius; ++k) sum += 2 * weight(k);
  HalfFilter filter;
  for (uint32_t k = 0; k <= kSsimRadius; ++k)
    filter.weights.push_back(static_cast<float>(weight(k) / sum));
  return filter;
}

/// With the second picture y = x + d, all that SSIM needs follows from the moments of x and d:
///   2 mx my + C1 = A1,  mx^2 + my^2 + C1 = A1 + md^2
///   2 sxy + C2 = A2,    sx^2 + sy^2 + C2 = A2 + sd^2
/// which is exactly 1 for d = 0 in any order of rounding.
void map_row(const float* __restrict x, const float* __restrict xx, const float* __restrict d,
             const float* __restrict xd, const float* __restrict dd, uint32_t width,
             float* __restrict out) {
  for (uint32_t i = 0; i < width; ++i) {
    const float my = x[i] + d[i];
    const float a1 = 2 * x[i] * my + kC1, md2 = d[i] * d[i];
    const float sx = xx[i] - x[i] * x[i], sxd = xd[i] - x[i] * d[i], sd = dd[i] - md2;
    const float a2 = 2 * (sx + sxd) + kC2;
    out[i] = a1 * a2 / ((a1 + md2) * (a2 + sd));
  }
}

}  // namespace

void ssim_map(uint32_t width, uint32_t height, uint32_t threads, const SsimSource& source,
              const SsimSink& sink) {
  const HalfFilter window = gaussian_window();
  enum Plane : uint32_t { kX, kXX, kD, kXD, kDD, kPlanes };
  parallel_rows(height, threads, [&](uint32_t begin, uint32_t end) {
    constexpr uint32_t kRows = 2 * kSsimRadius + 1;
    RowRing ring(kPlanes, kRows, width);
    // Zeros around the row are the padding along x.
    std::vector<std::vector<float>> padded(kPlanes, std::vector<float>(width + 2 * kSsimRadius));
    std::vector<std::vector<float>> filtered(kPlanes, std::vector<float>(width));
    const std::vector<float> zeros(width);
    std::vector<float> map(width);
    const auto read_row = [&](uint32_t y) {
      float* in[kPlanes];
      for (uint32_t plane = 0; plane < kPlanes; ++plane) in[plane] = &padded[plane][kSsimRadius];
      source(y, in[kX], in[kD]);
      const float *const x = in[kX], *const d = in[kD];
      float* const __restrict xx = in[kXX], * const __restrict xd = in[kXD], * const __restrict dd = in[kDD];
      for (uint32_t i = 0; i < width; ++i) {
        xx[i] = x[i] * x[i];
        xd[i] = x[i] * d[i];
        dd[i] = d[i] * d[i];
      }
      for (uint32_t plane = 0; plane < kPlanes; ++plane)
        filter_along(in[plane], width, window, ring.row(plane, y));
    };
    uint32_t next = begin > kSsimRadius ? begin - kSsimRadius : 0;
    for (uint32_t y = begin; y < end; ++y) {
      for (const uint32_t needed = std::min(y + kSsimRadius, height - 1); next <= needed; ++next)
        read_row(next);
      for (uint32_t plane = 0; plane < kPlanes; ++plane) {
        const float* rows[kRows];
        for (uint32_t k = 0; k < kRows; ++k) {
          const int64_t from = int64_t{y} + k - kSsimRadius;
          rows[k] = from < 0 || from >= height ? zeros.data()
                                               : ring.row(plane, static_cast<uint32_t>(from));
        }
        filter_across(rows, width, window, filtered[plane].data());
      }
      map_row(filtered[kX].data(), filtered[kXX].data(), filtered[kD].data(), filtered[kXD].data(),
              filtered[kDD].data(), width, map.data());
      sink(y, map.data());
    }
  });
}

}  // namespace shale
