// tools/scene/dataset.h -- sequences of frames on disk, in the layout of captured NSS training data:
//
//   ROOT/NNNN.json                     a sequence: cameras, jitter, exposure
//   ROOT/ground_truth/NNNN/FFFF.exr    half RGB at output size, linear
//   ROOT/motion_gt/NNNN/FFFF.exr       half RG at output size, uv
//   ROOT/depth_gt/NNNN/FFFF.exr        float R at output size; ours, optional
//   ROOT/x2/color/NNNN/FFFF.exr        half RGB at render size
//   ROOT/x2/depth/NNNN/FFFF.exr        float R
//   ROOT/x2/motion/NNNN/FFFF.exr       half RG, uv
//
// The folder is "x" and the ratio of sizes with an underscore for its point: x1_5, x2, x3; a capture may
// have several. Render sizes are the output's over the ratio, rounded down. What other tools write
// otherwise is read too: folders such as x1.5, depth called Z or Y, names of five digits or with a suffix
// (0002_camcut.json), fewer pictures than entries of "Frames", near and far plane told once for a
// sequence. Source: NSS dataset specification, and the reader of Arm's neural graphics model gym.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "tools/scene/frame_source.h"

namespace shale {

/// The ratio with the fewest decimals by which a reader finds the render size from the output's. Sides must
/// not be 0.
double ratio_of_sizes(Extent render, Extent output);

/// "x2", "x1_5": the folder of a ratio.
std::string ratio_folder(double ratio);

/// True for a file that is called like a sequence: 0000.json, 00012.json, 0002_camcut.json.
bool is_sequence_file(const std::string& path);

struct SequenceInfo {
  uint32_t number = 0;  ///< NNNN
  Extent render, output;
  double frame_rate = 30;
  std::string sampling = "halton";  ///< how its pattern is called
  uint32_t jitter_phases = 32;
  double ratio = 0;  ///< 0: that of the sizes
};

/// Writes one sequence frame by frame; the JSON comes last, so a sequence without it is incomplete.
class DatasetWriter {
 public:
  /// Creates the folders; of an earlier sequence of this number nothing stays in them.
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
/// "Frames", from 0, are called n, whatever its own number; frames end where the pictures do.
class DatasetSource : public FrameSource {
 public:
  /// `json_path` is ROOT/NNNN.json. `ratio` 0 takes 2 if that is there, else the only one. Where the
  /// sequence names its ratios, pictures of others are not its own.
  /// Errors: kIo; kBadInput naming file and field, or the ratios that are there.
  static Result<std::unique_ptr<DatasetSource>> open(const std::string& json_path,
                                                     double ratio = 0);

  const std::string& name() const override { return name_; }
  uint32_t frame_count() const override { return static_cast<uint32_t>(cameras_.size()); }
  Extent render_size() const override { return render_; }
  Extent output_size() const override { return output_; }
  Result<SourceFrame> frame(uint32_t index, bool with_truth) override;

  double frame_rate() const { return frame_rate_; }

 private:
  DatasetSource() = default;
  /// `own`: the ratios that the sequence says it has; none if it does not.
  Result<void> choose_ratio(double wanted, const std::map<double, size_t>& own);
  Result<void> measure_pictures();
  Result<void> parse(const std::string& text, double ratio);
  std::string picture(const std::string& folder, uint32_t index) const;

  std::string root_, name_;
  std::string folder_;  ///< of the ratio
  double ratio_ = 0;
  Extent render_, output_;
  double frame_rate_ = 30;
  std::vector<FrameCamera> cameras_;
};

/// Paths of the sequences of a dataset, in order of their names.
/// Errors: kIo; kBadInput if there is none.
Result<std::vector<std::string>> dataset_sequences(const std::string& root);

}  // namespace shale
