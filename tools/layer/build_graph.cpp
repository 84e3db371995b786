#include "tools/layer/build_graph.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cstring>

#include "compiler/driver/compile.h"
#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/formats.h"
#include "compiler/target/caps_json.h"
#include "ir/base/hash.h"
#include "tools/layer/chain.h"
#include "tools/layer/disk_cache.h"
#include "tools/layer/specialize.h"

namespace shale::layer {
namespace {

constexpr uint32_t kCapabilityOpcode = 17, kGraphCapability = 4191;

std::span<const uint8_t> bytes_of(const std::vector<uint32_t>& words) {
  return {reinterpret_cast<const uint8_t*>(words.data()), words.size() * sizeof(uint32_t)};
}

/// A number behind "expected-runs=" in the vendor's options, or in the environment.
std::optional<double> runs_in(const char* text) {
  constexpr std::string_view kKey = "expected-runs=";
  const std::string_view options = text ? text : "";
  const size_t at = options.find(kKey);
  if (at == std::string_view::npos) return std::nullopt;
  double runs = 0;
  const std::string_view number = options.substr(at + kKey.size());
  const auto parsed = std::from_chars(number.data(), number.data() + number.size(), runs);
  return parsed.ec == std::errc() && runs >= 1 ? std::optional(runs) : std::nullopt;
}

/// The options of one pipeline; null if there are none.
const char* vendor_options(const VkDataGraphPipelineCreateInfoARM& info) {
  const auto* control = find_in_chain<VkDataGraphPipelineCompilerControlCreateInfoARM>(
      info.pNext, VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_COMPILER_CONTROL_CREATE_INFO_ARM);
  return control ? control->pVendorOptions : nullptr;
}

double expected_runs(const VkDataGraphPipelineCreateInfoARM& info) {
  if (const auto runs = runs_in(vendor_options(info))) return *runs;
  if (info.flags & VK_PIPELINE_CREATE_DISABLE_OPTIMIZATION_BIT) return kRunsOfOne;
  return runs_in(secure_getenv("SHALE_LAYER_OPTIONS"))
      .value_or(kRunsOfFrame);  // others serve until then
}

/// The elements one behind the other.
std::vector<uint8_t> packed(const uint8_t* data, const TensorLayout& layout) {
  const uint64_t element = tensor_element_bytes(layout.format);
  const uint64_t total = layout.elements() * element;
  if (layout.packed) return {data, data + total};
  std::vector<uint8_t> bytes(total);
  std::vector<int64_t> index(layout.dims.size());
  const uint64_t row = static_cast<uint64_t>(layout.dims.back()) * element;
  for (uint64_t at = 0; at < total; at += row) {
    uint64_t from = 0;
    for (size_t i = 0; i + 1 < index.size(); ++i)
      from += static_cast<uint64_t>(index[i] * layout.strides[i]);
    std::memcpy(&bytes[at], data + from, row);
    for (size_t i = index.size() - 1; i-- > 0;) {
      if (++index[i] < layout.dims[i]) break;
      index[i] = 0;
    }
  }
  return bytes;
}

Result<std::vector<uint32_t>> module_words(
    Device& device, const VkDataGraphPipelineCreateInfoARM& info,
    const VkDataGraphPipelineShaderModuleCreateInfoARM& module) {
  const auto* chained = find_in_chain<VkShaderModuleCreateInfo>(
      info.pNext, VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
  if ((module.module != VK_NULL_HANDLE) == (chained != nullptr))
    return bad_input("VkDataGraphPipelineShaderModuleCreateInfoARM",
                     "expected either a module or a chained VkShaderModuleCreateInfo");
  if (chained) {
    if (chained->codeSize % sizeof(uint32_t) != 0)
      return bad_input("VkShaderModuleCreateInfo", "codeSize {} is no multiple of 4",
                       chained->codeSize);
    return std::vector<uint32_t>(chained->pCode, chained->pCode + chained->codeSize / 4);
  }
  const auto known = device.modules.find(module.module);
  if (!known) return bad_input("VkShaderModule", "the module has no graph");
  return known->words;
}

const VkTensorDescriptionARM* description_of(const void* next) {
  return find_in_chain<VkTensorDescriptionARM>(next, VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM);
}

/// What the graph of the source is, and where its tensors come from.
struct Interface {
  std::vector<SpirvEntryPoint::Slot> inputs, outputs;
  std::vector<uint32_t> constant_ids;
  std::vector<TensorType> constant_types;
};

Result<Interface> interface_of(const GraphSource& source) {
  SHALE_TRY(const auto entries, list_spirv_entry_points(bytes_of(source.words)));
  for (const SpirvEntryPoint& entry : entries)
    if (entry.name == source.entry_point)
      return Interface{entry.inputs, entry.outputs, entry.constant_ids, entry.constant_types};
  return bad_input("VkDataGraphPipelineShaderModuleCreateInfoARM",
                   "the module has no graph entry point \"{}\"", source.entry_point);
}

const GraphSource::Resource* resource_of(const GraphSource& source,
                                         const SpirvEntryPoint::Slot& slot) {
  for (const GraphSource::Resource& resource : source.resources)
    if (resource.set == slot.set && resource.binding == slot.binding) return &resource;
  return nullptr;
}

/// "in0 0.1.0;" or, for a tensor that is not packed, "in0 0.1.0 64,16,4;". Passes may add to it.
std::string tensor_name(const char* prefix, size_t index, const SpirvEntryPoint::Slot& slot,
                        const TensorLayout& layout) {
  std::string name =
      fmt::format("{}{} {}.{}.{}", prefix, index, slot.set, slot.binding, slot.element.value_or(0));
  if (!layout.packed) name += fmt::format(" {}", fmt::join(layout.strides, ","));
  return name + ";";
}

/// Renames inputs and outputs. An output that is no result of its own becomes one.
Result<void> name_interface(Graph& graph, const Interface& interface, const GraphSource& source) {
  for (size_t i = 0; i < graph.inputs.size(); ++i)
    graph.value(graph.inputs[i]).name =
        tensor_name("in", i, interface.inputs[i], resource_of(source, interface.inputs[i])->layout);
  std::set<ValueId> seen(graph.inputs.begin(), graph.inputs.end());
  for (size_t i = 0; i < graph.outputs.size(); ++i) {
    ValueId& output = graph.outputs[i];
    const std::string name = tensor_name("out", i, interface.outputs[i],
                                         resource_of(source, interface.outputs[i])->layout);
    if (seen.contains(output) || graph.value(output).is_constant())
      output = graph.add_node(Op::kIdentity, {}, {output}, name, graph.value(output).type);
    graph.value(output).name = name;
    seen.insert(output);
  }
  return {};
}

bool parse_numbers(std::string_view text, char separator, std::vector<int64_t>& numbers) {
  while (!text.empty()) {
    int64_t number = 0;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
    if (parsed.ec != std::errc() || number < 0) return false;
    numbers.push_back(number);
    text.remove_prefix(static_cast<size_t>(parsed.ptr - text.data()));
    if (text.empty()) return true;
    if (text.front() != separator || text.size() == 1) return false;
    text.remove_prefix(1);
  }
  return false;
}

}  // namespace

bool has_graphs(std::span<const uint32_t> words) {
  for (size_t at = 5; at < words.size();) {
    const size_t size = words[at] >> 16;
    if (size < 2 || size > words.size() - at) return false;
    // Capabilities come first.
    if ((words[at] & 0xffff) != kCapabilityOpcode) return false;
    if (words[at + 1] == kGraphCapability) return true;
    at += size;
  }
  return false;
}

Compile compile_when(const VkDataGraphPipelineCreateInfoARM& info) {
  const char* environment = secure_getenv("SHALE_LAYER_OPTIONS");
  for (const char* options : {vendor_options(info), environment})
    if (options && std::string_view(options).find("compile=at-once") != std::string_view::npos)
      return Compile::kAtOnce;
  return Compile::kInBackground;
}

Result<GraphSource> read_source(Device& device, const VkDataGraphPipelineCreateInfoARM& info,
                                const VkDataGraphPipelineShaderModuleCreateInfoARM& module) {
  GraphSource source;
  SHALE_TRY(source.words, module_words(device, info, module));
  SHALE_TRY_VOID(specialize(source.words, module.pSpecializationInfo));
  if (!module.pName) return bad_input("VkDataGraphPipelineShaderModuleCreateInfoARM", "no name");
  source.entry_point = module.pName;
  source.expected_runs = expected_runs(info);
  const auto layout = device.layouts.find(info.layout);
  if (!layout) return bad_input("VkPipelineLayout", "is unknown");
  if (layout->has_push_constants) return bad_input("VkPipelineLayout", "has push constants");
  if (info.resourceInfoCount > 0 && !info.pResourceInfos)
    return bad_input("VkDataGraphPipelineCreateInfoARM",
                     "has no resource infos behind pResourceInfos");
  for (uint32_t i = 0; i < info.resourceInfoCount; ++i) {
    const VkDataGraphPipelineResourceInfoARM& resource = info.pResourceInfos[i];
    const std::string where = fmt::format("resource {} (set {}, binding {})", i,
                                          resource.descriptorSet, resource.binding);
    const VkTensorDescriptionARM* description = description_of(resource.pNext);
    if (!description) return bad_input(where, "has no VkTensorDescriptionARM");
    if (resource.arrayElement != 0)
      return bad_input(where, "has array element {}, expected 0", resource.arrayElement);
    Result<TensorLayout> tensor = read_layout(*description, device);
    if (!tensor) return bad_input(where, "{}", tensor.error().text());
    if (graph_dtype(tensor->format) == DType::kUnknown)
      return unsupported(where, "format {} is none of graphs", static_cast<int>(tensor->format));
    const bool has_set =
        resource.descriptorSet < layout->sets.size() && layout->sets[resource.descriptorSet];
    const auto binding = has_set
                             ? layout->sets[resource.descriptorSet]->bindings.find(resource.binding)
                             : std::map<uint32_t, SetLayout::Binding>::iterator{};
    if (!has_set || binding == layout->sets[resource.descriptorSet]->bindings.end() ||
        binding->second.type != VK_DESCRIPTOR_TYPE_TENSOR_ARM)
      return bad_input(where, "the pipeline layout has no tensor there");
    source.resources.push_back({resource.descriptorSet, resource.binding, *std::move(tensor)});
  }
  if (module.constantCount > 0 && !module.pConstants)
    return bad_input("VkDataGraphPipelineShaderModuleCreateInfoARM",
                     "has no constants behind pConstants");
  for (uint32_t i = 0; i < module.constantCount; ++i) {
    const VkDataGraphPipelineConstantARM& constant = module.pConstants[i];
    const std::string where = fmt::format("constant {} (id {})", i, constant.id);
    const VkTensorDescriptionARM* description = description_of(constant.pNext);
    if (!description) return bad_input(where, "has no VkTensorDescriptionARM");
    if (!constant.pConstantData) return bad_input(where, "has no data");
    Result<TensorLayout> tensor = read_layout(*description, device);
    if (!tensor) return bad_input(where, "{}", tensor.error().text());
    std::vector<uint8_t> bytes =
        packed(static_cast<const uint8_t*>(constant.pConstantData), *tensor);
    source.constants.push_back({constant.id, *std::move(tensor), std::move(bytes)});
  }
  return source;
}

Identifier identify(const Device& device, const GraphSource& source) {
  std::string text = layer_identity() + caps_json(device.context->caps) + source.entry_point;
  text += fmt::format("\n{:g}\n", source.expected_runs);
  const auto add = [&](const TensorLayout& layout) {
    text += fmt::format(" {} {} {} [{}] [{}]\n", static_cast<int>(layout.tiling),
                        static_cast<int>(layout.format), layout.usage, fmt::join(layout.dims, ","),
                        fmt::join(layout.strides, ","));
  };
  for (const GraphSource::Resource& resource : source.resources) {
    text += fmt::format("{}.{}", resource.set, resource.binding);
    add(resource.layout);
  }
  for (const GraphSource::Constant& constant : source.constants) {
    text += fmt::format("#{}", constant.id);
    add(constant.layout);
  }
  Identifier identifier;
  for (size_t half = 0; half < 2; ++half) {
    uint64_t hash = kHashSeed + half;
    hash = stable_hash({reinterpret_cast<const uint8_t*>(text.data()), text.size()}, hash);
    hash = stable_hash(bytes_of(source.words), hash);
    for (const GraphSource::Constant& constant : source.constants)
      hash = stable_hash(constant.bytes, hash);
    std::memcpy(&identifier[8 * half], &hash, 8);
  }
  return identifier;
}

Result<Package> compile_source(const Device& device, const GraphSource& source, std::string& log) {
  SHALE_TRY(const Interface interface, interface_of(source));
  SpirvGraphOptions options{
      .entry_point = source.entry_point, .interface = {}, .constants = {}, .input_shapes = {}};
  for (const auto* slots : {&interface.inputs, &interface.outputs})
    for (const SpirvEntryPoint::Slot& slot : *slots) {
      const GraphSource::Resource* resource = resource_of(source, slot);
      if (!resource)
        return bad_input(fmt::format("variable \"{}\"", slot.name),
                         "there is no resource info for set {}, binding {}", slot.set,
                         slot.binding);
      options.interface.push_back({slot.set,
                                   slot.binding,
                                   {graph_dtype(resource->layout.format), resource->layout.dims},
                                   ""});
    }
  for (const GraphSource::Constant& constant : source.constants) {
    const auto used =
        std::find(interface.constant_ids.begin(), interface.constant_ids.end(), constant.id);
    if (used == interface.constant_ids.end()) continue;
    const TensorType& type =
        interface.constant_types[static_cast<size_t>(used - interface.constant_ids.begin())];
    const bool fits = type.shape.size() == constant.layout.dims.size() &&
                      std::equal(type.shape.begin(), type.shape.end(), constant.layout.dims.begin(),
                                 [](int64_t a, int64_t b) { return a == kDynamic || a == b; });
    const bool is_ranked = type.shape != Shape{kDynamic} || constant.layout.dims.size() == 1;
    if ((is_ranked && !fits) || graph_dtype(constant.layout.format) != type.dtype)
      return bad_input(fmt::format("constant with id {}", constant.id),
                       "is [{}] of format {}, the module has {}",
                       fmt::join(constant.layout.dims, ","),
                       static_cast<int>(constant.layout.format), type_text(type));
    options.constants.push_back({constant.id, constant.bytes, constant.layout.dims});
  }
  SHALE_TRY(Graph graph, read_spirv_graph(bytes_of(source.words), options));
  SHALE_TRY_VOID(name_interface(graph, interface, source));

  const DeviceProfile profile = profile_from_caps(device.context->caps);
  CompileOptions compile;
  compile.targets = {std::string(profile.name)};
  compile.profiles.emplace(profile.name, profile);
  compile.expected_runs = source.expected_runs;
  SHALE_TRY(Compiled compiled,
            compile_graph(std::move(graph), stable_hash(bytes_of(source.words)), compile));
  const Variant& variant = compiled.package.variants.front();
  size_t dispatches = 0;
  for (const Segment& segment : variant.segments) dispatches += segment.dispatches.size();
  log = fmt::format("compiled for {} in {:.0f} ms: {} dispatches, {} modules, arena {} bytes\n",
                    variant.target, compiled.kernels_ms, dispatches, variant.modules.size(),
                    variant.arena_bytes);
  for (const std::string& warning : compiled.warnings) log += "warning: " + warning + "\n";
  return std::move(compiled.package);
}

Result<std::vector<GraphTensor>> graph_tensors(const Variant& variant) {
  std::vector<GraphTensor> tensors;
  for (const Resource& resource : variant.resources) {
    if (resource.category != Category::kInput && resource.category != Category::kOutput) continue;
    const std::string_view name =
        std::string_view(resource.name).substr(0, resource.name.find(';'));
    const size_t place = name.find(' ');
    const size_t end = place == name.npos ? name.npos : name.find(' ', place + 1);
    std::vector<int64_t> where, strides;
    if (place == name.npos ||
        !parse_numbers(name.substr(place + 1, end == name.npos ? end : end - place - 1), '.',
                       where) ||
        where.size() != 3 ||
        (end != name.npos && !parse_numbers(name.substr(end + 1), ',', strides)) ||
        (end != name.npos && strides.size() != resource.shape.size()))
      return bad_input("package", "the tensor \"{}\" tells no descriptor", name);
    GraphTensor tensor{static_cast<uint32_t>(where[0]),
                       static_cast<uint32_t>(where[1]),
                       static_cast<uint32_t>(where[2]),
                       resource.name,
                       {},
                       resource.category == Category::kInput};
    tensor.layout.format = static_cast<VkFormat>(vk_format_of_dtype(resource.dtype));
    tensor.layout.dims = resource.shape;
    tensor.layout.strides.resize(resource.shape.size());
    int64_t next = dtype_info(resource.dtype).host_bytes;
    for (size_t i = resource.shape.size(); i-- > 0; next *= resource.shape[i])
      tensor.layout.strides[i] = next;
    if (!strides.empty()) {
      tensor.layout.packed = false;
      tensor.layout.strides = strides;
    }
    tensors.push_back(std::move(tensor));
  }
  return tensors;
}

}  // namespace shale::layer
