// shaders/frame/mnss/show.comp -- pass 5 of MNSS: the picture that the network corrected becomes the history, which the output shows.
//
// One invocation per output pixel. Reads the tensors "input" and "correction", int8 NHWC [1, H, W, 3]; the history is rgba8.
// Source: MNSS (TVCG 2023); ours: that the network corrects what went in (tools/train/mnss.py).
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const int base = (at.y * INPUT_WIDTH + at.x) * INPUT_CHANNELS;
  vec3 color;
  [[unroll]] for (int c = 0; c < 3; ++c)
    color[c] = float(element_input(base + c) - INPUT_ZERO_POINT) * float(INPUT_SCALE) +
               float(element_correction(base + c) - CORRECTION_ZERO_POINT) * float(CORRECTION_SCALE);
  store_history(at, vec4(clamp(color, 0.0, 1.0), 1.0));
}
