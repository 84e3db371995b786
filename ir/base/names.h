// ir/base/names.h -- what names may hold.
#pragma once

#include <algorithm>
#include <string_view>

namespace shale {

/// True of names that may not go into messages, tables, JSON and shaders' listings as they stand.
inline bool has_control_characters(std::string_view name) {
  return std::ranges::any_of(name, [](unsigned char c) { return c < 0x20 || c == 0x7f; });
}

}  // namespace shale
