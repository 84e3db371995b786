#include "tools/scene/archive.h"

#include <minizip/unzip.h>

#include <algorithm>
#include <filesystem>

#include "ir/base/file.h"

namespace shale {
namespace {

constexpr uint64_t kMaxEntryBytes = uint64_t{256} << 20;

class Folder : public Archive {
 public:
  explicit Folder(std::string path) : path_(std::move(path)) {}
  Result<std::vector<uint8_t>> read(const std::string& name) const override {
    return read_file(where(name));
  }
  bool has(const std::string& name) const override {
    std::error_code none;
    return std::filesystem::is_regular_file(where(name), none);
  }
  std::string where(const std::string& name) const override {
    return (std::filesystem::path(path_) / name).string();
  }

 private:
  std::string path_;
};

class Zip : public Archive {
 public:
  Zip(std::string path, unzFile file) : path_(std::move(path)), file_(file) {}
  ~Zip() override { unzClose(file_); }
  Zip(const Zip&) = delete;
  Zip& operator=(const Zip&) = delete;

  Result<std::vector<uint8_t>> read(const std::string& name) const override {
    if (!has(name)) return io_error(where(name), "is not in the archive");
    unz_file_info64 info{};
    if (unzGetCurrentFileInfo64(file_, &info, nullptr, 0, nullptr, 0, nullptr, 0) != UNZ_OK)
      return bad_input(where(name), "has a broken entry in the archive");
    if (info.uncompressed_size > kMaxEntryBytes)
      return bad_input(where(name), "has {} bytes, expected at most {}", info.uncompressed_size,
                       kMaxEntryBytes);
    std::vector<uint8_t> bytes(info.uncompressed_size);
    if (unzOpenCurrentFile(file_) != UNZ_OK)
      return bad_input(where(name), "is packed in a way that cannot be read");
    const int got = unzReadCurrentFile(file_, bytes.data(), static_cast<unsigned>(bytes.size()));
    const bool whole = got >= 0 && static_cast<size_t>(got) == bytes.size();
    // The close also compares the checksum.
    if (unzCloseCurrentFile(file_) != UNZ_OK || !whole)
      return bad_input(where(name), "cannot be unpacked: {} of {} bytes are sound",
                       std::max(got, 0), bytes.size());
    return bytes;
  }
  bool has(const std::string& name) const override {
    constexpr int kAnyCase = 2;
    return unzLocateFile(file_, name.c_str(), kAnyCase) == UNZ_OK;
  }
  std::string where(const std::string& name) const override { return path_ + "/" + name; }

 private:
  std::string path_;
  unzFile file_;
};

}  // namespace

std::unique_ptr<Archive> open_folder(const std::string& path) {
  return std::make_unique<Folder>(path);
}

Result<std::unique_ptr<Archive>> open_zip(const std::string& path) {
  std::error_code none;
  if (!std::filesystem::is_regular_file(path, none)) return io_error(path, "there is no such file");
  const unzFile file = unzOpen64(path.c_str());
  if (file == nullptr) return bad_input(path, "is not a zip file");
  return std::unique_ptr<Archive>(std::make_unique<Zip>(path, file));
}

}  // namespace shale
