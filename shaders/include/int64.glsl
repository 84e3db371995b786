// shaders/include/int64.glsl -- for INT48 tensors and for products that need more than a pair of words.
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require

// RESCALE of an INT48 value with a 16-bit multiplier. |value| < 2^47, 0 <= multiplier < 2^15 and
// 2 <= shift <= 62, so product and rounding stay inside 64 bits. Source: TOSA 1.0, apply_scale_16.
int apply_scale_48(int64_t value, int multiplier, int shift) {
  return int((value * int64_t(multiplier) + (int64_t(1) << (shift - 1))) >> shift);
}

// Source: TOSA 1.0, reciprocal_scale and apply_scale_32 with single rounding; n is 1 or more.
int average_pool(int sum, int n) {
  int k = n > 1 ? findMSB(uint(n - 1)) + 1 : 0;
  int multiplier = int(((int64_t((1 << 30) + 1)) << k) / int64_t(n));
  int shift = 30 + k;
  return int((int64_t(sum) * int64_t(multiplier) + (int64_t(1) << (shift - 1))) >> shift);
}
