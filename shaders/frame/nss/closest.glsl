// shaders/frame/nss/closest.glsl -- the closest depth around each texel of a 2x2 tile, of which base.x is even.
// Expects the image `depth`.
//
// Offsets of a window lie in [-1, 2] on both axes; the centre wins a tie, then the first in rows. Windows of
// neighbours overlap, so a tile reads each depth once, and a window is the closest of its rows' closest.

const int kWindow = 4;  // texels a side
const int kReach = 5;   // of the two windows of a tile
const int kLastFour = (COLOR_WIDTH - 1) / 4;  // of a row's texels, four by four

struct Closest {
  float depth;
  ivec2 at;  // render texel
};

/// Depths from texel at.x - 1 on, at.x even: they lie in two fetches, from the second or from the fourth of the first on; and
/// that of texel at.x - 2.
void depth_row(ivec2 at, out float row[kReach], out float left) {
  const int first = (at.x - 1) >> 2;
  float a[4], b[4];
  fetch4_depth(ivec2(max(first, 0), at.y), a);
  fetch4_depth(ivec2(min(first + 1, kLastFour), at.y), b);
  const bool late = (at.x & 2) == 0;
  const float depths[kReach] = float[kReach](late ? a[3] : a[1], late ? b[0] : a[2], late ? b[1] : a[3],
                                             late ? b[2] : b[0], late ? b[3] : b[1]);
  left = finite_depth(late ? a[2] : a[0]);
  // Beyond the border the last texel counts again.
  row[1] = finite_depth(depths[1]);
  row[0] = at.x == 0 ? row[1] : finite_depth(depths[0]);
  [[unroll]] for (int x = 2; x < kReach; ++x)
    row[x] = at.x + x - 1 < COLOR_WIDTH ? finite_depth(depths[x]) : row[x - 1];
}

void depth_row(ivec2 at, out float row[kReach]) {
  float left;
  depth_row(at, row, left);
}

#if STILL
/// Also the closest depth of 3x3 blocks of 2x2 texels around the tile, as scatter.comp leaves it of what stands still; [y][x].
/// Blocks beyond the border are anything.
void closest_in_tile(ivec2 base, out Closest closest[2][2], out uint blocks[3][3]) {
#else
/// base: upper left texel of the tile; [y][x].
void closest_in_tile(ivec2 base, out Closest closest[2][2]) {
#endif
  // Away from the camera, whichever way depth runs.
  const float away = params.reverse_depth != 0 ? -1.0 : 1.0;
  float row_best[kReach][2], middle[2][2];
  int row_x[kReach][2];
#if STILL
  float pairs[6][3];  // the closest of two side by side
  [[unroll]] for (int y = -1; y < kReach; ++y) {
#else
  [[unroll]] for (int y = 0; y < kReach; ++y) {
#endif
    float row[kReach], left;
    depth_row(ivec2(base.x, clamp(base.y + y - 1, 0, COLOR_HEIGHT - 1)), row, left);
    [[unroll]] for (int x = 0; x < kReach; ++x) row[x] *= away;
#if STILL
    pairs[y + 1] = float[3](min(away * left, row[0]), min(row[1], row[2]), min(row[3], row[4]));
    if (y < 0) continue;
#endif
    [[unroll]] for (int lane = 0; lane < 2; ++lane) {
      row_best[y][lane] = row[lane];
      row_x[y][lane] = lane;
      [[unroll]] for (int x = 1; x < kWindow; ++x) {
        const float other = row[lane + x];
        row_x[y][lane] = other < row_best[y][lane] ? lane + x : row_x[y][lane];
        row_best[y][lane] = other < row_best[y][lane] ? other : row_best[y][lane];
      }
      if (y == 1 || y == 2) middle[y - 1][lane] = row[lane + 1];
    }
  }
#if STILL
  [[unroll]] for (int y = 0; y < 3; ++y)
    [[unroll]] for (int x = 0; x < 3; ++x)
      blocks[y][x] = scatter_code(uint(away * min(pairs[2 * y][x], pairs[2 * y + 1][x]) * 2147483647.0));
#endif
  [[unroll]] for (int line = 0; line < 2; ++line) {
    [[unroll]] for (int lane = 0; lane < 2; ++lane) {
      float best = row_best[line][lane];
      ivec2 at = ivec2(row_x[line][lane], line);
      [[unroll]] for (int y = 1; y < kWindow; ++y) {
        const float other = row_best[line + y][lane];
        at = other < best ? ivec2(row_x[line + y][lane], line + y) : at;
        best = other < best ? other : best;
      }
      at = best < middle[line][lane] ? at : ivec2(lane, line) + 1;
      closest[line][lane] = Closest(away * best, inside(base + at - 1, kRender));
    }
  }
}
