// tools/layer/strided_copy.h -- copies between a tensor and packed elements by a shader. Unlike vkCmdCopyBuffer it
// can be recorded before the tensor is known.
#pragma once

#include "compiler/spirv/glsl.h"
#include "tools/layer/tensor.h"

namespace shale::layer {

/// The sizes and strides are literals of its shader, so that no push constants of the application are disturbed.
class StridedCopy {
 public:
  /// From `layout` to packed elements, or back with `unpacks`. The device must be able to store elements of that size.
  /// Errors: kDevice.
  static Result<StridedCopy> create(const vk::Context& context, const TensorLayout& layout,
                                    bool unpacks, VkPipelineCache cache);

  /// A copy that was recorded, and the descriptors that it reads when it runs.
  class Recorded {
   public:
    /// Names the buffers; not while it is pending.
    void bind(const vk::Context& context, VkBuffer tensor, VkBuffer packed) const;

   private:
    friend class StridedCopy;
    vk::DescriptorPoolHandle pool_;
    VkDescriptorSet set_ = VK_NULL_HANDLE;
  };
  /// Changes the bound compute pipeline and set 0. Errors: kDevice.
  Result<Recorded> record(const vk::Context& context, VkCommandBuffer commands) const;

  /// A tensor whose descriptor lies in a descriptor buffer, and where its packed elements are.
  struct InBuffer {
    VkPipelineLayout layout = VK_NULL_HANDLE;  ///< must outlive the copy
    uint32_t set = 0, binding = 0, element = 0;
    VkDeviceAddress packed = 0;
  };
  /// The copy that finds its tensor in the sets of the layout as they are bound. Errors: kDevice.
  static Result<StridedCopy> create(const vk::Context& context, const TensorLayout& layout,
                                    bool unpacks, const InBuffer& place);
  /// Changes the bound compute pipeline; its sets are bound by descriptor buffers.
  void record_bound(const vk::Context& context, VkCommandBuffer commands) const;

 private:
  Result<Spirv> compile(const TensorLayout& layout, bool unpacks, Defines places);

  vk::SetLayoutHandle set_layout_;
  vk::PipelineLayoutHandle layout_;
  vk::PipelineHandle pipeline_;
  std::array<uint32_t, 2> groups_{};
};

}  // namespace shale::layer
