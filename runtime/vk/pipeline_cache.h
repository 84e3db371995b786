// runtime/vk/pipeline_cache.h -- compiled pipelines that survive the process.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "runtime/vk/device.h"
#include "runtime/vk/handle.h"

namespace shale::vk {

/// Which driver and device a cache file belongs to.
struct CacheIdentity {
  uint32_t vendor_id = 0;
  uint32_t device_id = 0;
  uint32_t driver_version = 0;
  std::array<uint8_t, VK_UUID_SIZE> driver_uuid{};
  std::array<uint8_t, VK_UUID_SIZE> cache_uuid{};  ///< pipelineCacheUUID of the properties
  bool operator==(const CacheIdentity&) const = default;
};
CacheIdentity cache_identity(VkPhysicalDevice device, const Functions& vk);

/// A cache file: our header (magic, driver, length and hash of the data), then Vulkan's cache data.
std::vector<uint8_t> write_cache_blob(std::span<const uint8_t> data, const CacheIdentity& identity);

/// The cache data inside a file that nobody vouches for, ready for VkPipelineCacheCreateInfo; a
/// part of `bytes`. Drivers are known to trust their data, hence the hash.
/// Errors: kBadInput if the file is damaged, foreign, or its data have no header for that device.
Result<std::span<const uint8_t>> read_cache_blob(std::span<const uint8_t> bytes,
                                                 const CacheIdentity& expected);

/// A VkPipelineCache that starts from a file and can be saved to it.
class PipelineCache {
 public:
  /// A missing, damaged or foreign file is an empty cache; `ignored()` tells why.
  /// Errors: kDevice.
  static Result<PipelineCache> load(const Context& context, std::string path);

  VkPipelineCache get() const { return cache_.get(); }
  /// Empty if the file was used.
  const std::string& ignored() const { return ignored_; }

  /// Replaces the file, unless it holds the same already.
  /// Errors: kDevice, kIo.
  Result<void> save() const;

 private:
  Functions vk_;
  VkDevice device_ = VK_NULL_HANDLE;
  PipelineCacheHandle cache_;
  CacheIdentity identity_;
  std::string path_;
  std::string ignored_;
};

}  // namespace shale::vk
