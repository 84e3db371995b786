// shaders/frame/mnss/show.comp -- pass 5 of MNSS: the network's result becomes the history, which the output shows.
//
// One invocation per output pixel. Reads the tensor "reconstructed", int8 NHWC [1, H, W, 3], whose codes are those of the
// history (rgba8).
// Source: MNSS (TVCG 2023).
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const int base = (at.y * RECONSTRUCTED_WIDTH + at.x) * RECONSTRUCTED_CHANNELS;
  vec3 color;
  [[unroll]] for (int c = 0; c < 3; ++c)
    color[c] = float(element_reconstructed(base + c) - RECONSTRUCTED_ZERO_POINT) * float(RECONSTRUCTED_SCALE);
  store_history(at, vec4(color, 1.0));
}
