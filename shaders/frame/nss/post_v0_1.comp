// shaders/frame/nss/post_v0_1.comp -- filter, rectify, accumulate: the post pass of NSS v0.1.
//
// One invocation per 2x2 output pixels. For each of them: the samples of this frame that fall into its 4x4 kernel,
// weighted by the tensors k0 to k3 (a column each, 4 channels a texel); the history, blended in as the network says; a
// sample that lies on the pixel itself, blended in. All of it in exposed colours of the Karis domain, where the notes
// take linear ones: a display
// shows means of it. Output and history are linear, with the exposure removed.
// `mapped` and `moving` come from pre_v0_1.comp.
// Source: nss.md sections 3.1 to 3.3; tools/train/nss_passes.py computes the same.
#version 450
#extension GL_EXT_control_flow_attributes : require
#include "common.glsl"
#define KERNEL 4
#include "taps.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0, rgba32f) readonly uniform image2D mapped;
layout(set = 0, binding = 1, rg16f) readonly uniform image2D moving;
HISTORY_IMAGE(3, history, rgba16f);  // one frame back
layout(set = 0, binding = 4) uniform itextureBuffer temporal;
layout(set = 0, binding = 5) uniform itextureBuffer k0;
layout(set = 0, binding = 6) uniform itextureBuffer k1;
layout(set = 0, binding = 7) uniform itextureBuffer k2;
layout(set = 0, binding = 8) uniform itextureBuffer k3;
layout(set = 0, binding = 9, rgba16f) writeonly uniform image2D shown;
layout(set = 0, binding = 10, rgba16f) writeonly uniform image2D new_history;
#include "history.glsl"
vec3 sample_at(ivec2 at) { return imageLoad(mapped, at).rgb; }
#include "quad.glsl"

const ivec2 kPadded = ivec2(TEMPORAL_WIDTH, TEMPORAL_HEIGHT);

vec4 value_texel(itextureBuffer tensor, ivec2 at) {
  at = inside(at, kPadded);
  return vec4(texelFetch(tensor, at.y * kPadded.x + at.x) - TEMPORAL_ZERO_POINT) * float(TEMPORAL_SCALE);
}

struct Filtered {
  float weight;
  vec3 first, centre;  // weighted sum of the colours; the one that lies on the pixel
  float has_centre;    // 1 if one does
};

/// What a pixel shows. parameters: of the network; past: the history at uv `before`.
vec4 shown_color(Filtered sum, vec3 parameters, vec3 past, vec2 before) {
  vec3 mixed = sum.first * (1.0 / sum.weight);
  // Chosen, not multiplied: after a reset the history may hold anything.
  mixed = params.reset != 0 ? mixed : mix(mixed, past, on_screen(before) ? parameters.x : 0.0);
  mixed = mix(mixed, sum.centre, (0.35 * parameters.y + 0.05) * sum.has_centre);
  return vec4(min(karis_inverse(mixed) * (1.0 / params.exposure), kMaxColor), 1.0);
}

void show(ivec2 pixel, vec4 color) {
  imageStore(shown, pixel, color);
  imageStore(new_history, pixel, color);
}

void add_sample(inout Filtered sum, int ix, int iy, float weight, vec3 c) {
  sum.weight += weight;
  sum.first += weight * c;
  if (ix == -kFirst && iy == -kFirst) {
    sum.centre = c;
    sum.has_centre = 1.0;
  }
}

#if IS_DOUBLE
/// The weights of a column of the kernel, in 0..1, at pixel px along x: those that count for the even pixel along y (x
/// and z) there, those for the odd one (y and w) there.
vec4 column_of_quad(itextureBuffer tensor, QuadPlace place, Quad quad, int px) {
  vec4 along[3];
  const float f = place.part.x + float(px) * place.step.x;
  [[unroll]] for (int y = 0; y < 3; ++y) {
    const vec4 l = value_texel(tensor, place.base + ivec2(0, y)), c = value_texel(tensor, place.base + ivec2(1, y)),
               r = value_texel(tensor, place.base + ivec2(2, y));
    along[y] = f < 1.0 ? mix(l, c, f) : mix(c, r, f - 1.0);
  }
  const float even = place.part.y + float(quad.pixel[0].y) * place.step.y;
  const float odd = place.part.y + float(quad.pixel[1].y) * place.step.y;
  return vec4(between(along[0].x, along[1].x, along[2].x, even), between(along[0].y, along[1].y, along[2].y, odd),
              between(along[0].z, along[1].z, along[2].z, even), between(along[0].w, along[1].w, along[2].w, odd));
}

