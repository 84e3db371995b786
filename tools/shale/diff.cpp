// shale diff: how far pictures are from their references.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include "ir/base/file.h"
#include "tools/eval/html_report.h"
#include "tools/eval/metrics.h"
#include "tools/eval/sequence.h"
#include "tools/shale/command.h"
#include "tools/shale/evaluate.h"
#include "tools/shale/outputs.h"
#include "tools/shale/pictures.h"
#include "tools/shale/source.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string reference, test, map, dataset;
  std::vector<std::string> metrics{"psnr", "ssim", "flip"};
  double pixels_per_degree = kDefaultPixelsPerDegree;
  std::vector<float> exposures;
  SourceArguments source;
  bool over_time = false, json = false;
};

struct Pair {
  std::string name, reference, test;
};

/// Two pictures, or the pictures of two folders that have the same name. In order of their names.
Result<std::vector<Pair>> pairs_of(const Arguments& arguments) {
  const std::string &a = arguments.reference, &b = arguments.test;
  std::error_code ignored;
  const bool first = fs::is_directory(a, ignored), second = fs::is_directory(b, ignored);
  if (first != second)
    return bad_input(first ? b : a, "is no folder, but {} is one", first ? a : b);
  if (!first) return std::vector<Pair>{{fs::path(b).filename().string(), a, b}};
  SHALE_TRY(const auto references, pictures_of(a));
  SHALE_TRY(const auto tests, pictures_of(b));
  std::vector<Pair> pairs;
  for (const auto& [name, file] : tests) {
    const auto reference = references.find(name);
    if (reference == references.end())
      return bad_input(file, "has no reference of this name in {}", a);
    pairs.push_back({name, reference->second, file});
  }
  for (const auto& [name, file] : references)
    if (!tests.contains(name)) return bad_input(file, "has no picture of this name in {}", b);
  return pairs;
}

/// The columns of both forms of output, as keys of metrics_json.
struct Column {
  const char *key, *title;
  int digits;
};
constexpr Column kColumns[] = {{"psnr_db", "PSNR dB", 2},
                               {"ssim", "SSIM", 5},
                               {"ssim_valid", "SSIM valid", 5},
                               {"ssim_luma", "SSIM luma", 5},
                               {"ssim_luma_valid", "luma valid", 5},
                               {"flip", "FLIP", 5}};

std::string cell(const Json& metrics, const Column& column) {
  if (metrics.value("psnr_infinite", false) && metrics[column.key].is_null()) return "inf";
  return metrics.contains(column.key)
             ? fmt::format("{:.{}f}", metrics[column.key].get<double>(), column.digits)
             : "-";
}

/// By pair; those of a dataset come with its frames.
Result<std::vector<float>> exposures_of(const Arguments& arguments, FrameSource* source,
                                        size_t pairs) {
  if (source && source->frame_count() != pairs)
    return bad_input("--dataset", "has {} frames, expected one for each of {} pairs",
                     source->frame_count(), pairs);
  const std::vector<float>& given = arguments.exposures;
  if (given.size() > 1 && given.size() != pairs)
    return bad_input("--exposure", "has {} factors, expected one, or one for each of {} pairs",
                     given.size(), pairs);
  if (given.size() > 1) return given;
  return std::vector<float>(pairs, given.empty() ? 1.0f : given[0]);
}

void print_table(const Json& json, const Arguments& arguments) {
  std::vector<Column> columns;
  for (const Column& column : kColumns)
    if (json["mean"].contains(column.key)) columns.push_back(column);
  const auto print_line = [&](const Json& metrics, const std::string& name) {
    for (const Column& column : columns) fmt::print("{:>11}", cell(metrics, column));
    fmt::print("  {}\n", name);
  };
  for (const Column& column : columns) fmt::print("{:>11}", column.title);
  fmt::print("  picture\n");
  for (const Json& pair : json["pairs"]) print_line(pair, pair["name"].get<std::string>());
  if (json["pairs"].size() > 1)
    print_line(json["mean"], fmt::format("mean of {}", json["pairs"].size()));
  if (json["mean"].contains("ssim"))
    fmt::print("SSIM pads with 5 zeros; valid: without a border of 5 pixels\n");
  if (json["mean"].contains("flip"))
    fmt::print("FLIP at {:.2f} pixels per degree\n", arguments.pixels_per_degree);
}

