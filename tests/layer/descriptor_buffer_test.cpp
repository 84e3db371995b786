// Tensors whose descriptors lie in buffers, of shaders and of graphs. Mesa 26 has VK_EXT_descriptor_buffer, 22.3 has not.
#include <algorithm>
#include <cstring>
#include <functional>

#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"
#include "tests/layer/tensor_shaders.h"

namespace shale {
namespace {

const char* kTriple = R"(
graph main {
  input %x : i32[3,5]
  %two = add %x, %x : i32[3,5]
  %y = add %two, %x : i32[3,5]
  return %y
}
)";

constexpr VkPipelineCreateFlags kInBuffers = VK_PIPELINE_CREATE_DESCRIPTOR_BUFFER_BIT_EXT;
constexpr VkDescriptorSetLayoutCreateFlags kSetInBuffer =
    VK_DESCRIPTOR_SET_LAYOUT_CREATE_DESCRIPTOR_BUFFER_BIT_EXT;

class DescriptorBufferLayerTest : public LayerTest {
 protected:
  void SetUp() override {
    LayerTest::SetUp();
    if (!is_open) return;
    VkPhysicalDeviceDataGraphFeaturesARM graphs{};
    graphs.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_FEATURES_ARM;
    tensors.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_FEATURES_ARM;
    tensors.pNext = &graphs;
    VkPhysicalDeviceFeatures2 features{};
    features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
    features.pNext = &tensors;
    vkGetPhysicalDeviceFeatures2(client.physical, &features);
    sizes.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_TENSOR_PROPERTIES_ARM;
    VkPhysicalDeviceProperties2 properties{};
    properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
    properties.pNext = &sizes;
    vkGetPhysicalDeviceProperties2(client.physical, &properties);
    EXPECT_EQ(tensors.descriptorBufferTensorDescriptors, graphs.dataGraphDescriptorBuffer);
    EXPECT_EQ(tensors.descriptorBufferTensorDescriptors != 0, sizes.tensorDescriptorSize != 0);
    if (!tensors.descriptorBufferTensorDescriptors)
      GTEST_SKIP() << "the device has no descriptor buffers";

    // The client asks for all that these have.
    buffers.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_BUFFER_FEATURES_EXT;
    address.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_BUFFER_DEVICE_ADDRESS_FEATURES;
    types.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES;
    robustness.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ROBUSTNESS_2_FEATURES_EXT;
    tensors.pNext = &buffers;
    buffers.pNext = &address;
    address.pNext = &types;
    types.pNext = &robustness;
    client_close(&client);
    ASSERT_EQ(client_open(&client, &tensors), VK_SUCCESS);
    const auto load = [&](auto& function, const char* name) {
      function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(
          vkGetDeviceProcAddr(client.device, name));
      ASSERT_TRUE(function) << name;
    };
    load(get_descriptor, "vkGetDescriptorEXT");
    load(get_size, "vkGetDescriptorSetLayoutSizeEXT");
    load(get_offset, "vkGetDescriptorSetLayoutBindingOffsetEXT");
    load(bind_buffers, "vkCmdBindDescriptorBuffersEXT");
    load(set_offsets, "vkCmdSetDescriptorBufferOffsetsEXT");
    client.more_usage = VK_TENSOR_USAGE_SHADER_BIT_ARM;
    memory = host_buffer(kBytes, VK_BUFFER_USAGE_RESOURCE_DESCRIPTOR_BUFFER_BIT_EXT |
                                     VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT);
    ASSERT_TRUE(memory.mapped);
  }

