// runtime/vk/device.h -- a logical device, own or a host's, and what is known about it.
#pragma once

#include <vulkan/vulkan.h>

#include <cstdint>
#include <optional>
#include <span>

#include "ir/base/result.h"
#include "ir/package/caps.h"
#include "runtime/vk/instance.h"

namespace shale::vk {

/// What a device can do, as plain data. `device` must support Vulkan 1.3; `vk` are the functions of
/// its instance.
DeviceCaps snapshot_caps(VkPhysicalDevice device, const Functions& vk);

/// The features that a device was created with, of those that we know: from pEnabledFeatures or the
/// structures of Vulkan 1.0 to 1.3 and of the extensions that became part of it, and
/// VK_KHR_cooperative_matrix.
FeatureSet enabled_features(const VkDeviceCreateInfo& info);

/// The family that computes with least else to do: one without graphics if there is one, else the
/// first with compute. Nothing if no family computes.
std::optional<uint32_t> choose_queue_family(std::span<const VkQueueFamilyProperties> families);

/// A device that somebody else owns; everything in the runtime borrows one, and all that was made
/// from it must be gone before the device goes. Copies are cheap and mean the same device.
struct Context {
  VkPhysicalDevice physical_device = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  uint32_t queue_family = 0;
  /// Of an own device, for submit_and_wait; a host's queue is never used, and null here.
  VkQueue queue = VK_NULL_HANDLE;
  DeviceCaps caps;
  VkPhysicalDeviceLimits limits{};
  VkPhysicalDeviceMemoryProperties memory{};
  uint32_t timestamp_bits = 0;  ///< of the queue family; 0 if it has no timestamps
  Functions vk;
};

/// A device that a host made, and how to call it.
struct HostDevice {
  VkInstance instance = VK_NULL_HANDLE;
  VkPhysicalDevice physical_device = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  uint32_t queue_family = 0;  ///< of the queues that run what is recorded; must compute
  PFN_vkGetInstanceProcAddr get_instance_proc_addr = nullptr;
  PFN_vkGetDeviceProcAddr get_device_proc_addr = nullptr;  ///< the instance's if null
  /// What the host enabled on the device, such as enabled_features(its create info): a variant that
  /// needs more is not chosen.
  FeatureSet features = {};
};

/// Describes a host's device.
/// Errors: kBadInput for a handle or function that is null; kDevice if the device is below Vulkan
/// 1.3, lacks a function, or the family cannot compute.
Result<Context> wrap_device(const HostDevice& host);

/// An own device with one queue and every feature that caps know of and the device supports.
class Device {
 public:
  /// `vk` are the functions of the instance.
  /// Errors: kDevice if the device cannot compute or refuses to be created.
  static Result<Device> create(VkPhysicalDevice physical_device, const Functions& vk);
  Device(Device&& other) noexcept;
  Device& operator=(Device&& other) noexcept;
  ~Device();

  const Context& context() const { return context_; }

 private:
  Device() = default;

  Context context_;
};

}  // namespace shale::vk
