#include <unordered_map>
#include <unordered_set>

#include "compiler/frontend/spirv_graph/module.h"
#include "ir/verify/verify.h"

namespace shale {
namespace spirv_graph {
namespace {

/// The sizes that nothing has settled yet.
bool is_open(const Shape& shape) { return std::ranges::find(shape, kDynamic) != shape.end(); }

/// Unique names; the first to ask for a name gets it. Later ones get its beginning and a number, so
/// that one long name in a file cannot make many.
class Names {
 public:
  std::string claim(const std::string& wanted) {
    if (taken_.insert(wanted).second) return wanted;
    const std::string base = wanted.substr(0, 256);
    for (uint32_t& suffix = suffixes_[base];;) {
      std::string candidate = fmt::format("{}.{}", base, ++suffix);
      if (taken_.insert(candidate).second) return candidate;
    }
  }

 private:
  std::unordered_set<std::string> taken_;
  std::unordered_map<std::string, uint32_t> suffixes_;
};

/// One graph of a module as a Graph.
class Reader {
 public:
  Reader(const Module& module, const EntryPoint& entry, const SpirvGraphOptions& options)
      : module_(module),
        entry_(entry),
        definition_(*module.graph(entry.graph)),
        options_(options),
        slots_(module.slots(entry)),
        input_count_(module.type(definition_.type)->input_tensors()) {
    for (const ExternalTensor& tensor : options.interface)
      interface_.emplace(std::pair{tensor.set, tensor.binding}, &tensor);
    for (const ExternalConstant& constant : options.constants)
      external_.emplace(constant.id, &constant);
  }

  Result<Graph> read() {
    graph_.name = entry_.name;
    SHALE_TRY_VOID(read_inputs());
    for (const GraphOutput& output : definition_.outputs) claim_output_name(output);
    for (const size_t at : definition_.body) SHALE_TRY_VOID(read_operator(at));
    for (const GraphOutput& output : definition_.outputs) SHALE_TRY_VOID(read_output(output));
    SHALE_TRY_VOID(infer_open_results());
    return std::move(graph_);
  }

 private:
  const ExternalTensor* external(const SpirvEntryPoint::Slot& slot) const {
    const auto found = interface_.find({slot.set, slot.binding});
    return found == interface_.end() ? nullptr : found->second;
  }

  std::string slot_name(const SpirvEntryPoint::Slot& slot) const {
    const ExternalTensor* outside = external(slot);
    if (!outside || outside->name.empty()) return slot.name;
    return slot.element ? fmt::format("{}.{}", outside->name, *slot.element) : outside->name;
  }

  /// What module and outside know together.
  Result<void> add_outside(const std::string& where, SpirvEntryPoint::Slot& slot) const {
    const ExternalTensor* outside = external(slot);
    if (!outside) return {};
    const TensorType& given = outside->type;
    if (given.dtype != DType::kUnknown && given.dtype != slot.type.dtype)
      return bad_input(where, "is {} outside, the module has {}", dtype_info(given.dtype).name,
                       dtype_info(slot.type.dtype).name);
    if (given.shape.empty()) return {};
    if (!slot.ranked) {
      slot.type.shape.assign(given.shape.size(), kDynamic);
      slot.ranked = true;
    }
    const Shape known = slot.type.shape;
    if (given.shape.size() != known.size())
      return bad_input(where, "is {} outside, the module has {}", shape_text(given.shape),
                       shape_text(known));
    for (size_t i = 0; i < known.size(); ++i) {
      if (given.shape[i] == kDynamic) continue;
      if (given.shape[i] < 1)
        return bad_input(where, "has a size of {} outside, expected at least 1", given.shape[i]);
      if (known[i] != kDynamic && known[i] != given.shape[i])
        return bad_input(where, "is {} outside, the module has {}", shape_text(given.shape),
                         shape_text(known));
      slot.type.shape[i] = given.shape[i];
    }
    return check_size(where, slot.type.shape);
  }

  static Result<void> check_size(const std::string& where, const Shape& shape) {
    if (static_cast<int64_t>(shape.size()) > kMaxRank)
      return unsupported(where, "has rank {}, level 8K ends at rank {}", shape.size(), kMaxRank);
    if (!is_open(shape) && !element_count(shape))
      return unsupported(where, "has shape {}, level 8K ends at {} elements", shape_text(shape),
                         kMaxElements);
    return {};
  }

