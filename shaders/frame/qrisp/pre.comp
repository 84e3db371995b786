// shaders/frame/qrisp/pre.comp -- pass 2 of QRISP: warps the history to the frame, and fills the network's input.
//
// Reads color, depth, the blocks' motion, and of the frame before history (rgba16_float, as displayed) and features
// (r8_unorm), both at output size. Writes the tensor "input", int8 NHWC [1, h, w, 6 + 4 s^2], sides even: colour,
// nearness, jitter, warped colour by phases, warped feature; and warped, the warped colour at output size. With CUBIC the
// colour is read by Catmull-Rom. One invocation per two render texels side by side, so that codes come in whole words.
// Source: QRISP (ICCV 2023), seed_networks.md sections 2.1 and 2.3.
#version 450
#include "common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

#ifdef CUBIC
#include "../nss/catmull_rom.glsl"
vec3 past_at(vec2 uv) { RETURN_CATMULL_ROM(sample_history, uv, kOutput) }
#else
vec3 past_at(vec2 uv) { return rgb_of(sample_history(uv)); }
#endif

int code(float x) { return clamp(int(floor(x / float(INPUT_SCALE) + 0.5)) + INPUT_ZERO_POINT, -128, 127); }

void main() {
  const ivec2 base = ivec2(gl_GlobalInvocationID.xy) * ivec2(2, 1);
  if (base.x >= INPUT_WIDTH || base.y >= INPUT_HEIGHT) return;
  int codes[2 * INPUT_CHANNELS];
  [[unroll]] for (int i = 0; i < 2; ++i) {
    const int first = i * INPUT_CHANNELS;
    const ivec2 at = inside(base + ivec2(i, 0), kRender);
    const vec3 color = displayed(exposed(finite_color(rgb_of(fetch_color(at))), params.exposure));
    const float depth = finite_depth(fetch_depth(at));
    codes[first + 0] = code(color.r);
    codes[first + 1] = code(color.g);
    codes[first + 2] = code(color.b);
    codes[first + 3] = code(sqrt(sqrt(params.reverse_depth != 0 ? depth : 1.0 - depth)));
    codes[first + 4] = code(finite_jitter().x + 0.5);
    codes[first + 5] = code(finite_jitter().y + 0.5);
    [[unroll]] for (int phase = 0; phase < kPhases; ++phase) {
      const ivec2 pixel = at * kScale + ivec2(phase % kScale, phase / kScale);
      const vec2 uv = (vec2(pixel) + 0.5) / vec2(kOutput) - xy_of(fetch_moved(pixel / kBlock));
      const vec3 past = past_at(uv);
      const float feature = sample_features(uv);
      codes[first + 6 + phase] = code(past.r);
      codes[first + 6 + kPhases + phase] = code(past.g);
      codes[first + 6 + 2 * kPhases + phase] = code(past.b);
      codes[first + 6 + 3 * kPhases + phase] = code(feature);
      if (base + ivec2(i, 0) == at) store_warped(pixel, half4(past));
    }
  }
  const int word = (base.y * INPUT_WIDTH + base.x) / 2 * (INPUT_CHANNELS / 2);
  [[unroll]] for (int i = 0; i < INPUT_CHANNELS / 2; ++i)
    store_word_input(word + i, whole(uint(codes[4 * i] & 255 | (codes[4 * i + 1] & 255) << 8 |
                                          (codes[4 * i + 2] & 255) << 16 | (codes[4 * i + 3] & 255) << 24)));
}
