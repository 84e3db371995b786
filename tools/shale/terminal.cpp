#include "tools/shale/terminal.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <mutex>
#include <thread>
#include <vector>

#include "ir/base/file.h"

namespace shale {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kPatience{500};  ///< after the first signal
constexpr auto kTick = std::chrono::seconds(1);
constexpr auto kLineEvery = std::chrono::seconds(10);  ///< where it stays in a log

std::atomic<bool> interrupt_seen{false};

/// A Progress on the stack of those at work.
struct Activity {
  const Progress* owner;
  std::string label;
  size_t done = 0, total = 0;
  Clock::time_point begin = Clock::now(), told = begin;

  std::string text() const {
    std::string text = label;
    if (total > 0)
      text += fmt::format(" {}/{}", done, total);
    else if (done > 0)
      text += fmt::format(" {}", done);
    const auto seconds =
        std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - begin).count();
    return seconds > 0 ? text + fmt::format(", {} s", seconds) : text;
  }
};

/// Never destroyed: the watching thread outlives main().
struct Board {
  std::mutex mutex;
  std::vector<Activity> activities;
  bool is_terminal = isatty(STDERR_FILENO) != 0;
  bool shown = false;  ///< on the terminal's last line

  void show() {
    const std::string text = fmt::format("\r{}\x1b[K", one_line(activities.back().text()));
    std::fputs(text.c_str(), stderr);
    std::fflush(stderr);
    shown = true;
  }
  void erase() {
    if (shown) std::fputs("\r\x1b[K", stderr);
    shown = false;
  }
};

Board& board() {
  static auto* const the_board = new Board;
  return *the_board;
}

/// Above the line of the progress, which is shown again at its next step.
void print_line(const std::string& text) {
  std::lock_guard lock(board().mutex);
  board().erase();
  std::fputs((text + "\n").c_str(), stderr);
  std::fflush(stderr);
}

void tick() {
  std::lock_guard lock(board().mutex);
  if (board().activities.empty()) return;
  Activity& now = board().activities.back();
  if (board().is_terminal) {
    board().show();
  } else if (Clock::now() - now.told >= kLineEvery) {
    now.told = Clock::now();
    std::fputs((one_line(now.text()) + "\n").c_str(), stderr);
  }
}

[[noreturn]] void end_at_once() {
  std::string what;
  {
    std::lock_guard lock(board().mutex);
    if (!board().activities.empty()) what = " while " + board().activities.back().text();
  }
  print_line("shale: error: interrupted" + one_line(what));
  remove_unfinished_files();
  _exit(kInterrupted);
}

void watch(const sigset_t& signals) {
  const timespec second{1, 0};
  std::optional<Clock::time_point> first;
  for (;;) {
    const milliseconds left =
        first ? kPatience - std::chrono::duration_cast<milliseconds>(Clock::now() - *first)
              : milliseconds(0);
    if (first && left.count() <= 0) end_at_once();
    const timespec rest{left.count() / 1000, left.count() % 1000 * 1000000};
    const int number = sigtimedwait(&signals, nullptr, first ? &rest : &second);
    if (number < 0) {
      if (!first) tick();
      continue;
    }
    if (first) end_at_once();
    interrupt_seen = true;
    first = Clock::now();
  }
}

}  // namespace

void prepare_process() {
  for (const int number : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(number, F_GETFD) != -1) continue;
    // The lowest free number is this one, and its use has to be an error, also by its name below /dev: for
    // input a file open in the wrong direction, for output a pipe that nobody reads.
    int ends[2];
    if (number == STDIN_FILENO) {
      (void)!open("/dev/null", O_WRONLY);
    } else if (pipe(ends) == 0) {
      dup2(ends[1], number);
      if (ends[1] != number) close(ends[1]);
    }
  }
  signal(SIGPIPE, SIG_IGN);
  board();
  static sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  struct sigaction hangup = {};
  if (sigaction(SIGHUP, nullptr, &hangup) == 0 && hangup.sa_handler != SIG_IGN)
    sigaddset(&signals, SIGHUP);  // not under nohup
  // All threads that are made from here on inherit the mask; one waits for what it holds back.
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  std::thread([] { watch(signals); }).detach();
}

bool interrupted() { return interrupt_seen; }

std::string one_line(std::string_view text) {
  std::string line;
  for (const char c : text) {
    const auto code = static_cast<unsigned char>(c);
    if (c == '\n')
      line += "\\n";
    else if (code < 0x20 || code == 0x7f)
      line += fmt::format("\\x{:02x}", code);
    else
      line += c;
  }
  return line;
}

void print_error(const Error& error) {
  std::string head = error.file, text = error.message;
  if (head.empty())
    head = error.where;
  else if (!error.where.empty())
    text = error.where + ": " + text;
  print_line(one_line(fmt::format("{}: error: {}", head.empty() ? "shale" : head, text)));
}

void print_warning(const std::string& where, const std::string& message) {
  print_line(one_line(fmt::format("{}: warning: {}", where, message)));
}

Error in_file(const std::string& file, Error error) {
  if (error.file == file) return error;
  if (!error.file.empty())
    error.where = error.where.empty() ? error.file : error.file + ": " + error.where;
  else if (error.where == file)
    error.where.clear();
  error.file = file;
  return error;
}

Progress::Progress(std::string label) {
  std::lock_guard lock(board().mutex);
  board().activities.push_back({this, std::move(label)});
}

Progress::~Progress() {
  std::lock_guard lock(board().mutex);
  std::erase_if(board().activities,
                [this](const Activity& activity) { return activity.owner == this; });
  board().erase();
}

bool Progress::step(size_t done, size_t total) {
  std::lock_guard lock(board().mutex);
  for (Activity& activity : board().activities) {
    if (activity.owner != this) continue;
    activity.done = done;
    activity.total = total;
  }
  if (board().is_terminal) board().show();
  return !interrupted();
}

}  // namespace shale
