// Data graph pipelines: caches, properties, specialization, and modules that are wrong.
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>

#include "tests/compiler/graph_support.h"
#include "tests/compiler/spirv_text.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

const char* kNegate = R"(
graph main {
  input %x : i32[1,7]
  const %c : i32[1,7] = [1,2,3,4,5,6,7]
  %s = sub %x, %c : i32[1,7]
  %y = mul %s, %s, %shift : i32[1,7]
  return %y
}
)";

Graph small_graph() {
  std::string text = kNegate;
  return graph_of(text.insert(text.find("  %s ="), "  const %shift : i8[1] = [0]\n"));
}

class PipelineLayerTest : public LayerTest {
 protected:
  VkPipelineCache make_cache(const std::vector<uint8_t>& data = {}) const {
    VkPipelineCacheCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO;
    info.initialDataSize = data.size();
    info.pInitialData = data.data();
    VkPipelineCache cache = VK_NULL_HANDLE;
    EXPECT_EQ(vkCreatePipelineCache(client.device, &info, nullptr, &cache), VK_SUCCESS);
    return cache;
  }
  std::vector<uint8_t> cache_data(VkPipelineCache cache) const {
    size_t size = 0;
    EXPECT_EQ(vkGetPipelineCacheData(client.device, cache, &size, nullptr), VK_SUCCESS);
    std::vector<uint8_t> data(size);
    EXPECT_EQ(vkGetPipelineCacheData(client.device, cache, &size, data.data()), VK_SUCCESS);
    data.resize(size);
    return data;
  }
  /// Creates the graph with a cache and tells what the feedback says.
  VkResult create(const Graph& graph, VkPipelineCache cache, VkPipelineCreateFlags2 flags,
                  bool* hit, int64_t padding = 0) {
    VkPipelineCreationFeedback feedback{};
    VkPipelineCreationFeedbackCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_PIPELINE_CREATION_FEEDBACK_CREATE_INFO;
    info.pPipelineCreationFeedback = &feedback;
    ClientRun run;
    const VkResult result = run.create(
        client, graph, {.padding = padding, .flags = flags, .cache = cache, .next = &info});
    EXPECT_TRUE(feedback.flags & VK_PIPELINE_CREATION_FEEDBACK_VALID_BIT);
    *hit = feedback.flags & VK_PIPELINE_CREATION_FEEDBACK_APPLICATION_PIPELINE_CACHE_HIT_BIT;
    return result;
  }
};

constexpr VkPipelineCreateFlags2 kMustNotCompile =
    VK_PIPELINE_CREATE_FAIL_ON_PIPELINE_COMPILE_REQUIRED_BIT;

TEST_F(PipelineLayerTest, CachesTellWhetherTheyHelped) {
  const Graph graph = small_graph();
  const VkPipelineCache cache = make_cache(), other = make_cache();
  bool hit = true;
  EXPECT_EQ(create(graph, cache, kMustNotCompile, &hit), VK_PIPELINE_COMPILE_REQUIRED);
  EXPECT_EQ(create(graph, cache, 0, &hit), VK_SUCCESS);
  EXPECT_FALSE(hit);
  EXPECT_EQ(create(graph, cache, kMustNotCompile, &hit), VK_SUCCESS);
  EXPECT_TRUE(hit);
  EXPECT_EQ(create(graph, cache, kMustNotCompile, &hit, 2), VK_PIPELINE_COMPILE_REQUIRED)
      << "strides are part of what is cached";
  EXPECT_EQ(create(graph, other, kMustNotCompile, &hit), VK_PIPELINE_COMPILE_REQUIRED);
  ASSERT_EQ(vkMergePipelineCaches(client.device, other, 1, &cache), VK_SUCCESS);
  EXPECT_EQ(create(graph, other, kMustNotCompile, &hit), VK_SUCCESS);
  EXPECT_TRUE(hit);

  std::vector<uint8_t> data = cache_data(cache);
  const VkPipelineCache third = make_cache(data);
  EXPECT_EQ(create(graph, third, kMustNotCompile, &hit), VK_SUCCESS);
  // Data that are damaged help nobody, and hurt nobody.
  std::vector<VkPipelineCache> damaged;
  std::mt19937 random(1);
  for (int i = 0; i < 64; ++i) {
    std::vector<uint8_t> bad = data;
    bad[bad.size() - 1 - random() % 64] ^= static_cast<uint8_t>(1 + random() % 255);
    if (i % 2) bad.resize(32 + random() % (bad.size() - 32));
    damaged.push_back(make_cache(bad));
    EXPECT_EQ(create(graph, damaged.back(), kMustNotCompile, &hit), VK_PIPELINE_COMPILE_REQUIRED);
  }
  size_t small = data.size() - 1;
  std::vector<uint8_t> part(small);
  EXPECT_EQ(vkGetPipelineCacheData(client.device, cache, &small, part.data()), VK_INCOMPLETE);
  EXPECT_LE(small, part.size());
  for (const VkPipelineCache each : damaged) vkDestroyPipelineCache(client.device, each, nullptr);
  for (const VkPipelineCache each : {cache, other, third})
    vkDestroyPipelineCache(client.device, each, nullptr);
}

