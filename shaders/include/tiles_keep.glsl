// Copies the tiles of a list, those that changed, to where the network reads them. A workgroup is a tile, of all images.
#include "int8.glsl"

layout(local_size_x = LOCAL_X) in;

layout(set = 0, binding = 0, std430) readonly buffer Now { UNIT d[]; } now;
layout(set = 0, binding = 1, std430) writeonly buffer Kept { UNIT d[]; } kept;
layout(set = 0, binding = 2, std430) readonly buffer Work { uint d[]; } work;

void main() {
  int tile = int(work.d[LIST + gl_WorkGroupID.x]);
  int first = tile % COLUMNS * TILE_UNITS, top = tile / COLUMNS * TILE_ROWS;
  for (int image = 0; image < IMAGES; ++image)
    for (int i = int(gl_LocalInvocationID.x); i < TILE_ROWS * TILE_UNITS; i += LOCAL_X) {
      int x = first + i % TILE_UNITS, y = top + i / TILE_UNITS;
      if (x < ROW_UNITS && y < HEIGHT) {
        int at = (image * HEIGHT + y) * ROW_UNITS + x;
        kept.d[at] = now.d[at];
      }
    }
}
