#include <set>

#include "compiler/frontend/spirv_graph/grammar.h"
#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "ir/verify/verify.h"

namespace shale {
namespace spirv_graph {
namespace {

/// OpConstantComposite has 3 words beside its constituents.
constexpr int64_t kMaxConstituents = static_cast<int64_t>(kMaxInstructionWords) - 3;
constexpr size_t kMaxNameBytes = 260000;

/// The same results without what the format has not: INT4 as INT8, rank 0 as [1], NaN modes known.
Graph lowered(Graph graph) {
  const auto was_scalar = [](const Value& value) { return value.type.shape.empty(); };
  std::vector<Node> nodes;
  for (Node& node : graph.nodes) {
    if (node.attrs.has(Attr::kNanMode) && node.attrs.get(Attr::kNanMode) == 0)
      node.attrs.set(Attr::kNanMode, 1);  // integers have no NaN
    if (was_scalar(graph.value(node.output))) {
      if (node.op == Op::kReshape) node.inputs[1] = graph.add_shape("scalar_shape", {1});
      if (node.op == Op::kArgmax) {
        // [n] has one axis; the one that stays makes the result [1].
        const TensorType type = graph.value(node.inputs[0]).type;
        const int64_t n = type.shape[0];
        const ValueId shape = graph.add_shape("column_shape", {n, 1});
        const ValueId column = graph.add_value("column", {type.dtype, {n, 1}});
        nodes.push_back({Op::kReshape, {}, {node.inputs[0], shape}, column, 0});
        node.inputs[0] = column;
      }
    }
    nodes.push_back(std::move(node));
  }
  graph.nodes = std::move(nodes);
  for (Value& value : graph.values) {
    if (value.type.dtype == DType::kInt4) value.type.dtype = DType::kInt8;
    if (was_scalar(value)) value.type.shape = {1};
    if (value.is_constant()) value.constant->type = value.type;
  }
  return graph;
}

/// Operands that the set wants inline or that are not worth a graph constant.
bool stays_inline(Op op, size_t operand) {
  switch (op) {
    case Op::kConv2d:
    case Op::kConv3d:
    case Op::kDepthwiseConv2d:
    case Op::kTransposeConv2d: return operand >= 3;
    case Op::kMatmul:
    case Op::kMul:
    case Op::kPad: return operand >= 2 || is_shape_operand(op, operand);
    case Op::kAvgPool2d:
    case Op::kNegate:
    case Op::kRescale: return operand >= 1;
    default: return is_shape_operand(op, operand);
  }
}

class Writer {
 public:
  Writer(const Graph& graph, const SpirvWriteOptions& options)
      : graph_(graph), options_(options), ids_(graph.values.size()) {}

  Result<SpirvGraphModule> write() {
    SHALE_TRY_VOID(check_names());
    find_inline_constants();
    tosa_ = next_id_++;
    for (const ValueId id : graph_.inputs) add_variable(id);
    for (const ValueId id : graph_.outputs) add_variable(id);

    std::vector<uint32_t> type_operands{static_cast<uint32_t>(graph_.inputs.size())};
    for (const ValueId id : graph_.inputs) type_operands.push_back(type_of(id));
    for (const ValueId id : graph_.outputs) type_operands.push_back(type_of(id));
    const uint32_t graph_type = declare(Opcode::kTypeGraph, type_operands);
    const uint32_t graph_id = next_id_++;
    std::vector<uint32_t> entry{graph_id};
    append_string(entry, graph_.name);
    entry.insert(entry.end(), interface_.begin(), interface_.end());
    emit(body_, Opcode::kGraphEntryPoint, entry);
    emit(body_, Opcode::kGraph, {graph_type, graph_id});
    for (uint32_t i = 0; i < graph_.inputs.size(); ++i) {
      const uint32_t id = new_named(graph_.inputs[i]);
      emit(body_, Opcode::kGraphInput, {type_of(graph_.inputs[i]), id, integer(i)});
    }
    written_.resize(graph_.nodes.size());
    for (uint32_t i = 0; i < graph_.nodes.size(); ++i) SHALE_TRY_VOID(add_node({i}));
    for (uint32_t i = 0; i < graph_.outputs.size(); ++i) {
      SHALE_TRY(const uint32_t id, operand(graph_.outputs[i]));
      emit(body_, Opcode::kGraphSetOutput, {id, integer(i)});
    }
    emit(body_, Opcode::kGraphEnd, {});
    module_.entry_point = graph_.name;
    assemble();
    return std::move(module_);
  }

 private:
  using Words = std::vector<uint32_t>;

