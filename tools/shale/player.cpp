#include "tools/shale/player.h"

#include <Imath/half.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <thread>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "runtime/frame/camera.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/timestamps.h"
#include "tools/eval/tonemap.h"

namespace shale {
namespace {

VkBufferImageCopy whole(VkExtent2D extent) {
  VkBufferImageCopy copy{};
  copy.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
  copy.imageExtent = {extent.width, extent.height, 1};
  return copy;
}

uint64_t image_bytes(const Resource& image) {
  return uint64_t{image.width} * image.height * image_format_info(image.format).texel_bytes;
}

float read_channel(const uint8_t* texel, ImageFormat format, uint32_t channel) {
  const auto load = [&]<typename T>(T) {
    T value;
    std::memcpy(&value, texel + channel * sizeof(T), sizeof(T));
    return value;
  };
  switch (format) {
    case ImageFormat::kRgba8Unorm:
    case ImageFormat::kRg8Unorm:
    case ImageFormat::kR8Unorm: return static_cast<float>(texel[channel]) / 255;
    case ImageFormat::kRgba8Snorm: return std::max(static_cast<float>(load(int8_t{})) / 127, -1.0f);
    case ImageFormat::kRgba16Float:
    case ImageFormat::kRg16Float:
    case ImageFormat::kR16Float: {
      Imath::half value;
      value.setBits(load(uint16_t{}));
      return value;
    }
    case ImageFormat::kRgba32Float:
    case ImageFormat::kR32Float: return load(float{});
    case ImageFormat::kR32Uint: return static_cast<float>(load(uint32_t{}));
    default: return 0;
  }
}

void write_channel(uint8_t* texel, ImageFormat format, uint32_t channel, float value) {
  const auto store = [&](auto what) {
    std::memcpy(texel + channel * sizeof(what), &what, sizeof(what));
  };
  switch (format) {
    case ImageFormat::kRgba8Unorm:
    case ImageFormat::kRg8Unorm:
    case ImageFormat::kR8Unorm:
      // NaN is 0.
      store(static_cast<uint8_t>(value > 0 ? std::lround(std::min(value, 1.0f) * 255) : 0));
      break;
    case ImageFormat::kRgba16Float:
    case ImageFormat::kRg16Float:
    case ImageFormat::kR16Float: store(Imath::half(value).bits()); break;
    case ImageFormat::kRgba32Float:
    case ImageFormat::kR32Float: store(value); break;
    default: break;
  }
}

bool is_unorm(ImageFormat format) {
  return format == ImageFormat::kRgba8Unorm || format == ImageFormat::kRg8Unorm ||
         format == ImageFormat::kR8Unorm;
}

/// Three channels of one to four.
FloatImage to_rgb(const FloatImage& from) {
  FloatImage result{from.width, from.height, 3, {}};
  const size_t texels = size_t{from.width} * from.height;
  result.values.reserve(texels * 3);
  for (size_t i = 0; i < texels; ++i)
    for (size_t c = 0; c < 3; ++c) {
      const size_t channel = from.channels == 1 ? 0 : c;
      result.values.push_back(channel < from.channels ? from.values[i * from.channels + channel]
                                                      : 0.0f);
    }
  return result;
}

/// The texels of a linear image without what lies between its rows.
std::vector<uint8_t> dense_rows(std::span<const uint8_t> bytes, const Resource& image) {
  const size_t row = size_t{image.width} * image_format_info(image.format).texel_bytes;
  std::vector<uint8_t> dense(row * image.height);
  for (size_t y = 0; y < image.height; ++y)
    std::memcpy(&dense[y * row], &bytes[y * (image.size_bytes / image.height)], row);
  return dense;
}

/// Copies all of an image or a range of a buffer to the host.
Result<vk::Buffer> download(const vk::Context& context, uint64_t bytes,
                            const std::function<void(VkCommandBuffer, VkBuffer)>& copy) {
  SHALE_TRY(vk::Buffer buffer, vk::Buffer::create(context, bytes, VK_BUFFER_USAGE_TRANSFER_DST_BIT,
                                                  vk::MemoryKind::kReadback));
  SHALE_TRY_VOID(vk::submit_and_wait(context, [&](VkCommandBuffer commands) {
    vk::memory_barrier(context, commands, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT,
                       VK_ACCESS_MEMORY_WRITE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_READ_BIT);
    copy(commands, buffer.get());
    vk::memory_barrier(context, commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                       VK_ACCESS_HOST_READ_BIT);
  }));
  return buffer;
}

Result<vk::Buffer> download(const vk::Context& context, const TensorView& view) {
  return download(context, view.size_bytes, [&](VkCommandBuffer commands, VkBuffer to) {
    const VkBufferCopy copy{view.offset, 0, view.size_bytes};
    context.vk.CmdCopyBuffer(commands, view.buffer, to, 1, &copy);
  });
}

}  // namespace

FloatImage unpack_texels(std::span<const uint8_t> bytes, ImageFormat format, Extent extent) {
  const ImageFormatInfo& info = image_format_info(format);
  FloatImage image{extent.width, extent.height, info.channels, {}};
  const size_t texels = size_t{extent.width} * extent.height;
  image.values.reserve(texels * info.channels);
  for (size_t i = 0; i < texels; ++i)
    for (uint32_t c = 0; c < info.channels; ++c)
      image.values.push_back(read_channel(&bytes[i * info.texel_bytes], format, c));
  return image;
}

void pack_texels(const FloatImage& from, ImageFormat format, std::span<uint8_t> bytes) {
  const ImageFormatInfo& info = image_format_info(format);
  const size_t texels = size_t{from.width} * from.height;
  for (size_t i = 0; i < texels; ++i)
    for (uint32_t c = 0; c < info.channels; ++c)
      write_channel(&bytes[i * info.texel_bytes], format, c,
                    c < from.channels ? from.values[i * from.channels + c]
                    : c == 3          ? 1.0f
                                      : 0.0f);
}

Result<std::pair<Extent, Extent>> sandwich_sizes(const Variant& variant) {
  const auto find = [&](const char* name, Category category) -> const Resource* {
    for (const Resource& resource : variant.resources)
      if (resource.name == name && resource.category == category) return &resource;
    return nullptr;
  };
  const Resource* color = find("color", Category::kImageInput);
  const Resource* output = find("output", Category::kImageOutput);
  if (!color || !output)
    return bad_input("", "the package has no sandwich with the images \"color\" and \"output\"");
  return std::pair{Extent{color->width, color->height}, Extent{output->width, output->height}};
}

Result<Sandwich> load_sandwich(const std::string& path, const CompileArguments& arguments,
                               std::optional<Extent> render, std::optional<Extent> output,
                               Result<Frame> (*change)(Frame frame)) {
  Sandwich sandwich;
  std::error_code ignored;
  if (!std::filesystem::is_directory(path, ignored)) {
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
    if (is_package(bytes)) {
      if (change) return unsupported(path, "a package does not say what its passes are");
      Result<Package> package = read_package(bytes);
      if (!package) return in_file(path, package.error());
      sandwich.name = std::filesystem::path(path).stem().string();
      sandwich.package = *std::move(package);
      return sandwich;
    }
  }
  SHALE_TRY(ModelFiles model, load_model(path, arguments.frame, arguments.precision));
  if (!model.frame)
    return bad_input(model.path, "has no sandwich; name its frame.json with --frame");
  if (change) {
    SHALE_TRY(model.frame, change(*std::move(model.frame)));
  }
  SHALE_TRY(CompileOptions options, arguments.options(model));
  const auto take = [](std::optional<FrameExtent>& size, std::optional<Extent> from) {
    if (!size && from) size = FrameExtent{from->width, from->height};
  };
  take(options.sizes.render, render);
  take(options.sizes.output, output);
  SHALE_TRY(Compiled compiled, compile_model(model, options));
  for (const std::string& warning : compiled.warnings) print_warning(model.path, warning);
  sandwich.name = model.name;
  sandwich.pattern = model.frame->pattern;
  sandwich.package = std::move(compiled.package);
  sandwich.frame = model.frame;
  if (model.bytes.empty()) return sandwich;
  SHALE_TRY(sandwich.graphs.emplace_back(), import_model(model.bytes, options.import));
  if (!model.frame->chosen_by.empty())
    for (const std::string& file : graph_files(*model.frame)) {
      if (file == graph_files(*model.frame).front()) continue;
      SHALE_TRY(const std::vector<uint8_t> bytes, options.load_model(file));
      SHALE_TRY(sandwich.graphs.emplace_back(), import_model(bytes, options.import));
    }
  for (Graph& graph : sandwich.graphs)
    SHALE_TRY_VOID(match_shapes(graph, sandwich.package.variants.front()));
  return sandwich;
}

bool has_network(const Variant& variant, uint32_t program) {
  const std::span<const Segment> segments = program_segments(variant, program);
  return std::any_of(segments.begin(), segments.end(),
                     [](const Segment& segment) { return segment.kind == SegmentKind::kGraph; });
}

Result<std::unique_ptr<Player>> Player::create(const ToolDevice& device, const Package& package,
                                               Compile compile) {
  const vk::Context& context = device.context();
  const std::string compiles = driver_compiles(package.variants.front(), compile);
  Progress progress(compiles);
  SHALE_TRY(FrameLoop loop, FrameLoop::create(context, package,
                                              {.frames_in_flight = 1,
                                               .cache = device.cache(),
                                               .compile = compile,
                                               .threads = std::thread::hardware_concurrency()}));
  // The device may take another variant than the first.
  SHALE_TRY_VOID(sandwich_sizes(loop.variant()));
  auto player =
      std::unique_ptr<Player>(new Player(context, std::move(loop), "first frame, " + compiles));
  SHALE_TRY_VOID(player->make_images());
  return player;
}

Result<void> Player::make_images() {
  std::vector<VkImageMemoryBarrier> barriers;
  for (const Resource& resource : loop_.variant().resources) {
    const bool is_input = resource.category == Category::kImageInput;
    if (!is_input && resource.category != Category::kImageOutput) continue;
    const bool known =
        is_input ? resource.name == "color" || resource.name == "depth" || resource.name == "motion"
                 : resource.name == "output";
    if (!known)
      return unsupported(
          "image \"" + resource.name + "\"",
          "is none of those that this program fills and shows: color, depth, motion, "
          "output");
    // The view of an image that is copied alone needs a usage by shaders.
    const VkImageUsageFlags usage = loop_.image_usage(resource.name) | VK_IMAGE_USAGE_SAMPLED_BIT;
    HostImage host{&resource, {}, {}};
    SHALE_TRY(host.image, vk::Image::create(context_, resource.format,
                                            {resource.width, resource.height}, usage));
    SHALE_TRY(host.staging,
              vk::Buffer::create(
                  context_, (image_bytes(resource) + 3) / 4 * 4,
                  is_input ? VK_BUFFER_USAGE_TRANSFER_SRC_BIT : VK_BUFFER_USAGE_TRANSFER_DST_BIT,
                  is_input ? vk::MemoryKind::kUpload : vk::MemoryKind::kReadback));
    SHALE_TRY_VOID(
        loop_.bind_image(resource.name, {host.image.view(), vk::vk_format(resource.format),
                                         host.image.extent(), host.image.get()}));
    auto barrier = vk::init<VkImageMemoryBarrier>(VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER);
    barrier.oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
    barrier.newLayout = VK_IMAGE_LAYOUT_GENERAL;
    barrier.srcQueueFamilyIndex = barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.image = host.image.get();
    barrier.subresourceRange = vk::kWholeImage;
    barrier.dstAccessMask = VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
    barriers.push_back(barrier);
    images_.emplace(resource.name, std::move(host));
  }
  if (is_unorm(images_.at("color").resource->format) !=
      is_unorm(images_.at("output").resource->format))
    return unsupported("", "one of color and output is of unorm format, the other is not");
  return vk::submit_and_wait(context_, [&](VkCommandBuffer commands) {
    context_.vk.CmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                                   VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 0, nullptr, 0, nullptr,
                                   static_cast<uint32_t>(barriers.size()), barriers.data());
  });
}

