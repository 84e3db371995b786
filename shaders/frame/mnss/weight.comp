// shaders/frame/mnss/weight.comp -- pass 2 of MNSS: the inpainting network, conv 3x3 4->1 with a sigmoid.
//
// One invocation per render texel. weight (r32_float) is the share of the current frame, 1 without a past. The network's
// numbers are definitions of the pass: W0 to W35, by row, column and channel, and BIAS; float32.
// Source: MNSS (TVCG 2023).
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const vec4 kWeights[9] =
    vec4[9](vec4(W0, W1, W2, W3), vec4(W4, W5, W6, W7), vec4(W8, W9, W10, W11), vec4(W12, W13, W14, W15),
            vec4(W16, W17, W18, W19), vec4(W20, W21, W22, W23), vec4(W24, W25, W26, W27), vec4(W28, W29, W30, W31),
            vec4(W32, W33, W34, W35));

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  float sum = BIAS;
  [[unroll]] for (int i = 0; i < 9; ++i) {
    const ivec2 from = at + ivec2(i % 3, i / 3) - 1;
    const vec4 difference = unpackUnorm4x8(fetch_difference(inside(from, kRender)));
    sum += inside(from, kRender) == from ? dot(kWeights[i], difference) : 0.0;
  }
  store_weight(at, params.reset != 0 ? 1.0 : 1.0 / (1.0 + exp(-sum)));
}
