// Follows what is shown to its mean over a cycle of the jitter: of each pixel that was made, in a tile that rests for n
// frames, how far the mean of these frames lies from the last of them. What a tile shows while it stays as it is is that mean:
// any one frame of the cycle is further from the truth. A workgroup takes what one of the pass did that made it.
//
// Means: of each pixel three halves. They hold differences, so that the error of 32 roundings is a part of what the cycle moves.
#include "color.glsl"

layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = FREE_BINDING, std430) readonly buffer Kept { uint d[]; } kept;
layout(set = 0, binding = FREE_BINDING + 1, std430) readonly buffer Work { uint d[]; } work;
layout(set = 0, binding = FREE_BINDING + 2, std430) buffer Means { uvec2 d[]; } means;

ivec2 tile_of(ivec2 at) {
  return at * ivec2(RENDER_WIDTH, RENDER_HEIGHT) / ivec2(SHOWN_WIDTH, SHOWN_HEIGHT) / ivec2(TILE_WIDTH, TILE_HEIGHT);
}
uint count_of(ivec2 tile) { return kept.d[COUNTS + tile.y * COLUMNS + tile.x]; }

void main() {
  int own = int(work.d[LIST + gl_WorkGroupID.x]);
  ivec2 side = ivec2(SIDE_X, SIDE_Y), begin = side * ivec2(own % LIST_COLUMNS, own / LIST_COLUMNS);
  ivec2 extent = min(begin + side, ivec2(SHOWN_WIDTH, SHOWN_HEIGHT)) - begin;
  ivec2 first = tile_of(begin), last = tile_of(begin + extent - 1);
  uint most = 0u;
  for (int y = first.y; y <= last.y; ++y)
    for (int x = first.x; x <= last.x; ++x) most = max(most, count_of(ivec2(x, y)));
  // One frame is its own mean. A loop of no turns is left at once on a CPU, too.
  int pixels = most < 2u ? 0 : extent.x * extent.y;
  for (int i = int(gl_LocalInvocationID.x); i < pixels; i += LOCAL_X) {
    ivec2 at = begin + ivec2(i % extent.x, i / extent.x);
    uint count = count_of(tile_of(at)), pixel = at.y * SHOWN_WIDTH + at.x;
    vec3 away = rgb_of(fetch_past(at)) - rgb_of(fetch_shown(at));
    if (count > 2u) away += vec3(unpackHalf2x16(means.d[pixel].x), unpackHalf2x16(means.d[pixel].y).x);
    away *= 1.0 - 1.0 / float(clamp(count, 1u, uint(SETTLED) - 1u));
    means.d[pixel] = uvec2(packHalf2x16(away.rg), packHalf2x16(vec2(away.b, 0.0)));
  }
}
