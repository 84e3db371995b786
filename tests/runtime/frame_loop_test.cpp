#include "runtime/frame/frame_loop.h"

#include "ir/base/file.h"
#include "ir/base/hash.h"
#include "runtime/profile/profile.h"
#include "tests/support/small_packages.h"
#include "tests/support/vulkan_fixture.h"

namespace shale {
namespace {

constexpr VkExtent2D kExtent{kSmallWidth, kSmallHeight};
constexpr ImageFormat kColorFormat = ImageFormat::kRgba8Unorm;

class FrameLoopTest : public VulkanTest {
 protected:
  static ImageView view_of(const vk::Image& image) {
    return {image.view(), vk::vk_format(kColorFormat), image.extent()};
  }
  static vk::Image color(const std::vector<uint8_t>& texels) {
    return image_of(kColorFormat, kExtent, texels);
  }
  static vk::Image empty() { return image_of(kColorFormat, kExtent, {}); }
};

TEST_F(FrameLoopTest, FollowsTheModelFrameByFrame) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame()));
  SmallFrameModel model;
  for (uint64_t frame = 0; frame < 8; ++frame) {
    const std::vector<uint8_t> texels = random_bytes(kSmallBytes, frame);
    const vk::Image in = color(texels);
    const vk::Image out = empty();
    must(loop.bind_image("color", view_of(in)));
    must(loop.bind_image("shown", view_of(out)));
    EXPECT_EQ(loop.frame(), frame);
    run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
    EXPECT_EQ(texels_of(out, kColorFormat), model.next(texels)) << "frame " << frame;
  }
}

TEST_F(FrameLoopTest, ManyFramesInOneSubmissionKeepTheirHistory) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame(), {.frames_in_flight = 5}));
  std::vector<std::vector<uint8_t>> texels;
  std::vector<vk::Image> ins;
  std::vector<vk::Image> outs;
  for (uint64_t frame = 0; frame < 5; ++frame) {
    texels.push_back(random_bytes(kSmallBytes, 100 + frame));
    ins.push_back(color(texels.back()));
    outs.push_back(empty());
  }
  run([&](VkCommandBuffer commands) {
    for (size_t frame = 0; frame < 5; ++frame) {
      must(loop.bind_image("color", view_of(ins[frame])));
      must(loop.bind_image("shown", view_of(outs[frame])));
      must(loop.record(commands));
    }
  });
  SmallFrameModel model;
  for (size_t frame = 0; frame < 5; ++frame)
    EXPECT_EQ(texels_of(outs[frame], kColorFormat), model.next(texels[frame])) << frame;
}

TEST_F(FrameLoopTest, KeepsItsImagesUntilTheyAreBoundAnew) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame(), {.frames_in_flight = 1}));
  const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 200);
  const vk::Image in = color(texels);
  const vk::Image out = empty();
  must(loop.bind_image("color", view_of(in)));
  must(loop.bind_image("shown", view_of(out)));
  SmallFrameModel model;
  for (int frame = 0; frame < 7; ++frame) {
    run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
    EXPECT_EQ(texels_of(out, kColorFormat), model.next(texels)) << "frame " << frame;
  }
}

TEST_F(FrameLoopTest, ResetHistoryStartsAnew) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame()));
  const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 300);
  const vk::Image in = color(texels);
  const vk::Image out = empty();
  must(loop.bind_image("color", view_of(in)));
  must(loop.bind_image("shown", view_of(out)));
  SmallFrameModel model;
  for (int frame = 0; frame < 6; ++frame) {
    if (frame == 4) {
      loop.reset_history();
      model.reset_history();
    }
    run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
    EXPECT_EQ(texels_of(out, kColorFormat), model.next(texels)) << "frame " << frame;
  }
}

TEST_F(FrameLoopTest, LoopsOnOneDeviceAreIndependent) {
  const Package package = small_frame();
  FrameLoop first = must(FrameLoop::create(context(), package));
  FrameLoop second = must(FrameLoop::create(context(), package));
  const std::vector<uint8_t> texels1 = random_bytes(kSmallBytes, 400);
  const std::vector<uint8_t> texels2 = random_bytes(kSmallBytes, 401);
  const vk::Image in1 = color(texels1);
  const vk::Image in2 = color(texels2);
  const vk::Image out1 = empty();
  const vk::Image out2 = empty();
  must(first.bind_image("color", view_of(in1)));
  must(first.bind_image("shown", view_of(out1)));
  must(second.bind_image("color", view_of(in2)));
  must(second.bind_image("shown", view_of(out2)));
  run([&](VkCommandBuffer commands) {
    must(first.record(commands));
    must(second.record(commands));
  });
  EXPECT_EQ(texels_of(out1, kColorFormat), SmallFrameModel().next(texels1));
  EXPECT_EQ(texels_of(out2, kColorFormat), SmallFrameModel().next(texels2));
}

