// runtime/vk/cooperative_matrix.h -- VK_KHR_cooperative_matrix, which Vulkan headers 1.3.239 do not
// have: the parts that are needed, under names of our own.
#pragma once

#include <vulkan/vulkan.h>

#include <cstdint>
#include <span>
#include <vector>

#include "ir/package/caps.h"
#include "runtime/vk/functions.h"

namespace shale::vk {

inline constexpr const char* kCooperativeMatrixExtension = "VK_KHR_cooperative_matrix";

/// VkPhysicalDeviceCooperativeMatrixFeaturesKHR.
struct CooperativeMatrixFeatures {
  VkStructureType type = static_cast<VkStructureType>(1000506000);
  void* next = nullptr;
  VkBool32 cooperative_matrix = VK_FALSE;
  VkBool32 robust_buffer_access = VK_FALSE;
};

/// VkPhysicalDeviceCooperativeMatrixPropertiesKHR.
struct CooperativeMatrixStages {
  VkStructureType type = static_cast<VkStructureType>(1000506002);
  void* next = nullptr;
  VkShaderStageFlags stages = 0;
};

/// VkCooperativeMatrixPropertiesKHR: a kind of product that the device has.
struct CooperativeMatrixProduct {
  VkStructureType type = static_cast<VkStructureType>(1000506001);
  void* next = nullptr;
  uint32_t m = 0, n = 0, k = 0;
  uint32_t a = 0, b = 0, c = 0, result = 0;  ///< VkComponentTypeKHR
  VkBool32 saturates = VK_FALSE;
  uint32_t scope = 0;  ///< VkScopeKHR
};
inline constexpr uint32_t kComponentSint8 = 3, kComponentSint32 = 5, kScopeSubgroup = 3;

/// Those of them that DeviceCaps::matrix_products may list.
std::vector<MatrixProduct> int8_products(std::span<const CooperativeMatrixProduct> products);

/// Asks the device; empty wherever it does not know the extension.
std::vector<MatrixProduct> int8_products(const Functions& vk, VkPhysicalDevice device);

}  // namespace shale::vk
