// shaders/frame/nss/scatter.comp -- carries depth to where it was a frame ago: pass b of NSS v1.
//
// One invocation per block of BLOCK x BLOCK render texels takes the closest depth of the block, with the motion there,
// and writes it, as scatter_code says, to the texels around the block's earlier position whose bilinear weight exceeds
// 0.1; the closest wins. The result stands for the depth buffer of the frame before, which nobody has to keep.
// The block's middle moves, not the texel that was chosen: so what stands still stays in its block.
// Source: nss.md section 2.4 b.
#version 450
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, r32f) readonly uniform image2D depth;  // of check.comp
layout(set = 0, binding = 1) uniform texture2D motion;
layout(set = 0, binding = 2, r32ui) uniform uimage2D scatter;

const ivec2 kScatter = ivec2(SCATTER_WIDTH, SCATTER_HEIGHT);

void main() {
  const ivec2 block = ivec2(gl_GlobalInvocationID.xy);
  if (block.x >= kScatter.x || block.y >= kScatter.y) return;
  ivec2 from = block * BLOCK;
  float closest = imageLoad(depth, from).r;
  [[unroll]] for (int i = 1; i < BLOCK * BLOCK; ++i) {
    const ivec2 at = block * BLOCK + ivec2(i % BLOCK, i / BLOCK);
    if (any(greaterThanEqual(at, kRender))) continue;
    const float d = imageLoad(depth, at).r;
    if (closer(d, closest)) {
      closest = d;
      from = at;
    }
  }
  const vec2 uv = (vec2(block) + 0.5) / vec2(kScatter) - motion_at(motion, from, kRender, 0.1);
  const uint code = scatter_code(uint(closest * 2147483647.0));
  const Bilinear b = bilinear_at(uv, kScatter);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 to = b.base + ivec2(i & 1, i >> 1);
    if (bilinear_weight(b.part, i) <= 0.1 || any(lessThan(to, ivec2(0))) || any(greaterThanEqual(to, kScatter)))
      continue;
    imageAtomicMax(scatter, to, code);
  }
}
