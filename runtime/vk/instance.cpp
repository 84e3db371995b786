#include "runtime/vk/instance.h"

#include <algorithm>
#include <cstring>

#include "runtime/vk/handle.h"

namespace shale::vk {
namespace {

constexpr const char* kValidationLayer = "VK_LAYER_KHRONOS_validation";

VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT,
                                          VkDebugUtilsMessageTypeFlagsEXT,
                                          const VkDebugUtilsMessengerCallbackDataEXT* data,
                                          void* log) {
  static_cast<ValidationLog*>(log)->add(data->pMessage);
  return VK_FALSE;
}

/// An extension's function.
template <typename Function>
Function instance_function(const Functions& vk, const char* name) {
  const auto function = reinterpret_cast<Function>(vk.GetInstanceProcAddr(vk.instance, name));
  SHALE_CHECK(function);  // the extension is enabled
  return function;
}

bool has_validation_layer(PFN_vkGetInstanceProcAddr get_instance_proc_addr) {
  const auto enumerate = reinterpret_cast<PFN_vkEnumerateInstanceLayerProperties>(
      get_instance_proc_addr(nullptr, "vkEnumerateInstanceLayerProperties"));
  if (!enumerate) return false;
  uint32_t count = 0;
  enumerate(&count, nullptr);
  std::vector<VkLayerProperties> layers(count);
  enumerate(&count, layers.data());
  return std::any_of(layers.begin(), layers.end(), [](const VkLayerProperties& layer) {
    return std::strcmp(layer.layerName, kValidationLayer) == 0;
  });
}

}  // namespace

std::string result_text(VkResult result) {
  switch (result) {
    case VK_ERROR_OUT_OF_HOST_MEMORY: return "VK_ERROR_OUT_OF_HOST_MEMORY";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY: return "VK_ERROR_OUT_OF_DEVICE_MEMORY";
    case VK_ERROR_INITIALIZATION_FAILED: return "VK_ERROR_INITIALIZATION_FAILED";
    case VK_ERROR_DEVICE_LOST: return "VK_ERROR_DEVICE_LOST";
    case VK_ERROR_LAYER_NOT_PRESENT: return "VK_ERROR_LAYER_NOT_PRESENT";
    case VK_ERROR_EXTENSION_NOT_PRESENT: return "VK_ERROR_EXTENSION_NOT_PRESENT";
    case VK_ERROR_FEATURE_NOT_PRESENT: return "VK_ERROR_FEATURE_NOT_PRESENT";
    case VK_ERROR_INCOMPATIBLE_DRIVER: return "VK_ERROR_INCOMPATIBLE_DRIVER";
    case VK_ERROR_TOO_MANY_OBJECTS: return "VK_ERROR_TOO_MANY_OBJECTS";
    case VK_ERROR_FORMAT_NOT_SUPPORTED: return "VK_ERROR_FORMAT_NOT_SUPPORTED";
    case VK_ERROR_FRAGMENTED_POOL: return "VK_ERROR_FRAGMENTED_POOL";
    case VK_ERROR_OUT_OF_POOL_MEMORY: return "VK_ERROR_OUT_OF_POOL_MEMORY";
    case VK_TIMEOUT: return "VK_TIMEOUT";
    case VK_NOT_READY: return "VK_NOT_READY";
    default: return fmt::format("VkResult {}", static_cast<int>(result));
  }
}

void ValidationLog::add(std::string message) {
  const std::lock_guard lock(mutex_);
  messages_.push_back(std::move(message));
}

std::vector<std::string> ValidationLog::take() {
  const std::lock_guard lock(mutex_);
  return std::exchange(messages_, {});
}

