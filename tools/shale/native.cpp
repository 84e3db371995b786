#include "tools/shale/native.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <numeric>
#include <set>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/formats.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/memory.h"
#include "tools/layer/arm_vulkan.h"
#include "tools/shale/terminal.h"

namespace shale {
namespace {

using vk::check;
using vk::Handle;
using vk::init;
using vk::make;

constexpr const char* kInstructionSet = "TOSA.001000.1";

#define SHALE_ARM_FUNCTIONS(X)                           \
  X(CreateTensorARM)                                     \
  X(DestroyTensorARM)                                    \
  X(CreateTensorViewARM)                                 \
  X(DestroyTensorViewARM)                                \
  X(GetTensorMemoryRequirementsARM)                      \
  X(BindTensorMemoryARM)                                 \
  X(CreateDataGraphPipelinesARM)                         \
  X(CreateDataGraphPipelineSessionARM)                   \
  X(DestroyDataGraphPipelineSessionARM)                  \
  X(GetDataGraphPipelineSessionBindPointRequirementsARM) \
  X(GetDataGraphPipelineSessionMemoryRequirementsARM)    \
  X(BindDataGraphPipelineSessionMemoryARM)               \
  X(CmdDispatchDataGraphARM)

struct ArmFunctions {
#define SHALE_ARM_MEMBER(name) PFN_vk##name name = nullptr;
  SHALE_ARM_FUNCTIONS(SHALE_ARM_MEMBER)
#undef SHALE_ARM_MEMBER
};

std::set<std::string> extensions_of(const vk::Functions& vk, VkPhysicalDevice device) {
  uint32_t count = 0;
  std::vector<VkExtensionProperties> list;
  if (vk.EnumerateDeviceExtensionProperties(device, nullptr, &count, nullptr) != VK_SUCCESS)
    return {};
  list.resize(count);
  vk.EnumerateDeviceExtensionProperties(device, nullptr, &count, list.data());
  std::set<std::string> names;
  for (const VkExtensionProperties& each : list) names.insert(each.extensionName);
  return names;
}

/// The first queue family that runs graphs of the instruction set.
std::optional<uint32_t> graph_family(const vk::Functions& vk, VkPhysicalDevice device) {
  const auto query = reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM>(
      vk.GetInstanceProcAddr(vk.instance, "vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM"));
  if (!query) return std::nullopt;
  uint32_t families = 0;
  vk.GetPhysicalDeviceQueueFamilyProperties(device, &families, nullptr);
  for (uint32_t family = 0; family < families; ++family) {
    uint32_t count = 0;
    if (query(device, family, &count, nullptr) != VK_SUCCESS) continue;
    std::vector<VkQueueFamilyDataGraphPropertiesARM> list(
        count, init<VkQueueFamilyDataGraphPropertiesARM>(
                   VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_PROPERTIES_ARM));
    if (query(device, family, &count, list.data()) != VK_SUCCESS) continue;
    for (const VkQueueFamilyDataGraphPropertiesARM& each : list)
      if (std::strcmp(each.operation.name, kInstructionSet) == 0 && !each.engine.isForeign)
        return family;
  }
  return std::nullopt;
}

/// What the extensions' features are, and what modules of graphs declare.
struct NativeFeatures {
  VkPhysicalDeviceTensorFeaturesARM tensors = init<VkPhysicalDeviceTensorFeaturesARM>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM);
  VkPhysicalDeviceDataGraphFeaturesARM graphs = init<VkPhysicalDeviceDataGraphFeaturesARM>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM);
  VkPhysicalDeviceVulkan12Features v12 =
      init<VkPhysicalDeviceVulkan12Features>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES);
  VkPhysicalDeviceFeatures2 all =
      init<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2);

  NativeFeatures() {
    all.pNext = &v12;
    v12.pNext = &graphs;
    graphs.pNext = &tensors;
  }
  NativeFeatures(const NativeFeatures&) = delete;
  NativeFeatures& operator=(const NativeFeatures&) = delete;
};

/// Tensors of Vulkan have an axis at least, and no 4-bit elements.
TensorType api_type(const TensorType& type) {
  return {type.dtype == DType::kInt4 ? DType::kInt8 : type.dtype,
          type.shape.empty() ? Shape{1} : type.shape};
}

