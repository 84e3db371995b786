// tools/layer/specialize.h -- specialization constants of graph modules.
#pragma once

#include <vulkan/vulkan.h>

#include <cstdint>
#include <span>
#include <vector>

#include "ir/base/result.h"

namespace shale::layer {

/// Gives the scalar specialization constants of a module the values of `info`, which may be null. The
/// module may be anything: what is no instruction ends the search.
/// Errors: kBadInput for an entry that leaves the data or has another size than its constant.
Result<void> specialize(std::vector<uint32_t>& words, const VkSpecializationInfo* info);

}  // namespace shale::layer
