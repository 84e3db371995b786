// shale verify: is a model or a package legal?
#include "ir/verify/verify.h"

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

struct Arguments {
  std::vector<std::string> files;
  ImportArguments import;
  bool json = false;
};

Result<std::string> verify_file(const std::string& path, const ImportOptions& import) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  if (is_package(bytes)) {
    SHALE_TRY(const Package package, read_package(bytes));
    return fmt::format("package, {} variants", package.variants.size());
  }
  SHALE_TRY(const Graph graph, import_graph(bytes, import));
  SHALE_TRY_VOID(verify(graph));
  return fmt::format("{}, {} operators", model_format(bytes), graph.nodes.size());
}

Result<int> verify_files(const Arguments& arguments) {
  SHALE_TRY(const ImportOptions import, arguments.import.options());
  Json json = Json::array();
  int exit = kDone;
  for (const std::string& path : arguments.files) {
    const Result<std::string> result = verify_file(path, import);
    const std::string text = result                         ? *result
                             : result.error().where == path ? result.error().message
                                                            : result.error().text();
    if (!result) exit = kRefused;
    json.push_back(
        {{"file", path}, {"valid", result.has_value()}, {result ? "summary" : "error", text}});
    if (arguments.json) continue;
    if (result)
      fmt::print("{}: valid ({})\n", path, text);
    else
      fmt::print(stderr, "error: {}: {}\n", path, text);
  }
  if (arguments.json) print_json(json);
  return exit;
}

}  // namespace

Action add_verify(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("files", arguments->files,
                 fmt::format("models ({}) or packages (.shale)", kModelKinds))
      ->required();
  arguments->import.add_to(app);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer("Example: shale verify models/srpo_x2/model.tosa srpo.shale");
  return [arguments] { return verify_files(*arguments); };
}

}  // namespace shale