Extent Player::extent_of(const std::string& name) const {
  const Resource& image = *images_.at(name).resource;
  return {image.width, image.height};
}

bool Player::is_display() const { return is_unorm(images_.at("color").resource->format); }

void Player::reset() {
  loop_.reset_history();
  has_past_ = false;
}

Result<void> Player::upload(const SourceFrame& frame) {
  for (auto& [name, host] : images_) {
    if (host.resource->category != Category::kImageInput) continue;
    const FloatImage& from = name == "color"   ? frame.color
                             : name == "depth" ? frame.depth
                                               : frame.motion;
    const uint32_t channels = name == "color" ? 3 : name == "depth" ? 1 : 2;
    if (from.empty())
      return bad_input("", "has no {}, which the sandwich takes; it needs a scene or a dataset",
                       name);
    if (from.width != host.resource->width || from.height != host.resource->height ||
        from.channels < channels)
      return bad_input("", "{} has {}x{} pixels with {} channels, expected {}x{} with {}", name,
                       from.width, from.height, from.channels, host.resource->width,
                       host.resource->height, channels);
    pack_texels(from, host.resource->format, host.staging.mapped());
  }
  return {};
}

Result<void> Player::set_params(const FrameCamera& camera) {
  for (const Param& param : loop_.variant().params) {
    if (param.source != ParamSource::kHost) continue;
    const auto set = [&](std::span<const float> values) {
      return loop_.set_param(param.name, values);
    };
    if (param.name == "jitter") SHALE_TRY_VOID(set(camera.jitter));
    if (param.name == "previous_jitter")
      SHALE_TRY_VOID(set(has_past_ ? previous_jitter_ : camera.jitter));
    if (param.name == "exposure") SHALE_TRY_VOID(set(std::array{camera.exposure}));
    if (param.name == "reverse_depth")
      SHALE_TRY_VOID(set(std::array{camera.reverse_depth ? 1.0f : 0.0f}));
    if (param.name == "depth_to_view")
      SHALE_TRY_VOID(set(depth_to_view({.near_plane = camera.near_plane,
                                        .far_plane = camera.far_plane,
                                        .fov_x = camera.fov_x,
                                        .fov_y = camera.fov_y,
                                        .reverse = camera.reverse_depth})));
  }
  return {};
}

