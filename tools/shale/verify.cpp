// shale verify: is a model or a package legal?
#include "ir/verify/verify.h"

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

struct Arguments {
  std::vector<std::string> files;
  std::string precision = "int8";
  ImportArguments import;
  bool json = false;
};

Result<std::string> verify_file(const std::string& path, const std::string& precision,
                                const ImportOptions& import) {
  SHALE_TRY(const ModelFiles model, load_model(path, "", precision));
  const std::vector<uint8_t>& bytes = model.bytes;
  if (bytes.empty() && model.frame) return std::string("sandwich without a network");
  if (is_package(bytes)) {
    SHALE_TRY(const Package package, read_package(bytes));
    return fmt::format("package, {} variants", package.variants.size());
  }
  SHALE_TRY(Graph graph, import_graph(bytes, import));
  // Open sizes are asked for by the name of their option.
  SHALE_TRY_VOID(verify(graph, OpenSizes::kAllowed));
  SHALE_TRY_VOID(run_pass(*find_pass("infer-shapes"), graph, {}));
  SHALE_TRY_VOID(verify(graph));
  return fmt::format("{}, {} operators", model_format(bytes), graph.nodes.size());
}

Result<int> verify_files(const Arguments& arguments) {
  SHALE_TRY(const ImportOptions import, arguments.import.options());
  Json json = Json::array();
  int exit = kDone;
  for (const std::string& path : arguments.files) {
    const Result<std::string> result = verify_file(path, arguments.precision, import);
    if (result) {
      json.push_back({{"file", path}, {"valid", true}, {"summary", *result}});
      if (!arguments.json) fmt::print("{}: valid ({})\n", one_line(path), *result);
      continue;
    }
    exit = kRefused;
    Error error = in_file(path, result.error());
    if (!arguments.json) print_error(error);
    error.file.clear();
    json.push_back({{"file", path}, {"valid", false}, {"error", error.text()}});
  }
  if (arguments.json) print_json(json);
  return exit;
}

}  // namespace

Action add_verify(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("files", arguments->files,
                 fmt::format("models ({}), model folders, or packages (.shale)", kModelKinds))
      ->required();
  add_precision_option(app, arguments->precision);
  arguments->import.add_to(app);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer("Example: shale verify models/srpo_x2/model.tosa srpo.shale");
  return [arguments] { return verify_files(*arguments); };
}

}  // namespace shale
