// compiler/frontend/vgf/formats.h -- element types of tensors as formats of Vulkan.
#pragma once

#include "ir/base/dtype.h"

namespace shale {

/// The format of packed tensors of a type in host memory (dtype_info::host_bytes); 0 for kUnknown
/// and kShape, which no resource has.
/// Source: VK_ARM_tensors; the 64-bit integer holds INT48, as in SPIR-V graphs.
uint32_t vk_format_of_dtype(DType dtype);

/// The type that SPIR-V graphs have for a format of one channel: signedness is the operators'
/// matter there. kUnknown for other formats.
DType dtype_of_vk_format(uint32_t format);

}  // namespace shale
