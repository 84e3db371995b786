/* tests/e2e/host_program.c -- how an engine puts a package between its own passes, in plain C.
 *
 * Everything Vulkan here is the program's: instance, device, queue, images, command buffers,
 * fences. Each frame is one command buffer: the program's first pass (which fills the input
 * images), every program of the package, and the last pass (which reads the output images back).
 * Frames are run twice: one by one, and with two pending on the queue at once; both have to give
 * the same images.
 *
 *   host_program --package FILE [--expect CHECKSUM]
 *
 * Prints a checksum of the first frame's output images. Exit codes: 0 done, 1 refused or other
 * images than expected, 2 usage, 3 no usable device.
 */
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vulkan.h>

#include "runtime/shale.h"

enum { kInFlight = 2, kFrames = 8, kResetBefore = 5, kMaxImages = 32 };

_Noreturn static void stop(int code, const char* format, ...) {
  va_list arguments;
  va_start(arguments, format);
  fputs("host_program: ", stderr);
  vfprintf(stderr, format, arguments);
  fputc('\n', stderr);
  va_end(arguments);
  exit(code);
}

static void check_vk(VkResult result, const char* call) {
  if (result != VK_SUCCESS) stop(3, "%s: %d", call, (int)result);
}

static ShaleError last = {.struct_size = sizeof(ShaleError)};

static void check(ShaleResult result) {
  if (result != SHALE_OK) stop(1, "%s", last.text);
}

/* ---- The program's device */

typedef struct Application {
  VkInstance instance;
  VkPhysicalDevice physical;
  uint32_t family;
  VkDevice device;
  VkQueue queue;
  VkPhysicalDeviceMemoryProperties memory;
  ShaleDevice* shale;
} Application;

static bool find_compute_family(VkPhysicalDevice physical, uint32_t* family) {
  VkQueueFamilyProperties families[32];
  uint32_t count = 32;
  vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, families);
  for (*family = 0; *family < count; ++*family)
    if (families[*family].queueFlags & VK_QUEUE_COMPUTE_BIT) return true;
  return false;
}

static void find_device(Application* app) {
  VkPhysicalDevice devices[16];
  uint32_t count = 16;
  const VkResult found = vkEnumeratePhysicalDevices(app->instance, &count, devices);
  if (found != VK_INCOMPLETE) check_vk(found, "vkEnumeratePhysicalDevices");
  for (uint32_t i = 0; i < count; ++i) {
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(devices[i], &properties);
    if (properties.apiVersion < VK_API_VERSION_1_3 ||
        !find_compute_family(devices[i], &app->family))
      continue;
    app->physical = devices[i];
    printf("device %s\n", properties.deviceName);
    return;
  }
  stop(3, "no Vulkan 1.3 device");
}

static Application create_application(void) {
  Application app = {0};
  const VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
                                         .apiVersion = VK_API_VERSION_1_3};
  const VkInstanceCreateInfo instance_info = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
                                              .pApplicationInfo = &application};
  check_vk(vkCreateInstance(&instance_info, NULL, &app.instance), "vkCreateInstance");
  find_device(&app);
  vkGetPhysicalDeviceMemoryProperties(app.physical, &app.memory);

  /* Whatever the device supports is enabled, so a package may use it all. */
  VkPhysicalDeviceVulkan13Features v13 = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES};
  VkPhysicalDeviceVulkan12Features v12 = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, .pNext = &v13};
  VkPhysicalDeviceVulkan11Features v11 = {
      .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES, .pNext = &v12};
  VkPhysicalDeviceFeatures2 features = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2,
                                        .pNext = &v11};
  vkGetPhysicalDeviceFeatures2(app.physical, &features);
  features.features.robustBufferAccess = VK_FALSE;
  const float priority = 1.0f;
  const VkDeviceQueueCreateInfo queue_info = {.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
                                              .queueFamilyIndex = app.family,
                                              .queueCount = 1,
                                              .pQueuePriorities = &priority};
  const VkDeviceCreateInfo device_info = {.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
                                          .pNext = &features,
                                          .queueCreateInfoCount = 1,
                                          .pQueueCreateInfos = &queue_info};
  check_vk(vkCreateDevice(app.physical, &device_info, NULL, &app.device), "vkCreateDevice");
  vkGetDeviceQueue(app.device, app.family, 0, &app.queue);

  const ShaleDeviceInfo info = {.struct_size = sizeof(info),
                                .queue_family = app.family,
                                .instance = app.instance,
                                .physical_device = app.physical,
                                .device = app.device,
                                .get_instance_proc_addr = vkGetInstanceProcAddr,
                                .get_device_proc_addr = vkGetDeviceProcAddr,
                                .create_info = &device_info};
  check(shale_device_create(&info, &app.shale, &last));
  return app;
}