TEST_F(PipelineLayerTest, PropertiesAreWrittenAsFarAsTheyFit) {
  const Graph graph = small_graph();
  ClientRun run;
  ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
  VkDataGraphPipelineInfoARM which{};
  which.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_INFO_ARM;
  which.dataGraphPipeline = run.graph.pipeline;
  uint32_t count = 0;
  ASSERT_EQ(
      client.GetDataGraphPipelineAvailablePropertiesARM(client.device, &which, &count, nullptr),
      VK_SUCCESS);
  ASSERT_EQ(count, 2u);
  std::vector<VkDataGraphPipelinePropertyARM> properties(
      3, VK_DATA_GRAPH_PIPELINE_PROPERTY_MAX_ENUM_ARM);
  count = 1;
  EXPECT_EQ(client.GetDataGraphPipelineAvailablePropertiesARM(client.device, &which, &count,
                                                              properties.data()),
            VK_INCOMPLETE);
  EXPECT_EQ(properties[1], VK_DATA_GRAPH_PIPELINE_PROPERTY_MAX_ENUM_ARM);
  count = 3;
  EXPECT_EQ(client.GetDataGraphPipelineAvailablePropertiesARM(client.device, &which, &count,
                                                              properties.data()),
            VK_SUCCESS);
  ASSERT_EQ(count, 2u);
  for (uint32_t i = 0; i < count; ++i) {
    VkDataGraphPipelinePropertyQueryResultARM result{};
    result.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_PROPERTY_QUERY_RESULT_ARM;
    result.property = properties[i];
    ASSERT_EQ(client.GetDataGraphPipelinePropertiesARM(client.device, &which, 1, &result),
              VK_SUCCESS);
    const size_t all = result.dataSize;
    ASSERT_GT(all, 4u);
    for (const size_t room : {all, all - 1, size_t{3}}) {
      std::vector<uint8_t> data(all + 4, 0x7f);
      result.pData = data.data();
      result.dataSize = room;
      EXPECT_EQ(client.GetDataGraphPipelinePropertiesARM(client.device, &which, 1, &result),
                room < all ? VK_INCOMPLETE : VK_SUCCESS);
      EXPECT_EQ(result.dataSize, room);
      if (result.isText) {
        EXPECT_EQ(data[room - 1], 0);
      }
      for (size_t at = room; at < data.size(); ++at) EXPECT_EQ(data[at], 0x7f);
    }
  }
}

