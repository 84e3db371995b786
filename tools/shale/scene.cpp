// shale scene: renders scenes into a dataset on disk.
#include <charconv>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <numeric>

#include "ir/base/file.h"
#include "tools/eval/tonemap.h"
#include "tools/scene/dataset.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/measure_needs.h"
#include "tools/shale/outputs.h"
#include "tools/shale/picture.h"
#include "tools/shale/source.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

/// Of a data set, whose sequences have numbers of four digits.
constexpr uint32_t kMaxSequences = 10000;

struct Arguments {
  std::vector<std::string> scenes, crops;
  std::string needs, output, render = "960x540", size, pattern = "halton";
  double ratio = 2, frame_rate = 0;
  uint32_t first = 0, frames = 0;
  uint32_t random_crops = 0, crop_size = 256, clip_length = 16, seed = 1, number = 0;
  bool png = false, reverse_depth = false, no_truth = false, json = false;
  DeviceArguments device;
};

Result<Extent> extent_of(const std::string& option, const std::string& text) {
  SHALE_TRY(const auto extent, parse_extent(option, text));
  return Extent{extent.width, extent.height};
}

Result<Crop> parse_crop(const std::string& text) {
  Crop crop;
  const char* at = text.data();
  const char* const end = at + text.size();
  for (uint32_t* number : {&crop.x, &crop.y, &crop.width, &crop.height}) {
    const auto [next, error] = std::from_chars(at, end, *number);
    const bool is_last = number == &crop.height;
    if (error != std::errc() || (is_last ? next != end : next == end || *next != ','))
      return bad_input("--crop", "\"{}\" is not of the form X,Y,WIDTH,HEIGHT", text);
    at = is_last ? next : next + 1;
  }
  return crop;
}

/// The clips of one scene that the command line asks for.
Result<std::vector<SceneClip>> clips_of(const Arguments& arguments, const std::vector<Crop>& crops,
                                        const Scene& scene, uint32_t scene_index, Extent render,
                                        Extent output) {
  std::vector<SceneClip> clips;
  for (const Crop& crop : crops) clips.push_back({arguments.first, arguments.frames, crop});
  if (arguments.random_crops > 0) {
    const uint32_t frames = frames_at_rate(scene, arguments.frame_rate);
    const uint32_t length = std::min(arguments.clip_length, frames);
    const uint32_t step_x = output.width / std::gcd(render.width, output.width);
    const uint32_t step_y = output.height / std::gcd(render.height, output.height);
    const uint32_t width = arguments.crop_size / step_x * step_x;
    const uint32_t height = arguments.crop_size / step_y * step_y;
    if (width == 0 || height == 0 || width > output.width || height > output.height)
      return bad_input("--crop-size", "{} does not fit into {}x{}", arguments.crop_size,
                       output.width, output.height);
    uint32_t count = 0;
    const auto random = [&](uint32_t below) {
      const uint32_t own = scene_hash(arguments.seed, scene_index);
      return static_cast<uint32_t>(uint64_t{scene_hash(own, count++)} * below >> 32);
    };
    for (uint32_t i = 0; i < arguments.random_crops; ++i) {
      SceneClip clip;
      clip.first_frame = random(frames - length + 1);
      clip.frame_count = length;
      const uint32_t x = random((output.width - width) / step_x + 1) * step_x;
      const uint32_t y = random((output.height - height) / step_y + 1) * step_y;
      clip.crop = Crop{x, y, width, height};
      clips.push_back(clip);
    }
  }
  if (clips.empty()) clips.push_back({arguments.first, arguments.frames, {}});
  return clips;
}

/// Displayed colour and truth, for people to look at.
Result<void> save_previews(const fs::path& root, uint32_t number, uint32_t index,
                           const SourceFrame& frame) {
  for (const auto& [name, image] :
       {std::pair{"color", &frame.color}, std::pair{"truth", &frame.truth}}) {
    if (image->empty()) continue;
    const fs::path folder = root / "preview" / fmt::format("{:04}", number);
    SHALE_TRY_VOID(make_folder(folder.string()));
    SHALE_TRY_VOID(save_png((folder / fmt::format("{:04}_{}.png", index, name)).string(),
                            to_picture(display_image(*image, frame.camera.exposure))));
  }
  return {};
}

