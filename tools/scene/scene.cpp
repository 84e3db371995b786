#include "tools/scene/scene.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include "ir/base/file.h"
#include "ir/base/json.h"
#include "tools/scene/json_fields.h"

namespace shale {
namespace {

constexpr double kFar = 1e5;       ///< largest coordinate and size, metres
constexpr double kBright = 10000;  ///< largest colour and emission
constexpr size_t kMaxEntries = 4096;
constexpr size_t kMaxKeys = 1024;
constexpr int kMaxDepth = 8;
constexpr size_t kMaxNodes = 4 * kMaxPrimitives;

/// Numbers in [0, 1), one after the other.
class Random {
 public:
  explicit Random(uint32_t seed) : seed_(seed) {}
  uint32_t bits() { return scene_hash(seed_, count_++); }
  double next() { return bits() * 0x1p-32; }
  double between(double low, double high) { return low + (high - low) * next(); }

 private:
  uint32_t seed_, count_ = 0;
};

Result<void> check_order(const std::string& where, const std::vector<double>& frames) {
  for (size_t i = 1; i < frames.size(); ++i)
    if (!(frames[i] > frames[i - 1]))
      return bad_input(where, "frame {} follows frame {}, expected rising frames", frames[i],
                       frames[i - 1]);
  return {};
}

Result<SceneCamera> parse_camera(const Fields& fields) {
  SHALE_TRY_VOID(fields.only({"fov_y", "near", "far", "reverse_depth", "interpolation", "path"}));
  SceneCamera camera;
  SHALE_TRY(camera.fov_y, fields.number("fov_y", 5, 150, camera.fov_y));
  SHALE_TRY(camera.near_plane, fields.number("near", 1e-3, 100, camera.near_plane));
  SHALE_TRY(camera.far_plane, fields.number("far", 0, kFar * 10, 0.0));
  if (camera.far_plane > 0 && camera.far_plane <= camera.near_plane)
    return bad_input(fields.where(), "\"far\" is {}, expected more than \"near\", {}, or 0",
                     camera.far_plane, camera.near_plane);
  SHALE_TRY(camera.reverse_depth, fields.flag("reverse_depth", false));
  SHALE_TRY(const uint32_t kind, fields.choice("interpolation", {"linear", "smooth"}, 1));
  camera.smooth = kind == 1;
  SHALE_TRY(const std::vector<Fields> keys, fields.list("path", kMaxKeys));
  if (keys.empty()) return bad_input(fields.where(), "\"path\" has no keys, expected at least 1");
  std::vector<double> frames;
  for (const Fields& key : keys) {
    SHALE_TRY_VOID(key.only({"frame", "eye", "target", "roll", "cut"}));
    CameraKey parsed;
    SHALE_TRY(parsed.frame, key.number("frame", 0, kMaxSceneFrames));
    SHALE_TRY(parsed.eye, key.vec3("eye", -kFar, kFar));
    SHALE_TRY(parsed.target, key.vec3("target", -kFar, kFar));
    if (length(parsed.target - parsed.eye) < 1e-6)
      return bad_input(key.where(), "\"target\" is the same place as \"eye\"");
    SHALE_TRY(parsed.roll, key.number("roll", -360, 360, 0.0));
    SHALE_TRY(parsed.cut, key.flag("cut", false));
    if (parsed.cut && parsed.frame != std::floor(parsed.frame))
      return bad_input(key.where(), "a cut at frame {}, expected a whole number", parsed.frame);
    frames.push_back(parsed.frame);
    camera.path.push_back(parsed);
  }
  SHALE_TRY_VOID(check_order(fields.where() + ".path", frames));
  return camera;
}

Result<Sun> parse_sun(const Fields& fields) {
  SHALE_TRY_VOID(fields.only({"direction", "path", "color", "disc", "signal"}));
  Sun sun;
  SHALE_TRY(const std::vector<Fields> keys, fields.list("path", kMaxKeys));
  std::vector<double> frames;
  const auto add = [&](const Fields& key, double frame) -> Result<void> {
    SHALE_TRY(const Vec3 direction, key.vec3("direction", -kFar, kFar));
    if (length(direction) < 1e-6) return bad_input(key.where(), "\"direction\" has no length");
    sun.path.push_back({frame, normalized(direction, {0, 1, 0})});
    frames.push_back(frame);
    return {};
  };
  for (const Fields& key : keys) {
    SHALE_TRY_VOID(key.only({"frame", "direction"}));
    SHALE_TRY(const double frame, key.number("frame", 0, kMaxSceneFrames));
    SHALE_TRY_VOID(add(key, frame));
  }
  if (keys.empty()) SHALE_TRY_VOID(add(fields, 0));
  SHALE_TRY_VOID(check_order(fields.where() + ".path", frames));
  SHALE_TRY(sun.color, fields.vec3("color", 0, kBright, sun.color));
  SHALE_TRY(sun.disc, fields.number("disc", 0, 30, 0.0));
  return sun;
}

Result<Sky> parse_sky(const Fields& fields) {
  SHALE_TRY_VOID(fields.only(
      {"zenith", "horizon", "ground", "clouds", "stars", "fog", "ambient", "harmonics", "signal"}));
  Sky sky;
  SHALE_TRY(sky.zenith, fields.vec3("zenith", 0, kBright, sky.zenith));
  SHALE_TRY(sky.horizon, fields.vec3("horizon", 0, kBright, sky.horizon));
  SHALE_TRY(sky.ground, fields.vec3("ground", 0, kBright, sky.ground));
  SHALE_TRY(sky.clouds, fields.number("clouds", 0, 1, 0.0));
  SHALE_TRY(sky.stars, fields.number("stars", 0, kBright, 0.0));
  SHALE_TRY(sky.fog, fields.number("fog", 0, 10, 0.0));
  SHALE_TRY(sky.ambient, fields.vec3("ambient", 0, kBright, sky.ambient));
  if (fields.has("harmonics")) {
    SHALE_TRY(const std::vector<double> all, fields.matrix("harmonics", 9, 3, -kBright, kBright));
    sky.harmonics.emplace();
    for (size_t i = 0; i < 9; ++i)
      (*sky.harmonics)[i] = {all[3 * i], all[3 * i + 1], all[3 * i + 2]};
  }
  return sky;
}

Result<Material> parse_material(const std::string& name, const Fields& fields) {
  SHALE_TRY_VOID(fields.only({"pattern", "color", "color_b", "emission", "emission_b", "cell",
                              "width", "variation", "grain", "grain_size", "instance_variation",
                              "specular", "shininess", "cutout", "cutout_cell", "cutout_amount",
                              "signal", "scroll", "change"}));
  Material m;
  m.name = name;
  SHALE_TRY(const uint32_t pattern,
            fields.choice("pattern",
                          {"solid", "checker", "stripes", "lines", "bricks", "dots", "noise",
                           "glyphs", "windows", "cells", "smooth"},
                          0));
  m.pattern = static_cast<Pattern>(pattern);
  SHALE_TRY(m.color_a, fields.vec3("color", 0, kBright, m.color_a));
  SHALE_TRY(m.color_b, fields.vec3("color_b", 0, kBright, m.color_a * 0.4));
  SHALE_TRY(m.emission_a, fields.number("emission", 0, kBright, 0.0));
  SHALE_TRY(m.emission_b, fields.number("emission_b", 0, kBright, 0.0));
  if (fields.has("cell")) {
    SHALE_TRY(const std::vector<double> cell, fields.numbers("cell", 2, 1e-4, kFar));
    m.cell_x = cell[0];
    m.cell_y = cell[1];
  }
  SHALE_TRY(m.width, fields.number("width", 0, 1, m.pattern == Pattern::kNoise ? 0.5 : m.width));
  SHALE_TRY(m.variation, fields.number("variation", 0, 1, 0.0));
  SHALE_TRY(m.grain, fields.number("grain", 0, 1, 0.0));
  SHALE_TRY(m.grain_size, fields.number("grain_size", 1e-4, kFar, m.grain_size));
  SHALE_TRY(m.instance_variation, fields.number("instance_variation", 0, 1, 0.0));
  SHALE_TRY(m.specular, fields.number("specular", 0, kBright, 0.0));
  SHALE_TRY(m.shininess, fields.number("shininess", 1, 1000, m.shininess));
  SHALE_TRY(
      const uint32_t cutout,
      fields.choice("cutout", {"none", "leaves", "grass", "mesh", "pickets", "disc", "glyphs"}, 0));
  m.cutout = static_cast<CutoutKind>(cutout);
  SHALE_TRY(m.cutout_cell, fields.number("cutout_cell", 1e-4, kFar, m.cutout_cell));
  SHALE_TRY(m.cutout_amount, fields.number("cutout_amount", 0, 1, m.cutout_amount));
  if (fields.has("scroll")) {
    SHALE_TRY(const std::vector<double> scroll, fields.numbers("scroll", 2, -100, 100));
    m.scroll_x = scroll[0];
    m.scroll_y = scroll[1];
  }
  SHALE_TRY(m.change, fields.number("change", 0, 1e6, 0.0));
  return m;
}

Result<Animation> parse_animation(const Fields& fields) {
  SHALE_TRY_VOID(fields.only({"path", "interpolation", "spin", "swing", "bob"}));
  Animation a;
  SHALE_TRY(const uint32_t kind, fields.choice("interpolation", {"linear", "smooth"}, 1));
  a.smooth = kind == 1;
  SHALE_TRY(const std::vector<Fields> keys, fields.list("path", kMaxKeys));
  std::vector<double> frames;
  for (const Fields& key : keys) {
    SHALE_TRY_VOID(key.only({"frame", "at"}));
    PositionKey parsed;
    SHALE_TRY(parsed.frame, key.number("frame", 0, kMaxSceneFrames));
    SHALE_TRY(parsed.at, key.vec3("at", -kFar, kFar));
    frames.push_back(parsed.frame);
    a.path.push_back(parsed);
  }
  SHALE_TRY_VOID(check_order(fields.where() + ".path", frames));
  if (fields.has("spin")) {
    const Fields spin = fields.child("spin");
    SHALE_TRY_VOID(spin.only({"axis", "degrees"}));
    SHALE_TRY(const Vec3 axis, spin.vec3("axis", -kFar, kFar, Vec3{0, 1, 0}));
    a.spin_axis = normalized(axis, {0, 1, 0});
    SHALE_TRY(a.spin_degrees, spin.number("degrees", -180, 180));
  }
  if (fields.has("swing")) {
    const Fields swing = fields.child("swing");
    SHALE_TRY_VOID(swing.only({"axis", "degrees", "period", "phase"}));
    SHALE_TRY(const Vec3 axis, swing.vec3("axis", -kFar, kFar, Vec3{0, 0, 1}));
    a.swing_axis = normalized(axis, {0, 0, 1});
    SHALE_TRY(a.swing_degrees, swing.number("degrees", -180, 180));
    SHALE_TRY(a.swing_period, swing.number("period", 2, 1e6, a.swing_period));
    SHALE_TRY(a.swing_phase, swing.number("phase", 0, 1, 0.0));
  }
  if (fields.has("bob")) {
    const Fields bob = fields.child("bob");
    SHALE_TRY_VOID(bob.only({"offset", "period", "phase"}));
    SHALE_TRY(a.bob, bob.vec3("offset", -kFar, kFar));
    SHALE_TRY(a.bob_period, bob.number("period", 2, 1e6, a.bob_period));
    SHALE_TRY(a.bob_phase, bob.number("phase", 0, 1, 0.0));
  }
  return a;
}

/// A number for all colours, or one for each.
Result<Vec3> parse_value(const Fields& fields, const char* key, std::optional<Vec3> absent = {}) {
  if (fields.has(key) && fields.json()[key].is_array()) return fields.vec3(key, 0, kBright);
  if (!fields.has(key) && absent) return *absent;
  SHALE_TRY(const double value, fields.number(key, 0, kBright));
  return Vec3{value, value, value};
}

Result<Signal> parse_signal(const Fields& fields) {
  SHALE_TRY_VOID(fields.only({"path", "interpolation", "repeat", "flicker", "wave", "blink"}));
  Signal s;
  SHALE_TRY(const uint32_t kind, fields.choice("interpolation", {"linear", "smooth", "step"}, 0));
  s.between = static_cast<Signal::Between>(kind);
  SHALE_TRY(const std::vector<Fields> keys, fields.list("path", kMaxKeys));
  std::vector<double> frames;
  for (const Fields& key : keys) {
    SHALE_TRY_VOID(key.only({"frame", "value"}));
    SignalKey parsed;
    SHALE_TRY(parsed.frame, key.number("frame", 0, kMaxSceneFrames));
    SHALE_TRY(parsed.value, parse_value(key, "value"));
    frames.push_back(parsed.frame);
    s.path.push_back(parsed);
  }
  SHALE_TRY_VOID(check_order(fields.where() + ".path", frames));
  SHALE_TRY(s.repeat, fields.number("repeat", 0, kMaxSceneFrames, 0.0));
  if (fields.has("flicker")) {
    const Fields flicker = fields.child("flicker");
    SHALE_TRY_VOID(flicker.only({"amount", "period"}));
    SHALE_TRY(s.flicker_amount, flicker.number("amount", 0, 1));
    SHALE_TRY(s.flicker_period, flicker.number("period", 0.1, 1e6, s.flicker_period));
  }
  if (fields.has("wave")) {
    const Fields wave = fields.child("wave");
    SHALE_TRY_VOID(wave.only({"amount", "period", "phase"}));
    SHALE_TRY(s.wave_amount, wave.number("amount", 0, 1));
    SHALE_TRY(s.wave_period, wave.number("period", 0.1, 1e6, s.wave_period));
    SHALE_TRY(s.wave_phase, wave.number("phase", 0, 1, 0.0));
  }
  if (fields.has("blink")) {
    const Fields blink = fields.child("blink");
    SHALE_TRY_VOID(blink.only({"period", "on", "off", "phase", "random"}));
    SHALE_TRY(s.blink_period, blink.number("period", 0.1, 1e6));
    SHALE_TRY(s.blink_on, blink.number("on", 0, 1, s.blink_on));
    SHALE_TRY(s.blink_off, parse_value(blink, "off", Vec3{}));
    SHALE_TRY(s.blink_phase, blink.number("phase", 0, 1, 0.0));
    SHALE_TRY(s.blink_random, blink.flag("random", false));
  }
  return s;
}

/// Turns the y axis to `direction`.
Affine aimed(const Vec3& direction) {
  const Vec3 y = normalized(direction, {0, 1, 0});
  const Vec3 helper = std::abs(y.y) < 0.9 ? Vec3{0, 1, 0} : Vec3{1, 0, 0};
  const Vec3 x = normalized(cross(y, helper), {1, 0, 0});
  return {x, y, cross(x, y), {}};
}

class Parser {
 public:
  explicit Parser(Scene& scene) : scene_(scene) {}

