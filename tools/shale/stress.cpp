// shale stress: a sandwich at the extremes: faults and how they pass, many frames and whether they drift,
// precisions and where they part.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "ir/base/file.h"
#include "ir/graph/tensor.h"
#include "tools/eval/data_page.h"
#include "tools/eval/metrics.h"
#include "tools/eval/tonemap.h"
#include "tools/shale/command.h"
#include "tools/shale/cost_page.h"
#include "tools/shale/outputs.h"
#include "tools/shale/player.h"
#include "tools/shale/stress_frames.h"
#include "tools/shale/stress_reference.h"

namespace shale {
namespace {

constexpr const char* kStressSchema = "shale-stress/1";
constexpr const char* kDefaultRender = "96x54";
constexpr uint32_t kWarmFrames = 8, kFaultFrames = 4;
constexpr uint32_t kLookedAt =
    8;  ///< of a course's frames, every so many are held against the bounds
constexpr float kLargestHalf = 65504;
/// Of what passes keep in halves, x / (1 + x) of exposed colours: some steps of 2^-11.
constexpr double kOvershoot = 4.0 / 2048;
/// Display codes that nobody sees.
constexpr double kSeenCodes = 2, kDriftCodes = 0.5;
/// In the mean, between a device's floats and a model's doubles.
constexpr double kReferenceCodes = 0.5;

struct Arguments {
  std::string model, page, json_file;
  std::vector<std::string> only;
  std::string reference = "stored";
  uint32_t recover = 32, frames = 256, search = 0;
  uint64_t seed = 1;
  CompileArguments compile;
  DeviceArguments device;
  bool precisions = false, json = false;
};

/// Finite values' range, and how many are not finite.
struct Range {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  uint64_t not_finite = 0;

  void add(const FloatImage& image) {
    for (const float value : image.values)
      if (std::isfinite(value)) {
        low = std::min(low, static_cast<double>(value));
        high = std::max(high, static_cast<double>(value));
      } else {
        ++not_finite;
      }
  }
};

double mapped(double exposed) { return exposed / (1 + std::max(exposed, 0.0)); }

/// Difference of two pictures as a display shows them, in codes.
struct Difference {
  double largest = 0, mean = 0;
  double share = 0;  ///< of pixels that differ by more than one code
};

double pixel_codes(const float* a, const float* b) {
  double codes = 0;
  for (int c = 0; c < 3; ++c)
    codes =
        std::max(codes, 255.0 * std::abs(static_cast<double>(a[c]) - static_cast<double>(b[c])));
  return codes;
}

Difference difference(const FloatImage& a, const FloatImage& b) {
  Difference result;
  const size_t pixels = a.values.size() / 3;
  for (size_t i = 0; i < pixels; ++i) {
    const double codes = pixel_codes(&a.values[3 * i], &b.values[3 * i]);
    result.largest = std::max(result.largest, codes);
    result.mean += codes;
    result.share += codes > 1.5 ? 1 : 0;
  }
  result.mean /= static_cast<double>(pixels);
  result.share /= static_cast<double>(pixels);
  return result;
}

/// Files that the process has open, and its memory; 0 where the system does not tell.
struct Held {
  size_t files = 0;
  double megabytes = 0;
};

Held held() {
  Held held;
  std::error_code error;
  for (auto it = std::filesystem::directory_iterator("/proc/self/fd", error);
       !error && it != std::filesystem::directory_iterator(); it.increment(error))
    ++held.files;
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with("VmRSS:")) held.megabytes = std::strtod(line.c_str() + 6, nullptr) / 1024;
  return held;
}

/// One after the other what a verdict holds against; empty is that all holds.
std::string joined(const std::vector<std::string>& parts) {
  std::string text;
  for (const std::string& part : parts) text += (text.empty() ? "" : "; ") + part;
  return text;
}

/// The least and the largest value found of what the package bounds, by channel.
class BoundsFound {
 public:
  Result<void> look(const Player& player) {
    const Variant& variant = player.variant();
    found_.resize(variant.bounds.size());
    for (size_t b = 0; b < found_.size(); ++b) {
      SHALE_TRY(const FloatImage image,
                player.read(variant.resources[variant.bounds[b].resource].name, false));
      std::vector<Range>& ranges = found_[b];
      ranges.resize(variant.bounds[b].low.size());
      for (size_t i = 0; i < image.values.size(); ++i) {
        Range& range = ranges[i % image.channels % ranges.size()];
        const double value = static_cast<double>(image.values[i]);
        if (!std::isfinite(value)) {
          ++range.not_finite;
          continue;
        }
        range.low = std::min(range.low, value);
        range.high = std::max(range.high, value);
      }
    }
    return {};
  }