static void destroy_application(const Application* app) {
  shale_device_destroy(app->shale);
  vkDestroyDevice(app->device, NULL);
  vkDestroyInstance(app->instance, NULL);
}

static VkDeviceMemory allocate(const Application* app, VkMemoryRequirements needs,
                               VkMemoryPropertyFlags flags) {
  for (uint32_t i = 0; i < app->memory.memoryTypeCount; ++i) {
    if (!((needs.memoryTypeBits >> i) & 1u) ||
        (app->memory.memoryTypes[i].propertyFlags & flags) != flags)
      continue;
    const VkMemoryAllocateInfo info = {.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
                                       .allocationSize = needs.size,
                                       .memoryTypeIndex = i};
    VkDeviceMemory memory = VK_NULL_HANDLE;
    check_vk(vkAllocateMemory(app->device, &info, NULL, &memory), "vkAllocateMemory");
    return memory;
  }
  stop(3, "no memory type fits");
}

/* ---- Images */

typedef enum Channel { kByte, kHalf, kFloat, kUint } Channel;

typedef struct Format {
  VkFormat format;
  Channel channel;
  uint32_t channels;
} Format;

static Format format_info(VkFormat format) {
  static const Format kFormats[] = {
      {VK_FORMAT_R8G8B8A8_UNORM, kByte, 4},       {VK_FORMAT_R8G8B8A8_SNORM, kByte, 4},
      {VK_FORMAT_R8G8_UNORM, kByte, 2},           {VK_FORMAT_R8_UNORM, kByte, 1},
      {VK_FORMAT_R16G16B16A16_SFLOAT, kHalf, 4},  {VK_FORMAT_R16G16_SFLOAT, kHalf, 2},
      {VK_FORMAT_R16_SFLOAT, kHalf, 1},           {VK_FORMAT_R32_SFLOAT, kFloat, 1},
      {VK_FORMAT_R32G32B32A32_SFLOAT, kFloat, 4}, {VK_FORMAT_R32_UINT, kUint, 1},
      {VK_FORMAT_R32G32B32A32_UINT, kUint, 4},
  };
  for (size_t i = 0; i < sizeof(kFormats) / sizeof(kFormats[0]); ++i)
    if (kFormats[i].format == format) return kFormats[i];
  stop(1, "an image has VkFormat %d", (int)format);
}

static size_t channel_bytes(Channel channel) {
  return channel == kByte ? 1 : channel == kHalf ? 2 : 4;
}

/* An image of the program, and the host memory that it is filled from or copied to. */
typedef struct FrameImage {
  ShaleImageInfo info;
  VkImage image;
  VkDeviceMemory image_memory;
  VkImageView view;
  VkBuffer buffer;
  VkDeviceMemory buffer_memory;
  uint8_t* bytes;
  size_t size;
} FrameImage;

