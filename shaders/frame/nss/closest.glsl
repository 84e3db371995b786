// shaders/frame/nss/closest.glsl -- the closest depth around each texel of a 2x2 tile. Expects the image `depth`.
//
// Offsets of a window lie in [-1, CLOSEST_LAST] on both axes; the centre wins a tie, then the first in rows. Windows of
// neighbours overlap, so a tile reads each depth once, and a window is the closest of its rows' closest.

const int kWindow = CLOSEST_LAST + 2;  // texels a side
const int kReach = kWindow + 1;        // of the two windows of a tile

struct Closest {
  float depth;
  ivec2 at;  // render texel
};

/// base: upper left texel of the tile; [y][x].
void closest_in_tile(ivec2 base, out Closest closest[2][2]) {
  // Away from the camera, whichever way depth runs.
  const float away = params.reverse_depth != 0 ? -1.0 : 1.0;
  float row_best[kReach][2], middle[2][2];
  int row_x[kReach][2];
  [[unroll]] for (int y = 0; y < kReach; ++y) {
    float row[kReach];
    [[unroll]] for (int x = 0; x < kReach; ++x)
      row[x] = away * imageLoad(depth, inside(base + ivec2(x, y) - 1, kRender)).r;
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
