// shaders/include/color.glsl -- colours of frames: what may come in, the exposed Karis domain, YCoCg.
//
// Frames may hold anything: NaN becomes 0, colours lie in [0, 65504], so that every sum after it is finite.
// Source: nss.md section 2.1; NaN is found by its bits, since drivers may assume that there is none.
#ifndef SHALE_COLOR_GLSL
#define SHALE_COLOR_GLSL

const float kMaxColor = 65504.0;  // the largest half

// min and max for at most one negative operand, of which -NaN is one; NaN is above all others. Bits of floats are ordered
// as integers then: one instruction on a CPU, where min() takes three to see to NaN.
float least(float a, float b) { return intBitsToFloat(min(floatBitsToInt(a), floatBitsToInt(b))); }
float most(float a, float b) { return intBitsToFloat(max(floatBitsToInt(a), floatBitsToInt(b))); }
vec3 least(vec3 a, vec3 b) { return intBitsToFloat(min(floatBitsToInt(a), floatBitsToInt(b))); }
vec3 most(vec3 a, vec3 b) { return intBitsToFloat(max(floatBitsToInt(a), floatBitsToInt(b))); }

bool is_nan(float x) { return (floatBitsToUint(x) & 0x7fffffffu) > 0x7f800000u; }

/// x in [low, high]; `instead` for NaN.
float finite_in(float x, float low, float high, float instead) { return is_nan(x) ? instead : clamp(x, low, high); }

float finite_component(float c) {
  const int bits = max(floatBitsToInt(c), 0);
  return intBitsToFloat(bits > 0x7f800000 ? 0 : min(bits, floatBitsToInt(kMaxColor)));
}
vec3 finite_color(vec3 c) { return vec3(finite_component(c.r), finite_component(c.g), finite_component(c.b)); }

vec3 exposed(vec3 c, float exposure) { return least(c * exposure, vec3(kMaxColor)); }

float largest(vec3 c) { return most(c.r, most(c.g, c.b)); }

/// Filters with negative lobes work in the Karis domain. Above this (an exposed 7, which a display shows as almost
/// white) they may not leave their taps: the inverse would make of an overshoot to 0.99 a light of 99.
const float kNoOvershoot = 0.875;
/// [0, inf) to [0, 1).
vec3 karis(vec3 x) { return x * (1.0 / (1.0 + largest(x))); }
vec3 karis_inverse(vec3 x) {
  return least(x * (1.0 / (1.0 - least(largest(x), 1.0 - 1e-7))), vec3(kMaxColor));
}

/// x: luma; y, z: chroma. YCoCg with the lifting of nss.md section 2.5.
vec3 ycocg(vec3 c) {
  const float co = c.r - c.b;
  const float t = c.b + 0.5 * co;
  const float cg = c.g - t;
  return vec3(t + 0.5 * cg, co, cg);
}
vec3 ycocg_inverse(vec3 c) {
  const float t = c.x - 0.5 * c.z;
  const float g = c.z + t;
  const float b = t - 0.5 * c.y;
  return vec3(b + c.y, g, b);
}

#endif
