// ir/base/hash.h -- a stable 64-bit hash (FNV-1a), equal on every machine and in every run.
#pragma once

#include <cstdint>
#include <span>

namespace shale {

inline constexpr uint64_t kHashSeed = 0xcbf29ce484222325u;

/// For deduplication and provenance, not against forgery.
/// Source: Fowler, Noll, Vo, FNV-1a 64.
inline uint64_t stable_hash(std::span<const uint8_t> bytes, uint64_t seed = kHashSeed) {
  for (const uint8_t byte : bytes) seed = (seed ^ byte) * 0x100000001b3u;
  return seed;
}

}  // namespace shale
