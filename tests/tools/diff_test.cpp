// shale diff as its users meet it.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "tools/scene/exr.h"
#include "tools/shale/picture.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Outcome {
  int exit = -1;
  std::string text;  ///< standard output and error
};

Outcome diff(const std::string& arguments) {
  Outcome outcome;
  std::FILE* pipe = popen((SHALE_PROGRAM " diff " + arguments + " 2>&1").c_str(), "r");
  char buffer[4096];
  for (size_t count; (count = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;)
    outcome.text.append(buffer, count);
  const int status = pclose(pipe);
  outcome.exit = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

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
