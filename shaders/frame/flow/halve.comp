// shaders/frame/flow/halve.comp -- the next level of a pyramid of brightness: means of 2x2, of blurred pixels with BLUR.
//
// One invocation per pixel of coarse, r32_float as fine, with half its sides, rounded up; beyond the border of fine its last
// pixels are repeated. Source: nfru.md section 2.2.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

float pixel(ivec2 at) { return fetch_fine(inside(at, ivec2(FINE_WIDTH, FINE_HEIGHT))); }

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= COARSE_WIDTH || at.y >= COARSE_HEIGHT) return;
  float sum = 0.0;
#if BLUR
  // [1 2 1] / 4 around two neighbours each way, and their mean: [1 3 3 1] / 8.
  const vec4 weights = vec4(0.125, 0.375, 0.375, 0.125);
  for (int i = 0; i < 16; ++i) sum += weights[i % 4] * weights[i / 4] * pixel(2 * at + ivec2(i % 4, i / 4) - 1);
#else
  for (int i = 0; i < 4; ++i) sum += 0.25 * pixel(2 * at + ivec2(i & 1, i >> 1));
#endif
  store_coarse(at, sum);
}
