#include "runtime/vk/device.h"

#include <algorithm>

#include "runtime/vk/cooperative_matrix.h"
#include "runtime/vk/handle.h"
#include "runtime/vk/processor.h"

namespace shale::vk {
namespace {

/// The feature structs of Vulkan 1.0 to 1.3, chained; never moved.
struct Features {
  VkPhysicalDeviceVulkan13Features v13 =
      init<VkPhysicalDeviceVulkan13Features>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES);
  VkPhysicalDeviceVulkan12Features v12 =
      init<VkPhysicalDeviceVulkan12Features>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES);
  VkPhysicalDeviceVulkan11Features v11 =
      init<VkPhysicalDeviceVulkan11Features>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES);
  VkPhysicalDeviceFeatures2 v10 =
      init<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2);

  Features() {
    v10.pNext = &v11;
    v11.pNext = &v12;
    v12.pNext = &v13;
  }
  Features(const Features&) = delete;
  Features& operator=(const Features&) = delete;
};

/// One line ties a feature bit to its Vulkan member, for asking and for enabling.
struct FeatureMember {
  Feature feature;
  VkBool32& (*member)(Features&);
};
constexpr FeatureMember kFeatureMembers[] = {
    {Feature::kStorageBuffer8,
     [](Features& f) -> VkBool32& { return f.v12.storageBuffer8BitAccess; }},
    {Feature::kStorageBuffer16,
     [](Features& f) -> VkBool32& { return f.v11.storageBuffer16BitAccess; }},
    {Feature::kInt8, [](Features& f) -> VkBool32& { return f.v12.shaderInt8; }},
    {Feature::kInt16, [](Features& f) -> VkBool32& { return f.v10.features.shaderInt16; }},
    {Feature::kInt64, [](Features& f) -> VkBool32& { return f.v10.features.shaderInt64; }},
    {Feature::kFloat16, [](Features& f) -> VkBool32& { return f.v12.shaderFloat16; }},
    {Feature::kDotProduct8, [](Features& f) -> VkBool32& { return f.v13.shaderIntegerDotProduct; }},
    {Feature::kFloat64, [](Features& f) -> VkBool32& { return f.v10.features.shaderFloat64; }},
    {Feature::kStorageImageExtended,
     [](Features& f) -> VkBool32& { return f.v10.features.shaderStorageImageExtendedFormats; }},
};

/// A structure of a chain, by its type.
template <typename T>
const T& as(const VkBaseInStructure* structure) {
  return *reinterpret_cast<const T*>(structure);
}

/// What modules with matrices have to use. Where it is enabled the atomics of passes, which are of the
/// device's scope, need that scope enabled as well.
bool has_memory_model(const VkPhysicalDeviceVulkan12Features& v12) {
  return v12.vulkanMemoryModel && v12.vulkanMemoryModelDeviceScope;
}

std::vector<VkQueueFamilyProperties> queue_families(const Functions& vk, VkPhysicalDevice device) {
  uint32_t count = 0;
  vk.GetPhysicalDeviceQueueFamilyProperties(device, &count, nullptr);
  std::vector<VkQueueFamilyProperties> families(count);
  vk.GetPhysicalDeviceQueueFamilyProperties(device, &count, families.data());
  return families;
}

}  // namespace

DeviceCaps snapshot_caps(VkPhysicalDevice device, const Functions& vk) {
  auto v11 = init<VkPhysicalDeviceVulkan11Properties>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_PROPERTIES);
  auto v12 = init<VkPhysicalDeviceVulkan12Properties>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES);
  auto v10 = init<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  v10.pNext = &v11;
  v11.pNext = &v12;
  vk.GetPhysicalDeviceProperties2(device, &v10);
  Features features;
  vk.GetPhysicalDeviceFeatures2(device, &features.v10);

  const VkPhysicalDeviceLimits& limits = v10.properties.limits;
  DeviceCaps caps;
  caps.name = v10.properties.deviceName;
  caps.driver = fmt::format("{} {}", v12.driverName, v12.driverInfo);
  caps.api_version = v10.properties.apiVersion;
  caps.cpu = v10.properties.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU;
  if (caps.cpu) caps.processor = driver_processor();
  for (const FeatureMember& row : kFeatureMembers)
    if (row.member(features)) caps.features.add(row.feature);
  caps.max_workgroup_invocations = limits.maxComputeWorkGroupInvocations;
  std::copy_n(limits.maxComputeWorkGroupSize, 3, caps.max_workgroup_size);
  std::copy_n(limits.maxComputeWorkGroupCount, 3, caps.max_workgroup_count);
  caps.max_shared_bytes = limits.maxComputeSharedMemorySize;
  caps.max_storage_range_bytes = limits.maxStorageBufferRange;
  caps.max_texel_elements = limits.maxTexelBufferElements;
  caps.max_storage_buffers = limits.maxPerStageDescriptorStorageBuffers;
  caps.max_texel_buffers = limits.maxPerStageDescriptorSampledImages;
  caps.max_storage_images = limits.maxPerStageDescriptorStorageImages;
  caps.subgroup_size = v11.subgroupSize;
  if (has_memory_model(features.v12)) caps.matrix_products = int8_products(vk, device);
  if (!caps.matrix_products.empty()) caps.features.add(Feature::kCooperativeMatrix);
  return caps;
}

