#include "tools/layer/specialize.h"

#include <cstring>
#include <unordered_map>

namespace shale::layer {
namespace {

constexpr uint32_t kDecorate = 71, kSpecId = 1;
constexpr uint32_t kSpecConstantTrue = 48, kSpecConstantFalse = 49, kSpecConstant = 50;
constexpr size_t kHeaderWords = 5;

/// Calls visit(words of an instruction) for each.
template <typename Visit>
Result<void> for_each_instruction(std::span<uint32_t> words, const Visit& visit) {
  for (size_t at = kHeaderWords; at < words.size();) {
    const size_t size = words[at] >> 16;
    if (size == 0 || size > words.size() - at) break;
    SHALE_TRY_VOID(visit(words.subspan(at, size)));
    at += size;
  }
  return {};
}

}  // namespace

Result<void> specialize(std::vector<uint32_t>& words, const VkSpecializationInfo* info) {
  if (!info || info->mapEntryCount == 0) return {};
  std::unordered_map<uint32_t, const VkSpecializationMapEntry*> entries;  // by constant id
  for (uint32_t i = 0; i < info->mapEntryCount; ++i) {
    const VkSpecializationMapEntry& entry = info->pMapEntries[i];
    if (entry.offset > info->dataSize || entry.size > info->dataSize - entry.offset)
      return bad_input("VkSpecializationInfo", "constant {} is bytes {} to {} of {}",
                       entry.constantID, entry.offset, entry.offset + entry.size, info->dataSize);
    entries.emplace(entry.constantID, &entry);
  }
  std::unordered_map<uint32_t, const VkSpecializationMapEntry*> by_id;  // by result id
  SHALE_TRY_VOID(for_each_instruction(words, [&](std::span<uint32_t> words_of) -> Result<void> {
    if ((words_of[0] & 0xffff) == kDecorate && words_of.size() == 4 && words_of[2] == kSpecId)
      if (const auto found = entries.find(words_of[3]); found != entries.end())
        by_id.emplace(words_of[1], found->second);
    return {};
  }));
  return for_each_instruction(words, [&](std::span<uint32_t> words_of) -> Result<void> {
    const uint32_t opcode = words_of[0] & 0xffff;
    if (opcode < kSpecConstantTrue || opcode > kSpecConstant || words_of.size() < 3) return {};
    const auto found = by_id.find(words_of[2]);
    if (found == by_id.end()) return {};
    const VkSpecializationMapEntry& entry = *found->second;
    const auto* data = static_cast<const uint8_t*>(info->pData) + entry.offset;
    const bool is_bool = opcode != kSpecConstant;
    const size_t room = is_bool ? sizeof(VkBool32) : 4 * (words_of.size() - 3);
    // Types below 32 bits take a whole word.
    if (entry.size > room || entry.size == 0 || (is_bool && entry.size != room) ||
        (room == 8 && entry.size != 8))
      return bad_input("VkSpecializationInfo", "constant {} has {} bytes, expected {}",
                       entry.constantID, entry.size, room);
    uint32_t value[2] = {};
    std::memcpy(value, data, std::min(entry.size, sizeof value));
    if (is_bool)
      words_of[0] =
          (words_of[0] & 0xffff0000) | (value[0] ? kSpecConstantTrue : kSpecConstantFalse);
    else
      std::memcpy(&words_of[3], value, std::min(room, sizeof value));
    return {};
  });
}

}  // namespace shale::layer
