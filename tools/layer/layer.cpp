// The loader's side of the layer: negotiation, who answers which function, instances and devices.
#include "tools/layer/layer.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "tools/layer/chain.h"
#include "tools/layer/commands.h"
#include "tools/layer/descriptors.h"
#include "tools/layer/device_features.h"
#include "tools/layer/disk_cache.h"
#include "tools/layer/extensions.h"
#include "tools/layer/graph.h"
#include "tools/layer/optical_flow.h"
#include "tools/layer/tensor.h"

namespace shale::layer {
namespace {

struct Handles {
  Registry<const void*, std::shared_ptr<Instance>> instances;
  Registry<const void*, std::shared_ptr<Device>> devices;
};

/// Never destroyed: other threads may still call at the process's end.
Handles& handles() {
  static auto* all = new Handles;
  return *all;
}

const void* dispatch_key(const void* dispatchable) {
  return *static_cast<const void* const*>(dispatchable);
}

template <typename Info>
const Info* link_info(const void* next, VkStructureType type) {
  for (auto* each = find_in_chain<Info>(next, type); each;
       each = find_in_chain<Info>(each->pNext, type))
    if (each->function == VK_LAYER_LINK_INFO) return each;
  return nullptr;
}

template <typename Function>
void load(Function& function, PFN_vkVoidFunction found) {
  function = reinterpret_cast<Function>(found);
}

struct Hook {
  const char* name;
  PFN_vkVoidFunction function;
  enum class Kind { kInstance, kPhysical, kDevice, kTensor, kGraph, kLent, kDeferred } kind;
};

template <typename Function>
PFN_vkVoidFunction as_void(Function* function) {
  return reinterpret_cast<PFN_vkVoidFunction>(function);
}

const Hook* find_hook(const char* name) {
  // An alias may be of an instance's or a device's function; that of its row decides.
  // Never destroyed, as handles() are.
  static const auto& hooks = *[] {
    auto* made = new std::unordered_map<std::string_view, Hook>;
    auto& all = *made;
    const auto add = [&](const Hook& hook) { all.emplace(hook.name, hook); };
#define SHALE_INSTANCE_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kInstance});
#define SHALE_PHYSICAL_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kPhysical});
#define SHALE_DEVICE_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kDevice});
#define SHALE_TENSOR_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kTensor});
#define SHALE_GRAPH_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kGraph});
#define SHALE_LENT_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kLent});
#define SHALE_DEFERRED_HOOK(name) add({"vk" #name, as_void(name), Hook::Kind::kDeferred});
#define SHALE_HOOK_ALIAS(alias, name) add({"vk" #alias, as_void(name), all.at("vk" #name).kind});
#include "tools/layer/hooks.def"
    return made;
  }();
  const auto found = hooks.find(name);
  return found == hooks.end() ? nullptr : &found->second;
}

PFN_vkVoidFunction VKAPI_CALL get_instance_proc_addr(VkInstance instance, const char* name);
PFN_vkVoidFunction VKAPI_CALL get_device_proc_addr(VkDevice device, const char* name);

VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info,
                                    const VkAllocationCallbacks* allocator, VkInstance* result) {
  return guarded([&]() -> VkResult {
    auto* link = const_cast<VkLayerInstanceCreateInfo*>(link_info<VkLayerInstanceCreateInfo>(
        info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO));
    if (!link || !link->u.pLayerInfo) return VK_ERROR_INITIALIZATION_FAILED;
    auto data = std::make_shared<Instance>();
    data->next = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
    data->next_physical = link->u.pLayerInfo->pfnNextGetPhysicalDeviceProcAddr;
    const auto create =
        reinterpret_cast<PFN_vkCreateInstance>(data->next(nullptr, "vkCreateInstance"));
    if (!create) return VK_ERROR_INITIALIZATION_FAILED;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;  // the loader's own structure, for those below
    if (const VkResult created = create(info, allocator, result); created != VK_SUCCESS)
      return created;
    data->handle = *result;
    const auto find = [&](const char* name) { return data->next(data->handle, name); };
    // Of those that the loader does not know, only this way leads to the device.
    const auto find_physical = [&](const char* name) {
      return data->next_physical ? data->next_physical(data->handle, name) : find(name);
    };
#define SHALE_INSTANCE_HOOK(name) load(data->name, find("vk" #name));
#define SHALE_PHYSICAL_HOOK(name) load(data->name, find_physical("vk" #name));
#include "tools/layer/hooks.def"
    load(data->GetPhysicalDeviceExternalBufferProperties,
         find("vkGetPhysicalDeviceExternalBufferProperties"));
    // Below Vulkan 1.1 there are functions missing, and nothing to add.
    if (auto functions = vk::load_instance_functions(data->handle, data->next))
      data->functions = *functions;
    handles().instances.put(dispatch_key(*result), std::move(data));
    return VK_SUCCESS;
  });
}

VkResult VKAPI_CALL enumerate_instance_layers(uint32_t* count, VkLayerProperties* properties) {
  if (!properties) {
    *count = 1;
    return VK_SUCCESS;
  }
  if (*count == 0) return VK_INCOMPLETE;
  *count = 1;
  *properties = {"VK_LAYER_SHALE_data_graph", VK_HEADER_VERSION_COMPLETE, 1,
                 "VK_ARM_tensors and VK_ARM_data_graph on any Vulkan 1.3 device"};
  return VK_SUCCESS;
}

VkResult VKAPI_CALL enumerate_device_layers(VkPhysicalDevice, uint32_t* count,
                                            VkLayerProperties* properties) {
  return enumerate_instance_layers(count, properties);
}

VkResult VKAPI_CALL enumerate_instance_extensions(const char*, uint32_t* count,
                                                  VkExtensionProperties*) {
  *count = 0;  // asked for this layer by name; it adds none
  return VK_SUCCESS;
}

PFN_vkVoidFunction own_instance_function(const char* name) {
  const std::string_view wanted = name;
  if (wanted == "vkGetInstanceProcAddr") return as_void(get_instance_proc_addr);
  if (wanted == "vkGetDeviceProcAddr") return as_void(get_device_proc_addr);
  if (wanted == "vkCreateInstance") return as_void(create_instance);
  if (wanted == "vkEnumerateInstanceLayerProperties") return as_void(enumerate_instance_layers);
  if (wanted == "vkEnumerateDeviceLayerProperties") return as_void(enumerate_device_layers);
  if (wanted == "vkEnumerateInstanceExtensionProperties")
    return as_void(enumerate_instance_extensions);
  return nullptr;
}

PFN_vkVoidFunction VKAPI_CALL get_instance_proc_addr(VkInstance instance, const char* name) {
  if (const PFN_vkVoidFunction own = own_instance_function(name)) return own;
  if (!instance) return nullptr;
  const auto data = instance_of(instance);
  if (!data) return nullptr;
  const PFN_vkVoidFunction below = data->next(instance, name);
  const Hook* hook = find_hook(name);
  if (!hook) return below;
  switch (hook->kind) {
    case Hook::Kind::kInstance:
    case Hook::Kind::kDevice: return below ? hook->function : nullptr;
    case Hook::Kind::kLent:
    case Hook::Kind::kDeferred: return below ? below : hook->function;
    default: return hook->function;
  }
}

PFN_vkVoidFunction VKAPI_CALL get_physical_device_proc_addr(VkInstance instance, const char* name) {
  const auto data = instance_of(instance);
  const Hook* hook = find_hook(name);
  if (hook && hook->kind == Hook::Kind::kPhysical) return hook->function;
  if (!data || !data->next_physical) return nullptr;
  const PFN_vkVoidFunction below = data->next_physical(instance, name);
  return hook && hook->kind == Hook::Kind::kInstance && below ? hook->function : below;
}

PFN_vkVoidFunction VKAPI_CALL get_device_proc_addr(VkDevice device, const char* name) {
  const std::string_view wanted = name;
  if (wanted == "vkGetDeviceProcAddr") return as_void(get_device_proc_addr);
  if (wanted == "vkDestroyDevice") return as_void(DestroyDevice);
  const Device& data = device_of(device);
  const PFN_vkVoidFunction below = data.next(device, name);
  const Hook* hook = find_hook(name);
  if (!hook) return below;
  switch (hook->kind) {
    case Hook::Kind::kDevice:
      return below && (data.tensors || data.graphs || data.maintenance5) ? hook->function : below;
    case Hook::Kind::kTensor: return data.tensors ? hook->function : below;
    case Hook::Kind::kGraph: return data.graphs ? hook->function : below;
    case Hook::Kind::kLent: return data.maintenance5 ? hook->function : below;
    case Hook::Kind::kDeferred: return data.deferred ? hook->function : below;
    default: return nullptr;  // no function of a device
  }
}

/// The names without those that only the layer has.
std::vector<const char*> names_below(const VkDeviceCreateInfo& info, const Physical& physical) {
  std::vector<const char*> names;
  for (uint32_t i = 0; i < info.enabledExtensionCount; ++i)
    if (!offered(physical, info.ppEnabledExtensionNames[i]))
      names.push_back(info.ppEnabledExtensionNames[i]);
  return names;
}

bool enables(const VkDeviceCreateInfo& info, std::string_view name) {
  return std::any_of(info.ppEnabledExtensionNames,
                     info.ppEnabledExtensionNames + info.enabledExtensionCount,
                     [&](const char* each) { return name == each; });
}

/// Opens what the runtime needs of a device on which an extension of the layer is enabled.
Result<void> open_context(Device& device, const VkDeviceCreateInfo& info) {
  uint32_t family = 0;
  while (family < device.physical->families.size() &&
         !(device.physical->families[family].queueFlags & VK_QUEUE_COMPUTE_BIT))
    ++family;
  SHALE_TRY(device.context, vk::wrap_device({.instance = device.instance->handle,
                                             .physical_device = device.physical->handle,
                                             .device = device.handle,
                                             .queue_family = family,
                                             .get_instance_proc_addr = device.instance->next,
                                             .get_device_proc_addr = device.next,
                                             .features = vk::enabled_features(info)}));
  // Weights are written by the host, never copied by the application's queue: its command buffers may
  // be submitted in another order than they were recorded in. So all that the host can write counts as
  // the device's own memory.
  VkPhysicalDeviceMemoryProperties& memory = device.context->memory;
  bool has_both = false;
  constexpr VkMemoryPropertyFlags kMapped =
      VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
  constexpr VkMemoryPropertyFlags kBoth = kMapped | VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
  for (uint32_t i = 0; i < memory.memoryTypeCount; ++i)
    has_both = has_both || (memory.memoryTypes[i].propertyFlags & kBoth) == kBoth;
  for (uint32_t i = 0; i < memory.memoryTypeCount && !has_both; ++i)
    if ((memory.memoryTypes[i].propertyFlags & kMapped) == kMapped)
      memory.memoryTypes[i].propertyFlags |= VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
  return {};
}

}  // namespace

