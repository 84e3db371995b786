// tools/scene/dataset.h -- sequences of frames on disk, in the layout of captured NSS training data:
//
//   ROOT/NNNN.json                     a sequence: cameras, jitter, exposure
//   ROOT/ground_truth/NNNN/FFFF.exr    half RGB at output size, linear
//   ROOT/motion_gt/NNNN/FFFF.exr       half RG at output size, uv
//   ROOT/depth_gt/NNNN/FFFF.exr        float Z at output size; ours, optional
//   ROOT/x2/color/NNNN/FFFF.exr        half RGB at render size
//   ROOT/x2/depth/NNNN/FFFF.exr        float Z
//   ROOT/x2/motion/NNNN/FFFF.exr       half RG, uv
//
// The folder is "x" and the ratio of sizes: x1.5, x2, x3. Source: NSS dataset specification.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "tools/scene/frame_source.h"

namespace shale {

/// "x2", "x1.5": the folder of a ratio. Widths must not be 0.
std::string ratio_folder(Extent render, Extent output);

struct SequenceInfo {
  uint32_t number = 0;  ///< NNNN
  Extent render, output;
  double frame_rate = 30;
  uint32_t jitter_phases = 32;
};

/// Writes one sequence frame by frame; the JSON comes last, so a sequence without it is incomplete.
class DatasetWriter {
 public:
  /// Creates the folders.
  /// Errors: kIo.
  static Result<DatasetWriter> create(const std::string& root, const SequenceInfo& info);

  /// Pictures that are empty are left out.
  /// Errors: kIo.
  Result<void> add(const SourceFrame& frame);

  /// Errors: kIo.
  Result<void> finish();

 private:
  DatasetWriter(std::string root, const SequenceInfo& info) : root_(std::move(root)), info_(info) {}

  std::string root_;
  SequenceInfo info_;
  std::vector<FrameCamera> cameras_;
};

/// A sequence on disk. Files come from anywhere and are checked. The pictures of the n-th entry of
/// "Frames", from 0, are called n, whatever its own number.
class DatasetSource : public FrameSource {
 public:
  /// `json_path` is ROOT/NNNN.json. `ratio` is a folder such as "x2"; empty takes the first that
  /// the sequence lists, or x2.
  /// Errors: kIo; kBadInput naming file and field.
  static Result<std::unique_ptr<DatasetSource>> open(const std::string& json_path,
                                                     const std::string& ratio = "");

  const std::string& name() const override { return name_; }
  uint32_t frame_count() const override { return static_cast<uint32_t>(cameras_.size()); }
  Extent render_size() const override { return render_; }
  Extent output_size() const override { return output_; }
  Result<SourceFrame> frame(uint32_t index, bool with_truth) override;

  double frame_rate() const { return frame_rate_; }

 private:
  DatasetSource() = default;
  Result<void> parse(const std::string& text, const std::string& ratio);
  std::string picture(const char* folder, uint32_t index) const;

  std::string root_, name_, ratio_;
  Extent render_, output_;
  double frame_rate_ = 30;
  std::vector<FrameCamera> cameras_;
};

/// Paths of the sequences of a dataset, in order of their names.
/// Errors: kIo; kBadInput if there is none.
Result<std::vector<std::string>> dataset_sequences(const std::string& root);

}  // namespace shale
