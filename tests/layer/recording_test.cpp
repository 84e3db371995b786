// What stands around a dispatch: descriptors of every kind, barriers, secondaries, and the application's own
// compute work, whose state has to be as it was.
#include <cstring>

#include "compiler/spirv/glsl.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

class RecordingLayerTest : public LayerTest {
 protected:
  void SetUp() override {
    LayerTest::SetUp();
    if (!is_open) return;
    ASSERT_EQ(run.create(client, source), VK_SUCCESS) << client.last_message;
    run.write(inputs);
  }
  void TearDown() override {
    run.destroy();
    LayerTest::TearDown();
  }
  VkResult submit(const std::function<void(VkCommandBuffer)>& record) const {
    return client_submit(
        &client,
        [](VkCommandBuffer commands, void* user) {
          (*static_cast<const std::function<void(VkCommandBuffer)>*>(user))(commands);
        },
        const_cast<std::function<void(VkCommandBuffer)>*>(&record));
  }
  void expect_doubled() {
    EXPECT_EQ(run.read(), must(interpret(source, inputs)));
    std::memset(run.tensors[1].mapped, 0, 36);
  }

  const Graph source = graph_of(kDouble);
  const std::vector<Tensor> inputs = random_inputs(source, 1);
  ClientRun run;
};

TEST_F(RecordingLayerTest, DescriptorsAreCopied) {
  VkDescriptorSetAllocateInfo allocate{};
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_TENSOR_ARM, 2};
  VkDescriptorPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  pool_info.flags = VK_DESCRIPTOR_POOL_CREATE_FREE_DESCRIPTOR_SET_BIT;
  pool_info.maxSets = 1;
  pool_info.poolSizeCount = 1;
  pool_info.pPoolSizes = &size;
  VkDescriptorPool pool;
  ASSERT_EQ(vkCreateDescriptorPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
  allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  allocate.descriptorPool = pool;
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &run.graph.set_layout;
  VkDescriptorSet set;
  ASSERT_EQ(vkAllocateDescriptorSets(client.device, &allocate, &set), VK_SUCCESS);
  VkCopyDescriptorSet copies[2]{};
  for (uint32_t i = 0; i < 2; ++i) {
    copies[i].sType = VK_STRUCTURE_TYPE_COPY_DESCRIPTOR_SET;
    copies[i].srcSet = run.graph.set;
    copies[i].dstSet = set;
    copies[i].srcBinding = copies[i].dstBinding = i;
    copies[i].descriptorCount = 1;
  }
  const auto record = [&](VkCommandBuffer commands) {
    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, run.graph.pipeline);
    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, run.graph.layout, 0, 1,
                            &set, 0, nullptr);
    client.CmdDispatchDataGraphARM(commands, run.graph.session, nullptr);
  };
  if (!validated()) {
    EXPECT_LT(submit(record), 0) << "the set holds nothing yet";
  }
  vkUpdateDescriptorSets(client.device, 0, nullptr, 2, copies);
  EXPECT_EQ(submit(record), VK_SUCCESS) << client.last_message;
  expect_doubled();
  EXPECT_EQ(vkFreeDescriptorSets(client.device, pool, 1, &set), VK_SUCCESS);
  vkDestroyDescriptorPool(client.device, pool, nullptr);
}

