// shale bench: networks on the device, against its roof and against the naive kernel; and how long a
// start takes.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "runtime/vk/processor.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/roof.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::vector<std::string> models;
  CompileArguments compile;
  DeviceArguments device;
  uint32_t repeat = 7;
  bool naive = false, start = false, markdown = false, json = false;
};

/// A prediction within this share of the measured time is close.
constexpr double kClose = 0.25;

double elapsed_ms(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
      .count();
}

std::vector<Tensor> inputs_of(const Variant& variant) {
  std::vector<Tensor> inputs;
  for (const Resource* resource : tensors_of(variant, Category::kInput)) {
    Tensor& tensor = inputs.emplace_back(Tensor::zeros({resource->dtype, resource->shape}));
    // Any values do: no kernel's time hangs on them.
    for (size_t i = 0; i < tensor.bytes.size(); ++i) tensor.bytes[i] = static_cast<uint8_t>(37 * i);
  }
  return inputs;
}

const Segment& graph_of(const Variant& variant) {
  return *std::find_if(variant.segments.begin(), variant.segments.end(),
                       [](const Segment& s) { return s.kind == SegmentKind::kGraph; });
}

/// A folder for Mesa's shader cache, empty at first, that goes with the object. Other drivers do not
/// look at the variable.
class ColdCache {
 public:
  ColdCache() {
    std::string name = (fs::temp_directory_path() / "shale-bench-XXXXXX").string();
    if (mkdtemp(name.data())) folder_ = name;
    if (!folder_.empty()) setenv("MESA_SHADER_CACHE_DIR", folder_.c_str(), 1);
  }
  ~ColdCache() {
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
  }
  ColdCache(const ColdCache&) = delete;
  ColdCache& operator=(const ColdCache&) = delete;
  std::string pipeline_file() const { return folder_.empty() ? "" : folder_ + "/pipelines"; }

 private:
  std::string folder_;
};

/// Creates everything and runs once, on a device of its own.
Result<StartTimes> start_once(DeviceArguments arguments, const ColdCache& cache,
                              const Package& package, const std::vector<Tensor>& inputs) {
  arguments.cache = cache.pipeline_file();
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments));
  StartTimes times;
  const auto begin = std::chrono::steady_clock::now();
  {
    SHALE_TRY(NetworkRun network,
              NetworkRun::create(device, package, inputs, &times, Compile::kInBackground));
    SHALE_TRY(const std::vector<Tensor> first, run_repeatedly(network, 1, nullptr, &times));
    SHALE_TRY_VOID(network.finish());
    SHALE_TRY_VOID(network.run());
    if (network.outputs() != first)
      return bad_input("", "the kernels of the start give another result");
  }
  times.full_ms =
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
  SHALE_TRY_VOID(device.close());
  return times;
}

Json start_json(const StartTimes& times) {
  return {{"create_ms", times.create_ms},
          {"first_run_ms", times.first_ms},
          {"full_speed_ms", times.full_ms}};
}

/// A roof that moves by more than this between runs is no measure.
constexpr double kSteady = 1.3;

