// shaders/frame/mnss/difference.comp -- pass 1 of MNSS: how far the frame is from where the history says it should be.
//
// One invocation per render texel. difference (r32_uint) has four bytes, unorm: |colour - history where the texel was|, and
// the same of the nearness, over the larger of both. nearness (r32_float) is 1 / metres of this frame.
// Without a past the difference is 0; 1 where that was off the screen.
// Source: MNSS (TVCG 2023), inpainting; the nearness in place of the depth is ours.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

float nearness_at(ivec2 at) { return 1.0 / max(view_z(finite_depth(fetch_depth(at))), 1e-4); }

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  const float near = nearness_at(at);
  store_nearness(at, near);
  vec4 difference = vec4(0.0);
  if (params.reset == 0) {
    const vec2 before = (vec2(at * kScale + cell()) + 0.5) / vec2(kOutput) - finite_motion(xy_of(fetch_motion(at)));
    const Bilinear b = bilinear_at(before - params.previous_jitter / vec2(kRender), kRender);
    float past = 0.0;
    [[unroll]] for (int i = 0; i < 4; ++i) past += bilinear_weight(b.part, i) * fetch_past_nearness(tap(b, i));
    difference = vec4(abs(fetch_color(at).rgb - sample_history(before).rgb), abs(near - past) / max(near, max(past, 1e-9)));
    difference = on_screen(before) ? difference : vec4(1.0);
  }
  store_difference(at, packUnorm4x8(difference));
}
