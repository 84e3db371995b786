// shale play: pictures, scenes or captured frames through a sandwich, on the device.
#include <algorithm>
#include <filesystem>

#include "ir/base/file.h"
#include "tools/eval/tonemap.h"
#include "tools/scene/exr.h"
#include "tools/shale/animation.h"
#include "tools/shale/choices.h"
#include "tools/shale/command.h"
#include "tools/shale/npy.h"
#include "tools/shale/outputs.h"
#include "tools/shale/pictures.h"
#include "tools/shale/player.h"
#include "tools/shale/source.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

constexpr uint32_t kMosaicWidth = 480;  ///< of a panel
constexpr uint32_t kMaxPanel = 8192;    ///< side of a magnified part
constexpr uint32_t kFrameRate = 30;     ///< of frames that are not generated, in an animation

struct Arguments {
  std::string model, input, output, format, compare, reference, animation, debug_view, dump;
  std::vector<uint32_t> crop;
  uint32_t zoom = 4, repeat = 0, generate = 0;
  BudgetArguments budget;
  SourceArguments source;
  CompileArguments compile;
  DeviceArguments device;
  bool profile = false, check = false, json = false;
};

/// The picture itself, or the pictures of a folder in order of their names.
Result<std::vector<std::string>> input_files(const std::string& path) {
  std::error_code error;
  if (!fs::is_directory(path, error)) return std::vector<std::string>{path};
  std::vector<std::string> files;
  fs::directory_iterator it(path, error);
  for (; !error && it != fs::directory_iterator(); it.increment(error)) {
    const std::string extension = extension_of(it->path().string());
    for (const char* known : {".png", ".jpg", ".jpeg", ".bmp", ".tga"})
      if (extension == known) files.push_back(it->path().string());
  }
  if (error) return io_error(path, "cannot list: {}", error.message());
  if (files.empty())
    return bad_input(path,
                     "holds neither a dataset (0000.json) nor a picture (.png, .jpg, .bmp, "
                     ".tga)");
  std::sort(files.begin(), files.end());
  return files;
}

/// Pictures as frames without depth, motion or truth, for sandwiches that take displayed colours.
class PictureSource : public FrameSource {
 public:
  static Result<std::unique_ptr<FrameSource>> open(const std::string& path) {
    auto source = std::unique_ptr<PictureSource>(new PictureSource);
    SHALE_TRY(source->files_, input_files(path));
    SHALE_TRY(const Picture first, load_picture(source->files_[0]));
    source->size_ = {first.width, first.height};
    return std::unique_ptr<FrameSource>(std::move(source));
  }

  const std::string& name() const override { return files_[0]; }
  uint32_t frame_count() const override { return static_cast<uint32_t>(files_.size()); }
  Extent render_size() const override { return size_; }
  Extent output_size() const override { return {}; }
  Result<SourceFrame> frame(uint32_t index, bool) override {
    SHALE_TRY(const Picture picture, load_picture(files_[index]));
    SourceFrame frame;
    frame.color = to_float_image(picture);
    return frame;
  }
  const std::string& file(uint32_t index) const { return files_[index]; }

 private:
  std::vector<std::string> files_;
  Extent size_;
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
                         {"result", result}},
                        2);
  const std::vector<uint32_t>& c = arguments.crop;
  const auto part = [&](const Picture& picture) {
    return magnify(picture, c[0], c[1], c[2], c[3], arguments.zoom);
  };
  std::vector<Panel> panels{
      {"nearest", part(nearest)}, {"Lanczos", part(lanczos)}, {"result", part(result)}};
  if (!arguments.reference.empty()) {
    SHALE_TRY(const Picture reference, load_picture(arguments.reference));
    panels.push_back({"reference", part(reference)});
  }
  return side_by_side(panels, 2);
}

/// All images, words as int32, and all tensors, after a shown picture: DIR/0000.NAME.npy.
Result<void> dump(const Player& player, const std::string& folder, size_t shown, Outputs& outputs) {
  FileNames names;
  for (const Resource& resource : player.variant().resources) {
    const std::string path =
        (fs::path(folder) / fmt::format("{:04}.{}.npy", shown, names.claim(resource.name)))
            .string();
    SHALE_TRY_VOID(outputs.claim("--dump", path));
    if (resource.format == ImageFormat::kR32Uint && is_image(resource.category)) {
      SHALE_TRY(const Tensor words, player.read_words(resource.name));
      SHALE_TRY_VOID(write_npy(path, words));
    } else if (is_image(resource.category)) {
      SHALE_TRY(const FloatImage image, player.read(resource.name, false));
      SHALE_TRY_VOID(write_npy(path, image));
    } else if (resource.category == Category::kInput || resource.category == Category::kOutput) {
      SHALE_TRY(const Tensor tensor, player.read_tensor(resource.name));
      SHALE_TRY_VOID(write_npy(path, tensor));
    }
  }
  return {};
}

