// VK_ARM_data_graph_optical_flow between pictures whose flow is known, and beside Shale's own program of the same search.
#include <cmath>
#include <cstring>
#include <map>

#include "ir/base/file.h"
#include "ir/base/half.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"
#include "tests/support/source_folder.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr uint32_t kWidth = 186, kHeight = 122;  // no multiple of any grid

using Picture = std::vector<uint8_t>;

/// Smooth noise of several octaves, 20 to 200, moved by whole pixels.
Picture picture_of(int dx, int dy) {
  const auto lattice = [](int i, int j, uint32_t octave) {
    uint32_t h = static_cast<uint32_t>(i) * 0x8da6b343u ^ static_cast<uint32_t>(j) * 0xd8163841u ^
                 octave * 0xcb1ab31fu;
    h = (h ^ h >> 13) * 0x5bd1e995u;
    return ((h ^ h >> 15) & 0xffff) / 65535.0;
  };
  Picture picture;
  for (int y = 0; y < static_cast<int>(kHeight); ++y)
    for (int x = 0; x < static_cast<int>(kWidth); ++x) {
      double sum = 0, weight = 0;
      for (uint32_t octave = 0; octave < 4; ++octave) {
        const double cell = 40 / std::exp2(octave);
        const double u = (x - dx) / cell, v = (y - dy) / cell;
        const int i = static_cast<int>(std::floor(u)), j = static_cast<int>(std::floor(v));
        const auto smooth = [](double t) { return t * t * (3 - 2 * t); };
        const double fx = smooth(u - i), fy = smooth(v - j), part = std::exp2(-0.5 * octave);
        const double above = lattice(i, j, octave) * (1 - fx) + lattice(i + 1, j, octave) * fx;
        const double below =
            lattice(i, j + 1, octave) * (1 - fx) + lattice(i + 1, j + 1, octave) * fx;
        sum += part * (above * (1 - fy) + below * fy);
        weight += part;
      }
      picture.push_back(static_cast<uint8_t>(20 + 180 * sum / weight));
    }
  return picture;
}

struct Vector {
  float x, y;
  bool operator==(const Vector&) const = default;
};

class OpticalFlowLayerTest : public LayerTest {
 protected:
  void SetUp() override {
    LayerTest::SetUp();
    if (!is_open) return;
    features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DATA_GRAPH_OPTICAL_FLOW_FEATURES_ARM;
    VkPhysicalDeviceFeatures2 all{};
    all.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
    all.pNext = &features;
    vkGetPhysicalDeviceFeatures2(client.physical, &all);
    EXPECT_EQ(features.dataGraphOpticalFlow, all.features.shaderStorageImageExtendedFormats);
    if (!features.dataGraphOpticalFlow) GTEST_SKIP() << "the device has no optical flow";
    features.pNext = nullptr;
    client_close(&client);
    ASSERT_EQ(client_open(&client, &features), VK_SUCCESS);
  }
  void TearDown() override {
    for (const auto& [key, node] : nodes) destroy(node);
    for (const Image& image : images) {
      vkDestroyImageView(client.device, image.view, nullptr);
      vkDestroyImage(client.device, image.image, nullptr);
      vkFreeMemory(client.device, image.memory, nullptr);
    }
    LayerTest::TearDown();
  }

