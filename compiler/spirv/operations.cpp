#include "compiler/spirv/operations.h"

#include <spirv/unified1/GLSL.std.450.h>

#include <map>
#include <spirv/unified1/spirv.hpp>
#include <vector>

namespace shale {
namespace {

/// GPUs have units for these that make a quarter of the other operations' rate.
bool is_quarter_rate(uint32_t function) {
  return (function >= GLSLstd450Sin && function <= GLSLstd450InverseSqrt) ||
         function == GLSLstd450Length || function == GLSLstd450Distance ||
         function == GLSLstd450Normalize;
}

/// Opcodes whose result has the type in word 1 and that compute something: a range each.
bool computes(uint32_t opcode) {
  return (opcode >= spv::OpConvertFToU && opcode <= spv::OpQuantizeToF16) ||
         (opcode >= spv::OpSNegate && opcode <= spv::OpSMulExtended) ||
         (opcode >= spv::OpAny && opcode <= spv::OpFUnordGreaterThanEqual) ||
         (opcode >= spv::OpShiftRightLogical && opcode <= spv::OpBitCount);
}

bool touches_memory(uint32_t opcode) {
  return (opcode >= spv::OpImageSampleImplicitLod && opcode <= spv::OpImageWrite) ||
         (opcode >= spv::OpAtomicLoad && opcode <= spv::OpAtomicXor) || opcode == spv::OpLoad ||
         opcode == spv::OpStore;
}

}  // namespace

Result<double> spirv_operations(const Spirv& words, const std::string& where) {
  std::map<uint32_t, uint32_t> components, types;  // of types and of values, by id
  std::vector<uint32_t> loops;                     // merge blocks of the open ones
  double turns = 1, operations = 0;
  for (size_t at = 5; at < words.size();) {
    const uint32_t opcode = words[at] & 0xffff, length = words[at] >> 16;
    if (length == 0 || at + length > words.size())
      return bad_input(where, "word {}: broken instruction", at);
    const auto word = [&](uint32_t i) { return i < length ? words[at + i] : 0; };
    const auto width = [&](uint32_t type) {
      const auto known = components.find(type);
      return known == components.end() ? 1.0 : known->second;
    };
    if (opcode == spv::OpTypeVector) {
      components[word(1)] = word(3);
    } else if (opcode == spv::OpLoopMerge) {
      loops.push_back(word(1));
      turns *= kAssumedTurns;
    } else if (opcode == spv::OpLabel && !loops.empty() && loops.back() == word(1)) {
      loops.pop_back();
      turns /= kAssumedTurns;
    } else if (opcode == spv::OpDot) {
      operations += turns * 2 * width(types[word(3)]);
    } else if (opcode == spv::OpExtInst) {
      operations += turns * width(word(1)) * (is_quarter_rate(word(4)) ? 4 : 1);
    } else if (computes(opcode)) {
      operations += turns * width(word(1));
    } else if (touches_memory(opcode)) {
      operations += turns;
    }
    if (length > 2) types[word(2)] = word(1);  // exact for all with a result, never read for others
    at += length;
  }
  return operations;
}

}  // namespace shale
