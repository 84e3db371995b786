// tools/scene/scene_source.h -- a rendered scene, or a part of its picture, as a sequence of frames.
#pragma once

#include <functional>
#include <optional>
#include <span>

#include "ir/base/sampling_pattern.h"
#include "runtime/vk/device.h"
#include "tools/scene/frame_source.h"
#include "tools/scene/renderer.h"
#include "tools/scene/scene.h"

namespace shale {

/// Which frames of a scene, and which part of its picture, are the sequence.
struct SceneClip {
  uint32_t first_frame = 0;  ///< counted at the frame rate; it is frame 0 of the sequence
  uint32_t frame_count = 0;  ///< 0 is all from the first on; never more than the scene has
  /// Renders only this part, as if it were a whole picture: motion is in its own uv, the fields of
  /// view are those of a picture of its size with the same pixels. Its sides must fall on render
  /// pixels.
  std::optional<Crop> crop;
};

struct SceneOptions {
  Extent render{960, 540};
  Extent output{1920, 1080};
  SceneClip clip;
  double frame_rate = 0;  ///< frames a second, at which everything moves as fast; 0 is the scene's
  SamplingPattern pattern;
  std::optional<bool> reverse_depth;  ///< instead of what the scene says
  std::function<bool()> keep_going;   ///< asked between bands of rows; may be empty
  VkPipelineCache cache = VK_NULL_HANDLE;
};

/// Sub-pixel offset of a frame's samples. kHalton: Halton (2, 3) of frame + 1, repeated after 8 times
/// the ratio of areas, on a grid of 1/8 pixel; kMnss: at ratio 2 twelve frames, at ratio 3 nine.
/// Precondition: check_pattern. Source: NSS, shared conventions; MNSS (TVCG 2023), the phase of x2
/// and the spiral of x3 as in the authors' release of 2021.
std::array<float, 2> scene_jitter(uint32_t frame, Extent render, Extent output,
                                  const SamplingPattern& pattern = {});
/// Frames after which the offsets repeat.
uint32_t jitter_phases(Extent render, Extent output, const SamplingPattern& pattern = {});

/// Errors: kBadInput if the pattern does not exist for the sizes.
Result<void> check_pattern(const SamplingPattern& pattern, Extent render, Extent output);

/// Frames of the scene from one rendered frame to the next, and how many are rendered, at
/// `frame_rate`; 0 is the scene's own.
double frame_step(const Scene& scene, double frame_rate);
uint32_t frames_at_rate(const Scene& scene, double frame_rate);

/// A moment between frames of a sequence, at output size, and where in frames that lies which is seen then.
struct SceneMoment {
  FrameCamera camera;
  FloatImage truth;  ///< RGB; as all others empty if not asked for
  FloatImage bare;   ///< the same without particles and overlays; empty if the scene has none
  FloatImage depth;  ///< 1 channel, of the samples in the middles of pixels, as motion
  /// 2 channels, by moment asked for: what is at uv lies at uv - motion then.
  std::vector<FloatImage> motion;
  FloatImage still_motion;  ///< as motion[0] if nothing but the camera moved
};

class SceneSource : public FrameSource {
 public:
  /// `context` must outlive the source.
  /// Errors: kBadInput for sizes, a pattern or a crop that do not fit each other; kDevice.
  static Result<std::unique_ptr<SceneSource>> create(const vk::Context& context, Scene scene,
                                                     SceneOptions options);

  const std::string& name() const override { return scene_.name; }
  uint32_t frame_count() const override { return frames_; }
  Extent render_size() const override { return render_; }
  Extent output_size() const override { return window_.size; }
  Result<SourceFrame> frame(uint32_t index, bool with_truth) override;

  /// What is seen `after` frames behind frame `index`; motion to the moments that lie `to` frames behind it. Everything moves
  /// as in the frames; random things are those of the frames, too.
  /// Errors: as frame(); kBadInput for a moment behind the last frame.
  Result<SceneMoment> moment(uint32_t index, double after, std::span<const double> to,
                             bool with_truth);

  /// Makes another clip of the same scene the sequence; the pipelines are kept.
  /// Errors: kBadInput, and the clip is the one before.
  Result<void> set_clip(const SceneClip& clip);

  const Scene& scene() const { return scene_; }

 private:
  SceneSource(Scene scene, SceneOptions options)
      : scene_(std::move(scene)), options_(std::move(options)) {}
  FrameCamera camera(uint32_t number, const FramePoses& poses) const;
  /// Renders at output size, `samples` along each side of a pixel.
  Result<RenderedImages> render_output(const Scene& scene, const FramePoses& poses,
                                       uint32_t samples);

  Scene scene_;
  SceneOptions options_;
  Window window_;
  Extent render_;                         ///< of the window
  uint32_t render_x_ = 0, render_y_ = 0;  ///< first render pixel of the window
  uint32_t first_frame_ = 0, frames_ = 0;
  bool reverse_ = false;
  std::unique_ptr<SceneRenderer> renderer_;
};

}  // namespace shale
