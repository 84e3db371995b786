// runtime/datagraph/session.h -- an execution context of a pipeline: memory, tensors, recording.
#pragma once

#include <vulkan/vulkan.h>

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "runtime/datagraph/pipeline.h"
#include "runtime/vk/timestamps.h"

namespace shale {

/// Usage of the runtime's own tensor buffers: what shaders need of any, and transfers.
inline constexpr VkBufferUsageFlags kTensorBufferUsage =
    VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT |
    VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT |
    VK_BUFFER_USAGE_TRANSFER_DST_BIT;

/// A tensor inside somebody's buffer. The buffer's usage must have
/// VK_BUFFER_USAGE_STORAGE_BUFFER_BIT and VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT.
struct TensorView {
  VkBuffer buffer = VK_NULL_HANDLE;
  uint64_t offset = 0;      ///< bytes; a multiple of Session::tensor_alignment()
  uint64_t size_bytes = 0;  ///< available from `offset` on; at least bound_bytes of the tensor
};

/// Memory that a session asks of its user.
struct BindPoint {
  std::string name;               ///< "arena": the intermediate tensors
  VkMemoryRequirements memory{};  ///< size and alignment in bytes, allowed memory types
};

/// Use: create; bind_memory or allocate_memory; bind_tensor for every input and output; record. The
/// pipeline must outlive it, and so must the bound memory and buffers outlive the work that uses
/// them.
///
/// External synchronisation, as with the extension. One thread at a time. Inside of what record
/// adds, barriers are complete; around it they are the user's:
///  - before: inputs must be visible to VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT /
///    VK_ACCESS_SHADER_READ_BIT, and earlier uses of the outputs must have ended before that stage;
///  - after: outputs are written by VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT /
///    VK_ACCESS_SHADER_WRITE_BIT;
///  - between two recordings of one session: a memory barrier from that stage and
///    VK_ACCESS_SHADER_WRITE_BIT to it and VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT,
///    since they share the arena.
/// A graph that works by tiles runs what its changed inputs reach, so the arena's memory and the outputs have to stay as a
/// record left them until the next one, or run_all() has to be called. Its recordings begin with a barrier that serves
/// between two of them, too.
/// Different sessions need nothing between each other, unless they share memory or tensors. But the
/// first record of all sessions of a pipeline also uploads the weights, where the host cannot write
/// the device's memory: it must be submitted, and before anything that is recorded later.
class Session {
 public:
  /// Errors: kDevice.
  static Result<Session> create(const DataGraphPipeline& pipeline);
  Session(Session&&) noexcept;
  Session& operator=(Session&&) noexcept;
  ~Session();

  /// What must be bound before recording; empty if the graph has no intermediate tensor. The
  /// content means nothing between records, so sessions that never overlap in time may share the
  /// memory; but not of a graph that works by tiles.
  std::vector<BindPoint> memory_requirements() const;

  /// Gives the arena its memory, once. `memory` stays the caller's.
  /// Errors: kBadInput if nothing is asked for, if it is bound already, or if the offset is
  /// unaligned; kDevice. The size and type of `memory` are the caller's care: Vulkan cannot be
  /// asked for them.
  Result<void> bind_memory(VkDeviceMemory memory, uint64_t offset);

  /// Allocates and binds what is asked for; does nothing if there is nothing to bind.
  /// Errors: as bind_memory.
  Result<void> allocate_memory();

  /// Multiples of this, bytes, are allowed as offsets of tensors.
  uint64_t tensor_alignment() const;

  /// Names the buffer of an input or output. Binding again is allowed, but ends the use of what was
  /// recorded before: those command buffers must not be pending and never be submitted again.
  /// Ranges of different outputs, or of an input and an output, must not overlap.
  /// Errors: kBadInput if no input or output has that name, the range is too small or unaligned.
  Result<void> bind_tensor(std::string_view name, const TensorView& tensor);

  /// Points what is recorded, and what will be, at the tensors that are bound now; none of it may be pending. Only for
  /// pipelines with DataGraphPipelineOptions::update_after_bind, whose records take tensors that are not there yet.
  /// Errors: kBadInput, naming what is not bound yet; kDevice.
  Result<void> update();

  /// Adds the graph to a command buffer that is being recorded, outside of a render pass. Changes
  /// its bound compute pipeline and set 0. `timestamps` gains an interval for each dispatch of
  /// DataGraphPipeline::graph(); it may be null.
  /// Errors: kBadInput, naming what is not bound yet, or if there are timestamps of too few
  /// intervals; kDevice.
  Result<void> record(VkCommandBuffer commands, vk::Timestamps* timestamps = nullptr);

  /// The next record of a graph that works by tiles runs all of it, as the first one does and that behind a bind_tensor.
  void run_all();

  /// Tiles::work of a graph that works by tiles, where its indirect_grids lie. The buffer allows transfers.
  /// Errors: kBadInput if it does not, or has no memory yet.
  Result<TensorView> commands() const;

 private:
  struct State;
  explicit Session(std::unique_ptr<State> state);

  std::unique_ptr<State> state_;
};

}  // namespace shale
