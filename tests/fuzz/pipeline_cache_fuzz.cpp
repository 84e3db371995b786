// Pipeline cache files of any content: ignored with a reason, or exactly the data that was written.
#include <algorithm>
#include <cstdlib>

#include "runtime/vk/pipeline_cache.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  shale::vk::CacheIdentity identity;
  identity.vendor_id = 0x10005;
  const shale::Result<std::span<const uint8_t>> cache =
      shale::vk::read_cache_blob({data, size}, identity);
  if (cache && (cache->data() < data || cache->data() + cache->size() > data + size)) std::abort();
  // What is written from any data must be read back, unless Vulkan's own header in it is broken.
  const std::vector<uint8_t> written = shale::vk::write_cache_blob({data, size}, identity);
  const shale::Result<std::span<const uint8_t>> read =
      shale::vk::read_cache_blob(written, identity);
  if (read && !std::equal(read->begin(), read->end(), data, data + size)) std::abort();
  return 0;
}
