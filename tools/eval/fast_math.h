// tools/eval/fast_math.h -- powers in loops that the compiler turns into vector code.
#pragma once

#include <bit>
#include <cstdint>

namespace shale {

/// log2(x) of a positive, normal x; absolute error below 2e-7 plus rounding.
/// The mantissa m is brought to [sqrt(1/2), sqrt(2)); then ln m = 2 artanh((m - 1) / (m + 1)), and
/// four terms of the odd series leave s^11 * 2 / 11 < 1e-9.
inline float fast_log2(float x) {
  const int32_t bits = std::bit_cast<int32_t>(x);
  const int32_t exponent = (bits - 0x3f3504f3) >> 23;
  const float m = std::bit_cast<float>(bits - (exponent << 23));
  const float s = (m - 1) / (m + 1), q = s * s;
  const float series = 1 + q * (1 / 3.0f + q * (1 / 5.0f + q * (1 / 7.0f + q * (1 / 9.0f))));
  return static_cast<float>(exponent) + 2.8853900817779268f * s * series;
}

/// 2^x for x in [-126, 127]; relative error below 3e-7. The fraction in [-1/2, 1/2] goes through
/// seven terms of the exponential's series.
inline float fast_exp2(float x) {
  constexpr float kRound = 12582912.0f;  // 1.5 * 2^23: adding it leaves no fraction bits
  const float whole = (x + kRound) - kRound;
  const float y = (x - whole) * 0.6931471805599453f;
  const float series =
      1 +
      y * (1 + y * (1 / 2.0f +
                    y * (1 / 6.0f + y * (1 / 24.0f + y * (1 / 120.0f +
                                                          y * (1 / 720.0f + y * (1 / 5040.0f)))))));
  const int32_t scale = (static_cast<int32_t>(whole) + 127) << 23;
  return series * std::bit_cast<float>(scale);
}

/// x^power for x > 0 that is normal; the result must be normal too.
inline float fast_pow(float x, float power) { return fast_exp2(power * fast_log2(x)); }

}  // namespace shale