TEST_F(RecordingLayerTest, TemplatesHoldTensorViews) {
  // Validation 1.4.363 makes writes without VkWriteDescriptorSetTensorARM of a template's data.
  SHALE_SKIP_IF_VALIDATED();
  struct Data {
    uint64_t before;
    VkTensorViewARM views[2];
  } data{1, {run.tensors[0].view, run.tensors[1].view}};
  // One entry over both bindings.
  const VkDescriptorUpdateTemplateEntry entry{
      0, 0, 2, VK_DESCRIPTOR_TYPE_TENSOR_ARM, offsetof(Data, views), sizeof(VkTensorViewARM)};
  VkDescriptorUpdateTemplateCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_UPDATE_TEMPLATE_CREATE_INFO;
  info.descriptorUpdateEntryCount = 1;
  info.pDescriptorUpdateEntries = &entry;
  info.templateType = VK_DESCRIPTOR_UPDATE_TEMPLATE_TYPE_DESCRIPTOR_SET;
  info.descriptorSetLayout = run.graph.set_layout;
  VkDescriptorUpdateTemplate update;
  ASSERT_EQ(vkCreateDescriptorUpdateTemplate(client.device, &info, nullptr, &update), VK_SUCCESS);
  const VkTensorViewARM swapped[2] = {data.views[1], data.views[0]};
  client_write_set(&client, &run.graph, 2, swapped);
  vkUpdateDescriptorSetWithTemplate(client.device, run.graph.set, update, &data);
  EXPECT_EQ(run.submit(), VK_SUCCESS) << client.last_message;
  expect_doubled();
  vkDestroyDescriptorUpdateTemplate(client.device, update, nullptr);
}

/// One recording, in a secondary buffer, that is submitted with other tensors each time.
TEST_F(RecordingLayerTest, SetsAreUpdatedAfterBinding) {
  VkPhysicalDeviceDataGraphFeaturesARM graphs{};
  graphs.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM;
  VkPhysicalDeviceFeatures2 features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
  features.pNext = &graphs;
  vkGetPhysicalDeviceFeatures2(client.physical, &features);
  if (!graphs.dataGraphUpdateAfterBind) GTEST_SKIP() << "the device has no update after bind";
  for (const int64_t padding : {0, 3}) {
    SCOPED_TRACE(padding);
    ClientRun own, other;
    const GraphOptions options{
        .padding = padding,
        .set_flags = VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT};
    ASSERT_EQ(own.create(client, source, options), VK_SUCCESS) << client.last_message;
    ASSERT_EQ(other.create(client, source, options), VK_SUCCESS) << client.last_message;
    const VkCommandPoolCreateInfo pool_info{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr, 0,
                                            client.family};
    VkCommandPool pool;
    ASSERT_EQ(vkCreateCommandPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
    VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr,
                                         pool, VK_COMMAND_BUFFER_LEVEL_SECONDARY, 1};
    VkCommandBuffer secondary, primary;
    ASSERT_EQ(vkAllocateCommandBuffers(client.device, &allocate, &secondary), VK_SUCCESS);
    allocate.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
    ASSERT_EQ(vkAllocateCommandBuffers(client.device, &allocate, &primary), VK_SUCCESS);
    VkCommandBufferInheritanceInfo inheritance{};
    inheritance.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_INHERITANCE_INFO;
    VkCommandBufferBeginInfo begin{};
    begin.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
    begin.pInheritanceInfo = &inheritance;
    ASSERT_EQ(vkBeginCommandBuffer(secondary, &begin), VK_SUCCESS);
    client_record_graph(&client, secondary, &own.graph);
    ASSERT_EQ(vkEndCommandBuffer(secondary), VK_SUCCESS) << client.last_message;
    ASSERT_EQ(vkBeginCommandBuffer(primary, &begin), VK_SUCCESS);
    vkCmdExecuteCommands(primary, 1, &secondary);
    client_full_barrier(primary);
    ASSERT_EQ(vkEndCommandBuffer(primary), VK_SUCCESS);
    for (const uint64_t seed : {1, 2, 3}) {
      ClientRun& target = seed == 2 ? own : other;
      const VkTensorViewARM views[] = {target.tensors[0].view, target.tensors[1].view};
      client_write_set(&client, &own.graph, 2, views);
      const std::vector<Tensor> values = random_inputs(source, seed);
      target.write(values);
      VkSubmitInfo submit_info{};
      submit_info.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO;
      submit_info.commandBufferCount = 1;
      submit_info.pCommandBuffers = &primary;
      ASSERT_EQ(vkQueueSubmit(client.queue, 1, &submit_info, VK_NULL_HANDLE), VK_SUCCESS)
          << client.last_message;
      ASSERT_EQ(vkQueueWaitIdle(client.queue), VK_SUCCESS);
      EXPECT_EQ(target.read(), must(interpret(source, values))) << seed;
    }
    vkDestroyCommandPool(client.device, pool, nullptr);
  }
}

