#include "tools/layer/disk_cache.h"

#include <dlfcn.h>
#include <fmt/ranges.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "ir/base/file.h"
#include "ir/base/hash.h"

namespace shale::layer {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMagic = "SHALEGP1";
constexpr size_t kHeadBytes = 16;  ///< magic, hash of what follows
constexpr size_t kMostFiles = 256;

std::string cache_folder() {
  if (const char* chosen = secure_getenv("SHALE_LAYER_CACHE"))
    return std::string_view(chosen) == "off" ? "" : chosen;
  if (const char* cache = secure_getenv("XDG_CACHE_HOME"); cache && *cache == '/')
    return std::string(cache) + "/shale/layer";
  if (const char* home = secure_getenv("HOME"); home && *home == '/')
    return std::string(home) + "/.cache/shale/layer";
  return "";
}

/// The oldest files go.
void prune(const std::string& folder) {
  std::error_code error;
  std::vector<std::pair<fs::file_time_type, fs::path>> files;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error))
    if (it->path().extension() == ".shale")
      files.emplace_back(it->last_write_time(error), it->path());
  if (files.size() <= kMostFiles) return;
  std::sort(files.begin(), files.end());
  for (size_t i = 0; i < files.size() - kMostFiles; ++i) fs::remove(files[i].second, error);
}

}  // namespace

const std::string& layer_identity() {
  static const std::string identity = [] {
    Dl_info own{};
    struct stat file {};
    if (!dladdr(reinterpret_cast<const void*>(&layer_identity), &own) || stat(own.dli_fname, &file))
      return std::string("unknown");
    return fmt::format("{}.{}.{}", static_cast<int64_t>(file.st_mtim.tv_sec),
                       static_cast<int64_t>(file.st_mtim.tv_nsec),
                       static_cast<int64_t>(file.st_size));
  }();
  return identity;
}

std::unique_ptr<DiskCache> DiskCache::open(const Device& device) {
  const std::string folder = cache_folder();
  if (folder.empty() || !make_folder(folder)) return nullptr;
  std::unique_ptr<DiskCache> cache(new DiskCache(folder));
  const vk::CacheIdentity identity =
      vk::cache_identity(device.physical->handle, device.context->vk);
  const std::string file =
      fmt::format("{}/pipelines-{:02x}.cache", folder, fmt::join(identity.cache_uuid, ""));
  if (auto pipelines = vk::PipelineCache::load(*device.context, file))
    cache->pipelines_ = *std::move(pipelines);
  return cache;
}

DiskCache::~DiskCache() {
  if (pipelines_) (void)static_cast<bool>(pipelines_->save());
}

std::string DiskCache::file_of(const Identifier& identifier) const {
  return fmt::format("{}/{:02x}.shale", folder_, fmt::join(identifier, ""));
}

std::shared_ptr<const std::vector<uint8_t>> DiskCache::find(const Identifier& identifier) const {
  const Result<std::vector<uint8_t>> file = read_file(file_of(identifier));
  if (!file || file->size() < kHeadBytes ||
      std::memcmp(file->data(), kMagic.data(), kMagic.size()) != 0)
    return nullptr;
  const std::span<const uint8_t> package = std::span(*file).subspan(kHeadBytes);
  uint64_t hash = 0;
  std::memcpy(&hash, file->data() + kMagic.size(), sizeof hash);
  if (hash != stable_hash(package)) return nullptr;
  return std::make_shared<const std::vector<uint8_t>>(package.begin(), package.end());
}

void DiskCache::store(const Identifier& identifier, std::span<const uint8_t> package) const {
  std::vector<uint8_t> file(kMagic.begin(), kMagic.end());
  const uint64_t hash = stable_hash(package);
  const auto* bytes = reinterpret_cast<const uint8_t*>(&hash);
  file.insert(file.end(), bytes, bytes + sizeof hash);
  file.insert(file.end(), package.begin(), package.end());
  if (write_file(file_of(identifier), file)) prune(folder_);
}

}  // namespace shale::layer
