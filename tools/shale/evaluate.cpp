#include "tools/shale/evaluate.h"

#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"

namespace shale {
namespace {

/// Numbers of the frames whose pictures go into the page: the last, and others spread before it.
bool is_shown(uint32_t index, uint32_t count, uint32_t shown) {
  for (uint32_t i = 1; i <= std::min(shown, count); ++i)
    if (index + 1 == static_cast<uint32_t>(uint64_t{count} * i / shown)) return true;
  return false;
}

}  // namespace

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
  ReferenceTrack track;
  std::vector<SequenceEvaluator> evaluators(methods.size());
  std::optional<FrameCamera> previous;
  for (PlayedMethod& method : methods) method.player->reset();
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
    const bool shows = is_shown(i, count, options.shown);
    std::vector<FloatImage> pictures(methods.size()), maps(methods.size());
    for (size_t m = 0; m < methods.size(); ++m) {
      std::vector<DispatchTime> times;
      SourceFrame given = frame;
      if (i == 0 && options.timed) {
        SHALE_TRY_VOID([&]() -> Result<void> {
          SourceFrame once = frame;
          const Result<FloatImage> ignored = methods[m].player->show(once);
          if (!ignored) return ignored.error();
          methods[m].player->reset();
          return {};
        }());
      }
      Result<FloatImage> result = methods[m].player->show(given, options.timed ? &times : nullptr);
      if (!result) return in_file(methods[m].name, result.error());
      std::optional<double> time_ms;
      if (options.timed) {
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

}  // namespace shale
