// shaders/frame/baseline/resample.comp -- enlarges a frame by itself: nearest, bilinear, Catmull-Rom or Lanczos.
//
// One invocation per output pixel. The filter looks at where the samples lie, so the jitter does not shake the picture.
// It works on exposed colours in the Karis domain, where a highlight weighs what a display shows of it; what the
// negative lobes leave below 0 is 0, and a light above kNoOvershoot is none of their making. FILTER: 0 nearest, 1 bilinear, 2 Catmull-Rom (Keys, a = -1/2), 3 Lanczos with
// three lobes, weights normalized. Borders are clamped. Enlarging only, so the filters are as wide as render texels.
#version 450
#include "access.glsl"
#include "color.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

SHALE_PARAMS;

const ivec2 kRender = ivec2(COLOR_WIDTH, COLOR_HEIGHT);
const int kRadius = FILTER == 3 ? 3 : FILTER;  // taps on each side

float weight(float x) {
  x = abs(x);
#if FILTER == 1
  return max(1.0 - x, 0.0);
#elif FILTER == 2
  return x < 1.0 ? (1.5 * x - 2.5) * x * x + 1.0 : x < 2.0 ? ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0 : 0.0;
#else
  const float kPi = 3.14159265;
  if (x < 1e-4) return 1.0;
  return x < 3.0 ? 3.0 * sin(kPi * x) * sin(kPi * x / 3.0) / (kPi * kPi * x * x) : 0.0;
#endif
}

vec3 texel(ivec2 at) {
  return karis(exposed(finite_color(rgb_of(fetch_color(inside(at, kRender)))), params.exposure));
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const vec2 scene = (vec2(at) + 0.5) * vec2(kRender) / vec2(OUTPUT_WIDTH, OUTPUT_HEIGHT) - params.jitter;
#if FILTER == 0
  const vec3 result = texel(ivec2(floor(scene)));
#else
  const vec2 base = floor(scene - 0.5);
  const vec2 part = scene - 0.5 - base;
  vec3 sum = vec3(0.0), high = vec3(0.0);
  float total = 0.0;
  [[unroll]] for (int y = 1 - kRadius; y <= kRadius; ++y) {
    const float wy = weight(float(y) - part.y);
    [[unroll]] for (int x = 1 - kRadius; x <= kRadius; ++x) {
      const float w = wy * weight(float(x) - part.x);
      const vec3 t = texel(ivec2(base) + ivec2(x, y));
      sum += w * t;
      high = most(high, t);
      total += w;
    }
  }
  const vec3 filtered = max(sum / total, 0.0);
  const vec3 result = any(greaterThan(filtered, vec3(kNoOvershoot))) ? least(filtered, high) : filtered;
#endif
  store_output(at, half4(min(karis_inverse(result) / params.exposure, kMaxColor)));
}
