// Finds out where what is shown came to rest: where the mean of a tile changed by no more than LIMIT display codes since the
// frame before. Single pixels go on changing with the jitter; what brightens or darkens does not rest. An invocation takes a tile that repeats what it was and was made anew; of what was not made, what is
// known still holds. The image is `shown`, and `past` in the frame before.
#include "color.glsl"

layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = FREE_BINDING, std430) buffer Kept { uint d[]; } kept;
layout(set = 0, binding = FREE_BINDING + 1, std430) readonly buffer Work { uint d[]; } work;

vec3 codes(HALF4 texel) {
  vec3 c = finite_color(rgb_of(texel)) * EXPOSURE;
  return 255.0 * sqrt(c / (1.0 + largest(c)));
}

/// A mark of the tile or of one around it.
bool is_near_mark(int column, int row) {
  bool found = false;
  for (int y = max(row - 1, 0); y <= min(row + 1, ROWS - 1); ++y)
    for (int x = max(column - 1, 0); x <= min(column + 1, COLUMNS - 1); ++x)
      found = found || (work.d[y * ROW_WORDS + x / 32] >> (x & 31) & 1u) != 0u;
  return found;
}

void main() {
  int tile = int(gl_GlobalInvocationID.x);
  if (tile >= TILES) return;
  int column = tile % COLUMNS, row = tile / COLUMNS;
  bool repeats = kept.d[COUNTS + tile] != 0u, is_made = is_near_mark(column, row);
  ivec2 size = ivec2(SHOWN_WIDTH, SHOWN_HEIGHT), render = ivec2(RENDER_WIDTH, RENDER_HEIGHT);
  ivec2 first = ivec2(column, row) * ivec2(TILE_WIDTH, TILE_HEIGHT);
  ivec2 begin = first * size / render, end = min(first + ivec2(TILE_WIDTH, TILE_HEIGHT), render) * size / render;
  if (!repeats || !is_made) end.y = begin.y;
  vec3 sum = vec3(0.0);
  for (int y = begin.y; y < end.y; ++y)
    for (int x = begin.x / 2; 2 * x < end.x; ++x) {
      HALF4 now[2], before[2];
      fetch2_shown(ivec2(x, y), now);
      fetch2_past(ivec2(x, y), before);
      for (int i = 0; i < 2; ++i) sum += 2 * x + i < end.x ? codes(now[i]) - codes(before[i]) : vec3(0.0);
    }
  ivec2 extent = end - begin;
  bool rests = all(lessThanEqual(abs(sum), vec3(LIMIT * float(extent.x * extent.y))));
  if (!repeats)
    kept.d[RESTS + tile] = 0u;
  else if (is_made)
    kept.d[RESTS + tile] = rests ? 1u : 0u;
}
