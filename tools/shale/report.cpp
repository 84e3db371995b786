// shale report: what a network costs, predicted against measured, and the published cost tables.
#include <algorithm>
#include <cmath>
#include <filesystem>

#include "compiler/cost/cost.h"
#include "compiler/cost/layers.h"
#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "ir/verify/verify.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::vector<std::string> files, input_shapes;
  std::string cost_table, row, measured, convention = "mac", precision = "int8";
  uint32_t variant = 0;
  Budget budget;
  bool json = false;
};

/// 5599000000 as "5,599,000,000".
std::string grouped(uint64_t number) {
  std::string text = std::to_string(number);
  for (size_t at = text.size(); at > 3; at -= 3) text.insert(at - 3, ",");
  return text;
}

/// A count per pixel, which is whole for most networks.
std::string per_pixel_text(double count) {
  if (count == std::floor(count) && count < 1e15) return grouped(static_cast<uint64_t>(count));
  return fmt::format("{:.2f}", count);
}

std::string percent_text(double share) { return fmt::format("{:.1f} %", 100 * share); }

Json verdict_json(const Verdict& verdict, const Budget& budget) {
  const auto finite = [](double value) {
    return std::isfinite(value) ? Json(value) : Json(nullptr);
  };
  return {{"frame_ms", budget.frame_ms},
          {"passes_ms", budget.passes_ms},
          {"tops", budget.tops},
          {"efficiency", budget.efficiency},
          {"available_gop", verdict.available_gop},
          {"required_efficiency", finite(verdict.required_efficiency)},
          {"required_tops", finite(verdict.required_tops)},
          {"network_ms", verdict.network_ms},
          {"headroom_ms", verdict.headroom_ms},
          {"fits", verdict.fits}};
}

void print_verdict(const Verdict& verdict, const Budget& budget, double gop) {
  const double left_ms = budget.frame_ms - budget.passes_ms;
  fmt::print(
      "  budget: {} ms a frame less {} ms of passes leave {:.2f} ms, {:.2f} GOP at {} TOP/s\n",
      budget.frame_ms, budget.passes_ms, left_ms, verdict.available_gop, budget.tops);
  if (left_ms <= 0) {
    fmt::print("    no time is left for the network: it does not fit\n");
    return;
  }
  fmt::print("    {:.3f} GOP need {} efficiency; at {} they take {:.2f} ms: {:.2f} ms {}\n", gop,
             percent_text(verdict.required_efficiency), percent_text(budget.efficiency),
             verdict.network_ms, std::abs(verdict.headroom_ms),
             verdict.fits ? "to spare, it fits" : "too slow, it does not fit");
}

// A graph.

struct GraphReport {
  std::string input;  ///< name and type of the input that pixels are counted on; empty without an
                      ///< NHWC input
  uint64_t pixels = 0;
  uint64_t counter_operations = 0;
  OpCost total;
  std::map<std::string, OpCost> operators;
};

GraphReport cost_of_graph(const Graph& graph) {
  GraphReport report;
  for (const ValueId id : graph.inputs) {
    const Value& input = graph.value(id);
    if (input.type.shape.size() != 4) continue;
    report.input = fmt::format("{} {}", input.name, type_text(input.type));
    const Shape& shape = input.type.shape;
    report.pixels = static_cast<uint64_t>(shape[0] * shape[1] * shape[2]);
    break;
  }
  report.counter_operations = counter_operations(graph);
  report.operators = cost_by_operator(graph);
  for (const auto& [name, cost] : report.operators) {
    report.total.nodes += cost.nodes;
    report.total.parameters += cost.parameters;
    report.total.macs += cost.macs;
    report.total.ops += cost.ops;
    report.total.bytes_read += cost.bytes_read;
    report.total.bytes_written += cost.bytes_written;
  }
  return report;
}

double giga(uint64_t count) { return 1e-9 * static_cast<double>(count); }

Json op_json(const OpCost& cost) {
  return {{"nodes", cost.nodes},
          {"parameters", cost.parameters},
          {"macs", cost.macs},
          {"ops", cost.ops},
          {"bytes_read", cost.bytes_read},
          {"bytes_written", cost.bytes_written}};
}

