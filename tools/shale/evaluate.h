// tools/shale/evaluate.h -- a scene through several sandwiches, measured against the truth.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "tools/eval/html_report.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/player.h"

namespace shale {

/// A sandwich that is ready to play, or pictures that another program made of the frames.
struct PlayedMethod {
  std::string name;
  std::unique_ptr<Player> player;
  std::vector<std::string> pictures{};  ///< without a player: files by frame, see load_display
};

struct EvaluateOptions {
  uint32_t first_frame = 0;  ///< number of the source's first frame, for plots
  bool timed = true;         ///< measure the dispatches of each frame
  uint32_t shown = 0;        ///< frames whose pictures are kept, the last and others before it
  /// Of generated pictures: frames with a margin around the picture, which methods get in place of the source's own; what they
  /// make of the margin is cut off.
  SceneSource* with_margin = nullptr;
};

/// Plays the source through every method, all started without a past; shows progress on a terminal.
/// Errors: kBadInput without a ground truth, without a picture for each frame, or if the user interrupts; those of the
/// player, with the method's name, and of pictures, with theirs.
Result<EvalScene> evaluate_scene(FrameSource& source, std::vector<PlayedMethod>& methods,
                                 const EvaluateOptions& options);

/// Plays a scene's frames through methods that generate, and judges what they show at `times` behind each frame (above 0 up to
/// 1 frame, ascending) and the frames themselves (none where the last time is 1). Where render and output size are equal, the
/// frames are the truth, so that generation alone is judged. Behind the methods the report has what the truth's own motion
/// makes of true frames, between them and ahead, as far as a method does the same: a bound for all that only warps.
/// `names` become those of the report. A picture before a cut is left out.
/// Errors: as evaluate_scene; kBadInput for a method without such a program, and for pictures.
Result<EvalScene> evaluate_generated(SceneSource& source, std::vector<PlayedMethod>& methods,
                                     std::span<const double> times, const EvaluateOptions& options,
                                     std::vector<std::string>& names);

/// The figures of generated pictures as a table on standard output.
void print_generated(const std::vector<std::string>& methods, const EvalScene& scene);

/// The next frame of a reference as a display shows it; the rest of the truth, where it is known, and the camera are the
/// frame's. `previous` is the camera of the frame before, and becomes this one's.
/// Errors: as ReferenceTrack::advance.
Result<void> advance(ReferenceTrack& track, FloatImage display, const SourceFrame& frame,
                     std::optional<FrameCamera>& previous);

/// The measures over time as a table on standard output, a line a method.
/// Precondition: as many means as methods.
void print_over_time(const std::vector<std::string>& methods,
                     const std::vector<const SequenceMetrics*>& means);

}  // namespace shale
