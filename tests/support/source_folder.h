// tests/support/source_folder.h -- where tests find models: beside their sources, or, in a bundle on
// another machine, where SHALE_SOURCES says.
#pragma once

#include <cstdlib>
#include <string>

namespace shale {

inline std::string source_folder() {
  const char* moved = std::getenv("SHALE_SOURCES");
  return moved ? moved : SHALE_SOURCE_DIR;
}

}  // namespace shale
