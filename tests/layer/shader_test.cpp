// Compute shaders that read and write tensors, as SPV_ARM_tensors has them.
#include <cstring>
#include <functional>
#include <string>

#include "tests/compiler/spirv_text.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

/// b[y, x] = a[y, x + 1] + the width of a; outside of a is 42.
const char* kShift = R"(
OpCapability Shader
OpCapability Int8
OpCapability TensorsARM
OpExtension "SPV_ARM_tensors"
OpMemoryModel 0 1
OpEntryPoint 5 %main "main" %id %a %b
OpExecutionMode %main 17 1 1 1
OpName %a "a"
OpName %ta "loaded"
OpDecorate %id 11 28
OpDecorate %a DescriptorSet 0
OpDecorate %a Binding 0
OpDecorate %b DescriptorSet 0
OpDecorate %b Binding 1
%void = OpTypeVoid
%fn = OpTypeFunction %void
%uint = OpTypeInt 32 0
%i8 = OpTypeInt 8 1
%v3 = OpTypeVector %uint 3
%pin = OpTypePointer 1 %v3
%id = OpVariable %pin 1
%c1 = OpConstant %uint 1
%c2 = OpConstant %uint 2
%coords = OpTypeArray %uint %c2
%t = OpTypeTensorARM %i8 %c2
%pt = OpTypePointer UniformConstant %t
%a = OpVariable %pt UniformConstant
%b = OpVariable %pt UniformConstant
%other = OpConstant %i8 42
%main = OpFunction %void 0 %fn
%l = OpLabel
%gid = OpLoad %v3 %id
%x = OpCompositeExtract %uint %gid 0
%y = OpCompositeExtract %uint %gid 1
%x1 = OpIAdd %uint %x %c1
%here = OpCompositeConstruct %coords %y %x
%right = OpCompositeConstruct %coords %y %x1
%ta = OpLoad %t %a
%tb = OpLoad %t %b
%value = OpTensorReadARM %i8 %ta %right 2 %other
%width = OpTensorQuerySizeARM %uint %ta %c1
%narrow = OpSConvert %i8 %width
%sum = OpIAdd %i8 %value %narrow
OpTensorWriteARM %tb %here %sum
OpReturn
OpFunctionEnd
)";

/// For tensors of int16 in an array, by a dynamic index: three elements from 64-bit coordinates, moved by one.
const char* kArrays = R"(
OpCapability Shader
OpCapability Int16
OpCapability Int64
OpCapability TensorsARM
OpCapability 4175
OpExtension "SPV_ARM_tensors"
OpMemoryModel 0 1
OpEntryPoint 5 %main "main" %id %a
OpExecutionMode %main 17 1 1 1
OpDecorate %id 11 28
OpDecorate %a DescriptorSet 0
OpDecorate %a Binding 0
%void = OpTypeVoid
%fn = OpTypeFunction %void
%uint = OpTypeInt 32 0
%long = OpTypeInt 64 1
%i16 = OpTypeInt 16 1
%v3 = OpTypeVector %uint 3
%pin = OpTypePointer 1 %v3
%id = OpVariable %pin 1
%c1 = OpConstant %uint 1
%c2 = OpConstant %uint 2
%c3 = OpConstant %uint 3
%l1 = OpConstant %long 1 0
%coords = OpTypeArray %long %c1
%three = OpTypeArray %i16 %c3
%t = OpTypeTensorARM %i16 %c1
%ts = OpTypeArray %t %c2
%pts = OpTypePointer UniformConstant %ts
%pt = OpTypePointer UniformConstant %t
%a = OpVariable %pts UniformConstant
%main = OpFunction %void 0 %fn
%l = OpLabel
%gid = OpLoad %v3 %id
%x = OpCompositeExtract %uint %gid 0
%z = OpCompositeExtract %uint %gid 2
%lx = OpSConvert %long %x
%lx1 = OpIAdd %long %lx %l1
%here = OpCompositeConstruct %coords %lx
%next = OpCompositeConstruct %coords %lx1
%p = OpAccessChain %pt %a %z
%ta = OpLoad %t %p
%value = OpTensorReadARM %three %ta %next
OpTensorWriteARM %ta %here %value
OpReturn
OpFunctionEnd
)";

