// tools/layer/graph.h -- pipelines and sessions of VK_ARM_data_graph, over the compiler and the
// runtime.
#pragma once

#include <array>
#include <span>

#include "ir/package/package.h"
#include "runtime/datagraph/pipeline.h"
#include "runtime/datagraph/session.h"
#include "tools/layer/commands.h"
#include "tools/layer/optical_flow.h"
#include "tools/layer/strided_copy.h"
#include "tools/layer/tensor.h"

namespace shale::layer {

/// Names a pipeline's package in caches.
using Identifier = std::array<uint8_t, 16>;

/// A shader module with graphs, which never reaches the device.
struct GraphModule {
  std::vector<uint32_t> words;
};

/// What the layer keeps beside a pipeline cache of the device.
struct GraphCache {
  std::mutex mutex;
  std::map<Identifier, std::shared_ptr<const std::vector<uint8_t>>> packages;  ///< `.shale` files
};

/// An input or output of a graph: where its descriptor is, and what the application said of it.
struct GraphTensor {
  uint32_t set = 0, binding = 0, element = 0;
  std::string resource;  ///< in the package
  TensorLayout layout;
  bool is_input = false;
};

struct GraphPipeline {
  std::optional<DataGraphPipeline> pipeline;  ///< empty with `flow`
  std::vector<GraphTensor> tensors;
  Identifier identifier{};
  std::string log;
  /// As `tensors`, of those that are not packed, where their sets may be updated after they are bound.
  std::vector<std::optional<StridedCopy>> copies;
  /// There if the sets lie in descriptor buffers: then a session copies all tensors.
  std::shared_ptr<const PipelineLayout> in_buffers;

  std::unique_ptr<OpticalFlow> flow;  ///< in place of a graph

  /// True if a session has packed elements of its own for the tensor.
  bool stages(const GraphTensor& tensor) const { return in_buffers || !tensor.layout.packed; }
};

struct GraphSession {
  GraphSession(Device& own_device, std::shared_ptr<const GraphPipeline> own_pipeline)
      : device(own_device), owned(std::move(own_pipeline)), pipeline(*owned) {}

  /// The graph recorded for certain tensors; what is recorded stays as it is, so that every recording
  /// may be submitted as often as the application likes.
  struct Recording {
    std::vector<uint64_t> tensors;  ///< ids, in the order of GraphPipeline::tensors
    Session session;
  };
  /// A packed copy of a tensor, in the session's memory.
  struct Staging {
    vk::BufferHandle buffer;  ///< empty where the tensor itself is used
    uint64_t offset = 0;
    std::optional<StridedCopy> copy;  ///< of tensors that lie in descriptor buffers
  };

  Device& device;
  std::shared_ptr<const GraphPipeline> owned;  ///< the application may destroy it first
  const GraphPipeline& pipeline;
  VkMemoryRequirements requirements{};
  VkDeviceMemory memory = VK_NULL_HANDLE;
  uint64_t memory_offset = 0;
  vk::BufferHandle least_memory;  ///< asks for memory where nothing else does
  std::vector<Staging> staging;   ///< as GraphPipeline::tensors
  vk::BufferHandle flow_memory;   ///< with GraphPipeline::flow
  std::optional<OpticalFlow::Bound> flow_bound;
  std::mutex mutex;  ///< of what follows
  std::vector<Recording> recordings;
  std::optional<Session> spare;  ///< told the requirements; becomes the first recording
};

/// A dispatch whose descriptors may be written until it is submitted.
struct LateDispatch {
  std::shared_ptr<const GraphPipeline> pipeline;  ///< outlives the recording
  Device& device;
  GraphSession& session;
  std::vector<std::shared_ptr<Set>> sets;  ///< as GraphPipeline::tensors
  GraphSession::Recording recording;       ///< its tensors are those of the last submission
  std::vector<std::optional<StridedCopy::Recorded>> copies;  ///< as GraphPipeline::tensors

  /// Points the recording at what the sets hold now.
  /// Errors: kBadInput, naming the descriptor; kDevice.
  Result<void> bind();
};

/// Drops the recordings that use the tensor: it is about to be destroyed.
void forget_tensor(Device& device, uint64_t id);

/// True for modules with the capability of graphs.
bool has_graphs(std::span<const uint32_t> words);

}  // namespace shale::layer
