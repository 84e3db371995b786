// tools/layer/tensor.h -- tensors of VK_ARM_tensors: buffers of the device below.
//
// Both tilings are row-major, as the strides say or packed, so a tensor is a range of bytes.
#pragma once

#include <array>
#include <string>

#include "ir/base/dtype.h"
#include "runtime/vk/memory.h"
#include "tools/layer/layer.h"

namespace shale::layer {

inline constexpr uint32_t kMaxTensorRank = 6;

/// Usage of the buffers behind tensors: what kernels and copies need.
inline constexpr VkBufferUsageFlags kTensorUsage =
    VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT |
    VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;

/// The same, and an address where descriptors may lie in buffers.
VkBufferUsageFlags tensor_usage(const Device& device);

/// Bytes of an element; 0 for a format that tensors cannot have.
uint32_t tensor_element_bytes(VkFormat format);

/// The element type in graphs of a format; kUnknown if graphs have none.
DType graph_dtype(VkFormat format);

/// A VkTensorDescriptionARM that was looked at: sizes of axes, and bytes from one index of an axis to
/// the next, outermost first.
struct TensorLayout {
  VkTensorTilingARM tiling = VK_TENSOR_TILING_OPTIMAL_ARM;
  VkFormat format = VK_FORMAT_UNDEFINED;
  VkTensorUsageFlagsARM usage = 0;
  std::vector<int64_t> dims;
  std::vector<int64_t> strides;
  bool packed = true;

  uint64_t elements() const;
  /// From the first byte to behind the last.
  uint64_t size_bytes() const;
  /// Of the buffer behind it: a range of buffer descriptors ends with a whole word.
  uint64_t buffer_bytes() const { return (size_bytes() + 3) / 4 * 4; }
};

/// A tensor that may be aliased with an image lies as the device's linear images do, whose rows may be
/// padded.
/// Errors: kBadInput for what breaks a rule of the extension or a limit of the device, naming it;
/// kUnsupported for what is not reported.
Result<TensorLayout> read_layout(const VkTensorDescriptionARM& description, const Device& device);

/// Where the shape of a tensor lies for shaders (tensor_shader.h).
struct ShapeSlot {
  VkBuffer buffer = VK_NULL_HANDLE;  ///< null without shaders that access tensors
  uint64_t offset = 0;
  uint32_t* words = nullptr;
};

/// Slots in buffers that the host writes; any number of threads.
class ShapeSlots {
 public:
  explicit ShapeSlots(const Device& device) : device_(device) {}
  /// Errors: kDevice.
  Result<ShapeSlot> take(const TensorLayout& layout);
  void give_back(const ShapeSlot& slot);

 private:
  const Device& device_;
  std::mutex mutex_;
  std::vector<vk::Buffer> buffers_;
  std::vector<ShapeSlot> free_;
};

struct Tensor {
  uint64_t id = 0;  ///< never used again, as handles are
  VkTensorCreateFlagsARM flags = 0;
  TensorLayout layout;
  VkBuffer buffer = VK_NULL_HANDLE;
  ShapeSlot shape = {};
  bool bound = false;
};

struct TensorView {
  uint64_t tensor = 0;  ///< id
  VkFormat format = VK_FORMAT_UNDEFINED;
};

inline Tensor* tensor_of(VkTensorARM handle) { return reinterpret_cast<Tensor*>(handle); }
inline TensorView* view_of(VkTensorViewARM handle) { return reinterpret_cast<TensorView*>(handle); }

/// Records the copy of all elements between two layouts of equal sizes and element size.
void record_copy(const Device& device, VkCommandBuffer commands, VkBuffer from,
                 const TensorLayout& from_layout, VkBuffer to, const TensorLayout& to_layout);

}  // namespace shale::layer
