// VK_KHR_maintenance5 and VK_KHR_deferred_host_operations, on which VK_ARM_data_graph depends: of the device, or lent by the
// layer where the device has them not.
#include <cstring>

#include "compiler/spirv/glsl.h"
#include "tests/compiler/graph_support.h"
#include "tests/compiler/spirv_text.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

class LentLayerTest : public LayerTest {
 protected:
  template <typename Function>
  Function find(const char* name) const {
    const auto found = reinterpret_cast<Function>(vkGetDeviceProcAddr(client.device, name));
    EXPECT_NE(found, nullptr) << name;
    return found;
  }
  VkResult submit(const std::function<void(VkCommandBuffer)>& record) const {
    return client_submit(
        &client,
        [](VkCommandBuffer commands, void* user) {
          (*static_cast<const std::function<void(VkCommandBuffer)>*>(user))(commands);
        },
        const_cast<std::function<void(VkCommandBuffer)>*>(&record));
  }
};

TEST_F(LentLayerTest, AreReportedWithTheirFeature) {
  VkPhysicalDeviceMaintenance5FeaturesKHR features{};
  features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_FEATURES_KHR;
  VkPhysicalDeviceFeatures2 all{};
  all.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
  all.pNext = &features;
  vkGetPhysicalDeviceFeatures2(client.physical, &all);
  EXPECT_TRUE(features.maintenance5);
  VkPhysicalDeviceMaintenance5PropertiesKHR limits{};
  limits.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_5_PROPERTIES_KHR;
  limits.polygonModePointSize = 7;
  VkPhysicalDeviceProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
  properties.pNext = &limits;
  vkGetPhysicalDeviceProperties2(client.physical, &properties);
  EXPECT_LE(limits.polygonModePointSize, VkBool32{VK_TRUE});
  uint32_t count = 0;
  vkEnumerateDeviceExtensionProperties(client.physical, nullptr, &count, nullptr);
  std::vector<VkExtensionProperties> list(count);
  vkEnumerateDeviceExtensionProperties(client.physical, nullptr, &count, list.data());
  for (const char* name :
       {VK_KHR_MAINTENANCE_5_EXTENSION_NAME, VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME})
    EXPECT_EQ(std::count_if(list.begin(), list.end(),
                            [&](const VkExtensionProperties& each) {
                              return std::strcmp(each.extensionName, name) == 0;
                            }),
              1)
        << name;
  // Formats that came with it may be asked for.
  VkFormatProperties format{};
  vkGetPhysicalDeviceFormatProperties(client.physical, VK_FORMAT_A8_UNORM_KHR, &format);
  VkImageFormatProperties image{};
  if (format.optimalTilingFeatures == 0) {
    EXPECT_EQ(vkGetPhysicalDeviceImageFormatProperties(client.physical, VK_FORMAT_A8_UNORM_KHR,
                                                       VK_IMAGE_TYPE_2D, VK_IMAGE_TILING_OPTIMAL,
                                                       VK_IMAGE_USAGE_SAMPLED_BIT, 0, &image),
              VK_ERROR_FORMAT_NOT_SUPPORTED);
  }
}

TEST_F(LentLayerTest, OperationsAreOverOnceTheyAreJoined) {
  const auto create = find<PFN_vkCreateDeferredOperationKHR>("vkCreateDeferredOperationKHR");
  const auto destroy = find<PFN_vkDestroyDeferredOperationKHR>("vkDestroyDeferredOperationKHR");
  const auto join = find<PFN_vkDeferredOperationJoinKHR>("vkDeferredOperationJoinKHR");
  const auto result = find<PFN_vkGetDeferredOperationResultKHR>("vkGetDeferredOperationResultKHR");
  ASSERT_TRUE(create && destroy && join && result);
  VkDeferredOperationKHR operation = VK_NULL_HANDLE;
  ASSERT_EQ(create(client.device, nullptr, &operation), VK_SUCCESS);
  EXPECT_NE(operation, VkDeferredOperationKHR{VK_NULL_HANDLE});
  EXPECT_EQ(join(client.device, operation), VK_SUCCESS);
  EXPECT_EQ(result(client.device, operation), VK_SUCCESS);
  destroy(client.device, operation, nullptr);
}

