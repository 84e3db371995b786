#include "runtime/datagraph/session.h"

#include <cstdio>
#include <cstring>

#include "runtime/profile/profile.h"
#include "runtime/vk/pipeline_cache.h"
#include "tests/support/small_packages.h"
#include "tests/support/vulkan_fixture.h"

namespace shale {
namespace {

class SessionTest : public VulkanTest {
 protected:
  struct Bound {
    vk::Buffer x;
    vk::Buffer y;
  };

  /// Binds a buffer with `values` as "x" and one of zeros as "y".
  static Bound bind(Session& session, const std::vector<int8_t>& values) {
    Bound bound{buffer_of(values), buffer_of(std::vector<int8_t>(kSmallBytes))};
    must(session.bind_tensor("x", {bound.x.get(), 0, kSmallBytes}));
    must(session.bind_tensor("y", {bound.y.get(), 0, kSmallBytes}));
    return bound;
  }

  static Session ready_session(const DataGraphPipeline& pipeline) {
    Session session = must(Session::create(pipeline));
    must(session.allocate_memory());
    return session;
  }
};

TEST_F(SessionTest, ComputesTheGraphExactly) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = ready_session(pipeline);
  const std::vector<int8_t> x = random_int8(kSmallBytes, 1);
  const Bound bound = bind(session, x);
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });
  EXPECT_EQ(int8_values(bound.y, kSmallBytes), small_graph_result(x));
}

TEST_F(SessionTest, RunsAPackageThatCameFromAFile) {
  const Package package = must(read_package(write_package(small_graph())));
  const auto pipeline = must(DataGraphPipeline::create(context(), package));
  EXPECT_EQ(pipeline.graph().name, "network");
  Session session = ready_session(pipeline);
  const std::vector<int8_t> x = random_int8(kSmallBytes, 2);
  const Bound bound = bind(session, x);
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });
  EXPECT_EQ(int8_values(bound.y, kSmallBytes), small_graph_result(x));
}

TEST_F(SessionTest, RunsTheGraphOfAPackageWithPasses) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_frame()));
  Session session = must(Session::create(pipeline));
  EXPECT_TRUE(session.memory_requirements().empty());
  must(session.allocate_memory());
  EXPECT_EQ(error_text(session.bind_memory(VK_NULL_HANDLE, 0)), "arena: the graph needs no memory");
  const Bound bound = bind(session, std::vector<int8_t>(kSmallBytes, 7));
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });
  const std::vector<int8_t> y = int8_values(bound.y, kSmallBytes);
  EXPECT_EQ(std::vector<int8_t>(y.begin(), y.begin() + 4), (std::vector<int8_t>{7, -7, 14, 0}));
}

TEST_F(SessionTest, SessionsOfOnePipelineRunAtOnce) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session first = ready_session(pipeline);
  Session second = ready_session(pipeline);
  const std::vector<int8_t> x1 = random_int8(kSmallBytes, 3);
  const std::vector<int8_t> x2 = random_int8(kSmallBytes, 4);
  const Bound bound1 = bind(first, x1);
  const Bound bound2 = bind(second, x2);
  run([&](VkCommandBuffer commands) {
    must(first.record(commands));
    must(second.record(commands));
  });
  EXPECT_EQ(int8_values(bound1.y, kSmallBytes), small_graph_result(x1));
  EXPECT_EQ(int8_values(bound2.y, kSmallBytes), small_graph_result(x2));
}

