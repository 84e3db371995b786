// shaders/frame/nss/scattered.glsl -- the depth clip of NSS v1, against the scattered depth. Source: nss.md section 2.2.

/// 1 where what is seen at view distance z was hidden a frame ago, at uv. The image `scatter` is as scatter.comp leaves it.
float disoccluded(vec2 uv, float z, float tolerance) {
  const ivec2 size = ivec2(SCATTER_WIDTH, SCATTER_HEIGHT);
  const Bilinear b = bilinear_at(uv, size);
  vec2 sum = vec2(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = b.base + ivec2(i & 1, i >> 1);
    const bool is_inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size));
    const float before = float(scatter_code(imageLoad(scatter, inside(at, size)).r)) / 2147483647.0;
    sum += depth_clip_tap(bilinear_weight(b.part, i), is_inside, z, view_z(before), tolerance);
  }
  return depth_clip(sum);
}
