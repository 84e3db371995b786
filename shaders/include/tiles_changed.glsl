// Tiles that changed, a bit for each in rows of words, of a buffer that the includer calls CHANGES.

/// True if a tile of these columns and rows did; both are begin | end << 16.
bool is_changed(uint first_word, uint row_words, uint columns, uint rows) {
  uint begin = columns & 0xffffu, end = columns >> 16;
  for (uint y = rows & 0xffffu; y < rows >> 16; ++y)
    for (uint at = begin / 32u; at * 32u < end; ++at) {
      uint low = max(begin, at * 32u) - at * 32u, high = min(end - at * 32u, 32u);
      uint mask = (0xffffffffu >> (32u - (high - low))) << low;
      if ((CHANGES.d[first_word + y * row_words + at] & mask) != 0u) return true;
    }
  return false;
}
