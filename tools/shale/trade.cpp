// shale trade: speed against accuracy, over scenes, models, precisions and scales.
//
// A cell is one scene at one scale through one model in one precision. Its quality is measured
// against the truth and its time on the device; what it would take on a phone comes from the modelled
// device. Cells lie in the output folder as JSON, so that a run goes on where it was stopped; each is
// known by the content of all that makes it: program, scene, model, sizes, device.
#include <algorithm>
#include <array>
#include <filesystem>
#include <map>
#include <mutex>
#include <set>

#include "ir/base/file.h"
#include "ir/base/hash.h"
#include "ir/base/json.h"
#include "ir/package/rank.h"
#include "tools/eval/data_page.h"
#include "tools/scene/dataset.h"
#include "tools/scene/model.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/cost_page.h"
#include "tools/shale/evaluate.h"
#include "tools/shale/frame_cost.h"
#include "tools/shale/measure_needs.h"
#include "tools/shale/outputs.h"
#include "tools/shale/report.h"
#include "tools/shale/source.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::vector<std::string> scenes, models, precisions{"int8"};
  std::vector<double> scales{2};
  std::string folder, output = "1920x1080", model_at, device = "mobile";
  uint32_t frames = 16;
  std::vector<double> slacks_db{0.1, 0.3};
  std::vector<uint32_t> tiles;
  double frame_ms = 4;
  bool specialised = false, fresh = false, json = false;
  DeviceArguments tool;
};

constexpr const char* kTradeSchema = "shale-trade/2";

template <typename Values>
uint64_t hash_of(const Values& values, uint64_t seed = kHashSeed) {
  return stable_hash(
      {reinterpret_cast<const uint8_t*>(values.data()), values.size() * sizeof(values[0])}, seed);
}

/// Of the running program: what renders, compiles, runs and measures a cell.
Result<uint64_t> hash_program() {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file("/proc/self/exe"));
  return hash_of(bytes);
}

/// A model in one precision, whole or in one of the forms that leave work out.
struct Contender {
  std::string path, precision;  ///< precision is empty without a network
  ModelFiles files;
  uint64_t hash = 0;  ///< of the model and its frame.json
  std::optional<uint32_t> tiles = {};
  bool is_specialised = false;  ///< a package for what each scene needs

  bool is_baseline() const { return files.bytes.empty(); }
  std::string name() const {
    std::string name = is_baseline() ? files.name : files.name + " " + precision;
    if (tiles) name += fmt::format(", tiles {}", *tiles);
    return is_specialised ? name + ", as the scene needs" : name;
  }
  /// For the device at hand, if there is one, and the needs of a scene in a file.
  CompileArguments compile(const DeviceArguments* device, const std::string& needs) const {
    CompileArguments arguments;
    arguments.device = device;
    arguments.precision = precision.empty() ? arguments.precision : precision;
    arguments.tiles = tiles;
    if (is_specialised) arguments.needs = needs;
    return arguments;
  }
};

Result<Contender> contender_of(const std::string& path, const std::string& precision) {
  Contender contender{.path = path, .precision = precision, .files = {}};
  SHALE_TRY(contender.files, load_model(path, "", precision));
  if (!contender.files.frame) return bad_input(path, "has no sandwich (frame.json)");
  if (contender.is_baseline()) contender.precision.clear();
  SHALE_TRY(const std::vector<uint8_t> frame,
            read_file((fs::path(contender.files.frame_folder) / "frame.json").string()));
  contender.hash = hash_of(frame, hash_of(contender.files.bytes));
  return contender;
}

