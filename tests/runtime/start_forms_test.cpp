// Kernels of the start and those that replace them. In these packages the two compute different things, so that results
// tell which of them ran.
#include <atomic>
#include <thread>

#include "runtime/datagraph/session.h"
#include "runtime/frame/frame_loop.h"
#include "tests/support/small_packages.h"
#include "tests/support/vulkan_fixture.h"

namespace shale {
namespace {

/// small_graph with start forms of "scale", which adds x to itself, and of "double", which multiplies by the weights. Its
/// modules lie there twice, or the pipelines would be the same.
Package start_graph() {
  enum : uint32_t { kX, kW, kA, kB, kC };
  Package package = small_graph();
  Variant& variant = package.variants[0];
  Segment& segment = variant.segments[0];
  const Spirv scale = variant.modules[0], add = variant.modules[2];
  variant.modules.insert(variant.modules.end(), {add, scale, add});
  segment.dispatches[2].module = 5;
  const auto reads = [](uint32_t number, uint32_t resource) {
    return Binding{.binding = number, .resource = resource, .reads = true};
  };
  const auto form = [&](uint32_t index, const char* kernel, uint32_t module, Binding other,
                        uint32_t from, uint32_t to) {
    Dispatch start = segment.dispatches[index];
    start.kernel = kernel;
    start.module = module;
    start.bindings = {reads(0, from), other, {.binding = 2, .resource = to, .writes = true}};
    segment.start_forms.push_back({index, start});
  };
  form(0, "add", 3, reads(1, kX), kX, kA);
  form(2, "scale", 4, reads(1, kW), kB, kC);
  return package;
}

std::vector<int8_t> result(const std::vector<int8_t>& x, bool scale_starts, bool double_starts) {
  constexpr std::array<int, 4> kWeights{1, -1, 2, 0};
  const auto scaled = [&](size_t i, size_t at) {
    return static_cast<int8_t>(scale_starts ? 2 * x[at] : x[at] * kWeights[i % 4]);
  };
  std::vector<int8_t> y(kSmallBytes);
  for (size_t i = 0; i < kSmallBytes; ++i) {
    const auto b = static_cast<int8_t>(scaled(i, i) + scaled(i, (i + 4) % kSmallBytes));
    const auto c = static_cast<int8_t>(double_starts ? b * kWeights[i % 4] : b + b);
    y[i] = static_cast<int8_t>(c + x[i]);
  }
  return y;
}

class StartFormsTest : public VulkanTest {
 protected:
  struct Run {
    DataGraphPipeline pipeline;
    std::vector<int8_t> values = random_int8(kSmallBytes, 1);
    vk::Buffer x = buffer_of(values), y = buffer_of(std::vector<int8_t>(kSmallBytes));
    Session session = new_session(*this);

