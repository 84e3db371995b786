#include "compiler/plan/needs.h"

#include <gtest/gtest.h>

#include "compiler/plan/frame.h"
#include "tests/compiler/frame_support.h"

namespace shale {
namespace {

SceneNeeds all_known() {
  return {.camera_moves = true,
          .objects_move = false,
          .cuts = false,
          .light_changes = true,
          .thin_features = false,
          .finite = true,
          .motion_pixels = 12.5,
          .render = std::array{960.0, 540.0},
          .exposed = std::array{0.0, 40.25},
          .depth = std::array{0.5, 250.0}};
}

std::string error_of(const std::string& fields) {
  return error_text(parse_needs("{\"schema\": \"shale-needs/1\"" + fields + "}"));
}

TEST(Needs, SurviveAFile) {
  EXPECT_EQ(must(parse_needs(needs_text(all_known()))), all_known());
  EXPECT_EQ(must(parse_needs(needs_text({}))), SceneNeeds{});
  EXPECT_EQ(
      needs_text({.cuts = false, .exposed = std::array{0.0, 7.0}}),
      "{\n  \"schema\": \"shale-needs/1\",\n  \"cuts\": false,\n  \"exposed\": [0.0,7.0]\n}\n");
}

TEST(Needs, NothingMovesWhereNeitherCameraNorObjectsDo) {
  const std::string still = ", \"camera_moves\": false, \"objects_move\": false";
  EXPECT_EQ(must(parse_needs("{\"schema\": \"shale-needs/1\"" + still + "}")).motion_pixels, 0.0);
  EXPECT_EQ(error_of(still + ", \"motion_pixels\": 3"),
            "needs: \"motion_pixels\" is 3, but neither the camera nor objects move");
}

TEST(Needs, BadFilesAreRefusedByField) {
  EXPECT_EQ(error_text(parse_needs("[")), "is not valid JSON at byte 2");
  EXPECT_EQ(error_text(parse_needs("{\"a\": 1e999}")),
            "is not valid JSON, a number is out of range");
  // A value so deep would end the stack where it is copied.
  EXPECT_EQ(error_text(parse_needs("{\"schema\":" + std::string(200000, '[') +
                                   std::string(200000, ']') + "}")),
            "is nested deeper than 64 levels");
  EXPECT_EQ(error_text(parse_needs("{\"schema\": \"shale-needs/9\"}")),
            "needs: schema \"shale-needs/9\" is unknown, expected \"shale-needs/1\"");
  EXPECT_EQ(error_text(parse_needs("{}")),
            "needs: schema null is unknown, expected \"shale-needs/1\"");
  EXPECT_EQ(error_of(", \"cuts\": 1"), "needs: \"cuts\" is 1, expected true or false");
  EXPECT_EQ(error_of(", \"motion_pixels\": -1"),
            "needs: \"motion_pixels\" is -1, expected a number of at least 0");
  EXPECT_EQ(error_of(", \"motion_pixels\": 5"),
            "needs: \"motion_pixels\" is 5, and \"render\" does not say of what size");
  EXPECT_EQ(error_of(", \"depth\": [3, 2]"),
            "needs: \"depth\" runs from 3 to 2, expected the lesser one first");
  EXPECT_EQ(error_of(", \"exposed\": [0]"),
            "needs: \"exposed\" is [0], expected two numbers of at least 0");
  EXPECT_EQ(error_of(", \"render\": [0, 540]"),
            "needs: \"render\" is 0x540, expected a width and a height");
  EXPECT_EQ(
      error_of(", \"wind\": true"),
      "needs: field \"wind\" is unknown, expected one of schema, render, camera_moves, "
      "objects_move, motion_pixels, cuts, light_changes, thin_features, finite, exposed, depth");
}

TEST(Needs, OfTwoScenesAreWhatEitherNeeds) {
  SceneNeeds other = all_known();
  other.camera_moves = false;
  other.light_changes = std::nullopt;
  other.thin_features = std::nullopt;
  other.finite = false;
  other.motion_pixels = 10;
  other.render = std::array{480.0, 270.0};
  other.exposed = std::array{0.5, 80.0};
  const SceneNeeds both = united(all_known(), other);
  EXPECT_EQ(both.camera_moves, true);
  EXPECT_EQ(both.light_changes, true);          // one decides it
  EXPECT_EQ(both.thin_features, std::nullopt);  // false and unknown
  EXPECT_EQ(both.finite, false);
  EXPECT_EQ(both.motion_pixels, 20.0);
  EXPECT_EQ(both.exposed, (std::array{0.0, 80.0}));
}

constexpr const char* kPromises =
    R"("promises": [{"name": "still", "needs": {"motion_pixels": 0.5, "finite": true},
    "check": {"name": "check", "shader": "check.comp", "over": "color", "reads": ["color"]}}],
  "passes")";

