#include "tools/eval/sequence.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "tools/eval/parallel.h"
#include "tools/eval/ssim_map.h"

namespace shale {
namespace {

/// T, T/2, 2T: rank orders must not hinge on our approximation of the threshold.
constexpr float kThresholdFactors[3] = {1, 0.5f, 2};
constexpr float kDepthTolerance = 0.01f;

/// The colour change that is noticed, in code values, at a brightness of 0 to 255. Ours, for a phone's
/// screen: the paper has a curve only.
inline float noticed_change(float brightness) {
  return std::clamp(6 + 12 * brightness / 255, 6.0f, 18.0f);
}

/// Four neighbours and their weights. Beyond the outermost pixel centres the border is repeated.
struct Bilinear {
  size_t at[4];
  float weight[4];

  Bilinear(float x, float y, uint32_t width, uint32_t height) {
    const float x0 = std::floor(x), y0 = std::floor(y), fx = x - x0, fy = y - y0;
    const auto clamped = [](float value, uint32_t size) {
      return static_cast<size_t>(std::clamp(value, 0.0f, static_cast<float>(size - 1)));
    };
    const size_t left = clamped(x0, width), right = clamped(x0 + 1, width),
                 top = clamped(y0, height) * width, bottom = clamped(y0 + 1, height) * width;
    const size_t positions[4] = {top + left, top + right, bottom + left, bottom + right};
    const float weights[4] = {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy};
    std::copy_n(positions, 4, at);
    std::copy_n(weights, 4, weight);
  }