TEST_F(PipelineLayerTest, AnIdentifierAndACacheMakeThePipelineAgain) {
  const Graph graph = small_graph();
  const VkPipelineCache cache = make_cache(), empty = make_cache();
  ClientRun run;
  ASSERT_EQ(run.create(client, graph, {.padding = 1, .cache = cache}), VK_SUCCESS);
  VkDataGraphPipelineInfoARM which{};
  which.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_INFO_ARM;
  which.dataGraphPipeline = run.graph.pipeline;
  uint8_t bytes[64];
  VkDataGraphPipelinePropertyQueryResultARM result{};
  result.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_PROPERTY_QUERY_RESULT_ARM;
  result.property = VK_DATA_GRAPH_PIPELINE_PROPERTY_IDENTIFIER_ARM;
  result.dataSize = sizeof bytes;
  result.pData = bytes;
  ASSERT_EQ(client.GetDataGraphPipelinePropertiesARM(client.device, &which, 1, &result),
            VK_SUCCESS);
  VkDataGraphPipelineIdentifierCreateInfoARM named{};
  named.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_IDENTIFIER_CREATE_INFO_ARM;
  named.identifierSize = static_cast<uint32_t>(result.dataSize);
  named.pIdentifier = bytes;
  VkDataGraphPipelineCreateInfoARM info{};
  info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM;
  info.pNext = &named;
  info.flags = kMustNotCompile;
  info.layout = run.graph.layout;
  VkPipeline pipeline = run.graph.pipeline;
  EXPECT_EQ(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, empty, 1, &info,
                                               nullptr, &pipeline),
            VK_PIPELINE_COMPILE_REQUIRED);
  EXPECT_EQ(pipeline, VkPipeline{VK_NULL_HANDLE});
  ASSERT_EQ(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, cache, 1, &info,
                                               nullptr, &pipeline),
            VK_SUCCESS);
  // It runs in place of the first, with a session of its own.
  client.DestroyDataGraphPipelineSessionARM(client.device, run.graph.session, nullptr);
  vkFreeMemory(client.device, run.graph.session_memory, nullptr);
  vkDestroyPipeline(client.device, run.graph.pipeline, nullptr);
  run.graph.pipeline = pipeline;
  ASSERT_EQ(client_create_session(&client, pipeline, &run.graph.session, &run.graph.session_memory,
                                  &run.graph.session_bytes),
            VK_SUCCESS);
  const std::vector<Tensor> inputs = random_inputs(graph, 1);
  EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs)));
  vkDestroyPipelineCache(client.device, cache, nullptr);
  vkDestroyPipelineCache(client.device, empty, nullptr);
}

/// x + c, where c is a specialization constant of an int32 tensor; x >> 1, rounded if `round` is set.
const char* kSpecialized = R"(
OpCapability GraphARM
OpCapability TensorsARM
OpCapability Shader
OpCapability VulkanMemoryModel
OpExtension "SPV_ARM_graph"
OpExtension "SPV_ARM_tensors"
%tosa = OpExtInstImport "TOSA.001000.1"
OpMemoryModel Logical Vulkan
OpDecorate %x DescriptorSet 0
OpDecorate %x Binding 0
OpDecorate %y DescriptorSet 0
OpDecorate %y Binding 1
OpDecorate %c 1 7
OpDecorate %round 1 8
%bool = OpTypeBool
%i32 = OpTypeInt 32 0
%c0 = OpConstant %i32 0
%one = OpConstant %i32 1
%three = OpConstant %i32 3
%c = OpSpecConstant %i32 5
%round = OpSpecConstantFalse %bool
%a1 = OpTypeArray %i32 %one
%shape = OpConstantComposite %a1 %three
%t = OpTypeTensorARM %i32 %one %shape
%p = OpTypePointer UniformConstant %t
%x = OpVariable %p UniformConstant
%y = OpVariable %p UniformConstant
%addend = OpSpecConstantComposite %t %c %c %c
%ones = OpConstantComposite %t %one %one %one
%gt = OpTypeGraphARM 1 %t %t
OpGraphEntryPointARM %g "main" %x %y
%g = OpGraphARM %gt
%in = OpGraphInputARM %t %c0
%sum = OpExtInst %t %tosa ADD %in %addend
%out = OpExtInst %t %tosa ARITHMETIC_RIGHT_SHIFT %round %sum %ones
OpGraphSetOutputARM %out %c0
OpGraphEndARM
)";