std::shared_ptr<Instance> instance_of(const void* dispatchable) {
  return handles().instances.find(dispatch_key(dispatchable));
}

Device& device_of(const void* dispatchable) {
  // It lives as long as its device, and nobody may use that beyond.
  return *handles().devices.find(dispatch_key(dispatchable));
}

Device::Device() = default;
Device::~Device() = default;

VkResult Device::fail(VkObjectType type, uint64_t object, const Error& problem) {
  error(type, object, problem.text());
  if (problem.message.find("VK_ERROR_OUT_OF_DEVICE_MEMORY") != std::string::npos)
    return VK_ERROR_OUT_OF_DEVICE_MEMORY;
  if (problem.message.find("VK_ERROR_OUT_OF_HOST_MEMORY") != std::string::npos)
    return VK_ERROR_OUT_OF_HOST_MEMORY;
  return VK_ERROR_UNKNOWN;
}

void VKAPI_CALL DestroyInstance(VkInstance instance, const VkAllocationCallbacks* allocator) {
  if (!instance) return;
  guarded_void([&] {
    if (const auto data = handles().instances.take(dispatch_key(instance)))
      data->DestroyInstance(instance, allocator);
  });
}

VkResult VKAPI_CALL CreateDevice(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                 const VkAllocationCallbacks* allocator, VkDevice* result) {
  return guarded([&]() -> VkResult {
    const auto instance = instance_of(physical);
    const Physical& known = instance->physical(physical);
    const bool tensors = known.serves && enables(*info, VK_ARM_TENSORS_EXTENSION_NAME);
    const bool graphs = known.serves && enables(*info, VK_ARM_DATA_GRAPH_EXTENSION_NAME);

    VkDeviceCreateInfo below = *info;
    std::optional<ChainCopy> chain;
    const std::vector<const char*> names = names_below(*info, known);
    VkPhysicalDeviceFeatures features{};
    if (known.serves) {
      if (const Result<void> asked = check_features(known, *info); !asked) {
        instance->report(VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
                         VK_OBJECT_TYPE_PHYSICAL_DEVICE, number_of(physical), asked.error().text());
        return VK_ERROR_FEATURE_NOT_PRESENT;
      }
      below.enabledExtensionCount = static_cast<uint32_t>(names.size());
      below.ppEnabledExtensionNames = names.data();
      chain.emplace(info->pNext, known.lends_maintenance5);
      if (tensors || graphs) add_kernel_features(known, below, features, *chain);
      below.pNext = chain->next();
    }
    auto* link = const_cast<VkLayerDeviceCreateInfo*>(link_info<VkLayerDeviceCreateInfo>(
        below.pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO));
    if (!link || !link->u.pLayerInfo) return VK_ERROR_INITIALIZATION_FAILED;
    const PFN_vkGetDeviceProcAddr next = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
    const auto create = reinterpret_cast<PFN_vkCreateDevice>(
        link->u.pLayerInfo->pfnNextGetInstanceProcAddr(instance->handle, "vkCreateDevice"));
    if (!create) return VK_ERROR_INITIALIZATION_FAILED;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;  // the loader's own structure, or its copy
    if (const VkResult created = create(physical, &below, allocator, result); created != VK_SUCCESS)
      return created;

    auto data = std::make_shared<Device>();
    data->handle = *result;
    data->instance = instance.get();
    data->physical = &known;
    data->next = next;
    data->tensors = tensors;
    data->graphs = graphs;
    data->maintenance5 =
        known.lends_maintenance5 && enables(*info, VK_KHR_MAINTENANCE_5_EXTENSION_NAME);
    data->deferred =
        known.lends_deferred && enables(*info, VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME);
    const auto* asked = find_in_chain<VkPhysicalDeviceTensorFeaturesARM>(
        info->pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM);
    data->descriptor_buffers = asks_descriptor_buffers(*info);
    data->tensor_buffers =
        tensors && ((asked && asked->shaderTensorAccess) || data->descriptor_buffers);
    const auto* robustness = find_in_chain<VkPhysicalDeviceRobustness2FeaturesEXT>(
        info->pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ROBUSTNESS_2_FEATURES_EXT);
    data->null_descriptors = robustness && robustness->nullDescriptor;
    const auto find = [&](const char* name) { return next(*result, name); };
#define SHALE_DEVICE_HOOK(name) load(data->name, find("vk" #name));
#include "tools/layer/hooks.def"
    load(data->GetImageSubresourceLayout, find("vkGetImageSubresourceLayout"));
    load(data->CmdBindIndexBuffer, find("vkCmdBindIndexBuffer"));
    load(data->GetBufferDeviceAddress, find("vkGetBufferDeviceAddress"));
    // Since Vulkan 1.4 these are the device's own, and the extension need not be enabled.
    const auto load_core = [&](auto& function, const char* name) {
      if (!function) load(function, find(name));
    };
    load_core(data->CmdPushDescriptorSetKHR, "vkCmdPushDescriptorSet");
    load_core(data->CmdPushDescriptorSetWithTemplateKHR, "vkCmdPushDescriptorSetWithTemplate");
    load_core(data->CmdBindDescriptorSets2KHR, "vkCmdBindDescriptorSets2");
    load_core(data->CmdPushDescriptorSet2KHR, "vkCmdPushDescriptorSet2");
    load_core(data->CmdPushDescriptorSetWithTemplate2KHR, "vkCmdPushDescriptorSetWithTemplate2");
    if (tensors || graphs) {
      if (const Result<void> opened = open_context(*data, below); !opened) {
        const VkResult failed =
            data->fail(VK_OBJECT_TYPE_DEVICE, number_of(*result), opened.error());
        data->DestroyDevice(*result, allocator);
        return failed;
      }
      data->disk_cache = DiskCache::open(*data);
      const auto* flow = find_in_chain<VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM>(
          info->pNext, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM);
      if (graphs && flow && flow->dataGraphOpticalFlow &&
          enables(*info, VK_ARM_DATA_GRAPH_OPTICAL_FLOW_EXTENSION_NAME)) {
        auto sets = create_flow_set_layout(*data);
        if (!sets) {
          const VkResult failed =
              data->fail(VK_OBJECT_TYPE_DEVICE, number_of(*result), sets.error());
          data->DestroyDevice(*result, allocator);
          return failed;
        }
        data->flow_set_layout = *std::move(sets);
        data->optical_flow = true;
      }
      if (data->tensor_buffers) data->shapes = std::make_unique<ShapeSlots>(*data);
    }
    handles().devices.put(dispatch_key(*result), std::move(data));
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyDevice(VkDevice device, const VkAllocationCallbacks* allocator) {
  if (!device) return;
  guarded_void([&] {
    const auto data = handles().devices.take(dispatch_key(device));
    if (!data) return;
    // Threads may still compile for what the application forgot, and waiting for them here, where the
    // loader holds its lock, would be for ever.
    if (!data->pipelines.empty() || !data->sessions.empty()) {
      data->error(VK_OBJECT_TYPE_DEVICE, number_of(device),
                  "vkDestroyDevice: graph pipelines or sessions are left, so the device stays");
      new std::shared_ptr<Device>(data);  // never destroyed
      return;
    }
    data->disk_cache.reset();
    data->shapes.reset();
    data->commands.clear();
    data->late.clear();
    data->layouts.clear();
    data->flow_set_layout = {};
    data->DestroyDevice(device, allocator);
  });
}

}  // namespace shale::layer

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR VkResult VKAPI_CALL
vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface* negotiation) {
  using namespace shale::layer;
  if (!negotiation || negotiation->sType != LAYER_NEGOTIATE_INTERFACE_STRUCT ||
      negotiation->loaderLayerInterfaceVersion < 2)
    return VK_ERROR_INITIALIZATION_FAILED;
  negotiation->loaderLayerInterfaceVersion = 2;
  negotiation->pfnGetInstanceProcAddr = get_instance_proc_addr;
  negotiation->pfnGetDeviceProcAddr = get_device_proc_addr;
  negotiation->pfnGetPhysicalDeviceProcAddr = get_physical_device_proc_addr;
  return VK_SUCCESS;
}
