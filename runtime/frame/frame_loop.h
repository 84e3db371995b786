// runtime/frame/frame_loop.h -- a network between frame passes: host images in, host images out,
// with history. What passes and images there are is all read from the package.
#pragma once

#include <vulkan/vulkan.h>

#include <memory>
#include <optional>
#include <span>
#include <string_view>

#include "ir/package/package.h"
#include "runtime/datagraph/session.h"
#include "runtime/vk/device.h"
#include "runtime/vk/timestamps.h"

namespace shale {

/// A host's image. The view is two-dimensional, with one level and layer and no swizzle, of the
/// first level and layer of the image, which has the usage that FrameLoop::image_usage tells.
struct ImageView {
  VkImageView view = VK_NULL_HANDLE;  ///< needed where that is sampled or storage
  VkFormat format = VK_FORMAT_UNDEFINED;
  VkExtent2D extent{};
  VkImage image = VK_NULL_HANDLE;  ///< needed where that is a transfer
};

struct FrameLoopOptions {
  /// How many records of a program may be unfinished at once: before one is recorded, the one
  /// frames_in_flight records of that program before it must have been finished by the device. 1 to
  /// 8.
  uint32_t frames_in_flight = 2;
  /// As in DataGraphPipelineOptions.
  VkPipelineCache cache = VK_NULL_HANDLE;
  Compile compile = Compile::kAtOnce;
  uint32_t threads = 0;
};

/// What a loop takes of the device's memory, in bytes.
struct MemoryUse {
  uint64_t weights = 0;
  uint64_t arena = 0;    ///< intermediate tensors, of all programs together
  uint64_t tensors = 0;  ///< inputs and outputs of graphs, with their histories
  uint64_t images = 0;   ///< internal ones and histories
  uint64_t staging = 0;  ///< visible to the host, until the weights are where they belong
  uint64_t total() const { return weights + arena + tensors + images + staging; }
};

/// Owns the pipelines, weights, intermediate tensors, graph inputs and outputs, internal images and
/// the rings of histories; the host owns the device, its queues, the images it binds, and the
/// command buffers. The device must outlive the loop, and the loop the work that was recorded.
///
/// Rules for the host:
///  - One thread at a time. What is recorded is submitted once, in the order of recording, to one
///    queue of the context's family.
///  - Bound images are in VK_IMAGE_LAYOUT_GENERAL while a frame runs, and stay in it.
///  - Before: input images must be visible to VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT /
///    VK_ACCESS_SHADER_READ_BIT, and earlier uses of output images must have ended before that
///    stage.
///  - After: output images are written by VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT /
///    VK_ACCESS_SHADER_WRITE_BIT.
///    Both hold where the package copies an image, too.
///  - Barriers within a record and between the records of a loop are the loop's.
///
/// Networks that work by tiles (Tiles in package.h) run whole in the first record of their program, in the first one behind
/// reset_history, and where another program wrote their outputs meanwhile.
///
/// Programs and histories: as package.h says of Variant. Tensors and images are shared by all
/// programs of the package.
///
/// The loop itself submits nothing. What has to happen once on the device (weights to memory that
/// the host cannot write, first image layouts, zeros in the histories) is part of the first record.
/// The weights' staging memory is freed in the record that, by the rule of frames_in_flight, shows
/// that the first one is finished.
///
/// Descriptors: a program has frames_in_flight descriptor sets for each of its dispatches that lead
/// to host images or histories, written again in a record where they lead elsewhere than in their
/// last one; hence images may be bound between any two records.
class FrameLoop {
 public:
  /// Takes the best variant that the device meets (rank.h); `package` may go afterwards. Uses no queue.
  /// Errors: kBadInput if check_package refuses the package or the options are out of range;
  /// kDevice if the device meets no variant (what is missing is told for each), lacks an image
  /// format, is out of memory, or refuses a shader.
  static Result<FrameLoop> create(const vk::Context& context, const Package& package,
                                  const FrameLoopOptions& options = {});
  FrameLoop(FrameLoop&&) noexcept;
  FrameLoop& operator=(FrameLoop&&) noexcept;
  ~FrameLoop();

  /// The chosen variant, without the words of its modules. Its resources of category kImageInput
  /// and kImageOutput are what the host binds, its programs what the host records.
  const Variant& variant() const;

