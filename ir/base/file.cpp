#include "ir/base/file.h"

#include <fcntl.h>
#include <linux/magic.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>
#include <mutex>
#include <set>

#include "ir/base/hash.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

/// A descriptor of ours.
class Descriptor {
 public:
  explicit Descriptor(int number) : number_(number) {}
  ~Descriptor() { close(); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return number_; }
  explicit operator bool() const { return number_ >= 0; }
  bool close() {
    const int number = std::exchange(number_, -1);
    return number < 0 || ::close(number) == 0;
  }

 private:
  int number_;
};

/// Files that have not got their name yet. Never destroyed: a thread may end the process at any time.
struct Unfinished {
  std::mutex mutex;
  std::set<std::string> paths;
};
Unfinished& unfinished() {
  static auto* const files = new Unfinished;
  return *files;
}

constexpr int kMostLinks = 40;  // as the kernel follows

/// Where the bytes for a path go.
struct Target {
  std::string path;       ///< after links
  bool replaces = false;  ///< a regular file, by rename; else written through
  bool exists = false;
  struct stat info = {};
};

std::string folder_of(const std::string& path) {
  const std::string folder = fs::path(path).parent_path().string();
  return folder.empty() ? "." : folder;
}

/// Links below /proc lead to open files, not to names.
bool is_magic(const std::string& link) {
  struct statfs info = {};
  return statfs(folder_of(link).c_str(), &info) == 0 && info.f_type == PROC_SUPER_MAGIC;
}

/// Standard output or error, if they are the file: what is written otherwise starts anew at its
/// beginning, below or above their own text. -1 if they are not.
int standard_descriptor(const struct stat& info) {
  for (const int number : {STDOUT_FILENO, STDERR_FILENO}) {
    struct stat own = {};
    const int flags = fcntl(number, F_GETFL);
    if (flags != -1 && (flags & O_ACCMODE) != O_RDONLY && fstat(number, &own) == 0 &&
        own.st_dev == info.st_dev && own.st_ino == info.st_ino)
      return number;
  }
  return -1;
}

Result<Target> target_of(const std::string& path) {
  Target target{path, true};
  if (path.empty()) return io_error(path, "the path of the file to write is empty");
  // This first, by the kernel: it knows links that must not be followed.
  target.exists = stat(path.c_str(), &target.info) == 0;
  if (!target.exists && errno != ENOENT)
    return io_error(path, "cannot write: {}", std::strerror(errno));
  if (target.exists && S_ISDIR(target.info.st_mode))
    return bad_input(path, "is a folder, expected a file to write");
  if (target.exists && !S_ISREG(target.info.st_mode)) {
    target.replaces = false;
    if (standard_descriptor(target.info) < 0 &&
        faccessat(AT_FDCWD, path.c_str(), W_OK, AT_EACCESS) != 0)
      return io_error(path, "cannot write: {}", std::strerror(errno));
    return target;
  }
  for (int links = 0;; ++links) {
    struct stat own = {};
    if (lstat(target.path.c_str(), &own) != 0 || !S_ISLNK(own.st_mode)) break;
    if (is_magic(target.path)) {
      target.replaces = false;
      return target;
    }
    std::error_code error;
    const fs::path link = fs::read_symlink(target.path, error);
    if (error || links == kMostLinks)
      return io_error(path, "cannot follow the link: {}",
                      error ? error.message() : std::strerror(ELOOP));
    target.path = (fs::path(target.path).parent_path() / link).string();
  }
  if (target.path.ends_with('/')) return bad_input(path, "is a folder, expected a file to write");
  if (target.exists && faccessat(AT_FDCWD, target.path.c_str(), W_OK, AT_EACCESS) != 0)
    return io_error(path, "cannot write: {}", std::strerror(errno));
  if (faccessat(AT_FDCWD, folder_of(target.path).c_str(), W_OK | X_OK, AT_EACCESS) != 0)
    return io_error(path, "cannot create: {}", std::strerror(errno));
  return target;
}

