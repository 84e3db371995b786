// shale run: a network alone, arrays in, arrays out.
#include <charconv>
#include <cmath>
#include <filesystem>
#include <random>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tools/shale/command.h"
#include "tools/shale/layer_check.h"
#include "tools/shale/native.h"
#include "tools/shale/npy.h"
#include "tools/shale/outputs.h"
#include "tools/shale/random_inputs.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string file, check_model, output_folder, profile_file;
  std::vector<std::string> inputs, ranges;
  std::optional<uint64_t> random_seed;
  CompileArguments compile;
  DeviceArguments device;
  uint32_t repeat = 1;
  bool check = false, profile = false, native = false, json = false;
};

/// NAME=LOW,HIGH.
Result<GivenRanges> parse_ranges(const std::vector<std::string>& texts) {
  GivenRanges ranges;
  for (const std::string& text : texts) {
    const size_t equals = text.rfind('='), comma = text.rfind(',');
    std::pair<double, double> range;
    const auto parse = [&](size_t from, size_t to, double& value) {
      const auto [end, error] = std::from_chars(text.data() + from, text.data() + to, value);
      return error == std::errc() && end == text.data() + to && std::isfinite(value);
    };
    if (equals == std::string::npos || equals == 0 || comma == std::string::npos ||
        comma < equals || !parse(equals + 1, comma, range.first) ||
        !parse(comma + 1, text.size(), range.second))
      return bad_input("--range", "\"{}\" is not of the form NAME=LOW,HIGH", text);
    if (!ranges.emplace(text.substr(0, equals), range).second)
      return bad_input("--range", "\"{}\" has two ranges", text.substr(0, equals));
  }
  return ranges;
}

/// The file that --input names for an input, and the rest of the texts.
std::optional<std::string> take_file(std::vector<std::string>& texts, const std::string& name) {
  const auto given = std::find_if(texts.begin(), texts.end(), [&](const std::string& text) {
    return text.starts_with(name + "=");
  });
  if (given == texts.end()) return std::nullopt;
  const std::string file = given->substr(name.size() + 1);
  texts.erase(given);
  return file;
}

/// The network as the outside sees it, by its package or by its graph.
struct NamedType {
  std::string name;
  TensorType type;
};
struct Interface {
  std::vector<NamedType> inputs, outputs;

  explicit Interface(const Variant& variant) {
    for (const Resource* input : tensors_of(variant, Category::kInput))
      inputs.push_back({input->name, {input->dtype, input->shape}});
    for (const Resource* output : tensors_of(variant, Category::kOutput))
      outputs.push_back({output->name, {output->dtype, output->shape}});
  }
  explicit Interface(const Graph& graph) {
    for (const ValueId id : graph.inputs)
      inputs.push_back({graph.value(id).name, graph.value(id).type});
    for (const ValueId id : graph.outputs)
      outputs.push_back({graph.value(id).name, graph.value(id).type});
  }
};

/// What is missing is told before the driver compiles.
Result<void> check_input_names(const Arguments& arguments, const Interface& interface) {
  std::vector<std::string> unused = arguments.inputs;
  for (const auto& [name, type] : interface.inputs)
    if (!take_file(unused, name) && !arguments.random_seed)
      return bad_input("input \"" + name + "\"",
                       "is missing; give --input {}=FILE.npy of {}, or --random SEED", name,
                       type_text(type));
  if (!unused.empty())
    return bad_input("--input", "\"{}\" names no input of the network", unused.front());
  return {};
}

/// The inputs that come from files, in the order of the network; the others are empty.
Result<std::vector<Tensor>> read_inputs(const Arguments& arguments, const Interface& interface) {
  std::vector<Tensor> tensors;
  std::vector<std::string> texts = arguments.inputs;
  for (const auto& [name, type] : interface.inputs) {
    if (const std::optional<std::string> file = take_file(texts, name)) {
      SHALE_TRY(Tensor tensor, read_npy(*file, type));
      tensors.push_back(std::move(tensor));
    } else {
      tensors.push_back({type, {}});
    }
  }
  return tensors;
}

/// By the graph, where it is known; of a package alone the types have to do.
Result<std::vector<RandomRange>> ranges_of(const GivenRanges& given, const Interface& interface,
                                           const std::optional<Graph>& graph) {
  if (graph) return legal_ranges(*graph, given);
  Graph inputs_alone;
  for (const auto& [name, type] : interface.inputs) inputs_alone.add_input(name, type);
  return legal_ranges(inputs_alone, given);
}

