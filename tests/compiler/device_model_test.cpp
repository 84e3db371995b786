#include "compiler/cost/device_model.h"

#include <gtest/gtest.h>

#include "compiler/passes/pass.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"

namespace shale {
namespace {

/// Round numbers, so that times can be checked by hand.
ModelledDevice device() {
  ModelledDevice round = *find_modelled_device("mobile");
  round.tops.value = 1;          // 0.5 products a picosecond
  round.efficiency.value = 0.5;  // 0.25
  round.other_gops.value = 100;
  round.memory_gbps.value = 10;
  round.cache_bytes.value = 1 << 20;
  round.dispatch_us.value = 7;
  return round;
}

/// A 3x3 convolution of 32 to 16 channels over 40x64, rescaled and clamped, as one dispatch.
Graph layer() {
  Graph graph = ConvCase{.name = "layer", .h = 40, .w = 64, .ic = 32, .oc = 16}.graph();
  must(run_pipeline(graph, {}, {}));
  return graph;
}

constexpr double kPositions = 40 * 64;
constexpr double kMacs = kPositions * 16 * 32 * 9;
/// Weights, bias, multipliers and shifts; zero points are single elements.
constexpr double kConstants = 16 * 32 * 9 + 16 * 4 + 16 * 4 + 16;

TEST(DeviceModel, IsARooflineWithALaunch) {
  const ModelledNetwork network = model_network(layer(), device());
  ASSERT_EQ(network.dispatches.size(), 1u);
  const ModelledDispatch& d = network.dispatches[0];
  EXPECT_EQ(d.op, "conv2d");
  EXPECT_EQ(d.precision, Precision::kInt8);
  EXPECT_EQ(static_cast<double>(d.macs), kMacs);
  EXPECT_NEAR(d.compute_us, 2e-6 * kMacs / 0.5 + 1e-3 * static_cast<double>(d.ops) / 100, 1e-9);
  const double bytes = kPositions * 32 + kPositions * 16;
  EXPECT_NEAR(d.memory_bytes, bytes + kConstants, 16) << "input and output lie in memory";
  EXPECT_NEAR(d.memory_us, 1e-3 * d.memory_bytes / 10, 1e-9);
  EXPECT_FALSE(d.memory_bound());
  EXPECT_DOUBLE_EQ(d.time_us, d.compute_us + 7);
  EXPECT_EQ(d.tile.halo, 1.0) << "all of it fits";
  EXPECT_EQ(d.live_bytes, 0u) << "nothing but the graph's input and output";
  EXPECT_DOUBLE_EQ(network.time_us, d.time_us);
  EXPECT_NEAR(d.intensity(), (2 * kMacs + static_cast<double>(d.ops)) / d.memory_bytes, 1e-9);

  ModelledDevice narrow = device();
  narrow.memory_gbps.value = 0.1;
  const ModelledNetwork slow = model_network(layer(), narrow);
  EXPECT_TRUE(slow.dispatches[0].memory_bound());
  EXPECT_DOUBLE_EQ(slow.time_us, slow.dispatches[0].memory_us + 7);
}

TEST(DeviceModel, ReadsHalosAgainWhereTheCacheIsSmall) {
  ModelledDevice small = device();
  small.cache_bytes.value = 16 * 1024;
  const ModelledDispatch whole = model_network(layer(), device()).dispatches[0],
                         tiled = model_network(layer(), small).dispatches[0];
  EXPECT_GT(tiled.tile.halo, 1.0);
  EXPECT_NEAR(tiled.memory_bytes - whole.memory_bytes, kPositions * 32 * (tiled.tile.halo - 1),
              1e-6);
}

TEST(DeviceModel, AddsUpEnergy) {
  const ModelledDevice d = device();
  const ModelledDispatch one = model_network(layer(), d).dispatches[0];
  EXPECT_NEAR(one.energy_uj,
              1e-6 * (kMacs * 0.3 + static_cast<double>(one.ops) * 0.1 + one.memory_bytes * 162.5),
              1e-9)
      << "everything is memory traffic here";
}

/// Two convolutions in a row; the tensor between them has 40x64x16 bytes.
Graph two_layers() {
  const auto ones = [](int count) {
    std::string text = "1";
    for (int i = 1; i < count; ++i) text += ",1";
    return text;
  };
  return graph_of(fmt::format(R"(graph two {{
  input %x : i8[1,40,64,8]
  const %w1 : i8[16,1,1,8] = [{}]
  const %w2 : i8[4,1,1,16] = [{}]
  const %b : i32[1] = [0]
  const %zp : i8[1] = [0]
  const %zp32 : i32[1] = [0]
  const %m : i32[1] = [1073741824]
  const %s : i8[1] = [35]
  %a1 = conv2d %x, %w1, %b, %zp, %zp {{pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32}} : i32[1,40,64,16]
  %y1 = rescale %a1, %m, %s, %zp32, %zp {{scale32=true, rounding_mode=single}} : i8[1,40,64,16]
  %a2 = conv2d %y1, %w2, %b, %zp, %zp {{pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32}} : i32[1,40,64,4]
  %y2 = rescale %a2, %m, %s, %zp32, %zp {{scale32=true, rounding_mode=single}} : i8[1,40,64,4]
  return %y2
}}
)",
                              ones(128), ones(64)));
}

TEST(DeviceModel, KeepsSmallIntermediatesOnChip) {
  Graph graph = two_layers();
  must(run_pipeline(graph, {}, {}));
  const uint64_t between = 40 * 64 * 16;
  const ModelledNetwork large = model_network(graph, device());
  ASSERT_EQ(large.dispatches.size(), 2u);
  EXPECT_EQ(large.dispatches[0].live_bytes, between);
  EXPECT_EQ(large.dispatches[1].live_bytes, between);
  EXPECT_EQ(large.arena_bytes, between);
  ModelledDevice small = device();
  small.cache_bytes.value = 2.0 * static_cast<double>(between) - 2;
  const ModelledNetwork spilled = model_network(graph, small);
  EXPECT_NEAR(spilled.memory_bytes - large.memory_bytes, 2.0 * static_cast<double>(between), 1e-6)
      << "written and read again";
}

TEST(DeviceModel, EveryConstantHasASource) {
  for (const ModelledDevice& d : modelled_devices())
    for (const Constant* constant :
         {&d.tops, &d.efficiency, &d.other_gops, &d.memory_gbps, &d.cache_bytes, &d.dispatch_us,
          &d.other_pj, &d.memory_pj, &d.cache_pj}) {
      EXPECT_GT(constant->value, 0) << d.name;
      EXPECT_FALSE(constant->source.empty()) << d.name;
    }
}

TEST(DeviceModel, TakesGivenNumbersInPlaceOfItsOwn) {
  const ModelledDevice changed = with_options(device(), {.tops = 3, .cache_bytes = 5});
  EXPECT_EQ(changed.tops.value, 3);
  EXPECT_EQ(changed.tops.source, "given");
  EXPECT_EQ(changed.cache_bytes.value, 5);
  EXPECT_EQ(changed.efficiency.value, device().efficiency.value);
}

}  // namespace
}  // namespace shale
