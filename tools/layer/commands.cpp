#include "tools/layer/commands.h"

#include <algorithm>

#include "tools/layer/barriers.h"
#include "tools/layer/chain.h"
#include "tools/layer/graph.h"

namespace shale::layer {
namespace {

void forget(Device& device, std::span<const VkCommandBuffer> buffers) {
  for (const VkCommandBuffer each : buffers) {
    device.commands.take(each);
    device.late.take(each);
  }
}

/// Before the buffers are submitted. Errors: those of LateDispatch::bind.
VkResult bind_late(Device& device, VkCommandBuffer commands) {
  for (const std::shared_ptr<LateDispatch>& each : device.late.find(commands))
    if (const Result<void> bound = each->bind(); !bound)
      return device.fail(VK_OBJECT_TYPE_COMMAND_BUFFER, number_of(commands), bound.error());
  return VK_SUCCESS;
}

/// Descriptors that were pushed to a set, one by one, so that what is overwritten goes.
struct Pushed {
  struct Descriptor {
    VkDescriptorType type;
    VkDescriptorImageInfo image;
    VkDescriptorBufferInfo buffer;
    VkBufferView texel;
  };
  VkPipelineLayout layout = VK_NULL_HANDLE;
  std::map<std::pair<uint32_t, uint32_t>, Descriptor> descriptors;  ///< by binding and element

  void add(const VkWriteDescriptorSet& write) {
    for (uint32_t i = 0; i < write.descriptorCount; ++i) {
      Descriptor descriptor{write.descriptorType, {}, {}, VK_NULL_HANDLE};
      switch (write.descriptorType) {
        case VK_DESCRIPTOR_TYPE_SAMPLER:
        case VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER:
        case VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE:
        case VK_DESCRIPTOR_TYPE_STORAGE_IMAGE:
        case VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT: descriptor.image = write.pImageInfo[i]; break;
        case VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER:
        case VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER:
          descriptor.texel = write.pTexelBufferView[i];
          break;
        case VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER:
        case VK_DESCRIPTOR_TYPE_STORAGE_BUFFER: descriptor.buffer = write.pBufferInfo[i]; break;
        default: continue;  // acceleration structures, which no compute work of ours disturbs alone
      }
      descriptors[{write.dstBinding, write.dstArrayElement + i}] = descriptor;
    }
  }
  void push(const Device& device, VkCommandBuffer commands, uint32_t set) const {
    std::vector<VkWriteDescriptorSet> writes;
    for (const auto& [where, descriptor] : descriptors) {
      VkWriteDescriptorSet write{};
      write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
      write.dstBinding = where.first;
      write.dstArrayElement = where.second;
      write.descriptorCount = 1;
      write.descriptorType = descriptor.type;
      write.pImageInfo = &descriptor.image;
      write.pBufferInfo = &descriptor.buffer;
      write.pTexelBufferView = &descriptor.texel;
      writes.push_back(write);
    }
    device.CmdPushDescriptorSetKHR(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout, set,
                                   static_cast<uint32_t>(writes.size()), writes.data());
  }
};

void push_to_graph(Device& device, CommandState& state, VkPipelineLayout layout_handle,
                   uint32_t set, std::span<const VkWriteDescriptorSet> writes) {
  const auto layout = device.layouts.find(layout_handle);
  if (!layout || set >= layout->sets.size() || !layout->sets[set]) return;
  std::shared_ptr<Set>& pushed = state.pushed_graph_sets[set];
  if (!pushed || state.graph_sets[set] != pushed)
    state.graph_sets[set] = pushed = std::make_shared<Set>(*layout->sets[set]);
  const SplitWrites split(device, writes,
                          [&](const VkWriteDescriptorSet&) { return pushed.get(); });
}

}  // namespace

CommandState& state_of(Device& device, VkCommandBuffer commands) {
  auto state = device.commands.find(commands);
  if (!state) {
    state = std::make_shared<CommandState>();
    device.commands.put(commands, state);
  }
  return *state;  // as long as the command buffer
}

void CommandState::bind_sets(uint32_t first, uint32_t count,
                             std::function<void(VkCommandBuffer)> again) {
  std::erase_if(compute_sets, [&](const Bound& bound) {
    return bound.first >= first && bound.first + bound.count <= first + count;
  });
  compute_sets.push_back({first, count, std::move(again)});
}

void CommandState::restore(const Device& device, VkCommandBuffer commands) const {
  if (descriptor_buffers) descriptor_buffers(commands);
  for (const Bound& bound : compute_sets) bound.again(commands);
  if (compute) device.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, compute);
}

