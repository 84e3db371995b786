// shale play: pictures through a model's sandwich, on the device.
#include <algorithm>
#include <filesystem>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "runtime/frame/frame_loop.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/memory.h"
#include "runtime/vk/timestamps.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/picture.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string model, input, output, compare, reference;
  std::vector<uint32_t> crop;
  uint32_t zoom = 4;
  CompileArguments compile;
  DeviceArguments device;
  bool profile = false, json = false;
};

/// The picture itself, or the pictures of a folder in order of their names.
Result<std::vector<std::string>> input_files(const std::string& path) {
  std::error_code error;
  if (!fs::is_directory(path, error)) return std::vector<std::string>{path};
  std::vector<std::string> files;
  fs::directory_iterator it(path, error);
  for (; !error && it != fs::directory_iterator(); it.increment(error)) {
    std::string extension = it->path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    for (const char* known : {".png", ".jpg", ".jpeg", ".bmp", ".tga"})
      if (extension == known) files.push_back(it->path().string());
  }
  if (error) return io_error(path, "cannot list: {}", error.message());
  if (files.empty()) return bad_input(path, "holds no picture (.png, .jpg, .bmp, .tga)");
  std::sort(files.begin(), files.end());
  return files;
}

/// A package as it is, or a model compiled for pictures of this size.
Result<Package> package_for(const Arguments& arguments, const Picture& picture) {
  std::error_code ignored;
  if (!fs::is_directory(arguments.model, ignored)) {
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file(arguments.model));
    if (is_package(bytes)) {
      Result<Package> package = read_package(bytes);
      if (!package) return in_file(arguments.model, package.error());
      return package;
    }
  }
  SHALE_TRY(const ModelFiles model, load_model(arguments.model, arguments.compile.frame));
  if (!model.frame)
    return bad_input(model.path, "has no sandwich; name its frame.json with --frame");
  SHALE_TRY(CompileOptions options, arguments.compile.options(model));
  const Result<Graph> graph = import_model(model.bytes);
  if (!graph) return in_file(model.path, graph.error());
  const Value& first = graph->inputs.empty() ? Value{} : graph->value(graph->inputs[0]);
  if (first.type.shape.size() != 4) return bad_input(model.path, "its first input is not NHWC");
  if (options.passes.input_shapes.empty())
    options.passes.input_shapes[first.name] = {1, picture.height, picture.width,
                                               first.type.shape[3]};
  SHALE_TRY(Compiled compiled, compile_model(model, options));
  for (const std::string& warning : compiled.warnings)
    fmt::print(stderr, "{}: warning: {}\n", model.path, warning);
  return std::move(compiled.package);
}

/// A frame loop on a device of our own with the images that it asks for.
class Player {
 public:
  static Result<std::unique_ptr<Player>> create(const ToolDevice& device, const Package& package) {
    const vk::Context& context = device.context();
    SHALE_TRY(FrameLoop loop, FrameLoop::create(context, package,
                                                {.frames_in_flight = 1, .cache = device.cache()}));
    auto player = std::unique_ptr<Player>(new Player(context, std::move(loop)));
    SHALE_TRY_VOID(player->make_images());
    return player;
  }

  /// A frame that leaves no trace: drivers may compile a shader at its first dispatch.
  Result<void> warm_up(const Picture& picture) {
    const Result<Picture> ignored = play(picture, nullptr);
    if (!ignored) return ignored.error();
    loop_.reset_history();
    return {};
  }

