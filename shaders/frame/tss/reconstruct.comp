// shaders/frame/tss/reconstruct.comp -- pass 1 of TSS: the closest depth of 3x3 and its motion, and where that was.
//
// One invocation per render texel; the centre wins a tie. The dilated depth goes to the texels around its earlier position
// whose bilinear weight exceeds 0.01, the closest wins: `before` stands for the depth of the frame before, which nobody has
// to keep. dilated_depth is r32_float as the host gives it, dilated_motion rg16_float in uv.
// Source: the public description of FidelityFX Super Resolution 2, "reconstruct and dilate".
#version 450
#include "../nss/common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  ivec2 from = at;
  float closest = finite_depth(fetch_depth(at));
  [[unroll]] for (int i = 0; i < 9; ++i) {
    if (i == 4) continue;
    const ivec2 neighbour = inside(at + ivec2(i % 3, i / 3) - 1, kRender);
    const float depth = finite_depth(fetch_depth(neighbour));
    from = closer(depth, closest) ? neighbour : from;
    closest = closer(depth, closest) ? depth : closest;
  }
  const vec2 motion = finite_motion(xy_of(fetch_motion(from)));
  store_dilated_depth(at, closest);
  store_dilated_motion(at, half2(motion));
  const uint code = scatter_code(uint(closest * 2147483647.0));
  const Bilinear b = bilinear_at((vec2(at) + 0.5) / vec2(kRender) - motion, kRender);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 to = b.base + ivec2(i & 1, i >> 1);
    if (bilinear_weight(b.part, i) > 0.01 && all(greaterThanEqual(to, ivec2(0))) && all(lessThan(to, kRender)))
      max_before(to, code);
  }
}