Json graph_json(const GraphReport& report, const Arguments& arguments) {
  const Verdict verdict = judge(report.total.macs, arguments.budget);
  Json json = op_json(report.total);
  json["gop"] = 2 * giga(report.total.macs);
  if (arguments.convention == "counter_a") json["counter_operations"] = report.counter_operations;
  if (report.pixels > 0) {
    json["input"] = report.input;
    json["input_pixels"] = report.pixels;
    const double pixels = static_cast<double>(report.pixels);
    json["macs_per_pixel"] = static_cast<double>(report.total.macs) / pixels;
    if (arguments.convention == "counter_a")
      json["counter_operations_per_pixel"] =
          static_cast<double>(report.counter_operations) / pixels;
  }
  for (const auto& [name, cost] : report.operators) json["operators"][name] = op_json(cost);
  json["budget"] = verdict_json(verdict, arguments.budget);
  return json;
}

void print_count(const char* label, uint64_t count, uint64_t pixels, const std::string& more) {
  const std::string per_pixel =
      pixels > 0 ? per_pixel_text(static_cast<double>(count) / static_cast<double>(pixels)) +
                       " per input pixel"
                 : "";
  fmt::print("  {:<12}{:>20}{}{}\n", label, grouped(count),
             per_pixel.empty() ? "" : "   " + per_pixel, more);
}

void print_graph(const GraphReport& report, const Arguments& arguments) {
  if (!report.input.empty())
    fmt::print("  {:<12}{:>20}   {} pixels\n", "input", report.input, grouped(report.pixels));
  print_count("parameters", report.total.parameters, 0, "");
  print_count("MACs", report.total.macs, report.pixels,
              fmt::format("   {:.3f} GOP", 2 * giga(report.total.macs)));
  if (arguments.convention == "counter_a")
    print_count("counter_A", report.counter_operations, report.pixels,
                fmt::format("   {:.3f} G", giga(report.counter_operations)));
  print_count("bytes moved", report.total.bytes_read + report.total.bytes_written, 0,
              "   each operator on its own, nothing fused");
  fmt::print("\n  {:<18}{:>6}{:>12}{:>16}{:>16}{:>15}{:>15}\n", "operator", "nodes", "parameters",
             "MACs", "other ops", "bytes read", "bytes written");
  const auto line = [](const std::string& name, const OpCost& cost) {
    fmt::print("  {:<18}{:>6}{:>12}{:>16}{:>16}{:>15}{:>15}\n", name, cost.nodes,
               grouped(cost.parameters), grouped(cost.macs), grouped(cost.ops),
               grouped(cost.bytes_read), grouped(cost.bytes_written));
  };
  for (const auto& [name, cost] : report.operators) line(name, cost);
  line("total", report.total);
  fmt::print("\n");
  print_verdict(judge(report.total.macs, arguments.budget), arguments.budget,
                2 * giga(report.total.macs));
}

// A package.

/// Times by dispatch name from `shale run --profile-to`.
Result<std::map<std::string, double>> read_measured(const std::string& path) {
  SHALE_TRY(const std::string text, read_text(path));
  const Json json = Json::parse(text, nullptr, false);
  const Error error = bad_input(path, "is no profile; shale run --profile-to writes one");
  if (!json.is_object() || !json.contains("dispatches") || !json["dispatches"].is_array())
    return error;
  std::map<std::string, double> times;
  for (const Json& entry : json["dispatches"]) {
    if (!entry.is_object() || !entry.contains("name") || !entry["name"].is_string()) return error;
    const std::string name = entry["name"].get<std::string>();
    const bool has_time = entry.contains("time_us") && entry["time_us"].is_number();
    const double time_us = has_time ? entry["time_us"].get<double>() : -1;
    if (!(time_us >= 0)) return bad_input(path, "dispatch \"{}\" has no \"time_us\"", name);
    if (!times.emplace(name, time_us).second)
      return bad_input(path, "dispatch \"{}\" is named twice", name);
  }
  return times;
}

struct DispatchReport {
  const Segment* segment;
  const Dispatch* dispatch;
  std::optional<double> measured_us;