bool write_all(int descriptor, std::span<const uint8_t> bytes) {
  while (!bytes.empty()) {
    const ssize_t count = ::write(descriptor, bytes.data(), bytes.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return false;
    bytes = bytes.subspan(static_cast<size_t>(count));
  }
  return true;
}

/// To the disk; what is no disk says that it cannot.
bool flush(int descriptor) {
  return fsync(descriptor) == 0 || errno == EINVAL || errno == EROFS || errno == ENOTSUP;
}

Result<void> write_through(const std::string& path, const Target& target,
                           std::span<const uint8_t> bytes) {
  const auto fail = [&](const char* what) {
    return io_error(path, "cannot {}: {}", what, std::strerror(errno));
  };
  if (const int standard = standard_descriptor(target.info); standard >= 0) {
    if (std::fflush(standard == STDOUT_FILENO ? stdout : stderr) != 0 ||
        !write_all(standard, bytes))
      return fail("write");
    return {};
  }
  Descriptor file(open(target.path.c_str(), O_WRONLY | O_TRUNC | O_CLOEXEC | O_NOCTTY));
  if (!file) return fail("open for writing");
  if (!write_all(file.get(), bytes) || !flush(file.get()) || !file.close()) return fail("write");
  return {};
}

/// A new file with a name that nobody can foresee; -1 and errno.
int create_beside(const std::string& path, mode_t mode, std::string& name) {
  std::lock_guard lock(unfinished().mutex);
  for (int attempt = 0; attempt < 100; ++attempt) {
    uint64_t random[2];
    if (getrandom(random, sizeof random, 0) != sizeof random) return -1;
    name = (fs::path(folder_of(path)) / fmt::format(".shale-{:016x}{:016x}", random[0], random[1]))
               .string();
    const int file = open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, mode);
    if (file >= 0) unfinished().paths.insert(name);
    if (file >= 0 || errno != EEXIST) return file;
  }
  return -1;
}

}  // namespace

Result<std::vector<uint8_t>> read_file(const std::string& path) {
  File file(std::fopen(path.c_str(), "rbe"));
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
  SHALE_TRY(const Target target, target_of(path));
  if (!target.replaces || (target.exists && standard_descriptor(target.info) >= 0))
    return write_through(path, target, bytes);
  constexpr mode_t kPermissions = 0777;
  const mode_t mode = target.exists ? target.info.st_mode & kPermissions : mode_t{0666};
  std::string name;
  Descriptor file(create_beside(target.path, mode, name));
  if (!file) return io_error(path, "cannot create: {}", std::strerror(errno));
  const auto forget = [&] {
    std::lock_guard lock(unfinished().mutex);
    unfinished().paths.erase(name);
  };
  const auto fail = [&](const char* what) {
    const Error error = io_error(path, "cannot {}: {}", what, std::strerror(errno));
    std::remove(name.c_str());
    forget();
    return error;
  };
  if (target.exists) {
    // Another owner is for root to keep; a group may be ours.
    if (fchown(file.get(), target.info.st_uid, target.info.st_gid) != 0 &&
        fchown(file.get(), static_cast<uid_t>(-1), target.info.st_gid) != 0)
      errno = 0;
    if (fchmod(file.get(), mode) != 0) return fail("set the mode of the new file");
  }
  if (!write_all(file.get(), bytes) || !flush(file.get()) || !file.close()) return fail("write");
  if (std::rename(name.c_str(), target.path.c_str()) != 0) return fail("rename into place");
  forget();
  // The name is as good as its folder; where a folder cannot be flushed the file is there all the same.
  const Descriptor folder(open(folder_of(target.path).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder) (void)flush(folder.get());
  return {};
}

Result<void> write_text(const std::string& path, std::string_view text) {
  return write_file(path, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
}

Result<std::string> output_identity(const std::string& path) {
  SHALE_TRY(const Target target, target_of(path));
  if (!target.replaces) return std::string();
  struct stat folder = {};
  if (stat(folder_of(target.path).c_str(), &folder) != 0)
    return io_error(path, "cannot create: {}", std::strerror(errno));
  return fmt::format("{}:{}:{}", folder.st_dev, folder.st_ino,
                     fs::path(target.path).filename().string());
}

bool is_standard_output(const std::string& path) {
  struct stat info = {}, null = {};
  if (stat(path.c_str(), &info) != 0 || standard_descriptor(info) != STDOUT_FILENO) return false;
  // What goes there never meets.
  return !S_ISCHR(info.st_mode) || stat("/dev/null", &null) != 0 || info.st_rdev != null.st_rdev;
}

Result<void> make_folder(const std::string& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (!error && !fs::is_directory(path, error) && !error)
    error = std::make_error_code(std::errc::not_a_directory);
  if (error) return io_error(path, "cannot create the folder: {}", error.message());
  return {};
}

std::string safe_file_name(std::string_view name) {
  constexpr size_t kMostBytes = 200;  // of 255, and files have suffixes
  std::string safe(name);
  for (char& c : safe)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f || c == '/' || c == '\\') c = '_';
  if (safe.empty() || safe[0] == '.' || safe[0] == '-') safe.insert(0, "_");
  if (safe.size() > kMostBytes) {
    size_t cut = kMostBytes;
    while (cut > 0 && (static_cast<unsigned char>(safe[cut]) & 0xc0) == 0x80) --cut;
    safe = safe.substr(0, cut) +
           fmt::format("-{:016x}",
                       stable_hash({reinterpret_cast<const uint8_t*>(name.data()), name.size()}));
  }
  return safe;
}

void remove_unfinished_files() {
  std::lock_guard lock(unfinished().mutex);
  for (const std::string& path : unfinished().paths) unlink(path.c_str());
}

}  // namespace shale
