// tools/layer/barriers.h -- stages, accesses, layouts and barriers that the device below does not
// know, in its own terms: graphs are compute shaders and copies, tensors are buffers.
#pragma once

#include "tools/layer/chain.h"
#include "tools/layer/tensor.h"

namespace shale::layer {

inline VkPipelineStageFlags2 stages_below(VkPipelineStageFlags2 stages) {
  if (!(stages & VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM)) return stages;
  return (stages & ~VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM) |
         VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT;
}

inline VkAccessFlags2 accesses_below(VkAccessFlags2 accesses) {
  if (accesses & VK_ACCESS_2_DATA_GRAPH_READ_BIT_ARM)
    accesses |= VK_ACCESS_2_SHADER_READ_BIT | VK_ACCESS_2_TRANSFER_READ_BIT;
  if (accesses & VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM)
    accesses |= VK_ACCESS_2_SHADER_WRITE_BIT | VK_ACCESS_2_TRANSFER_WRITE_BIT;
  return accesses & ~(VK_ACCESS_2_DATA_GRAPH_READ_BIT_ARM | VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM);
}

inline VkImageLayout layout_below(VkImageLayout layout) {
  return layout == VK_IMAGE_LAYOUT_TENSOR_ALIASING_ARM ? VK_IMAGE_LAYOUT_GENERAL : layout;
}

inline std::vector<VkImageMemoryBarrier> images_below(
    std::span<const VkImageMemoryBarrier> images) {
  std::vector<VkImageMemoryBarrier> below(images.begin(), images.end());
  for (VkImageMemoryBarrier& image : below) {
    image.oldLayout = layout_below(image.oldLayout);
    image.newLayout = layout_below(image.newLayout);
  }
  return below;
}

/// A dependency without the layer's structures; tensor barriers are buffer barriers. Never moved.
class DependencyBelow {
 public:
  explicit DependencyBelow(const VkDependencyInfo& info);
  DependencyBelow(const DependencyBelow&) = delete;
  DependencyBelow& operator=(const DependencyBelow&) = delete;
  const VkDependencyInfo* get() const { return &info_; }

 private:
  VkDependencyInfo info_;
  ChainCopy chain_;
  std::vector<VkMemoryBarrier2> memory_;
  std::vector<VkBufferMemoryBarrier2> buffers_;
  std::vector<VkImageMemoryBarrier2> images_;
};

}  // namespace shale::layer
