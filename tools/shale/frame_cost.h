// tools/shale/frame_cost.h -- a model folder's frame on a modelled device, for report and trade.
#pragma once

#include <map>
#include <optional>
#include <string>

#include "compiler/cost/frame_model.h"
#include "tools/shale/command.h"

namespace shale {

/// A frame's passes, compiled once for a GPU so that their operations can be counted; sizes and
/// devices may be asked for as often as one likes. A model without a frame has no passes.
class FrameCost {
 public:
  /// `model` has to outlive it.
  /// Errors: those of the compiler.
  static Result<FrameCost> create(const ModelFiles& model, const CompileOptions& options);

  struct Modelled {
    ModelledFrame frame;
    std::optional<ModelledNetwork> network;
  };
  /// Errors: those of shapes, of the passes; kBadInput for sizes that the frame does not offer.
  Result<Modelled> at(const FrameSizes& sizes, const ModelledDevice& device) const;

 private:
  FrameCost(const ModelFiles& model, CompileOptions options)
      : model_(&model), options_(std::move(options)) {}

  Result<std::vector<PassWork>> passes(FrameExtent render, FrameExtent output,
                                       const Graph* graph) const;

  const ModelFiles* model_;
  CompileOptions options_;
  std::map<std::string, double> operations_;  ///< of an invocation, by pass
};

/// What is printed and written of the passes.
Json passes_json(const ModelledFrame& frame);

}  // namespace shale
