#include "tools/shale/evaluate.h"

#include <algorithm>

#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"
#include "tools/shale/pictures.h"

namespace shale {
namespace {

/// Numbers of the frames whose pictures go into the page: the last, and others spread before it.
bool is_shown(uint32_t index, uint32_t count, uint32_t shown) {
  for (uint32_t i = 1; i <= std::min(shown, count); ++i)
    if (index + 1 == static_cast<uint32_t>(uint64_t{count} * i / shown)) return true;
  return false;
}

std::string cell(const std::optional<double>& value, int digits) {
  return value ? fmt::format("{:.{}f}", *value, digits) : std::string("-");
}

std::string cells(const std::optional<double>& a, const std::optional<double>& b, int digits) {
  return cell(a, digits) + " " + cell(b, digits);
}

std::string cells(const std::optional<Trail>& trail) {
  return trail ? cells(trail->mean(0), trail->mean(3), 2) : std::string("-");
}

}  // namespace

Result<void> advance(ReferenceTrack& track, FloatImage display, const SourceFrame& frame,
                     std::optional<FrameCamera>& previous) {
  const auto known = [](const FloatImage& image) { return image.empty() ? nullptr : &image; };
  const bool still = previous && same_view(*previous, frame.camera);
  previous = frame.camera;
  return track.advance({.display = std::move(display),
                        .motion = known(frame.truth_motion),
                        .depth = known(frame.truth_depth),
                        .reverse_depth = frame.camera.reverse_depth,
                        .cut = frame.camera.cut,
                        .camera_still = still});
}

void print_over_time(const std::vector<std::string>& methods,
                     const std::vector<const SequenceMetrics*>& means) {
  size_t wide = 8;
  for (const std::string& method : methods) wide = std::max(wide, method.size());
  constexpr auto kLine = "  {:<{}} {:>13} {:>13} {:>13} {:>11} {:>8} {:>13} {:>11} {:>7} {:>7}\n";
  fmt::print(kLine, "", wide, "PSNR <10,10+", "SSIM <10,10+", "FLIP <10,10+", "lag, open", "bright",
             "trail, 3+", "sky, 3+", "grid", "rest");
  for (size_t m = 0; m < methods.size(); ++m) {
    const PartMetrics &first = means[m]->first, &later = means[m]->later;
    const TemporalMetrics& temporal = means[m]->temporal;
    fmt::print(
        kLine, methods[m], wide, cells(first.psnr_db, later.psnr_db, 2),
        cells(first.ssim, later.ssim, 4), cells(first.flip, later.flip, 4),
        temporal.lag ? cells(temporal.lag->frames, temporal.lag->open_fraction, 2) : "-",
        cell(temporal.brightness_codes, 2), cells(temporal.trail), cells(temporal.sky_trail),
        temporal.grid ? cell(temporal.grid->output_codes - temporal.grid->truth_codes, 3) : "-",
        means[m]->still ? cell(means[m]->still->rest_code_values, 3) : "-");
  }
}

Result<EvalScene> evaluate_scene(FrameSource& source, std::vector<PlayedMethod>& methods,
                                 const EvaluateOptions& options) {
  const Extent render = source.render_size(), output = source.output_size();
  const uint32_t count = source.frame_count();
  EvalScene scene;
  scene.name = source.name();
  scene.frames = count;
  scene.first_frame = options.first_frame;
  scene.size =
      fmt::format("{}x{} to {}x{}", render.width, render.height, output.width, output.height);
  scene.methods.resize(methods.size());
  SequenceOptions measures;
  measures.grid_period = grid_period(render, output);
  ReferenceTrack track(measures);
  std::vector<SequenceEvaluator> evaluators(methods.size(), SequenceEvaluator(measures));
  std::optional<FrameCamera> previous;
  for (PlayedMethod& method : methods) {
    if (method.player)
      method.player->reset();
    else if (method.pictures.size() != count)
      return bad_input(method.name, "has {} pictures, the sequence {} frames",
                       method.pictures.size(), count);
  }
  Progress progress("evaluating " + scene.name);
  for (uint32_t i = 0; i < count; ++i) {
    if (!progress.step(i, count))
      return bad_input(scene.name, "interrupted after {} of {} frames", i, count);
    SHALE_TRY(const SourceFrame frame, source.frame(i, true));
    if (frame.truth.empty()) return bad_input(scene.name, "frame {} has no ground truth", i);
    SHALE_TRY_VOID(
        advance(track, display_image(frame.truth, frame.camera.exposure), frame, previous));
    const bool shows = is_shown(i, count, options.shown);
    std::vector<FloatImage> pictures(methods.size()), maps(methods.size());
    for (size_t m = 0; m < methods.size(); ++m) {
      std::vector<DispatchTime> times;
      SourceFrame given = frame;
      const bool timed = options.timed && methods[m].player;
      if (i == 0 && timed) {
        SHALE_TRY_VOID([&]() -> Result<void> {
          SourceFrame once = frame;
          const Result<FloatImage> ignored = methods[m].player->show(once);
          if (!ignored) return ignored.error();
          methods[m].player->reset();
          return {};
        }());
      }
      Result<FloatImage> result = methods[m].player
                                      ? methods[m].player->show(given, timed ? &times : nullptr)
                                      : load_display(methods[m].pictures[i], frame.camera.exposure);
      if (!result) return in_file(methods[m].name, result.error());
      if (const auto share = methods[m].player ? methods[m].player->share_run() : std::nullopt)
        scene.methods[m].share_run =
            scene.methods[m].share_run.value_or(0) + *share / static_cast<double>(count);
      std::optional<double> time_ms;
      if (timed) {
        double total_us = 0;
        for (const DispatchTime& time : times) total_us += time.time_us;
        time_ms = total_us / 1000;
      }
      if (shows) pictures[m] = *result;
      const Result<FrameMetrics> metrics =
          evaluators[m].add(*std::move(result), track, time_ms, shows ? &maps[m] : nullptr);
      if (!metrics)
        return in_file(methods[m].player ? methods[m].name : methods[m].pictures[i],
                       metrics.error());
      scene.methods[m].frames.push_back(
          {*metrics, time_ms,
           methods[m].player ? methods[m].player->kept_promise() : std::optional<bool>()});
    }
    if (shows) scene.shown.push_back(show_frame(i, track.reference().picture(), pictures, maps));
  }
  for (size_t m = 0; m < methods.size(); ++m) {
    scene.methods[m].means = evaluators[m].finish();
    if (scene.methods[m].share_run)
      scene.notes.push_back(fmt::format("{}: {:.1f} % of its frames ran, the first one whole.",
                                        methods[m].name, 100 * *scene.methods[m].share_run));
    const std::vector<FrameResult>& frames = scene.methods[m].frames;
    if (!methods[m].player || !methods[m].player->variant().promise) continue;
    scene.notes.push_back(fmt::format(
        "{}: {} of {} frames kept the promise {}, the others took the full passes.",
        methods[m].name,
        std::count_if(frames.begin(), frames.end(),
                      [](const FrameResult& frame) { return frame.kept_promise == true; }),
        count, methods[m].player->variant().promise->text));
  }
  scene.notes.push_back("IF-SSIM masks by depth as it is stored, which is hyperbolic.");
  return scene;
}

}  // namespace shale
