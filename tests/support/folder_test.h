// tests/support/folder_test.h -- tests of the program in a folder of their own.
#pragma once

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

namespace shale {

/// An empty folder for each test, which goes with it.
class FolderTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::path(testing::TempDir()) /
              fmt::format("shale_{}_{}", test->test_suite_name(), test->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  void write(const std::string& name, const std::string& text) const {
    std::ofstream(path(name)) << text;
  }
  /// Exit code of a command line of the shell; 128 and more is a signal.
  static int shell(const std::string& command) {
    const int status = std::system(command.c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  /// Runs the program in the folder; what it says goes to the file "said".
  int shale(const std::string& arguments) const {
    return shell(
        fmt::format("cd {} && {} {} > said 2>&1", folder_.string(), SHALE_PROGRAM, arguments));
  }

  std::filesystem::path folder_;
};

}  // namespace shale