TEST_F(RecordingLayerTest, DescriptorsArePushed) {
  const auto push = reinterpret_cast<PFN_vkCmdPushDescriptorSetKHR>(
      vkGetDeviceProcAddr(client.device, "vkCmdPushDescriptorSetKHR"));
  if (!push) GTEST_SKIP() << "the device has no push descriptors";
  ClientRun pushed;
  ASSERT_EQ(pushed.create(client, source,
                          {.set_flags = VK_DESCRIPTOR_SET_LAYOUT_CREATE_PUSH_DESCRIPTOR_BIT_KHR}),
            VK_SUCCESS);
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                pushed.graph.pipeline);
              VkWriteDescriptorSetTensorARM tensors[2]{};
              VkWriteDescriptorSet writes[2]{};
              for (uint32_t i = 0; i < 2; ++i) {
                tensors[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM;
                tensors[i].tensorViewCount = 1;
                tensors[i].pTensorViews = &run.tensors[i].view;
                writes[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
                writes[i].pNext = &tensors[i];
                writes[i].dstBinding = i;
                writes[i].descriptorCount = 1;
                writes[i].descriptorType = VK_DESCRIPTOR_TYPE_TENSOR_ARM;
              }
              push(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, pushed.graph.layout, 0, 1,
                   &writes[0]);
              push(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, pushed.graph.layout, 0, 1,
                   &writes[1]);
              client.CmdDispatchDataGraphARM(commands, pushed.graph.session, nullptr);
            }),
            VK_SUCCESS)
      << client.last_message;
  expect_doubled();
}

TEST_F(RecordingLayerTest, TensorBarriersOfAllForms) {
  VkTensorMemoryBarrierARM tensor{};
  tensor.sType = VK_STRUCTURE_TYPE_TENSOR_MEMORY_BARRIER_ARM;
  tensor.srcStageMask = tensor.dstStageMask = VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM;
  tensor.srcAccessMask = VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM;
  tensor.dstAccessMask = VK_ACCESS_2_DATA_GRAPH_READ_BIT_ARM | VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM;
  tensor.srcQueueFamilyIndex = tensor.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  tensor.tensor = run.tensors[1].tensor;
  VkTensorMemoryBarrierARM list[2] = {tensor, tensor};
  list[1].tensor = run.tensors[0].tensor;
  VkTensorDependencyInfoARM all{};
  all.sType = VK_STRUCTURE_TYPE_TENSOR_DEPENDENCY_INFO_ARM;
  all.tensorMemoryBarrierCount = 2;
  all.pTensorMemoryBarriers = list;
  VkMemoryBarrier2 memory{};
  memory.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2;
  memory.srcStageMask = memory.dstStageMask = VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM;
  memory.srcAccessMask = VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM;
  memory.dstAccessMask = tensor.dstAccessMask;
  VkDependencyInfo single{}, several{}, plain{};
  single.sType = several.sType = plain.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
  single.pNext = &tensor;
  several.pNext = &all;
  plain.memoryBarrierCount = 1;
  plain.pMemoryBarriers = &memory;
  VkEventCreateInfo event_info{};
  event_info.sType = VK_STRUCTURE_TYPE_EVENT_CREATE_INFO;
  event_info.flags = VK_EVENT_CREATE_DEVICE_ONLY_BIT;
  VkEvent event;
  ASSERT_EQ(vkCreateEvent(client.device, &event_info, nullptr, &event), VK_SUCCESS);
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              client_record_graph(&client, commands, &run.graph);
              for (const VkDependencyInfo* info : {&single, &several, &plain}) {
                vkCmdPipelineBarrier2(commands, info);
                client_record_graph(&client, commands, &run.graph);
              }
              vkCmdSetEvent2(commands, event, &several);
              vkCmdWaitEvents2(commands, 1, &event, &several);
              client_full_barrier(commands);  // the wait is over before the event is reset
              vkCmdResetEvent2(commands, event, VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM);
              client_record_graph(&client, commands, &run.graph);
            }),
            VK_SUCCESS)
      << client.last_message;
  expect_doubled();
  vkDestroyEvent(client.device, event, nullptr);
}

