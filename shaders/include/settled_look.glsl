// Looks at what the host gave of each tile of the picture: an invocation hashes a tile of all images, and counts the frames
// in a row in which it was what it was when the frame last had this phase, while what is shown came to rest. It marks
// the tile if these are too few. look_at(tile), which calls look() for all texels, is the includer's.
//
// Kept, behind the phases: of each tile a count, which is 0 where it changed, then a 1 where what is shown rests, then,
// phase by phase, the hash, two words. Work: marks, a bit a tile.
layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = FREE_BINDING, std430) buffer Kept { uint d[]; } kept;
layout(set = 0, binding = FREE_BINDING + 1, std430) buffer Work { uint d[]; } work;

uvec2 hash = uvec2(0x243f6a88u, 0x85a308d3u);

void look(uint word) {
  hash = (hash ^ word) * uvec2(0x9e3779b1u, 0x85ebca77u);
  hash ^= hash >> uvec2(15, 13);
}
void look(uvec2 words) {
  look(words.x);
  look(words.y);
}
void look(ivec4 codes) {
  for (int i = 0; i < 4; ++i) look(uint(codes[i]));
}
void look(float value) { look(floatBitsToUint(value)); }
void look(vec2 values) { look(floatBitsToUint(values)); }
void look(vec4 values) {
  look(values.xy);
  look(values.zw);
}

void look_at(ivec2 tile);

void main() {
  uint tile = gl_GlobalInvocationID.x;
  if (tile >= TILES) return;
  uint column = tile % COLUMNS, row = tile / COLUMNS;
  look_at(ivec2(column, row));
  uint at = HASHES + 2u * (kept.d[1] * TILES + tile), count = kept.d[COUNTS + tile];
  bool repeats = kept.d[2] == 0u && kept.d[at] == hash.x && kept.d[at + 1u] == hash.y;
  kept.d[at] = hash.x;
  kept.d[at + 1u] = hash.y;
  count = !repeats ? 0u : kept.d[RESTS + tile] == 0u ? 1u : min(count + 1u, uint(SETTLED));
  kept.d[COUNTS + tile] = count;
  if (count < SETTLED) atomicOr(work.d[row * ROW_WORDS + column / 32u], 1u << (column & 31u));
}
