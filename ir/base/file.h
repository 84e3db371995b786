// ir/base/file.h -- whole files in and out; a written file is complete or absent.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "ir/base/result.h"

namespace shale {

/// Largest file that read_file accepts, bytes: FlatBuffers offsets end at 2 GiB.
inline constexpr uint64_t kMaxFileBytes = uint64_t{1} << 31;

/// Errors: kIo if the file cannot be opened or read, kBadInput if it is a folder or above 2 GiB.
Result<std::vector<uint8_t>> read_file(const std::string& path);

/// As read_file, for text.
Result<std::string> read_text(const std::string& path);

/// Writes to a temporary name beside `path`, then renames it, so no reader sees half a file.
/// Errors: kIo, and the temporary file is gone.
Result<void> write_file(const std::string& path, std::span<const uint8_t> bytes);
Result<void> write_text(const std::string& path, std::string_view text);

}  // namespace shale
