// tools/shale/source.h -- where the frames come from that a command line names.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <string>

#include "ir/base/sampling_pattern.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/device_run.h"

namespace shale {

enum class SourceKind {
  kScene,     ///< a scene file (.json)
  kDataset,   ///< a folder with sequences (NNNN.json), or one such sequence
  kPictures,  ///< anything else
};

/// By what lies at the path; a path with nothing there counts as pictures.
SourceKind source_kind(const std::string& path);

/// --frames, --first, --sequence, --pattern.
struct SourceArguments {
  uint32_t frames = 0;  ///< 0 is all
  uint32_t first = 0;
  uint32_t sequence = 0;
  std::string pattern;  ///< of a scene: what parse_pattern reads; empty is not given
  double ratio = 0;     ///< of a dataset that has several, from --ratio; 0 is not given
  void add_to(CLI::App& app);
};

/// The file of the sequence that the arguments choose; a file is one itself.
/// Errors: kIo; kBadInput if there is no such sequence.
Result<std::string> sequence_file(const std::string& path, const SourceArguments& arguments);

/// The frames of a dataset.
/// Errors: kIo; kBadInput if there is no such sequence or frame.
Result<std::unique_ptr<FrameSource>> open_dataset(const std::string& path,
                                                  const SourceArguments& arguments);

/// The frames of a scene, rendered on the device at these sizes; with `pattern` where the arguments
/// give none. With a margin the sizes are those of the picture, and the frames larger by twice the margin.
/// Errors: as load_scene and SceneSource::create.
/// Precondition: without a margin, or render and output size are equal.
Result<std::unique_ptr<SceneSource>> open_scene(const std::string& path,
                                                const SourceArguments& arguments,
                                                const ToolDevice& device, Extent render,
                                                Extent output, const SamplingPattern& pattern,
                                                uint32_t margin = 0);

}  // namespace shale
