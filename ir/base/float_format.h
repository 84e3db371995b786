// ir/base/float_format.h -- floating-point types by the widths of their fields: rounding a double to one, and back.
// Source: IEEE 754; OCP 8-bit Floating Point Specification 1.0 (E4M3 has no infinity, and one code for NaN).
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>

#include "ir/base/dtype.h"

namespace shale {

/// A sign, an exponent, a fraction. Constants are powers of 2 and what is made from them, exact in a double.
struct FloatFormat {
  int exponent_bits;
  int fraction_bits;
  bool has_infinity;  ///< else the code of all ones is the NaN, and all others are numbers

  constexpr int bias() const { return (1 << (exponent_bits - 1)) - 1; }
  /// Exponent of the smallest normal number.
  constexpr int lowest() const { return 1 - bias(); }
  constexpr uint32_t sign() const { return uint32_t{1} << (exponent_bits + fraction_bits); }
  /// Code of infinity; without one, the NaN.
  constexpr uint32_t top() const {
    return has_infinity ? ((1u << exponent_bits) - 1) << fraction_bits : sign() - 1;
  }
  /// 2^exponent, for exponents of a normal double.
  static constexpr double power(int exponent) {
    return std::bit_cast<double>(static_cast<uint64_t>(exponent + 1023) << 52);
  }
  constexpr double smallest_normal() const { return power(lowest()); }
  constexpr double largest() const {
    return has_infinity ? (2 - power(-fraction_bits)) * power(bias())
                        : (2 - power(1 - fraction_bits)) * power(bias() + 1);
  }
};

/// `dtype` is a floating-point type.
constexpr FloatFormat float_format(DType dtype) {
  switch (dtype) {
    case DType::kFp16: return {5, 10, true};
    case DType::kBf16: return {8, 7, true};
    case DType::kFp8E4M3: return {4, 3, false};
    case DType::kFp8E5M2: return {5, 2, true};
    default: return {8, 23, true};
  }
}

/// To nearest, ties to even. What is too large becomes infinity, or a NaN where there is none; a NaN becomes a quiet one.
constexpr uint32_t encode_float(FloatFormat format, double value) {
  const uint64_t bits = std::bit_cast<uint64_t>(value), magnitude = bits << 1 >> 1;
  const uint32_t sign = bits >> 63 != 0 ? format.sign() : 0;
  if (value != value)
    return sign | format.top() | (format.has_infinity ? 1u << (format.fraction_bits - 1) : 0);
  const int exponent = static_cast<int>(magnitude >> 52) - 1023;
  if (exponent < format.lowest() - format.fraction_bits - 1) return sign;
  const uint64_t significand = (magnitude & ((uint64_t{1} << 52) - 1)) | uint64_t{1} << 52;
  const int dropped = 52 - format.fraction_bits + std::max(format.lowest() - exponent, 0);
  const uint64_t half = uint64_t{1} << (dropped - 1);
  const uint64_t kept = (significand + half - 1 + (significand >> dropped & 1)) >> dropped;
  // The leading one of a normal number adds 1 to the exponent, as does a carry.
  const uint64_t below = static_cast<uint64_t>(std::max(exponent - format.lowest(), 0));
  return sign | static_cast<uint32_t>(
                    std::min<uint64_t>((below << format.fraction_bits) + kept, format.top()));
}

/// Exact; a NaN stays one.
constexpr double decode_float(FloatFormat format, uint32_t bits) {
  const uint32_t magnitude = bits & (format.sign() - 1);
  const uint32_t exponent = magnitude >> format.fraction_bits;
  const uint64_t fraction = magnitude & ((1u << format.fraction_bits) - 1);
  double value = 0;
  if (format.has_infinity ? magnitude >= format.top() : magnitude == format.top()) {
    const bool is_nan = !format.has_infinity || fraction != 0;
    value = std::bit_cast<double>(uint64_t{0x7ff} << 52 | (is_nan ? uint64_t{1} << 51 : 0));
  } else if (exponent == 0) {
    value =
        static_cast<double>(fraction) * FloatFormat::power(format.lowest() - format.fraction_bits);
  } else {
    value = std::bit_cast<double>(
        static_cast<uint64_t>(static_cast<int>(exponent) - format.bias() + 1023) << 52 |
        fraction << (52 - format.fraction_bits));
  }
  return (bits & format.sign()) != 0 ? -value : value;
}

}  // namespace shale
