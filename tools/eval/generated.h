// tools/eval/generated.h -- how well pictures between rendered frames, or beyond them, are made: figures for kinds of pixels
// that a mean hides, and how far the quality swings from picture to picture.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "tools/scene/frame_source.h"

namespace shale {

/// Kinds of pixels of the truth. The first three share out the picture; the others may overlap.
enum class PixelKind : uint8_t {
  kSeenInAll,   ///< the surface is seen in every frame that the picture may be made of
  kSeenInSome,  ///< in one of two
  kSeenInNone,
  kBorder,      ///< off the screen in some of the frames
  kMoving,      ///< of a surface that moves by itself, by 0.3 pixels or more
  kMotionless,  ///< changed by particles or overlays, which have no motion vectors
};
inline constexpr size_t kPixelKinds = 6;
/// As in tables and JSON: "seen_in_all" ...
const char* pixel_kind_name(PixelKind kind);

/// A frame that a picture may be made of, from the picture's truth.
struct SourceView {
  const FloatImage* motion;  ///< 2 channels: what is at uv lies at uv - motion in the frame
  const FloatImage* depth;   ///< 1 channel: of the frame
};

struct PictureTruth {
  const FloatImage* display;       ///< RGB in [0, 1]
  const FloatImage* bare;          ///< the same without particles and overlays; may be null
  const FloatImage* depth;         ///< 1 channel
  const FloatImage* motion;        ///< to some frame, as in SourceView
  const FloatImage* still_motion;  ///< the same if nothing but the camera moved
  bool reverse_depth = false;      ///< depth 1 is near
};

/// A surface is covered in a frame where something lies there that is closer by a tenth, as in temporal.h.
bool is_covered(const FloatImage& depth, bool reverse_depth, float x, float y, float own_depth);

/// Kinds of each pixel, a bit each. All pictures have one size. Source: ours, shown in generated_test.
std::vector<uint8_t> pixel_kinds(const PictureTruth& truth, std::span<const SourceView> frames);

struct GeneratedMetrics {
  struct Kind {
    double share = 0;  ///< of all pixels
    std::optional<double>
        psnr_db;  ///< of their pooled error; empty without such pixels; infinite ones capped
  };
  uint32_t frames = 0;                        ///< that were generated
  std::optional<double> psnr_db, ssim, flip;  ///< means over them
  std::array<Kind, kPixelKinds> kinds;
  /// Standard deviation of a picture's PSNR less the mean of its neighbours', over the whole shown sequence: 0 if rendered
  /// and generated pictures are equally good. Empty where rendered ones equal the truth.
  std::optional<double> judder_db;
  std::optional<double> time_ms;
  uint32_t latency_frames = 0;  ///< rendered frames that the newest one waits
};

/// Sums over the generated pictures of one method.
class KindSums {
 public:
  /// Pictures of one size, RGB.
  void add(const FloatImage& truth, const FloatImage& picture, std::span<const uint8_t> kinds);
  std::array<GeneratedMetrics::Kind, kPixelKinds> finish() const;

 private:
  std::array<double, kPixelKinds> error_{};
  std::array<uint64_t, kPixelKinds> count_{};
  uint64_t pixels_ = 0;
};

/// See GeneratedMetrics::judder_db; of PSNRs in the order of showing.
std::optional<double> judder_db(std::span<const double> psnr_db);

/// The best that can be made of the frames without inventing anything: the truth's own motion leads to them, and where the
/// surface is seen in both they are mixed by time. Where it is seen in none, the picture that lies there in the frame
/// nearer in time. `colors` (RGB, display values) by frame, `weights` the part of each in a mix.
FloatImage warped_by_truth(const PictureTruth& truth, std::span<const SourceView> frames,
                           std::span<const FloatImage* const> colors,
                           std::span<const float> weights);

}  // namespace shale