  struct Image {
    VkImage image;
    VkDeviceMemory memory;
    VkImageView view;
    VkExtent3D extent;
    HostBuffer host;  ///< what goes in before, or comes out behind
    bool is_output;
  };
  /// `texel` in bytes.
  const Image& make_image(VkFormat format, uint32_t width, uint32_t height, uint32_t texel,
                          VkDataGraphOpticalFlowImageUsageFlagsARM use, bool sampled) {
    const bool is_output = use == VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM ||
                           use == VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM;
    Image& made = images.emplace_back(Image{});
    made.is_output = is_output;
    made.extent = {width, height, 1};
    made.host = host_buffer(uint64_t{width} * height * texel + 16,
                            VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT);
    VkDataGraphOpticalFlowImageFormatInfoARM usage{};
    usage.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_INFO_ARM;
    usage.usage = use;
    VkImageCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
    info.pNext = &usage;
    info.imageType = VK_IMAGE_TYPE_2D;
    info.format = format;
    info.extent = made.extent;
    info.mipLevels = info.arrayLayers = 1;
    info.samples = VK_SAMPLE_COUNT_1_BIT;
    info.usage = (sampled ? VK_IMAGE_USAGE_SAMPLED_BIT : VK_IMAGE_USAGE_STORAGE_BIT) |
                 VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT;
    EXPECT_EQ(vkCreateImage(client.device, &info, nullptr, &made.image), VK_SUCCESS);
    VkMemoryRequirements needs;
    vkGetImageMemoryRequirements(client.device, made.image, &needs);
    VkMemoryAllocateInfo memory{};
    memory.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
    memory.allocationSize = needs.size;
    memory.memoryTypeIndex = client_memory_type(&client, needs.memoryTypeBits, 0);
    EXPECT_EQ(vkAllocateMemory(client.device, &memory, nullptr, &made.memory), VK_SUCCESS);
    EXPECT_EQ(vkBindImageMemory(client.device, made.image, made.memory, 0), VK_SUCCESS);
    VkImageViewCreateInfo view{};
    view.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO;
    view.image = made.image;
    view.viewType = VK_IMAGE_VIEW_TYPE_2D;
    view.format = format;
    view.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
    EXPECT_EQ(vkCreateImageView(client.device, &view, nullptr, &made.view), VK_SUCCESS);
    return made;
  }

  struct Case {
    uint32_t grid = 4;
    bool sampled = false;  ///< pictures are sampled images, else storage images
    bool coloured = false;
    bool cost = false;
    std::vector<Vector> hint = {};  ///< none if empty
  };
  struct Found {
    std::vector<Vector> vectors;
    std::vector<uint16_t> costs;
    uint32_t width = 0, height = 0;
  };