/// Every model in every precision, a baseline once; behind each its forms.
Result<std::vector<Contender>> contenders_of(const Arguments& arguments) {
  std::vector<Contender> contenders;
  for (const std::string& path : arguments.models)
    for (const std::string& precision : arguments.precisions) {
      SHALE_TRY(Contender contender, contender_of(path, precision));
      const bool is_baseline = contender.is_baseline();
      contenders.push_back(contender);
      if (arguments.specialised && !contender.files.frame->promises.empty()) {
        contenders.push_back(contender);
        contenders.back().is_specialised = true;
      }
      for (const uint32_t tolerance : arguments.tiles) {
        if (is_baseline && !contender.files.frame->settles) break;
        contenders.push_back(contender);
        contenders.back().tiles = tolerance;
      }
      if (is_baseline) break;
    }
  std::vector<std::string> of_models;
  for (const std::string& path : arguments.models)
    of_models.push_back(std::ranges::find(contenders, path, &Contender::path)->files.name);
  of_models = distinct_names(std::move(of_models), arguments.models);
  std::set<std::string> names;
  for (Contender& contender : contenders) {
    const auto model = std::ranges::find(arguments.models, contender.path);
    contender.files.name = of_models[static_cast<size_t>(model - arguments.models.begin())];
    if (!names.insert(contender.name()).second)
      return bad_input("--models", "\"{}\" is given twice", contender.name());
  }
  return contenders;
}

struct Sizes {
  double scale = 2;
  FrameExtent render, output;
};

Sizes sizes_of(FrameExtent output, double scale) {
  const auto divided = [&](uint32_t side) {
    return static_cast<uint32_t>(std::max(1L, std::lround(side / scale)));
  };
  return {scale, {divided(output.width), divided(output.height)}, output};
}

bool offers(const Contender& contender, const Sizes& sizes) {
  return frame_sizes(*contender.files.frame, {sizes.render, sizes.output}).has_value();
}

// Frames.

struct SceneFrames {
  Scene scene;
  std::string path;
  uint64_t hash = 0;  ///< of the scene, its meshes and the program that renders it
};

Result<SceneFrames> scene_frames_of(const std::string& path, uint64_t program) {
  SHALE_TRY(Scene scene, load_scene(path));
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  const uint64_t hash = hash_of(bytes, program);
  SHALE_TRY(const ModelBuffers meshes, model_buffers(scene.models));
  return SceneFrames{std::move(scene), path,
                     hash_of(meshes.texels, hash_of(meshes.geometry, hash))};
}

/// The scene's frames at these sizes, rendered into the folder unless they are there. The truth is the same for every
/// pattern, so that only the first one's is rendered.
Result<std::unique_ptr<FrameSource>> frames_of(const Arguments& arguments, const ToolDevice& device,
                                               const SceneFrames& scene, const Sizes& sizes,
                                               const SamplingPattern& pattern) {
  SourceArguments source;
  source.frames = arguments.frames;
  const std::string sampled = pattern_text(pattern);
  const uint64_t hash = hash_of(sampled, scene.hash);
  const fs::path folder = fs::path(arguments.folder) / "frames" /
                          fmt::format("{}-{}x{}-{}x{}-{}-{:016x}", scene.scene.name,
                                      sizes.render.width, sizes.render.height, sizes.output.width,
                                      sizes.output.height, arguments.frames, hash);
  std::error_code ignored;
  if (fs::exists(folder / "0000.json", ignored)) return open_dataset(folder.string(), source);
  const Extent render{sizes.render.width, sizes.render.height},
      output{sizes.output.width, sizes.output.height};
  std::unique_ptr<FrameSource> truths;
  if (pattern != SamplingPattern{}) {
    SHALE_TRY(truths, frames_of(arguments, device, scene, sizes, {}));
  }
  SHALE_TRY(const std::unique_ptr<FrameSource> rendered,
            open_scene(scene.path, source, device, render, output, pattern));
  SHALE_TRY(DatasetWriter writer,
            DatasetWriter::create(folder.string(),
                                  {.number = 0,
                                   .render = render,
                                   .output = output,
                                   .sampling = pattern_name(pattern),
                                   .jitter_phases = jitter_phases(render, output, pattern)}));
  Progress progress("rendering " + scene.scene.name);
  for (uint32_t i = 0; i < rendered->frame_count(); ++i) {
    if (!progress.step(i, rendered->frame_count()))
      return bad_input(scene.path, "interrupted after {} frames", i);
    SHALE_TRY(SourceFrame frame, rendered->frame(i, !truths));
    if (truths) {
      SHALE_TRY(SourceFrame other, truths->frame(i, true));
      frame.truth = std::move(other.truth);
      frame.truth_motion = std::move(other.truth_motion);
      frame.truth_depth = std::move(other.truth_depth);
    }
    SHALE_TRY_VOID(writer.add(frame));
  }
  SHALE_TRY_VOID(writer.finish());
  return open_dataset(folder.string(), source);
}

