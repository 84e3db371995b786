// ir/reference/arith.h -- TOSA's fixed-point arithmetic on single values.
#pragma once

#include <bit>
#include <cstdint>
#include <optional>

#include "ir/base/dtype.h"

namespace shale {

inline constexpr bool in_range(int64_t value, IntRange range) {
  return range.min <= value && value <= range.max;
}
inline constexpr bool fits_int32(int64_t value) {
  return in_range(value, dtype_range(DType::kInt32));
}

/// value * multiplier * 2^-shift, ties toward plus infinity; `double_round` pushes them away from 0
/// from shift 32 on, after a first rounding at bit 30.
/// Nothing if TOSA leaves the result unpredictable: multiplier below 0, shift outside 2..62, value
/// outside -2^(shift-1)..2^(shift-1)-1, or a result outside int32.
/// Source: TOSA 1.0, apply_scale_32.
inline constexpr std::optional<int64_t> apply_scale_32(int64_t value, int64_t multiplier,
                                                       int64_t shift, bool double_round) {
  if (multiplier < 0 || shift < 2 || shift > 62 || !fits_int32(value)) return std::nullopt;
  const int64_t half = int64_t{1} << (shift - 1);
  if (!in_range(value, {-half, half - 1})) return std::nullopt;
  int64_t round = half;
  if (double_round && shift > 31) round += value >= 0 ? int64_t{1} << 30 : -(int64_t{1} << 30);
  const int64_t result = (value * multiplier + round) >> shift;
  return fits_int32(result) ? std::optional(result) : std::nullopt;
}

/// The same for an int48 value and an int16 multiplier, single rounding, no bound from the shift.
/// Source: TOSA 1.0, apply_scale_16.
inline constexpr std::optional<int64_t> apply_scale_16(int64_t value, int64_t multiplier,
                                                       int64_t shift) {
  if (multiplier < 0 || shift < 2 || shift > 62) return std::nullopt;
  const int64_t result = (value * multiplier + (int64_t{1} << (shift - 1))) >> shift;
  return fits_int32(result) ? std::optional(result) : std::nullopt;
}

struct Scale {
  int64_t multiplier = 0;
  int64_t shift = 0;
};

/// 1/n for apply_scale_32; n in 1..2^31.
/// Source: TOSA 1.0, reciprocal_scale.
inline constexpr Scale reciprocal_scale(int64_t n) {
  const int64_t k = std::bit_width(static_cast<uint64_t>(n - 1));
  return {(((int64_t{1} << 30) + 1) << k) / n, 30 + k};
}

}  // namespace shale
