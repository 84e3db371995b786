// runtime/frame/budget.h -- which of several sandwiches the next frame takes, so that frames hold a time.
#pragma once

#include <cstddef>
#include <deque>
#include <span>
#include <vector>

#include "ir/base/result.h"

namespace shale {

struct BudgetOptions {
  double budget_ms = 0;             ///< above 0
  double frame_seconds = 1 / 60.0;  ///< from frame to frame, above 0
  double margin = 0.1;         ///< share of the budget that a better choice has to leave, [0, 1)
  uint32_t most_switches = 4;  ///< in any ten seconds, 2 or more; a better choice waits for them
};

/// Choices are ordered from the best, which cost most, to the cheapest. What all of them take grows and shrinks with the
/// load: other work, heat, clocks. So the time of the choice at hand says what the others would take. Two frames
/// beyond the budget are followed by the best choice that fits; a better one is taken when it would have fitted in
/// every frame of some time, which doubles when such a step had to be taken back and halves when it lasted.
/// Knows no device and no clock: times are told, so recorded ones give the same choices again.
class FrameBudget {
 public:
  /// `costs_ms`: what each choice takes under one and the same load.
  /// Errors: kBadInput without choices, for a cost that is not finite and above 0, for one above the cost before it, or
  /// for options out of range.
  static Result<FrameBudget> create(std::span<const double> costs_ms, const BudgetOptions& options);

  /// Of the next frame, an index.
  size_t choice() const { return choice_; }
  /// The time of a frame that the present choice made. A host that learns times some frames late tells none between a
  /// change of choice() and the first time of the new one.
  /// Precondition: finite and not negative.
  void add(double milliseconds);

 private:
  FrameBudget(std::span<const double> costs_ms, const BudgetOptions& options)
      : options_(options), costs_(costs_ms.begin(), costs_ms.end()) {}

  size_t frames(double seconds) const;
  /// The best choice that fits `budget_ms` under each of the newest `count` loads; the cheapest if none does.
  size_t fitting(size_t count, double budget_ms) const;
  void change(size_t choice);

  BudgetOptions options_;
  std::vector<double> costs_;
  size_t choice_ = 0;
  std::deque<double> loads_;       ///< of the newest frames, times over costs
  std::deque<uint64_t> switches_;  ///< frames of the changes in the last ten seconds
  uint64_t frame_ = 0, changed_ = 0;
  size_t beyond_ = 0;  ///< frames one after the other above the budget
  bool rose_ = false;  ///< by the last change
  double wait_seconds_;
};

}  // namespace shale
