// shaders/frame/nss/pre_v1.comp -- the network's input: pass d of NSS v1.
//
// Writes the tensor "input", int8 NHWC [1, h, w, 12] with h and w padded to multiples of 8, padding mirrored:
//   0-2 history, reprojected, Karis    3-5 current colour without jitter, Karis    6 speed of motion
//   7-10 feedback, reprojected         11 instability
// and the new state of the instability; and what the post pass would compute again for each of its pixels: `dilated`,
// the motion where the closest depth is. Colour and depth come from check.comp.
// An invocation takes 2x2 render texels, whose neighbourhoods overlap.
// SIDE 1 (HIGH): a network texel is a render texel; an invocation makes 2x2.
// SIDE 2 (MID, LOW): it is 2x2 of them, each reprojected for itself; disocclusion comes from disocclusion.comp.
// Source: nss.md sections 1.1, 2.4 d; tools/train/nss_passes.py computes the same.
#version 450
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"
#include "instability.glsl"

#if SIDE == 1
#define WORDS uvec2  // two texels are three of them
#else
#define WORDS uint
#endif

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, rgba16f) readonly uniform image2D color;
layout(set = 0, binding = 1, r32f) readonly uniform image2D depth;
layout(set = 0, binding = 2) uniform texture2D motion;
HISTORY_IMAGE(3, history, rgba16f);    // one frame back
HISTORY_IMAGE(4, state, rgba8_snorm);  // one frame back
layout(set = 0, binding = 5) uniform itextureBuffer feedback;  // the tensor "temporal" of one frame back
layout(set = 0, binding = 7, std430) writeonly buffer InputTensor { WORDS words[]; } network_input;
layout(set = 0, binding = 8, rgba8_snorm) writeonly uniform image2D new_state;
layout(set = 0, binding = 9, rg16f) writeonly uniform image2D dilated;
#include "warped.glsl"
#define CLOSEST_LAST 2
#include "closest.glsl"
#if SIDE == 1
layout(set = 0, binding = 6, r32ui) readonly uniform uimage2D scatter;
#include "scattered.glsl"
#else
layout(set = 0, binding = 6, r8) readonly uniform image2D disocclusion;
#endif

const ivec2 kPadded = ivec2(INPUT_WIDTH, INPUT_HEIGHT);
const ivec2 kNetwork = (kRender + SIDE - 1) / SIDE;

vec3 exposed_texel(ivec2 at) { return exposed(imageLoad(color, inside(at, kRender)).rgb, params.exposure); }

uint code(float value) {
  const int q = int(floor(value * (1.0 / float(INPUT_SCALE)) + 0.5)) + INPUT_ZERO_POINT;
  return uint(clamp(q, -128, 127)) & 255u;
}

uint pack4(float a, float b, float c, float d) {
  return whole(code(a) | code(b) << 8 | code(c) << 16 | code(d) << 24);
}

/// What a network texel leaves.
struct Texel {
  uint words[3];
  vec4 state;
};

/// before: uv of the frame before, in the network's picture without padding. now: exposed; around: differences of work
/// colours.
Texel network_texel(vec3 past, vec2 moved, vec2 before, bool hidden, vec3 now, vec3 work, vec4 around) {
  const float unit = length(1.0 / vec2(kRender));
  const float speed = sqrt((clamp(length(moved), unit, 200.0 * unit) - unit) * (1.0 / (199.0 * unit)));
  // Feedback and state have the same texels.
  const Bilinear b = bilinear_at(before * vec2(kNetwork) / vec2(kPadded), kPadded);
  vec4 fed = vec4(0.0), old_state = vec4(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b, i, kPadded);
    const float weight = bilinear_weight(b.part, i);
    fed += weight * vec4(texelFetch(feedback, at.y * kPadded.x + at.x) - TEMPORAL_ZERO_POINT);
    old_state += weight * HISTORY_TEXEL(state, at);
  }
  fed *= hidden ? 0.0 : not_reset() * float(TEMPORAL_SCALE);
  Texel texel;
  const float flicker = instability(work, around, old_state * not_reset(), hidden, texel.state);
  const vec3 shown = karis(now);
  past *= not_reset();
  texel.words[0] = pack4(past.r, past.g, past.b, shown.r);
  texel.words[1] = pack4(shown.g, shown.b, speed, fed.x);
  texel.words[2] = pack4(fed.y, fed.z, fed.w, flicker);
  return texel;
}