void main() {
  const ivec2 m = ivec2(gl_GlobalInvocationID.xy);
  if (m.x >= COLOR_WIDTH || m.y >= COLOR_HEIGHT) return;
  vec3 past[2][2], samples[kTaps + 1][kTaps + 1];
  const vec2 uv = (2.0 * vec2(m) + 0.5) / vec2(kOutput);
  const vec2 before = uv - long_motion(imageLoad(moving, m).rg, kOutput, 0.1);
  past_quad_catmull_rom(before, past);
  const Quad quad = quad_at(m);
  quad_samples(quad, samples);
  const QuadPlace place = quad_place(m, kRender);
  vec3 texels[3][3];
  [[unroll]] for (int y = 0; y < 3; ++y)
    [[unroll]] for (int x = 0; x < 3; ++x) texels[y][x] = value_texel(temporal, place.base + ivec2(x, y)).xyz;
  [[unroll]] for (int ox = 0; ox < 2; ++ox) {
    const int px = quad.pixel[ox].x;
    const vec4 columns[2] = vec4[2](ox == 0 ? column_of_quad(k0, place, quad, px) : column_of_quad(k1, place, quad, px),
                                    ox == 0 ? column_of_quad(k2, place, quad, px) : column_of_quad(k3, place, quad, px));
    [[unroll]] for (int oy = 0; oy < 2; ++oy) {
      Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), 0.0);
      [[unroll]] for (int y = 0; y < kTaps; ++y) {
        [[unroll]] for (int x = 0; x < kTaps; ++x) {
          const int iy = 2 * y + oy;
          add_sample(sum, 2 * x + ox, iy, max(columns[x][iy], 1e-7), quad_sample(quad, samples, ox, oy, x, y));
        }
      }
      const ivec2 pixel = quad_pixel(quad, ox, oy);
      const float fx = place.part.x + float(pixel.x) * place.step.x;
      const vec3 parameters =
          between(between(texels[0][0], texels[0][1], texels[0][2], fx),
                  between(texels[1][0], texels[1][1], texels[1][2], fx),
                  between(texels[2][0], texels[2][1], texels[2][2], fx), place.part.y + float(pixel.y) * place.step.y);
      show(2 * m + pixel,
           shown_color(sum, parameters, of_pixel(past, pixel), before + vec2(pixel) / vec2(kOutput)));
    }
  }
}
#else
/// A tensor of the network in 0..1; `b` in its padded picture. All of them share scale and zero point.
vec4 values_at(itextureBuffer tensor, Bilinear b) {
  vec4 sum = vec4(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * value_texel(tensor, b.base + ivec2(i & 1, i >> 1));
  return sum;
}

void pixel_at(ivec2 at) {
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Bilinear b = bilinear_at(uv * vec2(kRender) / vec2(kPadded), kPadded);
  const Axis x = axis_at(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH);
  const Axis y = axis_at(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT);
  Filtered sum = Filtered(0.0, vec3(0.0), vec3(0.0), 0.0);
  const vec4 columns[KERNEL] = vec4[KERNEL](values_at(k0, b), values_at(k1, b), values_at(k2, b), values_at(k3, b));
  [[unroll]] for (int ix = 0; ix < KERNEL; ++ix) {
    [[unroll]] for (int iy = 0; iy < KERNEL; ++iy) {
      if ((x.cells >> ix & 1u) == 0u || (y.cells >> iy & 1u) == 0u) continue;
      const ivec2 texel = inside(ivec2(texel_at(x, ix), texel_at(y, iy)), kRender);
      add_sample(sum, ix, iy, max(columns[ix][iy], 1e-7), sample_at(texel));
    }
  }
  if (sum.weight == 0.0) {
    const ivec2 texel = ivec2(closest_texel(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH),
                              closest_texel(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT));
    sum.first = sample_at(texel);
    sum.weight = 1.0;
  }
  const ivec2 texel = (2 * at + 1) * kRender / (2 * kOutput);
  const vec2 before = uv - long_motion(imageLoad(moving, texel).rg, kOutput, 0.1);
  show(at, shown_color(sum, values_at(temporal, b).xyz, past_catmull_rom(before), before));
}

void main() {
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = 2 * ivec2(gl_GlobalInvocationID.xy) + ivec2(i & 1, i >> 1);
    if (at.x < OUTPUT_WIDTH && at.y < OUTPUT_HEIGHT) pixel_at(at);
  }
}
#endif
