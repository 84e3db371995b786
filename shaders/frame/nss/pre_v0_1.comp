// shaders/frame/nss/pre_v0_1.comp -- the network's input: the pre pass of NSS v0.1.
//
// Writes the tensor "input", int8 NHWC [1, h, w, 12] with h and w padded to multiples of 8, padding mirrored:
//   0-2 history, reprojected, Karis    3-5 current colour, Karis    6 disocclusion
//   7-10 feedback, reprojected         11 change of luma over time
// and the new state of the luma (rg8: change, luma); the dilated depth; and what the post pass would look for again for each
// of its pixels: `moving`, the motion where the closest depth is. One invocation per texel of the tensor.
// Source: nss.md section 2.3; tools/train/nss_passes.py computes the same. The depth of the frame before is kept as it
// was dilated, instead of being gathered through the offsets of the frame before.
#version 450
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform utextureBuffer color;     // a texel a fetch; so the others
layout(set = 0, binding = 1) uniform utextureBuffer depth;
layout(set = 0, binding = 2) uniform utextureBuffer motion;
layout(set = 0, binding = 3) uniform utextureBuffer history;   // one frame back
layout(set = 0, binding = 4, rg8) readonly uniform image2D luma;  // one frame back
layout(set = 0, binding = 5) uniform utextureBuffer dilated;   // one frame back
layout(set = 0, binding = 6) uniform itextureBuffer feedback;  // of one frame back
layout(set = 0, binding = 7, std430) writeonly buffer InputTensor { uint words[]; } network_input;
layout(set = 0, binding = 8, rg8) writeonly uniform image2D new_luma;
layout(set = 0, binding = 9, std430) writeonly buffer NewDilated { float depths[]; } new_dilated;
layout(set = 0, binding = 10, std430) writeonly buffer Moving { uint halves[]; } moving;
#include "warped.glsl"

const ivec2 kPadded = ivec2(INPUT_WIDTH, INPUT_HEIGHT);

/// Disocclusion against the dilated depth of the frame before, at uv.
float disoccluded(vec2 uv, float z) {
  const Bilinear b = bilinear_at(uv, kRender);
  vec2 sum = vec2(0.0);
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = b.base + ivec2(i & 1, i >> 1);
    const bool is_inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, kRender));
    const ivec2 texel = inside(at, kRender);
    const float before = uintBitsToFloat(texelFetch(dilated, texel.y * DILATED_PITCH + texel.x).r);
    sum += depth_clip_tap(bilinear_weight(b.part, i), is_inside, z, view_z(before), 0.0);
  }
  return depth_clip(sum);
}

/// The previous frame's feedback in 0..1.
vec4 feedback_at(vec2 uv) {
  const Bilinear b = bilinear_at(uv * vec2(kRender) / vec2(kPadded), kPadded);
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b, i, kPadded);
    sum += bilinear_weight(b.part, i) * vec4(texelFetch(feedback, at.y * kPadded.x + at.x) - FEEDBACK_ZERO_POINT);
  }
  return sum * float(FEEDBACK_SCALE);
}

uint code(float value) {
  const int q = int(floor(value / float(INPUT_SCALE) + 0.5)) + INPUT_ZERO_POINT;
  return uint(clamp(q, -128, 127)) & 255u;
}

uint pack4(float a, float b, float c, float d) {
  return whole(code(a) | code(b) << 8 | code(c) << 16 | code(d) << 24);
}

void main() {
  const ivec2 padded = ivec2(gl_GlobalInvocationID.xy);
  if (padded.x >= kPadded.x || padded.y >= kPadded.y) return;
  const ivec2 at = mirrored(padded, kRender);
  const vec2 uv = (vec2(at) + 0.5) / vec2(kRender);

  float closest;
  const ivec2 from = inside(at + closest_offset(depth, RAW_DEPTH_PITCH, at, 1, closest), kRender);
  const uint raw = texelFetch(motion, from.y * RAW_MOTION_PITCH + from.x).r;
  const vec2 moved = long_motion(unpackHalf2x16(raw), kRender, 0.1);
  const vec2 before = uv - moved;
  const float z = view_z(closest);
  float hidden = 0.0;
  if (params.reset == 0) hidden = disoccluded(before - params.previous_jitter / vec2(kRender), z);
  // A learned constant of the source: fewer false alarms where little moves.
  if (length(moved * vec2(kRender)) <= 0.5) hidden *= 0.725223958;

  const Bilinear past_at = bilinear_at(before, kOutput);
  uvec2 past_words[4];
  fetch_history(past_at, past_words);
  const vec3 past = warped(past_at, past_words) * not_reset();
  const vec3 now = karis_of(finite_color(half_rgb(texelFetch(color, at.y * RAW_COLOR_PITCH + at.x).rg)));
  const vec4 fed = feedback_at(before) * not_reset();

  const float y = dot(now, vec3(0.2126, 0.7152, 0.0722));
  const Bilinear b = bilinear_at(before * vec2(kRender) / vec2(kPadded), kPadded);
  vec2 kept = vec2(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    kept += not_reset() * bilinear_weight(b.part, i) * imageLoad(luma, bilinear_texel(b, i, kPadded)).rg;
  const float difference = abs(y - kept.y);
  const float change = difference < 0.05 ? 0.0 : pow(min(difference, 0.3) / 0.3, 1.5);
  float level = mix(kept.x, change, mix(0.1, 0.01, clamp(kept.x, 0.0, 0.3) / 0.3));
  if (hidden > 0.01) level = 0.0;

  const int word = (padded.y * kPadded.x + padded.x) * 3;
  network_input.words[word] = pack4(past.r, past.g, past.b, now.r);
  network_input.words[word + 1] = pack4(now.g, now.b, hidden, fed.x);
  network_input.words[word + 2] = pack4(fed.y, fed.z, fed.w, level);
  imageStore(new_luma, padded, vec4(level, y, 0.0, 0.0));
  if (any(greaterThanEqual(padded, kRender))) return;
  new_dilated.depths[at.y * DILATED_PITCH + at.x] = closest;
  moving.halves[at.y * MOVING_PITCH + at.x] = raw;
}
