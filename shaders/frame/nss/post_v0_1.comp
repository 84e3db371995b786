// shaders/frame/nss/post_v0_1.comp -- filter, rectify, accumulate: the post pass of NSS v0.1.
//
// One invocation per output pixel: the samples of this frame that fall into its 4x4 kernel, weighted by the tensors k0
// to k3 (a column each, 4 channels a texel); the history, blended in as the network says; a sample that lies on the
// pixel itself, blended in. All of it in exposed colours of the Karis domain, where the notes take linear ones: a display
// shows means of it. Output and history are linear, with the exposure removed.
// Source: nss.md sections 3.1 to 3.3; tools/train/nss_passes.py computes the same.
#version 450
#include "common.glsl"
#define KERNEL 4
#include "taps.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1) uniform texture2D motion;
layout(set = 0, binding = 2) uniform texture2D nearest;
layout(set = 0, binding = 3) uniform texture2D history;        // one frame back
layout(set = 0, binding = 4) uniform itextureBuffer temporal;
layout(set = 0, binding = 5) uniform itextureBuffer k0;
layout(set = 0, binding = 6) uniform itextureBuffer k1;
layout(set = 0, binding = 7) uniform itextureBuffer k2;
layout(set = 0, binding = 8) uniform itextureBuffer k3;
layout(set = 0, binding = 9, rgba16f) writeonly uniform image2D shown;
layout(set = 0, binding = 10, rgba16f) writeonly uniform image2D new_history;

const ivec2 kPadded = ivec2(TEMPORAL_WIDTH, TEMPORAL_HEIGHT);

/// A tensor of the network in 0..1; `b` in its padded picture. All of them share scale and zero point.
vec4 values_at(itextureBuffer tensor, Bilinear b) {
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; ++i) {
    const ivec2 at = bilinear_texel(b, i, kPadded);
    sum += bilinear_weight(b.part, i) * vec4(texelFetch(tensor, at.y * kPadded.x + at.x) - TEMPORAL_ZERO_POINT);
  }
  return sum * float(TEMPORAL_SCALE);
}

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= OUTPUT_WIDTH || at.y >= OUTPUT_HEIGHT) return;
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Bilinear b = bilinear_at(uv * vec2(kRender) / vec2(kPadded), kPadded);

  const Axis x = axis_at(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH);
  const Axis y = axis_at(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT);
  vec3 sum = vec3(0.0), centre = vec3(0.0);
  float total = 0.0;
  bool has_centre = false;
  for (int ix = 0; ix < KERNEL; ++ix) {
    if ((x.cells >> ix & 1u) == 0u) continue;
    const vec4 column = ix == 0 ? values_at(k0, b) : ix == 1 ? values_at(k1, b) : ix == 2 ? values_at(k2, b) : values_at(k3, b);
    for (int iy = 0; iy < KERNEL; ++iy) {
      if ((y.cells >> iy & 1u) == 0u) continue;
      const ivec2 texel = inside(ivec2(texel_at(x, ix), texel_at(y, iy)), kRender);
      const vec3 c = karis(exposed(finite_color(texelFetch(color, texel, 0).rgb), params.exposure));
      const float weight = max(column[iy], 1e-7);
      sum += weight * c;
      total += weight;
      if (ix == -kFirst && iy == -kFirst) {
        centre = c;
        has_centre = true;
      }
    }
  }
  if (total == 0.0) {
    const ivec2 texel = ivec2(closest_texel(at.x, params.jitter.x, COLOR_WIDTH, OUTPUT_WIDTH),
                              closest_texel(at.y, params.jitter.y, COLOR_HEIGHT, OUTPUT_HEIGHT));
    sum = karis(exposed(finite_color(texelFetch(color, texel, 0).rgb), params.exposure));
    total = 1.0;
  }
  vec3 mixed = sum / total;
  const vec4 p = values_at(temporal, b);
  if (params.reset == 0) {
    const ivec2 texel = (2 * at + 1) * kRender / (2 * kOutput);
    const int code = int(texelFetch(nearest, texel, 0).r * 255.0 + 0.5);
    const ivec2 offset = ivec2(code & 3, code >> 2) - 1;
    const vec2 before = uv - motion_at(motion, inside(texel + offset, kRender), kOutput, 0.1);
    const vec3 past = clamp(sample_catmull_rom_mapped(history, before, kOutput, params.exposure), 0.0, 1.0);
    mixed = mix(mixed, past, on_screen(before) ? p.x : 0.0);
  }
  if (has_centre) mixed = mix(mixed, centre, 0.35 * p.y + 0.05);
  const vec4 result = vec4(min(karis_inverse(mixed) / params.exposure, kMaxColor), 1.0);
  imageStore(shown, at, result);
  imageStore(new_history, at, result);
}
