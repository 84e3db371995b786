// shaders/frame/mnss/insert.comp -- passes 3 and 4 of MNSS: the rectified history, and the new samples in it.
//
// One invocation per render texel makes the kScale x kScale output pixels that it covers: I = M now + (1 - M) past, with now
// and M between the texels, past from the history. The anti-aliasing network, conv 1x1 6->3 with ReLU, takes colour and mean
// of I; its result replaces the pixel that was sampled. Numbers of the network: W0 to W17, by output and input, B0 to B2;
// float32. Writes the tensor "input", int8 NHWC [1, H, W, 3].
// Source: MNSS (TVCG 2023), equation 2, anti-aliasing and pixel insertion.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

vec3 rectified(ivec2 at) {
  const Bilinear b = between_texels(at);
  vec3 now = vec3(0.0);
  vec2 motion = vec2(0.0);
  float weight = 0.0;
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 from = tap(b, i);
    const float share = bilinear_weight(b.part, i);
    now += share * fetch_color(from).rgb;
    motion += share * finite_motion(xy_of(fetch_motion(from)));
    weight += share * fetch_weight(from);
  }
  if (params.reset != 0) return now;
  return mix(sample_history((vec2(at) + 0.5) / vec2(kOutput) - motion).rgb, now, weight);
}

void store(ivec2 at, vec3 color) {
  const ivec3 codes = ivec3(floor(clamp(color, 0.0, 1.0) / float(INPUT_SCALE) + 0.5)) + INPUT_ZERO_POINT;
  const int base = (at.y * INPUT_WIDTH + at.x) * INPUT_CHANNELS;
  [[unroll]] for (int c = 0; c < 3; ++c) store_element_input(base + c, codes[c]);
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  const ivec2 sampled = cell();
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < kScale * kScale; ++i) {
    const ivec2 part = ivec2(i % kScale, i / kScale);
    const vec3 color = rectified(at * kScale + part);
    sum += color;
    if (part != sampled) store(at * kScale + part, color);
  }
  const vec3 now = fetch_color(at).rgb, mean = sum / float(kScale * kScale);
  store(at * kScale + sampled, vec3(B0 + dot(vec3(W0, W1, W2), now) + dot(vec3(W3, W4, W5), mean),
                                    B1 + dot(vec3(W6, W7, W8), now) + dot(vec3(W9, W10, W11), mean),
                                    B2 + dot(vec3(W12, W13, W14), now) + dot(vec3(W15, W16, W17), mean)));
}
