// shaders/frame/nss/pre_v1.comp -- the network's input: pass d of NSS v1.
//
// Writes the tensor "input", int8 NHWC [1, h, w, 12] with h and w padded to multiples of 8, padding mirrored:
//   0-2 history, reprojected, Karis    3-5 current colour without jitter, Karis    6 speed of motion
//   7-10 feedback, reprojected         11 instability
// and the new state of the instability; and `nearest`, where the closest depth is, for the post pass. One invocation
// per texel of the tensor.
// SIDE 1 (HIGH): a network texel is a render texel; nearest is r8, (y + 2) << 3 | (x + 2) of the offset.
// SIDE 2 (MID, LOW): it is 2x2 of them, each reprojected for itself; nearest is rg8, a nibble
// (y + 1) << 2 | (x + 1) each; disocclusion comes from disocclusion.comp.
// Source: nss.md sections 1.1, 2.4 d; tools/train/nss_passes.py computes the same.
#version 450
#include "common.glsl"
#include "instability.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1) uniform texture2D depth;
layout(set = 0, binding = 2) uniform texture2D motion;
layout(set = 0, binding = 3) uniform texture2D history;   // one frame back
layout(set = 0, binding = 4) uniform texture2D state;     // one frame back
layout(set = 0, binding = 5) uniform itextureBuffer feedback;  // the tensor "temporal" of one frame back
layout(set = 0, binding = 7, std430) writeonly buffer InputTensor { uint words[]; } network_input;
layout(set = 0, binding = 8, rgba8_snorm) writeonly uniform image2D new_state;
#if SIDE == 1
#include "scattered.glsl"
layout(set = 0, binding = 6) uniform utexture2D scatter;
layout(set = 0, binding = 9, r8) writeonly uniform image2D nearest;
#else
layout(set = 0, binding = 6) uniform texture2D disocclusion;
layout(set = 0, binding = 9, rg8) writeonly uniform image2D nearest;
#endif

const ivec2 kPadded = ivec2(INPUT_WIDTH, INPUT_HEIGHT);
const ivec2 kNetwork = (kRender + SIDE - 1) / SIDE;

/// Current colour of a network texel, without jitter, exposed.
vec3 current(ivec2 at) {
  const vec2 uv = (vec2(inside(at, kNetwork)) + 0.5) / vec2(kNetwork);
  return sample_exposed(color, uv - params.jitter / vec2(kRender), kRender, params.exposure);
}

vec3 history_at(vec2 uv) { return karis(exposed(sample_linear(history, uv, kOutput).rgb, params.exposure)); }

/// The previous frame's feedback in 0..1, at uv of the network's picture without padding.
vec4 feedback_at(vec2 uv) {
  const Bilinear b = bilinear_at(uv * vec2(kNetwork) / vec2(kPadded), kPadded);
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b, i, kPadded);
    sum += bilinear_weight(b.part, i) * vec4(texelFetch(feedback, at.y * kPadded.x + at.x) - TEMPORAL_ZERO_POINT);
  }
  return sum * float(TEMPORAL_SCALE);
}

uint code(float value) {
  const int q = int(floor(value / float(INPUT_SCALE) + 0.5)) + INPUT_ZERO_POINT;
  return uint(clamp(q, -128, 127)) & 255u;
}

uint pack4(float a, float b, float c, float d) {
  return code(a) | code(b) << 8 | code(c) << 16 | code(d) << 24;
}

void main() {
  const ivec2 padded = ivec2(gl_GlobalInvocationID.xy);
  if (padded.x >= kPadded.x || padded.y >= kPadded.y) return;
  const ivec2 at = mirrored(padded, kNetwork);
  const vec2 uv = (vec2(at) + 0.5) / vec2(kNetwork);

  vec3 past = vec3(0.0);
  vec2 moved = vec2(0.0);  // of the closest lane
  float closest = 0.0;
  ivec2 offsets[SIDE * SIDE];
  for (int i = 0; i < SIDE * SIDE; ++i) {
    const ivec2 lane = inside(at * SIDE + ivec2(i % SIDE, i / SIDE), kRender);
    float lane_depth;
    offsets[i] = closest_offset(depth, lane, 2, lane_depth);
    const vec2 lane_motion = motion_at(motion, inside(lane + offsets[i], kRender), kRender, 0.1);
    past += history_at((vec2(lane) + 0.5) / vec2(kRender) - lane_motion);
    if (i == 0 || closer(lane_depth, closest)) {
      closest = lane_depth;
      moved = lane_motion;
    }
  }
  past *= not_reset() / float(SIDE * SIDE);
  const vec2 before = uv - moved;
#if SIDE == 1
  const bool hidden = disoccluded(scatter, before, view_z(closest), 0.0) > 0.01;
#else
  const bool hidden = sample_linear(disocclusion, uv, ivec2(DISOCCLUSION_WIDTH, DISOCCLUSION_HEIGHT)).r > 0.01;
#endif

  const float unit = length(1.0 / vec2(kRender));
  const float speed = sqrt((clamp(length(moved), unit, 200.0 * unit) - unit) / (199.0 * unit));
  const vec4 fed = hidden ? vec4(0.0) : feedback_at(before) * not_reset();

  const vec3 now = current(at);
  const vec3 work = work_color(now);
  const vec4 around = vec4(color_distance(work, work_color(current(at + ivec2(0, -1)))),
                           color_distance(work, work_color(current(at + ivec2(0, 1)))),
                           color_distance(work, work_color(current(at + ivec2(1, 0)))),
                           color_distance(work, work_color(current(at + ivec2(-1, 0)))));
  const vec4 old_state = sample_linear(state, before * vec2(kNetwork) / vec2(kPadded), kPadded) * not_reset();
  vec4 next_state;
  const float flicker = instability(work, around, old_state, hidden, next_state);

  const vec3 shown = karis(now);
  const int word = (padded.y * kPadded.x + padded.x) * 3;
  network_input.words[word] = pack4(past.r, past.g, past.b, shown.r);
  network_input.words[word + 1] = pack4(shown.g, shown.b, speed, fed.x);
  network_input.words[word + 2] = pack4(fed.y, fed.z, fed.w, flicker);
  imageStore(new_state, padded, next_state);
  if (any(greaterThanEqual(padded, kNetwork))) return;
#if SIDE == 1
  imageStore(nearest, at, vec4(float((offsets[0].y + 2) << 3 | (offsets[0].x + 2)) / 255.0));
#else
  ivec4 nibbles;
  for (int i = 0; i < 4; ++i) nibbles[i] = (offsets[i].y + 1) << 2 | (offsets[i].x + 1);
  imageStore(nearest, at, vec4(nibbles.x | nibbles.y << 4, nibbles.z | nibbles.w << 4, 0, 0) / 255.0);
#endif
}