  Result<void> parse_materials(const Fields& fields) {
    if (!fields.json().is_object())
      return bad_input(fields.where(), "found {}, expected an object of named materials",
                       fields.json().type_name());
    if (fields.json().size() > kMaxMaterials)
      return bad_input(fields.where(), "found {} materials, expected at most {}",
                       fields.json().size(), kMaxMaterials);
    for (const auto& [name, json] : fields.json().items()) {
      const Fields own(json, fields.where() + "." + name);
      SHALE_TRY(Material material, parse_material(name, own));
      SHALE_TRY(material.signal, signal_of(own));
      materials_[name] = static_cast<uint32_t>(scene_.materials.size());
      scene_.materials.push_back(std::move(material));
    }
    return {};
  }

  /// With `vary`, the objects belong to one of several copies, each with phases of its own.
  Result<void> parse_objects(const std::vector<Fields>& objects, int parent, uint32_t seed,
                             bool vary, int depth) {
    for (size_t i = 0; i < objects.size(); ++i)
      SHALE_TRY_VOID(parse_object(objects[i], parent, scene_hash(seed, static_cast<uint32_t>(i)),
                                  vary, depth));
    return {};
  }

  Result<void> parse_emitter(const Fields& fields, uint32_t index) {
    SHALE_TRY_VOID(
        fields.only({"at", "animate", "count", "area", "velocity", "spread", "gravity", "life",
                     "size", "color", "color_end", "emission", "opacity", "blend", "edge"}));
    Emitter e;
    e.seed = scene_hash(scene_.seed, 0x70000000u + index);
    SHALE_TRY(e.node, add_node(fields, 0, e.seed, false));
    SHALE_TRY(const int64_t count, fields.integer("count", 1, kMaxParticles));
    e.count = static_cast<uint32_t>(count);
    particles_ += e.count;
    if (particles_ > kMaxParticles)
      return bad_input(fields.where(), "the scene has {} particles, expected at most {}",
                       particles_, kMaxParticles);
    SHALE_TRY(e.area, fields.vec3("area", 0, kFar, Vec3{}));
    SHALE_TRY(e.velocity, fields.vec3("velocity", -100, 100, Vec3{}));
    SHALE_TRY(e.spread, fields.vec3("spread", 0, 100, Vec3{}));
    SHALE_TRY(e.gravity, fields.vec3("gravity", -10, 10, Vec3{}));
    SHALE_TRY(e.life, fields.number("life", 2, 1e6, e.life));
    if (fields.has("size")) {
      SHALE_TRY(const std::vector<double> size, fields.numbers("size", 2, 0, 1000));
      e.size_start = size[0];
      e.size_end = size[1];
    }
    SHALE_TRY(e.color_start, fields.vec3("color", 0, kBright, e.color_start));
    SHALE_TRY(e.color_end, fields.vec3("color_end", 0, kBright, e.color_start));
    SHALE_TRY(e.emission, fields.number("emission", 0, kBright, 1.0));
    SHALE_TRY(e.opacity, fields.number("opacity", 0, 1, 1.0));
    SHALE_TRY(const uint32_t blend, fields.choice("blend", {"add", "over"}, 0));
    SHALE_TRY(const uint32_t edge, fields.choice("edge", {"soft", "hard"}, 0));
    e.additive = blend == 0;
    e.soft = edge == 0;
    scene_.emitters.push_back(e);
    return {};
  }

