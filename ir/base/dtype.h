// ir/base/dtype.h -- element types of tensors, numbered as TOSA 1.0 stores them.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string_view>

namespace shale {

/// Source: TOSA 1.0, DType. The values are the numbers on the wire.
enum class DType : uint32_t {
  kUnknown = 0,
  kBool = 1,
  kInt4 = 2,
  kInt8 = 3,
  kInt16 = 4,
  kInt32 = 5,
  kInt48 = 6,
  kFp32 = 7,
  kFp16 = 8,
  kBf16 = 9,
  kShape = 10,
  kFp8E4M3 = 11,
  kFp8E5M2 = 12,
};

struct DTypeInfo {
  DType dtype;
  std::string_view name;  ///< in text form: "i8"
  std::string_view wire;  ///< in desc.json and messages: "INT8"
  uint32_t bits;          ///< width of the value
  uint32_t host_bytes;    ///< bytes of an element in host tensors, npy files and device buffers
};

inline constexpr std::array<DTypeInfo, 13> kDTypes{{
    {DType::kUnknown, "unknown", "UNKNOWN", 0, 0},
    {DType::kBool, "bool", "BOOL", 1, 1},
    {DType::kInt4, "i4", "INT4", 4, 1},
    {DType::kInt8, "i8", "INT8", 8, 1},
    {DType::kInt16, "i16", "INT16", 16, 2},
    {DType::kInt32, "i32", "INT32", 32, 4},
    {DType::kInt48, "i48", "INT48", 48, 8},
    {DType::kFp32, "f32", "FP32", 32, 4},
    {DType::kFp16, "f16", "FP16", 16, 2},
    {DType::kBf16, "bf16", "BF16", 16, 2},
    {DType::kShape, "shape", "SHAPE", 64, 8},
    {DType::kFp8E4M3, "f8e4m3", "FP8E4M3", 8, 1},
    {DType::kFp8E5M2, "f8e5m2", "FP8E5M2", 8, 1},
}};

/// `dtype` must be one of the enumerators (is_dtype checks a number from a file).
inline constexpr const DTypeInfo& dtype_info(DType dtype) {
  return kDTypes[static_cast<uint32_t>(dtype)];
}

inline constexpr bool is_dtype(uint32_t number) { return number < kDTypes.size(); }

inline std::optional<DType> dtype_from_name(std::string_view name) {
  for (const DTypeInfo& info : kDTypes)
    if (info.name == name || info.wire == name) return info.dtype;
  return std::nullopt;
}

inline constexpr bool is_integer(DType dtype) {
  return dtype == DType::kInt4 || dtype == DType::kInt8 || dtype == DType::kInt16 ||
         dtype == DType::kInt32 || dtype == DType::kInt48;
}

inline constexpr bool is_float8(DType dtype) {
  return dtype == DType::kFp8E4M3 || dtype == DType::kFp8E5M2;
}

inline constexpr bool is_float(DType dtype) {
  return dtype == DType::kFp32 || dtype == DType::kFp16 || dtype == DType::kBf16 ||
         is_float8(dtype);
}

/// Smallest and largest value of an integer or boolean type. INT4 is -7..7, as TOSA 1.0 has it.
struct IntRange {
  int64_t min = 0;
  int64_t max = 0;
  bool operator==(const IntRange&) const = default;
};

inline constexpr IntRange dtype_range(DType dtype) {
  if (dtype == DType::kBool) return {0, 1};
  if (dtype == DType::kInt4) return {-7, 7};
  if (dtype == DType::kShape)
    return {std::numeric_limits<int64_t>::min(), std::numeric_limits<int64_t>::max()};
  const int64_t half = int64_t{1} << (dtype_info(dtype).bits - 1);
  return {-half, half - 1};
}

}  // namespace shale
