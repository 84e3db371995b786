// tools/layer/commands.h -- what the layer keeps of a command buffer that is being recorded.
#pragma once

#include <functional>

#include "tools/layer/descriptors.h"

namespace shale::layer {

struct LateDispatch;
using LateDispatches = std::vector<std::shared_ptr<LateDispatch>>;

/// Commands of the application that change what compute shaders see, to be recorded again after the
/// layer's own.
struct CommandState {
  struct Bound {
    uint32_t first = 0, count = 0;  ///< sets
    std::function<void(VkCommandBuffer)> again;
    std::shared_ptr<void> pushed = nullptr;  ///< descriptors, if they were pushed
  };
  VkPipeline compute = VK_NULL_HANDLE;
  std::function<void(VkCommandBuffer)> descriptor_buffers;
  std::vector<Bound> compute_sets;  ///< in the order in which they were bound
  std::shared_ptr<GraphPipeline> graph;
  std::map<uint32_t, std::shared_ptr<Set>> graph_sets;
  std::map<uint32_t, std::shared_ptr<Set>> pushed_graph_sets;  ///< those made by pushes
  std::map<uint32_t, VkDescriptorSet> graph_handles;  ///< of graph_sets and of sets without tensors
  /// A set of a graph that lies in one of `descriptor_buffers`.
  struct InBuffer {
    uint32_t buffer = 0;
    VkDeviceSize offset = 0;
  };
  std::map<uint32_t, InBuffer> graph_buffer_sets;
  LateDispatches late;           ///< recorded here, or in secondary buffers that are executed
  VkResult failed = VK_SUCCESS;  ///< what ending the recording answers

  void bind_sets(uint32_t first, uint32_t count, std::function<void(VkCommandBuffer)> again);
  /// Records what is bound to compute once more.
  void restore(const Device& device, VkCommandBuffer commands) const;
};

/// The state of a command buffer; made where the layer meets it first.
CommandState& state_of(Device& device, VkCommandBuffer commands);

/// Runs a command's work; an error is reported, and vkEndCommandBuffer will fail.
void record_guarded(VkCommandBuffer commands,
                    const std::function<Result<void>(Device&)>& work) noexcept;

}  // namespace shale::layer