  Result<void> parse_light(const Fields& fields, int parent, uint32_t seed, bool vary) {
    SHALE_TRY_VOID(fields.only({"shape", "at", "rotate", "animate", "color", "range", "cone",
                                "size", "shadow", "signal"}));
    if (scene_.lights.size() >= kMaxLights)
      return bad_input(fields.where(), "the scene has more than {} lights", kMaxLights);
    Light light;
    SHALE_TRY(light.node, add_node(fields, parent, seed, vary));
    SHALE_TRY(light.color, fields.vec3("color", 0, kBright, Vec3{1, 1, 1}));
    SHALE_TRY(light.range, fields.number("range", 0.01, kFar, 10.0));
    if (fields.has("cone")) {
      SHALE_TRY(const std::vector<double> cone, fields.numbers("cone", 2, 0, 179));
      if (!(cone[1] > cone[0]))
        return bad_input(fields.where(), "\"cone\" is {} to {}, expected a larger second angle",
                         cone[0], cone[1]);
      light.cone_inner = cone[0];
      light.cone_outer = cone[1];
    }
    if (fields.has("size")) {
      SHALE_TRY(const std::vector<double> size, fields.numbers("size", 2, 1e-3, kFar));
      light.size_x = size[0];
      light.size_z = size[1];
    }
    SHALE_TRY(light.casts_shadow, fields.flag("shadow", false));
    SHALE_TRY(light.signal, signal_of(fields));
    if (vary) light.variant = scene_hash(seed, 0x54) | 1;
    scene_.lights.push_back(light);
    return {};
  }

