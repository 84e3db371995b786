// Memory, images, names and private data: what carries an object of the layer to the device below.
#include "tools/layer/chain.h"
#include "tools/layer/graph.h"

namespace shale::layer {
namespace {

/// True for handles that mean nothing to the device.
bool is_layers_object(Device& device, VkObjectType type, uint64_t handle) {
  switch (static_cast<int>(type)) {
    case static_cast<int>(VK_OBJECT_TYPE_TENSOR_ARM):
    case static_cast<int>(VK_OBJECT_TYPE_TENSOR_VIEW_ARM):
    case static_cast<int>(VK_OBJECT_TYPE_DATA_GRAPH_PIPELINE_SESSION_ARM): return true;
    case VK_OBJECT_TYPE_PIPELINE:
      return device.pipelines.find(reinterpret_cast<VkPipeline>(handle)) != nullptr;
    case VK_OBJECT_TYPE_SHADER_MODULE:
      return device.modules.find(reinterpret_cast<VkShaderModule>(handle)) != nullptr;
    case VK_OBJECT_TYPE_DESCRIPTOR_UPDATE_TEMPLATE: {
      const auto update =
          device.templates.find(reinterpret_cast<VkDescriptorUpdateTemplate>(handle));
      return update && !update->below;
    }
    default: return false;
  }
}

/// A tensor's name is that of its buffer; other objects of the layer have none below.
template <typename Info, typename Call>
VkResult name_below(VkDevice handle, const Info& info, const Call& call) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    Info below = info;
    if (info.objectType == VK_OBJECT_TYPE_TENSOR_ARM) {
      below.objectType = VK_OBJECT_TYPE_BUFFER;
      below.objectHandle =
          number_of(tensor_of(reinterpret_cast<VkTensorARM>(info.objectHandle))->buffer);
    } else if (is_layers_object(device, info.objectType, info.objectHandle)) {
      return VK_SUCCESS;
    }
    return call(device, &below);
  });
}

}  // namespace

VkResult VKAPI_CALL AllocateMemory(VkDevice handle, const VkMemoryAllocateInfo* info,
                                   const VkAllocationCallbacks* allocator, VkDeviceMemory* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const auto* dedicated = find_in_chain<VkMemoryDedicatedAllocateInfoTensorARM>(
        info->pNext, VK_STRUCTURE_TYPE_MEMORY_DEDICATED_ALLOCATE_INFO_TENSOR_ARM);
    // Any memory may become that of a tensor or session, which descriptors in buffers name by address.
    const auto* flags = find_in_chain<VkMemoryAllocateFlagsInfo>(
        info->pNext, VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO);
    const bool lacks_address = device.descriptor_buffers &&
                               !(flags && flags->flags & VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT);
    if (!dedicated && !lacks_address) return device.AllocateMemory(handle, info, allocator, result);
    ChainCopy chain(info->pNext);
    if (lacks_address) {
      constexpr VkStructureType kType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO;
      auto* own = chain.find<VkMemoryAllocateFlagsInfo>(kType);
      if (!own) own = &chain.add<VkMemoryAllocateFlagsInfo>(kType);
      own->flags |= VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
    }
    if (dedicated && dedicated->tensor)
      chain.add<VkMemoryDedicatedAllocateInfo>(VK_STRUCTURE_TYPE_MEMORY_DEDICATED_ALLOCATE_INFO)
          .buffer = tensor_of(dedicated->tensor)->buffer;
    VkMemoryAllocateInfo below = *info;
    below.pNext = chain.next();
    return device.AllocateMemory(handle, &below, allocator, result);
  });
}

/// An image that tensors may be aliased with is linear below. What optical flow does with it is in its usage; `chain` is
/// where the rest of the application's goes.
static VkImageCreateInfo image_below(const VkImageCreateInfo& info,
                                     std::optional<ChainCopy>& chain) {
  VkImageCreateInfo below = info;
  if (find_in_chain<VkDataGraphOpticalFlowImageFormatInfoARM>(
          info.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_INFO_ARM))
    below.pNext = chain.emplace(info.pNext).next();
  if (info.usage & VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM) {
    below.usage &= ~VkImageUsageFlags{VK_IMAGE_USAGE_TENSOR_ALIASING_BIT_ARM};
    below.tiling = VK_IMAGE_TILING_LINEAR;
  }
  return below;
}

VkResult VKAPI_CALL CreateImage(VkDevice handle, const VkImageCreateInfo* info,
                                const VkAllocationCallbacks* allocator, VkImage* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    std::optional<ChainCopy> chain;
    const VkImageCreateInfo below = image_below(*info, chain);
    if (below.tiling != info->tiling) {
      VkImageFormatProperties limits;
      const VkResult allowed = device.instance->GetPhysicalDeviceImageFormatProperties(
          device.physical->handle, below.format, below.imageType, below.tiling, below.usage,
          below.flags, &limits);
      if (allowed != VK_SUCCESS || below.mipLevels > limits.maxMipLevels ||
          below.arrayLayers > limits.maxArrayLayers || !(below.samples & limits.sampleCounts))
        return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle),
                           unsupported("VkImageCreateInfo", "the device has no such linear image"));
    }
    const VkResult created = device.CreateImage(handle, &below, allocator, result);
    if (created == VK_SUCCESS && device.maintenance5 && info->arrayLayers > 1)
      device.image_layers.put(*result, info->arrayLayers);
    return created;
  });
}

void VKAPI_CALL GetDeviceImageMemoryRequirements(VkDevice handle,
                                                 const VkDeviceImageMemoryRequirements* info,
                                                 VkMemoryRequirements2* result) {
  std::optional<ChainCopy> chain;
  const VkImageCreateInfo image = image_below(*info->pCreateInfo, chain);
  VkDeviceImageMemoryRequirements below = *info;
  below.pCreateInfo = &image;
  device_of(handle).GetDeviceImageMemoryRequirements(handle, &below, result);
}

VkResult VKAPI_CALL SetDebugUtilsObjectNameEXT(VkDevice handle,
                                               const VkDebugUtilsObjectNameInfoEXT* info) {
  return name_below(handle, *info, [&](Device& device, const VkDebugUtilsObjectNameInfoEXT* below) {
    return device.SetDebugUtilsObjectNameEXT(handle, below);
  });
}

VkResult VKAPI_CALL SetDebugUtilsObjectTagEXT(VkDevice handle,
                                              const VkDebugUtilsObjectTagInfoEXT* info) {
  return name_below(handle, *info, [&](Device& device, const VkDebugUtilsObjectTagInfoEXT* below) {
    return device.SetDebugUtilsObjectTagEXT(handle, below);
  });
}

VkResult VKAPI_CALL SetPrivateData(VkDevice handle, VkObjectType type, uint64_t object,
                                   VkPrivateDataSlot slot, uint64_t data) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    if (!is_layers_object(device, type, object))
      return device.SetPrivateData(handle, type, object, slot, data);
    const std::lock_guard lock(device.mutex);
    device.private_data[{slot, object}] = data;
    return VK_SUCCESS;
  });
}

void VKAPI_CALL GetPrivateData(VkDevice handle, VkObjectType type, uint64_t object,
                               VkPrivateDataSlot slot, uint64_t* data) {
  guarded_void([&] {
    Device& device = device_of(handle);
    if (!is_layers_object(device, type, object))
      return device.GetPrivateData(handle, type, object, slot, data);
    const std::lock_guard lock(device.mutex);
    const auto found = device.private_data.find({slot, object});
    *data = found == device.private_data.end() ? 0 : found->second;
  });
}

}  // namespace shale::layer
