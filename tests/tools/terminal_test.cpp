#include "tools/shale/terminal.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "ir/base/file.h"
#include "tests/support/folder_test.h"

namespace shale {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

class TerminalTest : public FolderTest {
 protected:
  /// Starts the program; the signal goes to it after `delay`. Its exit code, and how long it took from
  /// the signal.
  struct End {
    int code;
    double seconds;
    std::string errors;
  };
  End interrupt(const std::vector<std::string>& arguments, int signal, double delay) const {
    const pid_t child = fork();
    if (child == 0) {
      const int out = open("/dev/null", O_WRONLY);
      const int err = open(path("errors").c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
      dup2(out, 1);
      dup2(err, 2);
      std::vector<char*> argv{const_cast<char*>(SHALE_PROGRAM)};
      for (const std::string& argument : arguments)
        argv.push_back(const_cast<char*>(argument.c_str()));
      argv.push_back(nullptr);
      execv(SHALE_PROGRAM, argv.data());
      _exit(99);
    }
    std::this_thread::sleep_for(std::chrono::duration<double>(delay));
    const Clock::time_point begin = Clock::now();
    EXPECT_EQ(kill(child, signal), 0);
    int status = 0;
    EXPECT_EQ(waitpid(child, &status, 0), child);
    const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
    const Result<std::string> errors = read_text(path("errors"));
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), seconds,
            errors ? *errors : errors.error().text()};
  }
};

const std::string kSmall = SHALE_SOURCE_DIR "/tests/tools/small.tir";

TEST_F(TerminalTest, NamesStayOnOneLine) {
  EXPECT_EQ(one_line("plain \"text\" äö"), "plain \"text\" äö");
  EXPECT_EQ(one_line("a\nb\x1b[31m\x7f"), "a\\nb\\x1b[31m\\x7f");
}

TEST_F(TerminalTest, FilesStandBeforeWhatIsInThem) {
  const auto text = [](Error error) { return error.file + "|" + error.where; };
  EXPECT_EQ(text(in_file("f", bad_input("node", "x"))), "f|node");
  EXPECT_EQ(text(in_file("f", bad_input("f", "x"))), "f|");
  EXPECT_EQ(text(in_file("g", in_file("f", bad_input("node", "x")))), "g|f: node");
  EXPECT_EQ(in_file("f", bad_input("node", "x")).text(), "f: node: x");
}

TEST_F(TerminalTest, ErrorsAreOneLineWithTheFileFirst) {
  write("bad\n.tir", "graph main {");
  EXPECT_EQ(
      shell(fmt::format("{} verify '{}' 2> {}", SHALE_PROGRAM, path("bad\n.tir"), path("errors"))),
      1);
  const std::string errors = *read_text(path("errors"));
  EXPECT_TRUE(errors.starts_with(path("bad\\n.tir") + ": error: ")) << errors;
  EXPECT_EQ(std::ranges::count(errors, '\n'), 1) << errors;
  EXPECT_EQ(shell(fmt::format("{} verify --no-such-option 2> {}", SHALE_PROGRAM, path("errors"))),
            2);
  EXPECT_TRUE(read_text(path("errors"))->starts_with("shale verify: error: "))
      << *read_text(path("errors"));
}

TEST_F(TerminalTest, AFullDiskOrClosedPipeIsAnErrorLine) {
  std::string big = "graph main {\n  input %x : i8[8]\n";
  for (int i = 0; i < 4000; ++i) big += fmt::format("  const %k{} : i8[2] = [{},1]\n", i, i % 100);
  big += "  return %x";
  for (int i = 0; i < 4000; ++i) big += fmt::format(", %k{}", i);
  write("big.tir", big + "\n}\n");
  const auto code = [&](const std::string& arguments, const std::string& rest) {
    return shell(fmt::format("{} {} {} 2> {}", SHALE_PROGRAM, arguments, rest, path("errors")));
  };
  for (const std::string& arguments :
       {"verify " + kSmall, "report " + kSmall, "report --json " + kSmall,
        "dump " + path("big.tir"), std::string("--help"), std::string("run --help"),
        std::string("--version")})
    for (const char* to : {"> /dev/full", ">&-"}) {
      EXPECT_EQ(code(arguments, to), 1) << arguments << to;
      const std::string errors = *read_text(path("errors"));
      EXPECT_TRUE(errors.starts_with("standard output: error: cannot write: ")) << errors;
      EXPECT_EQ(std::ranges::count(errors, '\n'), 1) << errors;
    }
  // The same by its name.
  EXPECT_EQ(code("dump " + kSmall + " -o /dev/stdout", ">&-"), 1);
  EXPECT_TRUE(read_text(path("errors"))->starts_with("/dev/stdout: error: cannot write: "))
      << *read_text(path("errors"));
  // A reader that goes away.
  EXPECT_EQ(
      shell(fmt::format("bash -c '(trap \"\" EXIT; {} dump {} 2> {}; echo $? > {}) | head -1 > "
                        "/dev/null'",
                        SHALE_PROGRAM, path("big.tir"), path("errors"), path("code"))),
      0);
  EXPECT_EQ(*read_text(path("code")), "1\n");
  EXPECT_EQ(*read_text(path("errors")), "standard output: error: cannot write: Broken pipe\n");
  // Where even the message cannot be written.
  EXPECT_EQ(shell(fmt::format("{} verify {} 2> /dev/full", SHALE_PROGRAM, path("absent"))), 1);
  EXPECT_EQ(shell(fmt::format("{} verify {} 2>&-", SHALE_PROGRAM, path("absent"))), 1);
}

TEST_F(TerminalTest, ADescriptorThatIsClosedIsNotTheResultsFile) {
  EXPECT_EQ(shell(fmt::format("{} dump {} -o {} >&- 2>&- <&-", SHALE_PROGRAM, kSmall, path("out"))),
            0);
  EXPECT_TRUE(read_text(path("out"))->starts_with("graph "));
}

TEST_F(TerminalTest, SignalsEndWorkThatCannotBeStopped) {
  // Each dispatch takes a second and more, by the slowest kernel.
  write("slow.tir",
        "graph main {\n  input %a : i8[1,1024,1024]\n  input %b : i8[1,1024,1024]\n"
        "  const %z : i8[1] = [1]\n  %y = matmul %a, %b, %z, %z : i32[1,1024,1024]\n"
        "  return %y\n}\n");
  for (const int signal : {SIGINT, SIGTERM}) {
    const End end = interrupt({"run", path("slow.tir"), "--kernels", "generic", "--random", "1",
                               "--repeat", "50", "-o", path("results")},
                              signal, 3);
    EXPECT_EQ(end.code, kInterrupted) << end.errors;
    EXPECT_LT(end.seconds, 2.5) << end.errors;
    EXPECT_NE(end.errors.find("interrupted"), std::string::npos) << end.errors;
    EXPECT_FALSE(fs::exists(path("results/y.npy")));
  }
}

TEST_F(TerminalTest, SignalsEndWaitingForAFile) {
  ASSERT_EQ(mkfifo(path("fifo").c_str(), 0600), 0);
  const End reading = interrupt({"verify", path("fifo")}, SIGINT, 0.5);
  EXPECT_EQ(reading.code, kInterrupted);
  EXPECT_LT(reading.seconds, 2.5);
  const End writing = interrupt({"dump", kSmall, "-o", path("fifo")}, SIGTERM, 0.5);
  EXPECT_EQ(writing.code, kInterrupted);
  EXPECT_LT(writing.seconds, 2.5);
}

}  // namespace
}  // namespace shale
