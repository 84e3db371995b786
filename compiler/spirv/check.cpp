#include "compiler/spirv/check.h"

#include <spirv-tools/libspirv.hpp>
#include <spirv-tools/optimizer.hpp>
#include <spirv/unified1/spirv.hpp>

namespace shale {
namespace {

constexpr spv_target_env kEnvironment = SPV_ENV_VULKAN_1_3;

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

Result<void> validate_spirv(const Spirv& words, const std::string& where) {
  spvtools::SpirvTools tools(kEnvironment);
  std::string message;
  tools.SetMessageConsumer(into(message));
  if (!tools.Validate(words)) return bad_input(where, "the module is not valid: {}", message);
  return {};
}

Result<std::string> disassemble_spirv(const Spirv& words) {
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
        case spv::CapabilityImageQuery:
        case spv::CapabilityStorageImageExtendedFormats: break;
        case spv::CapabilityInt8: needs.features.add(Feature::kInt8); break;
        case spv::CapabilityInt16: needs.features.add(Feature::kInt16); break;
        case spv::CapabilityInt64: needs.features.add(Feature::kInt64); break;
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
        default:
          return unsupported(where, "the module asks for SPIR-V capability {}", words[at + 1]);
      }
    }
    if (opcode == spv::OpExecutionMode && length == 6 &&
        words[at + 2] == spv::ExecutionModeLocalSize)
      needs.workgroup_invocations = words[at + 3] * words[at + 4] * words[at + 5];
    at += length;
  }
  return needs;
}

}  // namespace shale
