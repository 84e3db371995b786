// shaders/frame/nss/warped.glsl -- the history as the networks see it: bilinear at uv, exposed, Karis. Expects the texel
// buffer `history`.
#include "history_texel.glsl"

/// The four texels around, as they lie in memory.
void fetch_history(Bilinear b, out uvec2 words[4]) {
  [[unroll]] for (int i = 0; i < 4; ++i) words[i] = history_words(bilinear_texel(b, i, kOutput));
}
vec3 warped(Bilinear b, uvec2 words[4]) {
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) sum += bilinear_weight(b.part, i) * half_rgb(words[i]);
  return karis_of(sum);
}
