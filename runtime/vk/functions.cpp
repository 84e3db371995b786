#include "runtime/vk/functions.h"

#include <dlfcn.h>

namespace shale::vk {
namespace {

/// `get` answers for a name; a missing function is an error.
template <typename Function, typename Get>
Result<void> load(Function& function, const char* name, const char* owner, const Get& get) {
  function = reinterpret_cast<Function>(get(name));
  if (!function) return device_error("", "the {} has no {}", owner, name);
  return {};
}

}  // namespace

Result<Functions> load_instance_functions(VkInstance instance,
                                          PFN_vkGetInstanceProcAddr get_instance_proc_addr) {
  if (instance == VK_NULL_HANDLE) return bad_input("", "no instance is given");
  if (!get_instance_proc_addr) return bad_input("", "no vkGetInstanceProcAddr is given");
  Functions functions;
  functions.instance = instance;
  functions.GetInstanceProcAddr = get_instance_proc_addr;
  const auto get = [&](const char* name) { return get_instance_proc_addr(instance, name); };
#define SHALE_VK_INSTANCE(name) \
  SHALE_TRY_VOID(load(functions.name, "vk" #name, "Vulkan instance", get));
#include "runtime/vk/functions.def"
  return functions;
}

Result<void> load_device_functions(Functions& functions, VkDevice device,
                                   PFN_vkGetDeviceProcAddr get_device_proc_addr) {
  if (device == VK_NULL_HANDLE) return bad_input("", "no device is given");
  if (!get_device_proc_addr) get_device_proc_addr = functions.GetDeviceProcAddr;
  const auto get = [&](const char* name) { return get_device_proc_addr(device, name); };
#define SHALE_VK_DEVICE(name) \
  SHALE_TRY_VOID(load(functions.name, "vk" #name, "Vulkan device", get));
#include "runtime/vk/functions.def"
  return {};
}

Result<PFN_vkGetInstanceProcAddr> system_loader() {
  constexpr const char* kLoader = "libvulkan.so.1";
  void* library = dlopen(kLoader, RTLD_NOW | RTLD_LOCAL);  // counted; never closed
  if (!library) return device_error("", "there is no Vulkan loader ({})", dlerror());
  const auto get =
      reinterpret_cast<PFN_vkGetInstanceProcAddr>(dlsym(library, "vkGetInstanceProcAddr"));
  if (!get) return device_error(kLoader, "has no vkGetInstanceProcAddr");
  return get;
}

}  // namespace shale::vk