  /// One frame; `times` gains its dispatches.
  Result<Picture> play(const Picture& picture, std::vector<DispatchTime>* times) {
    if (picture.width != input_->width || picture.height != input_->height)
      return bad_input("", "has {}x{} pixels, the package was compiled for {}x{}", picture.width,
                       picture.height, input_->width, input_->height);
    std::copy(picture.rgba.begin(), picture.rgba.end(), upload_.mapped().begin());
    const std::span<const Segment> segments(loop_.variant().segments);
    std::optional<vk::Timestamps> timestamps;
    if (times) {
      SHALE_TRY(timestamps, vk::Timestamps::create(context_, interval_count(segments)));
    }
    Result<void> recorded;
    SHALE_TRY_VOID(vk::submit_and_wait(context_, [&](VkCommandBuffer commands) {
      const VkBufferImageCopy in = whole(input_image_);
      vkCmdCopyBufferToImage(commands, upload_.get(), input_image_.get(), VK_IMAGE_LAYOUT_GENERAL,
                             1, &in);
      vk::memory_barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT,
                         VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                         VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT);
      if (timestamps) timestamps->start(commands);
      recorded = loop_.record(commands, timestamps ? &*timestamps : nullptr);
      vk::memory_barrier(commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT,
                         VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_READ_BIT);
      const VkBufferImageCopy out = whole(output_image_);
      vkCmdCopyImageToBuffer(commands, output_image_.get(), VK_IMAGE_LAYOUT_GENERAL,
                             download_.get(), 1, &out);
      vk::memory_barrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT,
                         VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT);
    }));
    SHALE_TRY_VOID(recorded);
    if (timestamps) {
      SHALE_TRY(*times, measured_times(*timestamps, segments));
    }
    Picture result = Picture::filled(output_->width, output_->height, 0);
    const std::span<uint8_t> mapped = download_.mapped();
    std::copy_n(mapped.begin(), result.rgba.size(), result.rgba.begin());
    for (size_t i = 3; i < result.rgba.size(); i += 4) result.rgba[i] = 255;
    return result;
  }

 private:
  Player(const vk::Context& context, FrameLoop loop) : context_(context), loop_(std::move(loop)) {}

  static VkBufferImageCopy whole(const vk::Image& image) {
    VkBufferImageCopy copy{};
    copy.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
    copy.imageExtent = {image.extent().width, image.extent().height, 1};
    return copy;
  }

  Result<void> make_images() {
    for (const Resource& resource : loop_.variant().resources) {
      const bool is_input = resource.category == Category::kImageInput;
      if (!is_input && resource.category != Category::kImageOutput) continue;
      const Resource*& known = is_input ? input_ : output_;
      if (known || resource.format != ImageFormat::kRgba8Unorm)
        return unsupported("image \"" + resource.name + "\"",
                           "play takes sandwiches with one rgba8_unorm image in and one out");
      known = &resource;
      const VkImageUsageFlags usage =
          is_input ? VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT
                   : VK_IMAGE_USAGE_STORAGE_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT;
      SHALE_TRY(vk::Image image, vk::Image::create(context_, resource.format,
                                                   {resource.width, resource.height}, usage));
      SHALE_TRY_VOID(loop_.bind_image(
          resource.name, {image.view(), vk::vk_format(resource.format), image.extent()}));
      (is_input ? input_image_ : output_image_) = std::move(image);
    }
    if (!input_ || !output_)
      return bad_input("", "the package has no sandwich: it was compiled without a frame.json");
    const auto bytes = [](const Resource& r) { return uint64_t{r.width} * r.height * 4; };
    SHALE_TRY(upload_,
              vk::Buffer::create(context_, bytes(*input_), VK_BUFFER_USAGE_TRANSFER_SRC_BIT,
                                 vk::MemoryKind::kUpload));
    SHALE_TRY(download_,
              vk::Buffer::create(context_, bytes(*output_), VK_BUFFER_USAGE_TRANSFER_DST_BIT,
                                 vk::MemoryKind::kReadback));
    return vk::submit_and_wait(context_, [&](VkCommandBuffer commands) {
      for (const vk::Image* image : {&input_image_, &output_image_}) {
        VkImageMemoryBarrier barrier{};
        barrier.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER;
        barrier.oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
        barrier.newLayout = VK_IMAGE_LAYOUT_GENERAL;
        barrier.srcQueueFamilyIndex = barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
        barrier.image = image->get();
        barrier.subresourceRange = vk::kWholeImage;
        barrier.dstAccessMask = VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
        vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                             VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 0, nullptr, 0, nullptr, 1,
                             &barrier);
      }
    });
  }

  const vk::Context& context_;
  FrameLoop loop_;
  const Resource* input_ = nullptr;
  const Resource* output_ = nullptr;
  vk::Image input_image_, output_image_;
  vk::Buffer upload_, download_;
};

/// Input, nearest, Lanczos and result as panels of one picture, whole or a magnified part.
Result<Picture> comparison(const Arguments& arguments, const Picture& input,
                           const Picture& result) {
  const Picture nearest = upscale_nearest(input, result.width, result.height);
  const Picture lanczos = upscale_lanczos(input, result.width, result.height);
  if (arguments.crop.empty())
    return side_by_side({{fmt::format("input {}x{}", input.width, input.height), input},
                         {"nearest", nearest},
                         {"Lanczos", lanczos},
                         {"network", result}},
                        2);
  const std::vector<uint32_t>& c = arguments.crop;
  const auto part = [&](const Picture& picture) {
    return magnify(picture, c[0], c[1], c[2], c[3], arguments.zoom);
  };
  std::vector<Panel> panels{
      {"nearest", part(nearest)}, {"Lanczos", part(lanczos)}, {"network", part(result)}};
  if (!arguments.reference.empty()) {
    SHALE_TRY(const Picture reference, load_picture(arguments.reference));
    panels.push_back({"reference", part(reference)});
  }
  return side_by_side(panels, 2);
}

