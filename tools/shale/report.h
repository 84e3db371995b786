// tools/shale/report.h -- what the parts of `shale report` share.
#pragma once

#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "compiler/cost/cost.h"
#include "compiler/cost/device_model.h"
#include "tools/shale/command.h"

namespace shale {

struct ReportArguments {
  std::vector<std::string> files, measured;
  std::string cost_table, row, convention = "mac", device = "mobile", html, csv;
  uint32_t variant = 0;
  Budget budget;
  std::optional<double>
      passes_ms;  ///< given for the passes, in place of what they are modelled to take
  ModelOptions model;
  CompileArguments compile;  ///< its shapes and sizes alone
  bool layers = false, json = false;
  bool quiet = false;  ///< standard output has a result, so text may not go there
};

/// 5599000000 as "5,599,000,000".
std::string grouped(uint64_t number);
/// A count per pixel, which is whole for most networks.
std::string per_pixel_text(double count);
std::string percent_text(double share);
inline double giga(uint64_t count) { return 1e-9 * static_cast<double>(count); }

/// A number for JSON, which has no infinity.
inline Json finite_json(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json verdict_json(const Verdict& verdict, const Budget& budget);
void print_verdict(const Verdict& verdict, const Budget& budget, double gop);

/// A graph as it is in the model, each operator on its own.
Json graph_json(const Graph& graph, const ReportArguments& arguments);
void print_graph(const Json& json, const ReportArguments& arguments);

/// The model's costs with what it would cost fused on the modelled device, what of it fits the
/// budget, and measurements of shale bench for it.
/// Errors: those of loading, of shapes, of the passes.
Result<Json> report_model(const std::string& path, const ReportArguments& arguments);
/// A package's dispatches, predicted and measured.
Result<Json> report_package(const std::string& path, std::span<const uint8_t> bytes,
                            const ReportArguments& arguments);
/// Two files of one kind: what of the second differs first, and by how much.
/// Errors: those of reading.
Result<Json> compare_files(const std::string& before, const std::string& after,
                           const ReportArguments& arguments, const Json& reports);

/// The table of published figures.
Result<int> report_cost_table(const ReportArguments& arguments);

}  // namespace shale