Result<int> diff(const Arguments& arguments) {
  MetricOptions options;
  options.pixels_per_degree = arguments.pixels_per_degree;
  const auto wanted = [&](const char* name) {
    return std::find(arguments.metrics.begin(), arguments.metrics.end(), name) !=
           arguments.metrics.end();
  };
  options.psnr = wanted("psnr");
  options.ssim = wanted("ssim");
  options.flip = wanted("flip") || !arguments.map.empty();
  SHALE_TRY(const std::vector<Pair> pairs, pairs_of(arguments));
  std::unique_ptr<FrameSource> source;
  if (!arguments.dataset.empty()) {
    SHALE_TRY(source, open_dataset(arguments.dataset, arguments.source));
  }
  SHALE_TRY(std::vector<float> exposures, exposures_of(arguments, source.get(), pairs.size()));
  const bool over_time = arguments.over_time || source;
  SequenceOptions measures;
  measures.frame = options;
  if (source) measures.grid_period = grid_period(source->render_size(), source->output_size());
  ReferenceTrack track(measures);
  SequenceEvaluator evaluator(measures);
  std::optional<FrameCamera> previous;
  std::error_code error;
  const bool maps_to_folder = fs::is_directory(arguments.reference, error);
  std::vector<std::string> maps(arguments.map.empty() ? 0 : pairs.size(), arguments.map);
  if (maps_to_folder && !maps.empty()) {
    SHALE_TRY_VOID(make_folder(arguments.map));
    for (size_t i = 0; i < pairs.size(); ++i)
      maps[i] = (fs::path(arguments.map) / (pairs[i].name + ".png")).string();
  }
  Outputs outputs(arguments.json);
  for (const Pair& pair : pairs) outputs.keep({pair.reference, pair.test});
  for (const std::string& path : maps) SHALE_TRY_VOID(outputs.claim_picture("--map", path));
  Json json{{"reference", arguments.reference}, {"test", arguments.test}};
  if (options.flip) json["pixels_per_degree"] = arguments.pixels_per_degree;
  json["pairs"] = Json::array();
  std::map<std::string, std::pair<double, int>> sums;
  {
    Progress progress("comparing");
    for (size_t i = 0; i < pairs.size(); ++i) {
      const Pair& pair = pairs[i];
      if (!progress.step(i, pairs.size())) return bad_input("", "interrupted after {} pairs", i);
      SourceFrame frame;
      if (source) {
        SHALE_TRY(frame, source->frame(static_cast<uint32_t>(i), true));
        if (arguments.exposures.empty()) exposures[i] = frame.camera.exposure;
      }
      SHALE_TRY(FloatImage reference, load_display(pair.reference, exposures[i]));
      SHALE_TRY(FloatImage test, load_display(pair.test, exposures[i]));
      if (reference.width != test.width || reference.height != test.height)
        return bad_input(pair.test, "has {}x{} pixels, its reference {} has {}x{}", test.width,
                         test.height, pair.reference, reference.width, reference.height);
      Json entry{{"name", pair.name},
                 {"reference", pair.reference},
                 {"test", pair.test},
                 {"width", test.width},
                 {"height", test.height}};
      FloatImage map;
      FrameMetrics metrics;
      if (over_time) {
        if (Result<void> advanced = advance(track, std::move(reference), frame, previous);
            !advanced)
          return in_file(pair.reference, advanced.error());
        SHALE_TRY(metrics, evaluator.add(std::move(test), track, std::nullopt, &map));
      } else {
        metrics = compare(PreparedReference(std::move(reference), options), test, &map);
      }
      entry.update(metrics_json(metrics));
      // A folder that could not take one map will take no other.
      if (!maps.empty() && outputs.all_written() &&
          outputs.note(save_png(maps[i], error_colours(map))))
        entry["map"] = maps[i];
      for (const Column& column : kColumns) {
        if (!entry.contains(column.key)) continue;
        auto& [sum, count] = sums[column.key];
        sum += column.key == std::string_view("psnr_db") ? std::min(*metrics.psnr_db, kPsnrCapDb)
                                                         : entry[column.key].get<double>();
        ++count;
      }
      json["pairs"].push_back(std::move(entry));
    }
  }
  json["mean"] = Json::object();
  for (const Column& column : kColumns)
    if (const auto sum = sums.find(column.key); sum != sums.end())
      json["mean"][column.key] = sum->second.first / sum->second.second;
  const SequenceMetrics means = evaluator.finish();
  if (over_time) json["over_time"] = sequence_json(means);
  const int exit = outputs.all_written() ? kDone : kRefused;
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  if (outputs.has_standard_output()) return exit;
  print_table(json, arguments);
  if (over_time) {
    const std::vector<std::string> names{fs::path(arguments.test).filename().string()};
    print_over_time(names, {&means});
  }
  return exit;
}

}  // namespace

Action add_diff(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("reference", arguments->reference, "picture, or folder of pictures")->required();
  app.add_option("test", arguments->test, "picture of the same size, or folder with the same names")
      ->required();
  app.add_option("--map", arguments->map,
                 "write FLIP in colours, dark to light: a picture (.png), or a folder for folders");
  app.add_option("--metrics", arguments->metrics, "psnr, ssim, flip (default: all)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::IsMember({"psnr", "ssim", "flip"}));
  app.add_option("--ppd", arguments->pixels_per_degree,
                 "pixels per degree of the viewer, for FLIP (default: 67.02)")
      ->check(number_in(4, 400));
  app.add_option(
         "--exposure", arguments->exposures,
         "factor on the linear colours of .exr pictures, which are then tone-mapped; one, or one "
         "for each pair (default: the dataset's, else 1)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(number_in(1e-6, 1e6));
  app.add_flag("--over-time", arguments->over_time,
               "the pictures are frames in order: also what changes between them");
  app.add_option(
      "--dataset", arguments->dataset,
      "folder of the dataset whose frames the pictures are: each frame's exposure, cut, motion "
      "and depth; as --over-time");
  arguments->source.add_to(app);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale diff models/pictures/raster_x2.png result.png --map error.png\n"
      "Example: shale diff thin/ground_truth/0000 frames --dataset thin --json\n"
      "In means an infinite PSNR, of equal pictures, counts as 100 dB; in JSON it is null.");
  return [arguments] { return diff(*arguments); };
}

}  // namespace shale
