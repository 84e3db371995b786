// shaders/frame/nss/quad.glsl -- at x2, the samples in the kernels of the four output pixels of a render texel.
//
// Along one axis, with `shift` as in axis_at, sample l lies in output cell 2 * l + shift. Of the two pixels, one has
// its samples in the even cells of its kernel, the other in the odd ones; called so, each has samples in fixed cells:
// the k-th in cell 2 * k + odd. With t = shift + KERNEL / 2 - 1 - odd, it is pixel t & 1, and its first sample is that
// of render texel m - (t >> 1). Expects the image `color` and `sample_of`, a sample of its texel.
const int kTaps = KERNEL / 2;  // per axis

struct Quad {
  ivec2 pixel[2];  // of the even and of the odd one, 0 or 1
  ivec2 first;     // texel of the first sample of the even one, not clamped
  ivec2 apart;     // from there to the first sample of the odd one, 0 or 1
};
Quad quad_at(ivec2 m) {
  const ivec2 shift = (ivec2(floor(clamp(params.jitter, -0.5, 0.5) * 65536.0 + 0.5)) + 32768) >> 15;
  const ivec2 even = shift + kTaps - 1, odd = even - 1;
  // With shift 0 or 1, an odd count of taps has the even pixel's first sample in one place.
  const ivec2 back = kTaps % 2 == 1 ? ivec2(kTaps / 2) : even >> 1;
  return Quad(ivec2[2](even & 1, odd & 1), m - back, back - (odd >> 1));
}

/// Pixel of the even or odd one along x (ox) and along y (oy).
ivec2 quad_pixel(Quad quad, int ox, int oy) { return ivec2(quad.pixel[ox].x, quad.pixel[oy].y); }

/// One of four values by pixel, [y][x].
vec3 of_pixel(vec3 values[2][2], ivec2 pixel) {
  return pixel.y != 0 ? (pixel.x != 0 ? values[1][1] : values[1][0]) : (pixel.x != 0 ? values[0][1] : values[0][0]);
}

/// The samples of the eight kernels of two quads, at m and to its right, m.x even: [y][x].
void two_quads_samples(Quad quad, ivec2 m, out vec3 samples[kTaps + 1][kTaps + 2]) {
  [[unroll]] for (int y = 0; y <= kTaps; ++y) {
    const int row = clamp(quad.first.y + y, 0, COLOR_HEIGHT - 1), two = m.x >> 1;
    HALF4 left[2], middle[2], right[2];
    fetch2_color(ivec2(max(two - 1, 0), row), left);
    fetch2_color(ivec2(two, row), middle);
    fetch2_color(ivec2(min(two + 1, (COLOR_WIDTH - 1) / 2), row), right);
    // Beyond the border the last one counts again.
    HALF4 words[5] = HALF4[5](left[1], middle[0], middle[1], right[0], right[1]);
    words[0] = m.x == 0 ? words[1] : words[0];
    [[unroll]] for (int x = 2; x < 5; ++x) words[x] = m.x + x - 1 < COLOR_WIDTH ? words[x] : words[x - 1];
    vec3 five[5];
    [[unroll]] for (int x = 0; x < 5; ++x) five[x] = sample_of(words[x]);
    [[unroll]] for (int x = 0; x < kTaps + 2; ++x)
      samples[y][x] = x == 4 || quad.first.x == m.x - 1 ? five[x] : five[min(x + 1, 4)];
  }
}

/// The x-th and y-th of one pixel; x counts from the first quad's.
vec3 two_quads_sample(Quad quad, vec3 samples[kTaps + 1][kTaps + 2], int ox, int oy, int x, int y) {
  vec3 c = samples[y][x];
  if (ox == 1) c = quad.apart.x != 0 ? samples[y][x + 1] : c;
  if (oy == 1) {
    vec3 below = samples[y + 1][x];
    if (ox == 1) below = quad.apart.x != 0 ? samples[y + 1][x + 1] : below;
    c = quad.apart.y != 0 ? below : c;
  }
  return c;
}

/// Columns m.x - 1 to m.x + 2 and rows m.y - 1 to m.y + 1 of a tensor of four channels as large as the render picture, padded
/// to `size`, m.x even: in two fetches a row, [y][x]. The pixels of two quads lie a quarter of a texel around the middles of
/// two of them, see quarter().
#define FETCH_FOUR_COLUMNS(words4_of_tensor, m, size, words)                                                    \
  {                                                                                                             \
    const int first = (m.x - 1) >> 2;                                                                           \
    const bool late = (m.x & 2) == 0;                                                                           \
    [[unroll]] for (int y = 0; y < 3; ++y) {                                                                    \
      const int line = clamp(m.y + y - 1, 0, size.y - 1) * (size.x / 4);                                        \
      const uvec4 a = words4_of_tensor(line + max(first, 0));                                                   \
      const uvec4 b = words4_of_tensor(line + min(first + 1, size.x / 4 - 1));                                  \
      words[y] = uint[4](late ? a.w : a.y, late ? b.x : a.z, late ? b.y : a.w, late ? b.z : b.x);               \
      words[y][0] = m.x == 0 ? words[y][1] : words[y][0];                                                       \
      words[y][3] = m.x + 2 < size.x ? words[y][3] : words[y][2];                                               \
    }                                                                                                           \
  }

/// The share of the second of the two texels between which the first or second pixel of a quad lies.
float quarter(int pixel) { return pixel == 0 ? 0.75 : 0.25; }

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
