// shale convert: a model in another file format, a package as VGF.
#include "compiler/frontend/vgf/convert.h"

#include <filesystem>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "ir/base/file.h"
#include "ir/binary/tosa.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"
#include "tools/shale/command.h"
#include "tools/shale/outputs.h"

namespace shale {
namespace {

struct Arguments {
  std::string input, output, to, precision = "int8";
  ImportArguments import;
  PackageToVgfOptions package;
  bool json = false;
};

std::vector<uint8_t> text_bytes(const Graph& graph) {
  const std::string text = print_text(graph);
  return {text.begin(), text.end()};
}

Result<std::vector<uint8_t>> spirv_bytes(const Graph& graph) {
  SHALE_TRY(const SpirvGraphModule module, write_spirv_graph(graph, {}));
  const auto* words = reinterpret_cast<const uint8_t*>(module.words.data());
  return std::vector<uint8_t>(words, words + 4 * module.words.size());
}

Result<std::vector<uint8_t>> vgf_bytes(const Graph& graph) {
  SHALE_TRY(const Vgf vgf, graph_to_vgf(graph));
  return write_vgf(vgf);
}

struct Format {
  const char* name;
  Result<std::vector<uint8_t>> (*write)(const Graph&);
};

/// By suffix of the file, without its point.
constexpr Format kFormats[] = {
    {"tosa", [](const Graph& graph) -> Result<std::vector<uint8_t>> { return write_tosa(graph); }},
    {"tir", [](const Graph& graph) -> Result<std::vector<uint8_t>> { return text_bytes(graph); }},
    {"vgf", vgf_bytes},
    {"spv", spirv_bytes}};

Result<const Format*> output_format(const Arguments& arguments) {
  std::string name = arguments.to;
  if (name.empty()) {
    name = std::filesystem::path(arguments.output).extension().string();
    if (!name.empty()) name.erase(0, 1);
  }
  std::string known;
  for (const Format& format : kFormats) {
    if (format.name == name) return &format;
    known += fmt::format("{}{}", known.empty() ? "" : ", ", format.name);
  }
  return bad_input("--to", "\"{}\" is no format to write, expected one of: {}", name, known);
}

Result<std::vector<uint8_t>> convert_package(const Arguments& arguments, const Format& format,
                                             std::span<const uint8_t> bytes, Json& json) {
  if (format.write != vgf_bytes)
    return bad_input("--to", "a package becomes vgf only, found {}", format.name);
  SHALE_TRY(const Package package, read_package(bytes));
  SHALE_TRY(const Vgf vgf, package_to_vgf(package, arguments.package));
  json["from"] = "shale";
  json["segments"] = vgf.segments.size();
  return write_vgf(vgf);
}

Result<std::vector<uint8_t>> convert_model(const Arguments& arguments, const Format& format,
                                           std::span<const uint8_t> bytes, Json& json) {
  if (arguments.package.weights_as_inputs || arguments.package.variant != 0)
    return bad_input("--variant, --weights-as-inputs", "the file is a model, not a package");
  SHALE_TRY(const ImportOptions import, arguments.import.options());
  SHALE_TRY(const Graph graph, import_graph(bytes, import));
  SHALE_TRY_VOID(verify(graph, OpenSizes::kAllowed));
  json["from"] = model_format(bytes);
  json["operators"] = graph.nodes.size();
  return format.write(graph);
}

Result<int> convert(const Arguments& arguments) {
  SHALE_TRY(const Format* const format, output_format(arguments));
  Outputs outputs(arguments.json);
  outputs.keep({arguments.input});
  outputs.keep_named(arguments.import.constants);
  SHALE_TRY_VOID(outputs.claim("-o", arguments.output));
  SHALE_TRY(const ModelFiles model, load_model(arguments.input, "", arguments.precision));
  Json json{{"input", model.path}, {"output", arguments.output}};
  const Result<std::vector<uint8_t>> bytes =
      is_package(model.bytes) ? convert_package(arguments, *format, model.bytes, json)
                              : convert_model(arguments, *format, model.bytes, json);
  if (!bytes) return in_file(model.path, bytes.error());
  SHALE_TRY_VOID(write_file(arguments.output, *bytes));
  json["to"] = format->name;
  json["bytes"] = bytes->size();
  if (arguments.json)
    print_json(json);
  else
    fmt::print(outputs.summary(), "wrote {} ({}, {} bytes)\n", arguments.output, format->name,
               bytes->size());
  return kDone;
}

}  // namespace

Action add_convert(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("input", arguments->input,
                 fmt::format("model ({}), model folder, or package (.shale)", kModelKinds))
      ->required();
  app.add_option("-o,--output", arguments->output, "file to write")->required();
  app.add_option(
      "--to", arguments->to,
      "tosa, tir, vgf or spv (default: the suffix of the output); a package becomes vgf");
  add_precision_option(app, arguments->precision);
  arguments->import.add_to(app);
  app.add_option("--variant", arguments->package.variant, "variant of the package");
  app.add_flag("--weights-as-inputs", arguments->package.weights_as_inputs,
               "for a package: weights are inputs of the VGF file, their data its constants");
  app.add_flag("--json", arguments->json, "print the summary as JSON");
  app.footer(
      "Example: shale convert models/srpo_x2 -o srpo.vgf\n"
      "         shale convert network.vgf --entry-point decoder -o decoder.tosa\n"
      "         shale convert srpo.shale --weights-as-inputs -o srpo_compute.vgf");
  return [arguments] { return convert(*arguments); };
}

}  // namespace shale
