// tools/eval/metrics.h -- how far a picture is from its reference: PSNR, SSIM, FLIP.
// Pictures are RGB as a display shows them, values in [0, 1] that are 8-bit codes divided by 255.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "ir/base/result.h"
#include "tools/scene/frame_source.h"

namespace shale {

/// A screen of 3840 pixels and 0.7 m width, seen from 0.7 m. Source: FLIP's defaults.
inline constexpr double kDefaultPixelsPerDegree = 67.02064327658226;

/// What an infinite PSNR counts for in a mean, dB.
inline constexpr double kPsnrCapDb = 100;

struct MetricOptions {
  bool psnr = true, ssim = true, flip = true;
  double pixels_per_degree = kDefaultPixelsPerDegree;  ///< of FLIP; 4 to 400
  uint32_t threads = 0;                                ///< 0: as many as the machine has, 8 at most
};

/// Mean over channels and pixels of the map. Absent: the picture is smaller than the window.
struct SsimValues {
  double full = 0;                   ///< RGB, zero padding by 5: the one that tables call SSIM
  std::optional<double> valid;       ///< RGB, without the border of 5 pixels
  double luma = 0;                   ///< Rec. 709 luma of the encoded values, zero padding by 5
  std::optional<double> luma_valid;  ///< luma, without the border
};

/// What was not asked for stays empty.
struct FrameMetrics {
  std::optional<double> psnr_db;  ///< infinite for equal pictures
  std::optional<SsimValues> ssim;
  std::optional<double> flip;  ///< mean of the map, in [0, 1]
};

/// The features of a picture that FLIP compares; planes of [height][width].
struct FlipFeatures {
  std::vector<float> lightness, a, b;  ///< CIELAB after contrast filtering, chroma Hunt-adjusted
  std::vector<float> edge, point;      ///< magnitudes of first and second derivatives
};

/// A reference with everything that does not depend on the picture compared with it, to be used
/// for many.
class PreparedReference {
 public:
  PreparedReference() = default;
  /// Takes RGB in [0, 1]. FLIP's side is computed if the options ask for FLIP.
  PreparedReference(FloatImage picture, const MetricOptions& options);

  const FloatImage& picture() const { return picture_; }
  const FlipFeatures& flip_features() const { return flip_; }
  const MetricOptions& options() const { return options_; }

 private:
  FloatImage picture_;
  FlipFeatures flip_;
  MetricOptions options_;
};

/// Errors: kBadInput if one is empty or not RGB, or the sizes differ; the message says both.
Result<void> check_comparable(const FloatImage& reference, const FloatImage& test);

/// The metrics that the reference was prepared for. Precondition: check_comparable. If `flip_map`
/// is given and FLIP was asked for, it becomes the map: 1 channel, [0, 1].
FrameMetrics compare(const PreparedReference& reference, const FloatImage& test,
                     FloatImage* flip_map = nullptr);

/// 10 log10(1 / MSE) over all pixels and channels; infinite for equal pictures.
double psnr_db(const FloatImage& reference, const FloatImage& test, uint32_t threads = 0);

/// Gaussian window 11x11, sigma 1.5, K 0.01 and 0.03, population covariance.
/// Source: metrics.md section 2.
SsimValues ssim(const FloatImage& reference, const FloatImage& test, uint32_t threads = 0);

/// LDR-FLIP of one pair. Source: Andersson et al., HPG 2020.
struct FlipResult {
  double mean = 0;
  FloatImage map;  ///< 1 channel, [0, 1]
};
FlipResult flip(const FloatImage& reference, const FloatImage& test,
                double pixels_per_degree = kDefaultPixelsPerDegree, uint32_t threads = 0);

/// Mean of dB values, infinite ones counted as kPsnrCapDb; 0 of none.
double mean_psnr_db(std::span<const double> values);

}  // namespace shale
