// What the application is told of a physical device.
#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "ir/verify/verify.h"
#include "tools/layer/chain.h"
#include "tools/layer/extensions.h"
#include "tools/layer/optical_flow.h"
#include "tools/layer/tensor.h"
#include "tools/layer/tensor_shader.h"

namespace shale::layer {
namespace {

struct Offer {
  const char* name;
  uint32_t version;
  bool Physical::*has = nullptr;  ///< what the device must have; nothing if null

  bool on(const Physical& physical) const { return !has || physical.*has; }
};
// Each has a row in the manifest too, or the loader refuses it.
constexpr Offer kOffers[] = {
    {VK_ARM_TENSORS_EXTENSION_NAME, VK_ARM_TENSORS_SPEC_VERSION},
    {VK_ARM_DATA_GRAPH_EXTENSION_NAME, VK_ARM_DATA_GRAPH_SPEC_VERSION},
    {VK_ARM_DATA_GRAPH_INSTRUCTION_SET_TOSA_EXTENSION_NAME,
     VK_ARM_DATA_GRAPH_INSTRUCTION_SET_TOSA_SPEC_VERSION},
    {VK_ARM_DATA_GRAPH_OPTICAL_FLOW_EXTENSION_NAME, VK_ARM_DATA_GRAPH_OPTICAL_FLOW_SPEC_VERSION,
     &Physical::optical_flow},
};

/// What they depend on, lent where the device has it not.
struct Lent {
  Offer offer;
  bool Physical::*lends;
};
constexpr Lent kLent[] = {
    {{VK_KHR_MAINTENANCE_5_EXTENSION_NAME, VK_KHR_MAINTENANCE_5_SPEC_VERSION},
     &Physical::lends_maintenance5},
    {{VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME, VK_KHR_DEFERRED_HOST_OPERATIONS_SPEC_VERSION},
     &Physical::lends_deferred},
};

constexpr VkDataGraphTOSANameQualityARM kProfiles[] = {
    {"PRO-INT",
     VK_DATA_GRAPH_TOSA_QUALITY_ACCELERATED_ARM | VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM},
    {"PRO-FP", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM}};

/// An extension, and an operator and a type that only it has.
struct TosaExtension {
  VkDataGraphTOSANameQualityARM quality;
  std::optional<std::pair<Op, DType>> witness = {};
};
constexpr TosaExtension kTosaExtensions[] = {
    {{"EXT-INT16", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM},
     std::pair{Op::kConv2d, DType::kInt16}},
    {{"EXT-INT4", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM}},
    {{"EXT-DOUBLEROUND", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM}},
    {{"EXT-BF16", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM}, std::pair{Op::kConv2d, DType::kBf16}},
    {{"EXT-FP8E4M3", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM},
     std::pair{Op::kConv2d, DType::kFp8E4M3}},
    {{"EXT-FP8E5M2", VK_DATA_GRAPH_TOSA_QUALITY_CONFORMANT_ARM},
     std::pair{Op::kConv2d, DType::kFp8E5M2}},
    // Up to 1024 elements on an axis, where the level asks for 8192.
    {{"EXT-FFT", VK_DATA_GRAPH_TOSA_QUALITY_EXPERIMENTAL_ARM},
     std::pair{Op::kFft2d, DType::kFp32}}};

/// Those whose operators and types the verifier's table has.
const std::vector<VkDataGraphTOSANameQualityARM>& tosa_extensions() {
  static const std::vector<VkDataGraphTOSANameQualityARM> list = [] {
    std::vector<VkDataGraphTOSANameQualityARM> found;
    for (const TosaExtension& each : kTosaExtensions)
      if (!each.witness || accepts(each.witness->first, each.witness->second))
        found.push_back(each.quality);
    return found;
  }();
  return list;
}

/// The two-call pattern of Vulkan over a list of our own.
template <typename T, typename Write>
VkResult enumerate(uint32_t available, uint32_t* count, T* results, const Write& write) {
  if (!results) {
    *count = available;
    return VK_SUCCESS;
  }
  const uint32_t written = std::min(*count, available);
  for (uint32_t i = 0; i < written; ++i) write(results[i], i);
  *count = written;
  return written < available ? VK_INCOMPLETE : VK_SUCCESS;
}

VkResult extensions_below(const Instance& instance, VkPhysicalDevice physical,
                          std::vector<VkExtensionProperties>& list) {
  uint32_t count = 0;
  VkResult result = instance.EnumerateDeviceExtensionProperties(physical, nullptr, &count, nullptr);
  if (result != VK_SUCCESS) return result;
  list.resize(count);
  result = instance.EnumerateDeviceExtensionProperties(physical, nullptr, &count, list.data());
  list.resize(count);
  return result;
}

bool has_name(const std::vector<VkExtensionProperties>& list, const char* name) {
  return std::any_of(list.begin(), list.end(), [&](const VkExtensionProperties& each) {
    return std::strcmp(each.extensionName, name) == 0;
  });
}

/// Formats that came with the layer's extensions: devices know nothing of them.
bool is_new_format(const Physical& physical, VkFormat format) {
  const int block = static_cast<int>(format) / 1000;
  return block == 1000460 || (block == 1000470 && physical.lends_maintenance5);
}

/// Zeros behind a structure's head.
template <typename T>
void clear_body(T& structure) {
  T zeros{};
  zeros.sType = structure.sType;
  zeros.pNext = structure.pNext;
  structure = zeros;
}

/// True where the family can run graphs on the layer.
bool computes(const Physical& physical, uint32_t family) {
  return physical.serves && family < physical.families.size() &&
         physical.families[family].queueFlags & VK_QUEUE_COMPUTE_BIT;
}

void add_graph_bit(const Physical& physical, uint32_t count, VkQueueFamilyProperties* families,
                   size_t stride) {
  for (uint32_t i = 0; physical.serves && families && i < count; ++i) {
    if (families->queueFlags & VK_QUEUE_COMPUTE_BIT)
      families->queueFlags |= VK_QUEUE_DATA_GRAPH_BIT_ARM;
    families =
        reinterpret_cast<VkQueueFamilyProperties*>(reinterpret_cast<char*>(families) + stride);
  }
}

/// True where the layer steps aside, and the device below has the function itself.
template <typename Function>
bool below_answers(Instance& instance, VkPhysicalDevice physical, Function function) {
  return function && !instance.physical(physical).serves;
}

/// Tensors in shaders take elements of all sizes that a device below may hold in buffers.
bool tensor_shaders(const Physical& physical) {
  const FeatureSet features = physical.caps.features;
  return features.has(Feature::kStorageBuffer8) && features.has(Feature::kInt8) &&
         features.has(Feature::kStorageBuffer16);
}

/// As Physical has it, of a device with VK_EXT_descriptor_buffer. Which size counts depends on the device's
/// features, and that of tensors is told before: so both have to be equal.
size_t storage_descriptor_bytes(const Physical& physical, const vk::Functions& functions) {
  VkPhysicalDeviceDescriptorBufferFeaturesEXT buffers{};
  buffers.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_FEATURES_EXT;
  VkPhysicalDeviceFeatures2 features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
  features.pNext = &buffers;
  functions.GetPhysicalDeviceFeatures2(physical.handle, &features);
  VkPhysicalDeviceDescriptorBufferPropertiesEXT sizes{};
  sizes.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_PROPERTIES_EXT;
  VkPhysicalDeviceProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
  properties.pNext = &sizes;
  functions.GetPhysicalDeviceProperties2(physical.handle, &properties);
  return buffers.descriptorBuffer && physical.features12.bufferDeviceAddress &&
                 tensor_shaders(physical) &&
                 sizes.storageBufferDescriptorSize == sizes.robustStorageBufferDescriptorSize
             ? sizes.storageBufferDescriptorSize
             : 0;
}

/// What tensors can do that have that format.
VkFormatFeatureFlags2 tensor_features(const Physical& physical, VkFormat format,
                                      VkTensorTilingARM tiling) {
  const uint32_t element = tensor_element_bytes(format);
  if (element == 0) return 0;
  VkFormatFeatureFlags2 features =
      VK_FORMAT_FEATURE_2_TRANSFER_SRC_BIT | VK_FORMAT_FEATURE_2_TRANSFER_DST_BIT;
  if (graph_dtype(format) != DType::kUnknown)
    features |= VK_FORMAT_FEATURE_2_TENSOR_DATA_GRAPH_BIT_ARM;
  if (tensor_shaders(physical)) features |= VK_FORMAT_FEATURE_2_TENSOR_SHADER_BIT_ARM;
  if (tiling == VK_TENSOR_TILING_OPTIMAL_ARM && element <= 4 && format != VK_FORMAT_R8_BOOL_ARM)
    features |= VK_FORMAT_FEATURE_2_TENSOR_IMAGE_ALIASING_BIT_ARM;
  return features;
}

/// What optical flow can do with images of the format.
VkFormatFeatureFlags2 flow_features(const Physical& physical, VkFormat format) {
  constexpr std::pair<VkDataGraphOpticalFlowImageUsageFlagsARM, VkFormatFeatureFlags2> kUses[] = {
      {VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_INPUT_BIT_ARM,
       VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_IMAGE_BIT_ARM},
      {VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM,
       VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_VECTOR_BIT_ARM},
      {VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM,
       VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_COST_BIT_ARM}};
  VkFormatFeatureFlags2 features = 0;
  for (const auto& [usage, bit] : kUses) {
    const auto formats = flow_formats(usage);
    if (physical.optical_flow && std::find(formats.begin(), formats.end(), format) != formats.end())
      features |= bit;
  }
  return features;
}

}  // namespace

bool offered(const Physical& physical, std::string_view extension) {
  return physical.serves && (std::any_of(std::begin(kOffers), std::end(kOffers),
                                         [&](const Offer& offer) {
                                           return extension == offer.name && offer.on(physical);
                                         }) ||
                             std::any_of(std::begin(kLent), std::end(kLent), [&](const Lent& lent) {
                               return physical.*lent.lends && extension == lent.offer.name;
                             }));
}

void fill_features(const Physical& physical, void* chain) {
  if (auto* tensors = find_in_chain<VkPhysicalDeviceTensorFeaturesARM>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM)) {
    clear_body(*tensors);
    tensors->tensorNonPacked = tensors->tensors = VK_TRUE;
    tensors->shaderTensorAccess = tensor_shaders(physical);
    tensors->shaderStorageTensorArrayDynamicIndexing =
        tensors->shaderTensorAccess && physical.dynamic_indexing;
    tensors->shaderStorageTensorArrayNonUniformIndexing =
        tensors->shaderTensorAccess &&
        physical.features12.shaderStorageBufferArrayNonUniformIndexing;
    tensors->descriptorBindingStorageTensorUpdateAfterBind =
        physical.features12.descriptorBindingStorageBufferUpdateAfterBind;
  }
  if (auto* graphs = find_in_chain<VkPhysicalDeviceDataGraphFeaturesARM>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM)) {
    clear_body(*graphs);
    graphs->dataGraph = graphs->dataGraphShaderModule = VK_TRUE;
    graphs->dataGraphSpecializationConstants = VK_TRUE;
    graphs->dataGraphDescriptorBuffer = physical.storage_descriptor_bytes != 0;
    graphs->dataGraphUpdateAfterBind =
        tensor_shaders(physical) &&  // of padded tensors a shader has to hold the elements
        physical.features12.descriptorBindingStorageBufferUpdateAfterBind &&
        physical.features12.descriptorBindingUniformTexelBufferUpdateAfterBind;
  }
  if (auto* buffers = find_in_chain<VkPhysicalDeviceDescriptorBufferTensorFeaturesARM>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_FEATURES_ARM))
    buffers->descriptorBufferTensorDescriptors = physical.storage_descriptor_bytes != 0;
  if (auto* flow = find_in_chain<VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM))
    flow->dataGraphOpticalFlow = physical.optical_flow;
  if (auto* lent = find_in_chain<VkPhysicalDeviceMaintenance5FeaturesKHR>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_FEATURES_KHR);
      lent && physical.lends_maintenance5)
    lent->maintenance5 = VK_TRUE;
}

