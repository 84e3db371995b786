// VK_ARM_tensors: what is reported, layouts, memory, views, copies, names.
#include <algorithm>
#include <cstring>
#include <random>
#include <set>
#include <string>

#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

class TensorLayerTest : public LayerTest {
 protected:
  VkTensorDescriptionARM description_of(const std::vector<int64_t>& dims,
                                        const std::vector<int64_t>& strides = {}) const {
    VkTensorDescriptionARM description{};
    description.sType = VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM;
    description.tiling = VK_TENSOR_TILING_LINEAR_ARM;
    description.format = VK_FORMAT_R16_SINT;
    description.dimensionCount = static_cast<uint32_t>(dims.size());
    description.pDimensions = dims.data();
    description.pStrides = strides.empty() ? nullptr : strides.data();
    description.usage = VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM | VK_TENSOR_USAGE_TRANSFER_SRC_BIT_ARM |
                        VK_TENSOR_USAGE_TRANSFER_DST_BIT_ARM;
    return description;
  }
  VkResult create(const VkTensorDescriptionARM& description, VkTensorARM* tensor,
                  const VkAllocationCallbacks* allocator = nullptr) const {
    VkTensorCreateInfoARM info{};
    info.sType = VK_STRUCTURE_TYPE_TENSOR_CREATE_INFO_ARM;
    info.pDescription = &description;
    return client.CreateTensorARM(client.device, &info, allocator, tensor);
  }
};

TEST_F(TensorLayerTest, ReportsWhatTheExtensionsDemand) {
  VkPhysicalDeviceTensorPropertiesARM tensors{};
  tensors.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_PROPERTIES_ARM;
  VkPhysicalDeviceVulkan12Properties v12{};
  v12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES;
  tensors.pNext = &v12;
  VkPhysicalDeviceProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
  properties.pNext = &tensors;
  vkGetPhysicalDeviceProperties2(client.physical, &properties);
  EXPECT_GE(tensors.maxTensorDimensionCount, 6u);
  EXPECT_GE(tensors.maxTensorElements, 65536u);
  EXPECT_GE(tensors.maxPerDimensionTensorElements, 65536u);
  EXPECT_GE(tensors.maxTensorStride, 65536);
  EXPECT_GE(tensors.maxTensorSize, 65536u);
  EXPECT_GE(tensors.maxDescriptorSetStorageTensors, 16u);
  EXPECT_EQ(properties.pNext, &tensors);  // the chain is as it was
  EXPECT_EQ(tensors.pNext, &v12);
  EXPECT_NE(v12.driverName[0], '\0') << "what follows in the chain is filled too";

  VkPhysicalDeviceDataGraphFeaturesARM graphs{};
  graphs.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM;
  VkPhysicalDeviceFeatures2 features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
  features.pNext = &graphs;
  vkGetPhysicalDeviceFeatures2(client.physical, &features);
  EXPECT_TRUE(graphs.dataGraph && graphs.dataGraphShaderModule);

  for (const VkFormat format : {VK_FORMAT_R8_SINT, VK_FORMAT_R8_UINT, VK_FORMAT_R16_SINT,
                                VK_FORMAT_R32_SINT, VK_FORMAT_R64_SINT, VK_FORMAT_R8_BOOL_ARM}) {
    VkTensorFormatPropertiesARM tiling{};
    tiling.sType = VK_STRUCTURE_TYPE_TENSOR_FORMAT_PROPERTIES_ARM;
    VkFormatProperties2 of_format{};
    of_format.sType = VK_STRUCTURE_TYPE_FORMAT_PROPERTIES_2;
    of_format.pNext = &tiling;
    vkGetPhysicalDeviceFormatProperties2(client.physical, format, &of_format);
    for (const VkFormatFeatureFlags2 found :
         {tiling.optimalTilingTensorFeatures, tiling.linearTilingTensorFeatures}) {
      EXPECT_TRUE(found & VK_FORMAT_FEATURE_2_TENSOR_DATA_GRAPH_BIT_ARM) << format;
      EXPECT_TRUE(found & VK_FORMAT_FEATURE_2_TRANSFER_SRC_BIT) << format;
      EXPECT_TRUE(found & VK_FORMAT_FEATURE_2_TRANSFER_DST_BIT) << format;
    }
  }
}

