// runtime/vk/handle.h -- move-only owners of Vulkan handles, and VkResult as an Error.
#pragma once

#include <vulkan/vulkan.h>

#include <string>
#include <utility>

#include "ir/base/result.h"

namespace shale::vk {

/// "VK_ERROR_DEVICE_LOST", or the number.
std::string result_text(VkResult result);

/// Errors: kDevice, naming `call`, for every result but VK_SUCCESS.
inline Result<void> check(VkResult result, const char* call) {
  if (result == VK_SUCCESS) return {};
  return device_error(call, "the device answered {}", result_text(result));
}

/// The function that destroys children of a device of type T.
template <typename T>
using Destroy = void(VKAPI_PTR*)(VkDevice, T, const VkAllocationCallbacks*);

/// Destroys a child of a device when it goes; the device must outlive it.
template <typename T>
class Handle {
 public:
  Handle() = default;
  Handle(VkDevice device, T handle, Destroy<T> destroy)
      : device_(device), handle_(handle), destroy_(destroy) {}
  Handle(Handle&& other) noexcept
      : device_(other.device_),
        handle_(std::exchange(other.handle_, T{VK_NULL_HANDLE})),
        destroy_(other.destroy_) {}
  Handle& operator=(Handle&& other) noexcept {
    std::swap(device_, other.device_);
    std::swap(handle_, other.handle_);
    std::swap(destroy_, other.destroy_);
    return *this;
  }
  ~Handle() {
    if (handle_ != VK_NULL_HANDLE) destroy_(device_, handle_, nullptr);
  }

  T get() const { return handle_; }
  explicit operator bool() const { return handle_ != VK_NULL_HANDLE; }

 private:
  VkDevice device_ = VK_NULL_HANDLE;
  T handle_ = VK_NULL_HANDLE;
  Destroy<T> destroy_ = nullptr;
};

using BufferHandle = Handle<VkBuffer>;
using BufferViewHandle = Handle<VkBufferView>;
using CommandPoolHandle = Handle<VkCommandPool>;
using DescriptorPoolHandle = Handle<VkDescriptorPool>;
using FenceHandle = Handle<VkFence>;
using ImageHandle = Handle<VkImage>;
using ImageViewHandle = Handle<VkImageView>;
using MemoryHandle = Handle<VkDeviceMemory>;
using PipelineCacheHandle = Handle<VkPipelineCache>;
using PipelineHandle = Handle<VkPipeline>;
using PipelineLayoutHandle = Handle<VkPipelineLayout>;
using QueryPoolHandle = Handle<VkQueryPool>;
using SamplerHandle = Handle<VkSampler>;
using SetLayoutHandle = Handle<VkDescriptorSetLayout>;
using ShaderModuleHandle = Handle<VkShaderModule>;

/// A Vulkan struct of zeros with its type set.
template <typename T>
T init(VkStructureType type) {
  T value{};
  value.sType = type;
  return value;
}

/// Makes a device child: make(vk.CreateFence, vk.DestroyFence, "vkCreateFence", device, info) ->
/// Result<FenceHandle>.
template <typename T, typename Info>
Result<Handle<T>> make(VkResult(VKAPI_PTR* create)(VkDevice, const Info*,
                                                   const VkAllocationCallbacks*, T*),
                       Destroy<T> destroy, const char* call, VkDevice device, const Info& info) {
  T handle = VK_NULL_HANDLE;
  SHALE_TRY_VOID(check(create(device, &info, nullptr, &handle), call));
  return Handle<T>(device, handle, destroy);
}

}  // namespace shale::vk
