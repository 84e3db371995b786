#include "tools/layer/tensor_shader.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <unordered_map>

namespace shale::layer {
namespace {

using Words = std::vector<uint32_t>;

constexpr size_t kHeaderWords = 5;  // of a module
constexpr uint32_t kMagic = 0x07230203;
constexpr uint32_t kMostRank = 6;

enum Op : uint32_t {
  kOpName = 5,
  kOpExtension = 10,
  kOpMemoryModel = 14,
  kOpEntryPoint = 15,
  kOpCapability = 17,
  kOpTypeVoid = 19,
  kOpTypeBool = 20,
  kOpTypeInt = 21,
  kOpTypeFloat = 22,
  kOpTypeArray = 28,
  kOpTypeRuntimeArray = 29,
  kOpTypeStruct = 30,
  kOpTypePointer = 32,
  kOpTypeFunction = 33,
  kOpConstant = 43,
  kOpConstantNull = 46,
  kOpFunction = 54,
  kOpFunctionParameter = 55,
  kOpFunctionEnd = 56,
  kOpFunctionCall = 57,
  kOpVariable = 59,
  kOpLoad = 61,
  kOpStore = 62,
  kOpAccessChain = 65,
  kOpInBoundsAccessChain = 66,
  kOpDecorate = 71,
  kOpMemberDecorate = 72,
  kOpCompositeConstruct = 80,
  kOpCompositeExtract = 81,
  kOpUConvert = 113,
  kOpSConvert = 114,
  kOpBitcast = 124,
  kOpIAdd = 128,
  kOpIMul = 132,
  kOpLogicalAnd = 167,
  kOpSelect = 169,
  kOpINotEqual = 171,
  kOpULessThan = 176,
  kOpSelectionMerge = 247,
  kOpLabel = 248,
  kOpBranch = 249,
  kOpBranchConditional = 250,
  kOpReturn = 253,
  kOpReturnValue = 254,
  kOpTypeTensor = 4163,
  kOpTensorRead = 4164,
  kOpTensorWrite = 4165,
  kOpTensorQuerySize = 4166,
};
constexpr uint32_t kCapabilityTensors = 4174, kCapabilityGraph = 4191;
constexpr uint32_t kCapabilityTensorArrays = 4175, kCapabilityTensorNonUniform = 4176;
constexpr uint32_t kCapabilityNonUniform = 5301, kCapabilityBufferNonUniform = 5308;
constexpr uint32_t kCapabilityInt8 = 39, kCapabilityBufferArrays = 30, kCapabilityBuffer8 = 4448,
                   kCapabilityBuffer16 = 4433;
constexpr uint32_t kUniformConstant = 0, kStorageBuffer = 12;
constexpr uint32_t kDecorationBlock = 2, kDecorationArrayStride = 6, kDecorationAliased = 20,
                   kDecorationNonWritable = 24, kDecorationNonReadable = 25,
                   kDecorationBinding = 33, kDecorationSet = 34, kDecorationOffset = 35,
                   kDecorationNonUniform = 5300;

/// An operand that reads or writes may have: the value outside of the tensor.
constexpr uint32_t kOutOfBoundsValue = 2;

bool is_declaration(uint32_t op) {
  return (op >= kOpTypeVoid && op <= 52) || op == kOpVariable || op == kOpFunction ||
         op == kOpTypeTensor || op == 1;  // OpUndef
}

std::string literal(std::span<const uint32_t> words) {
  std::string text(reinterpret_cast<const char*>(words.data()), 4 * words.size());
  return text.substr(0, text.find('\0'));
}

Words string_words(const char* text) {
  Words words(std::strlen(text) / 4 + 1);
  std::memcpy(words.data(), text, std::strlen(text));
  return words;
}

struct Instruction {
  uint32_t op = 0;
  Words operands;
};

void append(Words& out, uint32_t op, std::span<const uint32_t> operands) {
  out.push_back(static_cast<uint32_t>(operands.size() + 1) << 16 | op);
  out.insert(out.end(), operands.begin(), operands.end());
}
void append(Words& out, uint32_t op, std::initializer_list<uint32_t> operands) {
  append(out, op, std::span(operands.begin(), operands.size()));
}

class Lowering {
 public:
  Result<Words> run(std::span<const uint32_t> words) {
    SHALE_TRY_VOID(read(words));
    find_variables();
    find_gone();
    for (const Instruction& instruction : instructions_) SHALE_TRY_VOID(lower(instruction));
    return write(words);
  }

