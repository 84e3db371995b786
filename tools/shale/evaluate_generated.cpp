// Pictures between rendered frames, or beyond them, against the truth of their moment.
#include <algorithm>
#include <cmath>

#include "tools/eval/generated.h"
#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"
#include "tools/shale/evaluate.h"

namespace shale {
namespace {

/// What makes a picture, and its figures.
struct Track {
  std::string name;
  Player* player = nullptr;  ///< null: the truth's own motion
  bool waits = false;        ///< makes pictures between the frames, else ahead
  SequenceEvaluator evaluator{};
  KindSums kinds{};
  std::vector<double> all_psnr_db{}, psnr_db{}, ssim{}, flip{}, time_ms{};
  FloatImage rendered{};  ///< the newest frame as it is shown
};

/// The newest frame's truth, and that of the one before, with the depth that lies at its pixels.
struct TrueFrame {
  FloatImage display, depth;
};

double mean(std::span<const double> values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

std::optional<double> mean_if_any(std::span<const double> values) {
  return values.empty() ? std::nullopt : std::optional(mean(values));
}

GeneratedMetrics finish(const Track& track) {
  GeneratedMetrics metrics;
  metrics.frames = static_cast<uint32_t>(track.psnr_db.size());
  metrics.psnr_db = mean_if_any(track.psnr_db);
  metrics.ssim = mean_if_any(track.ssim);
  metrics.flip = mean_if_any(track.flip);
  metrics.time_ms = mean_if_any(track.time_ms);
  metrics.kinds = track.kinds.finish();
  metrics.judder_db = judder_db(track.all_psnr_db);
  metrics.latency_frames = track.waits ? 1 : 0;
  return metrics;
}

Result<FrameMetrics> judge(Track& track, const FloatImage& picture, const ReferenceTrack& reference,
                           bool is_generated, std::span<const uint8_t> kinds, FloatImage* map) {
  SHALE_TRY(const FrameMetrics metrics, track.evaluator.add(picture, reference, std::nullopt, map));
  const double psnr = std::min(*metrics.psnr_db, kPsnrCapDb);
  track.all_psnr_db.push_back(psnr);
  if (!is_generated) return metrics;
  track.psnr_db.push_back(psnr);
  track.ssim.push_back(metrics.ssim->full);
  track.flip.push_back(*metrics.flip);
  track.kinds.add(reference.reference().picture(), picture, kinds);
  return metrics;
}

/// The middle of an image.
FloatImage middle(const FloatImage& image, uint32_t width, uint32_t height) {
  FloatImage part{width, height, image.channels, {}};
  const uint32_t x = (image.width - width) / 2, y = (image.height - height) / 2;
  for (uint32_t row = 0; row < height; ++row) {
    const auto from = image.values.begin() +
                      (static_cast<std::ptrdiff_t>(y + row) * image.width + x) * image.channels;
    part.values.insert(part.values.end(), from,
                       from + static_cast<std::ptrdiff_t>(width) * image.channels);
  }
  return part;
}

class Evaluation {
 public:
  Evaluation(SceneSource& source, std::vector<PlayedMethod>& methods, std::span<const double> times,
             const EvaluateOptions& options)
      : source_(source), times_(times), options_(options) {
    measures_.still_deviation = measures_.temporal = false;
    reference_ = ReferenceTrack(measures_);
    for (PlayedMethod& method : methods) {
      method.player->reset();
      const bool waits = method.player->variant().generator->waits();
      tracks_.push_back({method.name, method.player.get(), waits, SequenceEvaluator(measures_)});
    }
    for (const bool waits : {true, false})
      if (std::any_of(tracks_.begin(), tracks_.end(),
                      [&](const Track& track) { return track.player && track.waits == waits; }))
        tracks_.push_back({waits ? "true motion between" : "true motion ahead", nullptr, waits,
                           SequenceEvaluator(measures_)});
  }

  Result<EvalScene> run() {
    const uint32_t count = source_.frame_count();
    scene_.name = source_.name();
    scene_.first_frame = options_.first_frame;
    scene_.size =
        fmt::format("{}x{} to {}x{}", source_.render_size().width, source_.render_size().height,
                    source_.output_size().width, source_.output_size().height);
    if (options_.with_margin)
      scene_.size += fmt::format(
          ", rendered with {} pixels around it",
          (options_.with_margin->output_size().width - source_.output_size().width) / 2);
    scene_.methods.resize(tracks_.size());
    Progress progress("evaluating " + scene_.name);
    for (uint32_t i = 0; i < count; ++i) {
      if (!progress.step(i, count))
        return bad_input(scene_.name, "interrupted after {} of {} frames", i, count);
      SHALE_TRY_VOID(frame(i, i + 1 == count));
    }
    for (size_t t = 0; t < tracks_.size(); ++t) {
      scene_.methods[t].means = tracks_[t].evaluator.finish();
      scene_.methods[t].generated = finish(tracks_[t]);
      // Beside frames that are the truth, but for roundings, everything swings.
      if (source_.render_size() == source_.output_size() || !tracks_[t].player)
        scene_.methods[t].generated->judder_db.reset();
    }
    scene_.frames = static_cast<uint32_t>(tracks_[0].psnr_db.size());
    scene_.notes.push_back(fmt::format(
        "{} frames, {} generated pictures; IF-SSIM is that of all of them; it masks by depth as it "
        "is stored, which is hyperbolic.",
        count, scene_.frames));
    return std::move(scene_);
  }

  std::vector<std::string> names() const {
    std::vector<std::string> names;
    for (const Track& track : tracks_) names.push_back(track.name);
    return names;
  }

 private:
  /// Frame i, and the pictures before it, all but at the first frame and behind a cut.
  Result<void> frame(uint32_t i, bool is_last) {
    SHALE_TRY(SourceFrame given, source_.frame(i, true));
    const bool has_past = i > 0 && !given.camera.cut;
    TrueFrame now{display_image(given.truth, given.camera.exposure), {}};
    const double own_time = 1;
    SceneMoment own;  // of the frame, with its motion from what is shown before it
    if (has_past) {
      const double shown_before = times_.back() < 1 ? times_.back() : 0;
      SHALE_TRY(own, source_.moment(i - 1, 1, std::array{shown_before}, false));
    } else {
      SHALE_TRY(own, source_.moment(i, 0, std::array{0.0}, false));
    }
    now.depth = own.depth;

    // What lies ahead of the frame before is made before the next one is there.
    std::vector<std::vector<FloatImage>> pictures(tracks_.size());
    if (has_past) SHALE_TRY_VOID(generate(false, pictures));
    const bool reverse_depth = given.camera.reverse_depth;
    if (options_.with_margin) {
      SHALE_TRY(given, options_.with_margin->frame(i, true));
    }
    if (given.color.width == given.truth.width && given.color.height == given.truth.height) {
      given.color = given.truth;
      given.depth = given.truth_depth;
      given.motion = given.truth_motion;
    }
    for (Track& track : tracks_) {
      if (!track.player) {
        track.rendered = now.display;
        continue;
      }
      SourceFrame taken = given;
      Result<FloatImage> shown = track.player->show(taken);
      if (!shown) return in_file(track.name, shown.error());
      track.rendered = inner(*std::move(shown));
    }
    if (has_past) SHALE_TRY_VOID(generate(true, pictures));
    for (size_t k = 0; has_past && k < times_.size(); ++k)
      SHALE_TRY_VOID(moment(i - 1, k, now, pictures, is_last && k + 1 == times_.size()));
    before_ = now;
    if (has_past && times_.back() == own_time) return {};  // the last picture stood for the frame
    SHALE_TRY_VOID(reference_.advance({.display = std::move(now.display),
                                       .motion = has_past ? &own.motion[0] : nullptr,
                                       .depth = has_past ? &own.depth : nullptr,
                                       .reverse_depth = reverse_depth,
                                       .cut = !has_past}));
    for (Track& track : tracks_)
      if (Result<FrameMetrics> ok = judge(track, track.rendered, reference_, false, {}, nullptr);
          !ok)
        return in_file(track.name, ok.error());
    return {};
  }

  /// Without the margin.
  FloatImage inner(FloatImage picture) const {
    if (!options_.with_margin) return picture;
    return middle(picture, source_.output_size().width, source_.output_size().height);
  }

  /// Pictures of the methods that make them between frames, or of those that make them ahead.
  Result<void> generate(bool waits, std::vector<std::vector<FloatImage>>& pictures) {
    for (size_t t = 0; t < tracks_.size(); ++t) {
      Track& track = tracks_[t];
      if (!track.player || track.waits != waits) continue;
      for (const double after : times_) {
        const float time = static_cast<float>(waits ? after : 1 + after);
        std::vector<DispatchTime> dispatches;
        Result<FloatImage> picture =
            track.player->show_generated(time, options_.timed ? &dispatches : nullptr);
        if (!picture) return in_file(track.name, picture.error());
        double total_us = 0;
        for (const DispatchTime& each : dispatches) total_us += each.time_us;
        if (options_.timed) track.time_ms.push_back(total_us / 1000);
        pictures[t].push_back(inner(*std::move(picture)));
      }
    }
    return {};
  }

  /// The pictures at times_[k] behind frame i, against the truth; `now` is the frame i + 1.
  Result<void> moment(uint32_t i, size_t k, const TrueFrame& now,
                      std::vector<std::vector<FloatImage>>& pictures, bool shows) {
    const double after = times_[k];
    // To both frames, and to what is shown before if that is none of them.
    const std::array<double, 3> to{0, 1, k > 0 ? times_[k - 1] : 0};
    SHALE_TRY(const SceneMoment at,
              source_.moment(i, after, std::span(to).first(k > 0 ? 3 : 2), true));
    const FloatImage display = display_image(at.truth, at.camera.exposure);
    const FloatImage bare =
        at.bare.empty() ? FloatImage{} : display_image(at.bare, at.camera.exposure);
    const PictureTruth truth{.display = &display,
                             .bare = bare.empty() ? nullptr : &bare,
                             .depth = &at.depth,
                             .motion = &at.motion[0],
                             .still_motion = &at.still_motion,
                             .reverse_depth = at.camera.reverse_depth};
    const std::array<SourceView, 2> views{SourceView{&at.motion[0], &before_.depth},
                                          SourceView{&at.motion[1], &now.depth}};
    const std::array<const FloatImage*, 2> colors{&before_.display, &now.display};
    const std::array<float, 2> weights{static_cast<float>(1 - after), static_cast<float>(after)};
    SHALE_TRY_VOID(reference_.advance({.display = display,
                                       .motion = &at.motion[k > 0 ? 2 : 0],
                                       .depth = &at.depth,
                                       .reverse_depth = at.camera.reverse_depth}));
    std::vector<FloatImage> shown, maps;
    for (size_t t = 0; t < tracks_.size(); ++t) {
      Track& track = tracks_[t];
      // Ahead of a frame there is that frame alone.
      const size_t known = track.waits ? 2 : 1;
      const std::span<const SourceView> frames = std::span(views).first(known);
      FloatImage picture = track.player
                               ? std::move(pictures[t][k])
                               : warped_by_truth(truth, frames, std::span(colors).first(known),
                                                 known == 2 ? std::span<const float>(weights)
                                                            : std::span<const float>(kAlone));
      if (!track.player)  // in the steps of a display, as all pictures are
        for (float& value : picture.values) value = std::round(value * 255) / 255;
      FloatImage map;
      const bool wants_map = shows && options_.shown > 0;
      Result<FrameMetrics> metrics = judge(track, picture, reference_, true,
                                           pixel_kinds(truth, frames), wants_map ? &map : nullptr);
      if (!metrics) return in_file(track.name, metrics.error());
      scene_.methods[t].frames.push_back({*metrics, {}});
      if (!wants_map) continue;
      shown.push_back(std::move(picture));
      maps.push_back(std::move(map));
    }
    if (!shown.empty()) scene_.shown.push_back(show_frame(i, display, shown, maps));
    return {};
  }

  static constexpr std::array<float, 1> kAlone{1};
  SceneSource& source_;
  std::span<const double> times_;
  EvaluateOptions options_;
  SequenceOptions measures_;
  ReferenceTrack reference_;
  std::vector<Track> tracks_;
  TrueFrame before_;
  EvalScene scene_;
};

}  // namespace

Result<EvalScene> evaluate_generated(SceneSource& source, std::vector<PlayedMethod>& methods,
                                     std::span<const double> times, const EvaluateOptions& options,
                                     std::vector<std::string>& names) {
  for (const PlayedMethod& method : methods)
    if (!method.player || !method.player->variant().generator)
      return bad_input(method.name, "has no program that generates pictures");
  Evaluation evaluation(source, methods, times, options);
  names = evaluation.names();
  return evaluation.run();
}

void print_generated(const std::vector<std::string>& methods, const EvalScene& scene) {
  size_t wide = 8;
  for (const std::string& method : methods) wide = std::max(wide, method.size());
  const auto cell = [](const std::optional<double>& value, int digits) {
    return value ? fmt::format("{:.{}f}", *value, digits) : std::string("-");
  };
  constexpr auto kLine =
      "  {:<{}} {:>8} {:>7} {:>7} {:>8} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>5} {:>6}\n";
  fmt::print(kLine, "", wide, "PSNR dB", "SSIM", "FLIP", "IF-SSIM", "judder", "in all", "in some",
             "in none", "border", "moving", "unmoved", "waits", "ms");
  for (size_t m = 0; m < methods.size(); ++m) {
    const MethodResult& method = scene.methods[m];
    const GeneratedMetrics& made = *method.generated;
    const auto kind = [&](PixelKind which) {
      return cell(made.kinds[static_cast<size_t>(which)].psnr_db, 2);
    };
    const std::string if_ssim =
        method.means.if_ssim ? fmt::format("{:.4f}", method.means.if_ssim->at_t.value) : "-";
    fmt::print(kLine, methods[m], wide, cell(made.psnr_db, 2), cell(made.ssim, 4),
               cell(made.flip, 4), if_ssim, cell(made.judder_db, 2), kind(PixelKind::kSeenInAll),
               kind(PixelKind::kSeenInSome), kind(PixelKind::kSeenInNone), kind(PixelKind::kBorder),
               kind(PixelKind::kMoving), kind(PixelKind::kMotionless), made.latency_frames,
               cell(made.time_ms, 1));
  }
  fmt::print("  {:<{}} {:>42}", "parts of the pictures", wide, "");
  const GeneratedMetrics& first = *scene.methods[0].generated;
  for (const GeneratedMetrics::Kind& kind : first.kinds)
    fmt::print(" {:>5.1f} %", 100 * kind.share);
  fmt::print("\n");
}

}  // namespace shale