  /// Writes the descriptors of a binding of the set that lies at `at`.
  void write(VkDescriptorSetLayout layout, VkDeviceSize at, uint32_t binding,
             const std::vector<VkTensorViewARM>& views) const {
    VkDeviceSize size = 0, offset = 0;
    get_size(client.device, layout, &size);
    get_offset(client.device, layout, binding, &offset);
    ASSERT_LE(offset + views.size() * sizes.tensorDescriptorSize, size);
    ASSERT_LE(at + size, kBytes);
    for (size_t i = 0; i < views.size(); ++i) {
      VkDescriptorGetTensorInfoARM tensor{};
      tensor.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_GET_TENSOR_INFO_ARM;
      tensor.tensorView = views[i];
      VkDescriptorGetInfoEXT info{};
      info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_GET_INFO_EXT;
      info.pNext = &tensor;
      info.type = VK_DESCRIPTOR_TYPE_TENSOR_ARM;
      get_descriptor(
          client.device, &info, sizes.tensorDescriptorSize,
          static_cast<char*>(memory.mapped) + at + offset + i * sizes.tensorDescriptorSize);
    }
  }
  void bind(VkCommandBuffer commands) const {
    VkBufferDeviceAddressInfo which{};
    which.sType = VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO;
    which.buffer = memory.buffer;
    VkDescriptorBufferBindingInfoEXT info{};
    info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_BUFFER_BINDING_INFO_EXT;
    info.address = vkGetBufferDeviceAddress(client.device, &which);
    info.usage = VK_BUFFER_USAGE_RESOURCE_DESCRIPTOR_BUFFER_BIT_EXT |
                 VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
    bind_buffers(commands, 1, &info);
  }
  void bind_set(VkCommandBuffer commands, VkPipelineBindPoint point, VkPipelineLayout layout,
                VkDeviceSize at) const {
    const uint32_t buffer = 0;
    set_offsets(commands, point, layout, 0, 1, &buffer, &at);
  }
  void bind_graph(VkCommandBuffer commands, const ClientGraph& graph, VkDeviceSize at) const {
    bind(commands);
    bind_set(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, graph.layout, at);
    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, graph.pipeline);
  }
  VkResult submit(const std::function<void(VkCommandBuffer)>& record) const {
    return client_submit(
        &client,
        [](VkCommandBuffer commands, void* user) {
          (*static_cast<const std::function<void(VkCommandBuffer)>*>(user))(commands);
        },
        const_cast<std::function<void(VkCommandBuffer)>*>(&record));
  }

  struct Shader {
    VkDescriptorSetLayout set_layout;
    ComputePipeline code;
  };
  Shader make_shader(const char* text, const std::vector<uint32_t>& counts) const {
    Shader made{};
    std::vector<VkDescriptorSetLayoutBinding> bindings;
    for (const uint32_t count : counts)
      bindings.push_back({static_cast<uint32_t>(bindings.size()), VK_DESCRIPTOR_TYPE_TENSOR_ARM,
                          count, VK_SHADER_STAGE_COMPUTE_BIT, nullptr});
    VkDescriptorSetLayoutCreateInfo set_info{};
    set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
    set_info.flags = kSetInBuffer;
    set_info.bindingCount = static_cast<uint32_t>(bindings.size());
    set_info.pBindings = bindings.data();
    EXPECT_EQ(vkCreateDescriptorSetLayout(client.device, &set_info, nullptr, &made.set_layout),
              VK_SUCCESS);
    made.code = compute_pipeline(made.set_layout, text, kInBuffers);
    return made;
  }
  void destroy(const Shader& made) const {
    LayerTest::destroy(made.code);
    vkDestroyDescriptorSetLayout(client.device, made.set_layout, nullptr);
  }
  /// Four elements each, from 1 and from 101.
  void make_rows(ClientTensor (&rows)[2]) const {
    const int64_t dims[] = {4};
    for (ClientTensor& row : rows) {
      ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R16_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1,
                                     dims, nullptr, &row),
                VK_SUCCESS);
      for (int i = 0; i < 4; ++i)
        static_cast<int16_t*>(row.mapped)[i] = static_cast<int16_t>(100 * (&row - rows) + i + 1);
    }
  }
  static std::vector<int16_t> values(const ClientTensor& row) {
    const auto* first = static_cast<const int16_t*>(row.mapped);
    return {first, first + 4};
  }

  static constexpr VkDeviceSize kBytes = 1 << 16, kFirst = 4096, kSecond = 8192, kThird = 12288;
  VkPhysicalDeviceDescriptorBufferTensorFeaturesARM tensors{};
  VkPhysicalDeviceDescriptorBufferTensorPropertiesARM sizes{};
  VkPhysicalDeviceDescriptorBufferFeaturesEXT buffers{};
  VkPhysicalDeviceBufferDeviceAddressFeatures address{};
  VkPhysicalDeviceShaderFloat16Int8Features types{};
  VkPhysicalDeviceRobustness2FeaturesEXT robustness{};
  PFN_vkGetDescriptorEXT get_descriptor = nullptr;
  PFN_vkGetDescriptorSetLayoutSizeEXT get_size = nullptr;
  PFN_vkGetDescriptorSetLayoutBindingOffsetEXT get_offset = nullptr;
  PFN_vkCmdBindDescriptorBuffersEXT bind_buffers = nullptr;
  PFN_vkCmdSetDescriptorBufferOffsetsEXT set_offsets = nullptr;
  HostBuffer memory;
};

