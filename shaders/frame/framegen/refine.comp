// shaders/frame/framegen/refine.comp -- closes the gaps between splatted texels, and takes the previous frame's where none is left.
//
// One invocation per render texel; filled (r32_uint) is the word of splat, of a nearer neighbour, of splat_previous, or 0. What
// lies behind shows through the gaps of a surface that grew: a texel stays only if some 2x2 texels with it hold nothing
// that is nearer than it is by three percent; else the nearest neighbour covers it.
// Source: Mob-FGSR (SIGGRAPH 2024), seed_networks.md section 4.2.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

uint refined(ivec2 at) {
  const uint centre = fetch_splat(at);
#if REFINES
  bool similar[9];
  uint nearest = 0u;
  [[unroll]] for (int i = 0; i < 9; ++i) {
    const ivec2 to = at + ivec2(i % 3, i / 3) - 1;
    const bool there = all(greaterThanEqual(to, ivec2(0))) && all(lessThan(to, kRender));
    const uint word = there ? fetch_splat(to) : 0u;
    const bool is_candidate = word != 0u && (centre == 0u || is_nearer(near_of(word), near_of(centre)));
    similar[i] = there && !is_candidate;
    if (is_candidate) nearest = max(nearest, word);
  }
  bool stays = false;
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const int corner = i % 2 + 3 * (i / 2);
    stays = stays || similar[corner] && similar[corner + 1] && similar[corner + 3] && similar[corner + 4];
  }
  return stays ? centre : nearest;
#else
  return centre;
#endif
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  uint word = refined(at);
#if FILLS
  if (word == 0u) word = fetch_splat_previous(at);
#endif
  store_filled(at, word);
}