TEST_F(FrameLoopTest, RunsANetworkAloneOnItsTensors) {
  FrameLoop loop = must(FrameLoop::create(context(), small_graph()));
  const TensorView x = must(loop.tensor("x"));
  const TensorView y = must(loop.tensor("y"));
  EXPECT_EQ(x.size_bytes, kSmallBytes);
  EXPECT_EQ(error_text(loop.tensor("a")), "the network has no input or output \"a\"");
  const std::vector<int8_t> values = random_int8(kSmallBytes, 500);
  const vk::Buffer in = buffer_of(values);
  const vk::Buffer out = buffer_of(std::vector<int8_t>(kSmallBytes));
  run([&](VkCommandBuffer commands) {
    const VkBufferCopy to_x{0, x.offset, kSmallBytes};
    vkCmdCopyBuffer(commands, in.get(), x.buffer, 1, &to_x);
    vk::memory_barrier(context(), commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_READ_BIT);
    must(loop.record(commands));
    vk::memory_barrier(context(), commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_READ_BIT);
    const VkBufferCopy from_y{y.offset, 0, kSmallBytes};
    vkCmdCopyBuffer(commands, y.buffer, out.get(), 1, &from_y);
  });
  EXPECT_EQ(int8_values(out, kSmallBytes), small_graph_result(values));
}

TEST_F(FrameLoopTest, MeasuresAllSegments) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame()));
  const vk::Image in = color(random_bytes(kSmallBytes, 600));
  const vk::Image out = empty();
  must(loop.bind_image("color", view_of(in)));
  must(loop.bind_image("shown", view_of(out)));
  const std::vector<Segment>& segments = loop.variant().segments;
  auto timestamps = must(vk::Timestamps::create(context(), interval_count(segments)));
  for (int frame = 0; frame < 2; ++frame) {
    run([&](VkCommandBuffer commands) { must(loop.record(commands, &timestamps)); });
    const std::vector<DispatchTime> times = must(measured_times(timestamps, segments));
    ASSERT_EQ(times.size(), 3u);
    EXPECT_EQ(times[0].segment, "pre");
    EXPECT_EQ(times[1].name, "scale");
    EXPECT_EQ(times[2].kernel, "post");
  }
  EXPECT_EQ(error_text(measured_times(timestamps, std::span(segments).first(2))),
            "3 intervals were measured, expected 2 dispatches");
}

/// Shows the colours of the frame before, from a history in a buffer; and zeros, from one that is
/// filled and then cleared.
Package transfers() {
  enum : uint32_t { kColor, kKept, kScratch, kShown, kEmpty };
  const auto image = [](const char* name, Category category, bool linear, uint32_t depth = 0) {
    Resource resource;
    resource.name = name;
    resource.category = category;
    resource.format = kColorFormat;
    resource.width = kSmallWidth;
    resource.height = kSmallHeight;
    resource.history_depth = depth;
    if (linear)
      resource.size_bytes = uint64_t{4} * kSmallHeight * linear_pitch(kColorFormat, kSmallWidth);
    return resource;
  };
  const auto end = [](uint32_t number, uint32_t resource, uint32_t frames_back = 0) {
    return Binding{
        number,     BindingType::kTransfer, resource, ImageFormat::kNone, number == 0, number == 1,
        frames_back};
  };
  Variant v;
  v.target = "any";
  v.resources = {
      image("color", Category::kImageInput, false), image("kept", Category::kImageHistory, true, 2),
      image("scratch", Category::kImageInternal, true),
      image("shown", Category::kImageOutput, false), image("empty", Category::kImageOutput, false)};
  Binding cleared = end(0, kScratch);
  cleared.reads = false;
  cleared.writes = true;
  v.segments = {{"all",
                 SegmentKind::kTransfer,
                 {{"keep", "copy", 0, {1, 1, 1}, {end(0, kColor), end(1, kKept)}, {}},
                  {"fill", "copy", 0, {1, 1, 1}, {end(0, kColor), end(1, kScratch)}, {}},
                  {"clear", "clear", 0, {1, 1, 1}, {cleared}, {}},
                  {"show", "copy", 0, {1, 1, 1}, {end(0, kKept, 1), end(1, kShown)}, {}},
                  {"show_empty", "copy", 0, {1, 1, 1}, {end(0, kScratch), end(1, kEmpty)}, {}}}}};
  Package package;
  package.variants = {v};
  return package;
}

