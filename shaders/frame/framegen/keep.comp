// shaders/frame/framegen/keep.comp -- a rendered frame as it is shown: colours that are finite.
//
// One invocation per pixel, for frames that are rendered in the output's size and need no upscaler.
#version 450
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  store_shown(at, half4(finite_color(rgb_of(fetch_color(at)))));
}
