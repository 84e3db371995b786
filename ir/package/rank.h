// ir/package/rank.h -- which variant of a package a device takes: a pure function of plain data.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "ir/package/package.h"

namespace shale {

/// What a device is, by what it has: a CPU driver, by its processor's vectors; else a GPU with int8 matrices, with int8 dot
/// products alone, or neither (kAny).
DeviceClass device_class(const DeviceCaps& caps);

struct RankedVariant {
  uint32_t index = 0;  ///< into the variants
  double time_us = 0;  ///< predicted, of all dispatches
  /// What the device lacks; empty if it can take the variant.
  std::vector<std::string> missing;
};

/// All variants, the best first: those that the device meets before others; among them by the
/// variant's class, of which each class of devices has an order of its own; then by predicted time;
/// then as they stand. GPUs take a variant for CPUs, and CPUs one for GPUs, only where no other
/// will do.
std::vector<RankedVariant> rank_variants(std::span<const Variant> variants, const DeviceCaps& caps);

}  // namespace shale
