// shale eval: scenes or datasets through several sandwiches, measured against the truth.
#include <algorithm>
#include <filesystem>

#include "ir/base/file.h"
#include "tools/shale/command.h"
#include "tools/shale/evaluate.h"
#include "tools/shale/outputs.h"
#include "tools/shale/pictures.h"
#include "tools/shale/source.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::vector<std::string> inputs, methods, pictures;
  std::string page, json_file;
  uint32_t shown = 1, generate = 0;
  std::vector<double> at;
  uint32_t margin = 0;
  SourceArguments source;
  CompileArguments compile;
  DeviceArguments device;
  bool no_time = false, json = false;
};

/// The methods at one pair of sizes; rebuilt only when a source has others.
class Methods {
 public:
  Methods(const Arguments& arguments, const ToolDevice& device)
      : arguments_(arguments), device_(device) {}

  /// The first method without any size being given: the scene is rendered for it.
  Result<Sandwich> first(const std::string& scene) const {
    if (arguments_.methods.empty())
      return bad_input(scene,
                       "is rendered in the size of the first --method: give one, or a dataset");
    return load_sandwich(arguments_.methods[0], arguments_.compile, {}, {});
  }

  /// Errors: as load_sandwich and Player::create; kBadInput if a package has other sizes.
  Result<std::vector<PlayedMethod>*> at(Extent render, Extent output) {
    if (render == render_ && output == output_) return &methods_;
    methods_.clear();
    std::vector<std::string> names;
    CompileArguments compile = arguments_.compile;
    compile.ratio = 0;  // the frames have their sizes
    if (arguments_.margin > 0) compile.render.clear(), compile.output.clear();
    for (const std::string& path : arguments_.methods) {
      SHALE_TRY(const Sandwich sandwich, load_sandwich(path, compile, render, output));
      SHALE_TRY(const auto sizes, sandwich_sizes(sandwich.package.variants.front()));
      if (sizes.first != render || sizes.second != output)
        return bad_input(path, "was compiled for {}x{} to {}x{}, the frames are {}x{} to {}x{}",
                         sizes.first.width, sizes.first.height, sizes.second.width,
                         sizes.second.height, render.width, render.height, output.width,
                         output.height);
      names.push_back(sandwich.name);
      PlayedMethod method;
      SHALE_TRY(method.player,
                Player::create(device_, sandwich.package,
                               arguments_.no_time ? Compile::kInBackground : Compile::kAtOnce));
      methods_.push_back(std::move(method));
    }
    names = distinct_names(std::move(names), arguments_.methods);
    for (size_t i = 0; i < names.size(); ++i) methods_[i].name = names[i];
    render_ = render;
    output_ = output;
    return &methods_;
  }

 private:
  const Arguments& arguments_;
  const ToolDevice& device_;
  Extent render_, output_;
  std::vector<PlayedMethod> methods_;
};

/// Pictures by method, behind what is played: NAME=FOLDER, with a folder in it called as the scene, or with the pictures of
/// the only one.
Result<void> add_pictures(const Arguments& arguments, const std::string& scene,
                          std::vector<PlayedMethod>& methods) {
  std::erase_if(methods, [](const PlayedMethod& method) { return !method.player; });
  for (const std::string& option : arguments.pictures) {
    const size_t equals = option.find('=');
    if (equals == 0 || equals == std::string::npos || equals + 1 == option.size())
      return bad_input("--pictures", "expected NAME=FOLDER, found \"{}\"", option);
    PlayedMethod method{option.substr(0, equals), nullptr};
    if (std::ranges::find(methods, method.name, &PlayedMethod::name) != methods.end())
      return bad_input("--pictures", "\"{}\" is the name of another method", method.name);
    fs::path folder = option.substr(equals + 1);
    std::error_code ignored;
    if (fs::is_directory(folder / scene, ignored)) {
      folder /= scene;
    } else if (arguments.inputs.size() > 1) {
      return bad_input(folder.string(), "holds no folder \"{}\", as it has to with several inputs",
                       scene);
    }
    SHALE_TRY(const auto files, pictures_of(folder.string()));
    for (const auto& [name, file] : files) method.pictures.push_back(file);
    methods.push_back(std::move(method));
  }
  return {};
}

