#include "tools/eval/temporal.h"

#include <algorithm>
#include <cmath>

#include "tools/eval/parallel.h"

namespace shale {
namespace {

constexpr uint32_t kLumaRadius = 2;  // of the 5x5 window that brightness is taken from

/// Change of brightness that is an event, code values: a tenth of it is what a steady error of a few codes stays below.
constexpr float kChange = 24;
constexpr float kMade = 0.9f;
/// What was closer by this factor in the frame before has covered what is seen now.
constexpr float kCloser = 1.1f;
/// Windows have so many periods a side; around their plane the truth deviates by kSmooth codes at most.
constexpr uint32_t kWindowPeriods = 4;
constexpr float kSmooth = 1.5f;

float luma_codes(const float* rgb) {
  return 255 * (0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2]);
}

/// A window's brightness less the plane through it, row after row.
class Residual {
 public:
  Residual(const FloatImage& image, uint32_t x, uint32_t y, uint32_t side) : side_(side) {
    values_.reserve(size_t{side} * side);
    const double middle = (side - 1) / 2.0;
    double sum = 0, along_x = 0, along_y = 0, square = 0;
    for (uint32_t j = 0; j < side; ++j)
      for (uint32_t i = 0; i < side; ++i) {
        const double value = luma_codes(image.at(x + i, y + j));
        values_.push_back(value);
        sum += value;
        along_x += value * (i - middle);
        along_y += value * (j - middle);
        square += (i - middle) * (i - middle);
      }
    const double mean = sum / static_cast<double>(values_.size());
    for (uint32_t j = 0; j < side; ++j)
      for (uint32_t i = 0; i < side; ++i)
        values_[size_t{j} * side + i] -=
            mean + along_x / square * (i - middle) + along_y / square * (j - middle);
  }

  double largest() const {
    double largest = 0;
    for (const double value : values_) largest = std::max(largest, std::abs(value));
    return largest;
  }

  /// Mean square over the phases of the mean of what lies at a phase.
  double energy(uint32_t period) const {
    std::vector<double> phases(size_t{period} * period);
    for (uint32_t j = 0; j < side_; ++j)
      for (uint32_t i = 0; i < side_; ++i)
        phases[size_t{j % period} * period + i % period] += values_[size_t{j} * side_ + i];
    const double each = static_cast<double>(values_.size()) / static_cast<double>(phases.size());
    double energy = 0;
    for (const double phase : phases) energy += phase / each * (phase / each);
    return energy / static_cast<double>(phases.size());
  }

 private:
  uint32_t side_;
  std::vector<double> values_;
};

}  // namespace

std::vector<float> brightness_of(const FloatImage& image, uint32_t threads) {
  const uint32_t width = image.width, height = image.height;
  const auto count = [](uint32_t at, uint32_t size) {
    return static_cast<float>(std::min(at + kLumaRadius, size - 1) -
                              (at > kLumaRadius ? at - kLumaRadius : 0) + 1);
  };
  std::vector<float> sums(size_t{width} * height), result(sums.size());
  parallel_rows(height, threads, [&](uint32_t begin, uint32_t end) {
    std::vector<float> luma(width + 2 * kLumaRadius);
    for (uint32_t y = begin; y < end; ++y) {
      for (uint32_t x = 0; x < width; ++x) luma[x + kLumaRadius] = luma_codes(image.at(x, y));
      float* const out = &sums[size_t{y} * width];
      for (uint32_t x = 0; x < width; ++x)
        out[x] = luma[x] + luma[x + 1] + luma[x + 2] + luma[x + 3] + luma[x + 4];
    }
  });
  parallel_rows(height, threads, [&](uint32_t begin, uint32_t end) {
    for (uint32_t y = begin; y < end; ++y) {
      float* const out = &result[size_t{y} * width];
      const uint32_t first = y > kLumaRadius ? y - kLumaRadius : 0,
                     last = std::min(y + kLumaRadius, height - 1);
      for (uint32_t row = first; row <= last; ++row)
        for (uint32_t x = 0; x < width; ++x) out[x] += sums[size_t{row} * width + x];
      for (uint32_t x = 0; x < width; ++x) out[x] /= count(x, width) * count(y, height);
    }
  });
  return result;
}

