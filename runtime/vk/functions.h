// runtime/vk/functions.h -- the Vulkan functions that the runtime calls, as a table. The runtime
// links no loader: whoever has a device brings the functions, so that it also works inside of a
// layer.
#pragma once

#include <vulkan/vulkan.h>

#include "ir/base/result.h"

namespace shale::vk {

struct Functions {
  VkInstance instance = VK_NULL_HANDLE;
  PFN_vkGetInstanceProcAddr GetInstanceProcAddr = nullptr;
#define SHALE_VK_INSTANCE(name) PFN_vk##name name = nullptr;
#define SHALE_VK_DEVICE(name) PFN_vk##name name = nullptr;
#include "runtime/vk/functions.def"
};

/// The functions of an instance; those of devices stay null.
/// Errors: kDevice, naming a function that the instance does not have; kBadInput for null
/// arguments.
Result<Functions> load_instance_functions(VkInstance instance,
                                          PFN_vkGetInstanceProcAddr get_instance_proc_addr);

/// Adds the functions of a device, from `get_device_proc_addr`, or from the instance's own if that
/// is null.
/// Errors: as above.
Result<void> load_device_functions(Functions& functions, VkDevice device,
                                   PFN_vkGetDeviceProcAddr get_device_proc_addr = nullptr);

/// vkGetInstanceProcAddr of the system's Vulkan loader, which is opened once and stays.
/// Errors: kDevice if there is none.
Result<PFN_vkGetInstanceProcAddr> system_loader();

}  // namespace shale::vk