// Cells.

/// A cell that the folder holds, if it `is_whole`, or what `make` gives, which it holds from then on.
template <typename IsWhole, typename Make>
Result<Json> kept(const Arguments& arguments, const Json& key, const IsWhole& is_whole,
                  const Make& make) {
  const std::string file =
      (fs::path(arguments.folder) / "cells" / fmt::format("{:016x}.json", hash_of(key.dump())))
          .string();
  std::error_code ignored;
  if (!arguments.fresh && fs::exists(file, ignored)) {
    SHALE_TRY(const std::string text, read_text(file));
    const Result<Json> held = parse_json<Json>(text);
    if (held && held->is_object() && held->value("key", Json()) == key &&
        is_whole(held->value("result", Json())))
      return (*held)["result"];
  }
  SHALE_TRY(Json cell, make());
  SHALE_TRY_VOID(write_text(file, json_text({{"key", key}, {"result", cell}})));
  return cell;
}

/// What a scene's frames at these sizes need.
Result<SceneNeeds> needs_of(const Arguments& arguments, const SceneFrames& scene,
                            FrameSource& source, const Sizes& sizes) {
  const Json key{{"needs_of", scene.hash},
                 {"render", {sizes.render.width, sizes.render.height}},
                 {"frames", arguments.frames}};
  const auto is_whole = [](const Json& held) { return parse_needs(held.dump()).has_value(); };
  SHALE_TRY(const Json cell, kept(arguments, key, is_whole, [&]() -> Result<Json> {
              NeedsMeter meter;
              for (uint32_t i = 0; i < source.frame_count(); ++i) {
                SHALE_TRY(const SourceFrame frame, source.frame(i, false));
                SHALE_TRY_VOID(meter.add(frame));
              }
              return Json::parse(
                  needs_text(needs_of_scene(scene.scene, 0, source.frame_count(), meter.needs())));
            }));
  return parse_needs(cell.dump());
}

struct Costs {
  Json modelled;
  uint64_t hash = 0;  ///< of all files that make the contender
};

/// What the method would take on the modelled device, for results of `at` at the same scale.
Result<Costs> costs_of(const Contender& contender, const std::string& needs, const Sizes& at,
                       const ModelledDevice& device) {
  SHALE_TRY(CompileOptions options, contender.compile(nullptr, needs).options(contender.files));
  options.sizes = {at.render, at.output};
  std::map<std::string, uint64_t> loaded;
  std::mutex mutex;
  const auto noted = [&](const auto& load) {
    return [&, load](const std::string& path) {
      auto file = load(path);
      const std::lock_guard lock(mutex);
      if (file) loaded[path] = hash_of(*file);
      return file;
    };
  };
  options.load_shader = noted(options.load_shader);
  options.load_model = noted(options.load_model);
  SHALE_TRY(const FrameCost cost, FrameCost::create(contender.files, options));
  uint64_t hash = contender.hash;
  for (const auto& [path, content] : loaded) hash = hash_of(path, hash ^ content);
  SHALE_TRY(const FrameCost::Modelled modelled, cost.at(options.sizes, device));
  const bool network = modelled.network.has_value();
  Json json{{"gop", network ? 2e-9 * static_cast<double>(modelled.network->macs) : 0.0},
            {"network_ms", 1e-3 * modelled.frame.network_us},
            {"energy_mj", network ? 1e-3 * modelled.network->energy_uj : 0.0},
            {"passes_ms", 1e-3 * modelled.frame.passes_us},
            {"passes", passes_json(modelled.frame)},
            {"total_ms", 1e-3 * modelled.frame.total_us()}};
  return Costs{std::move(json), hash};
}