 private:
  struct Variable {
    uint32_t id = 0;       ///< of the elements; that of the tensors
    uint32_t shapes = 0;   ///< the variable of the shapes
    uint32_t element = 0;  ///< type of the tensors' elements
    uint32_t stored = 0;   ///< type of an element in memory
    uint32_t array = 0;    ///< the array type, or 0 for a single tensor
    uint32_t element_pointer = 0, word_pointer = 0;
  };
  /// Where a value of the module is a tensor, or a pointer to one.
  struct Place {
    size_t variable = 0;
    uint32_t index = 0;  ///< id, 0 for a single tensor
  };

  Result<void> read(std::span<const uint32_t> words) {
    if (words.size() < kHeaderWords || words[0] != kMagic)
      return bad_input("shader module", "is no SPIR-V");
    bound_ = words[3];
    for (size_t at = kHeaderWords; at < words.size();) {
      const size_t size = words[at] >> 16;
      if (size == 0 || size > words.size() - at)
        return bad_input(fmt::format("shader module, word {}", at), "an instruction has {} words",
                         size);
      Instruction& instruction = instructions_.emplace_back();
      instruction.op = words[at] & 0xffff;
      instruction.operands.assign(words.begin() + static_cast<std::ptrdiff_t>(at) + 1,
                                  words.begin() + static_cast<std::ptrdiff_t>(at + size));
      at += size;
      const Words& o = instruction.operands;
      const auto least = [&](size_t count) { return o.size() >= count; };
      switch (instruction.op) {
        case kOpTypeVoid:
        case kOpTypeBool:
        case kOpTypeInt:
        case kOpTypeFloat:
        case kOpTypeArray:
        case kOpTypeRuntimeArray:
        case kOpTypePointer:
        case kOpTypeFunction:
        case kOpTypeTensor:
          if (least(1)) types_[o[0]] = instruction;
          break;
        case kOpConstant:
          if (least(3)) constants_[o[1]] = {o[0], o[2]}, type_of_[o[1]] = o[0];
          break;
        default:
          // Whatever has a type and a result: where coordinates come from.
          if (least(2) && has_type_and_result(instruction.op)) type_of_[o[1]] = o[0];
      }
    }
    return {};
  }

  /// Those that may give coordinates, indices and dimensions; others give no integers.
  static bool has_type_and_result(uint32_t op) {
    return op == 1 || op == 12 || (op >= 41 && op <= 52) || op == kOpFunctionParameter ||
           op == kOpFunctionCall || op == kOpLoad || (op >= 77 && op <= 84) ||
           (op >= 109 && op <= 215) || op == 245 || op == 400 || (op >= 227 && op <= 242) ||
           op == 61 || op == 65 || op == kOpTensorRead || op == kOpTensorQuerySize;
  }

  const Instruction* type(uint32_t id) const {
    const auto found = types_.find(id);
    return found == types_.end() ? nullptr : &found->second;
  }
  bool is(uint32_t id, uint32_t op, size_t operands) const {
    const Instruction* found = type(id);
    return found && found->op == op && found->operands.size() >= operands;
  }
  uint32_t fresh() { return bound_++; }

  /// Types and constants that SPIR-V wants to be there once.
  uint32_t unique(uint32_t op, const Words& operands) {
    for (const auto& [id, known] : types_)
      if (known.op == op && std::equal(operands.begin(), operands.end(), known.operands.begin() + 1,
                                       known.operands.end()))
        return id;
    const uint32_t id = fresh();
    Words all{id};
    all.insert(all.end(), operands.begin(), operands.end());
    append(declarations_, op, all);
    types_[id] = {op, all};
    return id;
  }
  uint32_t pointer(uint32_t to) {
    const uint32_t id = fresh();
    append(declarations_, kOpTypePointer, {id, kStorageBuffer, to});
    return id;
  }
  uint32_t word(uint32_t value) {
    uint32_t& id = words_[value];
    if (id == 0) {
      id = fresh();
      append(declarations_, kOpConstant, {word_type_, id, value});
    }
    return id;
  }
  uint32_t null_of(uint32_t type_id) {
    uint32_t& id = nulls_[type_id];
    if (id == 0) {
      id = fresh();
      append(declarations_, kOpConstantNull, {type_id, id});
    }
    return id;
  }

