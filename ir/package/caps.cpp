#include "ir/package/caps.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

namespace shale {
namespace {

constexpr std::array<const char*, kFeatureCount> kFeatureNames{
    "storageBuffer8BitAccess",
    "storageBuffer16BitAccess",
    "shaderInt8",
    "shaderInt16",
    "shaderInt64",
    "shaderFloat16",
    "shaderIntegerDotProduct",
    "cooperativeMatrix",
    "shaderFloat64",
    "shaderStorageImageExtendedFormats",
};

constexpr std::array<const char*, kDeviceClassCount> kDeviceClassNames{
    "any", "cpu", "dot8-gpu", "matrix-gpu", "cpu-avx2", "cpu-sse", "cpu-neon"};

constexpr std::array<const char*, kProcessorCount> kProcessorNames{"unknown", "sse", "avx2",
                                                                   "avx512", "neon"};

}  // namespace

const char* feature_name(Feature feature) { return kFeatureNames[static_cast<uint32_t>(feature)]; }

const char* device_class_name(DeviceClass device_class) {
  return kDeviceClassNames[static_cast<uint32_t>(device_class)];
}

const char* processor_name(Processor processor) {
  return kProcessorNames[static_cast<uint32_t>(processor)];
}

std::string matrix_product_text(const MatrixProduct& product) {
  return fmt::format("{}x{}x{}", product.m, product.n, product.k);
}

std::vector<std::string> missing(const DeviceCaps& caps, const Requirements& requirements) {
  std::vector<std::string> lines;
  for (uint32_t i = 0; i < kFeatureCount; ++i) {
    const auto feature = static_cast<Feature>(i);
    if (requirements.features.has(feature) && !caps.features.has(feature))
      lines.push_back(fmt::format("{} is not supported", feature_name(feature)));
  }
  const auto at_least = [&](const char* what, uint64_t found, uint64_t needed) {
    if (found < needed) lines.push_back(fmt::format("{} is {}, needs {}", what, found, needed));
  };
  at_least("maxComputeWorkGroupInvocations", caps.max_workgroup_invocations,
           requirements.workgroup_invocations);
  at_least("maxComputeSharedMemorySize", caps.max_shared_bytes, requirements.shared_bytes);
  at_least("maxStorageBufferRange", caps.max_storage_range_bytes, requirements.storage_range_bytes);
  at_least("maxTexelBufferElements", caps.max_texel_elements, requirements.texel_elements);
  at_least("maxPerStageDescriptorStorageBuffers", caps.max_storage_buffers,
           requirements.storage_buffers);
  at_least("maxPerStageDescriptorSampledImages", caps.max_texel_buffers,
           requirements.texel_buffers);
  at_least("maxPerStageDescriptorStorageImages", caps.max_storage_images,
           requirements.storage_images);
  if (requirements.subgroup_size != 0 && caps.subgroup_size != requirements.subgroup_size)
    lines.push_back(fmt::format("subgroupSize is {}, needs {}", caps.subgroup_size,
                                requirements.subgroup_size));
  for (const MatrixProduct& product : requirements.matrix_products)
    if (std::find(caps.matrix_products.begin(), caps.matrix_products.end(), product) ==
        caps.matrix_products.end())
      lines.push_back(fmt::format("cooperative matrices of {} int8 are not supported",
                                  matrix_product_text(product)));
  return lines;
}

}  // namespace shale
