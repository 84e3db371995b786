// tools/shale/layer_check.h -- each dispatch of a network on its own, against the interpreter.
#pragma once

#include "compiler/driver/compile.h"
#include "tools/shale/device_run.h"

namespace shale {

/// What the interpreter says of one fused group that ran on the device by itself.
struct LayerCheck {
  std::string name;  ///< of the group's result
  OutputCheck check;
};

/// Bounds of floats widen from layer to layer until they say nothing of a deep network's outputs. Here
/// every fused group of `graph` (compile's result) runs as a network of its own, on what the interpreter
/// gives for its operands, so that the bounds are those of one layer. `options` are those of compile.
/// Errors: as compile_graph, run_network and interpret.
Result<std::vector<LayerCheck>> check_layers(const ToolDevice& device, const Graph& graph,
                                             const CompileOptions& options,
                                             const std::vector<Tensor>& inputs,
                                             const InterpreterProgress& progress);

}  // namespace shale
