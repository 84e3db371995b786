// tools/scene/pose.h -- where everything in a scene is at a frame.
#pragma once

#include <vector>

#include "tools/scene/scene.h"

namespace shale {

struct CameraPose {
  Vec3 eye;
  Vec3 right, up, forward;  ///< orthonormal; cross(right, up) is -forward
  bool operator==(const CameraPose&) const = default;
};

/// Between keys as the camera interpolates, held before the first and after the last; keys before a
/// cut have no influence behind it.
CameraPose camera_pose(const SceneCamera& camera, double frame);

/// True if a key of a cut lies behind `frame - step` and not behind `frame`.
bool is_camera_cut(const SceneCamera& camera, double frame, double step = 1);

/// The factor of one of the scene's signals, 1 for kSteady. With a `variant` other than 0 it has
/// phases and noise of its own.
Vec3 signal_value(const Scene& scene, int signal, double frame, uint32_t variant = 0);

/// Exposure at a frame.
double exposure_at(const Scene& scene, double frame);

/// Towards the sun; a unit vector.
Vec3 sun_direction(const Sun& sun, double frame);

/// From node to world, by node.
std::vector<Affine> node_poses(const Scene& scene, double frame);

/// A camera-facing disc.
struct Particle {
  Vec3 at;
  double radius = 0;
  Vec3 color;  ///< emitted light; times opacity where it is blended
  double opacity = 0;
  bool additive = true, soft = true;
};

/// All that are alive at a frame, in order of emitters.
std::vector<Particle> particles_at(const Scene& scene, const std::vector<Affine>& nodes,
                                   double frame);

}  // namespace shale