std::string with_promises(const std::string& form = "{\"defines\": {\"SIDE\": 3}}") {
  return replaced(replaced(kFrame, "\"passes\"", kPromises), "\"updates\": [\"marks\"]}",
                  "\"updates\": [\"marks\"], \"when\": {\"still\": " + form + "}}");
}

TEST(Promises, AreKeptByNeeds) {
  const Frame frame = must(parse_frame(with_promises()));
  const auto kept = [&](const SceneNeeds& needs, FrameExtent render = {10, 6}) {
    return kept_promises(frame, needs, render).size();
  };
  EXPECT_EQ(kept({}), 0u);
  EXPECT_EQ(kept({.motion_pixels = 0.5}), 0u);
  EXPECT_EQ(kept({.finite = true, .motion_pixels = 0.5}), 1u);
  EXPECT_EQ(kept({.finite = true, .motion_pixels = 0.6}), 0u);
  // Of twice the size: half as far.
  EXPECT_EQ(kept({.finite = true, .motion_pixels = 1.0, .render = std::array{20.0, 12.0}}), 1u);
  EXPECT_EQ(kept({.finite = true, .motion_pixels = 0.5, .render = std::array{5.0, 6.0}}), 0u);
  EXPECT_EQ(promise_text(frame.promises[0]), "motion_pixels at most 0.5, finite");
}

TEST(Promises, GiveFormsToPasses) {
  const Frame frame =
      must(parse_frame(with_promises(R"({"defines": {"SIDE": 3}, "reads": ["color"]})")));
  const FramePass& pass = frame.programs[0].passes[0];
  ASSERT_EQ(pass.forms.size(), 1u);
  EXPECT_EQ(pass.forms[0].promise, "still");
  EXPECT_FALSE(pass.forms[0].is_left_out);
  // Other reads, what is written and updated as before.
  ASSERT_EQ(pass.forms[0].bindings.size(), 3u);
  EXPECT_EQ(pass.forms[0].bindings[0].name, "color");
  EXPECT_EQ(pass.forms[0].bindings[1].name, "x");
  EXPECT_EQ(pass.forms[0].bindings[2].name, "marks");
  EXPECT_EQ(pass.bindings.size(), 4u);
  EXPECT_TRUE(must(parse_frame(with_promises("false"))).programs[0].passes[0].forms[0].is_left_out);
}

