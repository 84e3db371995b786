// Graphs through the extensions: results, constants, strides, sessions, threads.
#include <thread>

#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

const char* kAdd = R"(
graph main {
  input %a : i32[1,2,3,4]
  input %b : i32[1,2,3,4]
  %sum = add %a, %b : i32[1,2,3,4]
  return %sum
}
)";

class GraphLayerTest : public LayerTest {
 protected:
  void expect_exact(const Graph& graph, const GraphOptions& options = {}) {
    ClientRun run;
    ASSERT_EQ(run.create(client, graph, options), VK_SUCCESS) << client.last_message;
    for (const uint64_t seed : {1, 2}) {
      const std::vector<Tensor> inputs = random_inputs(graph, seed);
      EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs)));
    }
    EXPECT_EQ(client.other_messages, 0u) << client.last_message;
  }
};

const char* kConv = R"(
graph main {
  input %x : i8[1,6,5,4]
  const %w : i8[3,3,3,4] = [1,-2,3,4,5,6,7,8,9,10,11,12,-13,14,15,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,35,36,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18,-19,20,21,22,23,24,25,26,27,28,29,30,31,32,33,34,35,36,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18,19,20,21,22,23,24,-25,26,27,28,29,30,31,32,33,34,35,36]
  const %b : i32[3] = [10,-20,30]
  const %zp : i8[1] = [-3]
  const %zero : i8[1] = [0]
  const %zero32 : i32[1] = [0]
  const %m : i32[3] = [1073741824,1518500250,2021161081]
  const %s : i8[3] = [37,38,39]
  const %four : i8[1] = [4]
  %acc = conv2d %x, %w, %b, %zp, %zero {pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,6,5,3]
  %y = rescale %acc, %m, %s, %zero32, %four {scale32=true, rounding_mode=single, per_channel=true} : i8[1,6,5,3]
  %k = table %y, %t : i8[1,6,5,3]
  %z = max_pool2d %k {kernel=[2,1], stride=[1,1], pad=[0,0,0,0]} : i8[1,5,5,3]
  return %y, %z
}
)";

/// A chain that cannot be one dispatch, so that the session needs memory.
Graph chain_graph() {
  std::string table;
  for (int i = 0; i < 256; ++i) table += (i ? "," : "") + std::to_string((i * 37) % 251 - 125);
  std::string text = kConv;
  return graph_of(text.insert(text.find("  %acc"), "  const %t : i8[256] = [" + table + "]\n"));
}

TEST_F(GraphLayerTest, AddsTwoTensors) { expect_exact(graph_of(kAdd)); }

TEST_F(GraphLayerTest, TakesConstantsOfBothKinds) {
  for (const bool external : {true, false}) {
    SCOPED_TRACE(external);
    expect_exact(chain_graph(), {.external_constants = external});
  }
}

TEST_F(GraphLayerTest, TakesTensorsOfBothTilingsAndWithPaddedRows) {
  expect_exact(chain_graph(), {.tiling = VK_TENSOR_TILING_OPTIMAL_ARM});
  expect_exact(chain_graph(), {.padding = 3});
  expect_exact(graph_of(kAdd), {.padding = 13});
}

TEST_F(GraphLayerTest, ASessionAlwaysHasMemory) {
  for (const Graph& graph : {graph_of(kAdd), chain_graph()}) {
    ClientRun run;
    ASSERT_EQ(run.create(client, graph), VK_SUCCESS) << client.last_message;
    EXPECT_GT(run.graph.session_bytes, 0u);
  }
}

struct Recorded {
  const Client* client;
  std::vector<const ClientRun*> runs;
};

TEST_F(GraphLayerTest, OneCommandBufferRunsSeveralPipelines) {
  const Graph add = graph_of(kAdd), chain = chain_graph();
  ClientRun first, second, third;
  ASSERT_EQ(first.create(client, add), VK_SUCCESS);
  ASSERT_EQ(second.create(client, chain), VK_SUCCESS);
  ASSERT_EQ(third.create(client, add, {.padding = 1}), VK_SUCCESS);
  const auto sums = random_inputs(add, 3), others = random_inputs(add, 4),
             pixels = random_inputs(chain, 5);
  first.write(sums);
  second.write(pixels);
  third.write(others);
  Recorded all{&client, {&first, &second, &third, &first}};
  ASSERT_EQ(client_submit(
                &client,
                [](VkCommandBuffer commands, void* user) {
                  const auto* recorded = static_cast<const Recorded*>(user);
                  for (const ClientRun* run : recorded->runs) {
                    client_record_graph(recorded->client, commands, &run->graph);
                    client_full_barrier(commands);
                  }
                },
                &all),
            VK_SUCCESS);
  EXPECT_EQ(first.read(), must(interpret(add, sums)));
  EXPECT_EQ(second.read(), must(interpret(chain, pixels)));
  EXPECT_EQ(third.read(), must(interpret(add, others)));
}