static FrameImage create_image(const Application* app, const ShaleImageInfo* wanted) {
  FrameImage result = {.info = *wanted};
  const Format format = format_info(wanted->format);
  result.size = (size_t)wanted->extent.width * wanted->extent.height * format.channels *
                channel_bytes(format.channel);
  const VkImageCreateInfo info = {
      .sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO,
      .imageType = VK_IMAGE_TYPE_2D,
      .format = wanted->format,
      .extent = {wanted->extent.width, wanted->extent.height, 1},
      .mipLevels = 1,
      .arrayLayers = 1,
      .samples = VK_SAMPLE_COUNT_1_BIT,
      .usage = wanted->usage | VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT};
  check_vk(vkCreateImage(app->device, &info, NULL, &result.image), "vkCreateImage");
  VkMemoryRequirements needs;
  vkGetImageMemoryRequirements(app->device, result.image, &needs);
  result.image_memory = allocate(app, needs, 0);
  check_vk(vkBindImageMemory(app->device, result.image, result.image_memory, 0),
           "vkBindImageMemory");
  const VkImageViewCreateInfo view = {.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO,
                                      .image = result.image,
                                      .viewType = VK_IMAGE_VIEW_TYPE_2D,
                                      .format = wanted->format,
                                      .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1}};
  if (wanted->usage & (VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT))
    check_vk(vkCreateImageView(app->device, &view, NULL, &result.view), "vkCreateImageView");

  const VkBufferCreateInfo buffer = {
      .sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
      .size = result.size,
      .usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT};
  check_vk(vkCreateBuffer(app->device, &buffer, NULL, &result.buffer), "vkCreateBuffer");
  vkGetBufferMemoryRequirements(app->device, result.buffer, &needs);
  result.buffer_memory = allocate(
      app, needs, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
  check_vk(vkBindBufferMemory(app->device, result.buffer, result.buffer_memory, 0),
           "vkBindBufferMemory");
  void* mapped = NULL;
  check_vk(vkMapMemory(app->device, result.buffer_memory, 0, VK_WHOLE_SIZE, 0, &mapped),
           "vkMapMemory");
  result.bytes = mapped;
  return result;
}

static void destroy_image(const Application* app, const FrameImage* image) {
  vkDestroyBuffer(app->device, image->buffer, NULL);
  vkFreeMemory(app->device, image->buffer_memory, NULL);
  vkDestroyImageView(app->device, image->view, NULL);
  vkDestroyImage(app->device, image->image, NULL);
  vkFreeMemory(app->device, image->image_memory, NULL);
}

/* level / 256 in half precision, exactly. */
static uint32_t half_of(uint32_t level) {
  if (level == 0) return 0;
  uint32_t exponent = 0;
  while (level >> (exponent + 1)) ++exponent;
  return (exponent + 15 - 8) << 10 | ((level << (10 - exponent)) & 0x3ffu);
}

/* A pattern of levels 0..250, one per channel, as the format has them; another in each frame. */
static void fill(const FrameImage* image, uint32_t frame) {
  const Channel channel = format_info(image->info.format).channel;
  const size_t step = channel_bytes(channel);
  for (size_t i = 0; i < image->size / step; ++i) {
    const uint32_t level = (uint32_t)((i * 37 + frame * 11) % 251);
    const float value = (float)level / 256;
    uint32_t bits = channel == kHalf ? half_of(level) : level;
    if (channel == kFloat) memcpy(&bits, &value, sizeof(bits));
    memcpy(image->bytes + i * step, &bits, step);
  }
}

/* ---- Frames */

typedef struct Barrier {
  VkPipelineStageFlags stage;
  VkAccessFlags access;
  VkImageLayout layout;
} Barrier;

static void image_barrier(VkCommandBuffer commands, VkImage image, Barrier from, Barrier to) {
  const VkImageMemoryBarrier barrier = {
      .sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER,
      .srcAccessMask = from.access,
      .dstAccessMask = to.access,
      .oldLayout = from.layout,
      .newLayout = to.layout,
      .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
      .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
      .image = image,
      .subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1}};
  vkCmdPipelineBarrier(commands, from.stage, to.stage, 0, 0, NULL, 0, NULL, 1, &barrier);
}

static const Barrier kNothing = {VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, 0, VK_IMAGE_LAYOUT_UNDEFINED};
static const Barrier kFilled = {VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT,
                                VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL};
static const Barrier kTaken = {VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_READ_BIT,
                               VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL};
static const Barrier kRead = {VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_READ_BIT,
                              VK_IMAGE_LAYOUT_GENERAL};
static const Barrier kWritten = {VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT,
                                 VK_IMAGE_LAYOUT_GENERAL};

