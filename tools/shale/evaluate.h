// tools/shale/evaluate.h -- a scene through several sandwiches, measured against the truth.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "tools/eval/html_report.h"
#include "tools/shale/player.h"

namespace shale {

/// A sandwich that is ready to play.
struct PlayedMethod {
  std::string name;
  std::unique_ptr<Player> player;
};

struct EvaluateOptions {
  uint32_t first_frame = 0;  ///< number of the source's first frame, for plots
  bool timed = true;         ///< measure the dispatches of each frame
  uint32_t shown = 0;        ///< frames whose pictures are kept, the last and others before it
};

/// Plays the source through every method, all started without a past; shows progress on a terminal.
/// Errors: kBadInput without a ground truth, or if the user interrupts; those of the player, with the
/// method's name.
Result<EvalScene> evaluate_scene(FrameSource& source, std::vector<PlayedMethod>& methods,
                                 const EvaluateOptions& options);

}  // namespace shale