TEST_F(TensorLayerTest, QueueFamiliesTellTheirOperations) {
  const auto query = reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM>(
      vkGetInstanceProcAddr(client.instance,
                            "vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM"));
  const auto operation =
      reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM>(
          vkGetInstanceProcAddr(
              client.instance,
              "vkGetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM"));
  const auto engine =
      reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphProcessingEnginePropertiesARM>(
          vkGetInstanceProcAddr(
              client.instance,
              "vkGetPhysicalDeviceQueueFamilyDataGraphProcessingEnginePropertiesARM"));
  ASSERT_TRUE(query && operation && engine);
  uint32_t count = 0;
  ASSERT_EQ(query(client.physical, client.family, &count, nullptr), VK_SUCCESS);
  ASSERT_GE(count, 1u);
  ASSERT_LE(count, 2u);  // where the device can write its images, optical flow, too
  const uint32_t all = count;
  VkQueueFamilyDataGraphPropertiesARM several[3]{};
  for (VkQueueFamilyDataGraphPropertiesARM& each : several)
    each.sType = VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_PROPERTIES_ARM;
  const VkQueueFamilyDataGraphPropertiesARM& properties = several[0];
  count = 0;
  EXPECT_EQ(query(client.physical, client.family, &count, several), VK_INCOMPLETE);
  count = 3;
  ASSERT_EQ(query(client.physical, client.family, &count, several), VK_SUCCESS);
  EXPECT_EQ(count, all);
  EXPECT_STREQ(properties.operation.name, "TOSA.001000.1");
  EXPECT_EQ(properties.operation.version, 0u);
  EXPECT_FALSE(properties.engine.isForeign);

  VkQueueFamilyDataGraphTOSAPropertiesARM tosa{};
  tosa.sType = VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_TOSA_PROPERTIES_ARM;
  ASSERT_EQ(operation(client.physical, client.family, &properties,
                      reinterpret_cast<VkBaseOutStructure*>(&tosa)),
            VK_SUCCESS);
  ASSERT_GE(tosa.profileCount, 1u);
  EXPECT_STREQ(tosa.pProfiles[0].name, "PRO-INT");
  std::set<std::string> extensions;
  for (uint32_t i = 0; i < tosa.extensionCount; ++i) extensions.insert(tosa.pExtensions[i].name);
  EXPECT_EQ(extensions,
            (std::set<std::string>{"EXT-BF16", "EXT-DOUBLEROUND", "EXT-FFT", "EXT-FP8E4M3",
                                   "EXT-FP8E5M2", "EXT-INT16", "EXT-INT4"}));
  EXPECT_EQ(tosa.level, VK_DATA_GRAPH_TOSA_LEVEL_8K_ARM);

  VkPhysicalDeviceQueueFamilyDataGraphProcessingEngineInfoARM which{};
  which.sType =
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_QUEUE_FAMILY_DATA_GRAPH_PROCESSING_ENGINE_INFO_ARM;
  which.queueFamilyIndex = client.family;
  VkQueueFamilyDataGraphProcessingEnginePropertiesARM foreign{};
  foreign.sType = VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_PROCESSING_ENGINE_PROPERTIES_ARM;
  foreign.foreignMemoryHandleTypes = 7;
  engine(client.physical, &which, &foreign);
  EXPECT_EQ(foreign.foreignMemoryHandleTypes, 0u);
}

/// A device of one queue, without extensions.
VkResult create_device(const Client& client, const void* next, VkDevice* device) {
  const float priority = 1;
  VkDeviceQueueCreateInfo queue{};
  queue.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO;
  queue.queueFamilyIndex = client.family;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  VkDeviceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO;
  info.pNext = next;
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  return vkCreateDevice(client.physical, &info, nullptr, device);
}

