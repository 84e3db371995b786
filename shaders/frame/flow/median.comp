// shaders/frame/flow/median.comp -- takes out flow that stands alone: the median of 3x3, of each component.
//
// One invocation per pixel of cleaned, rg16_float as found. Source: nfru.md section 2.2.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const ivec2 kSize = ivec2(FOUND_WIDTH, FOUND_HEIGHT);

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kSize.x || at.y >= kSize.y) return;
  vec2 v[9];
  [[unroll]] for (int i = 0; i < 9; ++i) v[i] = xy_of(fetch_found(inside(at + ivec2(i % 3, i / 3) - 1, kSize)));
  // Half a selection sort: the fifth is in its place then.
  [[unroll]] for (int i = 0; i < 5; ++i)
    [[unroll]] for (int k = i + 1; k < 9; ++k) {
      const vec2 low = min(v[i], v[k]), high = max(v[i], v[k]);
      v[i] = low;
      v[k] = high;
    }
  store_cleaned(at, half2(v[4]));
}
