// shaders/frame/nss/pre_v1.comp -- the network's input: pass d of NSS v1.
//
// Writes the tensor "input", int8 NHWC [1, h, w, 12] with h and w padded to multiples of 8, padding mirrored:
//   0-2 history, reprojected, Karis    3-5 current colour without jitter, Karis    6 speed of motion
//   7-10 feedback, reprojected         11 instability
// and the new state of the instability; and what the post pass would compute again for each of its pixels: `dilated`,
// the motion where the closest depth is.
// An invocation takes 2x2 render texels, whose neighbourhoods overlap.
// SIDE 1 (HIGH): a network texel is a render texel; an invocation makes 2x2.
// SIDE 2 (MID, LOW): it is 2x2 of them, each reprojected for itself; disocclusion comes from disocclusion.comp.
// STILL: histories lie under the texel, and there is no `dilated`. What scatter.comp would leave are the blocks' own closest
// depths, which SIDE 1 finds itself; with SIDE 2 they are what they are held against, so that nothing is disoccluded.
// Source: nss.md sections 1.1, 2.4 d; tools/train/nss_passes.py computes the same.
#version 450
#include "common.glsl"
#include "instability.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
#include "warped.glsl"
#if SIDE == 1 || !STILL
#include "closest.glsl"
#endif
#if SIDE == 1
#include "scattered.glsl"
#endif

const ivec2 kPadded = ivec2(INPUT_WIDTH, INPUT_HEIGHT);
const ivec2 kNetwork = (kRender + SIDE - 1) / SIDE;

HALF4 color_texel(ivec2 at) { return fetch_color(inside(at, kRender)); }
vec3 exposed_color(HALF4 texel) { return exposed(finite_color(rgb_of(texel)), params.exposure); }

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
  uint state;
};

/// What is read of feedback and state around a place of the network's picture: they have the same texels. The feedback is the
/// tensor "temporal" of one frame back.
struct Kept {
  Bilinear at;
  ivec4 feedback[4];
  SNORM4 state[4];
};

#if STILL
/// What the filters give at the middle of a texel.
void fetch_kept(ivec2 at, out Kept kept) {
  kept.at = Bilinear(at, vec2(0.0));
  kept.feedback[0] = codes_temporal(at.y * kPadded.x + at.x);
  kept.state[0] = fetch_state(at);
  [[unroll]] for (int i = 1; i < 4; ++i) {
    kept.feedback[i] = kept.feedback[0];
    kept.state[i] = kept.state[0];
  }
}
#endif
/// before: uv of the frame before, in the network's picture without padding; rests: nothing moved.
void fetch_kept(vec2 before, bool rests, out Kept kept) {
  kept.at = bilinear_at(before * vec2(kNetwork) / vec2(kPadded), kPadded, rests);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(kept.at, i, kPadded);
    kept.feedback[i] = codes_temporal(at.y * kPadded.x + at.x);
    kept.state[i] = fetch_state(at);
  }
}

/// now: exposed; around: differences of work colours.
Texel network_texel(vec3 past, vec2 moved, Kept kept, bool hidden, vec3 now, vec3 work, vec4 around) {
  const float unit = length(1.0 / vec2(kRender));
  const float speed = sqrt((clamp(length(moved), unit, 200.0 * unit) - unit) * (1.0 / (199.0 * unit)));
  vec4 fed = vec4(0.0), old_state = vec4(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const float weight = bilinear_weight(kept.at.part, i);
    fed += weight * vec4(kept.feedback[i] - TEMPORAL_ZERO_POINT);
    old_state += weight * snorm_of(kept.state[i]);
  }
  fed *= hidden ? 0.0 : not_reset() * float(TEMPORAL_SCALE);
  Texel texel;
  vec4 next;
  const float flicker = instability(work, around, old_state * not_reset(), hidden, next);
  texel.state = snorm_word(next);
  const vec3 shown = karis(now);
  past *= not_reset();
  texel.words[0] = pack4(past.r, past.g, past.b, shown.r);
  texel.words[1] = pack4(shown.g, shown.b, speed, fed.x);
  texel.words[2] = pack4(fed.y, fed.z, fed.w, flicker);
  return texel;
}

