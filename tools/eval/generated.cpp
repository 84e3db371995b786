#include "tools/eval/generated.h"

#include <algorithm>
#include <cmath>

#include "tools/eval/metrics.h"
#include "tools/eval/parallel.h"

namespace shale {
namespace {

constexpr float kCloser = 1.1f;         // what covers has this much of the closeness
constexpr float kMovingPixels = 0.3f;   // Source: nfru.md section 3.2, the dynamic mask
constexpr float kVisible = 2.5f / 255;  // a change that particles and overlays make

/// Where a pixel of the truth lies in a frame, in pixels; false if that is off the screen.
bool position(const FloatImage& motion, uint32_t x, uint32_t y, float& at_x, float& at_y) {
  const float* const m = motion.at(x, y);
  at_x = static_cast<float>(x) - m[0] * static_cast<float>(motion.width);
  at_y = static_cast<float>(y) - m[1] * static_cast<float>(motion.height);
  return at_x >= -0.5f && at_y >= -0.5f && at_x <= static_cast<float>(motion.width) - 0.5f &&
         at_y <= static_cast<float>(motion.height) - 0.5f;
}

uint32_t nearest(float at, uint32_t size) {
  return static_cast<uint32_t>(std::clamp(std::lround(at), 0l, static_cast<long>(size) - 1));
}

/// Catmull-Rom, borders clamped; RGB in [0, 1].
void sample(const FloatImage& image, float x, float y, float rgb[3]) {
  const auto weights = [](float t, float w[4]) {
    w[0] = ((-0.5f * t + 1) * t - 0.5f) * t;
    w[1] = (1.5f * t - 2.5f) * t * t + 1;
    w[2] = ((-1.5f * t + 2) * t + 0.5f) * t;
    w[3] = 0.5f * (t - 1) * t * t;
  };
  const float x0 = std::floor(x), y0 = std::floor(y);
  float wx[4], wy[4];
  weights(x - x0, wx);
  weights(y - y0, wy);
  std::fill_n(rgb, 3, 0.0f);
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 4; ++i) {
      const float* const texel = image.at(nearest(x0 + static_cast<float>(i) - 1, image.width),
                                          nearest(y0 + static_cast<float>(j) - 1, image.height));
      for (int c = 0; c < 3; ++c) rgb[c] += wx[i] * wy[j] * texel[c];
    }
  for (int c = 0; c < 3; ++c) rgb[c] = std::clamp(rgb[c], 0.0f, 1.0f);
}

}  // namespace

const char* pixel_kind_name(PixelKind kind) {
  constexpr const char* kNames[kPixelKinds] = {"seen_in_all", "seen_in_some", "seen_in_none",
                                               "border",      "moving",       "motionless"};
  return kNames[static_cast<size_t>(kind)];
}

bool is_covered(const FloatImage& depth, bool reverse_depth, float x, float y, float own_depth) {
  const auto closeness = [&](float d) { return reverse_depth ? d : 1 - d; };
  const float there = *depth.at(nearest(x, depth.width), nearest(y, depth.height));
  return closeness(there) > kCloser * closeness(own_depth) + 1e-5f;
}

std::vector<uint8_t> pixel_kinds(const PictureTruth& truth, std::span<const SourceView> frames) {
  const uint32_t width = truth.depth->width, height = truth.depth->height;
  std::vector<uint8_t> kinds(size_t{width} * height);
  const auto bit = [](PixelKind kind) {
    return static_cast<uint8_t>(1u << static_cast<uint32_t>(kind));
  };
  parallel_rows(height, 0, [&](uint32_t begin, uint32_t end) {
    for (uint32_t y = begin; y < end; ++y)
      for (uint32_t x = 0; x < width; ++x) {
        size_t seen = 0;
        uint8_t own = 0;
        for (const SourceView& frame : frames) {
          float at_x = 0, at_y = 0;
          if (!position(*frame.motion, x, y, at_x, at_y))
            own |= bit(PixelKind::kBorder);
          else if (!is_covered(*frame.depth, truth.reverse_depth, at_x, at_y,
                               *truth.depth->at(x, y)))
            ++seen;
        }
        own |= bit(seen == frames.size() ? PixelKind::kSeenInAll
                   : seen > 0            ? PixelKind::kSeenInSome
                                         : PixelKind::kSeenInNone);
        const float* const m = truth.motion->at(x, y);
        const float* const still = truth.still_motion->at(x, y);
        if (std::hypot((m[0] - still[0]) * static_cast<float>(width),
                       (m[1] - still[1]) * static_cast<float>(height)) >= kMovingPixels)
          own |= bit(PixelKind::kMoving);
        for (uint32_t c = 0; truth.bare && c < 3; ++c)
          if (std::abs(truth.display->at(x, y)[c] - truth.bare->at(x, y)[c]) > kVisible)
            own |= bit(PixelKind::kMotionless);
        kinds[size_t{y} * width + x] = own;
      }
  });
  return kinds;
}

