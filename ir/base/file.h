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

/// Replaces a regular file, or makes one, in one step: the bytes go to a new file beside it, to disk,
/// and then by rename to their name, so no reader sees half a file. A symbolic link stays, what it
/// names is replaced; mode, and where permitted owner, stay. Whatever is no regular file (FIFO,
/// device, /dev/stdout) is written through.
/// Errors: kIo, and nothing is left of the new file; kBadInput if the path is a folder.
Result<void> write_file(const std::string& path, std::span<const uint8_t> bytes);
Result<void> write_text(const std::string& path, std::string_view text);

/// What write_file would refuse, told before there is anything to write. The value is equal for two
/// paths whose later one would replace the earlier; empty for what is written through.
/// Errors: as write_file.
Result<std::string> output_identity(const std::string& path);

/// True if the path leads to what is our standard output, where no other text may go then.
bool is_standard_output(const std::string& path);

/// The folder and those above it.
/// Errors: kIo.
Result<void> make_folder(const std::string& path);

/// A name of a value, image or layer as the name of a file: `name` where it is one, else with
/// underscores for what is not safe in one (separators, control characters, a leading point) and,
/// where it is too long, cut. Different names may give the same.
std::string safe_file_name(std::string_view name);

/// Removes what write_file has not brought to its name yet: for a process that is about to end.
void remove_unfinished_files();

}  // namespace shale
