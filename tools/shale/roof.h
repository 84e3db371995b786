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
/// from texel buffers of 16 bytes a texel, and reads and writes of storage buffers. A rate of arithmetic
/// is the best of several shapes of code, in registers only.
/// Errors: kDevice.
Result<std::vector<Roof>> measure_roofs(const ToolDevice& device, uint32_t repeat);

/// The rate that shares of a roof refer to, float32 multiply and add, alone: to be measured just before
/// and after a kernel, since a processor's speed changes with what it did in the last minute.
/// Errors: kDevice.
Result<double> measure_mul_add_roof(const ToolDevice& device, uint32_t repeat);

}  // namespace shale
