#include "runtime/frame/budget.h"

#include <algorithm>
#include <cmath>

namespace shale {
namespace {

constexpr double kSwitchSeconds = 10;  ///< in which there are at most so many switches
constexpr double kLeastWait = 1, kMostWait = 16, kRecent = 0.25;
constexpr size_t kPatience =
    2;  ///< frames above the budget that are not followed alone: one may be a hiccup

}  // namespace

Result<FrameBudget> FrameBudget::create(std::span<const double> costs_ms,
                                        const BudgetOptions& options) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0; };
  if (costs_ms.empty()) return bad_input("costs", "there is none");
  for (size_t i = 0; i < costs_ms.size(); ++i)
    if (!positive(costs_ms[i]) || (i > 0 && costs_ms[i] > costs_ms[i - 1]))
      return bad_input("costs",
                       "the one of index {} is {} ms, expected them above 0, the largest first", i,
                       costs_ms[i]);
  if (!positive(options.budget_ms))
    return bad_input("budget", "is {} ms, expected more than 0", options.budget_ms);
  if (!positive(options.frame_seconds) || options.frame_seconds > kSwitchSeconds)
    return bad_input("frame", "takes {} s, expected more than 0 and at most 10",
                     options.frame_seconds);
  if (!(options.margin >= 0 && options.margin < 1))
    return bad_input("margin", "is {}, expected 0 or more and less than 1", options.margin);
  if (options.most_switches < 2)
    return bad_input("switches", "may be {} in ten seconds, expected 2 or more",
                     options.most_switches);
  FrameBudget budget(costs_ms, options);
  budget.wait_seconds_ = kLeastWait;
  return budget;
}

size_t FrameBudget::frames(double seconds) const {
  return static_cast<size_t>(std::ceil(seconds / options_.frame_seconds));
}

size_t FrameBudget::fitting(size_t count, double budget_ms) const {
  const double load = *std::max_element(
      loads_.end() - static_cast<std::ptrdiff_t>(std::min(count, loads_.size())), loads_.end());
  for (size_t i = 0; i < costs_.size(); ++i)
    if (costs_[i] * load <= budget_ms) return i;
  return costs_.size() - 1;
}

void FrameBudget::change(size_t choice) {
  rose_ = choice < choice_;
  choice_ = choice;
  changed_ = frame_;
  beyond_ = 0;
  switches_.push_back(frame_);
}

void FrameBudget::add(double milliseconds) {
  ++frame_;
  loads_.push_back(milliseconds / costs_[choice_]);
  if (loads_.size() > frames(kMostWait)) loads_.pop_front();
  while (!switches_.empty() && switches_.front() + frames(kSwitchSeconds) <= frame_)
    switches_.pop_front();

  beyond_ = milliseconds > options_.budget_ms ? beyond_ + 1 : 0;
  const uint64_t since = frame_ - changed_;
  const double ample = options_.budget_ms * (1 - options_.margin);
  if (beyond_ >= kPatience && choice_ + 1 < costs_.size()) {
    if (rose_ && since < 4 * frames(wait_seconds_))
      wait_seconds_ = std::min(2 * wait_seconds_, kMostWait);
    // The last change that is left goes to where no other can be needed.
    const bool last = switches_.size() + 1 >= options_.most_switches;
    change(last ? costs_.size() - 1 : std::max(choice_ + 1, fitting(frames(kRecent), ample)));
    return;
  }
  if (rose_ && since == 4 * frames(wait_seconds_))
    wait_seconds_ = std::max(wait_seconds_ / 2, kLeastWait);
  if (choice_ == 0 || since < frames(wait_seconds_)) return;
  const size_t better = fitting(frames(wait_seconds_), ample);
  if (better >= choice_) return;
  // It may have to be taken back step by step, which has to be free.
  const size_t back = std::min<size_t>(costs_.size() - 1 - better, options_.most_switches - 1);
  if (switches_.size() + 1 + back <= options_.most_switches) change(better);
}

}  // namespace shale
