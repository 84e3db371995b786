// tools/scene/scene.h -- what a scene file says, as plain data. The format is described in README.md.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "ir/base/result.h"
#include "tools/scene/model.h"
#include "tools/scene/vector.h"

namespace shale {

/// Bounds of a scene; a file that asks for more is refused. Primitives, materials and particles
/// together stay below 65536 texels, which every Vulkan device can bind as a texel buffer.
inline constexpr uint32_t kMaxSceneFrames = 100000;
inline constexpr uint32_t kMaxPrimitives = 6000;
inline constexpr uint32_t kMaxMaterials = 128;
inline constexpr uint32_t kMaxParticles = 4096;
inline constexpr uint32_t kMaxOverlays = 4;
inline constexpr uint32_t kMaxLights = 16;
inline constexpr uint32_t kMaxSignals = 64;
inline constexpr uint32_t kMaxModels = 64;
inline constexpr uint32_t kMaxInstances = 2048;

struct SignalKey {
  double frame = 0;
  Vec3 value;
};

/// A factor on light that changes with time: a function of the frame as a real number. What it is
/// made of is multiplied.
struct Signal {
  enum class Between : uint32_t { kLinear, kSmooth, kStep };
  std::vector<SignalKey> path;  ///< 1 if empty
  Between between = Between::kLinear;
  double repeat = 0;  ///< frames after which the path starts again; never if 0
  double flicker_amount = 0, flicker_period = 4;             ///< noise; frames between its values
  double wave_amount = 0, wave_period = 60, wave_phase = 0;  ///< a sine from 1 - amount to 1
  double blink_period = 0, blink_on = 0.5, blink_phase = 0;  ///< on for a part of the period
  Vec3 blink_off;                                            ///< the factor while it is off
  bool blink_random = false;  ///< each period is on or off as a whole, drawn with chance `blink_on`
  uint32_t seed = 0;
};

/// No signal: always 1.
inline constexpr int kSteady = -1;

struct CameraKey {
  double frame = 0;
  Vec3 eye, target;
  double roll = 0;   ///< degrees
  bool cut = false;  ///< nothing is continued from the keys before
};

struct SceneCamera {
  double fov_y = 60;  ///< degrees
  double near_plane = 0.1;
  double far_plane = 0;  ///< infinite if 0
  bool reverse_depth = false;
  bool smooth = true;  ///< Catmull-Rom between keys, else linear
  std::vector<CameraKey> path;
};

struct DirectionKey {
  double frame = 0;
  Vec3 direction;
};

struct Sun {
  std::vector<DirectionKey> path;  ///< towards the sun
  Vec3 color{3, 3, 3};
  double disc = 0;  ///< diameter in the sky, degrees
  int signal = kSteady;
};

struct Sky {
  Vec3 zenith{0.2, 0.4, 0.8}, horizon{0.7, 0.8, 0.9}, ground{0.2, 0.2, 0.2};
  double clouds = 0;             ///< 0 to 1
  double stars = 0;              ///< brightness
  double fog = 0;                ///< density per metre, towards the horizon's colour
  Vec3 ambient{0.4, 0.45, 0.5};  ///< light from above; half of it from below
  /// Radiance of the surroundings as coefficients of real spherical harmonics, in order of (l, m)
  /// from (0, 0) to (2, 2), with the polar axis z; instead of `ambient`.
  std::optional<std::array<Vec3, 9>> harmonics;
  int signal = kSteady;  ///< on all colours, that of fog too
};

/// A point, or a rectangle of `size` that shines to one side: along -y of its node, as a cone does.
struct Light {
  Vec3 color;
  double range = 10;
  double cone_inner = 0, cone_outer = 0;  ///< full angles in degrees; all around if 0
  double size_x = 0, size_z = 0;          ///< metres; a point if 0
  bool casts_shadow = false;
  int node = 0;  ///< moves with it
  int signal = kSteady;
  uint32_t variant = 0;  ///< of its signal, for copies
};

/// The numbers are those of the shader.
enum class Pattern : uint32_t {
  kSolid,
  kChecker,
  kStripes,
  kLines,
  kBricks,
  kDots,
  kNoise,
  kGlyphs,
  kWindows,
  kCells,
  kSmooth
};
enum class CutoutKind : uint32_t { kNone, kLeaves, kGrass, kMesh, kPickets, kDisc, kGlyphs };
enum class PrimitiveShape : uint32_t { kSphere, kCylinder, kBox, kQuad };

struct Material {
  std::string name;
  Pattern pattern = Pattern::kSolid;
  Vec3 color_a{0.8, 0.8, 0.8}, color_b{0.3, 0.3, 0.3};
  double emission_a = 0, emission_b = 0;
  double cell_x = 1, cell_y = 1;  ///< metres
  double width = 0.1;    ///< of lines, as a part of the cell; threshold of noise and windows
  double variation = 0;  ///< of brightness from cell to cell
  double grain = 0, grain_size = 0.1;  ///< fine noise: strength, metres
  double instance_variation = 0;       ///< of colour from object to object
  double specular = 0, shininess = 32;
  CutoutKind cutout = CutoutKind::kNone;
  double cutout_cell = 0.3;    ///< metres
  double cutout_amount = 0.5;  ///< coverage of leaves, thickness of the rest as a part of the cell
  int signal = kSteady;        ///< on what it emits
  double scroll_x = 0, scroll_y = 0;  ///< metres per frame that the pattern moves over the surface
  double change = 0;                  ///< frames after which the pattern is drawn anew; never if 0
};

struct PositionKey {
  double frame = 0;
  Vec3 at;
};

struct Animation {
  std::vector<PositionKey> path;  ///< added to the position
  bool smooth = true;
  Vec3 spin_axis{0, 1, 0};
  double spin_degrees = 0;  ///< per frame
  Vec3 swing_axis{0, 0, 1};
  double swing_degrees = 0, swing_period = 60, swing_phase = 0;  ///< frames, turns
  Vec3 bob;
  double bob_period = 60, bob_phase = 0;
};

/// A coordinate system below its parent; node 0 is the world.
struct SceneNode {
  int parent = -1;
  Vec3 at;
  Vec3 rotate;  ///< degrees; about z, then x, then y
  Affine aim;   ///< after `rotate`; what the parser computed for wires
  double scale = 1;
  Animation animation;
};

struct Primitive {
  PrimitiveShape shape = PrimitiveShape::kBox;
  int node = 0;
  Vec3 half;  ///< radii or half lengths, metres
  uint32_t material = 0;
  bool casts_shadow = true;
  uint32_t seed = 0;
};

/// A model in a place.
struct Instance {
  int node = 0;
  uint32_t model = 0;
  bool casts_shadow = true;
};

struct Emitter {
  int node = 0;
  uint32_t count = 0;
  Vec3 area;                                ///< births lie in this box
  Vec3 velocity;                            ///< metres per frame
  Vec3 spread;                              ///< random part of the velocity
  Vec3 gravity;                             ///< metres per frame^2
  double life = 60;                         ///< frames
  double size_start = 0.1, size_end = 0.1;  ///< radius, metres
  Vec3 color_start{1, 1, 1}, color_end{1, 1, 1};
  double emission = 1;
  double opacity = 1;
  bool additive = true, soft = true;
  uint32_t seed = 0;
};

struct Overlay {
  double x = 0, y = 0, width = 0.2, height = 0.1;  ///< parts of the picture
  double rows = 4;                                 ///< lines of glyphs
  Vec3 color{1, 1, 1}, background{0, 0, 0};
  double opacity = 0.5;  ///< of the background
  double scroll = 0;     ///< rows per frame
  uint32_t first = 0, last = kMaxSceneFrames;
};

struct Scene {
  std::string name;
  uint32_t frames = 0;
  double frame_rate = 30;
  uint32_t seed = 0;
  double exposure = 1;
  int exposure_signal = kSteady;
  SceneCamera camera;
  Sun sun;
  Sky sky;
  std::vector<Signal> signals;
  std::vector<Light> lights;
  std::vector<Material> materials;
  std::vector<SceneNode> nodes;
  std::vector<Primitive> primitives;
  std::vector<SceneModel> models;
  std::vector<Instance> instances;
  std::vector<Emitter> emitters;
  std::vector<Overlay> overlays;
};

/// Files that it names lie relative to `folder`.
/// Errors: kBadInput naming the field, what was found and what was expected; those of load_model.
Result<Scene> parse_scene(const std::string& text, const std::string& folder = ".");

/// parse_scene of a file; the scene's name is that of the file without folder and extension.
/// Errors: kIo, kBadInput.
Result<Scene> load_scene(const std::string& path);

/// The scene as a picture of `width` by `height` pixels shows it that has `margin` more around it on each side: the pixels of the
/// picture are the same, overlays stay where they are in it.
Scene with_margin(Scene scene, uint32_t width, uint32_t height, uint32_t margin);

/// A number that depends on its arguments alone, for everything random in a scene.
uint32_t scene_hash(uint32_t a, uint32_t b);

}  // namespace shale
