// shaders/frame/flow/bilateral.comp -- smooths flow, but not across edges of the picture that it starts from.
//
// One invocation per pixel of flow, rg16_float as cleaned; 5x5, weights from 1 down to 0 with distance and difference of brightness
// (deviations 7.4 pixels and 0.14 of full brightness). Source: nfru.md section 2.2, whose first term there is a constant.
#version 450
#include "access.glsl"

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;

const ivec2 kSize = ivec2(CLEANED_WIDTH, CLEANED_HEIGHT);
const float kSpace = 7.4, kBrightness = 0.14;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= kSize.x || at.y >= kSize.y) return;
  const float middle = fetch_before(at);
  vec2 sum = vec2(0.0);
  float total = 0.0;
  for (int i = 0; i < 25; ++i) {
    const ivec2 k = ivec2(i % 5, i / 5) - 2, from = inside(at + k, kSize);
    const float difference = (fetch_before(from) - middle) / 255.0;
    const float far = float(k.x * k.x + k.y * k.y) / (2.0 * kSpace * kSpace);
    const float w = clamp(1.0 - far - difference * difference / (2.0 * kBrightness * kBrightness), 0.0, 1.0);
    sum += w * xy_of(fetch_cleaned(from));
    total += w;
  }
  store_flow(at, half2(sum / total));
}