  Result<void> check_names() const {
    const auto check = [](const std::string& where, const std::string& name) -> Result<void> {
      if (name.size() > kMaxNameBytes)
        return unsupported(where, "its name has {} bytes, the writer's limit is {}", name.size(),
                           kMaxNameBytes);
      return {};
    };
    for (uint32_t i = 0; i < graph_.values.size(); ++i)
      SHALE_TRY_VOID(check(fmt::format("value %{}", i), graph_.values[i].name));
    SHALE_TRY_VOID(check("graph", graph_.name));
    // OpGraphEntryPointARM has 2 words, the name and its NUL, and a word for each of them.
    const size_t most = kMaxInstructionWords - 3 - graph_.name.size() / 4;
    if (graph_.inputs.size() + graph_.outputs.size() > most)
      return unsupported("graph", "has {} inputs and {} outputs, the writer's limit is {} together",
                         graph_.inputs.size(), graph_.outputs.size(), most);
    return {};
  }

  /// A constant with any use that has to be inline is inline.
  void find_inline_constants() {
    inline_.assign(graph_.values.size(), !options_.external_constants);
    for (const Node& node : graph_.nodes)
      for (size_t i = 0; i < node.inputs.size(); ++i)
        if (stays_inline(node.op, i)) inline_[node.inputs[i].index] = true;
  }

  static void emit(Words& section, Opcode opcode, const Words& operands) {
    const size_t count = operands.size() + 1;
    SHALE_CHECK(count <= kMaxInstructionWords);
    section.push_back(static_cast<uint32_t>(count << 16) | static_cast<uint32_t>(opcode));
    section.insert(section.end(), operands.begin(), operands.end());
  }

  static void append_string(Words& words, const std::string& text) {
    const size_t first = words.size();
    words.resize(first + text.size() / 4 + 1);
    std::memcpy(words.data() + first, text.data(), text.size());
  }

  void add_name(uint32_t id, const std::string& name) {
    Words operands{id};
    append_string(operands, name);
    emit(names_, Opcode::kName, operands);
  }

  uint32_t new_named(ValueId value) {
    const uint32_t id = next_id_++;
    ids_[value.index] = id;
    add_name(id, graph_.value(value).name);
    return id;
  }

  /// A type, once however often it is asked for: [opcode, result, operands...].
  uint32_t declare(Opcode opcode, const Words& operands) {
    Words key{static_cast<uint32_t>(opcode)};
    key.insert(key.end(), operands.begin(), operands.end());
    const auto [found, is_new] = declared_.emplace(std::move(key), next_id_);
    if (is_new) {
      Words words{next_id_++};
      words.insert(words.end(), operands.begin(), operands.end());
      emit(declarations_, opcode, words);
    }
    return found->second;
  }

  /// A constant, likewise: [opcode, type, result, operands...].
  uint32_t declare_constant(Opcode opcode, uint32_t type, const Words& operands) {
    Words key{static_cast<uint32_t>(opcode), type};
    key.insert(key.end(), operands.begin(), operands.end());
    const auto [found, is_new] = declared_.emplace(std::move(key), next_id_);
    if (is_new) emit_constant(opcode, type, next_id_++, operands);
    return found->second;
  }

  void emit_constant(Opcode opcode, uint32_t type, uint32_t id, const Words& operands) {
    Words words{type, id};
    words.insert(words.end(), operands.begin(), operands.end());
    emit(declarations_, opcode, words);
  }

  uint32_t scalar_type(DType dtype) {
    const ScalarInfo& info = *std::ranges::find(kScalars, dtype, &ScalarInfo::dtype);
    capabilities_.insert(info.capability);
    if (info.opcode == Opcode::kTypeBool) return declare(info.opcode, {});
    if (info.opcode == Opcode::kTypeInt) return declare(info.opcode, {info.width, 0});
    if (!info.extension.empty()) extensions_.insert(info.extension);
    if (info.encoding) return declare(info.opcode, {info.width, *info.encoding});
    return declare(info.opcode, {info.width});
  }

  uint32_t tensor_type(const TensorType& type) {
    const uint32_t element = scalar_type(type.dtype);
    const uint32_t rank = integer(static_cast<uint32_t>(type.shape.size()));
    // A type has all its sizes or none.
    if (std::ranges::find(type.shape, kDynamic) != type.shape.end())
      return declare(Opcode::kTypeTensor, {element, rank});
    const uint32_t array = declare(Opcode::kTypeArray, {scalar_type(DType::kInt32), rank});
    Words sizes;
    for (const int64_t size : type.shape) sizes.push_back(integer(static_cast<uint32_t>(size)));
    const uint32_t shape = declare_constant(Opcode::kConstantComposite, array, sizes);
    return declare(Opcode::kTypeTensor, {element, rank, shape});
  }