  /// Against the bounds, a row for each resource: how far apart they are in the channel where that is most, and in the one
  /// where it is least.
  Json rows(const Variant& variant) const {
    Json rows = Json::array();
    for (size_t b = 0; b < found_.size(); ++b) {
      const ValueBounds& bounds = variant.bounds[b];
      double most = 0, least = 1;
      Range all;
      Json low = Json::array(), high = Json::array();
      std::vector<std::string> broken;
      for (size_t c = 0; c < found_[b].size(); ++c) {
        Range range = found_[b][c];
        if (range.low > range.high) range.low = range.high = 0;  // nothing finite
        const double lower = static_cast<double>(bounds.low[c]),
                     upper = static_cast<double>(bounds.high[c]);
        low.push_back(range.low);
        high.push_back(range.high);
        all.low = std::min(all.low, range.low);
        all.high = std::max(all.high, range.high);
        if (range.low < lower || range.high > upper || range.not_finite > 0)
          broken.push_back(fmt::format("channel {}: {:.6g} to {:.6g}, proven {:.6g} to {:.6g}", c,
                                       range.low, range.high, lower, upper));
        const double share = upper > lower ? (range.high - range.low) / (upper - lower) : 1;
        most = std::max(most, share);
        least = std::min(least, share);
      }
      rows.push_back({{"of", variant.resources[bounds.resource].name},
                      {"low", bounds.low},
                      {"high", bounds.high},
                      {"found_low", std::move(low)},
                      {"found_high", std::move(high)},
                      {"proven_least", std::ranges::min(bounds.low)},
                      {"proven_most", std::ranges::max(bounds.high)},
                      {"least_found", all.low},
                      {"most_found", all.high},
                      {"share_most", most},
                      {"share_least", least},
                      {"verdict", broken.empty() ? "holds" : joined(broken)}});
    }
    return rows;
  }

 private:
  std::vector<std::vector<Range>> found_;  ///< by bound, then by its channel
};

/// A sandwich that plays linear frames, or displayed ones, always from a start without a past.
class Subject {
 public:
  static Result<Subject> create(const Arguments& arguments, const ToolDevice& device,
                                const std::string& precision, std::optional<Extent> output) {
    CompileArguments compile = arguments.compile;
    compile.precision = precision;
    if (compile.render.empty()) compile.render = kDefaultRender;
    if (output) compile.ratio = 0;
    SHALE_TRY(Sandwich sandwich, load_sandwich(arguments.model, compile, {}, output));
    Subject subject;
    SHALE_TRY(subject.player_, Player::create(device, sandwich.package));
    if (output)
      subject.why_no_reference_ = "no reference: it is compared with another precision";
    else if (Result<StressReference> reference =
                 create_reference(arguments, device, compile, sandwich, *subject.player_))
      subject.reference_ = *std::move(reference);
    else if (reference.error().code == ErrorCode::kUnsupported)
      subject.why_no_reference_ = reference.error().text();
    else
      return reference.error();
    subject.graphs_ = std::move(sandwich.graphs);
    subject.pattern_ = sandwich.pattern;
    return subject;
  }

  Player& player() { return *player_; }
  bool display() const { return player_->is_display(); }
  bool generates() const { return player_->variant().generator.has_value(); }
  bool takes_depth() const {
    const std::vector<Resource>& all = player_->variant().resources;
    return std::any_of(all.begin(), all.end(), [](const Resource& r) {
      return r.category == Category::kImageInput && r.name == "depth";
    });
  }
  StressFrames frames() const {
    return {player_->render_size(), player_->output_size(), pattern_, display()};
  }

  /// The next frame starts without a past.
  void reset() {
    player_->reset();
    if (reference_) reference_->reset();
  }
  /// Empty if there is one.
  const std::string& why_no_reference() const { return why_no_reference_; }
  /// What the model shows of the frame that was played last; nothing without one. It has to see each frame.
  Result<std::optional<FloatImage>> reference(const SourceFrame& frame, bool of_device) {
    if (!reference_) return std::optional<FloatImage>();
    SHALE_TRY(FloatImage picture, reference_->play(frame, *player_, of_device));
    return std::optional(std::move(picture));
  }

  /// The linear picture, or the displayed one of a sandwich of such; a generated one below it.
  Result<FloatImage> play(const SourceFrame& frame) { return play_all(*player_, frame); }
  /// Remembers what the package bounds, as the last frame left it.
  Result<void> look() { return found_.look(*player_); }
  Json bounds() const { return found_.rows(player_->variant()); }
  /// What a display shows of it.
  FloatImage shown(const FloatImage& picture, float exposure) const {
    return display() ? picture : display_image(picture, exposure);
  }

  /// Values of the histories that are not finite.
  Result<uint64_t> broken_history() const {
    Range range;
    for (const Resource& resource : player_->variant().resources) {
      if (resource.category != Category::kImageHistory || resource.history_depth < 2) continue;
      SHALE_TRY(const FloatImage image, player_->read(resource.name, false));
      range.add(image);
    }
    return range.not_finite;
  }