  /// Predicted by measured time.
  std::optional<double> ratio() const {
    if (!measured_us || *measured_us <= 0) return std::nullopt;
    return dispatch->cost.time_us / *measured_us;
  }
};

struct PackageReport {
  const Variant* variant;
  std::vector<DispatchReport> dispatches;
  std::vector<std::string> unknown;  ///< measured, but not in the package
  Cost total;
  uint64_t network_macs = 0;              ///< without the passes around the network
  size_t joined = 0;                      ///< dispatches that have both times
  double joined_us = 0, measured_us = 0;  ///< predicted and measured, of those
};

Result<PackageReport> cost_of_package(const Package& package, const Arguments& arguments) {
  if (arguments.variant >= package.variants.size())
    return bad_input("--variant", "found {}, the package has {}", arguments.variant,
                     package.variants.size());
  std::map<std::string, double> measured;
  if (!arguments.measured.empty()) {
    SHALE_TRY(measured, read_measured(arguments.measured));
  }
  PackageReport report{.variant = &package.variants[arguments.variant],
                       .dispatches = {},
                       .unknown = {},
                       .total = {}};
  for (const Segment& segment : report.variant->segments) {
    for (const Dispatch& dispatch : segment.dispatches) {
      DispatchReport row{&segment, &dispatch, std::nullopt};
      if (const auto time = measured.find(dispatch.name); time != measured.end()) {
        row.measured_us = time->second;
        report.joined_us += dispatch.cost.time_us;
        report.measured_us += time->second;
        measured.erase(time);
        ++report.joined;
      }
      report.dispatches.push_back(row);
      report.total.macs += dispatch.cost.macs;
      report.total.ops += dispatch.cost.ops;
      report.total.bytes_read += dispatch.cost.bytes_read;
      report.total.bytes_written += dispatch.cost.bytes_written;
      report.total.time_us += dispatch.cost.time_us;
      if (segment.kind == SegmentKind::kGraph) report.network_macs += dispatch.cost.macs;
    }
  }
  if (!arguments.measured.empty() && report.joined == 0)
    return bad_input(arguments.measured,
                     "names no dispatch of this package; was it measured with another one?");
  for (const auto& [name, time_us] : measured) report.unknown.push_back(name);
  return report;
}

Json package_json(const PackageReport& report, const Arguments& arguments) {
  const auto cost_json = [](const Cost& cost) -> Json {
    return {{"macs", cost.macs},
            {"ops", cost.ops},
            {"bytes_read", cost.bytes_read},
            {"bytes_written", cost.bytes_written},
            {"time_us", cost.time_us}};
  };
  Json json{{"variant", arguments.variant},
            {"target", report.variant->target},
            {"arena_bytes", report.variant->arena_bytes}};
  json.update(cost_json(report.total));
  json["network_macs"] = report.network_macs;
  json["gop"] = 2 * giga(report.network_macs);
  json["dispatches"] = Json::array();
  for (const DispatchReport& row : report.dispatches) {
    Json entry{{"name", row.dispatch->name},
               {"segment", row.segment->name},
               {"kernel", row.dispatch->kernel}};
    entry.update(cost_json(row.dispatch->cost));
    if (row.measured_us) entry["measured_us"] = *row.measured_us;
    if (row.ratio()) entry["ratio"] = *row.ratio();
    json["dispatches"].push_back(std::move(entry));
  }
  if (!arguments.measured.empty()) {
    json["measured_us"] = report.measured_us;
    if (report.measured_us > 0) json["ratio"] = report.joined_us / report.measured_us;
    json["measured_only"] = report.unknown;
  }
  json["budget"] = verdict_json(judge(report.network_macs, arguments.budget), arguments.budget);
  return json;
}