  float sample(const FloatImage& image, size_t channel) const {
    float sum = 0;
    for (size_t i = 0; i < 4; ++i)
      sum += weight[i] * image.values[at[i] * image.channels + channel];
    return sum;
  }
};

Result<void> check_plane(const char* what, const FloatImage& image, uint32_t channels,
                         const FloatImage& display) {
  if (image.width == display.width && image.height == display.height &&
      image.channels == channels &&
      image.values.size() == size_t{image.width} * image.height * channels)
    return {};
  return bad_input(what, "has {}x{} pixels of {} channels, expected {}x{} of {}", image.width,
                   image.height, image.channels, display.width, display.height, channels);
}

/// The mean of four neighbours; `value(x, y, c)` gives them.
template <typename Value>
std::vector<float> pooled(uint32_t width, uint32_t height, uint32_t threads, const Value& value) {
  const uint32_t half_width = width / 2, half_height = height / 2;
  const size_t plane = size_t{half_width} * half_height;
  std::vector<float> result(3 * plane);
  parallel_rows(half_height, threads, [&](uint32_t begin, uint32_t end) {
    for (uint32_t y = begin; y < end; ++y)
      for (uint32_t x = 0; x < half_width; ++x) {
        float sum[3] = {};
        for (uint32_t i = 0; i < 4; ++i) value(2 * x + i % 2, 2 * y + i / 2, sum);
        for (size_t c = 0; c < 3; ++c)
          result[c * plane + size_t{y} * half_width + x] = sum[c] * 0.25f;
      }
  });
  return result;
}

}  // namespace

bool same_view(const FrameCamera& a, const FrameCamera& b) {
  const bool known = std::any_of(a.view_projection.begin(), a.view_projection.end(),
                                 [](float value) { return value != 0; });
  return known && a.view_projection == b.view_projection;
}

// The reference side.

ReferenceTrack::ReferenceTrack(const SequenceOptions& options)
    : options_(options), temporal_(options.grid_period, options.frame.threads) {}

Result<void> ReferenceTrack::advance(TruthFrame truth) {
  SHALE_TRY_VOID(check_comparable(truth.display, truth.display));
  if (frames_ > 0) {
    SHALE_TRY_VOID(check_comparable(reference_.picture(), truth.display));
  }
  if (truth.motion) {
    SHALE_TRY_VOID(check_plane("motion", *truth.motion, 2, truth.display));
  }
  if (truth.depth) {
    SHALE_TRY_VOID(check_plane("depth", *truth.depth, 1, truth.display));
  }
  warp_.reset();
  if (options_.if_ssim && frames_ > 0 && truth.motion && !truth.cut && truth.display.width > 1 &&
      truth.display.height > 1)
    warp_ = make_warp(truth);
  still_frames_ = frames_ > 0 && truth.camera_still && !truth.cut ? still_frames_ + 1 : 0;
  if (options_.temporal)
    temporal_.advance({.display = &truth.display,
                       .motion = truth.motion,
                       .depth = truth.depth,
                       .reverse_depth = truth.reverse_depth,
                       .cut = truth.cut});
  depth_ = truth.depth ? *truth.depth : FloatImage{};
  reference_ = PreparedReference(std::move(truth.display), options_.frame);
  ++frames_;
  return {};
}

ReferenceTrack::Warp ReferenceTrack::make_warp(const TruthFrame& truth) const {
  const FloatImage &now = truth.display, &before = reference_.picture();
  const uint32_t width = now.width, height = now.height, threads = options_.frame.threads;
  const uint32_t half_width = width / 2, half_height = height / 2;
  Warp warp;
  warp.by_depth = truth.depth && !depth_.empty();
  warp.x.resize(size_t{width} * height);
  warp.y.resize(size_t{width} * height);
  for (std::vector<float>& mask : warp.mask) mask.resize(size_t{half_width} * half_height);
  const std::vector<float> brightness = brightness_of(now, threads);

  /// Fills in the warp of a pixel and says at which thresholds it is valid.
  const auto warp_pixel = [&](uint32_t x, uint32_t y, bool(&valid)[3]) {
    const size_t at = size_t{y} * width + x;
    const float* const motion = truth.motion->at(x, y);
    const auto from_x = static_cast<float>(x - double{motion[0]} * width),
               from_y = static_cast<float>(y - double{motion[1]} * height);
    // A pixel's square, from which sampling still takes the pixel itself, reaches half a pixel out.
    const bool inside = from_x >= -0.5f && from_x <= static_cast<float>(width) - 0.5f &&
                        from_y >= -0.5f && from_y <= static_cast<float>(height) - 0.5f;
    warp.x[at] = inside ? std::max(from_x, 0.0f) : -1;
    warp.y[at] = inside ? std::max(from_y, 0.0f) : -1;
    std::fill_n(valid, 3, false);
    if (!inside) return;
    const Bilinear taps(warp.x[at], warp.y[at], width, height);
    if (warp.by_depth &&
        !(std::abs(truth.depth->values[at] - taps.sample(depth_, 0)) < kDepthTolerance))
      return;
    float change = 0;
    for (size_t c = 0; c < 3; ++c)
      change = std::max(change, 255 * std::abs(now.values[3 * at + c] - taps.sample(before, c)));
    for (size_t i = 0; i < 3; ++i)
      valid[i] = change < kThresholdFactors[i] * noticed_change(brightness[at]);
  };
  // Rows in pairs; where the height is odd the last row is in no pooled pixel.
  std::vector<std::array<uint32_t, 3>> masked(half_height);
  parallel_rows(half_height, threads, [&](uint32_t begin, uint32_t end) {
    for (uint32_t y = begin; y < end; ++y)
      for (uint32_t x = 0; x < half_width; ++x) {
        bool all[3] = {true, true, true};
        for (uint32_t i = 0; i < 4; ++i) {
          bool valid[3];
          warp_pixel(2 * x + i % 2, 2 * y + i / 2, valid);
          for (size_t t = 0; t < 3; ++t) all[t] = all[t] && valid[t];
        }
        for (size_t t = 0; t < 3; ++t) {
          warp.mask[t][size_t{y} * half_width + x] = all[t] ? 1.0f : 0.0f;
          masked[y][t] += !all[t];
        }
      }
  });
  for (const std::array<uint32_t, 3>& row : masked)
    for (size_t t = 0; t < 3; ++t) warp.masked_fraction[t] += row[t];
  for (double& fraction : warp.masked_fraction)
    fraction /= static_cast<double>(half_width) * half_height;
  return warp;
}

// A method.

SequenceEvaluator::SequenceEvaluator(const SequenceOptions& options) : options_(options) {}

Result<FrameMetrics> SequenceEvaluator::add(FloatImage output, const ReferenceTrack& track,
                                            std::optional<double> time_ms, FloatImage* flip_map) {
  if (track.frames() != frames_ + 1)
    return bad_input("", "the reference is at frame {}, expected frame {}", track.frames(),
                     frames_ + 1);
  SHALE_TRY_VOID(check_comparable(track.reference().picture(), output));
  const FrameMetrics metrics = compare(track.reference(), output, flip_map);
  Part& part = parts_[frames_ < kFirstFrames ? 0 : 1];
  ++frames_;
  if (metrics.psnr_db) {
    psnr_db_.add(std::min(*metrics.psnr_db, kPsnrCapDb));
    part.psnr_db.add(std::min(*metrics.psnr_db, kPsnrCapDb));
  }
  if (metrics.ssim) part.ssim.add(metrics.ssim->full);
  if (metrics.flip) part.flip.add(*metrics.flip);
  if (options_.temporal)
    part.brightness.add(temporal_.add(output, track.reference().picture(), track.temporal_));
  if (metrics.ssim) {
    ssim_.add(metrics.ssim->full);
    ssim_luma_.add(metrics.ssim->luma);
    if (metrics.ssim->valid) ssim_valid_.add(*metrics.ssim->valid);
    if (metrics.ssim->luma_valid) ssim_luma_valid_.add(*metrics.ssim->luma_valid);
  }
  if (metrics.flip) flip_.add(*metrics.flip);
  if (time_ms) time_ms_.add(*time_ms);
  if (track.warp_ && !previous_.empty()) add_if_ssim(output, track);
  if (options_.still_deviation) {
    if (track.still_frames() >= options_.settle_frames) {
      add_still(output, track.reference().picture(), metrics);
    } else if (still_.frames > 0) {
      add_stretch(still_, ended_);
      still_ = {};
    }
  }
  if (options_.if_ssim) previous_ = std::move(output);
  return metrics;
}

void SequenceEvaluator::add_if_ssim(const FloatImage& output, const ReferenceTrack& track) {
  const ReferenceTrack::Warp& warp = *track.warp_;
  const uint32_t width = output.width, height = output.height, threads = options_.frame.threads;
  const uint32_t half_width = width / 2, half_height = height / 2;
  const std::vector<float> now =
      pooled(width, height, threads, [&](uint32_t x, uint32_t y, float(&sum)[3]) {
        for (size_t c = 0; c < 3; ++c) sum[c] += output.at(x, y)[c];
      });
  const std::vector<float> warped =
      pooled(width, height, threads, [&](uint32_t x, uint32_t y, float(&sum)[3]) {
        const size_t at = size_t{y} * width + x;
        if (warp.x[at] < 0) return;
        const Bilinear taps(warp.x[at], warp.y[at], width, height);
        for (size_t c = 0; c < 3; ++c) sum[c] += taps.sample(previous_, c);
      });
  const size_t plane = size_t{half_width} * half_height;
  for (size_t t = 0; t < 3; ++t) {
    std::vector<double> all(half_height), centred(half_height);
    double sum = 0, centred_sum = 0;
    for (size_t c = 0; c < 3; ++c) {
      ssim_map(
          half_width, half_height, threads,
          [&](uint32_t y, float* first, float* difference) {
            const size_t row = size_t{y} * half_width;
            const float *const mask = &warp.mask[t][row], *const p = &warped[c * plane + row],
                               *const q = &now[c * plane + row];
            for (uint32_t x = 0; x < half_width; ++x) {
              first[x] = p[x] * mask[x];
              difference[x] = (q[x] - p[x]) * mask[x];
            }
          },
          [&](uint32_t y, const float* map) {
            const float* const mask = &warp.mask[t][size_t{y} * half_width];
            all[y] = centred[y] = 0;
            for (uint32_t x = 0; x < half_width; ++x) {
              all[y] += map[x];
              centred[y] += map[x] * mask[x];
            }
          });
      for (uint32_t y = 0; y < half_height; ++y) {
        sum += all[y];
        centred_sum += centred[y];
      }
    }
    const double masked = warp.masked_fraction[t];
    if_ssim_[t].add(sum / static_cast<double>(3 * plane));
    masked_[t].add(masked);
    const double valid = std::round(static_cast<double>(plane) * (1 - masked));
    if (valid > 0) if_ssim_valid_[t].add(centred_sum / (3 * valid));
  }
  every_pair_by_depth_ = every_pair_by_depth_ && warp.by_depth;
}

void SequenceEvaluator::add_still(const FloatImage& output, const FloatImage& truth,
                                  const FrameMetrics& metrics) {
  const auto code_of = [](float value) {
    return static_cast<uint8_t>(std::clamp(value, 0.0f, 1.0f) * 255 + 0.5f);
  };
  const size_t count = output.values.size();
  still_.sum.resize(count);
  still_.square.resize(count);
  still_.changed.resize(count / 3);
  if (still_.frames == 0) {
    still_.truth.resize(count);
    std::transform(truth.values.begin(), truth.values.end(), still_.truth.begin(), code_of);
  }
  for (size_t i = 0; i < count; ++i) {
    const uint32_t code = code_of(output.values[i]);
    still_.sum[i] += code;
    still_.square[i] += code * code;
    still_.changed[i / 3] |= code_of(truth.values[i]) != still_.truth[i];
  }
  if (metrics.psnr_db) still_.psnr_db.add(std::min(*metrics.psnr_db, kPsnrCapDb));
  ++still_.frames;
}

void SequenceEvaluator::add_stretch(const Still& still, StillSums& sums) {
  if (still.frames < 2) return;
  double total = 0, rest = 0;
  size_t at_rest = 0;
  for (size_t i = 0; i < still.sum.size(); ++i) {
    // n sum(x^2) - sum(x)^2 in integers is exact.
    const uint64_t spread =
        uint64_t{still.frames} * still.square[i] - uint64_t{still.sum[i]} * still.sum[i];
    const double deviation = std::sqrt(static_cast<double>(spread));
    total += deviation;
    if (still.changed[i / 3]) continue;
    rest += deviation;
    ++at_rest;
  }
  sums.code_values += total / static_cast<double>(still.sum.size());
  sums.frames += still.frames;
  if (at_rest > 0) {
    sums.rest_code_values += rest / static_cast<double>(at_rest);
    sums.rest_frames += still.frames;
  }
  sums.psnr_db += still.psnr_db.sum;
  sums.psnr_frames += still.psnr_db.count;
}

SequenceMetrics SequenceEvaluator::finish() const {
  SequenceMetrics result;
  result.frames = frames_;
  result.psnr_db = psnr_db_.value();
  result.ssim = ssim_.value();
  result.ssim_valid = ssim_valid_.value();
  result.ssim_luma = ssim_luma_.value();
  result.ssim_luma_valid = ssim_luma_valid_.value();
  result.flip = flip_.value();
  result.time_ms = time_ms_.value();
  if (if_ssim_[0].count > 0) {
    const auto value = [&](size_t t) {
      return IfSsimValue{*if_ssim_[t].value(), if_ssim_valid_[t].value(), *masked_[t].value()};
    };
    result.if_ssim = {value(0), value(1), value(2), if_ssim_[0].count, every_pair_by_depth_};
  }
  StillSums still = ended_;
  add_stretch(still_, still);
  if (still.frames > 0) {
    const auto mean = [](double sum, uint32_t frames) {
      return frames ? std::optional(sum / frames) : std::nullopt;
    };
    result.still =
        StillDeviation{still.code_values / still.frames, mean(still.psnr_db, still.psnr_frames),
                       still.frames, mean(still.rest_code_values, still.rest_frames)};
  }
  result.temporal = temporal_.finish();
  const auto part = [](const Part& sums, uint32_t frames) {
    return PartMetrics{frames, sums.psnr_db.value(), sums.ssim.value(), sums.flip.value(),
                       sums.brightness.value()};
  };
  result.first = part(parts_[0], std::min(frames_, kFirstFrames));
  result.later = part(parts_[1], frames_ - result.first.frames);
  return result;
}

}  // namespace shale
