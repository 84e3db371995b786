#include "runtime/vk/cooperative_matrix.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "runtime/vk/handle.h"

namespace shale::vk {
namespace {

using GetProducts = VkResult(VKAPI_PTR*)(VkPhysicalDevice, uint32_t* count,
                                         CooperativeMatrixProduct* products);

bool has_extension(const Functions& vk, VkPhysicalDevice device) {
  uint32_t count = 0;
  vk.EnumerateDeviceExtensionProperties(device, nullptr, &count, nullptr);
  std::vector<VkExtensionProperties> extensions(count);
  vk.EnumerateDeviceExtensionProperties(device, nullptr, &count, extensions.data());
  return std::any_of(extensions.begin(), extensions.end(), [](const VkExtensionProperties& each) {
    return std::strcmp(each.extensionName, kCooperativeMatrixExtension) == 0;
  });
}

}  // namespace

std::vector<MatrixProduct> int8_products(std::span<const CooperativeMatrixProduct> products) {
  std::vector<MatrixProduct> found;
  for (const CooperativeMatrixProduct& p : products)
    if (p.a == kComponentSint8 && p.b == kComponentSint8 && p.c == kComponentSint32 &&
        p.result == kComponentSint32 && !p.saturates && p.scope == kScopeSubgroup)
      found.push_back({p.m, p.n, p.k});
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

std::vector<MatrixProduct> int8_products(const Functions& vk, VkPhysicalDevice device) {
  if (!has_extension(vk, device)) return {};
  CooperativeMatrixFeatures matrices;
  auto features = init<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2);
  features.pNext = &matrices;
  vk.GetPhysicalDeviceFeatures2(device, &features);
  CooperativeMatrixStages stages;
  auto properties =
      init<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  properties.pNext = &stages;
  vk.GetPhysicalDeviceProperties2(device, &properties);
  const auto get_products = reinterpret_cast<GetProducts>(
      vk.GetInstanceProcAddr(vk.instance, "vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR"));
  if (!matrices.cooperative_matrix || !(stages.stages & VK_SHADER_STAGE_COMPUTE_BIT) ||
      !get_products)
    return {};
  uint32_t count = 0;
  if (get_products(device, &count, nullptr) != VK_SUCCESS) return {};
  std::vector<CooperativeMatrixProduct> products(count);
  if (get_products(device, &count, products.data()) != VK_SUCCESS) return {};
  products.resize(count);
  return int8_products(products);
}

}  // namespace shale::vk