  struct Node {
    VkDescriptorSetLayout set_layout;
    VkPipelineLayout layout;
    VkPipeline pipeline;
  };
  VkResult make_node(const Case& wanted, uint32_t width, uint32_t height, Node& node) const {
    constexpr VkDataGraphPipelineNodeConnectionTypeARM kAll[] = {
        VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_INPUT_ARM,
        VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_REFERENCE_ARM,
        VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_FLOW_VECTOR_ARM,
        VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_HINT_ARM,
        VK_DATA_GRAPH_PIPELINE_NODE_CONNECTION_TYPE_OPTICAL_FLOW_COST_ARM};
    std::vector<VkDescriptorSetLayoutBinding> bindings;
    std::vector<VkDataGraphPipelineSingleNodeConnectionARM> connections;
    std::vector<VkDataGraphPipelineResourceInfoARM> resources;
    VkDataGraphPipelineResourceInfoImageLayoutARM image_layout{};
    image_layout.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_RESOURCE_INFO_IMAGE_LAYOUT_ARM;
    image_layout.layout = VK_IMAGE_LAYOUT_GENERAL;
    for (uint32_t i = 0; i < 5; ++i) {
      if ((i == 3 && wanted.hint.empty()) || (i == 4 && !wanted.cost)) continue;
      bindings.push_back({i,
                          i < 2 && wanted.sampled ? VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE
                                                  : VK_DESCRIPTOR_TYPE_STORAGE_IMAGE,
                          1, VK_SHADER_STAGE_ALL, nullptr});
      connections.push_back({VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SINGLE_NODE_CONNECTION_ARM,
                             nullptr, 0, i, kAll[i]});
      resources.push_back(
          {VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_RESOURCE_INFO_ARM, &image_layout, 0, i, 0});
    }
    VkDescriptorSetLayoutCreateInfo set_info{};
    set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
    set_info.bindingCount = static_cast<uint32_t>(bindings.size());
    set_info.pBindings = bindings.data();
    EXPECT_EQ(vkCreateDescriptorSetLayout(client.device, &set_info, nullptr, &node.set_layout),
              VK_SUCCESS);
    VkPipelineLayoutCreateInfo layout_info{};
    layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
    layout_info.setLayoutCount = 1;
    layout_info.pSetLayouts = &node.set_layout;
    EXPECT_EQ(vkCreatePipelineLayout(client.device, &layout_info, nullptr, &node.layout),
              VK_SUCCESS);
    VkDataGraphPipelineOpticalFlowCreateInfoARM flow{};
    flow.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_OPTICAL_FLOW_CREATE_INFO_ARM;
    flow.width = width;
    flow.height = height;
    flow.imageFormat = wanted.coloured ? VK_FORMAT_R8G8B8A8_UNORM : VK_FORMAT_R8_UNORM;
    flow.flowVectorFormat = VK_FORMAT_R16G16_SFLOAT;
    flow.costFormat = wanted.cost ? VK_FORMAT_R16_UINT : VK_FORMAT_UNDEFINED;
    flow.outputGridSize = wanted.grid;
    flow.hintGridSize = wanted.hint.empty() ? 0 : wanted.grid;
    if (!wanted.hint.empty()) flow.flags |= VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_HINT_BIT_ARM;
    if (wanted.cost) flow.flags |= VK_DATA_GRAPH_OPTICAL_FLOW_CREATE_ENABLE_COST_BIT_ARM;
    VkDataGraphPipelineSingleNodeCreateInfoARM single{};
    single.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_SINGLE_NODE_CREATE_INFO_ARM;
    single.pNext = &flow;
    single.nodeType = VK_DATA_GRAPH_PIPELINE_NODE_TYPE_OPTICAL_FLOW_ARM;
    single.connectionCount = static_cast<uint32_t>(connections.size());
    single.pConnections = connections.data();
    VkDataGraphPipelineCreateInfoARM info{};
    info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CREATE_INFO_ARM;
    info.pNext = &single;
    info.layout = node.layout;
    info.resourceInfoCount = static_cast<uint32_t>(resources.size());
    info.pResourceInfos = resources.data();
    return client.CreateDataGraphPipelinesARM(client.device, VK_NULL_HANDLE, VK_NULL_HANDLE, 1,
                                              &info, nullptr, &node.pipeline);
  }
  void destroy(const Node& node) const {
    vkDestroyPipeline(client.device, node.pipeline, nullptr);
    vkDestroyPipelineLayout(client.device, node.layout, nullptr);
    vkDestroyDescriptorSetLayout(client.device, node.set_layout, nullptr);
  }

