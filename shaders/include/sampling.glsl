// shaders/include/sampling.glsl -- where filtered reads look, in texels, equal on every device; borders are clamped.
//
// Positions are uv in the picture, (0, 0) its upper left corner; they must be finite.
#ifndef SHALE_SAMPLING_GLSL
#define SHALE_SAMPLING_GLSL

/// The texel that holds `index`, moved to the border from outside.
ivec2 inside(ivec2 index, ivec2 size) { return clamp(index, ivec2(0), size - 1); }

/// Upper left of the four texels around uv, and where uv lies between them.
struct Bilinear {
  ivec2 base;
  vec2 part;
};
Bilinear bilinear_at(vec2 uv, ivec2 size) {
  const vec2 at = uv * vec2(size) - 0.5;
  const vec2 base = floor(at);
  return Bilinear(ivec2(base), at - base);
}
/// As bilinear_at, in steps of 1/128 texel: more than `uv` loses by rounding in a picture of any size, so what stands still is
/// read where it lies, and nothing around it.
Bilinear settled_at(vec2 uv, ivec2 size) {
  precise const vec2 at = floor((uv * vec2(size) - 0.5) * 128.0 + 0.5) * (1.0 / 128.0);
  const vec2 base = floor(at);
  return Bilinear(ivec2(base), at - base);
}
/// settled_at of what rests, bilinear_at of what moves.
Bilinear bilinear_at(vec2 uv, ivec2 size, bool rests) {
  if (rests) return settled_at(uv, size);
  return bilinear_at(uv, size);
}
float bilinear_weight(vec2 part, int i) {
  return ((i & 1) == 0 ? 1.0 - part.x : part.x) * ((i & 2) == 0 ? 1.0 - part.y : part.y);
}
ivec2 bilinear_texel(Bilinear b, int i, ivec2 size) { return inside(b.base + ivec2(i & 1, i >> 1), size); }

/// Weights of four texels in a row, by the part of the way from the second to the third. Source: Keys, a = -1/2.
vec4 catmull_rom(float x) {
  const float x2 = x * x, x3 = x2 * x;
  return vec4(-0.5 * x3 + x2 - 0.5 * x, 1.5 * x3 - 2.5 * x2 + 1.0, -1.5 * x3 + 2.0 * x2 + 0.5 * x, 0.5 * (x3 - x2));
}

#endif
