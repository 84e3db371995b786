#include "runtime/vk/pipeline_cache.h"

#include <gtest/gtest.h>

#include <cstring>

namespace shale {
namespace {

vk::CacheIdentity identity() {
  vk::CacheIdentity identity{.vendor_id = 0x10005, .device_id = 3, .driver_version = 7};
  identity.driver_uuid.fill(0xd1);
  identity.cache_uuid.fill(0xca);
  return identity;
}

/// What a driver returns: the header of version one and some bytes.
std::vector<uint8_t> driver_data(const vk::CacheIdentity& of) {
  std::vector<uint8_t> data(64, 0x5a);
  const uint32_t words[] = {32, VK_PIPELINE_CACHE_HEADER_VERSION_ONE, of.vendor_id, of.device_id};
  std::memcpy(data.data(), words, sizeof(words));
  std::copy(of.cache_uuid.begin(), of.cache_uuid.end(), data.begin() + 16);
  return data;
}

std::string refusal(std::span<const uint8_t> bytes, const vk::CacheIdentity& expected) {
  const auto data = vk::read_cache_blob(bytes, expected);
  return data ? "accepted" : data.error().text();
}

TEST(CacheBlob, ComesBackAsItWasWritten) {
  const std::vector<uint8_t> data = driver_data(identity());
  const std::vector<uint8_t> blob = vk::write_cache_blob(data, identity());
  const auto read = vk::read_cache_blob(blob, identity());
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_TRUE(std::equal(read->begin(), read->end(), data.begin(), data.end()));
}

TEST(CacheBlob, IsRefusedWhenCutAnywhere) {
  const std::vector<uint8_t> blob = vk::write_cache_blob(driver_data(identity()), identity());
  for (size_t size = 0; size < blob.size(); ++size)
    ASSERT_FALSE(vk::read_cache_blob(std::span(blob).first(size), identity())) << size;
}

TEST(CacheBlob, IsRefusedWithAnyByteChanged) {
  const std::vector<uint8_t> blob = vk::write_cache_blob(driver_data(identity()), identity());
  for (size_t i = 0; i < blob.size(); ++i) {
    std::vector<uint8_t> damaged = blob;
    damaged[i] ^= 0x10;
    ASSERT_FALSE(vk::read_cache_blob(damaged, identity())) << "byte " << i;
  }
  std::vector<uint8_t> longer = blob;
  longer.push_back(0);
  EXPECT_EQ(refusal(longer, identity()), "the cache file holds 65 bytes of data, expected 64");
}

TEST(CacheBlob, IsRefusedForAnotherDriverOrDevice) {
  const std::vector<uint8_t> blob = vk::write_cache_blob(driver_data(identity()), identity());
  vk::CacheIdentity other = identity();
  other.driver_uuid[15] = 0;
  EXPECT_EQ(refusal(blob, other), "the cache file is of another driver");
  other = identity();
  other.driver_version = 8;
  EXPECT_EQ(refusal(blob, other), "the cache file is of another driver");
  other = identity();
  other.device_id = 4;
  EXPECT_EQ(refusal(blob, other), "the pipeline cache is of another device");
  other = identity();
  other.cache_uuid[0] = 0;
  EXPECT_EQ(refusal(blob, other), "the pipeline cache is of another device");
}

TEST(CacheBlob, IsRefusedWithoutASoundVulkanHeader) {
  const auto refusal_of = [](const std::vector<uint8_t>& data) {
    return refusal(vk::write_cache_blob(data, identity()), identity());
  };
  EXPECT_EQ(refusal_of({}), "0 bytes hold no pipeline cache header");
  std::vector<uint8_t> data = driver_data(identity());
  data[0] = 31;
  EXPECT_EQ(refusal_of(data), "the pipeline cache header claims 31 bytes");
  data[0] = 65;
  EXPECT_EQ(refusal_of(data), "the pipeline cache header claims 65 bytes");
  data[0] = 32;
  data[4] = 2;
  EXPECT_EQ(refusal_of(data), "the pipeline cache header has version 2");
}

}  // namespace
}  // namespace shale
