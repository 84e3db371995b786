// tools/shale/animation.h -- frames as one animated PNG.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "ir/base/result.h"
#include "tools/eval/html_report.h"

namespace shale {

/// Plays the frames for ever; all must have one size. Source: PNG third edition, acTL, fcTL, fdAT.
/// Errors: kBadInput if there is no frame or the sizes differ; kIo.
Result<void> save_animation(const std::string& path, std::span<const PngPicture> frames,
                            uint16_t frames_per_second);

}  // namespace shale
