// shaders/frame/nss/common.glsl -- what the passes of NSS share: the frame's geometry, depth, motion, dilation.
//
// Conventions, settled here once: the sample in texel l of a frame lies at scene position l + 0.5 + jitter (render
// pixels, y down); motion is in uv, and what is seen at uv was at uv - motion in the frame before.
// STILL 1: no motion is longer than what counts as none (frame.json's promise); results equal those of STILL 0 bit for bit.
// Source: nss.md sections 2.1 and 2.2.
#ifndef STILL
#define STILL 0
#endif
#include "access.glsl"
#include "color.glsl"

const ivec2 kRender = ivec2(COLOR_WIDTH, COLOR_HEIGHT);
const ivec2 kOutput = ivec2(OUTPUT_WIDTH, OUTPUT_HEIGHT);

SHALE_PARAMS;

#define IS_DOUBLE (OUTPUT_WIDTH == 2 * COLOR_WIDTH && OUTPUT_HEIGHT == 2 * COLOR_HEIGHT)

/// Exposed and in the Karis domain. One factor does both; beyond kMaxColor, where exposed() stops, the result differs from
/// karis(exposed(c)) by less than 2e-5.
vec3 karis_of(vec3 c) {
  const float exposure = min(params.exposure, 1e30);
  return c * (exposure / (1.0 + exposure * largest(c)));
}

float not_reset() { return params.reset != 0 ? 0.0 : 1.0; }

/// Texel of a picture of `size` that a texel of its padded form shows: mirrored at the lower and right border, with
/// the last texel twice, as often as needed.
ivec2 mirrored(ivec2 at, ivec2 size) {
  const ivec2 turn = at % (2 * size);
  return min(turn, 2 * size - 1 - turn);
}

/// Depth as the host gives it; NaN counts as the farthest. Bits of floats are ordered as integers.
float finite_depth(float depth) {
  const int bits = clamp(floatBitsToInt(depth), 0, 0x3f800000);
  return is_nan(depth) ? (params.reverse_depth != 0 ? 0.0 : 1.0) : intBitsToFloat(bits);
}

bool closer(float a, float b) { return params.reverse_depth != 0 ? a > b : a < b; }

/// Depth times 2^31 - 1 as the scattered depth holds it, and back: the closest is the largest, the farthest 0.
uint scatter_code(uint scaled) {
  scaled = min(scaled, 0x7fffffffu);  // float rounds 2^31 - 1 up
  return params.reverse_depth != 0 ? scaled : 0x7fffffffu - scaled;
}

/// Distance along the view axis, metres.
float view_z(float depth) {
  return finite_in(params.depth_to_view.y / (depth - params.depth_to_view.x), 0.0, 1e8, 1e8);
}

/// Motion beyond the whole picture leads off the screen whatever its length.
vec2 finite_motion(vec2 motion) {
  motion *= params.motion_scale;
  return vec2(finite_in(motion.x, -1.0, 1.0, 0.0), finite_in(motion.y, -1.0, 1.0, 0.0));
}

/// Motion in uv, none if it is at most `least` pixels of `size`.
vec2 long_motion(vec2 motion, ivec2 size, float least) {
  const vec2 m = finite_motion(motion);
  return length(m * vec2(size)) <= least ? vec2(0.0) : m;
}

bool on_screen(vec2 uv) { return all(greaterThanEqual(uv, vec2(0.0))) && all(lessThan(uv, vec2(1.0))); }

/// Of the depth clip; 2 at 960x540.
const float kPower = mix(1.0, 3.0, clamp(length(vec2(kRender)) / length(vec2(1920.0, 1080.0)), 0.0, 1.0));

/// What one tap of the depth clip adds: x to kept, y to the sum of weights. `tolerance` in metres.
vec2 depth_clip_tap(float weight, bool inside_screen, float z, float z_before, float tolerance) {
  if (!inside_screen) return vec2(0.0, weight);
  if (weight <= 0.1) return vec2(0.0);
  const float difference = z - z_before;
  if (difference <= 0.0) return vec2(0.0);
  const vec2 half_view = params.depth_to_view.zw;
  const float separation = 1.37e-5 * sqrt(dot(half_view, half_view) + 1.0);
  const float needed = separation * length(vec2(kRender)) * max(z, z_before) + tolerance;
  const float near = clamp(needed / difference, 0.0, 1.0);
  return vec2(weight * (kPower == 2.0 ? near * near : pow(near, kPower)), weight);
}

float depth_clip(vec2 sum) { return sum.y > 0.0 ? clamp(1.0 - sum.x / sum.y, 0.0, 1.0) : 0.0; }