/* What one frame in flight has to itself. */
typedef struct Slot {
  VkCommandPool pool;
  VkCommandBuffer commands;
  VkFence fence;
  FrameImage images[kMaxImages];
  uint32_t image_count;
} Slot;

static Slot create_slot(const Application* app, const ShaleLoop* loop) {
  Slot slot = {.image_count = shale_loop_image_count(loop)};
  if (slot.image_count > kMaxImages) stop(1, "the package has %u images", slot.image_count);
  for (uint32_t i = 0; i < slot.image_count; ++i) {
    ShaleImageInfo info = {.struct_size = sizeof(info)};
    check(shale_loop_image_info(loop, i, &info, &last));
    slot.images[i] = create_image(app, &info);
  }
  const VkCommandPoolCreateInfo pool = {.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
                                        .queueFamilyIndex = app->family};
  check_vk(vkCreateCommandPool(app->device, &pool, NULL, &slot.pool), "vkCreateCommandPool");
  const VkCommandBufferAllocateInfo buffer = {
      .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
      .commandPool = slot.pool,
      .commandBufferCount = 1};
  check_vk(vkAllocateCommandBuffers(app->device, &buffer, &slot.commands),
           "vkAllocateCommandBuffers");
  const VkFenceCreateInfo fence = {.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
  check_vk(vkCreateFence(app->device, &fence, NULL, &slot.fence), "vkCreateFence");
  return slot;
}

static void destroy_slot(const Application* app, const Slot* slot) {
  vkDestroyFence(app->device, slot->fence, NULL);
  vkDestroyCommandPool(app->device, slot->pool, NULL);
  for (uint32_t i = 0; i < slot->image_count; ++i) destroy_image(app, &slot->images[i]);
}

static void record_frame(ShaleLoop* loop, Slot* slot, uint32_t frame) {
  for (uint32_t i = 0; i < slot->image_count; ++i) {
    const FrameImage* image = &slot->images[i];
    if (!image->info.is_output) fill(image, frame);
    const ShaleImage bound = {.struct_size = sizeof(bound),
                              .format = image->info.format,
                              .extent = image->info.extent,
                              .view = image->view,
                              .image = image->image};
    check(shale_loop_bind_image(loop, image->info.name, &bound, &last));
  }
  const VkCommandBufferBeginInfo begin = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  check_vk(vkBeginCommandBuffer(slot->commands, &begin), "vkBeginCommandBuffer");
  for (uint32_t i = 0; i < slot->image_count; ++i) {
    const FrameImage* image = &slot->images[i];
    const VkBufferImageCopy whole = {
        .imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1},
        .imageExtent = {image->info.extent.width, image->info.extent.height, 1}};
    if (image->info.is_output) {
      image_barrier(slot->commands, image->image, kNothing, kWritten);
      continue;
    }
    image_barrier(slot->commands, image->image, kNothing, kFilled);
    vkCmdCopyBufferToImage(slot->commands, image->buffer, image->image,
                           VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &whole);
    image_barrier(slot->commands, image->image, kFilled, kRead);
  }
  if (frame == kResetBefore) check(shale_loop_reset_history(loop, &last));
  const uint32_t programs = shale_loop_program_count(loop);
  ShaleGeneratorInfo generator = {.struct_size = sizeof(generator)};
  if (shale_loop_generator_info(loop, &generator, NULL) == SHALE_OK) {
    /* The picture that is made takes the frame's place in the output. */
    check(shale_loop_record(loop, NULL, slot->commands, &last));
    check(shale_loop_generate(loop, generator.waits ? 0.5f : 1.5f, slot->commands, &last));
  } else {
    for (uint32_t i = 0; i < programs; ++i)  // the only one needs no name
      check(shale_loop_record(loop, programs == 1 ? NULL : shale_loop_program_name(loop, i),
                              slot->commands, &last));
  }
  for (uint32_t i = 0; i < slot->image_count; ++i) {
    const FrameImage* image = &slot->images[i];
    if (!image->info.is_output) continue;
    const VkBufferImageCopy whole = {
        .imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1},
        .imageExtent = {image->info.extent.width, image->info.extent.height, 1}};
    image_barrier(slot->commands, image->image, kWritten, kTaken);
    vkCmdCopyImageToBuffer(slot->commands, image->image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL,
                           image->buffer, 1, &whole);
  }
  const VkMemoryBarrier to_host = {.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER,
                                   .srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT,
                                   .dstAccessMask = VK_ACCESS_HOST_READ_BIT};
  vkCmdPipelineBarrier(slot->commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                       0, 1, &to_host, 0, NULL, 0, NULL);
  check_vk(vkEndCommandBuffer(slot->commands), "vkEndCommandBuffer");
}

