// runtime/datagraph/driver_code.h -- code of a driver that compiles late. Not part of the public interface.
//
// Mesa's lavapipe compiles a shader at its first dispatch, on the one thread of a device's queue: a frame would wait for
// it. But it keeps the code in a cache on disk, by what the shader is and what is bound. So the shader is dispatched once on
// a device of our own, off the host's way, and the host's device finds the code in that cache.
#pragma once

#include <atomic>
#include <memory>
#include <span>
#include <thread>
#include <vector>

#include "ir/package/package.h"
#include "runtime/datagraph/end_at_exit.h"
#include "runtime/vk/device.h"

namespace shale {

/// A dispatch of a kGraph segment, and its module.
struct DriverWork {
  const Segment* segment = nullptr;
  const Dispatch* dispatch = nullptr;
  const Spirv* words = nullptr;
};

class DriverCode {
 public:
  /// Modules of fewer words are compiled in some 100 ms, as long as the way around takes.
  static constexpr size_t kShortWords = 20000;

  /// For the driver of `context`; null where it compiles when a pipeline is made, keeps no cache, or cannot be opened once
  /// more.
  static std::unique_ptr<DriverCode> open(const vk::Context& context);
  ~DriverCode();

  /// Dispatches one workgroup, on `weight_bytes` of zeros as weights. A help, not a result:
  /// what fails here fails again where it counts.
  void compile(const Variant& variant, const DriverWork& work, uint64_t weight_bytes) const;

 private:
  struct State;
  explicit DriverCode(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

/// compile() for all, on so many threads; nothing for a driver that needs no DriverCode.
void compile_ahead(const vk::Context& context, const Variant& variant,
                   std::span<const DriverWork> works, uint64_t weight_bytes, uint32_t threads);

/// compile() for what comes last in the first run, while the host's device compiles what comes first.
class CodeAhead {
 public:
  /// `works` in the order of the run, so many `helpers` beside the host's device: each gets an equal part of the words.
  /// `variant` must outlive the object, the words need not.
  CodeAhead(const vk::Context& context, const Variant& variant, std::span<const DriverWork> works,
            uint64_t weight_bytes, uint32_t helpers);
  /// Waits for what is being compiled, and for nothing else.
  ~CodeAhead();

 private:
  void end();

  std::vector<Spirv> words_;
  std::vector<DriverWork> works_;
  std::atomic<size_t> next_ = 0;
  std::atomic<bool> stop_ = false;
  std::vector<std::thread> threads_;
  EndAtExit end_at_exit_;  // goes first
};

}  // namespace shale
