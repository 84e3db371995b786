// shaders/include/integer.glsl -- integer operators of TOSA that GLSL has not, or leaves open.

// ARITHMETIC_RIGHT_SHIFT with rounding: the bit shifted out last is added. 0 <= b < 32.
int shift_round(int a, int b) {
  return (a >> b) + (b > 0 ? (a >> (b - 1)) & 1 : 0);
}

// INTDIV truncates. Division by 0 and -2^31 / -1 have no result in TOSA, and trap on some processors.
int divide(int a, int b) {
  bool undefined = b == 0 || (b == -1 && a == int(0x80000000u));
  return undefined ? 0 : a / b;
}

// MUL with 1 <= shift <= 63. The one product whose rounding leaves 64 bits has the exact answer 1.
int multiply_round(int a, int b, int shift) {
  bool corner = shift == 63 && a == int(0x80000000u) && b == a;
  return corner ? 1 : scale_round(a, b, shift, false);
}

// Source row or column of RESIZE in nearest mode: o is the output position, n / d the scale, `size` the
// input's extent. The quotient is at least -1, which both neighbours clamp to 0. Ties go up.
int nearest(int o, int n, int d, int offset, int size) {
  int position = o * d + offset;
  int base = (position + n) / n - 1;
  int fraction = position - base * n;
  return 2 * fraction >= n ? min(base + 1, size - 1) : max(base, 0);
}