VkTensorDescriptionARM describe(const TensorType& type) {
  auto description = init<VkTensorDescriptionARM>(VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM);
  description.tiling = VK_TENSOR_TILING_LINEAR_ARM;
  description.format = static_cast<VkFormat>(vk_format_of_dtype(type.dtype));
  description.dimensionCount = static_cast<uint32_t>(type.shape.size());
  description.pDimensions = type.shape.data();
  description.usage = VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM;
  return description;
}

/// A tensor with mapped memory and a view; freed from the last member on.
struct NativeTensor {
  vk::MemoryHandle memory;
  Handle<VkTensorARM> tensor;
  Handle<VkTensorViewARM> view;
  void* mapped = nullptr;
};

}  // namespace

struct NativeDevice::State {
  explicit State(vk::Instance own) : instance(std::move(own)) {}
  State(const State&) = delete;
  State& operator=(const State&) = delete;
  ~State() {
    if (context.device != VK_NULL_HANDLE) context.vk.DestroyDevice(context.device, nullptr);
  }

  Result<void> create_device(VkPhysicalDevice physical);
  Result<NativeTensor> tensor(const TensorType& type, vk::MemoryKind kind) const;
  /// Memory for all bind points of a session, bound.
  Result<std::vector<vk::MemoryHandle>> bind_session(VkDataGraphPipelineSessionARM session) const;

  vk::Instance instance;
  vk::Context context;
  ArmFunctions arm;
};

Result<void> NativeDevice::State::create_device(VkPhysicalDevice physical) {
  const vk::Functions& functions = instance.functions();
  context.caps = vk::snapshot_caps(physical, functions);
  const std::string& name = context.caps.name;
  const std::set<std::string> known = extensions_of(functions, physical);
  std::vector<const char*> extensions;
  for (const char* needed : {VK_ARM_TENSORS_EXTENSION_NAME, VK_ARM_DATA_GRAPH_EXTENSION_NAME}) {
    if (!known.contains(needed))
      return device_error(name, "has no {}; a layer may give it (tools/layer/README.md)", needed);
    extensions.push_back(needed);
  }
  // VK_ARM_data_graph depends on them, where they are known.
  for (const char* wanted :
       {VK_KHR_MAINTENANCE_5_EXTENSION_NAME, VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME})
    if (known.contains(wanted)) extensions.push_back(wanted);
  const std::optional<uint32_t> family = graph_family(functions, physical);
  if (!family) return device_error(name, "has no queue family that runs {}", kInstructionSet);

  NativeFeatures have, enabled;
  functions.GetPhysicalDeviceFeatures2(physical, &have.all);
  if (!have.tensors.tensors || !have.graphs.dataGraph || !have.graphs.dataGraphShaderModule)
    return device_error(name, "lacks a feature: tensors {}, dataGraph {}, dataGraphShaderModule {}",
                        have.tensors.tensors, have.graphs.dataGraph,
                        have.graphs.dataGraphShaderModule);
  enabled.tensors.tensors = enabled.graphs.dataGraph = enabled.graphs.dataGraphShaderModule =
      VK_TRUE;
  enabled.all.features.shaderInt16 = have.all.features.shaderInt16;
  enabled.all.features.shaderInt64 = have.all.features.shaderInt64;
  enabled.v12.shaderInt8 = have.v12.shaderInt8;
  enabled.v12.shaderFloat16 = have.v12.shaderFloat16;
  enabled.v12.vulkanMemoryModel = have.v12.vulkanMemoryModel;

  const float priority = 1;
  auto queue = init<VkDeviceQueueCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO);
  queue.queueFamilyIndex = *family;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  auto info = init<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
  info.pNext = &enabled.all;
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  info.ppEnabledExtensionNames = extensions.data();
  VkDevice device = VK_NULL_HANDLE;
  SHALE_TRY_VOID(
      check(functions.CreateDevice(physical, &info, nullptr, &device), "vkCreateDevice"));
  context.vk = functions;
  // Before the device is the state's, which takes this function to destroy it.
  context.vk.DestroyDevice =
      reinterpret_cast<PFN_vkDestroyDevice>(functions.GetDeviceProcAddr(device, "vkDestroyDevice"));
  if (!context.vk.DestroyDevice) return device_error(name, "has no vkDestroyDevice");
  context.device = device;
  context.physical_device = physical;
  context.queue_family = *family;
  SHALE_TRY_VOID(vk::load_device_functions(context.vk, device));
  functions.GetPhysicalDeviceMemoryProperties(physical, &context.memory);
  context.vk.GetDeviceQueue(device, *family, 0, &context.queue);