void record_guarded(VkCommandBuffer commands,
                    const std::function<Result<void>(Device&)>& work) noexcept {
  Device& device = device_of(commands);
  const VkResult result = guarded([&]() -> VkResult {
    const Result<void> done = work(device);
    return done ? VK_SUCCESS
                : device.fail(VK_OBJECT_TYPE_COMMAND_BUFFER, number_of(commands), done.error());
  });
  if (result != VK_SUCCESS) guarded_void([&] { state_of(device, commands).failed = result; });
}

VkResult VKAPI_CALL CreateCommandPool(VkDevice handle, const VkCommandPoolCreateInfo* info,
                                      const VkAllocationCallbacks* allocator,
                                      VkCommandPool* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const ChainCopy chain(info->pNext);
    VkCommandPoolCreateInfo below = *info;
    below.pNext = chain.next();
    const VkResult created = device.CreateCommandPool(handle, &below, allocator, result);
    if (created == VK_SUCCESS)
      device.command_pools.put(*result, std::make_shared<std::set<VkCommandBuffer>>());
    return created;
  });
}

VkResult VKAPI_CALL ResetCommandPool(VkDevice handle, VkCommandPool pool,
                                     VkCommandPoolResetFlags flags) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    if (const auto buffers = device.command_pools.find(pool))
      for (const VkCommandBuffer each : *buffers) forget(device, {&each, 1});
    return device.ResetCommandPool(handle, pool, flags);
  });
}

void VKAPI_CALL DestroyCommandPool(VkDevice handle, VkCommandPool pool,
                                   const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    if (const auto buffers = device.command_pools.take(pool))
      for (const VkCommandBuffer each : *buffers) forget(device, {&each, 1});
    device.DestroyCommandPool(handle, pool, allocator);
  });
}

VkResult VKAPI_CALL AllocateCommandBuffers(VkDevice handle, const VkCommandBufferAllocateInfo* info,
                                           VkCommandBuffer* results) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const VkResult allocated = device.AllocateCommandBuffers(handle, info, results);
    if (allocated != VK_SUCCESS) return allocated;
    if (const auto buffers = device.command_pools.find(info->commandPool))
      buffers->insert(results, results + info->commandBufferCount);
    return VK_SUCCESS;
  });
}

void VKAPI_CALL FreeCommandBuffers(VkDevice handle, VkCommandPool pool, uint32_t count,
                                   const VkCommandBuffer* buffers) {
  guarded_void([&] {
    Device& device = device_of(handle);
    forget(device, {buffers, count});
    if (const auto known = device.command_pools.find(pool))
      for (uint32_t i = 0; i < count; ++i) known->erase(buffers[i]);
    device.FreeCommandBuffers(handle, pool, count, buffers);
  });
}

VkResult VKAPI_CALL BeginCommandBuffer(VkCommandBuffer commands,
                                       const VkCommandBufferBeginInfo* info) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(commands);
    forget(device, {&commands, 1});
    return device.BeginCommandBuffer(commands, info);
  });
}

VkResult VKAPI_CALL EndCommandBuffer(VkCommandBuffer commands) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(commands);
    const auto state = device.commands.take(commands);
    const VkResult ended = device.EndCommandBuffer(commands);
    if (state && !state->late.empty()) device.late.put(commands, std::move(state->late));
    return state && state->failed != VK_SUCCESS ? state->failed : ended;
  });
}

VkResult VKAPI_CALL ResetCommandBuffer(VkCommandBuffer commands, VkCommandBufferResetFlags flags) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(commands);
    forget(device, {&commands, 1});
    return device.ResetCommandBuffer(commands, flags);
  });
}

