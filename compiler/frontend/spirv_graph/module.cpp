#include "compiler/frontend/spirv_graph/module.h"

namespace shale::spirv_graph {
namespace {

const OpcodeInfo* opcode_info(uint32_t number) {
  const auto found = std::ranges::lower_bound(kOpcodes, number, {}, [](const OpcodeInfo& info) {
    return static_cast<uint32_t>(info.opcode);
  });
  return found != kOpcodes.end() && static_cast<uint32_t>(found->opcode) == number ? &*found
                                                                                   : nullptr;
}
static_assert(std::ranges::is_sorted(kOpcodes, {}, &OpcodeInfo::opcode));

std::string opcode_text(uint32_t number) {
  if (const OpcodeInfo* info = opcode_info(number)) return std::string(info->name);
  for (const NumberName& refused : kRefusedOpcodes)
    if (refused.number == number) return std::string(refused.name);
  return fmt::format("opcode {}", number);
}

/// Debug instructions and others that carry nothing for a graph.
bool is_skipped(Opcode opcode) {
  switch (opcode) {
    case Opcode::kNop:
    case Opcode::kSourceContinued:
    case Opcode::kSource:
    case Opcode::kSourceExtension:
    case Opcode::kMemberName:
    case Opcode::kLine:
    case Opcode::kExtension:
    case Opcode::kMemoryModel:
    case Opcode::kCapability:
    case Opcode::kMemberDecorate:
    case Opcode::kNoLine:
    case Opcode::kModuleProcessed:
    case Opcode::kDecorateId:
    case Opcode::kDecorateString: return true;
    default: return false;
  }
}

/// "i8[?,?]", "i8 of unknown rank".
std::string tensor_text(const Type& type) {
  return type.ranked ? type_text({type.dtype, type.shape})
                     : fmt::format("{} of unknown rank", dtype_info(type.dtype).name);
}

}  // namespace

std::string Module::where(size_t at) const {
  return fmt::format("word {} ({})", at, opcode_text(words[at] & 0xffff));
}

std::string Module::name(uint32_t id) const {
  const auto found = names.find(id);
  return found == names.end() ? std::string() : found->second;
}

std::vector<SpirvEntryPoint::Slot> Module::slots(const EntryPoint& entry) const {
  std::vector<SpirvEntryPoint::Slot> slots;
  for (const uint32_t id : entry.interface) {
    const Type& own = *type(type(variable(id)->type)->element);
    const bool is_array = own.kind == Type::Kind::kArray;
    const Type& tensor = is_array ? *type(own.element) : own;
    for (uint32_t i = 0; i < (is_array ? own.length : 1); ++i) {
      std::string own_name = name(id);
      if (is_array && !own_name.empty()) own_name += fmt::format(".{}", i);
      slots.push_back({std::move(own_name),
                       sets.at(id),
                       bindings.at(id),
                       {tensor.dtype, tensor.shape},
                       tensor.ranked,
                       is_array ? std::optional(i) : std::nullopt});
    }
  }
  return slots;
}

std::map<uint32_t, TensorType> Module::external_constants(const GraphDefinition& graph) const {
  std::map<uint32_t, TensorType> result;
  std::unordered_set<uint32_t> seen;
  std::vector<uint32_t> waiting;
  for (const size_t at : graph.body)
    for (size_t i = 5; i < words[at] >> 16; ++i) waiting.push_back(words[at + i]);
  for (const GraphOutput& output : graph.outputs) waiting.push_back(output.value);
  while (!waiting.empty()) {
    const uint32_t id = waiting.back();
    waiting.pop_back();
    const Constant* found = constant(id);
    if (!found || !seen.insert(id).second) continue;
    if (found->kind == Constant::Kind::kExternal) {
      const Type& own = *type(found->type);
      result.emplace(found->external_id,
                     TensorType{own.dtype, own.ranked ? own.shape : Shape{kDynamic}});
    }
    for (size_t i = 0; i < found->part_count; ++i) waiting.push_back(words[found->first_part + i]);
  }
  return result;
}

std::optional<TensorType> Module::data_type(const Type& found) const {
  if (found.kind == Type::Kind::kTensor && found.shaped)
    return TensorType{found.dtype, found.shape};
  if (found.kind != Type::Kind::kArray) return std::nullopt;
  const Type& element = *type(found.element);
  if (element.kind != Type::Kind::kScalar) return std::nullopt;
  return TensorType{element.dtype, {found.length}};
}

Result<Tensor> Module::tensor(uint32_t constant_id, const ExternalData& external,
                              int64_t& budget) const {
  const Constant& found = *constant(constant_id);
  if (found.kind == Constant::Kind::kExternal) return external_tensor(constant_id, external);
  const std::string label = fmt::format("constant %{}", constant_id);
  const std::optional<TensorType> wanted = data_type(*type(found.type));
  if (!wanted || found.kind == Constant::Kind::kOther)
    return bad_input(label, "is neither a shaped tensor nor an array of scalars");
  const int64_t size = *element_count(wanted->shape) * dtype_info(wanted->dtype).host_bytes;
  if (size > budget)
    return unsupported(label, "is {}: inline constants of a graph may take {} bytes together",
                       type_text(*wanted), kMaxInlineBytes);
  budget -= size;
  Tensor result = Tensor::zeros(*wanted);
  SHALE_TRY_VOID(expand(constant_id, external, 0, result));
  return result;
}

/// The caller has its bytes already, so those need no limit.
Result<Tensor> Module::external_tensor(uint32_t constant_id, const ExternalData& external) const {
  const Constant& found = *constant(constant_id);
  const Type& declared = *type(found.type);
  const std::string own_name = name(constant_id);
  const std::string label = fmt::format("graph constant {}{}", found.external_id,
                                        own_name.empty() ? "" : " \"" + own_name + "\"");
  const auto given = external.find(found.external_id);
  if (given == external.end())
    return bad_input(label,
                     "is {} from outside the module, and no data was given for it (of a .spv file, "
                     "with --constant {}=FILE)",
                     tensor_text(declared), found.external_id);
  const auto& [id, bytes, outside] = *given->second;
  Tensor result{{declared.dtype, declared.shape}, {}};
  if (!declared.shaped) {
    result.type.shape = outside;
    if (outside.empty() || (declared.ranked && outside.size() != declared.shape.size()))
      return bad_input(label, "is {} in the module and {} outside, so its shape is not known",
                       tensor_text(declared),
                       outside.empty() ? "nothing else" : shape_text(outside));
    if (std::ranges::any_of(outside, [](int64_t size) { return size < 1; }) ||
        !element_count(outside))
      return bad_input(label, "is {} outside, which is no shape of a constant",
                       shape_text(outside));
  }
  const size_t size = static_cast<size_t>(*element_count(result.type.shape) * result.host_bytes());
  if (bytes.size() != size)
    return bad_input(label, "has {} bytes of data, {} needs {}", bytes.size(),
                     type_text(result.type), size);
  result.bytes.assign(bytes.begin(), bytes.end());
  return result;
}

/// Depth: constituents have a rank less than their composite, which read_constant has checked.
Result<void> Module::expand(uint32_t constant_id, const ExternalData& external, int64_t first,
                            Tensor& result) const {
  const Constant& found = *constant(constant_id);
  if (found.kind == Constant::Kind::kScalar) {
    result.set(first, found.value);
    return {};
  }
  if (found.kind == Constant::Kind::kNull) return {};
  const size_t element_bytes = static_cast<size_t>(result.host_bytes());
  if (found.kind == Constant::Kind::kExternal) {
    SHALE_TRY(const Tensor part, external_tensor(constant_id, external));
    std::ranges::copy(part.bytes,
                      result.bytes.begin() + first * static_cast<std::ptrdiff_t>(element_bytes));
    return {};
  }
  const TensorType own = *data_type(*type(found.type));
  const int64_t count = *element_count(own.shape);
  const int64_t rows = own.shape[0], step = count / rows;
  if (found.kind == Constant::Kind::kComposite) {
    for (int64_t i = 0; i < rows; ++i)
      SHALE_TRY_VOID(expand(words[found.first_part + static_cast<size_t>(i)], external,
                            first + i * step, result));
    return {};
  }
  SHALE_TRY_VOID(expand(words[found.first_part], external, first, result));
  const size_t row_bytes = static_cast<size_t>(step) * element_bytes;
  uint8_t* row = result.bytes.data() + static_cast<size_t>(first) * element_bytes;
  for (int64_t i = 1; i < rows; ++i)
    std::memcpy(row + static_cast<size_t>(i) * row_bytes, row, row_bytes);
  return {};
}

Result<Module> Module::parse(std::span<const uint8_t> bytes) {
  if (bytes.size() % 4 != 0)
    return bad_input("", "found {} bytes, SPIR-V has 4 a word", bytes.size());
  if (bytes.size() < 4 * kHeaderWords)
    return bad_input("", "found {} words, a SPIR-V header has {}", bytes.size() / 4, kHeaderWords);
  Module module;
  module.words.resize(bytes.size() / 4);
  std::memcpy(module.words.data(), bytes.data(), bytes.size());
  const std::vector<uint32_t>& words = module.words;
  if (words[0] == __builtin_bswap32(kMagic))
    return unsupported("word 0", "the module is big-endian, expected little-endian");
  if (words[0] != kMagic)
    return bad_input("word 0", "found the magic number {:#010x}, expected {:#010x}", words[0],
                     kMagic);
  if (words[1] >> 16 != 1)
    return unsupported("word 1", "found the version word {:#010x}, expected SPIR-V 1", words[1]);
  module.bound_ = words[3];
  for (size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16) {
    SHALE_TRY(const Instruction instruction, module.instruction_at(at));
    if (is_skipped(instruction.opcode())) continue;
    SHALE_TRY_VOID(module.in_graph_ ? module.read_in_graph(instruction) : module.read(instruction));
  }
  if (module.in_graph_)
    return bad_input(module.where(module.graphs_.back().at),
                     "the module ends before this graph's OpGraphEndARM");
  if (module.entry_points.empty())
    return bad_input("", "the SPIR-V module has no graph entry point");
  std::unordered_set<std::string> entry_names;
  size_t interface_bytes = 0;
  for (const EntryPoint& entry : module.entry_points) {
    SHALE_TRY_VOID(module.check_entry_point(entry));
    for (const uint32_t id : entry.interface) {
      const auto named = module.names.find(id);
      const Type& own = *module.type(module.type(module.variable(id)->type)->element);
      const size_t tensors = own.kind == Type::Kind::kArray ? static_cast<size_t>(own.length) : 1;
      interface_bytes += tensors * (64 + (named == module.names.end() ? 0 : named->second.size()));
    }
    if (interface_bytes > kMaxListingBytes)
      return unsupported(module.where(entry.at),
                         "the interfaces take over {} bytes with their names", kMaxListingBytes);
    if (!entry_names.insert(entry.name).second)
      return bad_input(module.where(entry.at), "another entry point is named \"{}\" too",
                       entry.name);
  }
  return module;
}

Result<Module::Instruction> Module::instruction_at(size_t at) const {
  const uint32_t number = words[at] & 0xffff;
  const size_t size = words[at] >> 16;
  if (size == 0 || size > words.size() - at)
    return bad_input(where(at), "has {} words, {} are left in the module", size, words.size() - at);
  const OpcodeInfo* info = opcode_info(number);
  if (!info) return unsupported(where(at), "the instruction has no place in a graph module");
  if (size < info->min_words || size > info->max_words)
    return bad_input(where(at), "has {} words, expected {}", size,
                     info->max_words == info->min_words ? std::to_string(info->min_words)
                     : info->max_words == kMaxInstructionWords
                         ? fmt::format("at least {}", info->min_words)
                         : fmt::format("{} to {}", info->min_words, info->max_words));
  return Instruction{at, info, std::span(words).subspan(at, size)};
}

Result<void> Module::define(const Instruction& instruction, uint32_t id, Kind kind, size_t index) {
  if (id == 0 || id >= bound_)
    return bad(instruction, "the result id %{} is outside 1 to {}, the module's bound", id,
               bound_ == 0 ? 0 : bound_ - 1);
  if (!definitions_.emplace(id, Definition{kind, index}).second)
    return bad(instruction, "the id %{} is defined a second time", id);
  return {};
}

Result<std::string> Module::string(const Instruction& instruction, size_t first,
                                   size_t* end) const {
  std::string text;
  for (size_t i = first; i < instruction.size(); ++i)
    for (uint32_t shift = 0; shift < 32; shift += 8) {
      const char c = static_cast<char>(instruction[i] >> shift & 0xff);
      if (c == 0) {
        if (end) *end = i + 1;
        return text;
      }
      text += c;
    }
  return bad(instruction, "the string does not end within the instruction");
}

Result<int64_t> Module::integer(const Instruction& instruction, std::string_view what,
                                uint32_t id) const {
  const Constant* found = constant(id);
  if (!found || found->kind != Constant::Kind::kScalar || !is_integer(type(found->type)->dtype))
    return bad(instruction, "the {} %{} is no integer constant", what, id);
  return found->value;
}

Result<void> Module::read(const Instruction& instruction) {
  const Opcode opcode = instruction.opcode();
  switch (opcode) {
    case Opcode::kName: {
      SHALE_TRY(std::string text, string(instruction, 2, nullptr));
      names.emplace(instruction[1], std::move(text));
      return {};
    }
    case Opcode::kString: return define(instruction, instruction[1], Kind::kOther, 0);
    case Opcode::kDecorate: {
      const uint32_t decoration = instruction[2];
      if (decoration != kDecorationBinding && decoration != kDecorationDescriptorSet) return {};
      if (instruction.size() != 4)
        return bad(instruction, "has {} words, this decoration has 4", instruction.size());
      (decoration == kDecorationBinding ? bindings : sets)
          .insert_or_assign(instruction[1], instruction[3]);
      return {};
    }
    case Opcode::kExtInstImport: {
      SHALE_TRY(std::string text, string(instruction, 2, nullptr));
      if (text.starts_with("TOSA.") && text != kTosaSet)
        return unsupported(where(instruction.at),
                           "found the instruction set \"{}\", expected \"{}\"", text, kTosaSet);
      imports_.push_back(std::move(text));
      return define(instruction, instruction[1], Kind::kImport, imports_.size() - 1);
    }
    case Opcode::kExtInst: {
      const std::string* set = import(instruction[3]);
      if (!set || !set->starts_with("NonSemantic."))
        return bad(instruction, "stands outside a graph");
      return define(instruction, instruction[2], Kind::kOther, 0);
    }
    case Opcode::kGraphEntryPoint: {
      in_graph_section_ = true;
      EntryPoint entry{instruction.at, instruction[1], {}, {}};
      size_t end = 0;
      SHALE_TRY(entry.name, string(instruction, 2, &end));
      const auto ids = instruction.words.subspan(end);
      entry.interface.assign(ids.begin(), ids.end());
      entry_points.push_back(std::move(entry));
      return {};
    }
    case Opcode::kGraph: {
      in_graph_section_ = in_graph_ = true;
      const Type* found = type(instruction[1]);
      if (!found || found->kind != Type::Kind::kGraph)
        return bad(instruction, "its type %{} is no OpTypeGraphARM", instruction[1]);
      GraphDefinition graph;
      graph.type = instruction[1];
      graph.at = instruction.at;
      graphs_.push_back(std::move(graph));
      seen_tensors_.clear();
      return define(instruction, instruction[2], Kind::kGraph, graphs_.size() - 1);
    }
    case Opcode::kGraphInput:
    case Opcode::kGraphSetOutput:
    case Opcode::kGraphEnd:
    case Opcode::kCompositeExtract: return bad(instruction, "stands outside a graph");
    default: break;
  }
  if (in_graph_section_)
    return bad(instruction, "types, constants and variables come before the first graph");
  switch (opcode) {
    case Opcode::kVariable: {
      const Type* pointer = type(instruction[1]);
      if (!pointer || pointer->kind != Type::Kind::kPointer)
        return bad(instruction, "its type %{} is no pointer", instruction[1]);
      variables_.push_back({instruction[1], instruction[3]});
      return define(instruction, instruction[2], Kind::kVariable, variables_.size() - 1);
    }
    case Opcode::kConstantTrue:
    case Opcode::kConstantFalse:
    case Opcode::kConstant:
    case Opcode::kConstantComposite:
    case Opcode::kConstantNull:
    case Opcode::kSpecConstantTrue:
    case Opcode::kSpecConstantFalse:
    case Opcode::kSpecConstant:
    case Opcode::kSpecConstantComposite:
    case Opcode::kGraphConstant:
    case Opcode::kConstantCompositeReplicate:
    case Opcode::kSpecConstantCompositeReplicate: return read_constant(instruction);
    default: return read_type(instruction);
  }
}

Result<void> Module::read_type(const Instruction& instruction) {
  Type result;
  const Opcode opcode = instruction.opcode();
  switch (opcode) {
    case Opcode::kTypeBool:
      result.kind = Type::Kind::kScalar;
      result.dtype = DType::kBool;
      break;
    case Opcode::kTypeInt:
    case Opcode::kTypeFloat: {
      std::optional<uint32_t> encoding;
      if (opcode == Opcode::kTypeFloat && instruction.size() == 4) encoding = instruction[3];
      for (const ScalarInfo& scalar : kScalars)
        if (scalar.opcode == opcode && scalar.width == instruction[2] &&
            scalar.encoding == encoding) {
          result.kind = Type::Kind::kScalar;
          result.dtype = scalar.dtype;
        }
      break;
    }
    case Opcode::kTypeArray: {
      result.kind = Type::Kind::kArray;
      result.element = instruction[2];
      if (!type(result.element))
        return bad(instruction, "the element type %{} is no type", result.element);
      SHALE_TRY(result.length, integer(instruction, "length", instruction[3]));
      if (result.length < 1 || result.length > kMaxElements)
        return bad(instruction, "has length {}, expected 1 to {}", result.length, kMaxElements);
      break;
    }
    case Opcode::kTypePointer:
      result.kind = Type::Kind::kPointer;
      result.storage_class = instruction[2];
      result.element = instruction[3];
      if (!type(result.element))
        return bad(instruction, "the pointed type %{} is no type", result.element);
      break;
    case Opcode::kTypeTensor: SHALE_TRY_VOID(read_tensor_type(instruction, result)); break;
    case Opcode::kTypeGraph: SHALE_TRY_VOID(read_graph_type(instruction, result)); break;
    case Opcode::kTypeStruct:
      result.kind = Type::Kind::kStruct;
      result.entries.assign(instruction.words.begin() + 2, instruction.words.end());
      break;
    default: break;  // void, runtime array: declared, but nothing here can use them
  }
  types_.push_back(std::move(result));
  return define(instruction, instruction[1], Kind::kType, types_.size() - 1);
}

Result<void> Module::read_tensor_type(const Instruction& instruction, Type& result) {
  result.kind = Type::Kind::kTensor;
  const Type* element = type(instruction[2]);
  if (!element || element->kind != Type::Kind::kScalar)
    return unsupported(
        where(instruction.at),
        "the element type %{} is no bool, int8, int16, int32, int64, float32, float16, "
        "bfloat16 or float8",
        instruction[2]);
  result.dtype = element->dtype;
  if (instruction.size() < 4) return {};
  SHALE_TRY(const int64_t rank, integer(instruction, "rank", instruction[3]));
  if (rank < 1) return bad(instruction, "has rank {}, expected at least 1", rank);
  if (rank > kMaxRank)
    return unsupported(where(instruction.at), "has rank {}, level 8K ends at rank {}", rank,
                       kMaxRank);
  result.ranked = true;
  result.shape.assign(static_cast<size_t>(rank), kDynamic);
  if (instruction.size() < 5) return {};
  SHALE_TRY(result.shape, shape_value(instruction, instruction[4], static_cast<size_t>(rank)));
  result.shaped = true;
  return {};
}

Result<Shape> Module::shape_value(const Instruction& instruction, uint32_t id, size_t rank) const {
  const Constant* found = constant(id);
  const Type* array = found ? type(found->type) : nullptr;
  const std::optional<TensorType> data =
      array && array->kind == Type::Kind::kArray ? data_type(*array) : std::nullopt;
  if (!data || !is_integer(data->dtype))
    return bad(instruction, "the shape %{} is no constant array of integers", id);
  if (array->length != static_cast<int64_t>(rank))
    return bad(instruction, "the shape %{} has {} sizes, the rank is {}", id, array->length, rank);
  int64_t budget = kMaxInlineBytes;
  SHALE_TRY(const Tensor sizes, tensor(id, {}, budget));
  Shape shape = sizes.ints();
  for (const int64_t size : shape)
    if (size < 1) return bad(instruction, "has a size of {}, expected at least 1", size);
  if (!element_count(shape))
    return unsupported(where(instruction.at), "has shape {}, level 8K ends at {} elements",
                       shape_text(shape), kMaxElements);
  return shape;
}

Result<void> Module::read_constant(const Instruction& instruction) {
  Constant result;
  result.type = instruction[1];
  const Type* found = type(result.type);
  if (!found) return bad(instruction, "its type %{} is no type", result.type);
  const std::optional<TensorType> data = data_type(*found);
  // The data of a graph constant may tell the shape.
  if (found->kind == Type::Kind::kTensor && !found->shaped &&
      instruction.opcode() != Opcode::kGraphConstant)
    return bad(instruction, "its type is {}, only tensors with a shape can be constants",
               tensor_text(*found));
  switch (instruction.opcode()) {
    case Opcode::kConstantTrue:
    case Opcode::kConstantFalse:
    case Opcode::kSpecConstantTrue:
    case Opcode::kSpecConstantFalse: {
      if (found->kind != Type::Kind::kScalar || found->dtype != DType::kBool)
        return bad(instruction, "its type %{} is not bool", result.type);
      const Opcode opcode = instruction.opcode();
      result.kind = Constant::Kind::kScalar;
      result.value = opcode == Opcode::kConstantTrue || opcode == Opcode::kSpecConstantTrue ? 1 : 0;
      break;
    }
    case Opcode::kConstant:
    case Opcode::kSpecConstant: {
      if (found->kind == Type::Kind::kOther) break;  // such as float64
      if (found->kind != Type::Kind::kScalar || found->dtype == DType::kBool)
        return bad(instruction, "its type %{} is no number", result.type);
      const uint32_t host_bits = 8 * dtype_info(found->dtype).host_bytes;
      if (instruction.size() != (host_bits == 64 ? 5u : 4u))
        return bad(instruction, "has {} words, a value of {} bits makes it {}", instruction.size(),
                   host_bits, host_bits == 64 ? 5 : 4);
      uint64_t bits = instruction[3];
      if (host_bits == 64) bits |= static_cast<uint64_t>(instruction[4]) << 32;
      result.kind = Constant::Kind::kScalar;
      result.value = static_cast<int64_t>(bits << (64 - host_bits)) >> (64 - host_bits);
      break;
    }
    case Opcode::kConstantNull:
      if (data) result.kind = Constant::Kind::kNull;
      if (found->kind == Type::Kind::kScalar) result.kind = Constant::Kind::kScalar;
      break;
    case Opcode::kGraphConstant: {
      if (found->kind != Type::Kind::kTensor)
        return bad(instruction, "its type %{} is no tensor type", result.type);
      result.kind = Constant::Kind::kExternal;
      result.external_id = instruction[3];
      const auto [other, is_new] = external_ids_.emplace(result.external_id, instruction.at);
      if (!is_new)
        return bad(instruction, "the GraphConstantID {} is taken by word {}", result.external_id,
                   other->second);
      break;
    }
    default: {  // composites
      if (!data) break;
      const bool replicate = instruction.opcode() == Opcode::kConstantCompositeReplicate ||
                             instruction.opcode() == Opcode::kSpecConstantCompositeReplicate;
      result.kind = replicate ? Constant::Kind::kReplicate : Constant::Kind::kComposite;
      result.first_part = instruction.at + 3;
      result.part_count = instruction.size() - 3;
      SHALE_TRY_VOID(check_parts(instruction, *data, replicate ? 1 : data->shape[0]));
    }
  }
  constants_.push_back(result);
  return define(instruction, instruction[2], Kind::kConstant, constants_.size() - 1);
}

/// The constituents are scalars for a list, and tensors of the inner shape for a higher rank.
Result<void> Module::check_parts(const Instruction& instruction, const TensorType& data,
                                 int64_t expected) const {
  const auto parts = instruction.words.subspan(3);
  if (static_cast<int64_t>(parts.size()) != expected)
    return bad(instruction, "has {} constituents, {} needs {}", parts.size(), type_text(data),
               expected);
  const TensorType inner{data.dtype, Shape(data.shape.begin() + 1, data.shape.end())};
  for (const uint32_t id : parts) {
    const Constant* part = constant(id);
    if (!part || part->kind == Constant::Kind::kOther)
      return bad(instruction, "the constituent %{} is no constant", id);
    const Type& part_type = *type(part->type);
    const bool fits = inner.shape.empty()
                          ? part_type.kind == Type::Kind::kScalar && part_type.dtype == data.dtype
                          : part_type.kind == Type::Kind::kTensor && data_type(part_type) == inner;
    if (!fits)
      return bad(instruction, "the constituent %{} is not {}, as {} needs", id,
                 inner.shape.empty() ? std::string(dtype_info(data.dtype).name) : type_text(inner),
                 type_text(data));
  }
  return {};
}

}  // namespace shale::spirv_graph
