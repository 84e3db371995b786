// The part of shale report that judges models: operators, the modelled device, what fits.
#include <algorithm>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tools/shale/frame_cost.h"
#include "tools/shale/report.h"

namespace shale {
namespace {

// Operators.

Json op_json(const OpCost& cost) {
  return {{"nodes", cost.nodes},
          {"parameters", cost.parameters},
          {"macs", cost.macs},
          {"ops", cost.ops},
          {"bytes_read", cost.bytes_read},
          {"bytes_written", cost.bytes_written}};
}

uint64_t count_of(const Json& json, const char* key) { return json[key].get<uint64_t>(); }

void print_count(const char* label, uint64_t count, uint64_t pixels, const std::string& more) {
  const std::string per_pixel =
      pixels > 0 ? per_pixel_text(static_cast<double>(count) / static_cast<double>(pixels)) +
                       " per input pixel"
                 : "";
  fmt::print("  {:<12}{:>20}{}{}\n", label, grouped(count),
             per_pixel.empty() ? "" : "   " + per_pixel, more);
}

// The modelled device.

Json constant_json(const Constant& constant) {
  return {{"value", constant.value},
          {"unit", std::string(constant.unit)},
          {"source", std::string(constant.source)}};
}

Json device_json(const ModelledDevice& device) {
  Json json{{"name", device.name},
            {"help", device.help},
            {"tops", constant_json(device.tops)},
            {"efficiency", constant_json(device.efficiency)},
            {"other_gops", constant_json(device.other_gops)},
            {"shader_gops", constant_json(device.shader_gops)},
            {"memory_gbps", constant_json(device.memory_gbps)},
            {"cache_bytes", constant_json(device.cache_bytes)},
            {"dispatch_us", constant_json(device.dispatch_us)},
            {"other_pj", constant_json(device.other_pj)},
            {"memory_pj", constant_json(device.memory_pj)},
            {"cache_pj", constant_json(device.cache_pj)}};
  for (size_t i = 0; i < kPrecisionCount; ++i) {
    const std::string name(precision_name(static_cast<Precision>(i)));
    json["rate"][name] = constant_json(device.rate.at(i));
    json["product_pj"][name] = constant_json(device.product_pj.at(i));
  }
  return json;
}

Json network_json(const ModelledNetwork& network, const ModelledDevice& device) {
  Json json{{"device", device_json(device)},
            {"time_ms", 1e-3 * network.time_us},
            {"gop", 2 * giga(network.macs)},
            {"memory_mb", 1e-6 * network.memory_bytes},
            {"energy_mj", 1e-3 * network.energy_uj},
            {"arena_bytes", network.arena_bytes},
            {"arena_lower_bound_bytes", network.arena_lower_bound_bytes}};
  double compute = 0, memory = 0;
  size_t memory_bound = 0;
  json["dispatches"] = Json::array();
  for (const ModelledDispatch& dispatch : network.dispatches) {
    compute += dispatch.compute_us;
    memory += dispatch.memory_us;
    memory_bound += dispatch.memory_bound();
    json["dispatches"].push_back({{"name", dispatch.name},
                                  {"op", dispatch.op},
                                  {"precision", precision_name(dispatch.precision)},
                                  {"macs", dispatch.macs},
                                  {"ops", dispatch.ops},
                                  {"tile_height", dispatch.tile.height},
                                  {"tile_width", dispatch.tile.width},
                                  {"halo", dispatch.tile.halo},
                                  {"bytes", dispatch.bytes},
                                  {"memory_bytes", dispatch.memory_bytes},
                                  {"compute_us", dispatch.compute_us},
                                  {"memory_us", dispatch.memory_us},
                                  {"dispatch_us", dispatch.dispatch_us},
                                  {"time_us", dispatch.time_us},
                                  {"bound", dispatch.memory_bound() ? "memory" : "compute"},
                                  {"ops_per_byte", finite_json(dispatch.intensity())},
                                  {"energy_uj", dispatch.energy_uj},
                                  {"live_bytes", dispatch.live_bytes}});
  }
  json["compute_ms"] = 1e-3 * compute;
  json["memory_ms"] = 1e-3 * memory;
  json["memory_bound"] = memory_bound;
  return json;
}

/// The passes' time is stated for a picture of this size, and grows with its pixels.
constexpr double kStatedPixels = 1920.0 * 1080.0;

/// What --passes-ms or the paper states for the passes of a frame of this size.
double stated_ms(FrameExtent output, double at_stated_size) {
  return at_stated_size * output.width * output.height / kStatedPixels;
}

/// Time of a whole frame; that of the passes as given, or as modelled.
Result<double> frame_ms(const FrameCost& cost, FrameExtent render, FrameExtent output,
                        const ModelledDevice& device, const ReportArguments& arguments) {
  SHALE_TRY(const FrameCost::Modelled at, cost.at({render, output}, device));
  const double passes_ms =
      arguments.passes_ms ? stated_ms(output, *arguments.passes_ms) : 1e-3 * at.frame.passes_us;
  return passes_ms + 1e-3 * at.frame.network_us;
}

uint32_t divided(uint32_t side, double ratio) {
  return static_cast<uint32_t>(std::ceil(side / ratio - 1e-9));
}

Json extent_json(FrameExtent extent) { return Json::array({extent.width, extent.height}); }

/// Rendered pictures of 16:9: 960x540 is the fifteenth.
FrameExtent step_of(uint32_t k) { return {64 * k, 36 * k}; }

/// The largest result at the frame's ratio, and the least ratio at its size, that fit the budget.
Result<Json> what_fits(const ModelFiles& model, const CompileOptions& options,
                       const FrameCost& cost, const ModelledDevice& device,
                       const ReportArguments& arguments) {
  SHALE_TRY(const auto sizes, frame_sizes(*model.frame, options.sizes));
  const FrameExtent output = sizes.second;
  const double ratio = static_cast<double>(output.width) / sizes.first.width;
  const auto output_of = [&](FrameExtent render) {
    return FrameExtent{static_cast<uint32_t>(std::lround(render.width * ratio)),
                       static_cast<uint32_t>(std::lround(render.height * ratio))};
  };
  Json json{{"ratio", ratio}, {"output", extent_json(output)}};
  // Time grows with the picture, so the largest is found by halving.
  uint32_t fitting = 0, above = static_cast<uint32_t>(kMaxImageExtent / (64 * ratio)) + 1;
  while (above - fitting > 1) {
    const uint32_t middle = (fitting + above) / 2;
    const FrameExtent render = step_of(middle);
    SHALE_TRY(const double time, frame_ms(cost, render, output_of(render), device, arguments));
    (time <= arguments.budget.frame_ms ? fitting : above) = middle;
  }
  const bool any = fitting > 0;
  json["largest_output"] = any ? extent_json(output_of(step_of(fitting))) : Json(nullptr);
  json["largest_render"] = any ? extent_json(step_of(fitting)) : Json(nullptr);
  constexpr double kRatios[] = {1, 1.25, 1.5, 1.75, 2, 2.25, 2.5, 3, 3.5, 4, 5, 6, 8};
  json["least_ratio"] = nullptr;
  for (const double by : kRatios) {
    const FrameExtent render{divided(output.width, by), divided(output.height, by)};
    CompileOptions tried = options;
    tried.sizes = {render, output};
    if (!frame_sizes(*model.frame, tried.sizes)) continue;
    SHALE_TRY(const double time, frame_ms(cost, render, output, device, arguments));
    if (time > arguments.budget.frame_ms) continue;
    json["least_ratio"] = by;
    break;
  }
  return json;
}

/// What of the device, the network or the passes alone would have to become for the frame to fit.
Json needs_json(const ModelledNetwork& network, const ModelledDevice& device,
                const Budget& budget) {
  const double left_us = 1e3 * (budget.frame_ms - budget.passes_ms);
  /// Time with products `speed` times as fast.
  const auto time_us = [&](double speed) {
    double sum = 0;
    for (const ModelledDispatch& dispatch : network.dispatches)
      sum += std::max(dispatch.product_us / speed + dispatch.compute_us - dispatch.product_us,
                      dispatch.memory_us) +
             dispatch.dispatch_us;
    return sum;
  };
  constexpr double kFastest = 1e6;
  Json json{{"passes_ms", budget.frame_ms - 1e-3 * network.time_us},
            {"frame_ms", budget.passes_ms + 1e-3 * network.time_us}};
  if (json["passes_ms"].get<double>() < 0) json["passes_ms"] = nullptr;
  if (time_us(kFastest) > left_us) {
    json["tops"] = json["efficiency"] = nullptr;  // memory and dispatches alone take too long
    return json;
  }
  double slow = 1 / kFastest, fast = kFastest;
  for (int i = 0; i < 200; ++i) {
    const double middle = std::sqrt(slow * fast);
    (time_us(middle) <= left_us ? fast : slow) = middle;
  }
  json["tops"] = device.tops.value * fast;
  const double efficiency = device.efficiency.value * fast;
  json["efficiency"] = efficiency <= 1 ? Json(efficiency) : Json(nullptr);
  return json;
}

void print_frame(const Json& frame, const Budget& budget, bool layers) {
  const auto number = [](const Json& from, const char* key) { return from[key].get<double>(); };
  const double total = number(frame, "total_ms");
  fmt::print("    frame: {:.2f} ms of passes and {:.2f} ms are {:.2f} of {:g} ms: {}\n",
             number(frame, "passes_ms"), number(frame, "network_ms"), total, budget.frame_ms,
             frame["fits"].get<bool>()
                 ? fmt::format("fits, {:.2f} ms to spare", budget.frame_ms - total)
                 : fmt::format("{:.2f} ms too long", total - budget.frame_ms));
  if (frame["passes"].empty()) return;
  if (layers)
    for (const Json& pass : frame["passes"])
      fmt::print("      {:<18} {:.2f} ms, {} bound: {:.1f} MB, {:.2f} GOP of shaders\n",
                 pass["name"].get<std::string>(), number(pass, "time_ms"),
                 pass["bound"].get<std::string>(), number(pass, "memory_mb"), number(pass, "gop"));
  fmt::print("    passes by their traffic and operations; the paper takes {:.2f} ms for them\n",
             number(frame, "stated_passes_ms"));
}

void print_modelled(const Json& json, const Budget& budget, bool layers) {
  const Json& modelled = json["modelled"];
  const Json& device = modelled["device"];
  const auto value = [&](const char* key) { return device[key]["value"].get<double>(); };
  const auto number = [](const Json& from, const char* key) { return from[key].get<double>(); };
  fmt::print("\n  modelled on {}, {} TOP/s at {}, {} GB/s, {:.1f} MiB on chip:\n",
             device["name"].get<std::string>(), value("tops"), percent_text(value("efficiency")),
             value("memory_gbps"), value("cache_bytes") / (1024.0 * 1024.0));
  if (layers) {
    fmt::print("  {:>9}{:>10}{:>10}{:>11}{:>8}{:>9}{:>8}{:>9}  {:<8} {:<18} {}\n", "us", "compute",
               "memory", "MMAC", "MB", "op/byte", "halo", "uJ", "bound", "operator", "dispatch");
    for (const Json& row : modelled["dispatches"])
      fmt::print(
          "  {:>9.1f}{:>10.1f}{:>10.1f}{:>11.2f}{:>8.2f}{:>9}{:>8.3f}{:>9.1f}  {:<8} {:<18} {}\n",
          number(row, "time_us"), number(row, "compute_us"), number(row, "memory_us"),
          1e-6 * number(row, "macs"), 1e-6 * number(row, "memory_bytes"),
          row["ops_per_byte"].is_null() ? "-" : fmt::format("{:.0f}", number(row, "ops_per_byte")),
          number(row, "halo"), number(row, "energy_uj"), row["bound"].get<std::string>(),
          fmt::format("{} {}", row["op"].get<std::string>(), row["precision"].get<std::string>()),
          row["name"].get<std::string>());
  }
  fmt::print(
      "    {} dispatches, {} of them memory-bound: {:.2f} ms; {:.1f} MB from and to memory, {:.1f} "
      "mJ "
      "(estimate), arena {:.2f} MiB\n",
      modelled["dispatches"].size(), modelled["memory_bound"].get<size_t>(),
      number(modelled, "time_ms"), number(modelled, "memory_mb"), number(modelled, "energy_mj"),
      number(modelled, "arena_bytes") / (1024.0 * 1024.0));
  print_frame(json["frame"], budget, layers);
  if (!json["frame"]["fits"].get<bool>()) {
    const Json& needs = json["frame"]["needs"];
    std::vector<std::string> ways;
    if (!needs["tops"].is_null())
      ways.push_back(fmt::format("{:.1f} TOP/s", number(needs, "tops")));
    if (!needs["efficiency"].is_null())
      ways.push_back(percent_text(number(needs, "efficiency")) + " efficiency");
    if (!needs["passes_ms"].is_null())
      ways.push_back(fmt::format("{:.2f} ms of passes", number(needs, "passes_ms")));
    ways.push_back(fmt::format("{:.2f} ms a frame", number(needs, "frame_ms")));
    fmt::print("    would fit with {}\n", fmt::join(ways, ", or "));
  }
  if (!json.contains("fits")) return;
  const Json& fits = json["fits"];
  const auto extent = [](const Json& size) {
    return size.is_null() ? std::string("none")
                          : fmt::format("{}x{}", size[0].get<int>(), size[1].get<int>());
  };
  fmt::print(
      "    largest result that fits at ratio {:g}: {} from {}; least ratio that fits at {}: {}\n",
      number(fits, "ratio"), extent(fits["largest_output"]), extent(fits["largest_render"]),
      extent(fits["output"]),
      fits["least_ratio"].is_null() ? "none" : fmt::format("{:g}", number(fits, "least_ratio")));
}

/// Results of shale bench for the model of that name.
Result<Json> measured_of(const ReportArguments& arguments, const std::string& name) {
  Json found = Json::array();
  for (const std::string& path : arguments.measured) {
    SHALE_TRY(const Json json, read_json(path));
    if (!json.is_object() || !json.contains("models") || !json["models"].is_array())
      return bad_input(path, "is no result of shale bench --json");
    for (const Json& model : json["models"]) {
      const auto is_number = [](const Json& in, const char* key) {
        return in.is_object() && in.contains(key) && in[key].is_number();
      };
      const bool whole =
          model.is_object() && model.contains("model") && model["model"].is_string() &&
          model.contains("inputs") && model.contains("total") &&
          is_number(model["total"], "time_ms") && is_number(model["total"], "predicted_ms") &&
          model.contains("dispatches") && model["dispatches"].is_array() &&
          std::all_of(model["dispatches"].begin(), model["dispatches"].end(), [&](const Json& row) {
            return is_number(row, "time_ms") && is_number(row, "predicted_ms");
          });
      if (!whole) return bad_input(path, "a model has no times beside predicted ones");
      if (model["model"].get<std::string>() != name) continue;
      Json entry = model;
      entry["on"] = json.value("device", Json(""));
      found.push_back(std::move(entry));
    }
  }
  return found;
}

}  // namespace

Json graph_json(const Graph& graph, const ReportArguments& arguments) {
  OpCost total;
  const std::map<std::string, OpCost> operators = cost_by_operator(graph);
  for (const auto& [name, cost] : operators) {
    total.nodes += cost.nodes;
    total.parameters += cost.parameters;
    total.macs += cost.macs;
    total.ops += cost.ops;
    total.bytes_read += cost.bytes_read;
    total.bytes_written += cost.bytes_written;
  }
  Json json = op_json(total);
  json["gop"] = 2 * giga(total.macs);
  const uint64_t counter = counter_operations(graph);
  if (arguments.convention == "counter_a") json["counter_operations"] = counter;
  // Pixels are counted on the first NHWC input.
  for (const ValueId id : graph.inputs) {
    const Value& input = graph.value(id);
    if (input.type.shape.size() != 4) continue;
    const Shape& shape = input.type.shape;
    const uint64_t pixels = static_cast<uint64_t>(shape[0] * shape[1] * shape[2]);
    json["input"] = fmt::format("{} {}", input.name, type_text(input.type));
    json["input_pixels"] = pixels;
    json["macs_per_pixel"] = static_cast<double>(total.macs) / static_cast<double>(pixels);
    if (arguments.convention == "counter_a")
      json["counter_operations_per_pixel"] =
          static_cast<double>(counter) / static_cast<double>(pixels);
    break;
  }
  for (const auto& [name, cost] : operators) json["operators"][name] = op_json(cost);
  json["budget"] = verdict_json(judge(total.macs, arguments.budget), arguments.budget);
  return json;
}

void print_graph(const Json& json, const ReportArguments& arguments) {
  const uint64_t pixels = json.contains("input") ? count_of(json, "input_pixels") : 0;
  const uint64_t macs = count_of(json, "macs");
  if (pixels > 0)
    fmt::print("  {:<12}{:>20}   {} pixels\n", "input", json["input"].get<std::string>(),
               grouped(pixels));
  print_count("parameters", count_of(json, "parameters"), 0, "");
  print_count("MACs", macs, pixels, fmt::format("   {:.3f} GOP", 2 * giga(macs)));
  if (arguments.convention == "counter_a")
    print_count("counter_A", count_of(json, "counter_operations"), pixels,
                fmt::format("   {:.3f} G", giga(count_of(json, "counter_operations"))));
  print_count("bytes moved", count_of(json, "bytes_read") + count_of(json, "bytes_written"), 0,
              "   each operator on its own, nothing fused");
  fmt::print("\n  {:<18}{:>6}{:>12}{:>16}{:>16}{:>15}{:>15}\n", "operator", "nodes", "parameters",
             "MACs", "other ops", "bytes read", "bytes written");
  const auto line = [](const std::string& name, const Json& cost) {
    fmt::print("  {:<18}{:>6}{:>12}{:>16}{:>16}{:>15}{:>15}\n", name, count_of(cost, "nodes"),
               grouped(count_of(cost, "parameters")), grouped(count_of(cost, "macs")),
               grouped(count_of(cost, "ops")), grouped(count_of(cost, "bytes_read")),
               grouped(count_of(cost, "bytes_written")));
  };
  const Json operators = json.value("operators", Json::object());
  for (const auto& [name, cost] : operators.items()) line(name, cost);
  line("total", json);
  fmt::print("\n");
  print_verdict(judge(macs, arguments.budget), arguments.budget, 2 * giga(macs));
}

Result<Json> report_model(const std::string& path, const ReportArguments& given) {
  SHALE_TRY(const ModelFiles model, load_model(path, given.compile.frame, given.compile.precision));
  const auto named = [&](const Error& error) { return in_file(model.path, error); };
  const Result<CompileOptions> options = given.compile.options(model);
  if (!options) return options.error();
  const ModelledDevice* known = find_modelled_device(given.device);
  if (!known) {
    std::string names;
    for (const ModelledDevice& device : modelled_devices())
      names += (names.empty() ? "" : ", ") + std::string(device.name);
    return bad_input("--device", "\"{}\" is unknown, expected one of: {}", given.device, names);
  }
  const ModelledDevice device = with_options(*known, given.model);
  Json json{{"model", model.name}};

  // The frame first: the network gets what its passes leave.
  ReportArguments arguments = given;
  Budget& budget = arguments.budget;
  SHALE_TRY(const FrameCost cost, FrameCost::create(model, *options));
  const Result<FrameCost::Modelled> modelled = cost.at(options->sizes, device);
  if (!modelled) return named(modelled.error());
  const ModelledFrame& frame = modelled->frame;
  double stated = given.passes_ms.value_or(budget.passes_ms);
  if (model.frame) {
    SHALE_TRY(const auto sizes, frame_sizes(*model.frame, options->sizes));
    json["render"] = extent_json(sizes.first);
    json["output"] = extent_json(sizes.second);
    stated = stated_ms(sizes.second, stated);
  }
  budget.passes_ms = model.frame && !given.passes_ms ? 1e-3 * frame.passes_us : stated;
  const double network_ms = 1e-3 * frame.network_us, total_ms = budget.passes_ms + network_ms;
  json["frame"] = {{"passes_ms", budget.passes_ms}, {"stated_passes_ms", stated},
                   {"network_ms", network_ms},      {"total_ms", total_ms},
                   {"frame_ms", budget.frame_ms},   {"fits", total_ms <= budget.frame_ms},
                   {"passes", passes_json(frame)}};
  if (!modelled->network) {
    json["macs"] = 0;
    json["gop"] = 0.0;
    if (!arguments.quiet) {
      fmt::print("{}\n  no network: passes alone\n", path);
      print_frame(json["frame"], budget, arguments.layers);
    }
    return json;
  }
  const ModelledNetwork& network = *modelled->network;
  Result<Graph> graph = shaped_graph(model.bytes, *options);
  if (!graph) return named(graph.error());
  json.update(graph_json(*graph, arguments));
  json["modelled"] = network_json(network, device);
  json["frame"]["needs"] = needs_json(network, device, budget);
  if (model.frame &&
      std::any_of(model.frame->tensors.begin(), model.frame->tensors.end(),
                  [](const FrameTensor& tensor) { return tensor.size.has_value(); })) {
    Result<Json> fits = what_fits(model, *options, cost, device, arguments);
    if (!fits) return named(fits.error());
    json["fits"] = *std::move(fits);
  }
  if (!arguments.measured.empty()) {
    SHALE_TRY(json["measured"], measured_of(arguments, model.name));
  }
  if (!arguments.quiet) {
    fmt::print("{}\n", path);
    print_graph(json, arguments);
    print_modelled(json, budget, arguments.layers);
  }
  return json;
}

}  // namespace shale
