// tests/compiler/spirv_text.h -- SPIR-V graph modules as text, with tables of their own, so that
// reader and writer are tested against another hand's numbers.
#pragma once

#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <sstream>
#include <string>
#include <vector>

namespace shale {

/// Operands behind type and result: i an id, n a literal number, s a string, e an enumerant or a
/// number; the last one repeats after '*'.
struct SpirvSyntax {
  uint32_t number;
  bool has_type, has_result;
  std::string operands;
};

inline const std::map<std::string, SpirvSyntax>& spirv_syntax() {
  static const std::map<std::string, SpirvSyntax> table{
      {"OpUndef", {1, true, true, ""}},
      {"OpSource", {3, false, false, "nn"}},
      {"OpName", {5, false, false, "is"}},
      {"OpString", {7, false, true, "s"}},
      {"OpLine", {8, false, false, "inn"}},
      {"OpExtension", {10, false, false, "s"}},
      {"OpExtInstImport", {11, false, true, "s"}},
      {"OpExtInst", {12, true, true, "ie*i"}},
      {"OpMemoryModel", {14, false, false, "ee"}},
      {"OpEntryPoint", {15, false, false, "nis*i"}},
      {"OpCapability", {17, false, false, "e"}},
      {"OpTypeVoid", {19, false, true, ""}},
      {"OpTypeBool", {20, false, true, ""}},
      {"OpTypeInt", {21, false, true, "nn"}},
      {"OpTypeFloat", {22, false, true, "n*n"}},
      {"OpTypeArray", {28, false, true, "ii"}},
      {"OpTypeRuntimeArray", {29, false, true, "i"}},
      {"OpTypeStruct", {30, false, true, "*i"}},
      {"OpTypePointer", {32, false, true, "ei"}},
      {"OpConstantTrue", {41, true, true, ""}},
      {"OpConstantFalse", {42, true, true, ""}},
      {"OpConstant", {43, true, true, "*n"}},
      {"OpConstantComposite", {44, true, true, "*i"}},
      {"OpConstantNull", {46, true, true, ""}},
      {"OpSpecConstantTrue", {48, true, true, ""}},
      {"OpSpecConstantFalse", {49, true, true, ""}},
      {"OpSpecConstant", {50, true, true, "*n"}},
      {"OpSpecConstantComposite", {51, true, true, "*i"}},
      {"OpVariable", {59, true, true, "e"}},
      {"OpDecorate", {71, false, false, "ie*n"}},
      {"OpCompositeExtract", {81, true, true, "i*n"}},
      {"OpTypeTensorARM", {4163, false, true, "*i"}},
      {"OpGraphConstantARM", {4181, true, true, "n"}},
      {"OpGraphEntryPointARM", {4182, false, false, "is*i"}},
      {"OpGraphARM", {4183, true, true, ""}},
      {"OpGraphInputARM", {4184, true, true, "*i"}},
      {"OpGraphSetOutputARM", {4185, false, false, "*i"}},
      {"OpGraphEndARM", {4186, false, false, ""}},
      {"OpTypeGraphARM", {4190, false, true, "n*i"}},
      {"OpExecutionMode", {16, false, false, "in*n"}},
      {"OpTypeVector", {23, false, true, "in"}},
      {"OpTypeFunction", {33, false, true, "*i"}},
      {"OpFunction", {54, true, true, "ni"}},
      {"OpFunctionEnd", {56, false, false, ""}},
      {"OpLoad", {61, true, true, "i"}},
      {"OpStore", {62, false, false, "ii"}},
      {"OpAccessChain", {65, true, true, "*i"}},
      {"OpCompositeConstruct", {80, true, true, "*i"}},
      {"OpUConvert", {113, true, true, "i"}},
      {"OpSConvert", {114, true, true, "i"}},
      {"OpIAdd", {128, true, true, "ii"}},
      {"OpUDiv", {134, true, true, "ii"}},
      {"OpUMod", {137, true, true, "ii"}},
      {"OpLabel", {248, false, true, ""}},
      {"OpReturn", {253, false, false, ""}},
      {"OpTensorReadARM", {4164, true, true, "ii*i"}},
      {"OpTensorWriteARM", {4165, false, false, "ii*i"}},
      {"OpTensorQuerySizeARM", {4166, true, true, "ii"}},
      {"OpConstantCompositeReplicateEXT", {4461, true, true, "i"}},
      {"OpSpecConstantCompositeReplicateEXT", {4462, true, true, "i"}},
  };
  return table;
}

inline const std::map<std::string, uint32_t>& spirv_enumerants() {
  static const std::map<std::string, uint32_t> table{
      {"Shader", 1},
      {"Float16", 9},
      {"Int64", 11},
      {"Int16", 22},
      {"Int8", 39},
      {"TensorsARM", 4174},
      {"GraphARM", 4191},
      {"Logical", 0},
      {"Vulkan", 3},
      {"UniformConstant", 0},
      {"StorageBuffer", 12},
      {"Binding", 33},
      {"DescriptorSet", 34},
      {"VulkanMemoryModel", 5345},
      {"ReplicatedCompositesEXT", 6024},
      {"ARGMAX", 0},
      {"AVG_POOL2D", 1},
      {"CONV2D", 2},
      {"TRANSPOSE_CONV2D", 9},
      {"CLAMP", 10},
      {"TANH", 13},
      {"ADD", 14},
      {"ARITHMETIC_RIGHT_SHIFT", 15},
      {"BITWISE_XOR", 18},
      {"TABLE", 30},
      {"ABS", 31},
      {"BITWISE_NOT", 32},
      {"LOGICAL_NOT", 39},
      {"CONCAT", 54},
      {"PAD", 55},
      {"RESHAPE", 56},
      {"SLICE", 58},
      {"TRANSPOSE", 60},
      {"RESIZE", 63},
      {"CAST", 64},
      {"RESCALE", 65},
  };
  return table;
}

/// Lines such as `%t = OpTypeInt 8 0`, ids by name; `;` starts a comment. Ids count from 1 in the
/// order of their first appearance.
inline std::vector<uint32_t> assemble_spirv(const std::string& text) {
  std::vector<uint32_t> words{0x07230203, 0x00010500, 0, 0, 0};
  std::map<std::string, uint32_t> ids;
  const auto id = [&](const std::string& token) {
    EXPECT_EQ(token[0], '%') << token;
    return ids.emplace(token, static_cast<uint32_t>(ids.size() + 1)).first->second;
  };
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream stream(line.substr(0, line.find(';')));
    std::vector<std::string> tokens;
    for (std::string token; stream >> token;) {
      if (token[0] == '"' && (token.size() == 1 || token.back() != '"')) {
        std::string rest;
        std::getline(stream, rest, '"');
        token += rest + '"';
      }
      tokens.push_back(token);
    }
    if (tokens.empty()) continue;
    uint32_t result = 0;
    if (tokens.size() > 1 && tokens[1] == "=") {
      result = id(tokens[0]);
      tokens.erase(tokens.begin(), tokens.begin() + 2);
    }
    const auto found = spirv_syntax().find(tokens[0]);
    if (found == spirv_syntax().end()) {
      ADD_FAILURE() << "unknown " << line;
      return words;
    }
    const SpirvSyntax& syntax = found->second;
    size_t next = 1;
    const size_t start = words.size();
    words.push_back(0);
    if (syntax.has_type) words.push_back(id(tokens[next++]));
    if (syntax.has_result) words.push_back(result);
    for (size_t kind = 0; next < tokens.size(); ++next) {
      if (kind < syntax.operands.size() && syntax.operands[kind] == '*') ++kind;
      const std::string& token = tokens[next];
      const auto enumerant = spirv_enumerants().find(token);
      if (token[0] == '"') {
        const std::string string = token.substr(1, token.size() - 2);
        const size_t at = words.size();
        words.resize(at + string.size() / 4 + 1);
        std::memcpy(words.data() + at, string.data(), string.size());
      } else if (token[0] == '%') {
        words.push_back(id(token));
      } else if (enumerant != spirv_enumerants().end()) {
        words.push_back(enumerant->second);
      } else {
        words.push_back(static_cast<uint32_t>(std::stoll(token)));
      }
      if (kind + 1 < syntax.operands.size()) ++kind;
    }
    words[start] = static_cast<uint32_t>(words.size() - start) << 16 | syntax.number;
  }
  words[3] = static_cast<uint32_t>(ids.size() + 1);
  return words;
}

