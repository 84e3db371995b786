// shale conform: runs TOSA test cases and compares bit for bit, or within errors that a case gives.
#include <algorithm>
#include <filesystem>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "ir/reference/interpreter.h"
#include "ir/reference/precision.h"
#include "ir/verify/verify.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/native.h"
#include "tools/shale/npy.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::vector<std::string> folders;
  std::string backend = "interpreter";
  DeviceArguments device;
  CompileArguments compile;
  bool json = false;
};

struct Outcome {
  std::string name;
  bool passed = false;
  std::string detail;  ///< why it failed, or why the file was refused
};

/// Every folder below `root` that holds a desc.json, sorted.
Result<std::vector<fs::path>> find_cases(const std::string& root) {
  std::error_code error;
  std::vector<fs::path> cases;
  fs::recursive_directory_iterator it(root, error);
  if (error) return io_error(root, "cannot list: {}", error.message());
  if (fs::exists(fs::path(root) / "desc.json", error)) cases.emplace_back(root);
  for (; it != fs::recursive_directory_iterator(); it.increment(error)) {
    if (error) return io_error(root, "cannot list: {}", error.message());
    if (it->is_directory(error) && fs::exists(it->path() / "desc.json", error))
      cases.push_back(it->path());
  }
  std::sort(cases.begin(), cases.end());
  return cases;
}

class Runner {
 public:
  /// At most one of the devices is there; the interpreter runs without.
  Runner(const Arguments& arguments, const ToolDevice* device, const NativeDevice* native)
      : arguments_(arguments), device_(device), native_(native) {}

  Outcome run(const fs::path& folder) const {
    Outcome outcome{folder.string(), false, {}};
    const Result<Json> description = read_description(folder);
    if (!description) return outcome.detail = description.error().text(), outcome;
    const bool must_accept = description->value("expect", "accept") == "accept";
    const std::string file = description->value("tosa_file", "graph.tosa");
    const Result<std::string> difference = check(folder, *description, file, must_accept);
    if (!difference) {
      outcome.passed = !must_accept && difference.error().code != ErrorCode::kDevice &&
                       difference.error().code != ErrorCode::kIo;
      outcome.detail = difference.error().text();
    } else if (!must_accept) {
      outcome.detail = "accepted, but TOSA calls it invalid: " + description->value("reason", "");
    } else {
      outcome.passed = difference->empty();
      outcome.detail = *difference;
    }
    return outcome;
  }

 private:
  static Result<Json> read_description(const fs::path& folder) {
    const std::string path = (folder / "desc.json").string();
    SHALE_TRY(Json json, read_json(path));
    if (!json.is_object()) return bad_input(path, "is no JSON object");
    SHALE_TRY_VOID(check_texts(json, {"expect", "tosa_file", "reason"}, path));
    for (const char* list : {"inputs", "outputs"}) {
      if (!json.contains(list)) continue;
      if (!json[list].is_array()) return bad_input(path, "\"{}\" is no list", list);
      for (const Json& entry : json[list]) {
        if (!entry.is_object()) return bad_input(path, "\"{}\" has what is no object", list);
        SHALE_TRY_VOID(check_texts(entry, {"name", "file", "error"}, path));
      }
    }
    return json;
  }

  static Result<void> check_texts(const Json& object, std::initializer_list<const char*> keys,
                                  const std::string& path) {
    for (const char* key : keys)
      if (object.contains(key) && !object[key].is_string())
        return bad_input(path, "\"{}\" is a {}, expected a text", key, object[key].type_name());
    return {};
  }

  /// First difference, empty if there is none; an error if the file is refused.
  Result<std::string> check(const fs::path& folder, const Json& description,
                            const std::string& file, bool must_accept) const {
    SHALE_TRY(const std::vector<uint8_t> bytes, read_file((folder / file).string()));
    SHALE_TRY(const Graph graph, import_model(bytes));
    SHALE_TRY_VOID(verify(graph));
    std::vector<Tensor> inputs;
    std::vector<Expected> expected;
    if (must_accept) {
      for (const ValueId id : graph.inputs) {
        SHALE_TRY(const std::string array,
                  file_of(folder, description, "inputs", "file", graph, id));
        SHALE_TRY(inputs.emplace_back(), read_npy(array, graph.value(id).type));
      }
      for (const ValueId id : graph.outputs) {
        SHALE_TRY(expected.emplace_back(), read_expected(folder, description, graph, id));
      }
    }
    SHALE_TRY(const std::vector<Tensor> outputs, compute(graph, bytes, inputs, must_accept));
    for (size_t i = 0; i < expected.size(); ++i)
      if (const auto difference = expected[i].difference(outputs[i]))
        return fmt::format("output \"{}\": {}", graph.value(graph.outputs[i]).name, *difference);
    return std::string();
  }

  /// An output bit for bit, or in double precision with the error that each element may have.
  struct Expected {
    Tensor exact;
    std::vector<Precision> within;

    std::optional<std::string> difference(const Tensor& found) const {
      return within.empty() ? first_difference(found, exact) : first_imprecise(found, within);
    }
  };

