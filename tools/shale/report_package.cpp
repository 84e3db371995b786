// The part of shale report that shows packages: dispatches, predicted and measured.
#include <optional>

#include "ir/base/file.h"
#include "tools/shale/report.h"

namespace shale {
namespace {

/// Times by dispatch name from `shale run --profile-to`.
Result<std::map<std::string, double>> read_measured(const std::string& path) {
  SHALE_TRY(const Json json, read_json(path));
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
  uint64_t live_bytes;  ///< of the arena, while it runs
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

/// Bytes of the arena that hold something at each dispatch of the variant, in order.
std::vector<uint64_t> live_bytes(const Variant& variant) {
  std::map<uint32_t, std::pair<size_t, size_t>> lives;  // resource to first and last dispatch
  size_t count = 0;
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches) {
      for (const Binding& binding : dispatch.bindings)
        if (variant.resources[binding.resource].category == Category::kIntermediate)
          lives.try_emplace(binding.resource, count, count).first->second.second = count;
      ++count;
    }
  std::vector<uint64_t> live(count, 0);
  for (const auto& [resource, life] : lives)
    for (size_t i = life.first; i <= life.second; ++i)
      live[i] += variant.resources[resource].size_bytes;
  return live;
}

Result<PackageReport> cost_of_package(const Package& package, const ReportArguments& arguments) {
  if (arguments.variant >= package.variants.size())
    return bad_input("--variant", "found {}, the package has {}", arguments.variant,
                     package.variants.size());
  std::map<std::string, double> measured;
  if (!arguments.measured.empty()) {
    SHALE_TRY(measured, read_measured(arguments.measured.front()));
  }
  PackageReport report{.variant = &package.variants[arguments.variant],
                       .dispatches = {},
                       .unknown = {},
                       .total = {}};
  const std::vector<uint64_t> live = live_bytes(*report.variant);
  for (const Segment& segment : report.variant->segments) {
    for (const Dispatch& dispatch : segment.dispatches) {
      DispatchReport row{&segment, &dispatch, live[report.dispatches.size()], std::nullopt};
      if (const auto time = measured.find(dispatch.name); time != measured.end()) {
        row.measured_us = time->second;
        report.joined_us += dispatch.cost.time_us;
        report.measured_us += time->second;
        measured.erase(time);
        ++report.joined;
      }
      report.dispatches.push_back(row);
      // Of programs that a parameter chooses among, a frame runs one.
      if (!report.variant->chosen_by.empty() && segment.program != 0) continue;
      report.total.macs += dispatch.cost.macs;
      report.total.ops += dispatch.cost.ops;
      report.total.bytes_read += dispatch.cost.bytes_read;
      report.total.bytes_written += dispatch.cost.bytes_written;
      report.total.time_us += dispatch.cost.time_us;
      if (segment.kind == SegmentKind::kGraph) report.network_macs += dispatch.cost.macs;
    }
  }
  if (!arguments.measured.empty() && report.joined == 0)
    return bad_input(arguments.measured.front(),
                     "names no dispatch of this package; was it measured with another one?");
  for (const auto& [name, time_us] : measured) report.unknown.push_back(name);
  return report;
}

Json package_json(const PackageReport& report, const Package& package,
                  const ReportArguments& arguments) {
  const auto cost_json = [](const Cost& cost) -> Json {
    return {{"macs", cost.macs},
            {"ops", cost.ops},
            {"bytes_read", cost.bytes_read},
            {"bytes_written", cost.bytes_written},
            {"time_us", cost.time_us}};
  };
  Json json{{"model", package.provenance.model_name}, {"compiler", package.provenance.compiler},
            {"options", package.provenance.options},  {"variant", arguments.variant},
            {"target", report.variant->target},       {"arena_bytes", report.variant->arena_bytes}};
  json.update(cost_json(report.total));
  json["network_macs"] = report.network_macs;
  json["gop"] = 2 * giga(report.network_macs);
  json["dispatches"] = Json::array();
  for (const DispatchReport& row : report.dispatches) {
    Json entry{{"name", row.dispatch->name},
               {"segment", row.segment->name},
               {"kernel", row.dispatch->kernel}};
    entry.update(cost_json(row.dispatch->cost));
    entry["live_bytes"] = row.live_bytes;
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
                   const ReportArguments& arguments) {
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

}  // namespace

Result<Json> report_package(const std::string& path, std::span<const uint8_t> bytes,
                            const ReportArguments& arguments) {
  if (arguments.measured.size() > 1)
    return bad_input("--measured", "found {} files, a package takes one profile",
                     arguments.measured.size());
  SHALE_TRY(const Package package, read_package(bytes));
  SHALE_TRY(const PackageReport report, cost_of_package(package, arguments));
  if (!arguments.quiet) {
    fmt::print("{}\n", path);
    print_package(report, package, arguments);
  }
  return package_json(report, package, arguments);
}

}  // namespace shale
