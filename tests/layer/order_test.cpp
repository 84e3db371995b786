// What careless programs do: objects destroyed too early, twice or never, callbacks that fail, ends without an end. The layer
// refuses what it can see, and never takes the program down. Validation is not in this test's chain: it would speak all the time.
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>

#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

class OrderLayerTest : public LayerTest {
 protected:
  void SetUp() override {
    if (validated()) GTEST_SKIP() << "calls that are wrong on purpose";
    LayerTest::SetUp();
  }
};

TEST_F(OrderLayerTest, APipelineMayGoBeforeItsSessions) {
  ClientRun run;
  ASSERT_EQ(run.create(client, graph_of(kDouble)), VK_SUCCESS);
  vkDestroyPipeline(client.device, run.graph.pipeline, nullptr);
  run.graph.pipeline = VK_NULL_HANDLE;
  VkDataGraphPipelineSessionMemoryRequirementsInfoARM which{};
  which.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_MEMORY_REQUIREMENTS_INFO_ARM;
  which.session = run.graph.session;
  VkMemoryRequirements2 needs{};
  needs.sType = VK_STRUCTURE_TYPE_MEMORY_REQUIREMENTS_2;
  client.GetDataGraphPipelineSessionMemoryRequirementsARM(client.device, &which, &needs);
  EXPECT_GT(needs.memoryRequirements.size, 0u);
}

TEST_F(OrderLayerTest, WhatIsDestroyedIsMissedWhereItIsUsed) {
  const Graph graph = graph_of(kDouble);
  ClientRun run;
  ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
  EXPECT_EQ(run.submit(), VK_SUCCESS) << client.last_message;
  client_destroy_tensor(&client, &run.tensors[0]);
  const VkTensorViewARM other = run.tensors[1].view;
  EXPECT_LT(run.submit(), 0) << "the set still names the tensor";
  client_write_set(&client, &run.graph, 1, &other);  // two of one; the set is whole again
  EXPECT_EQ(run.submit(), VK_SUCCESS) << client.last_message;
  run.tensors[0] = {};

  const VkDataGraphPipelineSessionARM gone = run.graph.session;
  client.DestroyDataGraphPipelineSessionARM(client.device, gone, nullptr);
  EXPECT_LT(run.submit(), 0) << "the session is gone";
  client.DestroyDataGraphPipelineSessionARM(client.device, gone, nullptr);
  run.graph.session = VK_NULL_HANDLE;
}

TEST_F(OrderLayerTest, ThereMayBeVeryManySessions) {
  const Graph graph = graph_of(kDouble);
  const std::vector<Tensor> inputs = random_inputs(graph, 1);
  ClientRun run;
  ASSERT_EQ(run.create(client, graph), VK_SUCCESS);
  run.write(inputs);
  constexpr size_t kCount = 1000;
  const VkDataGraphPipelineSessionARM own = run.graph.session;
  std::vector<std::pair<VkDataGraphPipelineSessionARM, VkDeviceMemory>> sessions(kCount);
  for (auto& [session, memory] : sessions) {
    VkDeviceSize bytes;
    ASSERT_EQ(client_create_session(&client, run.graph.pipeline, &session, &memory, &bytes),
              VK_SUCCESS);
  }
  for (size_t i = 0; i < kCount; i += 97) {
    run.graph.session = sessions[i].first;
    EXPECT_EQ(run.submit(), VK_SUCCESS) << client.last_message;
  }
  EXPECT_EQ(run.read(), must(interpret(graph, inputs)));
  for (const auto& [session, memory] : sessions) {
    client.DestroyDataGraphPipelineSessionARM(client.device, session, nullptr);
    vkFreeMemory(client.device, memory, nullptr);
  }
  run.graph.session = own;
}

/// Callbacks of which the one of a number fails, counting what is held.
struct Failing {
  int left = 0;
  std::map<void*, size_t> held;

