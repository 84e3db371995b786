// runtime/frame/camera.h -- what frame passes need to know of a camera, from what engines know.
#pragma once

#include <array>

namespace shale {

/// A perspective camera whose depth buffer holds values in [0, 1].
struct DepthProjection {
  float near_plane = 0.1f;     ///< metres, above 0
  float far_plane = 0;         ///< metres; infinite if 0 or less
  float fov_x = 1, fov_y = 1;  ///< radians
  bool reverse = false;        ///< 1 is near, 0 is far
};

/// D of the parameter "depth_to_view": a depth d lies at the view distance D[1] / (d - D[0])
/// metres; D[2] and D[3] are the tangents of half the field of view across and down.
/// Source: NSS notes, section 2.1, which have it from FSR 2.
std::array<float, 4> depth_to_view(const DepthProjection& projection);

}  // namespace shale