Result<FloatImage> Player::play(const SourceFrame& frame, std::vector<DispatchTime>* times) {
  if (frame.camera.cut) reset();
  SHALE_TRY_VOID(upload(frame));
  SHALE_TRY_VOID(set_params(frame.camera));
  SHALE_TRY_VOID(run(times));
  previous_jitter_ = frame.camera.jitter;
  has_past_ = true;
  exposure_ = frame.camera.exposure;
  return output_picture();
}

FloatImage Player::output_picture() const {
  const HostImage& output = images_.at("output");
  return to_rgb(unpack_texels(output.staging.mapped(), output.resource->format, output_size()));
}

Result<FloatImage> Player::generate(float time, std::vector<DispatchTime>* times) {
  // The loop refuses what no program generates; then it asks for no times.
  const std::optional<Generator>& generator = loop_.variant().generator;
  program_ = generator ? generator->program : 0;
  SHALE_TRY_VOID(submit(
      program_,
      [&](VkCommandBuffer commands, vk::Timestamps* timestamps) {
        return loop_.generate(time, commands, timestamps);
      },
      times));
  return output_picture();
}

Result<FloatImage> Player::show_generated(float time, std::vector<DispatchTime>* times) {
  SHALE_TRY(FloatImage picture, generate(time, times));
  return is_display() ? std::move(picture) : display_image(picture, exposure_);
}