/* Waits for a frame; FNV-1a 64 of its output images. */
static uint64_t finish_frame(const Application* app, const Slot* slot) {
  check_vk(vkWaitForFences(app->device, 1, &slot->fence, VK_TRUE, UINT64_MAX), "vkWaitForFences");
  check_vk(vkResetFences(app->device, 1, &slot->fence), "vkResetFences");
  check_vk(vkResetCommandPool(app->device, slot->pool, 0), "vkResetCommandPool");
  uint64_t checksum = 0xcbf29ce484222325u;
  for (uint32_t i = 0; i < slot->image_count; ++i)
    for (size_t k = 0; slot->images[i].info.is_output && k < slot->images[i].size; ++k)
      checksum = (checksum ^ slot->images[i].bytes[k]) * 0x100000001b3u;
  return checksum;
}

/* Checksums of all frames, `in_flight` of them pending on the queue at once. */
static void run_frames(const Application* app, const ShalePackage* package, uint32_t in_flight,
                       uint64_t checksums[kFrames]) {
  const ShaleCompile compile = in_flight == 1 ? SHALE_COMPILE_BY_HOST : SHALE_COMPILE_IN_BACKGROUND;
  const ShaleLoopInfo info = {
      .struct_size = sizeof(info), .frames_in_flight = in_flight, .compile = compile};
  ShaleLoop* loop = NULL;
  check(shale_loop_create(app->shale, package, &info, &loop, &last));
  Slot slots[kInFlight];
  for (uint32_t i = 0; i < in_flight; ++i) slots[i] = create_slot(app, loop);
  for (uint32_t frame = 0; frame < kFrames + in_flight; ++frame) {
    Slot* slot = &slots[frame % in_flight];
    if (frame >= in_flight) checksums[frame - in_flight] = finish_frame(app, slot);
    if (frame >= kFrames) continue;
    record_frame(loop, slot, frame);
    VkBool32 did = VK_FALSE;
    const uint32_t left = shale_loop_kernels_left(loop);
    if (compile == SHALE_COMPILE_BY_HOST) check(shale_loop_compile_one(loop, &did, &last));
    if (compile == SHALE_COMPILE_BY_HOST &&
        (did != (left > 0) || shale_loop_kernels_left(loop) != left - (did ? 1 : 0)))
      stop(1, "of %u kernels the host compiled %u", left, did);
    const VkSubmitInfo submit = {.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO,
                                 .commandBufferCount = 1,
                                 .pCommandBuffers = &slot->commands};
    check_vk(vkQueueSubmit(app->queue, 1, &submit, slot->fence), "vkQueueSubmit");
  }
  shale_loop_destroy(loop);
  for (uint32_t i = 0; i < in_flight; ++i) destroy_slot(app, &slots[i]);
}

/* What a mistaken host is told. */
static void expect_refusal(ShaleResult result, ShaleResult expected, const char* text) {
  if (result != expected || last.result != expected || strstr(last.text, text) == NULL)
    stop(1, "a mistake was answered by %d \"%s\", expected %d \"%s\"", (int)result, last.text,
         (int)expected, text);
}