/// What the report calls the inputs, and folders of --pictures are called.
Result<std::vector<std::string>> input_names(const Arguments& arguments) {
  std::vector<std::string> names, files;
  for (const std::string& input : arguments.inputs) {
    files.push_back(input);
    if (source_kind(input) == SourceKind::kDataset) {
      SHALE_TRY(files.back(), sequence_file(input, arguments.source));
    }
    names.push_back(fs::path(files.back()).stem().string());
  }
  return distinct_names(std::move(names), files);
}

/// Times of generated pictures, in frames behind each frame; empty if none are asked for.
Result<std::vector<double>> generated_times(const Arguments& arguments) {
  std::vector<double> times = arguments.at;
  for (uint32_t k = 1; k <= arguments.generate; ++k)
    times.push_back(static_cast<double>(k) / (arguments.generate + 1));
  for (size_t i = 0; i < times.size(); ++i)
    if (!(times[i] > (i > 0 ? times[i - 1] : 0) && times[i] <= 1))
      return bad_input("--at", "{} is none of ascending times above 0 up to 1", times[i]);
  return times;
}

void print_table(const EvalReport& report) {
  size_t wide = 8;
  for (const std::string& method : report.methods) wide = std::max(wide, method.size());
  const auto cell = [](const std::optional<double>& value, int digits) {
    return value ? fmt::format("{:.{}f}", *value, digits) : std::string("-");
  };
  for (const EvalScene& scene : report.scenes) {
    fmt::print("{}: {} frames, {}\n", scene.name, scene.frames, scene.size);
    if (scene.methods[0].generated) {
      print_generated(report.methods, scene);
      for (const std::string& note : scene.notes) fmt::print("  {}\n", note);
      continue;
    }
    fmt::print("  {:<{}} {:>9} {:>8} {:>8} {:>8} {:>8} {:>9}\n", "", wide, "PSNR dB", "SSIM",
               "FLIP", "IF-SSIM", "still", "ms");
    for (size_t m = 0; m < report.methods.size(); ++m) {
      const SequenceMetrics& means = scene.methods[m].means;
      const auto if_ssim =
          means.if_ssim ? std::optional(means.if_ssim->at_t.value) : std::optional<double>();
      const auto still =
          means.still ? std::optional(means.still->code_values) : std::optional<double>();
      fmt::print("  {:<{}} {:>9} {:>8} {:>8} {:>8} {:>8} {:>9}\n", report.methods[m], wide,
                 cell(means.psnr_db, 2), cell(means.ssim, 4), cell(means.flip, 4), cell(if_ssim, 4),
                 cell(still, 3), cell(means.time_ms, 1));
    }
    std::vector<const SequenceMetrics*> means;
    for (const MethodResult& method : scene.methods) means.push_back(&method.means);
    print_over_time(report.methods, means);
    for (const std::string& note : scene.notes) fmt::print("  {}\n", note);
  }
}

