// compiler/plan/frame_segments.h -- segments of one dispatch: passes, copies and clears.
#pragma once

#include "compiler/plan/plan.h"
#include "compiler/target/profile.h"

namespace shale {

/// Appends the dispatch as a segment of its own, under `name` or one like it that is free, with the cost of its traffic.
void add_segment(Plan& plan, SegmentKind kind, uint32_t program, const std::string& name,
                 Dispatch dispatch, const DeviceProfile& profile);

/// What a transfer reads or writes, by the number of its end.
Binding transfer_end(uint32_t number, uint32_t resource, bool writes);

/// A copy between the host's image and the linear one that stands for it.
void add_copy(Plan& plan, uint32_t program, uint32_t from, uint32_t to,
              const DeviceProfile& profile);

}  // namespace shale
