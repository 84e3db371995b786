// runtime/profile/profile.h -- measured device time per dispatch, under the names of the package.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "ir/package/package.h"
#include "runtime/vk/timestamps.h"

namespace shale {

struct DispatchTime {
  std::string name;  ///< Dispatch::name: the key to the predicted cost
  std::string kernel;
  std::string segment;
  double time_us = 0;
};

/// Number of intervals that recording `segments` takes.
uint32_t interval_count(std::span<const Segment> segments);

/// What `timestamps` measured while `segments` were recorded: all segments of a variant by
/// FrameLoop::record, the graph by Session::record. Waits for the device. See vk::Timestamps for
/// what the time of a dispatch means that overlaps others.
/// Errors: kBadInput if the numbers of intervals and dispatches differ; kDevice.
Result<std::vector<DispatchTime>> measured_times(const vk::Timestamps& timestamps,
                                                 std::span<const Segment> segments);

}  // namespace shale
