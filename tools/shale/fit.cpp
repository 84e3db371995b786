// shale fit: constants of the cost model for the device at hand, from times of shale bench.
#include "compiler/cost/fit.h"

#include <algorithm>
#include <cmath>

#include "ir/base/file.h"
#include "tools/shale/command.h"
#include "tools/shale/outputs.h"

namespace shale {
namespace {

struct Arguments {
  std::vector<std::string> files;
  std::string output, target;
  bool json = false;
};

/// Of times in us, roofs and amounts of work: their products and squares stay finite.
constexpr double kMost = 1e15;

/// The work of a row of shale bench.
Result<WorkTable> read_work(const Json& row, const std::string& where) {
  if (!row.contains("work") || !row["work"].is_object())
    return bad_input(where, "has no \"work\"; was it made by an older shale bench?");
  WorkTable amounts{};
  for (const auto& [name, amount] : row["work"].items()) {
    size_t i = 0;
    while (i < kWorkCount && work_info(static_cast<Work>(i)).name != name) ++i;
    if (i == kWorkCount || !amount.is_number() ||
        !(amount.get<double>() >= 0 && amount.get<double>() <= kMost))
      return bad_input(where, "\"work\": \"{}\" is no amount of work", name);
    amounts.at(i) = amount.get<double>();
  }
  return amounts;
}

struct Data {
  std::vector<MeasuredWork> rows;
  std::vector<double> roofs;  ///< of each row
  std::string target;         ///< of the first model that names one
};

Result<void> read_bench(const std::string& path, Data& data) {
  SHALE_TRY(const Json json, read_json(path));
  if (!json.is_object() || !json.contains("models") || !json["models"].is_array())
    return bad_input(path, "holds no times; shale bench --json writes them");
  for (const Json& model : json["models"]) {
    const bool whole = model.is_object() && model.contains("roof_gop_per_s") &&
                       model["roof_gop_per_s"].is_number() && model.contains("dispatches") &&
                       model["dispatches"].is_array();
    const double roof = whole ? model["roof_gop_per_s"].get<double>() : 0;
    if (!(roof > 0 && roof <= kMost))
      return bad_input(path, "a model has no roof up to {:g} or no dispatches", kMost);
    if (data.target.empty() && model.contains("target") && model["target"].is_string())
      data.target = model["target"].get<std::string>();
    for (size_t i = 0; i < model["dispatches"].size(); ++i) {
      const Json& row = model["dispatches"][i];
      const std::string where = fmt::format("{}: dispatch {}", path, i);
      const bool timed = row.is_object() && row.contains("time_ms") && row["time_ms"].is_number();
      MeasuredWork measured;
      measured.time_us = timed ? 1e3 * row["time_ms"].get<double>() : 0;
      if (!(measured.time_us > 0 && measured.time_us <= kMost))
        return bad_input(where, "has no \"time_ms\" above 0 and up to {:g}", 1e-3 * kMost);
      SHALE_TRY(measured.amounts, read_work(row, where));
      data.rows.push_back(measured);
      data.roofs.push_back(roof);
    }
  }
  return {};
}

Result<int> run(const Arguments& arguments) {
  Outputs outputs(arguments.json);
  outputs.keep(arguments.files);
  SHALE_TRY_VOID(outputs.claim("-o", arguments.output));
  Data data;
  for (const std::string& file : arguments.files) SHALE_TRY_VOID(read_bench(file, data));
  if (data.rows.empty()) return bad_input("", "the files hold no dispatch");
  const std::string target = !arguments.target.empty() ? arguments.target
                             : !data.target.empty()    ? data.target
                                                       : "lavapipe";
  const DeviceProfile* profile = find_profile(target);
  if (!profile) return bad_input("--target", "\"{}\" is unknown", target);
  // All times as they would be at one speed of the machine.
  std::vector<double> sorted = data.roofs;
  std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2),
                   sorted.end());
  MeasuredConstants constants{.roof_gops = sorted[sorted.size() / 2]};
  for (size_t i = 0; i < data.rows.size(); ++i)
    data.rows[i].time_us *= data.roofs[i] / constants.roof_gops;
  constants.ns = fit_constants(data.rows, profile->ns);

  double time = 0, predicted = 0, close = 0;
  for (const MeasuredWork& row : data.rows) {
    const double us = work_time_us(row.amounts, constants.ns);
    time += row.time_us;
    predicted += us;
    if (std::abs(us - row.time_us) <= 0.25 * row.time_us) close += row.time_us;
  }
  Json json = constants_json(target, constants);
  if (!arguments.output.empty()) outputs.note(write_text(arguments.output, json_text(json)));
  json["dispatches"] = data.rows.size();
  json["predicted_of_measured"] = predicted / time;
  json["close_share"] = close / time;
  const int exit = outputs.all_written() ? kDone : kRefused;
  if (arguments.json) {
    print_json(json);
    return exit;
  }
  if (outputs.has_standard_output()) return exit;
  fmt::print("{} dispatches of {} files, at a roof of {:.1f} GOP/s\n", data.rows.size(),
             arguments.files.size(), constants.roof_gops);
  for (size_t i = 0; i < kWorkCount; ++i)
    fmt::print("  {:>12.5g} ns  {}\n", constants.ns.at(i), work_info(static_cast<Work>(i)).what);
  fmt::print(
      "predicted {:+.1f} % in all; {:.0f} % of the time in dispatches predicted within 25 %\n",
      100 * (predicted / time - 1), 100 * close / time);
  return exit;
}

}  // namespace

Action add_fit(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("bench", arguments->files, "results of shale bench --json, of several sizes")
      ->required();
  app.add_option("-o,--output", arguments->output, "file for the constants (JSON)");
  app.add_option("--target", arguments->target,
                 "device class whose constants they replace (default: the one that was measured)");
  app.add_flag("--json", arguments->json, "print the constants as JSON");
  app.footer(
      "Example: shale fit a.json b.json -o here.json\n"
      "after     shale bench models/srpo_x2 --render 640x360 --json > a.json\n"
      "          shale bench models/srpo_x2 --render 1280x720 --json > b.json\n"
      "then      shale bench models/srpo_x2 --render 960x540 --constants here.json");
  return [arguments] { return run(*arguments); };
}

}  // namespace shale
