// shale doctor: which devices there are, what they can do, which kernels and which variants of a
// package they will get, what is missing.
#include <optional>
#include <utility>

#include "compiler/kernels/kernel.h"
#include "compiler/target/caps_json.h"
#include "ir/base/file.h"
#include "ir/package/rank.h"
#include "runtime/vk/device.h"
#include "runtime/vk/instance.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

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

/// What the device is, as --target takes it, and what it gets; of `package`, where there is one, which
/// variant, and why not the others.
Json describe(const DeviceCaps& caps, const std::optional<Package>& package) {
  const DeviceProfile profile = profile_from_caps(caps);
  Json json = Json::parse(caps_json(caps));
  json["class"] = device_class_name(device_class(caps));
  json["target"] = profile.name;
  json["kernels"] = kernels_of(profile);
  json["missing"] = lacking(caps);
  if (!package) return json;
  json["variants"] = Json::array();
  for (const RankedVariant& ranked : rank_variants(package->variants, caps)) {
    const Variant& variant = package->variants[ranked.index];
    json["variants"].push_back({{"variant", ranked.index},
                                {"target", variant.target},
                                {"class", device_class_name(variant.device_class)},
                                {"predicted_us", ranked.time_us},
                                {"missing", ranked.missing}});
  }
  return json;
}

void print(const Json& device) {
  fmt::print("{} ({}, class {}, Vulkan {})\n  driver: {}\n", device["name"].get<std::string>(),
             device["kind"].get<std::string>(), device["class"].get<std::string>(),
             device["vulkan"].get<std::string>(), device["driver"].get<std::string>());
  for (const auto& [name, present] : device["features"].items())
    fmt::print("  {:<34} {}\n", name, present.get<bool>() ? "yes" : "no");
  for (const Json& product : device["matrix_products"])
    fmt::print("  int8 matrices of {}x{}x{}\n", product[0].get<uint32_t>(),
               product[1].get<uint32_t>(), product[2].get<uint32_t>());
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
  if (!device.contains("variants")) return;
  bool is_taken = false;
  for (const Json& variant : device["variants"]) {
    const bool fits = variant["missing"].empty();
    fmt::print("  variant {} for {} (class {}, {:.3f} ms there): {}\n",
               variant["variant"].get<uint32_t>(), variant["target"].get<std::string>(),
               variant["class"].get<std::string>(), variant["predicted_us"].get<double>() / 1000,
               !fits                            ? "refused"
               : !std::exchange(is_taken, true) ? "taken"
                                                : "fits too");
    for (const Json& line : variant["missing"]) fmt::print("    {}\n", line.get<std::string>());
  }
}

Result<int> doctor(bool as_json, const std::string& package_path) {
  std::optional<Package> package;
  if (!package_path.empty()) {
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file(package_path));
    Result<Package> read = read_package(bytes);
    if (!read) return in_file(package_path, read.error());
    package = *std::move(read);
  }
  Json json{{"version", kVersionText}, {"devices", Json::array()}, {"advice", Json::array()}};
  int exit = kNoDevice;
  Result<vk::Instance> instance = vk::Instance::create();
  if (!instance) {
    json["advice"].push_back(instance.error().text());
  } else {
    SHALE_TRY(const std::vector<VkPhysicalDevice> devices, instance->physical_devices());
    for (const VkPhysicalDevice device : devices) {
      const DeviceCaps caps = vk::snapshot_caps(device, instance->functions());
      json["devices"].push_back(describe(caps, package));
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
  auto package = std::make_shared<std::string>();
  app.add_option("package", *package, "package (.shale): which variant each device takes, and why");
  app.add_flag("--json", *as_json, "print as JSON");
  app.footer(
      "Example: shale doctor --json > device.json\n"
      "         shale compile models/srpo_x2 --target device.json -o srpo.shale\n"
      "Exit code 3 if no device can run networks.");
  return [as_json, package] { return doctor(*as_json, *package); };
}

}  // namespace shale
