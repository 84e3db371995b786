#include "tools/eval/metrics.h"

#include <cmath>
#include <limits>

#include "tools/eval/flip.h"
#include "tools/eval/parallel.h"
#include "tools/eval/ssim_map.h"

namespace shale {
namespace {

double sum_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum;
}

/// Sum of squared differences; eight sums side by side, so that the loop becomes vector code.
double squared_difference(const float* a, const float* b, size_t count) {
  constexpr size_t kLanes = 8;
  double sums[kLanes] = {};
  size_t i = 0;
  for (; i + kLanes <= count; i += kLanes)
    for (size_t lane = 0; lane < kLanes; ++lane) {
      const double difference = static_cast<double>(a[i + lane]) - b[i + lane];
      sums[lane] += difference * difference;
    }
  double sum = 0;
  for (; i < count; ++i)
    sum += (static_cast<double>(a[i]) - b[i]) * (static_cast<double>(a[i]) - b[i]);
  for (const double lane : sums) sum += lane;
  return sum;
}

/// Sums of a map over all pixels and over those off the border.
struct MapSums {
  double full = 0, valid = 0;
};

MapSums ssim_sums(uint32_t width, uint32_t height, uint32_t threads, const SsimSource& source) {
  std::vector<double> full(height), valid(height);
  ssim_map(width, height, threads, source, [&](uint32_t y, const float* map) {
    double border = 0, inside = 0;
    for (uint32_t x = 0; x < width; ++x)
      (x >= kSsimRadius && x + kSsimRadius < width ? inside : border) += map[x];
    full[y] = border + inside;
    if (y >= kSsimRadius && y + kSsimRadius < height) valid[y] = inside;
  });
  return {sum_of(full), sum_of(valid)};
}

/// Rec. 709 luma.
inline float luma(const float* rgb) {
  return 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
}

}  // namespace

Result<void> check_comparable(const FloatImage& reference, const FloatImage& test) {
  for (const FloatImage* image : {&reference, &test})
    if (image->empty() || image->channels != 3 ||
        image->values.size() != size_t{image->width} * image->height * 3)
      return bad_input("", "expected RGB pictures, found {}x{} pixels of {} channels", image->width,
                       image->height, image->channels);
  if (reference.width != test.width || reference.height != test.height)
    return bad_input("", "has {}x{} pixels, its reference {}x{}", test.width, test.height,
                     reference.width, reference.height);
  return {};
}

double psnr_db(const FloatImage& reference, const FloatImage& test, uint32_t threads) {
  SHALE_CHECK(reference.values.size() == test.values.size() && !reference.empty());
  const size_t row = size_t{reference.width} * reference.channels;
  std::vector<double> sums(reference.height);
  parallel_rows(reference.height, threads, [&](uint32_t begin, uint32_t end) {
    for (uint32_t y = begin; y < end; ++y)
      sums[y] = squared_difference(reference.at(0, y), test.at(0, y), row);
  });
  const double mse = sum_of(sums) / static_cast<double>(reference.values.size());
  return mse > 0 ? -10 * std::log10(mse) : std::numeric_limits<double>::infinity();
}

SsimValues ssim(const FloatImage& reference, const FloatImage& test, uint32_t threads) {
  SHALE_CHECK(check_comparable(reference, test));
  const uint32_t width = reference.width, height = reference.height;
  MapSums rgb;
  for (size_t channel = 0; channel < 3; ++channel) {
    const MapSums sums =
        ssim_sums(width, height, threads, [&](uint32_t y, float* first, float* difference) {
          const float *p = reference.at(0, y) + channel, *q = test.at(0, y) + channel;
          for (uint32_t x = 0; x < width; ++x) {
            first[x] = p[3 * x];
            difference[x] = q[3 * x] - p[3 * x];
          }
        });
    rgb.full += sums.full;
    rgb.valid += sums.valid;
  }
  const MapSums grey =
      ssim_sums(width, height, threads, [&](uint32_t y, float* first, float* difference) {
        const float *p = reference.at(0, y), *q = test.at(0, y);
        for (uint32_t x = 0; x < width; ++x) {
          first[x] = luma(p + 3 * x);
          difference[x] = luma(q + 3 * x) - first[x];
        }
      });
  const double pixels = static_cast<double>(width) * height;
  SsimValues values{rgb.full / (3 * pixels), std::nullopt, grey.full / pixels, std::nullopt};
  if (width > 2 * kSsimRadius && height > 2 * kSsimRadius) {
    const double inside = (width - 2.0 * kSsimRadius) * (height - 2.0 * kSsimRadius);
    values.valid = rgb.valid / (3 * inside);
    values.luma_valid = grey.valid / inside;
  }
  return values;
}

PreparedReference::PreparedReference(FloatImage picture, const MetricOptions& options)
    : picture_(std::move(picture)), options_(options) {
  SHALE_CHECK(check_comparable(picture_, picture_));
  if (options_.flip)
    flip_ = shale::flip_features(picture_, options_.pixels_per_degree, options_.threads);
}

FrameMetrics compare(const PreparedReference& reference, const FloatImage& test,
                     FloatImage* flip_map) {
  SHALE_CHECK(check_comparable(reference.picture(), test));
  const MetricOptions& options = reference.options();
  FrameMetrics metrics;
  if (options.psnr) metrics.psnr_db = psnr_db(reference.picture(), test, options.threads);
  if (options.ssim) metrics.ssim = ssim(reference.picture(), test, options.threads);
  if (options.flip)
    metrics.flip = flip_difference(reference.flip_features(), test, options.pixels_per_degree,
                                   options.threads, flip_map);
  return metrics;
}

FlipResult flip(const FloatImage& reference, const FloatImage& test, double pixels_per_degree,
                uint32_t threads) {
  SHALE_CHECK(check_comparable(reference, test));
  FlipResult result;
  result.mean = flip_difference(flip_features(reference, pixels_per_degree, threads), test,
                                pixels_per_degree, threads, &result.map);
  return result;
}

double mean_psnr_db(std::span<const double> values) {
  double sum = 0;
  for (const double value : values) sum += std::min(value, kPsnrCapDb);
  return values.empty() ? 0 : sum / static_cast<double>(values.size());
}

}  // namespace shale
