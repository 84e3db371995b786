#include "tools/scene/scene_source.h"

#include <algorithm>
#include <numeric>
#include <span>

namespace shale {
namespace {

constexpr uint32_t kMaxSide = 16384;
constexpr uint32_t kTruthSamples = 4;

/// Column and row of the output pixel of each tile that a frame samples.
using MnssPattern = std::span<const std::array<uint8_t, 2>>;
constexpr std::array<uint8_t, 2> kMnss2[] = {{0, 0}, {1, 1}, {1, 0}, {0, 0}, {0, 1}, {1, 0},
                                             {1, 0}, {0, 1}, {0, 0}, {1, 0}, {1, 1}, {0, 0}};
constexpr std::array<uint8_t, 2> kMnss3[] = {{0, 0}, {1, 0}, {2, 0}, {2, 1}, {2, 2},
                                             {1, 2}, {0, 2}, {0, 1}, {1, 1}};

/// Empty where the paper has none.
MnssPattern mnss_pattern(Extent render, Extent output) {
  const auto is = [&](uint32_t scale) {
    return output == Extent{scale * render.width, scale * render.height};
  };
  return is(2) ? MnssPattern(kMnss2) : is(3) ? MnssPattern(kMnss3) : MnssPattern();
}

/// The radical inverse. Source: Halton 1960.
double halton(uint32_t index, uint32_t base) {
  double result = 0, part = 1;
  for (; index > 0; index /= base) {
    part /= base;
    result += part * (index % base);
  }
  return result;
}

/// First and number of render pixels that output pixels first..first+count cover exactly.
Result<std::pair<uint32_t, uint32_t>> render_pixels(const char* side, uint32_t first,
                                                    uint32_t count, uint32_t render,
                                                    uint32_t output) {
  if (count == 0 || first + uint64_t{count} > output)
    return bad_input("crop", "{} {} to {} is outside of the picture's {} pixels", side, first,
                     uint64_t{first} + count, output);
  const uint32_t step = output / std::gcd(render, output);
  if (first % step != 0 || count % step != 0)
    return bad_input("crop",
                     "{} {} with {} pixels does not fall on render pixels, expected "
                     "multiples of {}",
                     side, first, count, step);
  const auto at = [&](uint32_t pixels) {
    return static_cast<uint32_t>(uint64_t{pixels} * render / output);
  };
  return std::pair{at(first), at(count)};
}

/// Pixels of the window at output size.
SampleGrid output_grid(const Window& window, uint32_t samples) {
  SampleGrid grid;
  grid.extent = window.size;
  grid.origin_x = window.x;
  grid.origin_y = window.y;
  grid.samples = samples;
  return grid;
}

}  // namespace

double frame_step(const Scene& scene, double frame_rate) {
  return frame_rate > 0 ? scene.frame_rate / frame_rate : 1;
}

uint32_t frames_at_rate(const Scene& scene, double frame_rate) {
  // A last frame that rounding takes away is one that the scene has.
  const double last = (scene.frames - 1) / frame_step(scene, frame_rate) + 1e-9;
  return static_cast<uint32_t>(std::min(last, double{kMaxSceneFrames})) + 1;
}

uint32_t jitter_phases(Extent render, Extent output, const SamplingPattern& pattern) {
  if (pattern.kind == SamplingPattern::Kind::kList)
    return static_cast<uint32_t>(pattern.offsets.size());
  if (pattern.kind == SamplingPattern::Kind::kMnss)
    return static_cast<uint32_t>(mnss_pattern(render, output).size());
  const uint64_t phases =
      8ull * output.width * output.width / (uint64_t{render.width} * render.width);
  return static_cast<uint32_t>(std::max<uint64_t>(phases, 1));
}

Result<void> check_pattern(const SamplingPattern& pattern, Extent render, Extent output) {
  if (pattern.kind == SamplingPattern::Kind::kMnss && mnss_pattern(render, output).empty())
    return bad_input("pattern", "mnss is for ratios 2 and 3, the sizes are {}x{} to {}x{}",
                     render.width, render.height, output.width, output.height);
  return {};
}

std::array<float, 2> scene_jitter(uint32_t frame, Extent render, Extent output,
                                  const SamplingPattern& pattern) {
  const uint32_t phase = frame % jitter_phases(render, output, pattern);
  if (pattern.kind == SamplingPattern::Kind::kList) return pattern.offsets[phase];
  if (pattern.kind == SamplingPattern::Kind::kMnss) {
    const auto [column, row] = mnss_pattern(render, output)[phase];
    const auto offset = [&](uint32_t at) {
      return (static_cast<float>(at) + 0.5f) * static_cast<float>(render.width) /
                 static_cast<float>(output.width) -
             0.5f;
    };
    return {offset(column), offset(row)};
  }
  const uint32_t index = phase + 1;
  const auto quantized = [](double h) {
    return static_cast<float>((std::floor(8 * h) + 0.5) / 8 - 0.5);
  };
  return {quantized(halton(index, 2)), quantized(halton(index, 3))};
}

Result<std::unique_ptr<SceneSource>> SceneSource::create(const vk::Context& context, Scene scene,
                                                         SceneOptions options) {
  for (const Extent& size : {options.render, options.output})
    if (size.width < 1 || size.height < 1 || size.width > kMaxSide || size.height > kMaxSide)
      return bad_input("size", "{}x{} is outside 1x1 to {}x{}", size.width, size.height, kMaxSide,
                       kMaxSide);
  if (options.render.width > options.output.width || options.render.height > options.output.height)
    return bad_input("size", "render size {}x{} is above output size {}x{}", options.render.width,
                     options.render.height, options.output.width, options.output.height);
  auto source = std::unique_ptr<SceneSource>(new SceneSource(std::move(scene), std::move(options)));
  SHALE_TRY_VOID(
      check_pattern(source->options_.pattern, source->options_.render, source->options_.output));
  SHALE_TRY_VOID(source->set_clip(source->options_.clip));
  source->reverse_ = source->options_.reverse_depth.value_or(source->scene_.camera.reverse_depth);
  SHALE_TRY(source->renderer_,
            SceneRenderer::create(context, source->scene_, source->options_.cache));
  return source;
}

Result<void> SceneSource::set_clip(const SceneClip& clip) {
  const uint32_t all = frames_at_rate(scene_, options_.frame_rate);
  if (clip.first_frame >= all)
    return bad_input("first frame", "is {}, the scene has {} frames", clip.first_frame, all);
  const Extent &render = options_.render, &output = options_.output;
  const Crop crop = clip.crop.value_or(Crop{0, 0, output.width, output.height});
  SHALE_TRY(const auto x, render_pixels("x", crop.x, crop.width, render.width, output.width));
  SHALE_TRY(const auto y, render_pixels("y", crop.y, crop.height, render.height, output.height));
  window_ = {output, crop.x, crop.y, {crop.width, crop.height}};
  render_ = {x.second, y.second};
  render_x_ = x.first;
  render_y_ = y.first;
  first_frame_ = clip.first_frame;
  const uint32_t left = all - first_frame_;
  frames_ = clip.frame_count == 0 ? left : std::min(left, clip.frame_count);
  return {};
}

FrameCamera SceneSource::camera(uint32_t number, const FramePoses& poses) const {
  const CameraPose& pose = poses.camera;
  const Projection p = projection_of(scene_.camera, window_.full, reverse_);
  FrameCamera camera;
  // A crop stands for a picture of its size whose pixels are as wide as those of the whole one.
  const double part_x = static_cast<double>(window_.size.width) / window_.full.width;
  const double part_y = static_cast<double>(window_.size.height) / window_.full.height;
  camera.fov_x = static_cast<float>(2 * std::atan(p.tan_x * part_x));
  camera.fov_y = static_cast<float>(2 * std::atan(p.tan_y * part_y));
  camera.near_plane = static_cast<float>(scene_.camera.near_plane);
  camera.far_plane = static_cast<float>(scene_.camera.far_plane);
  camera.reverse_depth = reverse_;
  camera.jitter = scene_jitter(number, options_.render, options_.output, options_.pattern);
  camera.exposure = static_cast<float>(exposure_at(scene_, poses.frame));
  // Rows of clip space: x, y, then depth * w and w = view z. The window is moved to the middle and
  // widened to the whole clip space.
  const double middle_x = (window_.x + window_.size.width / 2.0) / window_.full.width * 2 - 1;
  const double middle_y = 1 - (window_.y + window_.size.height / 2.0) / window_.full.height * 2;
  const Vec3 x = (pose.right * (1 / p.tan_x) - pose.forward * middle_x) * (1 / part_x);
  const Vec3 y = (pose.up * (1 / p.tan_y) - pose.forward * middle_y) * (1 / part_y);
  const Vec3 z = pose.forward * p.a;
  const auto row = [&](size_t index, const Vec3& axis, double constant) {
    camera.view_projection[index] = static_cast<float>(axis.x);
    camera.view_projection[4 + index] = static_cast<float>(axis.y);
    camera.view_projection[8 + index] = static_cast<float>(axis.z);
    camera.view_projection[12 + index] = static_cast<float>(constant - dot(axis, pose.eye));
  };
  row(0, x, 0);
  row(1, y, 0);
  row(2, z, p.b);
  row(3, pose.forward, 0);
  return camera;
}

Result<SourceFrame> SceneSource::frame(uint32_t index, bool with_truth) {
  if (index >= frames_)
    return bad_input(scene_.name, "frame {} is asked for, the sequence has {}", index, frames_);
  const uint32_t number = first_frame_ + index;
  const double step = frame_step(scene_, options_.frame_rate), scene_frame = number * step;
  const bool cut = index == 0 || is_camera_cut(scene_.camera, scene_frame, step);
  const FramePoses poses = frame_poses(scene_, scene_frame, !cut, step);
  SHALE_TRY(const FrameTables tables,
            frame_tables(scene_, poses, window_, reverse_, renderer_->max_texels()));
  SHALE_TRY_VOID(renderer_->set_frame(tables));
  SourceFrame frame;
  frame.camera = camera(number, poses);
  frame.camera.cut = cut;
  SampleGrid grid;
  grid.extent = render_;
  grid.origin_x = render_x_;
  grid.origin_y = render_y_;
  grid.scale_x = static_cast<double>(options_.output.width) / options_.render.width;
  grid.scale_y = static_cast<double>(options_.output.height) / options_.render.height;
  grid.jitter = frame.camera.jitter;
  SHALE_TRY(RenderedImages render, renderer_->render(grid, options_.keep_going));
  frame.color = std::move(render.color);
  frame.depth = std::move(render.depth);
  frame.motion = std::move(render.motion);
  if (!with_truth) return frame;
  SHALE_TRY(render, renderer_->render(output_grid(window_, kTruthSamples), options_.keep_going));
  frame.truth = std::move(render.color);
  frame.truth_depth = std::move(render.depth);
  frame.truth_motion = std::move(render.motion);
  return frame;
}

Result<RenderedImages> SceneSource::render_output(const Scene& scene, const FramePoses& poses,
                                                  uint32_t samples) {
  SHALE_TRY(const FrameTables tables,
            frame_tables(scene, poses, window_, reverse_, renderer_->max_texels()));
  SHALE_TRY_VOID(renderer_->set_frame(tables));
  return renderer_->render(output_grid(window_, samples), options_.keep_going);
}

Result<SceneMoment> SceneSource::moment(uint32_t index, double after, std::span<const double> to,
                                        bool with_truth) {
  if (index >= frames_ || !(after >= 0 && index + after <= frames_ - 1))
    return bad_input(scene_.name, "the moment {} is asked for, the sequence has {} frames",
                     index + after, frames_);
  const double step = frame_step(scene_, options_.frame_rate);
  const double scene_frame = (first_frame_ + index + after) * step;
  const auto poses_to = [&](double other) {
    return frame_poses(scene_, scene_frame, other != after, (after - other) * step);
  };
  SceneMoment moment;
  for (const double other : to) {
    SHALE_TRY(RenderedImages images, render_output(scene_, poses_to(other), 1));
    moment.motion.push_back(std::move(images.motion));
    moment.depth = std::move(images.depth);
  }
  const FramePoses poses = frame_poses(scene_, scene_frame, false, step);
  moment.camera = camera(first_frame_ + index, poses);
  if (!with_truth) return moment;
  if (!to.empty()) {
    FramePoses still = poses_to(to[0]);
    still.nodes_was = still.nodes;
    SHALE_TRY(RenderedImages images, render_output(scene_, still, 1));
    moment.still_motion = std::move(images.motion);
  }
  SHALE_TRY(RenderedImages images, render_output(scene_, poses, kTruthSamples));
  moment.truth = std::move(images.color);
  if (scene_.emitters.empty() && scene_.overlays.empty()) return moment;
  Scene bare = scene_;
  bare.emitters.clear();
  bare.overlays.clear();
  SHALE_TRY(images, render_output(bare, poses, kTruthSamples));
  moment.bare = std::move(images.color);
  return moment;
}

}  // namespace shale