TEST_F(LentLayerTest, PipelinesTakeCodeAndFlagsFromTheirChains) {
  const std::vector<uint32_t> words = must(compile_glsl(R"(#version 450
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) buffer Values { int values[]; };
void main() { values[gl_GlobalInvocationID.x] += 5; }
)",
                                                        {}, "chained"));
  // The usage is said in the chain alone, too.
  VkBufferUsageFlags2CreateInfoKHR usage{};
  usage.sType = VK_STRUCTURE_TYPE_BUFFER_USAGE_FLAGS_2_CREATE_INFO_KHR;
  usage.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT;
  const HostBuffer values = host_buffer(16, 0, &usage);
  ASSERT_TRUE(values.mapped);
  VkDescriptorSetLayoutBinding binding{0, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1,
                                       VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
  VkDescriptorSetLayoutCreateInfo set_info{};
  set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
  set_info.bindingCount = 1;
  set_info.pBindings = &binding;
  VkDescriptorSetLayout set_layout;
  ASSERT_EQ(vkCreateDescriptorSetLayout(client.device, &set_info, nullptr, &set_layout),
            VK_SUCCESS);
  VkPipelineLayoutCreateInfo layout_info{};
  layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  layout_info.setLayoutCount = 1;
  layout_info.pSetLayouts = &set_layout;
  VkPipelineLayout layout;
  ASSERT_EQ(vkCreatePipelineLayout(client.device, &layout_info, nullptr, &layout), VK_SUCCESS);
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1};
  VkDescriptorPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  pool_info.maxSets = pool_info.poolSizeCount = 1;
  pool_info.pPoolSizes = &size;
  VkDescriptorPool pool;
  ASSERT_EQ(vkCreateDescriptorPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
  VkDescriptorSetAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  allocate.descriptorPool = pool;
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &set_layout;
  VkDescriptorSet set;
  ASSERT_EQ(vkAllocateDescriptorSets(client.device, &allocate, &set), VK_SUCCESS);
  const VkDescriptorBufferInfo whole{values.buffer, 0, VK_WHOLE_SIZE};
  VkWriteDescriptorSet write{};
  write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
  write.dstSet = set;
  write.descriptorCount = 1;
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = &whole;
  vkUpdateDescriptorSets(client.device, 1, &write, 0, nullptr);

  VkShaderModuleCreateInfo code{};
  code.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
  code.codeSize = 4 * words.size();
  code.pCode = words.data();
  VkPipelineCreateFlags2CreateInfoKHR flags{};
  flags.sType = VK_STRUCTURE_TYPE_PIPELINE_CREATE_FLAGS_2_CREATE_INFO_KHR;
  flags.flags = VK_PIPELINE_CREATE_DISABLE_OPTIMIZATION_BIT;
  VkComputePipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  info.pNext = &flags;
  info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
  info.stage.pNext = &code;
  info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  info.stage.pName = "main";
  info.layout = layout;
  VkPipeline pipeline;
  ASSERT_EQ(vkCreateComputePipelines(client.device, VK_NULL_HANDLE, 1, &info, nullptr, &pipeline),
            VK_SUCCESS);
  auto* numbers = static_cast<int32_t*>(values.mapped);
  for (int i = 0; i < 4; ++i) numbers[i] = i;
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline);
              vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout, 0, 1, &set,
                                      0, nullptr);
              vkCmdDispatch(commands, 4, 1, 1);
            }),
            VK_SUCCESS);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(numbers[i], i + 5);
  vkDestroyPipeline(client.device, pipeline, nullptr);
  vkDestroyDescriptorPool(client.device, pool, nullptr);
  vkDestroyPipelineLayout(client.device, layout, nullptr);
  vkDestroyDescriptorSetLayout(client.device, set_layout, nullptr);
}