  /// Codes at the ends of the type, by int8 tensor of the network.
  Result<Json> saturation() const {
    Json shares = Json::object();
    for (const Category category : {Category::kInput, Category::kOutput})
      for (const Resource* resource : tensors_of(player_->variant(), category)) {
        if (resource->dtype != DType::kInt8) continue;
        SHALE_TRY(const Tensor tensor, player_->read_tensor(resource->name));
        int64_t ends = 0;
        for (int64_t i = 0; i < tensor.count(); ++i)
          ends += tensor.get(i) <= -128 || tensor.get(i) >= 127;
        shares[resource->name] = static_cast<double>(ends) / static_cast<double>(tensor.count());
      }
    return shares;
  }

  /// The network of the last frame against the interpreter: what differs, or nothing.
  Result<std::optional<std::string>> departs() const {
    if (graphs_.empty() || !player_->ran_network()) return std::optional<std::string>();
    return network_difference(*player_, graphs_);
  }

 private:
  static Result<StressReference> create_reference(const Arguments& arguments,
                                                  const ToolDevice& device,
                                                  CompileArguments compile,
                                                  const Sandwich& sandwich, const Player& player) {
    const bool has_tolerance = compile.tiles.value_or(0) > 0;
    if (arguments.reference != "wide")
      return StressReference::create(
          sandwich, player, has_tolerance,
          arguments.reference == "exact" ? nss_v1::Rounding::kNone : nss_v1::Rounding::kAsStored);
    if (has_tolerance) compile.tiles.reset();
    SHALE_TRY(const Sandwich wide, load_sandwich(arguments.model, compile, player.render_size(),
                                                 player.output_size(), wide_frame));
    SHALE_TRY(std::unique_ptr<Player> beside, Player::create(device, wide.package));
    return StressReference(std::move(beside));
  }

  std::unique_ptr<Player> player_;
  std::vector<Graph> graphs_;
  SamplingPattern pattern_;
  BoundsFound found_;
  std::optional<StressReference> reference_;
  std::string why_no_reference_;
};

/// How far what a device shows departs from what the model in double precision shows.
class ReferenceDeparture {
 public:
  void add(const Difference& d) {
    largest_ = std::max(largest_, d.largest);
    means_ += d.mean;
    ++frames_;
  }
  double mean() const { return frames_ > 0 ? means_ / frames_ : 0; }
  /// Nothing is null: there is no model.
  void write(Json& row, std::vector<std::string>& broken) const {
    row["reference_largest_codes"] = frames_ > 0 ? Json(largest_) : Json();
    row["reference_mean_codes"] = frames_ > 0 ? Json(mean()) : Json();
    if (mean() > kReferenceCodes)
      broken.push_back(fmt::format("{:.2f} codes in the mean from the model", mean()));
  }

 private:
  double largest_ = 0, means_ = 0;
  uint32_t frames_ = 0;
};

/// A fault in kFaultFrames frames between clean ones, against the same frames without it. It has passed when no more
/// of it is left than of a cut.
class FaultRun {
 public:
  FaultRun(const Arguments& arguments, Subject& subject)
      : arguments_(arguments), subject_(subject), frames_(subject.frames()) {}

  /// Plays without a fault and with a cut: what the others are compared with.
  Result<void> prepare() {
    subject_.reset();
    for (uint32_t i = 0; i < count(); ++i) {
      const SourceFrame frame = frames_.frame(Course::kMoving, i);
      SHALE_TRY(const FloatImage picture, subject_.play(frame));
      clean_.push_back(subject_.shown(picture, frame.camera.exposure));
    }
    subject_.reset();
    for (uint32_t i = 0; i < count(); ++i) {
      SourceFrame frame = frames_.frame(Course::kMoving, i);
      frame.camera.cut = i == kWarmFrames + kFaultFrames;
      SHALE_TRY(const FloatImage picture, subject_.play(frame));
      of_cut_ = difference(subject_.shown(picture, frame.camera.exposure), clean_[i]).largest;
    }
    return {};
  }

  /// Display codes of a fault that may be left at the end.
  double most_left() const { return of_cut_ + kSeenCodes; }