class ShaderLayerTest : public LayerTest {
 protected:
  struct Pipeline {
    VkDescriptorSetLayout set_layout;
    VkPipelineLayout layout;
    VkDescriptorPool pool;
    VkDescriptorSet set;
    VkPipeline pipeline;
  };
  /// `chained`: the code comes with the stage, not in a module. With `varying` the last binding has so many
  /// descriptors of `count`, which may be written after the set is bound, and need not all be.
  Pipeline make(const char* text, uint32_t bindings, uint32_t count, bool chained = false,
                uint32_t varying = 0) {
    Pipeline made{};
    std::vector<VkDescriptorSetLayoutBinding> list;
    for (uint32_t i = 0; i < bindings; ++i)
      list.push_back(
          {i, VK_DESCRIPTOR_TYPE_TENSOR_ARM, count, VK_SHADER_STAGE_COMPUTE_BIT, nullptr});
    VkDescriptorSetLayoutCreateInfo set_info{};
    set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
    set_info.bindingCount = bindings;
    set_info.pBindings = list.data();
    std::vector<VkDescriptorBindingFlags> flags(bindings);
    flags.back() = VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT |
                   VK_DESCRIPTOR_BINDING_PARTIALLY_BOUND_BIT |
                   VK_DESCRIPTOR_BINDING_VARIABLE_DESCRIPTOR_COUNT_BIT;
    VkDescriptorSetLayoutBindingFlagsCreateInfo flag_info{};
    flag_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_BINDING_FLAGS_CREATE_INFO;
    flag_info.bindingCount = bindings;
    flag_info.pBindingFlags = flags.data();
    if (varying > 0) {
      set_info.pNext = &flag_info;
      set_info.flags = VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT;
      VkDescriptorSetVariableDescriptorCountLayoutSupport most{};
      most.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_VARIABLE_DESCRIPTOR_COUNT_LAYOUT_SUPPORT;
      VkDescriptorSetLayoutSupport support{};
      support.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_SUPPORT;
      support.pNext = &most;
      vkGetDescriptorSetLayoutSupport(client.device, &set_info, &support);
      EXPECT_TRUE(support.supported);
      EXPECT_GE(most.maxVariableDescriptorCount, varying);
    }
    EXPECT_EQ(vkCreateDescriptorSetLayout(client.device, &set_info, nullptr, &made.set_layout),
              VK_SUCCESS);
    VkPipelineLayoutCreateInfo layout_info{};
    layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
    layout_info.setLayoutCount = 1;
    layout_info.pSetLayouts = &made.set_layout;
    EXPECT_EQ(vkCreatePipelineLayout(client.device, &layout_info, nullptr, &made.layout),
              VK_SUCCESS);
    const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_TENSOR_ARM, bindings * count};
    VkDescriptorPoolCreateInfo pool_info{};
    pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
    pool_info.maxSets = 1;
    pool_info.poolSizeCount = 1;
    pool_info.pPoolSizes = &size;
    if (varying > 0) pool_info.flags = VK_DESCRIPTOR_POOL_CREATE_UPDATE_AFTER_BIND_BIT;
    EXPECT_EQ(vkCreateDescriptorPool(client.device, &pool_info, nullptr, &made.pool), VK_SUCCESS);
    VkDescriptorSetAllocateInfo allocate{};
    allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
    allocate.descriptorPool = made.pool;
    allocate.descriptorSetCount = 1;
    allocate.pSetLayouts = &made.set_layout;
    VkDescriptorSetVariableDescriptorCountAllocateInfo counts{};
    counts.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_VARIABLE_DESCRIPTOR_COUNT_ALLOCATE_INFO;
    counts.descriptorSetCount = 1;
    counts.pDescriptorCounts = &varying;
    if (varying > 0) allocate.pNext = &counts;
    EXPECT_EQ(vkAllocateDescriptorSets(client.device, &allocate, &made.set), VK_SUCCESS);
    const std::vector<uint32_t> words = assemble_spirv(text);
    VkShaderModuleCreateInfo module_info{};
    module_info.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
    module_info.codeSize = 4 * words.size();
    module_info.pCode = words.data();
    VkComputePipelineCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
    info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
    info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
    info.stage.pName = "main";
    info.layout = made.layout;
    if (chained) {
      info.stage.pNext = &module_info;
    } else {
      EXPECT_EQ(vkCreateShaderModule(client.device, &module_info, nullptr, &info.stage.module),
                VK_SUCCESS)
          << client.last_message;
    }
    EXPECT_EQ(
        vkCreateComputePipelines(client.device, VK_NULL_HANDLE, 1, &info, nullptr, &made.pipeline),
        VK_SUCCESS);
    vkDestroyShaderModule(client.device, info.stage.module, nullptr);
    return made;
  }
  void destroy(const Pipeline& made) const {
    vkDestroyPipeline(client.device, made.pipeline, nullptr);
    vkDestroyDescriptorPool(client.device, made.pool, nullptr);
    vkDestroyPipelineLayout(client.device, made.layout, nullptr);
    vkDestroyDescriptorSetLayout(client.device, made.set_layout, nullptr);
  }
  /// One write over all descriptors from `first` on, so that it runs from one binding into the next.
  void write(const Pipeline& made, const std::vector<VkTensorViewARM>& views,
             uint32_t first = 0) const {
    VkWriteDescriptorSetTensorARM tensors{};
    tensors.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM;
    tensors.tensorViewCount = static_cast<uint32_t>(views.size());
    tensors.pTensorViews = views.data();
    VkWriteDescriptorSet set{};
    set.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    set.pNext = &tensors;
    set.dstSet = made.set;
    set.dstArrayElement = first;
    set.descriptorCount = tensors.tensorViewCount;
    set.descriptorType = VK_DESCRIPTOR_TYPE_TENSOR_ARM;
    vkUpdateDescriptorSets(client.device, 1, &set, 0, nullptr);
  }
  /// `then` comes when all is recorded and nothing submitted.
  void run(
      const Pipeline& made, uint32_t x, uint32_t y, uint32_t z,
      const std::function<void()>& then = [] {}) const {
    struct Call {
      const Pipeline* pipeline;
      uint32_t groups[3];
      const std::function<void()>& then;
    } call{&made, {x, y, z}, then};
    EXPECT_EQ(
        client_submit(
            &client,
            [](VkCommandBuffer commands, void* user) {
              const auto* all = static_cast<const Call*>(user);
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, all->pipeline->pipeline);
              vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE,
                                      all->pipeline->layout, 0, 1, &all->pipeline->set, 0, nullptr);
              vkCmdDispatch(commands, all->groups[0], all->groups[1], all->groups[2]);
              all->then();
            },
            &call),
        VK_SUCCESS);
  }
};

