// compiler/target/profile.h -- device classes that a package can be compiled for.
#pragma once

#include <span>
#include <string_view>

#include "ir/package/caps.h"

namespace shale {

/// Constants of the cost model; rates are sustained, measured where `source` says so.
struct DeviceProfile {
  std::string_view name;
  std::string_view help;
  DeviceCaps caps;
  double mul_add_gops = 0;    ///< float32 multiply and add in registers, 2 per MAC
  double literal_share = 0;   ///< share of mul_add_gops that kernels with literal weights reach
  double winograd_share = 0;  ///< the same for Winograd kernels, by the products that they make
  double integer_share = 0;   ///< the same for the int32 form
  double driver_us_per_product = 0;  ///< the driver's compile time for a product in the code
  double dot8_gops = 0;          ///< kernels of int8 dot products, 2 per MAC; weights in buffers
  double matrix_gops = 0;        ///< kernels of int8 cooperative matrices, the same
  double generic_gops = 0;       ///< one invocation per output element, storage buffers, 2 per MAC
  double element_ns = 0;         ///< cost of one elementwise result of the generic kernel
  double bandwidth_gbps = 0;     ///< bytes read or written per nanosecond
  double launch_us = 0;          ///< per dispatch
  bool literal_weights = false;  ///< constants in code are free: true where kernels run on a CPU
  std::string_view source;
};

std::span<const DeviceProfile> known_profiles();
const DeviceProfile* find_profile(std::string_view name);

}  // namespace shale
