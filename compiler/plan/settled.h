// compiler/plan/settled.h -- frames whose passes run only where something happens.
//
// A tile of the picture is settled if for kSettledFrames in a row all that the host gave of it was what it was when the frame
// last had the same phase (the same parameters, jitter among them), and the mean of what is shown changed by no more than
// the tolerance from one frame to the next. Where a tile and those around it are settled no pass runs: histories keep
// what they hold. In front of a frame's passes stand
//
//   phase  finds out which of the last phases the frame has
//   look   hashes what the host gave, tile by tile, and marks the tiles that are not settled
//   find   of each pass the workgroups near a marked tile: a list, and a grid to dispatch by
//
// behind a pass that writes histories a copy of what did not run, where the ring's next image does not hold it yet (the
// first time as the mean of what was shown while it rested, which `mean` follows), and behind all of them `rest`, which
// sees how much of what is shown changed.
#pragma once

#include "compiler/plan/run_pass.h"

namespace shale {

inline constexpr uint32_t kSettledFrames = 32;
/// That are remembered: patterns have 8 times the squared ratio of phases, which is at most 72 at a ratio of 3.
inline constexpr uint32_t kSettledPhases = 80;

/// Lets the passes of the frame's rendering programs run so, where options.tiles, 1 and up, is the display codes by which
/// the mean of a tile that rests may change from frame to frame. `is_linear`: histories lie in buffers. Does nothing where passes have forms for promises that are kept: these run whole.
/// Behind add_images, and with the text of all shaders.
/// Errors: kBadInput if Frame::settles names no image that passes keep by workgroups, or several programs render.
Result<void> settle(Plan& plan, std::span<std::vector<RunPass>> programs,
                    const LoweringOptions& options, bool is_linear, WeightBlob& weights);

}  // namespace shale
