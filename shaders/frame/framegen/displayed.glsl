// shaders/frame/framegen/displayed.glsl -- brightness as a display shows it, nearly: the root of x / (1 + x) of an exposed colour x.
//
// Frames are mixed in it. Expects color.glsl and params.exposure.

vec3 displayed(vec3 c) {
  const vec3 x = exposed(c, params.exposure);
  return sqrt(x / (1.0 + x));
}
vec3 linear_of(vec3 d) {
  const vec3 x = min(d * d, 1.0 - 1e-6);
  return min(x / (1.0 - x) / params.exposure, kMaxColor);
}
