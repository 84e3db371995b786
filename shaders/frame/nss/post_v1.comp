// shaders/frame/nss/post_v1.comp -- filter, rectify, accumulate: the post pass of NSS v1.
//
// One invocation per 4x2 output pixels. For each of them: the samples of this frame that fall into its kernel, weighted
// as the network says; the history, clamped to their mean and deviation and blended as the network says; a sample that
// lies on the pixel itself, blended in. All of it in exposed colours of the Karis domain, where the notes take linear
// ones: a display shows means of it.
// KERNEL 6 and TAPS 9 (HIGH) or 4 and 4 (MID, LOW); KPN_SHIFT: render texel >> shift is the texel of the kernel tensor;
// CATMULL_ROM 1 or 0 chooses the filter of the history; WEIGHT_FLOOR is the least weight.
// STILL: the history lies under the pixel. `dilated` comes from pre_v1.comp. What is shown goes into the history, with the exposure removed; the output shows that.
// Source: nss.md sections 3.1, 3.2, 3.4; tools/train/nss_passes.py computes the same.
#version 450
#include "common.glsl"
#include "taps.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
#include "catmull_rom.glsl"
#include "history.glsl"
#include "sample.glsl"
#include "quad.glsl"

const ivec2 kPadded = ivec2(TEMPORAL_WIDTH, TEMPORAL_HEIGHT);
const ivec2 kNetwork = (kRender + SIDE - 1) / SIDE;

struct Filtered {
  float weight;
  vec3 first, second;  // weighted sums of the colours and of their squares
  vec3 centre;      // the sample that lies on the pixel
  bool has_centre;  // if there is one
};

// The kernel of a texel of the tensor is column-major: byte iy + KERNEL * ix is the weight of cell (ix, iy). Weights are
// relative to KERNEL_SCALE: only their ratios count.
const int kWords = KERNEL_CHANNELS / 4;
const int kFetches = (kWords + (kWords % 4 == 0 ? 0 : 3) + 3) / 4;

/// The kernel of a cell of the tensor. It may start at any word of a fetch.
void cell_words(ivec2 cell, out uint words[kWords]) {
  const int first = (cell.y * KERNEL_WIDTH + cell.x) * kWords;
  uint fetched[4 * kFetches];
  [[unroll]] for (int i = 0; i < kFetches; ++i) {
    const uvec4 four = words4_kernel(first / 4 + i);
    [[unroll]] for (int k = 0; k < 4; ++k) fetched[4 * i + k] = four[k];
  }
#if KERNEL_CHANNELS % 16 == 0
  [[unroll]] for (int i = 0; i < kWords; ++i) words[i] = fetched[i];
#else
  uint shifted[kWords + 2];
  [[unroll]] for (int i = 0; i < kWords + 2; ++i) shifted[i] = (first & 1) != 0 ? fetched[i + 1] : fetched[i];
  [[unroll]] for (int i = 0; i < kWords; ++i) words[i] = (first & 2) != 0 ? shifted[i + 2] : shifted[i];
#endif
}

float weight_of(uint word, int byte) {
  return most(code_of(word, byte % 4, KERNEL_ZERO_POINT), float(WEIGHT_FLOOR) / float(KERNEL_SCALE));
}

void add_sample(inout Filtered sum, int ix, int iy, float weight, vec3 c) {
  sum.weight += weight;
  const vec3 weighted = weight * c;
  sum.first += weighted;
  sum.second += weighted * c;
  if (ix == -kFirst && iy == -kFirst) {
    sum.centre = c;
    sum.has_centre = true;
  }
}

/// What a pixel shows. parameters: of the network; past: the history at uv `before`.
vec3 shown_color(Filtered sum, vec3 parameters, vec3 past, vec2 before) {
  const float scale = 1.0 / sum.weight;
  const vec3 mean = sum.first * scale;
  const float toward = parameters.x * parameters.x, away = (1.0 - parameters.x) * (1.0 - parameters.x);
  const float theta = toward / (toward + away);
  const float alpha = 0.35 * parameters.y + 0.05;
  const vec3 sigma = 2.0 * parameters.z * sqrt(most(abs(sum.second * scale - mean * mean), vec3(1e-7)));
  const vec3 rectified = least(most(past, mean - sigma), mean + sigma);
  vec3 mixed = mix(rectified, past, on_screen(before) ? theta : 0.0);
  if (sum.has_centre) mixed = mix(mixed, sum.centre, alpha);
  mixed = params.reset != 0 ? mean : mixed;  // chosen, not multiplied: the history may hold anything then
  return least(karis_inverse(mixed) * (1.0 / params.exposure), vec3(kMaxColor));
}

void show(ivec2 pixel, vec3 color) { store_history(pixel, half4(color)); }

