// shaders/frame/tss/accumulate.comp -- pass 3 of TSS: the history follows the motion, is rectified, and takes in the samples.
//
// One invocation per output pixel. All averaging is of exposed colours in the Karis domain; the history (rgba16_float) is
// linear, as the output that shows it. state (r32_uint) has four bytes, unorm: the weight that the history stands for over
// kMost, life of the lock, flicker, slow brightness; lumas (r32_uint) the brightness in the last four frames.
//
//  - Samples: Lanczos-2 around the pixel, narrower than render texels, so that each frame adds what lies close. A pixel
//    whose history is short also takes a soft sum of the samples around, which shows no stairs.
//  - Rectification: the history is clamped in YCoCg to mean and deviation of the samples around and to their range.
//  - Where nothing speaks against the history it is believed beyond that box: on a thin feature that was sampled lately (a
//    lock), where brightness comes and goes with the jitter (flicker), where the picture stands still. Against it speak a
//    disocclusion, and brightness of 3x3 samples that leaves its slow mean by more than jitter can explain: light changed.
// Source: the public description of FidelityFX Super Resolution 2, "reproject and accumulate"; constants and the slow mean
// in place of a pyramid of brightness are ours, chosen on crops of the test scenes.
#version 450
#include "../nss/common.glsl"
#include "../nss/catmull_rom.glsl"
#include "../nss/history.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const vec2 kScale = vec2(kOutput) / vec2(kRender);
const float kFine = 1.5;             // render texels over the texels of Lanczos-2, where the ratio allows
const float kSoft = 1.5, kBox = 1.0;  // falloff of the soft sum and of the box's samples: 2^-(k r^2), r in render texels
const float kReach = 1.6;            // render texels per axis: samples whose range bounds history and result
const float kMost = 8.0, kMostMoving = 2.0;  // weight of the history at rest, and at kSpeed and beyond
const float kSpeed = 4.0;                    // output pixels a frame
const float kDeviations = 2.0, kDeviationsMoving = 1.0, kDeviationsChanged = 0.5;  // half the box's side
const float kLocked = 0.9, kLockedMoving = 0.3;  // belief in a lock or in flicker
const float kBelief = 0.9, kBeliefMoving = 0.1;  // and elsewhere
const float kSoftShare = 0.2, kLeastSoftShare = 0.005;  // weight of the soft sum without history, and with one
const float kLockStep = 1.0 / 16.0, kFlickerStep = 0.9, kSlowStep = 0.125;  // a frame

float lanczos2(vec2 d) {
  // By a polynomial that is 0 from 2 on; sin() takes long on a CPU.
  const vec2 x = min(d * d, 4.0);
  const vec2 a = 0.4 * x - 1.0, b = 0.25 * x - 1.0;
  const vec2 w = (1.5625 * a * a - 0.5625) * b * b;
  return w.x * w.y;
}

/// The samples around a pixel.
struct Samples {
  vec4 fine;             // weighted sum and weight
  vec3 soft;             // mean
  vec3 mean, deviation;  // of YCoCg
  vec3 low, high;        // range of YCoCg
  vec3 least_rgb, most_rgb;
};
Samples samples_at(vec2 scene) {
  const vec2 base = floor(scene - 0.5), part = scene - 0.5 - base;
  Samples s;
  s.fine = vec4(0.0);
  s.low = s.least_rgb = vec3(1e9);
  s.high = s.most_rgb = vec3(-1e9);
  vec4 soft = vec4(0.0), box = vec4(0.0);
  vec3 square = vec3(0.0);
  [[unroll]] for (int y = -1; y <= 2; ++y) {
    [[unroll]] for (int x = -1; x <= 2; ++x) {
      const vec3 c = rgb_of(fetch_prepared(inside(ivec2(base) + ivec2(x, y), kRender))), t = ycocg(c);
      const vec2 d = vec2(x, y) - part;
      const float r2 = dot(d, d), near = exp2(-kBox * r2);
      s.fine += lanczos2(d * min(kScale, kFine)) * vec4(c, 1.0);
      soft += exp2(-kSoft * r2) * vec4(c, 1.0);
      box += near * vec4(t, 1.0);
      square += near * t * t;
      const bool counts = abs(d.x) < kReach && abs(d.y) < kReach;
      s.low = counts ? min(s.low, t) : s.low;
      s.high = counts ? max(s.high, t) : s.high;
      s.least_rgb = counts ? min(s.least_rgb, c) : s.least_rgb;
      s.most_rgb = counts ? max(s.most_rgb, c) : s.most_rgb;
    }
  }
  s.soft = soft.rgb / soft.w;
  s.mean = box.rgb / box.w;
  s.deviation = sqrt(max(square / box.w - s.mean * s.mean, 0.0));
  return s;
}

