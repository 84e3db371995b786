// Greps every include of the product against what its room may see, so that the layers cannot age,
// and keeps files short enough to read.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <regex>
#include <string>
#include <vector>

namespace {

namespace fs = std::filesystem;

struct Rule {
  std::string room;                  ///< prefix of the including file
  std::vector<std::string> may_see;  ///< prefixes of project headers
};

/// The longest matching room counts.
const std::vector<Rule> kRules{
    {"ir/base/", {"ir/base/"}},
    {"ir/graph/", {"ir/base/", "ir/graph/"}},
    {"ir/text/", {"ir/base/", "ir/graph/", "ir/text/"}},
    {"ir/verify/", {"ir/base/", "ir/graph/", "ir/verify/"}},
    {"ir/binary/", {"ir/base/", "ir/graph/", "ir/binary/", "ir/schema/tosa_generated.h"}},
    {"ir/reference/", {"ir/base/", "ir/graph/", "ir/reference/"}},
    {"ir/package/", {"ir/base/", "ir/package/", "ir/schema/package_generated.h"}},
    {"compiler/", {"ir/", "compiler/"}},
    {"compiler/target/", {"ir/base/", "ir/package/", "compiler/target/"}},
    {"compiler/passes/", {"ir/", "compiler/passes/"}},
    {"compiler/kernels/", {"ir/", "compiler/passes/", "compiler/target/", "compiler/kernels/"}},
    {"compiler/cost/",
     {"ir/", "compiler/passes/", "compiler/target/", "compiler/plan/", "compiler/memory/",
      "compiler/tile/", "compiler/cost/"}},
    {"compiler/plan/",
     {"ir/", "compiler/passes/", "compiler/target/", "compiler/kernels/", "compiler/spirv/",
      "compiler/cost/", "compiler/plan/"}},
    {"compiler/frontend/", {"ir/", "compiler/frontend/"}},
    {"compiler/spirv/", {"ir/base/", "ir/package/", "compiler/spirv/"}},
    {"runtime/", {"ir/base/", "ir/package/", "runtime/"}},
    {"tools/", {"ir/", "compiler/", "runtime/", "tools/"}},
    {"tools/eval/",
     {"ir/base/", "tools/eval/", "tools/scene/frame_source.h", "tools/shale/picture.h"}},
};

struct Door {
  std::regex include;
  std::vector<std::string> allowed;  ///< prefixes of files that may have it
};

const std::vector<Door> kDoors{
    {std::regex("^flatbuffers/"), {"ir/binary/", "ir/package/", "compiler/frontend/"}},
    {std::regex("_generated\\.h$"), {"ir/binary/", "ir/package/", "compiler/frontend/vgf/"}},
    {std::regex("^glslang/"), {"compiler/spirv/glsl.cpp"}},
    {std::regex("^spirv-tools/"), {"compiler/spirv/check.cpp"}},
    {std::regex("^spirv/"), {"compiler/spirv/"}},
    {std::regex("^vulkan/"), {"runtime/", "tools/"}},
    {std::regex("^CLI/"), {"tools/"}},
    {std::regex("^stb/"), {"tools/"}},
    {std::regex("^zlib"), {"ir/package/pack.cpp", "tools/"}},
    {std::regex("^OpenEXR/"), {"tools/scene/exr.cpp"}},
    {std::regex("^nlohmann/"), {"ir/base/json.h", "tools/"}},
};

bool starts_with_any(const std::string& text, const std::vector<std::string>& prefixes) {
  return std::any_of(prefixes.begin(), prefixes.end(),
                     [&](const std::string& prefix) { return text.starts_with(prefix); });
}

struct Include {
  std::string file, header;
};

std::vector<Include> all_includes() {
  static const std::regex kInclude("^\\s*#\\s*include\\s*[<\"]([^>\"]+)[>\"]");
  std::vector<Include> includes;
  const fs::path root(SHALE_SOURCE_DIR);
  for (const char* room : {"ir", "compiler", "runtime", "tools"}) {
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root / room)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".h" && extension != ".cpp" && extension != ".def") continue;
      std::ifstream stream(entry.path());
      for (std::string line; std::getline(stream, line);) {
        std::smatch match;
        if (std::regex_search(line, match, kInclude))
          includes.push_back({fs::relative(entry.path(), root).string(), match[1]});
      }
    }
  }
  return includes;
}

TEST(Layering, RoomsSeeOnlyWhatTheDrawingAllows) {
  const std::vector<Include> includes = all_includes();
  ASSERT_GT(includes.size(), 300u) << "the sources were not found";
  for (const Include& include : includes) {
    if (!starts_with_any(include.header, {"ir/", "compiler/", "runtime/", "tools/", "tests/"}))
      continue;
    const Rule* rule = nullptr;
    for (const Rule& candidate : kRules)
      if (include.file.starts_with(candidate.room) &&
          (!rule || candidate.room.size() > rule->room.size()))
        rule = &candidate;
    ASSERT_NE(rule, nullptr) << include.file << " lies in no room";
    EXPECT_TRUE(starts_with_any(include.header, rule->may_see))
        << include.file << " must not include " << include.header;
  }
}

TEST(Layering, ThirdPartiesComeThroughTheirDoors) {
  for (const Include& include : all_includes()) {
    for (const Door& door : kDoors) {
      if (!std::regex_search(include.header, door.include)) continue;
      EXPECT_TRUE(starts_with_any(include.file, door.allowed))
          << include.file << " must not include " << include.header;
    }
  }
}

/// A file that holds more has two jobs.
constexpr size_t kMostLines = 600;

TEST(Layering, NoFileOfCompilerAndRuntimeIsLong) {
  const fs::path root(SHALE_SOURCE_DIR);
  size_t files = 0;
  for (const char* room : {"compiler", "runtime"})
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root / room)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".h" && extension != ".cpp" && extension != ".def") continue;
      std::ifstream stream(entry.path());
      size_t lines = 0;
      for (std::string line; std::getline(stream, line);) ++lines;
      EXPECT_LE(lines, kMostLines) << fs::relative(entry.path(), root).string();
      ++files;
    }
  EXPECT_GT(files, 100u) << "the sources were not found";
}

}  // namespace
