// runtime/frame/frame_loop.h -- a network between frame passes: host images in, host images out,
// with history. What passes and images there are is all read from the package.
#pragma once

#include <vulkan/vulkan.h>

#include <memory>
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
  /// How many recorded frames may be unfinished at once: before frame t is recorded, frame
  /// t - frames_in_flight must have been finished by the device. 1 to 8.
  uint32_t frames_in_flight = 2;
  /// As in DataGraphPipelineOptions.
  VkPipelineCache cache = VK_NULL_HANDLE;
};

/// Owns the pipelines, weights, intermediate tensors, graph inputs and outputs, internal images and
/// the rings of history images; the host owns the device, the images it binds, and the command
/// buffers. The device must outlive the loop, and the loop the work that was recorded.
///
/// Rules for the host:
///  - One thread at a time. Each recorded frame is submitted once, in the order of recording, to
///    one queue of the context's family.
///  - Bound images are in VK_IMAGE_LAYOUT_GENERAL while a frame runs, and stay in it.
///  - Before: input images must be visible to VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT /
///    VK_ACCESS_SHADER_READ_BIT, and earlier uses of output images must have ended before that
///    stage.
///  - After: output images are written by VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT /
///    VK_ACCESS_SHADER_WRITE_BIT.
///    Both hold where the package copies an image, too.
///  - Barriers within a frame and between the frames of a loop are the loop's.
///
/// History: in frame t a ring of depth n is written at slot t mod n; what a package calls k frames
/// back is slot (t - k) mod n. A ring starts out as zeros.
///
/// Descriptors: each of frames_in_flight x (least common multiple of the depths) consecutive frames
/// has descriptor sets of its own, which are written when they are first needed and again only
/// after bind_image; hence images may be bound between any two frames, and steady frames write
/// none.
class FrameLoop {
 public:
  /// Takes the best variant that the device meets (rank.h); `package` may go afterwards. Uses the context's
  /// queue.
  /// Errors: kBadInput if check_package refuses the package or the options are out of range;
  /// kUnsupported if the depths of the histories have a common multiple above 64 only; kDevice if
  /// the device meets no variant (what is missing is told for each), lacks an image format, is out
  /// of memory, or refuses a shader.
  static Result<FrameLoop> create(const vk::Context& context, const Package& package,
                                  const FrameLoopOptions& options = {});
  FrameLoop(FrameLoop&&) noexcept;
  FrameLoop& operator=(FrameLoop&&) noexcept;
  ~FrameLoop();

  /// The chosen variant, without the words of its modules. Its resources of category kImageInput
  /// and kImageOutput are what the host binds.
  const Variant& variant() const;

  /// Usage that an image of the host must have: VK_IMAGE_USAGE_SAMPLED_BIT, _STORAGE_BIT,
  /// _TRANSFER_SRC_BIT and _TRANSFER_DST_BIT, as the package uses it. 0 for other names.
  VkImageUsageFlags image_usage(std::string_view name) const;

  /// Names the image for the frames recorded from now on.
  /// Errors: kBadInput if the package has no input or output image of that name, the format or
  /// extent differs, or a handle is missing.
  Result<void> bind_image(std::string_view name, const ImageView& image);

  /// Sets a parameter of the package's passes for the frames recorded from now on. Integers are
  /// given as whole numbers.
  /// Errors: kBadInput if the host sets no parameter of that name, the number of values differs, a
  /// value is not finite, or an integer is not exact.
  Result<void> set_param(std::string_view name, std::span<const float> values);

  /// The next recorded frame finds all histories and network outputs zero, as after a scene cut,
  /// and the package's reset parameter 1. The first frame is such a frame.
  void reset_history();

  /// Adds one frame to a command buffer that is being recorded, outside of a render pass, and moves
  /// the histories on. Changes its bound compute pipeline and set 0. `timestamps` gains an interval
  /// for each dispatch of all segments; it may be null.
  /// Errors: kBadInput, naming the image that is not bound yet; kDevice. The frame then does not
  /// count.
  Result<void> record(VkCommandBuffer commands, vk::Timestamps* timestamps = nullptr);

  /// Number of frames recorded so far.
  uint64_t frame() const;

  /// Where a graph input or output lies, for hosts that fill or read one themselves; inputs that no
  /// pass writes have to be filled. The buffer allows transfers. Its barriers are then the host's,
  /// as for images. Also where a linear image lies, as image() says of others.
  /// Errors: kBadInput if no graph input or output and no linear image has that name.
  Result<TensorView> tensor(std::string_view name) const;

  /// An image of the loop's own as the last recorded frame left it, in VK_IMAGE_LAYOUT_GENERAL; of
  /// a history the one that it wrote. For debugging: it allows transfers from it.
  /// Errors: kBadInput if no internal or history image has that name, it is linear, or no pass uses
  /// it.
  Result<VkImage> image(std::string_view name) const;

 private:
  struct State;
  explicit FrameLoop(std::unique_ptr<State> state);

  std::unique_ptr<State> state_;
};

}  // namespace shale