  Result<void> parse_models(const Fields& fields, const std::string& folder) {
    if (!fields.json().is_object() || fields.json().size() > kMaxModels)
      return bad_input(fields.where(), "found {}, expected an object of at most {} named models",
                       fields.json().type_name(), kMaxModels);
    for (const auto& [name, json] : fields.json().items()) {
      const Fields own(json, fields.where() + "." + name);
      SHALE_TRY(SceneModel model, load_model(name, own, folder));
      models_[name] = static_cast<uint32_t>(scene_.models.size());
      scene_.models.push_back(std::move(model));
    }
    return {};
  }

  Result<void> parse_instance(const Fields& fields, int parent, uint32_t seed, bool vary) {
    SHALE_TRY_VOID(fields.only({"shape", "model", "shadow", "at", "rotate", "animate"}));
    if (scene_.instances.size() >= kMaxInstances)
      return bad_input(fields.where(), "the scene has more than {} meshes", kMaxInstances);
    SHALE_TRY(const std::string name, fields.text("model"));
    const auto known = models_.find(name);
    if (known == models_.end())
      return bad_input(fields.where(), "\"model\" is \"{}\", which the scene has not", name);
    Instance instance;
    instance.model = known->second;
    SHALE_TRY(instance.casts_shadow, fields.flag("shadow", true));
    SHALE_TRY(instance.node, add_node(fields, parent, seed, vary));
    scene_.instances.push_back(instance);
    return {};
  }

