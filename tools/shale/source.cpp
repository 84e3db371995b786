#include "tools/shale/source.h"

#include <algorithm>
#include <filesystem>

#include "ir/base/file.h"
#include "tools/scene/dataset.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/command.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

/// A range of another source's frames.
class SliceSource : public FrameSource {
 public:
  SliceSource(std::unique_ptr<FrameSource> from, uint32_t first, uint32_t count)
      : from_(std::move(from)), first_(first), count_(count) {}

  const std::string& name() const override { return from_->name(); }
  uint32_t frame_count() const override { return count_; }
  Extent render_size() const override { return from_->render_size(); }
  Extent output_size() const override { return from_->output_size(); }
  Result<SourceFrame> frame(uint32_t index, bool with_truth) override {
    if (index >= count_) return bad_input(name(), "frame {} is not below {}", index, count_);
    return from_->frame(first_ + index, with_truth);
  }

 private:
  std::unique_ptr<FrameSource> from_;
  uint32_t first_, count_;
};

}  // namespace

SourceKind source_kind(const std::string& path) {
  std::error_code error;
  if (!fs::is_directory(path, error)) {
    if (fs::path(path).extension() != ".json") return SourceKind::kPictures;
    return is_sequence_file(path) ? SourceKind::kDataset : SourceKind::kScene;
  }
  for (fs::directory_iterator it(path, error); !error && it != fs::directory_iterator();
       it.increment(error))
    if (is_sequence_file(it->path().string())) return SourceKind::kDataset;
  return SourceKind::kPictures;
}

void SourceArguments::add_to(CLI::App& app) {
  app.add_option("--frames", frames, "frames to take of a scene or dataset (default: all)")
      ->check(CLI::Range(1u, 100000u));
  app.add_option("--first", first, "first frame to take")->check(CLI::Range(0u, 1000000u));
  app.add_option("--sequence", sequence, "which sequence of a dataset, counted from 0");
  app.add_option(
      "--pattern", pattern,
      "how a scene is sampled: halton, mnss, or offsets X,Y:X,Y (default: what the first "
      "model's frame.json says)");
}

Result<std::string> sequence_file(const std::string& path, const SourceArguments& arguments) {
  std::error_code ignored;
  if (!fs::is_directory(path, ignored)) return path;
  SHALE_TRY(const std::vector<std::string> files, dataset_sequences(path));
  if (arguments.sequence >= files.size())
    return bad_input(path, "has {} sequences, there is no number {}", files.size(),
                     arguments.sequence);
  return files[arguments.sequence];
}

Result<std::unique_ptr<FrameSource>> open_dataset(const std::string& path,
                                                  const SourceArguments& arguments) {
  SHALE_TRY(const std::string file, sequence_file(path, arguments));
  SHALE_TRY(std::unique_ptr<FrameSource> source, DatasetSource::open(file, arguments.ratio));
  const uint32_t all = source->frame_count();
  if (arguments.first >= all)
    return bad_input(file, "has {} frames, there is no number {}", all, arguments.first);
  const uint32_t left = all - arguments.first;
  const uint32_t count = arguments.frames == 0 ? left : std::min(left, arguments.frames);
  return std::unique_ptr<FrameSource>(new SliceSource(std::move(source), arguments.first, count));
}

Result<std::unique_ptr<SceneSource>> open_scene(const std::string& path,
                                                const SourceArguments& arguments,
                                                const ToolDevice& device, Extent render,
                                                Extent output, const SamplingPattern& pattern,
                                                uint32_t margin) {
  SHALE_TRY(Scene scene, load_scene(path));
  if (margin > 0) {
    scene = with_margin(std::move(scene), output.width, output.height, margin);
    render = output = {output.width + 2 * margin, output.height + 2 * margin};
  }
  SceneOptions options;
  options.pattern = pattern;
  if (!arguments.pattern.empty()) {
    Result<SamplingPattern> given = parse_pattern(arguments.pattern);
    if (!given) return in_file("--pattern", given.error());
    options.pattern = *std::move(given);
  }
  options.render = render;
  options.output = output;
  options.clip = {arguments.first, arguments.frames, {}};
  options.keep_going = [] { return !interrupted(); };
  options.cache = device.cache();
  return SceneSource::create(device.context(), std::move(scene), std::move(options));
}

}  // namespace shale
