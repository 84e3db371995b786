#include "ir/base/file.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>

namespace shale {
namespace {

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

}  // namespace

Result<std::vector<uint8_t>> read_file(const std::string& path) {
  File file(std::fopen(path.c_str(), "rb"));
  if (!file) return io_error(path, "cannot open: {}", std::strerror(errno));
  struct stat info = {};
  if (fstat(fileno(file.get()), &info) != 0)
    return io_error(path, "cannot read: {}", std::strerror(errno));
  if (S_ISDIR(info.st_mode)) return bad_input(path, "is a folder, expected a file");
  std::vector<uint8_t> bytes;
  // Grown chunk by chunk: the size of a pipe or a /proc file is not known in advance.
  constexpr size_t kChunk = size_t{1} << 20;
  for (;;) {
    const size_t old_size = bytes.size();
    bytes.resize(old_size + kChunk);
    const size_t count = std::fread(bytes.data() + old_size, 1, kChunk, file.get());
    bytes.resize(old_size + count);
    if (bytes.size() > kMaxFileBytes)
      return bad_input(path, "is larger than the {} bytes that are accepted", kMaxFileBytes);
    if (count < kChunk) break;
  }
  if (std::ferror(file.get())) return io_error(path, "cannot read: {}", std::strerror(errno));
  return bytes;
}

Result<std::string> read_text(const std::string& path) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  return std::string(bytes.begin(), bytes.end());
}

Result<void> write_file(const std::string& path, std::span<const uint8_t> bytes) {
  const std::string temporary = fmt::format("{}.tmp{}", path, getpid());
  const auto fail = [&](const char* what) {
    const Error error = io_error(path, "cannot {}: {}", what, std::strerror(errno));
    std::remove(temporary.c_str());
    return error;
  };
  File file(std::fopen(temporary.c_str(), "wb"));
  if (!file) return io_error(path, "cannot create: {}", std::strerror(errno));
  if (std::fwrite(bytes.data(), 1, bytes.size(), file.get()) != bytes.size()) return fail("write");
  if (std::fclose(file.release()) != 0) return fail("write");
  if (std::rename(temporary.c_str(), path.c_str()) != 0) return fail("rename into place");
  return {};
}

Result<void> write_text(const std::string& path, std::string_view text) {
  return write_file(path, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
}

}  // namespace shale
