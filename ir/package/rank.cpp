#include "ir/package/rank.h"

#include <algorithm>
#include <array>
#include <tuple>

namespace shale {
namespace {

/// Variant classes by device class, the best first. On lavapipe NSS v1 HIGH by dot products takes some
/// 30 times as long as by its own kernels (2.0 s to 60 ms); the order of the classes behind those is
/// assumed. A GPU without dot products meets no variant that has them.
constexpr std::array<std::array<DeviceClass, kDeviceClassCount>, kDeviceClassCount> kOrders{{
    {DeviceClass::kAny, DeviceClass::kDot8Gpu, DeviceClass::kMatrixGpu, DeviceClass::kCpu},
    {DeviceClass::kCpu, DeviceClass::kDot8Gpu, DeviceClass::kMatrixGpu, DeviceClass::kAny},
    {DeviceClass::kDot8Gpu, DeviceClass::kMatrixGpu, DeviceClass::kAny, DeviceClass::kCpu},
    {DeviceClass::kMatrixGpu, DeviceClass::kDot8Gpu, DeviceClass::kAny, DeviceClass::kCpu},
}};

size_t place(DeviceClass device, DeviceClass variant) {
  const auto& order = kOrders[static_cast<size_t>(device)];
  return static_cast<size_t>(std::find(order.begin(), order.end(), variant) - order.begin());
}

double predicted_us(const Variant& variant) {
  double time_us = 0;
  for (const Segment& segment : variant.segments)
    for (const Dispatch& dispatch : segment.dispatches) time_us += dispatch.cost.time_us;
  return time_us;
}

}  // namespace

DeviceClass device_class(const DeviceCaps& caps) {
  if (caps.cpu) return DeviceClass::kCpu;
  if (!caps.features.has(Feature::kDotProduct8)) return DeviceClass::kAny;
  return caps.features.has(Feature::kCooperativeMatrix) ? DeviceClass::kMatrixGpu
                                                        : DeviceClass::kDot8Gpu;
}

std::vector<RankedVariant> rank_variants(std::span<const Variant> variants,
                                         const DeviceCaps& caps) {
  std::vector<RankedVariant> ranked;
  for (uint32_t i = 0; i < variants.size(); ++i)
    ranked.push_back({i, predicted_us(variants[i]), missing(caps, variants[i].requirements)});
  const DeviceClass device = device_class(caps);
  const auto key = [&](const RankedVariant& each) {
    return std::tuple(!each.missing.empty(), place(device, variants[each.index].device_class),
                      each.time_us);
  };
  std::stable_sort(ranked.begin(), ranked.end(),
                   [&](const RankedVariant& a, const RankedVariant& b) { return key(a) < key(b); });
  return ranked;
}

}  // namespace shale