TEST_F(SessionTest, RunsInMemoryOfItsUser) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = must(Session::create(pipeline));
  const std::vector<BindPoint> points = session.memory_requirements();
  ASSERT_EQ(points.size(), 1u);
  EXPECT_EQ(points[0].name, "arena");
  EXPECT_GE(points[0].memory.size, 2 * kSmallBytes);
  VkMemoryRequirements larger = points[0].memory;
  larger.size += 4 * larger.alignment;
  const vk::MemoryHandle memory = must(vk::allocate(context(), larger, vk::MemoryKind::kDevice));
  EXPECT_NE(error_text(session.bind_memory(memory.get(), 1)).find("arena: offset 1 is no multiple"),
            std::string::npos);
  must(session.bind_memory(memory.get(), 4 * larger.alignment));
  EXPECT_EQ(error_text(session.bind_memory(memory.get(), 0)), "arena: has its memory already");
  EXPECT_EQ(error_text(session.allocate_memory()), "arena: has its memory already");
  const std::vector<int8_t> x = random_int8(kSmallBytes, 5);
  const Bound bound = bind(session, x);
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });
  EXPECT_EQ(int8_values(bound.y, kSmallBytes), small_graph_result(x));
}

TEST_F(SessionTest, TensorsMayBeReboundAndLieAnywhereInABuffer) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = ready_session(pipeline);
  const std::vector<int8_t> x1 = random_int8(kSmallBytes, 6);
  const Bound bound1 = bind(session, x1);
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });

  const std::vector<int8_t> x2 = random_int8(kSmallBytes, 7);
  const uint64_t at = session.tensor_alignment();
  std::vector<int8_t> both(2 * kSmallBytes + 3 * at);
  std::copy(x2.begin(), x2.end(), both.begin() + static_cast<ptrdiff_t>(at));
  const uint64_t y_at = (at + kSmallBytes + at - 1) / at * at;
  const vk::Buffer shared = buffer_of(both);
  must(session.bind_tensor("x", {shared.get(), at, kSmallBytes}));
  must(session.bind_tensor("y", {shared.get(), y_at, kSmallBytes}));
  run([&](VkCommandBuffer commands) { must(session.record(commands)); });
  const auto y = shared.mapped().subspan(y_at, kSmallBytes);
  const std::vector<int8_t> expected = small_graph_result(x2);
  EXPECT_EQ(std::memcmp(y.data(), expected.data(), kSmallBytes), 0);
  EXPECT_EQ(int8_values(bound1.y, kSmallBytes), small_graph_result(x1));
}

TEST_F(SessionTest, MayBeRecordedTwiceWithABarrierBetween) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = ready_session(pipeline);
  const std::vector<int8_t> x = random_int8(kSmallBytes, 8);
  const Bound bound = bind(session, x);
  run([&](VkCommandBuffer commands) {
    must(session.record(commands));
    vk::memory_barrier(context(), commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT);
    must(session.record(commands));
  });
  EXPECT_EQ(int8_values(bound.y, kSmallBytes), small_graph_result(x));
}

TEST_F(SessionTest, ValidationSeesAMissingBarrier) {
  // The other tests rely on it: without the barrier of the test above there must be messages.
  if (!validated()) GTEST_SKIP() << "no validation layer";
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = ready_session(pipeline);
  const Bound bound = bind(session, random_int8(kSmallBytes, 9));
  run([&](VkCommandBuffer commands) {
    must(session.record(commands));
    must(session.record(commands));
  });
  EXPECT_FALSE(validation_messages().empty());
}

TEST_F(SessionTest, RefusesWhatIsNotBound) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = must(Session::create(pipeline));
  const vk::Buffer buffer = buffer_of(std::vector<uint8_t>(2 * kSmallBytes));
  run([&](VkCommandBuffer commands) {
    EXPECT_EQ(error_text(session.record(commands)), "arena: has no memory yet");
    must(session.allocate_memory());
    EXPECT_EQ(error_text(session.record(commands)), "tensor \"x\": is not bound yet");
    must(session.bind_tensor("x", {buffer.get(), 0, kSmallBytes}));
    EXPECT_EQ(error_text(session.record(commands)), "tensor \"y\": is not bound yet");
    must(session.bind_tensor("y", {buffer.get(), kSmallBytes, kSmallBytes}));
    must(session.record(commands));
  });
}

