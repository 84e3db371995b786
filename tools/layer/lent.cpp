// What VK_ARM_data_graph depends on, for devices of Vulkan 1.3 that lack it: VK_KHR_maintenance5 by older calls, and
// VK_KHR_deferred_host_operations with operations that are over when they return.
#include <algorithm>
#include <list>

#include "tools/layer/chain.h"
#include "tools/layer/extensions.h"
#include "tools/layer/layer.h"
#include "tools/layer/tensor_shader.h"

namespace shale::layer {
namespace {

/// A create info whose chain is without what the device does not know.
template <typename Info>
class Below {
 public:
  Below(const Device& device, const Info& info)
      : chain_(info.pNext, device.maintenance5), info_(info) {
    info_.pNext = chain_.next();
  }
  Info* operator->() { return &info_; }
  const Info* get() const { return &info_; }

 private:
  ChainCopy chain_;
  Info info_;
};

/// The usage that the structure of maintenance5 says, or the info's own. Bits above 31 belong to extensions that the
/// device below has not got.
VkBufferUsageFlags usage_of(const void* next, VkBufferUsageFlags own) {
  const auto* wide = find_in_chain<VkBufferUsageFlags2CreateInfoKHR>(
      next, VK_STRUCTURE_TYPE_BUFFER_USAGE_FLAGS_2_CREATE_INFO_KHR);
  return wide ? static_cast<VkBufferUsageFlags>(wide->usage) : own;
}

/// VK_REMAINING_ARRAY_LAYERS is new in copies; a device that has maintenance5 itself takes it.
void resolve(const Device& device, VkImage image, VkImageSubresourceLayers& layers) {
  if (device.maintenance5 && layers.layerCount == VK_REMAINING_ARRAY_LAYERS)
    layers.layerCount = std::max(device.image_layers.find(image), 1u) - layers.baseArrayLayer;
}
/// Of regions between two images.
template <typename Region>
std::vector<Region> resolved(const Device& device, VkImage from, VkImage to, const Region* regions,
                             uint32_t count) {
  std::vector<Region> result(regions, regions + count);
  for (Region& region : result) {
    resolve(device, from, region.srcSubresource);
    resolve(device, to, region.dstSubresource);
  }
  return result;
}
/// Of regions between an image and a buffer.
template <typename Region>
std::vector<Region> resolved(const Device& device, VkImage image, const Region* regions,
                             uint32_t count) {
  std::vector<Region> result(regions, regions + count);
  for (Region& region : result) resolve(device, image, region.imageSubresource);
  return result;
}

/// Create infos of pipelines for the device below: flags where it looks for them, and stages whose code is chained to
/// them with a module.
template <typename Info>
class PipelinesBelow {
 public:
  PipelinesBelow(Device& device, const Info* infos, uint32_t count)
      : device_(device), infos_(infos, infos + count) {}
  ~PipelinesBelow() {
    for (const VkShaderModule module : modules_)
      device_.DestroyShaderModule(device_.handle, module, nullptr);
  }
  PipelinesBelow(const PipelinesBelow&) = delete;
  PipelinesBelow& operator=(const PipelinesBelow&) = delete;

  /// `stages_of` gives the stages of an info to change, in memory of `stages`.
  template <typename StagesOf>
  VkResult prepare(const StagesOf& stages_of) {
    for (Info& info : infos_) {
      if (const auto* wide = find_in_chain<VkPipelineCreateFlags2CreateInfoKHR>(
              info.pNext, VK_STRUCTURE_TYPE_PIPELINE_CREATE_FLAGS_2_CREATE_INFO_KHR);
          wide && device_.maintenance5) {
        info.flags = static_cast<VkPipelineCreateFlags>(wide->flags);
        info.pNext = chains_.emplace_back(info.pNext, true).next();
      }
      for (VkPipelineShaderStageCreateInfo& stage : stages_of(info))
        if (const VkResult made = lend_module(stage); made != VK_SUCCESS) return made;
    }
    return VK_SUCCESS;
  }
  const Info* data() const { return infos_.data(); }

