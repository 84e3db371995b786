// What the player makes of results with fewer channels than a picture has.
#include "tools/shale/player.h"

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <filesystem>
#include <fstream>

#include "ir/base/file.h"
#include "tests/support/folder_test.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

/// A sandwich of one pass that writes (0.25, 0.5, 0.75, 1) into an output of this format.
std::string frame_json(const std::string& color, const std::string& output) {
  return R"({"schema": "shale-frame/2", "render": [16, 8], "output": [16, 8], "images": [
  {"name": "color", "role": "input", "format": ")" +
         color + R"(", "size": "render"},
  {"name": "output", "role": "output", "format": ")" +
         output + R"(", "size": "output"}],
 "passes": [{"name": "fill", "shader": "fill.comp", "over": "output", "reads": ["color"], "writes": ["output"]}]})";
}

/// `texel`: that value as the output's accessor takes it, with the colour that was read as `zero`.
std::string shader(const std::string& color, const std::string& texel) {
  return R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const float zero = 0.0 * )" +
         std::string(color == "rgba16_float" ? "rgb_of(fetch_color(at)).x" : "fetch_color(at).x") +
         ";\n  store_output(at, " + texel + ");\n}\n";
}

class PlayerTest : public FolderTest {
 protected:
  void SetUp() override {
    FolderTest::SetUp();
    write("in.ppm", "P6 16 8 255\n" + std::string(16 * 8 * 3, 'x'));
  }
  void write_sandwich(const std::string& color, const std::string& output,
                      const std::string& texel) const {
    write("frame.json", frame_json(color, output));
    write("fill.comp", shader(color, texel));
  }
  std::string said() const { return *read_text(path("said")); }
};

TEST_F(PlayerTest, ResultsOfOneAndTwoChannelsAreShown) {
  const struct {
    const char *color, *output, *texel;
    int red, green, blue;
  } kCases[]{{"rgba8_unorm", "r8_unorm", "zero + 0.25", 64, 64, 64},
             {"rgba8_unorm", "rg8_unorm", "zero + vec2(0.25, 0.5)", 64, 128, 0},
             {"rgba8_unorm", "rgba8_unorm", "zero + vec4(0.25, 0.5, 0.75, 1.0)", 64, 128, 191}};
  for (const auto& test : kCases) {
    write_sandwich(test.color, test.output, test.texel);
    ASSERT_EQ(shale("play . -i in.ppm -o out.png --validation"), 0) << test.output << said();
    const Result<Picture> picture = load_picture((folder_ / "out.png").string());
    ASSERT_TRUE(picture) << picture.error().text();
    ASSERT_EQ(picture->width, 16u);
    const uint8_t* last = picture->at(15, 7);
    EXPECT_EQ(last[0], test.red) << test.output;
    EXPECT_EQ(last[1], test.green) << test.output;
    EXPECT_EQ(last[2], test.blue) << test.output;
  }
}

TEST_F(PlayerTest, LinearResultsOfOneAndTwoChannelsAreMeasured) {
  const std::string scene = SHALE_SOURCE_DIR "/models/scenes/test/motion.json";
  for (const auto& [output, texel] : {std::pair{"r16_float", "zero + 0.25"},
                                      {"rg16_float", "half2(zero + vec2(0.25, 0.5))"},
                                      std::pair{"r32_float", "zero + 0.25"}}) {
    write_sandwich("rgba16_float", output, texel);
    EXPECT_EQ(shale(fmt::format("eval {} -m . --frames 1 --no-time --validation", scene)), 0)
        << output << said();
    EXPECT_EQ(shale(fmt::format("play . -i {} -o frames --frames 1 --validation", scene)), 0)
        << output << said();
  }
}

/// A frame shows the number of frames so far, in 1/255; a picture the time, 255 at 2.
constexpr const char* kGeneratingFrame =
    R"({"schema": "shale-frame/2", "render": [16, 8], "output": [16, 8],
 "params": [{"name": "time", "type": "float", "time": true}, {"name": "frames", "type": "int", "frames": true}],
 "images": [{"name": "color", "role": "input", "format": "rgba8_unorm", "size": "render"},
  {"name": "motion", "role": "input", "format": "rg16_float", "size": "render"},
  {"name": "output", "role": "output", "format": "r8_unorm", "size": "output"}],
 "programs": [{"name": "frame", "passes": [{"name": "count", "shader": "count.comp", "over": "output", "reads": ["color", "motion"], "writes": ["output"]}]},
  {"name": "between", "generates": [TIMES], "passes": [{"name": "tell", "shader": "tell.comp", "over": "output", "writes": ["output"]}]}]})";

std::string showing(const std::string& value) {
  return R"(#version 450
#include "access.glsl"
layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
SHALE_PARAMS;
void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x < OUTPUT_WIDTH && at.y < OUTPUT_HEIGHT) store_output(at, )" +
         value + ");\n}\n";
}

TEST_F(PlayerTest, GeneratedPicturesAreShownInTheirPlace) {
  const std::string scene = SHALE_SOURCE_DIR "/models/scenes/test/motion.json";
  write("count.comp", showing("float(params.frames) / 255.0 + 0.0 * (fetch_color(at).x + "
                              "xy_of(fetch_motion(at)).x)"));
  write("tell.comp", showing("params.time / 2.0"));
  const auto play = [&](const std::string& times) {
    std::string text = kGeneratingFrame;
    write("frame.json", text.replace(text.find("TIMES"), 5, times));
    fs::remove_all(folder_ / "out");
    EXPECT_EQ(shale(fmt::format("play . -i {} -o out --frames 3 --generate 1 --animation all.png "
                                "--validation",
                                scene)),
              0)
        << said();
    std::vector<int> shown;
    for (int i = 0; fs::exists(folder_ / "out" / fmt::format("{:04}.png", i)); ++i)
      shown.push_back(
          load_picture((folder_ / "out" / fmt::format("{:04}.png", i)).string())->at(3, 3)[0]);
    return shown;
  };
  // Between: the newest frame waits, and there is nothing before the first. Ahead: behind each frame.
  EXPECT_EQ(play("0, 1"), (std::vector{1, 64, 2, 64, 3}));
  EXPECT_EQ(play("1, 2"), (std::vector{1, 191, 2, 191, 3, 191}));
  EXPECT_EQ(shale("play . -i in.ppm -o out.png --generate 1"), 1);
  EXPECT_NE(said().find("single pictures have no motion"), std::string::npos) << said();
  EXPECT_EQ(shale(fmt::format("play . -i {} -o out --frames 2 --generate 3 --json", scene)), 0);
  EXPECT_NE(said().find("\"generated_at\": 1.75"), std::string::npos) << said();
  write_sandwich("rgba8_unorm", "r8_unorm", "zero + 0.25");
  EXPECT_EQ(shale(fmt::format("play . -i {} -o out --frames 2 --generate 1", scene)), 1);
  EXPECT_NE(said().find("has no program that generates pictures"), std::string::npos) << said();
}

TEST_F(PlayerTest, OneOfTwoDisplaysIsRefused) {
  write_sandwich("rgba16_float", "r8_unorm", "zero + 0.25");
  EXPECT_EQ(shale("play . -i in.ppm -o out.png"), 1);
  EXPECT_NE(said().find("one of color and output is of unorm format"), std::string::npos) << said();
  EXPECT_FALSE(fs::exists(folder_ / "out.png"));
}

}  // namespace
}  // namespace shale
