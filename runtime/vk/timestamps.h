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
  /// Ends an interval and begins the next one. At most `intervals` times after each start.
  void mark(VkCommandBuffer commands);

  /// Microseconds of each interval, in order. The command buffer must have been submitted.
  /// Waits until it is done.
  /// Errors: kDevice.
  Result<std::vector<double>> read_us() const;

 private:
  VkDevice device_ = VK_NULL_HANDLE;
  QueryPoolHandle pool_;
  uint32_t capacity_ = 0;
  uint32_t used_ = 0;
  uint64_t mask_ = 0;
  double period_us_ = 0;
};

}  // namespace shale::vk