  Result<void> read_inputs() {
    std::vector<uint32_t> ids(input_count_);  // 0: the graph does not read this input
    for (const GraphInput& input : definition_.inputs) ids[input.tensor] = input.id;
    for (uint32_t i = 0; i < input_count_; ++i) {
      SpirvEntryPoint::Slot slot = slots_[i];
      std::string wanted = slot_name(slot);
      if (wanted.empty()) wanted = module_.name(ids[i]);
      if (wanted.empty()) wanted = fmt::format("input_{}", i);
      const std::string name = names_.claim(wanted);
      const std::string where = fmt::format("input {} \"{}\"", i, name);
      SHALE_TRY_VOID(add_outside(where, slot));
      if (!slot.ranked) {
        const auto found = options_.input_shapes.find(name);
        if (found == options_.input_shapes.end())
          return bad_input(where, "its rank is open; give it with --input-shape {}=N,H,W,C", name);
        slot.type.shape = found->second;
        if (slot.type.shape.empty() ||
            std::ranges::any_of(slot.type.shape, [](int64_t size) { return size < 1; }))
          return bad_input(where, "{} is no shape", shape_text(slot.type.shape));
        SHALE_TRY_VOID(check_size(where, slot.type.shape));
      }
      const ValueId id = add_value(name, slot.type);
      graph_.inputs.push_back(id);
      if (ids[i] != 0) values_.emplace(ids[i], id);
    }
    return {};
  }

  ValueId add_value(std::string name, TensorType type) {
    graph_.values.push_back({std::move(name), std::move(type), std::nullopt});
    return {static_cast<uint32_t>(graph_.values.size() - 1)};
  }

  /// A result that is an output takes the name of the first output that it is.
  void claim_output_name(const GraphOutput& output) {
    if (module_.constant(output.value) || values_.contains(output.value) ||
        result_names_.contains(output.value))
      return;
    std::string wanted = slot_name(slots_[input_count_ + output.tensor]);
    if (wanted.empty()) wanted = module_.name(output.value);
    if (wanted.empty()) wanted = fmt::format("output_{}", output.tensor);
    result_names_.emplace(output.value, names_.claim(wanted));
  }

  std::string result_name(uint32_t id, std::string_view op) {
    if (const auto found = result_names_.find(id); found != result_names_.end())
      return found->second;
    const std::string wanted = module_.name(id);
    return names_.claim(wanted.empty() ? fmt::format("{}_{}", op, graph_.nodes.size()) : wanted);
  }

  Result<void> read_operator(size_t at) {
    const uint32_t* words = module_.words.data() + at;
    const size_t size = words[0] >> 16;
    if (static_cast<Opcode>(words[0] & 0xffff) == Opcode::kCompositeExtract) return read_part(at);
    const std::string set = *module_.import(words[3]);
    if (set != kTosaSet)
      return unsupported(module_.where(at), "instruction {} of the set \"{}\", expected \"{}\"",
                         words[4], set, kTosaSet);
    const std::optional<Op> op = op_of_instruction(words[4]);
    if (!op)
      return bad_input(module_.where(at), "operator number {} is not in {}", words[4], kTosaSet);
    const OpInfo& info = op_info(*op);
    const std::string where = fmt::format("{}, {}", module_.where(at), info.name);
    const size_t results = result_count(*op);
    const Type& type = *module_.type(words[1]);
    if (results == 1 && type.kind != Type::Kind::kTensor)
      return bad_input(where, "its type %{} is no tensor type", words[1]);
    if (results > 1 && (type.kind != Type::Kind::kStruct || type.entries.size() != results))
      return bad_input(where, "its type %{} is no struct of {} members", words[1], results);
    const std::vector<Attr> attrs = instruction_attrs(*op);
    const size_t count = size - 5;
    const size_t most = attrs.size() + info.max_operands;
    if (count < attrs.size() + info.min_operands || count > most)
      return bad_input(where, "has {} operands, expected {}", count,
                       info.min_operands == info.max_operands
                           ? std::to_string(most)
                           : fmt::format("{} to {}", attrs.size() + info.min_operands, most));
    Node node{.op = *op, .attrs = {}, .inputs = {}, .output = {}, .group = 0};
    for (size_t i = 0; i < attrs.size(); ++i)
      SHALE_TRY_VOID(read_attribute(where, attr_info(attrs[i]), words[5 + i], node.attrs));
    for (size_t i = attrs.size(); i < count; ++i) {
      SHALE_TRY(const ValueId id, operand(where, node, i - attrs.size(), words[5 + i]));
      node.inputs.push_back(id);
    }
    if (results > 1)
      split_.emplace(words[2], std::move(node));
    else
      add_node(std::move(node), words[2], type);
    return {};
  }

