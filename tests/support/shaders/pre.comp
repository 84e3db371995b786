// x = the color's bytes / 4; blend = last frame's history + 2 * that before it.
// One invocation per pixel.
#version 460
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_int8 : require
#extension GL_EXT_samplerless_texture_functions : require
layout(local_size_x = 8, local_size_y = 8) in;
layout(binding = 0) uniform texture2D color;
layout(binding = 1) uniform utexture2D history1;
layout(binding = 2) uniform utexture2D history2;
layout(binding = 3, r32ui) writeonly uniform uimage2D blend;
layout(binding = 4) writeonly buffer X { int8_t x[]; };

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  const ivec2 size = textureSize(color, 0);
  if (any(greaterThanEqual(at, size))) return;
  const uvec4 bytes = uvec4(texelFetch(color, at, 0) * 255.0 + 0.5);
  for (int k = 0; k < 4; ++k) x[4 * (at.y * size.x + at.x) + k] = int8_t(bytes[k] / 4);
  const uint sum = texelFetch(history1, at, 0).r + 2 * texelFetch(history2, at, 0).r;
  imageStore(blend, at, uvec4(sum));
}
