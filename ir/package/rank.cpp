#include "ir/package/rank.h"

#include <algorithm>
#include <tuple>

namespace shale {
namespace {

/// Variant classes by device class, the best first. On lavapipe NSS v1 HIGH by dot products takes some
/// 30 times as long as by its own kernels (2.0 s to 60 ms); the order of the classes behind those is
/// assumed. A GPU without dot products meets no variant that has them.
std::span<const DeviceClass> order_of(DeviceClass device) {
  using enum DeviceClass;
  static constexpr DeviceClass kOfAny[] = {kAny,     kDot8Gpu, kMatrixGpu, kCpuNeon,
                                           kCpuAvx2, kCpuSse,  kCpu};
  static constexpr DeviceClass kOfDot8[] = {kDot8Gpu, kMatrixGpu, kAny, kCpuNeon,
                                            kCpuAvx2, kCpuSse,    kCpu};
  static constexpr DeviceClass kOfMatrix[] = {kMatrixGpu, kDot8Gpu, kAny, kCpuNeon,
                                              kCpuAvx2,   kCpuSse,  kCpu};
  static constexpr DeviceClass kOfAvx512[] = {kCpu,     kCpuAvx2,   kCpuNeon, kCpuSse,
                                              kDot8Gpu, kMatrixGpu, kAny};
  static constexpr DeviceClass kOfAvx2[] = {kCpuAvx2, kCpuSse,    kCpuNeon, kCpu,
                                            kDot8Gpu, kMatrixGpu, kAny};
  static constexpr DeviceClass kOfSse[] = {kCpuSse,  kCpuAvx2,   kCpuNeon, kCpu,
                                           kDot8Gpu, kMatrixGpu, kAny};
  static constexpr DeviceClass kOfNeon[] = {kCpuNeon, kCpuAvx2,   kCpuSse, kCpu,
                                            kDot8Gpu, kMatrixGpu, kAny};
  switch (device) {
    case kAny: return kOfAny;
    case kCpu: return kOfAvx512;
    case kDot8Gpu: return kOfDot8;
    case kMatrixGpu: return kOfMatrix;
    case kCpuAvx2: return kOfAvx2;
    case kCpuSse: return kOfSse;
    case kCpuNeon: return kOfNeon;
  }
  check_failed("a device class that exists", __FILE__, __LINE__);
}

size_t place(DeviceClass device, DeviceClass variant) {
  const std::span<const DeviceClass> order = order_of(device);
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
  if (caps.cpu) switch (caps.processor) {
      case Processor::kUnknown:
      case Processor::kAvx512: return DeviceClass::kCpu;
      case Processor::kAvx2: return DeviceClass::kCpuAvx2;
      case Processor::kSse: return DeviceClass::kCpuSse;
      case Processor::kNeon: return DeviceClass::kCpuNeon;
    }
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