void fill_properties(const Physical& physical, void* chain) {
  if (auto* found = find_in_chain<VkPhysicalDeviceTensorPropertiesARM>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_PROPERTIES_ARM)) {
    constexpr uint64_t kWidestElement = 8;
    const uint64_t bytes = physical.max_tensor_bytes();
    VkPhysicalDeviceTensorPropertiesARM& tensors = *found;
    clear_body(tensors);
    tensors.maxTensorDimensionCount = kMaxTensorRank;
    tensors.maxTensorElements = tensors.maxPerDimensionTensorElements = bytes / kWidestElement;
    tensors.maxTensorStride = static_cast<int64_t>(bytes);
    tensors.maxTensorSize = bytes;
    tensors.maxTensorShaderAccessArrayLength = 32;
    tensors.maxTensorShaderAccessSize = 32 * kWidestElement;
    tensors.maxDescriptorSetStorageTensors =
        physical.limits.maxDescriptorSetStorageBuffers / kBuffersOfTensor;
    tensors.maxPerStageDescriptorSetStorageTensors =
        physical.limits.maxPerStageDescriptorStorageBuffers / kBuffersOfTensor;
    const VkPhysicalDeviceVulkan12Properties& more = physical.properties12;
    if (physical.features12.descriptorBindingStorageBufferUpdateAfterBind) {
      tensors.maxDescriptorSetUpdateAfterBindStorageTensors =
          more.maxDescriptorSetUpdateAfterBindStorageBuffers / kBuffersOfTensor;
      tensors.maxPerStageDescriptorUpdateAfterBindStorageTensors =
          more.maxPerStageDescriptorUpdateAfterBindStorageBuffers / kBuffersOfTensor;
    }
    tensors.shaderStorageTensorArrayNonUniformIndexingNative =
        more.shaderStorageBufferArrayNonUniformIndexingNative;
    tensors.shaderTensorSupportedStages = VK_SHADER_STAGE_COMPUTE_BIT;
  }
  if (auto* buffers = find_in_chain<VkPhysicalDeviceDescriptorBufferTensorPropertiesARM>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_PROPERTIES_ARM)) {
    clear_body(*buffers);
    buffers->tensorDescriptorSize = kBuffersOfTensor * physical.storage_descriptor_bytes;
  }
  // What a device does not promise is false.
  if (auto* lent = find_in_chain<VkPhysicalDeviceMaintenance5PropertiesKHR>(
          chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_PROPERTIES_KHR);
      lent && physical.lends_maintenance5)
    clear_body(*lent);
}

