// runtime/vk/commands.h -- command buffers for work that is submitted once and waited for.
#pragma once

#include <vulkan/vulkan.h>

#include <functional>

#include "ir/base/result.h"
#include "runtime/vk/device.h"

namespace shale::vk {

/// Records with `record`, submits to the context's queue, which must be an own device's, and waits
/// until it is done. For tools; pipelines and loops submit nothing.
/// Errors: kDevice.
Result<void> submit_and_wait(const Context& context,
                             const std::function<void(VkCommandBuffer)>& record);

/// A memory barrier between commands recorded before and after it, without layout changes.
void memory_barrier(const Context& context, VkCommandBuffer commands, VkPipelineStageFlags from,
                    VkAccessFlags written, VkPipelineStageFlags to, VkAccessFlags used);

}  // namespace shale::vk
