// runtime/datagraph/end_at_exit.h -- threads of our own and the end of the process. Not part of the public interface.
#pragma once

#include <functional>

namespace shale {

/// A program may call exit() while our threads call Vulkan, and what the loader and drivers keep in statics goes then.
class EndAtExit {
 public:
  /// `end` stops the threads and waits for them. Called when the object goes and at exit(), by one thread at a time; the second
  /// call finds nothing to do.
  explicit EndAtExit(std::function<void()> end);
  ~EndAtExit();
  EndAtExit(const EndAtExit&) = delete;
  EndAtExit& operator=(const EndAtExit&) = delete;
};

}  // namespace shale