TEST_F(RecordingLayerTest, SecondariesAndRepeatedSubmission) {
  VkCommandPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
  pool_info.queueFamilyIndex = client.family;
  VkCommandPool pool;
  ASSERT_EQ(vkCreateCommandPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
  VkCommandBufferAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
  allocate.commandPool = pool;
  allocate.level = VK_COMMAND_BUFFER_LEVEL_SECONDARY;
  allocate.commandBufferCount = 1;
  VkCommandBuffer secondary;
  ASSERT_EQ(vkAllocateCommandBuffers(client.device, &allocate, &secondary), VK_SUCCESS);
  VkCommandBufferInheritanceInfo inheritance{};
  inheritance.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_INHERITANCE_INFO;
  VkCommandBufferBeginInfo begin{};
  begin.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
  begin.flags = VK_COMMAND_BUFFER_USAGE_SIMULTANEOUS_USE_BIT;
  begin.pInheritanceInfo = &inheritance;
  ASSERT_EQ(vkBeginCommandBuffer(secondary, &begin), VK_SUCCESS);
  client_record_graph(&client, secondary, &run.graph);
  ASSERT_EQ(vkEndCommandBuffer(secondary), VK_SUCCESS) << client.last_message;
  for (int turn = 0; turn < 2; ++turn) {
    ASSERT_EQ(submit([&](VkCommandBuffer commands) {
                vkCmdExecuteCommands(commands, 1, &secondary);
                client_full_barrier(commands);
                vkCmdExecuteCommands(commands, 1, &secondary);
              }),
              VK_SUCCESS);
    expect_doubled();
  }
  vkDestroyCommandPool(client.device, pool, nullptr);
}

TEST_F(RecordingLayerTest, MissingStateIsAnErrorWhereTheRecordingEnds) {
  SHALE_SKIP_IF_VALIDATED();
  EXPECT_LT(submit([&](VkCommandBuffer commands) {
              client.CmdDispatchDataGraphARM(commands, run.graph.session, nullptr);
            }),
            0);
  EXPECT_LT(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                run.graph.pipeline);
              client.CmdDispatchDataGraphARM(commands, run.graph.session, nullptr);
            }),
            0);
  EXPECT_EQ(client.other_messages, 2u);
  EXPECT_EQ(run.submit(), VK_SUCCESS) << "the next recording is a new one";
  expect_doubled();
}

