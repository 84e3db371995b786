// shaders/frame/nss/warped.glsl -- the history as the networks see it: bilinear, exposed, Karis.

vec3 warped(SAMPLED_HALF4 past) { return karis_of(rgb_of(past)); }