  /// A block of a runtime array, and the pointer to it or to an array of it as `like` has one.
  uint32_t block_variable(uint32_t id, uint32_t stored, uint32_t bytes, uint32_t like) {
    const uint32_t list = fresh(), block = fresh();
    append(declarations_, kOpTypeRuntimeArray, {list, stored});
    append(declarations_, kOpTypeStruct, {block, list});
    append(annotations_, kOpDecorate, {list, kDecorationArrayStride, bytes});
    append(annotations_, kOpDecorate, {block, kDecorationBlock});
    append(annotations_, kOpMemberDecorate, {block, 0, kDecorationOffset, 0});
    const uint32_t array = fresh();
    const Instruction* shape = type(like);
    if (like && shape->op == kOpTypeRuntimeArray) {
      append(declarations_, kOpTypeRuntimeArray, {array, block});
    } else {
      const uint32_t count = like ? constants_.at(shape->operands[2]).second : 1;
      append(declarations_, kOpTypeArray, {array, block, word(kBuffersOfTensor * count)});
    }
    append(declarations_, kOpVariable, {pointer(array), id, kStorageBuffer});
    append(annotations_, kOpDecorate, {id, kDecorationAliased});
    return id;
  }

  uint32_t bits_of(uint32_t type_id) const {
    if (is(type_id, kOpTypeBool, 1)) return 8;
    return is(type_id, kOpTypeInt, 2) || is(type_id, kOpTypeFloat, 2) ? type(type_id)->operands[1]
                                                                      : 0;
  }

  void find_variables() {
    word_type_ = unique(kOpTypeInt, {32, 0});
    bool_type_ = unique(kOpTypeBool, {});
    void_type_ = unique(kOpTypeVoid, {});
    for (const Instruction& instruction : std::vector(instructions_)) {
      const Words& o = instruction.operands;
      if (instruction.op != kOpVariable || o.size() < 3 || o[2] != kUniformConstant ||
          !is(o[0], kOpTypePointer, 3))
        continue;
      uint32_t pointee = type(o[0])->operands[2], array = 0;
      const bool counted =
          is(pointee, kOpTypeArray, 3) && constants_.contains(type(pointee)->operands[2]);
      if (counted || is(pointee, kOpTypeRuntimeArray, 2)) {
        array = pointee;
        pointee = type(pointee)->operands[1];
      }
      if (!is(pointee, kOpTypeTensor, 2)) continue;
      Variable variable;
      variable.id = o[1];
      variable.element = type(pointee)->operands[1];
      variable.array = array;
      const uint32_t bits = bits_of(variable.element);
      if (bits < 8 || bits > 64) continue;
      variable.stored =
          is(variable.element, kOpTypeBool, 1) ? unique(kOpTypeInt, {8, 0}) : variable.element;
      if (variable.stored != variable.element) capabilities_.insert(kCapabilityInt8);
      if (bits == 8) capabilities_.insert(kCapabilityBuffer8);
      if (bits == 16) capabilities_.insert(kCapabilityBuffer16);
      block_variable(variable.id, variable.stored, bits / 8, array);
      variable.shapes = block_variable(fresh(), word_type_, 4, array);
      variable.element_pointer = pointer(variable.stored);
      variable.word_pointer = pointer(word_type_);
      by_id_[variable.id] = variables_.size();
      variables_.push_back(variable);
    }
  }

  /// What is not in the result, so that nothing may name it.
  void find_gone() {
    for (const Instruction& instruction : instructions_) {
      const Words& o = instruction.operands;
      const bool is_access =
          instruction.op == kOpAccessChain || instruction.op == kOpInBoundsAccessChain;
      if ((is_access && o.size() == 4 && by_id_.contains(o[2])) ||
          (instruction.op == kOpLoad && o.size() >= 3 && is(o[0], kOpTypeTensor, 2)))
        gone_.insert(o[1]);
    }
    for (const auto& [id, known] : types_)
      if (is_tensor(id) || (is(id, kOpTypePointer, 3) && is_tensor(known.operands[2])))
        gone_.insert(id);
  }

  const Place* place(uint32_t id) const {
    const auto found = places_.find(id);
    return found == places_.end() ? nullptr : &found->second;
  }

