#include <algorithm>
#include <initializer_list>
#include <vector>

#include "compiler/target/profile.h"
#include "ir/package/rank.h"

namespace shale {
namespace {

FeatureSet features(std::initializer_list<Feature> list) {
  FeatureSet set;
  for (const Feature feature : list) set.add(feature);
  return set;
}

constexpr std::array<WorkInfo, kWorkCount> kWorks{{
    {"dispatch", "a dispatch"},
    {"code", "a product in the code, once a dispatch"},
    {"float_product", "a float32 product with a literal"},
    {"int_product", "an int32 product with a literal"},
    {"pair_product", "a float64 product of a packed pair with a literal"},
    {"transform", "an element of Winograd's transforms"},
    {"fetch", "a texel fetched"},
    {"unpack", "a channel of a texel made a number"},
    {"result", "an element requantized and stored"},
    {"generic_mac", "a product of the generic kernel"},
    {"generic_result", "an element of the generic kernel"},
    {"run_mac", "a product of the kernel of runs"},
    {"run_result", "an element of the kernel of runs"},
    {"real_mac", "a float product of weights that a loop loads"},
    {"dot_mac", "a product by int8 dot products"},
    {"matrix_mac", "a product by int8 cooperative matrices"},
    {"loop_mac", "a float32 product of weights that a loop loads"},
    {"byte", "a byte read or written"},
}};

WorkTable work_ns(std::initializer_list<std::pair<Work, double>> list) {
  WorkTable table{};
  for (const auto& [work, ns] : list) table[work] = ns;
  return table;
}

/// A class of GPUs: what any has, and `more`. Rates are assumed, for ranking kernels only.
DeviceProfile gpu_with(std::string_view name, std::string_view help, DeviceClass device_class,
                       FeatureSet more, WorkTable more_ns = {},
                       std::vector<MatrixProduct> products = {}) {
  DeviceProfile profile{
      .name = name,
      .help = help,
      .device_class = device_class,
      .caps = {.name = "GPU",
               .driver = "",
               .api_version = (1u << 22) | (3u << 12),
               .cpu = false,
               .features =
                   features({Feature::kStorageBuffer8, Feature::kStorageBuffer16, Feature::kInt8,
                             Feature::kInt16, Feature::kInt64, Feature::kStorageImageExtended}),
               .max_workgroup_invocations = 128,
               .max_workgroup_size = {128, 128, 64},
               .max_workgroup_count = {65535, 65535, 65535},
               .max_shared_bytes = 16384,
               .max_storage_range_bytes = uint64_t{1} << 27,
               .max_texel_elements = uint64_t{1} << 16,
               .max_storage_buffers = 16,
               .max_texel_buffers = 16,
               .max_storage_images = 8,
               .subgroup_size = 32,
               .matrix_products = std::move(products)},
      .ns = work_ns({{Work::kDispatch, 5000},
                     {Work::kGenericMac, 0.02},
                     {Work::kGenericResult, 0.05},
                     {Work::kByte, 0.02}}),
      .source = "assumed: order of magnitude of a phone GPU, for ranking kernels only"};
  profile.caps.features.bits |= more.bits;
  for (size_t i = 0; i < kWorkCount; ++i) profile.ns.at(i) += more_ns.at(i);
  return profile;
}

/// Mesa's lavapipe on a class of processors.
DeviceProfile lavapipe(std::string_view name, std::string_view help, DeviceClass device_class,
                       Processor processor, uint32_t subgroup_size) {
  return {.name = name,
          .help = help,
          .device_class = device_class,
          .caps = {.name = "llvmpipe",
                   .driver = "Mesa 22.3",
                   .api_version = (1u << 22) | (3u << 12),
                   .cpu = true,
                   .processor = processor,
                   .features = features({Feature::kStorageBuffer8, Feature::kStorageBuffer16,
                                         Feature::kInt8, Feature::kInt16, Feature::kInt64,
                                         Feature::kDotProduct8, Feature::kFloat64,
                                         Feature::kStorageImageExtended}),
                   .max_workgroup_invocations = 1024,
                   .max_workgroup_size = {1024, 1024, 1024},
                   .max_workgroup_count = {65535, 65535, 65535},
                   .max_shared_bytes = 32768,
                   .max_storage_range_bytes = uint64_t{1} << 27,
                   .max_texel_elements = uint64_t{1} << 27,
                   .max_storage_buffers = 32,
                   .max_texel_buffers = 128,
                   .max_storage_images = 32,
                   .subgroup_size = subgroup_size},
          .driver_us_per_product = 300,
          .driver_us_per_module = 30000,
          .literal_weights = true};
}

DeviceProfile avx512_profile() {
  DeviceProfile profile = lavapipe(
      "lavapipe", "Vulkan on the CPU by Mesa, with AVX-512: literal weights, packed doubles",
      DeviceClass::kCpu, Processor::kAvx512, 8);
  profile.ns = work_ns({{Work::kDispatch, 100400},
                        {Work::kCode, 4.63},
                        {Work::kFloatProduct, 0.0162},
                        {Work::kIntProduct, 0.032},
                        {Work::kPairProduct, 0.0169},
                        {Work::kTransform, 0.259},
                        {Work::kFetch, 0.711},
                        {Work::kUnpack, 0.168},
                        {Work::kResult, 0.353},
                        {Work::kGenericMac, 2.35},
                        {Work::kGenericResult, 3.46},
                        {Work::kRunMac, 0.13},
                        {Work::kRealMac, 0.08},
                        {Work::kRunResult, 0.78},
                        {Work::kLoopMac, 0.08},
                        {Work::kByte, 0.167}});
  profile.roof_gops = 121.8;
  profile.source =
      "fitted by shale fit to NSS v1 HIGH, v0.1, SRPO x2, x3 at 640x360 and NSS v1 HIGH, LOW at "
      "320x180 (shale bench --repeat 9) on 2 cores of a Zen 4 class processor, Mesa 22.3.6; "
      "float_product, int_product and generic_mac from tests/bench, byte assumed";
  return profile;
}

/// 16 vector registers: a sum, its product and the number that it is made from leave room for eight to
/// twelve; 16 spill and take 1.6 times as long.
DeviceProfile avx2_profile() {
  DeviceProfile profile = lavapipe(
      "lavapipe-avx2", "the same with AVX2: literal weights, float32 where exact, fewer sums live",
      DeviceClass::kCpuAvx2, Processor::kAvx2, 8);
  profile.ns = work_ns({{Work::kDispatch, 33000},
                        {Work::kCode, 4.04},
                        {Work::kFloatProduct, 0.0324},
                        {Work::kIntProduct, 0.065},
                        {Work::kPairProduct, 0.119},
                        {Work::kTransform, 0.169},
                        {Work::kFetch, 0.185},
                        {Work::kUnpack, 0.0437},
                        {Work::kResult, 0.472},
                        {Work::kGenericMac, 4.7},
                        {Work::kGenericResult, 7.18},
                        {Work::kRunMac, 0.24},
                        {Work::kRealMac, 0.155},
                        {Work::kRunResult, 1.45},
                        {Work::kLoopMac, 0.16},
                        {Work::kByte, 0.167}});
  profile.roof_gops = 65.3;
  profile.source =
      "fitted by shale fit to NSS v1 HIGH by several families and v0.1 at 640x360 and NSS v1 HIGH "
      "at "
      "320x180 (shale bench --repeat 7) on 2 cores of an Ice Lake class Xeon, Mesa 22.3.6 with "
      "GALLIUM_OVERRIDE_CPU_CAPS=avx; dispatch by tests/bench, int_product, generic_mac, loop_mac "
      "and "
      "byte assumed";
  profile.live_sums = profile.most_sums = 8;
  return profile;
}

/// As another class of processors, with its times by the vectors' width; not measured.
DeviceProfile assumed(DeviceProfile profile, std::string_view name, std::string_view help,
                      DeviceClass device_class, Processor processor) {
  profile.name = name;
  profile.help = help;
  profile.device_class = device_class;
  profile.caps.processor = processor;
  profile.caps.subgroup_size = 4;
  for (size_t i = 0; i < kWorkCount; ++i)
    if (static_cast<Work>(i) != Work::kDispatch && static_cast<Work>(i) != Work::kByte)
      profile.ns.at(i) *= 2;
  profile.roof_gops /= 2;
  profile.for_all = false;
  profile.source = "assumed: half the rates of lavapipe-avx2, for vectors of 128 bits";
  return profile;
}

const std::vector<DeviceProfile>& profiles() {
  static const std::vector<DeviceProfile> table{
      avx512_profile(),
      avx2_profile(),
      assumed(avx2_profile(), "lavapipe-sse", "the same without AVX2 (not measured)",
              DeviceClass::kCpuSse, Processor::kSse),
      assumed(avx2_profile(), "lavapipe-neon", "the same on an ARM processor (not measured)",
              DeviceClass::kCpuNeon, Processor::kNeon),
      gpu_with("generic-gpu", "any Vulkan 1.3 GPU with 8-bit storage: weights in buffers",
               DeviceClass::kAny, {}),
      gpu_with("dot8-gpu", "a GPU with int8 dot products: weights packed for them in buffers",
               DeviceClass::kDot8Gpu, features({Feature::kDotProduct8}),
               work_ns({{Work::kDotMac, 0.002}})),
      gpu_with(
          "coopmat-gpu",
          "a GPU with int8 cooperative matrices of 16x16x32 in subgroups of 32 (not run on one)",
          DeviceClass::kMatrixGpu, features({Feature::kDotProduct8, Feature::kCooperativeMatrix}),
          work_ns({{Work::kDotMac, 0.002}, {Work::kMatrixMac, 0.0008}}), {{16, 16, 32}}),
  };
  return table;
}

}  // namespace

const WorkInfo& work_info(Work work) { return kWorks[static_cast<size_t>(work)]; }

double work_time_us(const WorkTable& amounts, const WorkTable& ns) {
  double busy = 0;
  for (size_t i = 0; i < kWorkCount; ++i) busy += amounts.at(i) * ns.at(i);
  const double dispatch = amounts[Work::kDispatch] * ns[Work::kDispatch],
               memory = amounts[Work::kByte] * ns[Work::kByte];
  busy -= dispatch + memory;
  return 1e-3 * (std::max(busy, memory) + dispatch);
}

std::span<const DeviceProfile> known_profiles() { return profiles(); }

const DeviceProfile* find_profile(std::string_view name) {
  for (const DeviceProfile& profile : profiles())
    if (profile.name == name) return &profile;
  return nullptr;
}

DeviceProfile profile_from_caps(const DeviceCaps& caps) {
  const auto same_class = [&](const DeviceProfile& profile) {
    return profile.device_class == device_class(caps);
  };
  DeviceProfile profile = *std::find_if(profiles().begin(), profiles().end(), same_class);
  profile.caps = caps;
  return profile;
}

}  // namespace shale
