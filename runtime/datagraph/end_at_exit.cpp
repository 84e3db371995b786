#include "runtime/datagraph/end_at_exit.h"

#include <mutex>
#include <unordered_map>

namespace shale {
namespace {

struct Ends {
  std::mutex mutex;
  std::unordered_map<const EndAtExit*, std::function<void()>> all;
};

/// Never destroyed: objects may go after the process's end has begun.
Ends& ends() {
  static auto* all = new Ends;
  return *all;
}

/// A static's destructor, not std::atexit: that may be called after a layer of ours was unloaded.
struct AtExit {
  ~AtExit() {
    const std::lock_guard lock(ends().mutex);
    for (const auto& [object, end] : ends().all) end();
  }
};

}  // namespace

EndAtExit::EndAtExit(std::function<void()> end) {
  // Behind what a driver registers when it is loaded, and so called before that.
  static const AtExit at_exit;
  const std::lock_guard lock(ends().mutex);
  ends().all.emplace(this, std::move(end));
}

EndAtExit::~EndAtExit() {
  std::function<void()> end;
  {
    const std::lock_guard lock(ends().mutex);
    const auto own = ends().all.find(this);
    end = std::move(own->second);
    ends().all.erase(own);
  }
  end();
}

}  // namespace shale
