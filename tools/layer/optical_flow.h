// tools/layer/optical_flow.h -- the node of VK_ARM_data_graph_optical_flow: the search of shaders/frame/flow between two
// pictures, which read the application's images through its own descriptor sets.
#pragma once

#include <set>

#include "tools/layer/descriptors.h"

namespace shale::layer {

/// An image of the node, in a set of the pipeline's layout.
struct FlowImage {
  uint32_t set = 0, binding = 0;
  VkDescriptorType type = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE;
};

struct FlowSource {
  uint32_t width = 0, height = 0;
  uint32_t grid = 1;  ///< 1, 2, 4 or 8 pixels each way for each vector
  bool gray = false;  ///< pictures have one component
  FlowImage input, reference, flow;
  std::optional<FlowImage> hint, cost;
};

/// Reads a create info that has a single node.
/// Errors: kBadInput for what breaks a rule, kUnsupported for what is not reported as supported.
Result<FlowSource> read_flow(const Device& device, const VkDataGraphPipelineCreateInfoARM& info,
                             const VkDataGraphPipelineSingleNodeCreateInfoARM& node);

/// The set of the layer's own behind those of the application: what lies in the memory of a session.
/// Errors: kDevice.
Result<vk::SetLayoutHandle> create_flow_set_layout(const Device& device);

/// The longest side of pictures: each of a session's buffers is a storage buffer of the device.
uint32_t max_flow_side(const Physical& physical);
/// Formats that images of the node may have for a usage.
std::span<const VkFormat> flow_formats(VkDataGraphOpticalFlowImageUsageFlagsARM usage);

class OpticalFlow {
 public:
  /// Errors: kDevice.
  static Result<std::unique_ptr<OpticalFlow>> create(const Device& device, const FlowSource& source,
                                                     std::shared_ptr<const PipelineLayout> layout,
                                                     VkPipelineCache cache);

  /// Of a session.
  uint64_t memory_bytes() const { return memory_bytes_; }
  /// Sets of the application that have to be bound.
  const std::set<uint32_t>& sets() const { return sets_; }

  /// A session's descriptors for its memory.
  class Bound {
   public:
    /// Errors: kDevice.
    static Result<Bound> create(const Device& device, const OpticalFlow& flow, VkBuffer memory);
    VkDescriptorSet set() const { return set_; }

   private:
    vk::DescriptorPoolHandle pool_;
    VkDescriptorSet set_ = VK_NULL_HANDLE;
  };
  /// Changes the bound compute pipeline and sets; a barrier has to stand before and behind it.
  void record(const Device& device, VkCommandBuffer commands, const Bound& bound,
              const std::map<uint32_t, VkDescriptorSet>& sets) const;

 private:
  struct Part {
    uint64_t offset = 0, bytes = 0;
  };
  struct Pass {
    vk::PipelineHandle pipeline;
    uint32_t width = 0, height = 0;  ///< invocations
    bool waits = true;               ///< for the pass before it
  };

  std::shared_ptr<const PipelineLayout> layout_;
  std::vector<Pass> passes_;
  std::vector<Part> parts_;  ///< by binding of the layer's own set
  std::set<uint32_t> sets_;
  uint64_t memory_bytes_ = 0;
};

}  // namespace shale::layer
