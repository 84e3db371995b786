// Compute shaders that read and write tensors, as SPV_ARM_tensors has them.
#include <fmt/format.h>

#include <cstring>
#include <functional>
#include <string>

#include "tests/layer/layer_fixture.h"
#include "tests/layer/tensor_shaders.h"

namespace shale {
namespace {

struct ShaderFormat {
  VkFormat format;
  const char *type, *capability;  ///< the latter may be null
  size_t bytes;
};
constexpr ShaderFormat kShaderFormats[] = {
    {VK_FORMAT_R8_BOOL_ARM, "OpTypeBool", nullptr, 1},
    {VK_FORMAT_R8_UINT, "OpTypeInt 8 0", "Int8", 1},
    {VK_FORMAT_R8_SINT, "OpTypeInt 8 1", "Int8", 1},
    {VK_FORMAT_R16_UINT, "OpTypeInt 16 0", "Int16", 2},
    {VK_FORMAT_R16_SINT, "OpTypeInt 16 1", "Int16", 2},
    {VK_FORMAT_R32_UINT, nullptr, nullptr, 4},
    {VK_FORMAT_R32_SINT, "OpTypeInt 32 1", nullptr, 4},
    {VK_FORMAT_R64_UINT, "OpTypeInt 64 0", "Int64", 8},
    {VK_FORMAT_R64_SINT, "OpTypeInt 64 1", "Int64", 8},
};

/// b = a, an element per invocation, whose place comes of the sizes that a tells; these go into c.
std::string copy_shader(const ShaderFormat& format, size_t rank) {
  const std::string element = format.type ? "%element" : "%uint";
  std::string text = "OpCapability Shader\n";
  if (format.capability) text += fmt::format("OpCapability {}\n", format.capability);
  text += R"(OpCapability TensorsARM
OpExtension "SPV_ARM_tensors"
OpMemoryModel 0 1
OpEntryPoint 5 %main "main" %id %a %b %c
OpExecutionMode %main 17 1 1 1
OpDecorate %id 11 28
)";
  for (size_t i = 0; i < 3; ++i)
    text +=
        fmt::format("OpDecorate %{0} DescriptorSet 0\nOpDecorate %{0} Binding {1}\n", "abc"[i], i);
  text += R"(%void = OpTypeVoid
%fn = OpTypeFunction %void
%uint = OpTypeInt 32 0
%v3 = OpTypeVector %uint 3
%pin = OpTypePointer 1 %v3
%id = OpVariable %pin 1
)";
  if (format.type) text += fmt::format("%element = {}\n", format.type);
  for (size_t i = 0; i <= rank; ++i) text += fmt::format("%n{} = OpConstant %uint {}\n", i, i);
  text += fmt::format(R"(%coords = OpTypeArray %uint %n{0}
%t = OpTypeTensorARM {1} %n{0}
%pt = OpTypePointer UniformConstant %t
%a = OpVariable %pt UniformConstant
%b = OpVariable %pt UniformConstant
)",
                      rank, element);
  // Types are there once.
  const bool same = rank == 1 && !format.type;
  if (!same) text += "%tc = OpTypeTensorARM %uint %n1\n%ptc = OpTypePointer UniformConstant %tc\n";
  if (rank != 1) text += "%coord = OpTypeArray %uint %n1\n";
  text += fmt::format(R"(%c = OpVariable {} UniformConstant
%main = OpFunction %void 0 %fn
%l = OpLabel
%gid = OpLoad %v3 %id
%rest{} = OpCompositeExtract %uint %gid 0
%la = OpLoad %t %a
%lb = OpLoad %t %b
%lc = OpLoad {} %c
)",
                      same ? "%pt" : "%ptc", rank, same ? "%t" : "%tc");
  std::string coordinates;
  for (size_t axis = rank; axis-- > 0;) {
    text += fmt::format(R"(%s{0} = OpTensorQuerySizeARM %uint %la %n{0}
%at{0} = OpUMod %uint %rest{1} %s{0}
%rest{0} = OpUDiv %uint %rest{1} %s{0}
%w{0} = OpCompositeConstruct {2} %n{0}
OpTensorWriteARM %lc %w{0} %s{0}
)",
                        axis, axis + 1, rank == 1 ? "%coords" : "%coord");
    coordinates = fmt::format(" %at{}", axis) + coordinates;
  }
  return text + fmt::format(R"(%here = OpCompositeConstruct %coords{}
%value = OpTensorReadARM {} %la %here
OpTensorWriteARM %lb %here %value
OpReturn
OpFunctionEnd
)",
                            coordinates, element);
}

