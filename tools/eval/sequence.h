// tools/eval/sequence.h -- metrics of a sequence, frame by frame, without keeping the frames: the
// means of the frames' metrics, IF-SSIM between neighbours, the deviation while the camera is still.
//
//   ReferenceTrack track(options);                      // one for a scene
//   std::vector<SequenceEvaluator> evaluators(methods);  // one for a method
//   for each frame:
//     SHALE_TRY_VOID(track.advance({.display = ..., .motion = &..., .depth = &...}));
//     for each method: SHALE_TRY(metrics, evaluator.add(output, track));
//   evaluator.finish()
#pragma once

#include <optional>
#include <vector>

#include "tools/eval/metrics.h"
#include "tools/eval/temporal.h"

namespace shale {

/// IF-SSIM at one threshold. Source: metrics.md section 3.
struct IfSsimValue {
  double value = 0;  ///< mean over the whole pooled picture; wholly masked windows count as 1
  std::optional<double> valid_centres;  ///< mean over windows whose centre is not masked
  double masked_fraction = 0;           ///< of the pooled pixels
};

struct IfSsim {
  IfSsimValue at_t, at_half_t, at_double_t;
  uint32_t pairs = 0;             ///< of consecutive frames, cuts left out
  bool disocclusion_mask = true;  ///< false: some pair had no depth, its mask is by colour alone
};

/// Source: metrics.md section 4.
struct StillDeviation {
  double code_values = 0;  ///< standard deviation over time, mean over pixels and channels, of 255
  std::optional<double> psnr_db;  ///< mean over the same frames, infinite ones capped
  uint32_t frames = 0;
  /// Likewise of the pixels alone that did not change in the truth.
  std::optional<double> rest_code_values;
};

/// Means over a part of the frames.
struct PartMetrics {
  uint32_t frames = 0;
  std::optional<double> psnr_db, ssim, flip, brightness_codes;
};

/// Frames of a sequence until its history counts as built up.
inline constexpr uint32_t kFirstFrames = 10;

/// Means over frames; what was not asked for, or not to be had, is empty.
struct SequenceMetrics {
  uint32_t frames = 0;
  std::optional<double> psnr_db;  ///< infinite frames capped at kPsnrCapDb
  std::optional<double> ssim, ssim_valid, ssim_luma, ssim_luma_valid, flip;
  std::optional<IfSsim> if_ssim;
  std::optional<StillDeviation> still;
  TemporalMetrics temporal;
  PartMetrics first, later;  ///< the first kFirstFrames frames and those behind them
  std::optional<double> time_ms;
};

struct SequenceOptions {
  MetricOptions frame;
  bool if_ssim = true;
  bool still_deviation = true;
  bool temporal = true;
  uint32_t grid_period = 2;  ///< of the jitter's samples in the output, see grid_period()
  /// Frames after the camera stopped that are left out of the still deviation: one jitter period.
  uint32_t settle_frames = 16;
};

/// The truth of one frame at output size. Motion and depth as in SourceFrame; null if there is none.
struct TruthFrame {
  FloatImage display;                  ///< RGB in [0, 1]
  const FloatImage* motion = nullptr;  ///< without it there is no IF-SSIM for this frame
  const FloatImage* depth = nullptr;   ///< without it IF-SSIM masks by colour alone
  bool reverse_depth = false;          ///< depth 1 is near
  bool cut = false;                    ///< nothing is continued from the frame before
  bool camera_still = false;           ///< same view as in the frame before
};

/// True if both cameras have a view-projection and it is the same.
bool same_view(const FrameCamera& a, const FrameCamera& b);

/// The reference side of a scene: prepared for FLIP, warped and masked for IF-SSIM, once for all
/// methods.
class ReferenceTrack {
 public:
  explicit ReferenceTrack(const SequenceOptions& options = {});

  /// Goes on to the next frame.
  /// Errors: kBadInput if sizes or channels are not as expected, or the size changes.
  Result<void> advance(TruthFrame truth);

  /// Frames seen so far.
  uint32_t frames() const { return frames_; }
  /// The current frame. Precondition: frames() > 0.
  const PreparedReference& reference() const { return reference_; }
  /// Consecutive frames, before this one, with this one's view.
  uint32_t still_frames() const { return still_frames_; }

 private:
  friend class SequenceEvaluator;

  /// How the frame before maps onto this one.
  struct Warp {
    std::vector<float> x, y;     ///< where a pixel was, in pixels; x is negative if outside
    std::vector<float> mask[3];  ///< pooled, at T, T/2 and 2T; 1 is valid
    double masked_fraction[3] = {};
    bool by_depth = false;
  };
  Warp make_warp(const TruthFrame& truth) const;

  SequenceOptions options_;
  PreparedReference reference_;
  FloatImage depth_;  ///< of the current frame; empty if there is none
  std::optional<Warp> warp_;
  TemporalTrack temporal_;
  uint32_t frames_ = 0, still_frames_ = 0;
};

/// One method on one scene.
class SequenceEvaluator {
 public:
  explicit SequenceEvaluator(const SequenceOptions& options = {});

  /// Takes the method's picture for the track's current frame: RGB in [0, 1] at output size.
  /// Call once after each advance. `flip_map` as in compare.
  /// Errors: kBadInput if the sizes differ or a frame was left out.
  Result<FrameMetrics> add(FloatImage output, const ReferenceTrack& track,
                           std::optional<double> time_ms = std::nullopt,
                           FloatImage* flip_map = nullptr);

  /// Of all frames so far.
  SequenceMetrics finish() const;

 private:
  struct Mean {
    double sum = 0;
    uint32_t count = 0;
    void add(double value) { sum += value, ++count; }
    std::optional<double> value() const {
      return count ? std::optional(sum / count) : std::nullopt;
    }
  };
  /// Means of a part of the frames.
  struct Part {
    Mean psnr_db, ssim, flip, brightness;
  };
  /// Sums over stretches, weighted by frames.
  struct StillSums {
    double code_values = 0, rest_code_values = 0, psnr_db = 0;
    uint32_t frames = 0, rest_frames = 0, psnr_frames = 0;
  };
  /// Running sums of a still stretch, in code values.
  struct Still {
    std::vector<uint32_t> sum, square;
    std::vector<uint8_t> truth;    ///< of the first frame
    std::vector<uint8_t> changed;  ///< by pixel: some other frame's truth is not that
    Mean psnr_db;
    uint32_t frames = 0;
  };

  void add_if_ssim(const FloatImage& output, const ReferenceTrack& track);
  void add_still(const FloatImage& output, const FloatImage& truth, const FrameMetrics& metrics);
  /// Adds a stretch to sums that are weighted by frames.
  static void add_stretch(const Still& still, StillSums& sums);

  SequenceOptions options_;
  uint32_t frames_ = 0;
  FloatImage previous_;
  Mean psnr_db_, ssim_, ssim_valid_, ssim_luma_, ssim_luma_valid_, flip_, time_ms_;
  Mean if_ssim_[3], if_ssim_valid_[3], masked_[3];
  bool every_pair_by_depth_ = true;
  Still still_;
  StillSums ended_;  ///< of the stretches that ended
  TemporalEvaluator temporal_;
  Part parts_[2];  ///< the first frames, the later ones
};

}  // namespace shale
