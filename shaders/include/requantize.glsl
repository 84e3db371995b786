// shaders/include/requantize.glsl -- fixed-point scaling on 32-bit words, no 64-bit type needed.

// (a * b + round) >> shift for 1 <= shift <= 63, with round = 2^(shift-1); with `double_round`, from
// shift 32 on, 2^30 more for a >= 0 and 2^30 less for a < 0. The product is a pair of words, the sum
// never leaves it for legal operands. Source: TOSA 1.0, apply_scale_32; MUL.
int scale_round(int a, int b, int shift, bool double_round) {
  int high, low;
  imulExtended(a, b, high, low);
  uint carry;
  uint round_low = shift > 32 ? 0u : 1u << (shift - 1);
  int round_high = shift > 32 ? 1 << (shift - 33) : 0;
  if (double_round && shift > 31) {
    uint extra_low = a >= 0 ? 0x40000000u : 0xc0000000u;
    int extra_high = a >= 0 ? 0 : -1;
    round_low = uaddCarry(round_low, extra_low, carry);
    round_high += extra_high + int(carry);
  }
  uint sum_low = uaddCarry(uint(low), round_low, carry);
  int sum_high = high + round_high + int(carry);
  if (shift >= 32) return sum_high >> (shift - 32);
  return int(sum_low >> shift) | (sum_high << (32 - shift));
}

// The same for a shift of 32 + `shift`, shift > 0, without `double_round`: what is added and kept lies
// in the upper word alone.
int scale_high(int a, int b, int shift) {
  int high, low;
  imulExtended(a, b, high, low);
  return (high + (1 << (shift - 1))) >> shift;
}

// (a * (high * 2^16 + low) + 2^(shift + 15)) >> (shift + 16) for |a| <= 2^15, 0 <= high < 2^15, 0 <= low < 2^16 and
// 1 <= shift <= 30: two products of 32 bits, where a pair of words takes a driver three times as many instructions.
int scale_small(int a, int high, int low, int shift) {
  return (a * high + (a * low >> 16) + (1 << (shift - 1))) >> shift;
}
