// Bytes as the words of a module, which come back as they were; and as a body behind a sound zlib stream, which is refused, or makes
// words that do so.
#include <zlib.h>

#include <cstdlib>
#include <cstring>
#include <vector>

#include "ir/package/pack.h"

namespace {

void expect_back(const std::vector<uint32_t>& words) {
  const auto packed = shale::pack_module(words);
  if (!packed) return;
  const auto back = shale::unpack_module(*packed, static_cast<uint32_t>(words.size()), "words");
  if (!back || *back != words) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size < 4) return 0;
  std::vector<uint32_t> words(size / 4);
  std::memcpy(words.data(), data, words.size() * 4);
  expect_back(words);

  const uint32_t word_count = words[0] % 4096;
  const uint8_t* body = data + 4;
  size -= 4;
  std::vector<uint8_t> packed;
  for (size_t left = size; left > 0 || packed.empty(); left >>= 7)
    packed.push_back(static_cast<uint8_t>(left & 0x7f) | (left >> 7 ? 0x80 : 0));
  const size_t prefix = packed.size();
  uLongf bytes = compressBound(size);
  packed.resize(prefix + bytes);
  if (compress2(packed.data() + prefix, &bytes, body, size, Z_NO_COMPRESSION) != Z_OK) std::abort();
  packed.resize(prefix + bytes);
  if (const auto made = shale::unpack_module(packed, word_count, "body")) expect_back(*made);
  return 0;
}
