// ir/base/parallel.h -- independent work on all cores.
#pragma once

#include <algorithm>
#include <atomic>
#include <functional>
#include <thread>
#include <vector>

namespace shale {

/// Calls work(0) .. work(count - 1), each once, on as many threads as there are cores; the caller's is
/// one of them. `proceed` is asked on the caller's thread with the number of those done so far, and
/// stops what has not begun by answering false; the answer is then false.
inline bool parallel_for(size_t count, const std::function<void(size_t)>& work,
                         const std::function<bool(size_t)>& proceed = {}) {
  std::atomic<size_t> next = 0, done = 0;
  std::atomic<bool> stopped = false;
  const auto run = [&](bool is_caller) {
    for (size_t i = next++; i < count && !stopped; i = next++) {
      work(i);
      ++done;
      if (is_caller && proceed && !proceed(done)) stopped = true;
    }
  };
  std::vector<std::jthread> threads;
  const size_t cores = std::max(1u, std::thread::hardware_concurrency());
  for (size_t i = 1; i < std::min(cores, count); ++i) threads.emplace_back(run, false);
  run(true);
  threads.clear();
  return !stopped && (!proceed || count == 0 || proceed(count));
}

}  // namespace shale
