// What a loop does to its host's queue: nothing at creation, and two frames at once.
#include "runtime/frame/frame_loop.h"
#include "tests/support/small_packages.h"
#include "tests/support/vulkan_fixture.h"

namespace shale {
namespace {

constexpr VkExtent2D kExtent{kSmallWidth, kSmallHeight};
constexpr ImageFormat kFormat = ImageFormat::kRgba8Unorm;

class InFlightTest : public VulkanTest {
 protected:
  static ImageView view_of(const vk::Image& image) {
    return {image.view(), vk::vk_format(kFormat), image.extent()};
  }
};

int queue_uses = 0;

/// As a host's context: without a queue, and with whatever touches one counted.
vk::Context counting(vk::Context context) {
  queue_uses = 0;
  context.queue = VK_NULL_HANDLE;
  context.vk.QueueSubmit = [](VkQueue, uint32_t, const VkSubmitInfo*, VkFence) {
    ++queue_uses;
    return VK_ERROR_DEVICE_LOST;
  };
  context.vk.WaitForFences = [](VkDevice, uint32_t, const VkFence*, VkBool32, uint64_t) {
    ++queue_uses;
    return VK_ERROR_DEVICE_LOST;
  };
  context.vk.GetDeviceQueue = [](VkDevice, uint32_t, uint32_t, VkQueue* queue) {
    ++queue_uses;
    *queue = VK_NULL_HANDLE;
  };
  return context;
}

TEST_F(InFlightTest, NothingIsSubmittedByALoop) {
  const std::optional<vk::Context> discrete = discrete_context();
  for (const vk::Context* place : {&context(), discrete ? &*discrete : nullptr}) {
    if (!place) GTEST_SKIP() << "needs a device with a single memory type";
    FrameLoop loop = must(FrameLoop::create(counting(*place), small_frame()));
    const MemoryUse use = loop.memory_use();
    EXPECT_GE(use.weights, 260u);
    EXPECT_GE(use.tensors, 2 * kSmallBytes);
    EXPECT_GE(use.images, 4 * kSmallBytes);  // "blend" and three of "history"
    EXPECT_EQ(use.staging > 0, place != &context());
    SmallFrameModel model;
    for (uint64_t frame = 0; frame < 4; ++frame) {
      const std::vector<uint8_t> texels = random_bytes(kSmallBytes, frame);
      const vk::Image in = image_of(kFormat, kExtent, texels);
      const vk::Image out = image_of(kFormat, kExtent, {});
      must(loop.bind_image("color", view_of(in)));
      must(loop.bind_image("shown", view_of(out)));
      run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
      EXPECT_EQ(texels_of(out, kFormat), model.next(texels)) << "frame " << frame;
      // Two are in flight: the third record shows that the first is finished.
      EXPECT_EQ(loop.memory_use().staging, frame < 2 ? use.staging : 0);
    }
    EXPECT_EQ(queue_uses, 0);
  }
}

TEST_F(InFlightTest, SessionsUploadInTheFirstRecordOfAll) {
  const std::optional<vk::Context> discrete = discrete_context();
  if (!discrete) GTEST_SKIP() << "needs a device with a single memory type";
  auto pipeline = must(DataGraphPipeline::create(counting(*discrete), small_graph()));
  for (uint64_t seed = 0; seed < 3; ++seed) {
    Session session = must(Session::create(pipeline));
    must(session.allocate_memory());
    const std::vector<int8_t> x = random_int8(kSmallBytes, seed);
    const vk::Buffer in = buffer_of(x), out = buffer_of(std::vector<int8_t>(kSmallBytes));
    must(session.bind_tensor("x", {in.get(), 0, kSmallBytes}));
    must(session.bind_tensor("y", {out.get(), 0, kSmallBytes}));
    run([&](VkCommandBuffer commands) { must(session.record(commands)); });
    EXPECT_EQ(int8_values(out, kSmallBytes), small_graph_result(x));
    if (seed == 0) pipeline.release_staging();
  }
  EXPECT_EQ(queue_uses, 0);
}

/// Command buffers that are submitted without a wait, and a gate at the start of the first.
class Frames {
 public:
  Frames(const vk::Context& context, uint32_t count) : context_(context) {
    auto pool = vk::init<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
    pool.queueFamilyIndex = context.queue_family;
    EXPECT_EQ(vkCreateCommandPool(context.device, &pool, nullptr, &pool_), VK_SUCCESS);
    const auto event = vk::init<VkEventCreateInfo>(VK_STRUCTURE_TYPE_EVENT_CREATE_INFO);
    EXPECT_EQ(vkCreateEvent(context.device, &event, nullptr, &gate_), VK_SUCCESS);
    auto buffers =
        vk::init<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
    buffers.commandPool = pool_;
    buffers.commandBufferCount = count;
    commands_.resize(count);
    EXPECT_EQ(vkAllocateCommandBuffers(context.device, &buffers, commands_.data()), VK_SUCCESS);
    fences_.resize(count);
    const auto fence = vk::init<VkFenceCreateInfo>(VK_STRUCTURE_TYPE_FENCE_CREATE_INFO);
    for (VkFence& each : fences_)
      EXPECT_EQ(vkCreateFence(context.device, &fence, nullptr, &each), VK_SUCCESS);
  }
  ~Frames() {
    for (VkFence fence : fences_) vkDestroyFence(context_.device, fence, nullptr);
    vkDestroyEvent(context_.device, gate_, nullptr);
    vkDestroyCommandPool(context_.device, pool_, nullptr);
  }