#define SHALE_ARM_LOAD(function)                                                               \
  arm.function =                                                                               \
      reinterpret_cast<PFN_vk##function>(functions.GetDeviceProcAddr(device, "vk" #function)); \
  if (!arm.function) return device_error(name, "has no function {}", "vk" #function);
  SHALE_ARM_FUNCTIONS(SHALE_ARM_LOAD)
#undef SHALE_ARM_LOAD
  return {};
}

Result<NativeTensor> NativeDevice::State::tensor(const TensorType& type,
                                                 vk::MemoryKind kind) const {
  const VkTensorDescriptionARM description = describe(type);
  auto info = init<VkTensorCreateInfoARM>(VK_STRUCTURE_TYPE_TENSOR_CREATE_INFO_ARM);
  info.pDescription = &description;
  NativeTensor result;
  SHALE_TRY(result.tensor, make(arm.CreateTensorARM, arm.DestroyTensorARM, "vkCreateTensorARM",
                                context.device, info));
  auto which = init<VkTensorMemoryRequirementsInfoARM>(
      VK_STRUCTURE_TYPE_TENSOR_MEMORY_REQUIREMENTS_INFO_ARM);
  which.tensor = result.tensor.get();
  auto needs = init<VkMemoryRequirements2>(VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2);
  arm.GetTensorMemoryRequirementsARM(context.device, &which, &needs);
  SHALE_TRY(result.memory, vk::allocate(context, needs.memoryRequirements, kind));
  auto bind = init<VkBindTensorMemoryInfoARM>(VK_STRUCTURE_TYPE_BIND_TENSOR_MEMORY_INFO_ARM);
  bind.tensor = result.tensor.get();
  bind.memory = result.memory.get();
  SHALE_TRY_VOID(check(arm.BindTensorMemoryARM(context.device, 1, &bind), "vkBindTensorMemoryARM"));
  SHALE_TRY_VOID(check(context.vk.MapMemory(context.device, result.memory.get(), 0, VK_WHOLE_SIZE,
                                            0, &result.mapped),
                       "vkMapMemory"));
  auto view = init<VkTensorViewCreateInfoARM>(VK_STRUCTURE_TYPE_TENSOR_VIEW_CREATE_INFO_ARM);
  view.tensor = result.tensor.get();
  view.format = description.format;
  SHALE_TRY(result.view, make(arm.CreateTensorViewARM, arm.DestroyTensorViewARM,
                              "vkCreateTensorViewARM", context.device, view));
  return result;
}

Result<std::vector<vk::MemoryHandle>> NativeDevice::State::bind_session(
    VkDataGraphPipelineSessionARM session) const {
  auto which = init<VkDataGraphPipelineSessionBindPointRequirementsInfoARM>(
      VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_REQUIREMENTS_INFO_ARM);
  which.session = session;
  constexpr const char* kCall = "vkGetDataGraphPipelineSessionBindPointRequirementsARM";
  uint32_t count = 0;
  SHALE_TRY_VOID(check(arm.GetDataGraphPipelineSessionBindPointRequirementsARM(
                           context.device, &which, &count, nullptr),
                       kCall));
  std::vector<VkDataGraphPipelineSessionBindPointRequirementARM> points(
      count, init<VkDataGraphPipelineSessionBindPointRequirementARM>(
                 VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_REQUIREMENT_ARM));
  SHALE_TRY_VOID(check(arm.GetDataGraphPipelineSessionBindPointRequirementsARM(
                           context.device, &which, &count, points.data()),
                       kCall));
  std::vector<vk::MemoryHandle> memory;
  for (const VkDataGraphPipelineSessionBindPointRequirementARM& point : points) {
    if (point.bindPointType != VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TYPE_MEMORY_ARM) continue;
    for (uint32_t object = 0; object < point.numObjects; ++object) {
      auto needed = init<VkDataGraphPipelineSessionMemoryRequirementsInfoARM>(
          VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_MEMORY_REQUIREMENTS_INFO_ARM);
      needed.session = session;
      needed.bindPoint = point.bindPoint;
      needed.objectIndex = object;
      auto needs = init<VkMemoryRequirements2>(VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2);
      arm.GetDataGraphPipelineSessionMemoryRequirementsARM(context.device, &needed, &needs);
      if (needs.memoryRequirements.size == 0) continue;
      SHALE_TRY(vk::MemoryHandle handle,
                vk::allocate(context, needs.memoryRequirements, vk::MemoryKind::kDevice));
      auto bind = init<VkBindDataGraphPipelineSessionMemoryInfoARM>(
          VK_STRUCTURE_TYPE_BIND_DATA_GRAPH_PIPELINE_SESSION_MEMORY_INFO_ARM);
      bind.session = session;
      bind.bindPoint = point.bindPoint;
      bind.objectIndex = object;
      bind.memory = handle.get();
      SHALE_TRY_VOID(check(arm.BindDataGraphPipelineSessionMemoryARM(context.device, 1, &bind),
                           "vkBindDataGraphPipelineSessionMemoryARM"));
      memory.push_back(std::move(handle));
    }
  }
  return memory;
}