/// In 0..1, of a texel of the tensor.
vec3 parameters_of(uint word) {
  return float(TEMPORAL_SCALE) * vec3(code_of(word, 0, TEMPORAL_ZERO_POINT), code_of(word, 1, TEMPORAL_ZERO_POINT),
                                      code_of(word, 2, TEMPORAL_ZERO_POINT));
}
vec3 parameter_texel(ivec2 at) {
  at = inside(at, kPadded);
  return parameters_of(word_temporal(at.y * kPadded.x + at.x));
}

#if IS_DOUBLE
#if KERNEL / 2 + 1 > (1 << KPN_SHIFT)
#error "the samples of two quads must lie in two columns of kernel texels"
#endif
#if CATMULL_ROM
#define PAST_SIDE 5
#define FETCH_PAST fetch_quad_catmull_rom
#define FILTER_PAST past_quad_catmull_rom
#define PAST_STILL past_still_catmull_rom
#else
#define PAST_SIDE 3
#define FETCH_PAST fetch_quad_linear
#define FILTER_PAST past_quad_linear
#define PAST_STILL past_still
#endif
const int kColumnWords = (KERNEL % 4 + KERNEL + 3) / 4;  // that hold a column of a kernel

/// The network's parameters at the four pixels of two render texels next to each other, m and to its right, m.x even.
void parameters_of_quads(ivec2 m, out vec3 parameters[2][2][2]) {
#if SIDE == 1
  uint words[3][4];
  FETCH_FOUR_COLUMNS(words4_temporal, m, kPadded, words);
  vec3 along[3][2][2];
  [[unroll]] for (int y = 0; y < 3; ++y)
    [[unroll]] for (int q = 0; q < 2; ++q)
      [[unroll]] for (int x = 0; x < 2; ++x)
        along[y][q][x] = mix(parameters_of(words[y][q + x]), parameters_of(words[y][q + x + 1]), quarter(x));
  [[unroll]] for (int q = 0; q < 2; ++q)
    [[unroll]] for (int y = 0; y < 2; ++y)
      [[unroll]] for (int x = 0; x < 2; ++x)
        parameters[q][y][x] = mix(along[y][q][x], along[y + 1][q][x], quarter(y));
#else
  [[unroll]] for (int q = 0; q < 2; ++q) {
    const QuadPlace place = quad_place(m + ivec2(q, 0), kNetwork);
    vec3 along[3][2];
    [[unroll]] for (int y = 0; y < 3; ++y) {
      vec3 line[3];
      [[unroll]] for (int x = 0; x < 3; ++x) line[x] = parameter_texel(place.base + ivec2(x, y));
      [[unroll]] for (int x = 0; x < 2; ++x)
        along[y][x] = between(line[0], line[1], line[2], place.part.x + float(x) * place.step.x);
    }
    [[unroll]] for (int y = 0; y < 2; ++y)
      [[unroll]] for (int x = 0; x < 2; ++x)
        parameters[q][y][x] = between(along[0][x], along[1][x], along[2][x], place.part.y + float(y) * place.step.y);
  }
#endif
}