  /// Usage that an image of the host must have: VK_IMAGE_USAGE_SAMPLED_BIT, _STORAGE_BIT,
  /// _TRANSFER_SRC_BIT and _TRANSFER_DST_BIT, as the package uses it. 0 for other names.
  VkImageUsageFlags image_usage(std::string_view name) const;

  /// Names the image for what is recorded from now on.
  /// Errors: kBadInput if the package has no input or output image of that name, the format or
  /// extent differs, or a handle is missing.
  Result<void> bind_image(std::string_view name, const ImageView& image);

  /// Sets a parameter of the package's passes for what is recorded from now on. Integers are given
  /// as whole numbers.
  /// Errors: kBadInput if the host sets no parameter of that name, the number of values differs, a
  /// value is not finite, or an integer is not exact.
  Result<void> set_param(std::string_view name, std::span<const float> values);

  /// The next record finds all histories and network outputs zero, as after a scene cut; and the
  /// package's reset parameter is 1 in each program's next record, or where a parameter chooses
  /// among them, in the next record. The first records are such ones.
  void reset_history();

  /// The program that a record without a name takes: the package's only one, the one that its
  /// parameter chooses (Variant::chosen_by) as it is now, or that which renders where the other one
  /// generates. None where the host has to name one.
  std::optional<uint32_t> next_program() const;

  /// Adds next_program() to a command buffer that is being recorded, outside of a render pass, and
  /// moves the histories on. Changes its bound compute pipeline and set 0.
  /// `timestamps` gains an interval for each dispatch; it may be null.
  /// Errors: kBadInput, naming the image that is not bound yet, if there is no next program, or if
  /// the timestamps hold too few intervals; kDevice. Nothing was recorded then, and it does not
  /// count.
  Result<void> record(VkCommandBuffer commands, vk::Timestamps* timestamps = nullptr);

  /// The same with a program by its name, or by its index in Variant::programs.
  /// Errors: also kBadInput if there is no such program, or it generates.
  Result<void> record(std::string_view program, VkCommandBuffer commands,
                      vk::Timestamps* timestamps = nullptr);
  Result<void> record(uint32_t program, VkCommandBuffer commands,
                      vk::Timestamps* timestamps = nullptr);

  /// Adds the program that makes a picture between rendered frames, or beyond them
  /// (Variant::generator), from what the last records left in the histories; these stay as they
  /// are. It writes the output images that are bound now, which may be others than those of the
  /// rendered frame. Where the histories hold one frame only, as behind a cut, the picture is that
  /// frame. How a host paces N pictures for each rendered frame: generated_time(*generator, k, N);
  /// if the generator waits(), they are shown before the newest rendered frame, else behind it.
  /// Errors: as record; also kBadInput if no program generates, it takes no such time, or no frame
  /// was rendered since the histories were reset.
  Result<void> generate(float time, VkCommandBuffer commands, vk::Timestamps* timestamps = nullptr);

  /// Of a program that runs only what changed, network or passes, the share of its predicted time that a record took, 0 to 1:
  /// that of the last record, or of the one `records_ago` of the same program before it. The device must have finished it, and
  /// fewer than frames_in_flight records of the program must lie behind it. Nothing where all runs in every frame or there was
  /// no such record.
  std::optional<double> share_run(uint32_t records_ago = 0) const;

  /// Number of records so far, of all programs.
  uint64_t frame() const;

  MemoryUse memory_use() const;

  /// As those of DataGraphPipeline, and as there compile_one from any thread.
  size_t kernels_left() const;
  Result<bool> compile_one();
  Result<void> finish();

  /// Where a graph input or output lies, for hosts that fill or read one themselves; inputs that no
  /// pass writes have to be filled. Of a history the newest slot that was written. The buffer
  /// allows transfers. Its barriers are then the host's, as for images. Also where a linear image
  /// lies, as image() says of others.
  /// Errors: kBadInput if no graph input or output and no linear image has that name.
  Result<TensorView> tensor(std::string_view name) const;

  /// An image of the loop's own as the last record left it, in VK_IMAGE_LAYOUT_GENERAL; of a
  /// history the newest one that was written. For debugging, and after the first record: it allows
  /// transfers from it.
  /// Errors: kBadInput if no internal or history image has that name, it is linear, or no pass uses
  /// it.
  Result<VkImage> image(std::string_view name) const;

 private:
  struct State;
  explicit FrameLoop(std::unique_ptr<State> state);

  std::unique_ptr<State> state_;
};

}  // namespace shale