Result<int> eval(const Arguments& arguments) {
  if (arguments.methods.empty() && arguments.pictures.empty())
    return bad_input("", "expected a --method or --pictures");
  SHALE_TRY(const std::vector<double> times, generated_times(arguments));
  if (arguments.margin > 0 && times.empty())
    return bad_input("--margin", "is for generated pictures: give --generate or --at");
  Outputs outputs(arguments.json);
  outputs.keep(arguments.inputs);
  outputs.keep(arguments.methods);
  outputs.keep_named(arguments.pictures);
  outputs.keep(arguments.compile.files());
  SHALE_TRY_VOID(outputs.claim("--json-file", arguments.json_file));
  SHALE_TRY_VOID(outputs.claim("--page", arguments.page));
  SHALE_TRY(const std::vector<std::string> names, input_names(arguments));
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  EvalReport report;
  report.title = "shale eval";
  report.device = device.context().caps.name;
  {
    Methods methods(arguments, device);
    for (size_t i = 0; i < names.size(); ++i) {
      const std::string& input = arguments.inputs[i];
      std::unique_ptr<FrameSource> source;
      SceneSource* scene_source = nullptr;
      std::unique_ptr<SceneSource> with_margin;
      switch (source_kind(input)) {
        case SourceKind::kPictures:
          return bad_input(input,
                           "is neither a scene (.json) nor a dataset (a folder with 0000.json)");
        case SourceKind::kDataset: {
          SourceArguments from = arguments.source;
          from.ratio = arguments.compile.ratio;
          SHALE_TRY(source, open_dataset(input, from));
          break;
        }
        case SourceKind::kScene: {
          SHALE_TRY(const Sandwich first, methods.first(input));
          SHALE_TRY(const auto sizes, sandwich_sizes(first.package.variants.front()));
          SHALE_TRY(std::unique_ptr<SceneSource> opened,
                    open_scene(input, arguments.source, device, sizes.first, sizes.second,
                               first.pattern));
          if (arguments.margin > 0) {
            if (sizes.first != sizes.second)
              return bad_input("--margin",
                               "is for methods that do not upscale, {} makes {}x{} of {}x{}",
                               arguments.methods[0], sizes.second.width, sizes.second.height,
                               sizes.first.width, sizes.first.height);
            SHALE_TRY(with_margin, open_scene(input, arguments.source, device, sizes.first,
                                              sizes.second, first.pattern, arguments.margin));
          }
          scene_source = opened.get();
          source = std::move(opened);
        }
      }
      const FrameSource& played = with_margin ? *with_margin : *source;
      SHALE_TRY(std::vector<PlayedMethod>* const ready,
                methods.at(played.render_size(), played.output_size()));
      SHALE_TRY_VOID(add_pictures(arguments, names[i], *ready));
      report.methods.clear();
      for (const PlayedMethod& method : *ready) report.methods.push_back(method.name);
      const EvaluateOptions options{.first_frame = arguments.source.first,
                                    .timed = !arguments.no_time,
                                    .shown = arguments.page.empty() ? 0 : arguments.shown,
                                    .with_margin = with_margin.get()};
      if (!times.empty() && !scene_source)
        return bad_input(input, "is no scene: the truth of generated pictures has to be rendered");
      Result<EvalScene> scene =
          times.empty() ? evaluate_scene(*source, *ready, options)
                        : evaluate_generated(*scene_source, *ready, times, options, report.methods);
      if (!scene) return in_file(input, scene.error());
      scene->name = names[i];
      report.scenes.push_back(*std::move(scene));
    }
  }
  SHALE_TRY_VOID(device.close());
  const Json json = report_json(report);
  if (!arguments.json_file.empty()) outputs.note(write_text(arguments.json_file, json_text(json)));
  if (!arguments.page.empty()) outputs.note(write_text(arguments.page, report_html(report)));
  if (arguments.json)
    print_json(json);
  else if (!outputs.has_standard_output())
    print_table(report);
  return outputs.all_written() ? kDone : kRefused;
}

}  // namespace

Action add_eval(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("inputs", arguments->inputs, "scenes (.json) and datasets (folders)")->required();
  app.add_option("-m,--method", arguments->methods,
                 "model folder or package, again for each; the first one's frame.json gives scenes "
                 "their size and pattern of samples")
      ->allow_extra_args(false);
  app.add_option(
         "--pictures", arguments->pictures,
         "NAME=FOLDER, again for each: pictures that another program made of the frames, in "
         "order of their names (.png; .exr is linear); of several inputs, in folders called as "
         "the table calls these")
      ->allow_extra_args(false);
  app.add_option("--page", arguments->page, "write a page to look at (.html)");
  app.add_option("--json-file", arguments->json_file, "write the figures as JSON");
  app.add_option("--shown", arguments->shown,
                 "frames of each scene whose pictures go into the page")
      ->check(CLI::Range(1u, 16u));
  CLI::Option* generate = app.add_option(
      "--generate", arguments->generate,
      "judge so many pictures that the methods make for each frame of scenes, which are rendered "
      "more often for their truth; with render and output size equal the frames are the truth");
  generate->check(CLI::Range(1u, 15u));
  app.add_option("--at", arguments->at,
                 "the same at these times, in frames behind each frame: 0.5, or 1 in place of it")
      ->delimiter(',')
      ->excludes(generate);
  app.add_option("--margin", arguments->margin,
                 "render frames with so many pixels more on each side, which are cut off of what "
                 "is generated: what comes in "
                 "at the border is then known; needs --generate or --at")
      ->check(CLI::Range(1u, 4096u));
  app.add_flag("--no-time", arguments->no_time, "measure no times");
  arguments->source.add_to(app);
  arguments->compile.add_to(app, &arguments->device);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale eval models/scenes/test/thin.json -m models/nss_v1_high -m "
      "models/baselines/mob_fgsr --frames 16 --page report.html\n"
      "Example: shale eval models/scenes/test/motion.json --generate 1 --render 480x270 -m "
      "models/baselines/mob_fgsr_interpolation -m models/baselines/mob_fgsr_extrapolation\n"
      "Example: shale eval thin -m models/nss_v1_high --pictures other=frames");
  return [arguments] { return eval(*arguments); };
}

}  // namespace shale
