#include "runtime/vk/commands.h"

#include "runtime/vk/handle.h"

namespace shale::vk {

Result<void> submit_and_wait(const Context& context,
                             const std::function<void(VkCommandBuffer)>& record) {
  const Functions& vk = context.vk;
  auto pool_info = init<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool_info.flags = VK_COMMAND_POOL_CREATE_TRANSIENT_BIT;
  pool_info.queueFamilyIndex = context.queue_family;
  SHALE_TRY(const auto pool, make(vk.CreateCommandPool, vk.DestroyCommandPool,
                                  "vkCreateCommandPool", context.device, pool_info));
  SHALE_TRY(const auto fence, make(vk.CreateFence, vk.DestroyFence, "vkCreateFence", context.device,
                                   init<VkFenceCreateInfo>(VK_STRUCTURE_TYPE_FENCE_CREATE_INFO)));
  auto buffer_info =
      init<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  buffer_info.commandPool = pool.get();
  buffer_info.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  buffer_info.commandBufferCount = 1;
  VkCommandBuffer commands = VK_NULL_HANDLE;  // freed with its pool
  SHALE_TRY_VOID(check(vk.AllocateCommandBuffers(context.device, &buffer_info, &commands),
                       "vkAllocateCommandBuffers"));
  auto begin = init<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
  begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  SHALE_TRY_VOID(check(vk.BeginCommandBuffer(commands, &begin), "vkBeginCommandBuffer"));
  record(commands);
  SHALE_TRY_VOID(check(vk.EndCommandBuffer(commands), "vkEndCommandBuffer"));
  auto submit = init<VkSubmitInfo>(VK_STRUCTURE_TYPE_SUBMIT_INFO);
  submit.commandBufferCount = 1;
  submit.pCommandBuffers = &commands;
  SHALE_TRY_VOID(check(vk.QueueSubmit(context.queue, 1, &submit, fence.get()), "vkQueueSubmit"));
  const VkFence handle = fence.get();
  return check(vk.WaitForFences(context.device, 1, &handle, VK_TRUE, UINT64_MAX),
               "vkWaitForFences");
}

void memory_barrier(const Context& context, VkCommandBuffer commands, VkPipelineStageFlags from,
                    VkAccessFlags written, VkPipelineStageFlags to, VkAccessFlags used) {
  auto barrier = init<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  barrier.srcAccessMask = written;
  barrier.dstAccessMask = used;
  context.vk.CmdPipelineBarrier(commands, from, to, 0, 1, &barrier, 0, nullptr, 0, nullptr);
}

}  // namespace shale::vk
