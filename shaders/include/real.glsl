// shaders/include/real.glsl -- floating-point operators of TOSA: NaN modes, casts, FP16 in 16 bits.
//
// FP16 values are rounded in integers, since drivers may round packHalf2x16 either way and flush what is
// subnormal. Meaning of each function: ir/base/half.h and ir/reference/real.h.

bool is_nan(float x) { return (floatBitsToUint(x) & 0x7fffffffu) > 0x7f800000u; }

uint to_half(float x) {
  uint bits = floatBitsToUint(x), magnitude = bits & 0x7fffffffu;
  uint normal = (magnitude - 0x38000000u + 0xfffu + (magnitude >> 13 & 1u)) >> 13;
  uint shift = min(126u - min(magnitude >> 23, 126u), 25u);
  uint mantissa = (magnitude & 0x7fffffu) | 0x800000u;
  uint small = (mantissa + (1u << (shift - 1u)) - 1u + (mantissa >> shift & 1u)) >> shift;
  uint bounded = magnitude > 0x7f800000u ? 0x7e00u : magnitude >= 0x47800000u ? 0x7c00u : normal;
  return (bits >> 16 & 0x8000u) | (magnitude < 0x38800000u ? small : bounded);
}

float from_half(uint h) {
  uint magnitude = h & 0x7fffu;
  uint small = floatBitsToUint(float(magnitude) * (1.0 / 16777216.0));
  uint normal = (magnitude << 13) + (magnitude >= 0x7c00u ? 0x70000000u : 0x38000000u);
  return uintBitsToFloat((h & 0x8000u) << 16 | (magnitude < 0x400u ? small : normal));
}

float round_half(float x) { return from_half(to_half(x)); }

float max_propagate(float a, float b) { return is_nan(a) ? a : is_nan(b) ? b : max(a, b); }
float min_propagate(float a, float b) { return is_nan(a) ? a : is_nan(b) ? b : min(a, b); }
float max_ignore(float a, float b) { return is_nan(a) ? b : is_nan(b) ? a : max(a, b); }
float min_ignore(float a, float b) { return is_nan(a) ? b : is_nan(b) ? a : min(a, b); }

// CAST: to nearest even, saturated to low..high; a NaN gives 0.
int to_int(float x, int low, int high) {
  float whole = roundEven(x);
  int inner = whole <= float(low) ? low : whole >= float(high) ? high : int(whole);
  return is_nan(x) ? 0 : inner;
}

float sigmoid(float x) { return 1.0 / (1.0 + exp(-x)); }