TEST_F(TensorLayerTest, FunctionsAreThereOnlyWhereTheExtensionIsEnabled) {
  VkDevice plain;
  ASSERT_EQ(create_device(client, nullptr, &plain), VK_SUCCESS);
  EXPECT_EQ(vkGetDeviceProcAddr(plain, "vkCreateTensorARM"), nullptr);
  EXPECT_EQ(vkGetDeviceProcAddr(plain, "vkCmdDispatchDataGraphARM"), nullptr);
  EXPECT_NE(vkGetDeviceProcAddr(plain, "vkCmdDispatch"), nullptr);
  vkDestroyDevice(plain, nullptr);
}

TEST_F(TensorLayerTest, RefusesFeaturesThatItDoesNotReport) {
  VkPhysicalDeviceDataGraphFeaturesARM graphs{};
  graphs.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM;
  VkPhysicalDeviceFeatures2 features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
  features.pNext = &graphs;
  vkGetPhysicalDeviceFeatures2(client.physical, &features);
  if (graphs.dataGraphDescriptorBuffer) GTEST_SKIP() << "the device has all features";
  graphs.dataGraphDescriptorBuffer = VK_TRUE;
  VkDevice device;
  EXPECT_EQ(create_device(client, &graphs, &device), VK_ERROR_FEATURE_NOT_PRESENT);
}

TEST_F(TensorLayerTest, ChainsOfSingleFeatureStructuresAreKept) {
  // Beside Vulkan 1.2's, the structures of the extensions that it took in are not allowed.
  VkPhysicalDeviceShaderFloat16Int8Features types{};
  types.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES;
  types.shaderInt8 = VK_TRUE;
  Client other;
  ASSERT_EQ(client_open(&other, &types), VK_SUCCESS);
  client_close(&other);
  EXPECT_EQ(other.validation_messages, 0u);
}

TEST_F(TensorLayerTest, RefusesBrokenDescriptions) {
  SHALE_SKIP_IF_VALIDATED();
  struct Case {
    const char* what;
    std::vector<int64_t> dims, strides;
  };
  for (const Case& each : std::vector<Case>{
           {"no axis", {}, {}},
           {"seven axes", {1, 1, 1, 1, 1, 1, 1}, {}},
           {"an empty axis", {2, 0}, {}},
           {"a negative axis", {2, -1}, {}},
           {"more than fits", {1 << 20, 1 << 20}, {}},
           {"a product beyond 64 bits", {1 << 24, 1 << 24, 1 << 24}, {}},
           {"elements apart", {2, 2}, {8, 4}},
           {"no whole elements", {2, 2}, {5, 2}},
           {"rows that overlap", {2, 4}, {6, 2}},
           {"no stride", {2, 2}, {0, 2}},
           {"a negative stride", {2, 2}, {-4, 2}},
           {"a stride beyond the limit", {2, 2}, {int64_t{1} << 40, 2}},
       }) {
    VkTensorARM tensor;
    const uint32_t before = client.other_messages;
    EXPECT_LT(create(description_of(each.dims, each.strides), &tensor), 0) << each.what;
    EXPECT_EQ(tensor, VkTensorARM{VK_NULL_HANDLE}) << each.what;
    EXPECT_EQ(client.other_messages, before + 1) << each.what << " is told to nobody";
  }
  VkTensorARM tensor;
  const std::vector<int64_t> dims{2, 2};
  VkTensorDescriptionARM wrong = description_of(dims);
  wrong.format = VK_FORMAT_R8G8B8A8_UNORM;
  EXPECT_LT(create(wrong, &tensor), 0);
}

