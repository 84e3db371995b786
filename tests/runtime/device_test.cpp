#include "runtime/vk/device.h"

#include <array>
#include <cstdio>

#include "ir/base/file.h"
#include "runtime/vk/cooperative_matrix.h"
#include "runtime/vk/pipeline_cache.h"
#include "tests/support/vulkan_fixture.h"

namespace shale {
namespace {

class Device : public VulkanTest {};

TEST_F(Device, CapsAreFilled) {
  const DeviceCaps& caps = context().caps;
  EXPECT_FALSE(caps.name.empty());
  EXPECT_FALSE(caps.driver.empty());
  EXPECT_GE(caps.api_version, VK_API_VERSION_1_3);
  EXPECT_GE(caps.max_workgroup_invocations, 128u);
  EXPECT_GE(caps.max_workgroup_size[0], 128u);
  EXPECT_GE(caps.max_workgroup_count[2], kMaxWorkgroups);
  EXPECT_GE(caps.max_shared_bytes, 16384u);
  EXPECT_GE(caps.max_storage_range_bytes, uint64_t{1} << 27);
  EXPECT_GE(caps.max_texel_elements, 65536u);
  EXPECT_GE(caps.max_storage_buffers, 4u);
  EXPECT_GE(caps.max_texel_buffers, 16u);
  EXPECT_GE(caps.max_storage_images, 4u);
  EXPECT_GE(caps.subgroup_size, 1u);
}

TEST(CooperativeMatrix, ProductsOfInt8InSubgroupsCount) {
  const vk::CooperativeMatrixProduct wanted{.m = 16,
                                            .n = 16,
                                            .k = 32,
                                            .a = vk::kComponentSint8,
                                            .b = vk::kComponentSint8,
                                            .c = vk::kComponentSint32,
                                            .result = vk::kComponentSint32,
                                            .scope = vk::kScopeSubgroup};
  vk::CooperativeMatrixProduct other = wanted;
  other.k = 16;
  // Ascending, each once.
  EXPECT_EQ(vk::int8_products(std::array{wanted, other, wanted}),
            (std::vector<MatrixProduct>{{16, 16, 16}, {16, 16, 32}}));
  EXPECT_EQ(vk::int8_products(std::span<const vk::CooperativeMatrixProduct>()),
            std::vector<MatrixProduct>());
  for (uint32_t vk::CooperativeMatrixProduct::*member :
       {&vk::CooperativeMatrixProduct::a, &vk::CooperativeMatrixProduct::b,
        &vk::CooperativeMatrixProduct::c, &vk::CooperativeMatrixProduct::result,
        &vk::CooperativeMatrixProduct::saturates, &vk::CooperativeMatrixProduct::scope}) {
    vk::CooperativeMatrixProduct changed = wanted;
    changed.*member += 1;
    EXPECT_EQ(vk::int8_products(std::array{changed}), std::vector<MatrixProduct>());
  }
}

TEST_F(Device, NoDeviceOfThatNameIsAnError) {
  const auto instance = must(vk::Instance::create());
  const auto found = instance.find_device("no such device");
  ASSERT_FALSE(found);
  EXPECT_EQ(found.error().code, ErrorCode::kDevice);
  EXPECT_NE(found.error().message.find(context().caps.name), std::string::npos);
}

TEST_F(Device, HostFamilyMustCompute) {
  const auto wrapped =
      vk::wrap_device(context().physical_device, context().device, 1000, context().queue, {});
  ASSERT_FALSE(wrapped);
  EXPECT_EQ(wrapped.error().message, "queue family 1000 cannot compute");
}

TEST_F(Device, UploadReachesTheDeviceAndIsPaddedWithZeros) {
  const std::vector<uint8_t> bytes = random_bytes(1000, 3);
  const vk::Buffer source =
      must(vk::upload(context(), bytes, 1024, VK_BUFFER_USAGE_TRANSFER_SRC_BIT));
  const vk::Buffer target = buffer_of(std::vector<uint8_t>(1024, 0xff));
  run([&](VkCommandBuffer commands) {
    const VkBufferCopy region{0, 0, 1024};
    vkCmdCopyBuffer(commands, source.get(), target.get(), 1, &region);
  });
  std::vector<uint8_t> expected = bytes;
  expected.resize(1024);
  EXPECT_TRUE(std::equal(expected.begin(), expected.end(), target.mapped().begin()));
}

TEST_F(Device, UploadIsStagedWhereTheHostCannotWriteDeviceMemory) {
  // The same device, as if none of its own memory were visible to the host.
  vk::Context discrete = context();
  VkPhysicalDeviceMemoryProperties& memory = discrete.memory;
  memory.memoryTypeCount = 2;
  memory.memoryTypes[1] = memory.memoryTypes[0] = context().memory.memoryTypes[0];
  memory.memoryTypes[0].propertyFlags &=
      ~VkMemoryPropertyFlags{VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
  memory.memoryTypes[1].propertyFlags = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
  if (!(memory.memoryTypes[0].propertyFlags & VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT) ||
      context().memory.memoryTypeCount != 1)
    GTEST_SKIP() << "needs a device with a single memory type";
  memory.memoryTypeCount = 1;
  const std::vector<uint8_t> bytes = random_bytes(1000, 4);
  const vk::Buffer source =
      must(vk::upload(discrete, bytes, 1024, VK_BUFFER_USAGE_TRANSFER_SRC_BIT));
  EXPECT_TRUE(source.mapped().empty());
  const vk::Buffer target = buffer_of(std::vector<uint8_t>(1024, 0xff));
  run([&](VkCommandBuffer commands) {
    const VkBufferCopy region{0, 0, 1024};
    vkCmdCopyBuffer(commands, source.get(), target.get(), 1, &region);
  });
  EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), target.mapped().begin()));
}

TEST_F(Device, PipelineCacheSurvivesItsProcess) {
  const std::string path = testing::TempDir() + "shale_device_test.cache";
  std::remove(path.c_str());
  {
    const auto cache = must(vk::PipelineCache::load(context(), path));
    EXPECT_FALSE(cache.ignored().empty());
    must(cache.save());
  }
  EXPECT_EQ(must(vk::PipelineCache::load(context(), path)).ignored(), "");
  std::vector<uint8_t> bytes = must(read_file(path));
  bytes.back() ^= 1;
  must(write_file(path, bytes));
  {
    const auto cache = must(vk::PipelineCache::load(context(), path));
    EXPECT_NE(cache.ignored().find("the cache file is damaged"), std::string::npos);
    must(cache.save());
  }
  EXPECT_EQ(must(vk::PipelineCache::load(context(), path)).ignored(), "");
  std::remove(path.c_str());
}

}  // namespace
}  // namespace shale