void KindSums::add(const FloatImage& truth, const FloatImage& picture,
                   std::span<const uint8_t> kinds) {
  for (size_t i = 0; i < kinds.size(); ++i) {
    double error = 0;
    for (size_t c = 0; c < 3; ++c) {
      const double off = double{truth.values[3 * i + c]} - picture.values[3 * i + c];
      error += off * off;
    }
    for (size_t k = 0; k < kPixelKinds; ++k) {
      if (!(kinds[i] & 1u << k)) continue;
      error_[k] += error;
      ++count_[k];
    }
  }
  pixels_ += kinds.size();
}

std::array<GeneratedMetrics::Kind, kPixelKinds> KindSums::finish() const {
  std::array<GeneratedMetrics::Kind, kPixelKinds> kinds;
  for (size_t k = 0; k < kPixelKinds; ++k) {
    if (pixels_ == 0 || count_[k] == 0) continue;
    kinds[k].share = static_cast<double>(count_[k]) / static_cast<double>(pixels_);
    const double mean = error_[k] / (3 * static_cast<double>(count_[k]));
    kinds[k].psnr_db = mean > 0 ? std::min(-10 * std::log10(mean), kPsnrCapDb) : kPsnrCapDb;
  }
  return kinds;
}

std::optional<double> judder_db(std::span<const double> psnr_db) {
  if (psnr_db.size() < 3 ||
      std::any_of(psnr_db.begin(), psnr_db.end(), [](double db) { return db >= kPsnrCapDb; }))
    return std::nullopt;
  double sum = 0, square = 0;
  const size_t count = psnr_db.size() - 2;
  for (size_t i = 1; i + 1 < psnr_db.size(); ++i) {
    const double off = psnr_db[i] - 0.5 * (psnr_db[i - 1] + psnr_db[i + 1]);
    sum += off;
    square += off * off;
  }
  const double mean = sum / static_cast<double>(count);
  return std::sqrt(std::max(square / static_cast<double>(count) - mean * mean, 0.0));
}

FloatImage warped_by_truth(const PictureTruth& truth, std::span<const SourceView> frames,
                           std::span<const FloatImage* const> colors,
                           std::span<const float> weights) {
  const uint32_t width = truth.depth->width, height = truth.depth->height;
  FloatImage picture{width, height, 3, std::vector<float>(size_t{width} * height * 3)};
  const size_t nearer =
      static_cast<size_t>(std::max_element(weights.begin(), weights.end()) - weights.begin());
  parallel_rows(height, 0, [&](uint32_t begin, uint32_t end) {
    for (uint32_t y = begin; y < end; ++y)
      for (uint32_t x = 0; x < width; ++x) {
        float sum[3] = {}, total = 0, rgb[3];
        for (size_t f = 0; f < frames.size(); ++f) {
          float at_x = 0, at_y = 0;
          if (!position(*frames[f].motion, x, y, at_x, at_y) ||
              is_covered(*frames[f].depth, truth.reverse_depth, at_x, at_y, *truth.depth->at(x, y)))
            continue;
          sample(*colors[f], at_x, at_y, rgb);
          for (size_t c = 0; c < 3; ++c) sum[c] += weights[f] * rgb[c];
          total += weights[f];
        }
        float* const out = picture.at(x, y);
        for (size_t c = 0; c < 3; ++c)
          out[c] = total > 0 ? sum[c] / total : colors[nearer]->at(x, y)[c];
      }
  });
  return picture;
}

}  // namespace shale