  Result<void> parse_signals(const Fields& fields) {
    if (!fields.json().is_object() || fields.json().size() > kMaxSignals)
      return bad_input(fields.where(), "found {}, expected an object of at most {} named signals",
                       fields.json().type_name(), kMaxSignals);
    for (const auto& [name, json] : fields.json().items()) {
      const Fields own(json, fields.where() + "." + name);
      SHALE_TRY(Signal signal, parse_signal(own));
      const auto index = static_cast<uint32_t>(scene_.signals.size());
      signal.seed = scene_hash(scene_.seed, 0x51600000u + index);
      signals_[name] = static_cast<int>(index);
      scene_.signals.push_back(std::move(signal));
    }
    return {};
  }

  /// The signal that the field `key` names; kSteady if it is absent.
  Result<int> signal_of(const Fields& fields, const char* key = "signal") const {
    if (!fields.has(key)) return kSteady;
    SHALE_TRY(const std::string name, fields.text(key));
    const auto known = signals_.find(name);
    if (known == signals_.end())
      return bad_input(fields.where(), "\"{}\" is \"{}\", which the scene has not", key, name);
    return known->second;
  }

  Result<void> parse_overlay(const Fields& fields) {
    SHALE_TRY_VOID(
        fields.only({"rect", "rows", "color", "background", "opacity", "scroll", "first", "last"}));
    Overlay overlay;
    SHALE_TRY(const std::vector<double> rect, fields.numbers("rect", 4, 0, 1));
    overlay.x = rect[0];
    overlay.y = rect[1];
    overlay.width = rect[2];
    overlay.height = rect[3];
    SHALE_TRY(overlay.rows, fields.number("rows", 1, 200, overlay.rows));
    SHALE_TRY(overlay.color, fields.vec3("color", 0, kBright, overlay.color));
    SHALE_TRY(overlay.background, fields.vec3("background", 0, kBright, overlay.background));
    SHALE_TRY(overlay.opacity, fields.number("opacity", 0, 1, overlay.opacity));
    SHALE_TRY(overlay.scroll, fields.number("scroll", -10, 10, 0.0));
    SHALE_TRY(const int64_t first, fields.integer("first", 0, kMaxSceneFrames, 0));
    SHALE_TRY(const int64_t last, fields.integer("last", 0, kMaxSceneFrames, kMaxSceneFrames));
    overlay.first = static_cast<uint32_t>(first);
    overlay.last = static_cast<uint32_t>(last);
    scene_.overlays.push_back(overlay);
    return {};
  }

 private:
  /// "at", "rotate" and "animate" of an object. With `vary`, phases are those of a copy.
  Result<int> add_node(const Fields& fields, int parent, uint32_t seed, bool vary) {
    SceneNode node;
    node.parent = parent;
    SHALE_TRY(node.at, fields.vec3("at", -kFar, kFar, Vec3{}));
    SHALE_TRY(node.rotate, fields.vec3("rotate", -360, 360, Vec3{}));
    if (fields.has("animate")) {
      SHALE_TRY(node.animation, parse_animation(fields.child("animate")));
    }
    if (vary) {
      node.animation.swing_phase += scene_hash(seed, 0x51) * 0x1p-32;
      node.animation.bob_phase += scene_hash(seed, 0x52) * 0x1p-32;
    }
    return push(node, fields.where());
  }

  Result<int> push(const SceneNode& node, const std::string& where) {
    if (scene_.nodes.size() >= kMaxNodes)
      return bad_input(where, "the scene has more than {} coordinate systems", kMaxNodes);
    scene_.nodes.push_back(node);
    return static_cast<int>(scene_.nodes.size() - 1);
  }

