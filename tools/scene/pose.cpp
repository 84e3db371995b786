#include "tools/scene/pose.h"

#include <algorithm>
#include <span>

namespace shale {
namespace {

constexpr double kTwoPi = 6.283185307179586;

/// Value of a track of keys at a frame. Smooth is cubic Hermite with the slopes of Catmull and Rom,
/// zero at both ends.
template <typename Key, typename Value>
Vec3 track(std::span<const Key> keys, double frame, bool smooth, Value value) {
  if (keys.empty()) return {};
  if (frame <= keys.front().frame) return value(keys.front());
  if (frame >= keys.back().frame) return value(keys.back());
  size_t i = 1;
  while (keys[i].frame < frame) ++i;
  const Key& a = keys[i - 1];
  const Key& b = keys[i];
  const double span = b.frame - a.frame;
  const double s = (frame - a.frame) / span;
  if (!smooth) return mix(value(a), value(b), s);
  const auto slope = [&](size_t k) -> Vec3 {
    if (k == 0 || k + 1 == keys.size()) return {};
    return (value(keys[k + 1]) - value(keys[k - 1])) *
           (1 / (keys[k + 1].frame - keys[k - 1].frame));
  };
  const double s2 = s * s, s3 = s2 * s;
  return value(a) * (2 * s3 - 3 * s2 + 1) + slope(i - 1) * ((s3 - 2 * s2 + s) * span) +
         value(b) * (3 * s2 - 2 * s3) + slope(i) * ((s3 - s2) * span);
}

/// The keys from the last cut at or before `frame` to the next one.
std::span<const CameraKey> run_of_keys(const SceneCamera& camera, double frame) {
  const std::span<const CameraKey> all(camera.path);
  size_t first = 0, end = all.size();
  for (size_t i = 1; i < all.size(); ++i) {
    if (!all[i].cut) continue;
    if (all[i].frame <= frame) {
      first = i;
    } else {
      end = i;
      break;
    }
  }
  return all.subspan(first, end - first);
}

/// In [0, 1), from a seed and a whole number.
double random_at(uint32_t seed, double index) {
  return scene_hash(seed, static_cast<uint32_t>(static_cast<int64_t>(index))) * 0x1p-32;
}

/// Smooth noise in [0, 1).
double noise(uint32_t seed, double at) {
  const double cell = std::floor(at), part = at - cell;
  const double s = part * part * (3 - 2 * part);
  return random_at(seed, cell) * (1 - s) + random_at(seed, cell + 1) * s;
}

Affine moved(const SceneNode& node, double frame) {
  const Animation& a = node.animation;
  Affine result;
  result.at = node.at + track(std::span<const PositionKey>(a.path), frame, a.smooth,
                              [](const PositionKey& key) { return key.at; });
  if (!(a.bob == Vec3{}))
    result.at = result.at + a.bob * std::sin(kTwoPi * (frame / a.bob_period + a.bob_phase));
  if (node.rotate.y != 0) result = result * rotation({0, 1, 0}, node.rotate.y);
  if (node.rotate.x != 0) result = result * rotation({1, 0, 0}, node.rotate.x);
  if (node.rotate.z != 0) result = result * rotation({0, 0, 1}, node.rotate.z);
  if (a.swing_degrees != 0)
    result = result * rotation(a.swing_axis,
                               a.swing_degrees *
                                   std::sin(kTwoPi * (frame / a.swing_period + a.swing_phase)));
  if (a.spin_degrees != 0)
    result = result * rotation(a.spin_axis, std::fmod(a.spin_degrees * frame, 360.0));
  result = result * node.aim;
  result.x = result.x * node.scale;
  result.y = result.y * node.scale;
  result.z = result.z * node.scale;
  return result;
}

}  // namespace

CameraPose camera_pose(const SceneCamera& camera, double frame) {
  const std::span<const CameraKey> keys = run_of_keys(camera, frame);
  CameraPose pose;
  pose.eye = track(keys, frame, camera.smooth, [](const CameraKey& key) { return key.eye; });
  const Vec3 target =
      track(keys, frame, camera.smooth, [](const CameraKey& key) { return key.target; });
  const double roll = track(keys, frame, camera.smooth, [](const CameraKey& key) {
                        return Vec3{key.roll, 0, 0};
                      }).x;
  pose.forward = normalized(target - pose.eye, {0, 0, -1});
  const Vec3 helper = std::abs(pose.forward.y) < 0.9999 ? Vec3{0, 1, 0} : Vec3{0, 0, -1};
  pose.right = normalized(cross(pose.forward, helper), {1, 0, 0});
  if (roll != 0) pose.right = rotation(pose.forward, roll).direction(pose.right);
  pose.up = cross(pose.right, pose.forward);
  return pose;
}

bool is_camera_cut(const SceneCamera& camera, double frame, double step) {
  return std::any_of(camera.path.begin(), camera.path.end(), [&](const CameraKey& key) {
    return key.cut && key.frame > frame - step && key.frame <= frame;
  });
}

Vec3 signal_value(const Scene& scene, int signal, double frame, uint32_t variant) {
  if (signal == kSteady) return {1, 1, 1};
  const Signal& s = scene.signals[static_cast<size_t>(signal)];
  const uint32_t seed = variant == 0 ? s.seed : scene_hash(s.seed, variant);
  const double phase = variant * 0x1p-32;
  Vec3 value{1, 1, 1};
  if (!s.path.empty()) {
    const double at = s.repeat > 0 ? frame - std::floor(frame / s.repeat) * s.repeat : frame;
    if (s.between == Signal::Between::kStep) {
      for (const SignalKey& key : s.path)
        if (key.frame <= at || &key == s.path.data()) value = key.value;
    } else {
      value = track(std::span<const SignalKey>(s.path), at, s.between == Signal::Between::kSmooth,
                    [](const SignalKey& key) { return key.value; });
    }
  }
  double factor = 1;
  if (s.flicker_amount > 0)
    factor *= 1 - s.flicker_amount *
                      (2 * noise(seed, frame / s.flicker_period) +
                       noise(~seed, 2.7 * frame / s.flicker_period)) /
                      3;
  if (s.wave_amount > 0)
    factor *= 1 - s.wave_amount * 0.5 *
                      (1 - std::cos(kTwoPi * (frame / s.wave_period + s.wave_phase + phase)));
  value = value * factor;
  // A smooth path may swing below 0.
  value = {std::max(value.x, 0.0), std::max(value.y, 0.0), std::max(value.z, 0.0)};
  if (s.blink_period > 0) {
    const double turns = frame / s.blink_period + s.blink_phase + phase;
    const double drawn =
        s.blink_random ? random_at(seed, std::floor(turns)) : turns - std::floor(turns);
    if (drawn >= s.blink_on) value = value * s.blink_off;
  }
  return value;
}

double exposure_at(const Scene& scene, double frame) {
  return scene.exposure * signal_value(scene, scene.exposure_signal, frame).x;
}

Vec3 sun_direction(const Sun& sun, double frame) {
  const Vec3 direction = track(std::span<const DirectionKey>(sun.path), frame, false,
                               [](const DirectionKey& key) { return key.direction; });
  return normalized(direction, {0, 1, 0});
}

std::vector<Affine> node_poses(const Scene& scene, double frame) {
  std::vector<Affine> poses;
  poses.reserve(scene.nodes.size());
  // A parent always stands before its children.
  for (const SceneNode& node : scene.nodes) {
    const Affine own = moved(node, frame);
    poses.push_back(node.parent < 0 ? own : poses[static_cast<size_t>(node.parent)] * own);
  }
  return poses;
}

std::vector<Particle> particles_at(const Scene& scene, const std::vector<Affine>& nodes,
                                   double frame) {
  std::vector<Particle> result;
  for (const Emitter& e : scene.emitters) {
    const Affine& pose = nodes[static_cast<size_t>(e.node)];
    for (uint32_t i = 0; i < e.count; ++i) {
      const uint32_t own = scene_hash(e.seed, i);
      const double lives = frame / e.life + own * 0x1p-32;
      const double life = std::floor(lives);
      const double age = (lives - life) * e.life, part = lives - life;
      const uint32_t seed = scene_hash(own, static_cast<uint32_t>(static_cast<int64_t>(life)));
      const auto random = [&](uint32_t k) { return scene_hash(seed, k) * 0x1p-32 - 0.5; };
      const Vec3 birth{e.area.x * random(1), e.area.y * random(2), e.area.z * random(3)};
      const Vec3 velocity =
          e.velocity +
          Vec3{e.spread.x * 2 * random(4), e.spread.y * 2 * random(5), e.spread.z * 2 * random(6)};
      Particle p;
      p.at = pose.point(birth + velocity * age + e.gravity * (0.5 * age * age));
      p.radius = e.size_start + (e.size_end - e.size_start) * part;
      p.opacity = e.opacity * std::min(1.0, std::min(part, 1 - part) * 8);
      p.color = mix(e.color_start, e.color_end, part) * (e.emission * p.opacity);
      p.additive = e.additive;
      p.soft = e.soft;
      if (p.radius > 0 && p.opacity > 0) result.push_back(p);
    }
  }
  return result;
}

}  // namespace shale