Result<Json> bench(const Arguments& arguments, const ToolDevice& device, const ModelFiles& model) {
  SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
  const auto begin = std::chrono::steady_clock::now();
  SHALE_TRY(const Compiled compiled, compile_model(model, options));
  const double compile_ms = elapsed_ms(begin);
  const Package& package = compiled.package;
  const Variant& variant = package.variants.front();
  const std::vector<Tensor> inputs = inputs_of(variant);

  Json json{{"model", model.name}, {"target", variant.target}};
  for (const Tensor& input : inputs) json["inputs"].push_back(input.type.shape);
  json["compile_ms"] = compile_ms;
  json["package_bytes"] = write_package(package).size();
  json["arena_bytes"] = variant.arena_bytes;
  json["arena_lower_bound_bytes"] = compiled.arena_lower_bound_bytes;
  if (arguments.start) {
    const ColdCache cache;
    SHALE_TRY(const StartTimes first, start_once(arguments.device, cache, package, inputs));
    SHALE_TRY(const StartTimes second, start_once(arguments.device, cache, package, inputs));
    json["first_start"] = start_json(first);
    json["second_start"] = start_json(second);
  }
  std::vector<DispatchTime> times, naive_times;
  SHALE_TRY(RoofedTimes measured, measure_under_roof(device, package, inputs, arguments.repeat));
  times = std::move(measured.times);
  const std::vector<Tensor>& outputs = measured.outputs;
  const double roof = measured.roof;
  json["roof_gop_per_s"] = roof;
  json["roof_swing"] = measured.roof_swing;
  if (arguments.naive) {
    CompileOptions naive = options;
    naive.kernels = {"generic"};
    naive.choices.clear();
    SHALE_TRY(const Compiled generic, compile_model(model, naive));
    SHALE_TRY(const std::vector<Tensor> expected,
              run_network(device, generic.package, inputs, 1, &naive_times));
    // Sums of floats may differ in their last bits.
    for (size_t i = 0; i < outputs.size() && !has_reals(compiled.graph); ++i)
      if (outputs[i] != expected[i])
        return bad_input(model.path, "the naive kernels give another result");
  }
  const auto naive_us = [&](const std::string& name) {
    double sum = 0;  // a layer may be several dispatches
    for (const DispatchTime& time : naive_times)
      if (time.name == name || time.name.starts_with(name + "#")) sum += time.time_us;
    return sum;
  };
  // The machine's speed moves with its clock and its neighbours: predictions follow the roof.
  const DeviceProfile& profile = *find_profile(variant.target);
  const auto measured_constants = options.constants.find(variant.target);
  const double profile_roof = measured_constants != options.constants.end()
                                  ? measured_constants->second.roof_gops
                                  : profile.roof_gops;
  const double at_roof = profile_roof > 0 ? profile_roof / roof : 1;
  double layers_us = 0, total_naive_us = 0, total_gop = 0, predicted_us = 0, close_us = 0;
  const std::vector<Dispatch>& dispatches = graph_of(variant).dispatches;
  for (size_t i = 0; i < dispatches.size(); ++i) {
    const double gop = 2e-9 * static_cast<double>(dispatches[i].cost.macs);
    const double rate = 1e6 * gop / std::max(times[i].time_us, 1e-3);
    Json& row = json["dispatches"].emplace_back(Json{{"name", dispatches[i].name},
                                                     {"kernel", dispatches[i].kernel},
                                                     {"time_ms", 1e-3 * times[i].time_us},
                                                     {"gop", gop},
                                                     {"gop_per_s", rate},
                                                     {"share_of_roof", rate / roof}});
    const double predicted = at_roof * dispatches[i].cost.time_us;
    row["predicted_ms"] = 1e-3 * predicted;
    for (size_t k = 0; k < kWorkCount; ++k)
      if (const double amount = compiled.work.front()[i].at(k); amount > 0)
        row["work"][work_info(static_cast<Work>(k)).name] = amount;
    layers_us += times[i].time_us;
    total_gop += gop;
    predicted_us += predicted;
    if (std::abs(predicted - times[i].time_us) <= kClose * times[i].time_us)
      close_us += times[i].time_us;
    if (!arguments.naive) continue;
    const double other = naive_us(dispatches[i].name);
    row["naive_ms"] = 1e-3 * other;
    row["times_naive"] = other / std::max(times[i].time_us, 1e-3);
    total_naive_us += other;
  }
  // The layers' times in sum hold what timestamps between them cost.
  const double total_us = measured.whole_us, rate = 1e6 * total_gop / total_us;
  json["total"] = {{"time_ms", 1e-3 * total_us},
                   {"layers_ms", 1e-3 * layers_us},
                   {"gop", total_gop},
                   {"gop_per_s", rate},
                   {"share_of_roof", rate / roof},
                   {"predicted_ms", 1e-3 * predicted_us},
                   {"close_share", close_us / layers_us}};
  if (arguments.naive) {
    json["total"]["naive_ms"] = 1e-3 * total_naive_us;
    json["total"]["times_naive"] = total_naive_us / total_us;
  }
  return json;
}

/// A line of the table: plain, or with bars between for Markdown.
void print_row(bool markdown, const std::string& name, const std::string& kernel, const Json& row) {
  const auto number = [&](const char* key, double factor, const char* unit, int digits) {
    return row.contains(key)
               ? fmt::format("{:.{}f}{}", factor * row[key].get<double>(), digits, unit)
               : std::string();
  };
  const char* form = markdown ? "| {} | {} | {} | {} | {} | {} | {} |\n"
                              : "  {:<14} {:<20} {:>10} {:>10} {:>8} {:>8} {:>8}\n";
  fmt::print(fmt::runtime(form), name, kernel, number("time_ms", 1, markdown ? "" : " ms", 2),
             number("predicted_ms", 1, markdown ? "" : " ms", 2), number("gop_per_s", 1, "", 1),
             number("share_of_roof", 100, " %", 0), number("times_naive", 1, "x", 1));
}