  Result<uint32_t> parse_material_name(const Fields& fields, uint32_t seed) {
    const auto index = [&](const std::string& name) -> Result<uint32_t> {
      const auto known = materials_.find(name);
      if (known == materials_.end())
        return bad_input(fields.where(), "\"material\" is \"{}\", which the scene has not", name);
      return known->second;
    };
    if (!fields.has("material") || !fields.json()["material"].is_array()) {
      SHALE_TRY(const std::string name, fields.text("material"));
      return index(name);
    }
    const nlohmann::json& names = fields.json()["material"];
    if (names.empty() || names.size() > kMaxMaterials)
      return bad_input(fields.where(), "\"material\" lists {} names, expected 1 to {}",
                       names.size(), kMaxMaterials);
    std::vector<uint32_t> all;
    for (const nlohmann::json& name : names) {
      if (!name.is_string())
        return bad_input(fields.where(), "\"material\" lists {}, expected texts", name.type_name());
      SHALE_TRY(const uint32_t known, index(name.get<std::string>()));
      all.push_back(known);
    }
    return all[scene_hash(seed, 0x53) % all.size()];
  }

  Result<void> add_primitive(const Fields& fields, Primitive primitive) {
    if (scene_.primitives.size() >= kMaxPrimitives)
      return bad_input(fields.where(), "the scene has more than {} primitives", kMaxPrimitives);
    scene_.primitives.push_back(primitive);
    return {};
  }

  Result<void> parse_wire(const Fields& fields, int parent, Primitive primitive, uint32_t seed,
                          bool vary) {
    SHALE_TRY_VOID(fields.only({"shape", "from", "to", "radius", "sag", "segments", "material",
                                "shadow", "at", "rotate", "animate"}));
    SHALE_TRY(const int base, add_node(fields, parent, seed, vary));
    SHALE_TRY(const Vec3 from, fields.vec3("from", -kFar, kFar));
    SHALE_TRY(const Vec3 to, fields.vec3("to", -kFar, kFar));
    SHALE_TRY(const double radius, fields.number("radius", 1e-4, kFar));
    SHALE_TRY(const double sag, fields.number("sag", 0, kFar, 0.0));
    SHALE_TRY(const int64_t segments, fields.integer("segments", 1, 64, sag > 0 ? 8 : 1));
    Vec3 last = from;
    for (int64_t i = 1; i <= segments; ++i) {
      const double s = static_cast<double>(i) / static_cast<double>(segments);
      const Vec3 next = mix(from, to, s) - Vec3{0, sag * 4 * s * (1 - s), 0};
      SceneNode node;
      node.parent = base;
      node.at = mix(last, next, 0.5);
      node.aim = aimed(next - last);
      SHALE_TRY(primitive.node, push(node, fields.where()));
      primitive.shape = PrimitiveShape::kCylinder;
      primitive.half = {radius, std::max(length(next - last) / 2, 1e-6), radius};
      SHALE_TRY_VOID(add_primitive(fields, primitive));
      last = next;
    }
    return {};
  }

  Result<void> parse_shape(const Fields& fields, int parent, uint32_t seed, bool vary) {
    SHALE_TRY(const uint32_t shape, fields.choice("shape", {"sphere", "cylinder", "box", "quad",
                                                            "plane", "wire", "light", "mesh"}));
    if (shape == 6) return parse_light(fields, parent, seed, vary);
    if (shape == 7) return parse_instance(fields, parent, seed, vary);
    Primitive primitive;
    primitive.seed = seed;
    SHALE_TRY(primitive.material, parse_material_name(fields, seed));
    SHALE_TRY(primitive.casts_shadow, fields.flag("shadow", true));
    if (shape == 5) return parse_wire(fields, parent, primitive, seed, vary);
    SHALE_TRY(primitive.node, add_node(fields, parent, seed, vary));
    switch (shape) {
      case 0:
        SHALE_TRY_VOID(
            fields.only({"shape", "radius", "material", "shadow", "at", "rotate", "animate"}));
        primitive.shape = PrimitiveShape::kSphere;
        if (fields.has("radius") && fields.json()["radius"].is_array()) {
          SHALE_TRY(primitive.half, fields.vec3("radius", 1e-4, kFar));
        } else {
          SHALE_TRY(const double r, fields.number("radius", 1e-4, kFar));
          primitive.half = {r, r, r};
        }
        break;
      case 1: {
        SHALE_TRY_VOID(fields.only(
            {"shape", "radius", "height", "material", "shadow", "at", "rotate", "animate"}));
        primitive.shape = PrimitiveShape::kCylinder;
        SHALE_TRY(const double r, fields.number("radius", 1e-4, kFar));
        SHALE_TRY(const double height, fields.number("height", 1e-4, kFar));
        primitive.half = {r, height / 2, r};
        break;
      }
      case 2: {
        SHALE_TRY_VOID(
            fields.only({"shape", "size", "material", "shadow", "at", "rotate", "animate"}));
        primitive.shape = PrimitiveShape::kBox;
        SHALE_TRY(primitive.half, fields.vec3("size", 1e-4, kFar));
        primitive.half = primitive.half * 0.5;
        break;
      }
      default: {
        SHALE_TRY_VOID(
            fields.only({"shape", "size", "material", "shadow", "at", "rotate", "animate"}));
        primitive.shape = PrimitiveShape::kQuad;
        SHALE_TRY(const std::vector<double> size, fields.numbers("size", 2, 1e-4, kFar));
        primitive.half = {size[0] / 2, size[1] / 2, 1};
        if (shape == 4) {
          // A plane lies flat: its second side runs along -z, it faces up.
          scene_.nodes[static_cast<size_t>(primitive.node)].aim = rotation({1, 0, 0}, -90);
        }
        break;
      }
    }
    return add_primitive(fields, primitive);
  }

