// shaders/frame/mnss/common.glsl -- what the passes of MNSS share: where samples lie.
//
// Colours are what a display shows. The sample in texel l lies in the output pixel kScale * l + cell(); depth, motion and
// parameters are those of NSS. tools/train/mnss_passes.py computes the same and states every convention.
// Source: MNSS (TVCG 2023).
#include "../nss/common.glsl"

const int kScale = OUTPUT_WIDTH / COLOR_WIDTH;

ivec2 cell() { return clamp(ivec2(floor((0.5 + params.jitter) * float(kScale))), ivec2(0), ivec2(kScale - 1)); }

/// Where an output pixel lies between the render texels, so that no jitter enters.
Bilinear between_texels(ivec2 at) {
  const vec2 position = (vec2(at) + 0.5) / float(kScale) - 0.5 - params.jitter;
  const vec2 base = floor(position);
  return Bilinear(ivec2(base), position - base);
}

ivec2 tap(Bilinear b, int i) { return inside(b.base + ivec2(i & 1, i >> 1), kRender); }