uint32_t grid_period(Extent render, Extent output) {
  uint32_t best = 2;
  double least = 1e9;
  for (uint32_t period = 2; period <= 6; ++period) {
    const auto off = [period](uint32_t from, uint32_t to) {
      const double texels = static_cast<double>(period) * from / to;
      return std::abs(texels - std::round(texels));
    };
    const double sum = off(render.width, output.width) + off(render.height, output.height);
    if (sum < least - 0.02) {
      least = sum;
      best = period;
    }
  }
  return best;
}

std::optional<double> Trail::mean(uint32_t first) const {
  double sum = 0;
  uint64_t count = 0;
  for (uint32_t age = first; age < kTrailFrames; ++age) {
    sum += codes[age] * static_cast<double>(pixels[age]);
    count += pixels[age];
  }
  return count ? std::optional(sum / static_cast<double>(count)) : std::nullopt;
}

// The truth's side.

void TemporalTrack::advance(const TemporalTruth& truth) {
  follow(truth);
  find_windows(*truth.display);
}

void TemporalTrack::follow(const TemporalTruth& truth) {
  const uint32_t width = truth.display->width, height = truth.display->height;
  const size_t count = size_t{width} * height;
  std::vector<float> brightness = brightness_of(*truth.display, threads_), closeness;
  if (truth.depth) {
    closeness.resize(count);
    for (size_t i = 0; i < count; ++i)
      closeness[i] = truth.reverse_depth ? truth.depth->values[i] : 1 - truth.depth->values[i];
  }
  const bool continues = truth.motion && !truth.cut && pixels_.size() == count &&
                         closeness_.size() == count && truth.depth;
  std::vector<Pixel> pixels(count);
  previous_.assign(count, -1);
  std::vector<uint64_t> began(height);
  /// The pixel of the frame before that this one shows on; -1 if it is outside or what was there was closer.
  const auto origin = [&](uint32_t x, uint32_t y, bool* covered) -> int32_t {
    const float* const motion = truth.motion->at(x, y);
    const double from_x = std::round(x - double{motion[0]} * width),
                 from_y = std::round(y - double{motion[1]} * height);
    if (!(from_x >= 0 && from_x < width && from_y >= 0 && from_y < height)) return -1;
    const size_t from = static_cast<size_t>(from_y) * width + static_cast<size_t>(from_x);
    if (closeness_[from] > kCloser * closeness[size_t{y} * width + x] + 1e-5f) {
      *covered = true;
      return -1;
    }
    return static_cast<int32_t>(from);
  };
  if (continues)
    parallel_rows(height, threads_, [&](uint32_t begin, uint32_t end) {
      for (uint32_t y = begin; y < end; ++y)
        for (uint32_t x = 0; x < width; ++x) {
          bool covered = false;
          const size_t at = size_t{y} * width + x;
          previous_[at] = origin(x, y, &covered);
          if (covered) {
            pixels[at].uncovered = 0;
            pixels[at].sky = closeness[at] <= 0;
          }
        }
    });
  /// Whether the window of brightness moved as one: else it changes with what passes.
  const auto is_whole = [&](uint32_t x, uint32_t y) {
    if (x < kLumaRadius || y < kLumaRadius || x + kLumaRadius >= width || y + kLumaRadius >= height)
      return false;
    const size_t at = size_t{y} * width + x;
    for (const auto& [dx, dy] :
         {std::pair{-2, -2}, {2, -2}, {-2, 2}, {2, 2}, {0, -2}, {0, 2}, {-2, 0}, {2, 0}}) {
      const ptrdiff_t step = ptrdiff_t{dy} * width + dx;
      const size_t corner = static_cast<size_t>(static_cast<ptrdiff_t>(at) + step);
      // Rounding may part neighbours by a pixel.
      if (previous_[corner] < 0) return false;
      const ptrdiff_t apart = previous_[corner] - previous_[at] - step;
      const ptrdiff_t row = (apart + width + width / 2) / width - 1, column = apart - row * width;
      if (std::abs(row) > 1 || std::abs(column) > 1) return false;
    }
    return true;
  };
  if (continues)
    parallel_rows(height, threads_, [&](uint32_t begin, uint32_t end) {
      for (uint32_t y = begin; y < end; ++y)
        for (uint32_t x = 0; x < width; ++x) {
          const size_t at = size_t{y} * width + x;
          Pixel& pixel = pixels[at];
          const float now = brightness[at];
          if (previous_[at] < 0) {
            pixel.anchor = now;
            continue;
          }
          pixel = pixels_[static_cast<size_t>(previous_[at])];
          if (pixel.uncovered != kNone && ++pixel.uncovered >= kTrailFrames)
            pixel.uncovered = kNone;
          if (pixel.change != kNone) {
            const bool returned = (now - pixel.from) * (pixel.to - pixel.from) <
                                  0.5f * (pixel.to - pixel.from) * (pixel.to - pixel.from);
            if (++pixel.change > kLagFrames || returned) {
              pixel.change = kNone;
              pixel.anchor = now;
            }
          } else if (!is_whole(x, y)) {
            pixel.anchor = now;
          } else if (std::abs(now - pixel.anchor) >= kChange) {
            pixel.from = pixel.anchor;
            pixel.to = now;
            pixel.change = 0;
            ++began[y];
          }
        }
    });
  else
    for (size_t i = 0; i < count; ++i) pixels[i].anchor = brightness[i];
  events_ = 0;
  for (const uint64_t row : began) events_ += row;
  brightness_ = std::move(brightness);
  closeness_ = std::move(closeness);
  pixels_ = std::move(pixels);
}

