// tools/eval/temporal.h -- what goes wrong over time: light that lags, trails in what was uncovered, a grid of the jitter's
// phases. The truth's side is prepared once a frame for all methods, as in sequence.h, which owns both sides.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "tools/eval/metrics.h"

namespace shale {

/// Frames that light and what was uncovered are followed for.
inline constexpr uint32_t kLagFrames = 16, kTrailFrames = 8;

/// Light that lags. All by brightness: Rec. 709 luma in code values of 255, mean of 5x5 pixels.
struct Lag {
  double frames = 0;  ///< mean over events until 90 % of the change is made, kLagFrames at most
  double open_fraction = 0;  ///< of the events, those that had not made it after kLagFrames
  uint64_t events = 0;       ///< pixels whose light changed in the truth
};

/// Mean absolute error, in code values over R, G and B, of pixels by the frames since they were uncovered.
struct Trail {
  std::array<double, kTrailFrames> codes{};  ///< 0 where `pixels` is 0
  std::array<uint64_t, kTrailFrames> pixels{};
  /// Mean over the pixels of frames first..kTrailFrames - 1.
  std::optional<double> mean(uint32_t first) const;
};

/// Root mean square of the phases' deviations, in code values, over windows that are smooth in the truth.
struct Grid {
  double output_codes = 0, truth_codes = 0;
  uint64_t windows = 0;
};

struct TemporalMetrics {
  std::optional<Lag> lag;  ///< nothing changed, or there is no motion or depth: empty
  std::optional<Trail> trail, sky_trail;   ///< likewise
  std::optional<Grid> grid;                ///< nothing is smooth: empty
  std::optional<double> brightness_codes;  ///< mean of output less truth: positive is too bright
};

/// Output pixels after which the jitter's grid of samples repeats: the smallest of 2 to 6 that is a whole number of render
/// pixels on both axes, or the nearest to one.
uint32_t grid_period(Extent render, Extent output);

/// The truth of one frame. Motion and depth may be null.
struct TemporalTruth {
  const FloatImage* display = nullptr;
  const FloatImage* motion = nullptr;
  const FloatImage* depth = nullptr;
  bool reverse_depth = false;
  bool cut = false;
};

/// The truth's side: where pixels come from, which light changed, what was uncovered, what is smooth.
class TemporalTrack {
 public:
  explicit TemporalTrack(uint32_t period = 2, uint32_t threads = 0)
      : period_(period), threads_(threads) {}

  /// Precondition: sizes and channels as ReferenceTrack::advance checks them.
  void advance(const TemporalTruth& truth);

 private:
  friend class TemporalEvaluator;

  static constexpr uint8_t kNone = 255;

  /// Of a pixel, carried along with the motion.
  struct Pixel {
    float anchor = 0;           ///< brightness before the change that is awaited
    float from = 0, to = 0;     ///< of the change that is under way
    uint8_t change = kNone;     ///< frames since it was seen
    uint8_t uncovered = kNone;  ///< frames since
    bool sky = false;           ///< of `uncovered`
  };
  /// Smooth in the truth, side x side pixels.
  struct Window {
    uint32_t x, y;
    double truth_energy;
  };

  void follow(const TemporalTruth& truth);
  void find_windows(const FloatImage& display);

  uint32_t period_, threads_;
  std::vector<float> brightness_;
  std::vector<float> closeness_;   ///< 0 at the sky
  std::vector<int32_t> previous_;  ///< index in the frame before; -1: none
  std::vector<Pixel> pixels_;
  std::vector<Window> windows_;
  uint64_t events_ = 0;  ///< that began in this frame
};

/// One method on one scene.
class TemporalEvaluator {
 public:
  /// Takes the method's picture for the track's current frame. Returns the mean of brightness less the truth's.
  double add(const FloatImage& output, const FloatImage& truth, const TemporalTrack& track);
  TemporalMetrics finish() const;

 private:
  struct Sum {
    double sum = 0;
    uint64_t count = 0;
  };
  std::vector<uint8_t> made_;  ///< by pixel: 90 % of the change under way is made
  uint64_t events_ = 0, late_ = 0, open_ = 0;
  std::array<Sum, kTrailFrames> trail_, sky_trail_;
  Sum brightness_, grid_output_;
  double grid_truth_sum_ = 0;
};

/// Rec. 709 luma in code values, mean over 5x5 pixels; at the border over those inside.
std::vector<float> brightness_of(const FloatImage& image, uint32_t threads);

}  // namespace shale
