/* tools/layer/arm_vulkan.h -- VK_ARM_tensors, VK_ARM_data_graph and its two extensions, and what
 * meets them of VK_KHR_maintenance5 and 6, for Vulkan headers that do not know them, in C11 and C++. Headers that do win.
 *
 * Enumerators of enums that the headers close are macros; pointer types of functions are there, and no
 * prototypes: clients ask vkGetDeviceProcAddr. Source: the Vulkan registry, header version 359. */
#ifndef SHALE_TOOLS_LAYER_ARM_VULKAN_H
#define SHALE_TOOLS_LAYER_ARM_VULKAN_H

#include <vulkan/vulkan.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef VK_ARM_tensors
#define VK_ARM_tensors 1
#define VK_ARM_TENSORS_SPEC_VERSION 2
#define VK_ARM_TENSORS_EXTENSION_NAME "VK_ARM_tensors"

#define VK_OBJECT_TYPE_TENSOR_ARM ((VkObjectType)1000460000)
#define VK_OBJECT_TYPE_TENSOR_VIEW_ARM ((VkObjectType)1000460001)
#define VK_DESCRIPTOR_TYPE_TENSOR_ARM ((VkDescriptorType)1000460000)
#define VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM ((VkImageUsageFlagBits)0x800000)
#define VK_IMAGE_LAYOUT_TENSOR_ALIASING_ARM ((VkImageLayout)1000460000)
#define VK_FORMAT_R8_BOOL_ARM ((VkFormat)1000460000)

VK_DEFINE_NON_DISPATCHABLE_HANDLE(VkTensorARM)
VK_DEFINE_NON_DISPATCHABLE_HANDLE(VkTensorViewARM)

typedef VkFlags64 VkTensorCreateFlagsARM;
typedef VkFlags64 VkTensorViewCreateFlagsARM;
typedef VkFlags64 VkTensorUsageFlagsARM;

static const VkFormatFeatureFlagBits2 VK_FORMAT_FEATURE_2_TENSOR_SHADER_BIT_ARM = 1ull << 39;
static const VkFormatFeatureFlagBits2 VK_FORMAT_FEATURE_2_TENSOR_IMAGE_ALIASING_BIT_ARM = 1ull
                                                                                          << 43;
static const VkTensorCreateFlagsARM VK_TENSOR_CREATE_MUTABLE_FORMAT_BIT_ARM = 1ull << 0;
static const VkTensorCreateFlagsARM VK_TENSOR_CREATE_PROTECTED_BIT_ARM = 1ull << 1;
static const VkTensorCreateFlagsARM VK_TENSOR_CREATE_DESCRIPTOR_BUFFER_CAPTURE_REPLAY_BIT_ARM =
    1ull << 2;
static const VkTensorViewCreateFlagsARM
    VK_TENSOR_VIEW_CREATE_DESCRIPTOR_BUFFER_CAPTURE_REPLAY_BIT_ARM = 1ull << 0;
static const VkTensorUsageFlagsARM VK_TENSOR_USAGE_SHADER_BIT_ARM = 1ull << 1;
static const VkTensorUsageFlagsARM VK_TENSOR_USAGE_TRANSFER_SRC_BIT_ARM = 1ull << 2;
static const VkTensorUsageFlagsARM VK_TENSOR_USAGE_TRANSFER_DST_BIT_ARM = 1ull << 3;
static const VkTensorUsageFlagsARM VK_TENSOR_USAGE_IMAGE_ALIASING_BIT_ARM = 1ull << 4;
typedef enum VkTensorTilingARM {
  VK_TENSOR_TILING_OPTIMAL_ARM = 0,
  VK_TENSOR_TILING_LINEAR_ARM = 1,
  VK_TENSOR_TILING_MAX_ENUM_ARM = 0x7FFFFFFF
} VkTensorTilingARM;

#define VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM ((VkStructureType)1000460006)
#define VK_STRUCTURE_TYPE_TENSOR_CREATE_INFO_ARM ((VkStructureType)1000460000)
#define VK_STRUCTURE_TYPE_TENSOR_VIEW_CREATE_INFO_ARM ((VkStructureType)1000460001)
#define VK_STRUCTURE_TYPE_TENSOR_MEMORY_REQUIREMENTS_INFO_ARM ((VkStructureType)1000460007)
#define VK_STRUCTURE_TYPE_BIND_TENSOR_MEMORY_INFO_ARM ((VkStructureType)1000460002)
#define VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM ((VkStructureType)1000460003)
#define VK_STRUCTURE_TYPE_TENSOR_FORMAT_PROPERTIES_ARM ((VkStructureType)1000460005)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_PROPERTIES_ARM ((VkStructureType)1000460004)
#define VK_STRUCTURE_TYPE_TENSOR_MEMORY_BARRIER_ARM ((VkStructureType)1000460008)
#define VK_STRUCTURE_TYPE_TENSOR_DEPENDENCY_INFO_ARM ((VkStructureType)1000460013)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM ((VkStructureType)1000460009)
#define VK_STRUCTURE_TYPE_DEVICE_TENSOR_MEMORY_REQUIREMENTS_ARM ((VkStructureType)1000460010)
#define VK_STRUCTURE_TYPE_COPY_TENSOR_INFO_ARM ((VkStructureType)1000460011)
#define VK_STRUCTURE_TYPE_TENSOR_COPY_ARM ((VkStructureType)1000460012)
#define VK_STRUCTURE_TYPE_MEMORY_DEDICATED_ALLOCATE_INFO_TENSOR_ARM ((VkStructureType)1000460014)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_EXTERNAL_TENSOR_INFO_ARM ((VkStructureType)1000460015)
#define VK_STRUCTURE_TYPE_EXTERNAL_TENSOR_PROPERTIES_ARM ((VkStructureType)1000460016)
#define VK_STRUCTURE_TYPE_EXTERNAL_MEMORY_TENSOR_CREATE_INFO_ARM ((VkStructureType)1000460017)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_FEATURES_ARM \
  ((VkStructureType)1000460018)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_PROPERTIES_ARM \
  ((VkStructureType)1000460019)
#define VK_STRUCTURE_TYPE_DESCRIPTOR_GET_TENSOR_INFO_ARM ((VkStructureType)1000460020)
#define VK_STRUCTURE_TYPE_TENSOR_CAPTURE_DESCRIPTOR_DATA_INFO_ARM ((VkStructureType)1000460021)
#define VK_STRUCTURE_TYPE_TENSOR_VIEW_CAPTURE_DESCRIPTOR_DATA_INFO_ARM ((VkStructureType)1000460022)

