#include <array>
#include <cstring>
#include <deque>
#include <limits>

#include "runtime/datagraph/session.h"
#include "runtime/frame/frame_loop.h"
#include "runtime/profile/profile.h"
#include "tests/support/small_packages.h"
#include "tests/support/vulkan_fixture.h"

namespace shale {
namespace {

constexpr VkExtent2D kExtent{kSmallWidth, kSmallHeight};
constexpr VkPipelineStageFlags kCompute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
constexpr VkPipelineStageFlags kTransfer = VK_PIPELINE_STAGE_TRANSFER_BIT;

class ProgramsTest : public VulkanTest {
 protected:
  /// Fills "x", records and gives the values of `name` afterwards.
  static std::vector<int8_t> run_program(FrameLoop& loop, std::string_view program,
                                         const std::vector<int8_t>& x, const char* name) {
    const vk::Buffer in = buffer_of(x);
    const vk::Buffer out = buffer_of(std::vector<int8_t>(kSmallBytes));
    const TensorView to = must(loop.tensor("x"));
    run([&](VkCommandBuffer commands) {
      const VkBufferCopy fill{0, to.offset, kSmallBytes};
      vkCmdCopyBuffer(commands, in.get(), to.buffer, 1, &fill);
      vk::memory_barrier(context(), commands, kTransfer, VK_ACCESS_TRANSFER_WRITE_BIT, kCompute,
                         VK_ACCESS_SHADER_READ_BIT);
      must(loop.record(program, commands));
      vk::memory_barrier(context(), commands, kCompute, VK_ACCESS_SHADER_WRITE_BIT, kTransfer,
                         VK_ACCESS_TRANSFER_READ_BIT);
      const TensorView from = must(loop.tensor(name));
      const VkBufferCopy take{from.offset, 0, kSmallBytes};
      vkCmdCopyBuffer(commands, from.buffer, out.get(), 1, &take);
    });
    return int8_values(out, kSmallBytes);
  }
};

/// small_programs in plain C++.
class Model {
 public:
  std::vector<int8_t> frame(const std::vector<int8_t>& x) {
    constexpr std::array<int, 4> kWeights{1, -1, 2, 0};
    std::vector<int8_t> y(kSmallBytes);
    for (size_t i = 0; i < y.size(); ++i) y[i] = static_cast<int8_t>(x[i] * kWeights[i % 4]);
    ring_.push_front(y);
    ring_.pop_back();
    return sum(0, 2);
  }
  std::vector<int8_t> between() const { return sum(0, 1); }
  const std::vector<int8_t>& newest() const { return ring_[0]; }
  void reset() { *this = {}; }

 private:
  std::vector<int8_t> sum(size_t a, size_t b) const {
    std::vector<int8_t> values(kSmallBytes);
    for (size_t i = 0; i < values.size(); ++i)
      values[i] = static_cast<int8_t>(ring_[a][i] + ring_[b][i]);
    return values;
  }
  std::deque<std::vector<int8_t>> ring_{3, std::vector<int8_t>(kSmallBytes)};
};

TEST_F(ProgramsTest, ShareAHistoryThatOneOfThemWrites) {
  for (const uint32_t frames_in_flight : {1u, 2u, 5u}) {
    FrameLoop loop = must(
        FrameLoop::create(context(), small_programs(), {.frames_in_flight = frames_in_flight}));
    Model model;
    uint64_t seed = 1;
    // 'b' is the program that only reads, 'r' a reset; the ring goes round several times.
    for (const char step : std::string("bffbbfbfffbfrbffbfff")) {
      const std::vector<int8_t> x = random_int8(kSmallBytes, seed++);
      if (step == 'r') {
        loop.reset_history();
        model.reset();
      } else if (step == 'f') {
        const std::vector<int8_t> expected = model.frame(x);
        EXPECT_EQ(run_program(loop, "frame", x, "s"), expected) << "step " << seed;
      } else {
        EXPECT_EQ(run_program(loop, "between", x, "z"), model.between()) << "step " << seed;
      }
    }
    EXPECT_EQ(run_program(loop, "between", random_int8(kSmallBytes, 99), "y"), model.newest());
    EXPECT_EQ(loop.frame(), 19u + 1);
  }
}

TEST_F(ProgramsTest, ShareImagesAndTheirHistory) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame_again()));
  SmallFrameModel model;
  for (uint64_t frame = 0; frame < 5; ++frame) {
    const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 100 + frame);
    const vk::Image in = image_of(ImageFormat::kRgba8Unorm, kExtent, texels);
    const vk::Image out = image_of(ImageFormat::kRgba8Unorm, kExtent, {});
    must(loop.bind_image("color", {in.view(), VK_FORMAT_R8G8B8A8_UNORM, kExtent}));
    if (frame == 0)  // "again" does not use "shown"
      run([&](VkCommandBuffer commands) { must(loop.record("again", commands)); });
    must(loop.bind_image("shown", {out.view(), VK_FORMAT_R8G8B8A8_UNORM, kExtent}));
    const vk::Buffer blend = buffer_of(std::vector<uint8_t>(kSmallBytes));
    run([&](VkCommandBuffer commands) {
      must(loop.record(0u, commands));
      must(loop.record("again", commands));
      vk::memory_barrier(context(), commands, kCompute, VK_ACCESS_SHADER_WRITE_BIT, kTransfer,
                         VK_ACCESS_TRANSFER_READ_BIT);
      VkBufferImageCopy region{};
      region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
      region.imageExtent = {kSmallWidth, kSmallHeight, 1};
      vkCmdCopyImageToBuffer(commands, must(loop.image("blend")), VK_IMAGE_LAYOUT_GENERAL,
                             blend.get(), 1, &region);
    });
    EXPECT_EQ(texels_of(out, ImageFormat::kRgba8Unorm), model.next(texels)) << frame;
    const std::vector<uint32_t> expected = model.blend();
    EXPECT_EQ(std::memcmp(blend.mapped().data(), expected.data(), kSmallBytes), 0) << frame;
  }
}

