// Scenes: the format, the geometry behind motion and depth, the sampling conventions, crops, and the
// layout on disk.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <random>
#include <set>

#include "ir/base/file.h"
#include "tests/support/vulkan_fixture.h"
#include "tools/scene/dataset.h"
#include "tools/scene/exr.h"
#include "tools/scene/renderer.h"
#include "tools/scene/scene_source.h"
#include "tools/scene/tables.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

// --- The format ---

std::string scene_text(const std::string& rest, const std::string& camera = R"("path": [{"frame": 0,
    "eye": [0, 1, 5], "target": [0, 1, 0]}])") {
  return R"({"schema": "shale-scene/1", "frames": 4, "sun": {"direction": [0, 1, 0]}, "camera": {)" +
         camera + "}" + (rest.empty() ? "" : ", " + rest) + "}";
}

TEST(SceneFormat, RefusesWhatIsWrongNamingFieldAndExpectation) {
  const struct {
    std::string text, expected;
  } kCases[]{
      {"[", "is not valid JSON at byte 2"},
      {"[]", "scene: found array, expected an object"},
      {R"({"schema": "shale-scene/2"})",
       "scene: \"schema\" is \"shale-scene/2\", expected \"shale-scene/1\""},
      {R"({"schema": "shale-scene/1", "frames": 1.5})",
       "scene: \"frames\" is 1.5, expected a whole number"},
      {R"({"schema": "shale-scene/1", "frames": 0})",
       "scene: \"frames\" is 0, expected 1 to 100000"},
      {R"({"schema": "shale-scene/1", "frames": 1})",
       "scene: \"camera\" is missing, expected an object"},
      {scene_text("", R"("fov": 3)"),
       "scene.camera: field \"fov\" is unknown, expected one of fov_y, near, far, reverse_depth, "
       "interpolation, path"},
      {scene_text("", R"("path": [])"), "scene.camera: \"path\" has no keys, expected at least 1"},
      {scene_text("", R"("near": 1, "far": 0.5, "path": [])"),
       "scene.camera: \"far\" is 0.5, expected more than \"near\", 1, or 0"},
      {scene_text("", R"("path": [{"frame": 3, "eye": [0, 0, 0], "target": [0, 0, 1]},
                                  {"frame": 3, "eye": [0, 0, 0], "target": [0, 0, 1]}])"),
       "scene.camera.path: frame 3 follows frame 3, expected rising frames"},
      {scene_text("", R"("path": [{"frame": 0, "eye": [0, 0], "target": [0, 0, 1]}])"),
       "scene.camera.path[0]: \"eye\" is a list of 2, expected a list of 3 numbers"},
      {scene_text("", R"("path": [{"frame": 0, "eye": [0, "a", 0], "target": [0, 0, 1]}])"),
       "scene.camera.path[0]: \"eye\"[1] is \"a\", expected a number"},
      {scene_text(R"("objects": [{"shape": "cone", "material": "m"}])"),
       "scene.objects[0]: \"shape\" is \"cone\", expected one of sphere, cylinder, box, quad, "
       "plane, wire, light, mesh"},
      {scene_text(R"("objects": [{"shape": "sphere", "radius": 1, "material": "m"}])"),
       "scene.objects[0]: \"material\" is \"m\", which the scene has not"},
      {scene_text(R"("materials": {"m": {}}, "objects": [{"shape": "box", "material": "m",
                    "size": [1, 2, 0]}])"),
       "scene.objects[0]: \"size\"[2] is 0, expected 0.0001 to 100000"},
      {scene_text(R"("materials": {"m": {"emission": 20000}})"),
       "scene.materials.m: \"emission\" is 20000, expected 0 to 10000"},
      {scene_text(R"("materials": {"m": {}}, "objects": [{"array": {"count": [100, 100, 1],
                    "step": [1, 1, 1]}, "objects": []}])"),
       "scene.objects[0].array: 10000 copies, expected at most 6000"},
      {scene_text(R"("materials": {"m": {}}, "objects": [{"scatter": {"count": 6000,
                    "area": [1, 1, 1]}, "objects": [{"shape": "sphere", "radius": 1,
                    "material": "m"}, {"shape": "sphere", "radius": 1, "material": "m"}]}])"),
       "scene.objects[0].objects[0]: the scene has more than 6000 primitives"},
      {scene_text(R"("particles": [{"count": 4000}, {"count": 4000}])"),
       "scene.particles[1]: the scene has 8000 particles, expected at most 4096"},
      {scene_text(
           R"("lights": [{}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}])"),
       "scene: \"lights\" has 17 entries, expected at most 16"},
      {scene_text(R"("lights": [{"cone": [40, 20]}])"),
       "scene.lights[0]: \"cone\" is 40 to 20, expected a larger second angle"},
      {scene_text(R"("lights": [{"signal": "s"}])"),
       "scene.lights[0]: \"signal\" is \"s\", which the scene has not"},
      {scene_text(R"("signals": {"s": {"path": [{"frame": 0, "value": [1, 2]}]}})"),
       "scene.signals.s.path[0]: \"value\" is a list of 2, expected a list of 3 numbers"},
      {scene_text(R"("signals": {"s": {"blink": {"on": 0.5}}})"),
       "scene.signals.s.blink: \"period\" is missing, expected a number"},
      {scene_text(R"("sky": {"harmonics": [[1, 1, 1], [1, 2]]})"),
       "scene.sky: \"harmonics\" is a list of 2, expected a list of 9 lists of 3 numbers"},
      {scene_text(R"("objects": 3)"), "scene: \"objects\" is 3, expected a list"},
  };
  for (const auto& test : kCases)
    EXPECT_EQ(error_text(parse_scene(test.text)), test.expected) << test.text;
}

TEST(SceneFormat, RefusesGroupsWithoutAnEnd) {
  std::string objects = "[]";
  for (int i = 0; i < 12; ++i) objects = R"([{"objects": )" + objects + "}]";
  EXPECT_NE(error_text(parse_scene(scene_text("\"objects\": " + objects))).find("nested deeper"),
            std::string::npos);
  // Parentheses alone must not exhaust the stack.
  const std::string deep(200000, '[');
  EXPECT_EQ(error_text(parse_scene(deep)), "is not valid JSON at byte 200001");
  EXPECT_EQ(error_text(parse_scene(scene_text("\"objects\": " + deep + std::string(200000, ']')))),
            "is nested deeper than 64 levels");
}

TEST(SceneFormat, TheScenesOfTheRepositoryAreFit) {
  std::vector<uint32_t> seeds;
  size_t train = 0, test = 0;
  for (const char* folder : {"train", "test"}) {
    for (const auto& entry :
         fs::directory_iterator(fs::path(SHALE_SOURCE_DIR) / "models/scenes" / folder)) {
      const bool is_test = std::string_view(folder) == "test";
      ++(is_test ? test : train);
      const auto loaded = load_scene(entry.path().string());
      // Models lie in packages that need not be installed.
      if (!loaded && error_text(loaded).find("apt-get install") != std::string::npos) continue;
      const Scene& scene = must(loaded);
      EXPECT_GE(scene.frames, is_test ? 40u : 60u) << scene.name;
      size_t triangles = 0;
      for (const SceneModel& model : scene.models) triangles += model.mesh.triangles.size();
      // A level is one model.
      EXPECT_TRUE(scene.primitives.size() + scene.instances.size() > 20 || triangles > 10000)
          << scene.name;
      EXPECT_EQ(std::count(seeds.begin(), seeds.end(), scene.seed), 0) << scene.name;
      seeds.push_back(scene.seed);
    }
  }
  EXPECT_GE(train, 20u);
  EXPECT_GE(test, 8u);
}

// --- Pure functions ---

