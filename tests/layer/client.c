#include "tests/layer/client.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void must(VkResult result, const char* call) {
  if (result == VK_SUCCESS) return;
  fprintf(stderr, "client: %s: %d\n", call, (int)result);
  exit(3);
}
#define MUST(call) must(call, #call)

static VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                 VkDebugUtilsMessageTypeFlagsEXT types,
                                                 const VkDebugUtilsMessengerCallbackDataEXT* data,
                                                 void* user) {
  (void)severity, (void)types;
  Client* client = user;
  const bool validation =
      data->pMessageIdName && (strncmp(data->pMessageIdName, "VUID", 4) == 0 ||
                               strncmp(data->pMessageIdName, "SYNC", 4) == 0 ||
                               strncmp(data->pMessageIdName, "UNASSIGNED", 10) == 0);
  if (validation) {
    ++client->validation_messages;
    fprintf(stderr, "%s\n", data->pMessage);
  } else {
    ++client->other_messages;
  }
  snprintf(client->last_message, sizeof client->last_message, "%s", data->pMessage);
  return VK_FALSE;
}

static bool has_extension(VkPhysicalDevice physical, const char* name) {
  uint32_t count = 0;
  MUST(vkEnumerateDeviceExtensionProperties(physical, NULL, &count, NULL));
  VkExtensionProperties* list = calloc(count + 1, sizeof *list);
  MUST(vkEnumerateDeviceExtensionProperties(physical, NULL, &count, list));
  bool found = false;
  for (uint32_t i = 0; i < count; ++i) found = found || strcmp(list[i].extensionName, name) == 0;
  free(list);
  return found;
}

static bool find_family(VkPhysicalDevice physical, uint32_t* family) {
  VkQueueFamilyProperties families[32];
  uint32_t count = 32;
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, families);
  for (*family = 0; *family < count; ++*family)
    if (families[*family].queueFlags & VK_QUEUE_DATA_GRAPH_BIT_ARM) return true;
  return false;
}

static VkResult open_instance(Client* client) {
  const VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
                                         .apiVersion = VK_API_VERSION_1_3};
  const char* extension = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
  const VkInstanceCreateInfo info = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                     .pApplicationInfo = &application,
                                     .enabledExtensionCount = 1,
                                     .ppEnabledExtensionNames = &extension};
  const VkResult result = vkCreateInstance(&info, NULL, &client->instance);
  if (result != VK_SUCCESS) return result;
  const VkDebugUtilsMessengerCreateInfoEXT messenger = {
      .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
      .messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT |
                         VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
      .messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT |
                     VK_DEBUG_UTILS_MESSAGE_TYPE_GENERAL_BIT_EXT,
      .pfnUserCallback = on_message,
      .pUserData = client};
  const PFN_vkCreateDebugUtilsMessengerEXT create =
      (PFN_vkCreateDebugUtilsMessengerEXT)vkGetInstanceProcAddr(client->instance,
                                                                "vkCreateDebugUtilsMessengerEXT");
  MUST(create(client->instance, &messenger, NULL, &client->messenger));
  return VK_SUCCESS;
}