  Found find(const Picture& input, const Picture& reference, const Case& wanted) {
    const uint32_t texel = wanted.coloured ? 4 : 1;
    const VkFormat format = wanted.coloured ? VK_FORMAT_R8G8B8A8_UNORM : VK_FORMAT_R8_UNORM;
    Found found;
    found.width = (kWidth + wanted.grid - 1) / wanted.grid;
    found.height = (kHeight + wanted.grid - 1) / wanted.grid;
    const size_t first = images.size();
    images.reserve(first + 5);
    for (const Picture* picture : {&input, &reference}) {
      const Image& image =
          make_image(format, kWidth, kHeight, texel,
                     VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_INPUT_BIT_ARM, wanted.sampled);
      auto* to = static_cast<uint8_t*>(image.host.mapped);
      for (size_t i = 0; i < picture->size(); ++i)
        std::memset(to + i * texel, (*picture)[i], texel);
    }
    make_image(VK_FORMAT_R16G16_SFLOAT, found.width, found.height, 4,
               VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM, false);
    if (!wanted.hint.empty()) {
      const Image& image = make_image(VK_FORMAT_R16G16_SFLOAT, found.width, found.height, 4,
                                      VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_HINT_BIT_ARM, false);
      auto* to = static_cast<uint16_t*>(image.host.mapped);
      for (const Vector& vector : wanted.hint) {
        *to++ = float_to_half(vector.x);
        *to++ = float_to_half(vector.y);
      }
    }
    if (wanted.cost)
      make_image(VK_FORMAT_R16_UINT, found.width, found.height, 2,
                 VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM, false);
    const std::span<const Image> used(images.data() + first, images.size() - first);

    // Drivers take their time for a node: it is made once.
    Node& node = nodes[{wanted.grid, !wanted.hint.empty()}];
    if (!node.pipeline) {
      EXPECT_EQ(make_node(wanted, kWidth, kHeight, node), VK_SUCCESS) << client.last_message;
    }
    VkDataGraphPipelineSessionARM session;
    VkDeviceMemory session_memory;
    VkDeviceSize bytes;
    EXPECT_EQ(client_create_session(&client, node.pipeline, &session, &session_memory, &bytes),
              VK_SUCCESS)
        << client.last_message;
    const VkDescriptorPoolSize sizes[] = {{VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, 5},
                                          {VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 2}};
    VkDescriptorPoolCreateInfo pool_info{};
    pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
    pool_info.maxSets = 1;
    pool_info.poolSizeCount = 2;
    pool_info.pPoolSizes = sizes;
    VkDescriptorPool pool;
    EXPECT_EQ(vkCreateDescriptorPool(client.device, &pool_info, nullptr, &pool), VK_SUCCESS);
    VkDescriptorSetAllocateInfo allocate{};
    allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
    allocate.descriptorPool = pool;
    allocate.descriptorSetCount = 1;
    allocate.pSetLayouts = &node.set_layout;
    VkDescriptorSet set;
    EXPECT_EQ(vkAllocateDescriptorSets(client.device, &allocate, &set), VK_SUCCESS);
    for (size_t i = 0; i < used.size(); ++i) {
      const VkDescriptorImageInfo image{VK_NULL_HANDLE, used[i].view, VK_IMAGE_LAYOUT_GENERAL};
      VkWriteDescriptorSet write{};
      write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
      write.dstSet = set;
      write.dstBinding = i == 3 && wanted.hint.empty() ? 4 : static_cast<uint32_t>(i);
      write.descriptorCount = 1;
      write.descriptorType = i < 2 && wanted.sampled ? VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE
                                                     : VK_DESCRIPTOR_TYPE_STORAGE_IMAGE;
      write.pImageInfo = &image;
      vkUpdateDescriptorSets(client.device, 1, &write, 0, nullptr);
    }

    const std::function<void(VkCommandBuffer)> record = [&](VkCommandBuffer commands) {
      const auto barrier = [&](const Image& image, VkPipelineStageFlags2 from, VkAccessFlags2 wrote,
                               VkPipelineStageFlags2 to, VkAccessFlags2 use, VkImageLayout old) {
        VkImageMemoryBarrier2 one{};
        one.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2;
        one.srcStageMask = from;
        one.srcAccessMask = wrote;
        one.dstStageMask = to;
        one.dstAccessMask = use;
        one.oldLayout = old;
        one.newLayout = VK_IMAGE_LAYOUT_GENERAL;
        one.srcQueueFamilyIndex = one.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
        one.image = image.image;
        one.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
        VkDependencyInfo info{};
        info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
        info.imageMemoryBarrierCount = 1;
        info.pImageMemoryBarriers = &one;
        vkCmdPipelineBarrier2(commands, &info);
      };
      VkBufferImageCopy region{};
      region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
      for (const Image& image : used) {
        barrier(image, VK_PIPELINE_STAGE_2_NONE, VK_ACCESS_2_NONE, VK_PIPELINE_STAGE_2_COPY_BIT,
                VK_ACCESS_2_TRANSFER_WRITE_BIT, VK_IMAGE_LAYOUT_UNDEFINED);
        region.imageExtent = image.extent;
        vkCmdCopyBufferToImage(commands, image.host.buffer, image.image, VK_IMAGE_LAYOUT_GENERAL, 1,
                               &region);
        barrier(image, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT,
                VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM,
                VK_ACCESS_2_DATA_GRAPH_READ_BIT_ARM | VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM,
                VK_IMAGE_LAYOUT_GENERAL);
      }
      vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, node.pipeline);
      vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_DATA_GRAPH_ARM, node.layout, 0, 1,
                              &set, 0, nullptr);
      VkDataGraphPipelineOpticalFlowDispatchInfoARM flow_info{};
      flow_info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_OPTICAL_FLOW_DISPATCH_INFO_ARM;
      flow_info.flags = VK_DATA_GRAPH_OPTICAL_FLOW_EXECUTE_DISABLE_TEMPORAL_HINTS_BIT_ARM;
      VkDataGraphPipelineDispatchInfoARM dispatch{};
      dispatch.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_DISPATCH_INFO_ARM;
      dispatch.pNext = &flow_info;
      client.CmdDispatchDataGraphARM(commands, session, &dispatch);
      client.CmdDispatchDataGraphARM(commands, session, nullptr);
      for (const Image& image : used) {
        if (!image.is_output) continue;
        barrier(image, VK_PIPELINE_STAGE_2_DATA_GRAPH_BIT_ARM, VK_ACCESS_2_DATA_GRAPH_WRITE_BIT_ARM,
                VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_READ_BIT,
                VK_IMAGE_LAYOUT_GENERAL);
        region.imageExtent = image.extent;
        vkCmdCopyImageToBuffer(commands, image.image, VK_IMAGE_LAYOUT_GENERAL, image.host.buffer, 1,
                               &region);
      }
    };
    EXPECT_EQ(client_submit(
                  &client,
                  [](VkCommandBuffer commands, void* user) {
                    (*static_cast<const std::function<void(VkCommandBuffer)>*>(user))(commands);
                  },
                  const_cast<std::function<void(VkCommandBuffer)>*>(&record)),
              VK_SUCCESS)
        << client.last_message;
    const size_t count = size_t{found.width} * found.height;
    const auto* halves = static_cast<const uint16_t*>(used[2].host.mapped);
    for (size_t i = 0; i < count; ++i)
      found.vectors.push_back({half_to_float(halves[2 * i]), half_to_float(halves[2 * i + 1])});
    if (wanted.cost) {
      const auto* costs = static_cast<const uint16_t*>(used.back().host.mapped);
      found.costs.assign(costs, costs + count);
    }
    client.DestroyDataGraphPipelineSessionARM(client.device, session, nullptr);
    vkFreeMemory(client.device, session_memory, nullptr);
    vkDestroyDescriptorPool(client.device, pool, nullptr);
    return found;
  }

  /// Part of the vectors, away from the edges, within a pixel of the one expected.
  static double right(const Found& found, uint32_t grid, Vector wanted) {
    size_t right = 0, all = 0;
    for (uint32_t j = 0; j < found.height; ++j)
      for (uint32_t i = 0; i < found.width; ++i) {
        const uint32_t x = grid * i, y = grid * j, border = 32;
        if (x < border || y < border || x + border > kWidth || y + border > kHeight) continue;
        const Vector& vector = found.vectors[j * found.width + i];
        ++all;
        right += std::hypot(vector.x - wanted.x, vector.y - wanted.y) <= 1;
      }
    EXPECT_GT(all, 50u);
    return static_cast<double>(right) / static_cast<double>(all);
  }

  VkPhysicalDeviceDataGraphOpticalFlowFeaturesARM features{};
  std::vector<Image> images;
  std::map<std::pair<uint32_t, bool>, Node> nodes;  ///< by grid and whether there are hints
};

