#include "runtime/vk/device.h"

#include <array>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>

#include "ir/base/file.h"
#include "runtime/vk/cooperative_matrix.h"
#include "runtime/vk/pipeline_cache.h"
#include "runtime/vk/processor.h"
#include "runtime/vk/timestamps.h"
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

TEST(Processor, FollowsMesasOverride) {
  constexpr const char* kName = "GALLIUM_OVERRIDE_CPU_CAPS";
  const char* set = std::getenv(kName);
  const std::optional<std::string> before = set ? std::optional<std::string>(set) : std::nullopt;
  unsetenv(kName);
  const Processor own = vk::driver_processor();
  EXPECT_NE(own, Processor::kUnknown);
  setenv(kName, "avx", 1);
  EXPECT_EQ(vk::driver_processor(), own == Processor::kAvx512 ? Processor::kAvx2 : own);
  for (const char* less : {"nosse", "sse", "ssse3", "sse4.1"}) {
    setenv(kName, less, 1);
    EXPECT_EQ(vk::driver_processor(), own == Processor::kNeon ? own : Processor::kSse) << less;
  }
  before ? setenv(kName, before->c_str(), 1) : unsetenv(kName);
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

vk::HostDevice host_of(const vk::Context& context) {
  return {.instance = context.vk.instance,
          .physical_device = context.physical_device,
          .device = context.device,
          .queue_family = context.queue_family,
          .get_instance_proc_addr = context.vk.GetInstanceProcAddr,
          .features = context.caps.features};
}

TEST_F(Device, HostsBringTheirDevice) {
  const vk::Context wrapped = must(vk::wrap_device(host_of(context())));
  EXPECT_EQ(wrapped.device, context().device);
  EXPECT_EQ(wrapped.queue, nullptr);
  EXPECT_EQ(wrapped.caps.name, context().caps.name);
  EXPECT_EQ(wrapped.caps.features, context().caps.features);
  EXPECT_EQ(wrapped.vk.QueueSubmit, context().vk.QueueSubmit);
  vk::HostDevice host = host_of(context());
  host.features = {};
  host.get_device_proc_addr = context().vk.GetDeviceProcAddr;
  EXPECT_EQ(must(vk::wrap_device(host)).caps.features, FeatureSet{});
}

TEST_F(Device, HostsMustBringAllOfIt) {
  struct Row {
    void (*change)(vk::HostDevice&);
    const char* message;
  };
  for (const Row& row : {
           Row{[](vk::HostDevice& h) { h.queue_family = 1000; },
               "queue family 1000 cannot compute"},
           Row{[](vk::HostDevice& h) { h.instance = nullptr; }, "no instance is given"},
           Row{[](vk::HostDevice& h) { h.physical_device = nullptr; },
               "no physical device is given"},
           Row{[](vk::HostDevice& h) { h.device = nullptr; }, "no device is given"},
           Row{[](vk::HostDevice& h) { h.get_instance_proc_addr = nullptr; },
               "no vkGetInstanceProcAddr is given"},
           Row{[](vk::HostDevice& h) {
                 h.get_instance_proc_addr = [](VkInstance, const char*) {
                   return PFN_vkVoidFunction{};
                 };
               },
               "the Vulkan instance has no vkCreateDevice"},
           Row{[](vk::HostDevice& h) {
                 h.get_device_proc_addr = [](VkDevice, const char*) {
                   return PFN_vkVoidFunction{};
                 };
               },
               "the Vulkan device has no vkAllocateCommandBuffers"},
       }) {
    vk::HostDevice host = host_of(context());
    row.change(host);
    const auto wrapped = vk::wrap_device(host);
    ASSERT_FALSE(wrapped) << row.message;
    EXPECT_EQ(wrapped.error().message, row.message);
  }
}

TEST(EnabledFeatures, AreFoundUnderAllTheirNames) {
  VkDeviceCreateInfo info = vk::init<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
  EXPECT_EQ(vk::enabled_features(info), FeatureSet{});
  const auto set = [](std::initializer_list<Feature> features) {
    FeatureSet result;
    for (const Feature feature : features) result.add(feature);
    return result;
  };
  VkPhysicalDeviceFeatures core{};
  core.shaderInt64 = VK_TRUE;
  core.shaderStorageImageExtendedFormats = VK_TRUE;
  info.pEnabledFeatures = &core;
  EXPECT_EQ(vk::enabled_features(info), set({Feature::kInt64, Feature::kStorageImageExtended}));
  info.pEnabledFeatures = nullptr;

  auto v10 = vk::init<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2);
  auto v11 = vk::init<VkPhysicalDeviceVulkan11Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES);
  auto v12 = vk::init<VkPhysicalDeviceVulkan12Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES);
  auto v13 = vk::init<VkPhysicalDeviceVulkan13Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES);
  vk::CooperativeMatrixFeatures matrices;
  v10.features.shaderFloat64 = v10.features.shaderInt16 = VK_TRUE;
  v11.storageBuffer16BitAccess = VK_TRUE;
  v12.storageBuffer8BitAccess = v12.shaderInt8 = v12.shaderFloat16 = VK_TRUE;
  v13.shaderIntegerDotProduct = VK_TRUE;
  matrices.cooperative_matrix = VK_TRUE;
  info.pNext = &v10;
  v10.pNext = &v11;
  v11.pNext = &v12;
  v12.pNext = &v13;
  v13.pNext = &matrices;
  const FeatureSet most =
      set({Feature::kFloat64, Feature::kInt16, Feature::kStorageBuffer16, Feature::kStorageBuffer8,
           Feature::kInt8, Feature::kFloat16, Feature::kDotProduct8});
  EXPECT_EQ(vk::enabled_features(info), most);  // matrices need the memory model, too
  v12.vulkanMemoryModel = VK_TRUE;
  EXPECT_EQ(vk::enabled_features(info), most);  // and its device scope
  v12.vulkanMemoryModelDeviceScope = VK_TRUE;
  FeatureSet all = most;
  all.add(Feature::kCooperativeMatrix);
  EXPECT_EQ(vk::enabled_features(info), all);

  auto storage16 = vk::init<VkPhysicalDevice16BitStorageFeatures>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_16BIT_STORAGE_FEATURES);
  auto storage8 = vk::init<VkPhysicalDevice8BitStorageFeatures>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_8BIT_STORAGE_FEATURES);
  auto types = vk::init<VkPhysicalDeviceShaderFloat16Int8Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES);
  auto dots = vk::init<VkPhysicalDeviceShaderIntegerDotProductFeatures>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_INTEGER_DOT_PRODUCT_FEATURES);
  auto model = vk::init<VkPhysicalDeviceVulkanMemoryModelFeatures>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES);
  storage16.storageBuffer16BitAccess = storage8.storageBuffer8BitAccess = types.shaderInt8 =
      types.shaderFloat16 = dots.shaderIntegerDotProduct = model.vulkanMemoryModel =
          model.vulkanMemoryModelDeviceScope = VK_TRUE;
  v10.pNext = &storage16;
  storage16.pNext = &storage8;
  storage8.pNext = &types;
  types.pNext = &dots;
  dots.pNext = &model;
  model.pNext = &matrices;
  EXPECT_EQ(vk::enabled_features(info), all);
}

