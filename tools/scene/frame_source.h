// tools/scene/frame_source.h -- frames of a sequence with everything that a temporal upscaler reads,
// and the truth to judge it by; from a scene that is rendered, or from a captured dataset on disk.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "ir/base/result.h"

namespace shale {

/// Values of a picture, [height][width][channels] in row order from the top.
struct FloatImage {
  uint32_t width = 0, height = 0, channels = 0;
  std::vector<float> values;

  bool empty() const { return values.empty(); }
  const float* at(uint32_t x, uint32_t y) const {
    return &values[(size_t{y} * width + x) * channels];
  }
  float* at(uint32_t x, uint32_t y) { return &values[(size_t{y} * width + x) * channels]; }
};

struct Extent {
  uint32_t width = 0, height = 0;
  bool operator==(const Extent&) const = default;
};

/// A part of a picture, in pixels.
struct Crop {
  uint32_t x = 0, y = 0, width = 0, height = 0;
  bool operator==(const Crop&) const = default;
};

/// The camera of one frame.
struct FrameCamera {
  float fov_x = 0, fov_y = 0;  ///< radians
  float near_plane = 0.1f;     ///< metres
  float far_plane = 0;         ///< metres; infinite if 0 or less
  bool reverse_depth = false;  ///< depth 1 is near, 0 is far
  /// Render pixels in [-0.5, 0.5]: the sample stored in texel l lies at scene position l + 0.5 + j.
  std::array<float, 2> jitter{};
  float exposure = 1;                       ///< linear factor on colours
  bool cut = false;                         ///< nothing is continued from the frame before
  std::array<float, 16> view_projection{};  ///< column-major, without jitter
};

/// Colours are linear HDR. Motion is in uv of the whole picture, without jitter: what is seen at uv
/// was at uv - motion in the frame before. Depth is as the camera says, in [0, 1].
struct SourceFrame {
  FrameCamera camera;
  FloatImage color;   ///< RGB at render size, one jittered sample a pixel
  FloatImage depth;   ///< 1 channel at render size, of the same sample
  FloatImage motion;  ///< 2 channels at render size, of the same sample
  FloatImage truth;   ///< RGB at output size; empty if not asked for or not there
  FloatImage
      truth_motion;  ///< 2 channels at output size, of the nearest sample of a pixel; as truth
  FloatImage truth_depth;  ///< 1 channel at output size, of the nearest sample; as truth
};

/// Random access to the frames of one sequence.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual const std::string& name() const = 0;
  virtual uint32_t frame_count() const = 0;
  virtual Extent render_size() const = 0;
  virtual Extent output_size() const = 0;
  /// Errors: kBadInput for an index outside, or a file that is not as expected; kIo; kDevice.
  virtual Result<SourceFrame> frame(uint32_t index, bool with_truth) = 0;
};

}  // namespace shale
