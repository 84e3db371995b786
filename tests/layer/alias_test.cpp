// Images and tensors on the same memory: what one writes the other reads.
#include <cstring>

#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

constexpr uint32_t kWidth = 13, kHeight = 7, kTexelBytes = 4;

const char* kTable = R"(
graph main {
  input %x : i8[1,7,13,4]
  const %t : i8[256] = [TABLE]
  %y = table %x, %t : i8[1,7,13,4]
  return %y
}
)";

class AliasLayerTest : public LayerTest {
 protected:
  VkImage image_on(VkDeviceMemory memory, VkFormat format) const {
    VkImageCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
    info.imageType = VK_IMAGE_TYPE_2D;
    info.format = format;
    info.extent = {kWidth, kHeight, 1};
    info.mipLevels = info.arrayLayers = 1;
    info.samples = VK_SAMPLE_COUNT_1_BIT;
    info.tiling = VK_IMAGE_TILING_OPTIMAL;
    info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT |
                 VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM;
    VkImage image = VK_NULL_HANDLE;
    EXPECT_EQ(vkCreateImage(client.device, &info, nullptr, &image), VK_SUCCESS);
    EXPECT_EQ(vkBindImageMemory(client.device, image, memory, 0), VK_SUCCESS);
    return image;
  }
  static void layout(VkCommandBuffer commands, VkImage image, VkImageLayout from, VkImageLayout to,
                     VkTensorARM tensor) {
    VkTensorMemoryBarrierARM alias{};
    alias.sType = VK_STRUCTURE_TYPE_TENSOR_MEMORY_BARRIER_ARM;
    alias.srcStageMask = alias.dstStageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT;
    alias.srcAccessMask = VK_ACCESS_2_MEMORY_WRITE_BIT;
    alias.dstAccessMask = VK_ACCESS_2_MEMORY_READ_BIT | VK_ACCESS_2_MEMORY_WRITE_BIT;
    alias.srcQueueFamilyIndex = alias.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    alias.tensor = tensor;
    VkImageMemoryBarrier2 barrier{};
    barrier.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2;
    barrier.srcStageMask = barrier.dstStageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT;
    barrier.srcAccessMask = alias.srcAccessMask;
    barrier.dstAccessMask = alias.dstAccessMask;
    barrier.oldLayout = from;
    barrier.newLayout = to;
    barrier.srcQueueFamilyIndex = barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.image = image;
    barrier.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
    VkDependencyInfo info{};
    info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
    info.pNext = &alias;
    info.imageMemoryBarrierCount = 1;
    info.pImageMemoryBarriers = &barrier;
    vkCmdPipelineBarrier2(commands, &info);
  }
};

TEST_F(AliasLayerTest, AGraphReadsAndWritesImages) {
  std::string table;
  for (int i = 0; i < 256; ++i) table += (i ? "," : "") + std::to_string((i * 37) % 251 - 125);
  std::string text = kTable;
  const Graph graph = graph_of(text.replace(text.find("TABLE"), 5, table));
  client.more_usage = VK_TENSOR_USAGE_IMAGE_ALIASING_BIT_ARM;
  client.more_bytes = 4096;  // an image may ask for more than its rows
  ClientRun run;
  ASSERT_EQ(run.create(client, graph, {.tiling = VK_TENSOR_TILING_OPTIMAL_ARM}), VK_SUCCESS)
      << client.last_message;
  const VkImage images[] = {image_on(run.tensors[0].memory, VK_FORMAT_R8G8B8A8_UNORM),
                            image_on(run.tensors[1].memory, VK_FORMAT_R8G8B8A8_SNORM)};
  const HostBuffer host =
      host_buffer(kWidth * kHeight * kTexelBytes,
                  VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT);
  ASSERT_TRUE(host.mapped);
  const VkBuffer buffer = host.buffer;
  const std::vector<Tensor> inputs = random_inputs(graph, 1);
  std::memcpy(host.mapped, inputs[0].bytes.data(), inputs[0].bytes.size());
  const auto record = [&](VkCommandBuffer commands) {
    VkBufferImageCopy region{};
    region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
    region.imageExtent = {kWidth, kHeight, 1};
    layout(commands, images[0], VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
           run.tensors[0].tensor);
    vkCmdCopyBufferToImage(commands, buffer, images[0], VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1,
                           &region);
    layout(commands, images[0], VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
           VK_IMAGE_LAYOUT_TENSOR_ALIASING_ARM, run.tensors[0].tensor);
    layout(commands, images[1], VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_TENSOR_ALIASING_ARM,
           run.tensors[1].tensor);
    client_record_graph(&client, commands, &run.graph);
    layout(commands, images[1], VK_IMAGE_LAYOUT_TENSOR_ALIASING_ARM,
           VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, run.tensors[1].tensor);
    vkCmdCopyImageToBuffer(commands, images[1], VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, buffer, 1,
                           &region);
  };
  ASSERT_EQ(client_submit(
                &client,
                [](VkCommandBuffer commands, void* user) {
                  (*static_cast<const decltype(record)*>(user))(commands);
                },
                const_cast<void*>(static_cast<const void*>(&record))),
            VK_SUCCESS)
      << client.last_message;
  const std::vector<Tensor> expected = must(interpret(graph, inputs));
  EXPECT_EQ(std::memcmp(host.mapped, expected[0].bytes.data(), expected[0].bytes.size()), 0);
  for (const VkImage image : images) vkDestroyImage(client.device, image, nullptr);
}

TEST_F(AliasLayerTest, FormatsAndImagesTellThatTheyCan) {
  VkPhysicalDeviceImageFormatInfo2 info{};
  info.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_IMAGE_FORMAT_INFO_2;
  info.format = VK_FORMAT_R8G8B8A8_UNORM;
  info.type = VK_IMAGE_TYPE_2D;
  info.tiling = VK_IMAGE_TILING_OPTIMAL;
  info.usage = VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM;
  VkImageFormatProperties2 limits{};
  limits.sType = VK_STRUCTURE_TYPE_IMAGE_FORMAT_PROPERTIES_2;
  EXPECT_EQ(vkGetPhysicalDeviceImageFormatProperties2(client.physical, &info, &limits), VK_SUCCESS);
  VkFormatProperties3 features{};
  features.sType = VK_STRUCTURE_TYPE_FORMAT_PROPERTIES_3;
  VkFormatProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_FORMAT_PROPERTIES_2;
  properties.pNext = &features;
  vkGetPhysicalDeviceFormatProperties2(client.physical, VK_FORMAT_R8G8B8A8_UNORM, &properties);
  EXPECT_TRUE(features.optimalTilingFeatures & VK_FORMAT_FEATURE_2_TENSOR_IMAGE_ALIASING_BIT_ARM);
}

}  // namespace
}  // namespace shale
