// y = x * weight of the channel, four channels. One invocation per element.
#version 460
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_int8 : require
layout(local_size_x = 64) in;
layout(binding = 0) readonly buffer X { int8_t x[]; };
layout(binding = 1) readonly buffer Weights { int8_t weights[]; };
layout(binding = 2) writeonly buffer Y { int8_t y[]; };

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i < y.length()) y[i] = int8_t(int(x[i]) * int(weights[i % 4]));
}
