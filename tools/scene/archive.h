// tools/scene/archive.h -- files by name, from a folder or from a zip file.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "ir/base/result.h"

namespace shale {

class Archive {
 public:
  virtual ~Archive() = default;
  /// Errors: kIo if there is no such file, kBadInput if it cannot be unpacked or is above 256 MiB.
  virtual Result<std::vector<uint8_t>> read(const std::string& name) const = 0;
  virtual bool has(const std::string& name) const = 0;
  /// What messages call a file of that name.
  virtual std::string where(const std::string& name) const = 0;
};

std::unique_ptr<Archive> open_folder(const std::string& path);

/// Names are found in any case.
/// Errors: kIo if there is no such file, kBadInput if it is no zip file.
Result<std::unique_ptr<Archive>> open_zip(const std::string& path);

}  // namespace shale