  uint32_t type_of(ValueId id) {
    const TensorType& type = graph_.value(id).type;
    // Of a result that is [?] nothing is known, not even its rank; an input is a list.
    if (type.shape == Shape{kDynamic} &&
        std::ranges::find(graph_.inputs, id) == graph_.inputs.end())
      return declare(Opcode::kTypeTensor, {scalar_type(type.dtype)});
    return tensor_type(type);
  }

  uint32_t scalar(DType dtype, int64_t value) {
    const uint32_t type = scalar_type(dtype);
    if (dtype == DType::kBool)
      return declare_constant(value != 0 ? Opcode::kConstantTrue : Opcode::kConstantFalse, type,
                              {});
    const uint32_t host_bytes = dtype_info(dtype).host_bytes;
    const uint32_t low = static_cast<uint32_t>(value);
    if (host_bytes == 8)
      return declare_constant(Opcode::kConstant, type,
                              {low, static_cast<uint32_t>(static_cast<uint64_t>(value) >> 32)});
    // Narrow values of an unsigned type are zero-extended.
    const uint32_t mask = host_bytes == 4 ? ~0u : (1u << 8 * host_bytes) - 1;
    return declare_constant(Opcode::kConstant, type, {low & mask});
  }

  uint32_t integer(uint32_t value) { return scalar(DType::kInt32, static_cast<int32_t>(value)); }

  /// The instruction for elements `first`... of a tensor whose shape from `axis` on they fill.
  std::pair<Opcode, Words> composite(const Tensor& tensor, size_t axis, int64_t first) {
    const Shape& shape = tensor.type.shape;
    const Shape inner(shape.begin() + static_cast<std::ptrdiff_t>(axis) + 1, shape.end());
    const int64_t step = *element_count(inner), count = shape[axis] * step;
    const auto begin = tensor.bytes.begin() + first * tensor.host_bytes();
    if (std::all_of(begin, begin + count * tensor.host_bytes(), [](uint8_t b) { return b == 0; }))
      return {Opcode::kConstantNull, {}};
    Words parts;
    for (int64_t at = first; at < first + count; at += step) {
      if (inner.empty()) {
        parts.push_back(scalar(tensor.type.dtype, tensor.get(at)));
        continue;
      }
      const auto [opcode, operands] = composite(tensor, axis + 1, at);
      parts.push_back(declare_constant(opcode, tensor_type({tensor.type.dtype, inner}), operands));
    }
    return {Opcode::kConstantComposite, std::move(parts)};
  }

  /// A list attribute or a shape.
  uint32_t list(std::span<const int64_t> values) {
    const TensorType type{DType::kInt32, {static_cast<int64_t>(values.size())}};
    const auto [opcode, operands] = composite(Tensor::from_ints(type, values), 0, 0);
    return declare_constant(opcode, tensor_type(type), operands);
  }

  /// The id of an input, result or constant; constants are declared at their first use.
  Result<uint32_t> operand(ValueId value_id) {
    const Value& value = graph_.value(value_id);
    if (ids_[value_id.index] != 0) return ids_[value_id.index];
    // Only constants can be new: producers come first.
    if (!inline_[value_id.index]) {
      const uint32_t type = type_of(value_id), id = new_named(value_id);
      emit_constant(Opcode::kGraphConstant, type, id,
                    {static_cast<uint32_t>(module_.constants.size())});
      module_.constants.push_back(*value.constant);
      return id;
    }
    Tensor tensor = *value.constant;
    if (tensor.type.dtype == DType::kShape)
      tensor = Tensor::from_ints({DType::kInt32, tensor.type.shape}, tensor.ints());
    const uint32_t type = tensor_type(tensor.type);
    for (size_t axis = 0; axis < tensor.type.shape.size(); ++axis)
      if (tensor.type.shape[axis] > kMaxConstituents)
        return unsupported(fmt::format("constant \"{}\"", value.name),
                           "is {}: an inline constant has at most {} elements on an axis; write it "
                           "as an external constant",
                           type_text(tensor.type), kMaxConstituents);
    const auto [opcode, operands] = composite(tensor, 0, 0);
    const uint32_t id = new_named(value_id);
    emit_constant(opcode, type, id, operands);
    return id;
  }

  uint32_t attribute(const Node& node, Attr attr) {
    const AttrInfo& info = attr_info(attr);
    const int64_t value = node.attrs.get(attr);
    switch (info.kind) {
      case AttrKind::kIntList: return list(node.attrs.list(attr));
      case AttrKind::kBool: return scalar(DType::kBool, value);
      case AttrKind::kElement: return scalar(graph_.value(node.inputs[0]).type.dtype, value);
      case AttrKind::kDType: {
        const auto found = std::ranges::find(kAccTypes, static_cast<DType>(value));
        return scalar(DType::kInt32, found - kAccTypes.begin() + 1);
      }
      default: return scalar(DType::kInt32, value);
    }
  }

