// shaders/include/functions.glsl -- EXP, LOG, POW, SIN, ... of float32 within what TOSA asks, from operations that Vulkan
// rounds correctly: its own functions are allowed larger errors, most of all near 0 and for large angles. Coefficients that
// are no quotients of a series are least maximal relative errors (erf: absolute), fitted in double precision: below 0.1
// units in the last place. Needs real.glsl.

float nan() { return uintBitsToFloat(0x7fc00000u); }
float infinity() { return uintBitsToFloat(0x7f800000u); }

// x * 2^n for -252 <= n <= 254, in two factors that are numbers.
float scaled(float x, int n) {
  int half_n = n >> 1;
  precise float once = x * uintBitsToFloat(uint(half_n + 127) << 23);
  return once * uintBitsToFloat(uint(n - half_n + 127) << 23);
}

// ln 2 as 355/512, which times any exponent is exact, and the rest.
const float kLn2High = 0.693359375, kLn2Low = -2.12194440e-4;

// e^x = 2^n e^r with |r| <= ln 2 / 2; the series to r^7 leaves 5e-9.
float real_exp(float x) {
  float bounded = clamp(x, -104.0, 89.0);
  float n = roundEven(bounded * 1.44269504);
  precise float r = (bounded - n * kLn2High) - n * kLn2Low;
  precise float p = 1.0 / 5040.0;
  p = p * r + 1.0 / 720.0;
  p = p * r + 1.0 / 120.0;
  p = p * r + 1.0 / 24.0;
  p = p * r + 1.0 / 6.0;
  p = p * r + 0.5;
  precise float y = 1.0 + (r + r * r * p);
  return is_nan(x) ? x : scaled(y, int(n));
}

// log(2^k (1 + f)) with 1 + f from sqrt(1/2) to sqrt(2): s = f / (2 + f), log(1 + f) = 2 s + 2 s^3/3 + 2 s^5/5 + ...,
// written so that f, which is exact, is the largest term and the quotient's error counts by s alone.
float real_log(float x) {
  uint bits = floatBitsToUint(x);
  bool small = bits < 0x00800000u;  // a subnormal as an integer times 2^-149
  uint normal = small ? floatBitsToUint(float(bits)) : bits;
  uint fraction = normal & 0x7fffffu, up = fraction >= 0x3504f3u ? 1u : 0u;
  float k = float(int(normal >> 23) - 127 + int(up) - (small ? 149 : 0));
  precise float f = uintBitsToFloat(fraction | (0x3f800000u - (up << 23))) - 1.0;
  precise float s = f / (2.0 + f), z = s * s, half_square = 0.5 * f * f;
  precise float rest = z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * (2.0 / 7.0 + z * (2.0 / 9.0))));
  precise float y = k * kLn2High - ((half_square - (s * (half_square + rest) + k * kLn2Low)) - f);
  if ((bits & 0x7fffffffu) == 0u) return -infinity();
  return bits > 0x7f800000u ? nan() : bits == 0x7f800000u ? x : y;
}

// |x|^y = e^(y log |x|), whose error TOSA lets grow with the exponent. A negative x takes integers alone.
float real_pow(float x, float y) {
  if (is_nan(x) || is_nan(y)) return nan();
  if (y == 0.0 || x == 1.0) return 1.0;
  bool whole = floor(y) == y, odd = whole && abs(y) < 16777216.0 && floor(0.5 * y) != 0.5 * y;
  if (abs(x) == 1.0 && abs(y) == infinity()) return 1.0;
  precise float exponent = y * real_log(abs(x));
  float magnitude = real_exp(exponent);
  bool negative = (floatBitsToUint(x) & 0x80000000u) != 0u;
  if (negative && !whole && x != 0.0 && x != -infinity()) return nan();
  return negative && odd ? -magnitude : magnitude;
}

// Word `i`, at most 7, of 2/pi after 32 zero bits. No array: a CPU driver would write it to memory for every argument.
uint two_over_pi(uint i) {
  uint even = i < 4u ? (i < 2u ? 0u : 0x4e441529u) : (i < 6u ? 0xf534ddc0u : 0x3c439041u);
  uint odd = i < 4u ? (i < 2u ? 0xa2f9836eu : 0xfc2757d1u) : (i < 6u ? 0xdb629599u : 0xfe5163abu);
  return (i & 1u) == 0u ? even : odd;
}