typedef struct VkTensorDescriptionARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorTilingARM tiling;
  VkFormat format;
  uint32_t dimensionCount;
  const int64_t* pDimensions;
  const int64_t* pStrides;
  VkTensorUsageFlagsARM usage;
} VkTensorDescriptionARM;

typedef struct VkTensorCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorCreateFlagsARM flags;
  const VkTensorDescriptionARM* pDescription;
  VkSharingMode sharingMode;
  uint32_t queueFamilyIndexCount;
  const uint32_t* pQueueFamilyIndices;
} VkTensorCreateInfoARM;

typedef struct VkTensorViewCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorViewCreateFlagsARM flags;
  VkTensorARM tensor;
  VkFormat format;
} VkTensorViewCreateInfoARM;

typedef struct VkTensorMemoryRequirementsInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorARM tensor;
} VkTensorMemoryRequirementsInfoARM;

typedef struct VkBindTensorMemoryInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorARM tensor;
  VkDeviceMemory memory;
  VkDeviceSize memoryOffset;
} VkBindTensorMemoryInfoARM;

typedef struct VkWriteDescriptorSetTensorARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t tensorViewCount;
  const VkTensorViewARM* pTensorViews;
} VkWriteDescriptorSetTensorARM;

typedef struct VkTensorFormatPropertiesARM {
  VkStructureType sType;
  void* pNext;
  VkFormatFeatureFlags2 optimalTilingTensorFeatures;
  VkFormatFeatureFlags2 linearTilingTensorFeatures;
} VkTensorFormatPropertiesARM;

typedef struct VkPhysicalDeviceTensorPropertiesARM {
  VkStructureType sType;
  void* pNext;
  uint32_t maxTensorDimensionCount;
  uint64_t maxTensorElements;
  uint64_t maxPerDimensionTensorElements;
  int64_t maxTensorStride;
  uint64_t maxTensorSize;
  uint32_t maxTensorShaderAccessArrayLength;
  uint32_t maxTensorShaderAccessSize;
  uint32_t maxDescriptorSetStorageTensors;
  uint32_t maxPerStageDescriptorSetStorageTensors;
  uint32_t maxDescriptorSetUpdateAfterBindStorageTensors;
  uint32_t maxPerStageDescriptorUpdateAfterBindStorageTensors;
  VkBool32 shaderStorageTensorArrayNonUniformIndexingNative;
  VkShaderStageFlags shaderTensorSupportedStages;
} VkPhysicalDeviceTensorPropertiesARM;

typedef struct VkTensorMemoryBarrierARM {
  VkStructureType sType;
  const void* pNext;
  VkPipelineStageFlags2 srcStageMask;
  VkAccessFlags2 srcAccessMask;
  VkPipelineStageFlags2 dstStageMask;
  VkAccessFlags2 dstAccessMask;
  uint32_t srcQueueFamilyIndex;
  uint32_t dstQueueFamilyIndex;
  VkTensorARM tensor;
} VkTensorMemoryBarrierARM;

typedef struct VkTensorDependencyInfoARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t tensorMemoryBarrierCount;
  const VkTensorMemoryBarrierARM* pTensorMemoryBarriers;
} VkTensorDependencyInfoARM;

typedef struct VkPhysicalDeviceTensorFeaturesARM {
  VkStructureType sType;
  void* pNext;
  VkBool32 tensorNonPacked;
  VkBool32 shaderTensorAccess;
  VkBool32 shaderStorageTensorArrayDynamicIndexing;
  VkBool32 shaderStorageTensorArrayNonUniformIndexing;
  VkBool32 descriptorBindingStorageTensorUpdateAfterBind;
  VkBool32 tensors;
} VkPhysicalDeviceTensorFeaturesARM;

typedef struct VkDeviceTensorMemoryRequirementsARM {
  VkStructureType sType;
  const void* pNext;
  const VkTensorCreateInfoARM* pCreateInfo;
} VkDeviceTensorMemoryRequirementsARM;

typedef struct VkTensorCopyARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t dimensionCount;
  const uint64_t* pSrcOffset;
  const uint64_t* pDstOffset;
  const uint64_t* pExtent;
} VkTensorCopyARM;

typedef struct VkCopyTensorInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorARM srcTensor;
  VkTensorARM dstTensor;
  uint32_t regionCount;
  const VkTensorCopyARM* pRegions;
} VkCopyTensorInfoARM;

typedef struct VkMemoryDedicatedAllocateInfoTensorARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorARM tensor;
} VkMemoryDedicatedAllocateInfoTensorARM;

typedef struct VkPhysicalDeviceExternalTensorInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorCreateFlagsARM flags;
  const VkTensorDescriptionARM* pDescription;
  VkExternalMemoryHandleTypeFlagBits handleType;
} VkPhysicalDeviceExternalTensorInfoARM;

typedef struct VkExternalTensorPropertiesARM {
  VkStructureType sType;
  const void* pNext;
  VkExternalMemoryProperties externalMemoryProperties;
} VkExternalTensorPropertiesARM;

typedef struct VkExternalMemoryTensorCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkExternalMemoryHandleTypeFlags handleTypes;
} VkExternalMemoryTensorCreateInfoARM;

typedef struct VkPhysicalDeviceDescriptorBufferTensorFeaturesARM {
  VkStructureType sType;
  void* pNext;
  VkBool32 descriptorBufferTensorDescriptors;
} VkPhysicalDeviceDescriptorBufferTensorFeaturesARM;

typedef struct VkPhysicalDeviceDescriptorBufferTensorPropertiesARM {
  VkStructureType sType;
  void* pNext;
  size_t tensorCaptureReplayDescriptorDataSize;
  size_t tensorViewCaptureReplayDescriptorDataSize;
  size_t tensorDescriptorSize;
} VkPhysicalDeviceDescriptorBufferTensorPropertiesARM;

typedef struct VkDescriptorGetTensorInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorViewARM tensorView;
} VkDescriptorGetTensorInfoARM;

typedef struct VkTensorCaptureDescriptorDataInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorARM tensor;
} VkTensorCaptureDescriptorDataInfoARM;

typedef struct VkTensorViewCaptureDescriptorDataInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkTensorViewARM tensorView;
} VkTensorViewCaptureDescriptorDataInfoARM;

