// compiler/target/modelled_device.h -- devices that networks are judged for without being run there.
#pragma once

#include <array>
#include <span>
#include <string_view>

#include "ir/base/dtype.h"

namespace shale {

/// A number of the model, and where it is from.
struct Constant {
  double value = 0;
  std::string_view unit;
  std::string_view source;
};

/// Precision of a layer's products.
enum class Precision : uint8_t { kInt8, kInt16, kFp16, kFp32 };
inline constexpr size_t kPrecisionCount = 4;
std::string_view precision_name(Precision precision);

/// A roofline with a launch cost; every number a parameter.
struct ModelledDevice {
  std::string_view name;
  std::string_view help;
  Constant tops;                               ///< peak of INT8 products, 2 operations a product
  Constant efficiency;                         ///< share of the peak that convolutions reach
  std::array<Constant, kPrecisionCount> rate;  ///< of products, relative to INT8
  Constant other_gops;                         ///< operations that are no products
  Constant shader_gops;                        ///< operations of shaders, those of passes
  Constant memory_gbps;                        ///< DRAM, sustained
  Constant cache_bytes;  ///< on chip, for a layer's tiles and for what lives briefly
  Constant dispatch_us;  ///< from one dispatch to the next
  std::array<Constant, kPrecisionCount> product_pj{};  ///< a multiply and its addition
  Constant other_pj{};                                 ///< an operation that is no product
  Constant memory_pj{};                                ///< a byte from or to DRAM
  Constant cache_pj{};                                 ///< a byte from or to the cache
};

std::span<const ModelledDevice> modelled_devices();
/// Null if there is none of that name.
const ModelledDevice* find_modelled_device(std::string_view name);

}  // namespace shale