/// Psnr of the picture, of nearest and of Lanczos against the reference.
Result<Json> psnr_against(const std::string& path, const Picture& input, const Picture& result) {
  SHALE_TRY(const Picture reference, load_picture(path));
  if (reference.width != result.width || reference.height != result.height)
    return bad_input(path, "has {}x{} pixels, the result {}x{}", reference.width, reference.height,
                     result.width, result.height);
  return Json{{"nearest", psnr_db(upscale_nearest(input, result.width, result.height), reference)},
              {"lanczos", psnr_db(upscale_lanczos(input, result.width, result.height), reference)},
              {"result", psnr_db(result, reference)}};
}

void print_frames(const Json& json, std::FILE* to) {
  for (const Json& frame : json["frames"]) {
    const std::string timed =
        frame.contains("model") ? fmt::format(", {:.1f} ms by {}", frame["frame_ms"].get<double>(),
                                              frame["model"].get<std::string>())
                                : "";
    const std::string passes = !frame.contains("kept_promise")     ? ""
                               : frame["kept_promise"].get<bool>() ? ", kept its promise"
                                                                   : ", full passes";
    const std::string ran =
        frame.contains("share_run")
            ? fmt::format(", {:.1f} % run", 100 * frame["share_run"].get<double>())
            : "";
    fmt::print(to, "{} -> {} ({}x{}){}{}{}\n", frame["input"].get<std::string>(),
               frame["output"].get<std::string>(), frame["width"].get<uint32_t>(),
               frame["height"].get<uint32_t>(),
               frame.contains("network") ? ", network " + frame["network"].get<std::string>() : "",
               timed, passes + ran);
    if (frame.contains("psnr_db"))
      for (const auto& [name, value] : frame["psnr_db"].items())
        fmt::print(to, "  PSNR {:<8} {:.2f} dB\n", name, value.get<double>());
  }
  if (json.contains("budget"))
    fmt::print(to, "  {:.1f} % of {} frames within {} ms, {} switches\n",
               100 * json["budget"]["within"].get<double>(), json["budget"]["frames"].get<size_t>(),
               json["budget"]["budget_ms"].get<double>(), json["budget"]["switches"].get<size_t>());
}

void print_times(const Json& json, const char* what, size_t measured, std::FILE* to) {
  for (const Json& time : json["dispatches"])
    fmt::print(to, "  {:>10.1f} us {:>5.1f} %  {:<14} {:<20} {}\n", time["time_us"].get<double>(),
               100 * time["share"].get<double>(), time["segment"].get<std::string>(),
               time["kernel"].get<std::string>(), time["name"].get<std::string>());
  for (const Json& time : json["segments"])
    fmt::print(to, "  {:>10.1f} us {:>5.1f} %  {}\n", time["time_us"].get<double>(),
               100 * time["share"].get<double>(), time["segment"].get<std::string>());
  fmt::print(to, "  {:>10.1f} us a {}, median of {}\n", json["frame_us"].get<double>(), what,
             measured);
}

void add_times(Json& json, const std::vector<DispatchTime>& median) {
  double total_us = 0;
  for (const DispatchTime& time : median) total_us += time.time_us;
  const auto share = [&](double time_us) { return total_us > 0 ? time_us / total_us : 0.0; };
  json["frame_us"] = total_us;
  json["segments"] = Json::array();
  json["dispatches"] = Json::array();
  for (const DispatchTime& time : median) {
    json["dispatches"].push_back({{"segment", time.segment},
                                  {"name", time.name},
                                  {"kernel", time.kernel},
                                  {"time_us", time.time_us},
                                  {"share", share(time.time_us)}});
    if (json["segments"].empty() || json["segments"].back()["segment"] != time.segment)
      json["segments"].push_back({{"segment", time.segment}, {"time_us", 0.0}});
    Json& segment = json["segments"].back();
    segment["time_us"] = segment["time_us"].get<double>() + time.time_us;
  }
  for (Json& segment : json["segments"]) segment["share"] = share(segment["time_us"].get<double>());
}

