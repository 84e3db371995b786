// shale doctor: which devices there are, what they can do, which kernels they will get, what is
// missing.
#include "compiler/kernels/kernel.h"
#include "runtime/vk/device.h"
#include "runtime/vk/instance.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

std::string version(uint32_t number) {
  return fmt::format("{}.{}.{}", VK_API_VERSION_MAJOR(number), VK_API_VERSION_MINOR(number),
                     VK_API_VERSION_PATCH(number));
}

/// What the generic kernels of every network need; without it no package runs.
std::vector<std::string> lacking(const DeviceCaps& caps) {
  Requirements needs;
  for (const Feature feature :
       {Feature::kStorageBuffer8, Feature::kStorageBuffer16, Feature::kInt8, Feature::kInt16})
    needs.features.add(feature);
  return missing(caps, needs);
}

/// Families that packages for the profile choose from.
Json kernels_of(const DeviceProfile& profile) {
  Json names = Json::array();
  for (const KernelFamily& family : all_kernels()) {
    const bool is_for = family.literals                      ? profile.literal_weights
                        : family.name == "conv2d_s8_coopmat" ? profile.ns[Work::kMatrixMac] > 0
                        : family.name == "conv2d_s8_dot8"    ? profile.ns[Work::kDotMac] > 0
                                                             : true;
    if (is_for) names.push_back(family.name);
  }
  return names;
}

Json describe(const DeviceCaps& caps) {
  Json features = Json::object();
  for (uint32_t i = 0; i < kFeatureCount; ++i)
    features[feature_name(static_cast<Feature>(i))] = caps.features.has(static_cast<Feature>(i));
  const bool dots = caps.features.has(Feature::kDotProduct8);
  const bool matrices = dots && caps.features.has(Feature::kCooperativeMatrix);
  const std::string_view target = caps.cpu   ? "lavapipe"
                                  : matrices ? "coopmat-gpu"
                                  : dots     ? "dot8-gpu"
                                             : "generic-gpu";
  return {{"name", caps.name},
          {"driver", caps.driver},
          {"vulkan", version(caps.api_version)},
          {"kind", caps.cpu ? "CPU" : "GPU"},
          {"features", features},
          {"subgroup_size", caps.subgroup_size},
          {"max_workgroup_invocations", caps.max_workgroup_invocations},
          {"shared_bytes", caps.max_shared_bytes},
          {"storage_range_bytes", caps.max_storage_range_bytes},
          {"texel_elements", caps.max_texel_elements},
          {"target", target},
          {"kernels", kernels_of(*find_profile(target))},
          {"missing", lacking(caps)}};
}

void print(const Json& device) {
  fmt::print("{} ({}, Vulkan {})\n  driver: {}\n", device["name"].get<std::string>(),
             device["kind"].get<std::string>(), device["vulkan"].get<std::string>(),
             device["driver"].get<std::string>());
  for (const auto& [name, present] : device["features"].items())
    fmt::print("  {:<28} {}\n", name, present.get<bool>() ? "yes" : "no");
  fmt::print("  workgroup: {} invocations, subgroup {}, {} bytes shared\n",
             device["max_workgroup_invocations"].get<uint32_t>(),
             device["subgroup_size"].get<uint32_t>(), device["shared_bytes"].get<uint32_t>());
  std::string kernels;
  for (const Json& kernel : device["kernels"])
    kernels += (kernels.empty() ? "" : ", ") + kernel.get<std::string>();
  fmt::print("  compile with --target {}: kernels {}\n", device["target"].get<std::string>(),
             kernels);
  for (const Json& line : device["missing"])
    fmt::print("  cannot run networks: {}\n", line.get<std::string>());
}

Result<int> doctor(bool as_json) {
  Json json{{"version", kVersionText}, {"devices", Json::array()}, {"advice", Json::array()}};
  int exit = kNoDevice;
  Result<vk::Instance> instance = vk::Instance::create();
  if (!instance) {
    json["advice"].push_back(instance.error().text());
  } else {
    SHALE_TRY(const std::vector<VkPhysicalDevice> devices, instance->physical_devices());
    for (const VkPhysicalDevice device : devices) {
      const DeviceCaps caps = vk::snapshot_caps(device, instance->functions());
      json["devices"].push_back(describe(caps));
      if (lacking(caps).empty()) exit = kDone;
    }
    if (const Result<vk::Instance> validated = vk::Instance::create({.validation = true});
        !validated)
      json["advice"].push_back(
          "the validation layer is missing: apt-get install vulkan-validationlayers");
  }
  if (exit != kDone)
    json["advice"].push_back(
        "no usable device: apt-get install mesa-vulkan-drivers brings one that runs on the CPU");
  if (as_json) {
    print_json(json);
    return exit;
  }
  for (const Json& device : json["devices"]) print(device);
  for (const Json& line : json["advice"]) fmt::print("note: {}\n", line.get<std::string>());
  return exit;
}

}  // namespace

Action add_doctor(CLI::App& app) {
  auto as_json = std::make_shared<bool>(false);
  app.add_flag("--json", *as_json, "print as JSON");
  app.footer("Example: shale doctor\nExit code 3 if no device can run networks.");
  return [as_json] { return doctor(*as_json); };
}

}  // namespace shale
