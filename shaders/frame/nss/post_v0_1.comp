// shaders/frame/nss/post_v0_1.comp -- filter, rectify, accumulate: the post pass of NSS v0.1.
//
// One invocation per 4x2 output pixels. For each of them: the samples of this frame that fall into its 4x4 kernel,
// weighted by the tensors k0 to k3 (a column each, 4 channels a texel); the history, blended in as the network says; a
// sample that lies on the pixel itself, blended in. All of it in exposed colours of the Karis domain, where the notes take
// linear ones: a display shows means of it. What is shown goes into the history, with the exposure removed; the output
// shows that. `moving` comes from pre_v0_1.comp.
// Source: nss.md sections 3.1 to 3.3; tools/train/nss_passes.py computes the same.
#version 450
#include "common.glsl"
#define KERNEL 4
#include "taps.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
#include "catmull_rom.glsl"
#include "history.glsl"
#include "sample.glsl"
#include "quad.glsl"

const ivec2 kPadded = ivec2(TEMPORAL_WIDTH, TEMPORAL_HEIGHT);

/// A texel of a tensor of the network, in 0..1. All of them share scale and zero point.
vec4 values_of(uint word) {
  return float(TEMPORAL_SCALE) * vec4(code_of(word, 0, TEMPORAL_ZERO_POINT), code_of(word, 1, TEMPORAL_ZERO_POINT),
                                      code_of(word, 2, TEMPORAL_ZERO_POINT), code_of(word, 3, TEMPORAL_ZERO_POINT));
}

struct Filtered {
  float weight;
  vec3 first, centre;  // weighted sum of the colours; the one that lies on the pixel
  bool has_centre;     // if one does
};

/// What a pixel shows. parameters: of the network; past: the history at uv `before`.
vec3 shown_color(Filtered sum, vec3 parameters, vec3 past, vec2 before) {
  vec3 mixed = sum.first * (1.0 / sum.weight);
  // Chosen, not multiplied: after a reset the history may hold anything.
  mixed = params.reset != 0 ? mixed : mix(mixed, past, on_screen(before) ? parameters.x : 0.0);
  if (sum.has_centre) mixed = mix(mixed, sum.centre, 0.35 * parameters.y + 0.05);
  return least(karis_inverse(mixed) * (1.0 / params.exposure), vec3(kMaxColor));
}

void show(ivec2 pixel, vec3 color) { store_history(pixel, half4(color)); }

void add_sample(inout Filtered sum, int ix, int iy, float weight, vec3 c) {
  sum.weight += weight;
  sum.first += weight * c;
  if (ix == -kFirst && iy == -kFirst) {
    sum.centre = c;
    sum.has_centre = true;
  }
}

#if IS_DOUBLE
/// The weights of a column of the kernel, in 0..1, at the q-th quad's pixel px along x: those that count for the even pixel
/// along y (x and z) there, those for the odd one (y and w) there. words: of its tensor, as fetch_four_columns leaves them.
vec4 column_of_quad(uint words[3][4], int q, Quad quad, int px) {
  vec4 along[3];
  [[unroll]] for (int y = 0; y < 3; ++y)
    along[y] = mix(values_of(px == 0 ? words[y][q] : words[y][q + 1]), values_of(px == 0 ? words[y][q + 1] : words[y][q + 2]),
                   quarter(px));
  const int even = quad.pixel[0].y, odd = quad.pixel[1].y;
  const vec2 e = mix(even == 0 ? along[0].xz : along[1].xz, even == 0 ? along[1].xz : along[2].xz, quarter(even));
  const vec2 o = mix(odd == 0 ? along[0].yw : along[1].yw, odd == 0 ? along[1].yw : along[2].yw, quarter(odd));
  return vec4(e.x, o.x, e.y, o.y);
}

