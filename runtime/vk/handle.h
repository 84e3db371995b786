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

/// Destroys a child of a device when it goes; the device must outlive it.
template <typename T, auto Destroy>
class Handle {
 public:
  Handle() = default;
  Handle(VkDevice device, T handle) : device_(device), handle_(handle) {}
  Handle(Handle&& other) noexcept
      : device_(other.device_), handle_(std::exchange(other.handle_, T{VK_NULL_HANDLE})) {}
  Handle& operator=(Handle&& other) noexcept {
    std::swap(device_, other.device_);
    std::swap(handle_, other.handle_);
    return *this;
  }
  ~Handle() {
    if (handle_ != VK_NULL_HANDLE) Destroy(device_, handle_, nullptr);
  }

  T get() const { return handle_; }
  explicit operator bool() const { return handle_ != VK_NULL_HANDLE; }

 private:
  VkDevice device_ = VK_NULL_HANDLE;
  T handle_ = VK_NULL_HANDLE;
};

using BufferHandle = Handle<VkBuffer, vkDestroyBuffer>;
using BufferViewHandle = Handle<VkBufferView, vkDestroyBufferView>;
using CommandPoolHandle = Handle<VkCommandPool, vkDestroyCommandPool>;
using DescriptorPoolHandle = Handle<VkDescriptorPool, vkDestroyDescriptorPool>;
using FenceHandle = Handle<VkFence, vkDestroyFence>;
using ImageHandle = Handle<VkImage, vkDestroyImage>;
using ImageViewHandle = Handle<VkImageView, vkDestroyImageView>;
using MemoryHandle = Handle<VkDeviceMemory, vkFreeMemory>;
using PipelineCacheHandle = Handle<VkPipelineCache, vkDestroyPipelineCache>;
using PipelineHandle = Handle<VkPipeline, vkDestroyPipeline>;
using PipelineLayoutHandle = Handle<VkPipelineLayout, vkDestroyPipelineLayout>;
using QueryPoolHandle = Handle<VkQueryPool, vkDestroyQueryPool>;
using SamplerHandle = Handle<VkSampler, vkDestroySampler>;
using SetLayoutHandle = Handle<VkDescriptorSetLayout, vkDestroyDescriptorSetLayout>;
using ShaderModuleHandle = Handle<VkShaderModule, vkDestroyShaderModule>;

/// A Vulkan struct of zeros with its type set.
template <typename T>
T init(VkStructureType type) {
  T value{};
  value.sType = type;
  return value;
}

/// Makes a device child: make(vkCreateFence, "vkCreateFence", device, info) -> Result<FenceHandle>.
template <typename H, typename Create, typename Info>
Result<H> make(Create create, const char* call, VkDevice device, const Info& info) {
  decltype(std::declval<H>().get()) handle = VK_NULL_HANDLE;
  SHALE_TRY_VOID(check(create(device, &info, nullptr, &handle), call));
  return H(device, handle);
}

}  // namespace shale::vk
