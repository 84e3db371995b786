// compiler/frontend/spirv_graph/grammar.h -- numbers of SPIR-V and of TOSA.001000.1 that graph
// modules use, as tables. Source: SPIR-V 1.6, SPV_ARM_tensors, SPV_ARM_graph,
// SPV_EXT_replicated_composites, TOSA.001000.1.
#pragma once

#include <algorithm>
#include <array>
#include <string_view>
#include <vector>

#include "ir/base/dtype.h"
#include "ir/graph/op.h"

namespace shale::spirv_graph {

inline constexpr uint32_t kMagic = 0x07230203;
inline constexpr uint32_t kVersion15 = 0x00010500;
inline constexpr size_t kHeaderWords = 5;
inline constexpr size_t kMaxInstructionWords = 65535;
inline constexpr std::string_view kTosaSet = "TOSA.001000.1";

inline constexpr uint32_t kDecorationBinding = 33, kDecorationDescriptorSet = 34;
inline constexpr uint32_t kUniformConstant = 0;
inline constexpr uint32_t kLogicalAddressing = 0, kVulkanMemory = 3;

enum class Opcode : uint16_t {
  kNop = 0,
  kSourceContinued = 2,
  kSource = 3,
  kSourceExtension = 4,
  kName = 5,
  kMemberName = 6,
  kString = 7,
  kLine = 8,
  kExtension = 10,
  kExtInstImport = 11,
  kExtInst = 12,
  kMemoryModel = 14,
  kCapability = 17,
  kTypeVoid = 19,
  kTypeBool = 20,
  kTypeInt = 21,
  kTypeFloat = 22,
  kTypeArray = 28,
  kTypeRuntimeArray = 29,
  kTypeStruct = 30,
  kTypePointer = 32,
  kConstantTrue = 41,
  kConstantFalse = 42,
  kConstant = 43,
  kConstantComposite = 44,
  kConstantNull = 46,
  kSpecConstantTrue = 48,
  kSpecConstantFalse = 49,
  kSpecConstant = 50,
  kSpecConstantComposite = 51,
  kVariable = 59,
  kDecorate = 71,
  kMemberDecorate = 72,
  kCompositeExtract = 81,
  kNoLine = 317,
  kModuleProcessed = 330,
  kDecorateId = 332,
  kTypeTensor = 4163,
  kGraphConstant = 4181,
  kGraphEntryPoint = 4182,
  kGraph = 4183,
  kGraphInput = 4184,
  kGraphSetOutput = 4185,
  kGraphEnd = 4186,
  kTypeGraph = 4190,
  kConstantCompositeReplicate = 4461,
  kSpecConstantCompositeReplicate = 4462,
  kDecorateString = 5632,
};

struct OpcodeInfo {
  Opcode opcode;
  std::string_view name;
  size_t min_words;
  size_t max_words;
};

/// What a graph module may hold.
inline constexpr auto kOpcodes = std::to_array<OpcodeInfo>({
    {Opcode::kNop, "OpNop", 1, 1},
    {Opcode::kSourceContinued, "OpSourceContinued", 2, kMaxInstructionWords},
    {Opcode::kSource, "OpSource", 3, kMaxInstructionWords},
    {Opcode::kSourceExtension, "OpSourceExtension", 2, kMaxInstructionWords},
    {Opcode::kName, "OpName", 3, kMaxInstructionWords},
    {Opcode::kMemberName, "OpMemberName", 4, kMaxInstructionWords},
    {Opcode::kString, "OpString", 3, kMaxInstructionWords},
    {Opcode::kLine, "OpLine", 4, 4},
    {Opcode::kExtension, "OpExtension", 2, kMaxInstructionWords},
    {Opcode::kExtInstImport, "OpExtInstImport", 3, kMaxInstructionWords},
    {Opcode::kExtInst, "OpExtInst", 5, kMaxInstructionWords},
    {Opcode::kMemoryModel, "OpMemoryModel", 3, 3},
    {Opcode::kCapability, "OpCapability", 2, 2},
    {Opcode::kTypeVoid, "OpTypeVoid", 2, 2},
    {Opcode::kTypeBool, "OpTypeBool", 2, 2},
    {Opcode::kTypeInt, "OpTypeInt", 4, 4},
    {Opcode::kTypeFloat, "OpTypeFloat", 3, 4},
    {Opcode::kTypeArray, "OpTypeArray", 4, 4},
    {Opcode::kTypeRuntimeArray, "OpTypeRuntimeArray", 3, 3},
    {Opcode::kTypeStruct, "OpTypeStruct", 2, kMaxInstructionWords},
    {Opcode::kTypePointer, "OpTypePointer", 4, 4},
    {Opcode::kConstantTrue, "OpConstantTrue", 3, 3},
    {Opcode::kConstantFalse, "OpConstantFalse", 3, 3},
    {Opcode::kConstant, "OpConstant", 4, 5},
    {Opcode::kConstantComposite, "OpConstantComposite", 3, kMaxInstructionWords},
    {Opcode::kConstantNull, "OpConstantNull", 3, 3},
    {Opcode::kSpecConstantTrue, "OpSpecConstantTrue", 3, 3},
    {Opcode::kSpecConstantFalse, "OpSpecConstantFalse", 3, 3},
    {Opcode::kSpecConstant, "OpSpecConstant", 4, 5},
    {Opcode::kSpecConstantComposite, "OpSpecConstantComposite", 3, kMaxInstructionWords},
    {Opcode::kVariable, "OpVariable", 4, 5},
    {Opcode::kDecorate, "OpDecorate", 3, kMaxInstructionWords},
    {Opcode::kMemberDecorate, "OpMemberDecorate", 4, kMaxInstructionWords},
    {Opcode::kCompositeExtract, "OpCompositeExtract", 4, kMaxInstructionWords},
    {Opcode::kNoLine, "OpNoLine", 1, 1},
    {Opcode::kModuleProcessed, "OpModuleProcessed", 2, kMaxInstructionWords},
    {Opcode::kDecorateId, "OpDecorateId", 3, kMaxInstructionWords},
    {Opcode::kTypeTensor, "OpTypeTensorARM", 3, 5},
    {Opcode::kGraphConstant, "OpGraphConstantARM", 4, 4},
    {Opcode::kGraphEntryPoint, "OpGraphEntryPointARM", 3, kMaxInstructionWords},
    {Opcode::kGraph, "OpGraphARM", 3, 3},
    {Opcode::kGraphInput, "OpGraphInputARM", 4, 5},
    {Opcode::kGraphSetOutput, "OpGraphSetOutputARM", 3, 4},
    {Opcode::kGraphEnd, "OpGraphEndARM", 1, 1},
    {Opcode::kTypeGraph, "OpTypeGraphARM", 3, kMaxInstructionWords},
    {Opcode::kConstantCompositeReplicate, "OpConstantCompositeReplicateEXT", 4, 4},
    {Opcode::kSpecConstantCompositeReplicate, "OpSpecConstantCompositeReplicateEXT", 4, 4},
    {Opcode::kDecorateString, "OpDecorateString", 4, kMaxInstructionWords},
});

struct NumberName {
  uint32_t number;
  std::string_view name;
};

/// Instructions that people may meet and Shale does not read, for messages.
inline constexpr auto kRefusedOpcodes = std::to_array<NumberName>({
    {1, "OpUndef"},
    {15, "OpEntryPoint"},
    {16, "OpExecutionMode"},
    {23, "OpTypeVector"},
    {25, "OpTypeImage"},
    {33, "OpTypeFunction"},
    {52, "OpSpecConstantOp"},
    {54, "OpFunction"},
    {73, "OpDecorationGroup"},
    {74, "OpGroupDecorate"},
    {331, "OpExecutionModeId"},
    {4164, "OpTensorReadARM"},
    {4165, "OpTensorWriteARM"},
    {4166, "OpTensorQuerySizeARM"},
});

enum class Capability : uint32_t {
  kShader = 1,
  kFloat16 = 9,
  kInt64 = 11,
  kInt16 = 22,
  kInt8 = 39,
  kTensors = 4174,
  kGraph = 4191,
  kFloat8 = 4212,
  kBFloat16 = 5116,
  kVulkanMemoryModel = 5345,
};

/// How an element type is declared. Shader, which every module has, brings the others.
struct ScalarInfo {
  DType dtype;
  Opcode opcode;
  uint32_t width;  ///< bits; 0 for bool
  Capability capability;
  std::optional<uint32_t> encoding = {};  ///< of floats that are not IEEE 754's
  std::string_view extension = {};
};
inline constexpr auto kScalars = std::to_array<ScalarInfo>({
    {DType::kBool, Opcode::kTypeBool, 0, Capability::kShader},
    {DType::kInt8, Opcode::kTypeInt, 8, Capability::kInt8},
    {DType::kInt16, Opcode::kTypeInt, 16, Capability::kInt16},
    {DType::kInt32, Opcode::kTypeInt, 32, Capability::kShader},
    {DType::kInt48, Opcode::kTypeInt, 64, Capability::kInt64},
    {DType::kFp16, Opcode::kTypeFloat, 16, Capability::kFloat16},
    {DType::kFp32, Opcode::kTypeFloat, 32, Capability::kShader},
    {DType::kBf16, Opcode::kTypeFloat, 16, Capability::kBFloat16, 0, "SPV_KHR_bfloat16"},
    {DType::kFp8E4M3, Opcode::kTypeFloat, 8, Capability::kFloat8, 4214, "SPV_EXT_float8"},
    {DType::kFp8E5M2, Opcode::kTypeFloat, 8, Capability::kFloat8, 4215, "SPV_EXT_float8"},
});

/// The set numbers its instructions as the file format does its operators, from 0 instead of 1, and
/// ends with RESCALE.
inline constexpr uint32_t kInstructionCount = 66;
inline std::optional<Op> op_of_instruction(uint32_t number) {
  return number < kInstructionCount ? op_from_wire(number + 1) : std::nullopt;
}
inline uint32_t instruction_of(Op op) { return op_info(op).wire - 1; }

/// Attributes in the order of the set: that of ops.def, but acc_type comes before local_bound, and without the part.
inline std::vector<Attr> instruction_attrs(Op op) {
  std::vector<Attr> attrs = op_info(op).attrs;
  std::erase(attrs, Attr::kPart);
  const auto bound = std::ranges::find(attrs, Attr::kLocalBound);
  const auto acc = std::ranges::find(attrs, Attr::kAccType);
  if (bound != attrs.end() && acc != attrs.end()) std::iter_swap(bound, acc);
  return attrs;
}

/// acc_type: position in this list, from 1.
inline constexpr auto kAccTypes =
    std::to_array<DType>({DType::kInt32, DType::kFp16, DType::kFp32, DType::kInt48});

/// Operands that TOSA has as shapes and the set as int32 tensors.
inline bool is_shape_operand(Op op, size_t operand) {
  switch (op) {
    case Op::kPad:
    case Op::kReshape:
    case Op::kTile: return operand == 1;
    case Op::kSlice:
    case Op::kResize: return operand >= 1;
    default: return false;
  }
}

}  // namespace shale::spirv_graph
