// shaders/frame/tss/prepare.comp -- pass 2 of TSS: colours as they are accumulated, and what is known about each texel.
//
// One invocation per render texel. prepared (rgba16_float): exposed, in the Karis domain. mask (r32_uint): four bytes,
// unorm: disocclusion, thin feature, 0, 0.
// STILL: what is seen was seen a frame ago, at the same depth but for rounding, so that nothing is disoccluded.
// A texel is a thin feature if it is brighter or darker than all neighbours that differ from it, and none of the four 2x2
// squares that hold it is alike throughout.
// Source: the public description of FidelityFX Super Resolution 2, "depth clip" and "create locks".
#version 450
#include "../nss/common.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const float kAlike = 1.05;  // ratio of two lumas up to which they count as one

vec3 texel(ivec2 at) { return karis_of(finite_color(rgb_of(fetch_color(inside(at, kRender))))); }

float thin_feature(ivec2 at, float centre) {
  bool alike[9];
  float low = 1e9, high = -1.0;  // of the neighbours that differ
  [[unroll]] for (int i = 0; i < 9; ++i) {
    alike[i] = true;
    if (i == 4) continue;
    const float luma = ycocg(texel(at + ivec2(i % 3, i / 3) - 1)).x;
    alike[i] = max(luma, centre) < kAlike * min(luma, centre) + 1e-3;
    low = alike[i] ? low : min(low, luma);
    high = alike[i] ? high : max(high, luma);
  }
  const bool ridge = centre > high || centre < low;
  const bool area = (alike[0] && alike[1] && alike[3]) || (alike[1] && alike[2] && alike[5]) ||
                    (alike[3] && alike[6] && alike[7]) || (alike[5] && alike[7] && alike[8]);
  return ridge && !area ? 1.0 : 0.0;
}

#if STILL
float disocclusion_at(ivec2 at) { return 0.0; }
#else
/// 1 where what is seen was hidden a frame ago.
float disoccluded(vec2 uv, bool rests, float depth) {
  const Bilinear b = bilinear_at(uv, kRender, rests);
  const float z = view_z(depth);
  vec2 sum = vec2(0.0);
  [[unroll]] for (int i = 0; i < 4; ++i) {
    const ivec2 at = b.base + ivec2(i & 1, i >> 1);
    const bool is_inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, kRender));
    const float before = float(scatter_code(fetch_before(inside(at, kRender)))) * (1.0 / 2147483647.0);
    sum += depth_clip_tap(bilinear_weight(b.part, i), is_inside, z, view_z(before), 0.0);
  }
  return depth_clip(sum);
}
float disocclusion_at(ivec2 at) {
  const vec2 uv = (vec2(at) + 0.5) / vec2(kRender);
  const vec2 motion = xy_of(fetch_dilated_motion(at));
  return disoccluded(uv - motion, motion == vec2(0.0), fetch_dilated_depth(at));
}
#endif

void main() {
  const ivec2 at = ivec2(invocation());
  if (at.x >= kRender.x || at.y >= kRender.y) return;
  const vec3 color = texel(at);
  store_prepared(at, half4(color));
  store_mask(at, packUnorm4x8(vec4(disocclusion_at(at), thin_feature(at, ycocg(color).x), 0.0, 0.0)));
}
