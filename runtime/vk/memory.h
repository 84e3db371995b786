// runtime/vk/memory.h -- buffers and images with memory of their own.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "ir/package/package.h"
#include "runtime/vk/device.h"
#include "runtime/vk/handle.h"

namespace shale::vk {

/// The first type among `type_bits` with all `required` properties and the most of the `preferred`
/// ones. Nothing if no type has the required ones.
std::optional<uint32_t> choose_memory_type(const VkPhysicalDeviceMemoryProperties& memory,
                                           uint32_t type_bits, VkMemoryPropertyFlags required,
                                           VkMemoryPropertyFlags preferred);

enum class MemoryKind {
  kDevice,  ///< for the device alone
  kUpload,  ///< written by the host, read by the device; in the device's own memory where possible
  kReadback,  ///< written by the device, read by the host; cached where possible
};

/// Errors: kDevice if no memory type fits or memory is exhausted.
Result<MemoryHandle> allocate(const Context& context, const VkMemoryRequirements& requirements,
                              MemoryKind kind);

/// A buffer with memory; kUpload and kReadback are mapped for life and coherent.
class Buffer {
 public:
  Buffer() = default;
  /// Errors: kDevice.
  static Result<Buffer> create(const Context& context, uint64_t size_bytes,
                               VkBufferUsageFlags usage, MemoryKind kind);

  VkBuffer get() const { return buffer_.get(); }
  explicit operator bool() const { return static_cast<bool>(buffer_); }
  uint64_t size_bytes() const { return size_bytes_; }
  /// What it takes of the device's memory.
  uint64_t memory_bytes() const { return memory_bytes_; }
  /// Empty for kDevice.
  std::span<uint8_t> mapped() const { return {mapped_, mapped_ ? size_bytes_ : 0}; }

 private:
  MemoryHandle memory_;  // freed after the buffer
  BufferHandle buffer_;
  uint64_t size_bytes_ = 0;
  uint64_t memory_bytes_ = 0;
  uint8_t* mapped_ = nullptr;
};

/// A buffer of the device, and where its content still has to come from.
struct Upload {
  Buffer buffer;
  /// Empty where the host could write the buffer itself. Else record_upload has to be recorded
  /// before the first use, and this has to stay until the device has done that.
  Buffer staging;
};

/// A buffer on the device that is to hold `bytes`, zeros behind them up to `size_bytes`; `usage`
/// gains VK_BUFFER_USAGE_TRANSFER_DST_BIT. Submits nothing.
/// Errors: kDevice.
Result<Upload> upload(const Context& context, std::span<const uint8_t> bytes, uint64_t size_bytes,
                      VkBufferUsageFlags usage);

/// Copies from the staging buffer, which must be there; barriers are the caller's.
void record_upload(const Context& context, VkCommandBuffer commands, const Upload& upload);

/// SHALE_CHECK on kNone.
VkFormat vk_format(ImageFormat format);

/// An image of one level and layer in optimal tiling, with memory and a view.
class Image {
 public:
  Image() = default;
  /// `usage` may gain bits that every format allows, so tools can clear and copy.
  /// Errors: kDevice if the format does not allow the usage or the extent, naming them.
  static Result<Image> create(const Context& context, ImageFormat format, VkExtent2D extent,
                              VkImageUsageFlags usage);

  VkImage get() const { return image_.get(); }
  VkImageView view() const { return view_.get(); }
  VkExtent2D extent() const { return extent_; }
  /// What it takes of the device's memory.
  uint64_t memory_bytes() const { return memory_bytes_; }

 private:
  MemoryHandle memory_;  // freed after the image
  ImageHandle image_;
  ImageViewHandle view_;
  VkExtent2D extent_{};
  uint64_t memory_bytes_ = 0;
};

/// The only level and layer of a colour image.
inline constexpr VkImageSubresourceRange kWholeImage{VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};

}  // namespace shale::vk