TEST_F(DescriptorBufferLayerTest, ShadersFindTensorsAndArraysOfThem) {
  ClientTensor rows[2];
  ASSERT_NO_FATAL_FAILURE(make_rows(rows));
  const Shader shader = make_shader(kArrays, {2});
  write(shader.set_layout, kFirst, 0, {rows[0].view, rows[1].view});
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, shader.code.pipeline);
              bind(commands);
              bind_set(commands, VK_PIPELINE_BIND_POINT_COMPUTE, shader.code.layout, kFirst);
              vkCmdDispatch(commands, 1, 1, 2);
            }),
            VK_SUCCESS);
  EXPECT_EQ(values(rows[0]), (std::vector<int16_t>{2, 3, 4, 4}));
  EXPECT_EQ(values(rows[1]), (std::vector<int16_t>{102, 103, 104, 104}));
  destroy(shader);
  for (ClientTensor& row : rows) client_destroy_tensor(&client, &row);
}

TEST_F(DescriptorBufferLayerTest, ANullTensorHasNoElements) {
  if (!robustness.nullDescriptor) GTEST_SKIP() << "the device has no null descriptors";
  const int64_t dims[] = {2, 3};
  ClientTensor out;
  ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R8_SINT, VK_TENSOR_TILING_LINEAR_ARM, 2, dims,
                                 nullptr, &out),
            VK_SUCCESS);
  const Shader shader = make_shader(kShift, {1, 1});
  write(shader.set_layout, kFirst, 0, {VK_NULL_HANDLE});
  write(shader.set_layout, kFirst, 1, {out.view});
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, shader.code.pipeline);
              bind(commands);
              bind_set(commands, VK_PIPELINE_BIND_POINT_COMPUTE, shader.code.layout, kFirst);
              vkCmdDispatch(commands, 3, 2, 1);
            }),
            VK_SUCCESS);
  for (int i = 0; i < 6; ++i)  // what is outside, and a width of 0
    EXPECT_EQ(static_cast<const int8_t*>(out.mapped)[i], 42) << i;
  destroy(shader);
  client_destroy_tensor(&client, &out);
}