/// --needs: looks at the frames of scenes and datasets, and writes what they need.
Result<int> write_needs(const Arguments& arguments) {
  Outputs outputs(arguments.json);
  outputs.keep(arguments.scenes);
  SHALE_TRY_VOID(outputs.claim("--needs", arguments.needs));
  SHALE_TRY(const Extent render, extent_of("--render", arguments.render));
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  std::optional<SceneNeeds> all;
  {
    Progress progress("looking at frames");
    size_t seen = 0;
    SourceArguments from;
    from.frames = arguments.frames;
    from.first = arguments.first;
    for (const std::string& path : arguments.scenes) {
      std::unique_ptr<FrameSource> source;
      SceneSource* scene = nullptr;
      switch (source_kind(path)) {
        case SourceKind::kPictures:
          return bad_input(path,
                           "is neither a scene (.json) nor a dataset (a folder with 0000.json)");
        case SourceKind::kDataset: {
          SHALE_TRY(source, open_dataset(path, from));
          break;
        }
        case SourceKind::kScene: {
          SHALE_TRY(std::unique_ptr<SceneSource> opened,
                    open_scene(path, from, device, render, render, {}));
          scene = opened.get();
          source = std::move(opened);
        }
      }
      NeedsMeter meter;
      for (uint32_t i = 0; i < source->frame_count(); ++i) {
        if (!progress.step(++seen, 0)) return bad_input("", "interrupted");
        Result<SourceFrame> frame = source->frame(i, false);
        if (!frame) return in_file(path, frame.error());
        if (Result<void> added = meter.add(*frame); !added)
          return in_file(fmt::format("{} frame {}", path, i), added.error());
      }
      SceneNeeds own = meter.needs();
      if (scene) own = needs_of_scene(scene->scene(), arguments.first, source->frame_count(), own);
      all = all ? united(*all, own) : own;
    }
  }
  SHALE_TRY_VOID(device.close());
  const std::string text = needs_text(*all);
  outputs.note(write_text(arguments.needs, text));
  if (!outputs.has_standard_output() || arguments.json) fmt::print("{}", text);
  return outputs.all_written() ? kDone : kRefused;
}

Result<int> run(const Arguments& arguments) {
  if (arguments.needs.empty() == arguments.output.empty())
    return bad_input("", "expected either -o, a dataset to write, or --needs");
  if (!arguments.needs.empty()) return write_needs(arguments);
  const size_t sequences = arguments.scenes.size() *
                           std::max<size_t>(arguments.crops.size() + arguments.random_crops, 1);
  if (arguments.number + sequences > kMaxSequences)
    return bad_input("--number", "{} sequences from {} on do not end at {}", sequences,
                     arguments.number, kMaxSequences - 1);
  SHALE_TRY(const Extent render, extent_of("--render", arguments.render));
  // Readers divide by the ratio and round down.
  const auto larger = [&](uint32_t side) {
    const auto nearest = static_cast<uint32_t>(std::lround(side * arguments.ratio));
    return std::floor(nearest / arguments.ratio) < side ? nearest + 1 : nearest;
  };
  Extent output{larger(render.width), larger(render.height)};
  if (!arguments.size.empty()) {
    SHALE_TRY(output, extent_of("--output-size", arguments.size));
  }
  Result<SamplingPattern> pattern = parse_pattern(arguments.pattern);
  if (!pattern) return in_file("--pattern", pattern.error());
  std::vector<Scene> scenes;
  for (const std::string& path : arguments.scenes) {
    SHALE_TRY(Scene scene, load_scene(path));
    scenes.push_back(std::move(scene));
  }
  std::vector<Crop> crops;
  for (const std::string& text : arguments.crops) {
    SHALE_TRY(crops.emplace_back(), parse_crop(text));
  }
  SHALE_TRY_VOID(make_folder(arguments.output));
  Outputs outputs(arguments.json);
  outputs.keep(arguments.scenes);
  for (uint32_t i = 0; i < sequences; ++i) {
    const std::string file = fmt::format("{:04}.json", arguments.number + i);
    SHALE_TRY_VOID(outputs.claim("-o", (fs::path(arguments.output) / file).string()));
  }
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  Json json{{"device", device.context().caps.name}, {"sequences", Json::array()}};
  uint32_t number = arguments.number;
  double total_s = 0;
  size_t total_frames = 0;
  {
    Progress progress("rendering");
    for (uint32_t s = 0; s < scenes.size(); ++s) {
      SHALE_TRY(const std::vector<SceneClip> clips,
                clips_of(arguments, crops, scenes[s], s, render, output));
      SceneOptions options;
      options.render = render;
      options.output = output;
      options.clip = clips[0];
      options.frame_rate = arguments.frame_rate;
      options.pattern = *pattern;
      options.keep_going = [] { return !interrupted(); };
      options.cache = device.cache();
      if (arguments.reverse_depth) options.reverse_depth = true;
      Result<std::unique_ptr<SceneSource>> created =
          SceneSource::create(device.context(), scenes[s], options);
      if (!created) return in_file(arguments.scenes[s], created.error());
      SceneSource& source = **created;
      for (const SceneClip& clip : clips) {
        if (Result<void> set = source.set_clip(clip); !set)
          return in_file(arguments.scenes[s], set.error());
        SequenceInfo info;
        info.number = number;
        info.render = source.render_size();
        info.output = source.output_size();
        info.frame_rate =
            arguments.frame_rate > 0 ? arguments.frame_rate : source.scene().frame_rate;
        info.sampling = pattern_name(*pattern);
        info.jitter_phases = jitter_phases(render, output, *pattern);
        info.ratio = arguments.size.empty() ? arguments.ratio : ratio_of_sizes(render, output);
        SHALE_TRY(DatasetWriter writer, DatasetWriter::create(arguments.output, info));
        double render_s = 0;
        for (uint32_t i = 0; i < source.frame_count(); ++i) {
          const auto start = std::chrono::steady_clock::now();
          Result<SourceFrame> frame = source.frame(i, !arguments.no_truth);
          if (!frame) return in_file(arguments.scenes[s], frame.error());
          render_s +=
              std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
          SHALE_TRY_VOID(writer.add(*frame));
          if (arguments.png) SHALE_TRY_VOID(save_previews(arguments.output, number, i, *frame));
          if (!progress.step(++total_frames, 0)) return bad_input("", "interrupted");
        }
        SHALE_TRY_VOID(writer.finish());
        Json entry{{"number", number},
                   {"scene", source.name()},
                   {"first_frame", clip.first_frame},
                   {"frames", source.frame_count()},
                   {"render", {source.render_size().width, source.render_size().height}},
                   {"output", {source.output_size().width, source.output_size().height}}};
        if (clip.crop) entry["crop"] = {clip.crop->x, clip.crop->y};
        entry["ms_per_frame"] = render_s * 1000 / source.frame_count();
        json["sequences"].push_back(std::move(entry));
        total_s += render_s;
        ++number;
      }
    }
  }
  SHALE_TRY_VOID(device.close());
  if (arguments.json) {
    print_json(json);
    return kDone;
  }
  for (const Json& entry : json["sequences"])
    fmt::print("{:04} {}: frames {} to {}, {}x{} -> {}x{}, {:.0f} ms a frame\n",
               entry["number"].get<uint32_t>(), entry["scene"].get<std::string>(),
               entry["first_frame"].get<uint32_t>(),
               entry["first_frame"].get<uint32_t>() + entry["frames"].get<uint32_t>() - 1,
               entry["render"][0].get<uint32_t>(), entry["render"][1].get<uint32_t>(),
               entry["output"][0].get<uint32_t>(), entry["output"][1].get<uint32_t>(),
               entry["ms_per_frame"].get<double>());
  fmt::print("{} frames in {:.1f} s of rendering -> {}\n", total_frames, total_s, arguments.output);
  return kDone;
}

}  // namespace