typedef VkResult(VKAPI_PTR* PFN_vkCreateTensorARM)(VkDevice device,
                                                   const VkTensorCreateInfoARM* pCreateInfo,
                                                   const VkAllocationCallbacks* pAllocator,
                                                   VkTensorARM* pTensor);
typedef void(VKAPI_PTR* PFN_vkDestroyTensorARM)(VkDevice device, VkTensorARM tensor,
                                                const VkAllocationCallbacks* pAllocator);
typedef VkResult(VKAPI_PTR* PFN_vkCreateTensorViewARM)(VkDevice device,
                                                       const VkTensorViewCreateInfoARM* pCreateInfo,
                                                       const VkAllocationCallbacks* pAllocator,
                                                       VkTensorViewARM* pView);
typedef void(VKAPI_PTR* PFN_vkDestroyTensorViewARM)(VkDevice device, VkTensorViewARM tensorView,
                                                    const VkAllocationCallbacks* pAllocator);
typedef void(VKAPI_PTR* PFN_vkGetTensorMemoryRequirementsARM)(
    VkDevice device, const VkTensorMemoryRequirementsInfoARM* pInfo,
    VkMemoryRequirements2* pMemoryRequirements);
typedef VkResult(VKAPI_PTR* PFN_vkBindTensorMemoryARM)(VkDevice device, uint32_t bindInfoCount,
                                                       const VkBindTensorMemoryInfoARM* pBindInfos);
typedef void(VKAPI_PTR* PFN_vkGetDeviceTensorMemoryRequirementsARM)(
    VkDevice device, const VkDeviceTensorMemoryRequirementsARM* pInfo,
    VkMemoryRequirements2* pMemoryRequirements);
typedef void(VKAPI_PTR* PFN_vkCmdCopyTensorARM)(VkCommandBuffer commandBuffer,
                                                const VkCopyTensorInfoARM* pCopyTensorInfo);
typedef void(VKAPI_PTR* PFN_vkGetPhysicalDeviceExternalTensorPropertiesARM)(
    VkPhysicalDevice physicalDevice,
    const VkPhysicalDeviceExternalTensorInfoARM* pExternalTensorInfo,
    VkExternalTensorPropertiesARM* pExternalTensorProperties);
typedef VkResult(VKAPI_PTR* PFN_vkGetTensorOpaqueCaptureDescriptorDataARM)(
    VkDevice device, const VkTensorCaptureDescriptorDataInfoARM* pInfo, void* pData);
typedef VkResult(VKAPI_PTR* PFN_vkGetTensorViewOpaqueCaptureDescriptorDataARM)(
    VkDevice device, const VkTensorViewCaptureDescriptorDataInfoARM* pInfo, void* pData);
#endif

#ifndef VK_ARM_data_graph
#define VK_ARM_data_graph 1
#define VK_ARM_DATA_GRAPH_SPEC_VERSION 1
#define VK_ARM_DATA_GRAPH_EXTENSION_NAME "VK_ARM_data_graph"

#define VK_MAX_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_SET_NAME_SIZE_ARM 128U

#define VK_OBJECT_TYPE_DATA_GRAPH_PIPELINE_SESSION_ARM ((VkObjectType)1000507000)
#define VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM ((VkPipelineBindPoint)1000507000)
#define VK_QUEUE_DATA_GRAPH_BIT_ARM ((VkQueueFlagBits)0x400)

VK_DEFINE_NON_DISPATCHABLE_HANDLE(VkDataGraphPipelineSessionARM)

typedef VkFlags64 VkDataGraphPipelineSessionCreateFlagsARM;
typedef VkFlags64 VkDataGraphPipelineDispatchFlagsARM;
#ifndef VK_KHR_maintenance5
#define VK_KHR_maintenance5 1
#define VK_KHR_MAINTENANCE_5_SPEC_VERSION 1
#define VK_KHR_MAINTENANCE_5_EXTENSION_NAME "VK_KHR_maintenance5"
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_FEATURES_KHR ((VkStructureType)1000470000)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_PROPERTIES_KHR ((VkStructureType)1000470001)
#define VK_STRUCTURE_TYPE_RENDERING_AREA_INFO_KHR ((VkStructureType)1000470003)
#define VK_STRUCTURE_TYPE_DEVICE_IMAGE_SUBRESOURCE_INFO_KHR ((VkStructureType)1000470004)
#define VK_STRUCTURE_TYPE_PIPELINE_CREATE_FLAGS_2_CREATE_INFO_KHR ((VkStructureType)1000470005)
#define VK_STRUCTURE_TYPE_BUFFER_USAGE_FLAGS_2_CREATE_INFO_KHR ((VkStructureType)1000470006)
#define VK_STRUCTURE_TYPE_SUBRESOURCE_LAYOUT_2_KHR ((VkStructureType)1000338002)
#define VK_STRUCTURE_TYPE_IMAGE_SUBRESOURCE_2_KHR ((VkStructureType)1000338003)
#define VK_FORMAT_A1B5G5R5_UNORM_PACK16_KHR ((VkFormat)1000470000)
#define VK_FORMAT_A8_UNORM_KHR ((VkFormat)1000470001)

typedef VkFlags64 VkPipelineCreateFlags2;
typedef VkFlags64 VkPipelineCreateFlags2KHR;
typedef VkFlags64 VkBufferUsageFlags2KHR;
typedef VkImageSubresource2EXT VkImageSubresource2KHR;
typedef VkSubresourceLayout2EXT VkSubresourceLayout2KHR;

typedef struct VkPhysicalDeviceMaintenance5FeaturesKHR {
  VkStructureType sType;
  void* pNext;
  VkBool32 maintenance5;
} VkPhysicalDeviceMaintenance5FeaturesKHR;

typedef struct VkPhysicalDeviceMaintenance5PropertiesKHR {
  VkStructureType sType;
  void* pNext;
  VkBool32 earlyFragmentMultisampleCoverageAfterSampleCounting;
  VkBool32 earlyFragmentSampleMaskTestBeforeSampleCounting;
  VkBool32 depthStencilSwizzleOneSupport;
  VkBool32 polygonModePointSize;
  VkBool32 nonStrictSinglePixelWideLinesUseParallelogram;
  VkBool32 nonStrictWideLinesUseParallelogram;
} VkPhysicalDeviceMaintenance5PropertiesKHR;

typedef struct VkRenderingAreaInfoKHR {
  VkStructureType sType;
  const void* pNext;
  uint32_t viewMask;
  uint32_t colorAttachmentCount;
  const VkFormat* pColorAttachmentFormats;
  VkFormat depthAttachmentFormat;
  VkFormat stencilAttachmentFormat;
} VkRenderingAreaInfoKHR;

