// Sessions of graph pipelines, and their dispatch.
#include <algorithm>

#include "runtime/vk/commands.h"
#include "tools/layer/chain.h"
#include "tools/layer/graph.h"

namespace shale::layer {
namespace {

/// Null for a handle that is none of the device's sessions.
GraphSession* session_of(Device& device, VkDataGraphPipelineSessionARM handle) {
  auto* session = reinterpret_cast<GraphSession*>(handle);
  const std::lock_guard lock(device.mutex);
  return device.sessions.contains(session) ? session : nullptr;
}

/// Adds a buffer of `bytes` to what the session asks for; gives its place in the session's memory.
Result<uint64_t> add_buffer(GraphSession& session, uint64_t bytes, vk::BufferHandle& buffer) {
  const vk::Context& context = *session.device.context;
  auto info = vk::init<VkBufferCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO);
  info.size = (bytes + 3) / 4 * 4;
  info.usage = tensor_usage(session.device);
  SHALE_TRY(buffer, vk::make(context.vk.CreateBuffer, context.vk.DestroyBuffer, "vkCreateBuffer",
                             context.device, info));
  VkMemoryRequirements needs;
  context.vk.GetBufferMemoryRequirements(context.device, buffer.get(), &needs);
  VkMemoryRequirements& all = session.requirements;
  const uint64_t offset = (all.size + needs.alignment - 1) / needs.alignment * needs.alignment;
  all.size = offset + needs.size;
  all.alignment = std::max(all.alignment, needs.alignment);
  all.memoryTypeBits &= needs.memoryTypeBits;
  return offset;
}

/// The copies of a session whose tensors lie in descriptor buffers, when its memory has an address.
Result<void> make_copies(GraphSession& session) {
  const GraphPipeline& pipeline = session.pipeline;
  for (size_t i = 0; i < pipeline.tensors.size(); ++i) {
    const GraphTensor& tensor = pipeline.tensors[i];
    GraphSession::Staging& staging = session.staging[i];
    VkBufferDeviceAddressInfo which{};
    which.sType = VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO;
    which.buffer = staging.buffer.get();
    const StridedCopy::InBuffer place{
        pipeline.in_buffers->own.get(), tensor.set, tensor.binding, tensor.element,
        session.device.GetBufferDeviceAddress(session.device.handle, &which)};
    SHALE_TRY(staging.copy,
              StridedCopy::create(*session.device.context, tensor.layout, !tensor.is_input, place));
  }
  return {};
}

/// The arena lies at the session's offset 0, packed copies of tensors behind it.
Result<void> find_requirements(GraphSession& session) {
  session.requirements = {0, 1, ~0u};
  if (const OpticalFlow* flow = session.pipeline.flow.get()) {
    SHALE_TRY_VOID(add_buffer(session, flow->memory_bytes(), session.flow_memory));
    return {};
  }
  SHALE_TRY(session.spare, Session::create(*session.pipeline.pipeline));
  for (const BindPoint& point : session.spare->memory_requirements())
    session.requirements = point.memory;
  for (const GraphTensor& tensor : session.pipeline.tensors) {
    GraphSession::Staging& staging = session.staging.emplace_back();
    if (!session.pipeline.stages(tensor)) continue;
    SHALE_TRY(
        staging.offset,
        add_buffer(session, tensor.layout.elements() * tensor_element_bytes(tensor.layout.format),
                   staging.buffer));
  }
  // A session always has its transient memory: applications count on it.
  if (session.requirements.size == 0)
    SHALE_TRY_VOID(add_buffer(session, kBufferAlignment, session.least_memory));
  return {};
}

Result<void> bind_memory(GraphSession& session, VkDeviceMemory memory, uint64_t offset) {
  const vk::Context& context = *session.device.context;
  if (session.memory != VK_NULL_HANDLE) return bad_input("session", "has its memory already");
  if (offset % session.requirements.alignment != 0)
    return bad_input("session", "memory offset {} is no multiple of {}", offset,
                     session.requirements.alignment);
  const auto bind = [&](VkBuffer buffer, uint64_t at) {
    return vk::check(context.vk.BindBufferMemory(context.device, buffer, memory, offset + at),
                     "vkBindBufferMemory");
  };
  if (session.pipeline.flow) {
    SHALE_TRY_VOID(bind(session.flow_memory.get(), 0));
    SHALE_TRY(session.flow_bound, OpticalFlow::Bound::create(session.device, *session.pipeline.flow,
                                                             session.flow_memory.get()));
  } else if (!session.spare->memory_requirements().empty())
    SHALE_TRY_VOID(session.spare->bind_memory(memory, offset));
  for (const GraphSession::Staging& staging : session.staging)
    if (staging.buffer) SHALE_TRY_VOID(bind(staging.buffer.get(), staging.offset));
  if (session.least_memory) SHALE_TRY_VOID(bind(session.least_memory.get(), 0));
  if (session.pipeline.in_buffers) SHALE_TRY_VOID(make_copies(session));
  session.memory = memory;
  session.memory_offset = offset;
  return {};
}

std::string descriptor_name(const GraphTensor& wanted) {
  return fmt::format("set {}, binding {}, element {}", wanted.set, wanted.binding, wanted.element);
}

/// The descriptor set that the command buffer has for an input or output.
Result<std::shared_ptr<Set>> bound_set(const CommandState& state, const GraphTensor& wanted) {
  const auto set = state.graph_sets.find(wanted.set);
  if (set == state.graph_sets.end() || !set->second)
    return bad_input(descriptor_name(wanted), "no descriptor set with tensors is bound");
  return set->second;
}

/// The tensor that a descriptor of the set holds for an input or output.
Result<const Tensor*> bound_tensor(const Device& device, const Set& set,
                                   const GraphTensor& wanted) {
  const std::string where = descriptor_name(wanted);
  const auto binding = set.tensors.find(wanted.binding);
  const uint64_t id = binding == set.tensors.end() || wanted.element >= binding->second.size()
                          ? 0
                          : binding->second[wanted.element];
  const Tensor* tensor = device.tensors_by_id.find(id);
  if (!tensor) return bad_input(where, "the descriptor holds no tensor");
  const TensorLayout& layout = tensor->layout;
  if (layout.dims != wanted.layout.dims || layout.strides != wanted.layout.strides ||
      tensor_element_bytes(layout.format) != tensor_element_bytes(wanted.layout.format))
    return bad_input(where, "the tensor's sizes, strides or format are not those of the pipeline");
  if (!(layout.usage & VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM))
    return bad_input(where, "the tensor's usage has no data graph");
  if (!tensor->bound) return bad_input(where, "the tensor has no memory");
  return tensor;
}

std::vector<uint64_t> ids_of(std::span<const Tensor* const> tensors) {
  std::vector<uint64_t> ids;
  for (const Tensor* tensor : tensors) ids.push_back(tensor->id);
  return ids;
}

/// A session of the runtime's in the memory of the layer's.
Result<Session> make_session(GraphSession& session) {
  std::optional<Session> made = std::exchange(session.spare, std::nullopt);
  if (made) return *std::move(made);
  SHALE_TRY(made, Session::create(*session.pipeline.pipeline));
  if (!made->memory_requirements().empty() && session.memory)
    SHALE_TRY_VOID(made->bind_memory(session.memory, session.memory_offset));
  return *std::move(made);
}

/// Without `tensors` all of them are staged.
Result<void> bind_tensors(const GraphSession& session, Session& recording,
                          std::span<const Tensor* const> tensors) {
  for (size_t i = 0; i < session.pipeline.tensors.size(); ++i) {
    const GraphTensor& wanted = session.pipeline.tensors[i];
    const GraphSession::Staging& staging = session.staging[i];
    const VkBuffer buffer = staging.buffer ? staging.buffer.get() : tensors[i]->buffer;
    const uint64_t bytes = wanted.layout.elements() * tensor_element_bytes(wanted.layout.format);
    SHALE_TRY_VOID(recording.bind_tensor(wanted.resource, {buffer, 0, (bytes + 3) / 4 * 4}));
  }
  return {};
}

/// The session's recording for these tensors, made where there is none.
Result<Session*> recording_for(GraphSession& session, std::span<const Tensor* const> tensors) {
  std::vector<uint64_t> ids = ids_of(tensors);
  for (GraphSession::Recording& each : session.recordings)
    if (each.tensors == ids) return &each.session;
  SHALE_TRY(Session made, make_session(session));
  SHALE_TRY_VOID(bind_tensors(session, made, tensors));
  session.recordings.push_back({std::move(ids), std::move(made)});
  return &session.recordings.back().session;
}

TensorLayout packed_layout(TensorLayout layout) {
  int64_t next = tensor_element_bytes(layout.format);
  for (size_t i = layout.dims.size(); i-- > 0; next *= layout.dims[i]) layout.strides[i] = next;
  return layout;
}

/// Copies of all tensors that are not packed, into the session's memory or back.
void record_staging(const GraphSession& session, VkCommandBuffer commands,
                    std::span<const Tensor* const> tensors, bool inputs) {
  for (size_t i = 0; i < tensors.size(); ++i) {
    const GraphTensor& wanted = session.pipeline.tensors[i];
    const VkBuffer staging = session.staging[i].buffer.get();
    if (!staging || wanted.is_input != inputs) continue;
    const TensorLayout& layout = tensors[i]->layout;
    if (inputs)
      record_copy(session.device, commands, tensors[i]->buffer, layout, staging,
                  packed_layout(layout));
    else
      record_copy(session.device, commands, staging, packed_layout(layout), tensors[i]->buffer,
                  layout);
  }
}

/// The same for tensors that are not known yet.
Result<void> record_copies(LateDispatch& dispatch, VkCommandBuffer commands, bool inputs) {
  const GraphPipeline& pipeline = dispatch.session.pipeline;
  for (size_t i = 0; i < pipeline.tensors.size(); ++i)
    if (pipeline.copies[i] && pipeline.tensors[i].is_input == inputs) {
      SHALE_TRY(dispatch.copies[i],
                pipeline.copies[i]->record(*dispatch.session.device.context, commands));
    }
  return {};
}

/// The same for tensors whose descriptors lie in buffers, where those are bound as `state` says.
void record_bound_copies(const GraphSession& session, VkCommandBuffer commands,
                         const CommandState& state, bool inputs) {
  const Device& device = session.device;
  const GraphPipeline& pipeline = session.pipeline;
  state.descriptor_buffers(commands);  // kernels between have bound sets
  for (const auto& [set, where] : state.graph_buffer_sets)
    if (set < pipeline.in_buffers->sets.size())
      device.CmdSetDescriptorBufferOffsetsEXT(commands, VK_PIPELINE_BIND_POINT_COMPUTE,
                                              pipeline.in_buffers->own.get(), set, 1, &where.buffer,
                                              &where.offset);
  for (size_t i = 0; i < pipeline.tensors.size(); ++i)
    if (pipeline.tensors[i].is_input == inputs)
      session.staging[i].copy->record_bound(*device.context, commands);
}

/// Earlier dispatches of a session may still use its memory: the application's barriers may name
/// tensors and images alone.
void session_barrier(const Device& device, VkCommandBuffer commands) {
  constexpr VkPipelineStageFlags kStages =
      VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
  constexpr VkAccessFlags kWrites = VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
  vk::memory_barrier(*device.context, commands, kStages, kWrites, kStages,
                     kWrites | VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_TRANSFER_READ_BIT);
}

Result<void> dispatch_flow(Device& device, VkCommandBuffer commands, CommandState& state,
                           GraphSession& session) {
  const OpticalFlow& flow = *session.pipeline.flow;
  for (const uint32_t set : flow.sets())
    if (const auto bound = state.graph_handles.find(set);
        bound == state.graph_handles.end() || !bound->second)
      return bad_input("vkCmdDispatchDataGraphARM", "no descriptor set {} is bound", set);
  session_barrier(device, commands);
  flow.record(device, commands, *session.flow_bound, state.graph_handles);
  state.restore(device, commands);
  return {};
}

Result<void> dispatch(Device& device, VkCommandBuffer commands, CommandState& state,
                      GraphSession& session) {
  if (!state.graph)
    return bad_input("vkCmdDispatchDataGraphARM", "no data graph pipeline is bound");
  if (state.graph != session.owned)
    return bad_input("vkCmdDispatchDataGraphARM", "the bound pipeline is not the session's");
  if (!session.memory) return bad_input("vkCmdDispatchDataGraphARM", "the session has no memory");
  if (session.pipeline.flow) return dispatch_flow(device, commands, state, session);
  const bool in_buffers = session.pipeline.in_buffers != nullptr;
  std::vector<std::shared_ptr<Set>> sets;
  for (const GraphTensor& wanted : session.pipeline.tensors) {
    if (!in_buffers) {
      SHALE_TRY(sets.emplace_back(), bound_set(state, wanted));
    } else if (!state.descriptor_buffers || !state.graph_buffer_sets.contains(wanted.set)) {
      return bad_input(descriptor_name(wanted), "no descriptor buffer is bound");
    }
  }
  const bool late =
      std::any_of(sets.begin(), sets.end(), [](const auto& set) { return set->update_after_bind; });
  const std::lock_guard lock(session.mutex);
  std::vector<const Tensor*> tensors;
  Session* recording = nullptr;
  LateDispatch* late_dispatch = nullptr;
  if (late) {
    SHALE_TRY(Session made, make_session(session));
    state.late.push_back(std::make_shared<LateDispatch>(
        LateDispatch{session.owned, device, session, std::move(sets), {{}, std::move(made)}, {}}));
    late_dispatch = state.late.back().get();
    late_dispatch->copies.resize(session.pipeline.tensors.size());
    recording = &late_dispatch->recording.session;
  } else {
    for (size_t i = 0; i < sets.size(); ++i) {
      SHALE_TRY(tensors.emplace_back(),
                bound_tensor(device, *sets[i], session.pipeline.tensors[i]));
    }
    SHALE_TRY(recording, recording_for(session, tensors));
  }
  const auto barrier = [&] { session_barrier(device, commands); };
  const bool staged = std::any_of(session.staging.begin(), session.staging.end(),
                                  [](const auto& each) { return static_cast<bool>(each.buffer); });
  const auto stage = [&](bool inputs) -> Result<void> {
    if (late_dispatch) return record_copies(*late_dispatch, commands, inputs);
    if (in_buffers)
      record_bound_copies(session, commands, state, inputs);
    else
      record_staging(session, commands, tensors, inputs);
    return {};
  };
  const auto all = [&]() -> Result<void> {
    barrier();
    SHALE_TRY_VOID(stage(true));
    if (staged) barrier();
    SHALE_TRY_VOID(recording->record(commands));
    if (staged) barrier();
    return stage(false);
  };
  const Result<void> recorded = all();
  state.restore(device, commands);
  return recorded;
}

}  // namespace

