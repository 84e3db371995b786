/* tests/layer/client.h -- a program that uses VK_ARM_tensors and VK_ARM_data_graph, in plain C.
 *
 * It knows Vulkan and nothing of Shale: whether a driver or a layer gives the extensions, it cannot
 * tell. Functions give VkResult, and 0 where there is none; what cannot fail in a working program
 * prints and exits.
 */
#ifndef SHALE_TESTS_LAYER_CLIENT_H
#define SHALE_TESTS_LAYER_CLIENT_H

#include "tools/layer/arm_vulkan.h"

#ifdef __cplusplus
extern "C" {
#endif

#define CLIENT_FUNCTIONS(X)                              \
  X(CreateTensorARM)                                     \
  X(DestroyTensorARM)                                    \
  X(CreateTensorViewARM)                                 \
  X(DestroyTensorViewARM)                                \
  X(GetTensorMemoryRequirementsARM)                      \
  X(GetDeviceTensorMemoryRequirementsARM)                \
  X(BindTensorMemoryARM)                                 \
  X(CmdCopyTensorARM)                                    \
  X(CreateDataGraphPipelinesARM)                         \
  X(CreateDataGraphPipelineSessionARM)                   \
  X(DestroyDataGraphPipelineSessionARM)                  \
  X(GetDataGraphPipelineSessionBindPointRequirementsARM) \
  X(GetDataGraphPipelineSessionMemoryRequirementsARM)    \
  X(BindDataGraphPipelineSessionMemoryARM)               \
  X(CmdDispatchDataGraphARM)                             \
  X(GetDataGraphPipelineAvailablePropertiesARM)          \
  X(GetDataGraphPipelinePropertiesARM)

enum { CLIENT_MESSAGE_BYTES = 2048, CLIENT_MAX_RANK = 6 };

typedef struct Client {
  VkInstance instance;
  VkPhysicalDevice physical;
  VkDevice device;
  uint32_t family;
  VkQueue queue;
  VkPhysicalDeviceMemoryProperties memory;
  VkDebugUtilsMessengerEXT messenger;
  /* What debug utils said: by the validation layer, which is a failure, and by others. */
  uint32_t validation_messages, other_messages;
  char last_message[CLIENT_MESSAGE_BYTES];
  /* For all tensors that are created from now on. */
  VkTensorUsageFlagsARM more_usage;
  VkDeviceSize more_bytes; /* of their memory */
#define CLIENT_MEMBER(name) PFN_vk##name name;
  CLIENT_FUNCTIONS(CLIENT_MEMBER)
#undef CLIENT_MEMBER
} Client;

/* Opens the first device whose queue family runs data graphs. VK_ERROR_EXTENSION_NOT_PRESENT if there
 * is none. `next` is chained behind the features of the extensions and may be null; those of VK_EXT_descriptor_buffer,
 * VK_EXT_robustness2 and VK_ARM_data_graph_optical_flow in it have their extension enabled. */
VkResult client_open(Client* client, void* next);
void client_close(Client* client);

uint32_t client_memory_type(const Client* client, uint32_t type_bits, VkMemoryPropertyFlags flags);

/* A tensor with memory of its own, mapped. */
typedef struct ClientTensor {
  VkTensorARM tensor;
  VkTensorViewARM view;
  VkDeviceMemory memory;
  void* mapped;
  VkDeviceSize size; /* of the memory */
  /* The description, with its own arrays. */
  VkTensorDescriptionARM description;
  int64_t dims[CLIENT_MAX_RANK], strides[CLIENT_MAX_RANK];
} ClientTensor;

/* `strides` may be null. The description's tiling is linear with strides, else `tiling`. */
VkResult client_create_tensor(const Client* client, VkFormat format, VkTensorTilingARM tiling,
                              uint32_t rank, const int64_t* dims, const int64_t* strides,
                              ClientTensor* tensor);
void client_destroy_tensor(const Client* client, ClientTensor* tensor);

typedef struct ClientConstant {
  uint32_t id;
  const VkTensorDescriptionARM* description;
  const void* data;
} ClientConstant;

/* A pipeline whose tensors are bindings of set 0, with one session and its memory, and one descriptor
 * set. */
typedef struct ClientGraph {
  VkShaderModule module;
  VkDescriptorSetLayout set_layout;
  VkPipelineLayout layout;
  VkDescriptorPool pool;
  VkDescriptorSet set;
  VkPipeline pipeline;
  VkDataGraphPipelineSessionARM session;
  VkDeviceMemory session_memory;
  VkDeviceSize session_bytes;
} ClientGraph;

typedef struct ClientGraphInfo {
  const uint32_t* words;
  size_t word_count;
  const char* entry_point;
  VkBool32 chained; /* the words come with the pipeline, not as a module */
  uint32_t tensor_count;
  const uint32_t* bindings;                          /* of tensors; null: 0, 1, .. */
  const VkTensorDescriptionARM* const* descriptions; /* of tensors */
  uint32_t constant_count;
  const ClientConstant* constants;
  const VkSpecializationInfo* specialization;
  VkPipelineCreateFlags2 flags;
  VkPipelineCache cache;
  /* With those of pushed descriptors or of descriptor buffers there is no set; with VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT
   * the set may be written when it is bound. */
  VkDescriptorSetLayoutCreateFlags set_flags;
  void* next; /* chained to the pipeline's create info */
} ClientGraphInfo;

/* On failure nothing is left. */
VkResult client_create_graph(const Client* client, const ClientGraphInfo* info, ClientGraph* graph);
void client_destroy_graph(const Client* client, ClientGraph* graph);
VkResult client_create_session(const Client* client, VkPipeline pipeline,
                               VkDataGraphPipelineSessionARM* session, VkDeviceMemory* memory,
                               VkDeviceSize* bytes);

/* Writes the views to the bindings of the graph's set; null: 0, 1, .. */
void client_write_bindings(const Client* client, const ClientGraph* graph, uint32_t count,
                           const uint32_t* bindings, const VkTensorViewARM* views);
void client_write_set(const Client* client, const ClientGraph* graph, uint32_t count,
                      const VkTensorViewARM* views);
void client_record_graph(const Client* client, VkCommandBuffer commands, const ClientGraph* graph);

typedef void (*ClientRecord)(VkCommandBuffer commands, void* user);
/* Records, submits and waits. What ending the recording answers, if that is no success. */
VkResult client_submit(const Client* client, ClientRecord record, void* user);

/* A barrier from the host and all commands to all commands and the host. */
void client_full_barrier(VkCommandBuffer commands);

#ifdef __cplusplus
}
#endif

#endif
