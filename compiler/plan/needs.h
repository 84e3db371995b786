// compiler/plan/needs.h -- what a scene needs of an upscaler, as data: whatever it rules out, a package may leave out.
#pragma once

#include <array>
#include <optional>
#include <string>

#include "ir/base/result.h"

namespace shale {

inline constexpr const char* kNeedsSchema = "shale-needs/1";

/// What is known of all frames of a scene. What is not known may be anything.
struct SceneNeeds {
  std::optional<bool> camera_moves{}, objects_move{};
  std::optional<bool> cuts{};           ///< frames behind the first that continue nothing
  std::optional<bool> light_changes{};  ///< what stands still is shaded otherwise in another frame
  std::optional<bool> thin_features{};  ///< lines about as wide as a render pixel
  std::optional<bool> finite{};         ///< colour, depth and motion hold no NaN and no infinity
  std::optional<double> motion_pixels{};  ///< longest motion in a frame, in pixels of `render`
  std::optional<std::array<double, 2>> render{};   ///< width and height of the frames
  std::optional<std::array<double, 2>> exposed{};  ///< least and largest colour times exposure
  std::optional<std::array<double, 2>>
      depth{};  ///< nearest and farthest, metres; what is at the far plane left out
  bool operator==(const SceneNeeds&) const = default;
};

/// Reads untrusted JSON of schema "shale-needs/1": an object with the members of SceneNeeds that are known, by name, and
/// nothing else. Where neither the camera nor anything else moves, motion_pixels is 0 if it is absent.
/// Errors: kBadInput naming the field, what was found and what was expected; also for needs that contradict each other.
Result<SceneNeeds> parse_needs(const std::string& json);

/// What scenes need together: a member is known if it is known of both, or one alone decides it. Motion is in pixels of the
/// first one's size.
SceneNeeds united(const SceneNeeds& a, const SceneNeeds& b);

/// The file, as people would write it.
std::string needs_text(const SceneNeeds& needs);

}  // namespace shale
