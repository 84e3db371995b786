// shale dump: a model as text, a package as a listing, its shaders as assembly.
#include <filesystem>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/vgf.h"
#include "compiler/spirv/check.h"
#include "ir/base/file.h"
#include "ir/text/text.h"
#include "tools/shale/command.h"
#include "tools/shale/outputs.h"

namespace shale {
namespace {

struct Arguments {
  std::string file, output, modules;
  CompileArguments compile;
  std::string what = "text";
  bool plan = false;
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
    for (const Segment& segment : variant.segments) {
      for (const Dispatch& dispatch : segment.dispatches)
        entry["dispatches"].push_back(
            {{"segment", segment.name},
             {"name", dispatch.name},
             {"kernel", dispatch.kernel},
             {"module", dispatch.module},
             {"workgroups", dispatch.workgroups},
             {"indirect", dispatch.indirect ? Json{{"resource", dispatch.indirect->resource},
                                                   {"first", dispatch.indirect->first}}
                                            : Json()},
             {"macs", dispatch.cost.macs},
             {"time_us", dispatch.cost.time_us}});
      for (const auto& [index, form] : segment.start_forms)
        entry["start_forms"].push_back({{"name", form.name},
                                        {"kernel", form.kernel},
                                        {"module", form.module},
                                        {"workgroups", form.workgroups},
                                        {"time_us", form.cost.time_us}});
    }
    for (const RangeProof& proof : variant.proofs)
      entry["range_proofs"].push_back({{"name", proof.name},
                                       {"min", proof.min},
                                       {"max", proof.max},
                                       {"magnitude", proof.magnitude}});
    dump.json["variants"].push_back(std::move(entry));
  }
  return dump;
}

Json number_or_null(uint32_t number) { return number == kVgfNone ? Json() : Json(number); }

Json slots_json(const std::vector<VgfSlot>& slots) {
  Json list = Json::array();
  for (const VgfSlot& slot : slots)
    list.push_back({{"binding", slot.binding}, {"mrt_index", slot.resource}});
  return list;
}

Json vgf_header_json(const Vgf& vgf, const VgfLayout& layout) {
  const auto section = [](const VgfLayout::Section& s) {
    return Json{{"offset", s.offset}, {"size", s.size}};
  };
  return {{"header",
           {{"magic", layout.old_magic ? "C3D2E1F0" : "VGF1"},
            {"vk_header_version", vgf.vk_header_version},
            {"version", vgf.version}}},
          {"sections",
           {{"module_table", section(layout.modules)},
            {"model_sequence", section(layout.sequence)},
            {"model_resource_table", section(layout.resources)},
            {"constants", section(layout.constants)}}},
          {"constants_tag", layout.legacy_constants ? Json() : Json("CONST00")}};
}

Json module_json(const VgfModule& module) {
  Json json{{"type", vgf_name(module.type)},
            {"name", module.name},
            {"entry_point", module.entry_point},
            {"code", vgf_name(module.code)}};
  if (!module.source.empty()) {
    json["chars"] = module.source.size();
    json["source_text"] = module.source;
  }
  if (module.words.empty()) return json;
  json["words"] = module.words.size();
  json["spirv_header"] = {{"magic", fmt::format("{:#010x}", module.words[0])},
                          {"version", fmt::format("{:#010x}", module.words[1])},
                          {"bound", module.words[3]}};
  return json;
}

/// Sizes as numbers, open ones as "?".
Json shape_json(const Shape& shape) {
  Json list = Json::array();
  for (const int64_t size : shape) list.push_back(size == kDynamic ? Json("?") : Json(size));
  return list;
}

Json resource_json(const VgfResource& resource) {
  Json json{{"vk_descriptor_type", number_or_null(resource.descriptor_type)},
            {"vk_format", resource.format},
            {"category", vgf_name(resource.category)},
            {"shape", shape_json(resource.shape)},
            {"strides", resource.strides}};
  if (const std::optional<VgfSampler>& s = resource.sampler)
    json["sampler_config"] = {{"min_filter", s->min_filter},
                              {"mag_filter", s->mag_filter},
                              {"address_mode_u", s->address_mode_u},
                              {"address_mode_v", s->address_mode_v},
                              {"border_color", s->border_color}};
  json["alias_group_id"] = number_or_null(resource.alias_group);
  return json;
}

Json constant_json(const Vgf& vgf, const VgfLayout& layout, size_t index) {
  const VgfConstant& constant = vgf.constants[index];
  Json json{{"mrt_index", constant.resource},
            {"sparsity_dimension", constant.sparsity_dimension},
            {"size", constant.bytes.size()}};
  if (constant.sparsity_dimension >= 0)
    json["sparsity_holds"] = check_sparsity(vgf, index).has_value();
  if (!layout.legacy_constants) json["payload_offset"] = layout.payload_offsets[index];
  std::string first;
  for (size_t i = 0; i < std::min<size_t>(constant.bytes.size(), 16); ++i)
    first += fmt::format("{:02x}", constant.bytes[i]);
  json["first_bytes_hex"] = first;
  return json;
}

Json segment_json(const VgfSegment& segment) {
  Json sets = Json::array(), ranges = Json::array();
  for (size_t i = 0; i < segment.sets.size(); ++i)
    sets.push_back({{"set_index_field", number_or_null(segment.sets[i].set_index)},
                    {"set_index_effective", segment.set_number(i)},
                    {"bindings", slots_json(segment.sets[i].bindings)}});
  for (const VgfPushConstants& range : segment.push_constants)
    ranges.push_back(
        {{"stage_flags", range.stage_flags}, {"offset", range.offset}, {"size", range.size}});
  return {{"type", vgf_name(segment.type)},       {"name", segment.name},
          {"module_index", segment.module},       {"set_infos", sets},
          {"inputs", slots_json(segment.inputs)}, {"outputs", slots_json(segment.outputs)},
          {"constants", segment.constants},       {"dispatch_shape", segment.dispatch},
          {"push_constant_ranges", ranges}};
}

Result<Dump> vgf_dump(std::span<const uint8_t> bytes) {
  VgfLayout layout;
  SHALE_TRY(const Vgf vgf, read_vgf(bytes, &layout));
  Dump dump{dump_vgf(vgf, &layout), vgf_header_json(vgf, layout)};
  Json& json = dump.json;
  for (const char* list : {"modules", "resources", "constants", "segments"})
    json[list] = Json::array();
  for (const VgfModule& module : vgf.modules) json["modules"].push_back(module_json(module));
  for (const VgfResource& resource : vgf.resources)
    json["resources"].push_back(resource_json(resource));
  for (size_t i = 0; i < vgf.constants.size(); ++i)
    json["constants"].push_back(constant_json(vgf, layout, i));
  for (const VgfSegment& segment : vgf.segments) json["segments"].push_back(segment_json(segment));
  json["model"] = {{"inputs", slots_json(vgf.inputs)},
                   {"outputs", slots_json(vgf.outputs)},
                   {"input_names", vgf.input_names},
                   {"output_names", vgf.output_names}};
  return dump;
}

/// The entry points as comments of the text form, then the graph where it can be read.
Result<Dump> spirv_dump(std::span<const uint8_t> bytes, const ImportOptions& import) {
  SHALE_TRY(const std::vector<SpirvEntryPoint> entries, list_spirv_entry_points(bytes));
  std::string text;
  Json list = Json::array();
  for (const SpirvEntryPoint& entry : entries) {
    text += fmt::format("# entry point \"{}\"\n", entry.name);
    Json json{{"name", entry.name}};
    const auto add = [&](const char* what, const std::vector<SpirvEntryPoint::Slot>& slots) {
      json[what] = Json::array();
      for (const SpirvEntryPoint::Slot& slot : slots) {
        const std::string type =
            slot.ranked ? type_text(slot.type)
                        : std::string(dtype_info(slot.type.dtype).name) + " of unknown rank";
        text += fmt::format("#   {}: set {} binding {} {} \"{}\"\n", what, slot.set, slot.binding,
                            type, slot.name);
        json[what].push_back(
            {{"name", slot.name}, {"set", slot.set}, {"binding", slot.binding}, {"type", type}});
      }
    };
    add("inputs", entry.inputs);
    add("outputs", entry.outputs);
    json["constants"] = Json::array();
    for (size_t i = 0; i < entry.constant_ids.size(); ++i) {
      const std::string type = type_text(entry.constant_types[i]);
      text += fmt::format("#   constants: {} {}\n", entry.constant_ids[i], type);
      json["constants"].push_back({{"id", entry.constant_ids[i]}, {"type", type}});
    }
    list.push_back(std::move(json));
  }
  const Result<Graph> graph = import_graph(bytes, import);
  Dump dump = graph ? graph_dump(*graph) : Dump();
  if (!graph) {
    text += fmt::format("# {}\n", graph.error().text());
    dump.json["graph_error"] = graph.error().text();
  }
  dump.text = text + dump.text;
  dump.json["entry_points"] = std::move(list);
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

/// What would be compiled, for each target.
Result<Dump> plan_dump(const Arguments& arguments, const ModelFiles& model) {
  if (is_package(model.bytes)) return bad_input("--plan", "needs a model, the file is a package");
  SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
  SHALE_TRY(const std::vector<std::string> texts, plan_texts(model.bytes, options));
  Dump dump{{}, Json::array()};
  for (size_t i = 0; i < texts.size(); ++i) {
    dump.text += (i == 0 ? "" : "\n") + texts[i];
    dump.json.push_back({{"target", options.targets[i]}, {"plan", texts[i]}});
  }
  return dump;
}

/// A file of SPIR-V words for every module of every variant; prints how many.
Result<Dump> write_modules(const Package& package, const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return io_error(folder, "cannot create: {}", error.message());
  Dump dump;
  for (size_t v = 0; v < package.variants.size(); ++v) {
    const std::vector<Spirv>& modules = package.variants[v].modules;
    for (size_t m = 0; m < modules.size(); ++m) {
      const std::string path =
          (std::filesystem::path(folder) / fmt::format("variant{}_module{}.spv", v, m)).string();
      const auto* bytes = reinterpret_cast<const uint8_t*>(modules[m].data());
      SHALE_TRY_VOID(write_file(path, {bytes, modules[m].size() * sizeof(uint32_t)}));
    }
    dump.text += fmt::format("variant {} \"{}\": {} modules\n", v, package.variants[v].target,
                             modules.size());
    dump.json.push_back({{"variant", v}, {"modules", modules.size()}});
  }
  return dump;
}

Result<Dump> dump_file(const Arguments& arguments, const ModelFiles& model) {
  if (arguments.plan) return plan_dump(arguments, model);
  const std::vector<uint8_t>& bytes = model.bytes;
  if (bytes.empty() && model.frame)
    return bad_input("", "is a sandwich without a network, so there is no graph to print");
  if (!is_package(bytes)) {
    if (!arguments.modules.empty())
      return bad_input("--modules", "needs a package, the file is a model");
    if (arguments.what != "text" && arguments.what != "graph")
      return bad_input("--what", "\"{}\" needs a package, the file is a model", arguments.what);
    if (arguments.what == "text" && is_vgf(bytes)) return vgf_dump(bytes);
    SHALE_TRY(const ImportOptions import, arguments.compile.import.options());
    if (arguments.what == "text" && is_spirv(bytes)) return spirv_dump(bytes, import);
    SHALE_TRY(const Graph graph, import_graph(bytes, import));
    return graph_dump(graph);
  }
  if (arguments.what == "graph")
    return bad_input("--what", "\"graph\" needs a model, the file is a package");
  SHALE_TRY(const Package package, read_package(bytes));
  if (!arguments.modules.empty()) return write_modules(package, arguments.modules);
  if (arguments.what == "text") return package_dump(package);
  if (arguments.variant >= package.variants.size())
    return bad_input("--variant", "found {}, the package has {}", arguments.variant,
                     package.variants.size());
  const Variant& variant = package.variants[arguments.variant];
  if (arguments.what == "memory") return memory_plan(variant);
  return shader_dump(variant, arguments.module);
}

Result<int> dump(const Arguments& arguments) {
  Outputs outputs;
  outputs.keep({arguments.file});
  outputs.keep(arguments.compile.files());
  SHALE_TRY_VOID(outputs.claim("-o", arguments.output));
  SHALE_TRY(const ModelFiles model,
            load_model(arguments.file, arguments.compile.frame, arguments.compile.precision));
  const Result<Dump> result = dump_file(arguments, model);
  if (!result) return in_file(model.path, result.error());
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
  app.add_option("file", arguments->file,
                 fmt::format("model ({}), model folder, or package (.shale)", kModelKinds))
      ->required();
  app.add_option("-o,--output", arguments->output, "write to a file instead of the terminal");
  app.add_option(
         "--what", arguments->what,
         "text: the graph, package or container; graph: the graph alone; memory: the arena; "
         "spirv: the shaders")
      ->check(CLI::IsMember({"text", "graph", "memory", "spirv"}));
  app.add_flag("--plan", arguments->plan,
               "what would run, for each --target: resources, dispatches, bindings, copies");
  arguments->compile.add_to(app);
  app.add_option("--variant", arguments->variant, "variant of the package");
  app.add_option("--module", arguments->module, "only this shader module");
  app.add_option("--modules", arguments->modules,
                 "folder for the shaders of all variants, a SPIR-V file each");
  app.add_flag("--json", arguments->json, "print as JSON");
  app.footer(
      "Example: shale dump srpo.shale --what memory\n"
      "         shale dump network.vgf --what graph\n"
      "         shale dump models/nss_v1_high --plan --target lavapipe,dot8-gpu");
  return [arguments] { return dump(*arguments); };
}

}  // namespace shale