/// One recording, submitted with other descriptors each time; the layouts are gone by then.
TEST_F(DescriptorBufferLayerTest, GraphsReadTheDescriptorsWhenTheyRun) {
  const Graph source = graph_of(kTriple);
  for (const int64_t padding : {0, 3}) {
    SCOPED_TRACE(padding);
    ClientRun own, other;
    const GraphOptions options{.padding = padding, .flags = kInBuffers, .set_flags = kSetInBuffer};
    ASSERT_EQ(own.create(client, source, options), VK_SUCCESS) << client.last_message;
    ASSERT_EQ(other.create(client, source, options), VK_SUCCESS) << client.last_message;
    for (uint32_t i = 0; i < 2; ++i)  // in the wrong place, at first
      write(own.graph.set_layout, kFirst, i, {own.tensors[1 - i].view});
    const VkCommandPoolCreateInfo pool_info{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr, 0,
                                            client.family};
    VkCommandPool pool;
    ASSERT_EQ(vkCreateCommandPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
    const VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
                                               nullptr, pool, VK_COMMAND_BUFFER_LEVEL_PRIMARY, 1};
    VkCommandBuffer commands;
    ASSERT_EQ(vkAllocateCommandBuffers(client.device, &allocate, &commands), VK_SUCCESS);
    VkCommandBufferBeginInfo begin{};
    begin.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
    ASSERT_EQ(vkBeginCommandBuffer(commands, &begin), VK_SUCCESS);
    bind_graph(commands, own.graph, kFirst);
    client.CmdDispatchDataGraphARM(commands, own.graph.session, nullptr);
    client_full_barrier(commands);
    ASSERT_EQ(vkEndCommandBuffer(commands), VK_SUCCESS) << client.last_message;
    for (const uint64_t seed : {1, 2, 3}) {
      ClientRun& target = seed == 2 ? own : other;
      for (uint32_t i = 0; i < 2; ++i)
        write(own.graph.set_layout, kFirst, i, {target.tensors[i].view});
      const std::vector<Tensor> values = random_inputs(source, seed);
      target.write(values);
      VkSubmitInfo submit_info{};
      submit_info.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO;
      submit_info.commandBufferCount = 1;
      submit_info.pCommandBuffers = &commands;
      ASSERT_EQ(vkQueueSubmit(client.queue, 1, &submit_info, VK_NULL_HANDLE), VK_SUCCESS);
      ASSERT_EQ(vkQueueWaitIdle(client.queue), VK_SUCCESS);
      EXPECT_EQ(target.read(), must(interpret(source, values))) << seed;
    }
    vkDestroyCommandPool(client.device, pool, nullptr);
  }
}

/// The application's shader, its buffers and its offsets are there again behind a graph with others.
TEST_F(DescriptorBufferLayerTest, TheApplicationsBuffersStayBound) {
  ClientTensor rows[2];
  ASSERT_NO_FATAL_FAILURE(make_rows(rows));
  const Shader shader = make_shader(kArrays, {2});
  write(shader.set_layout, kFirst, 0, {rows[0].view, rows[1].view});
  const Graph source = graph_of(kTriple);
  ClientRun in_buffers, in_sets;
  ASSERT_EQ(in_buffers.create(client, source, {.flags = kInBuffers, .set_flags = kSetInBuffer}),
            VK_SUCCESS)
      << client.last_message;
  ASSERT_EQ(in_sets.create(client, source), VK_SUCCESS) << client.last_message;
  for (uint32_t i = 0; i < 2; ++i)
    write(in_buffers.graph.set_layout, kSecond, i, {in_buffers.tensors[i].view});
  const std::vector<Tensor> values_of_graph = random_inputs(source, 4);
  in_buffers.write(values_of_graph);
  in_sets.write(values_of_graph);
  const auto set_offsets_2 = reinterpret_cast<PFN_vkCmdSetDescriptorBufferOffsets2EXT>(
      vkGetDeviceProcAddr(client.device, "vkCmdSetDescriptorBufferOffsets2EXT"));
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, shader.code.pipeline);
              bind(commands);
              const VkDeviceSize at = kFirst;
              const uint32_t buffer = 0;
              VkSetDescriptorBufferOffsetsInfoEXT info{};
              info.sType = VK_STRUCTURE_TYPE_SET_DESCRIPTOR_BUFFER_OFFSETS_INFO_EXT;
              info.stageFlags = VK_SHADER_STAGE_COMPUTE_BIT;
              info.layout = shader.code.layout;
              info.setCount = 1;
              info.pBufferIndices = &buffer;
              info.pOffsets = &at;
              if (set_offsets_2)
                set_offsets_2(commands, &info);
              else
                bind_set(commands, VK_PIPELINE_BIND_POINT_COMPUTE, shader.code.layout, kFirst);
              vkCmdDispatch(commands, 1, 1, 2);
              client_full_barrier(commands);
              bind_set(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, in_buffers.graph.layout,
                       kSecond);
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                in_buffers.graph.pipeline);
              client.CmdDispatchDataGraphARM(commands, in_buffers.graph.session, nullptr);
              vkCmdDispatch(commands, 1, 1, 2);
              client_full_barrier(commands);
              client_record_graph(&client, commands, &in_sets.graph);
            }),
            VK_SUCCESS)
      << client.last_message;
  EXPECT_EQ(values(rows[0]), (std::vector<int16_t>{3, 4, 4, 4}));
  EXPECT_EQ(values(rows[1]), (std::vector<int16_t>{103, 104, 104, 104}));
  EXPECT_EQ(in_buffers.read(), must(interpret(source, values_of_graph)));
  EXPECT_EQ(in_sets.read(), must(interpret(source, values_of_graph)));
  destroy(shader);
  for (ClientTensor& row : rows) client_destroy_tensor(&client, &row);
}

