// compiler/plan/frame_lowering.h -- the passes of a frame as dispatches for one target.
//
// frame.json says what is read and written; here it is decided how. On a GPU the host's images are read and written as they
// are: sampled and storage images, the device's sampler. A CPU driver reads and writes buffers several times as fast as
// images (shaders/frame/README.md has the figures), so there texels lie in buffers, and the driver copies the host's images.
//
// Where promises of the frame are kept, passes that have another form for them stand there in both, and so that what a frame
// shows does not depend on a promise: checks come first, and behind them one invocation that gives either form its grid and
// the other none.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "compiler/plan/frame.h"
#include "compiler/plan/plan.h"

namespace shale {

struct LoweringOptions {
  const Frame& frame;
  FrameExtent render, output;
  ShaderLoader load_shader;
  const DeviceProfile& profile;
  std::span<const FramePromise* const> kept = {};  ///< promises of the frame
  std::optional<uint32_t> tiles = {};              ///< as in CompileOptions
};

/// Plans all programs of a frame: images, passes, copies and the graphs, which lie in the order of graph_files().
/// Errors: kBadInput naming pass and image for what does not fit together; those of shaders that do not load or compile.
Result<void> lower_frame(Plan& plan, std::span<const PlannedGraph> graphs,
                         const LoweringOptions& options, WeightBlob& weights);

}  // namespace shale