const Physical& Instance::physical(VkPhysicalDevice wanted) {
  const std::lock_guard lock(mutex);
  std::unique_ptr<Physical>& slot = physicals[wanted];
  if (slot) return *slot;
  auto found = std::make_unique<Physical>();
  found->handle = wanted;
  std::vector<VkExtensionProperties> extensions;
  if (functions.GetPhysicalDeviceProperties &&
      extensions_below(*this, wanted, extensions) == VK_SUCCESS) {
    VkPhysicalDeviceProperties properties;
    functions.GetPhysicalDeviceProperties(wanted, &properties);
    uint32_t count = 0;
    functions.GetPhysicalDeviceQueueFamilyProperties(wanted, &count, nullptr);
    found->families.resize(count);
    functions.GetPhysicalDeviceQueueFamilyProperties(wanted, &count, found->families.data());
    const bool native =
        std::any_of(std::begin(kOffers), std::end(kOffers),
                    [&](const Offer& offer) { return has_name(extensions, offer.name); });
    const bool is_new_enough = properties.apiVersion >= VK_API_VERSION_1_3;
    found->serves = is_new_enough && !native && vk::choose_queue_family(found->families);
    found->limits = properties.limits;
    if (found->serves) {
      for (const Lent& lent : kLent) (*found).*lent.lends = !has_name(extensions, lent.offer.name);
      found->caps = vk::snapshot_caps(wanted, functions);
      VkPhysicalDeviceFeatures2 features{};
      features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
      features.pNext = &found->features12;
      found->features12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES;
      functions.GetPhysicalDeviceFeatures2(wanted, &features);
      found->dynamic_indexing = features.features.shaderStorageBufferArrayDynamicIndexing;
      found->optical_flow = features.features.shaderStorageImageExtendedFormats;
      VkPhysicalDeviceProperties2 more{};
      more.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
      more.pNext = &found->properties12;
      found->properties12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES;
      functions.GetPhysicalDeviceProperties2(wanted, &more);
      if (has_name(extensions, VK_EXT_DESCRIPTOR_BUFFER_EXTENSION_NAME))
        found->storage_descriptor_bytes = storage_descriptor_bytes(*found, functions);
    }
  }
  slot = std::move(found);
  return *slot;
}