typedef struct VkDeviceImageSubresourceInfoKHR {
  VkStructureType sType;
  const void* pNext;
  const VkImageCreateInfo* pCreateInfo;
  const VkImageSubresource2KHR* pSubresource;
} VkDeviceImageSubresourceInfoKHR;

typedef struct VkPipelineCreateFlags2CreateInfoKHR {
  VkStructureType sType;
  const void* pNext;
  VkPipelineCreateFlags2KHR flags;
} VkPipelineCreateFlags2CreateInfoKHR;

typedef struct VkBufferUsageFlags2CreateInfoKHR {
  VkStructureType sType;
  const void* pNext;
  VkBufferUsageFlags2KHR usage;
} VkBufferUsageFlags2CreateInfoKHR;

typedef void(VKAPI_PTR* PFN_vkCmdBindIndexBuffer2KHR)(VkCommandBuffer commandBuffer,
                                                      VkBuffer buffer, VkDeviceSize offset,
                                                      VkDeviceSize size, VkIndexType indexType);
typedef void(VKAPI_PTR* PFN_vkGetRenderingAreaGranularityKHR)(
    VkDevice device, const VkRenderingAreaInfoKHR* pRenderingAreaInfo, VkExtent2D* pGranularity);
typedef void(VKAPI_PTR* PFN_vkGetDeviceImageSubresourceLayoutKHR)(
    VkDevice device, const VkDeviceImageSubresourceInfoKHR* pInfo,
    VkSubresourceLayout2KHR* pLayout);
typedef void(VKAPI_PTR* PFN_vkGetImageSubresourceLayout2KHR)(
    VkDevice device, VkImage image, const VkImageSubresource2KHR* pSubresource,
    VkSubresourceLayout2KHR* pLayout);
#endif

static const VkPipelineStageFlagBits2 VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM = 1ull << 42;
static const VkAccessFlagBits2 VK_ACCESS_2_DATA_GRAPH_READ_BIT_ARM = 1ull << 47;
static const VkAccessFlagBits2 VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM = 1ull << 48;
static const VkTensorUsageFlagsARM VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM = 1ull << 5;
static const VkFormatFeatureFlagBits2 VK_FORMAT_FEATURE_2_TENSOR_DATA_GRAPH_BIT_ARM = 1ull << 48;
typedef enum VkDataGraphPipelineSessionBindPointARM {
  VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TRANSIENT_ARM = 0,
  VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphPipelineSessionBindPointARM;
typedef enum VkDataGraphPipelineSessionBindPointTypeARM {
  VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TYPE_MEMORY_ARM = 0,
  VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TYPE_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphPipelineSessionBindPointTypeARM;
static const VkDataGraphPipelineSessionCreateFlagsARM
    VK_DATA_GRAPH_PIPELINE_SESSION_CREATE_PROTECTED_BIT_ARM = 1ull << 0;
static const VkDataGraphPipelineSessionCreateFlagsARM
    VK_DATA_GRAPH_PIPELINE_SESSION_CREATE_OPTICAL_FLOW_CACHE_BIT_ARM = 1ull << 1;
typedef enum VkDataGraphPipelinePropertyARM {
  VK_DATA_GRAPH_PIPELINE_PROPERTY_CREATION_LOG_ARM = 0,
  VK_DATA_GRAPH_PIPELINE_PROPERTY_IDENTIFIER_ARM = 1,
  VK_DATA_GRAPH_PIPELINE_PROPERTY_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphPipelinePropertyARM;
typedef enum VkPhysicalDeviceDataGraphProcessingEngineTypeARM {
  VK_PHYSICAL_DEVICE_DATA_GRAPH_PROCESSING_ENGINE_TYPE_DEFAULT_ARM = 0,
  VK_PHYSICAL_DEVICE_DATA_GRAPH_PROCESSING_ENGINE_TYPE_MAX_ENUM_ARM = 0x7FFFFFFF
} VkPhysicalDeviceDataGraphProcessingEngineTypeARM;
typedef enum VkPhysicalDeviceDataGraphOperationTypeARM {
  VK_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_TYPE_SPIRV_EXTENDED_INSTRUCTION_SET_ARM = 0,
  VK_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_TYPE_MAX_ENUM_ARM = 0x7FFFFFFF
} VkPhysicalDeviceDataGraphOperationTypeARM;

#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM ((VkStructureType)1000507006)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CONSTANT_ARM ((VkStructureType)1000507003)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_RESOURCE_INFO_ARM ((VkStructureType)1000507002)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_COMPILER_CONTROL_CREATE_INFO_ARM \
  ((VkStructureType)1000507010)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM ((VkStructureType)1000507000)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SHADER_MODULE_CREATE_INFO_ARM \
  ((VkStructureType)1000507007)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_CREATE_INFO_ARM ((VkStructureType)1000507001)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_REQUIREMENTS_INFO_ARM \
  ((VkStructureType)1000507011)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_REQUIREMENT_ARM \
  ((VkStructureType)1000507012)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_MEMORY_REQUIREMENTS_INFO_ARM \
  ((VkStructureType)1000507004)
#define VK_STRUCTURE_TYPE_BIND_DATA_GRAPH_PIPELINE_SESSION_MEMORY_INFO_ARM \
  ((VkStructureType)1000507005)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_INFO_ARM ((VkStructureType)1000507009)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_PROPERTY_QUERY_RESULT_ARM \
  ((VkStructureType)1000507008)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_IDENTIFIER_CREATE_INFO_ARM \
  ((VkStructureType)1000507013)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_DISPATCH_INFO_ARM ((VkStructureType)1000507014)
#define VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_PROPERTIES_ARM ((VkStructureType)1000507018)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PROCESSING_ENGINE_CREATE_INFO_ARM ((VkStructureType)1000507016)
#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_QUEUE_FAMILY_DATA_GRAPH_PROCESSING_ENGINE_INFO_ARM \
  ((VkStructureType)1000507019)
#define VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_PROCESSING_ENGINE_PROPERTIES_ARM \
  ((VkStructureType)1000507017)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CONSTANT_TENSOR_SEMI_STRUCTURED_SPARSITY_INFO_ARM \
  ((VkStructureType)1000507015)

typedef struct VkPhysicalDeviceDataGraphFeaturesARM {
  VkStructureType sType;
  void* pNext;
  VkBool32 dataGraph;
  VkBool32 dataGraphUpdateAfterBind;
  VkBool32 dataGraphSpecializationConstants;
  VkBool32 dataGraphDescriptorBuffer;
  VkBool32 dataGraphShaderModule;
} VkPhysicalDeviceDataGraphFeaturesARM;

typedef struct VkDataGraphPipelineConstantARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t id;
  const void* pConstantData;
} VkDataGraphPipelineConstantARM;

typedef struct VkDataGraphPipelineResourceInfoARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t descriptorSet;
  uint32_t binding;
  uint32_t arrayElement;
} VkDataGraphPipelineResourceInfoARM;

typedef struct VkDataGraphPipelineCompilerControlCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  const char* pVendorOptions;
} VkDataGraphPipelineCompilerControlCreateInfoARM;