FeatureSet enabled_features(const VkDeviceCreateInfo& info) {
  // What extensions and versions call by several names is gathered under the newest one.
  Features found;
  if (info.pEnabledFeatures) found.v10.features = *info.pEnabledFeatures;
  bool matrices = false;
  for (auto* next = static_cast<const VkBaseInStructure*>(info.pNext); next; next = next->pNext) {
    switch (static_cast<int>(next->sType)) {
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2:
        found.v10.features = as<VkPhysicalDeviceFeatures2>(next).features;
        break;
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES:
        found.v11.storageBuffer16BitAccess =
            as<VkPhysicalDeviceVulkan11Features>(next).storageBuffer16BitAccess;
        break;
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_16BIT_STORAGE_FEATURES:
        found.v11.storageBuffer16BitAccess =
            as<VkPhysicalDevice16BitStorageFeatures>(next).storageBuffer16BitAccess;
        break;
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES: {
        const auto& v12 = as<VkPhysicalDeviceVulkan12Features>(next);
        found.v12.storageBuffer8BitAccess = v12.storageBuffer8BitAccess;
        found.v12.shaderInt8 = v12.shaderInt8;
        found.v12.shaderFloat16 = v12.shaderFloat16;
        found.v12.vulkanMemoryModel = v12.vulkanMemoryModel;
        found.v12.vulkanMemoryModelDeviceScope = v12.vulkanMemoryModelDeviceScope;
        break;
      }
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_8BIT_STORAGE_FEATURES:
        found.v12.storageBuffer8BitAccess =
            as<VkPhysicalDevice8BitStorageFeatures>(next).storageBuffer8BitAccess;
        break;
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES: {
        const auto& types = as<VkPhysicalDeviceShaderFloat16Int8Features>(next);
        found.v12.shaderInt8 = types.shaderInt8;
        found.v12.shaderFloat16 = types.shaderFloat16;
        break;
      }
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES: {
        const auto& model = as<VkPhysicalDeviceVulkanMemoryModelFeatures>(next);
        found.v12.vulkanMemoryModel = model.vulkanMemoryModel;
        found.v12.vulkanMemoryModelDeviceScope = model.vulkanMemoryModelDeviceScope;
        break;
      }
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES:
        found.v13.shaderIntegerDotProduct =
            as<VkPhysicalDeviceVulkan13Features>(next).shaderIntegerDotProduct;
        break;
      case VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_INTEGER_DOT_PRODUCT_FEATURES:
        found.v13.shaderIntegerDotProduct =
            as<VkPhysicalDeviceShaderIntegerDotProductFeatures>(next).shaderIntegerDotProduct;
        break;
      case static_cast<int>(CooperativeMatrixFeatures{}.type):
        matrices = as<CooperativeMatrixFeatures>(next).cooperative_matrix;
        break;
      default: break;
    }
  }
  FeatureSet features;
  for (const FeatureMember& row : kFeatureMembers)
    if (row.member(found)) features.add(row.feature);
  if (matrices && has_memory_model(found.v12)) features.add(Feature::kCooperativeMatrix);
  return features;
}

std::optional<uint32_t> choose_queue_family(std::span<const VkQueueFamilyProperties> families) {
  std::optional<uint32_t> chosen;
  for (uint32_t i = 0; i < families.size(); ++i) {
    if (!(families[i].queueFlags & VK_QUEUE_COMPUTE_BIT)) continue;
    if (!(families[i].queueFlags & VK_QUEUE_GRAPHICS_BIT)) return i;
    if (!chosen) chosen = i;
  }
  return chosen;
}