TEST_F(Device, UploadReachesTheDeviceAndIsPaddedWithZeros) {
  const std::optional<vk::Context> discrete = discrete_context();
  for (const vk::Context* place : {&context(), discrete ? &*discrete : nullptr}) {
    if (!place) GTEST_SKIP() << "needs a device with a single memory type";
    const std::vector<uint8_t> bytes = random_bytes(1000, 3);
    const vk::Upload source =
        must(vk::upload(*place, bytes, 1024, VK_BUFFER_USAGE_TRANSFER_SRC_BIT));
    EXPECT_TRUE(place == &context() || source.staging);
    EXPECT_NE(source.buffer.mapped().empty(), !source.staging);
    EXPECT_GE(source.buffer.memory_bytes(), 1024u);
    const vk::Buffer target = buffer_of(std::vector<uint8_t>(1024, 0xff));
    run([&](VkCommandBuffer commands) {
      if (source.staging) {
        vk::record_upload(*place, commands, source);
        vk::memory_barrier(*place, commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                           VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT,
                           VK_ACCESS_TRANSFER_READ_BIT);
      }
      const VkBufferCopy region{0, 0, 1024};
      vkCmdCopyBuffer(commands, source.buffer.get(), target.get(), 1, &region);
    });
    std::vector<uint8_t> expected = bytes;
    expected.resize(1024);
    EXPECT_TRUE(std::equal(expected.begin(), expected.end(), target.mapped().begin()));
  }
}

TEST_F(Device, TooManyMarksAreAnError) {
  auto timestamps = must(vk::Timestamps::create(context(), 2));
  EXPECT_EQ(timestamps.intervals(), 2u);
  const auto marks = [&](int count) {
    run([&](VkCommandBuffer commands) {
      timestamps.start(commands);
      for (int i = 0; i < count; ++i) timestamps.mark(commands);
    });
  };
  marks(3);
  EXPECT_EQ(error_text(timestamps.read_us()), "3 intervals were marked, the timestamps hold 2");
  marks(2);
  EXPECT_EQ(must(timestamps.read_us()).size(), 2u);
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