typedef struct VkDataGraphPipelineCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkPipelineCreateFlags2 flags;
  VkPipelineLayout layout;
  uint32_t resourceInfoCount;
  const VkDataGraphPipelineResourceInfoARM* pResourceInfos;
} VkDataGraphPipelineCreateInfoARM;

typedef struct VkDataGraphPipelineShaderModuleCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkShaderModule module;
  const char* pName;
  const VkSpecializationInfo* pSpecializationInfo;
  uint32_t constantCount;
  const VkDataGraphPipelineConstantARM* pConstants;
} VkDataGraphPipelineShaderModuleCreateInfoARM;

typedef struct VkDataGraphPipelineSessionCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkDataGraphPipelineSessionCreateFlagsARM flags;
  VkPipeline dataGraphPipeline;
} VkDataGraphPipelineSessionCreateInfoARM;

typedef struct VkDataGraphPipelineSessionBindPointRequirementsInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkDataGraphPipelineSessionARM session;
} VkDataGraphPipelineSessionBindPointRequirementsInfoARM;

typedef struct VkDataGraphPipelineSessionBindPointRequirementARM {
  VkStructureType sType;
  void* pNext;
  VkDataGraphPipelineSessionBindPointARM bindPoint;
  VkDataGraphPipelineSessionBindPointTypeARM bindPointType;
  uint32_t numObjects;
} VkDataGraphPipelineSessionBindPointRequirementARM;

typedef struct VkDataGraphPipelineSessionMemoryRequirementsInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkDataGraphPipelineSessionARM session;
  VkDataGraphPipelineSessionBindPointARM bindPoint;
  uint32_t objectIndex;
} VkDataGraphPipelineSessionMemoryRequirementsInfoARM;

typedef struct VkBindDataGraphPipelineSessionMemoryInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkDataGraphPipelineSessionARM session;
  VkDataGraphPipelineSessionBindPointARM bindPoint;
  uint32_t objectIndex;
  VkDeviceMemory memory;
  VkDeviceSize memoryOffset;
} VkBindDataGraphPipelineSessionMemoryInfoARM;

typedef struct VkDataGraphPipelineInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkPipeline dataGraphPipeline;
} VkDataGraphPipelineInfoARM;

typedef struct VkDataGraphPipelinePropertyQueryResultARM {
  VkStructureType sType;
  void* pNext;
  VkDataGraphPipelinePropertyARM property;
  VkBool32 isText;
  size_t dataSize;
  void* pData;
} VkDataGraphPipelinePropertyQueryResultARM;

typedef struct VkDataGraphPipelineIdentifierCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t identifierSize;
  const uint8_t* pIdentifier;
} VkDataGraphPipelineIdentifierCreateInfoARM;

typedef struct VkDataGraphPipelineDispatchInfoARM {
  VkStructureType sType;
  void* pNext;
  VkDataGraphPipelineDispatchFlagsARM flags;
} VkDataGraphPipelineDispatchInfoARM;

typedef struct VkPhysicalDeviceDataGraphProcessingEngineARM {
  VkPhysicalDeviceDataGraphProcessingEngineTypeARM type;
  VkBool32 isForeign;
} VkPhysicalDeviceDataGraphProcessingEngineARM;

typedef struct VkPhysicalDeviceDataGraphOperationSupportARM {
  VkPhysicalDeviceDataGraphOperationTypeARM operationType;
  char name[VK_MAX_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_SET_NAME_SIZE_ARM];
  uint32_t version;
} VkPhysicalDeviceDataGraphOperationSupportARM;

typedef struct VkQueueFamilyDataGraphPropertiesARM {
  VkStructureType sType;
  void* pNext;
  VkPhysicalDeviceDataGraphProcessingEngineARM engine;
  VkPhysicalDeviceDataGraphOperationSupportARM operation;
} VkQueueFamilyDataGraphPropertiesARM;

typedef struct VkDataGraphProcessingEngineCreateInfoARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t processingEngineCount;
  VkPhysicalDeviceDataGraphProcessingEngineARM* pProcessingEngines;
} VkDataGraphProcessingEngineCreateInfoARM;

typedef struct VkPhysicalDeviceQueueFamilyDataGraphProcessingEngineInfoARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t queueFamilyIndex;
  VkPhysicalDeviceDataGraphProcessingEngineTypeARM engineType;
} VkPhysicalDeviceQueueFamilyDataGraphProcessingEngineInfoARM;

typedef struct VkQueueFamilyDataGraphProcessingEnginePropertiesARM {
  VkStructureType sType;
  void* pNext;
  VkExternalSemaphoreHandleTypeFlags foreignSemaphoreHandleTypes;
  VkExternalMemoryHandleTypeFlags foreignMemoryHandleTypes;
} VkQueueFamilyDataGraphProcessingEnginePropertiesARM;

typedef struct VkDataGraphPipelineConstantTensorSemiStructuredSparsityInfoARM {
  VkStructureType sType;
  const void* pNext;
  uint32_t dimension;
  uint32_t zeroCount;
  uint32_t groupSize;
} VkDataGraphPipelineConstantTensorSemiStructuredSparsityInfoARM;

typedef VkResult(VKAPI_PTR* PFN_vkCreateDataGraphPipelinesARM)(
    VkDevice device, VkDeferredOperationKHR deferredOperation, VkPipelineCache pipelineCache,
    uint32_t createInfoCount, const VkDataGraphPipelineCreateInfoARM* pCreateInfos,
    const VkAllocationCallbacks* pAllocator, VkPipeline* pPipelines);
typedef VkResult(VKAPI_PTR* PFN_vkCreateDataGraphPipelineSessionARM)(
    VkDevice device, const VkDataGraphPipelineSessionCreateInfoARM* pCreateInfo,
    const VkAllocationCallbacks* pAllocator, VkDataGraphPipelineSessionARM* pSession);