static void make_mistakes(const Application* app, const ShalePackage* package) {
  const uint8_t garbage[64] = {1, 2, 3};
  ShalePackage* none = NULL;
  expect_refusal(shale_package_read(garbage, sizeof(garbage), &none, &last), SHALE_BAD_INPUT,
                 "is no .shale package");
  expect_refusal(shale_package_read(NULL, 0, &none, &last), SHALE_BAD_INPUT, "bytes: is null");
  expect_refusal(shale_package_read(garbage, 64, NULL, &last), SHALE_BAD_INPUT, "package: is null");
  ShaleDevice* device = NULL;
  ShaleDeviceInfo device_info = {.struct_size = 1};
  expect_refusal(shale_device_create(&device_info, &device, &last), SHALE_BAD_INPUT,
                 "info: struct_size is 1, expected");
  device_info.struct_size = sizeof(device_info);
  expect_refusal(shale_device_create(&device_info, &device, &last), SHALE_BAD_INPUT,
                 "no physical device is given");
  ShaleLoop* loop = NULL;
  ShaleLoopInfo info = {
      .struct_size = sizeof(info), .frames_in_flight = 9, .compile = SHALE_COMPILE_BY_HOST};
  expect_refusal(shale_loop_create(app->shale, package, &info, &loop, &last), SHALE_BAD_INPUT,
                 "9 frames in flight are outside 1..8");
  info.compile = (ShaleCompile)3;
  expect_refusal(shale_loop_create(app->shale, package, &info, &loop, &last), SHALE_BAD_INPUT,
                 "info: compile is 3, expected");
  info.compile = SHALE_COMPILE_BY_HOST;
  expect_refusal(shale_loop_create(NULL, package, &info, &loop, &last), SHALE_BAD_INPUT,
                 "device: is null");
  /* Nothing was enabled, says this host. */
  device_info.queue_family = app->family;
  device_info.instance = app->instance;
  device_info.physical_device = app->physical;
  device_info.device = app->device;
  device_info.get_instance_proc_addr = vkGetInstanceProcAddr;
  check(shale_device_create(&device_info, &device, &last));
  info.frames_in_flight = 1;
  expect_refusal(shale_loop_create(device, package, &info, &loop, &last), SHALE_DEVICE_ERROR,
                 "is not supported");
  if (loop != NULL) stop(1, "a refused loop was made");
  shale_device_destroy(device);

  check(shale_loop_create(app->shale, package, &info, &loop, &last));
  ShaleImageInfo image_info = {.struct_size = sizeof(image_info)};
  expect_refusal(shale_loop_image_info(loop, kMaxImages, &image_info, &last), SHALE_BAD_INPUT,
                 "image 32 does not exist");
  check(shale_loop_image_info(loop, 0, &image_info, &last));
  ShaleImage image = {.struct_size = sizeof(image), .format = image_info.format, .extent = {1, 2}};
  expect_refusal(shale_loop_bind_image(loop, "no such image", &image, &last), SHALE_BAD_INPUT,
                 "no input or output image \"no such image\"");
  expect_refusal(shale_loop_bind_image(loop, image_info.name, &image, &last), SHALE_BAD_INPUT,
                 "is given");
  const float value = 1;
  expect_refusal(shale_loop_set_param(loop, "no such value", &value, 1, &last), SHALE_BAD_INPUT,
                 "no parameter \"no such value\"");
  expect_refusal(shale_loop_set_param(loop, NULL, &value, 1, &last), SHALE_BAD_INPUT,
                 "name: is null");
  expect_refusal(shale_loop_record(loop, shale_loop_program_name(loop, 0), NULL, &last),
                 SHALE_BAD_INPUT, "commands: is null");
  ShaleError small = {.struct_size = 8};
  if (shale_loop_reset_history(loop, &small) != SHALE_BAD_INPUT || small.result != SHALE_OK)
    stop(1, "an error of another size was used");
  if (shale_loop_reset_history(NULL, NULL) != SHALE_BAD_INPUT || shale_loop_program_count(NULL) ||
      shale_loop_program_name(loop, 1000) || shale_loop_target(NULL) != NULL)
    stop(1, "null is no loop");
  shale_loop_destroy(loop);
  shale_loop_destroy(NULL);
  shale_package_destroy(NULL);
  shale_device_destroy(NULL);
}

