// tools/layer/layer.h -- what the layer knows of instances, physical devices and devices.
//
// Dispatchable handles are those of below, never wrapped: their data are found by the loader's
// dispatch table, which is the first word of each. Tensors, views, sessions, graph pipelines and graph
// modules are objects of the layer, and their addresses are the handles.
#pragma once

#define VK_NO_PROTOTYPES
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#include <map>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <set>
#include <shared_mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "ir/base/result.h"
#include "ir/package/caps.h"
#include "runtime/vk/device.h"
#include "runtime/vk/handle.h"
#include "tools/layer/arm_vulkan.h"

namespace shale::layer {

/// The hooks themselves, with Vulkan's own signatures.
#define SHALE_INSTANCE_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#define SHALE_DEVICE_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#define SHALE_TENSOR_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#define SHALE_GRAPH_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#define SHALE_LENT_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#define SHALE_DEFERRED_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#define SHALE_PHYSICAL_HOOK(name) std::remove_pointer_t<PFN_vk##name> name;
#include "tools/layer/hooks.def"

/// Runs an entry point's work; whatever it throws becomes its result.
template <typename Work>
VkResult guarded(const Work& work) noexcept {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return VK_ERROR_OUT_OF_HOST_MEMORY;
  } catch (...) {
    return VK_ERROR_UNKNOWN;
  }
}

/// The same for what has no result; then there is nobody to tell.
template <typename Work>
void guarded_void(const Work& work) noexcept {
  try {
    work();
  } catch (...) {
  }
}

/// An object behind a handle, in the application's memory where it brought an allocator.
template <typename T, typename... Args>
T* make_object(const VkAllocationCallbacks* allocator, Args&&... args) {
  if (!allocator) return new T{std::forward<Args>(args)...};
  void* memory = allocator->pfnAllocation(allocator->pUserData, sizeof(T), alignof(T),
                                          VK_SYSTEM_ALLOCATION_SCOPE_OBJECT);
  if (!memory) throw std::bad_alloc();
  return new (memory) T{std::forward<Args>(args)...};
}

template <typename T>
void destroy_object(T* object, const VkAllocationCallbacks* allocator) {
  if (!allocator) {
    delete object;
    return;
  }
  object->~T();
  allocator->pfnFree(allocator->pUserData, object);
}

/// Values by key, for any number of threads.
template <typename Key, typename Value>
class Registry {
 public:
  void put(Key key, Value value) {
    const std::unique_lock lock(mutex_);
    values_.insert_or_assign(key, std::move(value));
  }
  /// An empty value where there is none.
  Value find(Key key) const {
    const std::shared_lock lock(mutex_);
    const auto found = values_.find(key);
    return found == values_.end() ? Value{} : found->second;
  }
  Value take(Key key) {
    const std::unique_lock lock(mutex_);
    const auto found = values_.find(key);
    if (found == values_.end()) return Value{};
    Value value = std::move(found->second);
    values_.erase(found);
    return value;
  }

  void clear() {
    const std::unique_lock lock(mutex_);
    values_.clear();
  }
  bool empty() const {
    const std::shared_lock lock(mutex_);
    return values_.empty();
  }

 private:
  mutable std::shared_mutex mutex_;
  std::unordered_map<Key, Value> values_;
};

/// What the layer adds to a physical device.
struct Physical {
  VkPhysicalDevice handle = VK_NULL_HANDLE;
  /// False where the layer steps aside: below Vulkan 1.3, or where the device has one of the
  /// extensions itself.
  bool serves = false;
  /// VK_KHR_maintenance5, VK_KHR_deferred_host_operations: the layer serves and the device has them not.
  bool lends_maintenance5 = false, lends_deferred = false;
  bool dynamic_indexing = false;  ///< shaderStorageBufferArrayDynamicIndexing
  /// Bytes of a storage buffer's descriptor, robust or not; 0 if tensors cannot be in descriptor buffers.
  size_t storage_descriptor_bytes = 0;
  bool optical_flow = false;  ///< shaders may write the formats of its images
  VkPhysicalDeviceVulkan12Features features12{};
  VkPhysicalDeviceVulkan12Properties properties12{};
  DeviceCaps caps;
  VkPhysicalDeviceLimits limits{};
  std::vector<VkQueueFamilyProperties> families;

  /// Of tensors, in bytes: what a storage buffer of the device can hold.
  uint64_t max_tensor_bytes() const { return limits.maxStorageBufferRange & ~uint64_t{7}; }
};

struct Instance {
  VkInstance handle = VK_NULL_HANDLE;
  PFN_vkGetInstanceProcAddr next = nullptr;
  PFN_GetPhysicalDeviceProcAddr next_physical = nullptr;
  vk::Functions functions;
#define SHALE_INSTANCE_HOOK(name) PFN_vk##name name = nullptr;
#define SHALE_PHYSICAL_HOOK(name) PFN_vk##name name = nullptr;
#include "tools/layer/hooks.def"
  PFN_vkGetPhysicalDeviceExternalBufferProperties GetPhysicalDeviceExternalBufferProperties =
      nullptr;

