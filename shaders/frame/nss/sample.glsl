// shaders/frame/nss/sample.glsl -- the samples of a frame in the exposed Karis domain. Expects the texel buffer `color`, two
// texels of rgba16_float a fetch, as the host gave them.

vec3 sample_of(uvec2 words) { return karis_of(finite_color(half_rgb(words))); }

vec3 sample_at(ivec2 at) {
  const uvec4 two = texelFetch(color, (at.y * RAW_COLOR_PITCH + at.x) / 2);
  return sample_of(at.x % 2 == 0 ? two.xy : two.zw);
}
