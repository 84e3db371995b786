// shaders/frame/nss/block.glsl -- the depths of a block of BLOCK x BLOCK render texels, 2 or 4. Expects the texel buffers
// `depth`, BLOCK texels a fetch, and `motion`.

struct Block {
  float closest, farthest;
  ivec2 from;  // texel of the closest
};

Block block_at(ivec2 block) {
  const ivec2 first = block * BLOCK;
  Block result;
  [[unroll]] for (int y = 0; y < BLOCK; ++y) {
    const int texel = (min(first.y + y, COLOR_HEIGHT - 1) * RAW_DEPTH_PITCH + first.x) / BLOCK;
    const uvec4 words = texelFetch(depth, texel);
    [[unroll]] for (int x = 0; x < BLOCK; ++x) {
      const float d = finite_depth(uintBitsToFloat(words[x]));
      if (x == 0 && y == 0) result = Block(d, d, first);
      // At the border a block is smaller; a row that was read before cannot be closer.
      const bool is_inside = first.x + x < COLOR_WIDTH;
      const bool leads = is_inside && closer(d, result.closest);
      result.closest = leads ? d : result.closest;
      result.from = leads ? first + ivec2(x, y) : result.from;
      result.farthest = is_inside && closer(result.farthest, d) ? d : result.farthest;
    }
  }
  return result;
}

vec2 block_motion(Block block) {
  const uint halves = texelFetch(motion, block.from.y * RAW_MOTION_PITCH + block.from.x).r;
  return long_motion(unpackHalf2x16(halves), kRender, 0.1);
}
