// shaders/frame/nss/quad.glsl -- at x2, the samples in the kernels of the four output pixels of a render texel.
//
// Along one axis, with `shift` as in axis_at, sample l lies in output cell 2 * l + shift. Of the two pixels, one has
// its samples in the even cells of its kernel, the other in the odd ones; called so, each has samples in fixed cells:
// the k-th in cell 2 * k + odd. With t = shift + KERNEL / 2 - 1 - odd, it is pixel t & 1, and its first sample is that
// of render texel m - (t >> 1). Expects `sample_at`, the colour of a sample.
#define IS_DOUBLE (OUTPUT_WIDTH == 2 * COLOR_WIDTH && OUTPUT_HEIGHT == 2 * COLOR_HEIGHT)

const int kTaps = KERNEL / 2;  // per axis

struct Quad {
  ivec2 pixel[2];  // of the even and of the odd one, 0 or 1
  ivec2 first;     // texel of the first sample of the even one, not clamped
  ivec2 apart;     // from there to the first sample of the odd one, 0 or 1
};
Quad quad_at(ivec2 m) {
  const ivec2 shift = (ivec2(floor(clamp(params.jitter, -0.5, 0.5) * 65536.0 + 0.5)) + 32768) >> 15;
  const ivec2 even = shift + kTaps - 1, odd = even - 1;
  return Quad(ivec2[2](even & 1, odd & 1), m - (even >> 1), (even >> 1) - (odd >> 1));
}

/// Pixel of the even or odd one along x (ox) and along y (oy).
ivec2 quad_pixel(Quad quad, int ox, int oy) { return ivec2(quad.pixel[ox].x, quad.pixel[oy].y); }

/// One of four values by pixel, [y][x].
vec3 of_pixel(vec3 values[2][2], ivec2 pixel) {
  return pixel.y != 0 ? (pixel.x != 0 ? values[1][1] : values[1][0]) : (pixel.x != 0 ? values[0][1] : values[0][0]);
}

/// The samples of all four kernels, [y][x].
void quad_samples(Quad quad, out vec3 samples[kTaps + 1][kTaps + 1]) {
  [[unroll]] for (int y = 0; y <= kTaps; ++y)
    [[unroll]] for (int x = 0; x <= kTaps; ++x)
      samples[y][x] = sample_at(inside(quad.first + ivec2(x, y), kRender));
}

/// The x-th and y-th of one pixel.
vec3 quad_sample(Quad quad, vec3 samples[kTaps + 1][kTaps + 1], int ox, int oy, int x, int y) {
  vec3 c = samples[y][x];
  if (ox == 1) c = quad.apart.x != 0 ? samples[y][x + 1] : c;
  if (oy == 1) c = quad.apart.y != 0 ? samples[y + 1][x] : c;
  if (ox == 1 && oy == 1) c = quad.apart.x != 0 && quad.apart.y != 0 ? samples[y + 1][x + 1] : c;
  return c;
}

/// Where a picture of `size` texels for the render picture is read for the four pixels: they lie less than a texel
/// apart, so between three texels an axis.
struct QuadPlace {
  ivec2 base;
  vec2 part, step;  // of the first pixel behind base; from the first to the second
};
QuadPlace quad_place(ivec2 m, ivec2 size) {
  const vec2 step = 0.5 * vec2(size) / vec2(kRender);
  const vec2 place = (2.0 * vec2(m) + 0.5) * step - 0.5;
  return QuadPlace(ivec2(floor(place)), place - floor(place), step);
}
float between(float a, float b, float c, float f) { return f < 1.0 ? mix(a, b, f) : mix(b, c, f - 1.0); }
vec3 between(vec3 a, vec3 b, vec3 c, float f) { return f < 1.0 ? mix(a, b, f) : mix(b, c, f - 1.0); }