  Result<void> lower(const Instruction& instruction) {
    const Words& o = instruction.operands;
    switch (instruction.op) {
      case kOpCapability:
        if (o.size() == 1 && o[0] == kCapabilityTensors) return {};
        if (o.size() == 1 && o[0] == kCapabilityTensorNonUniform) {
          is_non_uniform_ = true;
          capabilities_.insert({kCapabilityNonUniform, kCapabilityBufferNonUniform});
          return {};
        }
        if (o.size() == 1 && o[0] == kCapabilityTensorArrays) {
          capabilities_.insert(kCapabilityBufferArrays);
          return {};
        }
        if (o.size() == 1) capabilities_.erase(o[0]), stated_.insert(o[0]);
        break;
      case kOpExtension:
        if (literal(o) == "SPV_ARM_tensors") return {};
        break;
      case kOpEntryPoint: return lower_entry_point(instruction);
      case kOpDecorate:
        if (o.size() >= 2 && by_id_.contains(o[0])) return lower_decoration(instruction);
        if (!o.empty() && gone_.contains(o[0])) return {};
        break;
      case kOpName:
        if (!o.empty() && gone_.contains(o[0])) return {};
        break;
      case kOpTypeTensor: return {};
      case kOpTypeArray:
      case kOpTypeRuntimeArray:
        if (o.size() >= 2 && is(o[1], kOpTypeTensor, 2)) return {};
        break;
      case kOpTypePointer:
        if (o.size() >= 3 && is_tensor(o[2])) return {};
        break;
      case kOpTypeFunction:
        for (const uint32_t id : o)
          if (is_tensor(id) || (is(id, kOpTypePointer, 3) && is_tensor(type(id)->operands[2])))
            return unsupported("shader module", "passes a tensor to a function");
        break;
      case kOpVariable:
        if (o.size() >= 2 && by_id_.contains(o[1])) return {};
        if (!o.empty() && is(o[0], kOpTypePointer, 3) && is_tensor(type(o[0])->operands[2]))
          return unsupported("shader module", "has a tensor that no buffer can hold");
        break;
      case kOpAccessChain:
      case kOpInBoundsAccessChain:
        if (o.size() == 4 && by_id_.contains(o[2])) {
          places_[o[1]] = {by_id_.at(o[2]), o[3]};
          return {};
        }
        break;
      case kOpLoad:
        if (o.size() >= 3 && is(o[0], kOpTypeTensor, 2)) return lower_load(o);
        break;
      case kOpTensorRead: return lower_read(o);
      case kOpTensorWrite: return lower_write(o);
      case kOpTensorQuerySize: return lower_query(o);
      default: break;
    }
    Words& section = section_of(instruction.op);
    append(section, instruction.op, o);
    return {};
  }

  bool is_tensor(uint32_t id) const {
    if (is(id, kOpTypeTensor, 2)) return true;
    return (is(id, kOpTypeArray, 2) || is(id, kOpTypeRuntimeArray, 2)) &&
           is(type(id)->operands[1], kOpTypeTensor, 2);
  }

  /// Capabilities, what comes before annotations and with them, declarations, functions.
  Words& section_of(uint32_t op) {
    if (op == kOpCapability) return first_;
    if (op == kOpFunction) in_functions_ = true;
    if (in_functions_) return functions_;
    if (is_declaration(op)) in_declarations_ = true;
    return in_declarations_ ? own_declarations_ : head_;
  }

  Result<void> lower_entry_point(const Instruction& instruction) {
    Words o = instruction.operands;
    Words added;
    size_t first = 2;  // behind execution model, function and name
    const auto ends_name = [](uint32_t word) {
      return !(word & 0xff) || !(word & 0xff00) || !(word & 0xff0000) || !(word & 0xff000000);
    };
    while (first < o.size() && !ends_name(o[first])) ++first;
    for (size_t i = first + 1; i < o.size(); ++i)
      if (const auto found = by_id_.find(o[i]); found != by_id_.end())
        added.push_back(variables_[found->second].shapes);
    o.insert(o.end(), added.begin(), added.end());
    append(head_, instruction.op, o);
    return {};
  }

  Result<void> lower_decoration(const Instruction& instruction) {
    Words o = instruction.operands;
    const bool binds = o[1] == kDecorationBinding || o[1] == kDecorationSet;
    const bool says_use = o[1] == kDecorationNonWritable || o[1] == kDecorationNonReadable;
    if (!binds && !says_use) return {};  // has no meaning for buffers
    append(head_, kOpDecorate, o);
    if (!binds) return {};
    o[0] = variables_[by_id_.at(o[0])].shapes;
    append(head_, kOpDecorate, o);
    return {};
  }

  Result<void> lower_load(const Words& o) {
    if (const auto direct = by_id_.find(o[2]); direct != by_id_.end()) {
      places_[o[1]] = {direct->second, 0};
      return {};
    }
    const Place* at = place(o[2]);
    if (!at) return unsupported("shader module", "loads a tensor from what is no variable");
    places_[o[1]] = Place(*at);
    return {};
  }

