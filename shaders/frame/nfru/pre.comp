// shaders/frame/nfru/pre.comp -- what NFRU's network sees of the two frames.
//
// One invocation per pixel of the padded lane. Writes the tensor "input", int8 NHWC [1, h, w, 16], all in 0..1:
//   0-2, 3-5 previous and newest frame by motion    6-8, 9-11 the same by flow: means of 4x4 pixels, as displayed
//   12, 13 depth of the two by motion, a logarithm, 0 near    14, 15 how far it is from that of what was splatted
// A sample off the screen shows its partner's colour: it has no weight later. BY_HAND: weighs the samples itself, into `weights`
// (rgba8_unorm, their sum 1): each pair by the inverse square of its difference, of motion's what was hidden less.
// Source: nfru.md sections 3.3 and 6. Ours: means in place of single pixels, the partner in place of noise, the depth's test.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

#define MEAN(sample)                                                              \
  const vec2 texel = 1.0 / vec2(kOutput);                                         \
  vec3 sum = vec3(0.0);                                                           \
  [[unroll]] for (int i = 0; i < 4; ++i)                                          \
    sum += rgb_of(sample(uv + texel * vec2((i & 1) * 2 - 1, (i >> 1) * 2 - 1)));  \
  return 0.25 * sum;
vec3 newest_mean(vec2 uv) { MEAN(sample_displayed) }
vec3 previous_mean(vec2 uv) { MEAN(sample_previous_displayed) }

/// 0 at the near plane, 1 far away.
float log_depth(float d) { return 1.0 - log(1200.0 * (1.0 - d) + 1.0) / log(1201.0); }
/// 0 of the same depth, a half at the border of kSameDepth.
float hidden(float za, float zb) { return clamp(abs(za - zb) / (2.0 * kSameDepth * min(za, zb)), 0.0, 1.0); }

/// The texel of the lane that a texel of the tensor shows: mirrored below and right of it, as often as needed.
ivec2 mirrored(ivec2 at, ivec2 size) {
  const ivec2 turn = at % (2 * size);
  return min(turn, 2 * size - 1 - turn);
}

#if !BY_HAND
uint code(float x) { return uint(clamp(int(floor(x / float(INPUT_SCALE) + 0.5)) + INPUT_ZERO_POINT, -128, 127)) & 255u; }
uint word(float a, float b, float c, float d) { return whole(code(a) | code(b) << 8 | code(c) << 16 | code(d) << 24); }
#endif

void main() {
  const ivec2 to = ivec2(gl_GlobalInvocationID.xy);
#if BY_HAND
  const ivec2 size = kLane;
#else
  const ivec2 size = ivec2(INPUT_WIDTH, INPUT_HEIGHT);
#endif
  if (to.x >= size.x || to.y >= size.y) return;
  const vec2 uv = (vec2(mirrored(to, kLane)) + 0.5) / vec2(kLane);
  const Places p = places(uv, texel_at(uv));
  const Four four = four_at(uv, p);
  vec3 c[kSamples];
  [[unroll]] for (int i = 0; i < kSamples; i += 2) {
    c[i] = previous_mean(four.at[i]);
    c[i + 1] = newest_mean(four.at[i + 1]);
    if (four.seen[i] != four.seen[i + 1]) {
      if (four.seen[i] > 0.0) c[i + 1] = c[i];
      else c[i] = c[i + 1];
    }
  }
  const float d0 = fetch_previous_depth(texel_at(p.before)), d1 = fetch_dilated_depth(texel_at(p.now));
  const float z0 = view_z(d0), z1 = view_z(d1), z = p.depth < 0.0 ? max(z0, z1) : view_z(p.depth);
  const float hidden0 = four.seen[0] > 0.0 ? hidden(z0, z) : 1.0, hidden1 = four.seen[1] > 0.0 ? hidden(z1, z) : 1.0;
#if BY_HAND
  const float by_motion = 0.01 + dot(abs(c[0] - c[1]), vec3(0.25, 0.5, 0.25));
  const float by_flow = 0.01 + dot(abs(c[2] - c[3]), vec3(0.25, 0.5, 0.25));
  const vec4 w = vec4(vec2(1.02 - vec2(hidden0, hidden1)) / (by_motion * by_motion), vec2(1.0 / (by_flow * by_flow)));
  store_weights(to, w / dot(w, vec4(1.0)));
#else
  const int first = 4 * (to.y * size.x + to.x);
  store_words2_input(first / 2, word(c[0].r, c[0].g, c[0].b, c[1].r), word(c[1].g, c[1].b, c[2].r, c[2].g));
  store_words2_input(first / 2 + 1, word(c[2].b, c[3].r, c[3].g, c[3].b), word(log_depth(d0), log_depth(d1), hidden0, hidden1));
#endif
}
