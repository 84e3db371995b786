// The C interface (shale.h) over the C++ one.
#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <iterator>
#include <memory>
#include <new>
#include <vector>

#include "runtime/frame/camera.h"
#include "runtime/frame/frame_loop.h"
#include "runtime/shale.h"
#include "runtime/vk/memory.h"

// The types that C knows by name only.
struct ShaleDevice {
  shale::vk::Context context;
};
struct ShalePackage {
  shale::Package package;
};
struct ShaleLoop {
  shale::FrameLoop loop;
  std::vector<const shale::Resource*> images;  // what the host binds
  std::vector<const shale::Param*> params;     // what the host sets
};

namespace {

using shale::bad_input;
using shale::Result;

ShaleResult result_of(shale::ErrorCode code) {
  switch (code) {
    case shale::ErrorCode::kBadInput: return SHALE_BAD_INPUT;
    case shale::ErrorCode::kUnsupported: return SHALE_UNSUPPORTED;
    case shale::ErrorCode::kDevice: return SHALE_DEVICE_ERROR;
    case shale::ErrorCode::kIo: break;  // nothing here reads or writes files
  }
  return SHALE_BAD_INPUT;
}

ShaleResult report(ShaleError* error, ShaleResult result, const char* text) {
  if (!error) return result;
  error->result = result;
  size_t length = std::min(std::strlen(text), sizeof(error->text) - 1);
  // Never half a character of several bytes.
  while (length > 0 && (static_cast<unsigned char>(text[length]) & 0xc0) == 0x80) --length;
  std::memcpy(error->text, text, length);
  error->text[length] = 0;
  return result;
}

/// Runs the body of a call, which gives a Result<void>.
template <typename Body>
ShaleResult guarded(ShaleError* error, const Body& body) noexcept {
  if (error && error->struct_size != sizeof(ShaleError)) return SHALE_BAD_INPUT;
  try {
    if (const Result<void> done = body(); !done)
      return report(error, result_of(done.error().code), done.error().text().c_str());
    return report(error, SHALE_OK, "");
  } catch (const std::bad_alloc&) {
    return report(error, SHALE_OUT_OF_MEMORY, "out of memory");
  } catch (const std::exception& failure) {
    return report(error, SHALE_OUT_OF_MEMORY, failure.what());
  }
}

Result<void> given(const void* argument, const char* name) {
  if (!argument) return bad_input(name, "is null");
  return {};
}

/// Of a struct that a host filled or wants to have filled. Each has had one size so far.
template <typename T>
Result<void> check_struct(const T* argument, const char* name) {
  SHALE_TRY_VOID(given(argument, name));
  if (argument->struct_size != sizeof(T))
    return bad_input(name, "struct_size is {}, expected {}", argument->struct_size, sizeof(T));
  return {};
}

/// Leaves no handle behind if there will be none.
template <typename T>
Result<void> check_place(T** place, const char* name) {
  SHALE_TRY_VOID(given(place, name));
  *place = nullptr;
  return {};
}

/// One of a list, by its index.
template <typename T>
Result<const T*> at(const std::vector<const T*>& list, uint32_t index, const char* what) {
  if (index >= list.size())
    return bad_input("index", "{} {} does not exist, there are {}", what, index, list.size());
  return list[index];
}

}  // namespace

extern "C" {

ShaleResult shale_device_create(const ShaleDeviceInfo* info, ShaleDevice** device,
                                ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(check_place(device, "device"));
    SHALE_TRY_VOID(check_struct(info, "info"));
    SHALE_TRY(shale::vk::Context context,
              shale::vk::wrap_device({
                  .instance = info->instance,
                  .physical_device = info->physical_device,
                  .device = info->device,
                  .queue_family = info->queue_family,
                  .get_instance_proc_addr = info->get_instance_proc_addr,
                  .get_device_proc_addr = info->get_device_proc_addr,
                  .features = info->create_info ? shale::vk::enabled_features(*info->create_info)
                                                : shale::FeatureSet{},
              }));
    *device = new ShaleDevice{std::move(context)};
    return {};
  });
}

void shale_device_destroy(ShaleDevice* device) { delete device; }

ShaleResult shale_package_read(const void* bytes, size_t size, ShalePackage** package,
                               ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(check_place(package, "package"));
    SHALE_TRY_VOID(given(bytes, "bytes"));
    SHALE_TRY(shale::Package read, shale::read_package({static_cast<const uint8_t*>(bytes), size}));
    *package = new ShalePackage{std::move(read)};
    return {};
  });
}

void shale_package_destroy(ShalePackage* package) { delete package; }

ShaleResult shale_loop_create(const ShaleDevice* device, const ShalePackage* package,
                              const ShaleLoopInfo* info, ShaleLoop** loop, ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(check_place(loop, "loop"));
    SHALE_TRY_VOID(given(device, "device"));
    SHALE_TRY_VOID(given(package, "package"));
    SHALE_TRY_VOID(check_struct(info, "info"));
    if (info->compile > SHALE_COMPILE_BY_HOST)
      return bad_input("info", "compile is {}, expected one of ShaleCompile",
                       static_cast<uint32_t>(info->compile));
    SHALE_TRY(shale::FrameLoop made,
              shale::FrameLoop::create(device->context, package->package,
                                       {.frames_in_flight = info->frames_in_flight,
                                        .cache = info->pipeline_cache,
                                        .compile = static_cast<shale::Compile>(info->compile),
                                        .threads = info->compile_threads}));
    auto result = std::make_unique<ShaleLoop>(ShaleLoop{std::move(made), {}, {}});
    const shale::Variant& variant = result->loop.variant();
    for (const shale::Resource& resource : variant.resources)
      if (resource.category == shale::Category::kImageInput ||
          resource.category == shale::Category::kImageOutput)
        result->images.push_back(&resource);
    for (const shale::Param& param : variant.params)
      if (param.source == shale::ParamSource::kHost) result->params.push_back(&param);
    *loop = result.release();
    return {};
  });
}

