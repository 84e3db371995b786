// Pipeline caches: the device's own, with the packages of graphs behind its data.
#include <algorithm>
#include <cstring>

#include "ir/base/hash.h"
#include "tools/layer/graph.h"

namespace shale::layer {
namespace {

constexpr std::string_view kMagic = "SHALEGC1";

/// Behind the packages, at the very end of the data.
struct Footer {
  char magic[8];
  uint64_t body_bytes;
  uint64_t hash;  ///< of the body
};

void append(std::vector<uint8_t>& out, const void* data, size_t size) {
  const auto* bytes = static_cast<const uint8_t*>(data);
  out.insert(out.end(), bytes, bytes + size);
}

std::vector<uint8_t> write_trailer(GraphCache& cache) {
  std::vector<uint8_t> out;
  const std::lock_guard lock(cache.mutex);
  for (const auto& [identifier, package] : cache.packages) {
    const uint64_t size = package->size();
    append(out, identifier.data(), identifier.size());
    append(out, &size, sizeof size);
    append(out, package->data(), package->size());
  }
  Footer footer{};
  std::memcpy(footer.magic, kMagic.data(), kMagic.size());
  footer.body_bytes = out.size();
  footer.hash = stable_hash(out);
  append(out, &footer, sizeof footer);
  return out;
}

/// Takes the packages off the end of an application's data, which may be anything; the rest is the
/// device's.
std::span<const uint8_t> read_trailer(std::span<const uint8_t> data, GraphCache& cache) {
  Footer footer;
  if (data.size() < sizeof footer) return data;
  std::memcpy(&footer, data.data() + data.size() - sizeof footer, sizeof footer);
  const size_t room = data.size() - sizeof footer;
  if (std::memcmp(footer.magic, kMagic.data(), kMagic.size()) != 0 || footer.body_bytes > room)
    return data;
  std::span<const uint8_t> body = data.subspan(room - footer.body_bytes, footer.body_bytes);
  const std::span<const uint8_t> rest = data.first(room - footer.body_bytes);
  if (stable_hash(body) != footer.hash) return rest;
  constexpr size_t kHead = sizeof(Identifier) + sizeof(uint64_t);
  while (body.size() >= kHead) {
    Identifier identifier;
    uint64_t size = 0;
    std::memcpy(identifier.data(), body.data(), identifier.size());
    std::memcpy(&size, body.data() + identifier.size(), sizeof size);
    body = body.subspan(kHead);
    if (size > body.size()) break;
    cache.packages[identifier] = std::make_shared<const std::vector<uint8_t>>(
        body.begin(), body.begin() + static_cast<std::ptrdiff_t>(size));
    body = body.subspan(size);
  }
  return rest;
}

}  // namespace

VkResult VKAPI_CALL CreatePipelineCache(VkDevice handle, const VkPipelineCacheCreateInfo* info,
                                        const VkAllocationCallbacks* allocator,
                                        VkPipelineCache* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    auto cache = std::make_shared<GraphCache>();
    const std::span<const uint8_t> own = read_trailer(
        {static_cast<const uint8_t*>(info->pInitialData), info->initialDataSize}, *cache);
    VkPipelineCacheCreateInfo below = *info;
    // A graph's kernels are compiled side by side, with the application's cache.
    below.flags &=
        ~VkPipelineCacheCreateFlags{VK_PIPELINE_CACHE_CREATE_EXTERNALLY_SYNCHRONIZED_BIT};
    below.initialDataSize = own.size();
    const VkResult created = device.CreatePipelineCache(handle, &below, allocator, result);
    if (created == VK_SUCCESS) device.caches.put(*result, std::move(cache));
    return created;
  });
}

void VKAPI_CALL DestroyPipelineCache(VkDevice handle, VkPipelineCache cache,
                                     const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    device.caches.take(cache);
    device.DestroyPipelineCache(handle, cache, allocator);
  });
}

VkResult VKAPI_CALL GetPipelineCacheData(VkDevice handle, VkPipelineCache cache, size_t* size,
                                         void* data) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const auto known = device.caches.find(cache);
    const std::vector<uint8_t> trailer = known ? write_trailer(*known) : std::vector<uint8_t>{};
    size_t own = 0;
    const VkResult asked = device.GetPipelineCacheData(handle, cache, &own, nullptr);
    if (asked != VK_SUCCESS) return asked;
    if (!data) {
      *size = own + trailer.size();
      return VK_SUCCESS;
    }
    // lavapipe leaves the size as it is where there is more room.
    const size_t room = *size;
    *size = std::min(room, own);
    const VkResult below = device.GetPipelineCacheData(handle, cache, size, data);
    if (below != VK_SUCCESS) return below;
    if (room - *size < trailer.size()) return VK_INCOMPLETE;
    std::memcpy(static_cast<uint8_t*>(data) + *size, trailer.data(), trailer.size());
    *size += trailer.size();
    return VK_SUCCESS;
  });
}

VkResult VKAPI_CALL MergePipelineCaches(VkDevice handle, VkPipelineCache into, uint32_t count,
                                        const VkPipelineCache* from) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const auto target = device.caches.find(into);
    for (uint32_t i = 0; i < count && target; ++i) {
      const auto source = device.caches.find(from[i]);
      if (!source || source == target) continue;
      const std::scoped_lock lock(source->mutex, target->mutex);
      target->packages.insert(source->packages.begin(), source->packages.end());
    }
    return device.MergePipelineCaches(handle, into, count, from);
  });
}

}  // namespace shale::layer