// x = quarter * pi/2 + rest, |rest| <= pi/4: x is an integer of 24 bits times 2^s, and of 2/pi only the 96 bits count that
// do not give multiples of 4 (Payne and Hanek, 1983). The rest is exact to 2^-32.
float reduced(float x, out uint quarter) {
  uint bits = floatBitsToUint(abs(x));
  quarter = 0u;
  if (bits < 0x3f490fdbu) return x;  // below pi/4
  uint m = (bits & 0x7fffffu) | 0x800000u, first = min(bits >> 23, 254u) - 120u;
  uint word = first >> 5, shift = first & 31u;
  uint a = two_over_pi(word), b = two_over_pi(word + 1u), c = two_over_pi(word + 2u), d = two_over_pi(word + 3u);
  // In two shifts, since one by 32 is undefined.
  uint high2, low2, high1, low1, carry;
  umulExtended(m, (c << shift) | (d >> 1 >> (31u - shift)), high2, low2);
  umulExtended(m, (b << shift) | (c >> 1 >> (31u - shift)), high1, low1);
  uint middle = uaddCarry(low1, high2, carry);
  uint top = m * ((a << shift) | (b >> 1 >> (31u - shift))) + high1 + carry;
  uint fraction = (top << 2) | (middle >> 30);
  quarter = (top >> 30) + (fraction >> 31);  // to the nearest multiple
  precise float rest = float(int(fraction)) * (1.57079637 / 4294967296.0);
  if (x < 0.0) quarter = 0u - quarter;
  return x < 0.0 ? -rest : rest;
}

// The sine of `quarter` quarter turns and r.
float turned(float r, uint quarter) {
  precise float z = r * r;
  precise float sine = r * (1.0 - z * (1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z * (1.0 / 362880.0)))));
  precise float cosine = 1.0 - z * (0.5 - z * (1.0 / 24.0 - z * (1.0 / 720.0 - z * (1.0 / 40320.0 - z * (1.0 / 3628800.0)))));
  float value = (quarter & 1u) != 0u ? cosine : sine;
  return (quarter & 2u) != 0u ? -value : value;
}

bool is_number(float x) { return (floatBitsToUint(x) & 0x7fffffffu) < 0x7f800000u; }

float real_sin(float x) {
  uint quarter;
  float r = reduced(x, quarter);
  return !is_number(x) ? nan() : turned(r, quarter);
}

float real_cos(float x) {
  uint quarter;
  float r = reduced(x, quarter);
  return !is_number(x) ? nan() : turned(r, quarter + 1u);
}

// The quotient, corrected by what 1 - x y is exactly: halves of 12 bits have products without an error.
float real_reciprocal(float x) {
  float y = 1.0 / x;
  float size = abs(x);
  if (!(size > 2.3509887e-38 && size < 4.2535296e37)) return y;  // 2^-125 to 2^125
  float xh = uintBitsToFloat(floatBitsToUint(x) & 0xfffff000u), yh = uintBitsToFloat(floatBitsToUint(y) & 0xfffff000u);
  precise float xl = x - xh, yl = y - yh;
  precise float off = ((1.0 - xh * yh) - xh * yl - xl * yh) - xl * yl;
  precise float corrected = y + y * off;
  return corrected;
}

// A subnormal may be taken as 0. Vulkan's own is within 2 units in the last place.
float real_rsqrt(float x) {
  if (x == 0.0) return (floatBitsToUint(x) & 0x80000000u) != 0u ? -infinity() : infinity();
  if (x == infinity()) return 0.0;
  return x < 0.0 || is_nan(x) ? nan() : inversesqrt(x);
}

float real_sigmoid(float x) {
  precise float e = real_exp(-abs(x));
  precise float y = (x < 0.0 ? e : 1.0) / (1.0 + e);
  return is_nan(x) ? x : y;
}

float with_sign(float magnitude, float x) {
  return uintBitsToFloat((floatBitsToUint(magnitude) & 0x7fffffffu) | (floatBitsToUint(x) & 0x80000000u));
}

float real_tanh(float x) {
  float size = abs(x);
  precise float z = x * x;
  precise float p = -0.00570498733;
  p = p * z + 0.0206390880;
  p = p * z - 0.0537397154;
  p = p * z + 0.133314416;
  p = p * z - 0.333332807;
  precise float near = size + size * z * p;
  precise float far = 1.0 - 2.0 / (real_exp(2.0 * min(size, 16.0)) + 1.0);
  return is_nan(x) ? x : with_sign(size < 0.625 ? near : far, x);
}

float real_erf(float x) {
  float size = abs(x);
  float t = min(size, 4.0);
  precise float z = t * t;
  precise float p = 7.85391167e-05;
  p = p * z - 0.000801021000;
  p = p * z + 0.00518832961;
  p = p * z - 0.0268538129;
  p = p * z + 0.112835854;
  p = p * z - 0.376126260;
  p = p * z + 1.12837911;
  precise float near = size * p;
  precise float q = 0.000185574085;
  q = q * t - 0.00293960795;
  q = q * t + 0.0218053218;
  q = q * t - 0.103037372;
  q = q * t - 0.638225675;
  q = q * t - 1.12704003;
  q = q * t - 0.000353718613;
  precise float far = 1.0 - real_exp(q);
  return is_nan(x) ? x : with_sign(size < 1.0 ? near : far, x);
}