TEST(Promises, BadOnesAreRefused) {
  const auto error = [](const std::string& from, const std::string& to) {
    return error_text(parse_frame(replaced(with_promises(), from, to)));
  };
  EXPECT_EQ(error("\"when\": {\"still\"", "\"when\": {\"calm\""),
            "pass \"pre\": \"when\" names \"calm\", which is no promise");
  EXPECT_EQ(error("\"finite\": true", "\"wind\": 1"),
            "frame.promises[0].needs: \"wind\" is none of motion_pixels, finite");
  EXPECT_EQ(error("\"finite\": true", "\"finite\": false"),
            "frame.promises[0].needs: \"finite\" must be true");
  EXPECT_EQ(error("{\"motion_pixels\": 0.5, \"finite\": true}", "{}"),
            "frame.promises[0].needs: there is no condition");
  EXPECT_EQ(error("\"check\": {", "\"checks\": {"), "frame.promises[0]: \"check\" must be a pass");
  EXPECT_EQ(error("{\"defines\": {\"SIDE\": 3}}", "{\"clears\": []}"),
            "frame.passes[0].when.still: \"clears\" is none of defines, reads, writes");
  EXPECT_EQ(error("{\"defines\": {\"SIDE\": 3}}", "true"),
            "frame.passes[0].when.still: must be an object, or false");
  EXPECT_EQ(error("\"marks\", \"role\"", "\"broken\", \"role\""),
            "frame.images: the name \"broken\" is taken by what checks promises");
}

std::map<std::string, std::string> shaders_with_check() {
  auto shaders = frame_shaders();
  shaders["check.comp"] = R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
void main() {
  if (fetch_color(ivec2(gl_GlobalInvocationID.xy)).r > MOTION_PIXELS) max_broken(ivec2(0), 1u);
})";
  return shaders;
}

std::vector<std::string> dispatches_of(const Variant& variant) {
  std::vector<std::string> names;
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches)
      names.push_back(dispatch.indirect
                          ? fmt::format("{} by {}", dispatch.name, dispatch.indirect->first)
                          : dispatch.name);
  return names;
}

TEST(Promises, PutBothFormsIntoThePackage) {
  CompileOptions options = frame_options(with_promises(), shaders_with_check());
  options.needs = SceneNeeds{.finite = true, .motion_pixels = 0.0};
  for (const char* target : {"lavapipe", "dot8-gpu"}) {
    options.targets = {target};
    const Compiled compiled = must(compile_frame(options));
    const Variant& variant = compiled.package.variants[0];
    EXPECT_EQ(
        dispatches_of(variant),
        target == std::string("lavapipe")
            ? (std::vector<std::string>{"take_color", "clear_broken", "check", "choose_passes",
                                        "clear_marks", "pre by 0", "pre_still by 3", "y", "post",
                                        "show_shown"})
            : (std::vector<std::string>{"clear_broken", "check", "choose_passes", "clear_marks",
                                        "pre by 0", "pre_still by 3", "y", "post"}));
    ASSERT_TRUE(variant.promise);
    EXPECT_EQ(variant.promise->text, "still (motion_pixels at most 0.5, finite)");
    EXPECT_EQ(variant.resources[variant.promise->broken].name, "broken");
    EXPECT_TRUE(must(read_package(write_package(compiled.package))) == compiled.package);
    EXPECT_EQ(compiled.warnings, std::vector<std::string>{});
  }
}

TEST(Promises, OnePassLeftOutIsOneFormLess) {
  CompileOptions options = frame_options(with_promises("false"), shaders_with_check());
  options.needs = SceneNeeds{.finite = true, .motion_pixels = 0.0};
  EXPECT_EQ(dispatches_of(must(compile_frame(options)).package.variants[0]),
            (std::vector<std::string>{"take_color", "clear_broken", "check", "choose_passes",
                                      "clear_marks", "pre by 0", "y", "post", "show_shown"}));
}

TEST(Promises, ThatNeedsDoNotKeepLeaveThePackageAsItIs) {
  CompileOptions options = frame_options(with_promises(), shaders_with_check());
  const Package without = must(compile_frame(options)).package;
  options.needs = SceneNeeds{.motion_pixels = 3.0};
  const Compiled compiled = must(compile_frame(options));
  EXPECT_TRUE(compiled.package == without);
  EXPECT_EQ(compiled.warnings,
            std::vector<std::string>{
                "nothing can be left out: the sandwich has no promise that the needs keep"});
}

}  // namespace
}  // namespace shale
