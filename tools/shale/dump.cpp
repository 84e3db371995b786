// shale dump: a model as text, a package as a listing, its shaders as assembly.
#include "compiler/frontend/frontend.h"
#include "compiler/spirv/check.h"
#include "ir/base/file.h"
#include "ir/text/text.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

struct Arguments {
  std::string file, output;
  std::string what = "text";
  uint32_t variant = 0;
  int32_t module = -1;
  bool json = false;
};

/// The same content for people and for programs.
struct Dump {
  std::string text;
  Json json;
};

/// Offsets and lives of intermediate tensors, in order of offset.
Dump memory_plan(const Variant& variant) {
  std::vector<const Resource*> tensors;
  for (const Resource& resource : variant.resources)
    if (resource.category == Category::kIntermediate) tensors.push_back(&resource);
  std::stable_sort(tensors.begin(), tensors.end(), [](const Resource* a, const Resource* b) {
    return a->offset_bytes < b->offset_bytes;
  });
  Dump dump;
  dump.text = fmt::format("arena {} bytes\n  {:>12} {:>12}  first  last  tensor\n",
                          variant.arena_bytes, "offset", "bytes");
  dump.json = {{"arena_bytes", variant.arena_bytes}, {"tensors", Json::array()}};
  for (const Resource* tensor : tensors) {
    const size_t index = static_cast<size_t>(tensor - variant.resources.data());
    size_t number = 0, first = SIZE_MAX, last = 0;
    for (const Segment& segment : variant.segments)
      for (const Dispatch& dispatch : segment.dispatches) {
        for (const Binding& binding : dispatch.bindings)
          if (binding.resource == index) first = std::min(first, number), last = number;
        ++number;
      }
    dump.text += fmt::format("  {:>12} {:>12}  {:>5} {:>5}  {}\n", tensor->offset_bytes,
                             tensor->size_bytes, first, last, tensor->name);
    dump.json["tensors"].push_back({{"name", tensor->name},
                                    {"offset", tensor->offset_bytes},
                                    {"bytes", tensor->size_bytes},
                                    {"first", first},
                                    {"last", last}});
  }
  return dump;
}

Dump graph_dump(const Graph& graph) {
  Dump dump{print_text(graph), {{"graph", graph.name}}};
  const auto names = [&](const std::vector<ValueId>& ids) {
    Json list = Json::array();
    for (const ValueId id : ids) list.push_back(graph.value(id).name);
    return list;
  };
  dump.json["inputs"] = names(graph.inputs);
  dump.json["outputs"] = names(graph.outputs);
  for (const Value& value : graph.values)
    dump.json["values"].push_back(
        {{"name", value.name}, {"type", type_text(value.type)}, {"constant", value.is_constant()}});
  for (const Node& node : graph.nodes) {
    Json attributes = Json::object();
    for (const Attr attr : op_info(node.op).attrs)
      attributes[std::string(attr_info(attr).name)] = node.attrs.list(attr);
    dump.json["nodes"].push_back({{"op", op_info(node.op).name},
                                  {"inputs", names(node.inputs)},
                                  {"output", graph.value(node.output).name},
                                  {"attributes", attributes}});
  }
  return dump;
}

Dump package_dump(const Package& package) {
  Dump dump{dump_package(package),
            {{"model", package.provenance.model_name},
             {"compiler", package.provenance.compiler},
             {"options", package.provenance.options},
             {"weight_bytes", package.weights.size()}}};
  for (const Variant& variant : package.variants) {
    Json entry{{"target", variant.target},
               {"arena_bytes", variant.arena_bytes},
               {"modules", variant.modules.size()}};
    for (const Segment& segment : variant.segments)
      for (const Dispatch& dispatch : segment.dispatches)
        entry["dispatches"].push_back({{"segment", segment.name},
                                       {"name", dispatch.name},
                                       {"kernel", dispatch.kernel},
                                       {"module", dispatch.module},
                                       {"workgroups", dispatch.workgroups},
                                       {"macs", dispatch.cost.macs},
                                       {"time_us", dispatch.cost.time_us}});
    for (const RangeProof& proof : variant.proofs)
      entry["range_proofs"].push_back({{"name", proof.name},
                                       {"min", proof.min},
                                       {"max", proof.max},
                                       {"magnitude", proof.magnitude}});
    dump.json["variants"].push_back(std::move(entry));
  }
  return dump;
}

Result<Dump> shader_dump(const Variant& variant, int32_t module) {
  Dump dump;
  for (size_t i = 0; i < variant.modules.size(); ++i) {
    if (module >= 0 && i != static_cast<size_t>(module)) continue;
    SHALE_TRY(const std::string assembly, disassemble_spirv(variant.modules[i]));
    dump.text += fmt::format("; module {}\n{}", i, assembly);
    dump.json.push_back({{"module", i}, {"assembly", assembly}});
  }
  if (dump.text.empty())
    return bad_input("--module", "found {}, the variant has {}", module, variant.modules.size());
  return dump;
}

Result<Dump> dump_file(const Arguments& arguments) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(arguments.file));
  if (!is_package(bytes)) {
    if (arguments.what != "text")
      return bad_input("--what", "\"{}\" needs a package, the file is a model", arguments.what);
    SHALE_TRY(const Graph graph, import_model(bytes));
    return graph_dump(graph);
  }
  SHALE_TRY(const Package package, read_package(bytes));
  if (arguments.what == "text") return package_dump(package);
  if (arguments.variant >= package.variants.size())
    return bad_input("--variant", "found {}, the package has {}", arguments.variant,
                     package.variants.size());
  const Variant& variant = package.variants[arguments.variant];
  if (arguments.what == "memory") return memory_plan(variant);
  return shader_dump(variant, arguments.module);
}

Result<int> dump(const Arguments& arguments) {
  const Result<Dump> result = dump_file(arguments);
  if (!result) return in_file(arguments.file, result.error());
  const std::string text = arguments.json ? json_text(result->json) : result->text;
  if (arguments.output.empty()) {
    fmt::print("{}", text);
    return kDone;
  }
  SHALE_TRY_VOID(write_text(arguments.output, text));
  return kDone;
}

}  // namespace

Action add_dump(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("file", arguments->file, "model (.tosa, .tir) or package (.shale)")->required();
  app.add_option("-o,--output", arguments->output, "write to a file instead of the terminal");
  app.add_option("--what", arguments->what,
                 "text: the graph or the package; memory: the arena; spirv: the shaders")
      ->check(CLI::IsMember({"text", "memory", "spirv"}));
  app.add_option("--variant", arguments->variant, "variant of the package");
  app.add_option("--module", arguments->module, "only this shader module");
  app.add_flag("--json", arguments->json, "print as JSON");
  app.footer("Example: shale dump srpo.shale --what memory");
  return [arguments] { return dump(*arguments); };
}

}  // namespace shale