TEST_F(OpticalFlowLayerTest, SaysWhatItTakes) {
  uint32_t count = 8;
  VkQueueFamilyDataGraphPropertiesARM operations[8]{};
  const auto list = reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM>(
      vkGetInstanceProcAddr(client.instance,
                            "vkGetPhysicalDeviceQueueFamilyDataGraphPropertiesARM"));
  for (VkQueueFamilyDataGraphPropertiesARM& each : operations)
    each.sType = VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_PROPERTIES_ARM;
  ASSERT_EQ(list(client.physical, client.family, &count, operations), VK_SUCCESS);
  ASSERT_EQ(count, 2u);
  EXPECT_STREQ(operations[1].operation.name, "OpticalFlow");
  EXPECT_EQ(operations[1].operation.version, 1u);
  VkQueueFamilyDataGraphOpticalFlowPropertiesARM properties{};
  properties.sType = VK_STRUCTURE_TYPE_QUEUE_FAMILY_DATA_GRAPH_OPTICAL_FLOW_PROPERTIES_ARM;
  const auto ask =
      reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM>(
          vkGetInstanceProcAddr(
              client.instance,
              "vkGetPhysicalDeviceQueueFamilyDataGraphEngineOperationPropertiesARM"));
  ASSERT_EQ(ask(client.physical, client.family, &operations[1],
                reinterpret_cast<VkBaseOutStructure*>(&properties)),
            VK_SUCCESS);
  EXPECT_EQ(properties.supportedOutputGridSizes, 15u);
  EXPECT_TRUE(properties.hintSupported && properties.costSupported);
  EXPECT_GE(properties.maxWidth, 3840u);
  EXPECT_GE(properties.maxHeight, 2160u);
  const auto formats =
      reinterpret_cast<PFN_vkGetPhysicalDeviceQueueFamilyDataGraphOpticalFlowImageFormatsARM>(
          vkGetInstanceProcAddr(
              client.instance,
              "vkGetPhysicalDeviceQueueFamilyDataGraphOpticalFlowImageFormatsARM"));
  ASSERT_TRUE(formats);
  VkDataGraphOpticalFlowImageFormatInfoARM info{};
  info.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_INFO_ARM;
  const struct {
    VkDataGraphOpticalFlowImageUsageFlagsARM usage;
    VkFormat first;
    uint32_t count;
    VkFormatFeatureFlags2 feature;
  } kUses[] = {{VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_INPUT_BIT_ARM, VK_FORMAT_R8_UNORM, 2,
                VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_IMAGE_BIT_ARM},
               {VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_OUTPUT_BIT_ARM, VK_FORMAT_R16G16_SFLOAT, 1,
                VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_VECTOR_BIT_ARM},
               {VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_HINT_BIT_ARM, VK_FORMAT_R16G16_SFLOAT, 1,
                VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_VECTOR_BIT_ARM},
               {VK_DATA_GRAPH_OPTICAL_FLOW_IMAGE_USAGE_COST_BIT_ARM, VK_FORMAT_R16_UINT, 1,
                VK_FORMAT_FEATURE_2_DATA_GRAPH_OPTICAL_FLOW_COST_BIT_ARM}};
  for (const auto& [usage, first, number, feature] : kUses) {
    info.usage = usage;
    VkDataGraphOpticalFlowImageFormatPropertiesARM results[4]{};
    for (auto& each : results)
      each.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_OPTICAL_FLOW_IMAGE_FORMAT_PROPERTIES_ARM;
    count = 4;
    ASSERT_EQ(formats(client.physical, client.family, &operations[1], &info, &count, results),
              VK_SUCCESS);
    EXPECT_EQ(count, number);
    EXPECT_EQ(results[0].format, first);
    VkFormatProperties3 more{};
    more.sType = VK_STRUCTURE_TYPE_FORMAT_PROPERTIES_3;
    VkFormatProperties2 all{};
    all.sType = VK_STRUCTURE_TYPE_FORMAT_PROPERTIES_2;
    all.pNext = &more;
    vkGetPhysicalDeviceFormatProperties2(client.physical, first, &all);
    EXPECT_TRUE(more.optimalTilingFeatures & feature);
  }
}

