#include "tools/layer/barriers.h"

namespace shale::layer {
namespace {

template <typename T>
void translate(T& barrier) {
  barrier.srcStageMask = stages_below(barrier.srcStageMask);
  barrier.srcAccessMask = accesses_below(barrier.srcAccessMask);
  barrier.dstStageMask = stages_below(barrier.dstStageMask);
  barrier.dstAccessMask = accesses_below(barrier.dstAccessMask);
}

VkBufferMemoryBarrier2 buffer_barrier(const VkTensorMemoryBarrierARM& tensor) {
  VkBufferMemoryBarrier2 buffer{};
  buffer.sType = VK_STRUCTURE_TYPE_BUFFER_MEMORY_BARRIER_2;
  buffer.srcStageMask = tensor.srcStageMask;
  buffer.srcAccessMask = tensor.srcAccessMask;
  buffer.dstStageMask = tensor.dstStageMask;
  buffer.dstAccessMask = tensor.dstAccessMask;
  buffer.srcQueueFamilyIndex = tensor.srcQueueFamilyIndex;
  buffer.dstQueueFamilyIndex = tensor.dstQueueFamilyIndex;
  buffer.buffer = tensor_of(tensor.tensor)->buffer;
  buffer.size = VK_WHOLE_SIZE;
  return buffer;
}

}  // namespace

DependencyBelow::DependencyBelow(const VkDependencyInfo& info)
    : info_(info),
      chain_(info.pNext),
      memory_(info.pMemoryBarriers, info.pMemoryBarriers + info.memoryBarrierCount),
      buffers_(info.pBufferMemoryBarriers,
               info.pBufferMemoryBarriers + info.bufferMemoryBarrierCount),
      images_(info.pImageMemoryBarriers, info.pImageMemoryBarriers + info.imageMemoryBarrierCount) {
  for (auto* each = static_cast<const VkBaseInStructure*>(info.pNext); each; each = each->pNext) {
    if (each->sType == VK_STRUCTURE_TYPE_TENSOR_MEMORY_BARRIER_ARM)
      buffers_.push_back(buffer_barrier(*reinterpret_cast<const VkTensorMemoryBarrierARM*>(each)));
    if (each->sType != VK_STRUCTURE_TYPE_TENSOR_DEPENDENCY_INFO_ARM) continue;
    const auto& list = *reinterpret_cast<const VkTensorDependencyInfoARM*>(each);
    for (uint32_t i = 0; i < list.tensorMemoryBarrierCount; ++i)
      buffers_.push_back(buffer_barrier(list.pTensorMemoryBarriers[i]));
  }
  for (VkMemoryBarrier2& barrier : memory_) translate(barrier);
  for (VkBufferMemoryBarrier2& barrier : buffers_) translate(barrier);
  for (VkImageMemoryBarrier2& barrier : images_) {
    translate(barrier);
    barrier.oldLayout = layout_below(barrier.oldLayout);
    barrier.newLayout = layout_below(barrier.newLayout);
  }
  info_.pNext = chain_.next();
  info_.memoryBarrierCount = static_cast<uint32_t>(memory_.size());
  info_.pMemoryBarriers = memory_.data();
  info_.bufferMemoryBarrierCount = static_cast<uint32_t>(buffers_.size());
  info_.pBufferMemoryBarriers = buffers_.data();
  info_.imageMemoryBarrierCount = static_cast<uint32_t>(images_.size());
  info_.pImageMemoryBarriers = images_.data();
}

}  // namespace shale::layer
