// tools/shale/roof.h -- the rates that a kernel can reach at best on the device at hand.
#pragma once

#include <string>
#include <vector>

#include "tools/shale/device_run.h"

namespace shale {

/// One measured rate.
struct Roof {
  std::string name;  ///< "f32 mul+add", ...
  double rate = 0;   ///< median, in `unit`
  std::string unit;  ///< "GOP/s" (two per multiply-accumulate) or "GB/s"
};

/// Measures, by device timestamps and as medians of `repeat` runs, float32 multiply and add (the roof
/// of float kernels), fma, int32 multiply and add, the int8 dot product where the device has it, fetches
/// from texel buffers of 16 bytes a texel, and reads and stores of storage buffers. A rate of arithmetic
/// is the best of several shapes of code, in registers only.
/// Errors: kDevice.
Result<std::vector<Roof>> measure_roofs(const ToolDevice& device, uint32_t repeat);

/// What a probe does over and over.
enum class RoofKind {
  kMulAdd,  ///< float32 multiply and add, which shares of a roof refer to
  kFetch,   ///< texels of 16 bytes
  kStore,   ///< four times 16 bytes an invocation to a storage buffer
};

/// A rate, ready to be measured between other things: a processor's speed changes with what it and its neighbours did in
/// the last minute.
class RoofProbe {
 public:
  /// Takes the fastest of several shapes of code. Errors: kDevice.
  static Result<RoofProbe> create(const ToolDevice& device, RoofKind kind = RoofKind::kMulAdd);
  /// GOP/s or GB/s now, of one run of some tens of milliseconds: shorter ones read too low. Errors: kDevice.
  Result<double> measure();
  double work() const { return work_; }  ///< operations or bytes of a run

 private:
  RoofProbe(NetworkRun run, double work) : run_(std::move(run)), work_(work) {}
  NetworkRun run_;
  double work_;
};

/// Medians of a network, its dispatches and the roof; the outputs are those of the last run.
struct RoofedTimes {
  std::vector<DispatchTime> times;
  double whole_us = 0;  ///< of runs without timestamps between dispatches
  double roof = 0;
  double roof_swing =
      1;  ///< the highest roof to the lowest; far above 1 if the machine does other work
  std::vector<Tensor> outputs;
};

/// Runs the package's graph `repeat` times twice, after one run that is not measured, and measures the roof
/// around each: the machine's speed moves with its clock and its neighbours, so every run's times are
/// taken to the median roof.
/// `repeat` is at least 1. Errors: as NetworkRun.
Result<RoofedTimes> measure_under_roof(const ToolDevice& device, const Package& package,
                                       const std::vector<Tensor>& inputs, uint32_t repeat);

}  // namespace shale
