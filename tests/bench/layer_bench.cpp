// Networks by a client of the layer, which knows VK_ARM_data_graph alone, and by Shale's own package, by turns in one run;
// and dispatches of small graphs.
//
//   layer_bench MODEL... [--render WxH] [--repeat N] [--json]
//
// A time is from before the command buffer is recorded until its work has ended, on both sides. The kernels are
// those that run fastest: SHALE_LAYER_OPTIONS is compile=at-once where it is not set.
#include <algorithm>
#include <chrono>
#include <cstdlib>

#include "compiler/driver/compile.h"
#include "ir/text/text.h"
#include "runtime/vk/processor.h"
#include "tools/shale/command.h"
#include "tools/shale/native.h"
#include "tools/shale/terminal.h"

namespace shale {
namespace {

struct Arguments {
  std::vector<std::string> models;
  CompileArguments compile;
  DeviceArguments device;
  uint32_t repeat = 15;
  bool json = false;
};

struct SmallGraph {
  const char *name, *text;
};

constexpr SmallGraph kSmallGraphs[] = {
    {"add and sub of int32, 1x8x16x4", R"(graph addsub {
  input %a : i32[1,8,16,4]
  input %b : i32[1,8,16,4]
  %c = add %a, %b : i32[1,8,16,4]
  %d = sub %c, %b : i32[1,8,16,4]
  return %d
})"},
    {"two max_pool2d of int8, 1x32x32x16", R"(graph pools {
  input %a : i8[1,32,32,16]
  %b = max_pool2d %a {kernel=[2,2], stride=[2,2], pad=[0,0,0,0]} : i8[1,16,16,16]
  %c = max_pool2d %b {kernel=[2,2], stride=[2,2], pad=[0,0,0,0]} : i8[1,8,8,16]
  return %c
})"},
};
constexpr uint32_t kSmallRuns = 200;  ///< of a turn

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

/// Both sides at their turns: medians in microseconds of a run, and that of the turns' ratios.
Result<Json> by_turns(NativeNetwork& native, NetworkRun& package, uint32_t turns, uint32_t runs) {
  const auto package_us = [&]() -> Result<double> {
    const auto begin = std::chrono::steady_clock::now();
    SHALE_TRY_VOID(package.run());
    return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin)
        .count();
  };
  std::vector<double> layer, own, ratios;
  for (uint32_t turn = 0; turn <= turns; ++turn) {  // the first one warms caches and compiles
    if (interrupted()) return bad_input("", "interrupted");
    double layer_us = 0, own_us = 0;
    for (uint32_t i = 0; i < runs; ++i) {
      SHALE_TRY(const double us, native.run());
      layer_us += us / runs;
    }
    for (uint32_t i = 0; i < runs; ++i) {
      SHALE_TRY(const double us, package_us());
      own_us += us / runs;
    }
    if (turn == 0) continue;
    layer.push_back(layer_us);
    own.push_back(own_us);
    ratios.push_back(layer_us / own_us);
  }
  if (native.outputs() != package.outputs())
    return bad_input("", "the layer's outputs are not those of the package");
  return Json{{"layer_us", median(layer)}, {"package_us", median(own)}, {"ratio", median(ratios)}};
}

std::vector<Tensor> inputs_of(const Graph& graph) {
  std::vector<Tensor> inputs;
  for (const ValueId id : graph.inputs) {
    Tensor& input = inputs.emplace_back(Tensor::zeros(graph.value(id).type));
    for (size_t i = 0; i < input.bytes.size(); ++i) input.bytes[i] = static_cast<uint8_t>(37 * i);
  }
  return inputs;
}

Result<Json> compare(const NativeDevice& native, const ToolDevice& device, const Graph& graph,
                     const Package& package, const Arguments& arguments, uint32_t runs) {
  const std::vector<Tensor> inputs = inputs_of(graph);
  SHALE_TRY(NativeNetwork network, native.load(graph, inputs));
  SHALE_TRY(NetworkRun own, NetworkRun::create(device, package, inputs));
  return by_turns(network, own, arguments.repeat, runs);
}

Result<int> run(const Arguments& arguments) {
  SHALE_TRY(NativeDevice native, NativeDevice::open(arguments.device));
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  const DeviceCaps& caps = device.context().caps;
  Json json{{"device", caps.name},
            {"driver", caps.driver},
            {"processor", vk::processor_model()},
            {"networks", Json::object()},
            {"small", Json::object()}};
  for (const std::string& path : arguments.models) {
    SHALE_TRY(const ModelFiles model,
              load_model(path, arguments.compile.frame, arguments.compile.precision));
    SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
    SHALE_TRY(const Graph graph, shaped_graph(model.bytes, options));
    SHALE_TRY(const Compiled compiled, compile_model(model, options));
    SHALE_TRY(json["networks"][model.name],
              compare(native, device, graph, compiled.package, arguments, 1));
  }
  for (const SmallGraph& small : kSmallGraphs) {
    SHALE_TRY(const Graph graph, parse_text(small.text));
    CompileOptions options;
    options.expected_runs = kRunsOfFrame;
    options.targets = {"device"};
    options.profiles.emplace("device", profile_from_caps(caps));
    SHALE_TRY(const Compiled compiled, compile_graph(graph, 0, options));
    SHALE_TRY(json["small"][small.name],
              compare(native, device, graph, compiled.package, arguments, kSmallRuns));
  }
  SHALE_TRY_VOID(native.close());
  SHALE_TRY_VOID(device.close());
  if (arguments.json) {
    print_json(json);
    return kDone;
  }
  fmt::print(
      "{} ({}) on {}, medians of {} turns\n\n"
      "| | layer | package | ratio |\n|---|---:|---:|---:|\n",
      caps.name, caps.driver, vk::processor_model(), arguments.repeat);
  for (const auto& [name, one] : json["networks"].items())
    fmt::print("| {} | {:.1f} ms | {:.1f} ms | {:.3f} |\n", name,
               1e-3 * one["layer_us"].get<double>(), 1e-3 * one["package_us"].get<double>(),
               one["ratio"].get<double>());
  for (const auto& [name, one] : json["small"].items())
    fmt::print("| {} | {:.0f} a second | {:.0f} a second | {:.3f} |\n", name,
               1e6 / one["layer_us"].get<double>(), 1e6 / one["package_us"].get<double>(),
               one["ratio"].get<double>());
  return kDone;
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  using namespace shale;
  CLI::App app{"Networks by the layer's data graph pipelines and by packages, by turns"};
  Arguments arguments;
  app.add_option("models", arguments.models, "model folders or .tosa files");
  app.add_option("--repeat", arguments.repeat, "turns; times are the median")
      ->check(CLI::Range(1, 10000));
  arguments.compile.add_to(app, &arguments.device);
  add_device_options(app, arguments.device);
  app.add_flag("--json", arguments.json, "print the result as JSON");
  app.footer("Example: layer_bench models/nss_v1_high models/nss_v0_1 --render 960x540");
  CLI11_PARSE(app, argc, argv);
  setenv("VK_LAYER_PATH", SHALE_LAYER_FOLDER, 0);
  setenv("VK_INSTANCE_LAYERS", "VK_LAYER_SHALE_data_graph", 0);
  setenv("SHALE_LAYER_OPTIONS", "compile=at-once", 0);
  const Result<int> result = run(arguments);
  if (result) return *result;
  print_error(result.error());
  return kRefused;
}
