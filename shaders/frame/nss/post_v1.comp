// shaders/frame/nss/post_v1.comp -- filter, rectify, accumulate: the post pass of NSS v1.
//
// One invocation per output pixel: the samples of this frame that fall into its kernel, weighted as the network says;
// the history, clamped to their mean and deviation and blended as the network says; a sample that lies on the pixel
// itself, blended in. All of it in exposed colours of the Karis domain, where the notes take linear ones: a display shows
// means of it. Output and history are linear, with the exposure removed.
// KERNEL 6 and TAPS 9 (HIGH) or 4 and 4 (MID, LOW); KPN_SHIFT: render texel >> shift is the texel of the kernel tensor;
// CATMULL_ROM 1 or 0 chooses the filter of the history; WEIGHT_FLOOR is the least weight.
// Source: nss.md sections 3.1, 3.2, 3.4; tools/train/nss_passes.py computes the same.
#version 450
#include "common.glsl"
#include "taps.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1) uniform texture2D motion;
layout(set = 0, binding = 2) uniform texture2D nearest;
layout(set = 0, binding = 3) uniform texture2D history;         // one frame back
layout(set = 0, binding = 4) uniform itextureBuffer temporal;   // 4 channels a texel
layout(set = 0, binding = 5) uniform itextureBuffer kernel;     // 1 channel a texel
layout(set = 0, binding = 6, rgba16f) writeonly uniform image2D shown;
layout(set = 0, binding = 7, rgba16f) writeonly uniform image2D new_history;

const ivec2 kPadded = ivec2(TEMPORAL_WIDTH, TEMPORAL_HEIGHT);
const ivec2 kNetwork = (kRender + SIDE - 1) / SIDE;


/// The network's parameters in 0..1, at uv of its picture without padding.
vec4 parameters_at(vec2 uv) {
  const Bilinear b = bilinear_at(uv * vec2(kNetwork) / vec2(kPadded), kPadded);
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b, i, kPadded);
    sum += bilinear_weight(b.part, i) * vec4(texelFetch(temporal, at.y * kPadded.x + at.x) - TEMPORAL_ZERO_POINT);
  }
  return sum * float(TEMPORAL_SCALE);
}

/// Motion of the closest depth around the render texel that holds uv.
vec2 dilated_motion(ivec2 texel) {
#if SIDE == 1
  const int code = int(texelFetch(nearest, texel, 0).r * 255.0 + 0.5);
  const ivec2 offset = ivec2(code & 7, code >> 3) - 2;
#else
  const vec2 bytes = texelFetch(nearest, texel / 2, 0).rg;
  const int code = int(((texel.y & 1) == 0 ? bytes.r : bytes.g) * 255.0 + 0.5) >> ((texel.x & 1) * 4);
  const ivec2 offset = ivec2(code & 3, (code >> 2) & 3) - 1;
#endif
  return motion_at(motion, inside(texel + offset, kRender), kOutput, 0.1);
}

struct Filtered {
  float weight;
  vec3 first, second;  // weighted sums of the colours and of their squares
  vec3 centre;
  float has_centre;  // 1 if a sample lies on the pixel
};

/// Adds the sample of a texel at kernel cell (ix, iy).
void add_sample(inout Filtered sum, int ix, int iy, ivec2 texel) {
  const ivec2 at = inside(texel, kRender);
  const vec3 c = karis(exposed(finite_color(texelFetch(color, at, 0).rgb), params.exposure));
  const ivec2 cell = min(at >> KPN_SHIFT, ivec2(KERNEL_WIDTH, KERNEL_HEIGHT) - 1);
  const int index = (cell.y * KERNEL_WIDTH + cell.x) * KERNEL_CHANNELS + iy + KERNEL * ix;
  const float value = float(texelFetch(kernel, index).r - KERNEL_ZERO_POINT) * float(KERNEL_SCALE);
  const float weight = max(value, float(WEIGHT_FLOOR));
  sum.weight += weight;
  sum.first += weight * c;
  sum.second += weight * c * c;
  if (ix == -kFirst && iy == -kFirst) {
    sum.centre = c;
    sum.has_centre = 1.0;
  }
}

