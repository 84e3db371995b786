#include "compiler/spirv/cooperative_matrix.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <set>

namespace shale {
namespace {

// Source: SPIR-V 1.6; SPV_NV_cooperative_matrix; SPV_KHR_cooperative_matrix.
constexpr uint32_t kHeaderWords = 5, kBoundWord = 3;
constexpr uint32_t kOpUndef = 1, kOpSource = 3, kOpLine = 8, kOpExtension = 10, kOpCapability = 17,
                   kOpTypeVoid = 19, kOpTypeBool = 20, kOpTypeInt = 21, kOpTypePointer = 32,
                   kOpTypeFunction = 33, kOpTypeForwardPointer = 39, kOpConstantTrue = 41,
                   kOpConstantFalse = 42, kOpConstant = 43, kOpConstantNull = 46,
                   kOpFunctionParameter = 55, kOpFunctionCall = 57, kOpLoad = 61,
                   kOpCompositeConstruct = 80, kOpCopyObject = 83, kOpPhi = 245;
constexpr uint32_t kTypeKhr = 4456, kLoadKhr = 4457, kStoreKhr = 4458, kMulAddKhr = 4459,
                   kLengthKhr = 4460;
constexpr uint32_t kTypeNv = 5358, kLoadNv = 5359, kStoreNv = 5360, kMulAddNv = 5361,
                   kLengthNv = 5362;
constexpr uint32_t kCapabilityInt8 = 39, kCapabilityKhr = 6022, kCapabilityNv = 5357;
constexpr uint32_t kUseA = 0, kUseB = 1, kUseAccumulator = 2, kAllSigned = 15;
constexpr char kExtensionKhr[] = "SPV_KHR_cooperative_matrix";
constexpr char kExtensionNv[] = "SPV_NV_cooperative_matrix";

/// Words of an instruction, the first being opcode and length.
using Instruction = std::vector<uint32_t>;

uint32_t opcode(const Instruction& instruction) { return instruction[0] & 0xffff; }

Instruction make(uint32_t op, std::vector<uint32_t> operands) {
  operands.insert(operands.begin(), 0);
  operands[0] = static_cast<uint32_t>(operands.size()) << 16 | op;
  return operands;
}

Instruction extension(std::string_view name) {
  std::vector<uint32_t> words(name.size() / 4 + 1, 0);
  std::memcpy(words.data(), name.data(), name.size());
  return make(kOpExtension, words);
}

Result<std::vector<Instruction>> parse(const Spirv& words, const std::string& where) {
  if (words.size() < kHeaderWords) return bad_input(where, "holds no SPIR-V");
  std::vector<Instruction> instructions;
  for (size_t at = kHeaderWords; at < words.size();) {
    const size_t length = words[at] >> 16;
    if (length == 0 || length > words.size() - at)
      return bad_input(where, "word {}: broken instruction", at);
    const auto begin = words.begin() + static_cast<std::ptrdiff_t>(at);
    instructions.emplace_back(begin, begin + static_cast<std::ptrdiff_t>(length));
    // Fewest and most words; what may be left out is what the product's operands tell.
    static const std::map<uint32_t, std::pair<size_t, size_t>> kLengths{{kTypeKhr, {7, 7}},
                                                                        {kLoadKhr, {6, 8}},
                                                                        {kStoreKhr, {5, 7}},
                                                                        {kMulAddKhr, {7, 7}},
                                                                        {kLengthKhr, {4, 4}}};
    if (const auto known = kLengths.find(opcode(instructions.back())); known != kLengths.end())
      if (length < known->second.first || length > known->second.second)
        return bad_input(where, "word {}: instruction {} has {} words", at, known->first, length);
    at += length;
  }
  return instructions;
}

Spirv join(const Spirv& header, uint32_t bound, const std::vector<Instruction>& instructions) {
  Spirv words(header.begin(), header.begin() + kHeaderWords);
  words[kBoundWord] = bound;
  for (const Instruction& each : instructions) words.insert(words.end(), each.begin(), each.end());
  return words;
}

/// Where types begin.
std::vector<Instruction>::iterator first_type(std::vector<Instruction>& instructions) {
  return std::find_if(instructions.begin(), instructions.end(), [](const Instruction& each) {
    const uint32_t op = opcode(each);
    return (op >= kOpTypeVoid && op <= kOpTypeForwardPointer) || op == kTypeKhr;
  });
}

/// Without their use two types of matrices may be equal, which types may not be: one takes the place
/// of the other.
void merge_older_types(std::vector<Instruction>& instructions) {
  std::map<Instruction, uint32_t> first;      // id by all that follows it
  std::map<uint32_t, uint32_t> replacements;  // of ids
  std::erase_if(instructions, [&](const Instruction& each) {
    if (opcode(each) != kTypeNv) return false;
    const auto [same, is_new] = first.try_emplace({each.begin() + 2, each.end()}, each[1]);
    if (!is_new) replacements[each[1]] = same->second;
    return !is_new;
  });
  const auto replace = [&](uint32_t& id) {
    const auto found = replacements.find(id);
    if (found != replacements.end()) id = found->second;
  };
  // From the types on a first operand is an id: a result's type, or nothing that was replaced.
  for (auto each = first_type(instructions); each != instructions.end(); ++each) {
    const uint32_t op = opcode(*each);
    if (each->size() > 1) replace((*each)[1]);
    if (op == kOpTypePointer && each->size() > 3) replace((*each)[3]);
    if (op == kOpTypeFunction)
      for (size_t i = 2; i < each->size(); ++i) replace((*each)[i]);
  }
}

}  // namespace

bool uses_cooperative_matrices(const Spirv& words) {
  // Capabilities stand first; most modules are long and have nothing to look for.
  for (size_t at = kHeaderWords; at + 1 < words.size(); at += 2) {
    if (words[at] != (2u << 16 | kOpCapability)) return false;
    if (words[at + 1] == kCapabilityKhr) return true;
  }
  return false;
}

Result<void> complete_cooperative_matrices(Spirv& words, const std::string& where) {
  if (!uses_cooperative_matrices(words)) return {};
  SHALE_TRY(std::vector<Instruction> instructions, parse(words, where));
  std::erase_if(instructions, [](const Instruction& each) {
    const uint32_t op = opcode(each);
    return op >= kOpSource && op <= kOpLine;
  });
  uint32_t bound = words[kBoundWord];
  std::map<uint32_t, uint32_t> integers;  // id of the signed integer of so many bits
  for (Instruction& each : instructions) {
    if (opcode(each) != kTypeKhr) continue;
    const uint32_t bits = each[2];
    if (bits != 8 && bits != 32)
      return bad_input(where, "a matrix has elements of {} bits, expected 8 or 32", bits);
    if (!integers.contains(bits)) {
      const auto is_type = [&](const Instruction& type) {
        return opcode(type) == kOpTypeInt && type.size() == 4 && type[2] == bits && type[3] == 1;
      };
      const auto found = std::find_if(instructions.begin(), instructions.end(), is_type);
      integers[bits] = found == instructions.end() ? bound++ : (*found)[1];
    }
    each[2] = integers[bits];
  }
  // The integers have to stand before the matrices, and types may not be declared twice.
  std::vector<Instruction> types;
  for (const auto& [bits, id] : integers) {
    types.push_back(make(kOpTypeInt, {id, bits, 1}));
    std::erase(instructions, types.back());
  }
  instructions.insert(first_type(instructions), types.begin(), types.end());
  const Instruction int8 = make(kOpCapability, {kCapabilityInt8});
  if (integers.contains(8) &&
      std::find(instructions.begin(), instructions.end(), int8) == instructions.end())
    instructions.insert(instructions.begin(), int8);
  words = join(words, bound, instructions);
  return {};
}

Result<Spirv> with_older_matrices(const Spirv& words, const std::string& where) {
  SHALE_TRY(std::vector<Instruction> instructions, parse(words, where));
  uint32_t bound = words[kBoundWord];
  std::map<uint32_t, uint32_t> constants;  // 32 bits by id
  std::map<uint32_t, uint32_t> types;      // of what may be a matrix
  std::map<uint32_t, uint32_t> use_ids;    // of matrix types: id of the constant
  uint32_t boolean = 0;
  for (const Instruction& each : instructions) {
    switch (opcode(each)) {
      case kOpTypeBool: boolean = each[1]; break;
      case kOpConstant:
        if (each.size() == 4) constants[each[2]] = each[3];
        break;
      case kTypeKhr: use_ids[each[1]] = each[6]; break;
      case kOpUndef:
      case kOpConstantNull:
      case kOpFunctionParameter:
      case kOpFunctionCall:
      case kOpLoad:
      case kOpCompositeConstruct:
      case kOpCopyObject:
      case kOpPhi:
      case kLoadKhr:
      case kMulAddKhr:
        if (each.size() > 2) types[each[2]] = each[1];
        break;
      default: break;
    }
  }
  const auto use_of_type = [&](uint32_t type) -> std::optional<uint32_t> {
    const auto use = use_ids.find(type);
    if (use == use_ids.end()) return std::nullopt;
    const auto value = constants.find(use->second);
    return value == constants.end() ? std::nullopt : std::optional(value->second);
  };
  const auto use_of = [&](uint32_t id) {
    const auto type = types.find(id);
    return type == types.end() ? std::nullopt : use_of_type(type->second);
  };
  const bool declares_bool = boolean == 0;
  if (declares_bool) boolean = bound++;
  const uint32_t row_major = bound++, column_major = bound++;
  const auto layout = [&](uint32_t id) -> std::optional<uint32_t> {
    const auto value = constants.find(id);
    if (value == constants.end() || value->second > 1) return std::nullopt;
    return value->second == 0 ? row_major : column_major;
  };
  for (Instruction& each : instructions) {
    const uint32_t op = opcode(each);
    if (op == kOpCapability && each[1] == kCapabilityKhr) {
      each[1] = kCapabilityNv;
    } else if (op == kOpExtension && each == extension(kExtensionKhr)) {
      each = extension(kExtensionNv);
    } else if (op == kTypeKhr) {
      each = make(kTypeNv, {each[1], each[2], each[3], each[4], each[5]});
    } else if (op == kLengthKhr) {
      each[0] = make(kLengthNv, {each[1], each[2], each[3]})[0];
    } else if (op == kLoadKhr || op == kStoreKhr) {
      // Pointer (and object) stand first; the layout comes after the stride in the older form.
      const size_t at = op == kLoadKhr ? 4 : 3;
      const std::optional<uint32_t> order = layout(each[at]);
      if (!order) return bad_input(where, "the layout of a matrix is no constant 0 or 1");
      each[at] = each[at + 1];
      each[at + 1] = *order;
      each[0] = (each[0] & 0xffff0000u) | (op == kLoadKhr ? kLoadNv : kStoreNv);
    } else if (op == kMulAddKhr) {
      if (use_of(each[3]) != kUseA || use_of(each[4]) != kUseB ||
          use_of(each[5]) != kUseAccumulator || use_of_type(each[1]) != kUseAccumulator)
        return bad_input(where, "a product's operands are no matrices A, B and accumulator");
      if (each[6] != kAllSigned)
        return bad_input(where, "a product has the operands {}, expected all to be signed",
                         each[6]);
      each = make(kMulAddNv, {each[1], each[2], each[3], each[4], each[5]});
    }
  }
  merge_older_types(instructions);
  const std::vector<Instruction> orders{make(kOpConstantFalse, {boolean, row_major}),
                                        make(kOpConstantTrue, {boolean, column_major})};
  const Instruction bool_type = make(kOpTypeBool, {boolean});
  if (declares_bool) instructions.insert(first_type(instructions), bool_type);
  instructions.insert(std::find(instructions.begin(), instructions.end(), bool_type) + 1,
                      orders.begin(), orders.end());
  return join(words, bound, instructions);
}

}  // namespace shale
