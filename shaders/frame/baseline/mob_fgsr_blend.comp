// shaders/frame/baseline/mob_fgsr_blend.comp -- Mob-FGSR's super resolution: warp the history, clamp it, blend.
//
// One invocation per output pixel. Colours are exposed and in the Karis domain, where the method's 8-bit colours lie;
// the history (rgba16_float) stays in it. The history is read with the 4x4 kernel that the method's table holds
// (Keys, a = -1/2) and clamped in YCoCg to the 3x3 render texels; the current colour is bilinear where the samples lie;
// its share is 0.25 - 0.4 q^2, q the distance to the closest sample in render texels. Without history that is on the
// screen and within 0.01 of the depth, the current colour alone.
// STILL 1: nothing moves, and the history lies under the pixel; the promise of frame.json.
// Source: Mob-FGSR (SIGGRAPH 2024), seed_networks.md sections 4.3 and 4.4.
#version 450
#ifndef STILL
#define STILL 0
#endif
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;

const ivec2 kRender = ivec2(COLOR_WIDTH, COLOR_HEIGHT);
const ivec2 kOutput = ivec2(OUTPUT_WIDTH, OUTPUT_HEIGHT);
const float kDepthThreshold = 0.01;

vec3 texel(ivec2 at) {
  return karis(exposed(finite_color(rgb_of(fetch_color(inside(at, kRender)))), params.exposure));
}

vec3 history_at(vec2 uv, bool rests) {
  const Bilinear b = bilinear_at(uv, kOutput, rests);
  const vec4 wx = catmull_rom(b.part.x), wy = catmull_rom(b.part.y);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int y = 0; y < 4; ++y)
    [[unroll]] for (int x = 0; x < 4; ++x)
      sum += wx[x] * wy[y] * rgb_of(fetch_history(inside(b.base + ivec2(x, y) - 1, kOutput)));
  return sum;
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kOutput.x || at.y >= kOutput.y) return;
  precise const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const vec2 scene = uv * vec2(kRender) - params.jitter;  // in texels
  const vec2 base = floor(scene - 0.5);
  const vec2 part = scene - 0.5 - base;
  vec3 now = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) now += bilinear_weight(part, i) * texel(ivec2(base) + ivec2(i & 1, i >> 1));

  const ivec2 render = (2 * at + 1) * kRender / (2 * kOutput);
#if STILL
  const vec2 before = uv;
#else
  const vec2 motion = xy_of(fetch_dilated_motion(render));
  precise const vec2 before = uv - motion;
#endif
  vec3 result = now;
  if (params.reset == 0 && all(greaterThanEqual(before, vec2(0.0))) && all(lessThan(before, vec2(1.0)))) {
    const float z = fetch_dilated_depth(render);
    precise const vec2 place = before * vec2(kRender);  // in both forms alike
    const float z_before = fetch_previous_depth(inside(ivec2(place), kRender));
    if (abs(z - z_before) < kDepthThreshold) {
      const ivec2 centre = inside(ivec2(floor(scene)), kRender);
      vec3 low = ycocg(texel(centre)), high = low;
      [[unroll]] for (int i = 0; i < 9; ++i) {
        const vec3 c = ycocg(texel(centre + ivec2(i % 3, i / 3) - 1));
        low = min(low, c);
        high = max(high, c);
      }
#if STILL
      const vec3 history = rgb_of(fetch_history(at));
#else
      const vec3 history = history_at(before, motion == vec2(0.0));
#endif
      const vec3 past = max(ycocg_inverse(clamp(ycocg(history), low, high)), 0.0);
      const vec2 q = scene - (vec2(centre) + 0.5);
      result = mix(past, now, max(0.25 - 0.4 * dot(q, q), 0.0));
    }
  }
  store_history(at, half4(result));
  store_output(at, half4(min(karis_inverse(result) / params.exposure, kMaxColor)));
}