TEST_F(LentLayerTest, CopiesTakeTheLayersThatRemain) {
  constexpr uint32_t kLayers = 3, kSide = 4;
  constexpr VkDeviceSize kBytes = kLayers * kSide * kSide;
  VkImageCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = VK_FORMAT_R8_UINT;
  info.extent = {kSide, kSide, 1};
  info.mipLevels = 1;
  info.arrayLayers = kLayers;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT;
  VkImage images[2];
  VkDeviceMemory memory[2];
  for (int i = 0; i < 2; ++i) {
    ASSERT_EQ(vkCreateImage(client.device, &info, nullptr, &images[i]), VK_SUCCESS);
    VkMemoryRequirements needs;
    vkGetImageMemoryRequirements(client.device, images[i], &needs);
    VkMemoryAllocateInfo allocate{};
    allocate.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
    allocate.allocationSize = needs.size;
    allocate.memoryTypeIndex = client_memory_type(&client, needs.memoryTypeBits, 0);
    ASSERT_EQ(vkAllocateMemory(client.device, &allocate, nullptr, &memory[i]), VK_SUCCESS);
    ASSERT_EQ(vkBindImageMemory(client.device, images[i], memory[i], 0), VK_SUCCESS);
  }
  const VkBufferUsageFlags both =
      VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
  const HostBuffer from = host_buffer(kBytes, both), to = host_buffer(kBytes, both);
  ASSERT_TRUE(from.mapped && to.mapped);
  for (VkDeviceSize i = 0; i < kBytes; ++i)
    static_cast<uint8_t*>(from.mapped)[i] = static_cast<uint8_t>(3 * i + 1);
  EXPECT_EQ(
      submit([&](VkCommandBuffer commands) {
        VkImageMemoryBarrier ready[2]{};
        for (int i = 0; i < 2; ++i) {
          ready[i].sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER;
          ready[i].dstAccessMask = VK_ACCESS_MEMORY_WRITE_BIT;
          ready[i].newLayout = VK_IMAGE_LAYOUT_GENERAL;
          ready[i].srcQueueFamilyIndex = ready[i].dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
          ready[i].image = images[i];
          ready[i].subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, kLayers};
        }
        vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                             VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 0, nullptr, 0, nullptr, 2,
                             ready);
        VkBufferImageCopy region{};
        region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, VK_REMAINING_ARRAY_LAYERS};
        region.imageExtent = info.extent;
        vkCmdCopyBufferToImage(commands, from.buffer, images[0], VK_IMAGE_LAYOUT_GENERAL, 1,
                               &region);
        client_full_barrier(commands);
        VkImageCopy2 middle{};
        middle.sType = VK_STRUCTURE_TYPE_IMAGE_COPY_2;
        middle.srcSubresource = middle.dstSubresource = region.imageSubresource;
        middle.extent = info.extent;
        VkCopyImageInfo2 copy{};
        copy.sType = VK_STRUCTURE_TYPE_COPY_IMAGE_INFO_2;
        copy.srcImage = images[0], copy.dstImage = images[1];
        copy.srcImageLayout = copy.dstImageLayout = VK_IMAGE_LAYOUT_GENERAL;
        copy.regionCount = 1;
        copy.pRegions = &middle;
        vkCmdCopyImage2(commands, &copy);
        client_full_barrier(commands);
        vkCmdCopyImageToBuffer(commands, images[1], VK_IMAGE_LAYOUT_GENERAL, to.buffer, 1, &region);
      }),
      VK_SUCCESS);
  EXPECT_EQ(std::memcmp(from.mapped, to.mapped, kBytes), 0);

  // What an image would look like, and what one does.
  const auto of_device =
      find<PFN_vkGetDeviceImageSubresourceLayoutKHR>("vkGetDeviceImageSubresourceLayoutKHR");
  const auto of_image =
      find<PFN_vkGetImageSubresourceLayout2KHR>("vkGetImageSubresourceLayout2KHR");
  ASSERT_TRUE(of_device && of_image);
  VkImageSubresource2KHR which{};
  which.sType = VK_STRUCTURE_TYPE_IMAGE_SUBRESOURCE_2_KHR;
  which.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1};
  VkDeviceImageSubresourceInfoKHR asked{};
  asked.sType = VK_STRUCTURE_TYPE_DEVICE_IMAGE_SUBRESOURCE_INFO_KHR;
  asked.pCreateInfo = &info;
  asked.pSubresource = &which;
  VkSubresourceLayout2KHR would{}, does{};
  would.sType = does.sType = VK_STRUCTURE_TYPE_SUBRESOURCE_LAYOUT_2_KHR;
  info.tiling = VK_IMAGE_TILING_LINEAR;
  info.arrayLayers = 1;
  which.imageSubresource.arrayLayer = 0;
  VkImage linear;
  ASSERT_EQ(vkCreateImage(client.device, &info, nullptr, &linear), VK_SUCCESS);
  of_device(client.device, &asked, &would);
  of_image(client.device, linear, &which, &does);
  EXPECT_EQ(would.subresourceLayout.rowPitch, does.subresourceLayout.rowPitch);
  EXPECT_EQ(would.subresourceLayout.size, does.subresourceLayout.size);
  EXPECT_GE(does.subresourceLayout.rowPitch, kSide);
  vkDestroyImage(client.device, linear, nullptr);
  for (int i = 0; i < 2; ++i) {
    vkDestroyImage(client.device, images[i], nullptr);
    vkFreeMemory(client.device, memory[i], nullptr);
  }
}

