#include "tools/scene/renderer.h"

#include <algorithm>
#include <cstring>

#include "compiler/spirv/check.h"
#include "compiler/spirv/glsl.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/handle.h"
#include "runtime/vk/memory.h"
#include "tools/scene/trace_embedded.h"

namespace shale {
namespace {

constexpr uint32_t kGroup = 8;               ///< pixels along a side of a workgroup
constexpr uint32_t kPixelFloats = 6;         ///< of a pixel in the output buffer
constexpr uint64_t kBandSamples = 1u << 20;  ///< a submission takes a fraction of a second on a CPU

struct Push {
  float jitter[2];
  float scale[2];
  int32_t origin[2];
  int32_t extent[2];
  int32_t first_row;
  int32_t end_row;
  int32_t samples;
};

/// A texel buffer that grows as frames need it.
class TexelBuffer {
 public:
  TexelBuffer(VkFormat format, uint32_t texel_bytes) : format_(format), texel_bytes_(texel_bytes) {}

  Result<void> set(const vk::Context& context, const void* data, size_t texels) {
    const uint64_t bytes = std::max<uint64_t>(texels, 1) * texel_bytes_;
    if (bytes > buffer_.size_bytes()) {
      const uint64_t limit = uint64_t{context.limits.maxTexelBufferElements} * texel_bytes_;
      view_ = {};
      SHALE_TRY(buffer_, vk::Buffer::create(context, std::min(bytes + bytes / 2, limit),
                                            VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT,
                                            vk::MemoryKind::kUpload));
      auto info = vk::init<VkBufferViewCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_VIEW_CREATE_INFO);
      info.buffer = buffer_.get();
      info.format = format_;
      info.range = VK_WHOLE_SIZE;
      SHALE_TRY(view_, vk::make(context.vk.CreateBufferView, context.vk.DestroyBufferView,
                                "vkCreateBufferView", context.device, info));
    }
    if (texels > 0) std::memcpy(buffer_.mapped().data(), data, texels * texel_bytes_);
    return {};
  }
  VkBufferView view() const { return view_.get(); }

 private:
  VkFormat format_;
  uint32_t texel_bytes_;
  vk::Buffer buffer_;
  vk::BufferViewHandle view_;
};

}  // namespace

class SceneRenderer::Impl {
 public:
  explicit Impl(const vk::Context& context) : context_(context) {}

  Result<void> make(const Scene& scene, VkPipelineCache cache) {
    SHALE_TRY_VOID(make_layout());
    SHALE_TRY_VOID(make_pipeline(scene, cache));
    SHALE_TRY(block_,
              vk::Buffer::create(context_, sizeof(FrameBlock), VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT,
                                 vk::MemoryKind::kUpload));
    return {};
  }

  Result<void> set_frame(const FrameTables& tables) {
    std::memcpy(block_.mapped().data(), &tables.block, sizeof(FrameBlock));
    SHALE_TRY_VOID(texels_.set(context_, tables.texels.data(), tables.texels.size()));
    return lists_.set(context_, tables.lists.data(), tables.lists.size());
  }

