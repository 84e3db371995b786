// runtime/datagraph/late_pipelines.h -- pipelines that are made after the first record: by threads of their own, or when
// the host says so. Not part of the public interface.
#pragma once

#include <vulkan/vulkan.h>

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "ir/package/package.h"
#include "runtime/datagraph/end_at_exit.h"
#include "runtime/vk/device.h"
#include "runtime/vk/handle.h"

namespace shale {

class DriverCode;

/// Errors: kDevice.
Result<vk::PipelineHandle> create_pipeline(const vk::Context& context, const Spirv& words,
                                           VkPipelineLayout layout, VkPipelineCache cache,
                                           VkPipelineCreateFlags flags = 0);

/// A pipeline to be made.
struct LateJob {
  Spirv words;
  VkPipelineLayout layout = VK_NULL_HANDLE;
  const Segment* segment = nullptr;    ///< of the variant, as is the dispatch
  const Dispatch* dispatch = nullptr;  ///< the first one that it serves
  double gain_us = 0;                  ///< predicted for a run, over the start form
};

class LatePipelines {
 public:
  /// Jobs that gain the most for their code come first. `variant`, the layouts and the cache must outlive this. Without
  /// threads nothing happens until compile_one. Threads begin with the second record, or after some seconds: the first
  /// result's compilation has the processors for itself.
  LatePipelines(const vk::Context& context, const Variant& variant, uint64_t weight_bytes,
                std::vector<LateJob> jobs, VkPipelineCache cache, size_t threads);
  /// Waits for the pipelines that are being made, and for no others.
  ~LatePipelines();

  /// A record is being made.
  void note_record();
  /// The pipeline of a job, in the order given, for a record that is being made; null until it is there. A record takes
  /// one that no record took before only if `may_take`, which is false then: a driver may compile at a pipeline's first
  /// dispatch, and a frame should not wait for more than one.
  VkPipeline take(size_t job, bool& may_take);

  size_t count() const { return jobs_.size(); }
  /// That are not there yet; of those that the driver refused, too.
  size_t left() const { return left_; }
  /// Makes one on this thread; false if none is left that nobody makes.
  /// Errors: kDevice.
  Result<bool> compile_one();
  /// Until all are there, this thread at work too; from then on records take all of them.
  /// Errors: the first one, of any thread.
  Result<void> finish();

 private:
  struct Made {
    vk::PipelineHandle handle;
    std::atomic<VkPipeline> pipeline{VK_NULL_HANDLE};
    std::atomic<bool> taken = false;
  };
  void work();
  void begin();
  void end();
  Result<void> compile(size_t job, std::unique_ptr<DriverCode>& code);
  std::optional<size_t> next_job();

  const vk::Context context_;
  const Variant& variant_;
  const uint64_t weight_bytes_;
  const VkPipelineCache cache_;
  std::vector<LateJob> jobs_;
  std::vector<size_t> order_;  // of the jobs
  std::vector<Made> made_;     // by job

  std::mutex mutex_;
  std::condition_variable all_made_, begin_;
  size_t next_ = 0;     // in order_
  size_t working_ = 0;  // jobs that are being made
  uint64_t records_ = 0;
  Result<void> first_error_;
  std::atomic<size_t> left_;
  std::atomic<bool> stop_ = false;
  std::vector<std::thread> threads_;
  EndAtExit end_at_exit_;  // goes first
};

}  // namespace shale