void main() {
  const ivec2 at = ivec2(invocation());
  if (at.x >= kOutput.x || at.y >= kOutput.y) return;
  const vec2 uv = (vec2(at) + 0.5) / vec2(kOutput);
  const vec2 scene = uv * vec2(kRender) - params.jitter;  // in texels
  const ivec2 centre = inside(ivec2(floor(scene)), kRender);
#if STILL
  const vec2 motion = vec2(0.0), before = uv;
#else
  const vec2 motion = xy_of(fetch_dilated_motion(centre)), before = uv - motion;
#endif
  const vec4 mask = unpackUnorm4x8(fetch_mask(centre));
  const Samples s = samples_at(scene);

  const float luma = s.mean.x;
  float weight = 0.0, lock = 0.0, flicker = 0.0, slow = luma;
  vec4 lumas = vec4(luma);
  vec3 past = s.soft;
  if (params.reset == 0 && on_screen(before)) {
    const ivec2 from = inside(ivec2(before * vec2(kOutput)), kOutput);
    const vec4 state = unpackUnorm4x8(fetch_state(from)), seen = unpackUnorm4x8(fetch_lumas(from));
    const float still = clamp(1.0 - length(motion * vec2(kOutput)) / kSpeed, 0.0, 1.0);
    const float kept = 1.0 - mask.x;

    slow = kept > 0.5 ? state.w : luma;
    const float tolerance = s.deviation.x + 0.02 * luma + 0.004;
    const float change = clamp((abs(luma - slow) - tolerance) / tolerance, 0.0, 1.0);
    slow = mix(slow, luma, max(change, kSlowStep));
    const float good = kept * (1.0 - change);

    const float step = abs(luma - seen.x);
    const float back = min(min(abs(luma - seen.y), abs(luma - seen.z)), abs(luma - seen.w));
    const float returns = step > 0.01 ? clamp((step - back) / step, 0.0, 1.0) : 0.0;
    flicker = good * max(kFlickerStep * state.z, returns);
    lumas = vec4(luma, seen.xyz);
    lock = good * state.y;

#if STILL
    const vec3 p = ycocg(past_still_catmull_rom(fetch_history(at)));
#else
    const vec3 p = ycocg(past_catmull_rom(before, motion == vec2(0.0)));
#endif
    const vec3 side = mix(kDeviationsMoving, kDeviations, still) * mix(1.0, kDeviationsChanged, change) * s.deviation;
    const vec3 inner = clamp(p, max(s.mean - side, s.low), min(s.mean + side, s.high));
    const float belief = good * max(max(lock, flicker) * mix(kLockedMoving, kLocked, still), mix(kBeliefMoving, kBelief, still));
    past = max(ycocg_inverse(mix(inner, p, belief)), 0.0);
    // What had to be moved is worth less.
    const float moved = length((p - inner) / (s.deviation + 0.02));
    weight = kept * min(state.x * kMost, mix(kMostMoving, kMost, still)) * (1.0 - 0.7 * change) *
             mix(1.0 / (1.0 + 0.2 * moved), 1.0, belief);
  }
  const float share = max(kSoftShare * (1.0 - weight), kLeastSoftShare);
  const vec3 sum = past * weight + s.fine.rgb + s.soft * share;
  const vec3 result = clamp(sum / max(weight + s.fine.w + share, 0.01), min(s.least_rgb, past), max(s.most_rgb, past));

  // A thin feature locks the pixel that its sample lies in.
  const vec2 off = abs(scene - (vec2(centre) + 0.5)) * kScale;
  lock = mask.y > 0.5 && max(off.x, off.y) <= 0.5 ? 1.0 : max(lock - kLockStep, 0.0);
  store_state(at, packUnorm4x8(vec4((weight + max(s.fine.w, 0.0)) / kMost + 0.5 / 255.0, lock, flicker, slow)));
  store_lumas(at, packUnorm4x8(lumas));
  store_history(at, half4(least(karis_inverse(result) / params.exposure, vec3(kMaxColor))));
}