  /// The index among the variable's buffers: 2i for elements, 2i + 1 for the shape.
  uint32_t buffer_index(Words& code, uint32_t index, uint32_t which) {
    if (index == 0) return word(which);
    const uint32_t twice = fresh(), sum = fresh();
    append(code, kOpIMul, {word_type_, twice, as_word(code, index), word(kBuffersOfTensor)});
    append(code, kOpIAdd, {word_type_, sum, twice, word(which)});
    return sum;
  }

  /// An integer of any type as a 32-bit word. What does not fit is no index of a tensor.
  uint32_t as_word(Words& code, uint32_t id) {
    const auto known = type_of_.find(id);
    const Instruction* own = known == type_of_.end() ? nullptr : type(known->second);
    if (!own || own->op != kOpTypeInt || own->operands.size() < 3 || known->second == word_type_)
      return id;
    return converted(code, id, *own);
  }
  uint32_t converted(Words& code, uint32_t id, const Instruction& own) {
    const uint32_t result = fresh();
    if (own.operands[1] == 32) {
      append(code, kOpBitcast, {word_type_, result, id});
    } else if (own.operands[1] == 64) {
      // Beyond 32 bits there is no element: such a coordinate becomes one that is outside.
      const uint32_t wide = unique(kOpTypeInt, {64, 0});
      const uint32_t bits = fresh(), low = fresh(), back = fresh(), differs = fresh();
      append(code, own.operands[2] ? kOpBitcast : kOpIAdd,
             own.operands[2] ? Words{wide, bits, id} : Words{wide, bits, id, null_of(wide)});
      append(code, kOpUConvert, {word_type_, low, bits});
      append(code, kOpUConvert, {wide, back, low});
      append(code, kOpINotEqual, {bool_type_, differs, back, bits});
      append(code, kOpSelect, {word_type_, result, differs, word(~0u), low});
    } else {
      append(code, own.operands[2] ? kOpSConvert : kOpUConvert, {word_type_, result, id});
    }
    return result;
  }

  uint32_t shape_word(Words& code, const Variable& variable, uint32_t buffer, uint32_t at) {
    const uint32_t value = fresh();
    append(code, kOpLoad,
           {word_type_, value,
            in_buffer(code, variable, variable.word_pointer, variable.shapes, buffer, at)});
    return value;
  }

  /// A pointer to word or element `at` of one of the variable's buffers.
  uint32_t in_buffer(Words& code, const Variable& variable, uint32_t pointer_type, uint32_t blocks,
                     uint32_t buffer, uint32_t at) {
    const uint32_t chain = fresh();
    append(code, kOpAccessChain, {pointer_type, chain, blocks, buffer, word(0), at});
    if (is_non_uniform_ && variable.array != 0)
      append(annotations_, kOpDecorate, {chain, kDecorationNonUniform});
    return chain;
  }

  Result<uint32_t> count_of(uint32_t array) const {
    if (!is(array, kOpTypeArray, 3) || !constants_.contains(type(array)->operands[2]))
      return bad_input("shader module", "coordinates are %{}, expected an array", array);
    return constants_.at(type(array)->operands[2]).second;
  }

  /// Where a function gets its tensor's index from: a parameter unless it is a constant, which needs no
  /// dynamic indexing then.
  struct Access {
    const Variable* variable;
    uint32_t index = 0, index_type = 0;  ///< id of the caller
    bool index_is_constant = false;
    uint32_t value_type = 0;
    uint32_t coordinates_type = 0;
    uint32_t rank = 0, length = 1;
    bool is_array = false;
  };

