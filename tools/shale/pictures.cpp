#include "tools/shale/pictures.h"

#include <algorithm>
#include <cctype>
#include <filesystem>

#include "tools/eval/tonemap.h"
#include "tools/scene/exr.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

/// Largest picture, in pixels: the metrics' planes take some 60 bytes for each.
constexpr uint64_t kMaxPixels = uint64_t{1} << 26;

}  // namespace

std::string extension_of(const std::string& path) {
  std::string extension = fs::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

Result<FloatImage> load_display(const std::string& path, float exposure) {
  if (extension_of(path) == ".exr") {
    SHALE_TRY(const FloatImage linear, read_exr(path, 3));
    return display_image(linear, exposure);
  }
  SHALE_TRY(const Picture picture, load_picture(path));
  if (uint64_t{picture.width} * picture.height > kMaxPixels)
    return unsupported(path, "has {}x{} pixels, metrics take {} at most", picture.width,
                       picture.height, kMaxPixels);
  return to_float_image(picture);
}

Result<std::map<std::string, std::string>> pictures_of(const std::string& folder) {
  std::error_code error;
  std::map<std::string, std::string> files;
  fs::directory_iterator it(folder, error);
  for (; !error && it != fs::directory_iterator(); it.increment(error)) {
    const std::string extension = extension_of(it->path().string());
    for (const char* known : {".png", ".jpg", ".jpeg", ".bmp", ".tga", ".exr"}) {
      if (extension != known) continue;
      const auto [other, is_new] = files.emplace(it->path().stem().string(), it->path().string());
      if (!is_new)
        return bad_input(folder, "holds both {} and {}: which one is meant?",
                         fs::path(other->second).filename().string(),
                         it->path().filename().string());
    }
  }
  if (error) return io_error(folder, "cannot list: {}", error.message());
  if (files.empty()) return bad_input(folder, "holds no picture (.png, .jpg, .bmp, .tga, .exr)");
  return files;
}

}  // namespace shale