Result<int> play(const Arguments& arguments) {
  if (!arguments.crop.empty() && arguments.crop.size() != 4)
    return bad_input("--crop", "expected X,Y,WIDTH,HEIGHT");
  for (size_t i = 2; i < arguments.crop.size(); ++i)
    if (arguments.crop[i] < 1 || arguments.crop[i] > 2048)
      return bad_input("--crop", "a side of {} is outside 1..2048", arguments.crop[i]);
  SHALE_TRY(const std::vector<std::string> files, input_files(arguments.input));
  std::error_code ignored;
  const bool to_folder = files.size() > 1 || fs::is_directory(arguments.input, ignored) ||
                         fs::is_directory(arguments.output, ignored);
  if (to_folder) {
    std::error_code error;
    fs::create_directories(arguments.output, error);
    if (error) return io_error(arguments.output, "cannot create: {}", error.message());
  }
  SHALE_TRY(Picture picture, load_picture(files[0]));
  SHALE_TRY(const Package package, package_for(arguments, picture));
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  std::vector<std::vector<DispatchTime>> measured;
  Json json{{"device", device.context().caps.name}, {"frames", Json::array()}};
  {
    SHALE_TRY(const std::unique_ptr<Player> player, Player::create(device, package));
    Progress progress("playing");
    for (size_t i = 0; i < files.size(); ++i) {
      if (!progress.step(i, files.size())) return bad_input("", "interrupted after {} pictures", i);
      if (i > 0) {
        SHALE_TRY(picture, load_picture(files[i]));
      }
      if (i == 0 && arguments.profile) {
        if (Result<void> warm = player->warm_up(picture); !warm)
          return in_file(files[i], warm.error());
      }
      std::vector<DispatchTime> times;
      Result<Picture> result = player->play(picture, arguments.profile ? &times : nullptr);
      if (!result) return in_file(files[i], result.error());
      if (arguments.profile) measured.push_back(std::move(times));
      const std::string output =
          to_folder ? (fs::path(arguments.output) / (fs::path(files[i]).stem().string() + ".png"))
                          .string()
                    : arguments.output;
      SHALE_TRY_VOID(save_png(output, *result));
      Json frame{{"input", files[i]},
                 {"output", output},
                 {"width", result->width},
                 {"height", result->height}};
      if (!arguments.reference.empty() && files.size() == 1) {
        SHALE_TRY(const Picture reference, load_picture(arguments.reference));
        if (reference.width != result->width || reference.height != result->height)
          return bad_input(arguments.reference, "has {}x{} pixels, the result {}x{}",
                           reference.width, reference.height, result->width, result->height);
        frame["psnr_db"] = {
            {"nearest",
             psnr_db(upscale_nearest(picture, result->width, result->height), reference)},
            {"lanczos",
             psnr_db(upscale_lanczos(picture, result->width, result->height), reference)},
            {"network", psnr_db(*result, reference)}};
      }
      if (!arguments.compare.empty() && i == 0) {
        SHALE_TRY(const Picture panels, comparison(arguments, picture, *result));
        SHALE_TRY_VOID(save_png(arguments.compare, panels));
      }
      json["frames"].push_back(std::move(frame));
    }
  }
  SHALE_TRY_VOID(device.close());
  const std::vector<DispatchTime> median = median_times(measured);
  double total_us = 0;
  for (const DispatchTime& time : median) total_us += time.time_us;
  for (const DispatchTime& time : median)
    json["dispatches"].push_back({{"segment", time.segment},
                                  {"name", time.name},
                                  {"kernel", time.kernel},
                                  {"time_us", time.time_us},
                                  {"share", total_us > 0 ? time.time_us / total_us : 0}});
  if (arguments.json) {
    print_json(json);
    return kDone;
  }
  for (const Json& frame : json["frames"]) {
    fmt::print("{} -> {} ({}x{})\n", frame["input"].get<std::string>(),
               frame["output"].get<std::string>(), frame["width"].get<uint32_t>(),
               frame["height"].get<uint32_t>());
    if (frame.contains("psnr_db"))
      for (const auto& [name, value] : frame["psnr_db"].items())
        fmt::print("  PSNR {:<8} {:.2f} dB\n", name, value.get<double>());
  }
  for (const DispatchTime& time : median)
    fmt::print("  {:>10.1f} us {:>5.1f} %  {:<6} {:<20} {}\n", time.time_us,
               total_us > 0 ? 100 * time.time_us / total_us : 0.0, time.segment, time.kernel,
               time.name);
  if (arguments.profile)
    fmt::print("  {:>10.1f} us a frame, median of {}\n", total_us, measured.size());
  return kDone;
}

}  // namespace

Action add_play(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("model", arguments->model,
                 "model folder, model file with --frame, or package with a sandwich")
      ->required();
  app.add_option("-i,--input", arguments->input, "picture, or folder of pictures of one size")
      ->required();
  app.add_option("-o,--output", arguments->output,
                 "picture to write (.png), or folder for a folder")
      ->required();
  app.add_option("--compare", arguments->compare,
                 "also write input, nearest, Lanczos and result side by side (.png)");
  app.add_option("--crop", arguments->crop,
                 "X,Y,WIDTH,HEIGHT of the result to show in --compare, magnified")
      ->delimiter(',');
  app.add_option("--zoom", arguments->zoom, "magnification of --crop")->check(CLI::Range(1, 16));
  app.add_option("--reference", arguments->reference,
                 "high-resolution picture to measure PSNR against");
  app.add_flag("--profile", arguments->profile, "print the time of each dispatch");
  arguments->compile.add_to(app);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale play models/srpo_x2 -i models/pictures/raster_lr.png -o result.png --compare "
      "panels.png --profile");
  return [arguments] { return play(*arguments); };
}

}  // namespace shale