  Result<Json> run(const Fault& fault) {
    subject_.reset();
    Range output;
    double seen = 0;  // the largest finite colour that went in
    double above = 0, below = 0, highest = 0, exposure_before = 0;
    Json json{{"group", fault.group}, {"fault", fault.name}}, curve = Json::array();
    uint64_t broken_history = 0;
    Difference struck, left;
    uint32_t lasts = 0;
    std::optional<std::string> departs;
    ReferenceDeparture from_model;
    for (uint32_t i = 0; i < count(); ++i) {
      SourceFrame frame = frames_.frame(Course::kMoving, i);
      const float undisturbed = frame.camera.exposure;
      const bool struck_now = i >= kWarmFrames && i < kWarmFrames + kFaultFrames;
      if (struck_now) fault.apply(frame);
      for (const float value : frame.color.values)
        if (!std::isnan(value)) seen = std::max<double>(seen, std::min(value, kLargestHalf));
      SHALE_TRY(const FloatImage picture, subject_.play(frame));
      if (i >= kWarmFrames) SHALE_TRY_VOID(subject_.look());
      Range range;
      range.add(picture);
      output.add(picture);
      const double exposure = static_cast<double>(frame.camera.exposure);
      // A generated picture may be as bright as the frame before it was shown.
      const double brightest =
          subject_.generates() ? std::max(exposure, exposure_before) : exposure;
      exposure_before = exposure;
      // What a display shows ends at 1 by its format.
      if (const double excess = mapped(range.high * exposure) - mapped(seen * brightest);
          !subject_.display() && excess > above) {
        above = excess;
        highest = range.high;
      }
      below = std::min(below, range.low * exposure);
      // As the undisturbed exposure shows it, so that what differs is the picture.
      const FloatImage shown = subject_.shown(picture, undisturbed);
      left = difference(shown, clean_[i]);
      SHALE_TRY(const auto model, subject_.reference(frame, false));
      if (model && i >= kWarmFrames)
        from_model.add(difference(shown, subject_.shown(*model, undisturbed)));
      curve.push_back(left.largest);
      if (left.largest > kSeenCodes && i >= kWarmFrames + kFaultFrames)
        lasts = i + 1 - kWarmFrames - kFaultFrames;
      if (i + 1 == kWarmFrames + kFaultFrames) {
        struck = left;
        SHALE_TRY(broken_history, subject_.broken_history());
        SHALE_TRY(json["saturated"], subject_.saturation());
        SHALE_TRY(departs, subject_.departs());
      }
      if (i == kWarmFrames && fault.group == "texels") json["reach"] = reach(shown, clean_[i]);
    }
    SHALE_TRY(const uint64_t left_broken, subject_.broken_history());
    std::vector<std::string> broken;
    if (output.not_finite > 0)
      broken.push_back(fmt::format("{} values of the output are not finite", output.not_finite));
    if (left_broken > 0)
      broken.push_back(fmt::format("{} values of the histories stay not finite", left_broken));
    if (below < -kOvershoot)
      broken.push_back(fmt::format("output down to {:.3g}, expected 0", output.low));
    if (above > kOvershoot)
      broken.push_back(
          fmt::format("output up to {:.6g}, the colours went to {:.6g}", highest, seen));
    if (left.largest > most_left())
      broken.push_back(fmt::format("{:.0f} codes are left after {} frames, {:.0f} of a cut",
                                   left.largest, arguments_.recover, of_cut_));
    if (departs) broken.push_back("the network departs from the interpreter: " + *departs);
    from_model.write(json, broken);
    json.update({{"not_finite", output.not_finite},
                 {"broken_history", broken_history},
                 {"low", output.low},
                 {"high", output.high},
                 {"struck_codes", struck.largest},
                 {"struck_share", struck.share},
                 {"lasts_frames", lasts < arguments_.recover ? Json(lasts) : Json()},
                 {"left_codes", left.largest},
                 {"left_share", left.share},
                 {"codes", std::move(curve)},
                 {"verdict", broken.empty() ? "holds" : joined(broken)}});
    return json;
  }

 private:
  uint32_t count() const { return kWarmFrames + kFaultFrames + arguments_.recover; }

  /// Output pixels, per axis, from the spoilt texel's middle to the farthest pixel that differs.
  double reach(const FloatImage& shown, const FloatImage& clean) const {
    const Extent render = subject_.player().render_size();
    const auto [tx, ty] = spoilt_texel(render);
    const uint32_t height = subject_.player().output_size().height;  // of one of the pictures
    const double x0 = (tx + 0.5) * shown.width / render.width,
                 y0 = (ty + 0.5) * height / render.height;
    double farthest = 0;
    for (uint32_t y = 0; y < shown.height; ++y)
      for (uint32_t x = 0; x < shown.width; ++x)
        if (pixel_codes(shown.at(x, y), clean.at(x, y)) > 0.5)
          farthest = std::max({farthest, std::abs(x + 0.5 - x0), std::abs(y % height + 0.5 - y0)});
    return farthest;
  }