void shale_loop_destroy(ShaleLoop* loop) { delete loop; }

uint32_t shale_loop_kernels_left(const ShaleLoop* loop) {
  return loop ? static_cast<uint32_t>(loop->loop.kernels_left()) : 0;
}

ShaleResult shale_loop_compile_one(ShaleLoop* loop, VkBool32* did, ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(given(did, "did"));
    SHALE_TRY(*did, loop->loop.compile_one());
    return {};
  });
}

uint32_t shale_loop_program_count(const ShaleLoop* loop) {
  return loop ? static_cast<uint32_t>(loop->loop.variant().programs.size()) : 0;
}

const char* shale_loop_program_name(const ShaleLoop* loop, uint32_t index) {
  return index < shale_loop_program_count(loop) ? loop->loop.variant().programs[index].c_str()
                                                : nullptr;
}

const char* shale_loop_target(const ShaleLoop* loop) {
  return loop ? loop->loop.variant().target.c_str() : nullptr;
}

uint32_t shale_loop_image_count(const ShaleLoop* loop) {
  return loop ? static_cast<uint32_t>(loop->images.size()) : 0;
}

ShaleResult shale_loop_image_info(const ShaleLoop* loop, uint32_t index, ShaleImageInfo* info,
                                  ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(check_struct(info, "info"));
    SHALE_TRY(const shale::Resource* image, at(loop->images, index, "image"));
    info->is_output = image->category == shale::Category::kImageOutput;
    info->name = image->name.c_str();
    info->format = shale::vk::vk_format(image->format);
    info->extent = {image->width, image->height};
    info->usage = loop->loop.image_usage(image->name);
    return {};
  });
}

uint32_t shale_loop_param_count(const ShaleLoop* loop) {
  return loop ? static_cast<uint32_t>(loop->params.size()) : 0;
}

ShaleResult shale_loop_param_info(const ShaleLoop* loop, uint32_t index, ShaleParamInfo* info,
                                  ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(check_struct(info, "info"));
    SHALE_TRY(const shale::Param* param, at(loop->params, index, "parameter"));
    info->is_integer = param->is_integer;
    info->name = param->name.c_str();
    info->components = param->components;
    std::fill(std::begin(info->default_values), std::end(info->default_values), 0.0f);
    std::copy(param->default_values.begin(), param->default_values.end(), info->default_values);
    return {};
  });
}

ShaleResult shale_loop_memory_info(const ShaleLoop* loop, ShaleMemoryInfo* info,
                                   ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(check_struct(info, "info"));
    const shale::MemoryUse use = loop->loop.memory_use();
    info->weights = use.weights;
    info->arena = use.arena;
    info->tensors = use.tensors;
    info->images = use.images;
    info->staging = use.staging;
    return {};
  });
}

ShaleResult shale_loop_bind_image(ShaleLoop* loop, const char* name, const ShaleImage* image,
                                  ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(given(name, "name"));
    SHALE_TRY_VOID(check_struct(image, "image"));
    return loop->loop.bind_image(name, {.view = image->view,
                                        .format = image->format,
                                        .extent = image->extent,
                                        .image = image->image});
  });
}

ShaleResult shale_loop_set_param(ShaleLoop* loop, const char* name, const float* values,
                                 uint32_t count, ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(given(name, "name"));
    SHALE_TRY_VOID(given(values, "values"));
    return loop->loop.set_param(name, {values, count});
  });
}

ShaleResult shale_loop_reset_history(ShaleLoop* loop, ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    loop->loop.reset_history();
    return {};
  });
}

ShaleResult shale_loop_record(ShaleLoop* loop, const char* program, VkCommandBuffer commands,
                              ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(given(commands, "commands"));
    if (!program) return loop->loop.record(commands);
    return loop->loop.record(std::string_view(program), commands);
  });
}

ShaleResult shale_loop_generator_info(const ShaleLoop* loop, ShaleGeneratorInfo* info,
                                      ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(check_struct(info, "info"));
    const shale::Variant& variant = loop->loop.variant();
    if (!variant.generator)
      return shale::bad_input("", "the package has no program that generates pictures");
    info->waits = variant.generator->waits();
    info->program = variant.programs[variant.generator->program].c_str();
    info->after = variant.generator->after;
    info->until = variant.generator->until;
    return {};
  });
}

ShaleResult shale_loop_generate(ShaleLoop* loop, float time, VkCommandBuffer commands,
                                ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(given(loop, "loop"));
    SHALE_TRY_VOID(given(commands, "commands"));
    return loop->loop.generate(time, commands);
  });
}

ShaleResult shale_depth_to_view(const ShaleCamera* camera, float values[4], ShaleError* error) {
  return guarded(error, [&]() -> Result<void> {
    SHALE_TRY_VOID(check_struct(camera, "camera"));
    SHALE_TRY_VOID(given(values, "values"));
    const std::array<float, 4> result = shale::depth_to_view({
        .near_plane = camera->near_plane,
        .far_plane = camera->far_plane,
        .fov_x = camera->fov_x,
        .fov_y = camera->fov_y,
        .reverse = camera->reverse_depth != VK_FALSE,
    });
    std::copy(result.begin(), result.end(), values);
    return {};
  });
}

}  // extern "C"
