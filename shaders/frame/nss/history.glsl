// shaders/frame/nss/history.glsl -- filtered reads of the history in the post passes, between texels in the exposed
// Karis domain. Expects the image `history` and catmull_rom.glsl. Pixels side by side that move alike share most of their texels.

vec3 past_texel(ivec2 at) { return karis_of(rgb_of(fetch_history(inside(at, kOutput)))); }

/// The texels that the next function filters, as they lie in memory, [y][x]: fetched apart, so that many fetches are under
/// way at once.
void fetch_quad_catmull_rom(Bilinear b, out HALF4 raw[5][5]) {
  [[unroll]] for (int y = 0; y < 5; ++y)
    [[unroll]] for (int x = 0; x < 5; ++x)
      if ((x != 0 && x != 4) || (y != 0 && y != 4)) raw[y][x] = fetch_history(inside(b.base + ivec2(x, y) - 1, kOutput));
}

/// The history at b and at its neighbours one texel to the right and below, [y][x], in 0..1.
void past_quad_catmull_rom(Bilinear b, HALF4 raw[5][5], out vec3 past[2][2]) {
  const CatmullRom w = catmull_rom(b.part);
  vec3 texels[5][5];
  [[unroll]] for (int y = 0; y < 5; ++y)
    [[unroll]] for (int x = 0; x < 5; ++x)
      if ((x != 0 && x != 4) || (y != 0 && y != 4)) texels[y][x] = karis_of(rgb_of(raw[y][x]));
  vec3 along[5][2], down[2][5];
  [[unroll]] for (int y = 0; y < 5; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x) along[y][x] = mix(texels[y][x + 1], texels[y][x + 2], w.mid.x);
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 5; ++x)
      if (x != 2) down[y][x] = mix(texels[y + 1][x], texels[y + 2][x], w.mid.y);
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x)
      past[y][x] = combine(w, mix(along[y + 1][x], along[y + 2][x], w.mid.y), down[y][x], down[y][x + 3], along[y][x],
                           along[y + 3][x]);
}

/// As the two before, bilinear.
void fetch_quad_linear(Bilinear b, out HALF4 raw[3][3]) {
  [[unroll]] for (int y = 0; y < 3; ++y)
    [[unroll]] for (int x = 0; x < 3; ++x) raw[y][x] = fetch_history(inside(b.base + ivec2(x, y), kOutput));
}
void past_quad_linear(Bilinear b, HALF4 raw[3][3], out vec3 past[2][2]) {
  vec3 along[3][2];
  [[unroll]] for (int y = 0; y < 3; ++y) {
    vec3 t[3];
    [[unroll]] for (int x = 0; x < 3; ++x) t[x] = karis_of(rgb_of(raw[y][x]));
    [[unroll]] for (int x = 0; x < 2; ++x) along[y][x] = mix(t[x], t[x + 1], b.part.x);
  }
  [[unroll]] for (int y = 0; y < 2; ++y)
    [[unroll]] for (int x = 0; x < 2; ++x) past[y][x] = mix(along[y][x], along[y + 1][x], b.part.y);
}

/// What the filters give at the middle of a texel: Catmull-Rom is in 0..1.
vec3 past_still(HALF4 texel) { return karis_of(rgb_of(texel)); }
vec3 past_still_catmull_rom(HALF4 texel) { return least(most(past_still(texel), vec3(0.0)), vec3(1.0)); }

/// The history at uv alone; rests: nothing moves there.
vec3 past_linear(vec2 uv, bool rests) {
  const Bilinear b = bilinear_at(uv, kOutput, rests);
  vec3 sum = vec3(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i)
    sum += bilinear_weight(b.part, i) * past_texel(b.base + ivec2(i & 1, i >> 1));
  return sum;
}

vec3 past_catmull_rom(vec2 uv, bool rests) {
  const Bilinear b = bilinear_at(uv, kOutput, rests);
  const CatmullRom w = catmull_rom(b.part);
  #define SHALE_AT(x, y) past_texel(b.base + ivec2(x, y))
  const vec3 c =
      mix(mix(SHALE_AT(0, 0), SHALE_AT(1, 0), w.mid.x), mix(SHALE_AT(0, 1), SHALE_AT(1, 1), w.mid.x), w.mid.y);
  const vec3 l = mix(SHALE_AT(-1, 0), SHALE_AT(-1, 1), w.mid.y), r = mix(SHALE_AT(2, 0), SHALE_AT(2, 1), w.mid.y);
  const vec3 u = mix(SHALE_AT(0, -1), SHALE_AT(1, -1), w.mid.x), d = mix(SHALE_AT(0, 2), SHALE_AT(1, 2), w.mid.x);
  #undef SHALE_AT
  return combine(w, c, l, r, u, d);
}