Result<void> LateDispatch::bind() {
  if (!session_of(device, reinterpret_cast<VkDataGraphPipelineSessionARM>(&session)))
    return bad_input("vkQueueSubmit", "a session was destroyed");
  const std::lock_guard lock(session.mutex);
  std::vector<const Tensor*> tensors;
  for (size_t i = 0; i < sets.size(); ++i) {
    SHALE_TRY(tensors.emplace_back(), bound_tensor(device, *sets[i], session.pipeline.tensors[i]));
  }
  std::vector<uint64_t> ids = ids_of(tensors);
  if (ids == recording.tensors) return {};  // which may be pending
  SHALE_TRY_VOID(bind_tensors(session, recording.session, tensors));
  SHALE_TRY_VOID(recording.session.update());
  for (size_t i = 0; i < copies.size(); ++i)
    if (copies[i])
      copies[i]->bind(*session.device.context, tensors[i]->buffer, session.staging[i].buffer.get());
  recording.tensors = std::move(ids);
  return {};
}

void forget_tensor(Device& device, uint64_t id) {
  const std::lock_guard lock(device.mutex);
  for (GraphSession* session : device.sessions) {
    const std::lock_guard own(session->mutex);
    std::erase_if(session->recordings, [&](const GraphSession::Recording& recording) {
      return std::find(recording.tensors.begin(), recording.tensors.end(), id) !=
             recording.tensors.end();
    });
  }
}

