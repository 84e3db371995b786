// shaders/frame/nss/history_texel.glsl -- a texel of the texel buffer `history`, rgba16_float, as it lies in memory.

uvec2 history_words(ivec2 at) { return texelFetch(history, at.y * HISTORY_PITCH + at.x).rg; }
