// compiler/target/profile.h -- device classes that a package can be compiled for.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "ir/package/caps.h"

namespace shale {

/// What the time of a dispatch is made of.
enum class Work : uint8_t {
  kDispatch,       ///< one per dispatch: launch and barrier
  kCode,           ///< products in the code: fetched anew by every dispatch
  kFloatProduct,   ///< float32 multiply and add by a literal, of all invocations; so below
  kIntProduct,     ///< the same in int32
  kPairProduct,    ///< the same in float64 of two packed tiles
  kTransform,      ///< an element of those transforms
  kFetch,          ///< a texel
  kUnpack,         ///< a channel of a texel as a number
  kResult,         ///< an element requantized and stored
  kGenericMac,     ///< by the generic kernel, 1 per product
  kGenericResult,  ///< an element by the generic kernel
  kRunMac,         ///< by runs
  kRunResult,      ///< an element by runs
  kRealMac,        ///< a product of reals whose weights a loop loads
  kDotMac,         ///< by int8 dot products
  kMatrixMac,      ///< by int8 cooperative matrices
  kLoopMac,        ///< a float32 product of weights that a loop loads
  kByte,           ///< read or written, at the memory's rate while the rest goes on
};
inline constexpr size_t kWorkCount = 18;

struct WorkInfo {
  std::string_view name;  ///< in JSON
  std::string_view what;
};
const WorkInfo& work_info(Work work);

/// A number per Work: amounts, or the nanoseconds that one takes.
struct WorkTable : std::array<double, kWorkCount> {
  double& operator[](Work work) { return at(static_cast<size_t>(work)); }
  double operator[](Work work) const { return at(static_cast<size_t>(work)); }
};

/// Microseconds: the memory's time or that of all else, whichever is longer, and the dispatch.
double work_time_us(const WorkTable& amounts, const WorkTable& ns);

/// Constants that were measured on one device.
struct MeasuredConstants {
  WorkTable ns{};
  double roof_gops = 0;  ///< as in DeviceProfile
};

/// A device class: what it can do, and the constants of the cost model, measured where `source` says
/// so.
struct DeviceProfile {
  std::string_view name;
  std::string_view help;
  DeviceClass device_class = DeviceClass::kAny;
  DeviceCaps caps;
  WorkTable ns{};  ///< what a unit of work takes, all cores at work
  double roof_gops =
      0;  ///< float32 multiply and add in registers when `ns` was measured; 0 is unknown
  double driver_us_per_product = 0;  ///< the driver's compile time for a product in the code
  double driver_us_per_module = 0;   ///< the same for a module without any
  int64_t most_products = 262144;  ///< in the code of a network: bounds its package and first start
  bool literal_weights = false;    ///< constants in code are free: true where kernels run on a CPU
  /// Sums that kernels with literal weights keep in registers, and the most where equal passes over the
  /// channels are fewer so: what the processor has registers for.
  int64_t live_sums = 16, most_sums = 20;
  bool for_all =
      true;  ///< a variant of packages for all targets; else another class's serves there
  std::string_view source = {};
};

std::span<const DeviceProfile> known_profiles();
const DeviceProfile* find_profile(std::string_view name);

/// The profile of the device's class (device_class), under its name and with its constants, for the
/// capabilities that the device really has.
DeviceProfile profile_from_caps(const DeviceCaps& caps);

}  // namespace shale