static VkResult open_device(Client* client, void* next) {
  const float priority = 1;
  const VkDeviceQueueCreateInfo queue = {.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
                                         .queueFamilyIndex = client->family,
                                         .queueCount = 1,
                                         .pQueuePriorities = &priority};
  VkPhysicalDeviceDataGraphFeaturesARM graphs = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM, .pNext = next};
  VkPhysicalDeviceTensorFeaturesARM tensors = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM, .pNext = &graphs};
  /* What modules of graphs and shaders of tensors declare. */
  VkPhysicalDeviceMaintenance5FeaturesKHR maintenance5 = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_FEATURES_KHR, .pNext = &tensors};
  VkPhysicalDeviceVulkanMemoryModelFeatures model = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES,
      .pNext = &maintenance5};
  VkPhysicalDeviceShaderFloat16Int8Features types = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES, .pNext = &model};
  VkPhysicalDeviceVulkan13Features v13 = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
      .pNext = next ? (void*)&model : (void*)&types};
  VkPhysicalDeviceFeatures2 all = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2,
                                   .pNext = &v13};
  vkGetPhysicalDeviceFeatures2(client->physical, &all);
  if (!tensors.tensors || !graphs.dataGraph || !graphs.dataGraphShaderModule)
    return VK_ERROR_FEATURE_NOT_PRESENT;
  all.features = (VkPhysicalDeviceFeatures){.shaderInt16 = all.features.shaderInt16,
                                            .shaderInt64 = all.features.shaderInt64};
  const char* names[12] = {VK_ARM_TENSORS_EXTENSION_NAME, VK_ARM_DATA_GRAPH_EXTENSION_NAME};
  uint32_t name_count = 2;
  /* VK_ARM_data_graph depends on the last two. */
  const char* wanted[] = {VK_KHR_PUSH_DESCRIPTOR_EXTENSION_NAME,
                          VK_KHR_MAINTENANCE_5_EXTENSION_NAME,
                          VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME};
  for (size_t i = 0; i < sizeof wanted / sizeof *wanted; ++i)
    if (has_extension(client->physical, wanted[i])) names[name_count++] = wanted[i];
  for (VkBaseOutStructure* each = next; each; each = each->pNext) {
    if (each->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_FEATURES_EXT)
      names[name_count++] = VK_EXT_DESCRIPTOR_BUFFER_EXTENSION_NAME;
    if (each->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ROBUSTNESS_2_FEATURES_EXT) {
      /* For null descriptors; the others want robustBufferAccess, too. */
      VkPhysicalDeviceRobustness2FeaturesEXT* robustness = (void*)each;
      robustness->robustBufferAccess2 = robustness->robustImageAccess2 = VK_FALSE;
      names[name_count++] = VK_EXT_ROBUSTNESS_2_EXTENSION_NAME;
    }
    if (each->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM)
      names[name_count++] = VK_ARM_DATA_GRAPH_OPTICAL_FLOW_EXTENSION_NAME;
  }
  const VkDeviceCreateInfo info = {.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
                                   .pNext = &all,
                                   .queueCreateInfoCount = 1,
                                   .pQueueCreateInfos = &queue,
                                   .enabledExtensionCount = name_count,
                                   .ppEnabledExtensionNames = names};
  return vkCreateDevice(client->physical, &info, NULL, &client->device);
}

