// Marks the tiles of a tensor that differ from the copy of what was last made from them: an invocation compares
// a tile, of all images, and sets its bit. A workgroup is LOCAL_X tiles of a row of tiles. With TOLERANCE above 0
// the tensor is of int8, and codes may differ by so much.
#include "int8.glsl"

layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = 0, std430) readonly buffer Now { UNIT d[]; } now;
layout(set = 0, binding = 1, std430) readonly buffer Kept { UNIT d[]; } kept;
layout(set = 0, binding = 2, std430) buffer Changes { uint d[]; } changes;

#if UNIT_BYTES == 1
int difference(int a, int b) { return abs(a - b) > TOLERANCE ? 1 : 0; }
#define ACCUMULATOR int
#define IS_SET(bits) (bits != 0)
#else
uint difference(uint a, uint b) {
#if TOLERANCE == 0
  return a ^ b;
#else
  uint beyond = 0u;
  for (int lane = 0; lane < 32; lane += 8)
    beyond |= abs(bitfieldExtract(int(a), lane, 8) - bitfieldExtract(int(b), lane, 8)) > TOLERANCE ? 1u : 0u;
  return beyond;
#endif
}
#if UNIT_BYTES == 4
#define ACCUMULATOR uint
#define IS_SET(bits) (bits != 0u)
#else
uvec4 difference(uvec4 a, uvec4 b) {
  return uvec4(difference(a.x, b.x), difference(a.y, b.y), difference(a.z, b.z), difference(a.w, b.w));
}
#define ACCUMULATOR uvec4
#define IS_SET(bits) any(notEqual(bits, uvec4(0u)))
#endif
#endif

void main() {
  int column = int(gl_GlobalInvocationID.x), row = int(gl_WorkGroupID.y);
  if (column >= COLUMNS) return;
  int first = column * TILE_UNITS, last = min(first + TILE_UNITS, ROW_UNITS);
  ACCUMULATOR bits = ACCUMULATOR(0);
  for (int image = 0; image < IMAGES; ++image)
    for (int y = row * TILE_ROWS; y < min((row + 1) * TILE_ROWS, HEIGHT); ++y) {
      int line = (image * HEIGHT + y) * ROW_UNITS;
      for (int i = first; i < last; ++i)
        bits |= difference(ACCUMULATOR(now.d[line + i]), ACCUMULATOR(kept.d[line + i]));
    }
  if (IS_SET(bits)) atomicOr(changes.d[FIRST_WORD + row * ROW_WORDS + column / 32], 1u << (column & 31));
}
