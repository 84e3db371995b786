// Plans of small models for every target as text: golden files beside this one. Run with SHALE_WRITE_GOLDEN=1 to write them
// anew, then read the difference.
#include "compiler/plan/plan.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>

#include "ir/base/file.h"
#include "tests/compiler/frame_support.h"

namespace shale {
namespace {

std::string golden(const std::string& name) {
  return std::string(SHALE_SOURCE_DIR) + "/tests/compiler/plan/golden/" + name + ".txt";
}

void expect_golden(const std::string& name, const std::string& text) {
  if (std::getenv("SHALE_WRITE_GOLDEN")) {
    EXPECT_TRUE(
        write_file(golden(name), {reinterpret_cast<const uint8_t*>(text.data()), text.size()}));
    return;
  }
  EXPECT_EQ(text, must(read_text(golden(name)))) << name;
}

/// Of every target of packages for all, one behind the other.
std::string plans_of(CompileOptions options, std::span<const uint8_t> model) {
  options.targets.clear();
  // start_kernels_test has the start forms.
  options.start_us = std::numeric_limits<double>::infinity();
  for (const DeviceProfile& profile : known_profiles())
    if (profile.for_all) options.targets.emplace_back(profile.name);
  std::string all;
  for (const std::string& text : must(plan_texts(model, options))) all += text + "\n";
  return all;
}

std::string plans_of(const CompileOptions& options, const std::string& model) {
  return plans_of(options, std::span(reinterpret_cast<const uint8_t*>(model.data()), model.size()));
}

TEST(Plan, OfANetworkAlone) {
  expect_golden("network", plans_of({}, R"(graph main {
  input %x : i8[1,8,8,4]
  const %zp : i8[1] = [-3]
  const %w : i8[4,1,1,4] = [1,2,3,4, 5,6,7,8, 9,8,7,6, 5,4,3,2]
  const %b : i32[4] = [1,2,3,4]
  %c = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,8,8,4]
  %m = reduce_max %c {axis=3} : i32[1,8,8,1]
  %y = clz %m : i32[1,8,8,1]
  return %y
})"));
}

TEST(Plan, OfANetworkThatWorksByTiles) {
  CompileOptions options;
  options.tiles = 1;
  // A result with cells, one that mixes all positions, and an input that is no picture.
  expect_golden("tiles", plans_of(options, R"(graph main {
  input %x : i8[1,41,71,4]
  input %bias : i8[1,1,1,4]
  const %zp : i8[1] = [-3]
  const %w : i8[4,1,1,4] = [1,2,3,4, 5,6,7,8, 9,8,7,6, 5,4,3,2]
  const %b : i32[4] = [1,2,3,4]
  %c = conv2d %x, %w, %b, %zp, %zp {pad=[0,0,0,0], stride=[2,2], dilation=[1,1], acc_type=i32} : i32[1,21,36,4]
  %y = bitwise_xor %x, %bias : i8[1,41,71,4]
  %m = reduce_max %c {axis=1} : i32[1,1,36,4]
  return %y, %m
})"));
}

TEST(Plan, OfASmallFrame) { expect_golden("frame", plans_of(frame_options(kFrame), kNetwork)); }

/// A model folder at a small size.
std::string plans_of_folder(const std::string& name, FrameExtent render) {
  const std::string folder = std::string(SHALE_SOURCE_DIR) + "/models/" + name;
  CompileOptions options;
  options.frame = must(parse_frame(must(read_text(folder + "/frame.json"))));
  options.load_shader = [folder](const std::string& path) {
    return read_text(folder + "/" + path);
  };
  options.sizes.render = render;
  std::vector<uint8_t> model;
  if (!graph_files(*options.frame).empty()) model = must(read_file(folder + "/model.tosa"));
  return plans_of(options, model);
}

TEST(Plan, OfNssV1High) { expect_golden("nss_v1_high", plans_of_folder("nss_v1_high", {32, 16})); }
TEST(Plan, OfNssV1Low) { expect_golden("nss_v1_low", plans_of_folder("nss_v1_low", {32, 16})); }
TEST(Plan, OfNssV01) { expect_golden("nss_v0_1", plans_of_folder("nss_v0_1", {32, 16})); }
TEST(Plan, OfSrpoX2) { expect_golden("srpo_x2", plans_of_folder("srpo_x2", {16, 12})); }
TEST(Plan, OfMobFgsr) {
  expect_golden("mob_fgsr", plans_of_folder("baselines/mob_fgsr", {16, 12}));
}
TEST(Plan, OfTss) { expect_golden("tss", plans_of_folder("baselines/tss", {16, 12})); }

}  // namespace
}  // namespace shale
