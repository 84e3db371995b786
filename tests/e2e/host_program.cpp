// tests/e2e/host_program.cpp -- how an application puts a package between its own passes.
//
// Everything Vulkan here is the application's: instance, device, queue, images, command buffer. One
// command buffer holds its first pass (which fills the input images), the frame loop, and its last
// pass (which reads the output images back); it is submitted once.
//
//   host_program --package FILE [--expect CHECKSUM]
//
// Prints a checksum of all output images. Exit codes: 0 done, 1 refused or another checksum than
// expected, 2 usage, 3 no usable device.
#include <vulkan/vulkan.h>

#include <bit>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "ir/base/file.h"
#include "ir/base/hash.h"
#include "ir/package/package.h"
#include "runtime/frame/frame_loop.h"
#include "runtime/vk/device.h"

namespace {

using shale::Category;
using shale::ImageFormat;

[[noreturn]] void stop(int code, const std::string& message) {
  std::fprintf(stderr, "host_program: %s\n", message.c_str());
  std::exit(code);
}

void check(VkResult result, const char* call) {
  if (result != VK_SUCCESS) stop(3, std::string(call) + ": " + std::to_string(result));
}

template <typename T>
T check(shale::Result<T> result) {
  if (!result) stop(1, result.error().text());
  return *std::move(result);
}

void check(const shale::Result<void>& result) {
  if (!result) stop(1, result.error().text());
}

/// Zeros but for the type.
template <typename T>
T typed(VkStructureType type) {
  T value{};
  value.sType = type;
  return value;
}

/// The application's device; destroyed in reverse order of creation at the end of main.
struct Application {
  VkInstance instance = VK_NULL_HANDLE;
  VkPhysicalDevice physical = VK_NULL_HANDLE;
  uint32_t family = 0;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  VkPhysicalDeviceMemoryProperties memory{};
};

std::optional<uint32_t> compute_family(VkPhysicalDevice physical) {
  uint32_t count = 0;
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, nullptr);
  std::vector<VkQueueFamilyProperties> families(count);
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, families.data());
  for (uint32_t i = 0; i < count; ++i)
    if (families[i].queueFlags & VK_QUEUE_COMPUTE_BIT) return i;
  return std::nullopt;
}

Application create_application() {
  Application app;
  auto application = typed<VkApplicationInfo>(VK_STRUCTURE_TYPE_APPLICATION_INFO);
  application.apiVersion = VK_API_VERSION_1_3;
  auto instance_info = typed<VkInstanceCreateInfo>(VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO);
  instance_info.pApplicationInfo = &application;
  check(vkCreateInstance(&instance_info, nullptr, &app.instance), "vkCreateInstance");

  uint32_t count = 0;
  vkEnumeratePhysicalDevices(app.instance, &count, nullptr);
  std::vector<VkPhysicalDevice> devices(count);
  vkEnumeratePhysicalDevices(app.instance, &count, devices.data());
  for (VkPhysicalDevice device : devices) {
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(device, &properties);
    const std::optional<uint32_t> family = compute_family(device);
    if (properties.apiVersion < VK_API_VERSION_1_3 || !family) continue;
    app.physical = device;
    app.family = *family;
    std::printf("device %s\n", properties.deviceName);
    break;
  }
  if (app.physical == VK_NULL_HANDLE) stop(3, "no Vulkan 1.3 device");
  vkGetPhysicalDeviceMemoryProperties(app.physical, &app.memory);

  // Whatever the device supports is enabled, so a package may use it all.
  auto v13 = typed<VkPhysicalDeviceVulkan13Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES);
  auto v12 = typed<VkPhysicalDeviceVulkan12Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES);
  auto v11 = typed<VkPhysicalDeviceVulkan11Features>(
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES);
  auto features = typed<VkPhysicalDeviceFeatures2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2);
  features.pNext = &v11;
  v11.pNext = &v12;
  v12.pNext = &v13;
  vkGetPhysicalDeviceFeatures2(app.physical, &features);
  features.features.robustBufferAccess = VK_FALSE;
  const float priority = 1.0f;
  auto queue_info = typed<VkDeviceQueueCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO);
  queue_info.queueFamilyIndex = app.family;
  queue_info.queueCount = 1;
  queue_info.pQueuePriorities = &priority;
  auto device_info = typed<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
  device_info.pNext = &features;
  device_info.queueCreateInfoCount = 1;
  device_info.pQueueCreateInfos = &queue_info;
  check(vkCreateDevice(app.physical, &device_info, nullptr, &app.device), "vkCreateDevice");
  vkGetDeviceQueue(app.device, app.family, 0, &app.queue);
  return app;
}

