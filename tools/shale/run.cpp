// shale run: a network alone, arrays in, arrays out.
#include <cmath>
#include <filesystem>
#include <random>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tools/shale/command.h"
#include "tools/shale/layer_check.h"
#include "tools/shale/npy.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string file, check_model, output_folder, profile_file;
  std::vector<std::string> inputs;
  std::optional<uint64_t> random_seed;
  CompileArguments compile;
  DeviceArguments device;
  uint32_t repeat = 1;
  bool check = false, profile = false, json = false;
};

/// Values over the whole range of the type, of a float in -4..4; the same on every machine for a seed.
Tensor random_tensor(const TensorType& type, std::mt19937_64& generator) {
  Tensor tensor = Tensor::zeros(type);
  if (is_float(type.dtype)) {
    for (int64_t i = 0; i < tensor.count(); ++i)
      tensor.set_real(i, static_cast<float>(generator() % 8193) / 1024.0f - 4.0f);
    return tensor;
  }
  const IntRange range = dtype_range(type.dtype);
  const uint64_t span = static_cast<uint64_t>(range.max - range.min) + 1;
  for (int64_t i = 0; i < tensor.count(); ++i)
    tensor.set(i, range.min + static_cast<int64_t>(span == 0 ? generator() : generator() % span));
  return tensor;
}

Result<std::vector<Tensor>> read_inputs(const Arguments& arguments, const Variant& variant) {
  std::vector<Tensor> tensors;
  std::mt19937_64 generator(arguments.random_seed.value_or(0));
  std::vector<std::string> unused = arguments.inputs;
  for (const Resource* resource : tensors_of(variant, Category::kInput)) {
    const TensorType type{resource->dtype, resource->shape};
    const auto given = std::find_if(unused.begin(), unused.end(), [&](const std::string& text) {
      return text.starts_with(resource->name + "=");
    });
    if (given != unused.end()) {
      SHALE_TRY(Tensor tensor, read_npy(given->substr(resource->name.size() + 1), type));
      tensors.push_back(std::move(tensor));
      unused.erase(given);
    } else if (arguments.random_seed) {
      tensors.push_back(random_tensor(type, generator));
    } else {
      return bad_input("input \"" + resource->name + "\"",
                       "is missing; give --input {}=FILE.npy of {}, or --random SEED",
                       resource->name, type_text(type));
    }
  }
  if (!unused.empty())
    return bad_input("--input", "\"{}\" names no input of the network", unused.front());
  return tensors;
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
      if (!arguments.check_model.empty()) {
        SHALE_TRY(const ModelFiles model,
                  load_model(arguments.check_model, "", arguments.compile.precision));
        SHALE_TRY(const ImportOptions import, arguments.compile.import.options());
        SHALE_TRY(graph, import_model(model.bytes, import));
      }
      Result<Package> package = read_package(bytes);
      if (!package) return in_file(arguments.file, package.error());
      return package;
    }
  }
  SHALE_TRY(ModelFiles model,
            load_model(arguments.file, arguments.compile.frame, arguments.compile.precision));
  model.frame.reset();  // the network alone
  SHALE_TRY(options, arguments.compile.options(model));
  SHALE_TRY(Compiled compiled, compile_model(model, *options));
  for (const std::string& warning : compiled.warnings)
    fmt::print(stderr, "{}: warning: {}\n", model.path, warning);
  graph = std::move(compiled.graph);
  return std::move(compiled.package);
}

Result<int> run(const Arguments& arguments) {
  std::optional<Graph> graph;
  std::optional<CompileOptions> options;
  SHALE_TRY(const Package package, load_package(arguments, graph, options));
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  const Variant& variant = package.variants.front();
  SHALE_TRY(const std::vector<Tensor> inputs, read_inputs(arguments, variant));
  std::vector<DispatchTime> times;
  const bool measure = arguments.profile || !arguments.profile_file.empty();
  SHALE_TRY(const std::vector<Tensor> outputs,
            run_network(device, package, inputs, arguments.repeat, measure ? &times : nullptr));

  Json json{{"device", device.context().caps.name}};
  int exit = kDone;
  const std::vector<const Resource*> names = tensors_of(variant, Category::kOutput);
  std::vector<OutputCheck> checks;
  std::vector<LayerCheck> layers;
  if (arguments.check) {
    SHALE_TRY_VOID(match_shapes(*graph, variant));
    Progress progress("interpreting");
    SHALE_TRY(checks, check_outputs(*graph, inputs, outputs, [&](uint32_t node, uint32_t count) {
                return progress.step(node, count);
              }));
    for (size_t i = 0; i < outputs.size(); ++i) {
      json["check"][names[i]->name] =
          checks[i].difference.value_or(checks[i].widest ? "within bounds" : "equal");
      if (checks[i].widest && std::isfinite(*checks[i].widest))
        json["bounds"][names[i]->name] = *checks[i].widest;
      if (checks[i].difference) exit = kRefused;
    }
    if (has_reals(*graph) && options) {
      SHALE_TRY(layers,
                check_layers(device, *graph, *options, inputs, [&](uint32_t layer, uint32_t count) {
                  return progress.step(layer, count);
                }));
      for (const LayerCheck& layer : layers) {
        json["layers"][layer.name] = layer.check.difference.value_or("within bounds");
        if (layer.check.difference) exit = kRefused;
      }
    }
  }
  SHALE_TRY_VOID(device.close());
  if (!arguments.output_folder.empty()) {
    std::error_code error;
    fs::create_directories(arguments.output_folder, error);
    if (error) return io_error(arguments.output_folder, "cannot create: {}", error.message());
    for (size_t i = 0; i < outputs.size(); ++i) {
      std::string file = names[i]->name;
      std::replace(file.begin(), file.end(), '/', '_');
      const std::string path = (fs::path(arguments.output_folder) / (file + ".npy")).string();
      SHALE_TRY_VOID(write_npy(path, outputs[i]));
      json["outputs"][names[i]->name] = path;
    }
  }
  double total_us = 0;
  for (const DispatchTime& time : times) {
    total_us += time.time_us;
    json["dispatches"].push_back(
        {{"name", time.name}, {"kernel", time.kernel}, {"time_us", time.time_us}});
  }
  if (measure) json["total_us"] = total_us;
  if (!arguments.profile_file.empty())
    SHALE_TRY_VOID(write_text(arguments.profile_file, json_text(json)));
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  fmt::print("ran on {}\n", device.context().caps.name);
  for (size_t i = 0; i < checks.size(); ++i)
    fmt::print("output \"{}\": {}\n", names[i]->name, checks[i].text());
  for (const LayerCheck& layer : layers)
    fmt::print("layer \"{}\" alone: {}\n", layer.name, layer.check.text());
  if (arguments.profile) {
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
  app.add_option("-o,--output", arguments->output_folder, "folder for the outputs, NAME.npy each");
  app.add_flag(
      "--check", arguments->check,
      "compare with the reference interpreter: bit for bit, floats by their rounding bounds");
  app.add_option("--model", arguments->check_model, "the model of a package, for --check");
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