  const Physical& physical(VkPhysicalDevice handle);
  /// Tells the application's debug messengers.
  void report(VkDebugUtilsMessageSeverityFlagBitsEXT severity, VkObjectType type, uint64_t object,
              const std::string& text);

  std::mutex mutex;  ///< of what follows
  std::map<VkPhysicalDevice, std::unique_ptr<Physical>> physicals;
  std::map<VkDebugUtilsMessengerEXT, VkDebugUtilsMessengerCreateInfoEXT> messengers;
};

struct SetLayout;
struct Set;
struct Pool;
struct CommandState;
struct UpdateTemplate;
struct LateDispatch;
struct PipelineLayout;
struct GraphModule;
struct GraphPipeline;
struct GraphSession;
struct GraphCache;
struct Tensor;
class DiskCache;
class ShapeSlots;

struct Device {
  Device();
  ~Device();

  VkDevice handle = VK_NULL_HANDLE;
  Instance* instance = nullptr;
  const Physical* physical = nullptr;
  PFN_vkGetDeviceProcAddr next = nullptr;
  bool tensors = false, graphs = false;  ///< which extension the application enabled
  /// Sets below have the buffers of tensors: it enabled shaderTensorAccess or `descriptor_buffers`.
  bool tensor_buffers = false;
  bool descriptor_buffers = false;  ///< it enabled those of tensors, for shaders or graphs
  bool null_descriptors = false;    ///< it enabled nullDescriptor
  bool optical_flow = false;        ///< it enabled dataGraphOpticalFlow
  bool maintenance5 = false, deferred = false;  ///< it enabled what the layer lends
#define SHALE_DEVICE_HOOK(name) PFN_vk##name name = nullptr;
#include "tools/layer/hooks.def"
  PFN_vkGetImageSubresourceLayout GetImageSubresourceLayout = nullptr;
  PFN_vkCmdBindIndexBuffer CmdBindIndexBuffer = nullptr;
  PFN_vkGetBufferDeviceAddress GetBufferDeviceAddress = nullptr;
  /// For the runtime; there if `tensors` or `graphs`.
  std::optional<vk::Context> context;

  Registry<VkDescriptorSetLayout, std::shared_ptr<SetLayout>> set_layouts;
  Registry<VkPipelineLayout, std::shared_ptr<PipelineLayout>> layouts;
  Registry<VkDescriptorSet, std::shared_ptr<Set>> sets;
  Registry<VkDescriptorPool, std::shared_ptr<Pool>> pools;
  Registry<VkDescriptorUpdateTemplate, std::shared_ptr<UpdateTemplate>> templates;
  Registry<VkCommandBuffer, std::shared_ptr<CommandState>> commands;
  /// Of command buffers whose recording has ended.
  Registry<VkCommandBuffer, std::vector<std::shared_ptr<LateDispatch>>> late;
  Registry<VkCommandPool, std::shared_ptr<std::set<VkCommandBuffer>>> command_pools;
  Registry<VkShaderModule, std::shared_ptr<GraphModule>> modules;
  Registry<VkPipelineCache, std::shared_ptr<GraphCache>> caches;
  /// A handle is the address of another pointer to it (graph_pipeline.cpp).
  Registry<VkPipeline, std::shared_ptr<GraphPipeline>> pipelines;
  Registry<uint64_t, const Tensor*> tensors_by_id;  ///< those that there are
  /// What maintenance5 leaves out of commands; kept where it is lent.
  Registry<VkImage, uint32_t> image_layers;
  Registry<VkBuffer, VkDeviceSize> buffer_sizes;
  std::mutex mutex;  ///< of what follows
  std::set<GraphSession*> sessions;
  std::map<std::pair<VkPrivateDataSlot, uint64_t>, uint64_t> private_data;
  std::unique_ptr<DiskCache> disk_cache;  ///< null without one
  std::unique_ptr<ShapeSlots> shapes;     ///< null without tensor_buffers
  vk::SetLayoutHandle flow_set_layout;    ///< of sessions; there with optical_flow

  void error(VkObjectType type, uint64_t object, const std::string& text) {
    instance->report(VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT, type, object, text);
  }
  /// Reports the error, and gives the result for it.
  VkResult fail(VkObjectType type, uint64_t object, const Error& error);
};

/// The data of a dispatchable handle.
std::shared_ptr<Instance> instance_of(const void* dispatchable);
Device& device_of(const void* dispatchable);

template <typename Handle>
uint64_t number_of(Handle handle) {
  return reinterpret_cast<uint64_t>(handle);
}

}  // namespace shale::layer
