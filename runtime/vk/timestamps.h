// runtime/vk/timestamps.h -- device times between points of a command buffer.
#pragma once

#include <cstdint>
#include <vector>

#include "runtime/vk/device.h"
#include "runtime/vk/handle.h"

namespace shale::vk {

/// One start and up to `intervals` marks. A mark is taken when all commands recorded before it are
/// done, so an interval of a command that overlaps its neighbours holds part of theirs; the sum is
/// always right.
class Timestamps {
 public:
  /// Errors: kUnsupported if the queue family has no timestamps, kDevice.
  static Result<Timestamps> create(const Context& context, uint32_t intervals);

  /// Forgets earlier marks and starts. Outside of a render pass.
  void start(VkCommandBuffer commands);
  /// Ends an interval and begins the next one. More than `intervals` times after a start it does
  /// nothing, and read_us says so.
  void mark(VkCommandBuffer commands);

  /// The `intervals` of create.
  uint32_t intervals() const { return capacity_ - 1; }

  /// Microseconds of each interval, in order. The command buffer must have been submitted.
  /// Waits until it is done.
  /// Errors: kBadInput if there were more marks than intervals; kDevice.
  Result<std::vector<double>> read_us() const;

 private:
  Functions vk_;
  VkDevice device_ = VK_NULL_HANDLE;
  QueryPoolHandle pool_;
  uint32_t capacity_ = 1;
  uint32_t used_ = 0;  // marks and the start, also those beyond the capacity
  uint64_t mask_ = 0;
  double period_us_ = 0;
};

}  // namespace shale::vk