NativeDevice::NativeDevice(std::unique_ptr<State> state) : state_(std::move(state)) {}
NativeDevice::NativeDevice(NativeDevice&&) noexcept = default;
NativeDevice& NativeDevice::operator=(NativeDevice&&) noexcept = default;
NativeDevice::~NativeDevice() = default;

const std::string& NativeDevice::name() const { return state_->context.caps.name; }

std::vector<std::string> NativeDevice::take_validation_messages() {
  return state_->instance.take_validation_messages();
}

Result<void> NativeDevice::close() {
  const std::vector<std::string> messages = take_validation_messages();
  if (!messages.empty()) return device_error("validation", "{}", messages.front());
  return {};
}

Result<NativeDevice> NativeDevice::open(const DeviceArguments& arguments) {
  SHALE_TRY(vk::Instance instance, vk::Instance::create({.validation = arguments.validation}));
  auto state = std::make_unique<State>(std::move(instance));
  SHALE_TRY(VkPhysicalDevice physical, state->instance.find_device(arguments.name));
  if (arguments.name.empty()) {
    SHALE_TRY(const std::vector<VkPhysicalDevice> all, state->instance.physical_devices());
    for (const VkPhysicalDevice each : all)
      if (extensions_of(state->instance.functions(), each)
              .contains(VK_ARM_DATA_GRAPH_EXTENSION_NAME)) {
        physical = each;
        break;
      }
  }
  SHALE_TRY_VOID(state->create_device(physical));
  return NativeDevice(std::move(state));
}

/// In the order of construction: what is used goes last.
struct NativeNetwork::State {
  const NativeDevice::State* device = nullptr;
  std::vector<TensorType> outputs;
  std::vector<NativeTensor> tensors;  ///< inputs, outputs
  vk::SetLayoutHandle set_layout;
  vk::PipelineLayoutHandle layout;
  vk::DescriptorPoolHandle pool;
  VkDescriptorSet set = VK_NULL_HANDLE;
  vk::PipelineHandle pipeline;
  std::vector<vk::MemoryHandle> memory;
  Handle<VkDataGraphPipelineSessionARM> session;
};