TEST_F(PipelineLayerTest, SpecializationConstantsAreSet) {
  const std::vector<uint32_t> words = assemble_spirv(kSpecialized);
  const int64_t dims[] = {3};
  ClientTensor x, y;
  ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R32_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1, dims,
                                 nullptr, &x),
            VK_SUCCESS);
  ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R32_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1, dims,
                                 nullptr, &y),
            VK_SUCCESS);
  const VkTensorDescriptionARM* descriptions[] = {&x.description, &y.description};
  const struct {
    int32_t addend;
    VkBool32 round;
  } values{100, VK_TRUE};
  const VkSpecializationMapEntry entries[] = {{7, 0, 4}, {8, 4, 4}, {9, 0, 4}};
  const VkSpecializationInfo specialization{3, entries, sizeof values, &values};
  const VkSpecializationMapEntry outside{7, 6, 4};
  const VkSpecializationInfo broken{1, &outside, sizeof values, &values};
  for (const VkSpecializationInfo* info :
       {static_cast<const VkSpecializationInfo*>(nullptr), &specialization, &broken}) {
    if (info == &broken && validated()) continue;
    ClientGraphInfo graph_info{};
    graph_info.words = words.data();
    graph_info.word_count = words.size();
    graph_info.entry_point = "main";
    graph_info.tensor_count = 2;
    graph_info.descriptions = descriptions;
    graph_info.specialization = info;
    ClientGraph graph;
    const VkResult result = client_create_graph(&client, &graph_info, &graph);
    if (info == &broken) {
      EXPECT_LT(result, 0);
      continue;
    }
    ASSERT_EQ(result, VK_SUCCESS) << client.last_message;
    const VkTensorViewARM views[] = {x.view, y.view};
    client_write_set(&client, &graph, 2, views);
    auto* in = static_cast<int32_t*>(x.mapped);
    const auto* out = static_cast<const int32_t*>(y.mapped);
    in[0] = 0, in[1] = -6, in[2] = 1000;
    struct Call {
      const Client* client;
      const ClientGraph* graph;
    } call{&client, &graph};
    ASSERT_EQ(client_submit(
                  &client,
                  [](VkCommandBuffer commands, void* user) {
                    const auto* all = static_cast<const Call*>(user);
                    client_record_graph(all->client, commands, all->graph);
                  },
                  &call),
              VK_SUCCESS);
    for (int i = 0; i < 3; ++i)
      EXPECT_EQ(out[i], info ? (in[i] + 100 + 1) >> 1 : (in[i] + 5) >> 1) << i;
    client_destroy_graph(&client, &graph);
  }
  client_destroy_tensor(&client, &x);
  client_destroy_tensor(&client, &y);
}

TEST_F(PipelineLayerTest, RefusesWhatDoesNotFitTheModule) {
  SHALE_SKIP_IF_VALIDATED();
  const Graph graph = small_graph();
  const SpirvGraphModule module = must(write_spirv_graph(graph, {.external_constants = true}));
  const auto refused = [&](const char* what, const SpirvGraphModule& broken,
                           const GraphOptions& options = {}) {
    const uint32_t before = client.other_messages;
    ClientRun run;
    EXPECT_LT(run.create(client, graph, broken, options), 0) << what;
    EXPECT_EQ(run.graph.pipeline, VkPipeline{VK_NULL_HANDLE}) << what;
    EXPECT_GT(client.other_messages, before) << what;
  };
  SpirvGraphModule broken = module;
  broken.entry_point = "other";
  refused("no such entry point", broken);
  broken = module;
  broken.constants.pop_back();
  refused("a constant is missing", broken);
  broken = module;
  broken.constants[0] = Tensor::zeros({DType::kInt32, {7, 1}});
  refused("a constant of another shape", broken);
  broken = module;
  broken.constants[0] = Tensor::zeros({DType::kInt8, {1, 7}});
  refused("a constant of another type", broken);
  broken = module;
  broken.words.resize(broken.words.size() - 3);
  refused("a module without its end", broken);
  refused("descriptor buffers", module, {.flags = VkPipelineCreateFlags2{1} << 29});
  const Graph other = graph_of(R"(
graph main {
  input %x : i32[1,8]
  %y = abs %x : i32[1,8]
  return %y
}
)");
  ClientRun run;
  EXPECT_LT(run.create(client, other, module, {}), 0) << "tensors of other sizes";
}