  const Arguments& arguments_;
  Subject& subject_;
  StressFrames frames_;
  std::vector<FloatImage> clean_;
  double of_cut_ = 0;  ///< codes that are left of a cut at the end
};

/// Least squares of y over 0, 1, 2 ...
double slope(const std::vector<double>& y) {
  const double n = static_cast<double>(y.size());
  if (n < 2) return 0;
  double sum = 0, sum_iy = 0;
  for (size_t i = 0; i < y.size(); ++i) {
    sum += y[i];
    sum_iy += static_cast<double>(i) * y[i];
  }
  const double mean_i = (n - 1) / 2, squares = n * (n * n - 1) / 12;
  return (sum_iy - mean_i * sum) / squares;
}

/// Frames that repeat, over and over: what the results of each cycle have against those of the second.
Result<Json> run_course(const Arguments& arguments, Subject& subject, Course course,
                        Progress& progress) {
  const StressFrames frames = subject.frames();
  const uint32_t cycle = frames.cycle();
  const uint32_t cycles = std::max(4u, (arguments.frames + cycle - 1) / cycle), settled = 1;
  subject.reset();
  std::vector<SourceFrame> inputs;
  for (uint32_t i = 0; i < cycle; ++i) inputs.push_back(frames.frame(course, i));
  std::vector<FloatImage> reference;
  std::vector<double> means, model_means;
  ReferenceDeparture from_model;
  Json curve = Json::array();
  Range output;
  double largest = 0, swing = 0;
  std::vector<std::string> broken;
  Held before;
  for (uint32_t k = 0; k < cycles; ++k) {
    Difference worst;
    ReferenceDeparture of_cycle;
    std::vector<float> low, high;
    for (uint32_t i = 0; i < cycle; ++i) {
      if (!progress.step(size_t{k} * cycle + i, size_t{cycles} * cycle))
        return bad_input("", "interrupted");
      SHALE_TRY(const FloatImage picture, subject.play(inputs[i]));
      const float exposure = inputs[i].camera.exposure;
      output.add(picture);
      FloatImage shown = subject.shown(picture, exposure);
      // The interpreter would take most of the time.
      SHALE_TRY(const auto model, subject.reference(inputs[i], true));
      if (i % kLookedAt == 0) {
        SHALE_TRY_VOID(subject.look());
        if (model) {
          const Difference d = difference(shown, subject.shown(*model, exposure));
          from_model.add(d);
          of_cycle.add(d);
        }
      }
      if (course == Course::kStill && k == cycles - 1) {
        if (low.empty()) low = high = shown.values;
        for (size_t v = 0; v < low.size(); ++v) {
          low[v] = std::min(low[v], shown.values[v]);
          high[v] = std::max(high[v], shown.values[v]);
        }
      }
      if (k == settled) reference.push_back(std::move(shown));
      if (k <= settled) continue;
      const Difference now = difference(shown, reference[i]);
      worst.largest = std::max(worst.largest, now.largest);
      worst.mean += now.mean / cycle;
    }
    for (size_t v = 0; v < low.size(); ++v)
      swing += 255.0 * static_cast<double>(high[v] - low[v]) / static_cast<double>(low.size());
    model_means.push_back(of_cycle.mean());
    if (k == settled) before = held();
    if (k <= settled) continue;
    means.push_back(worst.mean);
    curve.push_back(worst.mean);
    largest = std::max(largest, worst.largest);
  }
  SHALE_TRY(const uint64_t broken_history, subject.broken_history());
  SHALE_TRY(const std::optional<std::string> departs, subject.departs());
  const Held after = held();
  const double rate = slope(means) / cycle * 1000;
  if (output.not_finite > 0)
    broken.push_back(fmt::format("{} values of the output are not finite", output.not_finite));
  if (broken_history > 0)
    broken.push_back(fmt::format("{} values of the histories are not finite", broken_history));
  if (means.back() > kDriftCodes)
    broken.push_back(fmt::format("{:.2f} codes of drift in the mean", means.back()));
  if (after.files > before.files)
    broken.push_back(fmt::format("{} files more are open", after.files - before.files));
  if (departs) broken.push_back("the network departs from the interpreter: " + *departs);
  Json json;
  from_model.write(json, broken);
  if (subject.why_no_reference().empty())
    json["reference_codes_per_1000_frames"] = slope(model_means) / cycle * 1000;
  json.update({{"course", course_name(course)},
               {"frames", cycles * cycle},
               {"cycle", cycle},
               {"low", output.low},
               {"high", output.high},
               {"drift_mean_codes", means.back()},
               {"drift_largest_codes", largest},
               {"drift_codes_per_1000_frames", rate},
               {"memory_growth_mb", after.megabytes - before.megabytes},
               {"codes", std::move(curve)},
               {"verdict", broken.empty() ? "holds" : joined(broken)}});
  if (course == Course::kStill) json["swing_codes"] = swing;
  return json;
}

/// Two precisions on the same frames, from a start without a past.
struct Departure {
  double psnr_db = 0;  ///< of what is shown, over all frames
  double largest_codes = 0;
  uint32_t frame = 0, x = 0, y = 0;  ///< where that is
};

Result<Departure> departure(Subject& a, Subject& b, std::span<const SourceFrame> frames) {
  a.player().reset();
  b.player().reset();
  Departure result;
  double squares = 0;
  size_t values = 0;
  for (uint32_t i = 0; i < frames.size(); ++i) {
    if (interrupted()) return bad_input("", "interrupted");
    const float exposure = frames[i].camera.exposure;
    SHALE_TRY(const FloatImage of_a, a.play(frames[i]));
    SHALE_TRY(const FloatImage of_b, b.play(frames[i]));
    const FloatImage shown_a = a.shown(of_a, exposure), shown_b = b.shown(of_b, exposure);
    for (size_t v = 0; v < shown_a.values.size(); ++v) {
      const double d = static_cast<double>(shown_a.values[v] - shown_b.values[v]);
      squares += d * d;
    }
    values += shown_a.values.size();
    for (uint32_t y = 0; y < shown_a.height; ++y)
      for (uint32_t x = 0; x < shown_a.width; ++x)
        if (const double codes = pixel_codes(shown_a.at(x, y), shown_b.at(x, y));
            codes > result.largest_codes) {
          result.largest_codes = codes;
          result.frame = i;
          result.x = x;
          result.y = y;
        }
  }
  result.psnr_db = squares > 0 ? -10 * std::log10(squares / static_cast<double>(values)) : 100;
  return result;
}

Json departure_json(const std::string& precision, const Departure& d) {
  return {{"precision", precision},
          {"psnr_db", d.psnr_db},
          {"largest_codes", d.largest_codes},
          {"frame", d.frame},
          {"x", d.x},
          {"y", d.y}};
}

/// Inputs that part two precisions most: blocks of a few frames are made brighter or darker, and what
/// parts them more is kept. Seeded, so a find can be made again.
Result<Json> search(const Arguments& arguments, Subject& int8, Subject& fp32, Progress& progress) {
  constexpr uint32_t kFrames = 3;
  const StressFrames source = int8.frames();
  const Extent size = int8.player().render_size();
  std::vector<SourceFrame> frames;
  for (uint32_t i = 0; i < kFrames; ++i) frames.push_back(source.frame(Course::kMoving, i));
  SHALE_TRY(Departure best, departure(int8, fp32, frames));
  const double start = best.psnr_db;
  std::mt19937_64 random(arguments.seed);
  const auto below = [&](uint32_t n) { return static_cast<uint32_t>(random() % n); };
  Json relights = Json::array();
  for (uint32_t step = 0; step < arguments.search; ++step) {
    if (!progress.step(step, arguments.search)) return bad_input("", "interrupted");
    Relight relight{.x = below(size.width), .y = below(size.height)};
    if (const uint32_t of = below(kFrames + 1); of < kFrames) relight.frame = of;
    relight.stops = static_cast<int>(below(13)) - 6;
    std::vector<SourceFrame> next = frames;
    relight.apply(next, int8.display());
    SHALE_TRY(const Departure now, departure(int8, fp32, next));
    if (now.psnr_db >= best.psnr_db) continue;
    best = now;
    frames = std::move(next);
    const bool all = relight.frame == Relight::kAllFrames;
    relights.push_back({{"x", relight.x},
                        {"y", relight.y},
                        {"frame", all ? Json() : Json(relight.frame)},
                        {"stops", relight.stops}});
  }
  Json json = departure_json("int8", best);
  json.update({{"steps", arguments.search},
               {"kept", relights.size()},
               {"relights", std::move(relights)},
               {"seed", arguments.seed},
               {"start_psnr_db", start}});
  return json;
}

/// Largest and mean departure.
std::string of_model(const Json& row) {
  return row["reference_mean_codes"].is_null()
             ? "-"
             : fmt::format("{:.0f}, {:.4f}", row["reference_largest_codes"].get<double>(),
                           row["reference_mean_codes"].get<double>());
}

void print(const Json& json) {
  if (!json["faults"].empty()) {
    fmt::print("{:<10} {:<22} {:>11} {:>11} {:>7} {:>6} {:>6} {:>6} {:>12}  {}\n", "group", "fault",
               "low", "high", "struck", "area", "lasts", "left", "of model", "verdict");
    for (const Json& row : json["faults"])
      fmt::print(
          "{:<10} {:<22} {:>11.4g} {:>11.4g} {:>7.0f} {:>4.0f} % {:>6} {:>6.0f} {:>12}  {}\n",
          row["group"].get<std::string>(), row["fault"].get<std::string>(),
          row["low"].get<double>(), row["high"].get<double>(), row["struck_codes"].get<double>(),
          100 * row["struck_share"].get<double>(),
          row["lasts_frames"].is_null() ? "-" : std::to_string(row["lasts_frames"].get<uint32_t>()),
          row["left_codes"].get<double>(), of_model(row),
          one_line(row["verdict"].get<std::string>()));
    fmt::print(
        "struck, left: largest difference in display codes; lasts: frames after the fault\n");
  }
  if (!json["courses"].empty()) {
    fmt::print("\n{:<10} {:>8} {:>9} {:>9} {:>12} {:>12} {:>12} {:>8}  {}\n", "course", "frames",
               "drift", "largest", "codes/1000", "of model", "codes/1000", "MB more", "verdict");
    for (const Json& row : json["courses"])
      fmt::print("{:<10} {:>8} {:>9.3f} {:>9.0f} {:>12.4f} {:>12} {:>12} {:>8.1f}  {}\n",
                 row["course"].get<std::string>(), row["frames"].get<uint32_t>(),
                 row["drift_mean_codes"].get<double>(), row["drift_largest_codes"].get<double>(),
                 row["drift_codes_per_1000_frames"].get<double>(), of_model(row),
                 row.contains("reference_codes_per_1000_frames")
                     ? fmt::format("{:.4f}", row["reference_codes_per_1000_frames"].get<double>())
                     : "-",
                 row["memory_growth_mb"].get<double>(),
                 one_line(row["verdict"].get<std::string>()));
    for (const Json& row : json["courses"])
      if (row.contains("swing_codes"))
        fmt::print("at rest a value swings by {:.2f} codes within a cycle, in the mean\n",
                   row["swing_codes"].get<double>());
  }
  if (!json["faults"].empty() || !json["courses"].empty())
    fmt::print("{}\n", json["reference"].get<std::string>());
  if (!json["bounds"].empty())
    fmt::print("\n{:<12} {:>26} {:>26} {:>15}  {}\n", "of", "proven, for every input", "found",
               "found of proven", "verdict");
  for (const Json& row : json["bounds"]) {
    const auto ends = [&](const char* low, const char* high) {
      return fmt::format("{:.6g} to {:.6g}", row[low].get<double>(), row[high].get<double>());
    };
    fmt::print("{:<12} {:>26} {:>26} {:>6.1f} to {:>3.0f} %  {}\n", row["of"].get<std::string>(),
               ends("proven_least", "proven_most"), ends("least_found", "most_found"),
               100 * row["share_least"].get<double>(), 100 * row["share_most"].get<double>(),
               one_line(row["verdict"].get<std::string>()));
  }
  if (!json["precisions"].empty()) fmt::print("\nagainst fp32, what is shown:\n");
  for (const Json& row : json["precisions"])
    fmt::print("{:<6} {:>7.2f} dB, at most {:.0f} codes, in frame {} at ({}, {})\n",
               row["precision"].get<std::string>(), row["psnr_db"].get<double>(),
               row["largest_codes"].get<double>(), row["frame"].get<uint32_t>(),
               row["x"].get<uint32_t>(), row["y"].get<uint32_t>());
  if (json.contains("search"))
    fmt::print("worst found in {} steps: {:.2f} dB in place of {:.2f}, {:.0f} codes\n",
               json["search"]["steps"].get<uint32_t>(), json["search"]["psnr_db"].get<double>(),
               json["search"]["start_psnr_db"].get<double>(),
               json["search"]["largest_codes"].get<double>());
  fmt::print("\n{} of {} verdicts hold\n", json["hold"].get<size_t>(),
             json["verdicts"].get<size_t>());
}

/// What the model is, or why there is none.
std::string reference_text(const Arguments& arguments, const Subject& subject) {
  if (!subject.why_no_reference().empty()) return subject.why_no_reference();
  if (arguments.reference == "wide")
    return "of model: largest and mean difference in display codes from the same sandwich with "
           "32-bit floats in all its images of half floats";
  return fmt::format(
      "of model: largest and mean difference in display codes from the passes of NSS v1 in double "
      "precision, which round {}; the network by the exact interpreter at faults, as the device "
      "had "
      "it over time",
      arguments.reference == "exact" ? "nothing but the network's inputs"
                                     : "where the shaders store");
}

Result<int> stress(const Arguments& arguments) {
  const auto wanted = [&](std::string_view group) {
    return arguments.only.empty() ||
           std::find(arguments.only.begin(), arguments.only.end(), group) != arguments.only.end();
  };
  Outputs outputs(arguments.json);
  outputs.keep({arguments.model});
  outputs.keep(arguments.compile.files());
  SHALE_TRY_VOID(outputs.claim("--json-file", arguments.json_file));
  SHALE_TRY_VOID(outputs.claim("--page", arguments.page));
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  Json json{{"schema", kStressSchema},
            {"model", arguments.model},
            {"device", device.context().caps.name}};
  {
    SHALE_TRY(Subject subject, Subject::create(arguments, device, arguments.compile.precision, {}));
    const Extent render = subject.player().render_size(), output = subject.player().output_size();
    json.update({{"reference", reference_text(arguments, subject)},
                 {"render", {render.width, render.height}},
                 {"output", {output.width, output.height}},
                 {"generates", subject.generates()},
                 {"limits",
                  {{"after_frames", arguments.recover},
                   {"overshoot", kOvershoot},
                   {"drift_codes", kDriftCodes},
                   {"reference_codes", kReferenceCodes}}},
                 {"faults", Json::array()},
                 {"courses", Json::array()},
                 {"bounds", Json::array()},
                 {"precisions", Json::array()}});
    std::vector<const Fault*> chosen;
    for (const Fault& fault : faults())
      if (wanted(fault.group) && (fault.of != Fault::For::kLinear || !subject.display()) &&
          (fault.of != Fault::For::kTemporal || subject.takes_depth()))
        chosen.push_back(&fault);
    if (!chosen.empty()) {
      FaultRun run(arguments, subject);
      SHALE_TRY_VOID(run.prepare());
      json["limits"]["codes"] = run.most_left();
      Progress progress("faults");
      for (size_t i = 0; i < chosen.size(); ++i) {
        if (!progress.step(i, chosen.size())) return bad_input("", "interrupted");
        SHALE_TRY(Json row, run.run(*chosen[i]));
        json["faults"].push_back(std::move(row));
      }
    }
    for (const Course course : kCourses) {
      if (!wanted("time") || (course == Course::kNan && subject.display())) continue;
      Progress progress(fmt::format("{}, {} frames", course_name(course), arguments.frames));
      SHALE_TRY(Json row, run_course(arguments, subject, course, progress));
      json["courses"].push_back(std::move(row));
    }
    json["bounds"] = subject.bounds();
    if (arguments.precisions || arguments.search > 0) {
      SHALE_TRY(Subject fp32, Subject::create(arguments, device, "fp32", output));
      std::vector<SourceFrame> frames;
      for (uint32_t i = 0; i < kWarmFrames; ++i)
        frames.push_back(subject.frames().frame(Course::kMoving, i));
      for (const char* precision : {"int8", "int16", "fp16"}) {
        if (!arguments.precisions) continue;
        SHALE_TRY(Subject other, Subject::create(arguments, device, precision, output));
        SHALE_TRY(const Departure parted, departure(other, fp32, frames));
        json["precisions"].push_back(departure_json(precision, parted));
      }
      if (arguments.search > 0) {
        Progress progress("searching");
        SHALE_TRY(json["search"], search(arguments, subject, fp32, progress));
      }
    }
  }
  SHALE_TRY_VOID(device.close());
  size_t hold = 0, verdicts = 0;
  for (const char* part : {"faults", "courses", "bounds"})
    for (const Json& row : json[part]) {
      ++verdicts;
      hold += row["verdict"] == "holds";
    }
  json["hold"] = hold;
  json["verdicts"] = verdicts;
  if (!arguments.json_file.empty()) outputs.note(write_text(arguments.json_file, json_text(json)));
  if (!arguments.page.empty())
    outputs.note(write_text(arguments.page,
                            data_page("At the extremes", json, cost_page::kEmbeddedFiles[2].text)));
  if (arguments.json)
    print_json(json);
  else if (!outputs.has_standard_output())
    print(json);
  return hold == verdicts && outputs.all_written() ? kDone : kRefused;
}

}  // namespace