TEST_F(FrameLoopTest, CopiesAndClearsLinearImages) {
  FrameLoop loop = must(FrameLoop::create(context(), transfers()));
  EXPECT_EQ(loop.image_usage("color"), VkImageUsageFlags{VK_IMAGE_USAGE_TRANSFER_SRC_BIT});
  EXPECT_EQ(loop.image_usage("shown"), VkImageUsageFlags{VK_IMAGE_USAGE_TRANSFER_DST_BIT});
  EXPECT_EQ(loop.image_usage("kept"), 0u);
  const vk::Image shown = empty(), cleared = empty();
  ImageView view = view_of(shown);
  EXPECT_EQ(error_text(loop.bind_image("shown", view)),
            "image \"shown\": no VkImage is given, and the package copies it");
  const auto bind = [&](const char* name, const vk::Image& image) {
    view = view_of(image);
    view.image = image.get();
    must(loop.bind_image(name, view));
  };
  bind("shown", shown);
  bind("empty", cleared);
  auto timestamps =
      must(vk::Timestamps::create(context(), interval_count(loop.variant().segments)));
  std::vector<uint8_t> before(kSmallBytes);
  for (uint64_t frame = 0; frame < 4; ++frame) {
    if (frame == 3) {
      loop.reset_history();
      before.assign(kSmallBytes, 0);
    }
    const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 700 + frame);
    const vk::Image in = color(texels);
    bind("color", in);
    run([&](VkCommandBuffer commands) { must(loop.record(commands, &timestamps)); });
    EXPECT_EQ(texels_of(shown, kColorFormat), before) << "frame " << frame;
    EXPECT_EQ(texels_of(cleared, kColorFormat), std::vector<uint8_t>(kSmallBytes))
        << "frame " << frame;
    before = texels;
  }
  EXPECT_EQ(must(measured_times(timestamps, loop.variant().segments)).size(), 5u);
  EXPECT_EQ(must(loop.tensor("kept")).size_bytes, kSmallBytes);  // its rows are 64 bytes
  EXPECT_EQ(error_text(loop.image("kept")), "the frame loop has no image \"kept\"");
}

TEST_F(FrameLoopTest, RefusesImagesThatDoNotFit) {
  FrameLoop loop = must(FrameLoop::create(context(), small_frame()));
  const vk::Image image = empty();
  ImageView view = view_of(image);
  EXPECT_EQ(error_text(loop.bind_image("blend", view)),
            "the package has no input or output image \"blend\"");
  view.extent.height = 9;
  EXPECT_EQ(error_text(loop.bind_image("color", view)), "image \"color\": is 16x9, expected 16x8");
  view = view_of(image);
  view.format = VK_FORMAT_B8G8R8A8_UNORM;
  EXPECT_EQ(error_text(loop.bind_image("color", view)),
            "image \"color\": has VkFormat 44, expected 37 (rgba8_unorm)");
  view.view = VK_NULL_HANDLE;
  EXPECT_EQ(error_text(loop.bind_image("color", view)), "image \"color\": no view is given");
  run([&](VkCommandBuffer commands) {
    EXPECT_EQ(error_text(loop.record(commands)), "image \"color\": is not bound yet");
    must(loop.bind_image("color", view_of(image)));
    EXPECT_EQ(error_text(loop.record(commands)), "image \"shown\": is not bound yet");
  });
  EXPECT_EQ(loop.frame(), 0u);
}

TEST_F(FrameLoopTest, RefusesWhatItCannotRun) {
  EXPECT_EQ(error_text(FrameLoop::create(context(), small_frame(), {.frames_in_flight = 0})),
            "0 frames in flight are outside 1..8");
  vk::Context poor = context();
  poor.caps.features = {};
  EXPECT_NE(error_text(FrameLoop::create(poor, small_frame())).find("shaderInt8 is not supported"),
            std::string::npos);
}