VkResult client_open(Client* client, void* next) {
  memset(client, 0, sizeof *client);
  VkResult result = open_instance(client);
  if (result != VK_SUCCESS) return result;
  VkPhysicalDevice devices[16];
  uint32_t count = 16;
  MUST(vkEnumeratePhysicalDevices(client->instance, &count, devices));
  for (uint32_t i = 0; i < count && !client->physical; ++i)
    if (has_extension(devices[i], VK_ARM_TENSORS_EXTENSION_NAME) &&
        has_extension(devices[i], VK_ARM_DATA_GRAPH_EXTENSION_NAME) &&
        find_family(devices[i], &client->family))
      client->physical = devices[i];
  result = client->physical ? open_device(client, next) : VK_ERROR_EXTENSION_NOT_PRESENT;
  if (result != VK_SUCCESS) {
    client_close(client);
    return result;
  }
  vkGetDeviceQueue(client->device, client->family, 0, &client->queue);
  vkGetPhysicalDeviceMemoryProperties(client->physical, &client->memory);
#define CLIENT_LOAD(name)                                                       \
  client->name = (PFN_vk##name)vkGetDeviceProcAddr(client->device, "vk" #name); \
  must(client->name ? VK_SUCCESS : VK_ERROR_INITIALIZATION_FAILED, "vk" #name);
  CLIENT_FUNCTIONS(CLIENT_LOAD)
#undef CLIENT_LOAD
  return VK_SUCCESS;
}

void client_close(Client* client) {
  if (client->device) vkDestroyDevice(client->device, NULL);
  const PFN_vkDestroyDebugUtilsMessengerEXT destroy =
      (PFN_vkDestroyDebugUtilsMessengerEXT)vkGetInstanceProcAddr(client->instance,
                                                                 "vkDestroyDebugUtilsMessengerEXT");
  destroy(client->instance, client->messenger, NULL);
  vkDestroyInstance(client->instance, NULL);
  client->device = NULL;
  client->instance = NULL;
}

uint32_t client_memory_type(const Client* client, uint32_t type_bits, VkMemoryPropertyFlags flags) {
  for (uint32_t i = 0; i < client->memory.memoryTypeCount; ++i)
    if (type_bits >> i & 1 && (client->memory.memoryTypes[i].propertyFlags & flags) == flags)
      return i;
  must(VK_ERROR_FEATURE_NOT_PRESENT, "memory type");
  return 0;
}

static VkDeviceMemory allocate(const Client* client, const VkMemoryRequirements* needs,
                               VkMemoryPropertyFlags flags) {
  const VkMemoryAllocateInfo info = {
      .sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
      .allocationSize = needs->size,
      .memoryTypeIndex = client_memory_type(client, needs->memoryTypeBits, flags)};
  VkDeviceMemory memory;
  MUST(vkAllocateMemory(client->device, &info, NULL, &memory));
  return memory;
}

VkResult client_create_tensor(const Client* client, VkFormat format, VkTensorTilingARM tiling,
                              uint32_t rank, const int64_t* dims, const int64_t* strides,
                              ClientTensor* tensor) {
  memset(tensor, 0, sizeof *tensor);
  for (uint32_t i = 0; i < rank && i < CLIENT_MAX_RANK; ++i) {
    tensor->dims[i] = dims[i];
    if (strides) tensor->strides[i] = strides[i];
  }
  tensor->description = (VkTensorDescriptionARM){
      .sType = VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM,
      .tiling = strides ? VK_TENSOR_TILING_LINEAR_ARM : tiling,
      .format = format,
      .dimensionCount = rank,
      .pDimensions = tensor->dims,
      .pStrides = strides ? tensor->strides : NULL,
      .usage = VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM | VK_TENSOR_USAGE_TRANSFER_SRC_BIT_ARM |
               VK_TENSOR_USAGE_TRANSFER_DST_BIT_ARM | client->more_usage};
  const VkTensorCreateInfoARM info = {.sType = VK_STRUCTURE_TYPE_TENSOR_CREATE_INFO_ARM,
                                      .pDescription = &tensor->description,
                                      .sharingMode = VK_SHARING_MODE_EXCLUSIVE};
  const VkResult result = client->CreateTensorARM(client->device, &info, NULL, &tensor->tensor);
  if (result != VK_SUCCESS) return result;
  const VkTensorMemoryRequirementsInfoARM which = {
      .sType = VK_STRUCTURE_TYPE_TENSOR_MEMORY_REQUIREMENTS_INFO_ARM, .tensor = tensor->tensor};
  VkMemoryRequirements2 needs = {.sType = VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2};
  client->GetTensorMemoryRequirementsARM(client->device, &which, &needs);
  needs.memoryRequirements.size += client->more_bytes;
  tensor->size = needs.memoryRequirements.size;
  tensor->memory =
      allocate(client, &needs.memoryRequirements,
               VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
  const VkBindTensorMemoryInfoARM bind = {.sType = VK_STRUCTURE_TYPE_BIND_TENSOR_MEMORY_INFO_ARM,
                                          .tensor = tensor->tensor,
                                          .memory = tensor->memory};
  MUST(client->BindTensorMemoryARM(client->device, 1, &bind));
  MUST(vkMapMemory(client->device, tensor->memory, 0, VK_WHOLE_SIZE, 0, &tensor->mapped));
  memset(tensor->mapped, 0, (size_t)tensor->size);
  const VkTensorViewCreateInfoARM view = {.sType = VK_STRUCTURE_TYPE_TENSOR_VIEW_CREATE_INFO_ARM,
                                          .tensor = tensor->tensor,
                                          .format = format};
  MUST(client->CreateTensorViewARM(client->device, &view, NULL, &tensor->view));
  return VK_SUCCESS;
}

void client_destroy_tensor(const Client* client, ClientTensor* tensor) {
  client->DestroyTensorViewARM(client->device, tensor->view, NULL);
  client->DestroyTensorARM(client->device, tensor->tensor, NULL);
  vkFreeMemory(client->device, tensor->memory, NULL);
}

static void create_layouts(const Client* client, const ClientGraphInfo* info, ClientGraph* graph) {
  const uint32_t tensors = info->tensor_count;
  VkDescriptorSetLayoutBinding* bindings = calloc(tensors + 1, sizeof *bindings);
  VkDescriptorBindingFlags* flags = calloc(tensors + 1, sizeof *flags);
  for (uint32_t i = 0; i < tensors; ++i) flags[i] = VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT;
  const VkDescriptorSetLayoutBindingFlagsCreateInfo late = {
      .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_BINDING_FLAGS_CREATE_INFO,
      .bindingCount = tensors,
      .pBindingFlags = flags};
  const bool is_late = info->set_flags & VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT;
  for (uint32_t i = 0; i < tensors; ++i)
    bindings[i] = (VkDescriptorSetLayoutBinding){.binding = info->bindings ? info->bindings[i] : i,
                                                 .descriptorType = VK_DESCRIPTOR_TYPE_TENSOR_ARM,
                                                 .descriptorCount = 1,
                                                 .stageFlags = VK_SHADER_STAGE_ALL};
  const VkDescriptorSetLayoutCreateInfo set = {
      .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
      .pNext = is_late ? &late : NULL,
      .flags = info->set_flags,
      .bindingCount = tensors,
      .pBindings = bindings};
  MUST(vkCreateDescriptorSetLayout(client->device, &set, NULL, &graph->set_layout));
  free(bindings);
  free(flags);
  const VkPipelineLayoutCreateInfo layout = {.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
                                             .setLayoutCount = 1,
                                             .pSetLayouts = &graph->set_layout};
  MUST(vkCreatePipelineLayout(client->device, &layout, NULL, &graph->layout));
  if (info->set_flags & (VK_DESCRIPTOR_SET_LAYOUT_CREATE_PUSH_DESCRIPTOR_BIT_KHR |
                         VK_DESCRIPTOR_SET_LAYOUT_CREATE_DESCRIPTOR_BUFFER_BIT_EXT))
    return;
  const VkDescriptorPoolSize size = {VK_DESCRIPTOR_TYPE_TENSOR_ARM, tensors};
  const VkDescriptorPoolCreateInfo pool = {
      .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO,
      .flags = is_late ? VK_DESCRIPTOR_POOL_CREATE_UPDATE_AFTER_BIND_BIT : 0,
      .maxSets = 1,
      .poolSizeCount = 1,
      .pPoolSizes = &size};
  MUST(vkCreateDescriptorPool(client->device, &pool, NULL, &graph->pool));
  const VkDescriptorSetAllocateInfo allocate_set = {
      .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO,
      .descriptorPool = graph->pool,
      .descriptorSetCount = 1,
      .pSetLayouts = &graph->set_layout};
  MUST(vkAllocateDescriptorSets(client->device, &allocate_set, &graph->set));
}

static VkResult create_pipeline(const Client* client, const ClientGraphInfo* info,
                                ClientGraph* graph) {
  VkDataGraphPipelineResourceInfoARM* resources = calloc(info->tensor_count + 1, sizeof *resources);
  for (uint32_t i = 0; i < info->tensor_count; ++i)
    resources[i] = (VkDataGraphPipelineResourceInfoARM){
        .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_RESOURCE_INFO_ARM,
        .pNext = info->descriptions[i],
        .descriptorSet = 0,
        .binding = info->bindings ? info->bindings[i] : i};
  VkDataGraphPipelineConstantARM* constants = calloc(info->constant_count + 1, sizeof *constants);
  for (uint32_t i = 0; i < info->constant_count; ++i)
    constants[i] = (VkDataGraphPipelineConstantARM){
        .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CONSTANT_ARM,
        .pNext = info->constants[i].description,
        .id = info->constants[i].id,
        .pConstantData = info->constants[i].data};
  const VkShaderModuleCreateInfo code = {.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
                                         .pNext = info->next,
                                         .codeSize = 4 * info->word_count,
                                         .pCode = info->words};
  const VkDataGraphPipelineShaderModuleCreateInfoARM module = {
      .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SHADER_MODULE_CREATE_INFO_ARM,
      .pNext = info->chained ? &code : info->next,
      .module = graph->module,
      .pName = info->entry_point,
      .pSpecializationInfo = info->specialization,
      .constantCount = info->constant_count,
      .pConstants = constants};
  const VkDataGraphPipelineCreateInfoARM pipeline = {
      .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM,
      .pNext = &module,
      .flags = info->flags,
      .layout = graph->layout,
      .resourceInfoCount = info->tensor_count,
      .pResourceInfos = resources};
  const VkResult result = client->CreateDataGraphPipelinesARM(
      client->device, VK_NULL_HANDLE, info->cache, 1, &pipeline, NULL, &graph->pipeline);
  free(resources);
  free(constants);
  return result;
}

VkResult client_create_session(const Client* client, VkPipeline pipeline,
                               VkDataGraphPipelineSessionARM* session, VkDeviceMemory* memory,
                               VkDeviceSize* bytes) {
  const VkDataGraphPipelineSessionCreateInfoARM info = {
      .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_CREATE_INFO_ARM,
      .dataGraphPipeline = pipeline};
  const VkResult result =
      client->CreateDataGraphPipelineSessionARM(client->device, &info, NULL, session);
  if (result != VK_SUCCESS) return result;
  const VkDataGraphPipelineSessionBindPointRequirementsInfoARM which = {
      .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_REQUIREMENTS_INFO_ARM,
      .session = *session};
  uint32_t count = 0;
  MUST(client->GetDataGraphPipelineSessionBindPointRequirementsARM(client->device, &which, &count,
                                                                   NULL));
  *memory = VK_NULL_HANDLE;
  *bytes = 0;
  if (count == 0) return VK_SUCCESS;
  VkDataGraphPipelineSessionBindPointRequirementARM point = {
      .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_REQUIREMENT_ARM};
  count = 1;
  MUST(client->GetDataGraphPipelineSessionBindPointRequirementsARM(client->device, &which, &count,
                                                                   &point));
  const VkDataGraphPipelineSessionMemoryRequirementsInfoARM object = {
      .sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_MEMORY_REQUIREMENTS_INFO_ARM,
      .session = *session,
      .bindPoint = point.bindPoint};
  VkMemoryRequirements2 needs = {.sType = VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2};
  client->GetDataGraphPipelineSessionMemoryRequirementsARM(client->device, &object, &needs);
  *bytes = needs.memoryRequirements.size;
  *memory = allocate(client, &needs.memoryRequirements, 0);
  const VkBindDataGraphPipelineSessionMemoryInfoARM bind = {
      .sType = VK_STRUCTURE_TYPE_BIND_DATA_GRAPH_PIPELINE_SESSION_MEMORY_INFO_ARM,
      .session = *session,
      .bindPoint = point.bindPoint,
      .memory = *memory};
  return client->BindDataGraphPipelineSessionMemoryARM(client->device, 1, &bind);
}

VkResult client_create_graph(const Client* client, const ClientGraphInfo* info,
                             ClientGraph* graph) {
  memset(graph, 0, sizeof *graph);
  const VkShaderModuleCreateInfo module = {.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
                                           .codeSize = 4 * info->word_count,
                                           .pCode = info->words};
  VkResult result = info->chained
                        ? VK_SUCCESS
                        : vkCreateShaderModule(client->device, &module, NULL, &graph->module);
  if (result == VK_SUCCESS) {
    create_layouts(client, info, graph);
    result = create_pipeline(client, info, graph);
  }
  if (result == VK_SUCCESS)
    result = client_create_session(client, graph->pipeline, &graph->session, &graph->session_memory,
                                   &graph->session_bytes);
  if (result != VK_SUCCESS) client_destroy_graph(client, graph);
  return result;
}

void client_destroy_graph(const Client* client, ClientGraph* graph) {
  if (graph->session)
    client->DestroyDataGraphPipelineSessionARM(client->device, graph->session, NULL);
  vkFreeMemory(client->device, graph->session_memory, NULL);
  vkDestroyPipeline(client->device, graph->pipeline, NULL);
  vkDestroyDescriptorPool(client->device, graph->pool, NULL);
  vkDestroyPipelineLayout(client->device, graph->layout, NULL);
  vkDestroyDescriptorSetLayout(client->device, graph->set_layout, NULL);
  vkDestroyShaderModule(client->device, graph->module, NULL);
  memset(graph, 0, sizeof *graph);
}

void client_write_set(const Client* client, const ClientGraph* graph, uint32_t count,
                      const VkTensorViewARM* views) {
  client_write_bindings(client, graph, count, NULL, views);
}

void client_write_bindings(const Client* client, const ClientGraph* graph, uint32_t count,
                           const uint32_t* bindings, const VkTensorViewARM* views) {
  for (uint32_t i = 0; i < count; ++i) {
    const VkWriteDescriptorSetTensorARM tensor = {
        .sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM,
        .tensorViewCount = 1,
        .pTensorViews = &views[i]};
    const VkWriteDescriptorSet write = {.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
                                        .pNext = &tensor,
                                        .dstSet = graph->set,
                                        .dstBinding = bindings ? bindings[i] : i,
                                        .descriptorCount = 1,
                                        .descriptorType = VK_DESCRIPTOR_TYPE_TENSOR_ARM};
    vkUpdateDescriptorSets(client->device, 1, &write, 0, NULL);
  }
}

void client_record_graph(const Client* client, VkCommandBuffer commands, const ClientGraph* graph) {
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, graph->pipeline);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, graph->layout, 0, 1,
                          &graph->set, 0, NULL);
  client->CmdDispatchDataGraphARM(commands, graph->session, NULL);
}

void client_full_barrier(VkCommandBuffer commands) {
  const VkMemoryBarrier barrier = {
      .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER,
      .srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT | VK_ACCESS_HOST_WRITE_BIT,
      .dstAccessMask =
          VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT | VK_ACCESS_HOST_READ_BIT};
  vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT | VK_PIPELINE_STAGE_HOST_BIT,
                       VK_PIPELINE_STAGE_ALL_COMMANDS_BIT | VK_PIPELINE_STAGE_HOST_BIT, 0, 1,
                       &barrier, 0, NULL, 0, NULL);
}

VkResult client_submit(const Client* client, ClientRecord record, void* user) {
  const VkCommandPoolCreateInfo pool_info = {.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
                                             .queueFamilyIndex = client->family};
  VkCommandPool pool;
  MUST(vkCreateCommandPool(client->device, &pool_info, NULL, &pool));
  const VkCommandBufferAllocateInfo allocate_info = {
      .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
      .commandPool = pool,
      .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
      .commandBufferCount = 1};
  VkCommandBuffer commands;
  MUST(vkAllocateCommandBuffers(client->device, &allocate_info, &commands));
  const VkCommandBufferBeginInfo begin = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  MUST(vkBeginCommandBuffer(commands, &begin));
  record(commands, user);
  client_full_barrier(commands);
  const VkResult ended = vkEndCommandBuffer(commands);
  if (ended == VK_SUCCESS) {
    const VkSubmitInfo submit = {.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO,
                                 .commandBufferCount = 1,
                                 .pCommandBuffers = &commands};
    MUST(vkQueueSubmit(client->queue, 1, &submit, VK_NULL_HANDLE));
    MUST(vkQueueWaitIdle(client->queue));
  }
  vkDestroyCommandPool(client->device, pool, NULL);
  return ended;
}
