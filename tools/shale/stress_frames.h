// tools/shale/stress_frames.h -- frames in closed form for stress tests: sequences that repeat after a cycle of
// frames, and faults to put into them. No renderer, so any size is cheap, and the same on every machine.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "ir/base/sampling_pattern.h"
#include "tools/scene/frame_source.h"

namespace shale {

/// What goes on in a sequence. All repeat after StressFrames::cycle() frames.
enum class Course {
  kStill,
  kMoving,    ///< a square goes round, with motion vectors
  kBlinking,  ///< light goes on and off without motion
  kCuts,      ///< every frame is a cut
  kExposure,  ///< exposure swings over ten stops
  kNan,       ///< 1 % of the texels of colour, depth and motion are NaN, others each frame
};
inline constexpr Course kCourses[] = {Course::kStill, Course::kMoving,   Course::kBlinking,
                                      Course::kCuts,  Course::kExposure, Course::kNan};
std::string_view course_name(Course course);

class StressFrames {
 public:
  /// Linear HDR of 0 to 20; with `display` what a display shows of it.
  StressFrames(Extent render, Extent output, SamplingPattern pattern, bool display)
      : render_(render), output_(output), pattern_(std::move(pattern)), display_(display) {}

  /// Frames after which everything repeats: a multiple of the jitter's, 32 or more.
  uint32_t cycle() const;
  SourceFrame frame(Course course, uint32_t index) const;

 private:
  Extent render_, output_;
  SamplingPattern pattern_;
  bool display_;
};

/// Something that no renderer should send, and some that all send.
struct Fault {
  std::string_view group, name;
  /// Sandwiches that it means something to: any, those of linear colours, those that take depth and motion.
  enum class For { kAny, kLinear, kTemporal } of;
  void (*apply)(SourceFrame& frame);
};
std::span<const Fault> faults();

/// A step of the search for inputs that part two precisions: the light of a block of texels, of one frame or of all.
struct Relight {
  static constexpr uint32_t kBlock = 8;  ///< texels per axis; cut at the border
  static constexpr uint32_t kAllFrames = UINT32_MAX;
  uint32_t x = 0, y = 0;  ///< first texel
  uint32_t frame = kAllFrames;
  int stops = 0;  ///< times 2^stops, at most the largest half, or 1 with `display`

  void apply(std::span<SourceFrame> frames, bool display) const;
};

/// The texel that the fault "one texel" spoils.
std::array<uint32_t, 2> spoilt_texel(Extent render);

}  // namespace shale
