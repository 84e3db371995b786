// The part of shale report that counts published networks and compares with their papers.
#include "compiler/cost/layers.h"
#include "ir/base/file.h"
#include "ir/verify/verify.h"
#include "tools/shale/report.h"

namespace shale {
namespace {

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
Result<Json> report_row_graph(const CostRow& row, const ReportArguments& arguments) {
  const auto [h, w] = row_size(row);
  SHALE_TRY(const Graph graph, graph_of_layers(row.id, row.layers, h, w));
  SHALE_TRY_VOID(verify(graph));
  const Json json = graph_json(graph, arguments);
  if (!arguments.quiet) {
    fmt::print("\nas an INT8 graph with made-up weights, {}x{} LR pixels:\n", w, h);
    print_graph(json, arguments);
  }
  return json;
}

}  // namespace

Result<int> report_cost_table(const ReportArguments& arguments) {
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
  if (!arguments.quiet) {
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
    else if (arguments.quiet)
      json["graph_error"] = graph.error().text();
    else
      fmt::print("no INT8 graph: {}\n", graph.error().text());
  }
  if (arguments.json) print_json(json);
  return exit;
}

}  // namespace shale