VkResult VKAPI_CALL EnumerateDeviceExtensionProperties(VkPhysicalDevice physical, const char* layer,
                                                       uint32_t* count,
                                                       VkExtensionProperties* results) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    const bool ours = layer && std::strcmp(layer, "VK_LAYER_SHALE_data_graph") == 0;
    if (layer && !ours)
      return instance->EnumerateDeviceExtensionProperties(physical, layer, count, results);
    std::vector<VkExtensionProperties> list;
    if (!ours) {
      const VkResult below = extensions_below(*instance, physical, list);
      if (below != VK_SUCCESS) return below;
    }
    const Physical& known = instance->physical(physical);
    const auto add = [&](const Offer& offer) {
      VkExtensionProperties& added = list.emplace_back();
      std::strncpy(added.extensionName, offer.name, sizeof added.extensionName - 1);
      added.specVersion = offer.version;
    };
    if (known.serves) {
      for (const Offer& offer : kOffers)
        if (offer.on(known)) add(offer);
      for (const Lent& lent : kLent)
        if (known.*lent.lends) add(lent.offer);
    }
    return enumerate(static_cast<uint32_t>(list.size()), count, results,
                     [&](VkExtensionProperties& result, uint32_t i) { result = list[i]; });
  });
}

void VKAPI_CALL GetPhysicalDeviceFeatures2(VkPhysicalDevice physical,
                                           VkPhysicalDeviceFeatures2* features) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    const bool serves = known.serves;
    {
      std::optional<WithoutLayers> without;
      if (serves) without.emplace(features, known.lends_maintenance5);
      instance->GetPhysicalDeviceFeatures2(physical, features);
    }
    if (serves) fill_features(known, features->pNext);
  });
}

