#include "ir/base/file.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <thread>

namespace shale {
namespace {

namespace fs = std::filesystem;

class FileTest : public testing::Test {
 protected:
  void SetUp() override {
    folder_ =
        fs::path(testing::TempDir()) /
        fmt::format("shale_file_{}", testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  void TearDown() override {
    // Nothing that was on its way is left.
    for (const fs::directory_entry& entry : fs::directory_iterator(folder_))
      EXPECT_FALSE(entry.path().filename().string().starts_with(".shale-")) << entry.path();
    fs::remove_all(folder_);
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  static std::string text(const std::string& path) {
    const Result<std::string> read = read_text(path);
    return read ? *read : read.error().text();
  }
  static mode_t mode(const std::string& path) {
    struct stat info = {};
    EXPECT_EQ(lstat(path.c_str(), &info), 0);
    return info.st_mode;
  }

  fs::path folder_;
};

TEST_F(FileTest, NewFilesHaveTheUsersModeAndOldOnesKeepTheirs) {
  const mode_t before = umask(027);
  ASSERT_TRUE(write_text(path("new"), "1"));
  umask(before);
  EXPECT_EQ(mode(path("new")) & 0777, 0640u);
  ASSERT_EQ(chmod(path("new").c_str(), 0751), 0);
  ASSERT_TRUE(write_text(path("new"), "22"));
  EXPECT_EQ(mode(path("new")) & 0777, 0751u);
  EXPECT_EQ(text(path("new")), "22");
}

TEST_F(FileTest, AReaderOfTheOldFileKeepsIt) {
  ASSERT_TRUE(write_text(path("file"), "old"));
  const int reader = open(path("file").c_str(), O_RDONLY);
  ASSERT_TRUE(write_text(path("file"), "new text"));
  char buffer[16];
  EXPECT_EQ(read(reader, buffer, sizeof buffer), 3);
  close(reader);
}

TEST_F(FileTest, LinksStayAndLeadToTheNewContent) {
  ASSERT_TRUE(make_folder(path("a/b")));
  ASSERT_TRUE(write_text(path("a/b/real"), "old"));
  fs::create_symlink("b/real", path("a/relative"));
  fs::create_symlink(path("a/relative"), path("absolute"));
  fs::create_symlink("a/b/absent", path("dangling"));
  for (const char* link : {"a/relative", "absolute", "dangling"}) {
    ASSERT_TRUE(write_text(path(link), link));
    EXPECT_TRUE(S_ISLNK(mode(path(link)))) << link;
    EXPECT_EQ(text(path(link)), link);
  }
  EXPECT_EQ(text(path("a/b/real")), "absolute");
  EXPECT_EQ(text(path("a/b/absent")), "dangling");
  fs::create_symlink("loop2", path("loop1"));
  fs::create_symlink("loop1", path("loop2"));
  const Result<void> loop = write_text(path("loop1"), "x");
  ASSERT_FALSE(loop);
  EXPECT_EQ(loop.error().message, "cannot write: Too many levels of symbolic links");
}

TEST_F(FileTest, WhatIsNoRegularFileIsWrittenThrough) {
  ASSERT_EQ(mkfifo(path("fifo").c_str(), 0600), 0);
  std::string got;
  std::thread reader([&] { got = text(path("fifo")); });
  EXPECT_TRUE(write_text(path("fifo"), "through"));
  reader.join();
  EXPECT_EQ(got, "through");
  EXPECT_TRUE(S_ISFIFO(mode(path("fifo"))));
  EXPECT_TRUE(write_text("/dev/null", "gone"));
  EXPECT_TRUE(S_ISCHR(mode("/dev/null")));
  const Result<void> full = write_text("/dev/full", "x");
  ASSERT_FALSE(full);
  EXPECT_EQ(full.error().text(), "/dev/full: cannot write: No space left on device");
  // An open file by its number, not by its name.
  const int file = open(path("open").c_str(), O_RDWR | O_CREAT, 0600);
  EXPECT_TRUE(write_text(fmt::format("/dev/fd/{}", file), "by number"));
  struct stat named = {}, opened = {};
  ASSERT_EQ(stat(path("open").c_str(), &named), 0);
  ASSERT_EQ(fstat(file, &opened), 0);
  EXPECT_EQ(named.st_ino, opened.st_ino);
  EXPECT_EQ(text(path("open")), "by number");
  close(file);
}

TEST_F(FileTest, RefusesWhatCannotBeWritten) {
  EXPECT_EQ(write_text(folder_.string(), "x").error().message,
            "is a folder, expected a file to write");
  EXPECT_EQ(write_text(path("absent/x"), "x").error().message,
            "cannot create: No such file or directory");
  EXPECT_EQ(write_text(path("absent/"), "x").error().message,
            "is a folder, expected a file to write");
  EXPECT_EQ(write_text("", "x").error().message, "the path of the file to write is empty");
  EXPECT_EQ(write_text(path(std::string(300, 'x')), "x").error().message,
            "cannot write: File name too long");
  // As long as a name may be.
  EXPECT_TRUE(write_text(path(std::string(255, 'x')), "x"));
  ASSERT_TRUE(write_text(path("file"), "x"));
  EXPECT_FALSE(make_folder(path("file")));
  EXPECT_FALSE(make_folder(path("file/below")));
}

TEST_F(FileTest, AReadOnlyFileIsNotReplaced) {
  ASSERT_TRUE(write_text(path("file"), "old"));
  chmod(path("file").c_str(), 0444);
  chmod(folder_.c_str(), 0777);
  // Root may write anywhere, so another user tries.
  const pid_t child = fork();
  if (child == 0) {
    if (getuid() == 0 && setuid(65534) != 0) _exit(2);
    _exit(write_text(path("file"), "new") ? 1 : 0);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(WEXITSTATUS(status), 0);
  EXPECT_EQ(text(path("file")), "old");
}

TEST_F(FileTest, IdentityTellsWhichPathsAreOneFile) {
  const auto identity = [&](const std::string& name) {
    const Result<std::string> found = output_identity(path(name));
    return found ? *found : found.error().text();
  };
  ASSERT_TRUE(make_folder(path("sub")));
  EXPECT_EQ(identity("a"), identity("./a"));
  EXPECT_EQ(identity("a"), identity("sub/../a"));
  EXPECT_NE(identity("a"), identity("sub/a"));
  fs::create_symlink("a", path("link"));
  EXPECT_EQ(identity("a"), identity("link"));
  fs::create_directory_symlink(".", path("here"));
  EXPECT_EQ(identity("a"), identity("here/a"));
  EXPECT_EQ(*output_identity("/dev/null"), "");
}

TEST_F(FileTest, NamesBecomeSafe) {
  EXPECT_EQ(safe_file_name("up2/conv"), "up2_conv");
  EXPECT_EQ(safe_file_name("../../etc"), "_.._.._etc");
  EXPECT_EQ(safe_file_name(""), "_");
  EXPECT_EQ(safe_file_name("-rf"), "_-rf");
  EXPECT_EQ(safe_file_name(std::string("a\nb\0c\x1b", 6)), "a_b_c_");
  EXPECT_EQ(safe_file_name("say \"hi\" äö"), "say \"hi\" äö");
  const std::string long_a = safe_file_name(std::string(5000, 'x') + "a"),
                    long_b = safe_file_name(std::string(5000, 'x') + "b");
  EXPECT_LE(long_a.size(), 230u);
  EXPECT_NE(long_a, long_b);
}

}  // namespace
}  // namespace shale