TEST_F(ShaderLayerTest, ReadsAndWritesWithinTheTensor) {
  constexpr int64_t kHeight = 3, kWidth = 5;
  const int64_t dims[] = {kHeight, kWidth}, padded[] = {kWidth + 3, 1};
  for (const int64_t* strides :
       {static_cast<const int64_t*>(nullptr), static_cast<const int64_t*>(padded)}) {
    client.more_usage = VK_TENSOR_USAGE_SHADER_BIT_ARM;
    ClientTensor a, b;
    ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R8_SINT, VK_TENSOR_TILING_OPTIMAL_ARM, 2,
                                   dims, strides, &a),
              VK_SUCCESS);
    ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R8_SINT, VK_TENSOR_TILING_OPTIMAL_ARM, 2,
                                   dims, nullptr, &b),
              VK_SUCCESS);
    const int64_t stride = strides ? strides[0] : kWidth;
    auto* in = static_cast<int8_t*>(a.mapped);
    const auto* out = static_cast<const int8_t*>(b.mapped);
    for (int64_t i = 0; i < kHeight * stride; ++i) in[i] = static_cast<int8_t>(i * 7 - 50);
    const Pipeline pipeline = make(kShift, 2, 1, strides != nullptr);
    write(pipeline, {a.view, b.view});
    run(pipeline, kWidth + 2, kHeight + 1, 1);  // more than there is
    for (int64_t y = 0; y < kHeight; ++y)
      for (int64_t x = 0; x < kWidth; ++x)
        EXPECT_EQ(out[y * kWidth + x],
                  static_cast<int8_t>((x + 1 < kWidth ? in[y * stride + x + 1] : 42) + kWidth))
            << y << " " << x;
    destroy(pipeline);
    client_destroy_tensor(&client, &a);
    client_destroy_tensor(&client, &b);
  }
}

TEST_F(ShaderLayerTest, ReadsAndWritesRowsOfArraysOfTensors) {
  const int64_t dims[] = {4};
  client.more_usage = VK_TENSOR_USAGE_SHADER_BIT_ARM;
  ClientTensor tensors[2];
  for (ClientTensor& tensor : tensors) {
    ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R16_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1,
                                   dims, nullptr, &tensor),
              VK_SUCCESS);
    for (int i = 0; i < 4; ++i)
      static_cast<int16_t*>(tensor.mapped)[i] =
          static_cast<int16_t>(100 * (&tensor - tensors) + i + 1);
  }
  const Pipeline pipeline = make(kArrays, 1, 2);
  write(pipeline, {tensors[0].view, tensors[1].view});
  run(pipeline, 1, 1, 2);
  for (int which = 0; which < 2; ++which) {
    const auto* values = static_cast<const int16_t*>(tensors[which].mapped);
    for (int i = 0; i < 4; ++i)
      EXPECT_EQ(values[i], 100 * which + (i < 3 ? i + 2 : 4)) << which << " " << i;
  }
  destroy(pipeline);
  for (ClientTensor& tensor : tensors) client_destroy_tensor(&client, &tensor);
}