  std::list<std::vector<VkPipelineShaderStageCreateInfo>> stages;

 private:
  VkResult lend_module(VkPipelineShaderStageCreateInfo& stage) {
    const auto* code = find_in_chain<VkShaderModuleCreateInfo>(
        stage.pNext, VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
    if (stage.module || !code) return VK_SUCCESS;
    const std::span<const uint32_t> words(code->pCode, code->codeSize / sizeof(uint32_t));
    if (!device_.maintenance5 && !(device_.tensor_buffers && has_tensors(words)))
      return VK_SUCCESS;  // the device takes it as it is
    VkShaderModuleCreateInfo info = *code;
    info.pNext = nullptr;
    const VkResult made = CreateShaderModule(device_.handle, &info, nullptr, &stage.module);
    if (made != VK_SUCCESS) return made;
    modules_.push_back(stage.module);
    ChainCopy& chain = chains_.emplace_back(stage.pNext, device_.maintenance5);
    chain.remove(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
    stage.pNext = chain.next();
    return VK_SUCCESS;
  }

  Device& device_;
  std::vector<Info> infos_;
  std::list<ChainCopy> chains_;
  std::vector<VkShaderModule> modules_;
};

void write_layout(const Device& device, VkImage image, const VkImageSubresource2KHR& which,
                  VkSubresourceLayout2KHR* layout) {
  device.GetImageSubresourceLayout(device.handle, image, &which.imageSubresource,
                                   &layout->subresourceLayout);
}

/// What the handle of an operation points to; nothing is ever left to be done.
struct Operation {
  char unused;
};

}  // namespace

VkResult VKAPI_CALL CreateBuffer(VkDevice handle, const VkBufferCreateInfo* info,
                                 const VkAllocationCallbacks* allocator, VkBuffer* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    if (!device.maintenance5) return device.CreateBuffer(handle, info, allocator, result);
    Below below(device, *info);
    below->usage = usage_of(info->pNext, info->usage);
    const VkResult created = device.CreateBuffer(handle, below.get(), allocator, result);
    if (created == VK_SUCCESS) device.buffer_sizes.put(*result, info->size);
    return created;
  });
}

void VKAPI_CALL DestroyBuffer(VkDevice handle, VkBuffer buffer,
                              const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    device.buffer_sizes.take(buffer);
    device.DestroyBuffer(handle, buffer, allocator);
  });
}

VkResult VKAPI_CALL CreateBufferView(VkDevice handle, const VkBufferViewCreateInfo* info,
                                     const VkAllocationCallbacks* allocator, VkBufferView* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    // A view of fewer usages than its buffer's may have them all.
    return device.CreateBufferView(handle, Below(device, *info).get(), allocator, result);
  });
}

void VKAPI_CALL GetDeviceBufferMemoryRequirements(VkDevice handle,
                                                  const VkDeviceBufferMemoryRequirements* info,
                                                  VkMemoryRequirements2* result) {
  guarded_void([&] {
    Device& device = device_of(handle);
    Below buffer(device, *info->pCreateInfo);
    buffer->usage = usage_of(info->pCreateInfo->pNext, info->pCreateInfo->usage);
    VkDeviceBufferMemoryRequirements below = *info;
    below.pCreateInfo = buffer.get();
    device.GetDeviceBufferMemoryRequirements(handle, &below, result);
  });
}

void VKAPI_CALL DestroyImage(VkDevice handle, VkImage image,
                             const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    device.image_layers.take(image);
    device.DestroyImage(handle, image, allocator);
  });
}

VkResult VKAPI_CALL CreateComputePipelines(VkDevice handle, VkPipelineCache cache, uint32_t count,
                                           const VkComputePipelineCreateInfo* infos,
                                           const VkAllocationCallbacks* allocator,
                                           VkPipeline* results) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    PipelinesBelow below(device, infos, count);
    const VkResult ready =
        below.prepare([](VkComputePipelineCreateInfo& info) { return std::span(&info.stage, 1); });
    if (ready != VK_SUCCESS) {
      std::fill_n(results, count, VkPipeline{VK_NULL_HANDLE});
      return ready;
    }
    return device.CreateComputePipelines(handle, cache, count, below.data(), allocator, results);
  });
}