  Result<void> add_node(NodeId node_id) {
    const Node& node = graph_.node(node_id);
    if (written_[node_id.index]) return {};
    if (node.op == Op::kIdentity) {
      SHALE_TRY(ids_[node.output.index], operand(node.inputs[0]));
      return {};
    }
    const bool splits = result_count(node.op) > 1;
    const uint32_t part_type = type_of(node.output);
    const uint32_t type =
        splits ? declare(Opcode::kTypeStruct, Words(result_count(node.op), part_type)) : part_type;
    Words words{type, 0, tosa_, instruction_of(node.op)};
    for (const Attr attr : instruction_attrs(node.op)) words.push_back(attribute(node, attr));
    for (const ValueId id : node.inputs) {
      SHALE_TRY(const uint32_t word, operand(id));
      words.push_back(word);
    }
    words[1] = splits ? next_id_++ : new_named(node.output);
    emit(body_, Opcode::kExtInst, words);
    const auto extract = [&](const Node& part) {
      emit(body_, Opcode::kCompositeExtract,
           {part_type, new_named(part.output), words[1],
            static_cast<uint32_t>(part.attrs.get(Attr::kPart))});
    };
    if (!splits) return {};
    extract(node);
    if (const std::optional<NodeId> other = graph_.other_part(node_id, written_)) {
      written_[other->index] = true;
      extract(graph_.node(*other));
    }
    return {};
  }

  void add_variable(ValueId value) {
    const uint32_t pointer = declare(Opcode::kTypePointer, {kUniformConstant, type_of(value)});
    const uint32_t id = next_id_++;
    emit(declarations_, Opcode::kVariable, {pointer, id, kUniformConstant});
    add_name(id, graph_.value(value).name);
    emit(decorations_, Opcode::kDecorate, {id, kDecorationDescriptorSet, 0});
    emit(decorations_, Opcode::kDecorate,
         {id, kDecorationBinding, static_cast<uint32_t>(interface_.size())});
    interface_.push_back(id);
  }

  void assemble() {
    Words& words = module_.words;
    words = {kMagic, kVersion15, 0, next_id_, 0};
    for (const Capability capability : capabilities_)
      emit(words, Opcode::kCapability, {static_cast<uint32_t>(capability)});
    for (const std::string_view extension : extensions_) {
      Words operands;
      append_string(operands, std::string(extension));
      emit(words, Opcode::kExtension, operands);
    }
    Words import{tosa_};
    append_string(import, std::string(kTosaSet));
    emit(words, Opcode::kExtInstImport, import);
    emit(words, Opcode::kMemoryModel, {kLogicalAddressing, kVulkanMemory});
    for (const Words* section : {&names_, &decorations_, &declarations_, &body_})
      words.insert(words.end(), section->begin(), section->end());
  }

  const Graph& graph_;
  const SpirvWriteOptions& options_;
  SpirvGraphModule module_;
  uint32_t next_id_ = 1, tosa_ = 0;
  Words names_, decorations_, declarations_, body_;
  Words interface_;
  std::vector<uint32_t> ids_;  ///< by value; 0 until it has one
  std::vector<bool> inline_;   ///< by value
  std::vector<bool> written_;  ///< by node: as the other part of an earlier one
  std::map<Words, uint32_t> declared_;
  std::set<std::string_view, std::greater<>> extensions_{"SPV_ARM_tensors", "SPV_ARM_graph"};
  std::set<Capability> capabilities_{Capability::kShader, Capability::kTensors, Capability::kGraph,
                                     Capability::kVulkanMemoryModel};
};

}  // namespace
}  // namespace spirv_graph

Result<SpirvGraphModule> write_spirv_graph(const Graph& graph, const SpirvWriteOptions& options) {
  if (options.verified) SHALE_TRY_VOID(verify(graph, OpenSizes::kAllowed));
  for (uint32_t i = 0; i < graph.nodes.size(); ++i)
    if (const Node& node = graph.nodes[i];
        node.op == Op::kArgmax && graph.value(node.output).type.shape.empty() &&
        graph.value(node.inputs[0]).type.shape == Shape{kDynamic})
      return unsupported(node_label(graph, {i}), "gives a scalar of a list of open size");
  const Graph writable = spirv_graph::lowered(graph);
  return spirv_graph::Writer(writable, options).write();
}

}  // namespace shale