/// `graph` is the package's, or the model's that --model names; `options` are set where it was compiled
/// here.
Result<Package> load_package(const Arguments& arguments, std::optional<Graph>& graph,
                             std::optional<CompileOptions>& options) {
  std::error_code ignored;
  if (!fs::is_directory(arguments.file, ignored)) {
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file(arguments.file));
    if (is_package(bytes)) {
      if (arguments.check && arguments.check_model.empty())
        return bad_input("--check", "a package holds no graph; name its model with --model");
      if (!arguments.compile.render.empty() || !arguments.compile.output.empty() ||
          arguments.compile.ratio != 0)
        return bad_input("--render", "{} is a package, whose sizes are fixed", arguments.file);
      if (!arguments.check_model.empty()) {
        SHALE_TRY(const ModelFiles model,
                  load_model(arguments.check_model, "", arguments.compile.precision));
        SHALE_TRY(const ImportOptions import, arguments.compile.import.options());
        Result<Graph> imported = import_model(model.bytes, import);
        if (!imported) return in_file(model.path, imported.error());
        graph = *std::move(imported);
      }
      Result<Package> package = read_package(bytes);
      if (!package) return in_file(arguments.file, package.error());
      return package;
    }
  }
  SHALE_TRY(ModelFiles model,
            load_model(arguments.file, arguments.compile.frame, arguments.compile.precision));
  // The network alone, at the size that its sandwich gives it where that is asked for.
  const bool sized = !arguments.compile.render.empty() || !arguments.compile.output.empty() ||
                     arguments.compile.ratio != 0;
  if (!sized) model.frame.reset();
  SHALE_TRY(options, arguments.compile.options(model));
  if (!options->expected_runs)
    options->expected_runs = std::max(kRunsOfOne, 1.0 * arguments.repeat);
  SHALE_TRY(Compiled compiled, compile_model(model, *options));
  for (const std::string& warning : compiled.warnings) print_warning(model.path, warning);
  if (!arguments.json)
    for (const std::string& line : selection_lines(compiled)) fmt::print(stderr, "{}\n", line);
  graph = std::move(compiled.graph);
  return std::move(compiled.package);
}

/// The model's own graph, as another compiler would get it.
Result<Graph> load_graph(const Arguments& arguments) {
  SHALE_TRY(const ModelFiles model,
            load_model(arguments.file, arguments.compile.frame, arguments.compile.precision));
  SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
  Result<Graph> graph = shaped_graph(model.bytes, options);
  if (!graph) return in_file(model.path, graph.error());
  return graph;
}

/// Draws the values of inputs that no file gives.
void fill_random(std::vector<Tensor>& inputs, const std::vector<RandomRange>& ranges,
                 uint64_t seed) {
  std::mt19937_64 generator(seed);
  for (size_t i = 0; i < inputs.size(); ++i)
    if (inputs[i].bytes.empty()) inputs[i] = random_tensor(inputs[i].type, ranges[i], generator);
}

