// What devices get: snapshots of real and of possible ones against the variants of a package for
// all targets, and profiles made from snapshots. Each file says where its numbers are from.
#include <fmt/ranges.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "compiler/driver/compile.h"
#include "compiler/target/caps_json.h"
#include "ir/base/file.h"
#include "ir/package/rank.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

const std::string kFolder = SHALE_SOURCE_DIR "/tests/compiler/snapshots/";

DeviceCaps snapshot(const std::string& name) {
  return must(parse_caps(must(read_text(kFolder + name + ".json"))));
}

struct Row {
  const char* snapshot;
  DeviceClass device_class;
  const char* variant;   ///< of a package for all targets; empty if none
  const char* kernel;    ///< of a layer 32->32 compiled for the device itself
  const char* products;  ///< of matrices in it
};

const Row kRows[] = {
    {"lavapipe_22_3", DeviceClass::kCpu, "lavapipe", "conv2d_s8_winograd", ""},
    {"lavapipe_22_3_avx2", DeviceClass::kCpuAvx2, "lavapipe-avx2", "conv2d_s8_winograd32", ""},
    {"lavapipe_22_3_sse", DeviceClass::kCpuSse, "lavapipe-sse", "conv2d_s8_winograd32", ""},
    {"lavapipe_22_3_neon", DeviceClass::kCpuNeon, "lavapipe-neon", "conv2d_s8_winograd32", ""},
    {"lavapipe_26_2", DeviceClass::kCpu, "lavapipe", "conv2d_s8_winograd", ""},
    // Four storage buffers a stage are too few for a convolution by a fast kernel.
    {"vulkan_1_3_minimum", DeviceClass::kDot8Gpu, "", "generic", ""},
    {"vulkan_1_3_minimum_8bit", DeviceClass::kDot8Gpu, "dot8-gpu", "conv2d_s8_dot8", ""},
    {"mali_g615", DeviceClass::kDot8Gpu, "dot8-gpu", "conv2d_s8_dot8", ""},
    {"adreno_740", DeviceClass::kDot8Gpu, "dot8-gpu", "conv2d_s8_dot8", ""},
    {"amd_rx_6500_xt", DeviceClass::kDot8Gpu, "dot8-gpu", "conv2d_s8_dot8", ""},
    // Matrices of another shape or subgroup than those of the class's profile: compiled for the
    // device itself they are used.
    {"amd_rx_7800_xt", DeviceClass::kMatrixGpu, "dot8-gpu", "conv2d_s8_coopmat", "16x16x16"},
    {"intel_arc_mtl", DeviceClass::kDot8Gpu, "dot8-gpu", "conv2d_s8_dot8", ""},
    {"intel_xe2", DeviceClass::kMatrixGpu, "dot8-gpu", "conv2d_s8_coopmat", "8x16x32"},
    {"nvidia_rtx", DeviceClass::kMatrixGpu, "coopmat-gpu", "conv2d_s8_coopmat", "16x16x32"},
};

Graph layer() {
  return ConvCase{.name = "layer",
                  .h = 136,
                  .w = 240,
                  .ic = 32,
                  .oc = 32,
                  .input_zp = -128,
                  .weight_min = -30,
                  .weight_max = 30}
      .graph();
}

TEST(Target, EverySnapshotHasARowAndSaysItsSource) {
  size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kFolder)) {
    const std::string name = entry.path().stem().string();
    EXPECT_TRUE(std::any_of(std::begin(kRows), std::end(kRows), [&](const Row& row) {
      return row.snapshot == name;
    })) << name;
    const std::string text = must(read_text(entry.path().string()));
    EXPECT_NE(text.find("\"source\": \""), std::string::npos) << name;
    ++files;
  }
  EXPECT_EQ(files, std::size(kRows));
}

TEST(Target, DevicesTakeTheVariantOfTheirClassThatFits) {
  CompileOptions options;
  options.expected_runs = kRunsOfFrame;
  options.targets.clear();
  // From the worst to the best: the order in the package does not matter.
  for (const DeviceProfile& profile : known_profiles())
    options.targets.insert(options.targets.begin(), std::string(profile.name));
  const Compiled compiled = must(compile_graph(layer(), 0, options));
  for (const Row& row : kRows) {
    const DeviceCaps caps = snapshot(row.snapshot);
    EXPECT_EQ(device_class(caps), row.device_class) << row.snapshot;
    const RankedVariant best = rank_variants(compiled.package.variants, caps)[0];
    EXPECT_EQ(best.missing.empty() ? compiled.package.variants[best.index].target : "", row.variant)
        << row.snapshot << ": " << fmt::format("{}", fmt::join(best.missing, "; "));
  }
}