/// A compute pipeline of the application: value[i] = value[i] * scale + addend[0], with sets 0 and 1, a dynamic
/// offset and push constants.
TEST_F(RecordingLayerTest, TheApplicationsComputeStateStays) {
  const auto words = compile_glsl(R"(#version 450
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) buffer A { int value[]; } a;
layout(set = 1, binding = 0) buffer B { int addend[]; } b;
layout(push_constant) uniform P { int scale; } p;
void main() { a.value[gl_WorkGroupID.x] = a.value[gl_WorkGroupID.x] * p.scale + b.addend[0]; }
)",
                                  {}, "test");
  ASSERT_TRUE(words) << words.error().text();
  VkShaderModuleCreateInfo module_info{};
  module_info.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
  module_info.codeSize = 4 * words->size();
  module_info.pCode = words->data();
  VkShaderModule module;
  ASSERT_EQ(vkCreateShaderModule(client.device, &module_info, nullptr, &module), VK_SUCCESS);
  VkDescriptorSetLayout layouts[2];
  const VkDescriptorType types[] = {VK_DESCRIPTOR_TYPE_STORAGE_BUFFER_DYNAMIC,
                                    VK_DESCRIPTOR_TYPE_STORAGE_BUFFER};
  for (int i = 0; i < 2; ++i) {
    const VkDescriptorSetLayoutBinding binding{0, types[i], 1, VK_SHADER_STAGE_COMPUTE_BIT,
                                               nullptr};
    VkDescriptorSetLayoutCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
    info.bindingCount = 1;
    info.pBindings = &binding;
    ASSERT_EQ(vkCreateDescriptorSetLayout(client.device, &info, nullptr, &layouts[i]), VK_SUCCESS);
  }
  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, 4};
  VkPipelineLayoutCreateInfo layout_info{};
  layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  layout_info.setLayoutCount = 2;
  layout_info.pSetLayouts = layouts;
  layout_info.pushConstantRangeCount = 1;
  layout_info.pPushConstantRanges = &range;
  VkPipelineLayout layout;
  ASSERT_EQ(vkCreatePipelineLayout(client.device, &layout_info, nullptr, &layout), VK_SUCCESS);
  VkComputePipelineCreateInfo pipeline_info{};
  pipeline_info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  pipeline_info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
  pipeline_info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  pipeline_info.stage.module = module;
  pipeline_info.stage.pName = "main";
  pipeline_info.layout = layout;
  VkPipeline pipeline;
  ASSERT_EQ(vkCreateComputePipelines(client.device, VK_NULL_HANDLE, 1, &pipeline_info, nullptr,
                                     &pipeline),
            VK_SUCCESS);

  constexpr uint32_t kOffset = 256;  // a legal dynamic offset anywhere
  const HostBuffer host = host_buffer(2 * kOffset, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
  ASSERT_TRUE(host.mapped);
  const VkBuffer buffer = host.buffer;
  int32_t* const mapped = static_cast<int32_t*>(host.mapped);
  std::memset(mapped, 0, 2 * kOffset);

  const VkDescriptorPoolSize sizes[] = {{types[0], 1}, {types[1], 1}};
  VkDescriptorPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  pool_info.maxSets = 2;
  pool_info.poolSizeCount = 2;
  pool_info.pPoolSizes = sizes;
  VkDescriptorPool pool;
  ASSERT_EQ(vkCreateDescriptorPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
  VkDescriptorSetAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  allocate.descriptorPool = pool;
  allocate.descriptorSetCount = 2;
  allocate.pSetLayouts = layouts;
  VkDescriptorSet sets[2];
  ASSERT_EQ(vkAllocateDescriptorSets(client.device, &allocate, sets), VK_SUCCESS);
  for (int i = 0; i < 2; ++i) {
    const VkDescriptorBufferInfo info{buffer, 0, 64};
    VkWriteDescriptorSet write{};
    write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write.dstSet = sets[i];
    write.descriptorCount = 1;
    write.descriptorType = types[i];
    write.pBufferInfo = &info;
    vkUpdateDescriptorSets(client.device, 1, &write, 0, nullptr);
  }
  mapped[0] = 7;                                   // the addend
  for (int i = 0; i < 4; ++i) mapped[64 + i] = i;  // the values
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              const int32_t scale = 3;
              vkCmdPushConstants(commands, layout, VK_SHADER_STAGE_COMPUTE_BIT, 0, 4, &scale);
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline);
              vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout, 1, 1,
                                      &sets[1], 0, nullptr);
              vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout, 0, 1,
                                      &sets[0], 1, &kOffset);
              vkCmdDispatch(commands, 4, 1, 1);
              client_full_barrier(commands);
              client_record_graph(&client, commands, &run.graph);
              vkCmdDispatch(commands, 4, 1, 1);
            }),
            VK_SUCCESS)
      << client.last_message;
  expect_doubled();
  for (int i = 0; i < 4; ++i) EXPECT_EQ(mapped[64 + i], (i * 3 + 7) * 3 + 7) << i;

  vkDestroyDescriptorPool(client.device, pool, nullptr);
  vkDestroyPipeline(client.device, pipeline, nullptr);
  vkDestroyPipelineLayout(client.device, layout, nullptr);
  for (const VkDescriptorSetLayout each : layouts)
    vkDestroyDescriptorSetLayout(client.device, each, nullptr);
  vkDestroyShaderModule(client.device, module, nullptr);
}

}  // namespace
}  // namespace shale
