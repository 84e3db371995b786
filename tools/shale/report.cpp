// shale report: what networks cost, predicted against measured, and the published cost tables.
#include "tools/shale/report.h"

#include <algorithm>
#include <filesystem>

#include "ir/base/file.h"
#include "tools/eval/data_page.h"
#include "tools/shale/cost_page.h"
#include "tools/shale/outputs.h"

namespace shale {

namespace fs = std::filesystem;

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
  return {{"frame_ms", budget.frame_ms},
          {"passes_ms", budget.passes_ms},
          {"tops", budget.tops},
          {"efficiency", budget.efficiency},
          {"available_gop", verdict.available_gop},
          {"required_efficiency", finite_json(verdict.required_efficiency)},
          {"required_tops", finite_json(verdict.required_tops)},
          {"network_ms", verdict.network_ms},
          {"headroom_ms", verdict.headroom_ms},
          {"fits", verdict.fits}};
}

void print_verdict(const Verdict& verdict, const Budget& budget, double gop) {
  const double left_ms = budget.frame_ms - budget.passes_ms;
  fmt::print(
      "  budget: {} ms a frame less {:.2f} ms of passes leave {:.2f} ms, {:.2f} GOP at {} TOP/s\n",
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

namespace {

/// A field of a CSV line; names come from files.
std::string csv_field(const Json& value) {
  if (!value.is_string()) return value.is_null() ? "" : value.dump();
  const std::string text = value.get<std::string>();
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
  return quoted + '"';
}

/// A line for each dispatch of each file; columns that a file's kind has not are empty.
std::string csv_of(const Json& files) {
  constexpr const char* kColumns[] = {
      "name",         "segment",     "kernel",     "op",          "precision",
      "macs",         "ops",         "bytes",      "bytes_read",  "bytes_written",
      "memory_bytes", "tile_height", "tile_width", "halo",        "compute_us",
      "memory_us",    "dispatch_us", "time_us",    "measured_us", "bound",
      "ops_per_byte", "energy_uj",   "live_bytes"};
  std::string text = "file";
  for (const char* column : kColumns) text += fmt::format(",{}", column);
  text += '\n';
  for (const Json& file : files) {
    const Json::json_pointer at(file["kind"] == "package" ? "/dispatches" : "/modelled/dispatches");
    if (!file.contains(at)) continue;
    for (const Json& row : file.at(at)) {
      text += csv_field(file["file"]);
      for (const char* column : kColumns)
        text += "," + (row.contains(column) ? csv_field(row[column]) : std::string());
      text += '\n';
    }
  }
  return text;
}

Result<int> report_files(ReportArguments arguments) {
  Outputs outputs(arguments.json);
  outputs.keep(arguments.files);
  outputs.keep(arguments.measured);
  outputs.keep(arguments.compile.files());
  SHALE_TRY_VOID(outputs.claim("--csv", arguments.csv));
  SHALE_TRY_VOID(outputs.claim("--html", arguments.html));
  arguments.quiet = outputs.has_standard_output();
  Json files = Json::array();
  for (size_t i = 0; i < arguments.files.size(); ++i) {
    const std::string& path = arguments.files[i];
    if (i > 0 && !arguments.quiet) fmt::print("\n");
    std::error_code ignored;
    Json entry{{"file", path}, {"kind", "model"}};
    bool packaged = false;
    if (!fs::is_directory(path, ignored)) {
      SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
      packaged = is_package(bytes);
      if (packaged) {
        entry["kind"] = "package";
        if (!arguments.measured.empty() && arguments.files.size() > 1)
          return bad_input("--measured", "belongs to one package, found {} files",
                           arguments.files.size());
        if (!arguments.compile.import.input_shapes.empty() || !arguments.compile.render.empty())
          return bad_input("--input-shape, --render", "{} is a package, its shapes are fixed",
                           path);
        const Result<Json> report = report_package(path, bytes, arguments);
        if (!report) return in_file(path, report.error());
        entry.update(*report);
      }
    }
    if (!packaged) {
      SHALE_TRY(const Json report, report_model(path, arguments));
      entry.update(report);
    }
    files.push_back(std::move(entry));
    if (interrupted()) return bad_input("", "interrupted");
  }
  Json json{{"files", std::move(files)}};
  if (arguments.files.size() == 2 && json["files"][0]["kind"] == json["files"][1]["kind"]) {
    SHALE_TRY(json["comparison"],
              compare_files(arguments.files[0], arguments.files[1], arguments, json["files"]));
  }
  if (!arguments.csv.empty()) outputs.note(write_text(arguments.csv, csv_of(json["files"])));
  if (!arguments.html.empty())
    outputs.note(write_text(
        arguments.html, data_page("What networks cost", json, cost_page::kEmbeddedFiles[0].text)));
  if (arguments.json) print_json(json);
  return outputs.all_written() ? kDone : kRefused;
}

Result<int> report(ReportArguments arguments) {
  const ModelledDevice* device = find_modelled_device(arguments.device);
  if (!device) {
    std::string names;
    for (const ModelledDevice& known : modelled_devices())
      names += (names.empty() ? "" : ", ") + std::string(known.name);
    return bad_input("--device", "\"{}\" is unknown, expected one of: {}", arguments.device, names);
  }
  const ModelledDevice own = with_options(*device, arguments.model);
  arguments.budget.tops = own.tops.value;
  arguments.budget.efficiency = own.efficiency.value;
  if (arguments.passes_ms) arguments.budget.passes_ms = *arguments.passes_ms;
  arguments.quiet = arguments.json;
  return arguments.cost_table.empty() ? report_files(arguments) : report_cost_table(arguments);
}

}  // namespace

Action add_report(CLI::App& app) {
  auto arguments = std::make_shared<ReportArguments>();
  Budget& budget = arguments->budget;
  ModelOptions& model = arguments->model;
  CompileArguments& compile = arguments->compile;
  CLI::Option_group& what =
      *app.add_option_group("What to report", "files, or a table of published figures");
  what.add_option("file", arguments->files,
                  fmt::format("models ({}), model folders, packages (.shale); two of a kind are "
                              "compared, too",
                              kModelKinds));
  CLI::Option* const table =
      what.add_option("--cost-table", arguments->cost_table,
                      "count the layers of a table of published figures and compare");
  what.require_option(1);
  app.add_option("--row", arguments->row, "only this row of the table, with its graph")
      ->needs(table);
  compile.import.add_to(app);
  add_precision_option(app, compile.precision);
  app.add_option("--frame", compile.frame,
                 "frame.json of the sandwich, for a model given as a file");
  app.add_option("--render", compile.render, "size of the rendered frames, WIDTHxHEIGHT");
  app.add_option("--output-size", compile.output, "size of the results, WIDTHxHEIGHT");
  app.add_option("--variant", arguments->variant, "variant of the package");
  app.add_option("--measured", arguments->measured,
                 "to set beside the predicted times: for a package those of shale run "
                 "--profile-to, for models results of shale bench --json (again for each)")
      ->allow_extra_args(false);
  app.add_option("--device", arguments->device,
                 "modelled device: mobile, desktop-dot8 or desktop-matrix");
  const auto positive = [](CLI::Option* option) {
    option->check(number_in(1e-6, 1e12))->default_str("");
  };
  positive(
      app.add_option("--tops", model.tops, "its peak, 1e12 int8 operations a second, 2 per MAC"));
  app.add_option("--efficiency", model.efficiency, "share of the peak that convolutions reach")
      ->check(number_in(1e-6, 1))
      ->default_str("");
  positive(app.add_option("--memory-gbps", model.memory_gbps, "its memory bandwidth, GB/s"));
  positive(app.add_option("--cache-bytes", model.cache_bytes, "its memory on chip, bytes"));
  app.add_option("--frame-ms", budget.frame_ms, "time for passes and network together")
      ->check(number_in(0, 1e6));
  app.add_option(
         "--passes-ms", arguments->passes_ms,
         "time of the passes around the network for a result of 1920x1080, in place of what "
         "they are modelled to take")
      ->check(number_in(0, 1e6))
      ->default_str("");
  app.add_option(
         "--convention", arguments->convention,
         "mac: multiply-accumulates; counter_a: also the operations that SRPO's table 1 counts")
      ->check(CLI::IsMember({"mac", "counter_a"}));
  app.add_flag("--layers", arguments->layers, "list the dispatches of the modelled network");
  app.add_option("--html", arguments->html, "file for a page with charts");
  app.add_option("--csv", arguments->csv, "file for a table of all dispatches");
  app.add_flag("--json", arguments->json, "print the report as JSON");
  // A table has none of what these choose or write.
  for (const char* option :
       {"--html", "--csv", "--measured", "--variant", "--frame", "--render", "--output-size",
        "--precision", "--input-shape", "--entry-point", "--constant"})
    app.get_option(option)->excludes(table);
  app.footer(
      "Example: shale report models/nss_v1_high models/srpo_x2 --html report.html\n"
      "         shale report models/nss_v1_high --layers --efficiency 0.4\n"
      "         shale report before.shale after.shale");
  return [arguments] { return report(*arguments); };
}

}  // namespace shale
