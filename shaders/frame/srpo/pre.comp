// shaders/frame/srpo/pre.comp -- quantizes the raster frame for the network.
//
// Reads color, rgba8 in [0, 1]; writes the tensor "input", int8 NHWC [1, h, w, 3]. With scale 1/255 and
// zero point -128 every 8-bit colour is exact. One invocation per pixel of color.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= INPUT_WIDTH || at.y >= INPUT_HEIGHT) return;
  const vec3 code = floor(fetch_color(at).rgb / float(INPUT_SCALE) + 0.5);
  const ivec3 q = clamp(ivec3(code) + INPUT_ZERO_POINT, -128, 127);
  const int base = (at.y * INPUT_WIDTH + at.x) * INPUT_CHANNELS;
  [[unroll]] for (int c = 0; c < 3; ++c) store_element_input(base + c, q[c]);
}