TEST_F(TensorLayerTest, TheLargestTensorsCanBeMade) {
  VkPhysicalDeviceTensorPropertiesARM limits{};
  limits.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_PROPERTIES_ARM;
  VkPhysicalDeviceProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
  properties.pNext = &limits;
  vkGetPhysicalDeviceProperties2(client.physical, &properties);
  const std::vector<int64_t> dims{static_cast<int64_t>(limits.maxTensorElements)};
  VkTensorDescriptionARM description = description_of(dims);
  description.format = VK_FORMAT_R64_SINT;
  VkTensorARM tensor;
  ASSERT_EQ(create(description, &tensor), VK_SUCCESS);
  VkTensorCreateInfoARM info{};
  info.sType = VK_STRUCTURE_TYPE_TENSOR_CREATE_INFO_ARM;
  info.pDescription = &description;
  VkDeviceTensorMemoryRequirementsARM early{};
  early.sType = VK_STRUCTURE_TYPE_DEVICE_TENSOR_MEMORY_REQUIREMENTS_ARM;
  early.pCreateInfo = &info;
  VkTensorMemoryRequirementsInfoARM late{};
  late.sType = VK_STRUCTURE_TYPE_TENSOR_MEMORY_REQUIREMENTS_INFO_ARM;
  late.tensor = tensor;
  VkMemoryRequirements2 before{}, after{};
  before.sType = after.sType = VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2;
  client.GetDeviceTensorMemoryRequirementsARM(client.device, &early, &before);
  client.GetTensorMemoryRequirementsARM(client.device, &late, &after);
  EXPECT_EQ(before.memoryRequirements.size, after.memoryRequirements.size);
  EXPECT_EQ(before.memoryRequirements.alignment, after.memoryRequirements.alignment);
  EXPECT_EQ(before.memoryRequirements.memoryTypeBits, after.memoryRequirements.memoryTypeBits);
  EXPECT_GE(after.memoryRequirements.size, 8 * limits.maxTensorElements);
  client.DestroyTensorARM(client.device, tensor, nullptr);
}

TEST_F(TensorLayerTest, CopiesBetweenAllKindsOfLayouts) {
  std::mt19937 random(1);
  const std::vector<std::vector<int64_t>> shapes{
      {71}, {26, 7}, {7, 4, 3}, {3, 1, 9, 5}, {2, 3, 2, 3, 2, 3}};
  for (const std::vector<int64_t>& dims : shapes) {
    std::vector<std::vector<int64_t>> layouts{{}};
    for (const int64_t padding : {13, 1}) {
      std::vector<int64_t> strides(dims.size());
      int64_t next = 2;
      for (size_t i = dims.size(); i-- > 0;) {
        strides[i] = next;
        next = next * dims[i] + 2 * padding * (i % 2 == 0);
      }
      layouts.push_back(strides);
    }
    for (const auto& from_strides : layouts)
      for (const auto& to_strides : layouts) {
        ClientTensor from, to;
        const auto rank = static_cast<uint32_t>(dims.size());
        const auto data = [](const std::vector<int64_t>& strides) {
          return strides.empty() ? nullptr : strides.data();
        };
        ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R16_SINT, VK_TENSOR_TILING_OPTIMAL_ARM,
                                       rank, dims.data(), data(from_strides), &from),
                  VK_SUCCESS);
        ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R16_SINT, VK_TENSOR_TILING_LINEAR_ARM,
                                       rank, dims.data(), data(to_strides), &to),
                  VK_SUCCESS);
        auto* source = static_cast<uint8_t*>(from.mapped);
        for (VkDeviceSize i = 0; i < from.size; ++i) source[i] = static_cast<uint8_t>(random());
        const std::pair tensors{from.tensor, to.tensor};
        struct Call {
          const Client* client;
          const decltype(tensors)* pair;
        } call{&client, &tensors};
        ASSERT_EQ(client_submit(
                      &client,
                      [](VkCommandBuffer commands, void* user) {
                        const auto* all = static_cast<const Call*>(user);
                        VkTensorCopyARM region{};
                        region.sType = VK_STRUCTURE_TYPE_TENSOR_COPY_ARM;
                        VkCopyTensorInfoARM info{};
                        info.sType = VK_STRUCTURE_TYPE_COPY_TENSOR_INFO_ARM;
                        info.srcTensor = all->pair->first;
                        info.dstTensor = all->pair->second;
                        info.regionCount = 1;
                        info.pRegions = &region;
                        all->client->CmdCopyTensorARM(commands, &info);
                      },
                      &call),
                  VK_SUCCESS);
        const auto offset_of = [&](int64_t element, const std::vector<int64_t>& strides) {
          int64_t at = 0, packed = 2;
          for (size_t i = dims.size(); i-- > 0;) {
            at += element % dims[i] * (strides.empty() ? packed : strides[i]);
            element /= dims[i];
            packed *= dims[i];
          }
          return at;
        };
        int64_t elements = 1;
        for (const int64_t size : dims) elements *= size;
        std::vector<bool> written(to.size);
        for (int64_t i = 0; i < elements; ++i) {
          const int64_t at = offset_of(i, to_strides);
          EXPECT_EQ(std::memcmp(source + offset_of(i, from_strides),
                                static_cast<uint8_t*>(to.mapped) + at, 2),
                    0)
              << i;
          written[static_cast<size_t>(at)] = written[static_cast<size_t>(at) + 1] = true;
        }
        for (size_t i = 0; i < to.size; ++i)
          if (!written[i]) {
            EXPECT_EQ(static_cast<uint8_t*>(to.mapped)[i], 0) << "between rows, " << i;
          }
        client_destroy_tensor(&client, &from);
        client_destroy_tensor(&client, &to);
      }
  }
}

