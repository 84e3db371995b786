// shale eval: scenes or datasets through several sandwiches, measured against the truth.
#include <filesystem>

#include "ir/base/file.h"
#include "tools/eval/html_report.h"
#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"
#include "tools/shale/command.h"
#include "tools/shale/player.h"
#include "tools/shale/source.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::vector<std::string> inputs, methods;
  std::string page, json_file;
  uint32_t shown = 1;
  SourceArguments source;
  CompileArguments compile;
  DeviceArguments device;
  bool no_time = false, json = false;
};

/// A sandwich that is ready to play.
struct Method {
  std::string name;
  std::unique_ptr<Player> player;
};

/// The methods at one pair of sizes; rebuilt only when a source has others.
class Methods {
 public:
  Methods(const Arguments& arguments, const ToolDevice& device)
      : arguments_(arguments), device_(device) {}

  /// Sizes of the first method without any being given: those that scenes are rendered in.
  Result<std::pair<Extent, Extent>> default_sizes() const {
    SHALE_TRY(const Sandwich first,
              load_sandwich(arguments_.methods[0], arguments_.compile, {}, {}));
    return sandwich_sizes(first.package);
  }

  /// Errors: as load_sandwich and Player::create; kBadInput if a package has other sizes.
  Result<std::vector<Method>*> at(Extent render, Extent output) {
    if (render == render_ && output == output_) return &methods_;
    methods_.clear();
    for (const std::string& path : arguments_.methods) {
      SHALE_TRY(const Sandwich sandwich, load_sandwich(path, arguments_.compile, render, output));
      SHALE_TRY(const auto sizes, sandwich_sizes(sandwich.package));
      if (sizes.first != render || sizes.second != output)
        return bad_input(path, "was compiled for {}x{} to {}x{}, the frames are {}x{} to {}x{}",
                         sizes.first.width, sizes.first.height, sizes.second.width,
                         sizes.second.height, render.width, render.height, output.width,
                         output.height);
      Method method{sandwich.name, nullptr};
      SHALE_TRY(method.player, Player::create(device_, sandwich.package));
      methods_.push_back(std::move(method));
    }
    render_ = render;
    output_ = output;
    return &methods_;
  }

 private:
  const Arguments& arguments_;
  const ToolDevice& device_;
  Extent render_, output_;
  std::vector<Method> methods_;
};

/// Numbers of the frames whose pictures go into the page: the last, and others spread before it.
bool is_shown(uint32_t index, uint32_t count, uint32_t shown) {
  for (uint32_t i = 1; i <= std::min(shown, count); ++i)
    if (index + 1 == static_cast<uint32_t>(uint64_t{count} * i / shown)) return true;
  return false;
}

Result<EvalScene> evaluate(const Arguments& arguments, FrameSource& source,
                           std::vector<Method>& methods) {
  const Extent render = source.render_size(), output = source.output_size();
  const uint32_t count = source.frame_count();
  EvalScene scene;
  scene.name = source.name();
  scene.frames = count;
  scene.first_frame = arguments.source.first;
  scene.size =
      fmt::format("{}x{} to {}x{}", render.width, render.height, output.width, output.height);
  scene.methods.resize(methods.size());
  ReferenceTrack track;
  std::vector<SequenceEvaluator> evaluators(methods.size());
  std::optional<FrameCamera> previous;
  for (Method& method : methods) method.player->reset();
  Progress progress("evaluating " + scene.name);
  for (uint32_t i = 0; i < count; ++i) {
    if (!progress.step(i, count))
      return bad_input(scene.name, "interrupted after {} of {} frames", i, count);
    SHALE_TRY(const SourceFrame frame, source.frame(i, true));
    if (frame.truth.empty()) return bad_input(scene.name, "frame {} has no ground truth", i);
    const bool still = previous && same_view(*previous, frame.camera);
    previous = frame.camera;
    SHALE_TRY_VOID(
        track.advance({.display = display_image(frame.truth, frame.camera.exposure),
                       .motion = frame.truth_motion.empty() ? nullptr : &frame.truth_motion,
                       .depth = frame.truth_depth.empty() ? nullptr : &frame.truth_depth,
                       .cut = frame.camera.cut,
                       .camera_still = still}));
    const bool shows = !arguments.page.empty() && is_shown(i, count, arguments.shown);
    std::vector<FloatImage> pictures(methods.size()), maps(methods.size());
    for (size_t m = 0; m < methods.size(); ++m) {
      std::vector<DispatchTime> times;
      SourceFrame given = frame;
      if (i == 0 && !arguments.no_time) {
        SHALE_TRY_VOID([&]() -> Result<void> {
          SourceFrame once = frame;
          const Result<FloatImage> ignored = methods[m].player->show(once);
          if (!ignored) return ignored.error();
          methods[m].player->reset();
          return {};
        }());
      }
      Result<FloatImage> result =
          methods[m].player->show(given, arguments.no_time ? nullptr : &times);
      if (!result) return in_file(methods[m].name, result.error());
      std::optional<double> time_ms;
      if (!arguments.no_time) {
        double total_us = 0;
        for (const DispatchTime& time : times) total_us += time.time_us;
        time_ms = total_us / 1000;
      }
      if (shows) pictures[m] = *result;
      SHALE_TRY(const FrameMetrics metrics,
                evaluators[m].add(*std::move(result), track, time_ms, shows ? &maps[m] : nullptr));
      scene.methods[m].frames.push_back({metrics, time_ms});
    }
    if (shows) scene.shown.push_back(show_frame(i, track.reference().picture(), pictures, maps));
  }
  for (size_t m = 0; m < methods.size(); ++m) scene.methods[m].means = evaluators[m].finish();
  scene.notes.push_back("IF-SSIM masks by depth as it is stored, which is hyperbolic.");
  return scene;
}