TEST_F(OpticalFlowLayerTest, ShiftsAreFoundOnEveryGrid) {
  const Picture still = picture_of(0, 0);
  for (const uint32_t grid : {1u, 8u}) {
    SCOPED_TRACE(grid);
    const Case wanted{.grid = grid, .sampled = grid == 8, .coloured = grid == 1};
    EXPECT_GT(right(find(still, picture_of(-8, 8), wanted), grid, {-8, 8}), 0.9);
  }
  for (const uint32_t grid : {2u, 4u}) {  // the rest of the tests runs the latter
    Node node{};
    EXPECT_EQ(make_node({.grid = grid}, kWidth, kHeight, node), VK_SUCCESS) << client.last_message;
    destroy(node);
  }
}

TEST_F(OpticalFlowLayerTest, HintsAndCostsTellWhatFits) {
  const Picture still = picture_of(0, 0);
  const size_t count = size_t{(kWidth + 3) / 4} * ((kHeight + 3) / 4);
  const std::vector<Vector> none(count, Vector{0, 0});
  // What stands still has no flow and costs nothing.
  const Found rest = find(still, still, {.cost = true, .hint = none});
  for (const Vector& vector : rest.vectors) ASSERT_EQ(vector, (Vector{0, 0}));
  for (const uint16_t cost : rest.costs) ASSERT_EQ(cost, 0);
  // Where the other picture has nothing like it, the cost is higher.
  Picture broken = still;
  for (uint32_t y = 40; y < 80; ++y)
    for (uint32_t x = 60; x < 120; ++x) broken[y * kWidth + x] = (x / 3 + y / 3) % 2 ? 255 : 0;
  const Found costly = find(still, broken, {.grid = 4, .cost = true});
  EXPECT_GT(costly.costs[15 * costly.width + 22], 100);
  EXPECT_EQ(costly.costs[5 * costly.width + 5], 0);
}

