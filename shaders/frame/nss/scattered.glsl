// shaders/frame/nss/scattered.glsl -- the depth clip of NSS v1, against the scattered depth. Expects the image
// `scatter` as scatter.comp leaves it. Source: nss.md section 2.2.

const ivec2 kScattered = ivec2(SCATTER_WIDTH, SCATTER_HEIGHT);

#if STILL
/// The four codes from `at` on, 0 or 1, of 3x3 blocks.
void block_codes(uint blocks[3][3], ivec2 at, out uint codes[4]) {
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const int x = i & 1, y = i >> 1;
    const uint upper = at.x == 0 ? blocks[y][x] : blocks[y][x + 1];
    const uint lower = at.x == 0 ? blocks[y + 1][x] : blocks[y + 1][x + 1];
    codes[i] = at.y == 0 ? upper : lower;
  }
}
#else
/// The four codes around.
void fetch_scattered(Bilinear b, out uint codes[4]) {
  [[unroll]] for (int i = 0; i < 4; ++i) {
    codes[i] = fetch_scatter(bilinear_texel(b, i, kScattered));
  }
}
#endif

/// 1 where what is seen at view distance z was hidden a frame ago, at b in the scattered depth.
float disoccluded(Bilinear b, uint codes[4], float z, float tolerance) {
  vec2 sum = vec2(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = b.base + ivec2(i & 1, i >> 1);
    const bool is_inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, kScattered));
    const float before = float(scatter_code(codes[i])) * (1.0 / 2147483647.0);
    sum += depth_clip_tap(bilinear_weight(b.part, i), is_inside, z, view_z(before), tolerance);
  }
  return depth_clip(sum);
}
