// tools/eval/html_report.h -- the result of an evaluation as one self-contained page and as JSON.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "tools/eval/generated.h"
#include "tools/eval/sequence.h"
#include "tools/shale/picture.h"

namespace shale {

/// A picture as it lies in the page.
struct PngPicture {
  uint32_t width = 0, height = 0;
  std::vector<uint8_t> bytes;
};

/// One frame shown in pictures. Everything by method is in the order of EvalReport::methods.
struct ShownFrame {
  uint32_t index = 0;
  PngPicture reference;
  std::vector<PngPicture> results;     ///< by method
  std::vector<PngPicture> error_maps;  ///< by method, FLIP in colours
  std::vector<Crop> crops;
  std::vector<PngPicture> reference_crops;            ///< by crop
  std::vector<std::vector<PngPicture>> result_crops;  ///< by crop, then by method
};

struct FrameResult {
  FrameMetrics metrics;
  std::optional<double> time_ms;
  std::optional<bool> kept_promise{};  ///< of a package with a promise: if not, the full passes ran
};

struct MethodResult {
  std::vector<FrameResult> frames;
  SequenceMetrics means;
  /// Share of the networks' predicted time that frames took on average, where networks work by tiles.
  std::optional<double> share_run = {};
  std::optional<GeneratedMetrics> generated;  ///< of the pictures that no frame was rendered for
};

struct EvalScene {
  std::string name;
  uint32_t frames = 0;
  uint32_t first_frame = 0;  ///< number of the first frame, for the plots
  std::string size;          ///< such as "960x540 to 1920x1080"
  std::vector<std::string> notes;
  std::vector<MethodResult> methods;  ///< by method
  std::vector<ShownFrame> shown;
};

struct EvalReport {
  std::string title;
  std::string device;              ///< what the times were measured on; may be empty
  std::vector<std::string> notes;  ///< said below the title
  std::vector<std::string> methods;
  std::vector<EvalScene> scenes;
};

/// The `count` windows in which the methods' errors differ most (largest variance over the methods
/// of the window's mean error; with one method, or equal ones, the largest error). They do not
/// overlap and lie inside; fewer if no more fit. `error_maps`: 1 channel, one size, by method.
/// Ties go to the first in row order. Source: ours, shown in html_report_test.
std::vector<Crop> choose_crops(std::span<const FloatImage> error_maps, uint32_t count = 3,
                               uint32_t width = 160, uint32_t height = 120);

/// Encodes the pictures of one frame. `results` and `error_maps` (FLIP, 1 channel) by method.
/// Precondition: as many maps as results, all of the reference's size.
ShownFrame show_frame(uint32_t index, const FloatImage& reference,
                      std::span<const FloatImage> results, std::span<const FloatImage> error_maps);

/// What was computed, as flat keys. JSON has no infinity: equal pictures have "psnr_db" null and
/// "psnr_infinite" true.
nlohmann::ordered_json metrics_json(const FrameMetrics& metrics);

/// A sequence's means; what is not there has no key.
nlohmann::ordered_json sequence_json(const SequenceMetrics& means);

/// Everything but the pictures; "mean_of_scenes" has the mean of the scenes' means by method.
nlohmann::ordered_json report_json(const EvalReport& report);

/// The page. Pictures are halved until it fits below `max_bytes`, which it says; crops are not.
std::string report_html(const EvalReport& report, size_t max_bytes = size_t{40} << 20);

/// FLIP in [0, 1] as colours, dark to light; 1 channel to an opaque picture.
Picture error_colours(const FloatImage& map);

/// RGB PNG; alpha is dropped.
PngPicture encode_png(const Picture& picture);

}  // namespace shale
