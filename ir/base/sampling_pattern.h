// ir/base/sampling_pattern.h -- where in its render pixel each frame of a sequence is sampled, as data: what a sandwich
// expects (frame.json) and what a scene is rendered with.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "ir/base/result.h"

namespace shale {

struct SamplingPattern {
  enum class Kind {
    kHalton,  ///< any ratio
    kMnss,    ///< ratios 2 and 3: the centres of the output pixels that a render pixel covers
    kList,    ///< `offsets`, one a frame, over and over
  };
  Kind kind = Kind::kHalton;
  /// Of a list: sample minus centre of the render pixel, (x, y) in render pixels, [-0.5, 0.5].
  std::vector<std::array<float, 2>> offsets;

  bool operator==(const SamplingPattern&) const = default;
};

inline constexpr size_t kMaxPatternOffsets = 4096;

/// A pattern of these offsets.
/// Errors: kBadInput for none, too many, or one outside of the pixel.
Result<SamplingPattern> pattern_of(std::vector<std::array<float, 2>> offsets);

/// "halton", "mnss", or offsets: "0.25,-0.25:-0.25,0.25".
/// Errors: kBadInput.
Result<SamplingPattern> parse_pattern(std::string_view text);

/// "halton", "mnss" or "list".
std::string pattern_name(const SamplingPattern& pattern);

/// What parse_pattern reads.
std::string pattern_text(const SamplingPattern& pattern);

}  // namespace shale