  Result<Access> access(uint32_t tensor, uint32_t coordinates, uint32_t value_type) {
    const Place* at = place(tensor);
    const auto coordinates_type = type_of_.find(coordinates);
    if (!at || coordinates_type == type_of_.end())
      return unsupported("shader module", "reads or writes %{}, which is no variable's tensor",
                         tensor);
    Access result;
    result.variable = &variables_[at->variable];
    result.index = at->index;
    result.index_is_constant = at->index == 0 || constants_.contains(at->index);
    if (const auto found = type_of_.find(at->index); found != type_of_.end())
      result.index_type = found->second;
    if (!result.index_is_constant) {
      if (result.index_type == 0) return bad_input("shader module", "an index has no type");
      capabilities_.insert(kCapabilityBufferArrays);
    }
    result.coordinates_type = coordinates_type->second;
    SHALE_TRY(result.rank, count_of(result.coordinates_type));
    if (result.rank == 0 || result.rank > kMostRank)
      return unsupported("shader module", "has {} coordinates, expected 1 to {}", result.rank,
                         kMostRank);
    result.value_type = value_type;
    if (value_type != result.variable->element) {
      SHALE_TRY(result.length, count_of(value_type));
      constexpr uint32_t kMostLength = 1024;
      if (type(value_type)->operands[1] != result.variable->element || result.length > kMostLength)
        return bad_input("shader module", "%{} is no value of the tensor's elements", value_type);
      result.is_array = true;
    }
    return result;
  }

  /// Sizes, strides and coordinates of an access inside of a function.
  struct Address {
    uint32_t elements = 0;                    ///< index of the buffer
    uint32_t inside = 0;                      ///< of all axes but the last
    uint32_t offset = 0, last = 0, size = 0;  ///< of those; coordinate and size of the last axis
  };
  Address address(Words& code, const Access& access, uint32_t index, uint32_t coordinates) {
    const Variable& variable = *access.variable;
    const uint32_t shape = buffer_index(code, index, 1);
    Address result;
    result.elements = buffer_index(code, index, 0);
    const uint32_t element = type(access.coordinates_type)->operands[1];
    for (uint32_t axis = 0; axis < access.rank; ++axis) {
      uint32_t at = fresh();
      append(code, kOpCompositeExtract, {element, at, coordinates, axis});
      if (const Instruction* own = type(element);
          element != word_type_ && own && own->op == kOpTypeInt)
        at = converted(code, at, *own);
      const uint32_t size = shape_word(code, variable, shape, word(kFirstSizeWord + axis));
      if (axis + 1 == access.rank) {
        result.last = at, result.size = size;
        break;
      }
      const uint32_t stride = shape_word(code, variable, shape, word(kFirstStrideWord + axis));
      const uint32_t fits = fresh(), step = fresh();
      append(code, kOpULessThan, {bool_type_, fits, at, size});
      append(code, kOpIMul, {word_type_, step, at, stride});
      result.inside = join(code, kOpLogicalAnd, bool_type_, result.inside, fits);
      result.offset = join(code, kOpIAdd, word_type_, result.offset, step);
    }
    return result;
  }
  uint32_t join(Words& code, uint32_t op, uint32_t type_id, uint32_t a, uint32_t b) {
    if (a == 0) return b;
    const uint32_t result = fresh();
    append(code, op, {type_id, result, a, b});
    return result;
  }

  /// Element k of an access: whether it is there, and its place, 0 where it is not.
  struct Element {
    uint32_t inside = 0, pointer = 0;
  };
  Element element(Words& code, const Variable& variable, const Address& address, uint32_t k) {
    uint32_t last = address.last;
    if (k > 0) last = join(code, kOpIAdd, word_type_, last, word(k));
    Element result;
    uint32_t fits = fresh();
    append(code, kOpULessThan, {bool_type_, fits, last, address.size});
    if (k > 0) {  // a coordinate that is outside stays there
      const uint32_t base = fresh();
      append(code, kOpULessThan, {bool_type_, base, address.last, address.size});
      fits = join(code, kOpLogicalAnd, bool_type_, base, fits);
    }
    result.inside = join(code, kOpLogicalAnd, bool_type_, address.inside, fits);
    const uint32_t sum = join(code, kOpIAdd, word_type_, address.offset, last), place = fresh();
    append(code, kOpSelect, {word_type_, place, result.inside, sum, word(0)});
    result.pointer =
        in_buffer(code, variable, variable.element_pointer, variable.id, address.elements, place);
    return result;
  }