void main() {
  const ivec2 m = ivec2(2, 1) * ivec2(invocation());
  if (m.x >= COLOR_WIDTH || m.y >= COLOR_HEIGHT) return;
  // What lies anywhere is fetched first.
  vec2 before[2];
#if STILL
  HALF4 past_words[2][2][2];
#else
  HALF2 moving[2];
  fetch2_dilated(ivec2(m.x >> 1, m.y), moving);
  Bilinear place[2];
  HALF4 past_words[2][PAST_SIDE][PAST_SIDE];
#endif
  [[unroll]] for (int q = 0; q < 2; ++q) {
    const vec2 uv = (2.0 * vec2(m + ivec2(q, 0)) + 0.5) / vec2(kOutput);
#if STILL
    before[q] = uv;
    [[unroll]] for (int y = 0; y < 2; ++y)
      fetch2_history(ivec2(min(m.x + q, COLOR_WIDTH - 1), 2 * m.y + y), past_words[q][y]);
#else
    const vec2 moved = long_motion(xy_of(moving[q]), kOutput, 0.1);
    before[q] = uv - moved;
    place[q] = bilinear_at(before[q], kOutput, moved == vec2(0.0));
    FETCH_PAST(place[q], past_words[q]);
#endif
  }
  const Quad quad = quad_at(m);
  vec3 samples[kTaps + 1][kTaps + 2];
  two_quads_samples(quad, m, samples);
  vec3 parameters[2][2][2];
  parameters_of_quads(m, parameters);
  // The samples lie in two columns and two rows of kernel texels at most.
  const ivec2 last_cell = ivec2(KERNEL_WIDTH, KERNEL_HEIGHT) - 1;
  int cell_x[kTaps + 2], cell_y[kTaps + 1];
  [[unroll]] for (int i = 0; i < kTaps + 2; ++i)
    cell_x[i] = min(clamp(quad.first.x + i, 0, COLOR_WIDTH - 1) >> KPN_SHIFT, last_cell.x);
  [[unroll]] for (int i = 0; i <= kTaps; ++i)
    cell_y[i] = min(clamp(quad.first.y + i, 0, COLOR_HEIGHT - 1) >> KPN_SHIFT, last_cell.y);
  uint cells[2][2][kWords];  // [y][x]
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x)
      cell_words(ivec2(cell_x[x * (kTaps + 1)], cell_y[y * kTaps]), cells[y][x]);
  [[unroll]] for (int q = 0; q < 2; ++q) {
    vec3 past[2][2];
#if STILL
    [[unroll]] for (int y = 0; y < 2; ++y)
      [[unroll]] for (int x = 0; x < 2; ++x) past[y][x] = PAST_STILL(past_words[q][y][x]);
#else
    FILTER_PAST(place[q], past_words[q], past);
#endif
    [[unroll]] for (int ox = 0; ox < 2; ++ox) {
      uint words[kTaps][2][kColumnWords];
      [[unroll]] for (int x = 0; x < kTaps; ++x) {
        const int column = ox == 1 && quad.apart.x != 0 ? cell_x[q + x + 1] : cell_x[q + x];
        [[unroll]] for (int i = 0; i < kColumnWords; ++i) {
          const int word = KERNEL * (2 * x + ox) / 4 + i;
          [[unroll]] for (int y = 0; y < 2; ++y)
            words[x][y][i] = column != cell_x[0] ? cells[y][1][word] : cells[y][0][word];
        }
      }
      [[unroll]] for (int oy = 0; oy < 2; ++oy) {
        Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), vec3(0.0), false);
        [[unroll]] for (int y = 0; y < kTaps; ++y) {
          const bool is_below = (oy == 1 && quad.apart.y != 0 ? cell_y[y + 1] : cell_y[y]) != cell_y[0];
          [[unroll]] for (int x = 0; x < kTaps; ++x) {
            const int ix = 2 * x + ox, iy = 2 * y + oy, byte = KERNEL * ix % 4 + iy;
            const uint word = is_below ? words[x][1][byte / 4] : words[x][0][byte / 4];
            add_sample(sum, ix, iy, weight_of(word, byte), two_quads_sample(quad, samples, ox, oy, q + x, y));
          }
        }
        const ivec2 pixel = quad_pixel(quad, ox, oy);
        show(2 * (m + ivec2(q, 0)) + pixel, shown_color(sum, of_pixel(parameters[q], pixel), of_pixel(past, pixel),
                                                        before[q] + vec2(pixel) / vec2(kOutput)));
      }
    }
  }
}
#else
void add_texel(inout Filtered sum, int ix, int iy, ivec2 texel) {
  const ivec2 at = inside(texel, kRender);
  const ivec2 cell = min(at >> KPN_SHIFT, ivec2(KERNEL_WIDTH, KERNEL_HEIGHT) - 1);
  const int byte = iy + KERNEL * ix, word = (cell.y * KERNEL_WIDTH + cell.x) * kWords + byte / 4;
  add_sample(sum, ix, iy, weight_of(word_kernel(word), byte), sample_of(fetch_color(at)));
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
  Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), vec3(0.0), false);
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
  Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), vec3(0.0), false);
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
  return sum;
}

void pixel_at(ivec2 at) {
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Axis x = axis_at(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH);
  const Axis y = axis_at(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT);
  Filtered sum = filter_samples(x, y);
  if (sum.weight == 0.0) {
    const ivec2 texel = ivec2(closest_texel(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH),
                              closest_texel(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT));
    sum.first = sample_of(fetch_color(texel));
    sum.second = sum.first * sum.first;
    sum.weight = 1.0;
  }
#if STILL
  const vec2 before = uv;
#if CATMULL_ROM
  const vec3 past = past_still_catmull_rom(fetch_history(at));
#else
  const vec3 past = past_still(fetch_history(at));
#endif
#else
  const ivec2 texel = (2 * at + 1) * kRender / (2 * kOutput);
  const vec2 moved = long_motion(xy_of(fetch_dilated(texel)), kOutput, 0.1), before = uv - moved;
#if CATMULL_ROM
  const vec3 past = past_catmull_rom(before, moved == vec2(0.0));
#else
  const vec3 past = past_linear(before, moved == vec2(0.0));
#endif
#endif
  show(at, shown_color(sum, parameters_at(uv), past, before));
}

void main() {
  for (int i = 0; i < 8; ++i) {
    const ivec2 at = ivec2(4, 2) * ivec2(invocation()) + ivec2(i & 3, i >> 2);
    if (at.x < OUTPUT_WIDTH && at.y < OUTPUT_HEIGHT) pixel_at(at);
  }
}
#endif
