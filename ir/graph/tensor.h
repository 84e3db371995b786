// ir/graph/tensor.h -- types of values, and tensors with data in host memory.
#pragma once

#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "ir/base/dtype.h"
#include "ir/base/result.h"

namespace shale {

/// Dimensions, outermost first; kDynamic where a file leaves a size open. Rank 0 is empty.
using Shape = std::vector<int64_t>;
inline constexpr int64_t kDynamic = -1;

/// Source: TOSA 1.0, level 8K.
inline constexpr int64_t kMaxRank = 6;
inline constexpr int64_t kMaxElements = (int64_t{1} << 31) - 1;

struct TensorType {
  DType dtype = DType::kUnknown;
  Shape shape;
  bool operator==(const TensorType&) const = default;
};

/// Product of the dimensions (1 for rank 0), or nothing if a dimension is below 1 or the product is
/// above kMaxElements.
inline std::optional<int64_t> element_count(const Shape& shape) {
  int64_t count = 1;
  for (const int64_t dim : shape) {
    if (dim < 1 || dim > kMaxElements / count) return std::nullopt;
    count *= dim;
  }
  return count;
}

/// "1x540x960x3"-like text for messages and the text form: "[1,540,960,3]"; kDynamic prints as "?".
std::string shape_text(const Shape& shape);
/// "i8[1,540,960,3]".
std::string type_text(const TensorType& type);

/// Data of one tensor, row-major, an element in dtype_info(dtype).host_bytes bytes, little-endian:
/// BOOL, INT4, INT8 and the FP8 types one byte, INT16, FP16 and BF16 two, INT32 and FP32 four, INT48
/// eight (sign extended), SHAPE eight.
struct Tensor {
  TensorType type;
  std::vector<uint8_t> bytes;

  /// Zeroes. The shape must have an element_count.
  static Tensor zeros(TensorType type);
  static Tensor from_ints(TensorType type, std::span<const int64_t> values);

  int64_t count() const { return static_cast<int64_t>(bytes.size()) / host_bytes(); }
  int64_t host_bytes() const { return dtype_info(type.dtype).host_bytes; }
  int64_t get(int64_t index) const;
  void set(int64_t index, int64_t value);  ///< keeps the low bits
  std::vector<int64_t> ints() const;
  /// An element of a floating-point type, whose get() is the bits; set_real rounds to nearest even, once.
  float real(int64_t index) const;
  void set_real(int64_t index, double value);
  static Tensor from_reals(TensorType type, std::span<const float> values);
  std::vector<float> reals() const;

  template <typename T>
  const T* data() const {
    return reinterpret_cast<const T*>(bytes.data());
  }
  template <typename T>
  T* data() {
    return reinterpret_cast<T*>(bytes.data());
  }

  bool operator==(const Tensor&) const = default;
};

/// What get() gives for a float of this type, and back: how attributes hold floats.
int64_t real_bits(DType dtype, double value);
float bits_real(DType dtype, int64_t bits);
/// The same for bits that are known already.
int64_t element_bits(DType dtype, uint32_t bits);

/// TOSA's encoding of constants: INT4 two an octet, INT48 six bytes, the rest as in Tensor.
/// Errors: kBadInput if `wire` is shorter than the type needs, or holds an INT4 of -8 or a BOOL
/// that is neither 0 nor 1. Bytes beyond the need are ignored.
Result<Tensor> decode_constant(const TensorType& type, std::span<const uint8_t> wire);
std::vector<uint8_t> encode_constant(const Tensor& tensor);

}  // namespace shale
