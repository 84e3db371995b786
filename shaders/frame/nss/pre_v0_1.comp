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
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform utextureBuffer color;     // two texels a fetch
layout(set = 0, binding = 1) uniform utextureBuffer depth;     // four texels a fetch
layout(set = 0, binding = 2) uniform utextureBuffer motion;    // a texel a fetch
layout(set = 0, binding = 3) uniform utextureBuffer history;   // one frame back
layout(set = 0, binding = 4) uniform utextureBuffer luma;      // one frame back, two texels a fetch
layout(set = 0, binding = 5) uniform utextureBuffer dilated;   // one frame back
layout(set = 0, binding = 6) uniform itextureBuffer feedback;  // of one frame back
// In pairs of words: two texels of the tensor are three, of the images one; of the luma they are a word.
layout(set = 0, binding = 7, std430) writeonly buffer InputTensor { PAIR words[]; } network_input;
layout(set = 0, binding = 8, std430) writeonly buffer NewLuma { uint words[]; } new_luma;
layout(set = 0, binding = 9, std430) writeonly buffer NewDilated { PAIR depths[]; } new_dilated;
layout(set = 0, binding = 10, std430) writeonly buffer Moving { PAIR halves[]; } moving;
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
  Bilinear history, depth, network;
  uvec2 past[4];
  float depths[4];
  ivec4 feedback[4];
  vec2 luma[4];
};

void fetch_before(vec2 uv, out Before b) {
  b.history = bilinear_at(uv, kOutput);
  b.depth = bilinear_at(uv - params.previous_jitter / vec2(kRender), kRender);
  b.network = bilinear_at(uv * vec2(kRender) / vec2(kPadded), kPadded);
  fetch_history(b.history, b.past);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b.depth, i, kRender);
    b.depths[i] = uintBitsToFloat(texelFetch(dilated, at.y * DILATED_PITCH + at.x).r);
  }
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b.network, i, kPadded);
    b.feedback[i] = texelFetch(feedback, at.y * kPadded.x + at.x);
    const uint codes = texelFetch(luma, (at.y * LUMA_PITCH + at.x) / 2).r >> 16 * (at.x & 1);
    b.luma[i] = vec2(codes & 255u, codes >> 8 & 255u) * (1.0 / 255.0);
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
  uint luma;
};

Texel network_texel(vec3 now, vec2 moved, float z, Before b) {
  float hidden = params.reset == 0 ? disoccluded(b, z) : 0.0;
  // A learned constant of the source: fewer false alarms where little moves.
  if (length(moved * vec2(kRender)) <= 0.5) hidden *= 0.725223958;
  const vec3 past = warped(b.history, b.past) * not_reset();
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
  const uvec2 codes = uvec2(floor(clamp(vec2(level, y), 0.0, 1.0) * 255.0 + 0.5));
  texel.luma = codes.x | codes.y << 8;
  return texel;
}

void main() {
  const ivec2 first = ivec2(2, 1) * ivec2(gl_GlobalInvocationID.xy);
  if (first.x >= kPadded.x || first.y >= kPadded.y) return;
  // In the padding the two lie in reverse order, or, at an odd border, the last one twice.
  const ivec2 from = mirrored(first, kRender), to = mirrored(first + ivec2(1, 0), kRender);
  const ivec2 base = min(from, to);
  const uvec4 colors = texelFetch(color, (base.y * RAW_COLOR_PITCH + base.x) / 2);
  float rows[3][kReach];
  [[unroll]] for (int y = 0; y < 3; ++y) depth_row(ivec2(base.x, clamp(base.y + y - 1, 0, COLOR_HEIGHT - 1)), rows[y]);
  Closest closest[2];
  uint raw[2];
  vec2 moved[2];
  Before before[2];
  [[unroll]] for (int x = 0; x < 2; ++x) {
    closest[x] = closest_of(base, rows, x);
    raw[x] = texelFetch(motion, closest[x].at.y * RAW_MOTION_PITCH + closest[x].at.x).r;
  }
  [[unroll]] for (int x = 0; x < 2; ++x) {
    moved[x] = long_motion(unpackHalf2x16(raw[x]), kRender, 0.1);
    fetch_before((vec2(base + ivec2(x, 0)) + 0.5) / vec2(kRender) - moved[x], before[x]);
  }
  Texel texels[2];
  [[unroll]] for (int x = 0; x < 2; ++x)
    texels[x] = network_texel(karis_of(finite_color(half_rgb(x == 0 ? colors.xy : colors.zw))), moved[x],
                              view_z(closest[x].depth), before[x]);
  const bool turned = from.x > to.x;
  const Texel last = from.x == to.x ? texels[0] : texels[1];
  uint words[6];
  [[unroll]] for (int i = 0; i < 3; ++i) {
    words[i] = turned ? last.words[i] : texels[0].words[i];
    words[3 + i] = turned ? texels[0].words[i] : last.words[i];
  }
  const int two = (first.y * kPadded.x + first.x) / 2;
  [[unroll]] for (int i = 0; i < 3; ++i) network_input.words[two * 3 + i] = pair(words[2 * i], words[2 * i + 1]);
  new_luma.words[(first.y * LUMA_PITCH + first.x) / 2] =
      whole(turned ? last.luma | texels[0].luma << 16 : texels[0].luma | last.luma << 16);
  if (any(notEqual(first, base))) return;
  new_dilated.depths[(first.y * DILATED_PITCH + first.x) / 2] =
      pair(floatBitsToUint(closest[0].depth), floatBitsToUint(closest[1].depth));
  moving.halves[(first.y * MOVING_PITCH + first.x) / 2] = pair(raw[0], raw[1]);
}
