// Graph segments of a VGF file to and from Graph.
#include <algorithm>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/convert.h"
#include "compiler/frontend/vgf/formats.h"
#include "compiler/frontend/vgf/layout.h"

namespace shale {
namespace {

using vgf_layout::label;

std::span<const uint8_t> bytes_of(const std::vector<uint32_t>& words) {
  return {reinterpret_cast<const uint8_t*>(words.data()), words.size() * sizeof(uint32_t)};
}

Result<size_t> find_segment(const Vgf& vgf, const std::string& wanted) {
  std::vector<size_t> graphs, named;
  std::string known;
  for (size_t i = 0; i < vgf.segments.size(); ++i) {
    const VgfSegment& segment = vgf.segments[i];
    if (segment.type != VgfModuleType::kGraph) continue;
    graphs.push_back(i);
    known += fmt::format("{}\"{}\"", known.empty() ? "" : ", ", segment.name);
    if (segment.name == wanted) named.push_back(i);
  }
  if (graphs.empty())
    return bad_input("", "has no graph segment, found {} of the type COMPUTE", vgf.segments.size());
  if (wanted.empty()) {
    if (graphs.size() == 1) return graphs.front();
    return bad_input("", "has {} graph segments, name one with --entry-point: {}", graphs.size(),
                     known);
  }
  if (named.empty())
    std::copy_if(graphs.begin(), graphs.end(), std::back_inserter(named), [&](size_t i) {
      return vgf.modules[vgf.segments[i].module].entry_point == wanted;
    });
  if (named.size() == 1) return named.front();
  return bad_input("--entry-point", "found \"{}\", which is the name of {} graph segments of: {}",
                   wanted, named.size(), known);
}

/// Resources of the interface under the names that the model gives them.
std::vector<ExternalTensor> interface_of(const Vgf& vgf, const VgfSegment& segment) {
  std::map<uint32_t, std::string> names;
  for (size_t i = 0; i < vgf.input_names.size(); ++i)
    names.emplace(vgf.inputs[i].resource, vgf.input_names[i]);
  for (size_t i = 0; i < vgf.output_names.size(); ++i)
    names.emplace(vgf.outputs[i].resource, vgf.output_names[i]);
  std::vector<ExternalTensor> tensors;
  for (size_t i = 0; i < segment.sets.size(); ++i)
    for (const VgfSlot& slot : segment.sets[i].bindings) {
      const VgfResource& resource = vgf.resources[slot.resource];
      ExternalTensor tensor;
      tensor.set = segment.set_number(i);
      tensor.binding = slot.binding;
      tensor.type.dtype = dtype_of_vk_format(resource.format);
      for (const int64_t dim : resource.shape) tensor.type.shape.push_back(dim);
      if (const auto name = names.find(slot.resource); name != names.end())
        tensor.name = name->second;
      tensors.push_back(std::move(tensor));
    }
  return tensors;
}

/// Data of the graph constants that the module asks for.
std::vector<ExternalConstant> constants_of(const Vgf& vgf, const VgfSegment& segment,
                                           std::span<const uint32_t> ids) {
  const std::vector<uint32_t>& listed = segment.constants;
  const bool by_number = std::all_of(ids.begin(), ids.end(), [&](uint32_t id) {
    return std::find(listed.begin(), listed.end(), id) != listed.end();
  });
  const bool by_position =
      std::all_of(ids.begin(), ids.end(), [&](uint32_t id) { return id < listed.size(); });
  std::vector<ExternalConstant> constants;
  for (uint32_t i = 0; i < listed.size(); ++i) {
    const VgfConstant& constant = vgf.constants[listed[i]];
    constants.push_back({!by_number && by_position ? i : listed[i], constant.bytes,
                         vgf.resources[constant.resource].shape});
  }
  return constants;
}

}  // namespace

Result<Graph> import_vgf(std::span<const uint8_t> bytes, const ImportOptions& options) {
  if (!options.constants.empty())
    return bad_input("--constant", "the format holds its constants itself");
  SHALE_TRY(const Vgf vgf, read_vgf(bytes));
  SHALE_TRY(const size_t index, find_segment(vgf, options.entry_point));
  const VgfSegment& segment = vgf.segments[index];
  const VgfModule& module = vgf.modules[segment.module];
  const std::string where = label("module", segment.module, module.name);
  if (module.words.empty())
    return bad_input(where, "is {}, expected SPIR-V with a graph",
                     module.code == VgfCode::kSpirv ? "a placeholder" : vgf_name(module.code));
  for (const uint32_t constant : segment.constants) SHALE_TRY_VOID(check_sparsity(vgf, constant));

  const auto in_module = [&](Error error) {
    error.where = error.where.empty() ? where : where + ", " + error.where;
    return error;
  };
  SpirvGraphOptions given;
  given.entry_point = module.entry_point;
  given.input_shapes = options.input_shapes;
  given.interface = interface_of(vgf, segment);
  const Result<std::vector<SpirvEntryPoint>> entries =
      list_spirv_entry_points(bytes_of(module.words));
  if (!entries) return in_module(entries.error());
  for (const SpirvEntryPoint& entry : *entries)
    if (entry.name == module.entry_point || (module.entry_point.empty() && entries->size() == 1))
      given.constants = constants_of(vgf, segment, entry.constant_ids);
  Result<Graph> graph = read_spirv_graph(bytes_of(module.words), given);
  if (!graph) return in_module(graph.error());
  return graph;
}

Result<Vgf> graph_to_vgf(const Graph& graph) {
  SHALE_TRY(SpirvGraphModule module, write_spirv_graph(graph, {.external_constants = true}));
  // The module's own types: INT4 and rank 0 are others there.
  SHALE_TRY(const std::vector<SpirvEntryPoint> entries,
            list_spirv_entry_points(bytes_of(module.words)));
  const SpirvEntryPoint& entry = entries.front();
  Vgf vgf;
  VgfSegment segment;
  segment.type = VgfModuleType::kGraph;
  segment.name = graph.name;
  segment.sets.emplace_back();
  const auto add_interface = [&](const std::vector<SpirvEntryPoint::Slot>& slots,
                                 const std::vector<ValueId>& values, VgfCategory category,
                                 std::vector<VgfSlot>& of_segment) {
    for (size_t i = 0; i < slots.size(); ++i) {
      const SpirvEntryPoint::Slot& slot = slots[i];
      of_segment.push_back({slot.binding, static_cast<uint32_t>(vgf.resources.size())});
      segment.sets[0].bindings.push_back(of_segment.back());
      VgfResource resource;
      resource.descriptor_type = kVkDescriptorTensor;
      resource.format = vk_format_of_dtype(slot.type.dtype);
      resource.category = category;
      // The module has all sizes of a tensor or none; a resource has each by itself.
      const bool is_open =
          !slot.ranked || std::ranges::find(slot.type.shape, kDynamic) != slot.type.shape.end();
      resource.shape = is_open ? graph.value(values[i]).type.shape : slot.type.shape;
      vgf.resources.push_back(std::move(resource));
    }
  };
  add_interface(entry.inputs, graph.inputs, VgfCategory::kInput, segment.inputs);
  add_interface(entry.outputs, graph.outputs, VgfCategory::kOutput, segment.outputs);
  for (Tensor& tensor : module.constants) {
    segment.constants.push_back(static_cast<uint32_t>(vgf.constants.size()));
    vgf.constants.push_back(
        {static_cast<uint32_t>(vgf.resources.size()), -1, std::move(tensor.bytes)});
    VgfResource resource;
    resource.format = vk_format_of_dtype(tensor.type.dtype);
    resource.category = VgfCategory::kConstant;
    resource.shape = std::move(tensor.type.shape);
    vgf.resources.push_back(std::move(resource));
  }
  vgf.inputs = segment.inputs;
  vgf.outputs = segment.outputs;
  for (const ValueId id : graph.inputs) vgf.input_names.push_back(graph.value(id).name);
  for (const ValueId id : graph.outputs) vgf.output_names.push_back(graph.value(id).name);
  vgf.segments.push_back(std::move(segment));
  vgf.modules.push_back({VgfModuleType::kGraph, graph.name, std::move(module.entry_point),
                         VgfCode::kSpirv, std::move(module.words), ""});
  return vgf;
}

}  // namespace shale
