// shown = color between four texels: halfway to the right and below. One invocation per pixel.
#version 460
layout(local_size_x = 8, local_size_y = 8) in;
layout(binding = 0) uniform sampler2D color;
layout(binding = 1, rgba8) writeonly uniform image2D shown;

void main() {
  const ivec2 at = ivec2(gl_GlobalInvocationID.xy);
  const ivec2 size = imageSize(shown);
  if (any(greaterThanEqual(at, size))) return;
  imageStore(shown, at, textureLod(color, vec2(at + 1) / vec2(size), 0));
}
