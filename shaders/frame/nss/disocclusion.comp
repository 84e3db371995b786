// shaders/frame/nss/disocclusion.comp -- disocclusion at a quarter of the render size: pass c of NSS v1 MID and LOW.
//
// One invocation per texel of disocclusion (r8), a block of 4x4 render texels: the depth clip of the block's closest
// texel, with the range of view depth in the block as tolerance. Source: nss.md section 2.4 c.
#version 450
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, r32f) readonly uniform image2D depth;  // of check.comp
layout(set = 0, binding = 1) uniform texture2D motion;
layout(set = 0, binding = 2, r32ui) readonly uniform uimage2D scatter;
layout(set = 0, binding = 3, r8) writeonly uniform image2D disocclusion;
#include "scattered.glsl"

void main() {
  const ivec2 block = ivec2(gl_GlobalInvocationID.xy);
  if (block.x >= DISOCCLUSION_WIDTH || block.y >= DISOCCLUSION_HEIGHT) return;
  ivec2 from = block * 4;
  float closest = imageLoad(depth, from).r;
  float farthest = closest;
  for (int i = 1; i < 16; ++i) {
    const ivec2 at = block * 4 + ivec2(i & 3, i >> 2);
    if (any(greaterThanEqual(at, kRender))) continue;
    const float d = imageLoad(depth, at).r;
    if (closer(d, closest)) {
      closest = d;
      from = at;
    }
    if (closer(farthest, d)) farthest = d;
  }
  const vec2 uv = (vec2(block) + 0.5) / vec2(DISOCCLUSION_WIDTH, DISOCCLUSION_HEIGHT);
  const float z = view_z(closest);
  const float mask = disoccluded(uv - motion_at(motion, from, kRender, 0.1), z, view_z(farthest) - z);
  imageStore(disocclusion, block, vec4(mask));
}
