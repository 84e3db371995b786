// tools/shale/player.h -- a sandwich on a device of the tool's own: frames in, pictures out, and a look
// at everything between.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "ir/base/sampling_pattern.h"
#include "ir/graph/tensor.h"
#include "runtime/frame/frame_loop.h"
#include "runtime/vk/memory.h"
#include "tools/scene/frame_source.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/picture.h"

namespace shale {

/// A sandwich to play, and its network as the model file has it where that is at hand.
struct Sandwich {
  std::string name;
  Package package;
  SamplingPattern pattern{};     ///< that it is made for; of a package not known
  std::optional<Frame> frame{};  ///< what frame.json says; of a package not known
  /// Before the passes: one, or where a parameter chooses among programs, the one of each. None for
  /// a package, or without a network.
  std::vector<Graph> graphs;
};

/// Sizes of the images color and output.
/// Errors: kBadInput if the variant has no such images.
Result<std::pair<Extent, Extent>> sandwich_sizes(const Variant& variant);

/// Takes a package as it is, or compiles a model for the sizes, where they are given; with another frame in place of the
/// model's where `change` makes one of it.
/// Errors: kBadInput, naming the file, if there is no sandwich; those of compiling and of `change`; kUnsupported for a
/// package that is to be changed.
Result<Sandwich> load_sandwich(const std::string& path, const CompileArguments& arguments,
                               std::optional<Extent> render, std::optional<Extent> output,
                               Result<Frame> (*change)(Frame frame) = nullptr);

/// Whether a program runs a network.
bool has_network(const Variant& variant, uint32_t program);

class Player {
 public:
  /// `device` must outlive the player. Known image names are color, depth, motion (inputs) and
  /// output; color and output may be rgba8_unorm, which holds pictures as a display shows them, or a
  /// float format, which holds linear HDR.
  /// Errors: kBadInput without a sandwich, kUnsupported for other images, kDevice.
  static Result<std::unique_ptr<Player>> create(const ToolDevice& device, const Package& package,
                                                Compile compile = Compile::kAtOnce);

  Extent render_size() const { return extent_of("color"); }
  Extent output_size() const { return extent_of("output"); }
  /// True if frames go in and out as a display shows them.
  bool is_display() const;
  const Variant& variant() const { return loop_.variant(); }
  /// The program that the last frame or generated picture ran, and whether it has a network.
  uint32_t program() const { return program_; }
  bool ran_network() const { return has_network(variant(), program_); }
  /// Whether the last frame kept the package's promise, so that the passes of kept promises made it, or took the full
  /// ones; nothing without a promise.
  std::optional<bool> kept_promise() const { return kept_promise_; }
  /// FrameLoop::kernels_left.
  size_t kernels_left() const { return loop_.kernels_left(); }
  /// FrameLoop::share_run of the last frame.
  std::optional<double> share_run() const { return loop_.share_run(); }

  /// The next frame starts without a past. Frames with a cut do so themselves.
  void reset();

  /// Plays one frame; the result has 3 channels at output size, of one channel grey, of two without
  /// blue: display values in [0, 1] if is_display(), else linear. `times` gains the dispatches. Of `frame`, color holds display values
  /// if is_display(); images that the sandwich does not take may be empty.
  /// Errors: kBadInput if a size differs from the package's or an image is missing; kDevice.
  Result<FloatImage> play(const SourceFrame& frame, std::vector<DispatchTime>* times = nullptr);

  /// play() of a scene's frame, whose color is linear; the result is what a display shows of it, in
  /// 8-bit steps. `frame` is changed to what the sandwich took.
  Result<FloatImage> show(SourceFrame& frame, std::vector<DispatchTime>* times = nullptr);

  /// A picture at a time between the frames that were played last, or beyond them, as play() gives
  /// frames; or as show() does, with the newest frame's exposure.
  /// Errors: as FrameLoop::generate.
  Result<FloatImage> generate(float time, std::vector<DispatchTime>* times = nullptr);
  Result<FloatImage> show_generated(float time, std::vector<DispatchTime>* times = nullptr);

  /// Runs the frame that was played last again, with what it left as its past, and without a look at
  /// the result: for times that nothing between the frames disturbs.
  Result<void> run(std::vector<DispatchTime>* times);

  /// play() on a frame that leaves no trace: drivers may compile a shader at its first dispatch.
  Result<void> warm_up(const SourceFrame& frame);

  /// An image after the last frame (integers as their values), or a graph input or output of
  /// NHWC [1,h,w,c], int8 codes as real values if `real` and its quantization is known.
  /// Errors: kBadInput if there is nothing of that name to read; kDevice.
  Result<FloatImage> read(const std::string& name, bool real) const;

  /// The bytes of a graph input or output after the last frame.
  Result<Tensor> read_tensor(const std::string& name) const;

  /// An image of format r32_uint after the last frame, as int32 [height, width]: all bits, which read() rounds to floats.
  /// Errors: kBadInput if there is none of that name; kDevice.
  Result<Tensor> read_words(const std::string& name) const;

  /// The package's views of the last frame as panels.
  Result<std::vector<Panel>> views() const;

 private:
  struct HostImage {
    const Resource* resource;
    vk::Image image;
    vk::Buffer staging;  ///< filled before a frame, or read after it
  };
  Player(const vk::Context& context, FrameLoop loop, std::string compiles)
      : context_(context), loop_(std::move(loop)), compiles_(std::move(compiles)) {}

  Result<void> make_images();
  Result<void> upload(const SourceFrame& frame);
  /// Records and runs a program, and downloads the output. `record` is FrameLoop's.
  Result<void> submit(uint32_t program,
                      const std::function<Result<void>(VkCommandBuffer, vk::Timestamps*)>& record,
                      std::vector<DispatchTime>* times);
  FloatImage output_picture() const;
  Result<void> set_params(const FrameCamera& camera);
  Extent extent_of(const std::string& name) const;
  /// Of an image, row after row.
  Result<std::vector<uint8_t>> texels(const Resource& image) const;
  const Resource* resource(const std::string& name) const;

  const vk::Context& context_;
  FrameLoop loop_;
  std::map<std::string, HostImage> images_;
  std::array<float, 2> previous_jitter_{};
  float exposure_ = 1;  ///< of the last frame
  bool has_past_ = false;
  uint32_t program_ = 0;
  std::optional<bool> kept_promise_;
  std::string compiles_;  ///< what the first frame waits for; empty after it
};

/// The network's outputs of the last frame or generated picture against the interpreter's, from the same inputs: what differs
/// first, or nothing. `graphs` are a Sandwich's, at least one; Player::ran_network().
/// Errors: as check_outputs and Player::read_tensor; kBadInput if the user interrupts.
Result<std::optional<std::string>> network_difference(const Player& player,
                                                      const std::vector<Graph>& graphs);

/// Texels of an image, as they lie in a buffer, to floats and back. `channels` of `from` that a
/// format lacks are dropped; what it lacks itself is 0, alpha 1.
FloatImage unpack_texels(std::span<const uint8_t> bytes, ImageFormat format, Extent extent);
void pack_texels(const FloatImage& from, ImageFormat format, std::span<uint8_t> bytes);

}  // namespace shale