TEST(SceneTables, CoverCellsMissesNoCell) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> at(-4, 16), part(0, 1);
  constexpr int32_t kColumns = 12, kRows = 9;
  for (int round = 0; round < 300; ++round) {
    std::vector<Point2> points(1 + random() % 8);
    const double width = round % 3 == 0 ? 0.01 : 1;  // slivers too
    for (Point2& p : points) p = {at(random) * width + 3 * (1 - width), at(random)};
    std::vector<int> hits(kColumns * kRows);
    cover_cells(points, 0.01, kColumns, kRows, [&](int32_t x, int32_t y) {
      ASSERT_TRUE(x >= 0 && x < kColumns && y >= 0 && y < kRows);
      ++hits[static_cast<size_t>(y * kColumns + x)];
    });
    for (const int count : hits) EXPECT_LE(count, 1);
    // Convex combinations lie in the hull.
    for (int i = 0; i < 400; ++i) {
      Point2 p;
      double sum = 0;
      for (const Point2& corner : points) {
        const double weight = std::pow(part(random), 6) + 1e-9;
        p.x += weight * corner.x;
        p.y += weight * corner.y;
        sum += weight;
      }
      const auto x = static_cast<int32_t>(std::floor(p.x / sum));
      const auto y = static_cast<int32_t>(std::floor(p.y / sum));
      if (x < 0 || y < 0 || x >= kColumns || y >= kRows) continue;
      EXPECT_EQ(hits[static_cast<size_t>(y * kColumns + x)], 1) << round;
    }
  }
}

TEST(SceneSampling, JitterIsHaltonOnAnEighthPixelGrid) {
  const Extent render{960, 540}, output{1920, 1080};
  EXPECT_EQ(jitter_phases(render, output), 32u);
  EXPECT_EQ(jitter_phases({1280, 720}, output), 18u);
  EXPECT_EQ(jitter_phases({640, 360}, output), 72u);
  // Halton of 1 is (1/2, 1/3): floors 4 and 2 of eighths.
  EXPECT_EQ(scene_jitter(0, render, output), (std::array{0.0625f, -0.1875f}));
  EXPECT_EQ(scene_jitter(32, render, output), scene_jitter(0, render, output));
  double sum_x = 0, sum_y = 0;
  for (uint32_t i = 0; i < 32; ++i) {
    const auto [x, y] = scene_jitter(i, render, output);
    EXPECT_EQ((x + 0.5f) * 8 - 0.5f, std::floor((x + 0.5f) * 8));
    EXPECT_LE(std::abs(y), 0.4375f);
    sum_x += x;
    sum_y += y;
  }
  EXPECT_LT(std::abs(sum_x / 32), 0.04);
  EXPECT_LT(std::abs(sum_y / 32), 0.04);
}

TEST(SceneSampling, MnssSamplesCentresOfOutputPixels) {
  // Source: MNSS (TVCG 2023): at ratio 2 the column moves by 1, 0 and the row by 1, 1, 0, again and again.
  const SamplingPattern mnss = must(parse_pattern("mnss"));
  const Extent render{48, 27}, twice{96, 54}, thrice{144, 81};
  EXPECT_EQ(jitter_phases(render, twice, mnss), 12u);
  EXPECT_EQ(jitter_phases(render, thrice, mnss), 9u);
  uint32_t column = 0, row = 0;
  for (uint32_t frame = 0; frame < 30; ++frame) {
    EXPECT_EQ(scene_jitter(frame, render, twice, mnss),
              (std::array{column ? 0.25f : -0.25f, row ? 0.25f : -0.25f}))
        << frame;
    column = (column + (frame % 2 == 0 ? 1 : 0)) % 2;
    row = (row + (frame % 3 == 2 ? 0 : 1)) % 2;
  }
  // Nine frames visit all nine places, each step to a neighbour.
  std::set<std::pair<int, int>> seen;
  std::pair<int, int> before{-1, 0};
  for (uint32_t frame = 0; frame < 9; ++frame) {
    const auto [x, y] = scene_jitter(frame, render, thrice, mnss);
    const std::pair at{std::lround(3 * x), std::lround(3 * y)};
    EXPECT_NEAR(x, static_cast<double>(at.first) / 3, 1e-6);
    EXPECT_NEAR(y, static_cast<double>(at.second) / 3, 1e-6);
    if (frame > 0) {
      EXPECT_EQ(std::abs(at.first - before.first) + std::abs(at.second - before.second), 1)
          << frame;
    }
    seen.insert(before = at);
  }
  EXPECT_EQ(seen.size(), 9u);
  EXPECT_EQ(error_text(check_pattern(mnss, {48, 27}, {72, 41})),
            "pattern: mnss is for ratios 2 and 3, the sizes are 48x27 to 72x41");
  EXPECT_TRUE(check_pattern({}, {48, 27}, {72, 41}));
}

TEST(SceneSampling, ListRepeats) {
  const SamplingPattern list = must(parse_pattern("0.25,-0.5:-1e-1,0"));
  EXPECT_EQ(pattern_text(list), "0.25,-0.5:-0.1,0");
  EXPECT_EQ(must(parse_pattern(pattern_text(list))), list);
  EXPECT_EQ(jitter_phases({4, 4}, {5, 5}, list), 2u);
  EXPECT_EQ(scene_jitter(6, {4, 4}, {5, 5}, list), (std::array{0.25f, -0.5f}));
  EXPECT_EQ(scene_jitter(7, {4, 4}, {5, 5}, list), (std::array{-0.1f, 0.0f}));
  for (const char* text : {"", "mnss2", "0.25", "0.1,0.2:", "0.1,0.2;0.3,0.4", "0.1,0.2,0.3"})
    EXPECT_NE(
        error_text(parse_pattern(text)).find("is none of halton, mnss, and offsets X,Y:X,Y:..."),
        std::string::npos)
        << text;
  EXPECT_EQ(error_text(parse_pattern("0.1,0.2:0.6,0")),
            "pattern: the offset 0.6,0 is outside -0.5 to 0.5");
  EXPECT_FALSE(parse_pattern("nan,0"));
  EXPECT_EQ(error_text(pattern_of({})), "pattern: has 0 offsets, expected 1 to 4096");
}

TEST(SceneSampling, ACameraStandsStillBehindItsLastKeyAndStartsAgainAtACut) {
  SceneCamera camera;
  camera.path = {{0, {0, 0, 0}, {0, 0, -1}, 0, false},
                 {10, {10, 0, 0}, {10, 0, -1}, 0, false},
                 {20, {50, 0, 0}, {50, 0, -1}, 0, true},
                 {30, {60, 0, 0}, {60, 0, -1}, 0, false}};
  camera.smooth = false;
  EXPECT_NEAR(camera_pose(camera, 5).eye.x, 5, 1e-12);
  EXPECT_EQ(camera_pose(camera, 19).eye.x, 10);
  EXPECT_EQ(camera_pose(camera, 20).eye.x, 50);
  EXPECT_NEAR(camera_pose(camera, 25).eye.x, 55, 1e-12);
  EXPECT_EQ(camera_pose(camera, 99).eye.x, 60);
  EXPECT_TRUE(is_camera_cut(camera, 20));
  EXPECT_FALSE(is_camera_cut(camera, 10));
}