VkResult VKAPI_CALL CreateGraphicsPipelines(VkDevice handle, VkPipelineCache cache, uint32_t count,
                                            const VkGraphicsPipelineCreateInfo* infos,
                                            const VkAllocationCallbacks* allocator,
                                            VkPipeline* results) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    PipelinesBelow below(device, infos, count);
    const VkResult ready = below.prepare([&](VkGraphicsPipelineCreateInfo& info) {
      auto& own = below.stages.emplace_back(info.pStages, info.pStages + info.stageCount);
      info.pStages = own.data();
      return std::span(own);
    });
    if (ready != VK_SUCCESS) {
      std::fill_n(results, count, VkPipeline{VK_NULL_HANDLE});
      return ready;
    }
    return device.CreateGraphicsPipelines(handle, cache, count, below.data(), allocator, results);
  });
}

void VKAPI_CALL CmdCopyImage(VkCommandBuffer commands, VkImage from, VkImageLayout from_layout,
                             VkImage to, VkImageLayout to_layout, uint32_t count,
                             const VkImageCopy* regions) {
  guarded_void([&] {
    const Device& device = device_of(commands);
    device.CmdCopyImage(commands, from, from_layout, to, to_layout, count,
                        resolved(device, from, to, regions, count).data());
  });
}

void VKAPI_CALL CmdBlitImage(VkCommandBuffer commands, VkImage from, VkImageLayout from_layout,
                             VkImage to, VkImageLayout to_layout, uint32_t count,
                             const VkImageBlit* regions, VkFilter filter) {
  guarded_void([&] {
    const Device& device = device_of(commands);
    device.CmdBlitImage(commands, from, from_layout, to, to_layout, count,
                        resolved(device, from, to, regions, count).data(), filter);
  });
}

void VKAPI_CALL CmdResolveImage(VkCommandBuffer commands, VkImage from, VkImageLayout from_layout,
                                VkImage to, VkImageLayout to_layout, uint32_t count,
                                const VkImageResolve* regions) {
  guarded_void([&] {
    const Device& device = device_of(commands);
    device.CmdResolveImage(commands, from, from_layout, to, to_layout, count,
                           resolved(device, from, to, regions, count).data());
  });
}

void VKAPI_CALL CmdCopyBufferToImage(VkCommandBuffer commands, VkBuffer from, VkImage to,
                                     VkImageLayout layout, uint32_t count,
                                     const VkBufferImageCopy* regions) {
  guarded_void([&] {
    const Device& device = device_of(commands);
    device.CmdCopyBufferToImage(commands, from, to, layout, count,
                                resolved(device, to, regions, count).data());
  });
}

void VKAPI_CALL CmdCopyImageToBuffer(VkCommandBuffer commands, VkImage from, VkImageLayout layout,
                                     VkBuffer to, uint32_t count,
                                     const VkBufferImageCopy* regions) {
  guarded_void([&] {
    const Device& device = device_of(commands);
    device.CmdCopyImageToBuffer(commands, from, layout, to, count,
                                resolved(device, from, regions, count).data());
  });
}

// Those whose arguments are a structure.
#define SHALE_COPY_2(name, Info, ...)                                        \
  void VKAPI_CALL name(VkCommandBuffer commands, const Info* info) {         \
    guarded_void([&] {                                                       \
      const Device& device = device_of(commands);                            \
      const auto regions = resolved(device, __VA_ARGS__, info->regionCount); \
      Info below = *info;                                                    \
      below.pRegions = regions.data();                                       \
      device.name(commands, &below);                                         \
    });                                                                      \
  }