void VKAPI_CALL CmdBindPipeline(VkCommandBuffer commands, VkPipelineBindPoint point,
                                VkPipeline pipeline) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    if (point == VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM) {
      state_of(device, commands).graph = device.pipelines.find(pipeline);
      return {};
    }
    if (point == VK_PIPELINE_BIND_POINT_COMPUTE) state_of(device, commands).compute = pipeline;
    device.CmdBindPipeline(commands, point, pipeline);
    return {};
  });
}

void VKAPI_CALL CmdBindDescriptorSets(VkCommandBuffer commands, VkPipelineBindPoint point,
                                      VkPipelineLayout layout, uint32_t first, uint32_t count,
                                      const VkDescriptorSet* sets, uint32_t offset_count,
                                      const uint32_t* offsets) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    if (point == VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM) {
      CommandState& state = state_of(device, commands);
      for (uint32_t i = 0; i < count; ++i) {
        state.graph_buffer_sets.erase(first + i);
        state.graph_sets[first + i] = sets[i] ? device.sets.find(sets[i]) : nullptr;
        state.graph_handles[first + i] = sets[i];
      }
      return {};
    }
    if (point == VK_PIPELINE_BIND_POINT_COMPUTE)
      state_of(device, commands)
          .bind_sets(first, count,
                     [&device, layout, first, all = std::vector(sets, sets + count),
                      dynamic = std::vector(offsets, offsets + offset_count)](VkCommandBuffer to) {
                       device.CmdBindDescriptorSets(
                           to, VK_PIPELINE_BIND_POINT_COMPUTE, layout, first,
                           static_cast<uint32_t>(all.size()), all.data(),
                           static_cast<uint32_t>(dynamic.size()), dynamic.data());
                     });
    device.CmdBindDescriptorSets(commands, point, layout, first, count, sets, offset_count,
                                 offsets);
    return {};
  });
}

void VKAPI_CALL CmdPushDescriptorSetKHR(VkCommandBuffer commands, VkPipelineBindPoint point,
                                        VkPipelineLayout layout, uint32_t set, uint32_t count,
                                        const VkWriteDescriptorSet* writes) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const std::span<const VkWriteDescriptorSet> all(writes, count);
    CommandState& state = state_of(device, commands);
    if (point == VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM) {
      push_to_graph(device, state, layout, set, all);
      return {};
    }
    const SplitWrites split(device, all, [](const VkWriteDescriptorSet&) { return nullptr; });
    if (split.below().empty()) return {};
    if (point == VK_PIPELINE_BIND_POINT_COMPUTE) {
      // Pushes add to each other, unless another set was bound in between.
      const auto old =
          std::find_if(state.compute_sets.begin(), state.compute_sets.end(),
                       [&](const auto& bound) { return bound.pushed && bound.first == set; });
      const auto pushed = old == state.compute_sets.end()
                              ? std::make_shared<Pushed>()
                              : std::static_pointer_cast<Pushed>(old->pushed);
      pushed->layout = layout;
      for (const VkWriteDescriptorSet& write : split.below()) pushed->add(write);
      state.bind_sets(
          set, 1, [&device, pushed, set](VkCommandBuffer to) { pushed->push(device, to, set); });
      state.compute_sets.back().pushed = pushed;
    }
    device.CmdPushDescriptorSetKHR(commands, point, layout, set,
                                   static_cast<uint32_t>(split.below().size()),
                                   split.below().data());
    return {};
  });
}

void VKAPI_CALL CmdPushDescriptorSetWithTemplateKHR(VkCommandBuffer commands,
                                                    VkDescriptorUpdateTemplate which,
                                                    VkPipelineLayout layout, uint32_t set,
                                                    const void* data) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const auto update = device.templates.find(which);
    if (!update)
      return bad_input("vkCmdPushDescriptorSetWithTemplateKHR", "the template is unknown");
    if (update->below && update->point != VK_PIPELINE_BIND_POINT_COMPUTE) {
      device.CmdPushDescriptorSetWithTemplateKHR(commands, which, layout, set, data);
      return {};
    }
    const TemplateWrites writes(*update, VK_NULL_HANDLE, data);
    CmdPushDescriptorSetKHR(commands, update->point, layout, set,
                            static_cast<uint32_t>(writes.writes().size()), writes.writes().data());
    return {};
  });
}