static void describe(const Application* app, const ShalePackage* package) {
  const ShaleLoopInfo info = {
      .struct_size = sizeof(info), .frames_in_flight = 1, .compile = SHALE_COMPILE_BY_HOST};
  ShaleLoop* loop = NULL;
  check(shale_loop_create(app->shale, package, &info, &loop, &last));
  printf("target %s\n", shale_loop_target(loop));
  for (uint32_t i = 0; i < shale_loop_program_count(loop); ++i)
    printf("program %s\n", shale_loop_program_name(loop, i));
  ShaleGeneratorInfo generator = {.struct_size = sizeof(generator)};
  if (shale_loop_generator_info(loop, &generator, NULL) == SHALE_OK) {
    printf("program %s makes pictures at %g to %g\n", generator.program, (double)generator.after,
           (double)generator.until);
    expect_refusal(shale_loop_generate(loop, generator.until + 1, VK_NULL_HANDLE, &last),
                   SHALE_BAD_INPUT, "commands: is null");
  } else {
    expect_refusal(shale_loop_generator_info(loop, &generator, &last), SHALE_BAD_INPUT,
                   "no program that generates pictures");
  }
  for (uint32_t i = 0; i < shale_loop_image_count(loop); ++i) {
    ShaleImageInfo image = {.struct_size = sizeof(image)};
    check(shale_loop_image_info(loop, i, &image, &last));
    printf("%s %s: VkFormat %d, %ux%u, usage %#x\n", image.is_output ? "output" : "input",
           image.name, (int)image.format, image.extent.width, image.extent.height, image.usage);
  }
  for (uint32_t i = 0; i < shale_loop_param_count(loop); ++i) {
    ShaleParamInfo param = {.struct_size = sizeof(param)};
    check(shale_loop_param_info(loop, i, &param, &last));
    printf("parameter %s: %u %s\n", param.name, param.components,
           param.is_integer ? "integers" : "numbers");
    check(shale_loop_set_param(loop, param.name, param.default_values, param.components, &last));
  }
  ShaleMemoryInfo memory = {.struct_size = sizeof(memory)};
  check(shale_loop_memory_info(loop, &memory, &last));
  printf("memory %llu bytes\n",
         (unsigned long long)(memory.weights + memory.arena + memory.tensors + memory.images));
  shale_loop_destroy(loop);
}

static ShalePackage* read_package(const char* path) {
  FILE* file = fopen(path, "rb");
  if (!file) stop(1, "%s cannot be opened", path);
  fseek(file, 0, SEEK_END);
  const long end = ftell(file);
  if (end <= 0) stop(1, "%s is empty", path);
  const size_t size = (size_t)end;
  rewind(file);
  uint8_t* bytes = malloc(size);
  if (!bytes || fread(bytes, 1, size, file) != size) stop(1, "%s cannot be read", path);
  fclose(file);
  ShalePackage* package = NULL;
  check(shale_package_read(bytes, size, &package, &last));
  free(bytes);
  return package;
}

int main(int argc, char** argv) {
  const char* path = NULL;
  const char* expected = NULL;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (strcmp(argv[i], "--package") == 0) path = argv[i + 1];
    if (strcmp(argv[i], "--expect") == 0) expected = argv[i + 1];
  }
  if (!path) stop(2, "usage: host_program --package FILE [--expect CHECKSUM]");
  ShalePackage* package = read_package(path);
  const Application app = create_application();
  describe(&app, package);
  make_mistakes(&app, package);
  uint64_t alone[kFrames], pending[kFrames];
  run_frames(&app, package, 1, alone);
  run_frames(&app, package, kInFlight, pending);
  shale_package_destroy(package);
  destroy_application(&app);

  for (uint32_t frame = 0; frame < kFrames; ++frame)
    if (alone[frame] != pending[frame])
      stop(1, "frame %u differs when two are in flight: %016llx, alone %016llx", frame,
           (unsigned long long)pending[frame], (unsigned long long)alone[frame]);
  char text[17];
  snprintf(text, sizeof(text), "%016llx", (unsigned long long)alone[0]);
  printf("checksum %s\n", text);
  if (expected && strcmp(expected, text) != 0) stop(1, "expected the checksum %s", expected);
  return 0;
}
