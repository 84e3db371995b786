// shaders/frame/nss/sample.glsl -- the samples of a frame in the exposed Karis domain. Expects the image `color`.

vec3 sample_of(HALF4 texel) { return karis_of(finite_color(rgb_of(texel))); }