Action add_scene(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("scene", arguments->scenes, "scene files (.json); each starts a new sequence")
      ->required();
  app.add_option("-o,--output", arguments->output, "folder of the dataset to write");
  app.add_option(
      "--needs", arguments->needs,
      "write what the frames need of an upscaler (.json) instead, for shale compile --needs; "
      "of datasets (folders), too");
  app.add_option("--render", arguments->render, "size of the rendered pictures (default 960x540)");
  auto* ratio = app.add_option("--ratio", arguments->ratio, "output size over render size")
                    ->check(number_in(1, 8));
  app.add_option("--output-size", arguments->size, "size of the truth, instead of --ratio")
      ->excludes(ratio);
  app.add_option("--pattern", arguments->pattern,
                 "where in its pixels a frame is sampled: halton, mnss, or a list of offsets from "
                 "their centres, X,Y:X,Y (default halton)");
  app.add_option("--frames", arguments->frames, "number of frames (default: all)")
      ->check(CLI::Range(1u, kMaxSceneFrames));
  app.add_option("--first", arguments->first, "first frame of the scene")
      ->check(CLI::Range(0u, kMaxSceneFrames));
  app.add_option("--frame-rate", arguments->frame_rate,
                 "frames a second; what moves is as fast as at the scene's own rate")
      ->check(number_in(1, 1000));
  app.add_option("--crop", arguments->crops,
                 "X,Y,WIDTH,HEIGHT of the output that is the picture (again for more sequences)")
      ->allow_extra_args(false);
  app.add_option("--random-crops", arguments->random_crops,
                 "draw this many crops and first frames from each scene")
      ->check(CLI::Range(1u, kMaxSequences));
  app.add_option("--crop-size", arguments->crop_size, "side of a random crop, output pixels")
      ->check(CLI::Range(8, 8192));
  app.add_option("--clip-length", arguments->clip_length, "frames of a random crop")
      ->check(CLI::Range(1, 100000));
  app.add_option("--seed", arguments->seed, "for the random crops");
  app.add_option("--number", arguments->number, "of the first sequence (default 0)")
      ->check(CLI::Range(0u, kMaxSequences - 1));
  app.add_flag("--no-truth", arguments->no_truth, "leave out what is at output size");
  app.add_flag("--png", arguments->png, "also write displayable pictures, below preview/");
  app.add_flag("--reverse-depth", arguments->reverse_depth, "depth 1 is near");
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale scene models/scenes/test/thin.json -o thin --render 960x540 --ratio 2 "
      "--frames 16 --png\n"
      "Example: shale scene models/scenes/test/still.json --needs still_needs.json\n"
      "Example: shale scene models/scenes/train/*.json -o clips --random-crops 40 --crop-size 256");
  return [arguments] { return run(*arguments); };
}

}  // namespace shale