TEST_F(ProgramsTest, AreMeasuredOneByOne) {
  FrameLoop loop = must(FrameLoop::create(context(), small_programs()));
  auto timestamps = must(vk::Timestamps::create(context(), 2));
  const auto names = [&](uint32_t program) {
    run([&](VkCommandBuffer commands) { must(loop.record(program, commands, &timestamps)); });
    std::string text;
    for (const DispatchTime& time :
         must(measured_times(timestamps, program_segments(loop.variant(), program))))
      text += time.name + " ";
    return text;
  };
  EXPECT_EQ(names(0), "scale sum ");
  EXPECT_EQ(names(1), "mix ");
}

TEST_F(ProgramsTest, HaveToBeNamed) {
  FrameLoop loop = must(FrameLoop::create(context(), small_programs()));
  run([&](VkCommandBuffer commands) {
    EXPECT_EQ(error_text(loop.record(commands)), "the package has 2 programs, and none is named");
    EXPECT_EQ(loop.next_program(), std::nullopt);
    EXPECT_EQ(error_text(loop.record("betwixt", commands)),
              "the package has no program \"betwixt\"");
    EXPECT_EQ(error_text(loop.record(2u, commands)), "the package has no program 2, there are 2");
  });
  EXPECT_EQ(loop.frame(), 0u);
}

TEST_F(ProgramsTest, AreChosenByAParameter) {
  Package package = small_programs();
  package.variants[0].params = {{"pick", false, 1, 0, ParamSource::kHost, {1.0f}}};
  package.variants[0].chosen_by = "pick";
  package.variants[0].choices = {0.5f, 1.0f};
  FrameLoop loop = must(FrameLoop::create(context(), package));
  EXPECT_EQ(loop.next_program(), 1u);  // by the default
  auto timestamps = must(vk::Timestamps::create(context(), 2));
  const auto recorded = [&](float pick) {
    must(loop.set_param("pick", std::array{pick}));
    run([&](VkCommandBuffer commands) { must(loop.record(commands, &timestamps)); });
    const std::span<const Segment> segments =
        program_segments(loop.variant(), loop.next_program().value());
    return must(measured_times(timestamps, segments)).front().name;
  };
  EXPECT_EQ(recorded(0.6f), "scale");
  EXPECT_EQ(recorded(9.0f), "mix");
  EXPECT_EQ(recorded(-3.0f), "scale");
}

Package generating(float after, float until) {
  Package package = small_programs();
  package.variants[0].generator = Generator{1, after, until};
  package.variants[0].params = {{"time", false, 1, 0, ParamSource::kTime, {0.5f}},
                                {"frames", true, 1, 4, ParamSource::kFrames, {0}}};
  return package;
}

TEST_F(ProgramsTest, ThatGenerateSurviveAFile) {
  const Package package = generating(0.25f, 1.5f);
  const Result<Package> read = read_package(write_package(package));
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, package);
  const std::string text = dump_package(package);
  EXPECT_NE(text.find("generates pictures at times above 0.25 up to 1.5"), std::string::npos);
  EXPECT_NE(text.find("\"frames\" = 0 (frames)"), std::string::npos) << text;
}

