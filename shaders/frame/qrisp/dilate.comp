// shaders/frame/qrisp/dilate.comp -- pass 1 of QRISP: jitter compensation, and one motion for each block of the output.
//
// One invocation per block of 8x8 output pixels: the motion of the render texel with the nearest depth among those that
// the block's pixels lie in, the first in rows of equal ones. moved is rg16_float in uv. Motion between jittered
// positions (params.jittered_motion) becomes that of the scene.
// Source: QRISP (ICCV 2023), seed_networks.md section 2.2.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

float component(float m) { return finite_in(m, -1.0, 1.0, 0.0); }

void main() {
  const ivec2 block = ivec2(gl_GlobalInvocationID.xy);
  if (block.x >= MOVED_WIDTH || block.y >= MOVED_HEIGHT) return;
  const ivec2 first = block * kBlock / kScale;
  const ivec2 last = min(block * kBlock + kBlock - 1, kOutput - 1) / kScale;
  const float away = params.reverse_depth != 0 ? -1.0 : 1.0;
  ivec2 from = first;
  float closest = away * finite_depth(fetch_depth(first));
  for (int y = first.y; y <= last.y; ++y)
    for (int x = first.x; x <= last.x; ++x) {
      const float depth = away * finite_depth(fetch_depth(ivec2(x, y)));
      from = depth < closest ? ivec2(x, y) : from;
      closest = min(depth, closest);
    }
  vec2 m = xy_of(fetch_motion(from)) * params.motion_scale;
  if (params.jittered_motion != 0) m += (params.jitter - params.previous_jitter) / vec2(kRender);
  store_moved(block, half2(vec2(component(m.x), component(m.y))));
}