Result<void> Player::run(std::vector<DispatchTime>* times) {
  const std::optional<uint32_t> program = loop_.next_program();
  if (!program)
    return bad_input("", "the package has {} programs, and none is named",
                     loop_.variant().programs.size());
  program_ = *program;
  SHALE_TRY_VOID(submit(
      *program,
      [&](VkCommandBuffer commands, vk::Timestamps* timestamps) {
        return loop_.record(*program, commands, timestamps);
      },
      times));
  if (const std::optional<Promise>& promise = loop_.variant().promise) {
    SHALE_TRY(const FloatImage broken,
              read(loop_.variant().resources[promise->broken].name, false));
    kept_promise_ = broken.values[0] == 0;
  }
  return {};
}

Result<void> Player::submit(
    uint32_t program, const std::function<Result<void>(VkCommandBuffer, vk::Timestamps*)>& record,
    std::vector<DispatchTime>* times) {
  const std::span<const Segment> segments = program_segments(loop_.variant(), program);
  std::optional<vk::Timestamps> timestamps;
  if (times) {
    SHALE_TRY(timestamps, vk::Timestamps::create(context_, interval_count(segments)));
  }
  const HostImage& output = images_.at("output");
  std::optional<Progress> first;
  if (const std::string label = std::exchange(compiles_, {}); !label.empty()) first.emplace(label);
  Result<void> recorded;
  SHALE_TRY_VOID(vk::submit_and_wait(context_, [&](VkCommandBuffer commands) {
    for (const auto& [name, host] : images_) {
      if (host.resource->category != Category::kImageInput) continue;
      const VkBufferImageCopy in = whole(host.image.extent());
      context_.vk.CmdCopyBufferToImage(commands, host.staging.get(), host.image.get(),
                                       VK_IMAGE_LAYOUT_GENERAL, 1, &in);
    }
    vk::memory_barrier(context_, commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_WRITE_BIT | VK_ACCESS_TRANSFER_READ_BIT,
                       VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT);
    recorded = record(commands, timestamps ? &*timestamps : nullptr);
    vk::memory_barrier(context_, commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_READ_BIT);
    const VkBufferImageCopy out = whole(output.image.extent());
    context_.vk.CmdCopyImageToBuffer(commands, output.image.get(), VK_IMAGE_LAYOUT_GENERAL,
                                     output.staging.get(), 1, &out);
    vk::memory_barrier(context_, commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                       VK_ACCESS_HOST_READ_BIT);
  }));
  SHALE_TRY_VOID(recorded);
  if (timestamps) {
    SHALE_TRY(*times, measured_times(*timestamps, segments));
  }
  return {};
}

