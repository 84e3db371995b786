#include "ir/package/rank.h"

#include <gtest/gtest.h>

#include <map>

namespace shale {
namespace {

/// A variant of one dispatch that asks for nothing.
Variant variant_of(DeviceClass device_class, double time_us = 1) {
  Variant variant;
  variant.device_class = device_class;
  Segment segment;
  segment.dispatches.emplace_back().cost.time_us = time_us;
  variant.segments.push_back(segment);
  return variant;
}

DeviceCaps caps_of(DeviceClass device_class) {
  DeviceCaps caps;
  const std::map<DeviceClass, Processor> processors{{DeviceClass::kCpu, Processor::kAvx512},
                                                    {DeviceClass::kCpuAvx2, Processor::kAvx2},
                                                    {DeviceClass::kCpuSse, Processor::kSse},
                                                    {DeviceClass::kCpuNeon, Processor::kNeon}};
  if (const auto found = processors.find(device_class); found != processors.end()) {
    caps.cpu = true;
    caps.processor = found->second;
  }
  if (device_class != DeviceClass::kAny) caps.features.add(Feature::kDotProduct8);
  if (device_class == DeviceClass::kMatrixGpu) {
    caps.features.add(Feature::kCooperativeMatrix);
    caps.matrix_products = {{16, 16, 32}};
  }
  return caps;
}

constexpr DeviceClass kClasses[] = {
    DeviceClass::kAny,     DeviceClass::kCpu,    DeviceClass::kDot8Gpu, DeviceClass::kMatrixGpu,
    DeviceClass::kCpuAvx2, DeviceClass::kCpuSse, DeviceClass::kCpuNeon};

std::vector<uint32_t> order(const std::vector<Variant>& variants, const DeviceCaps& caps) {
  std::vector<uint32_t> indices;
  for (const RankedVariant& ranked : rank_variants(variants, caps)) indices.push_back(ranked.index);
  return indices;
}

TEST(Rank, ADevicesClassFollowsFromItsCaps) {
  for (const DeviceClass each : kClasses) EXPECT_EQ(device_class(caps_of(each)), each);
  // A CPU driver with matrices is one all the same, and matrices without dot products are no class.
  DeviceCaps caps = caps_of(DeviceClass::kMatrixGpu);
  caps.cpu = true;
  EXPECT_EQ(device_class(caps), DeviceClass::kCpu);
  caps = {};
  caps.features.add(Feature::kCooperativeMatrix);
  EXPECT_EQ(device_class(caps), DeviceClass::kAny);
}

TEST(Rank, ClassGoesBeforeTime) {
  // The slowest is that of the device's own class.
  for (const DeviceClass device : kClasses) {
    std::vector<Variant> variants;
    for (const DeviceClass each : kClasses) variants.push_back(variant_of(each, 10));
    variants.push_back(variant_of(device, 20));
    variants.push_back(variant_of(device, 5));
    const std::vector<uint32_t> ranked = order(variants, caps_of(device));
    EXPECT_EQ(ranked[0], 8u);
    EXPECT_EQ(ranked[1], static_cast<uint32_t>(device));
    EXPECT_EQ(ranked[2], 7u);
  }
}

TEST(Rank, NeitherKindOfDeviceTakesTheOthersVariantWhileItsOwnFits) {
  const std::vector<Variant> both{variant_of(DeviceClass::kDot8Gpu), variant_of(DeviceClass::kCpu),
                                  variant_of(DeviceClass::kMatrixGpu),
                                  variant_of(DeviceClass::kAny)};
  EXPECT_EQ(order(both, caps_of(DeviceClass::kCpu))[0], 1u);
  for (const DeviceClass gpu : {DeviceClass::kAny, DeviceClass::kDot8Gpu, DeviceClass::kMatrixGpu})
    EXPECT_EQ(order(both, caps_of(gpu))[3], 1u);
}

TEST(Rank, ProcessorsWithoutAvx512TakeFloatsOfFewerSumsAndOnlyThenDoubles) {
  const std::vector<Variant> variants{variant_of(DeviceClass::kDot8Gpu),
                                      variant_of(DeviceClass::kCpu),
                                      variant_of(DeviceClass::kCpuAvx2)};
  using Order = std::vector<uint32_t>;
  EXPECT_EQ(order(variants, caps_of(DeviceClass::kCpu)), (Order{1, 2, 0}));
  for (const DeviceClass narrow :
       {DeviceClass::kCpuAvx2, DeviceClass::kCpuSse, DeviceClass::kCpuNeon})
    EXPECT_EQ(order(variants, caps_of(narrow)), (Order{2, 1, 0}));
  // A driver that does not say what it compiles for is taken as before there were classes.
  DeviceCaps caps;
  caps.cpu = true;
  EXPECT_EQ(order(variants, caps), (Order{1, 2, 0}));
}

TEST(Rank, WhatTheDeviceLacksPutsAVariantLast) {
  std::vector<Variant> variants{variant_of(DeviceClass::kMatrixGpu),
                                variant_of(DeviceClass::kDot8Gpu)};
  variants[0].requirements.features.add(Feature::kCooperativeMatrix);
  variants[0].requirements.matrix_products = {{16, 16, 16}};
  variants[0].requirements.subgroup_size = 64;
  DeviceCaps caps = caps_of(DeviceClass::kMatrixGpu);
  caps.subgroup_size = 32;
  caps.max_workgroup_invocations = 128;
  const std::vector<RankedVariant> ranked = rank_variants(variants, caps);
  EXPECT_EQ(ranked[0].index, 1u);
  EXPECT_EQ(ranked[1].missing,
            (std::vector<std::string>{"subgroupSize is 32, needs 64",
                                      "cooperative matrices of 16x16x16 int8 are not supported"}));
}

TEST(Rank, EqualsStayInThePackagesOrder) {
  const std::vector<Variant> variants(3, variant_of(DeviceClass::kAny));
  EXPECT_EQ(order(variants, {}), (std::vector<uint32_t>{0, 1, 2}));
  EXPECT_TRUE(rank_variants({}, {}).empty());
}

}  // namespace
}  // namespace shale