TEST(Target, ProfilesFromSnapshotsMakeVariantsThatTheDeviceMeets) {
  for (const Row& row : kRows) {
    const DeviceCaps caps = snapshot(row.snapshot);
    CompileOptions options;
    options.expected_runs = kRunsOfFrame;
    options.targets = {"own"};
    options.profiles.emplace("own", profile_from_caps(caps));
    const Compiled compiled = must(compile_graph(layer(), 0, options));
    const Variant& variant = compiled.package.variants[0];
    EXPECT_EQ(variant.device_class, row.device_class) << row.snapshot;
    EXPECT_EQ(variant.segments[0].dispatches[0].kernel, row.kernel) << row.snapshot;
    std::string products;
    for (const MatrixProduct& product : variant.requirements.matrix_products)
      products += matrix_product_text(product);
    EXPECT_EQ(products, row.products) << row.snapshot;
    // The minimum lacks 8-bit storage, without which nothing of Shale's runs.
    EXPECT_EQ(meets(caps, variant.requirements), std::string(row.variant) != "") << row.snapshot;
  }
}

TEST(Target, CapsComeBackAsTheyWere) {
  for (const Row& row : kRows) {
    const DeviceCaps caps = snapshot(row.snapshot);
    EXPECT_EQ(must(parse_caps(caps_json(caps))), caps) << row.snapshot;
    const std::string report = "{\"devices\": [" + caps_json(caps) + ", 7]}";
    EXPECT_EQ(must(parse_caps(report)), caps);
  }
}

TEST(Target, BadCapsAreRefused) {
  const std::string good = caps_json(snapshot("nvidia_rtx"));
  struct Change {
    const char *from, *to, *error;
  };
  const Change changes[] = {
      {"\"shale-caps/1\"", "\"other\"",
       "is no description of a device, expected schema shale-caps/1"},
      {"\"GPU\"", "\"TPU\"", "kind: expected CPU or GPU"},
      {"\"processor\": \"unknown\"", "\"processor\": \"mmx\"",
       "processor: expected unknown, sse, avx2, avx512 or neon"},
      {"\"1.3.280\"", "\"1.3\"", "vulkan: expected a version such as 1.3.246"},
      {"\"1.3.280\"", "\"1.3.280.1\"", "vulkan: expected a version such as 1.3.246"},
      {"\"1.3.280\"", "\"1.3000.1\"", "vulkan: expected a version such as 1.3.246"},
      {"\"shaderInt8\": true", "\"shaderInt8\": 1", "features.shaderInt8: expected true or false"},
      {"\"shared_bytes\": 49152", "\"shared_bytes\": -1",
       "shared_bytes: expected a whole number that is not negative"},
      {"\"shared_bytes\": 49152", "\"shared_bytes\": 4294967296",
       "shared_bytes: expected a whole number that is not negative"},
      {"\"shared_bytes\"", "\"shared\"", "shared_bytes: is missing"},
      {"\"name\": \"NVIDIA GeForce RTX\"", "\"name\": 7", "name: expected a text"},
      {"\"cooperativeMatrix\": true", "\"cooperativeMatrix\": false",
       "matrix_products: there are some where, and only where, features names them"},
  };
  for (const Change& change : changes) {
    std::string text = good;
    const size_t at = text.find(change.from);
    ASSERT_NE(at, std::string::npos) << change.from;
    text.replace(at, std::string(change.from).size(), change.to);
    EXPECT_EQ(error_text(parse_caps(text)), change.error);
  }
  EXPECT_EQ(error_text(parse_caps("")), "is not valid JSON at byte 1");
  for (const char* text : {"[]", "7", "{\"devices\": [7]}", "{\"devices\": 7}"})
    EXPECT_EQ(error_text(parse_caps(text)),
              "is no description of a device, expected schema shale-caps/1");
  EXPECT_EQ(error_text(parse_caps("{\"devices\": []}")), "devices: there is none");
}

}  // namespace
}  // namespace shale
