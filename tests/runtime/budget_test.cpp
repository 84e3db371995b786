// Which sandwich a frame takes, under loads as they are recorded: whether the budget holds, how often the choice
// changes, and whether it is the best one when there is time for it.
#include "runtime/frame/budget.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

namespace shale {
namespace {

// NSS v1 HIGH, LOW and a sandwich without a network, modelled for a phone.
const std::vector<double> kCosts{5.2, 3.2, 2.0};
constexpr double kFrameSeconds = 1 / 60.0;

struct Played {
  std::vector<size_t> choices;
  double within = 0;         ///< share of the frames
  size_t most_switches = 0;  ///< in any ten seconds
};

/// A minute under a load of the seconds since the start.
Played played(double budget_ms, const std::function<double(double)>& load, double seconds = 60) {
  FrameBudget budget = *FrameBudget::create(kCosts, {.budget_ms = budget_ms});
  Played result;
  std::vector<size_t> changes;
  const auto frames = static_cast<size_t>(seconds / kFrameSeconds);
  for (size_t i = 0; i < frames; ++i) {
    const size_t choice = budget.choice();
    if (i > 0 && choice != result.choices.back()) changes.push_back(i);
    result.choices.push_back(choice);
    const double ms = kCosts[choice] * load(static_cast<double>(i) * kFrameSeconds);
    result.within += ms <= budget_ms ? 1 : 0;
    budget.add(ms);
  }
  result.within /= static_cast<double>(frames);
  for (const size_t from : changes)
    result.most_switches = std::max<size_t>(
        result.most_switches, std::count_if(changes.begin(), changes.end(), [&](size_t at) {
          return at >= from && at < from + static_cast<size_t>(10 / kFrameSeconds);
        }));
  return result;
}

double share_of(const Played& run, size_t choice) {
  return static_cast<double>(std::count(run.choices.begin(), run.choices.end(), choice)) /
         static_cast<double>(run.choices.size());
}

class Swinging : public testing::TestWithParam<std::tuple<double, bool, double>> {};

TEST_P(Swinging, HoldsTheBudgetWithFewSwitches) {
  const auto [period, steps, noise] = GetParam();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-noise, noise);
  const Played found = played(6.5, [&, period = period, steps = steps](double t) {
    const double wave = std::sin(2 * std::numbers::pi * t / period);
    return (1.5 + 0.5 * (steps ? (wave > 0 ? 1 : -1) : wave)) * (1 + uniform(random));
  });
  EXPECT_GE(found.within, 0.95);
  EXPECT_LE(found.most_switches, 4u);
}

// By seconds of the load's swing from 1 to 2 and back, steps or waves, and noise.
INSTANTIATE_TEST_SUITE_P(Loads, Swinging,
                         testing::Combine(testing::Values(0.2, 0.7, 2.0, 5.0, 9.0, 20.0),
                                          testing::Bool(), testing::Values(0.0, 0.03)));

TEST(FrameBudget, TakesTheBestUnderASteadyLoad) {
  EXPECT_EQ(share_of(played(6.5, [](double) { return 1.0; }), 0), 1);
  // HIGH takes 7.3 ms, LOW 4.5: after two frames there is no doubt.
  const Played low = played(6.5, [](double) { return 1.4; });
  EXPECT_GT(share_of(low, 1), 0.99);
  EXPECT_EQ(low.most_switches, 1u);
}

TEST(FrameBudget, GoesStraightToWhatFitsAndComesBackWhenTheLoadIsGone) {
  const Played found = played(6.5, [](double t) { return t >= 10 && t < 20 ? 3.0 : 1.0; });
  const auto at = [&](double t) { return found.choices[static_cast<size_t>(t / kFrameSeconds)]; };
  EXPECT_EQ(at(9.9), 0u);
  EXPECT_EQ(at(10.1), 2u);
  EXPECT_EQ(at(19.9), 2u);
  EXPECT_EQ(at(24), 0u);
  EXPECT_EQ(found.most_switches, 1u);  // they are eleven seconds apart
}

TEST(FrameBudget, OneSlowFrameChangesNothing) {
  const Played found = played(6.5, [](double t) {
    return std::fmod(t + kFrameSeconds / 2, 2) < kFrameSeconds ? 4.0 : 1.0;
  });
  EXPECT_EQ(share_of(found, 0), 1);
}

TEST(FrameBudget, TakesTheCheapestWhereNothingFits) {
  EXPECT_GT(share_of(played(1, [](double) { return 1.0; }), 2), 0.99);
}

TEST(FrameBudget, RefusesWhatMakesNoSense) {
  const auto refused = [](std::vector<double> costs, BudgetOptions options) {
    const Result<FrameBudget> budget = FrameBudget::create(costs, options);
    return budget ? std::string() : budget.error().text();
  };
  EXPECT_EQ(refused({2, 1}, {.budget_ms = 4}), "");
  EXPECT_NE(refused({}, {.budget_ms = 4}).find("there is none"), std::string::npos);
  EXPECT_NE(refused({1, 2}, {.budget_ms = 4}).find("index 1 is 2 ms"), std::string::npos);
  EXPECT_NE(refused({1, 0}, {.budget_ms = 4}).find("index 1 is 0 ms"), std::string::npos);
  EXPECT_NE(refused({1}, {}).find("budget"), std::string::npos);
  EXPECT_NE(refused({1}, {.budget_ms = NAN}).find("budget"), std::string::npos);
  EXPECT_NE(refused({1}, {.budget_ms = 4, .frame_seconds = 0}).find("frame"), std::string::npos);
  EXPECT_NE(refused({1}, {.budget_ms = 4, .margin = 1}).find("margin"), std::string::npos);
  EXPECT_NE(refused({1}, {.budget_ms = 4, .most_switches = 1}).find("switches"), std::string::npos);
}

}  // namespace
}  // namespace shale
