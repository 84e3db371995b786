// shaders/frame/flow/luma.comp -- brightness of a frame as a display shows it, in 8-bit steps: what the search compares.
//
// One invocation per pixel; luma_0 (r32_float) is (R + 2G + B) / 4 of the displayed colour, 0 to 255.
// Source: nfru.md section 2.2; the curve of the display is nearly that of tools/eval/tonemap.h.
#version 450
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= LUMA_0_WIDTH || at.y >= LUMA_0_HEIGHT) return;
  const vec3 x = exposed(finite_color(rgb_of(fetch_color(at))), params.exposure);
  const vec3 shown = sqrt(x / (1.0 + x));
  store_luma_0(at, floor(dot(shown, vec3(0.25, 0.5, 0.25)) * 255.0 + 0.5));
}
