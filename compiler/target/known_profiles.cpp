#include <initializer_list>
#include <vector>

#include "compiler/target/profile.h"

namespace shale {
namespace {

FeatureSet features(std::initializer_list<Feature> list) {
  FeatureSet set;
  for (const Feature feature : list) set.add(feature);
  return set;
}

/// A class of GPUs: what any has, and `more`. Rates are assumed, for ranking kernels only.
DeviceProfile gpu_with(std::string_view name, std::string_view help, FeatureSet more,
                       double dot8_gops, double matrix_gops) {
  DeviceProfile profile{
      .name = name,
      .help = help,
      .caps = {.name = "GPU",
               .driver = "",
               .api_version = (1u << 22) | (3u << 12),
               .cpu = false,
               .features = features({Feature::kStorageBuffer8, Feature::kStorageBuffer16,
                                     Feature::kInt8, Feature::kInt16, Feature::kInt64}),
               .max_workgroup_invocations = 128,
               .max_workgroup_size = {128, 128, 64},
               .max_workgroup_count = {65535, 65535, 65535},
               .max_shared_bytes = 16384,
               .max_storage_range_bytes = uint64_t{1} << 27,
               .max_texel_elements = uint64_t{1} << 16,
               .max_storage_buffers = 16,
               .max_texel_buffers = 16,
               .max_storage_images = 8,
               .subgroup_size = 32},
      .mul_add_gops = 2000,
      .dot8_gops = dot8_gops,
      .matrix_gops = matrix_gops,
      .generic_gops = 100,
      .element_ns = 0.05,
      .bandwidth_gbps = 50,
      .launch_us = 5,
      .source = "assumed: order of magnitude of a phone GPU, for ranking kernels only"};
  profile.caps.features.bits |= more.bits;
  return profile;
}

const std::vector<DeviceProfile>& profiles() {
  static const std::vector<DeviceProfile> table{
      {.name = "lavapipe",
       .help = "Vulkan on the CPU by Mesa: literal weights, float32 where exact",
       .caps = {.name = "llvmpipe",
                .driver = "Mesa 22.3",
                .api_version = (1u << 22) | (3u << 12),
                .cpu = true,
                .features =
                    features({Feature::kStorageBuffer8, Feature::kStorageBuffer16, Feature::kInt8,
                              Feature::kInt16, Feature::kInt64, Feature::kDotProduct8}),
                .max_workgroup_invocations = 1024,
                .max_workgroup_size = {1024, 1024, 1024},
                .max_workgroup_count = {65535, 65535, 65535},
                .max_shared_bytes = 32768,
                .max_storage_range_bytes = uint64_t{1} << 27,
                .max_texel_elements = uint64_t{1} << 27,
                .max_storage_buffers = 32,
                .max_texel_buffers = 128,
                .max_storage_images = 32,
                .subgroup_size = 8},
       .mul_add_gops = 125,
       .literal_share = 0.72,
       .winograd_share = 0.65,
       .integer_share = 0.5,
       .driver_us_per_product = 120,
       .generic_gops = 0.85,
       .element_ns = 3.0,
       .bandwidth_gbps = 6.0,
       .launch_us = 30,
       .literal_weights = true,
       .source = "measured with tests/bench on 2 cores, Mesa 22.3.6"},
      gpu_with("generic-gpu", "any Vulkan 1.3 GPU with 8-bit storage: weights in buffers", {}, 0,
               0),
      gpu_with("dot8-gpu", "a GPU with int8 dot products: weights packed for them in buffers",
               features({Feature::kDotProduct8}), 1000, 0),
      gpu_with(
          "coopmat-gpu",
          "a GPU with int8 cooperative matrices of 16x16x32 in subgroups of 32 (not run on one)",
          features({Feature::kDotProduct8, Feature::kCooperativeMatrix}), 1000, 2500),
  };
  return table;
}

}  // namespace

std::span<const DeviceProfile> known_profiles() { return profiles(); }

const DeviceProfile* find_profile(std::string_view name) {
  for (const DeviceProfile& profile : profiles())
    if (profile.name == name) return &profile;
  return nullptr;
}

}  // namespace shale