/// Of the modelled times what a share of frames takes that ran here, by their predicted time: of the network, and of the
/// passes, too, where these leave out what rests.
void take_share(Json& row, const Contender& contender) {
  if (!row["share_run"].is_number()) return;
  const double share = row["share_run"].get<double>();
  Json& times = row["modelled"];
  const auto scale = [&](const char* key) { times[key] = times[key].get<double>() * share; };
  scale("network_ms");
  scale("energy_mj");
  scale("gop");
  if (*contender.tiles > 0 && contender.files.frame->settles) scale("passes_ms");
  times["total_ms"] = times["network_ms"].get<double>() + times["passes_ms"].get<double>();
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

Result<Json> measure(FrameSource& source, std::vector<PlayedMethod>& method) {
  SHALE_TRY(const EvalScene scene, evaluate_scene(source, method, {}));
  const SequenceMetrics& means = scene.methods[0].means;
  Json json{{"frames", scene.frames}};
  const auto put = [&](const char* key, const std::optional<double>& value) {
    json[key] = value ? finite_json(*value) : Json(nullptr);
  };
  put("share_run", scene.methods[0].share_run);
  put("psnr_db", means.psnr_db);
  put("ssim", means.ssim);
  put("flip", means.flip);
  put("if_ssim", means.if_ssim ? std::optional(means.if_ssim->at_t.value) : std::nullopt);
  std::vector<double> times;
  for (const FrameResult& frame : scene.methods[0].frames)
    if (frame.time_ms) times.push_back(*frame.time_ms);
  put("measured_ms", times.empty() ? std::nullopt : std::optional(median(times)));
  return json;
}

/// What `measure` gives: figures, or null where there is none.
bool is_measurement(const Json& json) {
  const std::array keys{"frames", "share_run", "psnr_db", "ssim", "flip", "if_ssim", "measured_ms"};
  return json.is_object() && json.size() == keys.size() &&
         std::ranges::all_of(keys, [&](const char* key) {
           return json.contains(key) && (json[key].is_number() || json[key].is_null());
         });
}

// The trade.

/// Marks which rows no other one beats in both: less in `cost`, more of `quality` (or less of it, if
/// `less` is better).
void mark_front(Json& rows, const char* quality, bool less, const Json::json_pointer& cost,
                const char* mark) {
  const auto figure = [&](const Json& row) {
    return std::pair{row.at(cost).get<double>(), (less ? -1 : 1) * row[quality].get<double>()};
  };
  for (Json& row : rows) {
    if (!row[quality].is_number()) continue;
    const auto [own_cost, own_quality] = figure(row);
    const bool beaten = std::any_of(rows.begin(), rows.end(), [&](const Json& other) {
      if (!other[quality].is_number()) return false;
      const auto [other_cost, other_quality] = figure(other);
      return other_cost <= own_cost && other_quality >= own_quality &&
             (other_cost < own_cost || other_quality > own_quality);
    });
    if (!beaten) row["fronts"].push_back(mark);
  }
}

/// What a scene needs, in words: what makes histories and networks pay, and what spares them.
struct NeedsInWords {
  std::vector<std::string> asks, spares;
};

NeedsInWords in_words(const SceneNeeds& needs) {
  NeedsInWords words;
  const auto tell = [&](const std::optional<bool>& has, const char* with, const char* without) {
    if (has) (*has ? words.asks : words.spares).emplace_back(*has ? with : without);
  };
  tell(needs.thin_features, "it has thin features", "it has no thin features");
  if (needs.camera_moves && needs.objects_move) {
    const std::string pixels =
        needs.motion_pixels ? fmt::format(" up to {:.1f} pixels a frame", *needs.motion_pixels)
                            : "";
    if (*needs.camera_moves || *needs.objects_move)
      words.asks.push_back(fmt::format("{} by{}",
                                       !*needs.objects_move  ? "the camera moves"
                                       : *needs.camera_moves ? "camera and objects move"
                                                             : "objects move before a still camera",
                                       pixels.empty() ? " some pixels" : pixels));
    else
      words.spares.emplace_back("nothing moves");
  }
  tell(needs.light_changes, "light changes without motion", "no light changes");
  if (needs.cuts.value_or(false)) words.asks.emplace_back("it cuts");
  if (needs.exposed && (*needs.exposed)[1] > 4)
    words.asks.push_back(fmt::format("its lights reach {:.3g} times white", (*needs.exposed)[1]));
  return words;
}

/// The best method under the budget, and for each slack the cheapest that is nearly as good, with what of the scene speaks
/// for it.
Json choose(const Json& rows, const Arguments& arguments, const NeedsInWords& words) {
  const Json *best = nullptr, *baseline = nullptr;
  const auto psnr = [](const Json& row) { return row["psnr_db"].get<double>(); };
  const auto time = [](const Json& row) { return row["modelled"]["total_ms"].get<double>(); };
  const auto fits = [&](const Json& row) {
    return row["psnr_db"].is_number() && time(row) <= arguments.frame_ms;
  };
  for (const Json& row : rows) {
    if (!fits(row)) continue;
    if (!best || psnr(row) > psnr(*best)) best = &row;
    if (row["baseline"].get<bool>() && (!baseline || psnr(row) > psnr(*baseline))) baseline = &row;
  }
  if (!best) return nullptr;
  Json json{{"best", (*best)["name"]},
            {"best_scale", (*best)["scale"]},
            {"best_psnr_db", psnr(*best)},
            {"best_ms", time(*best)},
            {"within", Json::array()}};
  for (const double slack : arguments.slacks_db) {
    const Json* enough = best;
    for (const Json& row : rows)
      if (fits(row) && psnr(row) >= psnr(*best) - slack && time(row) < time(*enough)) enough = &row;
    const bool is_baseline = (*enough)["baseline"].get<bool>();
    json["within"].push_back({{"slack_db", slack},
                              {"name", (*enough)["name"]},
                              {"scale", (*enough)["scale"]},
                              {"psnr_db", psnr(*enough)},
                              {"ms", time(*enough)},
                              {"needs_network", !is_baseline},
                              {"why", is_baseline ? words.spares : words.asks}});
  }
  if (baseline) {
    json["best_baseline"] = (*baseline)["name"];
    json["best_baseline_psnr_db"] = psnr(*baseline);
    json["gain_db"] = psnr(*best) - psnr(*baseline);
  }
  return json;
}

/// Means over the scenes, of what all of them have.
Json overall(const Json& scenes) {
  Json rows = Json::array();
  for (Json row : scenes[0]["methods"]) {
    const auto average = [&](const Json::json_pointer& at) {
      double sum = 0;
      size_t count = 0;
      for (const Json& scene : scenes)
        for (const Json& other : scene["methods"])
          if (other["name"] == row["name"] && other["scale"] == row["scale"] &&
              other[at].is_number())
            sum += other[at].get<double>(), ++count;
      row[at] = count == scenes.size() ? Json(sum / static_cast<double>(count)) : Json(nullptr);
    };
    for (const char* key : {"/psnr_db", "/ssim", "/flip", "/if_ssim", "/measured_ms", "/share_run",
                            "/modelled/gop", "/modelled/network_ms", "/modelled/energy_mj",
                            "/modelled/passes_ms", "/modelled/total_ms"})
      average(Json::json_pointer(key));
    if (row["psnr_db"].is_number()) rows.push_back(std::move(row));
  }
  return rows;
}

void finish(Json& scene, const Arguments& arguments, const NeedsInWords& words) {
  Json& rows = scene["methods"];
  for (Json& row : rows) row["fronts"] = Json::array();
  const Json::json_pointer time("/modelled/total_ms"), gop("/modelled/gop");
  mark_front(rows, "psnr_db", false, time, "psnr_db over ms");
  mark_front(rows, "flip", true, time, "flip over ms");
  mark_front(rows, "if_ssim", false, time, "if_ssim over ms");
  mark_front(rows, "psnr_db", false, gop, "psnr_db over GOP");
  scene["choice"] = choose(rows, arguments, words);
}

void print_scene(const Json& scene) {
  size_t wide = 6;
  for (const Json& row : scene["methods"])
    wide = std::max(wide, row["name"].get<std::string>().size());
  const auto cell = [](const Json& value, int digits) {
    return value.is_number() ? fmt::format("{:.{}f}", value.get<double>(), digits)
                             : std::string("-");
  };
  fmt::print("{}\n  {:<{}} {:>5} {:>8} {:>7} {:>7} {:>8} {:>9} {:>8} {:>9}  front\n",
             scene["name"].get<std::string>(), "", wide, "scale", "PSNR dB", "SSIM", "FLIP",
             "IF-SSIM", "modelled", "GOP", "measured");
  for (const Json& row : scene["methods"])
    fmt::print("  {:<{}} {:>5} {:>8} {:>7} {:>7} {:>8} {:>6} ms {:>8} {:>6} ms  {}\n",
               row["name"].get<std::string>(), wide, cell(row["scale"], 2), cell(row["psnr_db"], 2),
               cell(row["ssim"], 4), cell(row["flip"], 4), cell(row["if_ssim"], 4),
               cell(row["modelled"]["total_ms"], 2), cell(row["modelled"]["gop"], 2),
               cell(row["measured_ms"], 1), row["fronts"].empty() ? "" : "*");
  const Json& choice = scene["choice"];
  if (choice.is_null()) {
    fmt::print("  nothing fits the budget\n");
    return;
  }
  const auto text = [&](const char* key) { return choice[key].get<std::string>(); };
  fmt::print("  best under the budget: {} at x{}, {} dB, {} ms", text("best"),
             cell(choice["best_scale"], 2), cell(choice["best_psnr_db"], 2),
             cell(choice["best_ms"], 2));
  if (choice.contains("gain_db"))
    fmt::print("; {} dB above {}", cell(choice["gain_db"], 2), text("best_baseline"));
  fmt::print("\n");
  for (const Json& within : choice["within"])
    fmt::print(
        "  enough within {} dB: {} at x{}, {} dB, {} ms{}{}\n", cell(within["slack_db"], 2),
        within["name"].get<std::string>(), cell(within["scale"], 2), cell(within["psnr_db"], 2),
        cell(within["ms"], 2), within["needs_network"].get<bool>() ? "" : "; no network is needed",
        within["why"].empty()
            ? ""
            : fmt::format(": {}", fmt::join(within["why"].get<std::vector<std::string>>(), ", ")));
}

Result<int> trade(const Arguments& arguments) {
  SHALE_TRY(const FrameExtent output, parse_extent("--output-size", arguments.output));
  FrameExtent model_at = output;
  if (!arguments.model_at.empty()) {
    SHALE_TRY(model_at, parse_extent("--model-at", arguments.model_at));
  }
  const ModelledDevice* device = find_modelled_device(arguments.device);
  if (!device) return bad_input("--model-device", "\"{}\" is unknown", arguments.device);
  SHALE_TRY(const std::vector<Contender> contenders, contenders_of(arguments));
  SHALE_TRY(const uint64_t program, hash_program());
  std::vector<SceneFrames> scenes;
  for (const std::string& path : arguments.scenes) {
    SHALE_TRY(scenes.emplace_back(), scene_frames_of(path, program));
  }
  const fs::path folder(arguments.folder), cells = folder / "cells";
  const std::string text_file = (folder / "trade.json").string(),
                    page_file = (folder / "trade.html").string();
  std::error_code error;
  fs::create_directories(cells, error);
  if (error) return io_error(cells.string(), "cannot create: {}", error.message());
  Outputs outputs(arguments.json);
  outputs.keep(arguments.scenes);
  SHALE_TRY_VOID(outputs.claim("the figures", text_file));
  SHALE_TRY_VOID(outputs.claim("the page", page_file));

  SHALE_TRY(ToolDevice tool, ToolDevice::open(arguments.tool));
  Json json{{"schema", kTradeSchema},
            {"device", tool.context().caps.name},
            {"modelled_device", device->name},
            {"modelled_output", {model_at.width, model_at.height}},
            {"output", {output.width, output.height}},
            {"frame_ms", arguments.frame_ms},
            {"slacks_db", arguments.slacks_db},
            {"left_out", Json::array()},
            {"scenes", Json::array()}};
  std::vector<std::string> scene_names;
  for (const SceneFrames& scene : scenes) scene_names.push_back(scene.scene.name);
  for (const std::string& name : distinct_names(std::move(scene_names), arguments.scenes))
    json["scenes"].push_back({{"name", name}, {"methods", Json::array()}});
  size_t done = 0, all = 0;
  for (const double scale : arguments.scales)
    for (const Contender& contender : contenders)
      all += offers(contender, sizes_of(output, scale)) ? scenes.size() : 0;
  if (all == 0)
    return bad_input("--scales", "no model offers any of these scales at {}", arguments.output);
  Progress progress("cells");
  std::vector<NeedsInWords> words(scenes.size());
  for (const double scale : arguments.scales) {
    const Sizes sizes = sizes_of(output, scale);
    std::vector<SceneNeeds> needs(scenes.size());
    std::vector<std::string> needs_files(scenes.size());
    for (size_t s = 0; s < scenes.size(); ++s) {
      SHALE_TRY(const std::unique_ptr<FrameSource> source,
                frames_of(arguments, tool, scenes[s], sizes, {}));
      SHALE_TRY(needs[s], needs_of(arguments, scenes[s], *source, sizes));
      if (scale == arguments.scales.front()) {
        words[s] = in_words(needs[s]);
        json["scenes"][s]["needs"] = Json::parse(needs_text(needs[s]));
      }
      needs_files[s] =
          (cells / fmt::format("{}-{:016x}-{}x{}.needs", scenes[s].scene.name, scenes[s].hash,
                               sizes.render.width, sizes.render.height))
              .string();
      SHALE_TRY_VOID(write_text(needs_files[s], needs_text(needs[s])));
    }
    for (const Contender& contender : contenders) {
      if (!offers(contender, sizes)) continue;
      std::optional<Costs> costs;        // where they are the same for all scenes
      std::vector<PlayedMethod> method;  // made for the first scene that is not there yet
      for (size_t s = 0; s < scenes.size(); ++s) {
        if (!progress.step(done++, all)) return bad_input("", "interrupted; run again to go on");
        if (contender.is_specialised) {
          if (kept_promises(*contender.files.frame, needs[s], sizes.render).empty()) continue;
          method.clear();
          costs.reset();
        }
        if (!costs) {
          Result<Costs> found =
              costs_of(contender, needs_files[s], sizes_of(model_at, scale), *device);
          if (!found) return in_file(contender.files.path, found.error());
          costs = *std::move(found);
        }
        Json key{{"program", program},
                 {"scene", scenes[s].hash},
                 {"model", costs->hash},
                 {"render", {sizes.render.width, sizes.render.height}},
                 {"output", {output.width, output.height}},
                 {"frames", arguments.frames},
                 {"device", tool.context().caps.name},
                 {"driver", tool.context().caps.driver}};
        if (contender.tiles) key["tiles"] = *contender.tiles;
        if (contender.is_specialised) key["needs"] = needs_text(needs[s]);
        Result<Json> cell = kept(arguments, key, is_measurement, [&]() -> Result<Json> {
          SHALE_TRY(const std::unique_ptr<FrameSource> source,
                    frames_of(arguments, tool, scenes[s], sizes, contender.files.frame->pattern));
          if (method.empty()) {
            SHALE_TRY(
                const Sandwich sandwich,
                load_sandwich(contender.path, contender.compile(&arguments.tool, needs_files[s]),
                              Extent{sizes.render.width, sizes.render.height},
                              Extent{output.width, output.height}));
            const std::vector<RankedVariant> ranked =
                rank_variants(sandwich.package.variants, tool.context().caps);
            if (std::ranges::none_of(ranked, [](const auto& v) { return v.missing.empty(); }))
              return unsupported(tool.context().caps.name, "{}",
                                 fmt::join(ranked.front().missing, ", "));
            method.push_back({contender.name(), nullptr});
            SHALE_TRY(method[0].player, Player::create(tool, sandwich.package));
          }
          return measure(*source, method);
        });
        if (!cell && cell.error().code == ErrorCode::kUnsupported) {
          print_warning(contender.name(), "left out: " + cell.error().text());
          json["left_out"].push_back(
              {{"name", contender.name()}, {"scale", scale}, {"why", cell.error().text()}});
          if (contender.is_specialised) continue;  // the next scene has a package of its own
          done += scenes.size() - s - 1;
          break;
        }
        if (!cell) return cell.error();
        Json row{{"name", contender.name()},
                 {"model", contender.files.name},
                 {"precision", contender.precision},
                 {"baseline", contender.is_baseline()},
                 {"scale", scale}};
        row.update(*cell);
        row["modelled"] = costs->modelled;
        if (contender.tiles) take_share(row, contender);
        json["scenes"][s]["methods"].push_back(std::move(row));
      }
    }
  }
  SHALE_TRY_VOID(tool.close());
  json["overall"] = {
      {"name", scenes.size() == 1 ? "the scene" : fmt::format("mean of {} scenes", scenes.size())},
      {"methods", overall(json["scenes"])}};
  for (size_t s = 0; s < scenes.size(); ++s) finish(json["scenes"][s], arguments, words[s]);
  finish(json["overall"], arguments, {});
  outputs.note(write_text(text_file, json_text(json)));
  outputs.note(write_text(
      page_file, data_page("Speed against accuracy", json, cost_page::kEmbeddedFiles[1].text)));
  const int exit = outputs.all_written() ? kDone : kRefused;
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  for (const Json& scene : json["scenes"]) {
    print_scene(scene);
    fmt::print("\n");
  }
  print_scene(json["overall"]);
  for (const Json& row : json["left_out"])
    fmt::print("\n  left out: {} at x{}: {}\n", row["name"].get<std::string>(),
               row["scale"].get<double>(), row["why"].get<std::string>());
  fmt::print("\n{}\n", page_file);
  return exit;
}

}  // namespace