Result<Instance> Instance::create(const InstanceOptions& options) {
  Instance result;
  result.log_ = std::make_unique<ValidationLog>();
  PFN_vkGetInstanceProcAddr get_instance_proc_addr = options.get_instance_proc_addr;
  if (!get_instance_proc_addr) {
    SHALE_TRY(get_instance_proc_addr, system_loader());
  }
  if (options.validation && !has_validation_layer(get_instance_proc_addr))
    return device_error("", "{} is not installed", kValidationLayer);

  auto application = init<VkApplicationInfo>(VK_STRUCTURE_TYPE_APPLICATION_INFO);
  application.pApplicationName = "shale";
  application.apiVersion = VK_API_VERSION_1_3;
  auto info = init<VkInstanceCreateInfo>(VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO);
  info.pApplicationInfo = &application;

  const char* extensions[] = {VK_EXT_DEBUG_UTILS_EXTENSION_NAME,
                              VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME};
  const VkValidationFeatureEnableEXT enables[] = {
      VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT};
  auto features = init<VkValidationFeaturesEXT>(VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT);
  features.enabledValidationFeatureCount = 1;
  features.pEnabledValidationFeatures = enables;
  auto messenger = init<VkDebugUtilsMessengerCreateInfoEXT>(
      VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT);
  messenger.pNext = &features;
  messenger.messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT |
                              VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
  // No performance hints: they are against VK_IMAGE_LAYOUT_GENERAL, which is our contract.
  messenger.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
  messenger.pfnUserCallback = on_message;
  messenger.pUserData = result.log_.get();
  if (options.validation) {
    info.pNext = &messenger;  // covers instance creation and destruction themselves
    info.enabledLayerCount = 1;
    info.ppEnabledLayerNames = &kValidationLayer;
    info.enabledExtensionCount = 2;
    info.ppEnabledExtensionNames = extensions;
  }
  const auto create_instance =
      reinterpret_cast<PFN_vkCreateInstance>(get_instance_proc_addr(nullptr, "vkCreateInstance"));
  if (!create_instance) return device_error("", "the Vulkan loader has no vkCreateInstance");
  VkInstance instance = VK_NULL_HANDLE;
  SHALE_TRY_VOID(check(create_instance(&info, nullptr, &instance), "vkCreateInstance"));
  SHALE_TRY(result.functions_, load_instance_functions(instance, get_instance_proc_addr));

  if (options.validation) {
    messenger.pNext = nullptr;
    SHALE_TRY_VOID(check(instance_function<PFN_vkCreateDebugUtilsMessengerEXT>(
                             result.functions_, "vkCreateDebugUtilsMessengerEXT")(
                             instance, &messenger, nullptr, &result.messenger_),
                         "vkCreateDebugUtilsMessengerEXT"));
  }
  return result;
}

Instance::Instance(Instance&& other) noexcept
    : functions_(std::exchange(other.functions_, {})),
      messenger_(std::exchange(other.messenger_, VK_NULL_HANDLE)),
      log_(std::move(other.log_)) {}

Instance& Instance::operator=(Instance&& other) noexcept {
  std::swap(functions_, other.functions_);
  std::swap(messenger_, other.messenger_);
  std::swap(log_, other.log_);
  return *this;
}

Instance::~Instance() {
  if (messenger_ != VK_NULL_HANDLE)
    instance_function<PFN_vkDestroyDebugUtilsMessengerEXT>(
        functions_, "vkDestroyDebugUtilsMessengerEXT")(get(), messenger_, nullptr);
  if (get() != VK_NULL_HANDLE) functions_.DestroyInstance(get(), nullptr);
}

Result<std::vector<VkPhysicalDevice>> Instance::physical_devices() const {
  uint32_t count = 0;
  SHALE_TRY_VOID(check(functions_.EnumeratePhysicalDevices(get(), &count, nullptr),
                       "vkEnumeratePhysicalDevices"));
  std::vector<VkPhysicalDevice> devices(count);
  SHALE_TRY_VOID(check(functions_.EnumeratePhysicalDevices(get(), &count, devices.data()),
                       "vkEnumeratePhysicalDevices"));
  std::erase_if(devices, [&](VkPhysicalDevice device) {
    VkPhysicalDeviceProperties properties;
    functions_.GetPhysicalDeviceProperties(device, &properties);
    return properties.apiVersion < VK_API_VERSION_1_3;
  });
  return devices;
}

Result<VkPhysicalDevice> Instance::find_device(std::string_view name_part) const {
  SHALE_TRY(const auto devices, physical_devices());
  std::string names;
  for (VkPhysicalDevice device : devices) {
    VkPhysicalDeviceProperties properties;
    functions_.GetPhysicalDeviceProperties(device, &properties);
    const std::string_view name = properties.deviceName;
    if (name.find(name_part) != name.npos) return device;
    names += fmt::format("{}\"{}\"", names.empty() ? "" : ", ", name);
  }
  return device_error("", "no Vulkan 1.3 device is named \"{}\"; found: {}", name_part,
                      names.empty() ? "none" : names);
}

}  // namespace shale::vk
