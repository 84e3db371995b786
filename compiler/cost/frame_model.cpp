#include "compiler/cost/frame_model.h"

#include <algorithm>

namespace shale {

ModelledFrame model_frame(std::span<const PassWork> passes, const ModelledNetwork* network,
                          const ModelledDevice& device) {
  ModelledFrame frame;
  for (const PassWork& work : passes) {
    ModelledPass& pass = frame.passes.emplace_back();
    pass.name = work.name;
    pass.bytes = work.bytes;
    pass.operations = work.operations;
    pass.memory_us = 1e-3 * work.bytes / device.memory_gbps.value;
    pass.compute_us = 1e-3 * work.operations / device.shader_gops.value;
    pass.time_us = std::max(pass.memory_us, pass.compute_us) + device.dispatch_us.value;
    frame.passes_us += pass.time_us;
    frame.pass_bytes += pass.bytes;
  }
  if (network) frame.network_us = network->time_us;
  return frame;
}

}  // namespace shale
