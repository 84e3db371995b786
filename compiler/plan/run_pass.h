// compiler/plan/run_pass.h -- the passes of a frame as they run, those among them that the compiler adds.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "compiler/plan/frame_lowering.h"

namespace shale {

/// When a pass runs.
enum class Runs : uint8_t { kInAllFrames, kKept, kBroken };

/// The workgroups of a pass that run, as words of a buffer: each is row * columns + column.
struct WorkgroupList {
  uint32_t resource = 0;
  uint32_t first = 0;  ///< word
  uint32_t columns = 1;
};

/// A pass, or one of the two forms of a pass.
struct RunPass {
  FramePass pass;
  Runs runs = Runs::kInAllFrames;
  bool is_last_form = true;
  std::string glsl = {};  ///< of the shader
  // Of passes that the compiler adds.
  std::optional<std::array<uint32_t, 3>> workgroups = {};
  /// Behind what accessors bind, from FREE_BINDING on; their numbers are not set.
  std::vector<Binding> buffers = {};
  // Of any.
  std::optional<IndirectGrid> grid = {};  ///< that an earlier pass writes
  std::optional<WorkgroupList> list = {};
  bool is_rare = false;  ///< what it costs is not counted
};

/// The passes of a program as they run: where a promise is kept that some have forms for, the checks first.
std::vector<RunPass> run_passes(const FrameProgram& program,
                                std::span<const FramePromise* const> kept);

/// The shader that chooses between the forms of passes: the n-th of those that do not always run has three words from
/// 3 * n on.
Result<std::string> choice_shader(const Variant& variant, std::span<const RunPass> passes,
                                  const LoweringOptions& options);

std::string pass_label(const FramePass& pass);

/// Of images, graph inputs and outputs.
/// Errors: kBadInput if there is none of that name.
Result<uint32_t> find_resource(const Variant& variant, const std::string& name,
                               const std::string& where);

/// The grid of a pass.
/// Errors: kBadInput if there is nothing that it could go over.
Result<std::array<uint32_t, 3>> workgroups_of(const Variant& variant, const FramePass& pass,
                                              const LoweringOptions& options);

/// A linear image of the frame loop's own of at least so many words.
Resource words_image(std::string name, Category category, uint64_t words);

}  // namespace shale