typedef VkResult(VKAPI_PTR* PFN_vkGetDataGraphPipelineSessionBindPointRequirementsARM)(
    VkDevice device, const VkDataGraphPipelineSessionBindPointRequirementsInfoARM* pInfo,
    uint32_t* pBindPointRequirementCount,
    VkDataGraphPipelineSessionBindPointRequirementARM* pBindPointRequirements);
typedef void(VKAPI_PTR* PFN_vkGetDataGraphPipelineSessionMemoryRequirementsARM)(
    VkDevice device, const VkDataGraphPipelineSessionMemoryRequirementsInfoARM* pInfo,
    VkMemoryRequirements2* pMemoryRequirements);
typedef VkResult(VKAPI_PTR* PFN_vkBindDataGraphPipelineSessionMemoryARM)(
    VkDevice device, uint32_t bindInfoCount,
    const VkBindDataGraphPipelineSessionMemoryInfoARM* pBindInfos);
typedef void(VKAPI_PTR* PFN_vkDestroyDataGraphPipelineSessionARM)(
    VkDevice device, VkDataGraphPipelineSessionARM session,
    const VkAllocationCallbacks* pAllocator);
typedef void(VKAPI_PTR* PFN_vkCmdDispatchDataGraphARM)(
    VkCommandBuffer commandBuffer, VkDataGraphPipelineSessionARM session,
    const VkDataGraphPipelineDispatchInfoARM* pInfo);
typedef VkResult(VKAPI_PTR* PFN_vkGetDataGraphPipelineAvailablePropertiesARM)(
    VkDevice device, const VkDataGraphPipelineInfoARM* pPipelineInfo, uint32_t* pPropertiesCount,
    VkDataGraphPipelinePropertyARM* pProperties);
typedef VkResult(VKAPI_PTR* PFN_vkGetDataGraphPipelinePropertiesARM)(
    VkDevice device, const VkDataGraphPipelineInfoARM* pPipelineInfo, uint32_t propertiesCount,
    VkDataGraphPipelinePropertyQueryResultARM* pProperties);
typedef VkResult(VKAPI_PTR* PFN_vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM)(
    VkPhysicalDevice physicalDevice, uint32_t queueFamilyIndex,
    uint32_t* pQueueFamilyDataGraphPropertyCount,
    VkQueueFamilyDataGraphPropertiesARM* pQueueFamilyDataGraphProperties);
typedef void(VKAPI_PTR* PFN_vkGetPhysicalDeviceQueueFamilyDataGraphProcessingEnginePropertiesARM)(
    VkPhysicalDevice physicalDevice,
    const VkPhysicalDeviceQueueFamilyDataGraphProcessingEngineInfoARM*
        pQueueFamilyDataGraphProcessingEngineInfo,
    VkQueueFamilyDataGraphProcessingEnginePropertiesARM*
        pQueueFamilyDataGraphProcessingEngineProperties);
#endif

#ifndef VK_KHR_maintenance6
#define VK_KHR_maintenance6 1
#define VK_KHR_MAINTENANCE_6_EXTENSION_NAME "VK_KHR_maintenance6"
#define VK_STRUCTURE_TYPE_BIND_DESCRIPTOR_SETS_INFO_KHR ((VkStructureType)1000545003)
#define VK_STRUCTURE_TYPE_PUSH_DESCRIPTOR_SET_INFO_KHR ((VkStructureType)1000545005)
#define VK_STRUCTURE_TYPE_PUSH_DESCRIPTOR_SET_WITH_TEMPLATE_INFO_KHR ((VkStructureType)1000545006)
#define VK_STRUCTURE_TYPE_SET_DESCRIPTOR_BUFFER_OFFSETS_INFO_EXT ((VkStructureType)1000545007)
#define VK_STRUCTURE_TYPE_BIND_DESCRIPTOR_BUFFER_EMBEDDED_SAMPLERS_INFO_EXT \
  ((VkStructureType)1000545008)

typedef struct VkBindDescriptorSetsInfoKHR {
  VkStructureType sType;
  const void* pNext;
  VkShaderStageFlags stageFlags;
  VkPipelineLayout layout;
  uint32_t firstSet;
  uint32_t descriptorSetCount;
  const VkDescriptorSet* pDescriptorSets;
  uint32_t dynamicOffsetCount;
  const uint32_t* pDynamicOffsets;
} VkBindDescriptorSetsInfoKHR;

typedef struct VkPushDescriptorSetInfoKHR {
  VkStructureType sType;
  const void* pNext;
  VkShaderStageFlags stageFlags;
  VkPipelineLayout layout;
  uint32_t set;
  uint32_t descriptorWriteCount;
  const VkWriteDescriptorSet* pDescriptorWrites;
} VkPushDescriptorSetInfoKHR;

typedef struct VkPushDescriptorSetWithTemplateInfoKHR {
  VkStructureType sType;
  const void* pNext;
  VkDescriptorUpdateTemplate descriptorUpdateTemplate;
  VkPipelineLayout layout;
  uint32_t set;
  const void* pData;
} VkPushDescriptorSetWithTemplateInfoKHR;

typedef struct VkSetDescriptorBufferOffsetsInfoEXT {
  VkStructureType sType;
  const void* pNext;
  VkShaderStageFlags stageFlags;
  VkPipelineLayout layout;
  uint32_t firstSet;
  uint32_t setCount;
  const uint32_t* pBufferIndices;
  const VkDeviceSize* pOffsets;
} VkSetDescriptorBufferOffsetsInfoEXT;

typedef struct VkBindDescriptorBufferEmbeddedSamplersInfoEXT {
  VkStructureType sType;
  const void* pNext;
  VkShaderStageFlags stageFlags;
  VkPipelineLayout layout;
  uint32_t set;
} VkBindDescriptorBufferEmbeddedSamplersInfoEXT;

typedef void(VKAPI_PTR* PFN_vkCmdBindDescriptorSets2KHR)(VkCommandBuffer commandBuffer,
                                                         const VkBindDescriptorSetsInfoKHR* pInfo);
typedef void(VKAPI_PTR* PFN_vkCmdPushDescriptorSet2KHR)(VkCommandBuffer commandBuffer,
                                                        const VkPushDescriptorSetInfoKHR* pInfo);
