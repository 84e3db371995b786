#include "runtime/frame/camera.h"

#include <cmath>
#include <limits>

namespace shale {

std::array<float, 4> depth_to_view(const DepthProjection& projection) {
  // In float, an infinite far plane leaves depth 1 one step away from the pole.
  constexpr double kEpsilon = std::numeric_limits<float>::epsilon();
  const double near_plane = projection.near_plane, far_plane = projection.far_plane;
  double c = 0, k = 0;
  if (far_plane <= 0) {
    c = projection.reverse ? kEpsilon : -1 - kEpsilon;
    k = projection.reverse ? near_plane : -near_plane - kEpsilon;
  } else {
    const double low = projection.reverse ? far_plane : near_plane;
    const double high = projection.reverse ? near_plane : far_plane;
    c = high / (low - high);
    k = c * low;
  }
  return {static_cast<float>(-c), static_cast<float>(k),
          static_cast<float>(std::tan(projection.fov_x / 2.0)),
          static_cast<float>(std::tan(projection.fov_y / 2.0))};
}

}  // namespace shale
