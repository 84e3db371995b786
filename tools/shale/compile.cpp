// shale compile: a model file to a .shale package.
#include "ir/base/file.h"
#include "tools/shale/command.h"
#include "tools/shale/outputs.h"

namespace shale {
namespace {

struct Arguments {
  std::string model, output;
  CompileArguments compile;
  bool json = false, timings = false;
};

Result<int> compile_to_file(const Arguments& arguments) {
  Outputs outputs(arguments.json);
  outputs.keep({arguments.model});
  outputs.keep(arguments.compile.files());
  SHALE_TRY_VOID(outputs.claim("-o", arguments.output));
  SHALE_TRY(const ModelFiles model,
            load_model(arguments.model, arguments.compile.frame, arguments.compile.precision));
  SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
  SHALE_TRY(const Compiled compiled, compile_model(model, options));
  for (const std::string& warning : compiled.warnings) print_warning(model.path, warning);
  const std::vector<uint8_t> bytes = write_package(compiled.package);
  SHALE_TRY_VOID(write_file(arguments.output, bytes));

  Json json{
      {"package", arguments.output}, {"bytes", bytes.size()}, {"kernels_ms", compiled.kernels_ms}};
  for (const PassTiming& timing : compiled.timings)
    json["passes"].push_back({{"name", timing.pass},
                              {"time_us", timing.time_us},
                              {"changed", timing.change == Change::kChanged}});
  for (size_t i = 0; i < compiled.package.variants.size(); ++i) {
    const Variant& variant = compiled.package.variants[i];
    size_t dispatches = 0;
    for (const Segment& segment : variant.segments) dispatches += segment.dispatches.size();
    json["variants"].push_back({{"target", variant.target},
                                {"dispatches", dispatches},
                                {"modules", variant.modules.size()},
                                {"arena_bytes", variant.arena_bytes},
                                {"selection", selection_json(compiled.selections[i])}});
  }
  json["arena_lower_bound_bytes"] = compiled.arena_lower_bound_bytes;
  json["warnings"] = compiled.warnings;
  if (arguments.json) {
    print_json(json);
    return kDone;
  }
  std::FILE* const summary = outputs.summary();
  for (const Json& variant : json["variants"])
    fmt::print(summary, "{}: {} dispatches, {} modules, arena {} bytes\n",
               variant["target"].get<std::string>(), variant["dispatches"].get<size_t>(),
               variant["modules"].get<size_t>(), variant["arena_bytes"].get<uint64_t>());
  for (const std::string& line : selection_lines(compiled)) fmt::print(summary, "{}\n", line);
  fmt::print(summary, "wrote {} ({} bytes)\n", arguments.output, bytes.size());
  if (arguments.timings) {
    for (const PassTiming& timing : compiled.timings)
      fmt::print(summary, "  {:<18} {:>10.1f} us{}\n", timing.pass, timing.time_us,
                 timing.change == Change::kChanged ? "  changed" : "");
    fmt::print(summary, "  {:<18} {:>10.1f} us\n", "kernels", 1000 * compiled.kernels_ms);
  }
  return kDone;
}

}  // namespace

Action add_compile(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option(
         "model", arguments->model,
         fmt::format("model file ({}) or a folder with model.tosa and frame.json", kModelKinds))
      ->required();
  app.add_option("-o,--output", arguments->output, "package to write")->required();
  arguments->compile.default_target = "all";  // a package goes to devices that nobody knows yet
  arguments->compile.add_to(app);
  app.add_flag("--timings", arguments->timings, "print the time of each pass");
  app.add_flag("--json", arguments->json, "print the summary as JSON");
  app.footer("Example: shale compile models/srpo_x2 --render 960x540 -o srpo.shale");
  return [arguments] { return compile_to_file(*arguments); };
}

}  // namespace shale
