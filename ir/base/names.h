// ir/base/names.h -- what names may hold.
#pragma once

#include <algorithm>
#include <string_view>

namespace shale {

inline bool has_control_characters(std::string_view text) {
  return std::ranges::any_of(text, [](unsigned char c) { return c < 0x20 || c == 0x7f; });
}

/// What keeps a name from messages, tables, JSON and shaders' listings, where it has to go as it stands:
/// control characters, or bytes that are no UTF-8, which the strings of FlatBuffers, SPIR-V and JSON
/// are. Empty for a good name.
std::string_view name_fault(std::string_view name);

}  // namespace shale