VkDeviceMemory allocate(const Application& app, const VkMemoryRequirements& needs,
                        VkMemoryPropertyFlags flags) {
  for (uint32_t i = 0; i < app.memory.memoryTypeCount; ++i) {
    if (!((needs.memoryTypeBits >> i) & 1u) ||
        (app.memory.memoryTypes[i].propertyFlags & flags) != flags)
      continue;
    auto info = typed<VkMemoryAllocateInfo>(VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO);
    info.allocationSize = needs.size;
    info.memoryTypeIndex = i;
    VkDeviceMemory memory = VK_NULL_HANDLE;
    check(vkAllocateMemory(app.device, &info, nullptr, &memory), "vkAllocateMemory");
    return memory;
  }
  stop(3, "no memory type fits");
}

VkFormat format_of(ImageFormat format) {
  switch (format) {
    case ImageFormat::kRgba8Unorm: return VK_FORMAT_R8G8B8A8_UNORM;
    case ImageFormat::kRgba16Float: return VK_FORMAT_R16G16B16A16_SFLOAT;
    case ImageFormat::kRg16Float: return VK_FORMAT_R16G16_SFLOAT;
    case ImageFormat::kR32Float: return VK_FORMAT_R32_SFLOAT;
    case ImageFormat::kR8Unorm: return VK_FORMAT_R8_UNORM;
    case ImageFormat::kR32Uint: return VK_FORMAT_R32_UINT;
    case ImageFormat::kRgba32Float: return VK_FORMAT_R32G32B32A32_SFLOAT;
    case ImageFormat::kR16Float: return VK_FORMAT_R16_SFLOAT;
    default: stop(1, "an image cannot have that format");
  }
}

/// An image of the application, and the host memory that it is filled from or copied to.
struct FrameImage {
  const shale::Resource* resource = nullptr;
  VkImage image = VK_NULL_HANDLE;
  VkDeviceMemory image_memory = VK_NULL_HANDLE;
  VkImageView view = VK_NULL_HANDLE;
  VkBuffer buffer = VK_NULL_HANDLE;
  VkDeviceMemory buffer_memory = VK_NULL_HANDLE;
  uint8_t* bytes = nullptr;
  size_t size = 0;
};

/// `usage`: what the package does with it.
FrameImage create_image(const Application& app, const shale::Resource& resource,
                        VkImageUsageFlags usage) {
  FrameImage result;
  result.resource = &resource;
  result.size = size_t{resource.width} * resource.height *
                shale::image_format_info(resource.format).texel_bytes;
  auto info = typed<VkImageCreateInfo>(VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO);
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = format_of(resource.format);
  info.extent = {resource.width, resource.height, 1};
  info.mipLevels = 1;
  info.arrayLayers = 1;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  info.usage = usage | VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT;
  check(vkCreateImage(app.device, &info, nullptr, &result.image), "vkCreateImage");
  VkMemoryRequirements needs;
  vkGetImageMemoryRequirements(app.device, result.image, &needs);
  result.image_memory = allocate(app, needs, 0);
  check(vkBindImageMemory(app.device, result.image, result.image_memory, 0), "vkBindImageMemory");
  auto view_info = typed<VkImageViewCreateInfo>(VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO);
  view_info.image = result.image;
  view_info.viewType = VK_IMAGE_VIEW_TYPE_2D;
  view_info.format = info.format;
  view_info.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
  if (usage & (VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT))
    check(vkCreateImageView(app.device, &view_info, nullptr, &result.view), "vkCreateImageView");

  auto buffer_info = typed<VkBufferCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO);
  buffer_info.size = result.size;
  buffer_info.usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
  check(vkCreateBuffer(app.device, &buffer_info, nullptr, &result.buffer), "vkCreateBuffer");
  vkGetBufferMemoryRequirements(app.device, result.buffer, &needs);
  result.buffer_memory = allocate(
      app, needs, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
  check(vkBindBufferMemory(app.device, result.buffer, result.buffer_memory, 0),
        "vkBindBufferMemory");
  void* mapped = nullptr;
  check(vkMapMemory(app.device, result.buffer_memory, 0, VK_WHOLE_SIZE, 0, &mapped), "vkMapMemory");
  result.bytes = static_cast<uint8_t*>(mapped);
  return result;
}