  void add_node(Node node, uint32_t id, const Type& type) {
    TensorType result{type.dtype, type.ranked ? type.shape : Shape{kDynamic}};
    node.output = add_value(result_name(id, op_info(node.op).name), std::move(result));
    if (!type.ranked) unranked_.insert(node.output.index);
    values_.emplace(id, node.output);
    graph_.nodes.push_back(std::move(node));
  }

  /// One result of an operator of two.
  Result<void> read_part(size_t at) {
    const uint32_t* words = module_.words.data() + at;
    const auto whole = split_.find(words[3]);
    const Type* type = module_.type(words[1]);
    if (whole == split_.end() || !type || type->kind != Type::Kind::kTensor)
      return bad_input(module_.where(at), "expected a tensor out of an operator's struct");
    Node node = whole->second;
    node.attrs.set(Attr::kPart, words[4]);
    add_node(std::move(node), words[2], *type);
    return {};
  }

  Result<void> read_attribute(const std::string& where, const AttrInfo& info, uint32_t id,
                              Attrs& attrs) {
    const Constant* found = module_.constant(id);
    if (!found) return bad_input(where, "{} is %{}, which is no constant", info.name, id);
    if (info.kind == AttrKind::kIntList) {
      SHALE_TRY_VOID(check_list(where, info.name, id));
      SHALE_TRY(const Tensor list, data(where, info.name, id));
      attrs.set(info.attr, list.ints());
      return {};
    }
    const Type& type = *module_.type(found->type);
    const bool is_bool = info.kind == AttrKind::kBool;
    if (found->kind != Constant::Kind::kScalar || (type.dtype == DType::kBool) != is_bool)
      return bad_input(where, "{} is %{}, which is no {} constant", info.name, id,
                       is_bool ? "bool" : "number");
    int64_t value = found->value;
    const auto enumerator = [&](size_t count) -> Result<void> {
      if (value >= 1 && value <= static_cast<int64_t>(count)) return {};
      return bad_input(where, "{} is {}, expected 1 to {}", info.name, value, count);
    };
    if (info.kind == AttrKind::kDType) {
      SHALE_TRY_VOID(enumerator(kAccTypes.size()));
      value = static_cast<int64_t>(kAccTypes[static_cast<size_t>(value - 1)]);
    } else if (const auto known = attr_value_names(info.kind); !known.empty()) {
      SHALE_TRY_VOID(enumerator(known.size() - 1));  // TOSA.001000.1 has no unknown
    }
    attrs.set(info.attr, value);
    return {};
  }

  Result<ValueId> operand(const std::string& where, const Node& node, size_t index, uint32_t id) {
    const bool is_shape = is_shape_operand(node.op, index);
    if (!module_.constant(id)) {
      const auto found = values_.find(id);
      if (found == values_.end())
        return bad_input(where,
                         "operand {} is %{}, which is no constant and no earlier value of "
                         "this graph",
                         index, id);
      if (is_shape)
        return unsupported(where, "operand {} is %{}, a shape must be constant", index, id);
      return found->second;
    }
    if (is_shape) return constant(where, id, DType::kShape);
    // The two versions of the set's document differ in the type of RESCALE's multiplier.
    if (node.op == Op::kRescale && index == 1)
      return constant(where, id, node.attrs.flag(Attr::kScale32) ? DType::kInt32 : DType::kInt16);
    return constant(where, id, DType::kUnknown);
  }

  Result<Tensor> data(const std::string& where, std::string_view what, uint32_t id) {
    Result<Tensor> tensor = module_.tensor(id, external_, budget_);
    if (!tensor)
      tensor.error().where = fmt::format("{}, {}: {}", where, what, tensor.error().where);
    return tensor;
  }

