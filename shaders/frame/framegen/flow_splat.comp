// shaders/frame/framegen/flow_splat.comp -- sends every pixel of the flow to where it is at `time`.
//
// One invocation per pixel of flow (rg16_float, its own pixels, on the previous frame's, towards the newest). flow_splat
// (r32_uint, zeros before) holds of each target the nearest pixel that arrives, in words as those of splat.
// Source: nfru.md section 3.2.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy), size = ivec2(FLOW_WIDTH, FLOW_HEIGHT);
  if (at.x >= size.x || at.y >= size.y) return;
  const ivec2 way = ivec2(floor(params.time * xy_of(fetch_flow(at)))), target = at + way;
  if (any(lessThan(target, ivec2(0))) || any(greaterThanEqual(target, size)) || any(greaterThan(abs(way), ivec2(kReach)))) return;
  const ivec2 from = (2 * at + 1) * kRender / (2 * size);
  max_flow_splat(target, word_of(nearness(fetch_previous_depth(from), from), 1u, way));
}