void destroy_image(const Application& app, const FrameImage& image) {
  vkDestroyBuffer(app.device, image.buffer, nullptr);
  vkFreeMemory(app.device, image.buffer_memory, nullptr);
  vkDestroyImageView(app.device, image.view, nullptr);
  vkDestroyImage(app.device, image.image, nullptr);
  vkFreeMemory(app.device, image.image_memory, nullptr);
}

/// level / 256 in half precision, exactly.
uint16_t half_of(uint32_t level) {
  if (level == 0) return 0;
  const auto exponent = static_cast<uint32_t>(std::bit_width(level)) - 1;
  const uint32_t mantissa = (level << (10 - exponent)) & 0x3ffu;
  return static_cast<uint16_t>((exponent + 15 - 8) << 10 | mantissa);
}

/// A pattern of levels 0..250, one per channel, as the format has them.
void fill(const FrameImage& image) {
  enum class Channel { kByte, kHalf, kFloat, kUint } channel = Channel::kByte;
  switch (image.resource->format) {
    case ImageFormat::kRgba16Float:
    case ImageFormat::kRg16Float:
    case ImageFormat::kR16Float: channel = Channel::kHalf; break;
    case ImageFormat::kR32Float:
    case ImageFormat::kRgba32Float: channel = Channel::kFloat; break;
    case ImageFormat::kR32Uint: channel = Channel::kUint; break;
    default: break;
  }
  const size_t step = channel == Channel::kByte ? 1 : channel == Channel::kHalf ? 2 : 4;
  for (size_t i = 0; i < image.size / step; ++i) {
    const auto level = static_cast<uint32_t>(i * 37 % 251);
    uint32_t bits = level;
    if (channel == Channel::kHalf) bits = half_of(level);
    if (channel == Channel::kFloat) bits = std::bit_cast<uint32_t>(static_cast<float>(level) / 256);
    std::memcpy(image.bytes + i * step, &bits, step);
  }
}

void image_barrier(VkCommandBuffer commands, VkImage image, VkPipelineStageFlags from,
                   VkAccessFlags written, VkImageLayout old_layout, VkPipelineStageFlags to,
                   VkAccessFlags used, VkImageLayout new_layout) {
  auto barrier = typed<VkImageMemoryBarrier>(VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER);
  barrier.srcAccessMask = written;
  barrier.dstAccessMask = used;
  barrier.oldLayout = old_layout;
  barrier.newLayout = new_layout;
  barrier.srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  barrier.image = image;
  barrier.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
  vkCmdPipelineBarrier(commands, from, to, 0, 0, nullptr, 0, nullptr, 1, &barrier);
}

VkBufferImageCopy whole(const FrameImage& image) {
  VkBufferImageCopy region{};
  region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
  region.imageExtent = {image.resource->width, image.resource->height, 1};
  return region;
}

/// Fills the input images, and makes the output images ready to be written.
void record_first_pass(VkCommandBuffer commands, const std::vector<FrameImage>& images) {
  for (const FrameImage& image : images) {
    if (image.resource->category == Category::kImageOutput) {
      image_barrier(commands, image.image, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, 0,
                    VK_IMAGE_LAYOUT_UNDEFINED, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                    VK_ACCESS_SHADER_WRITE_BIT, VK_IMAGE_LAYOUT_GENERAL);
      continue;
    }
    image_barrier(commands, image.image, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, 0,
                  VK_IMAGE_LAYOUT_UNDEFINED, VK_PIPELINE_STAGE_TRANSFER_BIT,
                  VK_ACCESS_TRANSFER_WRITE_BIT, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL);
    const VkBufferImageCopy region = whole(image);
    vkCmdCopyBufferToImage(commands, image.buffer, image.image,
                           VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &region);
    image_barrier(commands, image.image, VK_PIPELINE_STAGE_TRANSFER_BIT,
                  VK_ACCESS_TRANSFER_WRITE_BIT, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
                  VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_READ_BIT,
                  VK_IMAGE_LAYOUT_GENERAL);
  }
}

