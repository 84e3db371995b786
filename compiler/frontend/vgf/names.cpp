// Numbers of Vulkan and of the format, for people and for sizes.
#include "compiler/frontend/vgf/formats.h"
#include "compiler/frontend/vgf/vgf.h"

namespace shale {
namespace {

/// Formats that follow each other and have texels of one size.
struct FormatRun {
  uint32_t first, last, bytes;
};

// Source: Vulkan 1.3, the uncompressed formats in the order of VkFormat; VK_ARM_tensors.
constexpr FormatRun kFormatRuns[] = {{1, 1, 1},
                                     {2, 8, 2},
                                     {9, 15, 1},
                                     {16, 22, 2},
                                     {23, 36, 3},
                                     {37, 69, 4},
                                     {70, 76, 2},
                                     {77, 83, 4},
                                     {84, 90, 6},
                                     {91, 97, 8},
                                     {98, 100, 4},
                                     {101, 103, 8},
                                     {104, 106, 12},
                                     {107, 109, 16},
                                     {110, 112, 8},
                                     {113, 115, 16},
                                     {116, 118, 24},
                                     {119, 121, 32},
                                     {122, 123, 4},
                                     {1000460000, 1000460000, 1},
                                     {1000460001, 1000460001, 2},
                                     {1000460002, 1000460003, 1}};

struct ElementFormat {
  uint32_t format;
  DType dtype;
};

/// The first of a type is the one that is written.
constexpr ElementFormat kElementFormats[] = {{14, DType::kInt8},
                                             {13, DType::kInt8},
                                             {75, DType::kInt16},
                                             {74, DType::kInt16},
                                             {99, DType::kInt32},
                                             {98, DType::kInt32},
                                             {111, DType::kInt48},
                                             {110, DType::kInt48},
                                             {76, DType::kFp16},
                                             {100, DType::kFp32},
                                             {1000460000, DType::kBool},
                                             {1000460001, DType::kBf16},
                                             {1000460002, DType::kFp8E4M3},
                                             {1000460003, DType::kFp8E5M2}};

struct Named {
  uint32_t number;
  const char* name;
};

constexpr Named kFormatNames[] = {{13, "R8_UINT"},
                                  {14, "R8_SINT"},
                                  {37, "R8G8B8A8_UNORM"},
                                  {42, "R8G8B8A8_SINT"},
                                  {74, "R16_UINT"},
                                  {75, "R16_SINT"},
                                  {76, "R16_SFLOAT"},
                                  {97, "R16G16B16A16_SFLOAT"},
                                  {98, "R32_UINT"},
                                  {99, "R32_SINT"},
                                  {100, "R32_SFLOAT"},
                                  {107, "R32G32B32A32_UINT"},
                                  {109, "R32G32B32A32_SFLOAT"},
                                  {110, "R64_UINT"},
                                  {111, "R64_SINT"},
                                  {1000460000, "R8_BOOL_ARM"},
                                  {1000460001, "R16_SFLOAT_FPENCODING_BFLOAT16_ARM"},
                                  {1000460002, "R8_SFLOAT_FPENCODING_FLOAT8E4M3_ARM"},
                                  {1000460003, "R8_SFLOAT_FPENCODING_FLOAT8E5M2_ARM"}};

constexpr Named kDescriptorNames[] = {
    {0, "SAMPLER"},        {1, "COMBINED_IMAGE_SAMPLER"}, {2, "SAMPLED_IMAGE"},
    {3, "STORAGE_IMAGE"},  {4, "UNIFORM_TEXEL_BUFFER"},   {5, "STORAGE_TEXEL_BUFFER"},
    {6, "UNIFORM_BUFFER"}, {7, "STORAGE_BUFFER"},         {1000460000, "TENSOR_ARM"},
    {kVgfNone, "none"}};

std::string name_of(std::span<const Named> table, uint32_t number) {
  for (const Named& row : table)
    if (row.number == number) return row.name;
  return std::to_string(number);
}

}  // namespace

uint32_t vk_format_bytes(uint32_t format) {
  for (const FormatRun& run : kFormatRuns)
    if (format >= run.first && format <= run.last) return run.bytes;
  return 0;
}

uint32_t vk_format_of_dtype(DType dtype) {
  if (dtype == DType::kInt4) dtype = DType::kInt8;  // one byte each in host memory
  for (const ElementFormat& row : kElementFormats)
    if (row.dtype == dtype) return row.format;
  return 0;
}

DType dtype_of_vk_format(uint32_t format) {
  for (const ElementFormat& row : kElementFormats)
    if (row.format == format) return row.dtype;
  return DType::kUnknown;
}

std::string vk_format_name(uint32_t format) { return name_of(kFormatNames, format); }
std::string vk_descriptor_name(uint32_t type) { return name_of(kDescriptorNames, type); }

const char* vgf_name(VgfModuleType type) {
  return type == VgfModuleType::kGraph ? "GRAPH" : "COMPUTE";
}

const char* vgf_name(VgfCode code) {
  constexpr const char* kNames[] = {"NONE", "SPIRV", "GLSL", "HLSL"};
  return kNames[static_cast<size_t>(code)];
}

const char* vgf_name(VgfCategory category) {
  constexpr const char* kNames[] = {"INPUT", "OUTPUT", "INTERMEDIATE", "CONSTANT"};
  return kNames[static_cast<size_t>(category)];
}

}  // namespace shale
