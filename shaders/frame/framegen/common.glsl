// shaders/frame/framegen/common.glsl -- what the passes share that make pictures between rendered frames, or beyond them.
//
// Times are in rendered frames: the newest one is at 1, the one before, "previous" here, at 0. Motion is in uv: what is
// at uv in a frame was at uv - motion in the frame before it. Depth is dilated_depth, whose near plane is at 0. m1 is the
// newest frame's motion, m0 that of the previous frame at the same place of the same thing; together they are a parabola.
// Source: Mob-FGSR (SIGGRAPH 2024), seed_networks.md section 4.2; frame_generation.md sections 1 and 8.
#include "access.glsl"
#include "color.glsl"

SHALE_PARAMS;

const ivec2 kRender = ivec2(DILATED_DEPTH_WIDTH, DILATED_DEPTH_HEIGHT);
const ivec2 kOutput = ivec2(OUTPUT_WIDTH, OUTPUT_HEIGHT);
/// View depths of one thing in two frames differ by less than this part of the nearer one.
const float kSameDepth = 0.1;

bool on_screen(vec2 uv) { return all(greaterThanEqual(uv, vec2(0.0))) && all(lessThan(uv, vec2(1.0))); }
ivec2 texel_at(vec2 uv) { return inside(ivec2(floor(uv * vec2(kRender))), kRender); }

/// Distance along the view axis, metres.
float view_z(float d) {
  const float depth = params.reverse_depth != 0 ? 1.0 - d : d;
  return finite_in(params.depth_to_view.y / (depth - params.depth_to_view.x), 0.0, 1e8, 1e8);
}
bool same_depth(float za, float zb) { return abs(za - zb) < kSameDepth * min(za, zb); }

// --- the splatted word: bits 31 to 21 how near it is, 20 whether the previous frame is its source, 19 to 10 and 9 to 0 where
// that lies: target - source + 512 in texels. 0 is empty. The source's own motion is fetched again, so that it is whole.

const int kReach = 511;  // texels; what goes farther is not splatted

/// The logarithm of how near a depth is, in 1946 steps of about half a percent of view depth below a thousand near planes.
/// By the bits of a float, which are a logarithm in straight pieces: equal on every device. At the far plane the order of
/// texels decides. Source: nfru.md section 3.2 for 1200 and the far plane's order.
uint nearness(float d, ivec2 at) {
  precise const float near = 1200.0 * (1.0 - d) + 1.0;
  const uint steps = uint(float(floatBitsToUint(near) - 0x3f800000u) * (1946.0 / 85336064.0));
  const uint order = uint(at.y * kRender.x + at.x) / (uint(kRender.x * kRender.y) / 100u + 1u);
  return steps > 0u ? 101u + min(steps, 1946u) : 100u - min(order, 99u);
}
uint word_of(uint near, uint is_previous, ivec2 displacement) {
  const uvec2 biased = uvec2(displacement + 512);
  return near << 21 | is_previous << 20 | biased.x << 10 | biased.y;
}
uint near_of(uint word) { return word >> 21; }
bool is_previous(uint word) { return (word & 1u << 20) != 0u; }
ivec2 displacement_of(uint word) { return ivec2(word >> 10 & 1023u, word & 1023u) - 512; }

/// True where a nearness is nearer by more than three percent of view depth.
bool is_nearer(uint a, uint b) { return a > b + 6u; }

// --- motion

/// From the previous frame to `time`.
vec2 way_to(float time, vec2 m1, vec2 m0) { return 0.5 * time * (m1 + m0) + 0.5 * time * time * (m1 - m0); }
