// runtime/datagraph/dispatch.h -- what sessions and frame loops share: the compute pipelines of a
// variant, the descriptor sets of its dispatches, and their recording. Not part of the public
// interface.
#pragma once

#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "ir/package/package.h"
#include "runtime/datagraph/barriers.h"
#include "runtime/datagraph/driver_code.h"
#include "runtime/datagraph/late_pipelines.h"
#include "runtime/datagraph/session.h"
#include "runtime/vk/device.h"
#include "runtime/vk/handle.h"
#include "runtime/vk/memory.h"
#include "runtime/vk/timestamps.h"

namespace shale {

/// Bytes of a buffer that holds a pool of tensors: room for the last one's last word.
inline constexpr uint64_t padded_bytes(uint64_t pool_bytes) {
  return (pool_bytes + kBufferAlignment - 1) / kBufferAlignment * kBufferAlignment;
}

inline constexpr bool is_host_image(Category category) {
  return category == Category::kImageInput || category == Category::kImageOutput;
}
/// A graph's input or output.
inline constexpr bool is_graph_tensor(Category category) {
  return category == Category::kInput || category == Category::kOutput;
}

/// A dispatch ready to be recorded; handles belong to Kernels.
struct Step {
  const Dispatch* dispatch = nullptr;
  VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
  VkPipelineLayout layout = VK_NULL_HANDLE;
  VkPipeline pipeline = VK_NULL_HANDLE;  ///< null while a start form serves
  bool takes_params = false;             ///< its layout has the variant's push constants
  bool is_transfer = false;              ///< has no handles
  bool barrier_before = false;
  const Segment* segment = nullptr;  ///< that it belongs to
  bool is_first = false;             ///< of its segment
  const Step* start = nullptr;       ///< what serves until the pipeline is there
  size_t late_job = 0;               ///< with `start`: that of Kernels::late()
};

/// Which segments of a variant are made ready: those of each program that is to be recorded, which
/// are a part of the variant's.
/// Errors: its own.
using Selection = std::function<Result<std::vector<std::span<const Segment>>>(const Variant&)>;

/// Where pipelines are looked up and left, or null; and when those behind start forms are made.
struct PipelineOptions {
  VkPipelineCache cache = VK_NULL_HANDLE;
  Compile compile = Compile::kAtOnce;
  uint32_t threads = 0;  ///< as in DataGraphPipelineOptions, as is the next one
  bool update_after_bind = false;
};

/// One variant of a package on a device. Its address is kept by what is made from it.
class Kernels {
 public:
  /// Takes the best variant that the device meets (rank.h), creates one pipeline per unique module and
  /// descriptor layout, on all cores, but for those that come late, and gets the weights ready. Submits nothing.
  /// Errors: kBadInput (check_package), those of `select`, kDevice (no variant fits, telling why
  /// for each; or the device refuses).
  static Result<std::unique_ptr<Kernels>> create(const vk::Context& context, const Package& package,
                                                 const Selection& select,
                                                 const PipelineOptions& options);

  const vk::Context& context() const { return context_; }
  /// Without the words of its modules.
  const Variant& variant() const { return variant_; }
  size_t program_count() const { return program_begins_.size() - 1; }
  /// The dispatches of a program, in order, with the barriers between them.
  std::span<const Step> steps(size_t program) const {
    return std::span(steps_).subspan(program_begins_[program],
                                     program_begins_[program + 1] - program_begins_[program]);
  }
  VkBuffer weights() const { return weights_.buffer.get(); }

  /// Once, from any thread: records the copy of the weights to where the host cannot write, with
  /// the barrier behind it. Later calls, or if nothing is to copy, do nothing and return false.
  bool record_upload(VkCommandBuffer commands) const;
  /// Ends what record_upload left to copy from: the device is done with it.
  void release_staging() { weights_.staging = {}; }
  const vk::Upload& weight_memory() const { return weights_; }

  /// A barrier between earlier and later steps, for all that they do.
  void barrier(VkCommandBuffer commands) const;
  /// True if there are transfers among the steps.
  bool has_transfers() const { return has_transfers_; }
  /// True if segments of the steps have Tiles.
  bool has_tiles() const { return has_tiles_; }