TEST_F(FrameLoopTest, RefusesTooFewTimestamps) {
  FrameLoop loop = must(FrameLoop::create(context(), small_graph()));
  auto timestamps = must(vk::Timestamps::create(context(), 3));
  run([&](VkCommandBuffer commands) {
    EXPECT_EQ(error_text(loop.record(commands, &timestamps)),
              "the timestamps hold 3 intervals, 4 dispatches need one each");
  });
  EXPECT_EQ(loop.frame(), 0u);
}

TEST_F(FrameLoopTest, HistoriesMayHaveAnyDepths) {
  // The rings come round together after 7 * 11 * 3 frames only.
  Package package = small_frame();
  Variant& variant = package.variants[0];
  for (const uint32_t depth : {7u, 11u}) {
    variant.resources.push_back(variant.resources[5]);
    variant.resources.back().name = fmt::format("history{}", depth);
    variant.resources.back().history_depth = depth;
  }
  FrameLoop loop = must(FrameLoop::create(context(), package));
  const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 800);
  const vk::Image in = color(texels), out = empty();
  must(loop.bind_image("color", view_of(in)));
  must(loop.bind_image("shown", view_of(out)));
  SmallFrameModel model;
  for (int frame = 0; frame < 5; ++frame) {
    run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
    EXPECT_EQ(texels_of(out, kColorFormat), model.next(texels)) << "frame " << frame;
  }
}

TEST_F(FrameLoopTest, RunsPackagesOfEarlierVersions) {
  for (const char* version : {"1.0", "1.1", "1.2", "1.3"}) {
    const std::vector<uint8_t> bytes =
        must(read_file(fmt::format("{}/tests/ir/packages/{}.shale", SHALE_SOURCE_DIR, version)));
    FrameLoop loop = must(FrameLoop::create(context(), must(read_package(bytes))));
    const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 900);
    const vk::Image in = color(texels), out = empty();
    must(loop.bind_image("color", view_of(in)));
    must(loop.bind_image("shown", view_of(out)));
    SmallFrameModel model;
    for (int frame = 0; frame < 3; ++frame) {
      run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
      EXPECT_EQ(texels_of(out, kColorFormat), model.next(texels)) << version << " " << frame;
    }
  }
}

TEST_F(FrameLoopTest, FiltersImagesBySampler) {
  FrameLoop loop = must(FrameLoop::create(context(), small_filter()));
  EXPECT_EQ(loop.image_usage("color"), VkImageUsageFlags{VK_IMAGE_USAGE_SAMPLED_BIT});
  const std::vector<uint8_t> texels = random_bytes(kSmallBytes, 1000);
  const vk::Image in = color(texels), out = empty();
  must(loop.bind_image("color", view_of(in)));
  must(loop.bind_image("shown", view_of(out)));
  run([&](VkCommandBuffer commands) { must(loop.record(commands)); });
  const std::vector<uint8_t> shown = texels_of(out, kColorFormat);
  for (uint32_t y = 0; y < kSmallHeight; ++y)
    for (uint32_t x = 0; x < kSmallWidth; ++x)
      for (uint32_t k = 0; k < 4; ++k) {
        const auto at = [&](uint32_t u, uint32_t v) {  // clamped to the edge
          return int{texels[4 * (std::min(v, kSmallHeight - 1) * kSmallWidth +
                                 std::min(u, kSmallWidth - 1)) +
                            k]};
        };
        const int sum = at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1);
        // A device interpolates with 8 bits of position or fewer, and rounds twice.
        EXPECT_NEAR(shown[4 * (y * kSmallWidth + x) + k], sum / 4.0, 2) << x << "," << y;
      }
}

TEST_F(FrameLoopTest, HostProgramFindsItsPackage) {
  // tests/e2e/host_program runs on this file, with this pattern, and expects this checksum.
  must(write_file(SHALE_BINARY_DIR "/small_frame.shale", write_package(small_frame())));
  std::vector<uint8_t> texels(kSmallBytes);
  for (size_t i = 0; i < texels.size(); ++i) texels[i] = static_cast<uint8_t>(i * 37 % 251);
  EXPECT_EQ(stable_hash(SmallFrameModel().next(texels)), 0xbd9d86b9087c0c29u);
}

}  // namespace
}  // namespace shale
