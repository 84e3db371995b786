#include "runtime/vk/memory.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace shale::vk {
namespace {

constexpr VkMemoryPropertyFlags kMapped =
    VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;

struct KindFlags {
  VkMemoryPropertyFlags required;
  VkMemoryPropertyFlags preferred;
};

KindFlags kind_flags(MemoryKind kind) {
  switch (kind) {
    case MemoryKind::kDevice: return {0, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
    case MemoryKind::kUpload: return {kMapped, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
    case MemoryKind::kReadback: return {kMapped, VK_MEMORY_PROPERTY_HOST_CACHED_BIT};
  }
  return {};
}

/// `flags` as VkMemoryAllocateFlagsInfo has them.
Result<MemoryHandle> allocate_with(const Context& context, const VkMemoryRequirements& requirements,
                                   MemoryKind kind, VkMemoryAllocateFlags flags) {
  const auto [required, preferred] = kind_flags(kind);
  const std::optional<uint32_t> type =
      choose_memory_type(context.memory, requirements.memoryTypeBits, required, preferred);
  if (!type)
    return device_error(context.caps.name, "no memory type among {:#x} fits",
                        requirements.memoryTypeBits);
  auto flags_info = init<VkMemoryAllocateFlagsInfo>(VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO);
  flags_info.flags = flags;
  auto info = init<VkMemoryAllocateInfo>(VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO);
  if (flags != 0) info.pNext = &flags_info;
  info.allocationSize = requirements.size;
  info.memoryTypeIndex = *type;
  return make(context.vk.AllocateMemory, context.vk.FreeMemory, "vkAllocateMemory", context.device,
              info);
}

}  // namespace

std::optional<uint32_t> choose_memory_type(const VkPhysicalDeviceMemoryProperties& memory,
                                           uint32_t type_bits, VkMemoryPropertyFlags required,
                                           VkMemoryPropertyFlags preferred) {
  std::optional<uint32_t> chosen;
  int most = -1;
  for (uint32_t i = 0; i < memory.memoryTypeCount; ++i) {
    const VkMemoryPropertyFlags flags = memory.memoryTypes[i].propertyFlags;
    if (!((type_bits >> i) & 1u) || (flags & required) != required) continue;
    const int count = std::popcount(flags & preferred);
    if (count <= most) continue;
    most = count;
    chosen = i;
  }
  return chosen;
}

Result<MemoryHandle> allocate(const Context& context, const VkMemoryRequirements& requirements,
                              MemoryKind kind) {
  return allocate_with(context, requirements, kind, 0);
}

Result<Buffer> Buffer::create(const Context& context, uint64_t size_bytes, VkBufferUsageFlags usage,
                              MemoryKind kind) {
  auto info = init<VkBufferCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO);
  info.size = size_bytes;
  info.usage = usage;
  Buffer result;
  result.size_bytes_ = size_bytes;
  SHALE_TRY(result.buffer_, make(context.vk.CreateBuffer, context.vk.DestroyBuffer,
                                 "vkCreateBuffer", context.device, info));
  VkMemoryRequirements requirements;
  context.vk.GetBufferMemoryRequirements(context.device, result.get(), &requirements);
  result.memory_bytes_ = requirements.size;
  const VkMemoryAllocateFlags flags =
      usage & VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT ? VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT : 0;
  SHALE_TRY(result.memory_, allocate_with(context, requirements, kind, flags));
  SHALE_TRY_VOID(
      check(context.vk.BindBufferMemory(context.device, result.get(), result.memory_.get(), 0),
            "vkBindBufferMemory"));
  if (kind != MemoryKind::kDevice) {
    void* mapped = nullptr;
    SHALE_TRY_VOID(check(
        context.vk.MapMemory(context.device, result.memory_.get(), 0, VK_WHOLE_SIZE, 0, &mapped),
        "vkMapMemory"));
    result.mapped_ = static_cast<uint8_t*>(mapped);
  }
  return result;
}

Result<Upload> upload(const Context& context, std::span<const uint8_t> bytes, uint64_t size_bytes,
                      VkBufferUsageFlags usage) {
  const auto fill = [&](const Buffer& buffer) {
    std::memcpy(buffer.mapped().data(), bytes.data(), bytes.size());
    std::memset(buffer.mapped().data() + bytes.size(), 0, size_bytes - bytes.size());
  };
  Upload result;
  usage |= VK_BUFFER_USAGE_TRANSFER_DST_BIT;
  const bool host_writes_device_memory =
      choose_memory_type(context.memory, ~0u, kMapped | VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, 0)
          .has_value();
  if (host_writes_device_memory) {
    // That memory may be a small window which is used up; the staged way below remains.
    if (auto direct = Buffer::create(context, size_bytes, usage, MemoryKind::kUpload)) {
      fill(*direct);
      result.buffer = *std::move(direct);
      return result;
    }
  }
  SHALE_TRY(result.buffer, Buffer::create(context, size_bytes, usage, MemoryKind::kDevice));
  SHALE_TRY(result.staging, Buffer::create(context, size_bytes, VK_BUFFER_USAGE_TRANSFER_SRC_BIT,
                                           MemoryKind::kUpload));
  fill(result.staging);
  return result;
}

void record_upload(const Context& context, VkCommandBuffer commands, const Upload& upload) {
  const VkBufferCopy region{0, 0, upload.buffer.size_bytes()};
  context.vk.CmdCopyBuffer(commands, upload.staging.get(), upload.buffer.get(), 1, &region);
}

VkFormat vk_format(ImageFormat format) {
  constexpr std::array<VkFormat, kImageFormatCount> kFormats{
      VK_FORMAT_UNDEFINED,
      VK_FORMAT_R8G8B8A8_UNORM,
      VK_FORMAT_R16G16B16A16_SFLOAT,
      VK_FORMAT_R16G16_SFLOAT,
      VK_FORMAT_R32_SFLOAT,
      VK_FORMAT_R8_UNORM,
      VK_FORMAT_R32_UINT,
      VK_FORMAT_R32G32B32A32_SFLOAT,
      VK_FORMAT_R16_SFLOAT,
      VK_FORMAT_R8G8B8A8_SINT,
      VK_FORMAT_R8_SINT,
      VK_FORMAT_R8G8_UNORM,
      VK_FORMAT_R8G8B8A8_SNORM,
      VK_FORMAT_R32G32B32A32_UINT,
      VK_FORMAT_R32G32_UINT,
      VK_FORMAT_R16_UINT,
  };
  SHALE_CHECK(format != ImageFormat::kNone);
  return kFormats[static_cast<uint32_t>(format)];
}

Result<Image> Image::create(const Context& context, ImageFormat format, VkExtent2D extent,
                            VkImageUsageFlags usage) {
  usage |= VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT;
  VkImageFormatProperties limits;
  const VkResult supported = context.vk.GetPhysicalDeviceImageFormatProperties(
      context.physical_device, vk_format(format), VK_IMAGE_TYPE_2D, VK_IMAGE_TILING_OPTIMAL, usage,
      0, &limits);
  if (supported != VK_SUCCESS || extent.width > limits.maxExtent.width ||
      extent.height > limits.maxExtent.height)
    return device_error(context.caps.name, "allows no {} image of {}x{} with usage {:#x}",
                        image_format_info(format).name, extent.width, extent.height, usage);
  auto info = init<VkImageCreateInfo>(VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO);
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = vk_format(format);
  info.extent = {extent.width, extent.height, 1};
  info.mipLevels = 1;
  info.arrayLayers = 1;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  info.tiling = VK_IMAGE_TILING_OPTIMAL;
  info.usage = usage;
  info.initialLayout = VK_IMAGE_LAYOUT_UNDEFINED;
  Image result;
  result.extent_ = extent;
  SHALE_TRY(result.image_, make(context.vk.CreateImage, context.vk.DestroyImage, "vkCreateImage",
                                context.device, info));
  VkMemoryRequirements requirements;
  context.vk.GetImageMemoryRequirements(context.device, result.get(), &requirements);
  result.memory_bytes_ = requirements.size;
  SHALE_TRY(result.memory_, allocate(context, requirements, MemoryKind::kDevice));
  SHALE_TRY_VOID(
      check(context.vk.BindImageMemory(context.device, result.get(), result.memory_.get(), 0),
            "vkBindImageMemory"));
  auto view = init<VkImageViewCreateInfo>(VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO);
  view.image = result.get();
  view.viewType = VK_IMAGE_VIEW_TYPE_2D;
  view.format = info.format;
  view.subresourceRange = kWholeImage;
  SHALE_TRY(result.view_, make(context.vk.CreateImageView, context.vk.DestroyImageView,
                               "vkCreateImageView", context.device, view));
  return result;
}

}  // namespace shale::vk