void main() {
  const ivec2 m = ivec2(2, 1) * ivec2(invocation());
  if (m.x >= COLOR_WIDTH || m.y >= COLOR_HEIGHT) return;
  // What lies anywhere is fetched first.
  HALF2 halves[2];
  fetch2_moving(ivec2(m.x >> 1, m.y), halves);
  vec2 before[2];
  Bilinear place[2];
  HALF4 past_words[2][5][5];
  [[unroll]] for (int q = 0; q < 2; ++q) {
    const vec2 uv = (2.0 * vec2(m + ivec2(q, 0)) + 0.5) / vec2(kOutput);
    before[q] = uv - long_motion(xy_of(halves[q]), kOutput, 0.1);
    place[q] = bilinear_at(before[q], kOutput);
    fetch_quad_catmull_rom(place[q], past_words[q]);
  }
  const Quad quad = quad_at(m);
  vec3 samples[kTaps + 1][kTaps + 2];
  two_quads_samples(quad, m, samples);
  uint words[5][3][4];  // of k0 to k3 and of temporal
  FETCH_FOUR_COLUMNS(words4_k0, m, kPadded, words[0]);
  FETCH_FOUR_COLUMNS(words4_k1, m, kPadded, words[1]);
  FETCH_FOUR_COLUMNS(words4_k2, m, kPadded, words[2]);
  FETCH_FOUR_COLUMNS(words4_k3, m, kPadded, words[3]);
  FETCH_FOUR_COLUMNS(words4_temporal, m, kPadded, words[4]);
  [[unroll]] for (int q = 0; q < 2; ++q) {
    vec3 past[2][2], parameters[2][2];
    past_quad_catmull_rom(place[q], past_words[q], past);
    [[unroll]] for (int x = 0; x < 2; ++x) {
      vec3 along[3];
      [[unroll]] for (int y = 0; y < 3; ++y)
        along[y] = mix(values_of(words[4][y][q + x]).xyz, values_of(words[4][y][q + x + 1]).xyz, quarter(x));
      [[unroll]] for (int y = 0; y < 2; ++y) parameters[y][x] = mix(along[y], along[y + 1], quarter(y));
    }
    [[unroll]] for (int ox = 0; ox < 2; ++ox) {
      vec4 columns[kTaps];
      [[unroll]] for (int x = 0; x < kTaps; ++x)
        columns[x] = column_of_quad(words[2 * x + ox], q, quad, quad.pixel[ox].x);
      [[unroll]] for (int oy = 0; oy < 2; ++oy) {
        Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), false);
        [[unroll]] for (int y = 0; y < kTaps; ++y) {
          [[unroll]] for (int x = 0; x < kTaps; ++x) {
            const int iy = 2 * y + oy;
            add_sample(sum, 2 * x + ox, iy, max(columns[x][iy], 1e-7), two_quads_sample(quad, samples, ox, oy, q + x, y));
          }
        }
        const ivec2 pixel = quad_pixel(quad, ox, oy);
        show(2 * (m + ivec2(q, 0)) + pixel, shown_color(sum, of_pixel(parameters, pixel), of_pixel(past, pixel),
                                                        before[q] + vec2(pixel) / vec2(kOutput)));
      }
    }
  }
}
#else
/// A tensor of the network in 0..1, bilinear; `b` in its padded picture.
#define VALUES_AT(word_of_tensor, b, sum)                                                          \
  {                                                                                                \
    sum = vec4(0.0);                                                                               \
    [[unroll]] for (int i = 0; i < 4; ++i) {                                                       \
      const ivec2 at = bilinear_texel(b, i, kPadded);                                              \
      sum += bilinear_weight(b.part, i) * values_of(word_of_tensor(at.y * kPadded.x + at.x));      \
    }                                                                                              \
  }

void pixel_at(ivec2 at) {
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Bilinear b = bilinear_at(uv * vec2(kRender) / vec2(kPadded), kPadded);
  const Axis x = axis_at(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH);
  const Axis y = axis_at(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT);
  Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), false);
  vec4 columns[KERNEL], parameters;
  VALUES_AT(word_k0, b, columns[0]);
  VALUES_AT(word_k1, b, columns[1]);
  VALUES_AT(word_k2, b, columns[2]);
  VALUES_AT(word_k3, b, columns[3]);
  VALUES_AT(word_temporal, b, parameters);
  [[unroll]] for (int ix = 0; ix < KERNEL; ++ix) {
    [[unroll]] for (int iy = 0; iy < KERNEL; ++iy) {
      if ((x.cells >> ix & 1u) == 0u || (y.cells >> iy & 1u) == 0u) continue;
      const ivec2 texel = inside(ivec2(texel_at(x, ix), texel_at(y, iy)), kRender);
      add_sample(sum, ix, iy, max(columns[ix][iy], 1e-7), sample_of(fetch_color(texel)));
    }
  }
  if (sum.weight == 0.0) {
    const ivec2 texel = ivec2(closest_texel(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH),
                              closest_texel(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT));
    sum.first = sample_of(fetch_color(texel));
    sum.weight = 1.0;
  }
  const ivec2 texel = (2 * at + 1) * kRender / (2 * kOutput);
  const vec2 before = uv - long_motion(xy_of(fetch_moving(texel)), kOutput, 0.1);
  show(at, shown_color(sum, parameters.xyz, past_catmull_rom(before, false), before));
}

void main() {
  for (int i = 0; i < 8; ++i) {
    const ivec2 at = ivec2(4, 2) * ivec2(invocation()) + ivec2(i & 3, i >> 2);
    if (at.x < OUTPUT_WIDTH && at.y < OUTPUT_HEIGHT) pixel_at(at);
  }
}
#endif