  Result<void> parse_array(const Fields& fields, int node, uint32_t seed, int depth,
                           const std::vector<Fields>& children) {
    const Fields array = fields.child("array");
    SHALE_TRY_VOID(array.only({"count", "step"}));
    SHALE_TRY(const std::vector<double> count, array.numbers("count", 3, 1, kMaxPrimitives));
    SHALE_TRY(const Vec3 step, array.vec3("step", -kFar, kFar));
    int64_t n[3];
    for (size_t i = 0; i < 3; ++i) {
      n[i] = static_cast<int64_t>(count[i]);
      if (static_cast<double>(n[i]) != count[i])
        return bad_input(array.where(), "\"count\"[{}] is {}, expected a whole number", i,
                         count[i]);
    }
    if (n[0] * n[1] * n[2] > kMaxPrimitives)
      return bad_input(array.where(), "{} copies, expected at most {}", n[0] * n[1] * n[2],
                       kMaxPrimitives);
    uint32_t copy = 0;
    for (int64_t z = 0; z < n[2]; ++z)
      for (int64_t y = 0; y < n[1]; ++y)
        for (int64_t x = 0; x < n[0]; ++x) {
          const auto centred = [](int64_t i, int64_t total, double s) {
            return (static_cast<double>(i) - static_cast<double>(total - 1) / 2) * s;
          };
          SceneNode child;
          child.parent = node;
          child.at = {centred(x, n[0], step.x), centred(y, n[1], step.y), centred(z, n[2], step.z)};
          SHALE_TRY(const int at, push(child, array.where()));
          SHALE_TRY_VOID(parse_objects(children, at, scene_hash(seed, ++copy), true, depth + 1));
        }
    return {};
  }

  Result<void> parse_scatter(const Fields& fields, int node, uint32_t seed, int depth,
                             const std::vector<Fields>& children) {
    const Fields scatter = fields.child("scatter");
    SHALE_TRY_VOID(scatter.only({"count", "area", "scale", "turn", "tilt", "clear"}));
    SHALE_TRY(const int64_t count, scatter.integer("count", 1, kMaxPrimitives));
    SHALE_TRY(const Vec3 area, scatter.vec3("area", 0, kFar));
    std::vector<double> scale{1, 1}, turn{0, 360}, clear;
    if (scatter.has("scale")) {
      SHALE_TRY(scale, scatter.numbers("scale", 2, 1e-3, 1000));
    }
    if (scatter.has("turn")) {
      SHALE_TRY(turn, scatter.numbers("turn", 2, -360, 360));
    }
    SHALE_TRY(const double tilt, scatter.number("tilt", 0, 180, 0.0));
    if (scatter.has("clear")) {
      SHALE_TRY(clear, scatter.numbers("clear", 4, -kFar, kFar));
    }
    Random random(scene_hash(seed, 0x5ca7));
    for (int64_t i = 0; i < count; ++i) {
      SceneNode child;
      child.parent = node;
      for (int attempt = 0; attempt < 64; ++attempt) {
        child.at = {random.between(-0.5, 0.5) * area.x, random.between(-0.5, 0.5) * area.y,
                    random.between(-0.5, 0.5) * area.z};
        const bool free = clear.empty() || child.at.x < clear[0] || child.at.x > clear[2] ||
                          child.at.z < clear[1] || child.at.z > clear[3];
        if (free) break;
      }
      child.scale = random.between(scale[0], scale[1]);
      child.rotate = {random.between(-tilt, tilt), random.between(turn[0], turn[1]),
                      random.between(-tilt, tilt)};
      SHALE_TRY(const int at, push(child, scatter.where()));
      SHALE_TRY_VOID(parse_objects(children, at, random.bits(), true, depth + 1));
    }
    return {};
  }

  Result<void> parse_object(const Fields& fields, int parent, uint32_t seed, bool vary, int depth) {
    if (!fields.json().is_object())
      return bad_input(fields.where(), "found {}, expected an object", fields.json().type_name());
    if (depth > kMaxDepth)
      return bad_input(fields.where(), "objects are nested deeper than {}", kMaxDepth);
    if (!fields.has("objects")) return parse_shape(fields, parent, seed, vary);
    SHALE_TRY_VOID(fields.only({"objects", "array", "scatter", "at", "rotate", "animate"}));
    SHALE_TRY(const int node, add_node(fields, parent, seed, vary));
    SHALE_TRY(const std::vector<Fields> children, fields.list("objects", kMaxEntries));
    if (fields.has("array")) return parse_array(fields, node, seed, depth, children);
    if (fields.has("scatter")) return parse_scatter(fields, node, seed, depth, children);
    return parse_objects(children, node, seed, vary, depth + 1);
  }

