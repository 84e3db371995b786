// shaders/frame/framegen/splat.comp -- sends every texel of the newest frame, and of the previous one, to where it is at `time`.
//
// One invocation per render texel. splat (r32_uint, zeros before) holds of each target the nearest texel of the newest frame
// that arrives; splat_previous the nearest of the previous frame, whose motion goes on evenly: it holds what the newest frame
// no longer shows, and is not there AHEAD of it. Whole words are compared, so the result does not depend on the order of invocations.
// Source: as common.glsl; the previous frame as second source: nfru.md section 3.2, here by its motion in place of the camera's.
#version 450
#include "common.glsl"
#include "parabola.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  const vec2 centre = vec2(at) + 0.5, size = vec2(kRender);
  const vec2 m1 = xy_of(fetch_dilated_motion(at));
  const vec2 place = centre + (way_to(params.time, m1, motion_before(at, m1)) - m1) * size;
  const ivec2 target = ivec2(floor(place)), way = target - at;
  if (on_screen(place / size) && all(lessThanEqual(abs(way), ivec2(kReach))))
    max_splat(inside(target, kRender), word_of(nearness(fetch_dilated_depth(at), at), 0u, inside(target, kRender) - at));
#if !AHEAD
  if (params.frames < 2) return;
  const vec2 before = centre + params.time * xy_of(fetch_previous_motion(at)) * size;
  const ivec2 seen = ivec2(floor(before));
  // What the newest frame shows too has been sent from there.
  const vec2 now = (centre + xy_of(fetch_previous_motion(at)) * size) / size;
  if (on_screen(now) && same_depth(view_z(fetch_dilated_depth(texel_at(now))), view_z(fetch_previous_depth(at)))) return;
  if (on_screen(before / size) && all(lessThanEqual(abs(seen - at), ivec2(kReach))))
    max_splat_previous(inside(seen, kRender), word_of(nearness(fetch_previous_depth(at), at), 1u, inside(seen, kRender) - at));
#endif
}
