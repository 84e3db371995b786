// compiler/frontend/vgf/layout.h -- fixed positions of a VGF file, for its reader and writer.
#pragma once

#include <array>
#include <cstdint>

#include "compiler/frontend/vgf/vgf.h"

namespace shale::vgf_layout {

inline constexpr std::array<uint8_t, 4> kMagic{'V', 'G', 'F', '1'};
inline constexpr std::array<uint8_t, 4> kOldMagic{0xC3, 0xD2, 0xE1, 0xF0};
inline constexpr std::array<uint8_t, 8> kConstantsTag{'C', 'O', 'N', 'S', 'T', '0', '0', 0};

// Offsets in the header.
inline constexpr size_t kVkHeaderVersion = 4;
inline constexpr size_t kVersion = 8;
inline constexpr size_t kSections = 16;  ///< offset and size of four sections, 8 bytes each
inline constexpr size_t kHeaderBytes = 128;

// Offsets in the constants section.
inline constexpr size_t kRecords = 16;
inline constexpr size_t kRecordBytes = 24;

/// Sections and constants begin at multiples of this.
inline constexpr size_t kAlignment = 8;
inline constexpr size_t aligned(size_t size) {
  return (size + kAlignment - 1) / kAlignment * kAlignment;
}

/// `segment 1 "decode"`: how messages name an entry.
inline std::string label(const char* what, size_t index, const std::string& name) {
  return name.empty() ? fmt::format("{} {}", what, index)
                      : fmt::format("{} {} \"{}\"", what, index, name);
}

}  // namespace shale::vgf_layout