  /// The function for an access, made where there is none yet; `body` adds to its code.
  template <typename Body>
  uint32_t function(const Access& access, bool writes, uint32_t result_type, const Body& body) {
    const uint32_t constant_index = access.index_is_constant ? access.index : 0;
    uint32_t& id = functions_by_access_[{
        access.variable->id, constant_index, access.index_is_constant, access.value_type,
        access.coordinates_type, writes, access.index_is_constant ? 0 : access.index_type}];
    if (id != 0) return id;
    id = fresh();
    Words parameters{result_type, access.coordinates_type, access.value_type};
    if (!access.index_is_constant) parameters.push_back(access.index_type);
    Words code;
    append(code, kOpFunction, {result_type, id, 0, unique(kOpTypeFunction, parameters)});
    const auto parameter = [&](uint32_t type_id) {
      const uint32_t parameter_id = fresh();
      append(code, kOpFunctionParameter, {type_id, parameter_id});
      type_of_[parameter_id] = type_id;
      return parameter_id;
    };
    const uint32_t coordinates = parameter(access.coordinates_type);
    const uint32_t value = parameter(access.value_type);
    const uint32_t index = access.index_is_constant ? access.index : parameter(access.index_type);
    append(code, kOpLabel, {fresh()});
    const Address where = address(code, access, index, coordinates);
    body(code, where, value);
    append(code, kOpFunctionEnd, {});
    helpers_.insert(helpers_.end(), code.begin(), code.end());
    return id;
  }

  void call(uint32_t function_id, uint32_t result_type, uint32_t result, const Access& access,
            uint32_t coordinates, uint32_t value) {
    Words operands{result_type, result, function_id, coordinates, value};
    if (!access.index_is_constant) operands.push_back(access.index);
    append(functions_, kOpFunctionCall, operands);
  }

  Result<void> lower_read(const Words& o) {
    if (o.size() < 4)
      return bad_input("shader module", "OpTensorReadARM has {} operands", o.size());
    SHALE_TRY(const Access read, access(o[2], o[3], o[0]));
    const Variable& variable = *read.variable;
    uint32_t outside = 0;
    if (o.size() > 4 && o[4] & kOutOfBoundsValue && o.size() > 5) outside = o[5];
    if (outside == 0) {
      outside = null_of(o[0]);
    } else if (read.is_array && type_of_[outside] == variable.element) {
      const uint32_t all = fresh();  // one value for all elements
      Words operands{o[0], all};
      operands.insert(operands.end(), read.length, outside);
      append(functions_, kOpCompositeConstruct, operands);
      outside = all;
    }
    const uint32_t id =
        function(read, false, o[0], [&](Words& code, const Address& where, uint32_t value) {
          Words elements;
          for (uint32_t k = 0; k < read.length; ++k) {
            const Element at = element(code, variable, where, k);
            uint32_t loaded = fresh();
            append(code, kOpLoad, {variable.stored, loaded, at.pointer});
            if (variable.stored != variable.element) {
              const uint32_t truth = fresh();
              append(code, kOpINotEqual,
                     {variable.element, truth, loaded, null_of(variable.stored)});
              loaded = truth;
            }
            uint32_t other = value;
            if (read.is_array) {
              other = fresh();
              append(code, kOpCompositeExtract, {variable.element, other, value, k});
            }
            elements.push_back(fresh());
            append(code, kOpSelect, {variable.element, elements.back(), at.inside, loaded, other});
          }
          uint32_t result = elements[0];
          if (read.is_array) {
            result = fresh();
            Words operands{read.value_type, result};
            operands.insert(operands.end(), elements.begin(), elements.end());
            append(code, kOpCompositeConstruct, operands);
          }
          append(code, kOpReturnValue, {result});
        });
    call(id, o[0], o[1], read, o[3], outside);
    return {};
  }

  Result<void> lower_write(const Words& o) {
    if (o.size() < 3)
      return bad_input("shader module", "OpTensorWriteARM has {} operands", o.size());
    const auto value_type = type_of_.find(o[2]);
    if (value_type == type_of_.end()) return bad_input("shader module", "%{} has no type", o[2]);
    SHALE_TRY(const Access write, access(o[0], o[1], value_type->second));
    const Variable& variable = *write.variable;
    const uint32_t id =
        function(write, true, void_type_, [&](Words& code, const Address& where, uint32_t value) {
          for (uint32_t k = 0; k < write.length; ++k) {
            const Element at = element(code, variable, where, k);
            uint32_t stored = value;
            if (write.is_array) {
              stored = fresh();
              append(code, kOpCompositeExtract, {variable.element, stored, value, k});
            }
            if (variable.stored != variable.element) {
              const uint32_t byte = fresh(), one = fresh();
              append(declarations_, kOpConstant, {variable.stored, one, 1});
              append(code, kOpSelect,
                     {variable.stored, byte, stored, one, null_of(variable.stored)});
              stored = byte;
            }
            const uint32_t then = fresh(), after = fresh();
            append(code, kOpSelectionMerge, {after, 0});
            append(code, kOpBranchConditional, {at.inside, then, after});
            append(code, kOpLabel, {then});
            append(code, kOpStore, {at.pointer, stored});
            append(code, kOpBranch, {after});
            append(code, kOpLabel, {after});
          }
          append(code, kOpReturn, {});
        });
    call(id, void_type_, fresh(), write, o[1], o[2]);
    return {};
  }

