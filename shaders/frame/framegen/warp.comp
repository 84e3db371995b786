// shaders/frame/framegen/warp.comp -- the picture at `time`, of the two frames' pixels that the splatted motion leads to.
//
// One invocation per output pixel. Colours are shown (rgba16_float, linear), of the newest frame and the previous one, read by
// Catmull-Rom in the exposed Karis domain, within the range of what it reads: past a bright edge it would reach 1, which stands
// for infinity there. A pixel that is met in its middle stays as it is, so that what does not move does
// not change. Between the frames both are weighed: the one that is on the screen; the one whose depth is that of the thing that
// was splatted (of a pixel without one the farther, for the other is still covered); of equal colours the frame nearer in
// time; else both by time. AHEAD of the newest frame it alone has
// colours. Where no texel was splatted: the previous frame's motion at the pixel, evenly; AHEAD the newest frame's,
// unless that leads to what is nearer, then none. With a single frame the picture is that frame.
// FLOW: two more samples where the flow leads; where those of the motion differ, each pair counts by the inverse square of
// its own difference, so that what has no motion vectors is found by its looks. Source: nfru.md sections 3.3 and 6.
// Source: Mob-FGSR (SIGGRAPH 2024), seed_networks.md sections 4.2 to 4.4; relative depth: frame_generation.md section 1.
#version 450
#ifndef FLOW
#define FLOW 0
#endif
#include "common.glsl"
#include "parabola.glsl"
#include "places.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const float kSameColor = 0.01;
/// What a colour of one frame alone is trusted as: as if the other one differed by so much.
const float kAlone = 0.05;

/// A colour, and the pixel whose it is if `whole`.
struct Taken {
  vec3 color;
  HALF4 pixel;
  bool whole;
};

vec3 mapped(HALF4 pixel) { return karis(exposed(rgb_of(pixel), params.exposure)); }

#define TAKE(fetch)                                                                                  \
  const vec2 place = uv * vec2(kOutput) - 0.5;                                                       \
  const ivec2 middle = inside(ivec2(floor(place + 0.5)), kOutput);                                   \
  const HALF4 pixel = fetch(middle);                                                                 \
  if (all(lessThan(abs(place - vec2(middle)), vec2(1.0 / 512.0)))) return Taken(mapped(pixel), pixel, true); \
  const Bilinear b = bilinear_at(uv, kOutput);                                                       \
  const vec4 wx = catmull_rom(b.part.x), wy = catmull_rom(b.part.y);                                 \
  vec3 sum = vec3(0.0), least = vec3(1.0), most = vec3(0.0);                                          \
  [[unroll]] for (int i = 0; i < 16; ++i) {                                                          \
    const vec3 color = mapped(fetch(inside(b.base + ivec2(i % 4, i / 4) - 1, kOutput)));             \
    sum += wx[i % 4] * wy[i / 4] * color;                                                            \
    least = min(least, color);                                                                       \
    most = max(most, color);                                                                         \
  }                                                                                                  \
  return Taken(clamp(sum, least, most), pixel, false);

Taken newest_at(vec2 uv) { TAKE(fetch_shown) }
#if !AHEAD
Taken previous_at(vec2 uv) { TAKE(fetch_previous_shown) }
#endif

float difference(vec3 a, vec3 b) { return dot(abs(a - b), vec3(0.5, 1.0, 0.5)); }

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kOutput.x || at.y >= kOutput.y) return;
  if (params.frames < 2) {
    store_output(at, fetch_shown(at));
    return;
  }
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Places p = places(uv, (2 * at + 1) * kRender / (2 * kOutput));
  const Taken newest = newest_at(p.now);
  Taken taken = newest;
#if !AHEAD
  float apart = kAlone;  // how much the two colours differ
  if (on_screen(p.before)) {
    const Taken previous = previous_at(p.before);
    const float z0 = view_z(fetch_previous_depth(texel_at(p.before)));
    const float z1 = view_z(fetch_dilated_depth(texel_at(p.now)));
    const float z = p.depth < 0.0 ? max(z0, z1) : view_z(p.depth);
    const bool seen_before = same_depth(z0, z), seen_now = same_depth(z1, z);
    if (!on_screen(p.now)) {
      taken = previous;
    } else if (seen_before != seen_now) {
      if (seen_before) taken = previous;
    } else if (difference(newest.color, previous.color) < kSameColor) {
      apart = 0.0;
      if (params.time < 0.5) taken = previous;
    } else {
      apart = difference(newest.color, previous.color);
      taken = Taken(mix(previous.color, newest.color, params.time), newest.pixel, params.time == 1.0 && newest.whole);
    }
  }
#if FLOW
  const vec2 flow = flow_at(uv), before = uv - params.time * flow, now = uv + (1.0 - params.time) * flow;
  if (apart > 0.0 && params.time < 1.0 && on_screen(before) && on_screen(now)) {
    const vec3 c0 = previous_at(before).color, c1 = newest_at(now).color;
    const float by_motion = kSameColor + apart, by_flow = kSameColor + difference(c0, c1);
    const float share = by_motion * by_motion / (by_motion * by_motion + by_flow * by_flow);
    taken = Taken(mix(taken.color, mix(c0, c1, params.time), share), newest.pixel, false);
  }
#endif
#endif
  if (taken.whole)
    store_output(at, taken.pixel);
  else
    store_output(at, half4(min(karis_inverse(taken.color) / params.exposure, kMaxColor)));
}
