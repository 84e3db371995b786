// history = blend + 100 + the sum of y's channels; shown = its bytes. One invocation per pixel.
#version 460
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_int8 : require
layout(local_size_x = 8, local_size_y = 8) in;
layout(binding = 0) readonly buffer Y { int8_t y[]; };
layout(binding = 1, r32ui) readonly uniform uimage2D blend;
layout(binding = 2, r32ui) writeonly uniform uimage2D history;
layout(binding = 3, rgba8) writeonly uniform image2D shown;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  const ivec2 size = imageSize(shown);
  if (any(greaterThanEqual(at, size))) return;
  const int base = 4 * (at.y * size.x + at.x);
  int sum = 100;
  for (int k = 0; k < 4; ++k) sum += int(y[base + k]);
  const uint value = imageLoad(blend, at).r + uint(sum);
  imageStore(history, at, uvec4(value));
  const uvec4 bytes = (uvec4(value) >> uvec4(0, 8, 16, 24)) & 255u;
  imageStore(shown, at, vec4(bytes) / 255.0);
}
