#include "tools/shale/outputs.h"

#include <algorithm>
#include <cctype>
#include <filesystem>

#include "ir/base/file.h"
#include "tools/shale/terminal.h"

namespace shale {

namespace fs = std::filesystem;

namespace {

constexpr const char* kStandardOutput = "standard output";  // no output_identity is like it

/// Whether a file of an input's folder is a part of a model or a data set, and not the result of an earlier command.
bool is_part(const fs::path& file) {
  const std::string suffix = file.extension().string(), stem = file.stem().string();
  if (suffix == ".json")
    return stem == "frame" || stem == "quantization" ||
           stem.find_first_not_of("0123456789") == std::string::npos;
  return suffix == ".tosa" || suffix == ".npz" || suffix == ".exr";
}

}  // namespace

Outputs::Outputs(bool prints_json) {
  if (prints_json) owners_.emplace(kStandardOutput, "--json");
}

void Outputs::keep_file(const std::string& path) {
  if (const Result<std::string> identity = output_identity(path); identity && !identity->empty())
    owners_.emplace(*identity, "the input");
}

void Outputs::keep(const std::vector<std::string>& paths) {
  std::error_code ignored;
  for (const std::string& path : paths) {
    if (!fs::is_directory(path, ignored)) {
      keep_file(path);
      continue;
    }
    for (fs::directory_iterator at(path, ignored); at != fs::directory_iterator();
         at.increment(ignored))
      if (at->is_regular_file(ignored) && is_part(at->path())) keep_file(at->path().string());
  }
}

void Outputs::keep_named(const std::vector<std::string>& texts) {
  std::error_code ignored;
  for (const std::string& text : texts) {
    const std::string path = text.substr(text.find('=') + 1);
    if (!fs::is_directory(path, ignored)) keep_file(path);
    for (fs::recursive_directory_iterator at(path, ignored), end; at != end; at.increment(ignored))
      if (at->is_regular_file(ignored)) keep_file(at->path().string());
  }
}

Result<void> Outputs::claim(const std::string& what, const std::string& path) {
  if (path.empty()) return {};
  SHALE_TRY(std::string identity, output_identity(path));
  if (is_standard_output(path)) identity = kStandardOutput;
  if (identity.empty()) return {};
  const auto [owner, is_new] = owners_.emplace(identity, what);
  if (!is_new)
    return bad_input(path, "is the file of {} already, so {} cannot go there", owner->second, what);
  return {};
}

Result<void> Outputs::claim_picture(const std::string& what, const std::string& path) {
  std::string suffix = fs::path(path).extension().string();
  std::ranges::transform(suffix, suffix.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (!suffix.empty() && suffix != ".png")
    return bad_input(path, "pictures are written as PNG, expected the suffix .png, found \"{}\"",
                     suffix);
  return claim(what, path);
}

bool Outputs::note(const Result<void>& written) {
  if (written) return true;
  print_error(written.error());
  return all_written_ = false;
}

bool Outputs::has_standard_output() const { return owners_.contains(kStandardOutput); }

std::FILE* Outputs::summary() const { return has_standard_output() ? stderr : stdout; }

std::string FileNames::claim(const std::string& name) {
  const std::string safe = safe_file_name(name);
  std::string candidate = safe;
  for (uint32_t i = 2; !taken_.insert(candidate).second; ++i)
    candidate = fmt::format("{}-{}", safe, i);
  return candidate;
}

std::vector<std::string> distinct_names(std::vector<std::string> names,
                                        const std::vector<std::string>& paths) {
  std::vector<fs::path> above;
  for (const std::string& path : paths)
    above.push_back(fs::absolute(path + "/").lexically_normal().parent_path().parent_path());
  for (bool changed = true; changed;) {
    changed = false;
    std::map<std::string, std::set<fs::path>> places;
    for (size_t i = 0; i < names.size(); ++i) places[names[i]].insert(above[i]);
    for (size_t i = 0; i < names.size(); ++i) {
      if (places[names[i]].size() < 2 || !above[i].has_relative_path()) continue;
      names[i] = (above[i].filename() / names[i]).string();
      above[i] = above[i].parent_path();
      changed = true;
    }
  }
  std::set<std::string> taken;
  for (std::string& name : names) {
    const std::string own = name;
    for (uint32_t i = 2; !taken.insert(name).second; ++i) name = fmt::format("{}-{}", own, i);
  }
  return names;
}

}  // namespace shale
