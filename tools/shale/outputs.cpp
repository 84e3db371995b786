#include "tools/shale/outputs.h"

#include <algorithm>
#include <cctype>
#include <filesystem>

#include "ir/base/file.h"

namespace shale {

void Outputs::keep(const std::string& path) {
  if (const Result<std::string> identity = output_identity(path); identity && !identity->empty())
    owners_.emplace(*identity, "the input");
}

Result<void> Outputs::claim(const std::string& what, const std::string& path) {
  if (path.empty()) return {};
  SHALE_TRY(const std::string identity, output_identity(path));
  if (identity.empty()) return {};
  const auto [owner, is_new] = owners_.emplace(identity, what);
  if (!is_new)
    return bad_input(path, "is the file of {} already, so {} cannot go there", owner->second, what);
  return {};
}

Result<void> Outputs::claim_picture(const std::string& what, const std::string& path) {
  std::string suffix = std::filesystem::path(path).extension().string();
  std::ranges::transform(suffix, suffix.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (!suffix.empty() && suffix != ".png")
    return bad_input(path, "pictures are written as PNG, expected the suffix .png, found \"{}\"",
                     suffix);
  return claim(what, path);
}

std::string FileNames::claim(const std::string& name) {
  const std::string safe = safe_file_name(name);
  std::string candidate = safe;
  for (uint32_t i = 2; !taken_.insert(candidate).second; ++i)
    candidate = fmt::format("{}-{}", safe, i);
  return candidate;
}

std::FILE* summary_stream(const std::string& path) {
  return is_standard_output(path) ? stderr : stdout;
}

}  // namespace shale
