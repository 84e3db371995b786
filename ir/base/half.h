// ir/base/half.h -- conversion between float and the 16 bits of IEEE 754 binary16, exact on every machine.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>

namespace shale {

inline constexpr float kHalfMax = 65504.0f;

/// Exact; a NaN stays a NaN.
inline constexpr float half_to_float(uint16_t half) {
  const uint32_t sign = (half & 0x8000u) << 16, magnitude = half & 0x7fffu;
  if (magnitude < 0x0400u) {  // zero or subnormal: a multiple of 2^-24
    const float value = static_cast<float>(magnitude) * 0x1p-24f;
    return sign != 0 ? -value : value;
  }
  const uint32_t bits = magnitude >= 0x7c00u ? 0x7f800000u | (magnitude & 0x3ffu) << 13
                                             : (magnitude << 13) + 0x38000000u;
  return std::bit_cast<float>(sign | bits);
}

/// To nearest, ties to even; from 65520 on infinity. A NaN becomes a quiet NaN.
inline constexpr uint16_t float_to_half(float value) {
  const uint32_t bits = std::bit_cast<uint32_t>(value), magnitude = bits & 0x7fffffffu;
  const uint32_t sign = bits >> 16 & 0x8000u;
  uint32_t half = 0;
  if (magnitude > 0x7f800000u) {
    half = 0x7e00u;
  } else if (magnitude >= 0x47800000u) {  // 2^16
    half = 0x7c00u;
  } else if (magnitude >= 0x38800000u) {  // 2^-14: a carry runs on into the exponent
    half = (magnitude - 0x38000000u + 0xfffu + (magnitude >> 13 & 1u)) >> 13;
  } else {  // multiples of 2^-24
    const uint32_t shift = std::min(126u - (magnitude >> 23), 25u);
    const uint32_t mantissa = (magnitude & 0x7fffffu) | 0x800000u;
    half = (mantissa + (1u << (shift - 1)) - 1u + (mantissa >> shift & 1u)) >> shift;
  }
  return static_cast<uint16_t>(sign | half);
}

}  // namespace shale
