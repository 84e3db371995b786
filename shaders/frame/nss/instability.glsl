// shaders/frame/nss/instability.glsl -- how much a pixel flickers: channel 11 of NSS v1 and its state.
//
// Work colours are (Y, Co, Cg) of the square root of exposed colour. The state is RGBA8_SNORM: Y / 4 - 1, Co / 8,
// Cg / 8, 2 * instability - 1; all zero is a state that nobody wrote. The gates for moire and flat blue, which the
// source calls optional, are left out. Source: nss.md section 2.5.

vec3 work_color(vec3 exposed_color) { return ycocg(sqrt(exposed_color)); }

float color_distance(vec3 a, vec3 b) { return length((a - b) * vec3(1.0, 1.25, 1.25)); }

float ramp(float x, float low, float high) { return clamp((x - low) / (high - low), 0.0, 1.0); }

/// Instability to show the network; `next` becomes the new state. around: distances to the four neighbours.
float instability(vec3 now, vec4 around, vec4 state, bool disoccluded, out vec4 next) {
  const vec3 before = vec3((state.x + 1.0) * 4.0, state.yz * 8.0);
  const float p = (state.w + 1.0) * 0.5;
  const float farthest = max(max(around.x, around.y), max(around.z, around.w));
  const float support = max(around.x + around.y + around.z + around.w - farthest, 0.0) / 3.0;
  const float s = 0.75 * mix(color_distance(now, before), support, 0.30);
  const float recall = ramp(s, 0.065, 0.42);
  const float mean = ramp(s, 0.07, 0.23);
  const float entry = sqrt(recall) * sqrt(ramp(max(s - p, 0.0), 0.025, 0.16)) * mean;
  const float heat = ramp(p, 0.11, 0.21);
  const float spread = ramp(mix(p, s, 0.3), mix(0.177, 0.157, heat), mix(0.33, 0.305, heat));
  const float sg = spread * spread;
  const float held = ramp(p, 0.18, 0.28);
  const float raw = max(entry, 0.8 * p * max(sg, 0.12 * held * held));
  const float decay = max(sg, 0.5 * heat * heat);
  const float rate = raw > p ? mix(0.08, 0.22, sqrt(recall * mean)) : mix(0.24, 0.05, decay);
  float value = mix(p, raw, rate);
  float visible = mix(p, value, value > p ? 0.75 : 0.80);
  if (disoccluded || abs(state.x) + abs(state.y) + abs(state.z) + abs(state.w) < 1e-4) {
    value = 0.0;
    visible = 0.0;
  }
  next = vec4(now.x / 4.0 - 1.0, now.yz / 8.0, 2.0 * value - 1.0);
  return visible;
}