TEST(SceneSignals, AreFunctionsOfContinuousTime) {
  const Scene scene = must(parse_scene(scene_text(R"("signals": {
    "a": {"path": [{"frame": 2, "value": 1}, {"frame": 4, "value": [3, 5, 7]}]},
    "b": {"path": [{"frame": 0, "value": 2}, {"frame": 3, "value": 4}], "interpolation": "step", "repeat": 5},
    "c": {"wave": {"amount": 0.5, "period": 8}},
    "d": {"blink": {"period": 4, "on": 0.25, "off": 0.125}},
    "e": {"flicker": {"amount": 0.6, "period": 3}},
    "f": {"blink": {"period": 2, "on": 0.7, "random": true}}})")));
  const auto at = [&](int signal, double frame, uint32_t variant = 0) {
    return signal_value(scene, signal, frame, variant);
  };
  EXPECT_EQ(at(kSteady, 3), (Vec3{1, 1, 1}));
  EXPECT_EQ(at(0, 0), (Vec3{1, 1, 1}));
  EXPECT_EQ(at(0, 3), (Vec3{2, 3, 4}));
  EXPECT_EQ(at(0, 3.5), (Vec3{2.5, 4, 5.5}));
  EXPECT_EQ(at(0, 90), (Vec3{3, 5, 7}));
  for (const auto& [frame, value] :
       {std::pair{0.0, 2.0}, {2.99, 2.0}, {3.0, 4.0}, {4.9, 4.0}, {5.0, 2.0}, {8.5, 4.0}})
    EXPECT_EQ(at(1, frame).x, value) << frame;
  for (const auto& [frame, value] : {std::pair{0.0, 1.0}, {2.0, 0.75}, {4.0, 0.5}, {12.0, 0.5}})
    EXPECT_NEAR(at(2, frame).x, value, 1e-12) << frame;
  for (const auto& [frame, value] :
       {std::pair{0.0, 1.0}, {0.99, 1.0}, {1.0, 0.125}, {3.9, 0.125}, {4.5, 1.0}})
    EXPECT_EQ(at(3, frame).x, value) << frame;
  // Noise: within its range, without jumps, and it does change. Copies differ.
  double low = 1, high = 0, jump = 0;
  int on = 0, differ = 0;
  for (int i = 0; i < 4000; ++i) {
    const double value = at(4, i * 0.1).x;
    low = std::min(low, value);
    high = std::max(high, value);
    jump = std::max(jump, std::abs(value - at(4, i * 0.1 + 0.01).x));
    on += at(5, i).x > 0 ? 1 : 0;
    differ += at(5, i).x != at(5, i, 77).x ? 1 : 0;
  }
  EXPECT_GE(low, 0.4);
  EXPECT_LT(low, 0.6);
  EXPECT_GT(high, 0.85);
  EXPECT_LT(jump, 0.02);
  EXPECT_NEAR(on, 2800, 200);
  EXPECT_GT(differ, 1000);
}

// --- Rendering ---

/// A floor, a ball that rolls and spins, a box that swings, under a camera that travels and turns; nothing but
/// emitted light, so that colour belongs to places of objects. Extra fields go into the camera.
std::string moving_scene(const std::string& camera, bool cut = false) {
  return R"({"schema": "shale-scene/1", "frames": 6, "seed": 5, "exposure": 0.8,
  "camera": {"fov_y": 55, )" +
         camera + R"( "interpolation": "linear", "path": [
    {"frame": 0, "eye": [-1, 1.6, 6], "target": [0, 0.8, 0]},)" +
         (cut ? R"({"frame": 3, "eye": [1, 3, 5], "target": [0, 0.5, 0], "cut": true},)" : "") + R"(
    {"frame": 5, "eye": [1.5, 1.9, 5.2], "target": [0.4, 0.9, -0.3], "roll": 6}]},
  "sun": {"direction": [0.4, 0.8, 0.3], "color": [0, 0, 0]},
  "sky": {"zenith": [0.1, 0.2, 0.5], "horizon": [0.4, 0.4, 0.5], "ground": [0.1, 0.1, 0.1], "ambient": [0, 0, 0]},
  "materials": {
    "floor": {"pattern": "smooth", "color": [0.9, 0.2, 0.3], "color_b": [0.1, 0.8, 0.4], "emission": 1, "emission_b": 1},
    "ball": {"pattern": "smooth", "color": [0.1, 0.3, 0.9], "color_b": [0.9, 0.9, 0.1], "emission": 2, "emission_b": 2},
    "mesh": {"pattern": "smooth", "color": [0.5, 0.1, 0.9], "emission": 1, "emission_b": 1, "cutout": "mesh", "cutout_cell": 0.2, "cutout_amount": 0.3}},
  "objects": [
    {"shape": "plane", "size": [8, 8], "material": "floor"},
    {"at": [0, 0.7, 0], "animate": {"interpolation": "linear", "path": [{"frame": 0, "at": [-1, 0, 0]}, {"frame": 5, "at": [0.6, 0.2, 0.5]}], "spin": {"axis": [0.3, 1, 0.2], "degrees": 9}},
      "objects": [{"shape": "sphere", "radius": 0.7, "material": "ball"}]},
    {"shape": "box", "at": [1.7, 0.6, -1], "size": [0.8, 1.2, 0.6], "material": "ball", "animate": {"swing": {"axis": [0, 1, 0], "degrees": 30, "period": 12}}},
    {"shape": "quad", "at": [-1.6, 0.8, 1], "rotate": [0, 30, 0], "size": [1.2, 1.4], "material": "mesh"}]})";
}

class SceneTest : public VulkanTest {
 protected:
  static std::unique_ptr<SceneSource> source_of(const Scene& scene, const SceneOptions& options) {
    return must(SceneSource::create(context(), scene, options));
  }
  static SceneOptions sizes(Extent render, Extent output) {
    SceneOptions options;
    options.render = render;
    options.output = output;
    return options;
  }
  static Scene moving(const std::string& camera = R"("near": 0.1, "far": 60,)", bool cut = false) {
    return must(parse_scene(moving_scene(camera, cut)));
  }
};

/// What a sample sees, computed again in double from depth and camera.
struct Place {
  double z = 0;
  Vec3 at;  ///< world
};

Vec3 direction_at(const CameraPose& pose, const Projection& p, Extent size, double x, double y) {
  return pose.forward + pose.right * ((x / size.width * 2 - 1) * p.tan_x) +
         pose.up * ((1 - y / size.height * 2) * p.tan_y);
}

Place place_at(const CameraPose& pose, const Projection& p, Extent size, double x, double y,
               float depth) {
  Place place;
  place.z = p.b / (depth - p.a);
  place.at = pose.eye + direction_at(pose, p, size, x, y) * place.z;
  return place;
}

/// uv of a place in the world.
std::array<double, 2> uv_of(const CameraPose& pose, const Projection& p, const Vec3& at) {
  const Vec3 v = at - pose.eye;
  const double z = dot(v, pose.forward);
  return {0.5 + 0.5 * dot(v, pose.right) / (z * p.tan_x),
          0.5 - 0.5 * dot(v, pose.up) / (z * p.tan_y)};
}

TEST_F(SceneTest, DepthGivesBackTheViewDepthOfEveryConvention) {
  for (const bool finite : {true, false}) {
    const Scene scene = moving(finite ? R"("near": 0.1, "far": 60,)" : R"("near": 0.1,)");
    for (const bool reverse : {false, true}) {
      SceneOptions options = sizes({64, 36}, {128, 72});
      options.reverse_depth = reverse;
      const auto source = source_of(scene, options);
      const SourceFrame frame = must(source->frame(2, false));
      EXPECT_EQ(frame.camera.reverse_depth, reverse);
      EXPECT_EQ(frame.camera.far_plane, finite ? 60 : 0);
      const Projection p = projection_of(scene.camera, options.output, reverse);
      const CameraPose pose = camera_pose(scene.camera, 2);
      size_t floor_pixels = 0;
      for (uint32_t y = 0; y < 36; ++y)
        for (uint32_t x = 0; x < 64; ++x) {
          const float depth = *frame.depth.at(x, y);
          if (depth == (reverse ? 0.0f : 1.0f)) continue;
          const double sx = x + 0.5 + frame.camera.jitter[0], sy = y + 0.5 + frame.camera.jitter[1];
          const Vec3 d = direction_at(pose, p, {64, 36}, sx, sy);
          const double floor_z = -pose.eye.y / d.y;
          const double z = p.b / (depth - p.a);
          if (std::abs(z - floor_z) > 0.02 * floor_z) continue;  // something stands on the floor
          ++floor_pixels;
          // A float near 1 is a multiple of 2^-24, and z' = z^2 / b; the ray itself is off by less
          // than 4e-6 of z here (a slope of at least 0.1, in float).
          const double bound = z * z / std::abs(p.b) * 0x1p-23 + 4e-6 * z;
          EXPECT_NEAR(z, floor_z, bound) << x << "," << y << " reverse " << reverse;
        }
      EXPECT_GT(floor_pixels, 500u);
    }
  }
}