Result<NativeNetwork> NativeDevice::load(const Graph& graph,
                                         const std::vector<Tensor>& inputs) const {
  const vk::Context& context = state_->context;
  const vk::Functions& vk = context.vk;
  const ArmFunctions& arm = state_->arm;
  std::vector<TensorType> types;
  for (const auto* ids : {&graph.inputs, &graph.outputs})
    for (const ValueId id : *ids) {
      const Value& value = graph.value(id);
      const TensorType type = api_type(value.type);
      if (vk_format_of_dtype(type.dtype) == 0 || *element_count(type.shape) == 0)
        return unsupported(value.name, "Vulkan has no tensor of this type");
      types.push_back(type);
    }
  SHALE_TRY(const SpirvGraphModule module, write_spirv_graph(graph, {.external_constants = true}));
  auto module_info = init<VkShaderModuleCreateInfo>(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
  module_info.codeSize = 4 * module.words.size();
  module_info.pCode = module.words.data();
  SHALE_TRY(const vk::ShaderModuleHandle shader,
            make(vk.CreateShaderModule, vk.DestroyShaderModule, "vkCreateShaderModule",
                 context.device, module_info));

  auto network = std::make_unique<NativeNetwork::State>();
  network->device = state_.get();
  for (const ValueId id : graph.outputs) network->outputs.push_back(graph.value(id).type);
  std::vector<NativeTensor>& tensors = network->tensors;
  const auto count = static_cast<uint32_t>(types.size());
  for (uint32_t i = 0; i < count; ++i) {
    const bool input = i < inputs.size();
    SHALE_TRY(NativeTensor tensor, state_->tensor(types[i], input ? vk::MemoryKind::kUpload
                                                                  : vk::MemoryKind::kReadback));
    if (input) std::memcpy(tensor.mapped, inputs[i].bytes.data(), inputs[i].bytes.size());
    tensors.push_back(std::move(tensor));
  }

  std::vector<VkDescriptorSetLayoutBinding> bindings(count);
  for (uint32_t i = 0; i < count; ++i)
    bindings[i] = {i, VK_DESCRIPTOR_TYPE_TENSOR_ARM, 1, VK_SHADER_STAGE_ALL, nullptr};
  auto set_info =
      init<VkDescriptorSetLayoutCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  set_info.bindingCount = count;
  set_info.pBindings = bindings.data();
  SHALE_TRY(network->set_layout, make(vk.CreateDescriptorSetLayout, vk.DestroyDescriptorSetLayout,
                                      "vkCreateDescriptorSetLayout", context.device, set_info));
  const VkDescriptorSetLayout layouts[] = {network->set_layout.get()};
  auto layout_info =
      init<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  layout_info.setLayoutCount = 1;
  layout_info.pSetLayouts = layouts;
  SHALE_TRY(network->layout, make(vk.CreatePipelineLayout, vk.DestroyPipelineLayout,
                                  "vkCreatePipelineLayout", context.device, layout_info));
  const VkDescriptorPoolSize pool_size{VK_DESCRIPTOR_TYPE_TENSOR_ARM, count};
  auto pool_info = init<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  pool_info.maxSets = 1;
  pool_info.poolSizeCount = 1;
  pool_info.pPoolSizes = &pool_size;
  SHALE_TRY(network->pool, make(vk.CreateDescriptorPool, vk.DestroyDescriptorPool,
                                "vkCreateDescriptorPool", context.device, pool_info));
  auto allocate = init<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  allocate.descriptorPool = network->pool.get();
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = layouts;
  SHALE_TRY_VOID(check(vk.AllocateDescriptorSets(context.device, &allocate, &network->set),
                       "vkAllocateDescriptorSets"));
  for (uint32_t i = 0; i < count; ++i) {
    const VkTensorViewARM view = tensors[i].view.get();
    auto written =
        init<VkWriteDescriptorSetTensorARM>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM);
    written.tensorViewCount = 1;
    written.pTensorViews = &view;
    auto write = init<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
    write.pNext = &written;
    write.dstSet = network->set;
    write.dstBinding = i;
    write.descriptorCount = 1;
    write.descriptorType = VK_DESCRIPTOR_TYPE_TENSOR_ARM;
    vk.UpdateDescriptorSets(context.device, 1, &write, 0, nullptr);
  }

  std::vector<VkTensorDescriptionARM> descriptions;
  for (const TensorType& type : types) descriptions.push_back(describe(type));
  std::vector<VkDataGraphPipelineResourceInfoARM> resources(
      count, init<VkDataGraphPipelineResourceInfoARM>(
                 VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_RESOURCE_INFO_ARM));
  for (uint32_t i = 0; i < count; ++i)
    resources[i].pNext = &descriptions[i], resources[i].binding = i;
  const auto constant_count = static_cast<uint32_t>(module.constants.size());
  std::vector<TensorType> constant_types;
  for (const Tensor& constant : module.constants) constant_types.push_back(api_type(constant.type));
  std::vector<VkTensorDescriptionARM> constant_descriptions;
  for (const TensorType& type : constant_types) constant_descriptions.push_back(describe(type));
  std::vector<VkDataGraphPipelineConstantARM> constants(
      constant_count,
      init<VkDataGraphPipelineConstantARM>(VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CONSTANT_ARM));
  for (uint32_t i = 0; i < constant_count; ++i) {
    constants[i].pNext = &constant_descriptions[i];
    constants[i].id = i;
    constants[i].pConstantData = module.constants[i].bytes.data();
  }
  auto stage = init<VkDataGraphPipelineShaderModuleCreateInfoARM>(
      VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SHADER_MODULE_CREATE_INFO_ARM);
  stage.module = shader.get();
  stage.pName = module.entry_point.c_str();
  stage.constantCount = constant_count;
  stage.pConstants = constants.data();
  auto pipeline_info =
      init<VkDataGraphPipelineCreateInfoARM>(VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM);
  pipeline_info.pNext = &stage;
  pipeline_info.layout = network->layout.get();
  pipeline_info.resourceInfoCount = count;
  pipeline_info.pResourceInfos = resources.data();
  VkPipeline made = VK_NULL_HANDLE;
  SHALE_TRY_VOID(
      check(arm.CreateDataGraphPipelinesARM(context.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 1,
                                            &pipeline_info, nullptr, &made),
            "vkCreateDataGraphPipelinesARM"));
  network->pipeline = vk::PipelineHandle(context.device, made, vk.DestroyPipeline);
  auto session_info = init<VkDataGraphPipelineSessionCreateInfoARM>(
      VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_CREATE_INFO_ARM);
  session_info.dataGraphPipeline = made;
  SHALE_TRY(network->session,
            make(arm.CreateDataGraphPipelineSessionARM, arm.DestroyDataGraphPipelineSessionARM,
                 "vkCreateDataGraphPipelineSessionARM", context.device, session_info));
  SHALE_TRY(network->memory, state_->bind_session(network->session.get()));
  return NativeNetwork(std::move(network));
}