TEST_F(TensorLayerTest, BadCopiesFailWhereTheRecordingEnds) {
  SHALE_SKIP_IF_VALIDATED();
  const int64_t four[] = {4}, five[] = {5};
  ClientTensor from, to;
  ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R8_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1, four,
                                 nullptr, &from),
            VK_SUCCESS);
  ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R8_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1, five,
                                 nullptr, &to),
            VK_SUCCESS);
  struct Call {
    const Client* client;
    VkTensorARM from, to;
  } call{&client, from.tensor, to.tensor};
  EXPECT_LT(client_submit(
                &client,
                [](VkCommandBuffer commands, void* user) {
                  const auto* all = static_cast<const Call*>(user);
                  VkTensorCopyARM region{};
                  region.sType = VK_STRUCTURE_TYPE_TENSOR_COPY_ARM;
                  VkCopyTensorInfoARM info{};
                  info.sType = VK_STRUCTURE_TYPE_COPY_TENSOR_INFO_ARM;
                  info.srcTensor = all->from;
                  info.dstTensor = all->to;
                  info.regionCount = 1;
                  info.pRegions = &region;
                  all->client->CmdCopyTensorARM(commands, &info);
                },
                &call),
            0);
  EXPECT_GE(client.other_messages, 1u);
  client_destroy_tensor(&client, &from);
  client_destroy_tensor(&client, &to);
}