void TemporalTrack::find_windows(const FloatImage& display) {
  const uint32_t side = kWindowPeriods * period_;
  windows_.clear();
  for (uint32_t y = 0; y + side <= display.height; y += side)
    for (uint32_t x = 0; x + side <= display.width; x += side) {
      const Residual residual(display, x, y, side);
      if (residual.largest() <= kSmooth) windows_.push_back({x, y, residual.energy(period_)});
    }
}

// A method.

double TemporalEvaluator::add(const FloatImage& output, const FloatImage& truth,
                              const TemporalTrack& track) {
  const size_t count = track.pixels_.size();
  const std::vector<float> brightness = brightness_of(output, track.threads_);
  std::vector<uint8_t> made(count);
  Sum difference{0, count};
  for (size_t i = 0; i < count; ++i) {
    difference.sum += double{brightness[i]} - track.brightness_[i];
    const TemporalTrack::Pixel& pixel = track.pixels_[i];
    if (pixel.change != TemporalTrack::kNone) {
      const bool was = pixel.change > 0 && made_[static_cast<size_t>(track.previous_[i])] != 0;
      made[i] = was || (brightness[i] - pixel.from) / (pixel.to - pixel.from) >= kMade;
      if (!made[i] && pixel.change < kLagFrames) ++late_;
      if (!made[i] && pixel.change == kLagFrames) ++open_;
    }
    if (pixel.uncovered != TemporalTrack::kNone) {
      Sum& sum = (pixel.sky ? sky_trail_ : trail_)[pixel.uncovered];
      for (size_t c = 0; c < 3; ++c)
        sum.sum += 255.0 / 3 * std::abs(output.values[3 * i + c] - truth.values[3 * i + c]);
      ++sum.count;
    }
  }
  made_ = std::move(made);
  events_ += track.events_;
  brightness_.sum += difference.sum;
  brightness_.count += count;
  for (const TemporalTrack::Window& window : track.windows_) {
    grid_output_.sum +=
        Residual(output, window.x, window.y, kWindowPeriods * track.period_).energy(track.period_);
    grid_truth_sum_ += window.truth_energy;
    ++grid_output_.count;
  }
  return difference.sum / static_cast<double>(count);
}

TemporalMetrics TemporalEvaluator::finish() const {
  TemporalMetrics metrics;
  if (events_ > 0)
    metrics.lag = Lag{static_cast<double>(late_) / static_cast<double>(events_),
                      static_cast<double>(open_) / static_cast<double>(events_), events_};
  const auto trail = [](const std::array<Sum, kTrailFrames>& sums) -> std::optional<Trail> {
    Trail result;
    for (uint32_t age = 0; age < kTrailFrames; ++age) {
      result.pixels[age] = sums[age].count;
      if (sums[age].count > 0)
        result.codes[age] = sums[age].sum / static_cast<double>(sums[age].count);
    }
    return result.mean(0) ? std::optional(result) : std::nullopt;
  };
  metrics.trail = trail(trail_);
  metrics.sky_trail = trail(sky_trail_);
  if (grid_output_.count > 0) {
    const auto windows = static_cast<double>(grid_output_.count);
    metrics.grid = Grid{std::sqrt(grid_output_.sum / windows), std::sqrt(grid_truth_sum_ / windows),
                        grid_output_.count};
  }
  if (brightness_.count > 0)
    metrics.brightness_codes = brightness_.sum / static_cast<double>(brightness_.count);
  return metrics;
}

}  // namespace shale