  static VKAPI_ATTR void* VKAPI_CALL allocate(void* self, size_t size, size_t alignment,
                                              VkSystemAllocationScope) {
    auto* own = static_cast<Failing*>(self);
    if (own->left-- == 0) return nullptr;
    void* memory = nullptr;
    if (posix_memalign(&memory, std::max(alignment, sizeof(void*)), size) != 0) return nullptr;
    own->held[memory] = size;
    return memory;
  }
  static VKAPI_ATTR void VKAPI_CALL free_one(void* self, void* memory) {
    if (!memory) return;
    EXPECT_EQ(static_cast<Failing*>(self)->held.erase(memory), 1u);
    std::free(memory);
  }
  static VKAPI_ATTR void* VKAPI_CALL reallocate(void* self, void* old, size_t size,
                                                size_t alignment, VkSystemAllocationScope scope) {
    auto* own = static_cast<Failing*>(self);
    void* memory = size == 0 ? nullptr : allocate(self, size, alignment, scope);
    if (memory && old) std::memcpy(memory, old, std::min(size, own->held[old]));
    if (memory || size == 0) free_one(self, old);
    return memory;
  }
  VkAllocationCallbacks callbacks() {
    return {this, allocate, reallocate, free_one, nullptr, nullptr};
  }
};

TEST_F(OrderLayerTest, CallbacksMayFailAnywhere) {
  const int64_t dims[] = {4, 5};
  VkTensorDescriptionARM description{};
  description.sType = VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM;
  description.tiling = VK_TENSOR_TILING_LINEAR_ARM;
  description.format = VK_FORMAT_R8_SINT;
  description.dimensionCount = 2;
  description.pDimensions = dims;
  description.usage = VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM;
  VkTensorCreateInfoARM tensor_info{};
  tensor_info.sType = VK_STRUCTURE_TYPE_TENSOR_CREATE_INFO_ARM;
  tensor_info.pDescription = &description;
  ClientRun run;
  ASSERT_EQ(run.create(client, graph_of(kDouble)), VK_SUCCESS);
  VkDataGraphPipelineSessionCreateInfoARM session_info{};
  session_info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SESSION_CREATE_INFO_ARM;
  session_info.dataGraphPipeline = run.graph.pipeline;
  const auto until_it_works = [](const std::function<VkResult(const VkAllocationCallbacks&)>& make,
                                 const std::function<void(const VkAllocationCallbacks&)>& destroy) {
    int failures = 0;
    for (VkResult result = VK_ERROR_OUT_OF_HOST_MEMORY; result != VK_SUCCESS; ++failures) {
      Failing failing{failures, {}};
      const VkAllocationCallbacks callbacks = failing.callbacks();
      result = make(callbacks);
      if (result == VK_SUCCESS)
        destroy(callbacks);
      else
        EXPECT_EQ(result, VK_ERROR_OUT_OF_HOST_MEMORY) << failures;
      EXPECT_TRUE(failing.held.empty()) << failures;
      ASSERT_LT(failures, 100);
    }
    EXPECT_GT(failures, 1) << "the callbacks are used";
  };
  VkTensorARM tensor = VK_NULL_HANDLE;
  until_it_works(
      [&](const VkAllocationCallbacks& callbacks) {
        return client.CreateTensorARM(client.device, &tensor_info, &callbacks, &tensor);
      },
      [&](const VkAllocationCallbacks& callbacks) {
        client.DestroyTensorARM(client.device, tensor, &callbacks);
      });
  VkTensorViewCreateInfoARM view_info{};
  view_info.sType = VK_STRUCTURE_TYPE_TENSOR_VIEW_CREATE_INFO_ARM;
  view_info.tensor = run.tensors[0].tensor;
  view_info.format = run.tensors[0].description.format;
  VkTensorViewARM view = VK_NULL_HANDLE;
  until_it_works(
      [&](const VkAllocationCallbacks& callbacks) {
        return client.CreateTensorViewARM(client.device, &view_info, &callbacks, &view);
      },
      [&](const VkAllocationCallbacks& callbacks) {
        client.DestroyTensorViewARM(client.device, view, &callbacks);
      });
  VkDataGraphPipelineSessionARM session = VK_NULL_HANDLE;
  until_it_works(
      [&](const VkAllocationCallbacks& callbacks) {
        return client.CreateDataGraphPipelineSessionARM(client.device, &session_info, &callbacks,
                                                        &session);
      },
      [&](const VkAllocationCallbacks& callbacks) {
        client.DestroyDataGraphPipelineSessionARM(client.device, session, &callbacks);
      });
}

