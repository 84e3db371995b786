/* runtime/shale.h -- Shale for engines that embed C: compiled packages on a host's Vulkan device.
 *
 * What the host has stays the host's: instance, device, queues, images, command buffers. Shale
 * records into the host's command buffers and submits nothing. How a host orders its own work
 * around that, and what histories and programs are, is told in runtime/frame/frame_loop.h; this is
 * that interface for C.
 *
 * - Nothing here throws, prints or ends the program.
 * - A handle is used by one thread at a time; different loops by different threads at once.
 * - A null pointer is an error, unless the argument is said to allow it. Destroying null is not.
 * - Every struct starts with `struct_size`, which the host sets to sizeof its struct. A library
 *   that is newer than the host takes the shorter struct; an older one refuses the longer.
 * - Strings are UTF-8 and end with zero. Those that Shale returns live as long as their handle.
 * - Results that fail explain themselves in a ShaleError, if one is given, and change nothing.
 */
#ifndef SHALE_RUNTIME_SHALE_H_
#define SHALE_RUNTIME_SHALE_H_

#include <stddef.h>
#include <stdint.h>
#include <vulkan/vulkan.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum ShaleResult {
  SHALE_OK = 0,
  SHALE_BAD_INPUT = 1,     /* an argument or a package breaks a rule */
  SHALE_UNSUPPORTED = 2,   /* legal, but outside of what this build does */
  SHALE_DEVICE_ERROR = 3,  /* the device cannot run it, or failed */
  SHALE_OUT_OF_MEMORY = 4, /* of the host's memory */
  SHALE_RESULT_MAX_ENUM = 0x7fffffff
} ShaleResult;

#define SHALE_ERROR_TEXT_BYTES 1016

typedef struct ShaleError {
  uint32_t struct_size;
  ShaleResult result;                /* what the call returned */
  char text[SHALE_ERROR_TEXT_BYTES]; /* one line: found, expected, where; cut if too long */
} ShaleError;

typedef struct ShaleDevice ShaleDevice;   /* a host's device */
typedef struct ShalePackage ShalePackage; /* a .shale file in memory */
typedef struct ShaleLoop ShaleLoop;       /* a package on a device; a frame loop */

/* ---- Device */

typedef struct ShaleDeviceInfo {
  uint32_t struct_size;
  uint32_t queue_family; /* of the queue that what is recorded is submitted to; must compute */
  VkInstance instance;
  VkPhysicalDevice physical_device; /* Vulkan 1.3 */
  VkDevice device;
  PFN_vkGetInstanceProcAddr get_instance_proc_addr;
  PFN_vkGetDeviceProcAddr get_device_proc_addr; /* null: the instance's */
  /* What the device was created with: what features are enabled, and thus what variants of a
   * package may be chosen. Read during the call only. Null: no feature is enabled. */
  const VkDeviceCreateInfo* create_info;
} ShaleDeviceInfo;

/* The device must outlive all that is made from it. */
ShaleResult shale_device_create(const ShaleDeviceInfo* info, ShaleDevice** device,
                                ShaleError* error);
/* Loops that were made from it stay. */
void shale_device_destroy(ShaleDevice* device);

/* ---- Package */

/* Reads and checks `size` bytes of a .shale file that nobody needs to vouch for. They may go
 * afterwards. */
ShaleResult shale_package_read(const void* bytes, size_t size, ShalePackage** package,
                               ShaleError* error);
/* Loops that were made from it stay. */
void shale_package_destroy(ShalePackage* package);

/* ---- Loop */

/* When the fast kernels are compiled that have start forms in the package. A record takes for each dispatch what is
 * there by then; results are the same, bit for bit. */
typedef enum ShaleCompile {
  SHALE_COMPILE_AT_ONCE = 0,       /* before shale_loop_create returns */
  SHALE_COMPILE_IN_BACKGROUND = 1, /* by threads that the loop owns and ends, after a frame */
  SHALE_COMPILE_BY_HOST = 2        /* by shale_loop_compile_one, on threads of the host's */
} ShaleCompile;

typedef struct ShaleLoopInfo {
  uint32_t struct_size;
  /* Before a program is recorded, its record of `frames_in_flight` records before must have been
   * finished by the device. 1 to 8. */
  uint32_t frames_in_flight;
  /* Null: none. Must outlive the loop, and must not be externally synchronized. */
  VkPipelineCache pipeline_cache;
  ShaleCompile compile;
  /* Of the loop's own, for drivers on the CPU with Vulkan devices of its own. 0: none, but in the
   * background, where it is half of the processors, at least 2. */
  uint32_t compile_threads;
} ShaleLoopInfo;

/* Takes the best variant that the device meets. A CPU driver compiles at the first record unless
 * `compile` or `compile_threads` ask for more: half a minute for fast kernels, a second where start
 * forms serve. */
ShaleResult shale_loop_create(const ShaleDevice* device, const ShalePackage* package,
                              const ShaleLoopInfo* info, ShaleLoop** loop, ShaleError* error);
/* Kernels that are not there yet; those that the driver refused, for which others go on to serve, too. 0 for null. */
uint32_t shale_loop_kernels_left(const ShaleLoop* loop);
/* Compiles one on this thread; *did is VK_FALSE if there is none left that nobody compiles. Any thread may call it, beside
 * other calls. */