/// A picture as it is shown: a frame, or what is generated once that frame is there.
struct Shown {
  uint32_t frame = 0;
  std::optional<float> time{};
};

/// In the order in which they are shown, `count` pictures beside each frame. Nothing lies before the
/// first frame.
std::vector<Shown> shown_pictures(uint32_t frames, const std::optional<Generator>& generator,
                                  uint32_t count) {
  std::vector<Shown> shown;
  for (uint32_t i = 0; i < frames; ++i) {
    const bool waits = generator && generator->waits();
    if (!waits) shown.push_back({i});
    for (uint32_t k = 1; k <= count && (i > 0 || !waits); ++k)
      shown.push_back({i, generated_time(*generator, k, count)});
    if (waits) shown.push_back({i});
  }
  return shown;
}

/// Where the results go: by shown picture, and claimed before the first is played.
struct Paths {
  std::vector<std::string> results, views;  ///< views: empty without --debug-view
};

bool writes_exr(const Arguments& arguments) {
  return arguments.format.empty() ? extension_of(arguments.output) == ".exr"
                                  : arguments.format == "exr";
}

Result<Paths> claim_paths(const Arguments& arguments, FrameSource& source, SourceKind kind,
                          const std::vector<Shown>& shown, Outputs& outputs) {
  const bool is_pictures = kind == SourceKind::kPictures;
  std::error_code ignored;
  const bool to_folder = !is_pictures || source.frame_count() > 1 ||
                         fs::is_directory(arguments.input, ignored) ||
                         fs::is_directory(arguments.output, ignored);
  if (to_folder) SHALE_TRY_VOID(make_folder(arguments.output));
  if (!arguments.debug_view.empty()) SHALE_TRY_VOID(make_folder(arguments.debug_view));
  if (!arguments.dump.empty()) SHALE_TRY_VOID(make_folder(arguments.dump));
  Paths paths;
  const auto label = [&](uint32_t i) {
    return is_pictures ? static_cast<PictureSource&>(source).file(i)
                       : fmt::format("{} frame {}", arguments.input, i);
  };
  outputs.keep({arguments.model, arguments.input, arguments.reference, arguments.budget.load});
  outputs.keep(arguments.budget.others);
  outputs.keep(arguments.compile.files());
  for (uint32_t i = 0; is_pictures && i < source.frame_count(); ++i) outputs.keep({label(i)});
  if (kind == SourceKind::kDataset)  // which has folders
    for (fs::recursive_directory_iterator at(arguments.input, ignored), end; at != end;
         at.increment(ignored))
      if (at->is_directory(ignored)) outputs.keep({at->path().string()});
  for (size_t s = 0; s < shown.size(); ++s) {
    const uint32_t i = shown[s].frame;
    const std::string name =
        is_pictures ? fs::path(label(i)).stem().string() : fmt::format("{:04}", s);
    const bool is_exr = writes_exr(arguments);
    paths.results.push_back(
        to_folder ? (fs::path(arguments.output) / (name + (is_exr ? ".exr" : ".png"))).string()
                  : arguments.output);
    if (is_exr && extension_of(paths.results.back()) != ".exr")
      return bad_input(paths.results.back(), "is written as OpenEXR, expected the suffix .exr");
    SHALE_TRY_VOID(is_exr ? outputs.claim(label(i), paths.results.back())
                          : outputs.claim_picture(label(i), paths.results.back()));
    if (arguments.debug_view.empty()) continue;
    paths.views.push_back((fs::path(arguments.debug_view) / (name + ".png")).string());
    SHALE_TRY_VOID(outputs.claim_picture("--debug-view of " + label(i), paths.views.back()));
  }
  SHALE_TRY_VOID(outputs.claim_picture("--compare", arguments.compare));
  SHALE_TRY_VOID(outputs.claim_picture("--animation", arguments.animation));
  return paths;
}