/// The position that the vertex has.
const char* kVertex = R"(
OpCapability Shader
OpMemoryModel 0 1
OpEntryPoint 0 %main "main" %in %out
OpDecorate %in 30 0
OpDecorate %out 11 0
%void = OpTypeVoid
%fn = OpTypeFunction %void
%f = OpTypeFloat 32
%v4 = OpTypeVector %f 4
%pin = OpTypePointer 1 %v4
%pout = OpTypePointer 3 %v4
%in = OpVariable %pin 1
%out = OpVariable %pout 3
%main = OpFunction %void 0 %fn
%l = OpLabel
%p = OpLoad %v4 %in
OpStore %out %p
OpReturn
OpFunctionEnd
)";

/// Red and green: 1065353216 is 1.0.
const char* kFragment = R"(
OpCapability Shader
OpMemoryModel 0 1
OpEntryPoint 4 %main "main" %color
OpExecutionMode %main 7
OpDecorate %color 30 0
%void = OpTypeVoid
%fn = OpTypeFunction %void
%f = OpTypeFloat 32
%v4 = OpTypeVector %f 4
%pout = OpTypePointer 3 %v4
%color = OpVariable %pout 3
%zero = OpConstant %f 0
%one = OpConstant %f 1065353216
%yellow = OpConstantComposite %v4 %one %one %zero %one
%main = OpFunction %void 0 %fn
%l = OpLabel
OpStore %color %yellow
OpReturn
OpFunctionEnd
)";

