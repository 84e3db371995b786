// shaders/frame/nss/disocclusion.comp -- disocclusion at a quarter of the render size: pass c of NSS v1 MID and LOW.
//
// One invocation per texel of disocclusion (r8), a block of 4x4 render texels: the depth clip of the block's closest
// texel, with the range of view depth in the block as tolerance. Source: nss.md section 2.4 c.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
#include "block.glsl"
#include "scattered.glsl"

void main() {
  const ivec2 at = ivec2(invocation());
  if (at.x >= DISOCCLUSION_WIDTH || at.y >= DISOCCLUSION_HEIGHT) return;
  const Block block = block_at(at);
  const vec2 uv = (vec2(at) + 0.5) / vec2(DISOCCLUSION_WIDTH, DISOCCLUSION_HEIGHT);
  const float z = view_z(block.closest);
  const vec2 moved = block_motion(block);
  const Bilinear b = bilinear_at(uv - moved, kScattered, moved == vec2(0.0));
  uint codes[4];
  fetch_scattered(b, codes);
  store_disocclusion(at, disoccluded(b, codes, z, view_z(block.farthest) - z));
}
