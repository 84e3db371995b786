#include "tools/shale/command.h"

#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <set>

#include "compiler/target/caps_json.h"
#include "ir/base/file.h"
#include "ir/base/json.h"
#include "ir/text/text.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

}  // namespace

std::string json_text(const Json& json) {
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

void print_json(const Json& json) { fmt::print("{}", json_text(json)); }

CLI::Validator number_in(double low, double high) {
  return CLI::Validator(
      [low, high](std::string& text) {
        double value = 0;
        const char* const end = text.data() + text.size();
        const auto [at, error] = std::from_chars(text.data(), end, value);
        return error == std::errc() && at == end && value >= low && value <= high
                   ? std::string()
                   : fmt::format("\"{}\" is no number from {} to {}", text, low, high);
      },
      fmt::format("FLOAT in [{} - {}]", low, high));
}

void add_precision_option(CLI::App& app, std::string& precision) {
  app.add_option("--precision", precision, "which network of a model folder")
      ->check(CLI::IsMember({"int8", "int16", "fp16", "fp32"}))
      ->capture_default_str();
}

Result<std::string> model_file(const std::string& path, const std::string& precision) {
  std::error_code ignored;
  if (!fs::is_directory(path, ignored)) {
    if (precision == "int8") return path;
    return bad_input("--precision", "chooses a network of a model folder, and {} is a file", path);
  }
  const fs::path file =
      fs::path(path) /
      (precision == "int8" ? "model.tosa" : fmt::format("model.{}.tosa", precision));
  if (precision != "int8" && !fs::exists(file, ignored))
    return bad_input("--precision", "{} has no {}", path, file.filename().string());
  return file.string();
}

Result<ModelFiles> load_model(const std::string& path, const std::string& frame_path,
                              const std::string& precision) {
  ModelFiles model;
  std::error_code ignored;
  const bool is_folder = fs::is_directory(path, ignored);
  const std::string stem =
      is_folder ? fs::path(path + "/").lexically_normal().parent_path().filename().string()
                : fs::path(path).stem().string();
  model.name = stem.empty() ? "model" : one_line(stem);
  std::string frame = frame_path;
  if (frame.empty() && is_folder && fs::exists(fs::path(path) / "frame.json", ignored))
    frame = (fs::path(path) / "frame.json").string();
  if (!frame.empty()) {
    SHALE_TRY(const std::string text, read_text(frame));
    Result<Frame> parsed = parse_frame(text);
    if (!parsed) return in_file(frame, parsed.error());
    model.frame = *std::move(parsed);
    model.frame_folder = fs::path(frame).parent_path().string();
  }
  if (model.frame && is_folder && graph_files(*model.frame).empty()) {
    model.path = frame;
    return model;
  }
  // A frame around the network of another folder names it.
  std::string folder = path;
  if (model.frame && is_folder && frame_path.empty() &&
      !fs::exists(fs::path(path) / "model.tosa", ignored))
    folder = (fs::path(path) / fs::path(graph_files(*model.frame)[0]).parent_path()).string();
  SHALE_TRY(model.path, model_file(folder, precision));
  SHALE_TRY(model.bytes, read_file(model.path));
  return model;
}

Result<FrameExtent> parse_extent(const std::string& option, const std::string& text) {
  FrameExtent extent;
  const char* const end = text.data() + text.size();
  const auto [middle, first] = std::from_chars(text.data(), end, extent.width);
  if (first == std::errc() && middle < end && *middle == 'x') {
    const auto [last, second] = std::from_chars(middle + 1, end, extent.height);
    if (second == std::errc() && last == end && extent.width >= 1 && extent.height >= 1 &&
        extent.width <= kMaxImageExtent && extent.height <= kMaxImageExtent)
      return extent;
  }
  return bad_input(option, "\"{}\" is not of the form WIDTHxHEIGHT, each 1 to {}", text,
                   kMaxImageExtent);
}

Result<std::pair<std::string, Shape>> parse_input_shape(const std::string& text) {
  const size_t equals = text.rfind('=');
  const Error error = bad_input("--input-shape", "\"{}\" is not of the form NAME=N,H,W,C", text);
  if (equals == std::string::npos || equals == 0) return error;
  Shape shape;
  const char* at = text.data() + equals + 1;
  const char* const end = text.data() + text.size();
  while (at < end) {
    int64_t dim = 0;
    const auto [next, status] = std::from_chars(at, end, dim);
    if (status != std::errc() || dim < 1 || (next < end && *next != ',')) return error;
    shape.push_back(dim);
    at = next + (next < end ? 1 : 0);
  }
  if (shape.empty() || text.back() == ',') return error;
  return std::pair{text.substr(0, equals), std::move(shape)};
}

Result<Json> read_json(const std::string& path) {
  SHALE_TRY(const std::string text, read_text(path));
  Result<Json> json = parse_json<Json>(text);
  if (!json) return in_file(path, json.error());
  return json;
}

Result<std::map<std::string, std::string>> read_choices(const std::string& path) {
  SHALE_TRY(const Json json, read_json(path));
  if (!json.is_object() || json.value("schema", Json()) != kChoicesSchema ||
      !json.contains("choices") || !json["choices"].is_object())
    return bad_input(path, "is no file of shale tune, expected schema {}", kChoicesSchema);
  std::map<std::string, std::string> choices;
  for (const auto& [name, kernel] : json["choices"].items()) {
    if (!kernel.is_string() || !find_kernel(kernel.get<std::string>()))
      return bad_input(path, "choices.{}: expected the name of a kernel family", name);
    choices[name] = kernel.get<std::string>();
  }
  return choices;
}

Json constants_json(const std::string& target, const MeasuredConstants& constants) {
  Json json{{"schema", kConstantsSchema}, {"target", target}, {"roof_gops", constants.roof_gops}};
  for (size_t i = 0; i < kWorkCount; ++i)
    json["ns"][work_info(static_cast<Work>(i)).name] = constants.ns.at(i);
  return json;
}

Result<std::map<std::string, MeasuredConstants>> read_constants(const std::string& path) {
  SHALE_TRY(const Json json, read_json(path));
  const auto number = [](const Json& object, std::string_view key) -> std::optional<double> {
    const auto found = object.find(key);
    if (found == object.end() || !found->is_number()) return std::nullopt;
    const double value = found->get<double>();
    return value >= 0 && std::isfinite(value) ? std::optional(value) : std::nullopt;
  };
  if (!json.is_object() || json.value("schema", Json()) != kConstantsSchema ||
      !json.contains("target") || !json["target"].is_string() || !json.contains("ns") ||
      !json["ns"].is_object())
    return bad_input(path, "is no file of shale fit, expected schema {}", kConstantsSchema);
  const std::string target = json["target"].get<std::string>();
  if (!find_profile(target)) return bad_input(path, "target: \"{}\" is unknown", target);
  MeasuredConstants constants;
  const std::optional<double> roof = number(json, "roof_gops");
  if (!roof) return bad_input(path, "roof_gops: expected a number of at least 0");
  constants.roof_gops = *roof;
  for (size_t i = 0; i < kWorkCount; ++i) {
    const std::string_view name = work_info(static_cast<Work>(i)).name;
    const std::optional<double> ns = number(json["ns"], name);
    if (!ns) return bad_input(path, "ns.{}: expected a number of at least 0", name);
    constants.ns.at(i) = *ns;
  }
  return std::map<std::string, MeasuredConstants>{{target, constants}};
}

void ImportArguments::add_to(CLI::App& app) {
  app.add_option("--input-shape", input_shapes,
                 "shape of a graph input, NAME=N,H,W,C (again for each input)")
      ->allow_extra_args(false);  // what follows may be a file
  app.add_option("--entry-point", entry_point,
                 "graph of a .spv file, or graph segment of a .vgf file, that holds several");
  app.add_option("--constant", constants,
                 "bytes of an external constant of a .spv file, ID=FILE (again for each constant)")
      ->allow_extra_args(false);
}

Result<ImportOptions> ImportArguments::options() const {
  ImportOptions options;
  options.entry_point = entry_point;
  for (const std::string& text : input_shapes) {
    SHALE_TRY(auto shape, parse_input_shape(text));
    if (!options.input_shapes.insert(shape).second)
      return bad_input("--input-shape", "\"{}\" has two shapes", shape.first);
  }
  for (const std::string& text : constants) {
    uint32_t id = 0;
    const char* const end = text.data() + text.size();
    const auto [next, status] = std::from_chars(text.data(), end, id);
    if (status != std::errc() || next == end || *next != '=')
      return bad_input("--constant", "\"{}\" is not of the form ID=FILE", text);
    SHALE_TRY(std::vector<uint8_t> bytes, read_file(std::string(next + 1, end)));
    if (!options.constants.emplace(id, std::move(bytes)).second)
      return bad_input("--constant", "constant {} has two files", id);
  }
  return options;
}

Result<Graph> import_graph(std::span<const uint8_t> bytes, const ImportOptions& options) {
  SHALE_TRY(Graph graph, import_model(bytes, options));
  if (options.input_shapes.empty()) return graph;
  PassContext context;
  context.input_shapes = options.input_shapes;
  SHALE_TRY_VOID(run_pass(*find_pass("infer-shapes"), graph, context));
  return graph;
}

void CompileArguments::add_to(CLI::App& app, const DeviceArguments* device_at_hand) {
  device = device_at_hand;
  import.add_to(app);
  std::string known;
  for (const DeviceProfile& profile : known_profiles())
    known += (known.empty() ? "" : ", ") + std::string(profile.name);
  app.add_option("--target", targets,
                 fmt::format("device classes, a variant each: {}; \"all\" for a package "
                             "that goes anywhere, SSE and NEON take its AVX2 variant; "
                             "\"device\", the device at hand; a file of shale doctor --json, the "
                             "device in it (default: {})",
                             known, device ? "device" : default_target))
      ->delimiter(',')
      ->allow_extra_args(false);
  app.add_option("--choices", choices, "file of shale tune: the fastest family for each layer");
  app.add_option("--constants", constants, "file of shale fit: constants of the cost model");
  app.add_option("--expected-runs", expected_runs,
                 "runs to spread the driver's compile time over: fewer give less code, more give "
                 "faster runs (default: 1 to run a network, 1000 to compile one alone, 100000 with "
                 "the passes of a frame)")
      ->check(number_in(1, 1e12))
      ->default_str("");
  app.add_option("--prefer", prefer,
                 "start: kernels that the driver compiles at once; throughput: fast ones, for "
                 "which the first "
                 "run waits; balanced: both, the first until the driver has compiled the others")
      ->check(CLI::IsMember({"start", "throughput", "balanced"}))
      ->capture_default_str();
  app.add_option("--tiles", tiles,
                 "run only what changed inputs reach; codes by which that may change what comes of "
                 "it, 0 is exact, above it settled tiles of frames stay as they are, 8 is for them "
                 "(default: all in every run)")
      ->check(CLI::Range(0u, kMaxTileTolerance))
      ->default_str("");
  app.add_option("--kernels", kernels, "kernel families to choose from (default: all)")
      ->delimiter(',')
      ->allow_extra_args(false);
  app.add_option("--frame", frame, "frame.json of the sandwich, for a model given as a file");
  add_precision_option(app, precision);
  app.add_option("--render", render, "size of the rendered frames of a sandwich, WIDTHxHEIGHT");
  auto* size = app.add_option("--output-size", output, "size of its results, WIDTHxHEIGHT");
  app.add_option("--ratio", ratio,
                 "ratio of the results' sides to the rendered frames'; of a dataset, which of its "
                 "ratios")
      ->excludes(size)
      ->check(number_in(1, 16));
  app.add_option(
      "--needs", needs,
      "what the scenes need (JSON of shale scene --needs, or by hand): what that rules out is not "
      "computed; frames that need more take the full passes");
  app.add_option("--dump-after", dump_after,
                 "print the graph after these passes, on standard error")
      ->delimiter(',')
      ->allow_extra_args(false);
  app.add_flag("--no-passes", no_passes, "skip every pass that is not needed to compile");
  app.add_flag("--verify-each", verify_each, "verify the graph after each pass, and all shaders");
  app.add_flag("--require-proof", require_proof,
               "refuse convolutions whose accumulators cannot be bounded");
  app.add_flag("--no-spirv-opt", no_spirv_opt, "leave the shaders as glslang made them");
}

Result<void> CompileArguments::add_targets(CompileOptions& options) const {
  options.targets.clear();
  std::vector<std::string> wanted = targets;
  if (wanted.empty()) wanted.push_back(device ? "device" : default_target);
  for (const std::string& target : wanted) {
    if (target == "all") {
      for (const DeviceProfile& profile : known_profiles())
        if (profile.for_all) options.targets.emplace_back(profile.name);
      continue;
    }
    options.targets.push_back(target);
    if (target == "device") {
      SHALE_TRY(const DeviceCaps caps, caps_at_hand(device ? *device : DeviceArguments()));
      options.profiles.emplace(target, profile_from_caps(caps));
    } else if (target.ends_with(".json")) {
      SHALE_TRY(const std::string text, read_text(target));
      const Result<DeviceCaps> caps = parse_caps(text);
      if (!caps) return in_file(target, caps.error());
      options.profiles.emplace(target, profile_from_caps(*caps));
    }
  }
  std::set<std::string> seen;
  for (const std::string& target : options.targets)
    if (!seen.insert(target).second) return bad_input("--target", "\"{}\" is given twice", target);
  return {};
}

Result<CompileOptions> CompileArguments::options(const ModelFiles& model) const {
  CompileOptions options;
  SHALE_TRY_VOID(add_targets(options));
  options.kernels = kernels;
  options.expected_runs = expected_runs;
  if (prefer == "start") options.expected_runs = kRunsOfOne;
  if (prefer != "balanced") options.start_us = std::numeric_limits<double>::infinity();
  options.tiles = tiles;
  for (const std::string& kernel : kernels)
    if (!find_kernel(kernel)) return bad_input("--kernels", "\"{}\" is no kernel family", kernel);
  if (!choices.empty()) {
    SHALE_TRY(options.choices, read_choices(choices));
  }
  if (!constants.empty()) {
    SHALE_TRY(options.constants, read_constants(constants));
  }
  SHALE_TRY(options.import, import.options());
  options.passes.input_shapes = options.import.input_shapes;
  options.pass_options.optimize = !no_passes;
  options.pass_options.verify_each = verify_each;
  options.require_proof = require_proof;
  options.optimize_spirv = !no_spirv_opt;
  options.model_name = model.name;
  options.frame = model.frame;
  if (!model.frame && (!render.empty() || !output.empty() || ratio != 0))
    return bad_input(model.path, "has no sandwich, so it has no render or output size");
  if (!render.empty()) {
    SHALE_TRY(options.sizes.render, parse_extent("--render", render));
  }
  if (!output.empty()) {
    SHALE_TRY(options.sizes.output, parse_extent("--output-size", output));
  }
  if (ratio != 0) {
    const FrameExtent from = options.sizes.render.value_or(model.frame->render);
    const auto side = [&](uint32_t of) { return static_cast<uint32_t>(std::lround(of * ratio)); };
    options.sizes.output = FrameExtent{side(from.width), side(from.height)};
  }
  if (!needs.empty()) {
    if (!model.frame)
      return bad_input(model.path, "has no sandwich from which needs could leave anything out");
    SHALE_TRY(const std::string text, read_text(needs));
    Result<SceneNeeds> parsed = parse_needs(text);
    if (!parsed) return in_file(needs, parsed.error());
    options.needs = *std::move(parsed);
  }
  options.load_shader = [folder = model.frame_folder](const std::string& path) {
    return read_text((fs::path(folder) / path).string());
  };
  options.load_model = [folder = model.frame_folder, precision = precision](
                           const std::string& path) -> Result<std::vector<uint8_t>> {
    fs::path file = fs::path(folder) / path;
    if (precision != "int8") file.replace_extension(precision + file.extension().string());
    return read_file(file.string());
  };
  for (const std::string& pass : dump_after)
    if (pass != "all" && !find_pass(pass))
      return bad_input("--dump-after", "\"{}\" is no pass", pass);
  if (!dump_after.empty()) {
    options.pass_options.after = [names = dump_after](std::string_view pass, const Graph& graph) {
      for (const std::string& name : names)
        if (name == "all" || name == pass)
          fmt::print(stderr, "# after {}\n{}", pass, print_text(graph));
    };
  }
  return options;
}

std::vector<std::string> CompileArguments::files() const {
  std::vector<std::string> files{frame, choices, constants, needs};
  files.insert(files.end(), targets.begin(), targets.end());
  for (const std::string& text : import.constants)  // ID=FILE
    files.push_back(text.substr(text.find('=') + 1));
  return files;
}

std::vector<std::string> selection_lines(const Compiled& compiled) {
  std::vector<std::string> lines;
  for (size_t i = 0; i < compiled.selections.size(); ++i) {
    const Selection& selection = compiled.selections[i];
    std::vector<std::pair<std::string_view, size_t>> counts;  // in the order of first use
    for (const KernelFamily* family : selection.families) {
      const auto known = std::find_if(counts.begin(), counts.end(), [&](const auto& count) {
        return count.first == family->name;
      });
      if (known == counts.end())
        counts.emplace_back(family->name, 1);
      else
        ++known->second;
    }
    if (counts.empty()) continue;
    std::string text = compiled.package.variants[i].target + ": ";
    for (const auto& [name, count] : counts)
      text += fmt::format("{}{} {}", name == counts.front().first ? "" : ", ", count, name);
    if (selection.driver_us > 0)
      text += fmt::format("; the driver compiles for about {:.{}f} s at the first start",
                          1e-6 * selection.driver_us, selection.driver_us < 1e7 ? 1 : 0);
    if (selection.start_us < selection.driver_us)
      text += fmt::format(", {:.1f} s of it before the first result", 1e-6 * selection.start_us);
    lines.push_back(std::move(text));
  }
  return lines;
}

Json selection_json(const Selection& selection) {
  Json json{{"kernels", Json::object()},
            {"products_in_code", selection.products},
            {"predicted_run_ms", 1e-3 * selection.run_us},
            {"predicted_driver_s", 1e-6 * selection.driver_us}};
  for (const KernelFamily* family : selection.families) {
    Json& count = json["kernels"][std::string(family->name)];
    count = count.is_null() ? 1 : count.get<int>() + 1;
  }
  return json;
}

Result<Compiled> compile_model(const ModelFiles& model, const CompileOptions& options) {
  CompileOptions with_progress = options;
  Progress progress("compiling kernels");
  with_progress.progress = [&](size_t done, size_t total) { return progress.step(done, total); };
  Result<Compiled> compiled = compile(model.bytes, with_progress);
  if (!compiled) return in_file(model.path, compiled.error());
  return compiled;
}

}  // namespace shale