  /// Attributes and shapes: no operator has a longer list, whatever a file holds.
  Result<void> check_list(const std::string& where, std::string_view what, uint32_t id) {
    const auto type = module_.data_type(*module_.type(module_.constant(id)->type));
    if (!type) {
      if (module_.constant(id)->kind != Constant::Kind::kExternal) return {};  // data() tells more
      return bad_input(where, "the {} %{} has no shape in the module", what, id);
    }
    if (!is_integer(type->dtype) || type->shape.size() != 1 || type->shape[0] > 2 * kMaxRank)
      return bad_input(where, "the {} %{} is {}, expected a list of at most {} integers", what, id,
                       type_text(*type), 2 * kMaxRank);
    return {};
  }

  /// The value of a constant in the element type `as`, or in its own for kUnknown.
  Result<ValueId> constant(const std::string& where, uint32_t id, DType as) {
    const Constant& source = *module_.constant(id);
    const Type& declared = *module_.type(source.type);
    const DType own =
        (declared.kind == Type::Kind::kArray ? *module_.type(declared.element) : declared).dtype;
    if (as == DType::kUnknown) as = own;
    if (const auto known = constants_.find({id, as}); known != constants_.end())
      return known->second;
    if (as == DType::kShape) SHALE_TRY_VOID(check_list(where, "shape", id));
    SHALE_TRY(Tensor tensor, data(where, "operand", id));
    const bool converts = as != own;
    if (converts && !is_integer(own))
      return bad_input(where, "the operand %{} is {}, expected integers", id,
                       type_text(tensor.type));
    // BOOL and INT48 do not fill their bytes.
    if (converts || dtype_info(as).bits != 8 * dtype_info(as).host_bytes) {
      const IntRange range = dtype_range(as);
      for (int64_t i = 0; i < tensor.count(); ++i)
        if (const int64_t element = tensor.get(i); element < range.min || element > range.max)
          return bad_input(where, "the operand %{} has {}, {} is {} to {}", id, element,
                           dtype_info(as).wire, range.min, range.max);
      if (converts) tensor = Tensor::from_ints({as, tensor.type.shape}, tensor.ints());
    }
    std::string wanted = module_.name(id);
    if (wanted.empty())
      wanted = source.kind == Constant::Kind::kExternal
                   ? fmt::format("graph_constant_{}", source.external_id)
                   : fmt::format("constant_{}", constants_.size());
    const ValueId value = add_value(names_.claim(wanted), tensor.type);
    graph_.value(value).constant = std::move(tensor);
    constants_.emplace(std::pair{id, as}, value);
    return value;
  }

  Result<void> read_output(const GraphOutput& output) {
    SpirvEntryPoint::Slot slot = slots_[input_count_ + output.tensor];
    const std::string where = fmt::format("output {}", output.tensor);
    ValueId value;
    if (const auto found = values_.find(output.value); found != values_.end()) {
      value = found->second;
    } else {
      SHALE_TRY(value, constant(where, output.value, DType::kUnknown));
    }
    SHALE_TRY_VOID(add_outside(fmt::format("{} \"{}\"", where, graph_.value(value).name), slot));
    const std::string wanted = slot_name(slot);
    const bool names_result = result_names_.erase(output.value) > 0;
    if (!names_result && !wanted.empty() && wanted != graph_.value(value).name) {
      // A second name for a value needs a node of its own.
      const ValueId alias = add_value(names_.claim(wanted), graph_.value(value).type);
      if (unranked_.contains(value.index)) unranked_.insert(alias.index);
      graph_.nodes.push_back({Op::kIdentity, {}, {value}, alias, 0});
      value = alias;
    }
    graph_.outputs.push_back(value);
    // Inputs are the first values; they and constants have their types from elsewhere.
    if (Value& result = graph_.value(value); value.index >= input_count_ && slot.ranked &&
                                             !result.is_constant() && is_open(result.type.shape)) {
      result.type = slot.type;
      unranked_.erase(value.index);
    }
    return {};
  }

  /// Closes what the operands determine; sizes that are known already must agree.
  Result<void> infer_open_results() {
    for (uint32_t i = 0; i < graph_.nodes.size(); ++i) {
      const Node& node = graph_.nodes[i];
      TensorType& declared = graph_.value(node.output).type;
      const bool operands_known = std::ranges::none_of(
          node.inputs, [&](ValueId id) { return is_open(graph_.value(id).type.shape); });
      if (!is_open(declared.shape) || !operands_known) continue;
      SHALE_TRY(const TensorType inferred, infer_result(graph_, {i}));
      bool agrees = declared.dtype == inferred.dtype;
      if (!unranked_.contains(node.output.index)) {
        agrees = agrees && declared.shape.size() == inferred.shape.size();
        for (size_t axis = 0; agrees && axis < inferred.shape.size(); ++axis)
          agrees = declared.shape[axis] == kDynamic || declared.shape[axis] == inferred.shape[axis];
      }
      if (!agrees)
        return bad_input(node_label(graph_, {i}), "declares its result as {}, its operands give {}",
                         type_text(declared), type_text(inferred));
      declared = inferred;
    }
    return {};
  }