  Scene& scene_;
  std::map<std::string, uint32_t> materials_;
  std::map<std::string, int> signals_;
  std::map<std::string, uint32_t> models_;
  uint32_t particles_ = 0;
};

}  // namespace

uint32_t scene_hash(uint32_t a, uint32_t b) {
  uint32_t h = a * 0x9E3779B1u + b * 0x85EBCA77u + 0x7F4A7C15u;
  h ^= h >> 15;
  h *= 0x2C1B3C6Du;
  h ^= h >> 12;
  h *= 0x297A2D39u;
  return h ^ (h >> 15);
}

Result<Scene> parse_scene(const std::string& text, const std::string& folder) {
  SHALE_TRY(const nlohmann::json json, parse_json(text));
  const Fields root(json, "scene");
  SHALE_TRY_VOID(root.only({"schema", "frames", "frame_rate", "seed", "exposure", "exposure_signal",
                            "camera", "sun", "sky", "signals", "lights", "models", "materials",
                            "objects", "particles", "overlays"}));
  SHALE_TRY(const std::string schema, root.text("schema"));
  if (schema != "shale-scene/1")
    return bad_input("scene", "\"schema\" is \"{}\", expected \"shale-scene/1\"", schema);
  Scene scene;
  SHALE_TRY(const int64_t frames, root.integer("frames", 1, kMaxSceneFrames));
  scene.frames = static_cast<uint32_t>(frames);
  SHALE_TRY(scene.frame_rate, root.number("frame_rate", 1, 1000, 30.0));
  SHALE_TRY(const int64_t seed, root.integer("seed", 0, 0xFFFFFFFF, 0));
  scene.seed = static_cast<uint32_t>(seed);
  SHALE_TRY(scene.exposure, root.number("exposure", 1e-6, 1e6, 1.0));
  if (!root.has("camera")) return bad_input("scene", "\"camera\" is missing, expected an object");
  SHALE_TRY(scene.camera, parse_camera(root.child("camera")));
  if (!root.has("sun")) return bad_input("scene", "\"sun\" is missing, expected an object");
  SHALE_TRY(scene.sun, parse_sun(root.child("sun")));
  if (root.has("sky")) {
    SHALE_TRY(scene.sky, parse_sky(root.child("sky")));
  }
  scene.nodes.push_back({});
  Parser parser(scene);
  if (root.has("signals")) SHALE_TRY_VOID(parser.parse_signals(root.child("signals")));
  SHALE_TRY(scene.exposure_signal, parser.signal_of(root, "exposure_signal"));
  SHALE_TRY(scene.sun.signal, parser.signal_of(root.child("sun")));
  if (root.has("sky")) {
    SHALE_TRY(scene.sky.signal, parser.signal_of(root.child("sky")));
  }
  if (root.has("materials")) SHALE_TRY_VOID(parser.parse_materials(root.child("materials")));
  if (root.has("models")) SHALE_TRY_VOID(parser.parse_models(root.child("models"), folder));
  SHALE_TRY(const std::vector<Fields> objects, root.list("objects", kMaxEntries));
  SHALE_TRY_VOID(parser.parse_objects(objects, 0, scene.seed, false, 0));
  SHALE_TRY(const std::vector<Fields> emitters, root.list("particles", kMaxParticles));
  for (size_t i = 0; i < emitters.size(); ++i)
    SHALE_TRY_VOID(parser.parse_emitter(emitters[i], static_cast<uint32_t>(i)));
  SHALE_TRY(const std::vector<Fields> lights, root.list("lights", kMaxLights));
  for (const Fields& light : lights) SHALE_TRY_VOID(parser.parse_light(light, 0, 0, false));
  SHALE_TRY(const std::vector<Fields> overlays, root.list("overlays", kMaxOverlays));
  for (const Fields& overlay : overlays) SHALE_TRY_VOID(parser.parse_overlay(overlay));
  return scene;
}

Scene with_margin(Scene scene, uint32_t width, uint32_t height, uint32_t margin) {
  constexpr double kRadians = 3.14159265358979323846 / 180;
  const double wide = width + 2.0 * margin, high = height + 2.0 * margin;
  double& fov = scene.camera.fov_y;
  fov = 2 * std::atan(std::tan(fov / 2 * kRadians) * high / height) / kRadians;
  for (Overlay& overlay : scene.overlays) {
    overlay.x = (overlay.x * width + margin) / wide;
    overlay.y = (overlay.y * height + margin) / high;
    overlay.width *= width / wide;
    overlay.height *= height / high;
  }
  return scene;
}

Result<Scene> load_scene(const std::string& path) {
  SHALE_TRY(const std::string text, read_text(path));
  const std::filesystem::path file(path);
  Result<Scene> scene =
      parse_scene(text, file.has_parent_path() ? file.parent_path().string() : ".");
  if (!scene) {
    Error error = scene.error();
    error.where = error.where.empty() ? path : path + ": " + error.where;
    return error;
  }
  scene->name = file.stem().string();
  return scene;
}

}  // namespace shale
