// shaders/frame/nss/check.comp -- the frame as the other passes of NSS v1 read it: finite, and in storage images, which
// CPU drivers read with half the instructions.
//
// One invocation per render texel. Colours stay halves, linear, without exposure; NaN in depth becomes the farthest.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1) uniform texture2D depth;
layout(set = 0, binding = 2, rgba16f) writeonly uniform image2D checked_color;
layout(set = 0, binding = 3, r32f) writeonly uniform image2D checked_depth;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= COLOR_WIDTH || at.y >= COLOR_HEIGHT) return;
  imageStore(checked_color, at, vec4(finite_color(texelFetch(color, at, 0).rgb), 0.0));
  imageStore(checked_depth, at, vec4(finite_depth(texelFetch(depth, at, 0).r)));
}