Result<int> play(const Arguments& arguments) {
  if (!arguments.crop.empty() && arguments.crop.size() != 4)
    return bad_input("--crop", "expected X,Y,WIDTH,HEIGHT");
  for (size_t i = 2; i < arguments.crop.size(); ++i)
    if (arguments.crop[i] < 1 || arguments.crop[i] > kMaxPanel / arguments.zoom)
      return bad_input("--crop", "a side of {} is outside 1..{}, magnified by {}",
                       arguments.crop[i], kMaxPanel / arguments.zoom, arguments.zoom);
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  const SourceKind kind = source_kind(arguments.input);
  const bool is_sequence = kind != SourceKind::kPictures;
  CompileArguments compile = arguments.compile;
  // Frames at hand give the sandwich its size; a scene is rendered in the sandwich's.
  std::unique_ptr<FrameSource> source;
  std::optional<Extent> render_size, output_size;
  if (kind == SourceKind::kDataset) {
    SourceArguments from = arguments.source;
    from.ratio = std::exchange(compile.ratio, 0);
    SHALE_TRY(source, open_dataset(arguments.input, from));
    output_size = source->output_size();
  } else if (kind == SourceKind::kPictures) {
    SHALE_TRY(source, PictureSource::open(arguments.input));
  }
  if (source) render_size = source->render_size();
  SHALE_TRY(const Sandwich sandwich,
            load_sandwich(arguments.model, compile, render_size, output_size));
  if (kind == SourceKind::kScene) {
    SHALE_TRY(const auto sizes, sandwich_sizes(sandwich.package.variants.front()));
    SHALE_TRY(source, open_scene(arguments.input, arguments.source, device, sizes.first,
                                 sizes.second, sandwich.pattern));
  }
  if (!arguments.crop.empty()) {
    SHALE_TRY(const auto sizes, sandwich_sizes(sandwich.package.variants.front()));
    const std::vector<uint32_t>& c = arguments.crop;
    const Extent result = sizes.second;
    if (c[0] >= result.width || c[2] > result.width - c[0] || c[1] >= result.height ||
        c[3] > result.height - c[1])
      return bad_input("--crop", "{}x{} pixels at {},{} do not lie in the result of {}x{}", c[2],
                       c[3], c[0], c[1], result.width, result.height);
  }
  if (arguments.check && sandwich.graphs.empty())
    return bad_input("--check", "{} holds no graph; give the model's folder", arguments.model);
  const std::optional<Generator>& generator = sandwich.package.variants.front().generator;
  if (arguments.generate > 0 && (!generator || !is_sequence))
    return bad_input("--generate", "{}",
                     is_sequence ? arguments.model + " has no program that generates pictures"
                                 : "single pictures have no motion; expected a scene or a dataset");
  const Variant& variant = sandwich.package.variants.front();
  if (arguments.check && generator && arguments.generate == 0 &&
      !has_network(variant, 1 - generator->program))
    return bad_input("--check",
                     "the network of {} makes pictures between frames; it needs --generate",
                     arguments.model);
  const std::vector<Shown> shown =
      shown_pictures(source->frame_count(), generator, arguments.generate);
  Outputs outputs(arguments.json);
  SHALE_TRY(const Paths paths, claim_paths(arguments, *source, kind, shown, outputs));

  std::vector<std::vector<DispatchTime>> measured, measured_generated;
  std::vector<PngPicture> animation(arguments.animation.empty() ? 0 : shown.size());
  Json json{{"device", device.context().caps.name}, {"frames", Json::array()}};
  int exit = kDone;
  {
    SHALE_TRY(Choices choices,
              Choices::create(arguments.budget, device, arguments.model, sandwich, compile,
                              arguments.profile || arguments.budget.budget_ms > 0
                                  ? Compile::kAtOnce
                                  : Compile::kInBackground));
    Player* player = &choices.next();
    const bool to_exr = writes_exr(arguments);
    if (to_exr && player->is_display())
      return bad_input("--format", "exr holds linear colours, {} shows those of a display",
                       arguments.model);
    Progress progress("playing");
    const uint32_t count = source->frame_count();
    for (uint32_t i = 0; i < count; ++i) {
      if (!progress.step(i, count)) return bad_input("", "interrupted after {} frames", i);
      const std::string label = is_sequence ? fmt::format("{} frame {}", arguments.input, i)
                                            : static_cast<PictureSource&>(*source).file(i);
      SHALE_TRY(SourceFrame frame, source->frame(i, false));
      if (i == 0 && arguments.profile)
        if (Result<void> warm = player->warm_up(frame); !warm) return in_file(label, warm.error());
      if (i == 0) SHALE_TRY_VOID(choices.measure(frame));
      player = &choices.next();
      std::vector<DispatchTime> times;
      std::vector<DispatchTime>* const wanted =
          arguments.profile || choices.has_budget() ? &times : nullptr;
      Result<FloatImage> played =
          is_sequence && !to_exr ? player->show(frame, wanted) : player->play(frame, wanted);
      if (!played) return in_file(label, played.error());
      Json timed = Json::object();
      choices.add(times, timed);
      if (arguments.profile) measured.push_back(std::move(times));
      /// Writes a picture in its place among the shown ones; gives it back as it is shown.
      const auto write = [&](size_t at, FloatImage picture) -> Result<Picture> {
        if (to_exr) {
          SHALE_TRY_VOID(write_exr(paths.results[at], picture, ExrPrecision::kHalf));
          picture = display_image(picture, frame.camera.exposure);
        }
        Picture result = to_picture(picture);
        if (!to_exr) SHALE_TRY_VOID(save_png(paths.results[at], result));
        if (!arguments.animation.empty()) animation[at] = encode_png(result);
        if (arguments.debug_view.empty()) return result;
        SHALE_TRY(std::vector<Panel> panels, player->views());
        panels.push_back({"result", result});
        for (Panel& panel : panels)
          panel.picture = upscale_nearest(
              panel.picture, kMosaicWidth,
              std::max(1u, kMosaicWidth * panel.picture.height / panel.picture.width));
        SHALE_TRY_VOID(save_png(paths.views[at], side_by_side(panels, 4)));
        return result;
      };
      const auto entry_of = [&](size_t at, const Picture& result) {
        return Json{{"input", label},
                    {"output", paths.results[at]},
                    {"width", result.width},
                    {"height", result.height}};
      };
      const auto at = [&](std::optional<float> time) {
        return static_cast<size_t>(
            std::find_if(shown.begin(), shown.end(),
                         [&](const Shown& each) { return each.frame == i && each.time == time; }) -
            shown.begin());
      };
      /// What --dump and --check ask for, of the picture that was just made.
      const auto look_inside = [&](size_t number, Json& into) -> Result<void> {
        if (!arguments.dump.empty()) SHALE_TRY_VOID(dump(*player, arguments.dump, number, outputs));
        if (!arguments.check || !player->ran_network()) return {};
        SHALE_TRY(const std::optional<std::string> difference,
                  network_difference(*player, sandwich.graphs));
        into["network"] = difference ? *difference : "equals the interpreter";
        if (difference) exit = kRefused;
        return {};
      };
      const size_t rendered_at = at({});
      SHALE_TRY(const Picture result, write(rendered_at, *std::move(played)));
      Json entry = entry_of(rendered_at, result);
      entry.update(timed);
      if (const std::optional<bool> kept = player->kept_promise()) entry["kept_promise"] = *kept;
      if (const std::optional<double> share = player->share_run()) entry["share_run"] = *share;
      SHALE_TRY_VOID(look_inside(rendered_at, entry));
      const bool compares = !arguments.reference.empty() || !arguments.compare.empty();
      if (compares && i == 0) {
        const Picture input = to_picture(
            player->is_display() ? frame.color : display_image(frame.color, frame.camera.exposure));
        if (!arguments.reference.empty()) {
          SHALE_TRY(entry["psnr_db"], psnr_against(arguments.reference, input, result));
        }
        if (!arguments.compare.empty()) {
          SHALE_TRY(const Picture panels, comparison(arguments, input, result));
          SHALE_TRY_VOID(save_png(arguments.compare, panels));
        }
      }
      json["frames"].push_back(std::move(entry));
      for (const Shown& each : shown) {
        if (each.frame != i || !each.time) continue;
        std::vector<DispatchTime>* const generated_times =
            arguments.profile ? &measured_generated.emplace_back() : nullptr;
        Result<FloatImage> generated = to_exr ? player->generate(*each.time, generated_times)
                                              : player->show_generated(*each.time, generated_times);
        if (!generated) return in_file(label, generated.error());
        SHALE_TRY(const Picture picture, write(at(each.time), *std::move(generated)));
        Json generated_entry = entry_of(at(each.time), picture);
        generated_entry["generated_at"] = *each.time;
        SHALE_TRY_VOID(look_inside(at(each.time), generated_entry));
        json["frames"].push_back(std::move(generated_entry));
      }
    }
    if (arguments.repeat > 0) measured.clear();
    for (uint32_t i = 0; i < arguments.repeat; ++i) {
      if (!progress.step(i, arguments.repeat)) return bad_input("", "interrupted");
      SHALE_TRY_VOID(player->run(&measured.emplace_back()));
    }
    if (arguments.repeat > 0 && arguments.generate > 0) measured_generated.clear();
    for (uint32_t i = 0; arguments.generate > 0 && i < arguments.repeat; ++i) {
      if (!progress.step(i, arguments.repeat)) return bad_input("", "interrupted");
      SHALE_TRY(const FloatImage ignored,
                player->generate(generated_time(*generator, 1, arguments.generate),
                                 &measured_generated.emplace_back()));
    }
    if (choices.has_budget()) json["budget"] = choices.summary();
  }
  source.reset();  // before the device
  SHALE_TRY_VOID(device.close());
  if (!arguments.animation.empty()) {
    outputs.note(save_animation(arguments.animation, animation,
                                static_cast<uint16_t>(kFrameRate * (arguments.generate + 1))));
    if (!outputs.all_written()) exit = kRefused;
  }
  const std::vector<DispatchTime> median = median_times(measured),
                                  median_generated = median_times(measured_generated);
  if (!median.empty()) add_times(json, median);
  if (!median_generated.empty()) add_times(json["generated"], median_generated);
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  std::FILE* const to = outputs.summary();
  print_frames(json, to);
  if (!median.empty()) print_times(json, "frame", measured.size(), to);
  if (!median_generated.empty())
    print_times(json["generated"], "generated picture", measured_generated.size(), to);
  return exit;
}

}  // namespace

