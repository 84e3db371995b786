// shaders/frame/framegen/baseline.comp -- pictures between frames, or beyond them, by methods that the others are measured against.
//
// One invocation per output pixel. METHOD 0 repeats the frame that is on the screen at `time`; 1 mixes both frames by time as a
// display shows them; 2 follows the newest frame's motion at the pixel itself, without a splat and without regard to depth.
// AHEAD: of the newest frame alone. Source: frame_generation.md section 6.
#version 450
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;
#include "displayed.glsl"

const ivec2 kOutput = ivec2(OUTPUT_WIDTH, OUTPUT_HEIGHT);

#if METHOD == 2
bool on_screen(vec2 uv) { return all(greaterThanEqual(uv, vec2(0.0))) && all(lessThan(uv, vec2(1.0))); }

#define TAKE(fetch)                                                    \
  const Bilinear b = bilinear_at(uv, kOutput);                         \
  vec3 sum = vec3(0.0);                                                \
  [[unroll]] for (int i = 0; i < 4; ++i)                               \
    sum += bilinear_weight(b.part, i) * displayed(rgb_of(fetch(bilinear_texel(b, i, kOutput)))); \
  return sum;
vec3 newest_at(vec2 uv) { TAKE(fetch_shown) }
#if !AHEAD
vec3 previous_at(vec2 uv) { TAKE(fetch_previous_shown) }
#endif
#endif

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kOutput.x || at.y >= kOutput.y) return;
#if METHOD == 0
#if AHEAD
  store_output(at, fetch_shown(at));
#else
  store_output(at, params.frames < 2 || params.time >= 1.0 ? fetch_shown(at) : fetch_previous_shown(at));
#endif
#else
  if (params.frames < 2) {
    store_output(at, fetch_shown(at));
    return;
  }
#if METHOD == 1
  const vec3 newest = displayed(rgb_of(fetch_shown(at))), previous = displayed(rgb_of(fetch_previous_shown(at)));
  const vec3 result = mix(previous, newest, params.time);
#else
  const ivec2 motion_size = ivec2(DILATED_MOTION_WIDTH, DILATED_MOTION_HEIGHT);
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const vec2 m = xy_of(fetch_dilated_motion((2 * at + 1) * motion_size / (2 * kOutput)));
  const vec2 there = uv + (1.0 - params.time) * m;
  vec3 result = newest_at(there);
#if !AHEAD
  const vec2 before = uv - params.time * m;
  if (on_screen(before)) {
    const vec3 previous = previous_at(before);
    result = on_screen(there) ? mix(previous, result, params.time) : previous;
  }
#endif
#endif
  store_output(at, half4(linear_of(result)));
#endif
}