TEST_F(PipelineLayerTest, GraphsAreKeptOnDiskUnlessTheyAreDamaged) {
  namespace fs = std::filesystem;
  const fs::path folder = fs::path(testing::TempDir()) / "shale_layer_cache";
  fs::remove_all(folder);
  setenv("SHALE_LAYER_CACHE", folder.c_str(), 1);
  const Graph graph = small_graph();
  const std::vector<Tensor> inputs = random_inputs(graph, 5);
  const auto log_of_new_device = [&] {
    Client other;
    EXPECT_EQ(client_open(&other, nullptr), VK_SUCCESS);
    std::string log(256, '\0');
    {
      ClientRun run;
      EXPECT_EQ(run.create(other, graph), VK_SUCCESS);
      EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs)));
      VkDataGraphPipelineInfoARM which{};
      which.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_INFO_ARM;
      which.dataGraphPipeline = run.graph.pipeline;
      VkDataGraphPipelinePropertyQueryResultARM result{};
      result.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_PROPERTY_QUERY_RESULT_ARM;
      result.property = VK_DATA_GRAPH_PIPELINE_PROPERTY_CREATION_LOG_ARM;
      result.dataSize = log.size();
      result.pData = log.data();
      EXPECT_EQ(other.GetDataGraphPipelinePropertiesARM(other.device, &which, 1, &result),
                VK_SUCCESS);
    }
    client_close(&other);
    return log;
  };
  const auto packages = [&] {
    std::vector<fs::path> files;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder))
      if (entry.path().extension() == ".shale") files.push_back(entry.path());
    return files;
  };
  EXPECT_NE(log_of_new_device().find("compiled"), std::string::npos);
  ASSERT_EQ(packages().size(), 1u);
  EXPECT_NE(log_of_new_device().find("cache"), std::string::npos);
  std::fstream(packages()[0], std::ios::in | std::ios::out | std::ios::binary).seekp(100).put('?');
  EXPECT_NE(log_of_new_device().find("compiled"), std::string::npos);
  EXPECT_NE(log_of_new_device().find("cache"), std::string::npos) << "the damaged file is replaced";
  fs::resize_file(packages()[0], 10);
  EXPECT_NE(log_of_new_device().find("compiled"), std::string::npos);
  setenv("SHALE_LAYER_CACHE", "off", 1);
  fs::remove_all(folder);
}

TEST_F(PipelineLayerTest, OneOfSeveralMayFail) {
  SHALE_SKIP_IF_VALIDATED();
  const Graph graph = small_graph();
  ClientRun run;
  ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
  VkDataGraphPipelineShaderModuleCreateInfoARM wrong{};
  wrong.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SHADER_MODULE_CREATE_INFO_ARM;
  wrong.module = run.graph.module;
  wrong.pName = "nothing";
  VkDataGraphPipelineCreateInfoARM infos[2]{};
  for (VkDataGraphPipelineCreateInfoARM& info : infos) {
    info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM;
    info.pNext = &wrong;
    info.layout = run.graph.layout;
  }
  infos[1].pNext = nullptr;
  VkPipeline pipelines[2] = {run.graph.pipeline, run.graph.pipeline};
  EXPECT_LT(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 2,
                                               infos, nullptr, pipelines),
            0);
  EXPECT_EQ(pipelines[0], VkPipeline{VK_NULL_HANDLE});
  EXPECT_EQ(pipelines[1], VkPipeline{VK_NULL_HANDLE});
}

TEST_F(PipelineLayerTest, AThousandDamagedModulesAreRefusedOrRun) {
  SHALE_SKIP_IF_VALIDATED();
  const Graph graph = small_graph();
  const SpirvGraphModule module = must(write_spirv_graph(graph, {.external_constants = false}));
  std::mt19937 random(3);
  // Behind the capabilities: without that of graphs a module is the driver's.
  size_t first = 5;
  while ((module.words[first] & 0xffff) == 17) first += module.words[first] >> 16;
  size_t refused = 0;
  for (int i = 0; i < 1000; ++i) {
    SpirvGraphModule damaged = module;
    for (auto n = 1 + random() % 8; n > 0; --n)
      damaged.words[first + random() % (damaged.words.size() - first)] ^= 1u << random() % 24;
    ClientRun run;
    const VkResult result =
        run.create(client, graph, damaged, {.flags = VK_PIPELINE_CREATE_DISABLE_OPTIMIZATION_BIT});
    if (result != VK_SUCCESS) ++refused;
  }
  EXPECT_GT(refused, 500u);
}

}  // namespace
}  // namespace shale
