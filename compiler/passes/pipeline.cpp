// compiler/passes/pipeline.cpp -- the order of the passes, and the reason for each place.
#include "compiler/passes/pass.h"
#include "ir/verify/verify.h"

namespace shale {

Result<std::vector<PassTiming>> run_pipeline(Graph& graph, const PassContext& context,
                                             const PassOptions& options) {
  // Shapes come first: the verifier and every later pass need them closed.
  static constexpr std::string_view kNeeded[] = {"infer-shapes"};
  static constexpr std::string_view kExpand[] = {"expand-fft"};  // kernels know no transform
  static constexpr std::string_view kOptimize[] = {
      "fold-constants",   // before merging, so that computed constants are merged too
      "remove-identity",  // exposes equal operands to merge-equal
      "merge-equal",
      "fold-zero-point",   // makes the pads of convolutions explicit; fuse-views folds them again
      "fold-constants",    // weights and biases that the previous pass touched
      "remove-dead",       // use counts must be true before fusion asks for single users
      "copy-views",        // after the last merging, which would undo it
      "fuse-elementwise",  // before views: a view must not cut a producer from its requantization
      "fuse-views",
  };
  SHALE_TRY(std::vector<PassTiming> timings, run_passes(graph, context, options, kNeeded));
  SHALE_TRY_VOID(verify(graph));
  const auto run = [&](std::span<const std::string_view> names) -> Result<void> {
    SHALE_TRY(const std::vector<PassTiming> more, run_passes(graph, context, options, names));
    timings.insert(timings.end(), more.begin(), more.end());
    return verify(graph);
  };
  SHALE_TRY_VOID(run(kExpand));
  if (options.optimize) SHALE_TRY_VOID(run(kOptimize));
  return timings;
}

}  // namespace shale
