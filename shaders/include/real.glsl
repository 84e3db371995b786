// shaders/include/real.glsl -- floating-point operators of TOSA: NaN modes, casts, types of 16 and 8 bits.
//
// Narrow types are rounded in integers, since drivers may round packHalf2x16 either way and flush what is
// subnormal. Meaning of each function: ir/base/float_format.h and ir/reference/real.h.

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

uint to_bf16(float x) {
  uint bits = floatBitsToUint(x);
  return is_nan(x) ? (bits >> 16 & 0x8000u) | 0x7fc0u : (bits + 0x7fffu + (bits >> 16 & 1u)) >> 16;
}

float from_bf16(uint b) { return uintBitsToFloat(b << 16); }

float round_bf16(float x) { return from_bf16(to_bf16(x)); }

// `fraction` bits, 2^lowest the smallest normal number, `top` the code of infinity, or of the NaN where there is none.
uint to_fp8(float x, int fraction, int lowest, uint top) {
  uint bits = floatBitsToUint(x), magnitude = bits & 0x7fffffffu;
  int exponent = int(magnitude >> 23) - 127;
  int dropped = clamp(23 - fraction + max(lowest - exponent, 0), 1, 25);
  uint significand = (magnitude & 0x7fffffu) | 0x800000u;
  uint kept = (significand + (1u << (dropped - 1)) - 1u + (significand >> dropped & 1u)) >> dropped;
  uint code = min((uint(max(exponent - lowest, 0)) << fraction) + kept, top);
  return (bits >> 24 & 0x80u) | (is_nan(x) ? 0x7fu : code);
}

float from_fp8(uint code, int fraction, int lowest) {
  uint magnitude = code & 0x7fu;
  float small = float(magnitude) * uintBitsToFloat(uint(lowest - fraction + 127) << 23);
  uint normal = (magnitude << (23 - fraction)) + (uint(lowest + 126) << 23);
  uint bits = magnitude < (1u << fraction) ? floatBitsToUint(small) : normal;
  return uintBitsToFloat((code & 0x80u) << 24 | bits);
}

uint to_e4m3(float x) { return to_fp8(x, 3, -6, 0x7fu); }
uint to_e5m2(float x) { return to_fp8(x, 2, -14, 0x7cu); }

float from_e4m3(uint code) {
  return (code & 0x7fu) == 0x7fu ? uintBitsToFloat(0x7fc00000u) : from_fp8(code, 3, -6);
}

float from_e5m2(uint code) {
  uint high = code & 0x7cu;
  return high == 0x7cu ? uintBitsToFloat((code & 0x80u) << 24 | 0x7f800000u | (code & 3u) << 21)
                       : from_fp8(code, 2, -14);
}

float round_e4m3(float x) { return from_e4m3(to_e4m3(x)); }
float round_e5m2(float x) { return from_e5m2(to_e5m2(x)); }

float max_propagate(float a, float b) { return is_nan(a) ? a : is_nan(b) ? b : max(a, b); }
float min_propagate(float a, float b) { return is_nan(a) ? a : is_nan(b) ? b : min(a, b); }
float max_ignore(float a, float b) { return is_nan(a) ? b : is_nan(b) ? a : max(a, b); }
float min_ignore(float a, float b) { return is_nan(a) ? b : is_nan(b) ? a : min(a, b); }

// CAST: to nearest even, saturated to low..high; a NaN gives 0. Up to 2^22 the last bits of 1.5 * 2^23 round as wanted.
int to_int(float x, int low, int high) {
  if (low >= -0x400000 && high <= 0x400000) {
    precise float held = clamp(is_nan(x) ? 0.0 : x, float(low), float(high)) + 12582912.0;
    return floatBitsToInt(held) - 0x4b400000;
  }
  float whole = roundEven(x);
  int inner = whole <= float(low) ? low : whole >= float(high) ? high : int(whole);
  return is_nan(x) ? 0 : inner;
}
