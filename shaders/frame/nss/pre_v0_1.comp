// shaders/frame/nss/pre_v0_1.comp -- the network's input: the pre pass of NSS v0.1.
//
// Writes the tensor "input", int8 NHWC [1, h, w, 12] with h and w padded to multiples of 8, padding mirrored:
//   0-2 history, reprojected, Karis    3-5 current colour, Karis    6 disocclusion
//   7-10 feedback, reprojected         11 change of luma over time
// and the new state of the luma (rg8: change, luma); the dilated depth; and what the post pass would look for again for each
// of its pixels: `moving`, the motion where the closest depth is. An invocation makes two texels of the tensor next to each
// other.
// Source: nss.md section 2.3; tools/train/nss_passes.py computes the same. The depth of the frame before is kept as it
// was dilated, instead of being gathered through the offsets of the frame before.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
#include "closest.glsl"
#include "warped.glsl"

const ivec2 kPadded = ivec2(INPUT_WIDTH, INPUT_HEIGHT);

/// The closest depth of the 3x3 around texel x of the two; rows: as depth_row leaves them, of three lines.
Closest closest_of(ivec2 base, float rows[3][kReach], int x) {
  const float away = params.reverse_depth != 0 ? -1.0 : 1.0;
  float best = away * rows[1][x + 1];
  ivec2 offset = ivec2(0);
  [[unroll]] for (int j = 0; j < 3; ++j) {
    [[unroll]] for (int i = 0; i < 3; ++i) {
      const float other = away * rows[j][x + i];
      offset = other < best ? ivec2(i, j) - 1 : offset;
      best = other < best ? other : best;
    }
  }
  return Closest(away * best, inside(base + ivec2(x, 0) + offset, kRender));
}

/// What is read of the frame before.
struct Before {
  Bilinear depth, network;
  SAMPLED_HALF4 past;
  float depths[4];
  ivec4 feedback[4];
  vec2 luma[4];
};

void fetch_before(vec2 uv, out Before b) {
  b.depth = bilinear_at(uv - params.previous_jitter / vec2(kRender), kRender);
  b.network = bilinear_at(uv * vec2(kRender) / vec2(kPadded), kPadded);
  b.past = sample_history(uv);
  [[unroll]] for (int i = 0; i < 4; ++i) b.depths[i] = fetch_dilated(bilinear_texel(b.depth, i, kRender));
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b.network, i, kPadded);
    b.feedback[i] = codes_feedback(at.y * kPadded.x + at.x);
    b.luma[i] = fetch_luma(at);
  }
}

/// Disocclusion against the dilated depth of the frame before.
float disoccluded(Before b, float z) {
  vec2 sum = vec2(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = b.depth.base + ivec2(i & 1, i >> 1);
    const bool is_inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, kRender));
    sum += depth_clip_tap(bilinear_weight(b.depth.part, i), is_inside, z, view_z(b.depths[i]), 0.0);
  }
  return depth_clip(sum);
}

uint code(float value) {
  const int q = int(floor(value * (1.0 / float(INPUT_SCALE)) + 0.5)) + INPUT_ZERO_POINT;
  return uint(clamp(q, -128, 127)) & 255u;
}

uint pack4(float a, float b, float c, float d) {
  return whole(code(a) | code(b) << 8 | code(c) << 16 | code(d) << 24);
}

/// What a texel leaves.
struct Texel {
  uint words[3];
  vec2 luma;  // change, luma
};

Texel network_texel(vec3 now, vec2 moved, float z, Before b) {
  float hidden = params.reset == 0 ? disoccluded(b, z) : 0.0;
  // A learned constant of the source: fewer false alarms where little moves.
  if (length(moved * vec2(kRender)) <= 0.5) hidden *= 0.725223958;
  const vec3 past = warped(b.past) * not_reset();
  vec4 fed = vec4(0.0);
  vec2 kept = vec2(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const float weight = bilinear_weight(b.network.part, i) * not_reset();
    fed += weight * vec4(b.feedback[i] - FEEDBACK_ZERO_POINT);
    kept += weight * b.luma[i];
  }
  fed *= float(FEEDBACK_SCALE);
  const float y = dot(now, vec3(0.2126, 0.7152, 0.0722));
  const float difference = abs(y - kept.y);
  const float share = min(difference, 0.3) * (1.0 / 0.3);
  const float change = difference < 0.05 ? 0.0 : share * sqrt(share);
  float level = mix(kept.x, change, mix(0.1, 0.01, clamp(kept.x, 0.0, 0.3) / 0.3));
  if (hidden > 0.01) level = 0.0;
  Texel texel;
  texel.words[0] = pack4(past.r, past.g, past.b, now.r);
  texel.words[1] = pack4(now.g, now.b, hidden, fed.x);
  texel.words[2] = pack4(fed.y, fed.z, fed.w, level);
  texel.luma = vec2(level, y);
  return texel;
}

void main() {
  const ivec2 first = ivec2(2, 1) * ivec2(invocation());
  if (first.x >= kPadded.x || first.y >= kPadded.y) return;
  // In the padding the two lie in reverse order, or, at an odd border, the last one twice.
  const ivec2 from = mirrored(first, kRender), to = mirrored(first + ivec2(1, 0), kRender);
  const ivec2 base = min(from, to);
  HALF4 colors[2];
  fetch2_color(ivec2(base.x >> 1, base.y), colors);
  float rows[3][kReach];
  [[unroll]] for (int y = 0; y < 3; ++y) depth_row(ivec2(base.x, clamp(base.y + y - 1, 0, COLOR_HEIGHT - 1)), rows[y]);
  Closest closest[2];
  HALF2 raw[2];
  vec2 moved[2];
  Before before[2];
  [[unroll]] for (int x = 0; x < 2; ++x) {
    closest[x] = closest_of(base, rows, x);
    raw[x] = fetch_motion(closest[x].at);
  }
  [[unroll]] for (int x = 0; x < 2; ++x) {
    moved[x] = long_motion(xy_of(raw[x]), kRender, 0.1);
    fetch_before((vec2(base + ivec2(x, 0)) + 0.5) / vec2(kRender) - moved[x], before[x]);
  }
  Texel texels[2];
  [[unroll]] for (int x = 0; x < 2; ++x)
    texels[x] = network_texel(karis_of(finite_color(rgb_of(colors[x]))), moved[x],
                              view_z(closest[x].depth), before[x]);
  const bool turned = from.x > to.x;
  const Texel last = from.x == to.x ? texels[0] : texels[1];
  uint words[6];
  [[unroll]] for (int i = 0; i < 3; ++i) {
    words[i] = turned ? last.words[i] : texels[0].words[i];
    words[3 + i] = turned ? texels[0].words[i] : last.words[i];
  }
  const int two = (first.y * kPadded.x + first.x) / 2;
  [[unroll]] for (int i = 0; i < 3; ++i) store_words2_input(two * 3 + i, words[2 * i], words[2 * i + 1]);
  store2_luma(first, turned ? last.luma : texels[0].luma, turned ? texels[0].luma : last.luma);
  if (any(notEqual(first, base))) return;
  store2_dilated(first, closest[0].depth, closest[1].depth);
  store2_moving(first, raw[0], raw[1]);
}