void VKAPI_CALL GetPhysicalDeviceProperties2(VkPhysicalDevice physical,
                                             VkPhysicalDeviceProperties2* properties) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    {
      std::optional<WithoutLayers> without;
      if (known.serves) without.emplace(properties, known.lends_maintenance5);
      instance->GetPhysicalDeviceProperties2(physical, properties);
    }
    if (known.serves) fill_properties(known, properties->pNext);
  });
}

void VKAPI_CALL GetPhysicalDeviceFormatProperties(VkPhysicalDevice physical, VkFormat format,
                                                  VkFormatProperties* properties) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    if (known.serves && is_new_format(known, format))
      *properties = {};
    else
      instance->GetPhysicalDeviceFormatProperties(physical, format, properties);
  });
}

void VKAPI_CALL GetPhysicalDeviceFormatProperties2(VkPhysicalDevice physical, VkFormat format,
                                                   VkFormatProperties2* properties) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    if (!known.serves) {
      instance->GetPhysicalDeviceFormatProperties2(physical, format, properties);
      return;
    }
    const bool is_known_below = !is_new_format(known, format);
    {
      const WithoutLayers without(properties);
      if (is_known_below)
        instance->GetPhysicalDeviceFormatProperties2(physical, format, properties);
      else
        properties->formatProperties = {};
    }
    if (auto* tensors = find_in_chain<VkTensorFormatPropertiesARM>(
            properties->pNext, VK_STRUCTURE_TYPE_TENSOR_FORMAT_PROPERTIES_ARM)) {
      tensors->optimalTilingTensorFeatures =
          tensor_features(known, format, VK_TENSOR_TILING_OPTIMAL_ARM);
      tensors->linearTilingTensorFeatures =
          tensor_features(known, format, VK_TENSOR_TILING_LINEAR_ARM);
    }
    // Images that tensors may be aliased with are linear below.
    if (auto* images = find_in_chain<VkFormatProperties3>(properties->pNext,
                                                          VK_STRUCTURE_TYPE_FORMAT_PROPERTIES_3);
        images) {
      if (images->linearTilingFeatures != 0)
        images->optimalTilingFeatures |= VK_FORMAT_FEATURE_2_TENSOR_IMAGE_ALIASING_BIT_ARM;
      images->optimalTilingFeatures |= flow_features(known, format);
    }
  });
}

