// shale diff as its users meet it.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "tools/scene/dataset.h"
#include "tools/scene/exr.h"
#include "tools/shale/picture.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Outcome {
  int exit = -1;
  std::string text;  ///< standard output and error
};

Outcome shale_program(const std::string& arguments) {
  Outcome outcome;
  std::FILE* pipe = popen((SHALE_PROGRAM " " + arguments + " 2>&1").c_str(), "r");
  char buffer[4096];
  for (size_t count; (count = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;)
    outcome.text.append(buffer, count);
  const int status = pclose(pipe);
  outcome.exit = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

Outcome diff(const std::string& arguments) { return shale_program("diff " + arguments); }

class Diff : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() /
              ("shale_diff_" +
               std::string(testing::UnitTest::GetInstance()->current_test_info()->name()));
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string file(const std::string& name) const { return (folder_ / name).string(); }

  /// A flat picture; returns its path.
  std::string grey(const std::string& name, uint8_t code, uint32_t width = 24) {
    fs::create_directories(fs::path(file(name)).parent_path());
    EXPECT_TRUE(save_png(file(name), Picture::filled(width, 20, code)));
    return file(name);
  }

  fs::path folder_;
};

TEST_F(Diff, TwoPictures) {
  const std::string a = grey("a.png", 100), b = grey("b.png", 110);
  const Outcome table = diff(a + " " + b);
  ASSERT_EQ(table.exit, 0) << table.text;
  EXPECT_NE(table.text.find("28.13"), std::string::npos) << table.text;
  EXPECT_NE(table.text.find("b.png"), std::string::npos) << table.text;
  EXPECT_NE(table.text.find("pads with 5 zeros"), std::string::npos) << table.text;

  const Outcome outcome = diff(a + " " + b + " --json --map " + file("map.png"));
  ASSERT_EQ(outcome.exit, 0) << outcome.text;
  const nlohmann::json json = nlohmann::json::parse(outcome.text);
  ASSERT_EQ(json["pairs"].size(), 1u);
  EXPECT_NEAR(json["pairs"][0]["psnr_db"].get<double>(), 28.1308, 1e-3);
  EXPECT_GT(json["pairs"][0]["ssim_valid"].get<double>(), 0.9);
  EXPECT_GT(json["pairs"][0]["flip"].get<double>(), 0);
  EXPECT_EQ(json["mean"]["flip"], json["pairs"][0]["flip"]);
  const Result<Picture> map = load_picture(file("map.png"));
  ASSERT_TRUE(map);
  EXPECT_EQ(map->width, 24u);
}

TEST_F(Diff, EqualPicturesHaveAnInfinitePsnrThatMeansCap) {
  grey("a/one.png", 100), grey("b/one.png", 100);
  grey("a/two.png", 100), grey("b/two.png", 110);
  const Outcome outcome = diff(file("a") + " " + file("b") + " --json --metrics psnr");
  ASSERT_EQ(outcome.exit, 0) << outcome.text;
  const nlohmann::json json = nlohmann::json::parse(outcome.text);
  EXPECT_TRUE(json["pairs"][0]["psnr_db"].is_null());
  EXPECT_EQ(json["pairs"][0]["psnr_infinite"], true);
  EXPECT_NEAR(json["mean"]["psnr_db"].get<double>(), (100 + 28.1308) / 2, 1e-3);
  EXPECT_FALSE(json["mean"].contains("flip"));
  const Outcome table = diff(file("a") + " " + file("b"));
  EXPECT_NE(table.text.find("inf"), std::string::npos) << table.text;
  EXPECT_NE(table.text.find("mean of 2"), std::string::npos) << table.text;
}

TEST_F(Diff, FoldersAreMatchedByName) {
  grey("a/one.png", 100), grey("b/one.png", 101);
  grey("a/two.png", 50), grey("b/two.png", 53);
  const Outcome outcome = diff(file("a") + " " + file("b") + " --map " + file("maps"));
  EXPECT_EQ(outcome.exit, 0) << outcome.text;
  EXPECT_TRUE(fs::exists(file("maps/one.png")));
  EXPECT_TRUE(fs::exists(file("maps/two.png")));
  grey("b/three.png", 1);
  const Outcome extra = diff(file("a") + " " + file("b"));
  EXPECT_EQ(extra.exit, 1);
  EXPECT_NE(extra.text.find("three.png"), std::string::npos) << extra.text;
  grey("a/three.png", 1), grey("a/four.png", 1);
  EXPECT_EQ(diff(file("a") + " " + file("b")).exit, 1);
}

TEST_F(Diff, ExrPicturesAreToneMapped) {
  // Linear 1 is shown as sRGB of a half: code 188.
  const FloatImage half{24, 20, 3, std::vector<float>(24 * 20 * 3, 0.5f)};
  ASSERT_TRUE(write_exr(file("half.exr"), half, ExrPrecision::kHalf));
  const std::string shown = grey("shown.png", 188);
  const Outcome outcome = diff(file("half.exr") + " " + shown + " --exposure 2");
  EXPECT_EQ(outcome.exit, 0) << outcome.text;
  EXPECT_NE(outcome.text.find("inf"), std::string::npos) << outcome.text;
}

/// Twelve frames of a flat grey that a display shows as 188 whatever the exposure, which doubles in frame 6. A square
/// passes in front of it, as dark as it is.
void write_sequence(const std::string& root) {
  auto writer = DatasetWriter::create(root, {.number = 0, .render = {24, 20}, .output = {48, 40}});
  ASSERT_TRUE(writer);
  for (uint32_t t = 0; t < 12; ++t) {
    SourceFrame frame;
    frame.camera.fov_x = frame.camera.fov_y = 1;
    frame.camera.exposure = t < 6 ? 1.0f : 2.0f;
    const auto flat = [](uint32_t width, uint32_t height, uint32_t channels, float value) {
      return FloatImage{width, height, channels,
                        std::vector<float>(size_t{width} * height * channels, value)};
    };
    frame.color = flat(24, 20, 3, 1 / frame.camera.exposure);
    frame.depth = flat(24, 20, 1, 0.5f);
    frame.motion = flat(24, 20, 2, 0);
    frame.truth = flat(48, 40, 3, 1 / frame.camera.exposure);
    frame.truth_motion = flat(48, 40, 2, 0);
    frame.truth_depth = flat(48, 40, 1, 0.9f);
    for (uint32_t y = 0; y < 40; ++y)
      for (uint32_t x = 2 * t; x < 2 * t + 8; ++x) {
        *frame.truth_depth.at(x, y) = 0.5f;
        frame.truth_motion.at(x, y)[0] = 2.0f / 48;
      }
    ASSERT_TRUE(writer->add(frame));
  }
  ASSERT_TRUE(writer->finish());
}

TEST_F(Diff, FramesOfADatasetHaveTheirExposureMotionAndDepth) {
  write_sequence(file("set"));
  for (uint32_t t = 0; t < 12; ++t)
    ASSERT_TRUE(save_png(grey(fmt::format("mine/{:04}.png", t), 0),
                         Picture::filled(48, 40, t < 6 ? 188 : 190)));
  const std::string both = file("set/ground_truth/0000") + " " + file("mine");
  const Outcome outcome = diff(both + " --json --metrics psnr --dataset " + file("set"));
  ASSERT_EQ(outcome.exit, 0) << outcome.text;
  const nlohmann::json json = nlohmann::json::parse(outcome.text);
  EXPECT_TRUE(json["pairs"][5]["psnr_infinite"]);
  const nlohmann::json& means = json["over_time"];
  EXPECT_NEAR(means["first_frames"]["brightness_codes"].get<double>(), 0.8, 1e-3);
  EXPECT_NEAR(means["later_frames"]["brightness_codes"].get<double>(), 2, 1e-3);
  EXPECT_FALSE(means.contains("lag")) << "an exposure that the display does not show";
  // Uncovered 0 frames ago in frames 1 to 11, of which 6 on are off by two codes.
  EXPECT_NEAR(means["trail"]["codes_by_frame"][0].get<double>(), 2.0 * 6 / 11, 1e-3);
  EXPECT_FALSE(means.contains("sky_trail"));
  // The same exposures by hand.
  std::string exposures = "1";
  for (uint32_t t = 1; t < 12; ++t) exposures += t < 6 ? ",1" : ",2";
  const Outcome by_hand = diff(both + " --json --metrics psnr --over-time --exposure " + exposures);
  ASSERT_EQ(by_hand.exit, 0) << by_hand.text;
  const nlohmann::json without = nlohmann::json::parse(by_hand.text);
  EXPECT_EQ(without["mean"], json["mean"]);
  EXPECT_EQ(without["over_time"]["later_frames"], means["later_frames"]);
  EXPECT_FALSE(without["over_time"].contains("trail"));
  const Outcome table = diff(both + " --metrics psnr --dataset " + file("set"));
  EXPECT_NE(table.text.find("trail, 3+"), std::string::npos) << table.text;

  const Outcome few = diff(both + " --dataset " + file("set") + " --frames 3");
  EXPECT_EQ(few.exit, 1);
  EXPECT_NE(few.text.find("3 frames, expected one for each of 12 pairs"), std::string::npos)
      << few.text;
  EXPECT_EQ(diff(both + " --exposure 1,2").exit, 1);
}

// What another program made stands in the table of shale eval as if it had been played here.
TEST_F(Diff, PicturesAreEvaluatedAsWhatIsPlayed) {
  write_sequence(file("set"));
  const std::string bilinear = SHALE_SOURCE_DIR "/models/baselines/bilinear";
  for (const char* format : {"png", "exr"}) {
    const Outcome played = shale_program("play " + bilinear + " -i " + file("set") +
                                         " --frames 3 -o " + file(format) + " --format " + format);
    ASSERT_EQ(played.exit, 0) << played.text;
    EXPECT_TRUE(fs::exists(file(format) + "/0002." + format));
  }
  const std::string eval = "eval " + file("set") + " --frames 3 --no-time --json ";
  const Outcome outcome = shale_program(eval + "-m " + bilinear + " --pictures png=" + file("png") +
                                        " --pictures exr=" + file("exr"));
  ASSERT_EQ(outcome.exit, 0) << outcome.text;
  const nlohmann::json methods = nlohmann::json::parse(outcome.text)["scenes"][0]["methods"];
  ASSERT_EQ(methods.size(), 3u);
  for (size_t m = 1; m < 3; ++m) EXPECT_EQ(methods[m]["means"], methods[0]["means"]) << m;
  EXPECT_EQ(methods[2]["method"], "exr");

  const Outcome few =
      shale_program("eval " + file("set") + " --no-time --pictures x=" + file("png"));
  EXPECT_EQ(few.exit, 1);
  EXPECT_NE(few.text.find("has 3 pictures, the sequence 12 frames"), std::string::npos) << few.text;
  grey("wrong/0000.png", 1), grey("wrong/0001.png", 1), grey("wrong/0002.png", 1);
  const Outcome size = shale_program(eval + "--pictures x=" + file("wrong"));
  EXPECT_EQ(size.exit, 1);
  EXPECT_NE(size.text.find("0000.png"), std::string::npos) << size.text;
  EXPECT_EQ(shale_program(eval + "--pictures nothing").exit, 1);
  EXPECT_EQ(shale_program(eval).exit, 1);
}

TEST_F(Diff, WhatCannotBeComparedIsNamed) {
  const std::string a = grey("a.png", 1), wide = grey("wide.png", 1, 32);
  const Outcome size = diff(a + " " + wide + " --map " + file("map.png"));
  EXPECT_EQ(size.exit, 1);
  EXPECT_NE(size.text.find("32x20"), std::string::npos) << size.text;
  EXPECT_NE(size.text.find("24x20"), std::string::npos) << size.text;
  EXPECT_NE(size.text.find("wide.png"), std::string::npos) << size.text;
  EXPECT_FALSE(fs::exists(file("map.png")));
  EXPECT_EQ(diff(a + " " + file("absent.png")).exit, 1);
  EXPECT_EQ(diff(a + " " + folder_.string()).exit, 1) << "a picture and a folder";
  EXPECT_EQ(diff(a + " " + SHALE_SOURCE_DIR "/CMakeLists.txt").exit, 1);
  EXPECT_EQ(diff(a).exit, 2);
  EXPECT_EQ(diff(a + " " + a + " --metrics beauty").exit, 2);
}

}  // namespace
}  // namespace shale
