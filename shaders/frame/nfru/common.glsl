// shaders/frame/nfru/common.glsl -- what the passes of NFRU share: where its four samples lie.
//
// Samples are, in this order, of the previous and the newest frame by motion, of the previous and the newest by optical flow. The
// network looks at a picture of the flow's size, the lane; its tensors are padded to multiples of 8, mirrored.
// tools/train/nfru_passes.py computes the same. Source: Arm's NFRU v1, nfru.md.
#define AHEAD 0
#define QUADRATIC 1
#define FLOW 1
#include "../framegen/common.glsl"
#include "../framegen/parabola.glsl"
#include "../framegen/places.glsl"

const ivec2 kLane = ivec2(FLOW_WIDTH, FLOW_HEIGHT);
const int kSamples = 4;

/// Where the samples of uv are; which of them are on the screen, 1 or 0.
struct Four {
  vec2 at[kSamples];
  vec4 seen;
};

Four four_at(vec2 uv, Places p) {
  const vec2 flow = flow_at(uv);
  Four four;
  four.at[0] = p.before;
  four.at[1] = p.now;
  four.at[2] = uv - params.time * flow;
  four.at[3] = uv + (1.0 - params.time) * flow;
  [[unroll]] for (int i = 0; i < kSamples; ++i) four.seen[i] = on_screen(four.at[i]) ? 1.0 : 0.0;
  return four;
}
