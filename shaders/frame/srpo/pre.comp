// shaders/frame/srpo/pre.comp -- quantizes the raster frame for the network.
//
// Reads color, rgba8 in [0, 1]; writes the tensor "input", int8 NHWC [1, h, w, 3]. With scale 1/255 and
// zero point -128 every 8-bit colour is exact. One invocation per pixel of color.
#version 450
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_int8 : require

layout(local_size_x = LOCAL_X, local_size_y = LOCAL_Y) in;
layout(set = 0, binding = 0) uniform texture2D color;
layout(set = 0, binding = 1, std430) writeonly buffer InputTensor { int8_t data[]; } network_input;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= INPUT_WIDTH || at.y >= INPUT_HEIGHT) return;
  const vec3 code = floor(texelFetch(color, at, 0).rgb / float(INPUT_SCALE) + 0.5);
  const ivec3 q = clamp(ivec3(code) + INPUT_ZERO_POINT, -128, 127);
  const int base = (at.y * INPUT_WIDTH + at.x) * INPUT_CHANNELS;
  for (int c = 0; c < 3; ++c) network_input.data[base + c] = int8_t(q[c]);
}