Result<FloatImage> Player::show(SourceFrame& frame, std::vector<DispatchTime>* times) {
  if (is_display()) {
    frame.color = display_image(frame.color, frame.camera.exposure);
    return play(frame, times);
  }
  SHALE_TRY(const FloatImage linear, play(frame, times));
  return display_image(linear, frame.camera.exposure);
}

Result<void> Player::warm_up(const SourceFrame& frame) {
  const Result<FloatImage> ignored = play(frame);
  if (!ignored) return ignored.error();
  reset();
  return {};
}

const Resource* Player::resource(const std::string& name) const {
  for (const Resource& each : loop_.variant().resources)
    if (each.name == name) return &each;
  return nullptr;
}

Result<Tensor> Player::read_tensor(const std::string& name) const {
  SHALE_TRY(const TensorView view, loop_.tensor(name));
  const Resource& tensor = *resource(name);
  SHALE_TRY(const vk::Buffer buffer, download(context_, view));
  Tensor result{{tensor.dtype, tensor.shape}, {}};
  result.bytes.assign(buffer.mapped().begin(),
                      buffer.mapped().begin() + static_cast<std::ptrdiff_t>(tensor.size_bytes));
  return result;
}

Result<std::vector<uint8_t>> Player::texels(const Resource& image) const {
  if (is_linear(image)) {
    SHALE_TRY(const TensorView view, loop_.tensor(image.name));
    SHALE_TRY(const vk::Buffer buffer, download(context_, view));
    return dense_rows(buffer.mapped(), image);
  }
  VkImage from = VK_NULL_HANDLE;
  if (const auto host = images_.find(image.name); host != images_.end()) {
    from = host->second.image.get();
  } else {
    SHALE_TRY(from, loop_.image(image.name));
  }
  SHALE_TRY(const vk::Buffer buffer,
            download(context_, (image_bytes(image) + 3) / 4 * 4,
                     [&](VkCommandBuffer commands, VkBuffer to) {
                       const VkBufferImageCopy copy = whole({image.width, image.height});
                       context_.vk.CmdCopyImageToBuffer(commands, from, VK_IMAGE_LAYOUT_GENERAL, to,
                                                        1, &copy);
                     }));
  return std::vector<uint8_t>(
      buffer.mapped().begin(),
      buffer.mapped().begin() + static_cast<std::ptrdiff_t>(image_bytes(image)));
}