void print_package(const PackageReport& report, const Package& package,
                   const Arguments& arguments) {
  const bool measured = !arguments.measured.empty();
  fmt::print("  variant {} of {}, for {}; arena {} bytes\n\n", arguments.variant,
             package.variants.size(), report.variant->target, grouped(report.variant->arena_bytes));
  const std::string heads = measured ? fmt::format("{:>12}{:>8}", "measured", "ratio") : "";
  fmt::print("  {:>16}{:>15}{:>15}{:>12}{}  {:<22} {}\n", "MACs", "bytes read", "bytes written",
             "time us", heads, "kernel", "dispatch");
  const auto line = [](const Cost& cost, const std::string& times, const std::string& kernel,
                       const std::string& name) {
    fmt::print("  {:>16}{:>15}{:>15}{:>12.1f}{}  {:<22} {}\n", grouped(cost.macs),
               grouped(cost.bytes_read), grouped(cost.bytes_written), cost.time_us, times, kernel,
               name);
  };
  const auto times_text = [&](std::optional<double> measured_us, std::optional<double> ratio) {
    if (!measured) return std::string();
    return fmt::format("{:>12}{:>8}", measured_us ? fmt::format("{:.1f}", *measured_us) : "-",
                       ratio ? fmt::format("{:.2f}", *ratio) : "-");
  };
  for (const DispatchReport& row : report.dispatches)
    line(row.dispatch->cost, times_text(row.measured_us, row.ratio()), row.dispatch->kernel,
         row.dispatch->name);
  const std::optional<double> ratio =
      report.measured_us > 0 ? std::optional(report.joined_us / report.measured_us) : std::nullopt;
  line(report.total, times_text(report.measured_us, ratio), "", "total");
  if (measured && report.joined < report.dispatches.size())
    fmt::print("  {} of {} dispatches were measured; the last ratio is theirs\n", report.joined,
               report.dispatches.size());
  for (const std::string& name : report.unknown)
    fmt::print("  measured, but not in the package: {}\n", name);
  fmt::print("\n");
  print_verdict(judge(report.network_macs, arguments.budget), arguments.budget,
                2 * giga(report.network_macs));
}

// Files.

Result<Json> report_package(const std::string& path, std::span<const uint8_t> bytes,
                            const Arguments& arguments) {
  SHALE_TRY(const Package package, read_package(bytes));
  SHALE_TRY(const PackageReport report, cost_of_package(package, arguments));
  if (!arguments.json) {
    fmt::print("{}\n", path);
    print_package(report, package, arguments);
  }
  return package_json(report, arguments);
}

Result<Json> report_model(const std::string& path, std::span<const uint8_t> bytes,
                          const Arguments& arguments) {
  SHALE_TRY(Graph graph, import_model(bytes));
  PassContext context;
  for (const std::string& text : arguments.input_shapes) {
    SHALE_TRY(auto shape, parse_input_shape(text));
    context.input_shapes.insert(std::move(shape));
  }
  SHALE_TRY_VOID(run_pass(*find_pass("infer-shapes"), graph, context));
  SHALE_TRY_VOID(verify(graph));
  const GraphReport report = cost_of_graph(graph);
  if (!arguments.json) {
    fmt::print("{}\n", path);
    print_graph(report, arguments);
  }
  return graph_json(report, arguments);
}

Result<int> report_files(const Arguments& arguments) {
  if (!arguments.measured.empty() && arguments.files.size() > 1)
    return bad_input("--measured", "belongs to one package, found {} files",
                     arguments.files.size());
  Json json = Json::array();
  for (size_t i = 0; i < arguments.files.size(); ++i) {
    const std::string& path = arguments.files[i];
    if (i > 0 && !arguments.json) fmt::print("\n");
    SHALE_TRY(const std::string file, model_file(path, arguments.precision));
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file(file));
    const bool packaged = is_package(bytes);
    if (!packaged && !arguments.measured.empty())
      return bad_input("--measured", "needs a package, {} is a model", file);
    if (packaged && !arguments.input_shapes.empty())
      return bad_input("--input-shape", "{} is a package, its shapes are fixed", file);
    Result<Json> report =
        packaged ? report_package(path, bytes, arguments) : report_model(path, bytes, arguments);
    if (!report) return in_file(file, report.error());
    Json entry{{"file", path}, {"kind", packaged ? "package" : "model"}};
    entry.update(*report);
    json.push_back(std::move(entry));
  }
  if (arguments.json) print_json({{"files", std::move(json)}});
  return kDone;
}

// Published tables.

std::string convention_name(Convention convention) {
  return convention == Convention::kMac ? "mac" : "counter_A";
}

