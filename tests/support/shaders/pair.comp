// y = x + x of the next texel, around the end; x through a texel buffer. One invocation per texel.
#version 460
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_int8 : require
#extension GL_EXT_samplerless_texture_functions : require
layout(local_size_x = 64) in;
layout(binding = 0) uniform itextureBuffer x;
layout(binding = 5) writeonly buffer Y { int8_t y[]; };

void main() {
  const int i = int(gl_GlobalInvocationID.x);
  const int count = textureSize(x);
  if (i >= count) return;
  const ivec4 sum = texelFetch(x, i) + texelFetch(x, (i + 1) % count);
  for (int k = 0; k < 4; ++k) y[4 * i + k] = int8_t(sum[k]);
}
