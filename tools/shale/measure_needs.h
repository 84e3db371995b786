// tools/shale/measure_needs.h -- what frames need of an upscaler, found by looking at them, and for scenes in what the scene says.
#pragma once

#include <optional>

#include "compiler/plan/needs.h"
#include "tools/scene/frame_source.h"
#include "tools/scene/scene.h"

namespace shale {

/// Takes the frames of a sequence, and says what they need.
///  - motion_pixels, exposed, depth, finite: over all texels.
///  - objects_move: a texel moves otherwise than its depth does between the two cameras, by more than a quarter of a pixel.
///  - light_changes: a block of 8x8 texels that did not move has another mean than in the frame before, by more than the
///    jitter of its samples can make. Unknown where too little stands still.
///  - thin_features: more than 1 % of the texels are brighter or darker than all around that differ from them, in no 2x2
///    square that is alike; as `tss` finds what it locks.
/// Source: ours, shown in measure_needs_test.
class NeedsMeter {
 public:
  /// Errors: kBadInput for a frame of another size, or without colour, depth or motion.
  Result<void> add(const SourceFrame& frame);
  /// Precondition: a frame was added.
  SceneNeeds needs() const;

 private:
  void add_motion(const SourceFrame& frame);
  void add_light(const SourceFrame& frame);
  void add_thin(const std::vector<float>& lumas);

  SceneNeeds needs_;
  Extent size_;
  bool has_previous_ = false;
  FrameCamera previous_camera_;
  std::vector<float> previous_lumas_;
  std::vector<bool> previous_still_;  ///< by block
  uint64_t texels_ = 0, thin_ = 0;
  uint64_t blocks_ = 0, still_blocks_ = 0, changed_blocks_ = 0;
};

/// What `measured` says, but for what the scene itself says of frames `first` to `first + frames - 1`: whether the camera and
/// objects move, cuts, changing light.
SceneNeeds needs_of_scene(const Scene& scene, uint32_t first, uint32_t frames,
                          const SceneNeeds& measured);

}  // namespace shale