TEST_F(LentLayerTest, GraphicsPipelinesDrawFromWholeBuffers) {
  constexpr uint32_t kSide = 8;
  VkImageCreateInfo image_info{};
  image_info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
  image_info.imageType = VK_IMAGE_TYPE_2D;
  image_info.format = VK_FORMAT_R8G8B8A8_UNORM;
  image_info.extent = {kSide, kSide, 1};
  image_info.mipLevels = image_info.arrayLayers = 1;
  image_info.samples = VK_SAMPLE_COUNT_1_BIT;
  image_info.usage = VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT;
  VkImage image;
  ASSERT_EQ(vkCreateImage(client.device, &image_info, nullptr, &image), VK_SUCCESS);
  VkMemoryRequirements needs;
  vkGetImageMemoryRequirements(client.device, image, &needs);
  VkMemoryAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
  allocate.allocationSize = needs.size;
  allocate.memoryTypeIndex = client_memory_type(&client, needs.memoryTypeBits, 0);
  VkDeviceMemory memory;
  ASSERT_EQ(vkAllocateMemory(client.device, &allocate, nullptr, &memory), VK_SUCCESS);
  ASSERT_EQ(vkBindImageMemory(client.device, image, memory, 0), VK_SUCCESS);
  VkImageViewCreateInfo view_info{};
  view_info.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO;
  view_info.image = image;
  view_info.viewType = VK_IMAGE_VIEW_TYPE_2D;
  view_info.format = image_info.format;
  view_info.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
  VkImageView view;
  ASSERT_EQ(vkCreateImageView(client.device, &view_info, nullptr, &view), VK_SUCCESS);

  const std::vector<uint32_t> code[2] = {assemble_spirv(kVertex), assemble_spirv(kFragment)};
  VkShaderModuleCreateInfo modules[2]{};
  VkPipelineShaderStageCreateInfo stages[2]{};
  for (int i = 0; i < 2; ++i) {
    modules[i].sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
    modules[i].codeSize = 4 * code[i].size();
    modules[i].pCode = code[i].data();
    stages[i].sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
    stages[i].pNext = &modules[i];
    stages[i].stage = i == 0 ? VK_SHADER_STAGE_VERTEX_BIT : VK_SHADER_STAGE_FRAGMENT_BIT;
    stages[i].pName = "main";
  }
  const VkVertexInputBindingDescription binding{0, 16, VK_VERTEX_INPUT_RATE_VERTEX};
  const VkVertexInputAttributeDescription attribute{0, 0, VK_FORMAT_R32G32B32A32_SFLOAT, 0};
  VkPipelineVertexInputStateCreateInfo vertex{};
  vertex.sType = VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO;
  vertex.vertexBindingDescriptionCount = vertex.vertexAttributeDescriptionCount = 1;
  vertex.pVertexBindingDescriptions = &binding;
  vertex.pVertexAttributeDescriptions = &attribute;
  VkPipelineInputAssemblyStateCreateInfo assembly{};
  assembly.sType = VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO;
  assembly.topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST;
  const VkViewport viewport{0, 0, kSide, kSide, 0, 1};
  const VkRect2D all{{0, 0}, {kSide, kSide}};
  VkPipelineViewportStateCreateInfo viewports{};
  viewports.sType = VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO;
  viewports.viewportCount = viewports.scissorCount = 1;
  viewports.pViewports = &viewport;
  viewports.pScissors = &all;
  VkPipelineRasterizationStateCreateInfo raster{};
  raster.sType = VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO;
  raster.lineWidth = 1;
  VkPipelineMultisampleStateCreateInfo samples{};
  samples.sType = VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO;
  samples.rasterizationSamples = VK_SAMPLE_COUNT_1_BIT;
  VkPipelineColorBlendAttachmentState written{};
  written.colorWriteMask = 15;
  VkPipelineColorBlendStateCreateInfo blend{};
  blend.sType = VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO;
  blend.attachmentCount = 1;
  blend.pAttachments = &written;
  const VkDynamicState stride = VK_DYNAMIC_STATE_VERTEX_INPUT_BINDING_STRIDE;
  VkPipelineDynamicStateCreateInfo dynamic{};
  dynamic.sType = VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO;
  dynamic.dynamicStateCount = 1;
  dynamic.pDynamicStates = &stride;
  VkPipelineLayoutCreateInfo layout_info{};
  layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  VkPipelineLayout layout;
  ASSERT_EQ(vkCreatePipelineLayout(client.device, &layout_info, nullptr, &layout), VK_SUCCESS);
  VkPipelineCreateFlags2CreateInfoKHR flags{};
  flags.sType = VK_STRUCTURE_TYPE_PIPELINE_CREATE_FLAGS_2_CREATE_INFO_KHR;
  flags.flags = VK_PIPELINE_CREATE_DISABLE_OPTIMIZATION_BIT;
  VkPipelineRenderingCreateInfo rendering{};
  rendering.sType = VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO;
  rendering.pNext = &flags;
  rendering.colorAttachmentCount = 1;
  rendering.pColorAttachmentFormats = &image_info.format;
  VkGraphicsPipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO;
  info.pNext = &rendering;
  info.stageCount = 2;
  info.pStages = stages;
  info.pVertexInputState = &vertex;
  info.pInputAssemblyState = &assembly;
  info.pViewportState = &viewports;
  info.pRasterizationState = &raster;
  info.pMultisampleState = &samples;
  info.pColorBlendState = &blend;
  info.pDynamicState = &dynamic;
  info.layout = layout;
  VkPipeline pipeline;
  ASSERT_EQ(vkCreateGraphicsPipelines(client.device, VK_NULL_HANDLE, 1, &info, nullptr, &pipeline),
            VK_SUCCESS);

  // The left half, of a buffer whose first vertex is another.
  const HostBuffer vertices = host_buffer(5 * 16, VK_BUFFER_USAGE_VERTEX_BUFFER_BIT);
  const HostBuffer indices = host_buffer(6 * 2, VK_BUFFER_USAGE_INDEX_BUFFER_BIT);
  const HostBuffer pixels = host_buffer(kSide * kSide * 4, VK_BUFFER_USAGE_TRANSFER_DST_BIT);
  ASSERT_TRUE(vertices.mapped && indices.mapped && pixels.mapped);
  const float corners[5][4] = {
      {9, 9, 0, 1}, {-1, -1, 0, 1}, {0, -1, 0, 1}, {-1, 1, 0, 1}, {0, 1, 0, 1}};
  std::memcpy(vertices.mapped, corners, sizeof corners);
  const uint16_t order[6] = {0, 1, 2, 2, 1, 3};
  std::memcpy(indices.mapped, order, sizeof order);
  const auto bind_indices = find<PFN_vkCmdBindIndexBuffer2KHR>("vkCmdBindIndexBuffer2KHR");
  const auto granularity =
      find<PFN_vkGetRenderingAreaGranularityKHR>("vkGetRenderingAreaGranularityKHR");
  ASSERT_TRUE(bind_indices && granularity);
  VkRenderingAreaInfoKHR area{};
  area.sType = VK_STRUCTURE_TYPE_RENDERING_AREA_INFO_KHR;
  area.colorAttachmentCount = 1;
  area.pColorAttachmentFormats = &image_info.format;
  VkExtent2D step{};
  granularity(client.device, &area, &step);
  EXPECT_GE(step.width, 1u);
  EXPECT_EQ(submit([&](VkCommandBuffer commands) {
              VkImageMemoryBarrier ready{};
              ready.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER;
              ready.dstAccessMask =
                  VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_COLOR_ATTACHMENT_READ_BIT;
              ready.newLayout = VK_IMAGE_LAYOUT_GENERAL;
              ready.srcQueueFamilyIndex = ready.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
              ready.image = image;
              ready.subresourceRange = view_info.subresourceRange;
              vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                                   VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT, 0, 0, nullptr, 0,
                                   nullptr, 1, &ready);
              VkRenderingAttachmentInfo target{};
              target.sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO;
              target.imageView = view;
              target.imageLayout = VK_IMAGE_LAYOUT_GENERAL;
              target.loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR;
              target.storeOp = VK_ATTACHMENT_STORE_OP_STORE;
              VkRenderingInfo drawn{};
              drawn.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
              drawn.renderArea = all;
              drawn.layerCount = drawn.colorAttachmentCount = 1;
              drawn.pColorAttachments = &target;
              vkCmdBeginRendering(commands, &drawn);
              vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline);
              const VkDeviceSize offset = 16, whole = VK_WHOLE_SIZE, each = 16;
              vkCmdBindVertexBuffers2(commands, 0, 1, &vertices.buffer, &offset, &whole, &each);
              bind_indices(commands, indices.buffer, 0, VK_WHOLE_SIZE, VK_INDEX_TYPE_UINT16);
              vkCmdDrawIndexed(commands, 6, 1, 0, 0, 0);
              vkCmdEndRendering(commands);
              client_full_barrier(commands);
              VkBufferImageCopy region{};
              region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
              region.imageExtent = image_info.extent;
              vkCmdCopyImageToBuffer(commands, image, VK_IMAGE_LAYOUT_GENERAL, pixels.buffer, 1,
                                     &region);
            }),
            VK_SUCCESS);
  const auto* texel = static_cast<const uint32_t*>(pixels.mapped);
  for (uint32_t i = 0; i < kSide * kSide; ++i)
    EXPECT_EQ(texel[i], i % kSide < kSide / 2 ? 0xff00ffffu : 0u) << i;
  vkDestroyPipeline(client.device, pipeline, nullptr);
  vkDestroyPipelineLayout(client.device, layout, nullptr);
  vkDestroyImageView(client.device, view, nullptr);
  vkDestroyImage(client.device, image, nullptr);
  vkFreeMemory(client.device, memory, nullptr);
}

}  // namespace
}  // namespace shale
