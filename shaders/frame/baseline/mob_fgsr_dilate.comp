// shaders/frame/baseline/mob_fgsr_dilate.comp -- pass 0 of Mob-FGSR: the closest depth of 3x3 and its motion.
//
// STILL 1: nothing moves, and nobody asks for motion; the promise of frame.json.
// One invocation per render texel; the centre wins a tie. dilated_depth is r32_float, dilated_motion rg16_float in uv.
// Source: Mob-FGSR (SIGGRAPH 2024), seed_networks.md section 4.1.
#version 450
#ifndef STILL
#define STILL 0
#endif
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;

const ivec2 kRender = ivec2(COLOR_WIDTH, COLOR_HEIGHT);

/// Depth with near at 0 whatever the host's order; NaN is the farthest.
float depth_at(ivec2 at) {
  const float d = finite_in(fetch_depth(inside(at, kRender)), 0.0, 1.0,
                            params.reverse_depth != 0 ? 0.0 : 1.0);
  return params.reverse_depth != 0 ? 1.0 - d : d;
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  ivec2 from = at;
  float closest = depth_at(at);
  [[unroll]] for (int i = 0; i < 9; ++i) {
    const ivec2 neighbour = at + ivec2(i % 3, i / 3) - 1;
    const float d = depth_at(neighbour);
    if (d < closest) {
      closest = d;
      from = clamp(neighbour, ivec2(0), kRender - 1);
    }
  }
  store_dilated_depth(at, closest);
#if !STILL
  const vec2 m = xy_of(fetch_motion(from)) * params.motion_scale;
  store_dilated_motion(at, half2(vec2(finite_in(m.x, -1.0, 1.0, 0.0), finite_in(m.y, -1.0, 1.0, 0.0))));
#endif
}