TEST_F(ProgramsTest, APictureLeavesNoTraceInTheFrames) {
  FrameLoop loop = must(FrameLoop::create(context(), generating(0, 1)));
  Model model;
  EXPECT_EQ(loop.next_program(), 0u);
  for (uint64_t seed = 1; seed <= 7; ++seed) {
    const std::vector<int8_t> x = random_int8(kSmallBytes, seed);
    const std::vector<int8_t> expected = model.frame(x);
    EXPECT_EQ(run_program(loop, "frame", x, "s"), expected);
    for (uint64_t k = 0; k < seed % 3; ++k)
      run([&](VkCommandBuffer commands) { must(loop.generate(0.5f, commands)); });
  }
}

TEST_F(ProgramsTest, PicturesHaveATimeAndAFrame) {
  FrameLoop loop = must(FrameLoop::create(context(), generating(0, 1)));
  run([&](VkCommandBuffer commands) {
    EXPECT_EQ(error_text(loop.generate(0.5f, commands)),
              "no frame was rendered since the histories were reset");
    must(loop.record(commands));
    EXPECT_EQ(error_text(loop.record("between", commands)),
              "program \"between\" makes pictures between frames: it needs a time");
    for (const float time : {0.0f, 1.5f, std::numeric_limits<float>::quiet_NaN()})
      EXPECT_EQ(error_text(loop.generate(time, commands)),
                fmt::format("a picture at time {} is asked for, the package takes times above 0 up "
                            "to 1",
                            time));
    must(loop.generate(1.0f, commands));
    loop.reset_history();
    EXPECT_EQ(error_text(loop.generate(0.5f, commands)),
              "no frame was rendered since the histories were reset");
  });
  EXPECT_EQ(loop.frame(), 2u);
  FrameLoop other = must(FrameLoop::create(context(), small_programs()));
  run([&](VkCommandBuffer commands) {
    EXPECT_EQ(error_text(other.generate(0.5f, commands)),
              "the package has no program that generates pictures");
  });
}

TEST_F(ProgramsTest, PicturesArePacedEvenly) {
  const Generator between{1, 0, 1}, ahead{1, 1, 2};
  EXPECT_TRUE(between.waits());
  EXPECT_FALSE(ahead.waits());
  EXPECT_EQ(generated_time(between, 1, 1), 0.5f);
  EXPECT_EQ(generated_time(between, 3, 3), 0.75f);
  EXPECT_EQ(generated_time(ahead, 1, 3), 1.25f);
}

TEST_F(ProgramsTest, LeaveHistoriesToFrameLoops) {
  EXPECT_EQ(
      error_text(DataGraphPipeline::create(context(), small_programs())),
      "the package has several networks, such as \"network\" and \"middle\", and none is named");
  DataGraphPipelineOptions options;
  options.graph = "middle";
  EXPECT_EQ(error_text(DataGraphPipeline::create(context(), small_programs(), options)),
            "tensor \"y\": is a history, which only a frame loop keeps");
  options.graph = "centre";
  EXPECT_EQ(error_text(DataGraphPipeline::create(context(), small_programs(), options)),
            "the package has no network \"centre\"");
}

TEST_F(ProgramsTest, OneOfSeveralNetworksRunsAlone) {
  Package package = small_programs();
  Variant& v = package.variants[0];
  v.resources[2].history_depth = 0;  // "y"
  for (Segment& segment : v.segments)
    for (Dispatch& dispatch : segment.dispatches)
      for (Binding& binding : dispatch.bindings) binding.frames_back = 0;
  const auto pipeline =
      must(DataGraphPipeline::create(context(), package, {.graph = std::string("middle")}));
  EXPECT_EQ(pipeline.graph().name, "middle");
  Session session = must(Session::create(pipeline));
  const std::vector<int8_t> y = random_int8(kSmallBytes, 7);
  const vk::Buffer in = buffer_of(y), out = buffer_of(std::vector<int8_t>(kSmallBytes));
  must(session.bind_tensor("y", {in.get(), 0, kSmallBytes}));
  must(session.bind_tensor("z", {out.get(), 0, kSmallBytes}));
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });
  std::vector<int8_t> expected(kSmallBytes);
  for (size_t i = 0; i < y.size(); ++i) expected[i] = static_cast<int8_t>(2 * y[i]);
  EXPECT_EQ(int8_values(out, kSmallBytes), expected);
}

}  // namespace
}  // namespace shale
