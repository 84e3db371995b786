// Finds out which workgroups of the passes run: those near a tile that is marked, and of what a pass writes into
// histories, which workgroup's part has to be copied from the frame before: those that did not run, but in one of
// the last frames, or all; the first time with FIRST_COPY. An invocation looks at one workgroup of the pass that gl_WorkGroupID.y counts.
//
// Tables: of each pass ENTRY_WORDS words: columns and rows of workgroups; its list (all ones for none: it runs as a
// whole); the grid; the word of its command; the list and the command of the copy (all ones for none); for how many
// frames a copy is needed, all ones for all; where Kept has for how many frames it still is; and where the tiles
// that count stand: column by column, then row by row, begin | end << 16.
layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = FREE_BINDING, std430) readonly buffer Tables { uint d[]; } tables;
layout(set = 0, binding = FREE_BINDING + 1, std430) buffer Kept { uint d[]; } kept;
layout(set = 0, binding = FREE_BINDING + 2, std430) buffer Work { uint d[]; } work;

#define CHANGES work
#include "tiles_changed.glsl"

const uint kNone = 0xffffffffu;

void set_grid(uint command, uint x, uint y, uint z) {
  work.d[command + 1u] = y;
  work.d[command + 2u] = z;
  if (x > 0u) work.d[command] = x;
}

void main() {
  uint entry = gl_WorkGroupID.y * ENTRY_WORDS, own = gl_GlobalInvocationID.x;
  uint columns = tables.d[entry], rows = tables.d[entry + 1u], list = tables.d[entry + 2u];
  if (own >= columns * rows) return;
  uint command = tables.d[entry + 6u], copies = tables.d[entry + 7u], copy_command = tables.d[entry + 8u];
  uint frames = tables.d[entry + 9u], age_at = tables.d[entry + 10u] + own, at = tables.d[entry + 11u];
  bool runs = is_changed(0u, ROW_WORDS, tables.d[at + own % columns], tables.d[at + columns + own / columns]);
  bool is_whole = list == kNone;
  if (own == 0u) {
    uvec3 grid = uvec3(tables.d[entry + 3u], tables.d[entry + 4u], tables.d[entry + 5u]);
    set_grid(command, is_whole && runs ? grid.x : 0u, is_whole ? grid.y : 1u, is_whole ? grid.z : 1u);
    if (copies != kNone) set_grid(copy_command, 0u, 1u, 1u);
  }
  if (runs && !is_whole) work.d[list + atomicAdd(work.d[command], 1u)] = own;
  if (copies == kNone) return;
  uint age = kept.d[age_at];
  if (!runs && age < frames) work.d[copies + atomicAdd(work.d[copy_command], 1u)] = own | (age == 0u ? FIRST_COPY : 0u);
  kept.d[age_at] = runs ? 0u : min(age, frames - 1u) + 1u;
}
