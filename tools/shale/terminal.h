// tools/shale/terminal.h -- what the program says beside its results, and how it is interrupted.
#pragma once

#include <string>
#include <string_view>

#include "ir/base/result.h"

namespace shale {

/// The exit code of a command that was interrupted, whatever it had done by then.
inline constexpr int kInterrupted = 130;

/// First thing in the process, before there are threads: from here on SIGINT, SIGTERM and SIGHUP ask
/// the command to stop (see interrupted()). One that does not within half a second, since it waits for a
/// driver or for a file, is ended with kInterrupted, and what it waits for is said; so is one that is
/// asked again. Also a closed pipe becomes an error of the write, and descriptors 0 to 2
/// exist, so that no file gets their numbers.
void prepare_process();

/// True once the user has pressed Ctrl-C; long work asks it and stops.
bool interrupted();

/// `text` on one line: control characters as \n, \x1b. For names and messages that come from files.
std::string one_line(std::string_view text);

/// "FILE: error: WHERE: MESSAGE" on standard error, one line. That cannot fail.
void print_error(const Error& error);
/// "WHERE: warning: MESSAGE", likewise.
void print_warning(const std::string& where, const std::string& message);

/// Puts `file` in front of an error's location.
Error in_file(const std::string& file, Error error);

/// Tells what goes on: on a terminal label, done/total and seconds on a line that erases itself at the
/// end, elsewhere a line every ten seconds. The one that was made last is shown.
class Progress {
 public:
  explicit Progress(std::string label);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  /// Returns false if the user interrupted. A `total` of 0 is not known.
  bool step(size_t done, size_t total);
};

}  // namespace shale