NativeNetwork::NativeNetwork(std::unique_ptr<State> state) : state_(std::move(state)) {}
NativeNetwork::NativeNetwork(NativeNetwork&&) noexcept = default;
NativeNetwork::~NativeNetwork() = default;

Result<double> NativeNetwork::run() {
  const vk::Context& context = state_->device->context;
  const auto begin = std::chrono::steady_clock::now();
  SHALE_TRY_VOID(vk::submit_and_wait(context, [&](VkCommandBuffer commands) {
    context.vk.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                               state_->pipeline.get());
    context.vk.CmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                     state_->layout.get(), 0, 1, &state_->set, 0, nullptr);
    state_->device->arm.CmdDispatchDataGraphARM(commands, state_->session.get(), nullptr);
    vk::memory_barrier(context, commands, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT,
                       VK_ACCESS_MEMORY_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                       VK_ACCESS_HOST_READ_BIT);
  }));
  return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin)
      .count();
}

std::vector<Tensor> NativeNetwork::outputs() const {
  std::vector<Tensor> outputs;
  const size_t inputs = state_->tensors.size() - state_->outputs.size();
  for (const TensorType& type : state_->outputs) {
    Tensor output = Tensor::zeros(type);
    std::memcpy(output.bytes.data(), state_->tensors[inputs + outputs.size()].mapped,
                output.bytes.size());
    outputs.push_back(std::move(output));
  }
  return outputs;
}

Result<std::vector<Tensor>> NativeDevice::run(const Graph& graph, const std::vector<Tensor>& inputs,
                                              uint32_t repeat, double* median_us,
                                              StartTimes* start) const {
  const auto begin = std::chrono::steady_clock::now();
  SHALE_TRY(NativeNetwork network, load(graph, inputs));
  if (start)
    start->create_ms =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
  std::vector<double> times;
  Progress progress("running");
  for (uint32_t i = 0; i < repeat; ++i) {
    if (!progress.step(i, repeat)) return bad_input("", "interrupted");
    SHALE_TRY(times.emplace_back(), network.run());
  }
  if (start) start->first_ms = 1e-3 * times.front();
  if (median_us) {
    const auto middle = times.begin() + static_cast<ptrdiff_t>(times.size() / 2);
    std::nth_element(times.begin(), middle, times.end());
    *median_us = *middle;
  }
  return network.outputs();
}

}  // namespace shale
