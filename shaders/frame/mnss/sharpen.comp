// shaders/frame/mnss/sharpen.comp -- pass 6 of MNSS, optional: the output is the history sharpened, the history stays.
//
// One invocation per output pixel. 3x3 with corners -BETA, edges 0, centre 1 + 4 BETA; borders clamped.
// Source: MNSS (TVCG 2023), which recommends 0.15.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

vec3 shown(ivec2 at) { return fetch_history(clamp(at, ivec2(0), ivec2(OUTPUT_WIDTH, OUTPUT_HEIGHT) - 1)).rgb; }

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const vec3 corners = shown(at + ivec2(-1, -1)) + shown(at + ivec2(1, -1)) + shown(at + ivec2(-1, 1)) + shown(at + 1);
  store_output(at, vec4(clamp((1.0 + 4.0 * BETA) * shown(at) - BETA * corners, 0.0, 1.0), 1.0));
}