TEST_F(SceneTest, MotionIsThatOfTheObjectsAndTheCamera) {
  const Scene scene = moving();
  const SceneOptions options = sizes({96, 54}, {192, 108});
  const auto source = source_of(scene, options);
  must(source->frame(2, false));
  const SourceFrame frame = must(source->frame(3, true));
  const FramePoses poses = frame_poses(scene, 3, true);
  const Projection p = projection_of(scene.camera, options.output, false);
  size_t seen[4] = {};
  double largest[2] = {};
  const auto check = [&](const FloatImage& depth, const FloatImage& motion, Extent size, uint32_t x,
                         uint32_t y, double sx, double sy) {
    const float d = *depth.at(x, y);
    if (d == 1) return;
    const Place place = place_at(poses.camera, p, size, sx, sy, d);
    // The primitive: the one whose surface the place is nearest to, in its unit space.
    size_t best = 0;
    double nearest = 1e30;
    for (size_t i = 0; i < scene.primitives.size(); ++i) {
      const Primitive& primitive = scene.primitives[i];
      const Vec3 local =
          inverse_orthogonal(poses.nodes[static_cast<size_t>(primitive.node)]).point(place.at);
      const Vec3 u{local.x / primitive.half.x, local.y / primitive.half.y,
                   local.z / primitive.half.z};
      const double inside = primitive.shape == PrimitiveShape::kSphere ? length(u)
                            : primitive.shape == PrimitiveShape::kBox
                                ? std::max({std::abs(u.x), std::abs(u.y), std::abs(u.z)})
                                : std::max({std::abs(u.x), std::abs(u.y), 1 + std::abs(local.z)});
      if (std::abs(inside - 1) < nearest) {
        nearest = std::abs(inside - 1);
        best = i;
      }
    }
    if (nearest > 2e-3) return;  // float depth is too coarse to tell here
    ++seen[best];
    const size_t node = static_cast<size_t>(scene.primitives[best].node);
    const Vec3 was =
        poses.nodes_was[node].point(inverse_orthogonal(poses.nodes[node]).point(place.at));
    const auto uv_was = uv_of(poses.camera_was, p, was);
    for (size_t c = 0; c < 2; ++c) {
      const double uv = c == 0 ? sx / size.width : sy / size.height;
      largest[c] = std::max(largest[c], std::abs(uv - uv_was[c]));
      // In pixels of the output. The place is known to about z^2 / near * 2^-24 = 6e-5 m along the
      // ray at z = 10; between the two frames that moves by less than a tenth of it, at 100 pixels
      // per metre: below 1e-3. Positions in float are off by 1e-6 of the picture.
      EXPECT_NEAR(uv - uv_was[c], motion.at(x, y)[c], 1e-5)
          << "primitive " << best << " at " << x << "," << y;
    }
  };
  for (uint32_t y = 0; y < 54; ++y)
    for (uint32_t x = 0; x < 96; ++x)
      check(frame.depth, frame.motion, {96, 54}, x, y, x + 0.5 + frame.camera.jitter[0],
            y + 0.5 + frame.camera.jitter[1]);
  for (const size_t count : seen) EXPECT_GT(count, 20u);
  for (const double m : largest) EXPECT_GT(m, 0.01);
}

/// Bilinear colour at a position in texels; nothing near the border.
std::optional<std::array<double, 3>> bilinear(const FloatImage& image, double x, double y) {
  const double fx = std::floor(x - 0.5), fy = std::floor(y - 0.5);
  if (fx < 0 || fy < 0 || fx + 1 >= image.width || fy + 1 >= image.height) return std::nullopt;
  const auto ix = static_cast<uint32_t>(fx), iy = static_cast<uint32_t>(fy);
  const double a = x - 0.5 - fx, b = y - 0.5 - fy;
  std::array<double, 3> color{};
  for (uint32_t c = 0; c < 3; ++c)
    color[c] = (1 - b) * ((1 - a) * image.at(ix, iy)[c] + a * image.at(ix + 1, iy)[c]) +
               b * ((1 - a) * image.at(ix, iy + 1)[c] + a * image.at(ix + 1, iy + 1)[c]);
  return color;
}

TEST_F(SceneTest, ColourReprojectsWithMotionAndJitter) {
  const Scene scene = moving();
  const auto source = source_of(scene, sizes({192, 108}, {384, 216}));
  const SourceFrame before = must(source->frame(3, false));
  const SourceFrame now = must(source->frame(4, false));
  // Median of what colours differ by, for the right signs and for wrong ones.
  const auto median = [&](double motion_sign, double jitter_sign) {
    std::vector<double> errors;
    for (uint32_t y = 0; y < 108; ++y)
      for (uint32_t x = 0; x < 192; ++x) {
        if (*now.depth.at(x, y) == 1) continue;
        const float* m = now.motion.at(x, y);
        const double px = x + 0.5 + jitter_sign * now.camera.jitter[0] - motion_sign * m[0] * 192;
        const double py = y + 0.5 + jitter_sign * now.camera.jitter[1] - motion_sign * m[1] * 108;
        const auto color = bilinear(before.color, px - jitter_sign * before.camera.jitter[0],
                                    py - jitter_sign * before.camera.jitter[1]);
        if (!color) continue;
        for (uint32_t c = 0; c < 3; ++c)
          errors.push_back(std::abs((*color)[c] - now.color.at(x, y)[c]));
      }
    std::nth_element(errors.begin(), errors.begin() + static_cast<ptrdiff_t>(errors.size() / 2),
                     errors.end());
    return errors[errors.size() / 2];
  };
  const double right = median(1, 1);
  // Bilinear error is at most 1/8 of the second difference on either axis. Colours change by
  // 0.8 * 9 / 6 per unit squared, and a pixel is about 0.01 units: below 1e-4.
  EXPECT_LT(right, 1e-4);
  EXPECT_GT(median(1, -1), 4 * right);
  EXPECT_GT(median(1, 0), 4 * right);
  EXPECT_GT(median(-1, 1), 20 * right);
  EXPECT_GT(median(0, 1), 20 * right);
}

TEST_F(SceneTest, JitteredSamplesAndTruthAreSamplesOfOnePicture) {
  const Scene scene = moving();
  const SceneOptions options = sizes({32, 18}, {64, 36});
  const auto source = source_of(scene, options);
  const SourceFrame frame = must(source->frame(1, true));
  // 8x8 samples to a render pixel, 4x4 to an output pixel, none moved.
  auto renderer = must(SceneRenderer::create(context(), scene));
  const Window window{options.output, 0, 0, options.output};
  const FramePoses poses = frame_poses(scene, 1, true);
  must(
      renderer->set_frame(must(frame_tables(scene, poses, window, false, renderer->max_texels()))));
  SampleGrid grid;
  grid.extent = {32 * 8, 18 * 8};
  grid.scale_x = grid.scale_y = 0.25;
  const RenderedImages fine = must(renderer->render(grid, {}));

  const auto offset = [&](size_t axis) {
    return static_cast<uint32_t>((frame.camera.jitter[axis] + 0.5f) * 8);
  };
  for (uint32_t y = 0; y < 18; ++y)
    for (uint32_t x = 0; x < 32; ++x) {
      const uint32_t fx = 8 * x + offset(0), fy = 8 * y + offset(1);
      for (uint32_t c = 0; c < 3; ++c)
        ASSERT_EQ(frame.color.at(x, y)[c], fine.color.at(fx, fy)[c]) << x << "," << y;
      ASSERT_EQ(*frame.depth.at(x, y), *fine.depth.at(fx, fy));
      ASSERT_EQ(frame.motion.at(x, y)[0], fine.motion.at(fx, fy)[0]);
    }
  const double exposure = frame.camera.exposure;
  for (uint32_t y = 0; y < 36; ++y)
    for (uint32_t x = 0; x < 64; ++x) {
      std::array<double, 3> sum{};
      float nearest = 2;
      std::array<float, 2> motion{};
      for (uint32_t sy = 4 * y; sy < 4 * y + 4; ++sy)
        for (uint32_t sx = 4 * x; sx < 4 * x + 4; ++sx) {
          const float* c = fine.color.at(sx, sy);
          const double most = std::max({c[0], c[1], c[2]}) * exposure;
          for (size_t i = 0; i < 3; ++i) sum[i] += c[i] * exposure / (1 + most) / 16;
          if (*fine.depth.at(sx, sy) >= nearest) continue;
          nearest = *fine.depth.at(sx, sy);
          motion = {fine.motion.at(sx, sy)[0], fine.motion.at(sx, sy)[1]};
        }
      const double most = std::max({sum[0], sum[1], sum[2]});
      for (uint32_t c = 0; c < 3; ++c) {
        const double expected = sum[c] / (1 - most) / exposure;
        // 16 roundings in float, widened by the inverse.
        EXPECT_NEAR(frame.truth.at(x, y)[c], expected, 4e-6 * (1 + expected) / (1 - most));
      }
      EXPECT_EQ(*frame.truth_depth.at(x, y), nearest);
      // Samples of equal depth may differ in motion; on one primitive by very little.
      EXPECT_NEAR(frame.truth_motion.at(x, y)[0], motion[0], 1e-4);
      EXPECT_NEAR(frame.truth_motion.at(x, y)[1], motion[1], 1e-4);
    }
}