void print_table(const EvalReport& report) {
  size_t wide = 8;
  for (const std::string& method : report.methods) wide = std::max(wide, method.size());
  const auto cell = [](const std::optional<double>& value, int digits) {
    return value ? fmt::format("{:.{}f}", *value, digits) : std::string("-");
  };
  for (const EvalScene& scene : report.scenes) {
    fmt::print("{}: {} frames, {}\n", scene.name, scene.frames, scene.size);
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
    for (const std::string& note : scene.notes) fmt::print("  {}\n", note);
  }
}

Result<int> eval(const Arguments& arguments) {
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  EvalReport report;
  report.title = "shale eval";
  report.device = device.context().caps.name;
  {
    Methods methods(arguments, device);
    for (const std::string& input : arguments.inputs) {
      std::unique_ptr<FrameSource> source;
      switch (source_kind(input)) {
        case SourceKind::kPictures:
          return bad_input(input,
                           "is neither a scene (.json) nor a dataset (a folder with 0000.json)");
        case SourceKind::kDataset: {
          SHALE_TRY(source, open_dataset(input, arguments.source));
          break;
        }
        case SourceKind::kScene: {
          SHALE_TRY(const auto sizes, methods.default_sizes());
          SHALE_TRY(source, open_scene(input, arguments.source, device, sizes.first, sizes.second));
        }
      }
      SHALE_TRY(std::vector<Method>* const ready,
                methods.at(source->render_size(), source->output_size()));
      report.methods.clear();
      for (const Method& method : *ready) report.methods.push_back(method.name);
      Result<EvalScene> scene = evaluate(arguments, *source, *ready);
      if (!scene) return in_file(input, scene.error());
      report.scenes.push_back(*std::move(scene));
    }
  }
  SHALE_TRY_VOID(device.close());
  const Json json = report_json(report);
  if (!arguments.json_file.empty())
    SHALE_TRY_VOID(write_text(arguments.json_file, json_text(json)));
  if (!arguments.page.empty()) SHALE_TRY_VOID(write_text(arguments.page, report_html(report)));
  if (arguments.json)
    print_json(json);
  else
    print_table(report);
  return kDone;
}

}  // namespace

Action add_eval(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("inputs", arguments->inputs, "scenes (.json) and datasets (folders)")->required();
  app.add_option("-m,--method", arguments->methods,
                 "model folder or package, again for each; the first one's frame.json gives scenes "
                 "their size")
      ->required()
      ->allow_extra_args(false);
  app.add_option("--page", arguments->page, "write a page to look at (.html)");
  app.add_option("--json-file", arguments->json_file, "write the figures as JSON");
  app.add_option("--shown", arguments->shown,
                 "frames of each scene whose pictures go into the page")
      ->check(CLI::Range(1u, 16u));
  app.add_flag("--no-time", arguments->no_time, "measure no times");
  arguments->source.add_to(app);
  arguments->compile.add_to(app);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale eval models/scenes/test/thin.json -m models/nss_v1_high -m "
      "models/baselines/mob_fgsr --frames 16 --page report.html");
  return [arguments] { return eval(*arguments); };
}

}  // namespace shale