void print_model(const Json& json, bool markdown) {
  std::string inputs;
  for (const Json& shape : json["inputs"]) inputs += " " + shape.dump();
  fmt::print("{}{}{}:\n\n", markdown ? "\n### " : "\n", json["model"].get<std::string>(), inputs);
  fmt::print("{}", markdown ? "| layer | kernel | ms | predicted | GOP/s | of roof | naive "
                              "|\n|---|---|---:|---:|---:|---:|---:|\n"
                            : "  layer          kernel                     time  predicted    "
                              "GOP/s  of roof    naive\n");
  for (const Json& row : json["dispatches"])
    print_row(markdown, row["name"].get<std::string>(), row["kernel"].get<std::string>(), row);
  print_row(markdown, "total", fmt::format("{} dispatches", json["dispatches"].size()),
            json["total"]);
  fmt::print("\nroof before and after, float32 mul+add: {:.1f} GOP/s\n",
             json["roof_gop_per_s"].get<double>());
  if (const double swing = json["roof_swing"].get<double>(); swing > kSteady)
    fmt::print(
        "the roof moved by a factor of {:.1f} between runs: other work is on the machine, and the "
        "times "
        "are not to be trusted\n",
        swing);
  fmt::print(
      "predicted {:+.0f} % in all; {:.0f} % of the time in layers predicted within {:.0f} %\n",
      100 * (json["total"]["predicted_ms"].get<double>() / json["total"]["time_ms"].get<double>() -
             1),
      100 * json["total"]["close_share"].get<double>(), 100 * kClose);
  const double arena = json["arena_bytes"].get<double>();
  const double least = json["arena_lower_bound_bytes"].get<double>();
  fmt::print("compiled in {:.0f} ms to {:.2f} MB; {}\n", json["compile_ms"].get<double>(),
             1e-6 * json["package_bytes"].get<double>(),
             least == 0 ? "no arena"
                        : fmt::format("arena {:.0f} bytes, {:.1f} % above the bound", arena,
                                      100 * (arena / least - 1)));
  for (const auto& [key, label] : {std::pair{"first_start", "first start, caches empty"},
                                   std::pair{"second_start", "second start, caches warm"}})
    if (json.contains(key))
      fmt::print(
          "{}: {:.0f} ms for the pipelines, {:.0f} ms for the first run, full speed after {:.0f} "
          "ms\n",
          label, json[key]["create_ms"].get<double>(), json[key]["first_run_ms"].get<double>(),
          json[key]["full_speed_ms"].get<double>());
}

Result<int> run(const Arguments& arguments) {
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  const DeviceCaps& caps = device.context().caps;
  Json json{{"device", caps.name},
            {"driver", caps.driver},
            {"processor", vk::processor_model()},
            {"repeat", arguments.repeat}};
  // What cannot be read is named before minutes are spent on what can.
  std::vector<ModelFiles> models;
  for (const std::string& path : arguments.models) {
    SHALE_TRY(ModelFiles model,
              load_model(path, arguments.compile.frame, arguments.compile.precision));
    models.push_back(std::move(model));
  }
  SHALE_TRY(const std::vector<Roof> roofs, measure_roofs(device, arguments.repeat));
  for (const Roof& roof : roofs)
    json["roofs"].push_back({{"name", roof.name}, {"rate", roof.rate}, {"unit", roof.unit}});
  json["models"] = Json::array();
  for (const ModelFiles& model : models) {
    SHALE_TRY(Json one, bench(arguments, device, model));
    json["models"].push_back(std::move(one));
    if (interrupted()) return bad_input("", "interrupted");
  }
  SHALE_TRY_VOID(device.close());
  if (arguments.json) {
    print_json(json);
    return kDone;
  }
  fmt::print("{}{} ({}) on {}, medians of {}\n\n", arguments.markdown ? "## " : "", caps.name,
             caps.driver, vk::processor_model(), arguments.repeat);
  if (arguments.markdown) fmt::print("| roof | rate |\n|---|---:|\n");
  for (const Roof& roof : roofs)
    fmt::print("{}", arguments.markdown
                         ? fmt::format("| {} | {:.1f} {} |\n", roof.name, roof.rate, roof.unit)
                         : fmt::format("  {:<22} {:>8.1f} {}\n", roof.name, roof.rate, roof.unit));
  for (const Json& model : json["models"]) print_model(model, arguments.markdown);
  return kDone;
}

}  // namespace

Action add_bench(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("models", arguments->models,
                 fmt::format("models ({}) or model folders; without any, the device's roofs alone",
                             kModelKinds));
  app.add_option("--repeat", arguments->repeat, "runs; times are the median")
      ->check(CLI::Range(1, 10000));
  app.add_flag("--naive", arguments->naive,
               "measure the generic kernels too, once, and compare the results");
  app.add_flag("--start", arguments->start,
               "measure two starts: with empty caches, and with what the first one left");
  arguments->compile.add_to(app, &arguments->device);
  add_device_options(app, arguments->device);
  app.add_flag("--markdown", arguments->markdown, "print Markdown tables");
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer("Example: shale bench models/nss_v1_high --render 960x540 --start");
  return [arguments] { return run(*arguments); };
}

}  // namespace shale
