// shaders/frame/flow/hint.comp -- takes a hint in place of the flow that was found where it fits better.
//
// One invocation per pixel of flow (rg16_float, pixels of this level, from the previous frame to the newest). hint is motion in uv,
// of any size, of what is there in the newest frame; RAW as the host gives it. Both are compared by the sum of absolute differences over 5x5, at whole
// pixels; the hint has to be strictly better. Without a past there is no flow.
// Source: nfru.md sections 2.1 and 2.2, where the camera's motion is the hint.
#version 450
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;

const ivec2 kSize = ivec2(FLOW_WIDTH, FLOW_HEIGHT);

float difference(ivec2 at, vec2 flow) {
  const ivec2 way = ivec2(floor(clamp(flow, vec2(-16384.0), vec2(16384.0)) + 0.5));
  float sum = 0.0;
  for (int i = 0; i < 25; ++i) {
    const ivec2 p = at + ivec2(i % 5, i / 5) - 2;
    sum += abs(fetch_before(inside(p, kSize)) - fetch_after(inside(p + way, kSize)));
  }
  return sum;
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kSize.x || at.y >= kSize.y) return;
  const vec2 found = xy_of(fetch_smooth(at));
  vec2 m = xy_of(fetch_hint((2 * at + 1) * ivec2(HINT_WIDTH, HINT_HEIGHT) / (2 * kSize)));
#if RAW
  m *= params.motion_scale;
#endif
  const vec2 hint = vec2(finite_in(m.x, -1.0, 1.0, 0.0), finite_in(m.y, -1.0, 1.0, 0.0)) * vec2(kSize);
  const vec2 best = difference(at, hint) < difference(at, found) ? hint : found;
  store_flow(at, half2(params.reset != 0 ? vec2(0.0) : best));
}