/// LR size of a row's figures; without one, that of a 1920x1080 result.
std::pair<int64_t, int64_t> row_size(const CostRow& row) {
  if (row.lr_h > 0) return {row.lr_h, row.lr_w};
  const int64_t scale = std::max<int64_t>(row.scale, 1);
  return {1080 / scale, 1920 / scale};
}

Json row_json(const CostRow& row) {
  Json json{{"id", row.id}, {"network", row.network}, {"paper", row.paper}, {"kind", row.kind}};
  if (row.is_timing()) {
    json["note"] = "timing, not computed by counting";
    return json;
  }
  if (row.layers.empty()) {
    json["note"] = "no layers to count";
    return json;
  }
  const RowCheck check = check_row(row);
  json["parameters"] = {
      {"computed", check.counts.parameters},
      {"stated", row.parameters_stated ? Json(row.parameters_stated->text) : Json(nullptr)},
      {"verdict", agreement_text(check.parameters)}};
  json["macs_per_lr_pixel"] = check.counts.macs();
  json["macs_per_lr_pixel_at_lr"] = check.counts.macs_lr;
  json["macs_per_lr_pixel_at_hr"] = check.counts.macs_hr;
  json["counter_operations_per_lr_pixel"] = check.counts.counter_operations();
  json["convention"] = convention_name(row.convention);
  json["giga"] = {{"stated", row.giga_stated ? Json(*row.giga_stated) : Json(nullptr)},
                  {"verdict", agreement_text(check.giga_agreement)}};
  if (row.lr_h > 0) {
    json["giga"]["computed"] = check.giga;
    json["giga"]["lr_w"] = row.lr_w;
    json["giga"]["lr_h"] = row.lr_h;
  }
  return json;
}

void print_row(const CostRow& row) {
  const RowCheck check = check_row(row);
  fmt::print("{:<20}{:>10}{:>9} {:<11}{:>12}{:>11}{:>11}", row.id, grouped(check.counts.parameters),
             row.parameters_stated ? row.parameters_stated->text : "-",
             agreement_text(check.parameters), per_pixel_text(check.counts.macs()),
             per_pixel_text(check.counts.macs_hr),
             per_pixel_text(check.counts.counter_operations()));
  const std::string size = row.lr_h > 0 ? fmt::format("{}x{}", row.lr_w, row.lr_h) : "-";
  fmt::print("{:>11}{:>11}{:>8}  {:<10} {}\n", size,
             row.lr_h > 0 ? fmt::format("{:.5f}", check.giga) : "-",
             row.giga_stated ? fmt::format("{}", *row.giga_stated) : "-",
             agreement_text(check.giga_agreement), convention_name(row.convention));
}

/// The network of one row as an INT8 graph, made for its cost alone.
Result<Json> report_row_graph(const CostRow& row, const Arguments& arguments) {
  const auto [h, w] = row_size(row);
  SHALE_TRY(const Graph graph, graph_of_layers(row.id, row.layers, h, w));
  SHALE_TRY_VOID(verify(graph));
  const GraphReport report = cost_of_graph(graph);
  if (!arguments.json) {
    fmt::print("\nas an INT8 graph with made-up weights, {}x{} LR pixels:\n", w, h);
    print_graph(report, arguments);
  }
  return graph_json(report, arguments);
}