  VkCommandBuffer begin(size_t frame) {
    const auto info =
        vk::init<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
    EXPECT_EQ(vkBeginCommandBuffer(commands_[frame], &info), VK_SUCCESS);
    if (frame == 0)
      vkCmdWaitEvents(commands_[0], 1, &gate_, VK_PIPELINE_STAGE_HOST_BIT,
                      VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, nullptr, 0, nullptr, 0, nullptr);
    return commands_[frame];
  }
  void submit(size_t frame) {
    EXPECT_EQ(vkEndCommandBuffer(commands_[frame]), VK_SUCCESS);
    auto info = vk::init<VkSubmitInfo>(VK_STRUCTURE_TYPE_SUBMIT_INFO);
    info.commandBufferCount = 1;
    info.pCommandBuffers = &commands_[frame];
    EXPECT_EQ(vkQueueSubmit(context_.queue, 1, &info, fences_[frame]), VK_SUCCESS);
  }
  bool pending(size_t frame) const {
    return vkGetFenceStatus(context_.device, fences_[frame]) == VK_NOT_READY;
  }
  void open() { EXPECT_EQ(vkSetEvent(context_.device, gate_), VK_SUCCESS); }
  void wait(size_t frame) {
    EXPECT_EQ(vkWaitForFences(context_.device, 1, &fences_[frame], VK_TRUE, 60'000'000'000),
              VK_SUCCESS);
  }

 private:
  const vk::Context& context_;
  VkCommandPool pool_ = VK_NULL_HANDLE;
  VkEvent gate_ = VK_NULL_HANDLE;
  std::vector<VkCommandBuffer> commands_;
  std::vector<VkFence> fences_;
};

TEST_F(InFlightTest, TwoFramesArePendingAtOnce) {
  constexpr size_t kFrames = 7;
  const std::optional<vk::Context> discrete = discrete_context();
  // With and without an upload in the first frame.
  for (const vk::Context* place : {&context(), discrete ? &*discrete : nullptr}) {
    if (!place) GTEST_SKIP() << "needs a device with a single memory type";
    FrameLoop loop =
        must(FrameLoop::create(counting(*place), small_frame(), {.frames_in_flight = 2}));
    std::vector<std::vector<uint8_t>> texels;
    std::vector<vk::Image> ins, outs;
    for (uint64_t frame = 0; frame < kFrames; ++frame) {
      texels.push_back(random_bytes(kSmallBytes, 50 + frame));
      ins.push_back(image_of(kFormat, kExtent, texels.back()));
      outs.push_back(image_of(kFormat, kExtent, {}));
    }
    Frames frames(context(), kFrames);
    for (size_t frame = 0; frame < kFrames; ++frame) {
      if (frame >= 2) frames.wait(frame - 2);
      must(loop.bind_image("color", view_of(ins[frame])));
      must(loop.bind_image("shown", view_of(outs[frame])));
      must(loop.record(frames.begin(frame)));
      frames.submit(frame);
      if (frame != 1) continue;
      EXPECT_TRUE(frames.pending(0));
      EXPECT_TRUE(frames.pending(1));
      frames.open();
    }
    frames.wait(kFrames - 1);
    frames.wait(kFrames - 2);
    SmallFrameModel model;
    for (size_t frame = 0; frame < kFrames; ++frame)
      EXPECT_EQ(texels_of(outs[frame], kFormat), model.next(texels[frame])) << "frame " << frame;
  }
}

}  // namespace
}  // namespace shale