  Result<RenderedImages> render(const SampleGrid& grid, const std::function<bool()>& keep_going) {
    const uint32_t width = grid.extent.width, height = grid.extent.height;
    const uint64_t row_samples = uint64_t{width} * grid.samples * grid.samples;
    const uint32_t band = static_cast<uint32_t>(
        std::clamp<uint64_t>(kBandSamples / row_samples / kGroup * kGroup, kGroup,
                             (height + kGroup - 1) / kGroup * kGroup));
    const uint64_t band_bytes = uint64_t{width} * band * kPixelFloats * sizeof(float);
    if (band_bytes > context_.limits.maxStorageBufferRange)
      return device_error(context_.caps.name, "cannot bind {} bytes of rows", band_bytes);
    if (band_bytes > out_.size_bytes()) {
      SHALE_TRY(out_, vk::Buffer::create(context_, band_bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT,
                                         vk::MemoryKind::kReadback));
    }
    write_set();
    RenderedImages images{image(grid.extent, 3), image(grid.extent, 1), image(grid.extent, 2)};
    for (uint32_t row = 0; row < height; row += band) {
      if (keep_going && !keep_going()) return bad_input("", "interrupted");
      const uint32_t end = std::min(row + band, height);
      const Push push{{grid.jitter[0], grid.jitter[1]},
                      {static_cast<float>(grid.scale_x), static_cast<float>(grid.scale_y)},
                      {static_cast<int32_t>(grid.origin_x), static_cast<int32_t>(grid.origin_y)},
                      {static_cast<int32_t>(width), static_cast<int32_t>(height)},
                      static_cast<int32_t>(row),
                      static_cast<int32_t>(end),
                      static_cast<int32_t>(grid.samples)};
      SHALE_TRY_VOID(vk::submit_and_wait(context_, [&](VkCommandBuffer commands) {
        context_.vk.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_.get());
        context_.vk.CmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout_.get(),
                                          0, 1, &set_, 0, nullptr);
        context_.vk.CmdPushConstants(commands, layout_.get(), VK_SHADER_STAGE_COMPUTE_BIT, 0,
                                     sizeof(push), &push);
        context_.vk.CmdDispatch(commands, (width + kGroup - 1) / kGroup,
                                (end - row + kGroup - 1) / kGroup, 1);
        vk::memory_barrier(context_, commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                           VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                           VK_ACCESS_HOST_READ_BIT);
      }));
      take(images, row, end);
    }
    return images;
  }

  uint32_t max_texels() const { return context_.limits.maxTexelBufferElements; }

 private:
  static FloatImage image(Extent extent, uint32_t channels) {
    return {extent.width, extent.height, channels,
            std::vector<float>(size_t{extent.width} * extent.height * channels)};
  }

  void take(RenderedImages& images, uint32_t row, uint32_t end) const {
    const size_t first = size_t{row} * images.color.width;
    const size_t count = size_t{end - row} * images.color.width;
    std::vector<float> pixel(kPixelFloats);
    const uint8_t* from = out_.mapped().data();
    for (size_t i = first; i < first + count; ++i, from += kPixelFloats * sizeof(float)) {
      std::memcpy(pixel.data(), from, kPixelFloats * sizeof(float));
      for (size_t c = 0; c < 3; ++c) images.color.values[3 * i + c] = pixel[c];
      images.depth.values[i] = pixel[3];
      images.motion.values[2 * i] = pixel[4];
      images.motion.values[2 * i + 1] = pixel[5];
    }
  }

  Result<void> make_layout() {
    constexpr std::array<VkDescriptorType, 4> kTypes{
        VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER,
        VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER};
    std::array<VkDescriptorSetLayoutBinding, 4> bindings{};
    std::array<VkDescriptorPoolSize, 4> sizes{};
    for (uint32_t i = 0; i < kTypes.size(); ++i) {
      bindings[i] = {i, kTypes[i], 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
      sizes[i] = {kTypes[i], 1};
    }
    auto set_info = vk::init<VkDescriptorSetLayoutCreateInfo>(
        VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
    set_info.bindingCount = static_cast<uint32_t>(bindings.size());
    set_info.pBindings = bindings.data();
    SHALE_TRY(set_layout_, vk::make(context_.vk.CreateDescriptorSetLayout,
                                    context_.vk.DestroyDescriptorSetLayout,
                                    "vkCreateDescriptorSetLayout", context_.device, set_info));
    const VkDescriptorSetLayout set_layout = set_layout_.get();
    const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof(Push)};
    auto info = vk::init<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
    info.setLayoutCount = 1;
    info.pSetLayouts = &set_layout;
    info.pushConstantRangeCount = 1;
    info.pPushConstantRanges = &range;
    SHALE_TRY(layout_, vk::make(context_.vk.CreatePipelineLayout, context_.vk.DestroyPipelineLayout,
                                "vkCreatePipelineLayout", context_.device, info));
    auto pool_info =
        vk::init<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
    pool_info.maxSets = 1;
    pool_info.poolSizeCount = static_cast<uint32_t>(sizes.size());
    pool_info.pPoolSizes = sizes.data();
    SHALE_TRY(pool_, vk::make(context_.vk.CreateDescriptorPool, context_.vk.DestroyDescriptorPool,
                              "vkCreateDescriptorPool", context_.device, pool_info));
    auto allocate =
        vk::init<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
    allocate.descriptorPool = pool_.get();
    allocate.descriptorSetCount = 1;
    allocate.pSetLayouts = &set_layout;
    return vk::check(context_.vk.AllocateDescriptorSets(context_.device, &allocate, &set_),
                     "vkAllocateDescriptorSets");
  }

  Result<void> make_pipeline(const Scene& scene, VkPipelineCache cache) {
    // What the scene lacks is cut off the shader; the order is that of its constants.
    uint32_t patterns = 0, cutouts = 0;
    for (const Material& m : scene.materials) {
      patterns |= 1u << static_cast<uint32_t>(m.pattern);
      cutouts |= 1u << static_cast<uint32_t>(m.cutout);
    }
    const bool round_cutouts =
        std::any_of(scene.primitives.begin(), scene.primitives.end(), [&](const Primitive& p) {
          return scene.materials[p.material].cutout != CutoutKind::kNone &&
                 (p.shape == PrimitiveShape::kSphere || p.shape == PrimitiveShape::kCylinder);
        });
    uint32_t shadows = 0, areas = 0, cones = 0;
    for (uint32_t i = 0; i < scene.lights.size(); ++i) {
      const Light& light = scene.lights[i];
      shadows |= (light.casts_shadow ? 1u : 0u) << i;
      areas |= (light.size_x > 0 ? 1u : 0u) << i;
      cones |= (light.cone_outer > 0 ? 1u : 0u) << i;
    }
    const auto any_material = [&](const auto& has) {
      return std::any_of(scene.materials.begin(), scene.materials.end(), has);
    };
    const std::array<uint32_t, 13> features{
        patterns,
        cutouts,
        round_cutouts,
        !scene.emitters.empty(),
        static_cast<uint32_t>(scene.overlays.size()),
        static_cast<uint32_t>(scene.lights.size()),
        scene.sky.clouds > 0 || scene.sky.stars > 0,
        shadows,
        areas,
        cones,
        any_material([](const Material& m) { return m.signal != kSteady; }),
        any_material(
            [](const Material& m) { return m.scroll_x != 0 || m.scroll_y != 0 || m.change > 0; }),
        scene.sky.harmonics.has_value()};
    std::array<VkSpecializationMapEntry, features.size()> entries{};
    for (uint32_t i = 0; i < entries.size(); ++i)
      entries[i] = {i, i * static_cast<uint32_t>(sizeof(uint32_t)), sizeof(uint32_t)};
    const VkSpecializationInfo specialization{static_cast<uint32_t>(entries.size()), entries.data(),
                                              sizeof(features), features.data()};
    SHALE_TRY(const Spirv plain,
              compile_glsl(embedded_scene::kEmbeddedFiles[0].text, {}, "scene/trace.comp"));
    SHALE_TRY(const Spirv words, optimize_spirv(plain, "scene/trace.comp"));
    auto module_info =
        vk::init<VkShaderModuleCreateInfo>(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
    module_info.codeSize = words.size() * sizeof(uint32_t);
    module_info.pCode = words.data();
    SHALE_TRY(const vk::ShaderModuleHandle module,
              vk::make(context_.vk.CreateShaderModule, context_.vk.DestroyShaderModule,
                       "vkCreateShaderModule", context_.device, module_info));
    auto info =
        vk::init<VkComputePipelineCreateInfo>(VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO);
    info.stage = vk::init<VkPipelineShaderStageCreateInfo>(
        VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO);
    info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
    info.stage.module = module.get();
    info.stage.pName = "main";
    info.stage.pSpecializationInfo = &specialization;
    info.layout = layout_.get();
    VkPipeline pipeline = VK_NULL_HANDLE;
    SHALE_TRY_VOID(vk::check(
        context_.vk.CreateComputePipelines(context_.device, cache, 1, &info, nullptr, &pipeline),
        "vkCreateComputePipelines"));
    pipeline_ = vk::PipelineHandle(context_.device, pipeline, context_.vk.DestroyPipeline);
    return {};
  }

  void write_set() {
    const VkDescriptorBufferInfo block{block_.get(), 0, VK_WHOLE_SIZE};
    const VkDescriptorBufferInfo out{out_.get(), 0, VK_WHOLE_SIZE};
    const std::array<VkBufferView, 2> views{texels_.view(), lists_.view()};
    std::array<VkWriteDescriptorSet, 4> writes{};
    for (uint32_t i = 0; i < writes.size(); ++i) {
      writes[i] = vk::init<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
      writes[i].dstSet = set_;
      writes[i].dstBinding = i;
      writes[i].descriptorCount = 1;
    }
    writes[0].descriptorType = VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER;
    writes[0].pBufferInfo = &block;
    for (size_t i = 0; i < 2; ++i) {
      writes[1 + i].descriptorType = VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER;
      writes[1 + i].pTexelBufferView = &views[i];
    }
    writes[3].descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    writes[3].pBufferInfo = &out;
    context_.vk.UpdateDescriptorSets(context_.device, static_cast<uint32_t>(writes.size()),
                                     writes.data(), 0, nullptr);
  }

  const vk::Context context_;
  vk::SetLayoutHandle set_layout_;
  vk::PipelineLayoutHandle layout_;
  vk::PipelineHandle pipeline_;
  vk::DescriptorPoolHandle pool_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;  // freed with its pool
  vk::Buffer block_, out_;
  TexelBuffer texels_{VK_FORMAT_R32G32B32A32_SFLOAT, sizeof(Float4)};
  TexelBuffer lists_{VK_FORMAT_R32G32_UINT, sizeof(Uint2)};
};

SceneRenderer::SceneRenderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SceneRenderer::~SceneRenderer() = default;

Result<std::unique_ptr<SceneRenderer>> SceneRenderer::create(const vk::Context& context,
                                                             const Scene& scene,
                                                             VkPipelineCache cache) {
  auto impl = std::make_unique<Impl>(context);
  SHALE_TRY_VOID(impl->make(scene, cache));
  return std::unique_ptr<SceneRenderer>(new SceneRenderer(std::move(impl)));
}

Result<void> SceneRenderer::set_frame(const FrameTables& tables) {
  return impl_->set_frame(tables);
}

Result<RenderedImages> SceneRenderer::render(const SampleGrid& grid,
                                             const std::function<bool()>& keep_going) {
  return impl_->render(grid, keep_going);
}

uint32_t SceneRenderer::max_texels() const { return impl_->max_texels(); }

}  // namespace shale
