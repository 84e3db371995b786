// shaders/frame/srpo/post.comp -- project, interpolate and fuse: passes 2 to 4 of SRPO.
//
// Reads color (rgba8, low resolution) and the tensor "offsets", int8 NHWC [1, s*h, s*w, 2], offsets in
// low-resolution pixels, channel 0 right, channel 1 down. Writes output (rgba8), s = 2 or 3 times color.
// R = offset rounded, halves away from zero. Where R is not 0 the pixel at floor(position/s) + R shows, elsewhere
// Lanczos; a 3x3 Gaussian share of moved neighbours mixes the two. Outside the image nothing moves.
// Exactness: R and the choice of pixels are exact, the mix is float32. One invocation per pixel of output.
// Source: SRPO (ECCV 2022); tools/train/srpo.py fuse() computes the same picture.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const int kScale = OUTPUT_WIDTH / COLOR_WIDTH;
// 3x3 Gaussian, sigma 1.5, sum 1: centre, edge, corner.
const float kMaskWeight[3] = float[3](0.147761, 0.118318, 0.094742);

// Lanczos with support 3 for scales 2 and 3. Output pixel k*s + p has its centre at k + (p + 0.5)/s - 0.5: phase 0
// lies left of k, the last phase mirrors it, the middle one of 3 is k. The weights sinc(d) * sinc(d/3), normalized,
// are constants because sin() may be coarse on small devices; tests/tools/train/test_srpo.py recomputes them.
const float kLanczosBy2[6] = float[6](0.00737827, -0.06799726, 0.27101057, 0.89277077, -0.13327464, 0.03011229);
const float kLanczosBy3[6] = float[6](0.01271681, -0.09373845, 0.38239641, 0.81387552, -0.14646632, 0.03121603);

/// Weight of tap i, 0 to 5, for one axis; tap 0 is the pixel lanczos_first(k, p).
float lanczos_weight(int i, int p) {
  if (kScale == 2) return kLanczosBy2[p == 0 ? i : 5 - i];
  if (p == 1) return i == 2 ? 1.0 : 0.0;
  return kLanczosBy3[p == 0 ? i : 5 - i];
}

/// First of the six pixels of phase p around pixel k.
int lanczos_first(int k, int p) { return 2 * p + 1 < kScale ? k - 3 : k - 2; }

/// Enlarged colour at output pixel `at`; not clamped to [0, 1].
vec3 lanczos(ivec2 at) {
  const ivec2 k = at / kScale, p = at - k * kScale;
  const int x0 = lanczos_first(k.x, p.x), y0 = lanczos_first(k.y, p.y);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int j = 0; j < 6; ++j) {
    const int y = clamp(y0 + j, 0, COLOR_HEIGHT - 1);
    vec3 row = vec3(0.0);
    [[unroll]] for (int i = 0; i < 6; ++i)
      row += lanczos_weight(i, p.x) * fetch_color(ivec2(clamp(x0 + i, 0, COLOR_WIDTH - 1), y)).rgb;
    sum += lanczos_weight(j, p.y) * row;
  }
  return sum;
}

ivec2 rounded_offset(ivec2 at) {
  const int base = (at.y * OFFSETS_WIDTH + at.x) * OFFSETS_CHANNELS;
  const ivec2 q = ivec2(element_offsets(base), element_offsets(base + 1)) - OFFSETS_ZERO_POINT;
  const vec2 offset = vec2(q) * float(OFFSETS_SCALE);
  return ivec2(sign(offset) * floor(abs(offset) + 0.5));
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;

  float alpha = 0.0;
  int moved = 0;
  [[unroll]] for (int y = -1; y <= 1; ++y) {
    [[unroll]] for (int x = -1; x <= 1; ++x) {
      const ivec2 neighbour = at + ivec2(x, y);
      if (any(lessThan(neighbour, ivec2(0))) || neighbour.x >= OUTPUT_WIDTH || neighbour.y >= OUTPUT_HEIGHT) continue;
      if (rounded_offset(neighbour) == ivec2(0)) continue;
      alpha += kMaskWeight[abs(x) + abs(y)];
      ++moved;
    }
  }

  vec3 result = vec3(0.0);
  if (moved > 0) {
    const ivec2 from = clamp(at / kScale + rounded_offset(at), ivec2(0), ivec2(COLOR_WIDTH, COLOR_HEIGHT) - 1);
    result = fetch_color(from).rgb;
  }
  if (moved < 9) result = mix(lanczos(at), result, alpha);
  store_output(at, vec4(clamp(result, 0.0, 1.0), 1.0));
}
