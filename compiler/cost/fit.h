// compiler/cost/fit.h -- constants of the cost model from measured times.
#pragma once

#include <span>
#include <vector>

#include "compiler/target/profile.h"

namespace shale {

/// What one dispatch did and how long it took.
struct MeasuredWork {
  WorkTable amounts{};
  double time_us = 0;  ///< above 0
};

/// The constants, none below 0, of the least sum of (predicted - measured)^2 / measured: relative
/// errors, weighed by time. Kinds of work that no dispatch has keep the value in `start`, and so does
/// kByte, which the other terms hide. Deterministic.
/// Source: coordinate descent on the normal equations; the sum is convex.
WorkTable fit_constants(std::span<const MeasuredWork> measured, const WorkTable& start);

}  // namespace shale