SHALE_COPY_2(CmdCopyImage2, VkCopyImageInfo2, info->srcImage, info->dstImage, info->pRegions)
SHALE_COPY_2(CmdBlitImage2, VkBlitImageInfo2, info->srcImage, info->dstImage, info->pRegions)
SHALE_COPY_2(CmdResolveImage2, VkResolveImageInfo2, info->srcImage, info->dstImage, info->pRegions)
SHALE_COPY_2(CmdCopyBufferToImage2, VkCopyBufferToImageInfo2, info->dstImage, info->pRegions)
SHALE_COPY_2(CmdCopyImageToBuffer2, VkCopyImageToBufferInfo2, info->srcImage, info->pRegions)
#undef SHALE_COPY_2

void VKAPI_CALL CmdBindVertexBuffers2(VkCommandBuffer commands, uint32_t first, uint32_t count,
                                      const VkBuffer* buffers, const VkDeviceSize* offsets,
                                      const VkDeviceSize* sizes, const VkDeviceSize* strides) {
  guarded_void([&] {
    const Device& device = device_of(commands);
    std::vector<VkDeviceSize> whole;
    if (sizes && device.maintenance5) {
      whole.assign(sizes, sizes + count);
      for (uint32_t i = 0; i < count; ++i)
        if (whole[i] == VK_WHOLE_SIZE && buffers[i])
          whole[i] = device.buffer_sizes.find(buffers[i]) - offsets[i];
      sizes = whole.data();
    }
    device.CmdBindVertexBuffers2(commands, first, count, buffers, offsets, sizes, strides);
  });
}

void VKAPI_CALL CmdBindIndexBuffer2KHR(VkCommandBuffer commands, VkBuffer buffer,
                                       VkDeviceSize offset, VkDeviceSize, VkIndexType type) {
  // The size bounds what may be read; the device's bound is the buffer.
  device_of(commands).CmdBindIndexBuffer(commands, buffer, offset, type);
}

void VKAPI_CALL GetRenderingAreaGranularityKHR(VkDevice, const VkRenderingAreaInfoKHR*,
                                               VkExtent2D* granularity) {
  *granularity = {1, 1};
}

void VKAPI_CALL GetImageSubresourceLayout2KHR(VkDevice handle, VkImage image,
                                              const VkImageSubresource2KHR* which,
                                              VkSubresourceLayout2KHR* layout) {
  write_layout(device_of(handle), image, *which, layout);
}

void VKAPI_CALL GetDeviceImageSubresourceLayoutKHR(VkDevice handle,
                                                   const VkDeviceImageSubresourceInfoKHR* info,
                                                   VkSubresourceLayout2KHR* layout) {
  guarded_void([&] {
    Device& device = device_of(handle);
    VkImage image = VK_NULL_HANDLE;
    layout->subresourceLayout = {};
    if (CreateImage(handle, info->pCreateInfo, nullptr, &image) != VK_SUCCESS) return;
    write_layout(device, image, *info->pSubresource, layout);
    DestroyImage(handle, image, nullptr);
  });
}

VkResult VKAPI_CALL CreateDeferredOperationKHR(VkDevice, const VkAllocationCallbacks* allocator,
                                               VkDeferredOperationKHR* result) {
  return guarded([&]() -> VkResult {
    *result = reinterpret_cast<VkDeferredOperationKHR>(make_object<Operation>(allocator));
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyDeferredOperationKHR(VkDevice, VkDeferredOperationKHR operation,
                                            const VkAllocationCallbacks* allocator) {
  if (operation) destroy_object(reinterpret_cast<Operation*>(operation), allocator);
}

uint32_t VKAPI_CALL GetDeferredOperationMaxConcurrencyKHR(VkDevice, VkDeferredOperationKHR) {
  return 0;
}
VkResult VKAPI_CALL GetDeferredOperationResultKHR(VkDevice, VkDeferredOperationKHR) {
  return VK_SUCCESS;
}
VkResult VKAPI_CALL DeferredOperationJoinKHR(VkDevice, VkDeferredOperationKHR) {
  return VK_SUCCESS;
}

}  // namespace shale::layer
