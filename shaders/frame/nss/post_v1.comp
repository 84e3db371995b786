// shaders/frame/nss/post_v1.comp -- filter, rectify, accumulate: the post pass of NSS v1.
//
// One invocation per 2x2 output pixels. For each of them: the samples of this frame that fall into its kernel, weighted
// as the network says; the history, clamped to their mean and deviation and blended as the network says; a sample that
// lies on the pixel itself, blended in. All of it in exposed colours of the Karis domain, where the notes take linear
// ones: a display shows means of it. Output and history are linear, with the exposure removed.
// KERNEL 6 and TAPS 9 (HIGH) or 4 and 4 (MID, LOW); KPN_SHIFT: render texel >> shift is the texel of the kernel tensor;
// CATMULL_ROM 1 or 0 chooses the filter of the history; WEIGHT_FLOOR is the least weight.
// `checked_color` comes from check.comp, `dilated` from pre_v1.comp.
// Source: nss.md sections 3.1, 3.2, 3.4; tools/train/nss_passes.py computes the same.
#version 450
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"
#include "taps.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, rgba16f) readonly uniform image2D checked_color;
layout(set = 0, binding = 1, rg16f) readonly uniform image2D dilated;
HISTORY_IMAGE(3, history, rgba16f);                            // one frame back
layout(set = 0, binding = 4) uniform itextureBuffer temporal;  // 4 channels a texel
layout(set = 0, binding = 5) uniform utextureBuffer kernel;    // 4 channels a texel
layout(set = 0, binding = 6, rgba16f) writeonly uniform image2D shown;
layout(set = 0, binding = 7, rgba16f) writeonly uniform image2D new_history;
#include "history.glsl"
vec3 sample_at(ivec2 at) { return karis(exposed(imageLoad(checked_color, at).rgb, params.exposure)); }
#include "quad.glsl"

const ivec2 kPadded = ivec2(TEMPORAL_WIDTH, TEMPORAL_HEIGHT);
const ivec2 kNetwork = (kRender + SIDE - 1) / SIDE;

struct Filtered {
  float weight;
  vec3 first, second;  // weighted sums of the colours and of their squares
  vec3 centre;
  float has_centre;  // 1 if a sample lies on the pixel
};

// The kernel of a texel of the tensor is column-major: byte iy + KERNEL * ix is the weight of cell (ix, iy). Weights are
// relative to KERNEL_SCALE: only their ratios count.
int kernel_texel(ivec2 cell) { return (cell.y * KERNEL_WIDTH + cell.x) * (KERNEL_CHANNELS / 4); }
float weight_of(uint word, int byte) {
  const float u = float((word ^ 0x80808080u) >> byte % 4 * 8 & 255u);
  return most(u - float(KERNEL_ZERO_POINT + 128), float(WEIGHT_FLOOR) / float(KERNEL_SCALE));
}

void add_sample(inout Filtered sum, int ix, int iy, float weight, vec3 c) {
  sum.weight += weight;
  const vec3 weighted = weight * c;
  sum.first += weighted;
  sum.second += weighted * c;
  if (ix == -kFirst && iy == -kFirst) {
    sum.centre = c;
    sum.has_centre = 1.0;
  }
}

/// What a pixel shows. parameters: of the network; past: the history at uv `before`.
vec4 shown_color(Filtered sum, vec3 parameters, vec3 past, vec2 before) {
  const float scale = 1.0 / sum.weight;
  const vec3 mean = sum.first * scale;
  const float toward = parameters.x * parameters.x, away = (1.0 - parameters.x) * (1.0 - parameters.x);
  const float theta = toward / (toward + away);
  const float alpha = 0.35 * parameters.y + 0.05;
  const vec3 sigma = 2.0 * parameters.z * sqrt(most(abs(sum.second * scale - mean * mean), vec3(1e-7)));
  const vec3 rectified = least(most(past, mean - sigma), mean + sigma);
  vec3 mixed = mix(rectified, past, on_screen(before) ? theta : 0.0);
  mixed = mix(mixed, sum.centre, alpha * sum.has_centre);
  mixed = params.reset != 0 ? mean : mixed;  // chosen, not multiplied: the history may hold anything then
  return vec4(least(karis_inverse(mixed) * (1.0 / params.exposure), vec3(kMaxColor)), 1.0);
}

void show(ivec2 pixel, vec4 color) {
  imageStore(shown, pixel, color);
  imageStore(new_history, pixel, color);
}

vec3 parameter_texel(ivec2 at) {
  at = inside(at, kPadded);
  return vec3(texelFetch(temporal, at.y * kPadded.x + at.x).xyz - TEMPORAL_ZERO_POINT);
}

#if IS_DOUBLE
#if KERNEL / 2 > (1 << KPN_SHIFT)
#error "the samples of a kernel must lie in two rows of kernel texels"
#endif
const int kColumnWords = (KERNEL % 4 + KERNEL + 3) / 4;  // that hold a column of a kernel

/// The network's parameters at the four pixels of render texel m.
void parameters_of_quad(ivec2 m, out vec3 parameters[2][2]) {
  const QuadPlace place = quad_place(m, kNetwork);
  vec3 along[3][2];
  [[unroll]] for (int y = 0; y < 3; ++y) {
    vec3 t[3];
    [[unroll]] for (int x = 0; x < 3; ++x) t[x] = parameter_texel(place.base + ivec2(x, y));
    [[unroll]] for (int x = 0; x < 2; ++x) along[y][x] = between(t[0], t[1], t[2], place.part.x + float(x) * place.step.x);
  }
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x)
      parameters[y][x] = float(TEMPORAL_SCALE) *
                         between(along[0][x], along[1][x], along[2][x], place.part.y + float(y) * place.step.y);
}