#if OUTPUT_WIDTH < 2 * COLOR_WIDTH || OUTPUT_HEIGHT < 2 * COLOR_HEIGHT
// The kernel may hold more than TAPS samples: the closest count. Cells by distance, then in rows.
#if KERNEL == 6
const int kOrder[36] = int[36](14, 8, 13, 15, 20, 7, 9, 19, 21, 2, 12, 16, 26, 1, 3, 6, 10, 18, 22, 25, 27, 0, 4, 24, 28,
                               17, 32, 11, 23, 31, 33, 5, 29, 30, 34, 35);
#else
const int kOrder[16] = int[16](5, 1, 4, 6, 9, 0, 2, 8, 10, 7, 13, 3, 11, 12, 14, 15);
#endif
Filtered filter_samples(Axis x, Axis y) {
  Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), vec3(0.0), 0.0);
  int taps = 0;
  for (int n = 0; n < KERNEL * KERNEL && taps < TAPS; ++n) {
    const int ix = kOrder[n] % KERNEL, iy = kOrder[n] / KERNEL;
    if ((x.cells >> ix & 1u) == 0u || (y.cells >> iy & 1u) == 0u) continue;
    add_sample(sum, ix, iy, ivec2(texel_at(x, ix), texel_at(y, iy)));
    ++taps;
  }
  return sum;
}
#else
Filtered filter_samples(Axis x, Axis y) {
  Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), vec3(0.0), 0.0);
  uint rows = y.cells;
  for (int j = 0; j < KERNEL / 2; ++j) {
    const int iy = findLSB(rows);
    rows &= rows - 1u;
    uint columns = x.cells;
    for (int i = 0; i < KERNEL / 2; ++i) {
      const int ix = findLSB(columns);
      columns &= columns - 1u;
      if (ix >= 0 && iy >= 0) add_sample(sum, ix, iy, ivec2(x.texel + i, y.texel + j));
    }
  }
  return sum;
}
#endif

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);

  const Axis x = axis_at(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH);
  const Axis y = axis_at(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT);
  Filtered sum = filter_samples(x, y);
  if (sum.weight == 0.0) {
    const ivec2 texel = ivec2(closest_texel(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH),
                              closest_texel(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT));
    sum.first = karis(exposed(finite_color(texelFetch(color, texel, 0).rgb), params.exposure));
    sum.second = sum.first * sum.first;
    sum.weight = 1.0;
  }
  const vec3 mean = sum.first / sum.weight;
  vec3 mixed = mean;
  if (params.reset == 0) {
    const vec4 p = parameters_at(uv);
    const float toward = p.x * p.x, away = (1.0 - p.x) * (1.0 - p.x);
    const float theta = toward / (toward + away);
    const float alpha = 0.35 * p.y + 0.05;
    const vec3 sigma = 2.0 * p.z * sqrt(max(abs(sum.second / sum.weight - mean * mean), 1e-7));
    const vec2 before = uv - dilated_motion((2 * at + 1) * kRender / (2 * kOutput));
#if CATMULL_ROM
    const vec3 past = clamp(sample_catmull_rom_mapped(history, before, kOutput, params.exposure), 0.0, 1.0);
#else
    const vec3 past = sample_linear_mapped(history, before, kOutput, params.exposure);
#endif
    mixed = mix(clamp(past, mean - sigma, mean + sigma), past, on_screen(before) ? theta : 0.0);
    mixed = mix(mixed, sum.centre, alpha * sum.has_centre);
  }
  const vec4 result = vec4(min(karis_inverse(mixed) / params.exposure, kMaxColor), 1.0);
  imageStore(shown, at, result);
  imageStore(new_history, at, result);
}