TEST_F(SceneTest, ACropIsAPartOfThePictureBitForBit) {
  const Scene scene = must(load_scene(SHALE_SOURCE_DIR "/models/scenes/test/motion.json"));
  const auto source = source_of(scene, sizes({96, 54}, {192, 108}));
  must(source->set_clip({20, 2, {}}));
  must(source->frame(0, false));
  const SourceFrame whole = must(source->frame(1, true));
  const Crop crop{66, 30, 64, 48};
  must(source->set_clip({20, 2, crop}));
  EXPECT_EQ(source->render_size(), (Extent{32, 24}));
  EXPECT_EQ(source->output_size(), (Extent{64, 48}));
  const SourceFrame part = must(source->frame(1, true));
  for (uint32_t y = 0; y < 48; ++y)
    for (uint32_t x = 0; x < 64; ++x) {
      ASSERT_EQ(std::memcmp(part.truth.at(x, y), whole.truth.at(x + 66, y + 30), 12), 0)
          << x << "," << y;
      ASSERT_EQ(*part.truth_depth.at(x, y), *whole.truth_depth.at(x + 66, y + 30));
      const float* m = whole.truth_motion.at(x + 66, y + 30);
      EXPECT_FLOAT_EQ(part.truth_motion.at(x, y)[0], m[0] * 3);
      EXPECT_FLOAT_EQ(part.truth_motion.at(x, y)[1], m[1] * 2.25f);
    }
  for (uint32_t y = 0; y < 24; ++y)
    for (uint32_t x = 0; x < 32; ++x)
      ASSERT_EQ(std::memcmp(part.color.at(x, y), whole.color.at(x + 33, y + 15), 12), 0);
  // The pixels of a crop are as wide as those of the whole.
  EXPECT_NEAR(std::tan(part.camera.fov_x / 2) / 64, std::tan(whole.camera.fov_x / 2) / 192, 1e-8);
  EXPECT_NEAR(std::tan(part.camera.fov_y / 2) / 48, std::tan(whole.camera.fov_y / 2) / 108, 1e-8);
  // The matrices agree about a place in the world: clip space of the crop is that of its part.
  const auto project = [](const std::array<float, 16>& m, const Vec3& p) {
    std::array<double, 4> clip{};
    for (size_t r = 0; r < 4; ++r)
      clip[r] = m[r] * p.x + m[4 + r] * p.y + m[8 + r] * p.z + m[12 + r];
    return clip;
  };
  const Vec3 place{0.4, 1.1, -1.5};
  const auto a = project(whole.camera.view_projection, place);
  const auto b = project(part.camera.view_projection, place);
  EXPECT_NEAR((b[0] / b[3] + 1) / 2 * 64 + 66, (a[0] / a[3] + 1) / 2 * 192, 1e-3);
  EXPECT_NEAR((1 - b[1] / b[3]) / 2 * 48 + 30, (1 - a[1] / a[3]) / 2 * 108, 1e-3);
  EXPECT_NEAR(b[2] / b[3], a[2] / a[3], 1e-6);

  EXPECT_EQ(error_text(source->set_clip({0, 0, Crop{65, 0, 64, 48}})),
            "crop: x 65 with 64 pixels does not fall on render pixels, expected multiples of 2");
  EXPECT_EQ(error_text(source->set_clip({0, 0, Crop{0, 80, 64, 48}})),
            "crop: y 80 to 128 is outside of the picture's 108 pixels");
  EXPECT_EQ(error_text(source->set_clip({60, 0, {}})),
            "first frame: is 60, the scene has 60 frames");
}

TEST_F(SceneTest, RendersTheSameBitsAgain) {
  const Scene scene = must(load_scene(SHALE_SOURCE_DIR "/models/scenes/test/motion.json"));
  const auto render = [&] {
    return must(source_of(scene, sizes({48, 27}, {96, 54}))->frame(3, true));
  };
  const SourceFrame a = render(), b = render();
  EXPECT_EQ(a.color.values, b.color.values);
  EXPECT_EQ(a.motion.values, b.motion.values);
  EXPECT_EQ(a.truth.values, b.truth.values);
  for (const float value : a.truth.values) EXPECT_TRUE(std::isfinite(value) && value >= 0);
}

TEST_F(SceneTest, NothingIsContinuedAcrossACutOrFromBeforeTheFirstFrame) {
  const auto source =
      source_of(moving(R"("near": 0.1, "far": 60,)", true), sizes({48, 27}, {96, 54}));
  EXPECT_EQ(source->frame_count(), 6u);
  for (const uint32_t index : {0u, 3u}) {
    const SourceFrame frame = must(source->frame(index, false));
    EXPECT_TRUE(frame.camera.cut);
    for (const float m : frame.motion.values) EXPECT_EQ(m, 0);
  }
  const SourceFrame frame = must(source->frame(4, false));
  EXPECT_FALSE(frame.camera.cut);
  EXPECT_GT(*std::max_element(frame.motion.values.begin(), frame.motion.values.end()), 1e-3f);
  EXPECT_EQ(error_text(source->frame(6, false)), "frame 6 is asked for, the sequence has 6");
}

/// A white floor seen from above, lit by nothing but what `rest` says.
Scene lit_floor(const std::string& rest, const std::string& objects = "") {
  return must(parse_scene(R"({"schema": "shale-scene/1", "frames": 4,
    "camera": {"fov_y": 60, "path": [{"frame": 0, "eye": [0, 6, 0.01], "target": [0, 0, 0]}]},
    "sun": {"direction": [0, 1, 0], "color": [0, 0, 0]},
    "materials": {"white": {"color": [1, 1, 1]}},
    "objects": [)" + objects +
                          R"({"shape": "plane", "size": [40, 40], "material": "white"}], )" + rest +
                          "}"));
}

const std::string kNoAmbient =
    R"("sky": {"zenith": [0, 0, 0], "horizon": [0, 0, 0], "ground": [0, 0, 0], "ambient": [0, 0, 0]}, )";

TEST_F(SceneTest, ARectangleLightsAsTheClosedFormSays) {
  // Below the middle of a rectangle: four times what one with a corner above a place sends there.
  const double width = 3, depth = 1.2, height = 2.5;
  const Scene scene = lit_floor(
      kNoAmbient +
      R"("lights": [{"at": [0, 2.5, 0], "size": [3, 1.2], "color": [4, 2, 1], "range": 1000}])");
  const SourceFrame frame = must(source_of(scene, sizes({33, 33}, {33, 33}))->frame(0, false));
  const double a = width / 2 / height, b = depth / 2 / height;
  const double form = 4 / (2 * 3.14159265358979) *
                      (a / std::sqrt(1 + a * a) * std::atan(b / std::sqrt(1 + a * a)) +
                       b / std::sqrt(1 + b * b) * std::atan(a / std::sqrt(1 + b * b)));
  const float* middle = frame.color.at(16, 16);
  // The pixel is at most 0.1 m from the middle, where the factor changes by less than its square.
  EXPECT_NEAR(middle[0], 4 * form, 0.01 * 4 * form);
  EXPECT_NEAR(middle[1], 2 * form, 0.01 * 2 * form);
  // It shines to one side: from above it, nothing.
  const Scene turned = lit_floor(
      kNoAmbient +
      R"("lights": [{"at": [0, 2.5, 0], "rotate": [180, 0, 0], "size": [3, 1.2], "range": 1000}])");
  const SourceFrame dark = must(source_of(turned, sizes({8, 8}, {8, 8}))->frame(0, false));
  for (const float value : dark.color.values) EXPECT_EQ(value, 0);
}