/// Calls work(point) for the bind points of `stages` that the layer has to know of, and gives what is left of them.
template <typename Work>
static VkShaderStageFlags known_points(VkShaderStageFlags stages, const Work& work) {
  // There is no stage of graphs: those that name all mean them, too.
  if (stages == VK_SHADER_STAGE_ALL) work(VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM);
  if (stages & VK_SHADER_STAGE_COMPUTE_BIT) work(VK_PIPELINE_BIND_POINT_COMPUTE);
  return stages & ~VkShaderStageFlags{VK_SHADER_STAGE_COMPUTE_BIT};
}

void VKAPI_CALL CmdBindDescriptorSets2KHR(VkCommandBuffer commands,
                                          const VkBindDescriptorSetsInfoKHR* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    VkBindDescriptorSetsInfoKHR rest = *info;
    if (info->layout)  // else a chained layout, which is not kept
      rest.stageFlags = known_points(info->stageFlags, [&](VkPipelineBindPoint point) {
        CmdBindDescriptorSets(commands, point, info->layout, info->firstSet,
                              info->descriptorSetCount, info->pDescriptorSets,
                              info->dynamicOffsetCount, info->pDynamicOffsets);
      });
    if (rest.stageFlags != 0) device.CmdBindDescriptorSets2KHR(commands, &rest);
    return {};
  });
}

void VKAPI_CALL CmdPushDescriptorSet2KHR(VkCommandBuffer commands,
                                         const VkPushDescriptorSetInfoKHR* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    VkPushDescriptorSetInfoKHR rest = *info;
    if (info->layout)
      rest.stageFlags = known_points(info->stageFlags, [&](VkPipelineBindPoint point) {
        CmdPushDescriptorSetKHR(commands, point, info->layout, info->set,
                                info->descriptorWriteCount, info->pDescriptorWrites);
      });
    if (rest.stageFlags == 0) return {};
    const SplitWrites split(device, {info->pDescriptorWrites, info->descriptorWriteCount},
                            [](const VkWriteDescriptorSet&) { return nullptr; });
    rest.descriptorWriteCount = static_cast<uint32_t>(split.below().size());
    rest.pDescriptorWrites = split.below().data();
    if (rest.descriptorWriteCount > 0) device.CmdPushDescriptorSet2KHR(commands, &rest);
    return {};
  });
}

void VKAPI_CALL CmdPushDescriptorSetWithTemplate2KHR(
    VkCommandBuffer commands, const VkPushDescriptorSetWithTemplateInfoKHR* info) {
  if (info->layout)  // the template names its one bind point
    CmdPushDescriptorSetWithTemplateKHR(commands, info->descriptorUpdateTemplate, info->layout,
                                        info->set, info->pData);
  else
    device_of(commands).CmdPushDescriptorSetWithTemplate2KHR(commands, info);
}

void VKAPI_CALL CmdBindDescriptorBuffersEXT(VkCommandBuffer commands, uint32_t count,
                                            const VkDescriptorBufferBindingInfoEXT* infos) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    std::vector<std::shared_ptr<ChainCopy>> chains;
    for (uint32_t i = 0; i < count; ++i)
      chains.push_back(std::make_shared<ChainCopy>(infos[i].pNext));
    state_of(device, commands).descriptor_buffers =
        [&device, chains, all = std::vector(infos, infos + count)](VkCommandBuffer to) {
          std::vector<VkDescriptorBufferBindingInfoEXT> own = all;
          for (size_t i = 0; i < own.size(); ++i)
            own[i].pNext = const_cast<void*>(chains[i]->next());
          device.CmdBindDescriptorBuffersEXT(to, static_cast<uint32_t>(own.size()), own.data());
        };
    device.CmdBindDescriptorBuffersEXT(commands, count, infos);
    return {};
  });
}