Result<int> run(const Arguments& arguments) {
  Outputs files(arguments.json);
  files.keep({arguments.file, arguments.check_model});
  files.keep(arguments.compile.files());
  files.keep_named(arguments.inputs);
  SHALE_TRY_VOID(files.claim("--profile-to", arguments.profile_file));
  SHALE_TRY(const GivenRanges given, parse_ranges(arguments.ranges));
  if (!given.empty() && !arguments.random_seed)
    return bad_input("--range", "says how random values are drawn; --random SEED is missing");
  std::optional<Graph> graph;
  std::optional<CompileOptions> options;
  std::optional<Package> package;
  if (arguments.native) {
    SHALE_TRY(graph, load_graph(arguments));
  } else {
    SHALE_TRY(package, load_package(arguments, graph, options));
    if (graph) SHALE_TRY_VOID(match_shapes(*graph, package->variants.front()));
  }
  const Interface interface = package ? Interface(package->variants.front()) : Interface(*graph);
  SHALE_TRY_VOID(check_input_names(arguments, interface));
  SHALE_TRY(const std::vector<RandomRange> ranges, ranges_of(given, interface, graph));
  SHALE_TRY(std::vector<Tensor> inputs, read_inputs(arguments, interface));
  const std::vector<NamedType>& names = interface.outputs;
  std::vector<std::string> paths;
  if (!arguments.output_folder.empty()) {
    SHALE_TRY_VOID(make_folder(arguments.output_folder));
    FileNames file_names;
    for (const NamedType& output : names) {
      paths.push_back(
          (fs::path(arguments.output_folder) / (file_names.claim(output.name) + ".npy")).string());
      SHALE_TRY_VOID(files.claim("output \"" + output.name + "\"", paths.back()));
    }
  }
  std::optional<ToolDevice> device;
  std::optional<NativeDevice> native;
  if (arguments.native) {
    SHALE_TRY(native, NativeDevice::open(arguments.device));
  } else {
    SHALE_TRY(device, ToolDevice::open(arguments.device));
  }
  std::vector<Tensor> outputs;
  std::vector<DispatchTime> times;
  StartTimes start;
  const bool measure = arguments.profile || !arguments.profile_file.empty();
  const uint64_t seed = arguments.random_seed.value_or(0);
  if (native) {
    fill_random(inputs, ranges, seed);
    double median_us = 0;
    SHALE_TRY(outputs, native->run(*graph, inputs, arguments.repeat, &median_us, &start));
    if (measure) times.push_back({"graph", "native", "graph", median_us});
  } else {
    // Times are those of the fast kernels; a single run is over before these are there.
    const Compile compile = measure                ? Compile::kAtOnce
                            : arguments.repeat > 1 ? Compile::kInBackground
                                                   : Compile::kByHost;
    // The device refuses what it cannot run before there are random inputs.
    SHALE_TRY(NetworkRun network, NetworkRun::create(*device, *package, &start, compile));
    fill_random(inputs, ranges, seed);
    SHALE_TRY_VOID(network.set_inputs(inputs));
    SHALE_TRY(outputs,
              run_repeatedly(network, arguments.repeat, measure ? &times : nullptr, &start));
  }

  const std::string& device_name = native ? native->name() : device->context().caps.name;
  Json json{{"device", device_name}};
  int exit = kDone;
  std::vector<OutputCheck> checks;
  std::vector<LayerCheck> layers;
  if (arguments.check) {
    Progress progress("interpreting");
    SHALE_TRY(checks, check_outputs(*graph, inputs, outputs, [&](uint32_t node, uint32_t count) {
                return progress.step(node, count);
              }));
    for (size_t i = 0; i < outputs.size(); ++i) {
      json["check"][names[i].name] =
          checks[i].difference.value_or(checks[i].widest ? "within bounds" : "equal");
      if (checks[i].widest && std::isfinite(*checks[i].widest))
        json["bounds"][names[i].name] = *checks[i].widest;
      if (checks[i].difference) exit = kRefused;
    }
    if (has_reals(*graph) && options && device) {
      SHALE_TRY(layers, check_layers(*device, *graph, *options, inputs,
                                     [&](uint32_t layer, uint32_t count) {
                                       return progress.step(layer, count);
                                     }));
      for (const LayerCheck& layer : layers) {
        json["layers"][layer.name] = layer.check.difference.value_or("within bounds");
        if (layer.check.difference) exit = kRefused;
      }
    }
  }
  SHALE_TRY_VOID(native ? native->close() : device->close());
  for (size_t i = 0; i < paths.size(); ++i) {
    if (files.note(write_npy(paths[i], outputs[i]))) json["outputs"][names[i].name] = paths[i];
  }
  double total_us = 0;
  for (const DispatchTime& time : times) {
    total_us += time.time_us;
    json["dispatches"].push_back(
        {{"name", time.name}, {"kernel", time.kernel}, {"time_us", time.time_us}});
  }
  json["start"] = {{"create_ms", start.create_ms}, {"first_ms", start.first_ms}};
  if (measure) json["total_us"] = total_us;
  if (!arguments.profile_file.empty())
    files.note(write_text(arguments.profile_file, json_text(json)));
  if (!files.all_written()) exit = kRefused;
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  if (files.has_standard_output()) return exit;
  fmt::print("ran on {}{}\n", device_name, native ? ", by its own data graph pipelines" : "");
  for (size_t i = 0; i < checks.size(); ++i)
    fmt::print("output \"{}\": {}\n", names[i].name, checks[i].text());
  for (const LayerCheck& layer : layers)
    fmt::print("layer \"{}\" alone: {}\n", layer.name, layer.check.text());
  if (arguments.profile) {
    fmt::print("  {:.0f} ms to be ready, {:.0f} ms for the first run\n", start.create_ms,
               start.first_ms);
    for (const DispatchTime& time : times)
      fmt::print("  {:>10.1f} us {:>5.1f} %  {:<20} {}\n", time.time_us,
                 total_us > 0 ? 100 * time.time_us / total_us : 0.0, time.kernel, time.name);
    fmt::print("  {:>10.1f} us total, median of {}\n", total_us, arguments.repeat);
  }
  return exit;
}

}  // namespace

Action add_run(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("file", arguments->file,
                 fmt::format("model ({}), model folder, or package (.shale)", kModelKinds))
      ->required();
  app.add_option("--input", arguments->inputs, "NAME=FILE.npy for each graph input")
      ->allow_extra_args(false);
  app.add_option("--random", arguments->random_seed,
                 "seed for random values of the inputs that are not given");
  app.add_option("--range", arguments->ranges,
                 "LOW and HIGH of an input's random values, NAME=LOW,HIGH (default: all that the "
                 "graph is defined for)")
      ->allow_extra_args(false);
  app.add_option("-o,--output", arguments->output_folder, "folder for the outputs, NAME.npy each");
  app.add_flag(
      "--check", arguments->check,
      "compare with the reference interpreter: bit for bit, floats by their rounding bounds");
  app.add_option("--model", arguments->check_model, "the model of a package, for --check");
  app.add_flag("--native", arguments->native,
               "run the model on the device's own data graph pipelines (VK_ARM_data_graph), for a "
               "driver or a layer that has them; the time is that of the whole graph");
  app.add_option("--repeat", arguments->repeat, "runs; times are the median")
      ->check(CLI::Range(1, 10000));
  app.add_flag("--profile", arguments->profile, "print the time of each dispatch");
  app.add_option("--profile-to", arguments->profile_file,
                 "write the times as JSON, for shale report --measured");
  arguments->compile.add_to(app, &arguments->device);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer("Example: shale run models/srpo_x2 --random 1 --check --profile");
  return [arguments] { return run(*arguments); };
}

}  // namespace shale