Result<Context> wrap_device(const HostDevice& host) {
  if (host.physical_device == VK_NULL_HANDLE) return bad_input("", "no physical device is given");
  Context context;
  SHALE_TRY(context.vk, load_instance_functions(host.instance, host.get_instance_proc_addr));
  SHALE_TRY_VOID(load_device_functions(context.vk, host.device, host.get_device_proc_addr));
  const Functions& vk = context.vk;
  VkPhysicalDeviceProperties properties;
  vk.GetPhysicalDeviceProperties(host.physical_device, &properties);
  if (properties.apiVersion < VK_API_VERSION_1_3)
    return device_error(properties.deviceName, "supports Vulkan {}.{}, expected 1.3",
                        VK_API_VERSION_MAJOR(properties.apiVersion),
                        VK_API_VERSION_MINOR(properties.apiVersion));
  const std::vector<VkQueueFamilyProperties> families = queue_families(vk, host.physical_device);
  if (host.queue_family >= families.size() ||
      !(families[host.queue_family].queueFlags & VK_QUEUE_COMPUTE_BIT))
    return device_error(properties.deviceName, "queue family {} cannot compute", host.queue_family);
  context.physical_device = host.physical_device;
  context.device = host.device;
  context.queue_family = host.queue_family;
  context.caps = snapshot_caps(host.physical_device, vk);
  context.caps.features.bits &= host.features.bits;
  context.limits = properties.limits;
  vk.GetPhysicalDeviceMemoryProperties(host.physical_device, &context.memory);
  context.timestamp_bits = families[host.queue_family].timestampValidBits;
  return context;
}

Result<Device> Device::create(VkPhysicalDevice physical_device, const Functions& vk) {
  const DeviceCaps caps = snapshot_caps(physical_device, vk);
  const std::optional<uint32_t> family = choose_queue_family(queue_families(vk, physical_device));
  if (!family) return device_error(caps.name, "has no queue that computes");

  Features enabled;
  for (const FeatureMember& row : kFeatureMembers)
    if (caps.features.has(row.feature)) row.member(enabled) = VK_TRUE;

  const float priority = 1.0f;
  auto queue_info = init<VkDeviceQueueCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO);
  queue_info.queueFamilyIndex = *family;
  queue_info.queueCount = 1;
  queue_info.pQueuePriorities = &priority;
  auto info = init<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
  info.pNext = &enabled.v10;
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue_info;
  CooperativeMatrixFeatures matrices{.next = &enabled.v10, .cooperative_matrix = VK_TRUE};
  if (caps.features.has(Feature::kCooperativeMatrix)) {
    enabled.v12.vulkanMemoryModel = enabled.v12.vulkanMemoryModelDeviceScope = VK_TRUE;
    info.pNext = &matrices;
    info.enabledExtensionCount = 1;
    info.ppEnabledExtensionNames = &kCooperativeMatrixExtension;
  }
  VkDevice device = VK_NULL_HANDLE;
  SHALE_TRY_VOID(
      check(vk.CreateDevice(physical_device, &info, nullptr, &device), "vkCreateDevice"));
  auto context = wrap_device({.instance = vk.instance,
                              .physical_device = physical_device,
                              .device = device,
                              .queue_family = *family,
                              .get_instance_proc_addr = vk.GetInstanceProcAddr,
                              .features = caps.features});
  if (!context) {
    if (const auto destroy =
            reinterpret_cast<PFN_vkDestroyDevice>(vk.GetDeviceProcAddr(device, "vkDestroyDevice")))
      destroy(device, nullptr);
    return std::move(context.error());
  }
  Device result;
  result.context_ = *std::move(context);
  result.context_.vk.GetDeviceQueue(device, *family, 0, &result.context_.queue);
  return result;
}

Device::Device(Device&& other) noexcept : context_(other.context_) {
  other.context_.device = VK_NULL_HANDLE;
}

Device& Device::operator=(Device&& other) noexcept {
  std::swap(context_, other.context_);
  return *this;
}

Device::~Device() {
  if (context_.device != VK_NULL_HANDLE) context_.vk.DestroyDevice(context_.device, nullptr);
}

}  // namespace shale::vk