void VKAPI_CALL CmdSetDescriptorBufferOffsetsEXT(VkCommandBuffer commands,
                                                 VkPipelineBindPoint point, VkPipelineLayout layout,
                                                 uint32_t first, uint32_t count,
                                                 const uint32_t* buffers,
                                                 const VkDeviceSize* offsets) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    if (point == VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM) {
      CommandState& state = state_of(device, commands);
      for (uint32_t i = 0; i < count; ++i) {
        state.graph_sets.erase(first + i);
        state.graph_handles.erase(first + i);
        state.graph_buffer_sets[first + i] = {buffers[i], offsets[i]};
      }
      return {};
    }
    if (point == VK_PIPELINE_BIND_POINT_COMPUTE)
      state_of(device, commands)
          .bind_sets(first, count,
                     [&device, layout, first, all = std::vector(buffers, buffers + count),
                      at = std::vector(offsets, offsets + count)](VkCommandBuffer to) {
                       device.CmdSetDescriptorBufferOffsetsEXT(
                           to, VK_PIPELINE_BIND_POINT_COMPUTE, layout, first,
                           static_cast<uint32_t>(all.size()), all.data(), at.data());
                     });
    device.CmdSetDescriptorBufferOffsetsEXT(commands, point, layout, first, count, buffers,
                                            offsets);
    return {};
  });
}

void VKAPI_CALL CmdSetDescriptorBufferOffsets2EXT(VkCommandBuffer commands,
                                                  const VkSetDescriptorBufferOffsetsInfoEXT* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    VkSetDescriptorBufferOffsetsInfoEXT rest = *info;
    if (info->layout)
      rest.stageFlags = known_points(info->stageFlags, [&](VkPipelineBindPoint point) {
        CmdSetDescriptorBufferOffsetsEXT(commands, point, info->layout, info->firstSet,
                                         info->setCount, info->pBufferIndices, info->pOffsets);
      });
    if (rest.stageFlags != 0) device.CmdSetDescriptorBufferOffsets2EXT(commands, &rest);
    return {};
  });
}

void VKAPI_CALL CmdBindDescriptorBufferEmbeddedSamplersEXT(VkCommandBuffer commands,
                                                           VkPipelineBindPoint point,
                                                           VkPipelineLayout layout, uint32_t set) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    if (point == VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM) return {};  // it has none
    if (point == VK_PIPELINE_BIND_POINT_COMPUTE)
      state_of(device, commands).bind_sets(set, 1, [&device, layout, set](VkCommandBuffer to) {
        device.CmdBindDescriptorBufferEmbeddedSamplersEXT(to, VK_PIPELINE_BIND_POINT_COMPUTE,
                                                          layout, set);
      });
    device.CmdBindDescriptorBufferEmbeddedSamplersEXT(commands, point, layout, set);
    return {};
  });
}

void VKAPI_CALL CmdBindDescriptorBufferEmbeddedSamplers2EXT(
    VkCommandBuffer commands, const VkBindDescriptorBufferEmbeddedSamplersInfoEXT* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    VkBindDescriptorBufferEmbeddedSamplersInfoEXT rest = *info;
    if (info->layout)
      rest.stageFlags = known_points(info->stageFlags, [&](VkPipelineBindPoint point) {
        CmdBindDescriptorBufferEmbeddedSamplersEXT(commands, point, info->layout, info->set);
      });
    if (rest.stageFlags != 0) device.CmdBindDescriptorBufferEmbeddedSamplers2EXT(commands, &rest);
    return {};
  });
}

void VKAPI_CALL CmdExecuteCommands(VkCommandBuffer commands, uint32_t count,
                                   const VkCommandBuffer* secondaries) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    device.CmdExecuteCommands(commands, count, secondaries);
    // What was bound is undefined behind it.
    CommandState& state = state_of(device, commands);
    CommandState next;
    next.failed = state.failed;
    next.late = std::move(state.late);
    for (uint32_t i = 0; i < count; ++i) {
      const LateDispatches late = device.late.find(secondaries[i]);
      next.late.insert(next.late.end(), late.begin(), late.end());
    }
    state = std::move(next);
    return {};
  });
}

void VKAPI_CALL CmdPipelineBarrier(VkCommandBuffer commands, VkPipelineStageFlags from,
                                   VkPipelineStageFlags to, VkDependencyFlags flags,
                                   uint32_t memory_count, const VkMemoryBarrier* memory,
                                   uint32_t buffer_count, const VkBufferMemoryBarrier* buffers,
                                   uint32_t image_count, const VkImageMemoryBarrier* images) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const std::vector<VkImageMemoryBarrier> below = images_below({images, image_count});
    device.CmdPipelineBarrier(commands, from, to, flags, memory_count, memory, buffer_count,
                              buffers, image_count, below.data());
    return {};
  });
}

