// tools/layer/tensor_shader.h -- shaders that read and write tensors, with buffers in their place.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "ir/base/result.h"

namespace shale::layer {

/// A binding of n tensors is one of 2n storage buffers below: element 2i holds the elements of tensor i,
/// element 2i + 1 its shape as 32-bit words (TensorShape).
inline constexpr uint32_t kBuffersOfTensor = 2;

/// Word 0: the rank; 1 to 6: sizes, outermost first; 7 to 12: elements from one index to the next.
inline constexpr uint32_t kShapeWords = 13, kFirstSizeWord = 1, kFirstStrideWord = 7;

/// True for modules with the capability of tensors, and not that of graphs.
bool has_tensors(std::span<const uint32_t> words);

/// The module with its tensor variables as storage buffers. Each read and write is a function that
/// checks its coordinates: outside of the tensor a read gives the operand for that or zero, a write does
/// nothing. Memory operands other than that value are dropped.
/// Errors: kBadInput for a broken module; kUnsupported for tensors that are passed to functions, and for
/// element types that buffers do not hold.
/// Source: SPV_ARM_tensors revision 2.
Result<std::vector<uint32_t>> lower_tensors(std::span<const uint32_t> words);

}  // namespace shale::layer
