// shaders/frame/nfru/post.comp -- the picture at `time`: the mean of four samples by the network's weights.
//
// One invocation per output pixel. Reads the tensor "weights", int8 NHWC [1, h, w, 4], logits, between its pixels bilinear; BY_HAND the
// weights themselves (rgba8_unorm). Each sample then counts by its frame's nearness in time, and not at all off the screen.
// Samples are mixed as a display shows them. Where all are the same pixel, each met in its middle, the picture has that pixel:
// what does not change stays, bit for bit, whatever the weights. With a single frame the picture is that frame.
// Source: nfru.md section 3.4. Ours: the two factors, Catmull-Rom in place of bilinear colours.
#version 450
#include "common.glsl"
#include "../framegen/displayed.glsl"
#include "../nss/catmull_rom.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

#if BY_HAND
const ivec2 kPadded = kLane;
#else
const ivec2 kPadded = ivec2(WEIGHTS_WIDTH, WEIGHTS_HEIGHT);
#endif

/// Up to a factor, none of them 0.
vec4 weights_at(vec2 uv, vec4 seen) {
  const Bilinear b = bilinear_at(uv * vec2(kLane) / vec2(kPadded), kPadded);
  vec4 sum = vec4(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 from = bilinear_texel(b, i, kPadded);
#if BY_HAND
    sum += bilinear_weight(b.part, i) * fetch_weights(from);
  }
  return sum;
#else
    sum += bilinear_weight(b.part, i) * vec4(codes_weights(from.y * kPadded.x + from.x));
  }
  const vec4 logits = sum * float(WEIGHTS_SCALE), counted = mix(vec4(-1e3), logits, seen);
  const float top = max(max(counted.x, counted.y), max(counted.z, counted.w));
  return exp(clamp(logits - top, -60.0, 0.0));
#endif
}

/// Between pixels by Catmull-Rom, as displayed.
vec3 newest_at(vec2 uv) { RETURN_CATMULL_ROM(sample_displayed, uv, kOutput) }
vec3 previous_at(vec2 uv) { RETURN_CATMULL_ROM(sample_previous_displayed, uv, kOutput) }

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kOutput.x || at.y >= kOutput.y) return;
  const HALF4 newest = fetch_shown(at);
  if (params.frames < 2) {
    store_output(at, newest);
    return;
  }
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const Four four = four_at(uv, places(uv, (2 * at + 1) * kRender / (2 * kOutput)));
  const vec4 in_time = vec4(1.0 - params.time, params.time, 1.0 - params.time, params.time);
  vec4 w = weights_at(uv, four.seen * sign(in_time)) * in_time;
  const vec4 counted = w * four.seen;
  if (dot(counted, vec4(1.0)) > 0.0) w = counted;
  vec3 sum = vec3(0.0);
  HALF4 pixel = newest;
  bool alike = true, is_first = true;
  [[unroll]] for (int i = 0; i < kSamples; ++i) {
    if (w[i] <= 0.0) continue;
    const bool is_newest = i % 2 == 1;
    sum += w[i] * (is_newest ? newest_at(four.at[i]) : previous_at(four.at[i]));
    const vec2 place = four.at[i] * vec2(kOutput) - 0.5;
    const ivec2 middle = inside(ivec2(floor(place + 0.5)), kOutput);
    alike = alike && all(lessThan(abs(place - vec2(middle)), vec2(1.0 / 512.0)));
    if (!alike) continue;
    const HALF4 met = is_newest ? fetch_shown(middle) : fetch_previous_shown(middle);
    alike = is_first || met == pixel;
    pixel = met;
    is_first = false;
  }
  if (alike)
    store_output(at, pixel);
  else
    store_output(at, half4(linear_of(sum / dot(w, vec4(1.0)))));
}
