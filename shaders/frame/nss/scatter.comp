// shaders/frame/nss/scatter.comp -- carries depth to where it was a frame ago: pass b of NSS v1.
//
// One invocation per block of BLOCK x BLOCK render texels takes the closest depth of the block, with the motion there,
// and writes it, as scatter_code says, to the texels around the block's earlier position whose bilinear weight exceeds
// 0.1; the closest wins. The result stands for the depth buffer of the frame before, which nobody has to keep.
// The block's middle moves, not the texel that was chosen: so what stands still stays in its block.
// Source: nss.md section 2.4 b.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
#include "block.glsl"

const ivec2 kScatter = ivec2(SCATTER_WIDTH, SCATTER_HEIGHT);

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kScatter.x || at.y >= kScatter.y) return;
  const Block block = block_at(at);
  const vec2 uv = (vec2(at) + 0.5) / vec2(kScatter) - block_motion(block);
  const uint code = scatter_code(uint(block.closest * 2147483647.0));
  const Bilinear b = bilinear_at(uv, kScatter);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 to = b.base + ivec2(i & 1, i >> 1);
    if (bilinear_weight(b.part, i) <= 0.1 || any(lessThan(to, ivec2(0))) || any(greaterThanEqual(to, kScatter)))
      continue;
    max_scatter(to, code);
  }
}