vec2 texel_motion(ivec2 at, out vec2 raw) {
  raw = texelFetch(motion, at, 0).rg;
  return long_motion(raw, kRender, 0.1);
}

#if SIDE == 1
void main() {
  const ivec2 first = 2 * ivec2(gl_GlobalInvocationID.xy);
  if (first.x >= kPadded.x || first.y >= kPadded.y) return;
  // In the padding the tile shows its texels in reverse order, or, at an odd border, the last texel twice.
  const ivec2 from = mirrored(first, kNetwork), to = mirrored(first + 1, kNetwork);
  const ivec2 base = min(from, to);

  Closest closest[2][2];
  closest_in_tile(base, closest);

  // Without jitter all texels lie at the same place between four samples: exposed colours around the tile, bilinear
  // between them, and the work colours of the tile with its four sides.
  const vec2 place = -clamp(params.jitter, -0.5, 0.5);
  const ivec2 shift = ivec2(floor(place));
  const vec2 part = place - vec2(shift);
  vec3 samples[5][5];
  [[unroll]] for (int y = 0; y < 5; ++y)
    [[unroll]] for (int x = 0; x < 5; ++x)
      if ((x != 0 && x != 4) || (y != 0 && y != 4)) samples[y][x] = exposed_texel(base + shift + ivec2(x, y) - 1);
  vec3 now[4][4], work[4][4];
  [[unroll]] for (int y = 0; y < 4; ++y) {
    [[unroll]] for (int x = 0; x < 4; ++x) {
      if ((x == 0 || x == 3) && (y == 0 || y == 3)) continue;
      now[y][x] = mix(mix(samples[y][x], samples[y][x + 1], part.x),
                      mix(samples[y + 1][x], samples[y + 1][x + 1], part.x), part.y);
      work[y][x] = work_color(now[y][x]);
    }
  }

  Texel texels[2][2];
  [[unroll]] for (int y = 0; y < 2; ++y) {
    [[unroll]] for (int x = 0; x < 2; ++x) {
      const ivec2 at = base + ivec2(x, y);
      vec2 raw;
      const vec2 moved = texel_motion(closest[y][x].at, raw);
      const vec2 before = (vec2(at) + 0.5) / vec2(kRender) - moved;
      const bool hidden = disoccluded(before, view_z(closest[y][x].depth), 0.0) > 0.01;
      // A neighbour beyond the border is the texel itself.
      const vec3 own = work[y + 1][x + 1];
      const vec4 around = vec4(at.y > 0 ? color_distance(own, work[y][x + 1]) : 0.0,
                               at.y < kRender.y - 1 ? color_distance(own, work[y + 2][x + 1]) : 0.0,
                               at.x < kRender.x - 1 ? color_distance(own, work[y + 1][x + 2]) : 0.0,
                               at.x > 0 ? color_distance(own, work[y + 1][x]) : 0.0);
      texels[y][x] = network_texel(history_at(before), moved, before, hidden, now[y + 1][x + 1], own, around);
      if (at.x < kRender.x && at.y < kRender.y && all(equal(first, base))) imageStore(dilated, at, vec4(raw, 0.0, 0.0));
    }
  }
#if COLOR_WIDTH % 2 == 1
  if (from.x == to.x) texels[0][1] = texels[0][0], texels[1][1] = texels[1][0];
#endif
#if COLOR_HEIGHT % 2 == 1
  if (from.y == to.y) texels[1] = texels[0];
#endif
  [[unroll]] for (int y = 0; y < 2; ++y) {
    const bool turned = from.x > to.x;
    const int line = from.y > to.y ? first.y + 1 - y : first.y + y;
    const Texel left = texels[y][0], right = texels[y][1];
    const int word = (line * kPadded.x + first.x) / 2 * 3;
    const uvec3 l = uvec3(left.words[0], left.words[1], left.words[2]);
    const uvec3 r = uvec3(right.words[0], right.words[1], right.words[2]);
    const uvec3 a = turned ? r : l, b = turned ? l : r;
    network_input.words[word] = a.xy;
    network_input.words[word + 1] = uvec2(a.z, b.x);
    network_input.words[word + 2] = b.yz;
    imageStore(new_state, ivec2(turned ? first.x + 1 : first.x, line), left.state);
    imageStore(new_state, ivec2(turned ? first.x : first.x + 1, line), right.state);
  }
}
#else
/// Current colour of a network texel, without jitter, exposed.
vec3 current(ivec2 at) {
  const vec2 uv = (vec2(inside(at, kNetwork)) + 0.5) / vec2(kNetwork);
  const Bilinear b = bilinear_at(uv - clamp(params.jitter, -0.5, 0.5) / vec2(kRender), kRender);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * exposed_texel(b.base + ivec2(i & 1, i >> 1));
  return sum;
}

