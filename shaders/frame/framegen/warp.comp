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
// Colours of both frames are mixed as square roots, near to what an eye sees: a bright thing that flickers keeps its hue.
// What the frames have at the pixel itself counts, too, with its four neighbours, since a single pixel is alike by chance. Where
// colours of both frames are mixed it is weighed against the motion's by the inverse square of how much they differ; what is
// alike, has contrast and ought to move is taken whatever the motion finds: a text on the screen has no motion vectors and
// stays while the camera turns. Source: ours; the paper leaves overlays to be drawn later.
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
/// How much the pixels of what is no smooth surface differ at least.
const float kContrast = 0.1;

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

/// A pixel without motion: the most that it and the four beside it differ between the frames, and the most that they differ
/// among each other.
struct Resting {
  float unrest, contrast;
};

Resting resting_at(ivec2 at) {
  float unrest = 0.0;
  vec3 least = vec3(1.0), most = vec3(0.0);
  [[unroll]] for (int i = 0; i < 5; ++i) {
    const ivec2 to = inside(at + ivec2(int(i == 1) - int(i == 2), int(i == 3) - int(i == 4)), kOutput);
    const vec3 color = mapped(fetch_shown(to));
    unrest = max(unrest, difference(color, mapped(fetch_previous_shown(to))));
    least = min(least, color);
    most = max(most, color);
  }
  return Resting(unrest, difference(least, most));
}

/// Whether that is a thing on the screen although what lies there moves.
bool stays(Resting here, vec2 uv) {
  const vec2 motion = xy_of(fetch_dilated_motion(texel_at(uv))) * vec2(kOutput);
  return here.unrest < 2.0 * kSameColor && here.contrast > kContrast && dot(motion, motion) > 1.0;
}

#if !AHEAD
/// Two colours mixed.
vec3 between(vec3 a, vec3 b, float t) {
  const vec3 root = mix(sqrt(karis_inverse(a)), sqrt(karis_inverse(b)), t);
  return karis(root * root);
}

/// The share that `b` has against `a`, two colours of frames that differ by these.
float share_of(float a, float b) {
  const float by_a = kSameColor + a, by_b = kSameColor + b;
  return by_a * by_a / (by_a * by_a + by_b * by_b);
}
#endif

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
  bool is_mixed = false;
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
      taken = Taken(between(previous.color, newest.color, params.time), newest.pixel, params.time == 1.0 && newest.whole);
      is_mixed = true;
    }
  }
  if (params.time < 1.0) {
    const Resting here = resting_at(at);
    const HALF4 before = fetch_previous_shown(at), now = fetch_shown(at);
    const vec3 color = between(mapped(before), mapped(now), params.time);
    if (stays(here, uv)) {
      taken = Taken(color, now, now == before);
      apart = 0.0;
    } else if (is_mixed) {
      taken.color = between(taken.color, color, share_of(apart, here.unrest));
      apart = min(apart, here.unrest);
    }
  }
#if FLOW
  const vec2 flow = flow_at(uv), before = uv - params.time * flow, now = uv + (1.0 - params.time) * flow;
  if (apart > 0.0 && params.time < 1.0 && on_screen(before) && on_screen(now)) {
    const vec3 c0 = previous_at(before).color, c1 = newest_at(now).color;
    const float share = share_of(apart, difference(c0, c1));
    taken = Taken(between(taken.color, between(c0, c1, params.time), share), newest.pixel, false);
  }
#endif
#else
  if (stays(resting_at(at), uv)) taken = Taken(mapped(fetch_shown(at)), fetch_shown(at), true);
#endif
  if (taken.whole)
    store_output(at, taken.pixel);
  else
    store_output(at, half4(min(karis_inverse(taken.color) / params.exposure, kMaxColor)));
}
