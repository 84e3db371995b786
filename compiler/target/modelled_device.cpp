#include "compiler/target/modelled_device.h"

#include <array>

namespace shale {
namespace {

constexpr std::string_view kEnergySource =
    "Horowitz, ISSCC 2014, figure 1.1.9: 45 nm, 0.9 V; newer processes need less, ratios hold";
constexpr std::string_view kAssumed = "assumed";

/// Energy is that of the operations alone, without control and leakage.
constexpr ModelledDevice with_energy(ModelledDevice device) {
  constexpr std::string_view pj = "pJ";
  device.product_pj[0] = {0.3, pj, kEnergySource};  // 8-bit product 0.2, 32-bit sum 0.1
  device.product_pj[1] = {0.6, pj, "twice INT8: 16 x 8 bits as two products of 8 x 8"};
  device.product_pj[2] = {2.0, pj, kEnergySource};  // half product 1.1, float sum 0.9
  device.product_pj[3] = {4.6, pj, kEnergySource};  // float product 3.7, float sum 0.9
  device.other_pj = {0.1, pj, kEnergySource};       // 32-bit integer sum
  device.memory_pj = {162.5, pj, kEnergySource};    // 1.3 nJ for 8 bytes, the lower figure
  device.cache_pj = {12.5, pj, kEnergySource};      // 100 pJ for 8 bytes of 1 MB
  return device;
}

constexpr std::array kDevices{
    with_energy({.name = "mobile",
                 .help = "the accelerator of the frame budget: 10 TOP/s on a phone",
                 .tops = {10, "TOP/s", "the frame budget"},
                 .efficiency = {0.5, "", "a parameter: NSS v0.1 needs half the peak to fit"},
                 .rate = {{{1, "", "the frame budget"},
                           {0.5, "", "two passes of 8 bits"},
                           {0.5, "", "half-rate float16, usual for mobile accelerators; assumed"},
                           {0.125, "", kAssumed}}},
                 .other_gops = {500, "GOP/s", kAssumed},
                 .shader_gops = {1000, "GOP/s", "half of the 2 TFLOP/s of a phone GPU; assumed"},
                 .memory_gbps = {40, "GB/s", "LPDDR5-6400 on 64 bits: 51.2 GB/s, some 80 % of it"},
                 .cache_bytes = {2.0 * 1024 * 1024, "bytes", kAssumed},
                 .dispatch_us = {5, "us", kAssumed}}),
    with_energy({.name = "desktop-dot8",
                 .help = "a desktop GPU with int8 dot products",
                 .tops = {40, "TOP/s", "10 TFLOP/s of float32, four int8 products in place of one"},
                 .efficiency = {0.5, "", kAssumed},
                 .rate = {{{1, "", ""},
                           {0.25, "", "no 16-bit dot product in Vulkan 1.3: int32"},
                           {0.5, "", "packed float16, twice float32"},
                           {0.25, "", "float32, a quarter of int8 dot products"}}},
                 .other_gops = {5000, "GOP/s", "half of the float32 rate"},
                 .shader_gops = {5000, "GOP/s", "half of the float32 rate"},
                 .memory_gbps = {400, "GB/s", "GDDR6 on 256 bits: 448 GB/s, some 90 % of it"},
                 .cache_bytes = {4.0 * 1024 * 1024, "bytes", "the L2 cache of that class"},
                 .dispatch_us = {4, "us", kAssumed}}),
    with_energy({.name = "desktop-matrix",
                 .help = "a desktop GPU with cooperative matrices",
                 .tops = {160, "TOP/s", "int8 matrices at four times the dot product's rate"},
                 .efficiency = {0.3, "", kAssumed},
                 .rate = {{{1, "", ""},
                           {0.0625, "", "no 16-bit integer matrices: int32 outside of them"},
                           {0.5, "", "float16 matrices at half the rate of int8"},
                           {0.0625, "", "float32 outside of the matrices"}}},
                 .other_gops = {5000, "GOP/s", "half of the float32 rate"},
                 .shader_gops = {5000, "GOP/s", "half of the float32 rate"},
                 .memory_gbps = {400, "GB/s", "GDDR6 on 256 bits: 448 GB/s, some 90 % of it"},
                 .cache_bytes = {4.0 * 1024 * 1024, "bytes", "the L2 cache of that class"},
                 .dispatch_us = {4, "us", kAssumed}}),
};

}  // namespace

std::string_view precision_name(Precision precision) {
  constexpr std::string_view kNames[kPrecisionCount] = {"int8", "int16", "fp16", "fp32"};
  return kNames[static_cast<size_t>(precision)];
}

std::span<const ModelledDevice> modelled_devices() { return kDevices; }

const ModelledDevice* find_modelled_device(std::string_view name) {
  for (const ModelledDevice& device : kDevices)
    if (device.name == name) return &device;
  return nullptr;
}

}  // namespace shale