/// Copies the output images to host memory.
void record_last_pass(VkCommandBuffer commands, const std::vector<FrameImage>& images) {
  for (const FrameImage& image : images) {
    if (image.resource->category != Category::kImageOutput) continue;
    image_barrier(commands, image.image, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                  VK_ACCESS_SHADER_WRITE_BIT, VK_IMAGE_LAYOUT_GENERAL,
                  VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_READ_BIT,
                  VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL);
    const VkBufferImageCopy region = whole(image);
    vkCmdCopyImageToBuffer(commands, image.image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL,
                           image.buffer, 1, &region);
  }
  auto barrier = typed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  barrier.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
  barrier.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
  vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1,
                       &barrier, 0, nullptr, 0, nullptr);
}

/// Runs one frame of `package` between the application's passes; the checksum of the output images.
uint64_t run_frame(const Application& app, const shale::Package& package) {
  const shale::vk::Context context = check(shale::vk::wrap_device(
      app.physical, app.device, app.family, app.queue, shale::vk::snapshot_caps(app.physical)));
  shale::FrameLoop loop = check(shale::FrameLoop::create(context, package));
  std::vector<FrameImage> images;
  const shale::Variant& variant = loop.variant();
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const shale::Resource& resource = variant.resources[i];
    if (resource.category != Category::kImageInput && resource.category != Category::kImageOutput)
      continue;
    images.push_back(create_image(app, resource, loop.image_usage(resource.name)));
    if (resource.category == Category::kImageInput) fill(images.back());
    check(loop.bind_image(resource.name, {images.back().view,
                                          format_of(resource.format),
                                          {resource.width, resource.height},
                                          images.back().image}));
  }

  auto pool_info = typed<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
  pool_info.queueFamilyIndex = app.family;
  VkCommandPool pool = VK_NULL_HANDLE;
  check(vkCreateCommandPool(app.device, &pool_info, nullptr, &pool), "vkCreateCommandPool");
  auto buffer_info =
      typed<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
  buffer_info.commandPool = pool;
  buffer_info.commandBufferCount = 1;
  VkCommandBuffer commands = VK_NULL_HANDLE;
  check(vkAllocateCommandBuffers(app.device, &buffer_info, &commands), "vkAllocateCommandBuffers");
  const auto begin = typed<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
  check(vkBeginCommandBuffer(commands, &begin), "vkBeginCommandBuffer");
  record_first_pass(commands, images);
  check(loop.record(commands));
  record_last_pass(commands, images);
  check(vkEndCommandBuffer(commands), "vkEndCommandBuffer");

  auto submit = typed<VkSubmitInfo>(VK_STRUCTURE_TYPE_SUBMIT_INFO);
  submit.commandBufferCount = 1;
  submit.pCommandBuffers = &commands;
  check(vkQueueSubmit(app.queue, 1, &submit, VK_NULL_HANDLE), "vkQueueSubmit");
  check(vkQueueWaitIdle(app.queue), "vkQueueWaitIdle");

  uint64_t checksum = shale::kHashSeed;
  for (const FrameImage& image : images)
    if (image.resource->category == Category::kImageOutput)
      checksum = shale::stable_hash({image.bytes, image.size}, checksum);
  vkDestroyCommandPool(app.device, pool, nullptr);
  for (const FrameImage& image : images) destroy_image(app, image);
  return checksum;
}

}  // namespace

int main(int argc, char** argv) {
  std::string path;
  std::string expected;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::strcmp(argv[i], "--package") == 0) path = argv[i + 1];
    if (std::strcmp(argv[i], "--expect") == 0) expected = argv[i + 1];
  }
  if (path.empty()) stop(2, "usage: host_program --package FILE [--expect CHECKSUM]");
  const std::vector<uint8_t> bytes = check(shale::read_file(path));
  const shale::Package package = check(shale::read_package(bytes));

  const Application app = create_application();
  const uint64_t checksum = run_frame(app, package);
  vkDestroyDevice(app.device, nullptr);
  vkDestroyInstance(app.instance, nullptr);

  char text[17];
  std::snprintf(text, sizeof(text), "%016llx", static_cast<unsigned long long>(checksum));
  std::printf("checksum %s\n", text);
  if (!expected.empty() && expected != text) stop(1, "expected the checksum " + expected);
  return 0;
}
