#include "tools/layer/device_features.h"

#include <algorithm>

#include "tools/layer/extensions.h"

namespace shale::layer {
namespace {

/// Every feature that `wanted` sets is set in `offered` too: structures of one type with only VkBool32
/// members behind their head, `last` of them before what may be padding.
template <typename T>
bool all_offered(const T& wanted, const T& offered, VkBool32 T::*last) {
  constexpr size_t kHead = sizeof(VkBaseInStructure);
  const auto end = static_cast<size_t>(reinterpret_cast<const char*>(&(wanted.*last) + 1) -
                                       reinterpret_cast<const char*>(&wanted));
  for (size_t at = kHead; at < end; at += sizeof(VkBool32)) {
    VkBool32 ask, have;
    std::memcpy(&ask, reinterpret_cast<const char*>(&wanted) + at, sizeof ask);
    std::memcpy(&have, reinterpret_cast<const char*>(&offered) + at, sizeof have);
    if (ask && !have) return false;
  }
  return true;
}

template <typename T>
Result<void> check_feature_struct(const Physical& physical, const VkDeviceCreateInfo& info,
                                  VkStructureType type, VkBool32 T::*last, const char* name) {
  const T* asked = find_in_chain<T>(info.pNext, type);
  if (!asked) return {};
  T have{};
  have.sType = type;
  fill_features(physical, &have);
  if (all_offered(*asked, have, last)) return {};
  return unsupported(name, "asks for a feature that the layer does not report");
}

/// Sets a member of the structure of a Vulkan version if it is chained, else of that of the extension,
/// which is added where needed.
template <typename Version, typename Single>
void turn_on(ChainCopy& chain, VkStructureType version_type, VkBool32 Version::*in_version,
             VkStructureType single_type, VkBool32 Single::*in_single) {
  if (auto* version = chain.find<Version>(version_type)) {
    version->*in_version = VK_TRUE;
    return;
  }
  auto* single = chain.find<Single>(single_type);
  if (!single) single = &chain.add<Single>(single_type);
  single->*in_single = VK_TRUE;
}

}  // namespace

Result<void> check_features(const Physical& physical, const VkDeviceCreateInfo& info) {
  SHALE_TRY_VOID(check_feature_struct<VkPhysicalDeviceTensorFeaturesARM>(
      physical, info, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM,
      &VkPhysicalDeviceTensorFeaturesARM::tensors, "VkPhysicalDeviceTensorFeaturesARM"));
  SHALE_TRY_VOID(check_feature_struct<VkPhysicalDeviceDataGraphFeaturesARM>(
      physical, info, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM,
      &VkPhysicalDeviceDataGraphFeaturesARM::dataGraphShaderModule,
      "VkPhysicalDeviceDataGraphFeaturesARM"));
  SHALE_TRY_VOID(check_feature_struct<VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM>(
      physical, info, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM,
      &VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM::dataGraphOpticalFlow,
      "VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM"));
  return check_feature_struct<VkPhysicalDeviceDescriptorBufferTensorFeaturesARM>(
      physical, info, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_FEATURES_ARM,
      &VkPhysicalDeviceDescriptorBufferTensorFeaturesARM::descriptorBufferTensorDescriptors,
      "VkPhysicalDeviceDescriptorBufferTensorFeaturesARM");
}

bool asks_descriptor_buffers(const VkDeviceCreateInfo& info) {
  const auto* tensors = find_in_chain<VkPhysicalDeviceDescriptorBufferTensorFeaturesARM>(
      info.pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_FEATURES_ARM);
  const auto* graphs = find_in_chain<VkPhysicalDeviceDataGraphFeaturesARM>(
      info.pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM);
  const bool has_buffers =
      std::any_of(info.ppEnabledExtensionNames,
                  info.ppEnabledExtensionNames + info.enabledExtensionCount, [](const char* name) {
                    return std::string_view(name) == VK_EXT_DESCRIPTOR_BUFFER_EXTENSION_NAME;
                  });
  return has_buffers && ((tensors && tensors->descriptorBufferTensorDescriptors) ||
                         (graphs && graphs->dataGraphDescriptorBuffer));
}

void add_kernel_features(const Physical& physical, VkDeviceCreateInfo& info,
                         VkPhysicalDeviceFeatures& features, ChainCopy& chain) {
  VkPhysicalDeviceFeatures* base = &features;
  if (auto* chained =
          chain.find<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2)) {
    base = &chained->features;
  } else {
    if (info.pEnabledFeatures) features = *info.pEnabledFeatures;
    info.pEnabledFeatures = &features;
  }
  if (physical.dynamic_indexing) base->shaderStorageBufferArrayDynamicIndexing = VK_TRUE;
  if (const auto* flow = find_in_chain<VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM>(
          info.pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM);
      flow && flow->dataGraphOpticalFlow)
    base->shaderStorageImageExtendedFormats = VK_TRUE;
  const FeatureSet supported = physical.caps.features;
  const auto has = [&](Feature feature) { return supported.has(feature); };
  if (has(Feature::kInt16)) base->shaderInt16 = VK_TRUE;
  if (has(Feature::kInt64)) base->shaderInt64 = VK_TRUE;
  if (has(Feature::kFloat64)) base->shaderFloat64 = VK_TRUE;
  if (has(Feature::kStorageBuffer16))
    turn_on(chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES,
            &VkPhysicalDeviceVulkan11Features::storageBuffer16BitAccess,
            VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_16BIT_STORAGE_FEATURES,
            &VkPhysicalDevice16BitStorageFeatures::storageBuffer16BitAccess);
  const auto turn_on_12 = [&](VkBool32 VkPhysicalDeviceVulkan12Features::*in_version, auto type,
                              auto in_single) {
    turn_on(chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, in_version, type,
            in_single);
  };
  if (has(Feature::kStorageBuffer8))
    turn_on_12(&VkPhysicalDeviceVulkan12Features::storageBuffer8BitAccess,
               VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_8BIT_STORAGE_FEATURES,
               &VkPhysicalDevice8BitStorageFeatures::storageBuffer8BitAccess);
  // What tensors may is what the buffers behind them may.
  const auto* tensors = find_in_chain<VkPhysicalDeviceTensorFeaturesARM>(
      info.pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM);
  constexpr VkStructureType kIndexing =
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_INDEXING_FEATURES;
  if (tensors && tensors->shaderStorageTensorArrayNonUniformIndexing)
    turn_on_12(
        &VkPhysicalDeviceVulkan12Features::shaderStorageBufferArrayNonUniformIndexing, kIndexing,
        &VkPhysicalDeviceDescriptorIndexingFeatures::shaderStorageBufferArrayNonUniformIndexing);
  const auto* graphs = find_in_chain<VkPhysicalDeviceDataGraphFeaturesARM>(
      info.pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM);
  const bool late_graphs = graphs && graphs->dataGraphUpdateAfterBind;
  if (late_graphs)
    turn_on_12(
        &VkPhysicalDeviceVulkan12Features::descriptorBindingUniformTexelBufferUpdateAfterBind,
        kIndexing,
        &VkPhysicalDeviceDescriptorIndexingFeatures::
            descriptorBindingUniformTexelBufferUpdateAfterBind);
  if (late_graphs || (tensors && tensors->descriptorBindingStorageTensorUpdateAfterBind))
    turn_on_12(
        &VkPhysicalDeviceVulkan12Features::descriptorBindingStorageBufferUpdateAfterBind, kIndexing,
        &VkPhysicalDeviceDescriptorIndexingFeatures::descriptorBindingStorageBufferUpdateAfterBind);
  // Descriptors that lie in buffers name memory by its address.
  if (asks_descriptor_buffers(info)) {
    turn_on_12(&VkPhysicalDeviceVulkan12Features::bufferDeviceAddress,
               VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_BUFFER_DEVICE_ADDRESS_FEATURES,
               &VkPhysicalDeviceBufferDeviceAddressFeatures::bufferDeviceAddress);
    constexpr VkStructureType kType =
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_FEATURES_EXT;
    auto* buffers = chain.find<VkPhysicalDeviceDescriptorBufferFeaturesEXT>(kType);
    if (!buffers) buffers = &chain.add<VkPhysicalDeviceDescriptorBufferFeaturesEXT>(kType);
    buffers->descriptorBuffer = VK_TRUE;
  }
  if (has(Feature::kInt8))
    turn_on_12(&VkPhysicalDeviceVulkan12Features::shaderInt8,
               VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES,
               &VkPhysicalDeviceShaderFloat16Int8Features::shaderInt8);
  if (has(Feature::kFloat16))
    turn_on_12(&VkPhysicalDeviceVulkan12Features::shaderFloat16,
               VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES,
               &VkPhysicalDeviceShaderFloat16Int8Features::shaderFloat16);
  if (has(Feature::kDotProduct8))
    turn_on(chain, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
            &VkPhysicalDeviceVulkan13Features::shaderIntegerDotProduct,
            VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_INTEGER_DOT_PRODUCT_FEATURES,
            &VkPhysicalDeviceShaderIntegerDotProductFeatures::shaderIntegerDotProduct);
}

}  // namespace shale::layer