VkResult VKAPI_CALL CreateDataGraphPipelineSessionARM(
    VkDevice handle, const VkDataGraphPipelineSessionCreateInfoARM* info,
    const VkAllocationCallbacks* allocator, VkDataGraphPipelineSessionARM* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    *result = VK_NULL_HANDLE;
    const std::shared_ptr<GraphPipeline> pipeline = device.pipelines.find(info->dataGraphPipeline);
    constexpr VkDataGraphPipelineSessionCreateFlagsARM kCache =
        VK_DATA_GRAPH_PIPELINE_SESSION_CREATE_OPTICAL_FLOW_CACHE_BIT_ARM;  // of which none is made
    if (!pipeline || info->flags & ~(pipeline->flow ? kCache : 0))
      return device.fail(
          VK_OBJECT_TYPE_PIPELINE, number_of(info->dataGraphPipeline),
          pipeline
              ? unsupported("VkDataGraphPipelineSessionCreateInfoARM::flags", "{:#x}", info->flags)
              : bad_input("vkCreateDataGraphPipelineSessionARM", "is no data graph pipeline"));
    auto* session = make_object<GraphSession>(allocator, device, pipeline);
    if (const Result<void> found = find_requirements(*session); !found) {
      destroy_object(session, allocator);
      return device.fail(VK_OBJECT_TYPE_PIPELINE, number_of(info->dataGraphPipeline),
                         found.error());
    }
    const std::lock_guard lock(device.mutex);
    device.sessions.insert(session);
    *result = reinterpret_cast<VkDataGraphPipelineSessionARM>(session);
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyDataGraphPipelineSessionARM(VkDevice handle,
                                                   VkDataGraphPipelineSessionARM which,
                                                   const VkAllocationCallbacks* allocator) {
  if (!which) return;
  guarded_void([&] {
    Device& device = device_of(handle);
    GraphSession* session = session_of(device, which);
    if (!session) return;
    {
      const std::lock_guard lock(device.mutex);
      device.sessions.erase(session);
    }
    destroy_object(session, allocator);
  });
}

VkResult VKAPI_CALL GetDataGraphPipelineSessionBindPointRequirementsARM(
    VkDevice, const VkDataGraphPipelineSessionBindPointRequirementsInfoARM*, uint32_t* count,
    VkDataGraphPipelineSessionBindPointRequirementARM* results) {
  if (!results) {
    *count = 1;
    return VK_SUCCESS;
  }
  if (*count == 0) return VK_INCOMPLETE;
  *count = 1;
  results->bindPoint = VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TRANSIENT_ARM;
  results->bindPointType = VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TYPE_MEMORY_ARM;
  results->numObjects = 1;
  return VK_SUCCESS;
}

void VKAPI_CALL GetDataGraphPipelineSessionMemoryRequirementsARM(
    VkDevice handle, const VkDataGraphPipelineSessionMemoryRequirementsInfoARM* info,
    VkMemoryRequirements2* result) {
  if (auto* dedicated = find_in_chain<VkMemoryDedicatedRequirements>(
          result->pNext, VK_STRUCTURE_TYPE_MEMORY_DEDICATED_REQUIREMENTS))
    dedicated->prefersDedicatedAllocation = dedicated->requiresDedicatedAllocation = VK_FALSE;
  const GraphSession* session = session_of(device_of(handle), info->session);
  result->memoryRequirements = session ? session->requirements : VkMemoryRequirements{};
}

VkResult VKAPI_CALL BindDataGraphPipelineSessionMemoryARM(
    VkDevice handle, uint32_t count, const VkBindDataGraphPipelineSessionMemoryInfoARM* infos) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    for (uint32_t i = 0; i < count; ++i) {
      const VkBindDataGraphPipelineSessionMemoryInfoARM& info = infos[i];
      GraphSession* session = session_of(device, info.session);
      Result<void> bound =
          session && info.bindPoint == VK_DATA_GRAPH_PIPELINE_SESSION_BIND_POINT_TRANSIENT_ARM &&
                  info.objectIndex == 0
              ? bind_memory(*session, info.memory, info.memoryOffset)
              : bad_input("session", "has no object {} of bind point {}", info.objectIndex,
                          static_cast<int>(info.bindPoint));
      if (!bound)
        return device.fail(VK_OBJECT_TYPE_DATA_GRAPH_PIPELINE_SESSION_ARM, number_of(info.session),
                           bound.error());
    }
    return VK_SUCCESS;
  });
}

void VKAPI_CALL CmdDispatchDataGraphARM(VkCommandBuffer commands,
                                        VkDataGraphPipelineSessionARM session,
                                        const VkDataGraphPipelineDispatchInfoARM*) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const auto state = device.commands.find(commands);
    if (!state) return bad_input("vkCmdDispatchDataGraphARM", "no data graph pipeline is bound");
    GraphSession* found = session_of(device, session);
    if (!found) return bad_input("vkCmdDispatchDataGraphARM", "there is no such session");
    return dispatch(device, commands, *state, *found);
  });
}

}  // namespace shale::layer