Action add_trade(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("scenes", arguments->scenes, "scene files (.json)")->required();
  app.add_option("-o,--output", arguments->folder,
                 "folder for trade.html, trade.json, and what a later run need not do again")
      ->required();
  app.add_option("-m,--models", arguments->models,
                 "model folders; those without a network are baselines")
      ->required()
      ->delimiter(',');
  app.add_option("--precisions", arguments->precisions, "of the networks: int8, int16, fp16, fp32")
      ->delimiter(',')
      ->check(CLI::IsMember({"int8", "int16", "fp16", "fp32"}));
  app.add_option("--scales", arguments->scales,
                 "ratios of the result's to the rendered frame's sides")
      ->delimiter(',')
      ->check(number_in(1, 16));
  app.add_option("--output-size", arguments->output, "size of the results that are judged");
  app.add_option("--model-at", arguments->model_at,
                 "size of the results that times are modelled for (default: --output-size)");
  app.add_option("--model-device", arguments->device, "modelled device");
  app.add_option("--frames", arguments->frames, "frames of each scene")
      ->check(CLI::Range(2, 10000));
  app.add_option("--frame-ms", arguments->frame_ms, "budget of passes and network together")
      ->check(number_in(0, 1e6));
  app.add_option("--slack-db", arguments->slacks_db,
                 "the cheapest method so close to the best one's PSNR is enough; several distances")
      ->delimiter(',')
      ->check(number_in(0, 100));
  app.add_option("--tiles", arguments->tiles,
                 "also the networks by tiles, for each of these tolerances (compile --tiles)")
      ->delimiter(',')
      ->check(CLI::Range(0u, kMaxTileTolerance));
  app.add_flag("--specialised", arguments->specialised,
               "also packages that leave out what a scene rules out (compile --needs)");
  app.add_flag("--fresh", arguments->fresh, "measure again what the folder holds already");
  add_device_options(app, arguments->tool);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale trade models/scenes/test/*.json -o out/trade -m "
      "models/nss_v1_low,models/srpo_x2,models/baselines/bilinear --precisions int8,fp16 "
      "--output-size 960x540 --model-at 1920x1080");
  return [arguments] { return trade(*arguments); };
}

}  // namespace shale