  static Result<Expected> read_expected(const fs::path& folder, const Json& description,
                                        const Graph& graph, ValueId id) {
    const TensorType& type = graph.value(id).type;
    SHALE_TRY(const std::string file, file_of(folder, description, "outputs", "file", graph, id));
    Expected expected;
    const Result<std::string> errors = file_of(folder, description, "outputs", "error", graph, id);
    if (!errors) {
      SHALE_TRY(expected.exact, read_npy(file, type));
      return expected;
    }
    SHALE_TRY(const std::vector<double> values, read_npy_doubles(file, type.shape));
    SHALE_TRY(const std::vector<double> error, read_npy_doubles(*errors, type.shape));
    for (size_t i = 0; i < values.size(); ++i) {
      if (!(error[i] >= 0))
        return bad_input(*errors, "has {} at element {}, expected 0 or more", error[i], i);
      expected.within.push_back({values[i], error[i]});
    }
    return expected;
  }

  Result<std::vector<Tensor>> compute(const Graph& graph, const std::vector<uint8_t>& bytes,
                                      const std::vector<Tensor>& inputs, bool must_accept) const {
    if (native_) return must_accept ? native_->run(graph, inputs) : std::vector<Tensor>{};
    if (!device_) return must_accept ? interpret(graph, inputs) : std::vector<Tensor>{};
    SHALE_TRY(const CompileOptions options, arguments_.compile.options({}));
    SHALE_TRY(const Compiled compiled, compile(bytes, options));
    // What the runtime gets is what a file holds.
    SHALE_TRY(const Package package, read_package(write_package(compiled.package)));
    return must_accept ? run_network(*device_, package, inputs) : std::vector<Tensor>{};
  }

  /// The file that the description's list `list` names as `key` for a value.
  static Result<std::string> file_of(const fs::path& folder, const Json& description,
                                     const char* list, const char* key, const Graph& graph,
                                     ValueId id) {
    const std::string& name = graph.value(id).name;
    std::string file;
    for (const Json& entry : description.value(list, Json::array()))
      if (entry.value("name", "") == name) file = entry.value(key, "");
    if (file.empty())
      return bad_input((folder / "desc.json").string(), "names no {} for \"{}\"", key, name);
    return (folder / file).string();
  }

  const Arguments& arguments_;
  const ToolDevice* device_;
  const NativeDevice* native_;
};

Result<int> conform(const Arguments& arguments) {
  std::vector<fs::path> cases;
  for (const std::string& folder : arguments.folders) {
    SHALE_TRY(const std::vector<fs::path> found, find_cases(folder));
    cases.insert(cases.end(), found.begin(), found.end());
  }
  if (cases.empty()) return bad_input("", "no folder with a desc.json below the given folders");
  std::optional<ToolDevice> device;
  std::optional<NativeDevice> native;
  if (arguments.backend == "device") {
    SHALE_TRY(device, ToolDevice::open(arguments.device));
  } else if (arguments.backend == "native") {
    SHALE_TRY(native, NativeDevice::open(arguments.device));
  }
  const Runner runner(arguments, device ? &*device : nullptr, native ? &*native : nullptr);
  size_t passed = 0;
  Json failures = Json::array();
  {
    Progress progress("conform");
    for (size_t i = 0; i < cases.size(); ++i) {
      if (!progress.step(i, cases.size())) return bad_input("", "interrupted");
      Outcome outcome = runner.run(cases[i]);
      if (device || native) {
        const std::vector<std::string> messages =
            device ? device->take_validation_messages() : native->take_validation_messages();
        if (outcome.passed && !messages.empty())
          outcome.passed = false, outcome.detail = "validation: " + messages.front();
      }
      passed += outcome.passed ? 1 : 0;
      if (!outcome.passed) failures.push_back({{"case", outcome.name}, {"detail", outcome.detail}});
    }
  }
  if (device) SHALE_TRY_VOID(device->close());
  if (native) SHALE_TRY_VOID(native->close());
  if (arguments.json) {
    print_json({{"backend", arguments.backend},
                {"passed", passed},
                {"failed", failures.size()},
                {"failures", failures}});
  } else {
    for (const Json& failure : failures)
      fmt::print("FAILED {}: {}\n", failure["case"].get<std::string>(),
                 failure["detail"].get<std::string>());
    fmt::print("{} passed, {} failed\n", passed, failures.size());
  }
  return failures.empty() ? kDone : kRefused;
}

}  // namespace

Action add_conform(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("folders", arguments->folders, "case folders, or folders of such")->required();
  app.add_option("--backend", arguments->backend,
                 "interpreter, device, or native: the device's own data graph pipelines")
      ->check(CLI::IsMember({"interpreter", "device", "native"}));
  add_device_options(app, arguments->device);
  arguments->compile.add_to(app, &arguments->device);
  app.add_flag("--json", arguments->json, "print the result as JSON");
  app.footer(
      "Outputs are compared bit for bit. Where an output of desc.json has the key \"error\", its "
      "file "
      "holds float64, and that key's file the error that each element may have.\n"
      "Example: shale conform build/golden/tosa --backend device --no-passes");
  return [arguments] { return conform(*arguments); };
}

}  // namespace shale