/// The instructions of a well-formed module, a line each, with ids as numbers.
inline std::string spirv_text(const std::vector<uint32_t>& words) {
  std::string text;
  for (size_t at = 5; at < words.size(); at += words[at] >> 16) {
    const size_t end = at + (words[at] >> 16);
    const SpirvSyntax* syntax = nullptr;
    std::string name;
    for (const auto& [candidate, row] : spirv_syntax())
      if (row.number == (words[at] & 0xffff)) name = candidate, syntax = &row;
    if (!syntax || end <= at || end > words.size()) return text + "broken\n";
    size_t next = at + 1;
    const uint32_t type = syntax->has_type ? words[next++] : 0;
    if (syntax->has_result) text += "%" + std::to_string(words[next++]) + " = ";
    text += name;
    if (syntax->has_type) text += " %" + std::to_string(type);
    for (size_t kind = 0; next < end;) {
      if (kind < syntax->operands.size() && syntax->operands[kind] == '*') ++kind;
      const char operand = kind < syntax->operands.size() ? syntax->operands[kind] : '!';
      if (operand == 's') {
        const size_t length =
            strnlen(reinterpret_cast<const char*>(&words[next]), (end - next) * 4);
        text += " \"" + std::string(reinterpret_cast<const char*>(&words[next]), length) + "\"";
        next += length / 4 + 1;
      } else {
        text += operand == 'i' ? " %" : " ";
        text += std::to_string(words[next++]);
      }
      if (kind + 1 < syntax->operands.size()) ++kind;
    }
    text += '\n';
  }
  return text;
}

}  // namespace shale