VkResult VKAPI_CALL GetPhysicalDeviceImageFormatProperties(
    VkPhysicalDevice physical, VkFormat format, VkImageType type, VkImageTiling tiling,
    VkImageUsageFlags usage, VkImageCreateFlags flags, VkImageFormatProperties* result) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    if (known.serves && is_new_format(known, format)) return VK_ERROR_FORMAT_NOT_SUPPORTED;
    if (known.serves && usage & VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM) {
      usage &= ~VkImageUsageFlags{VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM};
      tiling = VK_IMAGE_TILING_LINEAR;  // as objects.cpp makes them
    }
    return instance->GetPhysicalDeviceImageFormatProperties(physical, format, type, tiling, usage,
                                                            flags, result);
  });
}

VkResult VKAPI_CALL GetPhysicalDeviceImageFormatProperties2(
    VkPhysicalDevice physical, const VkPhysicalDeviceImageFormatInfo2* info,
    VkImageFormatProperties2* result) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    if (known.serves && is_new_format(known, info->format)) return VK_ERROR_FORMAT_NOT_SUPPORTED;
    VkPhysicalDeviceImageFormatInfo2 below = *info;
    std::optional<ChainCopy> chain;
    if (known.serves &&
        find_in_chain<VkDataGraphOpticalFlowImageFormatInfoARM>(
            info->pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_INFO_ARM))
      below.pNext = chain.emplace(info->pNext).next();
    if (known.serves && info->usage & VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM) {
      below.usage &= ~VkImageUsageFlags{VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM};
      below.tiling = VK_IMAGE_TILING_LINEAR;
    }
    return instance->GetPhysicalDeviceImageFormatProperties2(physical, &below, result);
  });
}

void VKAPI_CALL GetPhysicalDeviceQueueFamilyProperties(VkPhysicalDevice physical, uint32_t* count,
                                                       VkQueueFamilyProperties* results) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    instance->GetPhysicalDeviceQueueFamilyProperties(physical, count, results);
    add_graph_bit(instance->physical(physical), *count, results, sizeof *results);
  });
}

void VKAPI_CALL GetPhysicalDeviceQueueFamilyProperties2(VkPhysicalDevice physical, uint32_t* count,
                                                        VkQueueFamilyProperties2* results) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    instance->GetPhysicalDeviceQueueFamilyProperties2(physical, count, results);
    add_graph_bit(instance->physical(physical), *count,
                  results ? &results->queueFamilyProperties : nullptr, sizeof *results);
  });
}