TEST_F(SceneTest, AConeEndsWhereItSays) {
  const Scene scene =
      lit_floor(kNoAmbient + R"("lights": [{"at": [0, 2, 0], "cone": [89.9, 90], "range": 1000}])");
  const SourceFrame frame = must(source_of(scene, sizes({65, 65}, {65, 65}))->frame(0, false));
  const CameraPose pose = camera_pose(scene.camera, 0);
  const Projection p = projection_of(scene.camera, {65, 65}, false);
  size_t lit = 0;
  for (uint32_t y = 0; y < 65; ++y)
    for (uint32_t x = 0; x < 65; ++x) {
      const Vec3 d = direction_at(pose, p, {65, 65}, x + 0.5 + frame.camera.jitter[0],
                                  y + 0.5 + frame.camera.jitter[1]);
      const Vec3 at = pose.eye + d * (-pose.eye.y / d.y);
      const double off = std::hypot(at.x, at.z) - 2;
      if (std::abs(off) < 0.02) continue;
      EXPECT_EQ(*frame.color.at(x, y) > 0, off < 0) << x << "," << y;
      lit += off < 0 ? 1 : 0;
    }
  EXPECT_GT(lit, 200u);
}

TEST_F(SceneTest, LampsCastShadowsOfWhateverStandsBetween) {
  std::string balls;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> part(-1, 1);
  std::vector<std::pair<Vec3, double>> spheres;
  for (int i = 0; i < 60; ++i) {
    const Vec3 at{4 * part(random), 1.4 + part(random), 3 * part(random)};
    const double radius = 0.12 + 0.08 * part(random);
    spheres.push_back({at, radius});
    balls += fmt::format(
        R"({{"shape": "sphere", "at": [{}, {}, {}], "radius": {}, "material": "white", "shadow": {}}}, )",
        at.x, at.y, at.z, radius, i % 5 != 0);
  }
  const Scene scene = lit_floor(
      kNoAmbient + R"("lights": [{"at": [0.5, 3.4, 0.3], "range": 1000, "shadow": true}])", balls);
  const SourceFrame frame = must(source_of(scene, sizes({160, 120}, {160, 120}))->frame(0, false));
  const CameraPose pose = camera_pose(scene.camera, 0);
  const Projection p = projection_of(scene.camera, {160, 120}, false);
  const Vec3 lamp{0.5, 3.4, 0.3};
  size_t lit = 0, dark = 0;
  for (uint32_t y = 0; y < 120; ++y)
    for (uint32_t x = 0; x < 160; ++x) {
      const Place place = place_at(pose, p, {160, 120}, x + 0.5 + frame.camera.jitter[0],
                                   y + 0.5 + frame.camera.jitter[1], *frame.depth.at(x, y));
      if (std::abs(place.at.y) > 0.01) continue;
      double nearest = 1e9;  // what the shadow's edge is away by, negative inside of it
      for (size_t i = 0; i < spheres.size(); ++i) {
        if (i % 5 == 0) continue;
        const Vec3 way = lamp - place.at, to = spheres[i].first - place.at;
        const double s = dot(to, way) / dot(way, way);
        nearest = std::min(nearest, length(to - way * s) - spheres[i].second);
      }
      if (std::abs(nearest) < 2e-3) continue;
      ++(nearest > 0 ? lit : dark);
      EXPECT_EQ(*frame.color.at(x, y) > 0, nearest > 0) << x << "," << y;
    }
  EXPECT_GT(lit, 5000u);
  EXPECT_GT(dark, 500u);
}

TEST_F(SceneTest, SphericalHarmonicsLightAsTheirEnvironmentDoes) {
  // Radiance 3 + 2 y - z + 0.5 (3 y^2 - 1): a floor reflects 3 + 2 * 2/3 + 0.5 * 2 / 4 of it. The
  // last part is -(1/4)(3 z^2 - 1) - (3/4)(x^2 - y^2) times 1, on the bands' normalizations.
  const double c0 = 0.28209479177387814, c1 = 0.4886025119029199, c20 = 0.31539156525252005,
               c22 = 0.5462742152960396;
  const auto coefficient = [](double value, double factor) {
    return fmt::format("[{0}, {0}, {0}]", value / factor);
  };
  const Scene scene =
      lit_floor(R"("sky": {"ambient": [9, 9, 9], "harmonics": [)" + coefficient(3, c0) + "," +
                coefficient(2, c1) + "," + coefficient(-1, c1) + ",[0,0,0],[0,0,0],[0,0,0]," +
                coefficient(-0.25, c20) + ",[0,0,0]," + coefficient(-0.75, c22) + "]}");
  const SourceFrame frame = must(source_of(scene, sizes({8, 8}, {8, 8}))->frame(0, false));
  for (const float value : frame.color.values)
    EXPECT_NEAR(value, 3 + 2 * 2.0 / 3 + 0.5 * 2 / 4, 1e-5);
}

TEST_F(SceneTest, AnyFrameRateShowsTheSameTime) {
  const Scene scene = moving(R"("near": 0.1, "far": 60,)", true);
  SceneOptions options = sizes({48, 27}, {96, 54});
  const auto at_30 = source_of(scene, options);
  options.frame_rate = 75;
  const auto at_75 = source_of(scene, options);
  EXPECT_EQ(at_30->frame_count(), 6u);
  EXPECT_EQ(at_75->frame_count(), 13u);  // 5 frames take 1/6 s: 12.5 steps
  const SourceFrame slow = must(at_30->frame(2, true)), fast = must(at_75->frame(5, true));
  EXPECT_EQ(slow.truth.values, fast.truth.values);
  // Linear paths: the motion is less by the ratio of rates, apart from turns and perspective.
  double slow_sum = 0, fast_sum = 0;
  for (const float m : slow.motion.values) slow_sum += std::abs(m);
  for (const float m : fast.motion.values) fast_sum += std::abs(m);
  EXPECT_NEAR(fast_sum * 2.5, slow_sum, 0.05 * slow_sum);
  // The cut at frame 3 lies between 7 and 8 steps of 0.4.
  EXPECT_FALSE(must(at_75->frame(7, false)).camera.cut);
  EXPECT_TRUE(must(at_75->frame(8, false)).camera.cut);
  EXPECT_FALSE(must(at_75->frame(9, false)).camera.cut);
}

TEST_F(SceneTest, StopsBetweenBandsWhenToldTo) {
  SceneOptions options = sizes({512, 512}, {1024, 1024});
  int asked = 0;
  options.keep_going = [&] { return ++asked < 3; };
  const auto source = source_of(moving(), options);
  EXPECT_EQ(error_text(source->frame(0, true)), "interrupted");
  EXPECT_EQ(asked, 3);
}

// --- On disk ---

class DatasetTest : public testing::Test {
 protected:
  void SetUp() override {
    root_ = fs::path(testing::TempDir()) / "shale_dataset_test";
    fs::remove_all(root_);
  }
  void TearDown() override { fs::remove_all(root_); }

  static FloatImage random_image(Extent size, uint32_t channels, float least, float most,
                                 uint32_t seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> value(least, most);
    FloatImage image{size.width, size.height, channels, {}};
    image.values.resize(size_t{size.width} * size.height * channels);
    for (float& v : image.values) v = value(random);
    return image;
  }

  static SourceFrame random_frame(uint32_t seed) {
    SourceFrame frame;
    frame.color = random_image({12, 8}, 3, 0, 900, seed);
    frame.depth = random_image({12, 8}, 1, 0.99f, 1, seed + 1);
    frame.motion = random_image({12, 8}, 2, -1, 1, seed + 2);
    frame.truth = random_image({18, 12}, 3, 0, 60000, seed + 3);
    frame.truth_motion = random_image({18, 12}, 2, -1, 1, seed + 4);
    frame.truth_depth = random_image({18, 12}, 1, 0, 1, seed + 5);
    frame.camera.fov_x = 1.2f;
    frame.camera.fov_y = 0.8f;
    frame.camera.near_plane = 0.1f;
    frame.camera.jitter = {0.0625f, -0.4375f};
    frame.camera.exposure = 0.37f;
    frame.camera.reverse_depth = true;
    for (size_t i = 0; i < 16; ++i)
      frame.camera.view_projection[i] = static_cast<float>(i) / 7 + static_cast<float>(seed);
    return frame;
  }