ShaleResult shale_loop_compile_one(ShaleLoop* loop, VkBool32* did, ShaleError* error);
/* All that was recorded with it must have been finished by the device. Waits for a kernel that is being compiled in the
 * background, for seconds where a CPU driver has a long one. */
void shale_loop_destroy(ShaleLoop* loop);

/* Number of programs; 0 for null. */
uint32_t shale_loop_program_count(const ShaleLoop* loop);
/* Null if there is no such program. */
const char* shale_loop_program_name(const ShaleLoop* loop, uint32_t index);
/* The target that the chosen variant was compiled for; null for null. */
const char* shale_loop_target(const ShaleLoop* loop);

typedef struct ShaleImageInfo {
  uint32_t struct_size;
  VkBool32 is_output; /* written by the package; else read */
  const char* name;
  VkFormat format;
  VkExtent2D extent;
  /* VK_IMAGE_USAGE_* that the image must have. 0 if no program uses it. */
  VkImageUsageFlags usage;
} ShaleImageInfo;

/* Number of images that the host binds; 0 for null. */
uint32_t shale_loop_image_count(const ShaleLoop* loop);
ShaleResult shale_loop_image_info(const ShaleLoop* loop, uint32_t index, ShaleImageInfo* info,
                                  ShaleError* error);

typedef struct ShaleParamInfo {
  uint32_t struct_size;
  VkBool32 is_integer; /* takes whole numbers only */
  const char* name;
  uint32_t components;     /* 1 to 4 */
  float default_values[4]; /* as many as components; then zeros */
} ShaleParamInfo;

/* Number of parameters that the host may set; 0 for null. */
uint32_t shale_loop_param_count(const ShaleLoop* loop);
ShaleResult shale_loop_param_info(const ShaleLoop* loop, uint32_t index, ShaleParamInfo* info,
                                  ShaleError* error);

/* Bytes of the device's memory. */
typedef struct ShaleMemoryInfo {
  uint32_t struct_size;
  uint32_t reserved;
  uint64_t weights;
  uint64_t arena;   /* intermediate tensors */
  uint64_t tensors; /* inputs and outputs of graphs, with their histories */
  uint64_t images;  /* internal ones and histories */
  uint64_t staging; /* until the weights are where they belong */
} ShaleMemoryInfo;

ShaleResult shale_loop_memory_info(const ShaleLoop* loop, ShaleMemoryInfo* info, ShaleError* error);

/* An image in VK_IMAGE_LAYOUT_GENERAL. The view is two-dimensional, with one level and layer and no
 * swizzle, of the first level and layer. */
typedef struct ShaleImage {
  uint32_t struct_size;
  VkFormat format;
  VkExtent2D extent;
  VkImageView view; /* may be null if the usage has neither SAMPLED nor STORAGE */
  VkImage image;    /* may be null if the usage has neither TRANSFER_SRC nor TRANSFER_DST */
} ShaleImage;

/* For what is recorded from now on. */
ShaleResult shale_loop_bind_image(ShaleLoop* loop, const char* name, const ShaleImage* image,
                                  ShaleError* error);
/* For what is recorded from now on; `count` must be the parameter's components. */
ShaleResult shale_loop_set_param(ShaleLoop* loop, const char* name, const float* values,
                                 uint32_t count, ShaleError* error);
/* The next record finds all histories empty, as after a scene cut. */
ShaleResult shale_loop_reset_history(ShaleLoop* loop, ShaleError* error);

/* Adds a program to a command buffer that is being recorded, outside of a render pass. Each record
 * is submitted once, in the order of recording. Changes the bound compute pipeline and set 0.
 * `program` may be null: then it is the only one, the one that a parameter of the package chooses,
 * or that which renders where the other one generates; an error where the host has to choose. */
ShaleResult shale_loop_record(ShaleLoop* loop, const char* program, VkCommandBuffer commands,
                              ShaleError* error);

/* ---- Pictures between rendered frames */

/* Times are in rendered frames: the newest one is at 1, the one before at 0. Of N pictures for each
 * rendered frame the k-th is at k / (N + 1), and 1 more if the program does not wait. */
typedef struct ShaleGeneratorInfo {
  uint32_t struct_size;
  VkBool32 waits;      /* pictures are shown before the newest rendered frame, else behind it */
  const char* program; /* the name of the program that makes them */
  float after, until;  /* it takes times above the one, up to the other */
} ShaleGeneratorInfo;

/* An error if no program of the package makes such pictures. */
ShaleResult shale_loop_generator_info(const ShaleLoop* loop, ShaleGeneratorInfo* info,
                                      ShaleError* error);
/* Adds the making of a picture from the frames that were recorded last; no frame to come finds
 * anything of it. It writes the output images that are bound now. While a single frame was recorded
 * since a reset, as behind a cut, the picture is that frame. */
ShaleResult shale_loop_generate(ShaleLoop* loop, float time, VkCommandBuffer commands,
                                ShaleError* error);

/* ---- Cameras */

typedef struct ShaleCamera {
  uint32_t struct_size;
  VkBool32 reverse_depth; /* 1 is near, 0 is far */
  float near_plane;       /* metres, above 0 */
  float far_plane;        /* metres; infinite if 0 or less */
  float fov_x, fov_y;     /* radians */
} ShaleCamera;

/* The parameter "depth_to_view" of upscalers: 4 values. */
ShaleResult shale_depth_to_view(const ShaleCamera* camera, float values[4], ShaleError* error);

#ifdef __cplusplus
}
#endif

#endif
