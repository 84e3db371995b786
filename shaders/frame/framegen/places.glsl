// shaders/frame/framegen/places.glsl -- where the thing at a place of the picture at `time` is in the two frames, by the splatted motion
// and, with FLOW, by optical flow.
//
// Expects common.glsl, parabola.glsl, and the images that they, splat and flow_splat name. AHEAD there is no previous frame.

/// Where the pixel's thing is in the previous frame and in the newest one, in uv; its depth, below 0 if nobody knows.
struct Places {
  vec2 before, now;
  float depth;
};

/// Of what moves evenly by m.
Places evenly(vec2 uv, vec2 m, float depth) { return Places(uv - params.time * m, uv + (1.0 - params.time) * m, depth); }

Places places(vec2 uv, ivec2 at) {
  const uint word = fetch_filled(at);
  if (word != 0u) {
    const ivec2 source = inside(at - displacement_of(word), kRender);
#if !AHEAD
    if (is_previous(word)) return evenly(uv, xy_of(fetch_previous_motion(source)), fetch_previous_depth(source));
#endif
    const vec2 m1 = xy_of(fetch_dilated_motion(source));
    const vec2 from = uv - way_to(params.time, m1, motion_before(source, m1));
    return Places(from, from + m1, fetch_dilated_depth(source));
  }
#if AHEAD
  const float a = params.time - 1.0;
  const vec2 m = xy_of(fetch_dilated_motion(at));
  const float there = fetch_dilated_depth(texel_at(uv - a * m));
  return Places(uv, uv - (there >= fetch_dilated_depth(at) - 1e-5 ? a * m : vec2(0.0)), -1.0);
#else
  return evenly(uv, xy_of(fetch_previous_motion(at)), -1.0);
#endif
}

#if FLOW
/// Motion in uv from the previous frame to the newest one, of the pixel of the flow that was sent here, else of the nearest one that was
/// sent around here. Source: nfru.md section 3.2, which takes the nearest in either case.
vec2 flow_at(vec2 uv) {
  const ivec2 size = ivec2(FLOW_WIDTH, FLOW_HEIGHT), at = inside(ivec2(floor(uv * vec2(size))), size);
  const uint own = fetch_flow_splat(at);
  uint nearest = own;
  ivec2 target = at;
  [[unroll]] for (int i = 0; i < 9; ++i) {
    const ivec2 to = inside(at + ivec2(i % 3, i / 3) - 1, size);
    const uint word = fetch_flow_splat(to);
    if (own == 0u && word > nearest) {
      nearest = word;
      target = to;
    }
  }
  if (nearest == 0u) return vec2(0.0);
  return xy_of(fetch_flow(inside(target - displacement_of(nearest), size))) / vec2(size);
}
#endif
