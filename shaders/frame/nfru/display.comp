// shaders/frame/nfru/display.comp -- a shown frame as a display shows it, which NFRU mixes, and its brightness for the optical flow.
//
// One invocation per output pixel. displayed is rgba16_float, luma_0 that of flow/luma.comp.
#version 450
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;
#include "../framegen/displayed.glsl"

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const vec3 c = displayed(rgb_of(fetch_shown(at)));
  store_displayed(at, half4(c));
  store_luma_0(at, floor(dot(c, vec3(0.25, 0.5, 0.25)) * 255.0 + 0.5));
}
