// compiler/cost/frame_model.h -- what a frame, its passes and its network, would cost on a modelled
// device: the one answer that report and trade give.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "compiler/cost/device_model.h"

namespace shale {

/// What a pass of shaders does for a frame, on a device that reads and writes images as they are.
struct PassWork {
  std::string name;
  double bytes = 0;       ///< of the images and tensors that it binds, each once and whole
  double operations = 0;  ///< of all invocations, as spirv_operations counts them
};

struct ModelledPass {
  std::string name;
  double bytes = 0, operations = 0;
  double memory_us = 0, compute_us = 0;
  double time_us = 0;  ///< the longer of both, and the dispatch

  bool memory_bound() const { return memory_us > compute_us; }
};

struct ModelledFrame {
  std::vector<ModelledPass> passes;
  double passes_us = 0, network_us = 0, pass_bytes = 0;

  double total_us() const { return passes_us + network_us; }
};

/// Bytes at the device's memory bandwidth, operations at its shader rate; `network` is null for a
/// frame without one.
ModelledFrame model_frame(std::span<const PassWork> passes, const ModelledNetwork* network,
                          const ModelledDevice& device);

}  // namespace shale