TEST_F(DescriptorBufferLayerTest, WhatDoesNotFitIsRefused) {
  SHALE_SKIP_IF_VALIDATED();
  const Graph source = graph_of(kTriple);
  ClientRun plain, flagged;
  EXPECT_LT(plain.create(client, source, {.set_flags = kSetInBuffer}), 0);
  EXPECT_LT(flagged.create(client, source, {.flags = kInBuffers}), 0);
  ClientRun run;
  ASSERT_EQ(run.create(client, source, {.flags = kInBuffers, .set_flags = kSetInBuffer}),
            VK_SUCCESS);
  EXPECT_LT(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM,
                                run.graph.pipeline);
              client.CmdDispatchDataGraphARM(commands, run.graph.session, nullptr);
            }),
            0)
      << "no buffer is bound";
  // Fewer bytes than a descriptor has: nothing is written.
  VkDescriptorGetTensorInfoARM tensor{};
  tensor.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_GET_TENSOR_INFO_ARM;
  tensor.tensorView = run.tensors[0].view;
  VkDescriptorGetInfoEXT info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_GET_INFO_EXT;
  info.type = VK_DESCRIPTOR_TYPE_TENSOR_ARM;
  std::vector<uint8_t> bytes(sizes.tensorDescriptorSize, 0x7f);
  get_descriptor(client.device, &info, bytes.size(), bytes.data());
  info.pNext = &tensor;
  get_descriptor(client.device, &info, bytes.size() - 1, bytes.data());
  EXPECT_TRUE(std::all_of(bytes.begin(), bytes.end(), [](uint8_t each) { return each == 0x7f; }));
  // No tensor can be captured.
  EXPECT_EQ(sizes.tensorCaptureReplayDescriptorDataSize, 0u);
  const auto capture = reinterpret_cast<PFN_vkGetTensorOpaqueCaptureDescriptorDataARM>(
      vkGetDeviceProcAddr(client.device, "vkGetTensorOpaqueCaptureDescriptorDataARM"));
  ASSERT_TRUE(capture);
  VkTensorCaptureDescriptorDataInfoARM which{};
  which.sType = VK_STRUCTURE_TYPE_TENSOR_CAPTURE_DESCRIPTOR_DATA_INFO_ARM;
  which.tensor = run.tensors[0].tensor;
  EXPECT_LT(capture(client.device, &which, bytes.data()), 0);
}

}  // namespace
}  // namespace shale
