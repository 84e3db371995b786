// Finds the cells that a changed tile reaches: an invocation looks at one cell of the dispatch that gl_WorkGroupID.y
// counts, and puts it into the dispatch's list. A dispatch without a list has one cell, and runs as a whole.
//
// Changes: a word that is 0 but where all has to run, then a bit for each tile.
// Tables: of each input the first word of its changes and the words of a row of tiles; of each dispatch ENTRY_WORDS
// words: columns and rows of cells, the list (all ones for none), the grid, and where its tiles stand: of each input
// those that a column of cells reaches, column by column, then row by row, begin | end << 16.
// Work: of each dispatch its command and a word that is not used, then the lists.
layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = 0, std430) readonly buffer Tables { uint d[]; } tables;
layout(set = 0, binding = 1, std430) readonly buffer Changes { uint d[]; } changes;
layout(set = 0, binding = 2, std430) buffer Work { uint d[]; } work;

#define CHANGES changes
#include "tiles_changed.glsl"

void main() {
  uint entry = 2u * INPUTS + gl_WorkGroupID.y * ENTRY_WORDS, cell = gl_GlobalInvocationID.x;
  uint columns = tables.d[entry], rows = tables.d[entry + 1u], list = tables.d[entry + 2u];
  if (cell >= columns * rows) return;
  uint at = tables.d[entry + 6u], command = 4u * gl_WorkGroupID.y;
  bool runs = changes.d[0] != 0u;  // what is made of constants alone runs then only
  for (uint i = 0u; i < INPUTS; ++i, at += columns + rows)
    runs = runs || is_changed(tables.d[2u * i], tables.d[2u * i + 1u], tables.d[at + cell % columns],
                              tables.d[at + columns + cell / columns]);
  if (cell == 0u) {
    work.d[command + 1u] = tables.d[entry + 4u];
    work.d[command + 2u] = tables.d[entry + 5u];
  }
  if (!runs) return;
  if (list == 0xffffffffu)
    work.d[command] = tables.d[entry + 3u];
  else
    work.d[list + atomicAdd(work.d[command], 1u)] = cell;
}
