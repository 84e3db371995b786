#include "tools/shale/measure_needs.h"

#include <algorithm>
#include <cmath>

#include "runtime/frame/camera.h"
#include "tools/eval/sequence.h"
#include "tools/scene/pose.h"

namespace shale {
namespace {

constexpr double kOwnMotionPixels = 0.25, kOwnMotionShare = 1.0 / 512;  ///< halves round motion
constexpr double kStillPixels = 0.03;
constexpr uint32_t kBlock = 8;
constexpr double kLightStep =
    0.02;  ///< of luma in the Karis domain, beside a half of the block's deviation
constexpr double kChangedShare = 0.01, kThinShare = 0.01, kLeastStillShare = 0.05;
constexpr float kAlike = 1.05f;

using Matrix = std::array<double, 16>;  // column-major

std::array<double, 4> times(const Matrix& m, const std::array<double, 4>& v) {
  std::array<double, 4> result{};
  for (size_t c = 0; c < 4; ++c)
    for (size_t r = 0; r < 4; ++r) result[r] += m[4 * c + r] * v[c];
  return result;
}

/// By Gauss and Jordan with the largest pivot; nothing if there is no inverse.
std::optional<Matrix> inverse(const std::array<float, 16>& of) {
  Matrix a{}, result{};
  for (size_t i = 0; i < 16; ++i) a[i] = static_cast<double>(of[i]);
  for (size_t i = 0; i < 4; ++i) result[5 * i] = 1;
  for (size_t c = 0; c < 4; ++c) {
    size_t pivot = c;
    for (size_t r = c; r < 4; ++r)
      if (std::abs(a[4 * c + r]) > std::abs(a[4 * c + pivot])) pivot = r;
    if (!(std::abs(a[4 * c + pivot]) > 1e-12)) return std::nullopt;
    for (size_t k = 0; k < 4; ++k) {
      std::swap(a[4 * k + c], a[4 * k + pivot]);
      std::swap(result[4 * k + c], result[4 * k + pivot]);
    }
    const double scale = 1 / a[4 * c + c];
    for (size_t k = 0; k < 4; ++k) a[4 * k + c] *= scale, result[4 * k + c] *= scale;
    for (size_t r = 0; r < 4; ++r) {
      const double factor = a[4 * c + r];
      if (r == c || factor == 0) continue;
      for (size_t k = 0; k < 4; ++k) {
        a[4 * k + r] -= factor * a[4 * k + c];
        result[4 * k + r] -= factor * result[4 * k + c];
      }
    }
  }
  return result;
}

Matrix widened(const std::array<float, 16>& of) {
  Matrix result{};
  std::copy(of.begin(), of.end(), result.begin());
  return result;
}

template <typename Values>
void widen(std::optional<std::array<double, 2>>& range, const Values& values) {
  for (const float value : values) {
    if (!std::isfinite(value)) continue;
    const double v = static_cast<double>(value);
    if (!range) range = {v, v};
    (*range)[0] = std::min((*range)[0], v);
    (*range)[1] = std::max((*range)[1], v);
  }
}

bool all_finite(const FloatImage& image) {
  return std::all_of(image.values.begin(), image.values.end(),
                     [](float value) { return std::isfinite(value); });
}

/// Upwards to two digits behind the point, so that a file reads well and still holds.
double rounded_up(double value) { return std::max(0.0, std::ceil(value * 100 - 1e-9) / 100); }
double rounded_down(double value) { return std::floor(value * 100 + 1e-9) / 100; }

}  // namespace

Result<void> NeedsMeter::add(const SourceFrame& frame) {
  const Extent size{frame.color.width, frame.color.height};
  if (frame.color.empty() || frame.depth.empty() || frame.motion.empty())
    return bad_input("", "has no {}, which its needs follow from",
                     frame.color.empty() ? "colour" : (frame.depth.empty() ? "depth" : "motion"));
  if (needs_.render && size != size_)
    return bad_input("", "has {}x{} pixels, the frames before {}x{}", size.width, size.height,
                     size_.width, size_.height);
  if (!needs_.render) {
    size_ = size;
    needs_ = {.camera_moves = false,
              .objects_move = false,
              .cuts = false,
              .light_changes = {},
              .thin_features = {},
              .finite = true,
              .motion_pixels = 0.0,
              .render = std::array<double, 2>{static_cast<double>(size.width),
                                              static_cast<double>(size.height)},
              .exposed = {},
              .depth = {}};
  }
  if (frame.camera.cut && has_previous_) needs_.cuts = true;
  if (frame.camera.cut) has_previous_ = false;
  if (has_previous_ && !same_view(previous_camera_, frame.camera)) needs_.camera_moves = true;
  needs_.finite = *needs_.finite && all_finite(frame.color) && all_finite(frame.depth) &&
                  all_finite(frame.motion);
  std::vector<float> exposed;
  for (const float value : frame.color.values)
    exposed.push_back(std::max(value, 0.0f) * frame.camera.exposure);
  widen(needs_.exposed, exposed);
  const std::array<float, 4> d = depth_to_view({.near_plane = frame.camera.near_plane,
                                                .far_plane = frame.camera.far_plane,
                                                .fov_x = frame.camera.fov_x,
                                                .fov_y = frame.camera.fov_y,
                                                .reverse = frame.camera.reverse_depth});
  std::vector<float> metres;
  for (const float value : frame.depth.values)
    if (value != (frame.camera.reverse_depth ? 0.0f : 1.0f))
      metres.push_back(d[1] / (value - d[0]));
  widen(needs_.depth, metres);
  add_motion(frame);
  add_light(frame);
  previous_camera_ = frame.camera;
  has_previous_ = true;
  return {};
}

void NeedsMeter::add_motion(const SourceFrame& frame) {
  const std::optional<Matrix> back =
      has_previous_ ? inverse(frame.camera.view_projection) : std::optional<Matrix>();
  const Matrix before = widened(previous_camera_.view_projection);
  for (uint32_t y = 0; y < size_.height; ++y)
    for (uint32_t x = 0; x < size_.width; ++x) {
      const float* const motion = frame.motion.at(x, y);
      const double mx = static_cast<double>(motion[0]) * size_.width,
                   my = static_cast<double>(motion[1]) * size_.height, pixels = std::hypot(mx, my);
      if (!std::isfinite(pixels)) continue;
      needs_.motion_pixels = std::max(*needs_.motion_pixels, pixels);
      if (!back || *needs_.objects_move) continue;
      // The sample's place in the world, through the camera that was. Jitter does not move the cameras.
      const double u = (x + 0.5 + static_cast<double>(frame.camera.jitter[0])) / size_.width,
                   v = (y + 0.5 + static_cast<double>(frame.camera.jitter[1])) / size_.height;
      const auto world =
          times(*back, {2 * u - 1, 1 - 2 * v, static_cast<double>(*frame.depth.at(x, y)), 1});
      const auto clip = times(before, world);
      if (!(std::abs(clip[3]) > 1e-9)) continue;
      const double own_x = mx - (u - (clip[0] / clip[3] + 1) / 2) * size_.width,
                   own_y = my - (v - (1 - clip[1] / clip[3]) / 2) * size_.height;
      if (std::hypot(own_x, own_y) > kOwnMotionPixels + kOwnMotionShare * pixels)
        needs_.objects_move = true;
    }
}

void NeedsMeter::add_light(const SourceFrame& frame) {
  std::vector<float> lumas;
  lumas.reserve(size_t{size_.width} * size_.height);
  for (uint32_t y = 0; y < size_.height; ++y)
    for (uint32_t x = 0; x < size_.width; ++x) {
      const float* const c = frame.color.at(x, y);
      const float luma = frame.camera.exposure * (0.25f * c[0] + 0.5f * c[1] + 0.25f * c[2]);
      lumas.push_back(luma > 0 ? luma / (1 + luma) : 0);
    }
  add_thin(lumas);
  std::vector<bool> still;
  for (uint32_t by = 0; by + kBlock <= size_.height; by += kBlock)
    for (uint32_t bx = 0; bx + kBlock <= size_.width; bx += kBlock) {
      double now = 0, square = 0, then = 0, moved = 0;
      for (uint32_t y = by; y < by + kBlock; ++y)
        for (uint32_t x = bx; x < bx + kBlock; ++x) {
          const float* const m = frame.motion.at(x, y);
          moved = std::max(moved, std::hypot(static_cast<double>(m[0]) * size_.width,
                                             static_cast<double>(m[1]) * size_.height));
          const size_t i = size_t{y} * size_.width + x;
          const double luma = static_cast<double>(lumas[i]);
          now += luma;
          square += luma * luma;
          if (has_previous_) then += static_cast<double>(previous_lumas_[i]);
        }
      constexpr double kCount = kBlock * kBlock;
      now /= kCount, square /= kCount, then /= kCount;
      const double deviation = std::sqrt(std::max(square - now * now, 0.0));
      still.push_back(moved <= kStillPixels);
      ++blocks_;
      // What moves away leaves a place that did not move.
      if (!has_previous_ || !still.back() || !previous_still_[still.size() - 1]) continue;
      ++still_blocks_;
      changed_blocks_ += std::abs(now - then) > kLightStep + 0.5 * deviation;
    }
  previous_lumas_ = std::move(lumas);
  previous_still_ = std::move(still);
}

void NeedsMeter::add_thin(const std::vector<float>& lumas) {
  const size_t width = size_.width;
  for (size_t y = 1; y + 1 < size_.height; ++y)
    for (size_t x = 1; x + 1 < width; ++x) {
      const float centre = lumas[y * width + x];
      std::array<bool, 9> alike{};
      float low = 1e9f, high = -1;
      for (size_t i = 0; i < 9; ++i) {
        const float luma = lumas[(y + i / 3 - 1) * width + x + i % 3 - 1];
        alike[i] = i == 4 || std::max(luma, centre) < kAlike * std::min(luma, centre) + 1e-3f;
        if (alike[i]) continue;
        low = std::min(low, luma);
        high = std::max(high, luma);
      }
      const bool is_area = (alike[0] && alike[1] && alike[3]) ||
                           (alike[1] && alike[2] && alike[5]) ||
                           (alike[3] && alike[6] && alike[7]) || (alike[5] && alike[7] && alike[8]);
      ++texels_;
      thin_ += (centre > high || centre < low) && !is_area;
    }
}

SceneNeeds NeedsMeter::needs() const {
  SceneNeeds needs = needs_;
  needs.motion_pixels = rounded_up(*needs.motion_pixels);
  if (needs.exposed)
    needs.exposed = {rounded_down((*needs.exposed)[0]), rounded_up((*needs.exposed)[1])};
  if (needs.depth) needs.depth = {rounded_down((*needs.depth)[0]), rounded_up((*needs.depth)[1])};
  if (texels_ > 0)
    needs.thin_features = static_cast<double>(thin_) > kThinShare * static_cast<double>(texels_);
  if (static_cast<double>(still_blocks_) > kLeastStillShare * static_cast<double>(blocks_))
    needs.light_changes =
        static_cast<double>(changed_blocks_) > kChangedShare * static_cast<double>(still_blocks_);
  return needs;
}

SceneNeeds needs_of_scene(const Scene& scene, uint32_t first, uint32_t frames,
                          const SceneNeeds& measured) {
  SceneNeeds needs = measured;
  bool camera_moves = false, objects_move = false, cuts = false;
  const auto is_used = [](int signal) { return signal != kSteady; };
  const bool light_changes =
      is_used(scene.exposure_signal) || is_used(scene.sun.signal) || is_used(scene.sky.signal) ||
      scene.sun.path.size() > 1 || !scene.emitters.empty() ||
      std::any_of(scene.lights.begin(), scene.lights.end(),
                  [&](const Light& light) { return is_used(light.signal); }) ||
      std::any_of(scene.materials.begin(), scene.materials.end(),
                  [&](const Material& material) {
                    return is_used(material.signal) || material.change > 0 ||
                           material.scroll_x != 0 || material.scroll_y != 0;
                  }) ||
      !scene.overlays.empty();
  for (uint32_t i = 1; i < frames; ++i) {
    const double now = first + i, before = now - 1;
    const bool cut = is_camera_cut(scene.camera, now);
    cuts = cuts || cut;
    camera_moves = camera_moves ||
                   (!cut && camera_pose(scene.camera, now) != camera_pose(scene.camera, before));
    objects_move = objects_move || node_poses(scene, now) != node_poses(scene, before);
  }
  needs.camera_moves = camera_moves;
  needs.objects_move = objects_move;
  needs.cuts = cuts;
  // Shadows move with what casts them.
  needs.light_changes = light_changes || objects_move;
  return needs;
}

}  // namespace shale
