// tools/layer/device_features.h -- features of devices on which the layer's extensions are enabled.
#pragma once

#include "tools/layer/chain.h"
#include "tools/layer/layer.h"

namespace shale::layer {

/// Errors: kUnsupported, naming a feature of the layer's extensions that is asked for and not there.
Result<void> check_features(const Physical& physical, const VkDeviceCreateInfo& info);

/// True if tensors may lie in descriptor buffers, of shaders or of graphs.
bool asks_descriptor_buffers(const VkDeviceCreateInfo& info);

/// Turns on what kernels may use and the device has: in the structures that the application chained,
/// of which `chain` is a copy, or in new ones, never in both. `features` is where those of Vulkan 1.0 go
/// if the application gave them beside the chain, or not at all.
void add_kernel_features(const Physical& physical, VkDeviceCreateInfo& info,
                         VkPhysicalDeviceFeatures& features, ChainCopy& chain);

}  // namespace shale::layer