float disocclusion_at(vec2 uv) {
  const ivec2 size = ivec2(DISOCCLUSION_WIDTH, DISOCCLUSION_HEIGHT);
  const Bilinear b = bilinear_at(uv, size);
  float sum = 0.0;
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * imageLoad(disocclusion, bilinear_texel(b, i, size)).r;
  return sum;
}

void main() {
  const ivec2 padded = ivec2(gl_GlobalInvocationID.xy);
  if (padded.x >= kPadded.x || padded.y >= kPadded.y) return;
  const ivec2 at = mirrored(padded, kNetwork);
  const vec2 uv = (vec2(at) + 0.5) / vec2(kNetwork);

  Closest closest[2][2];
  closest_in_tile(2 * at, closest);
  // At an odd border the tile's second column or row is its first.
#if COLOR_WIDTH % 2 == 1
  if (2 * at.x + 1 == kRender.x) closest[0][1] = closest[0][0], closest[1][1] = closest[1][0];
#endif
#if COLOR_HEIGHT % 2 == 1
  if (2 * at.y + 1 == kRender.y) closest[1] = closest[0];
#endif
  const float away = params.reverse_depth != 0 ? -1.0 : 1.0;
  vec3 past = vec3(0.0);
  vec2 moved = vec2(0.0);  // of the closest lane
  float nearest = 0.0;
  [[unroll]] for (int y = 0; y < 2; ++y) {
    [[unroll]] for (int x = 0; x < 2; ++x) {
      const ivec2 lane = inside(2 * at + ivec2(x, y), kRender);
      vec2 raw;
      const vec2 lane_moved = texel_motion(closest[y][x].at, raw);
      past += 0.25 * history_at((vec2(lane) + 0.5) / vec2(kRender) - lane_moved);
      const bool leads = (x == 0 && y == 0) || away * closest[y][x].depth < away * nearest;
      nearest = leads ? closest[y][x].depth : nearest;
      moved = leads ? lane_moved : moved;
      // At an odd border some are written twice, alike.
      if (all(lessThan(padded, kNetwork))) imageStore(dilated, lane, vec4(raw, 0.0, 0.0));
    }
  }
  const vec3 now = current(at), work = work_color(now);
  const vec4 around = vec4(color_distance(work, work_color(current(at + ivec2(0, -1)))),
                           color_distance(work, work_color(current(at + ivec2(0, 1)))),
                           color_distance(work, work_color(current(at + ivec2(1, 0)))),
                           color_distance(work, work_color(current(at + ivec2(-1, 0)))));
  const Texel texel = network_texel(past, moved, uv - moved, disocclusion_at(uv) > 0.01, now, work, around);
  const int word = (padded.y * kPadded.x + padded.x) * 3;
  [[unroll]] for (int i = 0; i < 3; ++i) network_input.words[word + i] = texel.words[i];
  imageStore(new_state, padded, texel.state);
}
#endif
