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

bool has_int8_product(std::span<const CooperativeMatrixProduct> products, uint32_t subgroup_size) {
  return subgroup_size == 32 &&
         std::any_of(products.begin(), products.end(), [](const CooperativeMatrixProduct& p) {
           return p.m == 16 && p.n == 16 && p.k == 32 && p.a == kComponentSint8 &&
                  p.b == kComponentSint8 && p.c == kComponentSint32 &&
                  p.result == kComponentSint32 && !p.saturates && p.scope == kScopeSubgroup;
         });
}

bool supports_cooperative_matrices(const Functions& vk, VkPhysicalDevice device,
                                   uint32_t subgroup_size) {
  if (!has_extension(vk, device)) return false;
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
    return false;
  uint32_t count = 0;
  if (get_products(device, &count, nullptr) != VK_SUCCESS) return false;
  std::vector<CooperativeMatrixProduct> products(count);
  if (get_products(device, &count, products.data()) != VK_SUCCESS) return false;
  products.resize(count);
  return has_int8_product(products, subgroup_size);
}

}  // namespace shale::vk