TEST_F(GraphLayerTest, OneSessionServesSeveralSetsOfTensors) {
  const Graph graph = chain_graph();
  ClientRun run, other;
  ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
  ASSERT_EQ(other.create(client, graph), VK_SUCCESS);
  const auto inputs = random_inputs(graph, 6), more = random_inputs(graph, 7);
  run.write(inputs);
  other.write(more);
  // The second set goes through the session of the first.
  struct Both {
    const Client* client;
    const ClientGraph* graph;
    VkDescriptorSet sets[2];
  } both{&client, &run.graph, {run.graph.set, other.graph.set}};
  ASSERT_EQ(client_submit(
                &client,
                [](VkCommandBuffer commands, void* user) {
                  const auto* all = static_cast<const Both*>(user);
                  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                    all->graph->pipeline);
                  for (const VkDescriptorSet set : all->sets) {
                    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                            all->graph->layout, 0, 1, &set, 0, nullptr);
                    // No barrier: the tensors differ, and the session's memory is not the client's affair.
                    all->client->CmdDispatchDataGraphARM(commands, all->graph->session, nullptr);
                  }
                },
                &both),
            VK_SUCCESS)
      << client.last_message;
  EXPECT_EQ(run.read(), must(interpret(graph, inputs)));
  EXPECT_EQ(other.read(), must(interpret(graph, more)));
}

TEST_F(GraphLayerTest, TensorsComeAndGoUnderOnePipeline) {
  const Graph graph = chain_graph();
  ClientRun run;
  ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
  for (uint64_t seed = 10; seed < 14; ++seed) {
    // The driver may give the same handles again.
    for (ClientTensor& tensor : run.tensors) {
      ClientTensor again;
      const ClientTensor old = tensor;
      client_destroy_tensor(&client, &tensor);
      ASSERT_EQ(client_create_tensor(&client, old.description.format, old.description.tiling,
                                     old.description.dimensionCount, old.dims, nullptr, &again),
                VK_SUCCESS);
      tensor = again;
    }
    std::vector<VkTensorViewARM> views;
    for (const ClientTensor& tensor : run.tensors) views.push_back(tensor.view);
    client_write_set(&client, &run.graph, static_cast<uint32_t>(views.size()), views.data());
    const std::vector<Tensor> inputs = random_inputs(graph, seed);
    EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs)));
  }
}

TEST_F(GraphLayerTest, ThreadsCreateAndRecordSideBySide) {
  const Graph graph = chain_graph();
  const std::vector<Tensor> inputs = random_inputs(graph, 20);
  const std::vector<Tensor> expected = must(interpret(graph, inputs));
  std::mutex queue;  // a queue belongs to one thread at a time
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i)
    threads.emplace_back([&] {
      for (int round = 0; round < 3; ++round) {
        ClientRun run;
        ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
        run.write(inputs);
        const std::lock_guard lock(queue);
        ASSERT_EQ(run.submit(), VK_SUCCESS);
        EXPECT_EQ(run.read(), expected);
      }
    });
  for (std::thread& thread : threads) thread.join();
}

TEST_F(GraphLayerTest, DevicesAndInstancesDoNotMeet) {
  const Graph graph = graph_of(kAdd);
  Client other;
  ASSERT_EQ(client_open(&other, nullptr), VK_SUCCESS);
  {
    ClientRun here, there;
    ASSERT_EQ(here.create(client, graph), VK_SUCCESS);
    ASSERT_EQ(there.create(other, graph), VK_SUCCESS);
    const auto inputs = random_inputs(graph, 8), more = random_inputs(graph, 9);
    EXPECT_EQ(here.run(inputs), must(interpret(graph, inputs)));
    EXPECT_EQ(there.run(more), must(interpret(graph, more)));
  }
  client_close(&other);
  EXPECT_EQ(other.validation_messages, 0u);
}

TEST_F(GraphLayerTest, StartsOnKernelsThatAreThereSoonAndGoesOnTheSame) {
  ConvCase row{.name = "heavy", .h = 24, .w = 24, .ic = 32, .oc = 32};
  row.weight_min = -20, row.weight_max = 20;
  const Graph graph = row.graph();
  VkDataGraphPipelineCompilerControlCreateInfoARM control{};
  control.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_COMPILER_CONTROL_CREATE_INFO_ARM;
  for (const char* vendor : {"expected-runs=1e9", "expected-runs=1e9,compile=at-once"}) {
    control.pVendorOptions = vendor;
    ClientRun run;
    ASSERT_EQ(run.create(client, graph, {.next = &control}), VK_SUCCESS) << client.last_message;
    for (const uint64_t frame : {1, 2, 3}) {
      const std::vector<Tensor> inputs = random_inputs(graph, frame);
      EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs))) << vendor << ", frame " << frame;
    }
  }
}

}  // namespace
}  // namespace shale