  /// Pipelines that come after the first record; null if there are none.
  LatePipelines* late() const { return late_.get(); }
  /// As DataGraphPipeline has them.
  size_t left() const { return late_ ? late_->left() : 0; }
  Result<bool> compile_one() const { return late_ ? late_->compile_one() : false; }
  Result<void> finish() const { return late_ ? late_->finish() : Result<void>(); }

  /// Descriptor sets may be written when they are recorded, if they are not pending.
  bool update_after_bind() const { return update_after_bind_; }

  /// Offsets of caller's buffers must be multiples of this.
  uint64_t tensor_alignment() const;

 private:
  Kernels() = default;
  struct Wanted {
    const Segment* segment;
    const Dispatch* dispatch;
    uint32_t push_bytes;
    const Dispatch* start = nullptr;  ///< its start form
  };
  Result<void> create_pipelines(const Package& package, const Variant& variant,
                                std::span<const Wanted> dispatches, const PipelineOptions& options);

  vk::Context context_;
  Variant variant_;
  vk::Upload weights_;
  mutable std::atomic_flag upload_recorded_;
  vk::SamplerHandle sampler_;  // empty if no dispatch has one
  std::vector<vk::SetLayoutHandle> set_layouts_;
  std::vector<vk::PipelineLayoutHandle> layouts_;
  std::vector<vk::PipelineHandle> pipelines_;
  std::vector<Step> steps_;             // program by program
  std::vector<size_t> program_begins_;  // in steps_, and the end
  bool has_transfers_ = false;
  bool has_indirect_ = false;
  bool has_tiles_ = false;
  bool update_after_bind_ = false;
  std::deque<Step> starts_;              // what serves in place of steps
  std::unique_ptr<CodeAhead> ahead_;     // as does this: it uses the variant
  std::unique_ptr<LatePipelines> late_;  // goes first: its threads use the layouts
};

/// What a binding leads to: a buffer from `offset` on, or an image in VK_IMAGE_LAYOUT_GENERAL: its
/// view for shaders, itself for transfers.
struct Target {
  VkBuffer buffer = VK_NULL_HANDLE;
  uint64_t offset = 0;
  VkImageView view = VK_NULL_HANDLE;
  VkImage image = VK_NULL_HANDLE;
};
using TargetOf = std::function<Target(const Binding&)>;

/// Descriptor sets, one for each of the steps given to create.
class DescriptorSets {
 public:
  /// `steps` are no transfers.
  /// Errors: kDevice.
  static Result<DescriptorSets> create(const Kernels& kernels, std::span<const Step* const> steps);

  /// Points set `index` at what `target` answers for each binding of its dispatch. No pending
  /// command buffer may use the set.
  /// Errors: kDevice.
  Result<void> write(size_t index, const TargetOf& target);

  VkDescriptorSet operator[](size_t index) const { return sets_[index]; }

 private:
  const Kernels* kernels_ = nullptr;
  vk::DescriptorPoolHandle pool_;
  std::vector<const Step*> steps_;
  std::vector<VkDescriptorSet> sets_;                           // freed with their pool
  std::vector<std::vector<vk::BufferViewHandle>> texel_views_;  // by set
};

/// The descriptor sets of a step and, if it has one, of its start form.
struct StepSets {
  VkDescriptorSet own = VK_NULL_HANDLE, start = VK_NULL_HANDLE;
};

/// Records steps of `kernels` in order, each with its set and the barrier before it; `params`
/// are the push constants of steps that take them, `target` answers for the ends of transfers and for Tiles,
/// `timestamps` may be null and otherwise is started and marked after each step. Segments with Tiles run all that
/// they have if `runs_all`.
void record_steps(VkCommandBuffer commands, const Kernels& kernels, std::span<const Step> steps,
                  std::span<const StepSets> sets, std::span<const uint8_t> params,
                  const TargetOf& target, bool runs_all, vk::Timestamps* timestamps);

/// Errors: kBadInput if there are timestamps of fewer intervals than steps.
Result<void> check_timestamps(const vk::Timestamps* timestamps, size_t steps);

/// Index of the best variant that a device with `caps` can run.
/// Errors: kDevice, telling what is missing for each variant.
Result<uint32_t> choose_variant(const Package& package, const DeviceCaps& caps);

}  // namespace shale
