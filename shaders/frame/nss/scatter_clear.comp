// shaders/frame/nss/scatter_clear.comp -- sets the scattered depth to the farthest value: pass a of NSS v1.
// One invocation per texel of scatter (r32_uint).
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, r32ui) writeonly uniform uimage2D scatter;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= SCATTER_WIDTH || at.y >= SCATTER_HEIGHT) return;
  imageStore(scatter, at, uvec4(0u));
}
