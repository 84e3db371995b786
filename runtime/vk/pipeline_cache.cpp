#include "runtime/vk/pipeline_cache.h"

#include <algorithm>
#include <cstring>

#include "ir/base/file.h"
#include "ir/base/hash.h"

namespace shale::vk {
namespace {

constexpr std::array<uint8_t, 8> kMagic{'S', 'H', 'A', 'L', 'E', 'P', 'C', '1'};

/// The bytes before the cache data. Read on the machine that wrote it, so in native order.
struct BlobHeader {
  std::array<uint8_t, 8> magic;
  std::array<uint8_t, VK_UUID_SIZE> driver_uuid;
  uint32_t driver_version;
  uint32_t header_bytes;
  uint64_t data_bytes;
  uint64_t data_hash;
};
static_assert(sizeof(BlobHeader) == 48, "no padding is hashed or written");

/// Source: Vulkan 1.3, VkPipelineCacheHeaderVersionOne.
constexpr size_t kVulkanHeaderBytes = 16 + VK_UUID_SIZE;

uint32_t word_at(std::span<const uint8_t> bytes, size_t offset) {
  uint32_t word = 0;
  std::memcpy(&word, bytes.data() + offset, sizeof(word));
  return word;
}

Result<void> check_vulkan_header(std::span<const uint8_t> data, const CacheIdentity& expected) {
  if (data.size() < kVulkanHeaderBytes)
    return bad_input("", "{} bytes hold no pipeline cache header", data.size());
  const uint32_t header_bytes = word_at(data, 0);
  if (header_bytes < kVulkanHeaderBytes || header_bytes > data.size())
    return bad_input("", "the pipeline cache header claims {} bytes", header_bytes);
  if (word_at(data, 4) != VK_PIPELINE_CACHE_HEADER_VERSION_ONE)
    return bad_input("", "the pipeline cache header has version {}", word_at(data, 4));
  if (word_at(data, 8) != expected.vendor_id || word_at(data, 12) != expected.device_id ||
      !std::equal(expected.cache_uuid.begin(), expected.cache_uuid.end(), data.data() + 16))
    return bad_input("", "the pipeline cache is of another device");
  return {};
}

}  // namespace

CacheIdentity cache_identity(VkPhysicalDevice device, const Functions& vk) {
  auto ids = init<VkPhysicalDeviceIDProperties>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES);
  auto properties =
      init<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
  properties.pNext = &ids;
  vk.GetPhysicalDeviceProperties2(device, &properties);
  CacheIdentity identity;
  identity.vendor_id = properties.properties.vendorID;
  identity.device_id = properties.properties.deviceID;
  identity.driver_version = properties.properties.driverVersion;
  std::copy_n(ids.driverUUID, VK_UUID_SIZE, identity.driver_uuid.begin());
  std::copy_n(properties.properties.pipelineCacheUUID, VK_UUID_SIZE, identity.cache_uuid.begin());
  return identity;
}

std::vector<uint8_t> write_cache_blob(std::span<const uint8_t> data,
                                      const CacheIdentity& identity) {
  const BlobHeader header{.magic = kMagic,
                          .driver_uuid = identity.driver_uuid,
                          .driver_version = identity.driver_version,
                          .header_bytes = sizeof(BlobHeader),
                          .data_bytes = data.size(),
                          .data_hash = stable_hash(data)};
  std::vector<uint8_t> bytes(sizeof(header) + data.size());
  std::memcpy(bytes.data(), &header, sizeof(header));
  std::copy(data.begin(), data.end(), bytes.begin() + sizeof(header));
  return bytes;
}

Result<std::span<const uint8_t>> read_cache_blob(std::span<const uint8_t> bytes,
                                                 const CacheIdentity& expected) {
  BlobHeader header;
  if (bytes.size() < sizeof(header))
    return bad_input("", "{} bytes are too few for a cache file", bytes.size());
  std::memcpy(&header, bytes.data(), sizeof(header));
  if (header.magic != kMagic || header.header_bytes != sizeof(header))
    return bad_input("", "is no cache file");
  if (header.driver_uuid != expected.driver_uuid ||
      header.driver_version != expected.driver_version)
    return bad_input("", "the cache file is of another driver");
  const std::span<const uint8_t> data = bytes.subspan(sizeof(header));
  if (header.data_bytes != data.size())
    return bad_input("", "the cache file holds {} bytes of data, expected {}", data.size(),
                     header.data_bytes);
  if (header.data_hash != stable_hash(data)) return bad_input("", "the cache file is damaged");
  SHALE_TRY_VOID(check_vulkan_header(data, expected));
  return data;
}

Result<PipelineCache> PipelineCache::load(const Context& context, std::string path) {
  PipelineCache result;
  result.vk_ = context.vk;
  result.device_ = context.device;
  result.identity_ = cache_identity(context.physical_device, context.vk);
  result.path_ = std::move(path);
  auto info = init<VkPipelineCacheCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO);
  const auto bytes = read_file(result.path_);
  if (!bytes) {
    result.ignored_ = bytes.error().text();
  } else if (const auto data = read_cache_blob(*bytes, result.identity_); !data) {
    result.ignored_ = fmt::format("{}: {}", result.path_, data.error().text());
  } else {
    info.initialDataSize = data->size();
    info.pInitialData = data->data();
  }
  SHALE_TRY(result.cache_, make(context.vk.CreatePipelineCache, context.vk.DestroyPipelineCache,
                                "vkCreatePipelineCache", context.device, info));
  return result;
}

Result<void> PipelineCache::save() const {
  size_t size = 0;
  SHALE_TRY_VOID(check(vk_.GetPipelineCacheData(device_, cache_.get(), &size, nullptr),
                       "vkGetPipelineCacheData"));
  std::vector<uint8_t> data(size);
  SHALE_TRY_VOID(check(vk_.GetPipelineCacheData(device_, cache_.get(), &size, data.data()),
                       "vkGetPipelineCacheData"));
  data.resize(size);
  const std::vector<uint8_t> bytes = write_cache_blob(data, identity_);
  if (const auto old = read_file(path_); old && *old == bytes) return {};
  return write_file(path_, bytes);
}

}  // namespace shale::vk