typedef void(VKAPI_PTR* PFN_vkCmdPushDescriptorSetWithTemplate2KHR)(
    VkCommandBuffer commandBuffer, const VkPushDescriptorSetWithTemplateInfoKHR* pInfo);
typedef void(VKAPI_PTR* PFN_vkCmdSetDescriptorBufferOffsets2EXT)(
    VkCommandBuffer commandBuffer, const VkSetDescriptorBufferOffsetsInfoEXT* pInfo);
typedef void(VKAPI_PTR* PFN_vkCmdBindDescriptorBufferEmbeddedSamplers2EXT)(
    VkCommandBuffer commandBuffer, const VkBindDescriptorBufferEmbeddedSamplersInfoEXT* pInfo);
#endif

#ifndef VK_ARM_data_graph_instruction_set_tosa
#define VK_ARM_data_graph_instruction_set_tosa 1
#define VK_ARM_DATA_GRAPH_INSTRUCTION_SET_TOSA_SPEC_VERSION 1
#define VK_ARM_DATA_GRAPH_INSTRUCTION_SET_TOSA_EXTENSION_NAME \
  "VK_ARM_data_graph_instruction_set_tosa"

#define VK_MAX_DATA_GRAPH_TOSA_NAME_SIZE_ARM 128U

typedef VkFlags VkDataGraphTOSAQualityFlagsARM;

