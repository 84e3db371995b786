// tools/eval/parallel.h -- rows of a picture over the cores.
#pragma once

#include <algorithm>
#include <cstdint>
#include <thread>
#include <vector>

namespace shale {

/// Calls work(begin, end) on strips that cover [0, rows), at most one a thread, and waits.
/// `threads` 0: as many as the machine has, 8 at most. A strip has 32 rows or more, so that small
/// pictures start no threads. What `work` writes must not depend on where the strips begin.
template <typename Work>
void parallel_rows(uint32_t rows, uint32_t threads, const Work& work) {
  constexpr uint32_t kMaxThreads = 8, kMinRows = 32;
  if (threads == 0) threads = std::clamp(std::thread::hardware_concurrency(), 1u, kMaxThreads);
  threads = std::clamp(rows / kMinRows, 1u, threads);
  const auto begin = [&](uint32_t strip) {
    return static_cast<uint32_t>(uint64_t{rows} * strip / threads);
  };
  std::vector<std::jthread> others;
  for (uint32_t strip = 1; strip < threads; ++strip)
    others.emplace_back([&, strip] { work(begin(strip), begin(strip + 1)); });
  work(0, begin(1));
}

}  // namespace shale