TEST_F(SessionTest, RefusesTensorsThatDoNotFit) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = must(Session::create(pipeline));
  const vk::Buffer buffer = buffer_of(std::vector<uint8_t>(2 * kSmallBytes));
  EXPECT_EQ(error_text(session.bind_tensor("z", {buffer.get(), 0, kSmallBytes})),
            "the network has no input or output \"z\"");
  EXPECT_EQ(error_text(session.bind_tensor("a", {buffer.get(), 0, kSmallBytes})),
            "tensor \"a\": is neither input nor output");
  EXPECT_EQ(error_text(session.bind_tensor("x", {VK_NULL_HANDLE, 0, kSmallBytes})),
            "tensor \"x\": no buffer is given");
  EXPECT_EQ(error_text(session.bind_tensor("x", {buffer.get(), 0, kSmallBytes - 1})),
            "tensor \"x\": 511 bytes are given, expected at least 512");
  EXPECT_EQ(error_text(session.bind_tensor("x", {buffer.get(), 1, kSmallBytes})),
            fmt::format("tensor \"x\": offset 1 is no multiple of {}", session.tensor_alignment()));
}

TEST_F(SessionTest, RefusesADeviceThatLacksFeatures) {
  vk::Context poor = context();
  poor.caps.name = "poor";
  poor.caps.features = {};
  poor.caps.max_texel_elements = 100;
  const auto refused = DataGraphPipeline::create(poor, small_graph());
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kDevice);
  EXPECT_EQ(refused.error().text(),
            "poor: runs no variant of the package: variant 0 \"any\": storageBuffer8BitAccess is "
            "not supported, shaderInt8 is not supported, maxTexelBufferElements is 100, needs 128");
}

TEST_F(SessionTest, TakesTheFirstVariantThatFits) {
  Package package = small_graph();
  package.variants.insert(package.variants.begin(), package.variants[0]);
  package.variants[0].target = "demanding";
  package.variants[0].requirements.workgroup_invocations = UINT32_MAX;
  const auto pipeline = must(DataGraphPipeline::create(context(), package));
  EXPECT_EQ(pipeline.variant().target, "any");
}

TEST_F(SessionTest, RefusesAPackageThatBreaksTheRules) {
  Package package = small_graph();
  package.variants[0].resources[2].offset_bytes = 64;
  EXPECT_EQ(error_text(DataGraphPipeline::create(context(), package)),
            "variant 0, resource \"a\": offset 64 is no multiple of 256");
}

TEST_F(SessionTest, UsesAPipelineCache) {
  const std::string path = testing::TempDir() + "shale_session_test.cache";
  std::remove(path.c_str());
  for (int round = 0; round < 2; ++round) {
    const auto cache = must(vk::PipelineCache::load(context(), path));
    EXPECT_EQ(cache.ignored().empty(), round == 1) << cache.ignored();
    must(DataGraphPipeline::create(context(), small_graph(), {.cache = cache.get()}));
    must(cache.save());
  }
  std::remove(path.c_str());
}

TEST_F(SessionTest, MeasuresEachDispatch) {
  const auto pipeline = must(DataGraphPipeline::create(context(), small_graph()));
  Session session = ready_session(pipeline);
  const Bound bound = bind(session, random_int8(kSmallBytes, 10));
  const std::span<const Segment> segments(&pipeline.graph(), 1);
  auto timestamps = must(vk::Timestamps::create(context(), interval_count(segments)));
  run([&](VkCommandBuffer commands) { must(session.record(commands, &timestamps)); });
  const std::vector<DispatchTime> times = must(measured_times(timestamps, segments));
  ASSERT_EQ(times.size(), 4u);
  EXPECT_EQ(times[2].name, "double");
  EXPECT_EQ(times[2].kernel, "add");
  EXPECT_EQ(times[2].segment, "network");
  double total_us = 0;
  for (const DispatchTime& time : times) {
    EXPECT_GE(time.time_us, 0);
    total_us += time.time_us;
  }
  EXPECT_GT(total_us, 0);
  EXPECT_LT(total_us, 60e6);
}

}  // namespace
}  // namespace shale