typedef enum VkDataGraphTOSAQualityFlagBitsARM {
  VK_DATA_GRAPH_TOSA_QUALITY_ACCELERATED_ARM = 0x1,
  VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM = 0x2,
  VK_DATA_GRAPH_TOSA_QUALITY_EXPERIMENTAL_ARM = 0x4,
  VK_DATA_GRAPH_TOSA_QUALITY_DEPRECATED_ARM = 0x8,
  VK_DATA_GRAPH_TOSA_QUALITY_FLAG_BITS_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphTOSAQualityFlagBitsARM;
typedef enum VkDataGraphTOSALevelARM {
  VK_DATA_GRAPH_TOSA_LEVEL_NONE_ARM = 0,
  VK_DATA_GRAPH_TOSA_LEVEL_8K_ARM = 1,
  VK_DATA_GRAPH_TOSA_LEVEL_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphTOSALevelARM;

#define VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_TOSA_PROPERTIES_ARM ((VkStructureType)1000508000)

typedef struct VkDataGraphTOSANameQualityARM {
  char name[VK_MAX_DATA_GRAPH_TOSA_NAME_SIZE_ARM];
  VkDataGraphTOSAQualityFlagsARM qualityFlags;
} VkDataGraphTOSANameQualityARM;

typedef struct VkQueueFamilyDataGraphTOSAPropertiesARM {
  VkStructureType sType;
  void* pNext;
  uint32_t profileCount;
  const VkDataGraphTOSANameQualityARM* pProfiles;
  uint32_t extensionCount;
  const VkDataGraphTOSANameQualityARM* pExtensions;
  VkDataGraphTOSALevelARM level;
} VkQueueFamilyDataGraphTOSAPropertiesARM;

typedef VkResult(
    VKAPI_PTR* PFN_vkGetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM)(
    VkPhysicalDevice physicalDevice, uint32_t queueFamilyIndex,
    const VkQueueFamilyDataGraphPropertiesARM* pQueueFamilyDataGraphProperties,
    VkBaseOutStructure* pProperties);
#endif

#ifndef VK_ARM_data_graph_optical_flow
#define VK_ARM_data_graph_optical_flow 1
#define VK_ARM_DATA_GRAPH_OPTICAL_FLOW_SPEC_VERSION 1
#define VK_ARM_DATA_GRAPH_OPTICAL_FLOW_EXTENSION_NAME "VK_ARM_data_graph_optical_flow"

#define VK_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_TYPE_OPTICAL_FLOW_ARM \
  ((VkPhysicalDeviceDataGraphOperationTypeARM)1000631000)
#define VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_OPTICAL_FLOW_CACHE_ARM \
  ((VkDataGraphPipelineSessionBindPointARM)1000631001)

static const VkFormatFeatureFlagBits2 VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_IMAGE_BIT_ARM =
    1ull << 56;
static const VkFormatFeatureFlagBits2 VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_VECTOR_BIT_ARM =
    1ull << 57;
static const VkFormatFeatureFlagBits2 VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_COST_BIT_ARM =
    1ull << 58;

#define VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM \
  ((VkStructureType)1000631000)
#define VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_OPTICAL_FLOW_PROPERTIES_ARM \
  ((VkStructureType)1000631001)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_OPTICAL_FLOW_CREATE_INFO_ARM \
  ((VkStructureType)1000631002)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_INFO_ARM \
  ((VkStructureType)1000631003)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_PROPERTIES_ARM \
  ((VkStructureType)1000631004)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_OPTICAL_FLOW_DISPATCH_INFO_ARM \
  ((VkStructureType)1000631005)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_RESOURCE_INFO_IMAGE_LAYOUT_ARM \
  ((VkStructureType)1000631006)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SINGLE_NODE_CREATE_INFO_ARM \
  ((VkStructureType)1000631007)
#define VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SINGLE_NODE_CONNECTION_ARM \
  ((VkStructureType)1000631008)

typedef VkFlags VkDataGraphOpticalFlowImageUsageFlagsARM;
typedef enum VkDataGraphOpticalFlowImageUsageFlagBitsARM {
  VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_UNKNOWN_ARM = 0,
  VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_INPUT_BIT_ARM = 0x1,
  VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM = 0x2,
  VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_HINT_BIT_ARM = 0x4,
  VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM = 0x8
} VkDataGraphOpticalFlowImageUsageFlagBitsARM;

typedef VkFlags VkDataGraphOpticalFlowCreateFlagsARM;
typedef enum VkDataGraphOpticalFlowCreateFlagBitsARM {
  VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_HINT_BIT_ARM = 0x1,
  VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_COST_BIT_ARM = 0x2,
  VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_RESERVED_30_BIT_ARM = 0x40000000
} VkDataGraphOpticalFlowCreateFlagBitsARM;

typedef enum VkDataGraphOpticalFlowPerformanceLevelARM {
  VK_DATA_GRAPH_OPTICAL_FLOW_PERFORMANCE_LEVEL_UNKNOWN_ARM = 0,
  VK_DATA_GRAPH_OPTICAL_FLOW_PERFORMANCE_LEVEL_SLOW_ARM = 1,
  VK_DATA_GRAPH_OPTICAL_FLOW_PERFORMANCE_LEVEL_MEDIUM_ARM = 2,
  VK_DATA_GRAPH_OPTICAL_FLOW_PERFORMANCE_LEVEL_FAST_ARM = 3,
  VK_DATA_GRAPH_OPTICAL_FLOW_PERFORMANCE_LEVEL_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphOpticalFlowPerformanceLevelARM;

typedef VkFlags VkDataGraphOpticalFlowGridSizeFlagsARM;
typedef enum VkDataGraphOpticalFlowGridSizeFlagBitsARM {
  VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_UNKNOWN_ARM = 0,
  VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_1X1_BIT_ARM = 0x1,
  VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_2X2_BIT_ARM = 0x2,
  VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_4X4_BIT_ARM = 0x4,
  VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_8X8_BIT_ARM = 0x8
} VkDataGraphOpticalFlowGridSizeFlagBitsARM;

typedef VkFlags VkDataGraphOpticalFlowExecuteFlagsARM;
typedef enum VkDataGraphOpticalFlowExecuteFlagBitsARM {
  VK_DATA_GRAPH_OPTICAL_FLOW_EXECUTE_DISABLE_TEMPORAL_HINTS_BIT_ARM = 0x1,
  VK_DATA_GRAPH_OPTICAL_FLOW_EXECUTE_INPUT_UNCHANGED_BIT_ARM = 0x2,
  VK_DATA_GRAPH_OPTICAL_FLOW_EXECUTE_REFERENCE_UNCHANGED_BIT_ARM = 0x4,
  VK_DATA_GRAPH_OPTICAL_FLOW_EXECUTE_INPUT_IS_PREVIOUS_REFERENCE_BIT_ARM = 0x8,
  VK_DATA_GRAPH_OPTICAL_FLOW_EXECUTE_REFERENCE_IS_PREVIOUS_INPUT_BIT_ARM = 0x10
} VkDataGraphOpticalFlowExecuteFlagBitsARM;

typedef enum VkDataGraphPipelineNodeTypeARM {
  VK_DATA_GRAPH_PIPELINE_NODE_TYPE_OPTICAL_FLOW_ARM = 1000631000,
  VK_DATA_GRAPH_PIPELINE_NODE_TYPE_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphPipelineNodeTypeARM;

typedef enum VkDataGraphPipelineNodeConnectionTypeARM {
  VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_INPUT_ARM = 1000631000,
  VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_REFERENCE_ARM = 1000631001,
  VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_HINT_ARM = 1000631002,
  VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_FLOW_VECTOR_ARM = 1000631003,
  VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_COST_ARM = 1000631004,
  VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_MAX_ENUM_ARM = 0x7FFFFFFF
} VkDataGraphPipelineNodeConnectionTypeARM;

typedef struct VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM {
  VkStructureType sType;
  void* pNext;
  VkBool32 dataGraphOpticalFlow;
} VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM;

typedef struct VkQueueFamilyDataGraphOpticalFlowPropertiesARM {
  VkStructureType sType;
  void* pNext;
  VkDataGraphOpticalFlowGridSizeFlagsARM supportedOutputGridSizes;
  VkDataGraphOpticalFlowGridSizeFlagsARM supportedHintGridSizes;
  VkBool32 hintSupported;
  VkBool32 costSupported;
  uint32_t minWidth;
  uint32_t minHeight;
  uint32_t maxWidth;
  uint32_t maxHeight;
} VkQueueFamilyDataGraphOpticalFlowPropertiesARM;

typedef struct VkDataGraphPipelineOpticalFlowCreateInfoARM {
  VkStructureType sType;
  void* pNext;
  uint32_t width;
  uint32_t height;
  VkFormat imageFormat;
  VkFormat flowVectorFormat;
  VkFormat costFormat;
  VkDataGraphOpticalFlowGridSizeFlagsARM outputGridSize;
  VkDataGraphOpticalFlowGridSizeFlagsARM hintGridSize;
  VkDataGraphOpticalFlowPerformanceLevelARM performanceLevel;
  VkDataGraphOpticalFlowCreateFlagsARM flags;
} VkDataGraphPipelineOpticalFlowCreateInfoARM;

typedef struct VkDataGraphOpticalFlowImageFormatPropertiesARM {
  VkStructureType sType;
  void* pNext;
  VkFormat format;
} VkDataGraphOpticalFlowImageFormatPropertiesARM;

typedef struct VkDataGraphOpticalFlowImageFormatInfoARM {
  VkStructureType sType;
  const void* pNext;
  VkDataGraphOpticalFlowImageUsageFlagsARM usage;
} VkDataGraphOpticalFlowImageFormatInfoARM;

typedef struct VkDataGraphPipelineOpticalFlowDispatchInfoARM {
  VkStructureType sType;
  void* pNext;
  VkDataGraphOpticalFlowExecuteFlagsARM flags;
  uint32_t meanFlowL1NormHint;
} VkDataGraphPipelineOpticalFlowDispatchInfoARM;

typedef struct VkDataGraphPipelineResourceInfoImageLayoutARM {
  VkStructureType sType;
  const void* pNext;
  VkImageLayout layout;
} VkDataGraphPipelineResourceInfoImageLayoutARM;

typedef struct VkDataGraphPipelineSingleNodeConnectionARM {
  VkStructureType sType;
  void* pNext;
  uint32_t set;
  uint32_t binding;
  VkDataGraphPipelineNodeConnectionTypeARM connection;
} VkDataGraphPipelineSingleNodeConnectionARM;

typedef struct VkDataGraphPipelineSingleNodeCreateInfoARM {
  VkStructureType sType;
  void* pNext;
  VkDataGraphPipelineNodeTypeARM nodeType;
  uint32_t connectionCount;
  const VkDataGraphPipelineSingleNodeConnectionARM* pConnections;
} VkDataGraphPipelineSingleNodeCreateInfoARM;

typedef VkResult(VKAPI_PTR* PFN_vkGetPhysicalDeviceQueueFamilyDataGraphOpticalFlowImageFormatsARM)(
    VkPhysicalDevice physicalDevice, uint32_t queueFamilyIndex,
    const VkQueueFamilyDataGraphPropertiesARM* pQueueFamilyDataGraphProperties,
    const VkDataGraphOpticalFlowImageFormatInfoARM* pOpticalFlowImageFormatInfo,
    uint32_t* pFormatCount, VkDataGraphOpticalFlowImageFormatPropertiesARM* pImageFormatProperties);
#endif

#ifdef __cplusplus
}
#endif

#endif
