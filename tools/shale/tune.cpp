// shale tune: for each layer the kernel family that is fastest on the device, by measurement.
#include <algorithm>
#include <map>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/outputs.h"

namespace shale {
namespace {

struct Arguments {
  std::string model, output;
  CompileArguments compile;
  DeviceArguments device;
  uint32_t repeat = 5;
  std::vector<std::string> without{"generic", "conv2d_s8_i32"};
  bool json = false;
};

/// Time of each layer in microseconds, and the family that it ran on.
struct Layer {
  std::string kernel;
  double time_us = 0;
};
using Layers = std::map<std::string, Layer>;

Result<Layers> measure(const Arguments& arguments, const ToolDevice& device,
                       const ModelFiles& model, const CompileOptions& options) {
  SHALE_TRY(const Compiled compiled, compile_model(model, options));
  const Variant& variant = compiled.package.variants.front();
  std::vector<Tensor> inputs;
  for (const Resource* resource : tensors_of(variant, Category::kInput))
    inputs.push_back(Tensor::zeros({resource->dtype, resource->shape}));
  std::vector<DispatchTime> times;
  SHALE_TRY(const std::vector<Tensor> outputs,
            run_network(device, compiled.package, inputs, arguments.repeat, &times));
  Layers layers;
  for (const DispatchTime& time : times) {
    // Parts of a layer are called name#1, name#2, ...
    std::string name = time.name;
    if (const size_t hash = name.find('#');
        hash != std::string::npos && layers.contains(name.substr(0, hash)))
      name.resize(hash);
    layers[name].kernel = time.kernel;
    layers[name].time_us += time.time_us;
  }
  return layers;
}

Result<int> run(const Arguments& arguments) {
  Outputs outputs(arguments.json);
  outputs.keep({arguments.model});
  outputs.keep(arguments.compile.files());
  SHALE_TRY_VOID(outputs.claim("-o", arguments.output));
  for (const std::string& kernel : arguments.without)
    if (!find_kernel(kernel)) return bad_input("--without", "\"{}\" is no kernel family", kernel);
  SHALE_TRY(ModelFiles model,
            load_model(arguments.model, arguments.compile.frame, arguments.compile.precision));
  SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
  if (options.targets.size() != 1)
    return bad_input("--target", "{} targets are given, expected one", options.targets.size());
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  SHALE_TRY(const Layers selected, measure(arguments, device, model, options));
  Layers best = selected;
  Json layers = Json::object();
  for (const auto& [name, layer] : selected)
    layers[name]["candidates"][layer.kernel] = layer.time_us;
  Progress progress("tuning");
  const std::span<const KernelFamily> families = all_kernels();
  for (size_t i = 0; i < families.size(); ++i) {
    if (!progress.step(i, families.size())) return bad_input("", "interrupted");
    const std::string family(families[i].name);
    if (std::find(arguments.without.begin(), arguments.without.end(), family) !=
        arguments.without.end())
      continue;
    // Every layer that can, on this family; the others stay as they were selected.
    CompileOptions candidate = options;
    candidate.prefer = family;
    SHALE_TRY(const Layers measured, measure(arguments, device, model, candidate));
    for (const auto& [name, layer] : measured) {
      const auto found = best.find(name);
      if (found == best.end() || layer.kernel != family || selected.at(name).kernel == family)
        continue;
      layers[name]["candidates"][family] = layer.time_us;
      if (layer.time_us < found->second.time_us) found->second = layer;
    }
  }
  double selected_us = 0, tuned_us = 0;
  Json choices = Json::object();
  for (const auto& [name, layer] : best) {
    choices[name] = layer.kernel;
    layers[name]["selected"] = selected.at(name).kernel;
    layers[name]["fastest"] = layer.kernel;
    selected_us += selected.at(name).time_us;
    tuned_us += layer.time_us;
  }
  const Json json{{"schema", kChoicesSchema},
                  {"device", device.context().caps.name},
                  {"driver", device.context().caps.driver},
                  {"model", model.name},
                  {"selected_us", selected_us},
                  {"tuned_us", tuned_us},
                  {"layers", layers},
                  {"choices", choices}};
  SHALE_TRY_VOID(device.close());
  outputs.note(write_text(arguments.output, json_text(json)));
  const int exit = outputs.all_written() ? kDone : kRefused;
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  std::FILE* const summary = outputs.summary();
  for (const auto& [name, layer] : best)
    fmt::print(summary, "  {:<16} {:<20} {:>9.1f} us   selected {:<20} {:>9.1f} us\n", name,
               layer.kernel, layer.time_us, selected.at(name).kernel, selected.at(name).time_us);
  fmt::print(summary, "selected {:.1f} us, fastest {:.1f} us: selection is {:.1f} % above it\n",
             selected_us, tuned_us, 100 * (selected_us / tuned_us - 1));
  if (outputs.all_written()) fmt::print(summary, "wrote {}\n", arguments.output);
  return exit;
}

}  // namespace

Action add_tune(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("model", arguments->model, fmt::format("model ({}) or model folder", kModelKinds))
      ->required();
  app.add_option("-o,--output", arguments->output, "file for the choices (JSON)")->required();
  app.add_option("--repeat", arguments->repeat, "runs; times are the median")
      ->check(CLI::Range(1, 10000));
  app.add_option("--without", arguments->without,
                 "families that are not tried (default: generic and conv2d_s8_i32, which are slow "
                 "to run or to compile)");
  arguments->compile.add_to(app, &arguments->device);
  add_device_options(app, arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Example: shale tune models/srpo_x2 --render 960x540 -o srpo.choices.json\n"
      "         shale compile models/srpo_x2 --render 960x540 --choices "
      "srpo.choices.json -o srpo.shale");
  return [arguments] { return run(*arguments); };
}

}  // namespace shale
