#include "compiler/spirv/check.h"

#include <algorithm>
#include <array>
#include <map>
#include <spirv-tools/libspirv.hpp>
#include <spirv-tools/optimizer.hpp>
#include <spirv/unified1/spirv.hpp>

#include "compiler/spirv/cooperative_matrix.h"

namespace shale {
namespace {

constexpr spv_target_env kEnvironment = SPV_ENV_VULKAN_1_3;
// Not in the headers of 2023.
constexpr uint32_t kCapabilityCooperativeMatrixKhr = 6022, kOpTypeCooperativeMatrixKhr = 4456,
                   kOpCooperativeMatrixLoadKhr = 4457, kOpCooperativeMatrixMulAddKhr = 4459;

/// Collects what SPIRV-Tools says into one line.
spvtools::MessageConsumer into(std::string& text) {
  return [&text](spv_message_level_t, const char*, const spv_position_t& position,
                 const char* message) {
    if (text.empty()) text = fmt::format("word {}: {}", position.index, message);
  };
}

}  // namespace

Result<Spirv> optimize_spirv(const Spirv& words, const std::string& where) {
  spvtools::Optimizer optimizer(kEnvironment);
  std::string message;
  optimizer.SetMessageConsumer(into(message));
  optimizer.RegisterPerformancePasses();
  spvtools::OptimizerOptions options;
  options.set_run_validator(false);
  Spirv result;
  if (!optimizer.Run(words.data(), words.size(), &result, options))
    return bad_input(where, "spirv-opt refuses the module: {}", message);
  return result;
}

Result<Validity> validate_spirv(const Spirv& words, const std::string& where) {
  if (uses_cooperative_matrices(words)) {
    SHALE_TRY(const Spirv older, with_older_matrices(words, where));
    SHALE_TRY_VOID(validate_spirv(older, where));
    return Validity::kNewerThanValidator;
  }
  spvtools::SpirvTools tools(kEnvironment);
  std::string message;
  tools.SetMessageConsumer(into(message));
  if (!tools.Validate(words)) return bad_input(where, "the module is not valid: {}", message);
  return Validity::kValid;
}

Result<std::string> disassemble_spirv(const Spirv& words) {
  if (uses_cooperative_matrices(words)) {
    SHALE_TRY(const Spirv older, with_older_matrices(words, ""));
    SHALE_TRY(const std::string text, disassemble_spirv(older));
    return "; SPV_KHR_cooperative_matrix, shown as SPV_NV_cooperative_matrix\n" + text;
  }
  spvtools::SpirvTools tools(kEnvironment);
  std::string message, text;
  tools.SetMessageConsumer(into(message));
  if (!tools.Disassemble(
          words, &text,
          SPV_BINARY_TO_TEXT_OPTION_FRIENDLY_NAMES | SPV_BINARY_TO_TEXT_OPTION_INDENT))
    return bad_input("", "cannot be disassembled: {}", message);
  return text;
}

Result<SpirvNeeds> spirv_needs(const Spirv& words, const std::string& where) {
  SpirvNeeds needs;
  // Bytes of types by id, of constants their value: enough to size the variables of a workgroup.
  std::map<uint32_t, uint64_t> sizes, constants, shared;
  uint64_t shared_bytes = 0;
  std::map<uint32_t, std::array<uint32_t, 2>> matrices;  // ids of rows and columns, by type
  std::map<uint32_t, uint32_t> loaded;                   // types of matrices
  for (size_t at = 5; at < words.size();) {
    const uint32_t opcode = words[at] & 0xffff, length = words[at] >> 16;
    if (length == 0 || at + length > words.size())
      return bad_input(where, "word {}: broken instruction", at);
    if (opcode == spv::OpCapability && length == 2) {
      switch (words[at + 1]) {
        case spv::CapabilityMatrix:
        case spv::CapabilityShader:
        case spv::CapabilitySampledBuffer:
        case spv::CapabilityImageBuffer:
        case spv::CapabilityImageQuery: break;
        case spv::CapabilityStorageImageExtendedFormats:
          needs.features.add(Feature::kStorageImageExtended);
          break;
        case spv::CapabilityInt8: needs.features.add(Feature::kInt8); break;
        case spv::CapabilityInt16: needs.features.add(Feature::kInt16); break;
        case spv::CapabilityInt64: needs.features.add(Feature::kInt64); break;
        case spv::CapabilityFloat64: needs.features.add(Feature::kFloat64); break;
        case spv::CapabilityFloat16: needs.features.add(Feature::kFloat16); break;
        case spv::CapabilityStorageBuffer8BitAccess:
          needs.features.add(Feature::kStorageBuffer8);
          break;
        case spv::CapabilityStorageBuffer16BitAccess:
          needs.features.add(Feature::kStorageBuffer16);
          break;
        case spv::CapabilityDotProduct:
        case spv::CapabilityDotProductInput4x8Bit:
        case spv::CapabilityDotProductInput4x8BitPacked:
          needs.features.add(Feature::kDotProduct8);
          break;
        case kCapabilityCooperativeMatrixKhr:
        case spv::CapabilityVulkanMemoryModel:  // which goes with it
          needs.features.add(Feature::kCooperativeMatrix);
          break;
        default:
          return unsupported(where, "the module asks for SPIR-V capability {}", words[at + 1]);
      }
    }
    if (opcode == spv::OpExecutionMode && length == 6 &&
        words[at + 2] == spv::ExecutionModeLocalSize)
      needs.workgroup_invocations = words[at + 3] * words[at + 4] * words[at + 5];
    const uint32_t* operand = words.data() + at;
    switch (opcode) {
      case spv::OpTypeInt:
      case spv::OpTypeFloat:
        if (length >= 3) sizes[operand[1]] = operand[2] / 8;
        break;
      case spv::OpTypeBool:
        if (length >= 2) sizes[operand[1]] = 4;
        break;
      case spv::OpTypeVector:
      case spv::OpTypeMatrix:
        if (length >= 4) sizes[operand[1]] = sizes[operand[2]] * operand[3];
        break;
      case spv::OpTypeArray:
        if (length >= 4) sizes[operand[1]] = sizes[operand[2]] * constants[operand[3]];
        break;
      case spv::OpTypeStruct:
        if (length >= 2)
          for (uint32_t member = 2; member < length; ++member)
            sizes[operand[1]] += sizes[operand[member]];
        break;
      case spv::OpConstant:
        if (length >= 4) constants[operand[2]] = operand[3];
        break;
      case spv::OpTypePointer:
        if (length >= 4 && operand[2] == spv::StorageClassWorkgroup)
          shared[operand[1]] = sizes[operand[3]];
        break;
      case spv::OpVariable:
        if (length >= 4 && operand[3] == spv::StorageClassWorkgroup)
          shared_bytes += shared[operand[1]];
        break;
      case kOpTypeCooperativeMatrixKhr:
        if (length >= 6) matrices[operand[1]] = {operand[4], operand[5]};
        break;
      case spv::OpLoad:
      case kOpCooperativeMatrixLoadKhr:
        if (length >= 3) loaded[operand[2]] = operand[1];
        break;
      case kOpCooperativeMatrixMulAddKhr: {
        if (length < 6) break;
        const auto result = matrices[operand[1]], a = matrices[loaded[operand[3]]];
        const auto size = [&](uint32_t id) { return static_cast<uint32_t>(constants[id]); };
        needs.matrix_products.push_back({size(result[0]), size(result[1]), size(a[1])});
        break;
      }
      default: break;
    }
    at += length;
  }
  std::sort(needs.matrix_products.begin(), needs.matrix_products.end());
  needs.matrix_products.erase(
      std::unique(needs.matrix_products.begin(), needs.matrix_products.end()),
      needs.matrix_products.end());
  needs.shared_bytes = static_cast<uint32_t>(std::min<uint64_t>(shared_bytes, UINT32_MAX));
  return needs;
}

}  // namespace shale
