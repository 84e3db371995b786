// runtime/vk/instance.h -- an own Vulkan instance, and what its validation layer has to say.
#pragma once

#include <vulkan/vulkan.h>

#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "ir/base/result.h"
#include "runtime/vk/functions.h"

namespace shale::vk {

/// Warnings and errors of the validation layer, in order. Filled from any thread.
class ValidationLog {
 public:
  void add(std::string message);
  /// Hands over what was collected since the last call.
  std::vector<std::string> take();

 private:
  std::mutex mutex_;
  std::vector<std::string> messages_;
};

struct InstanceOptions {
  /// Core and synchronization checks of VK_LAYER_KHRONOS_validation.
  bool validation = false;
  /// Of the loader to use; null is the system's (system_loader).
  PFN_vkGetInstanceProcAddr get_instance_proc_addr = nullptr;
};

class Instance {
 public:
  /// Errors: kDevice if there is no Vulkan 1.3 loader, or no validation layer where one was asked
  /// for.
  static Result<Instance> create(const InstanceOptions& options = {});
  Instance(Instance&& other) noexcept;
  Instance& operator=(Instance&& other) noexcept;
  ~Instance();

  VkInstance get() const { return functions_.instance; }
  const Functions& functions() const { return functions_; }

  /// Devices of Vulkan 1.3 and above, in the loader's order; empty if there are none.
  Result<std::vector<VkPhysicalDevice>> physical_devices() const;

  /// The first device whose name contains `name_part`; the first at all if that is empty.
  /// Errors: kDevice, listing the names that were found.
  Result<VkPhysicalDevice> find_device(std::string_view name_part) const;

  /// What validation said since the last call; empty without validation.
  std::vector<std::string> take_validation_messages() { return log_->take(); }

 private:
  Instance() = default;

  Functions functions_;  // its instance is null if this owns none
  VkDebugUtilsMessengerEXT messenger_ = VK_NULL_HANDLE;
  std::unique_ptr<ValidationLog> log_;  // the messenger keeps its address
};

}  // namespace shale::vk