  Result<void> lower_query(const Words& o) {
    if (o.size() < 4)
      return bad_input("shader module", "OpTensorQuerySizeARM has {} operands", o.size());
    const Place* at = place(o[2]);
    if (!at || !is(o[0], kOpTypeInt, 3))
      return unsupported("shader module", "asks %{} for a size", o[2]);
    if (at->index != 0 && !constants_.contains(at->index))
      capabilities_.insert(kCapabilityBufferArrays);
    const Variable& variable = variables_[at->variable];
    const uint32_t buffer = buffer_index(functions_, at->index, 1), where = fresh();
    append(functions_, kOpIAdd,
           {word_type_, where, as_word(functions_, o[3]), word(kFirstSizeWord)});
    const uint32_t size = shape_word(functions_, variable, buffer, where);
    const uint32_t bits = type(o[0])->operands[1];
    if (o[0] == word_type_)
      append(functions_, kOpIAdd, {o[0], o[1], size, word(0)});
    else if (bits == 32)
      append(functions_, kOpBitcast, {o[0], o[1], size});
    else
      append(functions_, type(o[0])->operands[2] ? kOpSConvert : kOpUConvert, {o[0], o[1], size});
    return {};
  }

  Result<Words> write(std::span<const uint32_t> words) {
    Words out(words.begin(), words.begin() + kHeaderWords);
    out[3] = bound_;
    out.insert(out.end(), first_.begin(), first_.end());
    for (const uint32_t capability : capabilities_)
      if (!stated_.contains(capability)) append(out, kOpCapability, {capability});
    append(out, kOpExtension, string_words("SPV_KHR_storage_buffer_storage_class"));
    if (capabilities_.contains(kCapabilityBuffer8))
      append(out, kOpExtension, string_words("SPV_KHR_8bit_storage"));
    if (capabilities_.contains(kCapabilityBuffer16))
      append(out, kOpExtension, string_words("SPV_KHR_16bit_storage"));
    if (is_non_uniform_) append(out, kOpExtension, string_words("SPV_EXT_descriptor_indexing"));
    for (const Words* section :
         {&head_, &annotations_, &own_declarations_, &declarations_, &functions_, &helpers_})
      out.insert(out.end(), section->begin(), section->end());
    return out;
  }

  std::vector<Instruction> instructions_;
  uint32_t bound_ = 0;
  std::unordered_map<uint32_t, Instruction> types_;                        ///< by id
  std::unordered_map<uint32_t, std::pair<uint32_t, uint32_t>> constants_;  ///< type and first word
  std::unordered_map<uint32_t, uint32_t> type_of_;
  std::vector<Variable> variables_;
  std::unordered_map<uint32_t, size_t> by_id_;
  std::unordered_map<uint32_t, Place> places_;
  std::map<uint32_t, uint32_t> words_, nulls_;
  std::map<std::tuple<uint32_t, uint32_t, bool, uint32_t, uint32_t, bool, uint32_t>, uint32_t>
      functions_by_access_;
  std::set<uint32_t> gone_;  ///< ids
  std::set<uint32_t> capabilities_, stated_;
  uint32_t word_type_ = 0, bool_type_ = 0, void_type_ = 0;
  bool in_declarations_ = false, in_functions_ = false;
  bool is_non_uniform_ = false;  ///< indices of tensor arrays may be
  Words first_, head_, annotations_, own_declarations_, declarations_, functions_, helpers_;
};

}  // namespace

bool has_tensors(std::span<const uint32_t> words) {
  bool tensors = false;
  for (size_t at = kHeaderWords; at < words.size();) {
    const size_t size = words[at] >> 16;
    if (size < 2 || size > words.size() - at || (words[at] & 0xffff) != kOpCapability) break;
    if (words[at + 1] == kCapabilityGraph) return false;
    tensors = tensors || words[at + 1] == kCapabilityTensors ||
              words[at + 1] == kCapabilityTensorArrays ||
              words[at + 1] == kCapabilityTensorNonUniform;
    at += size;
  }
  return tensors;
}

Result<std::vector<uint32_t>> lower_tensors(std::span<const uint32_t> words) {
  return Lowering().run(words);
}

}  // namespace shale::layer
