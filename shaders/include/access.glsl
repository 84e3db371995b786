// shaders/include/access.glsl -- how a pass reaches the images and tensors that its frame.json names.
//
// The compiler writes an accessor for each one that the pass uses, for one target; this file has their types. Texels of
// an image lie in an image or, SHALE_LINEAR, in a buffer, row after row; what a fetch gives is a texel as it lies there,
// which rgb_of, xy_of or snorm_of make numbers of: fetches may so come first, and arithmetic behind them.
//
//   fetch_X(at)            the texel at `at`, which lies inside
//   fetch2_X(at, t)        two texels side by side, those of columns 2 * at.x and on; fetch4_X: four, 4 * at.x and on.
//                          Beyond the right border they are anything
//   sample_X(uv)           bilinear, borders clamped; on a GPU by the device's sampler
//   store_X(at, t)         a texel; store2_X(at, a, b): two, at.x even
//   max_X(at, u)           an atomic maximum
//   codes_X(i)             four int8 of a tensor, those from 4 * i on; word_X(i), words4_X(i): one, four words of four int8
//   element_X(i)           one of them
//   store_word_X(i, w), store_words2_X(i, a, b), store_element_X(i, v): words i; 2 * i and 2 * i + 1; element i
//
// rgba16_float is HALF4 (made by half4, of a colour in [0, 65504]), rg16_float HALF2 (half2), rgba8_snorm SNORM4 to read and
// a word (snorm_word) to store; the others are floats, vectors of them, or uint. With SHALE_WIDE, for what rounding costs
// (`shale stress --reference wide`), rgba32_float stands in its place, and half4 does not round.
#ifndef SHALE_ACCESS_GLSL
#define SHALE_ACCESS_GLSL
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#ifdef SHALE_STORES_ELEMENTS
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_int8 : require
#endif
#include "sampling.glsl"

// Where a lane of a processor runs an invocation, 64 bits are stored as one number: a loop over the lanes, two for a uvec2.
#if SHALE_LINEAR
#define PAIR double
PAIR pair(uint low, uint high) { return packDouble2x32(uvec2(low, high)); }
/// A word, packed: Mesa stores lane by lane, and LLVM would pack it lane by lane, too, but for the maximum.
uint whole(uint word) { return max(word, uint(int(gl_GlobalInvocationID.x) == 0x7fffffff)); }
#else
#define PAIR uvec2
PAIR pair(uint low, uint high) { return uvec2(low, high); }
uint whole(uint word) { return word; }
#endif

/// Halves of values in [0, 65504], rounded to even. Mesa's packHalf2x16 takes five times as many instructions, and its
/// stores to images cut off.
uvec3 half_bits(vec3 c) {
  const uvec3 bits = floatBitsToUint(c);
  // Above 2^-14 the exponent changes its bias; below, 0.5 plus the value holds it in steps of 2^-24, as halves do.
  const uvec3 normal = (bits - 0x38000000u + 0xfffu + (bits >> 13 & 1u)) >> 13;
  const uvec3 small = floatBitsToUint(c + 0.5) - 0x3f000000u;
  return mix(normal, small, lessThan(c, vec3(6.103515625e-5)));
}

/// Four values in [-1, 1] as a word of rgba8_snorm.
uint snorm_word(vec4 v) {
  const ivec4 codes = ivec4(floor(clamp(v, -1.0, 1.0) * 127.0 + 0.5)) & 255;
  return whole(uint(codes.x | codes.y << 8 | codes.z << 16 | codes.w << 24));
}
ivec4 signed_bytes(uint word) {
  const int w = int(word);
  return ivec4(w << 24, w << 16, w << 8, w) >> 24;
}
uvec2 unorm_codes(vec2 v) { return uvec2(floor(clamp(v, 0.0, 1.0) * 255.0 + 0.5)); }

#if SHALE_LINEAR
#define HALF4 uvec2
#define HALF2 uint
#define SNORM4 ivec4
vec3 rgb_of(HALF4 words) { return vec3(unpackHalf2x16(words.x), unpackHalf2x16(words.y).x); }
vec2 xy_of(HALF2 word) { return unpackHalf2x16(word); }
vec4 snorm_of(SNORM4 codes) { return vec4(max(codes, -127)) * (1.0 / 127.0); }
HALF4 half4(vec3 c) {
  const uvec3 h = half_bits(c);
  return uvec2(whole(h.r | h.g << 16), whole(h.b | 0x3c000000u));
}
HALF2 half2(vec2 v) { return packHalf2x16(v); }
// Of the images that stay images: those that are written alone, such as the host's output.
vec4 image_of_half4(HALF4 words) { return vec4(unpackHalf2x16(words.x), unpackHalf2x16(words.y)); }
vec4 image_of_half2(HALF2 word) { return vec4(unpackHalf2x16(word), 0.0, 0.0); }
HALF4 half4_of_image(vec4 texel) { return uvec2(packHalf2x16(texel.xy), packHalf2x16(texel.zw)); }
HALF2 half2_of_image(vec2 texel) { return packHalf2x16(texel); }
SNORM4 snorm4_of_image(vec4 texel) { return ivec4(floor(texel * 127.0 + 0.5)); }
struct SAMPLED_HALF4 {
  HALF4 texels[4];
  vec2 part;
};
vec3 rgb_of(SAMPLED_HALF4 s) {
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) sum += bilinear_weight(s.part, i) * rgb_of(s.texels[i]);
  return sum;
}
#else
#define HALF4 vec4
#define HALF2 vec2
#define SNORM4 vec4
vec3 rgb_of(HALF4 texel) { return texel.rgb; }
vec2 xy_of(HALF2 texel) { return texel; }
vec4 snorm_of(SNORM4 texel) { return texel; }
#if SHALE_WIDE
HALF4 half4(vec3 c) { return vec4(c, 1.0); }
#else
HALF4 half4(vec3 c) {
  const uvec3 h = half_bits(c);
  return vec4(unpackHalf2x16(h.r | h.g << 16), unpackHalf2x16(h.b).x, 1.0);
}
#endif
HALF2 half2(vec2 v) { return unpackHalf2x16(packHalf2x16(v)); }  // rounded here: stores may cut off
vec4 image_of_half4(HALF4 texel) { return texel; }
vec4 image_of_half2(HALF2 texel) { return vec4(texel, 0.0, 0.0); }
HALF4 half4_of_image(vec4 texel) { return texel; }
HALF2 half2_of_image(vec2 texel) { return texel; }
SNORM4 snorm4_of_image(vec4 texel) { return texel; }
struct SAMPLED_HALF4 {
  vec4 value;
};
vec3 rgb_of(SAMPLED_HALF4 s) { return s.value.rgb; }
#endif

/// A byte of a word of an int8 tensor, less the zero point: as the last bits of 2^23, which spares a conversion.
float code_of(uint word, int byte, int zero_point) {
  const uint u = (word ^ 0x80808080u) >> 8 * byte & 255u | 0x4b000000u;
  return uintBitsToFloat(u) - float(8388608 + 128 + zero_point);
}

#include "generated_accessors.glsl"

#endif