void main() {
  const ivec2 m = ivec2(gl_GlobalInvocationID.xy);
  if (m.x >= COLOR_WIDTH || m.y >= COLOR_HEIGHT) return;
  vec3 past[2][2], parameters[2][2], samples[kTaps + 1][kTaps + 1];
  const vec2 uv = (2.0 * vec2(m) + 0.5) / vec2(kOutput);
  const vec2 before = uv - long_motion(imageLoad(dilated, m).rg, kOutput, 0.1);
#if CATMULL_ROM
  past_quad_catmull_rom(before, past);
#else
  past_quad_linear(before, past);
#endif
  parameters_of_quad(m, parameters);
  const Quad quad = quad_at(m);
  quad_samples(quad, samples);
  // The samples lie in two rows of kernel texels at most: both are read, a word for up to four weights.
  int cell_x[kTaps + 1], cell_y[kTaps + 1];
  [[unroll]] for (int i = 0; i <= kTaps; ++i) {
    const ivec2 cell = min(inside(quad.first + i, kRender) >> KPN_SHIFT, ivec2(KERNEL_WIDTH, KERNEL_HEIGHT) - 1);
    cell_x[i] = cell.x, cell_y[i] = cell.y;
  }
  [[unroll]] for (int ox = 0; ox < 2; ++ox) {
    uint words[kTaps][2][kColumnWords];
    [[unroll]] for (int x = 0; x < kTaps; ++x) {
      const int column = ox == 1 && quad.apart.x != 0 ? cell_x[x + 1] : cell_x[x];
      [[unroll]] for (int i = 0; i < kColumnWords; ++i) {
        const int word = KERNEL * (2 * x + ox) / 4 + i;
        words[x][0][i] = texelFetch(kernel, kernel_texel(ivec2(column, cell_y[0])) + word).r;
        words[x][1][i] = texelFetch(kernel, kernel_texel(ivec2(column, cell_y[kTaps])) + word).r;
      }
    }
    [[unroll]] for (int oy = 0; oy < 2; ++oy) {
      Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), vec3(0.0), 0.0);
      [[unroll]] for (int y = 0; y < kTaps; ++y) {
        const bool is_below = (oy == 1 && quad.apart.y != 0 ? cell_y[y + 1] : cell_y[y]) != cell_y[0];
        [[unroll]] for (int x = 0; x < kTaps; ++x) {
          const int ix = 2 * x + ox, iy = 2 * y + oy, byte = KERNEL * ix % 4 + iy;
          const uint word = is_below ? words[x][1][byte / 4] : words[x][0][byte / 4];
          add_sample(sum, ix, iy, weight_of(word, byte), quad_sample(quad, samples, ox, oy, x, y));
        }
      }
      const ivec2 pixel = quad_pixel(quad, ox, oy);
      show(2 * m + pixel, shown_color(sum, of_pixel(parameters, pixel), of_pixel(past, pixel),
                                      before + vec2(pixel) / vec2(kOutput)));
    }
  }
}
#else
void add_texel(inout Filtered sum, int ix, int iy, ivec2 texel) {
  const ivec2 at = inside(texel, kRender);
  const ivec2 cell = min(at >> KPN_SHIFT, ivec2(KERNEL_WIDTH, KERNEL_HEIGHT) - 1);
  const int byte = iy + KERNEL * ix;
  const uint word = texelFetch(kernel, kernel_texel(cell) + byte / 4).r;
  add_sample(sum, ix, iy, weight_of(word, byte), sample_at(at));
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
    add_texel(sum, ix, iy, ivec2(texel_at(x, ix), texel_at(y, iy)));
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
      if (ix >= 0 && iy >= 0) add_texel(sum, ix, iy, ivec2(x.texel + i, y.texel + j));
    }
  }
  return sum;
}
#endif

/// The network's parameters in 0..1, at uv of its picture without padding.
vec3 parameters_at(vec2 uv) {
  const Bilinear b = bilinear_at(uv * vec2(kNetwork) / vec2(kPadded), kPadded);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * parameter_texel(b.base + ivec2(i & 1, i >> 1));
  return sum * float(TEMPORAL_SCALE);
}

void pixel_at(ivec2 at) {
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Axis x = axis_at(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH);
  const Axis y = axis_at(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT);
  Filtered sum = filter_samples(x, y);
  if (sum.weight == 0.0) {
    const ivec2 texel = ivec2(closest_texel(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH),
                              closest_texel(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT));
    sum.first = sample_at(texel);
    sum.second = sum.first * sum.first;
    sum.weight = 1.0;
  }
  const ivec2 texel = (2 * at + 1) * kRender / (2 * kOutput);
  const vec2 before = uv - long_motion(imageLoad(dilated, texel).rg, kOutput, 0.1);
#if CATMULL_ROM
  const vec3 past = past_catmull_rom(before);
#else
  const vec3 past = past_linear(before);
#endif
  show(at, shown_color(sum, parameters_at(uv), past, before));
}

void main() {
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = 2 * ivec2(gl_GlobalInvocationID.xy) + ivec2(i & 1, i >> 1);
    if (at.x < OUTPUT_WIDTH && at.y < OUTPUT_HEIGHT) pixel_at(at);
  }
}
#endif
