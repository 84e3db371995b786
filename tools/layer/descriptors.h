// tools/layer/descriptors.h -- descriptors of tensors, which only the layer knows.
//
// Graphs get sets of their own: what a set's tensor descriptors hold is kept here, beside the device's set.
// There a binding of tensors has the buffers that shaders see (tensor_shader.h), or none if no shader may.
#pragma once

#include <functional>
#include <map>
#include <span>

#include "tools/layer/tensor.h"

namespace shale::layer {

struct SetLayout {
  struct Binding {
    VkDescriptorType type = VK_DESCRIPTOR_TYPE_SAMPLER;
    uint32_t count = 0;
    bool varies = false;  ///< each set has a count of its own, up to this one
    VkShaderStageFlags stages = 0;
  };
  std::map<uint32_t, Binding> bindings;  ///< by number
  bool has_tensors = false;
  bool update_after_bind = false;  ///< tensors may be written when the set is bound
  bool in_descriptor_buffer = false;
  bool is_pushed = false;
  bool has_dynamic = false;  ///< buffers with dynamic offsets

  /// How many descriptors the device below has for one whose count varies, of a tensor or of others.
  uint32_t varying_scale(const Device& device) const;
};

struct PipelineLayout {
  std::vector<std::shared_ptr<SetLayout>> sets;
  bool has_push_constants = false;
  /// The same layout as long as graph pipelines need it; there if its sets lie in descriptor buffers.
  vk::PipelineLayoutHandle own;
  /// The same with Device::flow_set_layout behind its sets; there if optical flow can use it.
  vk::PipelineLayoutHandle with_flow;
};

/// The tensor descriptors of a set, as ids; 0 where none was written.
struct Set {
  std::map<uint32_t, std::vector<uint64_t>> tensors;  ///< by binding, then element
  bool update_after_bind = false;

  Set() = default;
  /// `varying` is the count of the binding that has one of its own in each set.
  explicit Set(const SetLayout& layout, uint32_t varying = 0);
};

struct Pool {
  std::mutex mutex;
  std::set<VkDescriptorSet> sets;  ///< those with tensors
};

struct UpdateTemplate {
  std::vector<VkDescriptorUpdateTemplateEntry> entries;
  VkPipelineBindPoint point = VK_PIPELINE_BIND_POINT_COMPUTE;  ///< of one that pushes
  VkDescriptorUpdateTemplate below = VK_NULL_HANDLE;  ///< null where tensors are among the entries
};

/// Writes as the device below takes them, and those of tensors into `set_of(write)`, which may answer
/// null. Consecutive bindings are filled as Vulkan has it. Of layouts only those that the device knows are
/// left.
class SplitWrites {
 public:
  using SetOf = std::function<Set*(const VkWriteDescriptorSet&)>;
  SplitWrites(const Device& device, std::span<const VkWriteDescriptorSet> writes,
              const SetOf& set_of);
  std::span<const VkWriteDescriptorSet> below() const { return below_; }

 private:
  void translate_layouts(VkWriteDescriptorSet& write);

  std::vector<VkWriteDescriptorSet> below_;
  std::vector<std::vector<VkDescriptorImageInfo>> images_;
  std::vector<std::vector<VkDescriptorBufferInfo>> buffers_;
};

/// The writes that a template stands for, with the data at `data`.
class TemplateWrites {
 public:
  TemplateWrites(const UpdateTemplate& update, VkDescriptorSet set, const void* data);
  std::span<const VkWriteDescriptorSet> writes() const { return writes_; }

 private:
  template <typename T>
  const T* gather(std::vector<std::vector<T>>& lists, const VkDescriptorUpdateTemplateEntry& entry,
                  const void* data);
  std::vector<VkWriteDescriptorSet> writes_;
  std::vector<std::vector<VkDescriptorImageInfo>> images_;
  std::vector<std::vector<VkDescriptorBufferInfo>> buffers_;
  std::vector<std::vector<VkBufferView>> texels_;
  std::vector<std::vector<VkTensorViewARM>> views_;
  std::vector<std::unique_ptr<VkWriteDescriptorSetTensorARM>> tensors_;
  std::vector<std::unique_ptr<VkWriteDescriptorSetInlineUniformBlock>> inlines_;
};

}  // namespace shale::layer
