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

/// What a device can do, as plain data. `device` must support Vulkan 1.3. Cooperative matrices can
/// only be asked for with the `instance` that the device is from; without it they are not reported.
DeviceCaps snapshot_caps(VkPhysicalDevice device, VkInstance instance = VK_NULL_HANDLE);

/// The family that computes with least else to do: one without graphics if there is one, else the
/// first with compute. Nothing if no family computes.
std::optional<uint32_t> choose_queue_family(std::span<const VkQueueFamilyProperties> families);

/// A device that somebody else owns; everything in the runtime borrows one, and all that was made
/// from it must be gone before the device goes. Copies are cheap and mean the same device.
struct Context {
  VkPhysicalDevice physical_device = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  uint32_t queue_family = 0;
  /// Used inside create functions only (uploads, first image layouts), each time submitted and
  /// waited for. The host must not use it from another thread meanwhile.
  VkQueue queue = VK_NULL_HANDLE;
  DeviceCaps caps;
  VkPhysicalDeviceLimits limits{};
  VkPhysicalDeviceMemoryProperties memory{};
  uint32_t timestamp_bits = 0;  ///< of the queue family; 0 if it has no timestamps
};

/// Describes a host's device. `queue_family` must compute. `caps` tells what may be used: what
/// snapshot_caps found, less the features that the host did not enable on `device`. A variant that
/// needs more is not chosen.
/// Errors: kDevice if the device is below Vulkan 1.3 or the family cannot compute.
Result<Context> wrap_device(VkPhysicalDevice physical_device, VkDevice device,
                            uint32_t queue_family, VkQueue queue, DeviceCaps caps);

/// An own device with one queue and every feature that caps know of and the device supports.
class Device {
 public:
  /// `instance` as in snapshot_caps.
  /// Errors: kDevice if the device cannot compute or refuses to be created.
  static Result<Device> create(VkPhysicalDevice physical_device,
                               VkInstance instance = VK_NULL_HANDLE);
  Device(Device&& other) noexcept;
  Device& operator=(Device&& other) noexcept;
  ~Device();

  const Context& context() const { return context_; }

 private:
  Device() = default;

  Context context_;
};

}  // namespace shale::vk
