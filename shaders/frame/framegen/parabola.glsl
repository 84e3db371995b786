// shaders/frame/framegen/parabola.glsl -- the motion m0 that goes with a texel of the newest frame.

/// The previous frame's motion where this texel was; m1 itself, that is even motion, where there is none, another thing lies
/// there, or it turned by more than half: at a stop a parabola would swing back.
vec2 motion_before(ivec2 at, vec2 m1) {
#if QUADRATIC
  const vec2 uv = (vec2(at) + 0.5) / vec2(kRender) - m1;
  if (params.frames < 3 || !on_screen(uv)) return m1;
  const ivec2 from = texel_at(uv);
  const vec2 m0 = xy_of(fetch_previous_motion(from));
  const vec2 size = vec2(kRender), now = m1 * size, change = now - m0 * size;
  const bool same = same_depth(view_z(fetch_dilated_depth(at)), view_z(fetch_previous_depth(from)));
  return same && dot(change, change) <= 0.25 * dot(now, now) ? m0 : m1;
#else
  return m1;
#endif
}