#if STILL
/// The history around render texel `at`, which no motion leads elsewhere.
SAMPLED_HALF4 still_history(ivec2 at) {
#if SHALE_LINEAR && IS_DOUBLE
  SAMPLED_HALF4 s;
  s.part = vec2(0.5);
  [[unroll]] for (int y = 0; y < 2; ++y) {
    HALF4 two[2];
    fetch2_history(inside(ivec2(at.x, 2 * at.y + y), ivec2(COLOR_WIDTH, OUTPUT_HEIGHT)), two);
    s.texels[2 * y] = two[0];
    s.texels[2 * y + 1] = two[1];
  }
  return s;
#elif SHALE_LINEAR
  const Bilinear b = bilinear_at((vec2(at) + 0.5) / vec2(kRender), kOutput);
  SAMPLED_HALF4 s;
  s.part = b.part;
  [[unroll]] for (int i = 0; i < 4; ++i) s.texels[i] = fetch_history(bilinear_texel(b, i, kOutput));
  return s;
#else
  return sample_history((vec2(at) + 0.5) / vec2(kRender));
#endif
}
#else
/// The history at uv. At other ratios than 2 a texel's place has no fraction to settle on.
SAMPLED_HALF4 past_at(vec2 uv, bool rests) {
#if SHALE_LINEAR
  const Bilinear b = bilinear_at(uv, kOutput, rests && IS_DOUBLE);
  SAMPLED_HALF4 s;
  s.part = b.part;
  [[unroll]] for (int i = 0; i < 4; ++i) s.texels[i] = fetch_history(bilinear_texel(b, i, kOutput));
  return s;
#else
  return sample_history(uv);
#endif
}

/// raw: as the host gave it.
vec2 texel_motion(ivec2 at, out HALF2 raw) {
  raw = fetch_motion(at);
  return long_motion(xy_of(raw), kRender, 0.1);
}

void keep_motion(ivec2 first, HALF2 raw[2][2]) {
  [[unroll]] for (int y = 0; y < 2; ++y)
    if (first.y + y < COLOR_HEIGHT) store2_dilated(first + ivec2(0, y), raw[y][0], raw[y][1]);
}
#endif

#if SIDE == 1
void main() {
  const ivec2 first = 2 * ivec2(invocation());
  if (first.x >= kPadded.x || first.y >= kPadded.y) return;
  // In the padding the tile shows its texels in reverse order, or, at an odd border, the last texel twice.
  const ivec2 from = mirrored(first, kNetwork), to = mirrored(first + 1, kNetwork);
  const ivec2 base = min(from, to);

  // Fetches that wait for nothing come first, then those that wait for the closest depth, for motion; all of them before
  // any use, so that many are under way at once.
  const vec2 place = -clamp(params.jitter, -0.5, 0.5);
  const ivec2 shift = ivec2(floor(place));
  const vec2 part = place - vec2(shift);
  HALF4 words[5][5];
  [[unroll]] for (int y = 0; y < 5; ++y)
    [[unroll]] for (int x = 0; x < 5; ++x)
      if ((x != 0 && x != 4) || (y != 0 && y != 4)) words[y][x] = color_texel(base + shift + ivec2(x, y) - 1);
  Closest closest[2][2];
  vec2 moved[2][2];
  SAMPLED_HALF4 past[2][2];
  Bilinear scattered_at[2][2];
  uint codes[2][2][4];
  Kept kept[2][2];
#if STILL
  uint blocks[3][3];
  closest_in_tile(base, closest, blocks);
#else
  HALF2 raw[2][2];
  closest_in_tile(base, closest);
#endif
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x)
#if STILL
      moved[y][x] = vec2(0.0);
#else
      moved[y][x] = texel_motion(closest[y][x].at, raw[y][x]);
#endif
  [[unroll]] for (int y = 0; y < 2; ++y) {
    [[unroll]] for (int x = 0; x < 2; ++x) {
      const ivec2 at = base + ivec2(x, y);
      const vec2 before = (vec2(at) + 0.5) / vec2(kRender) - moved[y][x];
      const bool rests = moved[y][x] == vec2(0.0);
      scattered_at[y][x] = bilinear_at(before, kScattered, rests);
#if STILL
      past[y][x] = still_history(at);
      block_codes(blocks, scattered_at[y][x].base - (base / 2 - 1), codes[y][x]);
      fetch_kept(at, kept[y][x]);
#else
      past[y][x] = past_at(before, rests);
      fetch_scattered(scattered_at[y][x], codes[y][x]);
      fetch_kept(before, rests, kept[y][x]);
#endif
    }
  }

  // Without jitter all texels lie at the same place between four samples: exposed colours around the tile, bilinear
  // between them, and the work colours of the tile with its four sides.
  vec3 samples[5][5];
  [[unroll]] for (int y = 0; y < 5; ++y)
    [[unroll]] for (int x = 0; x < 5; ++x)
      if ((x != 0 && x != 4) || (y != 0 && y != 4)) samples[y][x] = exposed_color(words[y][x]);
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
      const float z = view_z(closest[y][x].depth);
      const bool hidden = disoccluded(scattered_at[y][x], codes[y][x], z, 0.0) > 0.01;
      // A neighbour beyond the border is the texel itself.
      const vec3 own = work[y + 1][x + 1];
      const vec4 around = vec4(at.y > 0 ? color_distance(own, work[y][x + 1]) : 0.0,
                               at.y < kRender.y - 1 ? color_distance(own, work[y + 2][x + 1]) : 0.0,
                               at.x < kRender.x - 1 ? color_distance(own, work[y + 1][x + 2]) : 0.0,
                               at.x > 0 ? color_distance(own, work[y + 1][x]) : 0.0);
      texels[y][x] = network_texel(warped(past[y][x]), moved[y][x], kept[y][x], hidden,
                                   now[y + 1][x + 1], own, around);
    }
  }
