// shaders/frame/nss/catmull_rom.glsl -- filtered reads between texels by five bilinear taps. Expects color.glsl; the last one
// bilinear_at.

/// Catmull-Rom from the cross of the twelve texels around a place without the four corners, the weights made to sum to
/// 1: where between the two middle texels of an axis the middle tap lies, and the weights of the five taps.
/// Source: nss.md section 3.1.
struct CatmullRom {
  vec2 mid;
  float centre, left, right, up, down;
};
CatmullRom catmull_rom(vec2 f) {
  const vec2 f2 = f * f, f3 = f2 * f;
  const vec2 w0 = f2 - 0.5 * (f3 + f);
  const vec2 w1 = 1.5 * f3 - 2.5 * f2 + 1.0;
  const vec2 w3 = 0.5 * (f3 - f2);
  const vec2 w2 = 1.0 - w0 - w1 - w3;
  const vec2 w12 = w1 + w2;
  CatmullRom w =
      CatmullRom(w2 / w12, w12.x * w12.y, w0.x * w12.y, w3.x * w12.y, w12.x * w0.y, w12.x * w3.y);
  const float scale = 1.0 / (w.centre + w.left + w.right + w.up + w.down);
  w.centre *= scale, w.left *= scale, w.right *= scale, w.up *= scale, w.down *= scale;
  return w;
}

/// The five taps as one, in 0..1. Where a channel comes out negative or above kNoOvershoot, all are clamped to the taps.
vec3 combine(CatmullRom w, vec3 centre, vec3 left, vec3 right, vec3 up, vec3 down) {
  const vec3 sum = w.centre * centre + w.left * left + w.right * right + w.up * up + w.down * down;
  const vec3 low = least(centre, least(least(left, right), least(up, down)));
  const vec3 high = most(centre, most(most(left, right), most(up, down)));
  const bool beyond = any(lessThan(sum, vec3(0.0))) || any(greaterThan(sum, vec3(kNoOvershoot)));
  const vec3 kept = beyond ? least(most(sum, low), high) : sum;
  return least(most(kept, vec3(0.0)), vec3(1.0));
}

/// The body of a function: a picture of `extent` between its pixels at uv, read by `sample`, which is bilinear.
#define RETURN_CATMULL_ROM(sample, uv, extent)                                                              \
  const vec2 size = vec2(extent);                                                                           \
  const Bilinear b = bilinear_at(uv, extent);                                                               \
  const CatmullRom w = catmull_rom(b.part);                                                                 \
  const vec2 base = vec2(b.base) + 0.5, mid = base + w.mid;                                                 \
  const vec3 centre = rgb_of(sample(mid / size)), left = rgb_of(sample(vec2(base.x - 1.0, mid.y) / size)),  \
             right = rgb_of(sample(vec2(base.x + 2.0, mid.y) / size)),                                      \
             up = rgb_of(sample(vec2(mid.x, base.y - 1.0) / size)),                                         \
             down = rgb_of(sample(vec2(mid.x, base.y + 2.0) / size));                                       \
  return combine(w, centre, left, right, up, down);
