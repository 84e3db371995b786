// shaders/frame/qrisp/post.comp -- pass 4 of QRISP: depth to space, and the blend with the warped history.
//
// Reads the tensors "alpha", "candidate" and "feature", int8 NHWC at render size (sides even) with s^2, 3 s^2 and s^2
// channels, warped and color; writes history (rgba16_float, as displayed), features (r8_unorm) and output (linear, without
// exposure). Without a past the candidate is the result. With CORRECTS the candidate is what is added to the frame, enlarged
// bilinearly from its samples where they lie. Almost white it may not be brighter than the frame is around it or the past
// was (color.glsl, kNoOvershoot): the last code of a candidate alone would be a light of 65504. One invocation per output pixel.
// Source: QRISP (ICCV 2023), seed_networks.md section 2.2.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

vec3 sample_at(ivec2 texel) {
  return displayed(exposed(finite_color(rgb_of(fetch_color(inside(texel, kRender)))), params.exposure));
}

/// The frame between the four samples around the middle of an output pixel, clamped to the border.
vec3 enlarged(ivec2 at) {
  const vec2 middle = clamp((vec2(at) + 0.5) / float(kScale) - finite_jitter() - 0.5, vec2(0.0), vec2(kRender - 1));
  const ivec2 first = ivec2(middle);
  const vec2 part = middle - vec2(first);
  return mix(mix(sample_at(first), sample_at(first + ivec2(1, 0)), part.x),
             mix(sample_at(first + ivec2(0, 1)), sample_at(first + 1), part.x), part.y);
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kOutput.x || at.y >= kOutput.y) return;
  const ivec2 texel = at / kScale, part = at - texel * kScale;
  const int pixel = texel.y * ALPHA_WIDTH + texel.x, phase = part.y * kScale + part.x;
  vec3 result;
  [[unroll]] for (int c = 0; c < 3; ++c)
    result[c] = float(CANDIDATE_SCALE) *
                float(element_candidate((pixel * 3 + c) * kPhases + phase) - CANDIDATE_ZERO_POINT);
#ifdef CORRECTS
  result = clamp(enlarged(at) + result, 0.0, 1.0);
#endif
  if (params.reset == 0) {
    const float alpha = float(ALPHA_SCALE) * float(element_alpha(pixel * kPhases + phase) - ALPHA_ZERO_POINT);
    result = mix(rgb_of(fetch_warped(at)), result, alpha);
  }
  result = clamp(result, 0.0, 1.0);
  const vec3 bright = vec3(sqrt(kNoOvershoot));
  if (any(greaterThan(result, bright))) {
    vec3 brightest = bright;
    if (params.reset == 0) brightest = most(brightest, rgb_of(fetch_warped(at)));
    for (int i = 0; i < 9; ++i) {
      brightest = most(brightest, sample_at(texel + ivec2(i % 3, i / 3) - 1));
    }
    result = min(result, brightest);
  }
  store_features(at, float(FEATURE_SCALE) *
                         float(element_feature(pixel * kPhases + phase) - FEATURE_ZERO_POINT));
  store_history(at, half4(result));
  store_output(at, half4(min(linear(result) / params.exposure, vec3(kMaxColor))));
}
