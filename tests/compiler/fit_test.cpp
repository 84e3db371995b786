#include "compiler/cost/fit.h"

#include <gtest/gtest.h>

#include <random>

namespace shale {
namespace {

TEST(Fit, FindsTheConstantsThatMadeTheTimes) {
  WorkTable truth{};
  truth[Work::kDispatch] = 50000;
  truth[Work::kFloatProduct] = 0.015;
  truth[Work::kFetch] = 0.6;
  truth[Work::kResult] = 0.1;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> exponent(5, 9);
  std::vector<MeasuredWork> rows;
  for (int i = 0; i < 40; ++i) {
    MeasuredWork row;
    row.amounts[Work::kDispatch] = 1;
    for (const Work work : {Work::kFloatProduct, Work::kFetch, Work::kResult})
      row.amounts[work] = std::pow(10.0, exponent(random));
    row.time_us = work_time_us(row.amounts, truth);
    rows.push_back(row);
  }
  WorkTable start{};
  start[Work::kByte] = 0.2;
  start[Work::kGenericMac] = 2;
  const WorkTable found = fit_constants(rows, start);
  for (size_t i = 0; i < kWorkCount; ++i) {
    const Work work = static_cast<Work>(i);
    if (work == Work::kByte || work == Work::kGenericMac) continue;
    EXPECT_NEAR(found[work], truth[work], 1e-6 * truth[work]) << work_info(work).name;
  }
  EXPECT_EQ(found[Work::kByte], 0.2) << "the other terms hide it";
  EXPECT_EQ(found[Work::kGenericMac], 2) << "no row has it";
}

TEST(Fit, KeepsConstantsFromFallingBelowZero) {
  // Of two rows the one with more fetches takes less time: no constant of fetches explains that.
  MeasuredWork a, b;
  a.amounts[Work::kFloatProduct] = b.amounts[Work::kFloatProduct] = 1e6;
  a.amounts[Work::kFetch] = 1e5;
  b.amounts[Work::kFetch] = 9e5;
  a.time_us = 1200;
  b.time_us = 1000;
  const WorkTable found = fit_constants(std::vector{a, b}, {});
  EXPECT_EQ(found[Work::kFetch], 0);
  // Least (p - 1.2)^2 / 1.2 + (p - 1)^2 / 1 for p milliseconds.
  EXPECT_NEAR(found[Work::kFloatProduct], 2 / (1 / 1.2 + 1), 1e-9);
}

TEST(WorkTime, IsTheLongerOfMemoryAndTheRestAndTheDispatch) {
  WorkTable ns{}, amounts{};
  ns[Work::kDispatch] = 1000;
  ns[Work::kDotMac] = 0.5;
  ns[Work::kByte] = 2;
  amounts[Work::kDispatch] = 1;
  amounts[Work::kDotMac] = 4000;
  amounts[Work::kByte] = 500;
  EXPECT_DOUBLE_EQ(work_time_us(amounts, ns), 2 + 1);
  amounts[Work::kByte] = 5000;
  EXPECT_DOUBLE_EQ(work_time_us(amounts, ns), 10 + 1);
}

}  // namespace
}  // namespace shale
