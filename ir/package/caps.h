// ir/package/caps.h -- what a device can do, and what a package variant asks of it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace shale {

/// A bit per optional device feature that a kernel may use. The numbers are stored in packages.
enum class Feature : uint32_t {
  kStorageBuffer8 = 0,   ///< 8-bit values in storage buffers
  kStorageBuffer16 = 1,  ///< 16-bit values in storage buffers
  kInt8 = 2,             ///< shaderInt8
  kInt16 = 3,            ///< shaderInt16
  kInt64 = 4,            ///< shaderInt64
  kFloat16 = 5,          ///< shaderFloat16
  kDotProduct8 = 6,      ///< shaderIntegerDotProduct
  /// VK_KHR_cooperative_matrix with the products that DeviceCaps::matrix_products lists; and
  /// vulkanMemoryModel with its device scope, which modules with such products have to use
  kCooperativeMatrix = 7,
  kFloat64 = 8,  ///< shaderFloat64
  /// shaderStorageImageExtendedFormats: storage images of the formats that every device need not
  /// have
  kStorageImageExtended = 9,
};
inline constexpr uint32_t kFeatureCount = 10;

/// Feature as written in messages and by `shale doctor`: "shaderInt8".
const char* feature_name(Feature feature);

struct FeatureSet {
  uint32_t bits = 0;
  bool has(Feature f) const { return (bits >> static_cast<uint32_t>(f)) & 1u; }
  void add(Feature f) { bits |= 1u << static_cast<uint32_t>(f); }
  bool operator==(const FeatureSet&) const = default;
};

/// What kind of device a variant is for. The numbers are stored in packages.
enum class DeviceClass : uint8_t {
  kAny = 0,        ///< whatever meets the requirements
  kCpu = 1,        ///< a driver that runs shaders on the CPU, one with AVX-512
  kDot8Gpu = 2,    ///< a GPU with int8 dot products
  kMatrixGpu = 3,  ///< a GPU with int8 cooperative matrices
  kCpuAvx2 = 4,    ///< as kCpu, with AVX2: 16 vector registers of 256 bits
  kCpuSse = 5,     ///< as kCpu, an x86 processor with less
  kCpuNeon = 6,    ///< as kCpu, an ARM processor: 32 vector registers of 128 bits
};
inline constexpr uint32_t kDeviceClassCount = 7;

/// As `shale dump` writes it: "dot8-gpu".
const char* device_class_name(DeviceClass device_class);

/// What vectors a CPU driver compiles shaders for.
enum class Processor : uint8_t { kUnknown, kSse, kAvx2, kAvx512, kNeon };
inline constexpr uint32_t kProcessorCount = 5;
/// As `shale doctor` writes it: "avx2".
const char* processor_name(Processor processor);

/// A product that a subgroup computes: m x k int8 times k x n int8, added to m x n int32.
struct MatrixProduct {
  uint32_t m = 0, n = 0, k = 0;
  auto operator<=>(const MatrixProduct&) const = default;
};
/// "16x16x32", in the order m, n, k.
std::string matrix_product_text(const MatrixProduct& product);

/// Snapshot of a device, taken by runtime/vk or written down in compiler/target; no handles.
struct DeviceCaps {
  std::string name;                           ///< VkPhysicalDeviceProperties::deviceName
  std::string driver;                         ///< driver name and version, for humans
  uint32_t api_version = 0;                   ///< VK_MAKE_API_VERSION form
  bool cpu = false;                           ///< VK_PHYSICAL_DEVICE_TYPE_CPU
  Processor processor = Processor::kUnknown;  ///< of a device with `cpu`
  FeatureSet features;
  uint32_t max_workgroup_invocations = 0;
  uint32_t max_workgroup_size[3] = {0, 0, 0};
  uint32_t max_workgroup_count[3] = {0, 0, 0};
  uint32_t max_shared_bytes = 0;
  uint64_t max_storage_range_bytes = 0;
  uint64_t max_texel_elements = 0;
  uint32_t max_storage_buffers = 0;  ///< per stage
  uint32_t max_texel_buffers = 0;    ///< sampled images per stage; texel buffers and images with
                                     ///< samplers count there
  uint32_t max_storage_images = 0;   ///< per stage
  uint32_t subgroup_size = 0;
  /// Signed, not saturating, of subgroups; ascending. Empty without kCooperativeMatrix.
  std::vector<MatrixProduct> matrix_products = {};
  bool operator==(const DeviceCaps&) const = default;
};

/// What a variant needs. Filled from the SPIR-V words and the dispatches, never by hand.
struct Requirements {
  FeatureSet features;
  uint32_t workgroup_invocations = 1;
  uint32_t shared_bytes = 0;
  uint64_t storage_range_bytes = 0;  ///< largest buffer binding
  uint64_t texel_elements = 0;       ///< largest texel buffer binding
  uint32_t storage_buffers = 0;      ///< most in one dispatch
  uint32_t texel_buffers = 0;        ///< most in one dispatch, all sampled images included
  uint32_t storage_images = 0;       ///< most in one dispatch
  uint32_t subgroup_size = 0;        ///< of modules with matrix products; 0 is any
  std::vector<MatrixProduct> matrix_products = {};  ///< those of the modules, ascending
  bool operator==(const Requirements&) const = default;
};

/// One line per thing that is missing ("shaderInt8 is not supported"); empty if the device will do.
std::vector<std::string> missing(const DeviceCaps& caps, const Requirements& requirements);
inline bool meets(const DeviceCaps& caps, const Requirements& requirements) {
  return missing(caps, requirements).empty();
}

}  // namespace shale
