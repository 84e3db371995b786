// Writes the floating-point cases of float_cases.h as folders that `shale conform` reads: values in double precision with
// the error that TOSA lets each have. Usage: make_float_cases FOLDER
#include <filesystem>
#include <nlohmann/json.hpp>

#include "ir/base/file.h"
#include "ir/binary/tosa.h"
#include "tests/support/float_cases.h"
#include "tools/shale/npy.h"

namespace shale {
namespace {

Result<void> write_case(const FloatCase& each, const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return io_error(folder.string(), "cannot be made: {}", error.message());
  const auto at = [&](const std::string& file) { return (folder / file).string(); };
  nlohmann::json inputs = nlohmann::json::array(), outputs = nlohmann::json::array();
  for (size_t i = 0; i < each.inputs.size(); ++i) {
    const std::string& name = each.graph.value(each.graph.inputs[i]).name;
    SHALE_TRY_VOID(write_npy(at(name + ".npy"), each.inputs[i]));
    inputs.push_back({{"name", name}, {"file", name + ".npy"}});
  }
  const auto expected = output_precision(each.graph, each.inputs);
  for (size_t i = 0; i < expected.size(); ++i) {
    const Value& output = each.graph.value(each.graph.outputs[i]);
    std::vector<double> values, errors;
    for (const Precision& element : expected[i]) {
      values.push_back(element.value);
      errors.push_back(element.error);
    }
    const std::string file = "expected-" + output.name + ".npy",
                      bound = "error-" + output.name + ".npy";
    SHALE_TRY_VOID(write_npy(at(file), output.type.shape, values));
    SHALE_TRY_VOID(write_npy(at(bound), output.type.shape, errors));
    outputs.push_back({{"name", output.name}, {"file", file}, {"error", bound}});
  }
  const std::vector<uint8_t> graph = write_tosa(each.graph);
  SHALE_TRY_VOID(write_file(at("graph.tosa"), graph));
  const nlohmann::json description{{"case", "float/" + each.name},
                                   {"expect", "accept"},
                                   {"tosa_file", "graph.tosa"},
                                   {"inputs", inputs},
                                   {"outputs", outputs}};
  return write_text(at("desc.json"), description.dump(2) + "\n");
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  if (argc != 2) {
    fmt::print(stderr, "usage: make_float_cases FOLDER\n");
    return 2;
  }
  for (const shale::FloatCase& each : shale::float_cases())
    if (const auto written = shale::write_case(each, std::filesystem::path(argv[1]) / each.name);
        !written) {
      fmt::print(stderr, "{}\n", written.error().text());
      return 1;
    }
  return 0;
}