    explicit Run(const Package& package, Compile compile)
        : pipeline(must(DataGraphPipeline::create(context(), package, {.compile = compile}))) {}
    std::vector<int8_t> next() {
      run([&](VkCommandBuffer commands) { must(session.record(commands)); });
      return int8_values(y, kSmallBytes);
    }
    std::vector<int8_t> expected(bool scale_starts, bool double_starts) const {
      return result(values, scale_starts, double_starts);
    }
  };
  static Session new_session(Run& run) {
    Session session = must(Session::create(run.pipeline));
    must(session.allocate_memory());
    must(session.bind_tensor("x", {run.x.get(), 0, kSmallBytes}));
    must(session.bind_tensor("y", {run.y.get(), 0, kSmallBytes}));
    return session;
  }
};

TEST_F(StartFormsTest, TheHostReplacesThemOneByOne) {
  Run own(start_graph(), Compile::kByHost);
  EXPECT_EQ(own.pipeline.kernels_left(), 2u);
  EXPECT_EQ(own.next(), own.expected(true, true));
  EXPECT_EQ(own.next(), own.expected(true, true));
  EXPECT_TRUE(must(own.pipeline.compile_one()));
  EXPECT_EQ(own.pipeline.kernels_left(), 1u);
  EXPECT_EQ(own.next(), own.expected(false, true));
  EXPECT_TRUE(must(own.pipeline.compile_one()));
  EXPECT_FALSE(must(own.pipeline.compile_one()));
  EXPECT_EQ(own.pipeline.kernels_left(), 0u);
  EXPECT_EQ(own.next(), own.expected(false, false));
}

TEST_F(StartFormsTest, ARecordTakesOneMoreThanTheOneBefore) {
  Run own(start_graph(), Compile::kByHost);
  while (must(own.pipeline.compile_one())) continue;
  EXPECT_EQ(own.next(), own.expected(false, true));
  Session other = new_session(own);  // what one session took, all have
  run([&](VkCommandBuffer commands) { must(other.record(commands)); });
  EXPECT_EQ(int8_values(own.y, kSmallBytes), own.expected(false, false));
}

TEST_F(StartFormsTest, AllThatIsWaitedForIsTaken) {
  for (const Compile compile : {Compile::kByHost, Compile::kInBackground}) {
    Run own(start_graph(), compile);
    must(own.pipeline.finish());
    EXPECT_EQ(own.pipeline.kernels_left(), 0u);
    EXPECT_EQ(own.next(), own.expected(false, false));
  }
}

TEST_F(StartFormsTest, NoneServesWhereAllIsCompiledAtOnce) {
  Run own(start_graph(), Compile::kAtOnce);
  EXPECT_EQ(own.pipeline.kernels_left(), 0u);
  EXPECT_FALSE(must(own.pipeline.compile_one()));
  must(own.pipeline.finish());
  EXPECT_EQ(own.next(), own.expected(false, false));
}

TEST_F(StartFormsTest, NoneServesForAPipelineThatIsThereAnyway) {
  Package package = start_graph();
  package.variants[0].segments[0].dispatches[2].module = 2;  // that of "sum"
  Run own(package, Compile::kByHost);
  EXPECT_EQ(own.pipeline.kernels_left(), 1u);
  EXPECT_EQ(own.next(), own.expected(true, false));
}

TEST_F(StartFormsTest, EndsWhileItCompiles) {
  for (int i = 0; i < 8; ++i) {
    Run own(start_graph(), Compile::kInBackground);
    if (i % 2) {
      EXPECT_EQ(own.next().size(), kSmallBytes);
    }
  }
}

TEST_F(StartFormsTest, SessionsRecordWhileOthersCompile) {
  Run own(start_graph(), Compile::kByHost);
  std::atomic<bool> done = false;
  const auto record = [&] {
    const vk::Context& device = context();
    auto info = vk::init<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
    info.queueFamilyIndex = device.queue_family;
    const auto pool = must(vk::make(device.vk.CreateCommandPool, device.vk.DestroyCommandPool,
                                    "vkCreateCommandPool", device.device, info));
    auto buffers =
        vk::init<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
    buffers.commandPool = pool.get();
    buffers.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
    buffers.commandBufferCount = 1;
    Session session = new_session(own);
    bool last = false;
    do {
      last = done;
      VkCommandBuffer commands = VK_NULL_HANDLE;
      must(vk::check(device.vk.AllocateCommandBuffers(device.device, &buffers, &commands), ""));
      const auto begin =
          vk::init<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
      must(vk::check(device.vk.BeginCommandBuffer(commands, &begin), ""));
      must(session.record(commands));
      must(vk::check(device.vk.EndCommandBuffer(commands), ""));
    } while (!last);
  };
  std::thread first(record), second(record);
  std::thread compiler([&] { EXPECT_TRUE(must(own.pipeline.compile_one())); });
  EXPECT_TRUE(must(own.pipeline.compile_one()));
  compiler.join();
  done = true;
  first.join();
  second.join();
  must(own.pipeline.finish());
  EXPECT_EQ(own.next(), own.expected(false, false));
}

TEST_F(StartFormsTest, FramesGoOnAsIfNothingHadChanged) {
  Package package = small_frame();
  Variant& variant = package.variants[0];
  variant.modules.push_back(variant.modules[1]);
  variant.segments[1].start_forms.push_back({0, variant.segments[1].dispatches[0]});
  variant.segments[1].start_forms[0].form.module = 3;
  for (const Compile compile : {Compile::kByHost, Compile::kInBackground}) {
    FrameLoop loop =
        must(FrameLoop::create(context(), package, {.frames_in_flight = 2, .compile = compile}));
    SmallFrameModel model;
    for (uint64_t frame = 0; frame < 8; ++frame) {
      const std::vector<uint8_t> texels = random_bytes(kSmallBytes, frame);
      const vk::Image in = image_of(ImageFormat::kRgba8Unorm, {kSmallWidth, kSmallHeight}, texels),
                      out = image_of(ImageFormat::kRgba8Unorm, {kSmallWidth, kSmallHeight}, {});
      const auto view = [](const vk::Image& image) {
        return ImageView{image.view(), VK_FORMAT_R8G8B8A8_UNORM, image.extent()};
      };
      must(loop.bind_image("color", view(in)));
      must(loop.bind_image("shown", view(out)));
      run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
      EXPECT_EQ(texels_of(out, ImageFormat::kRgba8Unorm), model.next(texels)) << "frame " << frame;
      if (frame == 3 && compile == Compile::kByHost) {
        EXPECT_EQ(loop.kernels_left(), 1u);
        EXPECT_TRUE(must(loop.compile_one()));
      }
    }
    must(loop.finish());
    EXPECT_EQ(loop.kernels_left(), 0u);
  }
}

}  // namespace
}  // namespace shale