  const Module& module_;
  const EntryPoint& entry_;
  const GraphDefinition& definition_;
  const SpirvGraphOptions& options_;
  const std::vector<SpirvEntryPoint::Slot> slots_;  ///< inputs first
  const uint32_t input_count_;
  std::map<std::pair<uint32_t, uint32_t>, const ExternalTensor*> interface_;  ///< by set, binding
  ExternalData external_;
  Graph graph_;
  Names names_;
  std::unordered_map<uint32_t, ValueId> values_;            ///< inputs and results, by id
  std::unordered_map<uint32_t, std::string> result_names_;  ///< of results that outputs name, by id
  std::map<std::pair<uint32_t, DType>, ValueId> constants_;
  std::unordered_set<uint32_t> unranked_;     ///< values whose shape [?] only says that it is open
  std::unordered_map<uint32_t, Node> split_;  ///< operators of two results, by id
  int64_t budget_ = kMaxInlineBytes;
};

Result<const EntryPoint*> choose(const Module& module, const std::string& name) {
  std::vector<std::string> names;
  for (const EntryPoint& entry : module.entry_points) {
    if (entry.name == name || (name.empty() && module.entry_points.size() == 1)) return &entry;
    names.push_back("\"" + entry.name + "\"");
  }
  if (name.empty())
    return bad_input("", "the module has {} entry points, choose one: {}", names.size(),
                     fmt::join(names, ", "));
  return bad_input("", "the module has no entry point \"{}\", it has {}", name,
                   fmt::join(names, ", "));
}

}  // namespace
}  // namespace spirv_graph

bool is_spirv(std::span<const uint8_t> bytes) {
  if (bytes.size() < 4) return false;
  uint32_t word = 0;
  std::memcpy(&word, bytes.data(), 4);
  return word == spirv_graph::kMagic || word == __builtin_bswap32(spirv_graph::kMagic);
}

Result<std::vector<SpirvEntryPoint>> list_spirv_entry_points(std::span<const uint8_t> bytes) {
  SHALE_TRY(const spirv_graph::Module module, spirv_graph::Module::parse(bytes));
  std::vector<SpirvEntryPoint> result;
  std::map<uint32_t, std::map<uint32_t, TensorType>> constants;  // by graph
  size_t total_bytes = 0;
  for (const spirv_graph::EntryPoint& entry : module.entry_points) {
    const spirv_graph::GraphDefinition& graph = *module.graph(entry.graph);
    const uint32_t input_count = module.type(graph.type)->input_tensors();
    const auto [used, is_new] = constants.try_emplace(entry.graph);
    if (is_new) used->second = module.external_constants(graph);
    // Entry points may share graphs, so a small module could list constants without end.
    total_bytes += 64 * used->second.size();
    if (total_bytes > spirv_graph::kMaxListingBytes)
      return unsupported(module.where(entry.at),
                         "the constants of all entry points take over {} bytes",
                         spirv_graph::kMaxListingBytes);
    SpirvEntryPoint listed;
    listed.name = entry.name;
    std::vector<SpirvEntryPoint::Slot> slots = module.slots(entry);
    for (size_t i = 0; i < slots.size(); ++i)
      (i < input_count ? listed.inputs : listed.outputs).push_back(std::move(slots[i]));
    for (const auto& [id, type] : used->second) {
      listed.constant_ids.push_back(id);
      listed.constant_types.push_back(type);
    }
    result.push_back(std::move(listed));
  }
  return result;
}

Result<Graph> read_spirv_graph(std::span<const uint8_t> bytes, const SpirvGraphOptions& options) {
  SHALE_TRY(const spirv_graph::Module module, spirv_graph::Module::parse(bytes));
  SHALE_TRY(const spirv_graph::EntryPoint* entry, spirv_graph::choose(module, options.entry_point));
  return spirv_graph::Reader(module, *entry, options).read();
}

}  // namespace shale
