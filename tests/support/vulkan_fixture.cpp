#include "tests/support/vulkan_fixture.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <random>

#include "runtime/datagraph/dispatch.h"

namespace shale {

std::unique_ptr<VulkanTest::Gpu> VulkanTest::gpu_;

void VulkanTest::SetUpTestSuite() {
  bool validated = true;
  auto instance = vk::Instance::create({.validation = true});
  if (!instance) {
    std::printf("not validated: %s\n", instance.error().text().c_str());
    validated = false;
    instance = vk::Instance::create();
  }
  if (!instance) return;
  const char* name = std::getenv("SHALE_DEVICE");
  const auto physical = instance->find_device(name ? name : "");
  if (!physical) {
    std::printf("%s\n", physical.error().text().c_str());
    return;
  }
  vk::Device device = must(vk::Device::create(*physical, instance->functions()));
  gpu_ = std::make_unique<Gpu>(*std::move(instance), std::move(device), validated);
}

void VulkanTest::TearDownTestSuite() { gpu_.reset(); }

void VulkanTest::SetUp() {
  if (!gpu_) GTEST_SKIP() << "no Vulkan 1.3 device";
}

void VulkanTest::TearDown() {
  if (!gpu_) return;
  for (const std::string& message : validation_messages()) ADD_FAILURE() << message;
}

std::vector<std::string> VulkanTest::validation_messages() {
  return gpu_->instance.take_validation_messages();
}

std::optional<vk::Context> VulkanTest::discrete_context() {
  vk::Context discrete = context();
  VkMemoryType& type = discrete.memory.memoryTypes[0];
  if (discrete.memory.memoryTypeCount != 1 ||
      !(type.propertyFlags & VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT))
    return std::nullopt;
  type.propertyFlags &= ~VkMemoryPropertyFlags{VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
  return discrete;
}

void VulkanTest::run(const std::function<void(VkCommandBuffer)>& record) {
  must(vk::submit_and_wait(context(), [&](VkCommandBuffer commands) {
    record(commands);
    vk::memory_barrier(context(), commands, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT,
                       VK_ACCESS_MEMORY_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                       VK_ACCESS_HOST_READ_BIT);
  }));
}

vk::Buffer VulkanTest::buffer_of(std::span<const uint8_t> bytes) {
  vk::Buffer buffer = must(vk::Buffer::create(context(), padded_bytes(bytes.size()),
                                              kTensorBufferUsage, vk::MemoryKind::kReadback));
  std::copy(bytes.begin(), bytes.end(), buffer.mapped().begin());
  return buffer;
}

vk::Buffer VulkanTest::buffer_of(const std::vector<int8_t>& values) {
  return buffer_of({reinterpret_cast<const uint8_t*>(values.data()), values.size()});
}

std::vector<int8_t> VulkanTest::int8_values(const vk::Buffer& buffer, size_t count) {
  std::vector<int8_t> values(count);
  std::memcpy(values.data(), buffer.mapped().data(), count);
  return values;
}

vk::Image VulkanTest::image_of(ImageFormat format, VkExtent2D extent,
                               std::span<const uint8_t> texels) {
  vk::Image image = must(vk::Image::create(
      context(), format, extent, VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT));
  const vk::Buffer staging = buffer_of(texels.empty() ? std::vector<uint8_t>(4)
                                                      : std::vector(texels.begin(), texels.end()));
  run([&](VkCommandBuffer commands) {
    auto barrier = vk::init<VkImageMemoryBarrier>(VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER);
    barrier.dstAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    barrier.oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
    barrier.newLayout = VK_IMAGE_LAYOUT_GENERAL;
    barrier.srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.image = image.get();
    barrier.subresourceRange = vk::kWholeImage;
    vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                         VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0, nullptr, 0, nullptr, 1, &barrier);
    if (texels.empty()) return;
    VkBufferImageCopy region{};
    region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
    region.imageExtent = {extent.width, extent.height, 1};
    vkCmdCopyBufferToImage(commands, staging.get(), image.get(), VK_IMAGE_LAYOUT_GENERAL, 1,
                           &region);
  });
  return image;
}

std::vector<uint8_t> VulkanTest::texels_of(const vk::Image& image, ImageFormat format) {
  const VkExtent2D extent = image.extent();
  const size_t size = size_t{extent.width} * extent.height * image_format_info(format).texel_bytes;
  const vk::Buffer buffer = buffer_of(std::vector<uint8_t>(size));
  run([&](VkCommandBuffer commands) {
    VkBufferImageCopy region{};
    region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
    region.imageExtent = {extent.width, extent.height, 1};
    vkCmdCopyImageToBuffer(commands, image.get(), VK_IMAGE_LAYOUT_GENERAL, buffer.get(), 1,
                           &region);
  });
  const auto bytes = buffer.mapped().first(size);
  return {bytes.begin(), bytes.end()};
}

std::vector<uint8_t> random_bytes(size_t count, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<uint8_t> bytes(count);
  for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random());
  return bytes;
}

std::vector<int8_t> random_int8(size_t count, uint64_t seed) {
  const std::vector<uint8_t> bytes = random_bytes(count, seed);
  std::vector<int8_t> values(count);
  std::memcpy(values.data(), bytes.data(), count);
  return values;
}

}  // namespace shale