Result<Tensor> Player::read_words(const std::string& name) const {
  const Resource* image = resource(name);
  if (!image || !is_image(image->category) || image->format != ImageFormat::kR32Uint)
    return bad_input("", "there is no image \"{}\" of words", name);
  Tensor words{{DType::kInt32, {image->height, image->width}}, {}};
  SHALE_TRY(words.bytes, texels(*image));
  return words;
}

Result<FloatImage> Player::read(const std::string& name, bool real) const {
  const Resource* wanted = resource(name);
  if (!wanted) return bad_input("", "there is no image or tensor \"{}\"", name);
  if (is_image(wanted->category)) {
    SHALE_TRY(const std::vector<uint8_t> bytes, texels(*wanted));
    return unpack_texels(bytes, wanted->format, {wanted->width, wanted->height});
  }
  SHALE_TRY(const Tensor tensor, read_tensor(name));
  const Shape& shape = tensor.type.shape;
  if (shape.size() != 4 || shape[0] != 1)
    return bad_input("", "tensor \"{}\" is not NHWC with one batch", name);
  FloatImage result{static_cast<uint32_t>(shape[2]),
                    static_cast<uint32_t>(shape[1]),
                    static_cast<uint32_t>(shape[3]),
                    {}};
  const Quantization quantization =
      real ? wanted->quantization.value_or(Quantization{}) : Quantization{};
  result.values.reserve(static_cast<size_t>(tensor.count()));
  for (int64_t i = 0; i < tensor.count(); ++i)
    result.values.push_back(quantization.scale *
                            static_cast<float>(tensor.get(i) - quantization.zero_point));
  return result;
}

Result<std::vector<Panel>> Player::views() const {
  std::map<std::string, FloatImage> known;
  std::vector<Panel> panels;
  for (const View& view : loop_.variant().views) {
    const std::string& name = loop_.variant().resources[view.resource].name;
    if (!known.contains(name)) {
      SHALE_TRY(known[name], read(name, true));
    }
    const FloatImage& from = known.at(name);
    Picture picture = Picture::filled(from.width, from.height, 0);
    for (size_t i = 0; i < size_t{from.width} * from.height; ++i) {
      for (uint32_t c = 0; c < 3; ++c) {
        // One channel shows as grey, two as red and green around the middle of blue.
        const uint32_t channel = view.channels == 1 ? 0 : c;
        float shown = 0.5f;
        if (channel < view.channels)
          shown = (from.values[i * from.channels + view.first_channel + channel] - view.low) /
                  (view.high - view.low);
        picture.rgba[i * 4 + c] =
            shown > 0 ? static_cast<uint8_t>(std::lround(std::min(shown, 1.0f) * 255)) : uint8_t{0};
      }
    }
    panels.push_back({view.title, std::move(picture)});
  }
  return panels;
}

Result<std::optional<std::string>> network_difference(const Player& player,
                                                      const std::vector<Graph>& graphs) {
  const std::vector<const Resource*> results = tensors_of(player.variant(), Category::kOutput);
  std::vector<Tensor> inputs, outputs;
  for (const Resource* resource : tensors_of(player.variant(), Category::kInput)) {
    SHALE_TRY(Tensor tensor, player.read_tensor(resource->name));
    inputs.push_back(std::move(tensor));
  }
  for (const Resource* resource : results) {
    SHALE_TRY(Tensor tensor, player.read_tensor(resource->name));
    outputs.push_back(std::move(tensor));
  }
  const Graph& graph = graphs[graphs.size() > 1 ? player.program() : 0];
  SHALE_TRY(
      const std::vector<OutputCheck> checks,
      check_outputs(graph, inputs, outputs, [](uint32_t, uint32_t) { return !interrupted(); }));
  for (size_t i = 0; i < outputs.size(); ++i)
    if (checks[i].difference)
      return std::optional("output \"" + results[i]->name + "\": " + *checks[i].difference);
  return std::optional<std::string>();
}

}  // namespace shale