Action add_stress(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("model", arguments->model,
                 "model folder, model file with --frame, or package with a sandwich")
      ->required();
  app.add_option("--only", arguments->only,
                 "of colour, exposure, depth, motion, jitter, texels, cut, time (default: all)")
      ->delimiter(',')
      ->check(CLI::IsMember(
          {"colour", "exposure", "depth", "motion", "jitter", "texels", "cut", "time"}));
  app.add_option("--recover", arguments->recover, "frames after a fault, in which it has to pass")
      ->check(CLI::Range(1, 10000));
  app.add_option("--frames", arguments->frames,
                 "frames of each course over time; whole cycles, four at least")
      ->check(CLI::Range(1, 10000000));
  app.add_option(
         "--reference", arguments->reference,
         "what runs beside it: the passes of NSS v1 in double precision, up to 32x18, rounded "
         "where the shaders store (\"stored\") or at the network's inputs alone (\"exact\"); "
         "or any sandwich with 32-bit floats in place of half floats (\"wide\")")
      ->check(CLI::IsMember({"stored", "exact", "wide"}));
  app.add_flag("--precisions", arguments->precisions,
               "also int8, int16 and fp16 against fp32 on the same frames");
  app.add_option("--search", arguments->search,
                 "steps of a search for inputs that part int8 from fp32 most")
      ->check(CLI::Range(1, 100000));
  app.add_option("--seed", arguments->seed, "of the search");
  app.add_option("--page", arguments->page, "write a page to look at (.html)");
  app.add_option("--json-file", arguments->json_file, "write the figures as JSON");
  arguments->compile.add_to(app, &arguments->device);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Of a sandwich that generates pictures, one for each frame is judged with it.\n"
      "Frames are 96x54 in closed form, unless --render says otherwise. Exit code 1 if a verdict "
      "does not hold.\n"
      "Example: shale stress models/nss_v1_high --page stress.html\n"
      "Example: shale stress models/baselines/tss --render 32x18 --only time --frames 100000");
  return [arguments] { return stress(*arguments); };
}

}  // namespace shale