void VKAPI_CALL CmdWaitEvents(VkCommandBuffer commands, uint32_t event_count, const VkEvent* events,
                              VkPipelineStageFlags from, VkPipelineStageFlags to,
                              uint32_t memory_count, const VkMemoryBarrier* memory,
                              uint32_t buffer_count, const VkBufferMemoryBarrier* buffers,
                              uint32_t image_count, const VkImageMemoryBarrier* images) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const std::vector<VkImageMemoryBarrier> below = images_below({images, image_count});
    device.CmdWaitEvents(commands, event_count, events, from, to, memory_count, memory,
                         buffer_count, buffers, image_count, below.data());
    return {};
  });
}

void VKAPI_CALL CmdPipelineBarrier2(VkCommandBuffer commands, const VkDependencyInfo* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const DependencyBelow below(*info);
    device.CmdPipelineBarrier2(commands, below.get());
    return {};
  });
}

void VKAPI_CALL CmdSetEvent2(VkCommandBuffer commands, VkEvent event,
                             const VkDependencyInfo* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const DependencyBelow below(*info);
    device.CmdSetEvent2(commands, event, below.get());
    return {};
  });
}

void VKAPI_CALL CmdWaitEvents2(VkCommandBuffer commands, uint32_t count, const VkEvent* events,
                               const VkDependencyInfo* infos) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    std::vector<std::unique_ptr<DependencyBelow>> all;
    std::vector<VkDependencyInfo> below;
    for (uint32_t i = 0; i < count; ++i)
      below.push_back(*all.emplace_back(std::make_unique<DependencyBelow>(infos[i]))->get());
    device.CmdWaitEvents2(commands, count, events, below.data());
    return {};
  });
}

void VKAPI_CALL CmdResetEvent2(VkCommandBuffer commands, VkEvent event,
                               VkPipelineStageFlags2 stages) {
  device_of(commands).CmdResetEvent2(commands, event, stages_below(stages));
}

void VKAPI_CALL CmdWriteTimestamp2(VkCommandBuffer commands, VkPipelineStageFlags2 stage,
                                   VkQueryPool pool, uint32_t query) {
  // One stage is asked for: that of the kernels.
  if (stage == VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM)
    stage = VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT;
  device_of(commands).CmdWriteTimestamp2(commands, stage, pool, query);
}

VkResult VKAPI_CALL QueueSubmit(VkQueue queue, uint32_t count, const VkSubmitInfo* infos,
                                VkFence fence) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(queue);
    for (const VkSubmitInfo& info : std::span(infos, count))
      for (uint32_t i = 0; i < info.commandBufferCount; ++i)
        if (const VkResult bound = bind_late(device, info.pCommandBuffers[i]); bound != VK_SUCCESS)
          return bound;
    return device.QueueSubmit(queue, count, infos, fence);
  });
}

VkResult VKAPI_CALL QueueSubmit2(VkQueue queue, uint32_t count, const VkSubmitInfo2* infos,
                                 VkFence fence) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(queue);
    for (const VkSubmitInfo2& info : std::span(infos, count))
      for (uint32_t i = 0; i < info.commandBufferInfoCount; ++i)
        if (const VkResult bound = bind_late(device, info.pCommandBufferInfos[i].commandBuffer);
            bound != VK_SUCCESS)
          return bound;
    std::vector<VkSubmitInfo2> below(infos, infos + count);
    std::vector<std::vector<VkSemaphoreSubmitInfo>> semaphores;
    const auto translated = [&](const VkSemaphoreSubmitInfo* list, uint32_t size) {
      auto& copy = semaphores.emplace_back(list, list + size);
      for (VkSemaphoreSubmitInfo& each : copy) each.stageMask = stages_below(each.stageMask);
      return copy.data();
    };
    for (VkSubmitInfo2& info : below) {
      info.pWaitSemaphoreInfos = translated(info.pWaitSemaphoreInfos, info.waitSemaphoreInfoCount);
      info.pSignalSemaphoreInfos =
          translated(info.pSignalSemaphoreInfos, info.signalSemaphoreInfoCount);
    }
    return device.QueueSubmit2(queue, count, below.data(), fence);
  });
}

}  // namespace shale::layer
