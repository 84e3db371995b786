// shaders/frame/nss/warped.glsl -- the history as the networks see it: bilinear at uv, exposed, Karis. Expects the image
// `history`.

vec3 history_at(vec2 uv) {
  const Bilinear b = bilinear_at(uv, kOutput);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * HISTORY_TEXEL(history, bilinear_texel(b, i, kOutput)).rgb;
  return karis(exposed(sum, params.exposure));
}