#if !STILL
  if (all(equal(first, base))) keep_motion(first, raw);
#endif
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
    const int two = (line * kPadded.x + first.x) / 2;
    const uvec3 l = uvec3(left.words[0], left.words[1], left.words[2]);
    const uvec3 r = uvec3(right.words[0], right.words[1], right.words[2]);
    const uvec3 a = turned ? r : l, b = turned ? l : r;
    store_words2_input(two * 3, a.x, a.y);
    store_words2_input(two * 3 + 1, a.z, b.x);
    store_words2_input(two * 3 + 2, b.y, b.z);
    store2_state(ivec2(first.x, line), turned ? right.state : left.state, turned ? left.state : right.state);
  }
}
#else
/// Current colour of a network texel, without jitter, exposed.
vec3 current(ivec2 at) {
  const vec2 uv = (vec2(inside(at, kNetwork)) + 0.5) / vec2(kNetwork);
  const Bilinear b = bilinear_at(uv - clamp(params.jitter, -0.5, 0.5) / vec2(kRender), kRender);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * exposed_color(color_texel(b.base + ivec2(i & 1, i >> 1)));
  return sum;
}

void main() {
  const ivec2 padded = ivec2(invocation());
  if (padded.x >= kPadded.x || padded.y >= kPadded.y) return;
  const ivec2 at = mirrored(padded, kNetwork);
  const vec2 uv = (vec2(at) + 0.5) / vec2(kNetwork);

  vec3 past = vec3(0.0);
  vec2 moved = vec2(0.0);  // of the closest lane
#if STILL
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x) past += 0.25 * warped(still_history(inside(2 * at + ivec2(x, y), kRender)));
#else
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
  float nearest = 0.0;
  HALF2 raw[2][2];
  [[unroll]] for (int y = 0; y < 2; ++y) {
    [[unroll]] for (int x = 0; x < 2; ++x) {
      const ivec2 lane = inside(2 * at + ivec2(x, y), kRender);
      const vec2 lane_moved = texel_motion(closest[y][x].at, raw[y][x]);
      past += 0.25 * warped(past_at((vec2(lane) + 0.5) / vec2(kRender) - lane_moved, lane_moved == vec2(0.0)));
      const bool leads = (x == 0 && y == 0) || away * closest[y][x].depth < away * nearest;
      nearest = leads ? closest[y][x].depth : nearest;
      moved = leads ? lane_moved : moved;
    }
  }
  if (all(lessThan(padded, kNetwork))) keep_motion(2 * at, raw);
#endif
  const vec3 now = current(at), work = work_color(now);
  const vec4 around = vec4(color_distance(work, work_color(current(at + ivec2(0, -1)))),
                           color_distance(work, work_color(current(at + ivec2(0, 1)))),
                           color_distance(work, work_color(current(at + ivec2(1, 0)))),
                           color_distance(work, work_color(current(at + ivec2(-1, 0)))));
  Kept kept;
#if STILL
  fetch_kept(at, kept);
  const bool hidden = false;
#else
  fetch_kept(uv - moved, moved == vec2(0.0), kept);
  const bool hidden = sample_disocclusion(uv) > 0.01;
#endif
  const Texel texel = network_texel(past, moved, kept, hidden, now, work, around);
  const int word = (padded.y * kPadded.x + padded.x) * 3;
  [[unroll]] for (int i = 0; i < 3; ++i) store_word_input(word + i, texel.words[i]);
  store_state(padded, texel.state);
}
#endif
