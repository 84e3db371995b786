// tests/ir/golden_files.h -- the .tosa files of the golden cases (tests/golden/tosa.tar.xz, unpacked by CMake).
#pragma once

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "ir/base/file.h"

namespace shale {

struct GoldenFile {
  std::string name;  ///< "conv2d/03"
  std::vector<uint8_t> bytes;
};

/// Sorted by name; empty without the folder.
inline std::vector<GoldenFile> golden_files() {
  namespace fs = std::filesystem;
  const fs::path root = fs::path(SHALE_BINARY_DIR) / "golden" / "tosa";
  std::vector<GoldenFile> files;
  std::error_code error;
  for (fs::recursive_directory_iterator it(root, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() != ".tosa") continue;
    if (Result<std::vector<uint8_t>> bytes = read_file(it->path().string()))
      files.push_back({fs::relative(it->path().parent_path(), root).string(), *std::move(bytes)});
  }
  std::sort(files.begin(), files.end(),
            [](const GoldenFile& a, const GoldenFile& b) { return a.name < b.name; });
  return files;
}

/// The cases that TOSA calls legal.
inline bool is_legal(const GoldenFile& file) { return !file.name.starts_with("invalid/"); }

}  // namespace shale
