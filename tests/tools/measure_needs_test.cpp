// What frames need, from scenes and from captures; and what the program makes of it, on a device.
#include "tools/shale/measure_needs.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "ir/base/file.h"
#include "tests/support/folder_test.h"

namespace shale {
namespace {

constexpr uint32_t kWidth = 64, kHeight = 40;

/// A still frame of grey, at 4 metres.
SourceFrame grey_frame(float value = 0.5f) {
  SourceFrame frame;
  frame.camera.near_plane = 0.1f;
  frame.camera.view_projection = {1, 0, 0, 0, 0, 1, 0,     0,
                                  0, 0, 1, 1, 0, 0, -0.1f, 0};  // z to (z - 0.1) / z
  frame.camera.exposure = 2;
  const size_t texels = size_t{kWidth} * kHeight;
  frame.color = {kWidth, kHeight, 3, std::vector<float>(3 * texels, value)};
  frame.depth = {kWidth, kHeight, 1, std::vector<float>(texels, 1 - 0.1f / 4)};
  frame.motion = {kWidth, kHeight, 2, std::vector<float>(2 * texels, 0.0f)};
  return frame;
}

SceneNeeds needs_of(const std::vector<SourceFrame>& frames) {
  NeedsMeter meter;
  for (const SourceFrame& frame : frames) EXPECT_TRUE(meter.add(frame));
  return meter.needs();
}

TEST(NeedsMeter, SeesThatNothingHappens) {
  const SceneNeeds needs = needs_of({grey_frame(), grey_frame(), grey_frame()});
  EXPECT_EQ(needs.camera_moves, false);
  EXPECT_EQ(needs.objects_move, false);
  EXPECT_EQ(needs.motion_pixels, 0.0);
  EXPECT_EQ(needs.cuts, false);
  EXPECT_EQ(needs.light_changes, false);
  EXPECT_EQ(needs.thin_features, false);
  EXPECT_EQ(needs.finite, true);
  EXPECT_EQ(needs.render, (std::array{64.0, 40.0}));
  EXPECT_EQ(needs.exposed, (std::array{1.0, 1.0}));
  ASSERT_TRUE(needs.depth);
  EXPECT_NEAR((*needs.depth)[0], 4, 0.02);
  EXPECT_NEAR((*needs.depth)[1], 4, 0.02);
}

TEST(NeedsMeter, TellsTheCamerasMotionFromThatOfObjects) {
  SourceFrame moved = grey_frame();
  // A step of the camera of 0.4 metres to the right: 0.1 of half a picture at 4 metres, to the left.
  moved.camera.view_projection[12] = -0.4f;
  for (size_t i = 0; i < moved.motion.values.size(); i += 2) moved.motion.values[i] = -0.05f;
  SceneNeeds needs = needs_of({grey_frame(), moved});
  EXPECT_EQ(needs.camera_moves, true);
  EXPECT_EQ(needs.objects_move, false);
  EXPECT_NEAR(*needs.motion_pixels, 0.05 * kWidth, 0.01);
  // One texel that moves otherwise.
  moved.motion.values[400] = 0.02f;
  needs = needs_of({grey_frame(), moved});
  EXPECT_EQ(needs.objects_move, true);
  // Behind a cut nothing is known of motion.
  moved.camera.cut = true;
  needs = needs_of({grey_frame(), moved});
  EXPECT_EQ(needs.camera_moves, false);
  EXPECT_EQ(needs.objects_move, false);
  EXPECT_EQ(needs.cuts, true);
}

TEST(NeedsMeter, SeesLightThatChanges) {
  EXPECT_EQ(needs_of({grey_frame(), grey_frame(0.51f)}).light_changes, false);
  EXPECT_EQ(needs_of({grey_frame(), grey_frame(0.8f)}).light_changes, true);
  // Nothing stands still: not known.
  SourceFrame moving = grey_frame(0.8f);
  for (float& m : moving.motion.values) m = 0.1f;
  EXPECT_EQ(needs_of({grey_frame(), moving}).light_changes, std::nullopt);
}

TEST(NeedsMeter, SeesLinesAndWhatIsNotFinite) {
  SourceFrame frame = grey_frame();
  for (uint32_t y = 0; y < kHeight; ++y)
    for (uint32_t x = 0; x < kWidth; x += 8)
      for (int c = 0; c < 3; ++c) frame.color.at(x, y)[c] = 4;
  EXPECT_EQ(needs_of({frame}).thin_features, true);
  EXPECT_EQ(needs_of({frame}).exposed, (std::array{1.0, 8.0}));
  frame.motion.values[5] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(needs_of({frame}).finite, false);
}

TEST(NeedsMeter, RefusesOtherFrames) {
  NeedsMeter meter;
  SourceFrame bare = grey_frame();
  bare.depth = {};
  EXPECT_EQ(meter.add(bare).error().text(), "has no depth, which its needs follow from");
  ASSERT_TRUE(meter.add(grey_frame()));
  SourceFrame small = grey_frame();
  small.color = {1, 1, 3, {0, 0, 0}};
  EXPECT_EQ(meter.add(small).error().text(), "has 1x1 pixels, the frames before 64x40");
}

class NeedsTest : public FolderTest {
 protected:
  std::string said() const { return *read_text(path("said")); }
  nlohmann::json needs(const std::string& file) const {
    return nlohmann::json::parse(*read_text(path(file)), nullptr, false);
  }
  /// A box on a plane; `box` moves it, `more` are further fields of the scene.
  void write_scene(const std::string& name, const std::string& box,
                   const std::string& more = "") const {
    write(
        name,
        R"({"schema": "shale-scene/1", "frames": 6, "camera": {"path": [{"frame": 0, "eye": [0, 2, 5], "target": [0, 0.5, 0]}]},
  "sun": {"direction": [0.4, 0.8, 0.3]}, "materials": {"m": {"pattern": "checker"}}, )" +
            more + R"("objects": [
    {"shape": "plane", "size": [8, 8], "material": "m"}, {"shape": "box", "at": [0, 0.5, 0], "size": [1, 1, 1], "material": "m")" +
            box + "}]}");
  }
};

constexpr const char* kSpin =
    R"(, "animate": {"path": [{"frame": 0, "at": [0, 0, 0]}, {"frame": 3, "at": [0, 0, 0]}, {"frame": 5, "at": [0.5, 0, 0]}]})";

TEST_F(NeedsTest, OfScenesAndOfTheirCapturesAreTheSame) {
  write_scene("still.json", "");
  write_scene("moving.json", kSpin);
  write_scene(
      "lamps.json", "",
      R"("signals": {"s": {"blink": {"period": 2}}}, "lights": [{"at": [0, 3, 1], "signal": "s"}], )");
  ASSERT_EQ(shale("scene still.json --needs still.needs --render 64x40"), 0) << said();
  EXPECT_EQ(needs("still.needs")["motion_pixels"], 0.0);
  EXPECT_EQ(needs("still.needs")["motion_pixels"].dump(), "0.0");
  EXPECT_EQ(needs("still.needs")["objects_move"], false);
  EXPECT_EQ(needs("still.needs")["light_changes"], false);
  ASSERT_EQ(shale("scene moving.json --needs moving.needs --render 64x40"), 0) << said();
  EXPECT_GT(needs("moving.needs")["motion_pixels"], 1.0);
  EXPECT_EQ(needs("moving.needs")["objects_move"], true);
  EXPECT_EQ(needs("moving.needs")["camera_moves"], false);
  ASSERT_EQ(shale("scene lamps.json --needs lamps.needs --render 64x40"), 0) << said();
  EXPECT_EQ(needs("lamps.needs")["light_changes"], true);
  EXPECT_EQ(needs("lamps.needs")["objects_move"], false);
  // The moving one as a capture, of which nothing is known but the frames.
  ASSERT_EQ(shale("scene moving.json -o capture --render 64x40 --no-truth"), 0) << said();
  ASSERT_EQ(shale("scene capture --needs capture.needs"), 0) << said();
  for (const char* same : {"camera_moves", "objects_move", "cuts", "finite", "render"})
    EXPECT_EQ(needs("capture.needs")[same], needs("moving.needs")[same]) << same;
  EXPECT_NEAR(needs("capture.needs")["motion_pixels"].get<double>(),
              needs("moving.needs")["motion_pixels"].get<double>(), 0.05);
  ASSERT_EQ(shale("scene still.json capture --needs both.needs --render 64x40"), 0) << said();
  EXPECT_EQ(needs("both.needs")["objects_move"], true);
}

TEST_F(NeedsTest, OnePackageServesScenesThatKeepThemAndOthers) {
  const std::string tss = SHALE_SOURCE_DIR "/models/baselines/tss";
  write_scene("still.json", "");
  write_scene("moving.json", kSpin);
  ASSERT_EQ(shale("scene still.json --needs still.needs --render 64x40"), 0) << said();
  ASSERT_EQ(shale("compile " + tss +
                  " --needs still.needs --render 64x40 --target lavapipe -o needed.shale"),
            0)
      << said();
  ASSERT_EQ(shale("dump needed.shale"), 0);
  EXPECT_NE(said().find("promised: still (motion_pixels at most 0)"), std::string::npos);
  for (const char* scene : {"still", "moving"}) {
    ASSERT_EQ(
        shale(fmt::format("play needed.shale -i {}.json -o needed_{} --validation", scene, scene)),
        0)
        << said();
    const std::string text = said();
    // Two of the moving one's frames move.
    EXPECT_NE(text.find("kept its promise"), std::string::npos) << text;
    EXPECT_EQ(text.find("full passes") != std::string::npos, scene == std::string("moving"))
        << text;
    ASSERT_EQ(shale(fmt::format("play {} -i {}.json -o full_{} --render 64x40", tss, scene, scene)),
              0)
        << said();
    for (int i = 0; i < 6; ++i)
      EXPECT_EQ(*read_file(path(fmt::format("needed_{}/{:04}.png", scene, i))),
                *read_file(path(fmt::format("full_{}/{:04}.png", scene, i))))
          << scene << i;
  }
  ASSERT_EQ(shale("eval moving.json -m needed.shale --no-time --json-file eval.json"), 0) << said();
  EXPECT_NE(said().find("of 6 frames kept the promise still (motion_pixels at most 0), the others "
                        "took the full passes"),
            std::string::npos)
      << said();
  const auto frames = needs("eval.json")["scenes"][0]["methods"][0]["frames"];
  EXPECT_EQ(frames[0]["kept_promise"], true);
  EXPECT_EQ(frames[5]["kept_promise"], false);
}

TEST_F(NeedsTest, BadOnesAreRefusedInOneLine) {
  write_scene("still.json", "");
  const auto refused = [&](const std::string& arguments) {
    EXPECT_EQ(shale(arguments), 1) << arguments;
    return said();
  };
  const std::string tss = SHALE_SOURCE_DIR "/models/baselines/tss";
  write("bad.json", "{\"schema\": \"shale-needs/1\", \"motion_pixels\": \"none\"}");
  EXPECT_EQ(
      refused("compile " + tss + " --needs bad.json -o x.shale"),
      "bad.json: error: needs: \"motion_pixels\" is \"none\", expected a number of at least 0\n");
  EXPECT_FALSE(std::filesystem::exists(path("x.shale")));
  EXPECT_NE(refused("compile " + tss + " --needs none.json -o x.shale").find("none.json: error: "),
            std::string::npos);
  write("network.tir",
        "graph main {\n input %x : i8[4]\n %y = bitwise_not %x : i8[4]\n return %y\n}");
  write("ok.json", "{\"schema\": \"shale-needs/1\"}");
  EXPECT_EQ(refused("compile network.tir --needs ok.json -o x.shale"),
            "network.tir: error: has no sandwich from which needs could leave anything out\n");
  EXPECT_EQ(refused("scene still.json"),
            "shale: error: expected either -o, a dataset to write, or --needs\n");
  EXPECT_EQ(refused("scene still.json -o a --needs b"),
            "shale: error: expected either -o, a dataset to write, or --needs\n");
  EXPECT_EQ(
      refused("scene network.tir --needs b"),
      "network.tir: error: is neither a scene (.json) nor a dataset (a folder with 0000.json)\n");
  EXPECT_FALSE(std::filesystem::exists(path("b")));
  // Needs that keep nothing say so, and leave the package as it is.
  ASSERT_EQ(shale("compile " + tss + " --needs ok.json --target lavapipe -o x.shale"), 0);
  EXPECT_NE(
      said().find(
          "warning: nothing can be left out: the sandwich has no promise that the needs keep"),
      std::string::npos)
      << said();
}

}  // namespace
}  // namespace shale
