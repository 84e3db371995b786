// shaders/frame/nss/block.glsl -- the depths of a block of BLOCK x BLOCK render texels, 2 or 4. Expects the images `depth` and
// `motion`.

struct Block {
  float closest, farthest;
  ivec2 from;  // texel of the closest
};

Block block_at(ivec2 block) {
  const ivec2 first = block * BLOCK;
  Block result;
  [[unroll]] for (int y = 0; y < BLOCK; ++y) {
    float row[BLOCK];
#if BLOCK == 2
    fetch2_depth(ivec2(block.x, min(first.y + y, COLOR_HEIGHT - 1)), row);
#else
    fetch4_depth(ivec2(block.x, min(first.y + y, COLOR_HEIGHT - 1)), row);
#endif
    [[unroll]] for (int x = 0; x < BLOCK; ++x) {
      const float d = finite_depth(row[x]);
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
  return long_motion(xy_of(fetch_motion(block.from)), kRender, 0.1);
}
