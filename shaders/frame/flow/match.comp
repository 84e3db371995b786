// shaders/frame/flow/match.comp -- a level of the search: where in the newest frame each pixel of the previous one is now.
//
// One invocation per pixel of found (rg16_float, pixels of this level, from the previous frame to the newest). The flow of the
// level above, twice as long, is where the search begins (COARSEST: at rest), rounded to whole pixels; 49 offsets around it are
// compared by the sum of absolute differences over 5x5, the first of equal ones, from the middle outwards. One step of Lucas
// and Kanade over the border of the 5x5 gives the fraction, unless the picture is flat or the step is a pixel or more.
// Source: nfru.md section 2.2, where the newest picture is warped by the flow above instead of the search's start being moved.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const ivec2 kSize = ivec2(FOUND_WIDTH, FOUND_HEIGHT);
const int kReach = 3, kRadius = 2, kSide = 2 * (kReach + kRadius) + 1;

float before_at(ivec2 at) { return fetch_before(inside(at, kSize)); }
float after_at(ivec2 at) { return fetch_after(inside(at, kSize)); }

/// Rings around the middle, each from its upper left corner in rows: what is nearer wins a tie.
ivec2 offset_of(int i) {
  if (i == 0) return ivec2(0);
  const int ring = i < 9 ? 1 : i < 25 ? 2 : 3;
  const int k = i - (2 * ring - 1) * (2 * ring - 1), side = 2 * ring + 1;
  if (k < side) return ivec2(k - ring, -ring);
  if (k >= side + 2 * (side - 2)) return ivec2(k - side - 2 * (side - 2) - ring, ring);
  return ivec2((k - side) % 2 == 0 ? -ring : ring, (k - side) / 2 - ring + 1);
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kSize.x || at.y >= kSize.y) return;
#if COARSEST
  const ivec2 start = ivec2(0);
#else
  const ivec2 above_size = ivec2(ABOVE_WIDTH, ABOVE_HEIGHT);
  const Bilinear b = bilinear_at((vec2(at) + 0.5) / vec2(2 * above_size), above_size);
  vec2 flow = vec2(0.0);
  for (int i = 0; i < 4; ++i) flow += bilinear_weight(b.part, i) * xy_of(fetch_above(bilinear_texel(b, i, above_size)));
  const ivec2 start = ivec2(floor(2.0 * flow + 0.5));
#endif
  float block[25];
  for (int i = 0; i < 25; ++i) block[i] = before_at(at + ivec2(i % 5, i / 5) - kRadius);
  float window[kSide * kSide];
  for (int i = 0; i < kSide * kSide; ++i)
    window[i] = after_at(at + start + ivec2(i % kSide, i / kSide) - kReach - kRadius);
  float least = 1e30;
  ivec2 best = ivec2(0);
  for (int i = 0; i < 49; ++i) {
    const ivec2 offset = offset_of(i);
    const int corner = (offset.y + kReach) * kSide + offset.x + kReach;
    float sum = 0.0;
    for (int k = 0; k < 25; ++k) sum += abs(block[k] - window[corner + k / 5 * kSide + k % 5]);
    if (sum < least) {
      least = sum;
      best = offset;
    }
  }
  // Gradients of the newest picture at the place that was found.
  const ivec2 place = at + start + best;
  float xx = 0.0, xy = 0.0, yy = 0.0, xt = 0.0, yt = 0.0;
  for (int i = 0; i < 25; ++i) {
    const ivec2 k = ivec2(i % 5, i / 5) - kRadius;
    if (max(abs(k.x), abs(k.y)) < kRadius) continue;
    const ivec2 p = place + k;
    const float gx = 0.5 * (after_at(p + ivec2(1, 0)) - after_at(p - ivec2(1, 0)));
    const float gy = 0.5 * (after_at(p + ivec2(0, 1)) - after_at(p - ivec2(0, 1)));
    const float gt = block[i] - after_at(p);
    xx += gx * gx;
    xy += gx * gy;
    yy += gy * gy;
    xt += gx * gt;
    yt += gy * gt;
  }
  const float determinant = xx * yy - xy * xy;
  vec2 part = vec2(0.0);
  if (determinant > 1e-7) {
    part = vec2(yy * xt - xy * yt, xx * yt - xy * xt) / determinant;
    if (any(greaterThanEqual(abs(part), vec2(1.0)))) part = vec2(0.0);
  }
  store_found(at, half2(vec2(start + best) + part));
}