class ShaderLayerTest : public LayerTest {
 protected:
  /// Four elements each, 1 to 4 and 101 to 104, that shaders may access.
  void make_rows(ClientTensor (&tensors)[2]) {
    const int64_t dims[] = {4};
    client.more_usage = VK_TENSOR_USAGE_SHADER_BIT_ARM;
    for (ClientTensor& tensor : tensors) {
      ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R16_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1,
                                     dims, nullptr, &tensor),
                VK_SUCCESS);
      for (int i = 0; i < 4; ++i)
        static_cast<int16_t*>(tensor.mapped)[i] =
            static_cast<int16_t>(100 * (&tensor - tensors) + i + 1);
    }
  }

  struct Pipeline {
    VkDescriptorSetLayout set_layout;
    VkDescriptorPool pool;
    VkDescriptorSet set;
    ComputePipeline code;
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
    made.code = compute_pipeline(made.set_layout, text, 0, chained);
    return made;
  }
  void destroy(const Pipeline& made) const {
    LayerTest::destroy(made.code);
    vkDestroyDescriptorPool(client.device, made.pool, nullptr);
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
    EXPECT_EQ(client_submit(
                  &client,
                  [](VkCommandBuffer commands, void* user) {
                    const auto* all = static_cast<const Call*>(user);
                    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE,
                                      all->pipeline->code.pipeline);
                    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE,
                                            all->pipeline->code.layout, 0, 1, &all->pipeline->set,
                                            0, nullptr);
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
  ClientTensor tensors[2];
  ASSERT_NO_FATAL_FAILURE(make_rows(tensors));
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

TEST_F(ShaderLayerTest, EveryFormatAndRankIsReadAndWritten) {
  VkPhysicalDeviceFeatures features;
  vkGetPhysicalDeviceFeatures(client.physical, &features);
  client.more_usage = VK_TENSOR_USAGE_SHADER_BIT_ARM;
  const std::vector<int64_t> shapes[] = {{251},        {17, 23},        {7, 11, 5},
                                         {3, 5, 2, 7}, {2, 3, 5, 2, 7}, {2, 3, 1, 5, 2, 7}};
  for (const ShaderFormat& format : kShaderFormats)
    for (const std::vector<int64_t>& shape : shapes) {
      if (format.bytes == 8 && !features.shaderInt64) continue;
      SCOPED_TRACE(
          fmt::format("format {}, rank {}", static_cast<int>(format.format), shape.size()));
      const auto rank = static_cast<uint32_t>(shape.size());
      const auto bytes = static_cast<int64_t>(format.bytes);
      std::vector<int64_t> strides(rank);
      int64_t next = bytes, count = 1;
      for (size_t i = rank; i-- > 0; next *= shape[i], count *= shape[i]) {
        strides[i] = next;
        if (i + 2 == rank) strides[i] += 13 * bytes, next = strides[i];
      }
      ClientTensor a, b, c;
      ASSERT_EQ(client_create_tensor(&client, format.format, VK_TENSOR_TILING_LINEAR_ARM, rank,
                                     shape.data(), rank > 1 ? strides.data() : nullptr, &a),
                VK_SUCCESS);
      ASSERT_EQ(client_create_tensor(&client, format.format, VK_TENSOR_TILING_OPTIMAL_ARM, rank,
                                     shape.data(), nullptr, &b),
                VK_SUCCESS);
      const int64_t axes = rank;
      ASSERT_EQ(client_create_tensor(&client, VK_FORMAT_R32_UINT, VK_TENSOR_TILING_LINEAR_ARM, 1,
                                     &axes, nullptr, &c),
                VK_SUCCESS);
      auto* in = static_cast<uint8_t*>(a.mapped);
      const bool is_bool = format.format == VK_FORMAT_R8_BOOL_ARM;
      for (VkDeviceSize i = 0; i < a.size; ++i)
        in[i] = static_cast<uint8_t>(is_bool ? i * i % 3 % 2 : 1 + i * 41 % 251);
      const Pipeline pipeline = make(copy_shader(format, rank).c_str(), 3, 1);
      write(pipeline, {a.view, b.view, c.view});
      run(pipeline, static_cast<uint32_t>(count), 1, 1);
      const auto* out = static_cast<const uint8_t*>(b.mapped);
      for (int64_t i = 0; i < count; ++i) {
        int64_t rest = i, at = 0;
        for (size_t axis = rank; axis-- > 0; rest /= shape[axis])
          at += rest % shape[axis] * strides[axis];
        ASSERT_EQ(std::memcmp(out + i * bytes, in + at, format.bytes), 0) << i;
      }
      for (size_t axis = 0; axis < rank; ++axis)
        EXPECT_EQ(static_cast<const uint32_t*>(c.mapped)[axis], shape[axis]) << axis;
      destroy(pipeline);
      for (ClientTensor* tensor : {&a, &b, &c}) client_destroy_tensor(&client, tensor);
    }
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

  ClientTensor tensors[2];
  ASSERT_NO_FATAL_FAILURE(make_rows(tensors));
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