  std::string write_sequence() {
    SequenceInfo info;
    info.number = 3;
    info.render = {12, 8};
    info.output = {18, 12};
    info.jitter_phases = 18;
    DatasetWriter writer = must(DatasetWriter::create(root_.string(), info));
    for (uint32_t i = 0; i < 2; ++i) must(writer.add(random_frame(10 * i)));
    must(writer.finish());
    return (root_ / "0003.json").string();
  }

  void replace_in(const std::string& path, const std::string& from, const std::string& to) {
    std::string text = must(read_text(path));
    const size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    must(write_text(path, text.replace(at, from.size(), to)));
  }

  fs::path root_;
};

TEST_F(DatasetTest, ReadsBackWhatItWrote) {
  const std::string json = write_sequence();
  EXPECT_EQ(must(dataset_sequences(root_.string())), std::vector<std::string>{json});
  EXPECT_TRUE(fs::exists(root_ / "x1_5/color/0003/0001.exr"));
  const auto source = must(DatasetSource::open(json));
  EXPECT_EQ(source->name(), "0003");
  EXPECT_EQ(source->frame_count(), 2u);
  EXPECT_EQ(source->render_size(), (Extent{12, 8}));
  EXPECT_EQ(source->output_size(), (Extent{18, 12}));
  for (uint32_t i = 0; i < 2; ++i) {
    const SourceFrame written = random_frame(10 * i), read = must(source->frame(i, true));
    EXPECT_EQ(read.depth.values, written.depth.values);
    EXPECT_EQ(read.truth_depth.values, written.truth_depth.values);
    // Half: 11 significant bits, rounded to nearest; below 2^-14 steps of 2^-24.
    const auto expect_half = [](const FloatImage& a, const FloatImage& b) {
      ASSERT_EQ(a.values.size(), b.values.size());
      for (size_t k = 0; k < a.values.size(); ++k)
        ASSERT_NEAR(a.values[k], b.values[k], std::abs(b.values[k]) * 0x1p-11 + 0x1p-25);
    };
    expect_half(read.color, written.color);
    expect_half(read.motion, written.motion);
    expect_half(read.truth, written.truth);
    expect_half(read.truth_motion, written.truth_motion);
    EXPECT_EQ(read.camera.fov_x, written.camera.fov_x);
    EXPECT_EQ(read.camera.fov_y, written.camera.fov_y);
    EXPECT_EQ(read.camera.near_plane, written.camera.near_plane);
    EXPECT_EQ(read.camera.far_plane, 0);
    EXPECT_NEAR(read.camera.jitter[0], written.camera.jitter[0], 1e-6);
    EXPECT_NEAR(read.camera.jitter[1], written.camera.jitter[1], 1e-6);
    EXPECT_EQ(read.camera.exposure, written.camera.exposure);
    EXPECT_TRUE(read.camera.reverse_depth);
    EXPECT_EQ(read.camera.view_projection, written.camera.view_projection);
    EXPECT_EQ(read.camera.cut, i == 0);
  }
  const SourceFrame plain = must(source->frame(1, false));
  EXPECT_TRUE(plain.truth.empty());
}

TEST_F(DatasetTest, ValuesOfPicturesMayBeAnything) {
  FloatImage image{2, 2, 3, {1e9f, -1e9f, 0, 65504, 65520, -0.0f, 1e-9f, 3, 4, 5, 6, 7}};
  image.values[7] = std::numeric_limits<float>::quiet_NaN();
  image.values[8] = std::numeric_limits<float>::infinity();
  fs::create_directories(root_);
  const std::string path = (root_ / "a.exr").string();
  must(write_exr(path, image, ExrPrecision::kHalf));
  const FloatImage read = must(read_exr(path, 3));
  EXPECT_EQ(read.values[0], 65504);
  EXPECT_EQ(read.values[1], -65504);
  EXPECT_EQ(read.values[4], 65504);
  EXPECT_TRUE(std::isnan(read.values[7]));
  EXPECT_TRUE(std::isinf(read.values[8]));
}

TEST_F(DatasetTest, RefusesFilesThatAreNotAsExpected) {
  const std::string json = write_sequence();
  const std::string color = (root_ / "x1_5/color/0003/0001.exr").string();
  const auto read = [&] { return error_text(must(DatasetSource::open(json))->frame(1, true)); };

  must(write_exr(color, random_image({12, 9}, 3, 0, 1, 1), ExrPrecision::kHalf));
  EXPECT_EQ(read(), color + ": has 12x9 pixels, expected 12x8");
  must(write_exr(color, random_image({12, 8}, 2, 0, 1, 1), ExrPrecision::kHalf));
  EXPECT_EQ(read(), color + ": lacks channel B, found G, R");
  // Cut short, and of other bytes: an error, never an exception or a crash.
  must(write_exr(color, random_image({12, 8}, 3, 0, 1, 1), ExrPrecision::kFloat));
  const std::vector<uint8_t> whole = must(read_file(color));
  for (size_t size = 0; size < whole.size(); size += 37) {
    must(write_file(color, std::span(whole).first(size)));
    EXPECT_NE(read().find(color + ": "), std::string::npos) << size;
  }
  std::mt19937 random(11);
  for (int round = 0; round < 200; ++round) {
    std::vector<uint8_t> bytes = whole;
    for (int i = 0; i < 4; ++i) bytes[random() % bytes.size()] = static_cast<uint8_t>(random());
    must(write_file(color, bytes));
    (void)read();
  }
  // Frames end where the pictures do.
  fs::remove(color);
  EXPECT_EQ(must(DatasetSource::open(json))->frame_count(), 1u);

  replace_in(json, "\"FovY\": 0.8", "\"FovY\": \"0.8");
  EXPECT_EQ(error_text(DatasetSource::open(json)), json + ": is not valid JSON at byte 340");
}

TEST_F(DatasetTest, RefusesSequencesThatBreakTheRules) {
  const struct {
    const char *from, *to, *expected;
  } kCases[]{
      {"\"X\": 18", "\"X\": 90000",
       "sequence.TargetResolution: \"X\" is 90000, expected 1 to 8192"},
      {"\"CameraNearPlane\"", "\"CameraNearPlan\"",
       "sequence.Frames[0]: \"CameraNearPlane\" is missing, expected a number"},
      {"\"CameraFarPlane\": -1.0", "\"CameraFarPlane\": 0.05",
       "sequence.Frames[0]: \"CameraFarPlane\" is 0.05, expected more than the near plane, "
       "0.10000000149011612, or -1"},
      {"\"x1_5_index\": 0", "\"x1_5_index\": 4",
       "sequence.Frames[0]: \"NormalizedPerRatioJitter\" has 1 entries, ratio 1.5 is 4"},
      {"\"CameraCut\": false", "\"CameraCut\": 1",
       "sequence.Frames[0]: \"CameraCut\" is 1, expected true or false"},
  };
  for (const auto& test : kCases) {
    const std::string json = write_sequence();
    replace_in(json, test.from, test.to);
    EXPECT_EQ(error_text(DatasetSource::open(json)), json + ": " + test.expected);
  }
  const std::string json = write_sequence();
  replace_in(json, "\"Exposure\"", "\"Exposur\"");
  EXPECT_NEAR(must(must(DatasetSource::open(json))->frame(0, false)).camera.exposure, std::exp(2.0),
              1e-5);
  EXPECT_EQ(error_text(DatasetSource::open(json, 2)),
            json + ": has no pictures of ratio 2, it has x1_5");
}

