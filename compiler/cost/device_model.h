// compiler/cost/device_model.h -- what a fused and tiled network would cost on a modelled device.
#pragma once

#include <string>
#include <vector>

#include "compiler/passes/op_kind.h"
#include "compiler/plan/tiles.h"
#include "compiler/target/modelled_device.h"

namespace shale {

/// Multiplies the device's own numbers; 0 leaves one as it is.
struct ModelOptions {
  double tops = 0, efficiency = 0, memory_gbps = 0, cache_bytes = 0;  ///< in place of the device's
};
ModelledDevice with_options(const ModelledDevice& device, const ModelOptions& options);

/// One fused group.
struct ModelledDispatch {
  std::string name;  ///< of its result
  std::string op;    ///< of its head, or of its last node
  Precision precision = Precision::kInt8;
  uint64_t macs = 0, ops = 0;
  Tile tile;
  double bytes = 0;         ///< read and written, halos of tiles included
  double memory_bytes = 0;  ///< of them from and to DRAM
  double product_us = 0;    ///< of compute_us
  double compute_us = 0, memory_us = 0, dispatch_us = 0;
  double time_us = 0;       ///< the longer of both, and the dispatch
  double energy_uj = 0;     ///< an estimate
  uint64_t live_bytes = 0;  ///< of intermediate tensors while it runs

  bool memory_bound() const { return memory_us > compute_us; }
  /// Operations a byte of DRAM, 2 a product; infinite if everything stays on chip.
  double intensity() const;
};

struct ModelledNetwork {
  std::vector<ModelledDispatch> dispatches;
  uint64_t macs = 0;
  double time_us = 0, energy_uj = 0, memory_bytes = 0;
  uint64_t arena_bytes = 0, arena_lower_bound_bytes = 0;
};

/// `graph` after the passes, groups set, shapes known. Rules: a graph input or output and a tensor
/// of more than half the cache lie in DRAM; a smaller intermediate stays in the cache; weights are
/// read from DRAM once a frame. A convolution or pooling reads the halo of its tiles again.
ModelledNetwork model_network(const Graph& graph, const ModelledDevice& device);

}  // namespace shale
