// shaders/frame/needs/still.comp -- whether a frame keeps the promise that nothing moves: checks `motion`.
//
// One invocation per 16x4 render texels; MOTION_PIXELS is what a texel may move, render pixels. NaN breaks the promise.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;

void main() {
  const ivec2 first = ivec2(16, 4) * ivec2(gl_GlobalInvocationID.xy);
  if (first.x >= MOTION_WIDTH || first.y >= MOTION_HEIGHT) return;
  bool kept = true;
  [[unroll]] for (int y = 0; y < 4; ++y) {
    [[unroll]] for (int x = 0; x < 4; ++x) {
      HALF2 four[4];
      fetch4_motion(ivec2(min(first.x / 4 + x, (MOTION_WIDTH - 1) / 4), min(first.y + y, MOTION_HEIGHT - 1)), four);
      [[unroll]] for (int i = 0; i < 4; ++i) {
        const vec2 pixels = xy_of(four[i]) * params.motion_scale * vec2(MOTION_WIDTH, MOTION_HEIGHT);
        const bool is_inside = first.x + 4 * x + i < MOTION_WIDTH;
        kept = kept && (!is_inside || dot(pixels, pixels) <= float(MOTION_PIXELS) * float(MOTION_PIXELS));
      }
    }
  }
  if (!kept) max_broken(ivec2(0), 1u);
}
