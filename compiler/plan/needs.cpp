#include "compiler/plan/needs.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "ir/base/json.h"

namespace shale {
namespace {

using Json = nlohmann::ordered_json;

/// Calls `visit` with the name and the place of each member, in the order of the file.
template <typename Needs, typename Visit>
void for_each_member(Needs& needs, Visit visit) {
  visit("render", needs.render);
  visit("camera_moves", needs.camera_moves);
  visit("objects_move", needs.objects_move);
  visit("motion_pixels", needs.motion_pixels);
  visit("cuts", needs.cuts);
  visit("light_changes", needs.light_changes);
  visit("thin_features", needs.thin_features);
  visit("finite", needs.finite);
  visit("exposed", needs.exposed);
  visit("depth", needs.depth);
}

std::string found(const Json& json) {
  const std::string text = json.dump(-1, ' ', true, Json::error_handler_t::replace);
  return text.size() > 40 ? text.substr(0, 40) + "..." : text;
}

bool is_amount(const Json& json) {
  return json.is_number() && std::isfinite(json.get<double>()) && json.get<double>() >= 0;
}

Result<void> take(const char* name, const Json& json, std::optional<bool>& member) {
  if (!json.is_boolean())
    return bad_input("needs", "\"{}\" is {}, expected true or false", name, found(json));
  member = json.get<bool>();
  return {};
}

Result<void> take(const char* name, const Json& json, std::optional<double>& member) {
  if (!is_amount(json))
    return bad_input("needs", "\"{}\" is {}, expected a number of at least 0", name, found(json));
  member = json.get<double>();
  return {};
}

Result<void> take(const char* name, const Json& json,
                  std::optional<std::array<double, 2>>& member) {
  if (!json.is_array() || json.size() != 2 || !is_amount(json[0]) || !is_amount(json[1]))
    return bad_input("needs", "\"{}\" is {}, expected two numbers of at least 0", name,
                     found(json));
  member = {json[0].get<double>(), json[1].get<double>()};
  return {};
}

/// What no scene can need at once.
Result<void> check(const SceneNeeds& needs) {
  if (needs.render && ((*needs.render)[0] < 1 || (*needs.render)[1] < 1))
    return bad_input("needs", "\"render\" is {}x{}, expected a width and a height",
                     (*needs.render)[0], (*needs.render)[1]);
  const auto ordered = [](const char* name, const auto& range) -> Result<void> {
    if (range && (*range)[0] > (*range)[1])
      return bad_input("needs", "\"{}\" runs from {} to {}, expected the lesser one first", name,
                       (*range)[0], (*range)[1]);
    return {};
  };
  SHALE_TRY_VOID(ordered("exposed", needs.exposed));
  SHALE_TRY_VOID(ordered("depth", needs.depth));
  if (needs.camera_moves == false && needs.objects_move == false &&
      needs.motion_pixels.value_or(0) > 0)
    return bad_input("needs", "\"motion_pixels\" is {}, but neither the camera nor objects move",
                     *needs.motion_pixels);
  if (needs.motion_pixels.value_or(0) > 0 && !needs.render)
    return bad_input("needs", "\"motion_pixels\" is {}, and \"render\" does not say of what size",
                     *needs.motion_pixels);
  return {};
}

}  // namespace

Result<SceneNeeds> parse_needs(const std::string& text) {
  SHALE_TRY(const Json json, parse_json<Json>(text));
  if (!json.is_object()) return bad_input("", "is no JSON object");
  if (json.value("schema", Json()) != kNeedsSchema)
    return bad_input("needs", "schema {} is unknown, expected \"{}\"",
                     found(json.value("schema", Json())), kNeedsSchema);
  SceneNeeds needs;
  std::vector<std::string> names{"schema"};
  Result<void> taken;
  for_each_member(needs, [&](const char* name, auto& member) {
    names.emplace_back(name);
    if (taken && json.contains(name)) taken = take(name, json[name], member);
  });
  for (const auto& [key, value] : json.items())
    if (std::find(names.begin(), names.end(), key) == names.end())
      return bad_input("needs", "field {} is unknown, expected one of {}", found(key),
                       fmt::join(names, ", "));
  SHALE_TRY_VOID(taken);
  SHALE_TRY_VOID(check(needs));
  if (needs.camera_moves == false && needs.objects_move == false) needs.motion_pixels = 0;
  return needs;
}

SceneNeeds united(const SceneNeeds& a, const SceneNeeds& b) {
  const auto either = [](std::optional<bool> x, std::optional<bool> y, bool decides) {
    if (x == decides || y == decides) return std::optional(decides);
    return x && y ? x : std::optional<bool>();
  };
  using Range = std::optional<std::array<double, 2>>;
  const auto hull = [](const Range& x, const Range& y) -> Range {
    if (!x || !y) return std::nullopt;
    return std::array{std::min((*x)[0], (*y)[0]), std::max((*x)[1], (*y)[1])};
  };
  SceneNeeds all{.camera_moves = either(a.camera_moves, b.camera_moves, true),
                 .objects_move = either(a.objects_move, b.objects_move, true),
                 .cuts = either(a.cuts, b.cuts, true),
                 .light_changes = either(a.light_changes, b.light_changes, true),
                 .thin_features = either(a.thin_features, b.thin_features, true),
                 .finite = either(a.finite, b.finite, false),
                 .motion_pixels = {},
                 .render = a.render,
                 .exposed = hull(a.exposed, b.exposed),
                 .depth = hull(a.depth, b.depth)};
  if (!a.motion_pixels || !b.motion_pixels) return all;
  const double scale = a.render && b.render ? std::max((*a.render)[0] / (*b.render)[0],
                                                       (*a.render)[1] / (*b.render)[1])
                                            : 1;
  all.motion_pixels = std::max(*a.motion_pixels, *b.motion_pixels * scale);
  return all;
}

std::string needs_text(const SceneNeeds& needs) {
  Json json{{"schema", kNeedsSchema}};
  for_each_member(needs, [&](const char* name, const auto& member) {
    if (member) json[name] = *member;
  });
  // A line a field; lists stay in theirs.
  std::string text;
  for (const auto& [key, value] : json.items())
    text += fmt::format("{}  \"{}\": {}", text.empty() ? "{\n" : ",\n", key, value.dump());
  return text + "\n}\n";
}

}  // namespace shale