TEST_F(OpticalFlowLayerTest, TheSearchIsThatOfTheProgram) {
  const std::string folder = source_folder() + "/models/baselines/flow/";
  CompileOptions options;
  options.frame = must(parse_frame(must(read_text(folder + "frame.json"))));
  options.load_shader = [folder](const std::string& path) { return read_text(folder + path); };
  options.sizes = {FrameExtent{kWidth, kHeight}, FrameExtent{kWidth, kHeight}};
  const ToolDevice device = must(ToolDevice::open({}));
  const Compiled compiled = must(compile_graph(Graph{}, 0, options));
  const auto player = must(Player::create(device, compiled.package));
  const Picture before = picture_of(0, 0), after = picture_of(13, -7);
  FloatImage expected;
  for (const Picture* picture : {&before, &after}) {
    SourceFrame frame;
    frame.camera.exposure = 1;
    frame.color = {kWidth, kHeight, 3, {}};
    frame.motion = {kWidth, kHeight, 2, std::vector<float>(size_t{2} * kWidth * kHeight)};
    for (const uint8_t code : *picture) {
      // Of which the curve of luma.comp makes the code again.
      const float shown = static_cast<float>(code) / 255;
      frame.color.values.insert(frame.color.values.end(), 3, shown * shown / (1 - shown * shown));
    }
    expected = must(player->play(frame));
  }
  // The program takes a motion of nothing for a hint.
  const size_t count = size_t{(kWidth + 3) / 4} * ((kHeight + 3) / 4);
  const Found found = find(before, after, {.hint = std::vector<Vector>(count, Vector{0, 0})});
  ASSERT_EQ(found.width, expected.width);
  ASSERT_EQ(found.height, expected.height);
  for (uint32_t j = 0; j < found.height; ++j)
    for (uint32_t i = 0; i < found.width; ++i)
      ASSERT_EQ(found.vectors[j * found.width + i],
                (Vector{4 * expected.at(i, j)[0], 4 * expected.at(i, j)[1]}))
          << i << " " << j;
}

TEST_F(OpticalFlowLayerTest, WhatIsNotReportedIsRefused) {
  SHALE_SKIP_IF_VALIDATED();
  const auto refused = [&](const Case& wanted, uint32_t width, uint32_t height) {
    Node node{};
    const VkResult result = make_node(wanted, width, height, node);
    EXPECT_EQ(node.pipeline, VkPipeline{VK_NULL_HANDLE});
    destroy(node);
    return result < 0;
  };
  EXPECT_TRUE(refused({.grid = 3}, 64, 64));
  EXPECT_TRUE(refused({.grid = 16}, 64, 64));
  EXPECT_TRUE(refused({}, 0, 64));
  EXPECT_TRUE(refused({}, 64, 1u << 20));
  EXPECT_EQ(client.other_messages, 4u);
}

}  // namespace
}  // namespace shale