TEST_F(OrderLayerTest, CountsOfNothingDoNothing) {
  VkPipeline none = VK_NULL_HANDLE;
  EXPECT_EQ(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 0,
                                               nullptr, nullptr, &none),
            VK_SUCCESS);
  EXPECT_EQ(client.BindTensorMemoryARM(client.device, 0, nullptr), VK_SUCCESS);
  EXPECT_EQ(client.BindDataGraphPipelineSessionMemoryARM(client.device, 0, nullptr), VK_SUCCESS);
  vkUpdateDescriptorSets(client.device, 0, nullptr, 0, nullptr);
  client.DestroyTensorARM(client.device, VK_NULL_HANDLE, nullptr);
  client.DestroyTensorViewARM(client.device, VK_NULL_HANDLE, nullptr);
  client.DestroyDataGraphPipelineSessionARM(client.device, VK_NULL_HANDLE, nullptr);
  // A pipeline without anything, and one whose arrays are not there.
  VkDataGraphPipelineCreateInfoARM info{};
  info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM;
  EXPECT_LT(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 1,
                                               &info, nullptr, &none),
            0);
  ClientRun run;
  ASSERT_EQ(run.create(client, graph_of(kDouble)), VK_SUCCESS);
  VkBaseInStructure unknown{static_cast<VkStructureType>(1999999999), nullptr};
  VkDataGraphPipelineShaderModuleCreateInfoARM module{};
  module.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SHADER_MODULE_CREATE_INFO_ARM;
  module.pNext = &unknown;
  module.module = run.graph.module;
  module.pName = "main";
  module.constantCount = 3;
  info.pNext = &module;
  info.layout = run.graph.layout;
  EXPECT_LT(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 1,
                                               &info, nullptr, &none),
            0);
  module.constantCount = 0;
  info.resourceInfoCount = 2;
  EXPECT_LT(client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 1,
                                               &info, nullptr, &none),
            0);
}

/// Leaves a pipeline whose kernels are still being compiled, and says how the program ends.
[[noreturn]] void leave(bool destroys_device) {
  Client client{};
  if (client_open(&client, nullptr) != VK_SUCCESS) std::exit(3);
  ConvCase row{.name = "heavy", .h = 24, .w = 24, .ic = 32, .oc = 32};
  row.weight_min = -20, row.weight_max = 20;
  const Graph graph = row.graph();
  VkDataGraphPipelineCompilerControlCreateInfoARM control{};
  control.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_COMPILER_CONTROL_CREATE_INFO_ARM;
  control.pVendorOptions = "expected-runs=1e9";
  auto* run = new ClientRun;  // never destroyed
  if (run->create(client, graph, {.next = &control}) != VK_SUCCESS) std::exit(4);
  run->write(random_inputs(graph, 1));
  for (int i = 0; i < 3; ++i)
    if (run->submit() != VK_SUCCESS) std::exit(5);
  if (destroys_device) vkDestroyDevice(client.device, nullptr);
  std::exit(0);
}

TEST_F(OrderLayerTest, ADeviceMayGoBeforeEverythingElse) {
  testing::GTEST_FLAG(death_test_style) = "threadsafe";
  EXPECT_EXIT(leave(true), testing::ExitedWithCode(0), "");
}

TEST_F(OrderLayerTest, AProgramMayEndWhileKernelsAreCompiled) {
  testing::GTEST_FLAG(death_test_style) = "threadsafe";
  EXPECT_EXIT(leave(false), testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace shale