Action add_play(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("model", arguments->model,
                 "model folder, model file with --frame, or package with a sandwich")
      ->required();
  app.add_option("-i,--input", arguments->input,
                 "scene (.json), folder of a captured dataset, picture, or folder of pictures of "
                 "one size")
      ->required();
  app.add_option("-o,--output", arguments->output,
                 "picture to write (.png or .exr), or folder for more than one")
      ->required();
  app.add_option(
         "--format", arguments->format,
         "png, as a display shows it, or exr: linear, halves (default: as the suffix, else png)")
      ->check(CLI::IsMember({"png", "exr"}));
  arguments->source.add_to(app);
  CLI::Option* generate =
      app.add_option("--generate", arguments->generate,
                     "pictures to make between rendered frames, or beyond each, by the sandwich's "
                     "program for that; shown in between")
          ->check(CLI::Range(1u, 15u));
  app.add_option("--animation", arguments->animation, "also write all frames as animated PNG");
  app.add_option("--debug-view", arguments->debug_view,
                 "folder for a mosaic of the intermediate images of each frame");
  app.add_option("--dump", arguments->dump,
                 "folder for every image and tensor of each shown picture, NUMBER.NAME.npy");
  CLI::Option* check =
      app.add_flag("--check", arguments->check,
                   "compare the network of each frame bit for bit with the reference interpreter");
  app.add_option("--compare", arguments->compare,
                 "also write input, nearest, Lanczos and result of the first frame side by side");
  app.add_option("--crop", arguments->crop,
                 "X,Y,WIDTH,HEIGHT of the result to show in --compare, magnified")
      ->delimiter(',');
  app.add_option("--zoom", arguments->zoom, "magnification of --crop")->check(CLI::Range(1, 16));
  app.add_option("--reference", arguments->reference,
                 "picture to measure the PSNR of the first frame against");
  CLI::Option* profile =
      app.add_flag("--profile", arguments->profile, "print the time of each dispatch");
  app.add_option("--repeat", arguments->repeat,
                 "print the times of so many runs of the last frame, one after the other")
      ->check(CLI::Range(1, 10000))
      ->needs(profile);
  arguments->budget.add_to(app, {profile, check, generate});
  arguments->compile.add_to(app, &arguments->device);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale play models/nss_v1_high -i models/scenes/test/motion.json -o frames --frames "
      "8 "
      "--profile\n"
      "Example: shale play models/baselines/mob_fgsr_interpolation -i "
      "models/scenes/test/motion.json -o frames --generate 1 --animation double.png\n"
      "Example: shale play models/baselines/tss -i thin -o frames --format exr\n"
      "Example: shale play models/nss_v1_high -i models/scenes/test/motion.json -o frames --budget "
      "90 --or "
      "models/nss_v1_low --or models/baselines/bilinear\n"
      "Example: shale play models/srpo_x2 -i models/pictures/raster_lr.png -o result.png --compare "
      "panels.png");
  return [arguments] { return play(*arguments); };
}

}  // namespace shale