void VKAPI_CALL GetPhysicalDeviceExternalTensorPropertiesARM(
    VkPhysicalDevice physical, const VkPhysicalDeviceExternalTensorInfoARM* info,
    VkExternalTensorPropertiesARM* result) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    if (below_answers(*instance, physical, instance->GetPhysicalDeviceExternalTensorPropertiesARM))
      return instance->GetPhysicalDeviceExternalTensorPropertiesARM(physical, info, result);
    result->externalMemoryProperties = {};
    if (!instance->GetPhysicalDeviceExternalBufferProperties) return;
    VkPhysicalDeviceExternalBufferInfo buffer{};
    buffer.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_EXTERNAL_BUFFER_INFO;
    buffer.usage = kTensorUsage;
    buffer.handleType = info->handleType;
    VkExternalBufferProperties properties{};
    properties.sType = VK_STRUCTURE_TYPE_EXTERNAL_BUFFER_PROPERTIES;
    instance->GetPhysicalDeviceExternalBufferProperties(physical, &buffer, &properties);
    result->externalMemoryProperties = properties.externalMemoryProperties;
  });
}

VkResult VKAPI_CALL GetPhysicalDeviceQueueFamilyDataGraphPropertiesARM(
    VkPhysicalDevice physical, uint32_t family, uint32_t* count,
    VkQueueFamilyDataGraphPropertiesARM* results) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    if (below_answers(*instance, physical,
                      instance->GetPhysicalDeviceQueueFamilyDataGraphPropertiesARM))
      return instance->GetPhysicalDeviceQueueFamilyDataGraphPropertiesARM(physical, family, count,
                                                                          results);
    constexpr VkPhysicalDeviceDataGraphOperationSupportARM kOperations[] = {
        {VK_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_TYPE_SPIRV_EXTENDED_INSTRUCTION_SET_ARM,
         "TOSA.001000.1", 0},
        {VK_PHYSICAL_DEVICE_DATA_GRAPH_OPERATION_TYPE_OPTICAL_FLOW_ARM, "OpticalFlow", 1}};
    const Physical& known = instance->physical(physical);
    const uint32_t available = !computes(known, family) ? 0 : known.optical_flow ? 2 : 1;
    return enumerate(
        available, count, results, [&](VkQueueFamilyDataGraphPropertiesARM& result, uint32_t i) {
          result.engine = {VK_PHYSICAL_DEVICE_DATA_GRAPH_PROCESSING_ENGINE_TYPE_DEFAULT_ARM,
                           VK_FALSE};
          result.operation = kOperations[i];
        });
  });
}

void VKAPI_CALL GetPhysicalDeviceQueueFamilyDataGraphProcessingEnginePropertiesARM(
    VkPhysicalDevice physical,
    const VkPhysicalDeviceQueueFamilyDataGraphProcessingEngineInfoARM* info,
    VkQueueFamilyDataGraphProcessingEnginePropertiesARM* result) {
  guarded_void([&] {
    const auto instance = instance_of(physical);
    const auto below = instance->GetPhysicalDeviceQueueFamilyDataGraphProcessingEnginePropertiesARM;
    if (below_answers(*instance, physical, below)) return below(physical, info, result);
    // The engine is the device itself, so nothing has to be exported to it.
    result->foreignSemaphoreHandleTypes = 0;
    result->foreignMemoryHandleTypes = 0;
  });
}

VkResult VKAPI_CALL GetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM(
    VkPhysicalDevice physical, uint32_t family, const VkQueueFamilyDataGraphPropertiesARM* which,
    VkBaseOutStructure* result) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    const auto below = instance->GetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM;
    if (below_answers(*instance, physical, below)) return below(physical, family, which, result);
    if (auto* tosa = find_in_chain<VkQueueFamilyDataGraphTOSAPropertiesARM>(
            static_cast<void*>(result),
            VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_TOSA_PROPERTIES_ARM)) {
      tosa->profileCount = static_cast<uint32_t>(std::size(kProfiles));
      tosa->pProfiles = kProfiles;
      tosa->extensionCount = static_cast<uint32_t>(tosa_extensions().size());
      tosa->pExtensions = tosa_extensions().data();
      tosa->level = VK_DATA_GRAPH_TOSA_LEVEL_8K_ARM;
    }
    const Physical& known = instance->physical(physical);
    if (auto* flow = find_in_chain<VkQueueFamilyDataGraphOpticalFlowPropertiesARM>(
            static_cast<void*>(result),
            VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_OPTICAL_FLOW_PROPERTIES_ARM)) {
      clear_body(*flow);
      if (!computes(known, family) || !known.optical_flow) return VK_SUCCESS;
      constexpr VkDataGraphOpticalFlowGridSizeFlagsARM kAll =
          VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_1X1_BIT_ARM |
          VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_2X2_BIT_ARM |
          VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_4X4_BIT_ARM |
          VK_DATA_GRAPH_OPTICAL_FLOW_GRID_SIZE_8X8_BIT_ARM;
      flow->supportedOutputGridSizes = flow->supportedHintGridSizes = kAll;
      flow->hintSupported = flow->costSupported = VK_TRUE;
      flow->minWidth = flow->minHeight = 1;
      flow->maxWidth = flow->maxHeight = max_flow_side(known);
    }
    return VK_SUCCESS;
  });
}