TEST_F(DatasetTest, TakesTheRatioThatIsNamedOrTwoOrTheOnlyOne) {
  const std::string json = write_sequence();
  EXPECT_EQ(must(DatasetSource::open(json))->render_size(), (Extent{12, 8}));
  // Not all that the sequence lists has to be there.
  replace_in(json, "\"x1_5_index\": 0", "\"x1_3_index\": 7, \"x2_index\": 1, \"x1_5_index\": 0");
  EXPECT_EQ(must(DatasetSource::open(json))->render_size(), (Extent{12, 8}));
  const auto add = [&](const char* ratio, Extent size) {
    for (uint32_t i = 0; i < 2; ++i)
      for (const auto& [kind, channels] :
           {std::pair{"color", 3u}, std::pair{"depth", 1u}, std::pair{"motion", 2u}}) {
        const fs::path folder = root_ / ratio / kind / "0003";
        fs::create_directories(folder);
        must(write_exr((folder / fmt::format("{:04}.exr", i)).string(),
                       random_image(size, channels, 0, 1, i), ExrPrecision::kFloat));
      }
  };
  add("x1.3", {13, 9});  // 18 / 1.3 is 13.8, 12 / 1.3 is 9.2: rounded down
  EXPECT_EQ(error_text(DatasetSource::open(json)),
            json + ": has pictures of several ratios, choose one with --ratio: x1.3, x1_5");
  EXPECT_EQ(
      error_text(DatasetSource::open(json, 1.3)),
      json + ": sequence.Frames[0]: \"NormalizedPerRatioJitter\" has 1 entries, ratio 1.3 is 7");
  replace_in(json, "\"x1_3_index\": 7", "\"x1_3_index\": 0");
  EXPECT_EQ(must(DatasetSource::open(json, 1.3))->render_size(), (Extent{13, 9}));
  EXPECT_EQ(must(must(DatasetSource::open(json, 1.3))->frame(1, true)).color.width, 13u);
  add("x2", {9, 6});
  replace_in(json, "\"x2_index\": 1", "\"x2_index\": 0");
  EXPECT_EQ(must(DatasetSource::open(json))->render_size(), (Extent{9, 6}));
  EXPECT_EQ(must(DatasetSource::open(json, 1.5))->render_size(), (Extent{12, 8}));
  add("x3", {6, 6});
  // What it does not list was left by another sequence of its name.
  EXPECT_EQ(error_text(DatasetSource::open(json, 3)),
            json + ": has no pictures of ratio 3, it has x1.3, x1_5, x2");
  replace_in(json, "\"x2_index\": 0", "\"x2_index\": 0, \"x3_index\": 0");
  EXPECT_EQ(
      error_text(DatasetSource::open(json, 3)),
      (root_ / "x3/color/0003/0000.exr").string() + ": has 6x6 pixels, 18x12 at ratio 3 makes 6x4");
}

TEST_F(DatasetTest, NothingOfAnEarlierSequenceStays) {
  const std::string json = write_sequence();
  EXPECT_EQ(must(must(DatasetSource::open(json))->frame(0, true)).truth.width, 18u);
  must(write_text((root_ / "ground_truth/0003/note.txt").string(), "mine"));
  SequenceInfo info{.number = 3, .render = {6, 4}, .output = {18, 12}};
  DatasetWriter writer = must(DatasetWriter::create(root_.string(), info));
  EXPECT_FALSE(fs::exists(json)) << "of what is half written there is no sequence";
  EXPECT_TRUE(fs::exists(root_ / "ground_truth/0003/note.txt"));
  SourceFrame frame;
  frame.camera.fov_x = frame.camera.fov_y = 1;
  frame.color = random_image({6, 4}, 3, 0, 1, 1);
  frame.depth = random_image({6, 4}, 1, 0, 1, 1);
  frame.motion = random_image({6, 4}, 2, 0, 1, 1);
  must(writer.add(frame));
  must(writer.finish());
  // The older one had x1_5.
  const auto source = must(DatasetSource::open(json));
  EXPECT_EQ(source->render_size(), (Extent{6, 4}));
  EXPECT_TRUE(must(source->frame(0, true)).truth.empty());
  fs::remove_all(root_ / "x3");
  EXPECT_EQ(error_text(DatasetSource::open(json)),
            json + ": has no pictures of a ratio that \"UpscalingRatiosIndices\" names, but x1_5");
}

TEST_F(DatasetTest, ReadsWhatOtherToolsCapture) {
  const std::string before = write_sequence();
  const std::string json = (root_ / "00012_camcut.json").string();
  fs::rename(before, json);
  for (const char* folder : {"x1_5/color", "x1_5/depth", "x1_5/motion", "ground_truth"})
    fs::rename(root_ / folder / "0003", root_ / folder / "00012_camcut");
  EXPECT_EQ(must(dataset_sequences(root_.string())), std::vector<std::string>{json});
  // Planes once for the sequence, jitter under its older name.
  std::string text = must(read_text(json));
  for (const auto& [from, to] : {std::pair{"\"CameraNearPlane\"", "\"Unused1\""},
                                 {"\"CameraFarPlane\"", "\"Unused2\""},
                                 {"\"NormalizedPerRatioJitter\"", "\"QuantisedPerRatioJitter\""}})
    for (size_t at; (at = text.find(from)) != std::string::npos;)
      text.replace(at, std::string(from).size(), to);
  must(write_text(json, "{\"NearPlane\": 0.25, \"FarPlane\": -1," + text.substr(1)));
  const auto source = must(DatasetSource::open(json));
  const SourceFrame frame = must(source->frame(1, true));
  EXPECT_EQ(frame.camera.near_plane, 0.25f);
  EXPECT_EQ(frame.camera.far_plane, 0);
  EXPECT_NEAR(frame.camera.jitter[0], 0.0625f, 1e-6);
  EXPECT_FALSE(frame.truth.empty());
  // More rows than pictures of one kind.
  fs::remove(root_ / "x1_5/motion/00012_camcut/0001.exr");
  EXPECT_EQ(must(DatasetSource::open(json))->frame_count(), 1u);
  fs::remove(root_ / "x1_5/motion/00012_camcut/0000.exr");
  EXPECT_NE(error_text(DatasetSource::open(json)).find("holds no picture"), std::string::npos);
}

TEST_F(DatasetTest, NamesOfRatiosGiveReadersTheRenderSize) {
  const struct {
    Extent render, output;
    const char* folder;
  } kCases[]{{{960, 540}, {1920, 1080}, "x2"},    {{640, 360}, {1920, 1080}, "x3"},
             {{1280, 720}, {1920, 1080}, "x1_5"}, {{1476, 830}, {1920, 1080}, "x1_3"},
             {{8, 8}, {15, 15}, "x1_875"},        {{1129, 635}, {1920, 1080}, "x1_7"}};
  for (const auto& test : kCases)
    EXPECT_EQ(ratio_folder(ratio_of_sizes(test.render, test.output)), test.folder)
        << test.render.width;
}

// --- The program ---

TEST_F(SceneTest, TheProgramWritesADataset) {
  const fs::path root = fs::path(testing::TempDir()) / "shale_scene_program";
  fs::remove_all(root);
  const std::string command = SHALE_PROGRAM " scene " SHALE_SOURCE_DIR
                                            "/models/scenes/test/motion.json -o " +
                              root.string() +
                              " --render 96x54 --random-crops 2 --crop-size 33 --clip-length 2"
                              " --seed 3 --png --json > " +
                              (root.string() + ".txt") + " 2>&1";
  const int status = std::system(command.c_str());
  ASSERT_EQ(WEXITSTATUS(status), 0) << must(read_text(root.string() + ".txt"));
  const std::vector<std::string> sequences = must(dataset_sequences(root.string()));
  ASSERT_EQ(sequences.size(), 2u);
  const auto source = must(DatasetSource::open(sequences[1]));
  EXPECT_EQ(source->render_size(), (Extent{16, 16}));
  const SourceFrame frame = must(source->frame(1, true));
  EXPECT_FALSE(frame.truth.empty());
  EXPECT_TRUE(fs::exists(root / "preview/0001/0001_truth.png"));
  const int wrong = std::system((SHALE_PROGRAM " scene " SHALE_SOURCE_DIR "/CMakeLists.txt -o " +
                                 root.string() + " 2> " + root.string() + ".txt")
                                    .c_str());
  EXPECT_EQ(WEXITSTATUS(wrong), 1);
  EXPECT_NE(
      must(read_text(root.string() + ".txt")).find("CMakeLists.txt: error: is not valid JSON"),
      std::string::npos);
  fs::remove_all(root);
  fs::remove(root.string() + ".txt");
}

}  // namespace
}  // namespace shale