TEST_F(TensorLayerTest, MemoryMayBeDedicatedAndIsBoundOnce) {
  SHALE_SKIP_IF_VALIDATED();
  const std::vector<int64_t> dims{3, 5};
  VkTensorARM tensor;
  ASSERT_EQ(create(description_of(dims), &tensor), VK_SUCCESS);
  VkTensorMemoryRequirementsInfoARM which{};
  which.sType = VK_STRUCTURE_TYPE_TENSOR_MEMORY_REQUIREMENTS_INFO_ARM;
  which.tensor = tensor;
  VkMemoryRequirements2 needs{};
  needs.sType = VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2;
  client.GetTensorMemoryRequirementsARM(client.device, &which, &needs);
  VkMemoryDedicatedAllocateInfoTensorARM dedicated{};
  dedicated.sType = VK_STRUCTURE_TYPE_MEMORY_DEDICATED_ALLOCATE_INFO_TENSOR_ARM;
  dedicated.tensor = tensor;
  VkMemoryAllocateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
  info.pNext = &dedicated;
  info.allocationSize = needs.memoryRequirements.size;
  info.memoryTypeIndex = client_memory_type(&client, needs.memoryRequirements.memoryTypeBits, 0);
  VkDeviceMemory memory;
  ASSERT_EQ(vkAllocateMemory(client.device, &info, nullptr, &memory), VK_SUCCESS);
  VkBindTensorMemoryInfoARM bind{};
  bind.sType = VK_STRUCTURE_TYPE_BIND_TENSOR_MEMORY_INFO_ARM;
  bind.tensor = tensor;
  bind.memory = memory;
  VkTensorViewCreateInfoARM view_info{};
  view_info.sType = VK_STRUCTURE_TYPE_TENSOR_VIEW_CREATE_INFO_ARM;
  view_info.tensor = tensor;
  view_info.format = VK_FORMAT_R16_SINT;
  VkTensorViewARM view;
  EXPECT_LT(client.CreateTensorViewARM(client.device, &view_info, nullptr, &view), 0);
  EXPECT_EQ(client.BindTensorMemoryARM(client.device, 1, &bind), VK_SUCCESS);
  EXPECT_LT(client.BindTensorMemoryARM(client.device, 1, &bind), 0);
  view_info.format = VK_FORMAT_R16_UINT;
  EXPECT_LT(client.CreateTensorViewARM(client.device, &view_info, nullptr, &view), 0)
      << "the tensor's format may not change";
  client.DestroyTensorARM(client.device, tensor, nullptr);
  client.DestroyTensorARM(client.device, VK_NULL_HANDLE, nullptr);
  client.DestroyTensorViewARM(client.device, VK_NULL_HANDLE, nullptr);
  vkFreeMemory(client.device, memory, nullptr);
}

TEST_F(TensorLayerTest, ObjectsLieInTheApplicationsMemory) {
  struct Counts {
    size_t allocated = 0, freed = 0;
  } counts;
  VkAllocationCallbacks allocator{};
  allocator.pUserData = &counts;
  allocator.pfnAllocation = [](void* user, size_t size, size_t alignment,
                               VkSystemAllocationScope) -> void* {
    ++static_cast<Counts*>(user)->allocated;
    return std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
  };
  allocator.pfnReallocation = [](void*, void*, size_t, size_t, VkSystemAllocationScope) -> void* {
    return nullptr;
  };
  allocator.pfnFree = [](void* user, void* memory) {
    if (memory) ++static_cast<Counts*>(user)->freed;
    std::free(memory);
  };
  const std::vector<int64_t> dims{4};
  VkTensorARM tensor;
  ASSERT_EQ(create(description_of(dims), &tensor, &allocator), VK_SUCCESS);
  EXPECT_GT(counts.allocated, 0u);
  client.DestroyTensorARM(client.device, tensor, &allocator);
  EXPECT_EQ(counts.allocated, counts.freed);
  allocator.pfnAllocation = [](void*, size_t, size_t, VkSystemAllocationScope) -> void* {
    return nullptr;
  };
  EXPECT_EQ(create(description_of(dims), &tensor, &allocator), VK_ERROR_OUT_OF_HOST_MEMORY);
}

TEST_F(TensorLayerTest, TensorsHaveNamesAndPrivateData) {
  const std::vector<int64_t> dims{4};
  VkTensorARM tensor;
  ASSERT_EQ(create(description_of(dims), &tensor), VK_SUCCESS);
  const auto set_name = reinterpret_cast<PFN_vkSetDebugUtilsObjectNameEXT>(
      vkGetInstanceProcAddr(client.instance, "vkSetDebugUtilsObjectNameEXT"));
  VkDebugUtilsObjectNameInfoEXT name{};
  name.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT;
  name.objectType = VK_OBJECT_TYPE_TENSOR_ARM;
  name.objectHandle = reinterpret_cast<uint64_t>(tensor);
  name.pObjectName = "activations";
  EXPECT_EQ(set_name(client.device, &name), VK_SUCCESS);
  client.DestroyTensorARM(client.device, tensor, nullptr);
}

}  // namespace
}  // namespace shale
