// What a module says of graphs: their types, inputs, outputs, operators and entry points.
#include "compiler/frontend/spirv_graph/module.h"

namespace shale::spirv_graph {

Result<void> Module::read_graph_type(const Instruction& instruction, Type& result) {
  result.kind = Type::Kind::kGraph;
  result.input_count = instruction[2];
  const auto entries = instruction.words.subspan(3);
  if (entries.size() <= result.input_count)
    return bad(instruction, "has {} types for {} inputs, expected at least one output",
               entries.size(), result.input_count);
  result.first_tensor.push_back(0);
  for (const uint32_t id : entries) {
    const Type* entry = type(id);
    int64_t count = 1;
    if (entry && entry->kind == Type::Kind::kArray) {
      count = entry->length;
      entry = type(entry->element);
    }
    if (!entry || entry->kind != Type::Kind::kTensor)
      return bad(instruction, "the type %{} is no tensor and no array of tensors of fixed length",
                 id);
    if (count > kMaxArrayTensors)
      return unsupported(where(instruction.at), "the type %{} has {} tensors, the limit is {}", id,
                         count, kMaxArrayTensors);
    result.first_tensor.push_back(result.first_tensor.back() + static_cast<uint32_t>(count));
  }
  result.entries.assign(entries.begin(), entries.end());
  return {};
}

Result<void> Module::read_in_graph(const Instruction& instruction) {
  GraphDefinition& graph = graphs_.back();
  switch (instruction.opcode()) {
    case Opcode::kGraphInput: return read_graph_input(instruction);
    case Opcode::kGraphSetOutput: return read_graph_output(instruction);
    case Opcode::kGraphEnd: return end_graph(instruction);
    case Opcode::kExtInst: {
      const std::string* set = import(instruction[3]);
      if (!set) return bad(instruction, "%{} is no imported instruction set", instruction[3]);
      if (set->starts_with("NonSemantic."))
        return define(instruction, instruction[2], Kind::kOther, 0);
      if (!graph.outputs.empty())
        return bad(instruction, "stands behind an OpGraphSetOutputARM, outputs come last");
      if (!type(instruction[1])) return bad(instruction, "its type %{} is no type", instruction[1]);
      graph.body.push_back(instruction.at);
      values_.push_back({instruction[1], graphs_.size() - 1});
      return define(instruction, instruction[2], Kind::kValue, values_.size() - 1);
    }
    case Opcode::kCompositeExtract: return read_extract(instruction);
    default: return bad(instruction, "stands inside a graph");
  }
}

Result<Module::GraphTensor> Module::graph_tensor(const Instruction& instruction, bool is_input,
                                                 size_t first_operand) const {
  const Type& graph_type = *type(graphs_.back().type);
  const char* what = is_input ? "input" : "output";
  const size_t first = is_input ? 0 : graph_type.input_count;
  const size_t count = is_input ? graph_type.input_count : graph_type.entries.size() - first;
  SHALE_TRY(const int64_t index,
            integer(instruction, fmt::format("{} index", what), instruction[first_operand]));
  if (index < 0 || index >= static_cast<int64_t>(count))
    return bad(instruction, "the {} index is {}, the graph has {} {}s", what, index, count, what);
  const size_t entry = first + static_cast<size_t>(index);
  GraphTensor result{graph_type.first_tensor[entry], graph_type.entries[entry]};
  const bool has_element = instruction.size() > first_operand + 1;
  const Type& own = *type(result.type);
  if (own.kind != Type::Kind::kArray) {
    if (has_element)
      return bad(instruction, "has an element index, but {} {} is no array", what, index);
    return result;
  }
  if (!has_element)
    return unsupported(where(instruction.at),
                       "{} {} is an array of {} tensors, which is taken element by element: its "
                       "element index is missing",
                       what, index, own.length);
  SHALE_TRY(const int64_t element,
            integer(instruction, "element index", instruction[first_operand + 1]));
  if (element < 0 || element >= own.length)
    return bad(instruction, "the element index is {}, {} {} has {} tensors", element, what, index,
               own.length);
  result.number += static_cast<uint32_t>(element);
  result.type = own.element;
  return result;
}

Result<void> Module::read_graph_input(const Instruction& instruction) {
  GraphDefinition& graph = graphs_.back();
  if (!graph.body.empty() || !graph.outputs.empty())
    return bad(instruction, "inputs come straight after OpGraphARM");
  SHALE_TRY(const GraphTensor tensor, graph_tensor(instruction, true, 3));
  if (instruction[1] != tensor.type)
    return bad(instruction, "its type is %{}, input {} of the graph's type is %{}", instruction[1],
               tensor.number, tensor.type);
  if (!seen_tensors_.insert(tensor.number).second)
    return bad(instruction, "input {} is read a second time", tensor.number);
  graph.inputs.push_back({instruction[2], tensor.number});
  values_.push_back({instruction[1], graphs_.size() - 1});
  return define(instruction, instruction[2], Kind::kValue, values_.size() - 1);
}

Result<void> Module::read_graph_output(const Instruction& instruction) {
  GraphDefinition& graph = graphs_.back();
  SHALE_TRY(const GraphTensor tensor, graph_tensor(instruction, false, 2));
  const uint32_t number = tensor.number - type(graph.type)->input_tensors();
  const uint32_t id = instruction[1];
  const auto found = definitions_.find(id);
  uint32_t found_type = 0;
  if (const Constant* as_constant = constant(id)) {
    found_type = as_constant->type;
  } else if (found != definitions_.end() && found->second.kind == Kind::kValue &&
             values_[found->second.index].graph == graphs_.size() - 1) {
    found_type = values_[found->second.index].type;
  } else {
    return bad(instruction, "%{} is no value of this graph and no constant", id);
  }
  if (found_type != tensor.type)
    return bad(instruction, "the type of %{} is %{}, output {} of the graph's type is %{}", id,
               found_type, number, tensor.type);
  if (!seen_tensors_.insert(tensor.number).second)
    return bad(instruction, "output {} is set a second time", number);
  graph.outputs.push_back({id, number});
  return {};
}

Result<void> Module::read_extract(const Instruction& instruction) {
  GraphDefinition& graph = graphs_.back();
  if (!graph.outputs.empty())
    return bad(instruction, "stands behind an OpGraphSetOutputARM, outputs come last");
  const auto found = definitions_.find(instruction[3]);
  const Type* whole = nullptr;
  if (found != definitions_.end() && found->second.kind == Kind::kValue &&
      values_[found->second.index].graph == graphs_.size() - 1)
    whole = type(values_[found->second.index].type);
  if (!whole || whole->kind != Type::Kind::kStruct)
    return bad(instruction, "%{} is no struct of this graph", instruction[3]);
  if (instruction.size() != 5 || instruction[4] >= whole->entries.size())
    return bad(instruction, "expected the index of one of {} members", whole->entries.size());
  if (instruction[1] != whole->entries[instruction[4]])
    return bad(instruction, "its type is %{}, member {} is %{}", instruction[1], instruction[4],
               whole->entries[instruction[4]]);
  graph.body.push_back(instruction.at);
  values_.push_back({instruction[1], graphs_.size() - 1});
  return define(instruction, instruction[2], Kind::kValue, values_.size() - 1);
}

Result<void> Module::end_graph(const Instruction& instruction) {
  GraphDefinition& graph = graphs_.back();
  const Type& graph_type = *type(graph.type);
  const size_t count = graph_type.first_tensor.back() - graph_type.input_tensors();
  if (graph.outputs.size() != count)
    return bad(instruction, "the graph sets {} of its {} outputs", graph.outputs.size(), count);
  std::ranges::sort(graph.outputs, {}, &GraphOutput::tensor);
  in_graph_ = false;
  return {};
}

Result<void> Module::check_entry_point(const EntryPoint& entry) const {
  const std::string label = where(entry.at);
  const GraphDefinition* found = graph(entry.graph);
  if (!found) return bad_input(label, "%{} is no OpGraphARM", entry.graph);
  const Type& graph_type = *type(found->type);
  if (entry.interface.size() != graph_type.entries.size())
    return bad_input(label, "has {} interface variables, the graph has {} inputs and {} outputs",
                     entry.interface.size(), graph_type.input_count,
                     graph_type.entries.size() - graph_type.input_count);
  for (size_t i = 0; i < entry.interface.size(); ++i) {
    const uint32_t id = entry.interface[i];
    const Variable* found_variable = variable(id);
    if (!found_variable) return bad_input(label, "the interface id %{} is no variable", id);
    const Type& pointer = *type(found_variable->type);
    if (found_variable->storage_class != kUniformConstant ||
        pointer.storage_class != kUniformConstant)
      return bad_input(label, "the variable %{} has storage class {}, expected UniformConstant", id,
                       found_variable->storage_class != kUniformConstant
                           ? found_variable->storage_class
                           : pointer.storage_class);
    if (pointer.element != graph_type.entries[i])
      return bad_input(label,
                       "the variable %{} points to type %{}, entry {} of the graph's type is "
                       "%{}",
                       id, pointer.element, i, graph_type.entries[i]);
    if (!sets.contains(id))
      return bad_input(label, "the variable %{} has no DescriptorSet decoration", id);
    if (!bindings.contains(id))
      return bad_input(label, "the variable %{} has no Binding decoration", id);
  }
  return {};
}

}  // namespace shale::spirv_graph
