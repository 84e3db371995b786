#include "runtime/profile/profile.h"

namespace shale {

uint32_t interval_count(std::span<const Segment> segments) {
  size_t count = 0;
  for (const Segment& segment : segments) count += segment.dispatches.size();
  return static_cast<uint32_t>(count);
}

Result<std::vector<DispatchTime>> measured_times(const vk::Timestamps& timestamps,
                                                 std::span<const Segment> segments) {
  SHALE_TRY(const std::vector<double> intervals, timestamps.read_us());
  if (intervals.size() != interval_count(segments))
    return bad_input("", "{} intervals were measured, expected {} dispatches", intervals.size(),
                     interval_count(segments));
  std::vector<DispatchTime> times;
  for (const Segment& segment : segments)
    for (const Dispatch& dispatch : segment.dispatches)
      times.push_back({dispatch.name, dispatch.kernel, segment.name, intervals[times.size()]});
  return times;
}

}  // namespace shale