Result<int> report_cost_table(const Arguments& arguments) {
  SHALE_TRY(const std::string text, read_text(arguments.cost_table));
  Result<std::vector<CostRow>> parsed = parse_cost_table(text);
  if (!parsed) return in_file(arguments.cost_table, parsed.error());
  std::vector<CostRow> rows = *std::move(parsed);
  if (!arguments.row.empty()) {
    std::erase_if(rows, [&](const CostRow& row) { return row.id != arguments.row; });
    if (rows.empty())
      return bad_input("--row", "{} has no row \"{}\"", arguments.cost_table, arguments.row);
  }
  uint64_t counted = 0, reproduced = 0, differ = 0, timings = 0;
  for (const CostRow& row : rows) {
    if (row.layers.empty()) {
      timings += row.is_timing();
      continue;
    }
    ++counted;
    const RowCheck check = check_row(row);
    for (const Agreement agreement : {check.parameters, check.giga_agreement}) {
      reproduced += agreement == Agreement::kReproduced;
      differ += agreement == Agreement::kDiffers;
    }
  }
  const int exit = differ > 0 ? kRefused : kDone;
  Json json{{"reproduced", reproduced}, {"differs", differ}, {"rows", Json::array()}};
  for (const CostRow& row : rows) json["rows"].push_back(row_json(row));
  if (!arguments.json) {
    if (counted > 0)
      fmt::print("{:<20}{:>10}{:>9} {:<11}{:>12}{:>11}{:>11}{:>11}{:>11}{:>8}  {:<10} {}\n", "row",
                 "params", "stated", "", "MAC/LR px", "at HR", "ctr_A/px", "LR size", "G computed",
                 "stated", "", "convention");
    for (const CostRow& row : rows)
      if (!row.layers.empty()) print_row(row);
    for (const CostRow& row : rows)
      if (row.layers.empty())
        fmt::print("{}: {}\n", row.id,
                   row.is_timing() ? "timing, not computed by counting" : "no layers to count");
    fmt::print("{} networks counted: {} stated figures reproduced, {} differ; {} timings\n",
               counted, reproduced, differ, timings);
  }
  if (!arguments.row.empty() && counted > 0) {
    const Result<Json> graph = report_row_graph(rows.front(), arguments);
    if (graph)
      json["graph"] = *graph;
    else if (arguments.json)
      json["graph_error"] = graph.error().text();
    else
      fmt::print("no INT8 graph: {}\n", graph.error().text());
  }
  if (arguments.json) print_json(json);
  return exit;
}

Result<int> report(const Arguments& arguments) {
  for (const double value : {arguments.budget.tops, arguments.budget.efficiency,
                             arguments.budget.frame_ms, arguments.budget.passes_ms})
    if (!std::isfinite(value))
      return bad_input("--tops, --efficiency, --frame-ms, --passes-ms", "must be finite, found {}",
                       value);
  return arguments.cost_table.empty() ? report_files(arguments) : report_cost_table(arguments);
}

}  // namespace

Action add_report(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  Budget& budget = arguments->budget;
  CLI::Option_group& what =
      *app.add_option_group("What to report", "files, or a table of published figures");
  what.add_option("file", arguments->files,
                  "models (.tosa, .tir), model folders, packages (.shale)");
  CLI::Option* const table =
      what.add_option("--cost-table", arguments->cost_table,
                      "count the layers of a table of published figures and compare");
  what.require_option(1);
  app.add_option("--row", arguments->row, "only this row of the table, with its graph")
      ->needs(table);
  app.add_option("--input-shape", arguments->input_shapes,
                 "shape of a model's input, NAME=N,H,W,C (again for each input)")
      ->allow_extra_args(false);  // what follows is a file
  add_precision_option(app, arguments->precision);
  app.add_option("--variant", arguments->variant, "variant of the package");
  app.add_option("--measured", arguments->measured,
                 "times from shale run --profile-to, to set beside the predicted ones");
  app.add_option("--tops", budget.tops, "peak of the device, 1e12 operations a second, 2 per MAC")
      ->check(CLI::Range(1e-6, 1e6));
  app.add_option("--efficiency", budget.efficiency,
                 "share of the peak that the network is assumed to reach")
      ->check(CLI::Range(1e-6, 1.0));
  app.add_option("--frame-ms", budget.frame_ms, "time for passes and network together")
      ->check(CLI::Range(0.0, 1e6));
  app.add_option("--passes-ms", budget.passes_ms, "time of the passes around the network")
      ->check(CLI::Range(0.0, 1e6));
  app.add_option(
         "--convention", arguments->convention,
         "mac: multiply-accumulates; counter_a: also the operations that SRPO's table 1 counts")
      ->check(CLI::IsMember({"mac", "counter_a"}));
  app.add_flag("--json", arguments->json, "print the report as JSON");
  app.footer("Example: shale report models/srpo_x2 --render 960x540");
  return [arguments] { return report(*arguments); };
}

}  // namespace shale
