// shaders/frame/qrisp/common.glsl -- what the passes of QRISP share: geometry, and pictures as a display shows them.
//
// Conventions, settled here once: the output is kScale times the render size; the sample in texel l of a frame lies at
// scene position l + 0.5 + jitter; motion is in uv, and what is seen at uv was at uv - motion in the frame before.
// tools/train/qrisp_passes.py computes the same. Source: seed_networks.md sections 2.1 and 2.2.
#include "access.glsl"
#include "color.glsl"

const ivec2 kRender = ivec2(COLOR_WIDTH, COLOR_HEIGHT);
const ivec2 kOutput = ivec2(OUTPUT_WIDTH, OUTPUT_HEIGHT);
const int kScale = OUTPUT_WIDTH / COLOR_WIDTH;
const int kPhases = kScale * kScale;  // output pixels of a render texel; phase dy * kScale + dx
const int kBlock = 8;                 // output pixels that move alike, a side

SHALE_PARAMS;

/// Exposed colour in [0, 65504] to [0, 1), and back to [0, 65504].
vec3 displayed(vec3 x) { return sqrt(x / (1.0 + x)); }
vec3 linear(vec3 y) {
  const vec3 square = y * y;
  return min(square / (1.0 - min(square, vec3(1.0 - 1e-7))), vec3(kMaxColor));
}

/// Depth as the host gives it; NaN counts as the farthest.
float finite_depth(float depth) { return finite_in(depth, 0.0, 1.0, params.reverse_depth != 0 ? 0.0 : 1.0); }

/// Jitter as the host gives it, in render pixels; NaN counts as none.
vec2 finite_jitter() {
  return vec2(finite_in(params.jitter.x, -0.5, 0.5, 0.0), finite_in(params.jitter.y, -0.5, 0.5, 0.0));
}
