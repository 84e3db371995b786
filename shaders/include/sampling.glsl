// shaders/include/sampling.glsl -- filtered reads by texelFetch, equal on every device; borders are clamped.
//
// Positions are uv in the picture, (0, 0) its upper left corner; they must be finite. Needs
// GL_EXT_samplerless_texture_functions and color.glsl.
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
float bilinear_weight(vec2 part, int i) {
  return ((i & 1) == 0 ? 1.0 - part.x : part.x) * ((i & 2) == 0 ? 1.0 - part.y : part.y);
}
ivec2 bilinear_texel(Bilinear b, int i, ivec2 size) { return inside(b.base + ivec2(i & 1, i >> 1), size); }

vec4 sample_linear(texture2D image, vec2 uv, ivec2 size) {
  const Bilinear b = bilinear_at(uv, size);
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; ++i) sum += bilinear_weight(b.part, i) * texelFetch(image, bilinear_texel(b, i, size), 0);
  return sum;
}

/// As sample_linear, of a host's colours: each made finite and exposed first.
vec3 sample_exposed(texture2D image, vec2 uv, ivec2 size, float exposure) {
  const Bilinear b = bilinear_at(uv, size);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) *
           exposed(finite_color(texelFetch(image, bilinear_texel(b, i, size), 0).rgb), exposure);
  return sum;
}

/// Texel of a linear picture in the exposed Karis domain.
vec3 mapped_texel(texture2D image, ivec2 at, ivec2 size, float exposure) {
  return karis(exposed(texelFetch(image, inside(at, size), 0).rgb, exposure));
}

/// As sample_linear, between mapped texels.
vec3 sample_linear_mapped(texture2D image, vec2 uv, ivec2 size, float exposure) {
  const Bilinear b = bilinear_at(uv, size);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * mapped_texel(image, b.base + ivec2(i & 1, i >> 1), size, exposure);
  return sum;
}

/// Between mapped texels: Catmull-Rom from the cross of the twelve texels around uv without the four corners, the weights made to sum to 1;
/// where a channel comes out negative, all are clamped to the five bilinear taps that the cross is made of.
/// Source: nss.md section 3.1.
vec3 sample_catmull_rom_mapped(texture2D image, vec2 uv, ivec2 size, float exposure) {
  const Bilinear b = bilinear_at(uv, size);
  const vec2 f = b.part, f2 = f * f, f3 = f2 * f;
  const vec2 w0 = f2 - 0.5 * (f3 + f);
  const vec2 w1 = 1.5 * f3 - 2.5 * f2 + 1.0;
  const vec2 w3 = 0.5 * (f3 - f2);
  const vec2 w2 = 1.0 - w0 - w1 - w3;
  const vec2 w12 = w1 + w2;
  const vec2 mid = w2 / w12;
  #define SHALE_AT(x, y) mapped_texel(image, b.base + ivec2(x, y), size, exposure)
  const vec3 centre = mix(mix(SHALE_AT(0, 0), SHALE_AT(1, 0), mid.x), mix(SHALE_AT(0, 1), SHALE_AT(1, 1), mid.x), mid.y);
  const vec3 left = mix(SHALE_AT(-1, 0), SHALE_AT(-1, 1), mid.y);
  const vec3 right = mix(SHALE_AT(2, 0), SHALE_AT(2, 1), mid.y);
  const vec3 up = mix(SHALE_AT(0, -1), SHALE_AT(1, -1), mid.x);
  const vec3 down = mix(SHALE_AT(0, 2), SHALE_AT(1, 2), mid.x);
  #undef SHALE_AT
  const float kc = w12.x * w12.y, kl = w0.x * w12.y, kr = w3.x * w12.y, ku = w12.x * w0.y, kd = w12.x * w3.y;
  const vec3 sum = (kc * centre + kl * left + kr * right + ku * up + kd * down) / (kc + kl + kr + ku + kd);
  const vec3 low = min(centre, min(min(left, right), min(up, down)));
  const vec3 high = max(centre, max(max(left, right), max(up, down)));
  return any(lessThan(sum, vec3(0.0))) ? clamp(sum, low, high) : sum;
}

#endif