/// Tensors 0 and 2 of an array of any length, of which the invocations of one workgroup take one each; between
/// them nothing is bound. The descriptors are written when the dispatch is recorded.
TEST_F(ShaderLayerTest, TakesDescriptorsWrittenAfterBindingByIndicesThatDiffer) {
  VkPhysicalDeviceVulkan12Features v12{};
  v12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES;
  VkPhysicalDeviceTensorFeaturesARM tensor_features{};
  tensor_features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_TENSOR_FEATURES_ARM;
  tensor_features.pNext = &v12;
  VkPhysicalDeviceFeatures2 features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
  features.pNext = &tensor_features;
  vkGetPhysicalDeviceFeatures2(client.physical, &features);
  EXPECT_EQ(tensor_features.descriptorBindingStorageTensorUpdateAfterBind,
            v12.descriptorBindingStorageBufferUpdateAfterBind);
  EXPECT_EQ(tensor_features.shaderStorageTensorArrayNonUniformIndexing,
            v12.shaderStorageBufferArrayNonUniformIndexing);
  if (!tensor_features.descriptorBindingStorageTensorUpdateAfterBind ||
      !tensor_features.shaderStorageTensorArrayNonUniformIndexing ||
      !v12.descriptorBindingPartiallyBound || !v12.descriptorBindingVariableDescriptorCount ||
      !v12.runtimeDescriptorArray)
    GTEST_SKIP() << "the device has no update after bind or no indices that differ";
  VkPhysicalDeviceDescriptorIndexingFeatures indexing{};
  indexing.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DESCRIPTOR_INDEXING_FEATURES;
  indexing.descriptorBindingPartiallyBound = VK_TRUE;
  indexing.descriptorBindingVariableDescriptorCount = VK_TRUE;
  indexing.runtimeDescriptorArray = VK_TRUE;
  client_close(&client);
  ASSERT_EQ(client_open(&client, &indexing), VK_SUCCESS);

  std::string text = kArrays;
  const auto replace = [&](const std::string& from, const std::string& to) {
    ASSERT_NE(text.find(from), std::string::npos) << from;
    text.replace(text.find(from), from.size(), to);
  };
  replace("OpCapability 4175\n",
          "OpCapability 4175\nOpCapability 4176\nOpCapability 5301\nOpCapability 5302\n"
          "OpExtension \"SPV_EXT_descriptor_indexing\"\n");
  replace("17 1 1 1\n", "17 1 1 2\n");
  replace("OpDecorate %a Binding 0\n",
          "OpDecorate %a Binding 0\nOpDecorate %index 5300\nOpDecorate %p 5300\n"
          "OpDecorate %ta 5300\n");
  replace("%ts = OpTypeArray %t %c2\n", "%ts = OpTypeRuntimeArray %t\n");
  replace("%p = OpAccessChain %pt %a %z\n",
          "%index = OpIAdd %uint %z %z\n%p = OpAccessChain %pt %a %index\n");

  const int64_t dims[] = {4};
  client.more_usage = VK_TENSOR_USAGE_SHADER_BIT_ARM;
  ClientTensor tensors[2];
  for (ClientTensor& tensor : tensors) {
    ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R16_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1,
                                   dims, nullptr, &tensor),
              VK_SUCCESS);
    for (int i = 0; i < 4; ++i)
      static_cast<int16_t*>(tensor.mapped)[i] =
          static_cast<int16_t>(100 * (&tensor - tensors) + i + 1);
  }
  const Pipeline pipeline = make(text.c_str(), 1, 8, false, 3);
  run(pipeline, 1, 1, 1, [&] {
    write(pipeline, {tensors[0].view});
    write(pipeline, {tensors[1].view}, 2);
  });
  for (int which = 0; which < 2; ++which) {
    const auto* values = static_cast<const int16_t*>(tensors[which].mapped);
    for (int i = 0; i < 4; ++i)
      EXPECT_EQ(values[i], 100 * which + (i < 3 ? i + 2 : 4)) << which << " " << i;
  }
  destroy(pipeline);
  for (ClientTensor& tensor : tensors) client_destroy_tensor(&client, &tensor);
}

}  // namespace
}  // namespace shale
