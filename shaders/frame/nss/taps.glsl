// shaders/frame/nss/taps.glsl -- which cells of the kernel around an output pixel hold a sample of this frame.
//
// Per axis, the sample of render texel l lies in output cell floor((l + 0.5 + jitter) * s), s = output / render size.
// Computed in integers, so that no two pixels disagree: with J = round(65536 * jitter), render size w, output size W:
// floor((l * 65536 + 32768 + J) * W / (w * 65536)). Sizes up to 16384 keep each product below 2^31 once whole texels
// are divided off. As s >= 1, a cell holds at most one sample, and the samples in the kernel are consecutive texels.
// Source: nss.md section 3.2.

const int kFirst = 1 - KERNEL / 2;  // kernel offsets are kFirst .. kFirst + KERNEL - 1

/// The samples in the kernel along one axis.
struct Axis {
  uint cells;  // bit i: the cell at offset kFirst + i holds one
  int texel;   // of the first of them, not clamped; each next cell holds the next texel
};

Axis axis_at(int at, float jitter_texels, int render, int size) {
  const int jitter = int(floor(clamp(jitter_texels, -0.5, 0.5) * 65536.0 + 0.5));
  Axis axis = Axis(0u, 0);
  if (size % render == 0) {
    // Whole ratios: cell(l) = l * s + shift.
    const int s = size / render;
    const int shift = ((32768 + jitter) * s) >> 16;
    const int from = at + kFirst - shift + s * KERNEL;  // not negative
    const int i = (s - from % s) % s;
    for (int n = i; n < KERNEL; n += s) axis.cells |= 1u << n;
    axis.texel = (from + i) / s - KERNEL;
    return axis;
  }
  // Whole pictures are added where a division must not see a negative number.
  const int pictures = render < 8 ? 8 : 1;
  const int low = (at + kFirst + pictures * size) * render / size - pictures * render - 1;
  for (int n = 0; n < KERNEL + 3; ++n) {
    const int l = low + n;
    const int scaled = (l + (pictures + 1) * render) * size;
    const uint rest = uint(scaled % render);
    const int cell = scaled / render - (pictures + 1) * size +
                     int((rest * 65536u + uint(32768 + jitter) * uint(size)) / (uint(render) * 65536u));
    const int i = cell - at - kFirst;
    if (i < 0 || i >= KERNEL) continue;
    if (axis.cells == 0u) axis.texel = l;
    axis.cells |= 1u << i;
  }
  return axis;
}

/// Texel of the cell with index i, one of axis.cells.
int texel_at(Axis axis, int i) { return axis.texel + bitCount(axis.cells & ((1u << i) - 1u)); }

/// The render texel whose sample is closest to output pixel `at`, for a kernel without any.
int closest_texel(int at, float jitter_texels, int render, int size) {
  return clamp(int(floor((float(at) + 0.5) * float(render) / float(size) - jitter_texels)), 0, render - 1);
}