VkResult VKAPI_CALL GetPhysicalDeviceQueueFamilyDataGraphOpticalFlowImageFormatsARM(
    VkPhysicalDevice physical, uint32_t family, const VkQueueFamilyDataGraphPropertiesARM* which,
    const VkDataGraphOpticalFlowImageFormatInfoARM* info, uint32_t* count,
    VkDataGraphOpticalFlowImageFormatPropertiesARM* results) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    const auto below = instance->GetPhysicalDeviceQueueFamilyDataGraphOpticalFlowImageFormatsARM;
    if (below_answers(*instance, physical, below))
      return below(physical, family, which, info, count, results);
    const Physical& known = instance->physical(physical);
    if (!computes(known, family) || !known.optical_flow) {
      *count = 0;
      return VK_ERROR_EXTENSION_NOT_PRESENT;
    }
    const std::span<const VkFormat> formats = flow_formats(info->usage);
    return enumerate(static_cast<uint32_t>(formats.size()), count, results,
                     [&](VkDataGraphOpticalFlowImageFormatPropertiesARM& result, uint32_t i) {
                       result.format = formats[i];
                     });
  });
}

void Instance::report(VkDebugUtilsMessageSeverityFlagBitsEXT severity, VkObjectType type,
                      uint64_t object, const std::string& text) {
  std::vector<VkDebugUtilsMessengerCreateInfoEXT> listeners;
  {
    const std::lock_guard lock(mutex);
    for (const auto& [messenger, info] : messengers) listeners.push_back(info);
  }
  VkDebugUtilsObjectNameInfoEXT named{};
  named.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT;
  named.objectType = type;
  named.objectHandle = object;
  VkDebugUtilsMessengerCallbackDataEXT data{};
  data.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CALLBACK_DATA_EXT;
  data.pMessageIdName = "SHALE-data-graph";
  data.pMessage = text.c_str();
  data.objectCount = 1;
  data.pObjects = &named;
  constexpr VkDebugUtilsMessageTypeFlagsEXT kType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
  for (const VkDebugUtilsMessengerCreateInfoEXT& info : listeners)
    if (info.messageSeverity & severity && info.messageType & kType)
      info.pfnUserCallback(severity, kType, &data, info.pUserData);
}

VkResult VKAPI_CALL CreateDebugUtilsMessengerEXT(VkInstance instance,
                                                 const VkDebugUtilsMessengerCreateInfoEXT* info,
                                                 const VkAllocationCallbacks* allocator,
                                                 VkDebugUtilsMessengerEXT* messenger) {
  return guarded([&]() -> VkResult {
    const auto data = instance_of(instance);
    const VkResult result =
        data->CreateDebugUtilsMessengerEXT(instance, info, allocator, messenger);
    if (result != VK_SUCCESS) return result;
    const std::lock_guard lock(data->mutex);
    data->messengers[*messenger] = *info;
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyDebugUtilsMessengerEXT(VkInstance instance,
                                              VkDebugUtilsMessengerEXT messenger,
                                              const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    const auto data = instance_of(instance);
    {
      const std::lock_guard lock(data->mutex);
      data->messengers.erase(messenger);
    }
    data->DestroyDebugUtilsMessengerEXT(instance, messenger, allocator);
  });
}

}  // namespace shale::layer
