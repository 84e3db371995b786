#include "runtime/vk/memory.h"

#include <gtest/gtest.h>

namespace shale {
namespace {

constexpr VkMemoryPropertyFlags kLocal = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
constexpr VkMemoryPropertyFlags kMapped =
    VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
constexpr VkMemoryPropertyFlags kCached = VK_MEMORY_PROPERTY_HOST_CACHED_BIT;

VkPhysicalDeviceMemoryProperties types(std::initializer_list<VkMemoryPropertyFlags> flags) {
  VkPhysicalDeviceMemoryProperties memory{};
  for (const VkMemoryPropertyFlags f : flags)
    memory.memoryTypes[memory.memoryTypeCount++].propertyFlags = f;
  return memory;
}

TEST(ChooseMemoryType, TakesTheFirstWithAllThatIsRequired) {
  const auto discrete = types({0, kLocal, kMapped, kMapped | kCached, kMapped | kLocal});
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, 0, 0), 0u);
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, kMapped, 0), 2u);
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, kMapped | kLocal, 0), 4u);
}

TEST(ChooseMemoryType, PrefersMoreOfThePreferred) {
  const auto discrete = types({0, kLocal, kMapped, kMapped | kCached, kMapped | kLocal});
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, 0, kLocal), 1u);
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, kMapped, kCached), 3u);
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, kMapped, kLocal), 4u);
  EXPECT_EQ(vk::choose_memory_type(discrete, ~0u, kMapped, kLocal | kCached), 3u);
}

TEST(ChooseMemoryType, StaysAmongTheAllowedTypes) {
  const auto discrete = types({0, kLocal, kMapped, kMapped | kCached, kMapped | kLocal});
  EXPECT_EQ(vk::choose_memory_type(discrete, 0b00101, 0, kLocal), 0u);
  EXPECT_EQ(vk::choose_memory_type(discrete, 0b00011, kMapped, 0), std::nullopt);
  EXPECT_EQ(vk::choose_memory_type(types({}), ~0u, 0, 0), std::nullopt);
}

TEST(ChooseQueueFamily, PrefersOneThatOnlyComputes) {
  const auto family = [](VkQueueFlags flags) {
    VkQueueFamilyProperties properties{};
    properties.queueFlags = flags;
    return properties;
  };
  const std::vector<VkQueueFamilyProperties> families{
      family(VK_QUEUE_TRANSFER_BIT), family(VK_QUEUE_GRAPHICS_BIT | VK_QUEUE_COMPUTE_BIT),
      family(VK_QUEUE_COMPUTE_BIT | VK_QUEUE_TRANSFER_BIT)};
  EXPECT_EQ(vk::choose_queue_family(families), 2u);
  EXPECT_EQ(vk::choose_queue_family(std::span(families).first(2)), 1u);
  EXPECT_EQ(vk::choose_queue_family(std::span(families).first(1)), std::nullopt);
}

TEST(VkFormat, EveryImageFormatHasOne) {
  EXPECT_EQ(vk::vk_format(ImageFormat::kRgba8Unorm), VK_FORMAT_R8G8B8A8_UNORM);
  EXPECT_EQ(vk::vk_format(ImageFormat::kRgba16Float), VK_FORMAT_R16G16B16A16_SFLOAT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kRg16Float), VK_FORMAT_R16G16_SFLOAT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kR32Float), VK_FORMAT_R32_SFLOAT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kR8Unorm), VK_FORMAT_R8_UNORM);
  EXPECT_EQ(vk::vk_format(ImageFormat::kR32Uint), VK_FORMAT_R32_UINT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kRgba32Float), VK_FORMAT_R32G32B32A32_SFLOAT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kR16Float), VK_FORMAT_R16_SFLOAT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kRgba8Sint), VK_FORMAT_R8G8B8A8_SINT);
  EXPECT_EQ(vk::vk_format(ImageFormat::kR8Sint), VK_FORMAT_R8_SINT);
}

}  // namespace
}  // namespace shale
