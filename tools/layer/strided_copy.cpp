#include "tools/layer/strided_copy.h"

#include <fmt/ranges.h>

#include "runtime/datagraph/late_pipelines.h"
#include "tools/layer/tensor_shader.h"

namespace shale::layer {
namespace {

constexpr uint32_t kGroup = 64, kMostGroups = 65535;

/// An element per invocation, the row of invocations as long as the device allows.
constexpr const char* kSource = R"(
#version 450
#extension GL_EXT_shader_8bit_storage : require
#extension GL_EXT_shader_16bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types : require
layout(local_size_x = 64) in;
#ifdef PACKED_LOW
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_buffer_reference_uvec2 : require
layout(std430, set = SET, binding = BINDING) buffer Strided { ELEMENT strided[]; } tensor[AT + 1];
layout(std430, buffer_reference, buffer_reference_align = 8) buffer Packed { ELEMENT packed[]; };
#define STRIDED(place) tensor[AT].strided[place]
Packed elements() {
  uvec2 place = uvec2(PACKED_LOW, PACKED_HIGH);  // no constant: glslang 12 dies of those
  return Packed(place);
}
#define PACKED(at) elements().packed[at]
#else
layout(std430, set = 0, binding = 0) buffer Strided { ELEMENT strided[]; };
layout(std430, set = 0, binding = 1) buffer Packed { ELEMENT packed[]; };
#define STRIDED(place) strided[place]
#define PACKED(at) packed[at]
#endif
const uint kSizes[] = { SIZES };
const uint kSteps[] = { STEPS };
void main() {
  const uint at = gl_GlobalInvocationID.y * ROW + gl_GlobalInvocationID.x;
  if (at >= COUNT) return;
  uint rest = at, place = 0;
  for (int axis = RANK - 1; axis >= 0; --axis) {
    place += rest % kSizes[axis] * kSteps[axis];
    rest /= kSizes[axis];
  }
#if UNPACKS
  STRIDED(place) = PACKED(at);
#else
  PACKED(at) = STRIDED(place);
#endif
}
)";

const char* element_type(uint32_t bytes) {
  switch (bytes) {
    case 1: return "uint8_t";
    case 2: return "uint16_t";
    case 4: return "uint";
    default: return "uvec2";
  }
}

}  // namespace

Result<Spirv> StridedCopy::compile(const TensorLayout& layout, bool unpacks, Defines places) {
  const uint32_t bytes = tensor_element_bytes(layout.format);
  std::vector<std::string> sizes, steps;
  for (size_t i = 0; i < layout.dims.size(); ++i) {
    sizes.push_back(fmt::format("{}u", layout.dims[i]));
    steps.push_back(fmt::format("{}u", layout.strides[i] / bytes));
  }
  const uint64_t groups = (layout.elements() + kGroup - 1) / kGroup;
  const auto x = static_cast<uint32_t>(std::min<uint64_t>(groups, kMostGroups));
  groups_ = {x, static_cast<uint32_t>((groups + x - 1) / x)};
  const Defines common{{"ELEMENT", element_type(bytes)},
                       {"SIZES", fmt::format("{}", fmt::join(sizes, ","))},
                       {"STEPS", fmt::format("{}", fmt::join(steps, ","))},
                       {"RANK", std::to_string(layout.dims.size())},
                       {"COUNT", fmt::format("{}u", layout.elements())},
                       {"ROW", fmt::format("{}u", x * kGroup)},
                       {"UNPACKS", unpacks ? "1" : "0"}};
  places.insert(places.end(), common.begin(), common.end());
  return compile_glsl(kSource, places, "strided copy");
}

Result<StridedCopy> StridedCopy::create(const vk::Context& context, const TensorLayout& layout,
                                        bool unpacks, const InBuffer& place) {
  const Defines places{
      {"SET", std::to_string(place.set)},
      {"BINDING", std::to_string(place.binding)},
      {"AT", std::to_string(kBuffersOfTensor * place.element)},
      {"PACKED_LOW", fmt::format("{}u", place.packed & 0xffffffffu)},
      {"PACKED_HIGH", fmt::format("{}u", place.packed >> 32)},
  };
  StridedCopy copy;
  SHALE_TRY(const Spirv words, copy.compile(layout, unpacks, places));
  SHALE_TRY(copy.pipeline_, create_pipeline(context, words, place.layout, VK_NULL_HANDLE,
                                            VK_PIPELINE_CREATE_DESCRIPTOR_BUFFER_BIT_EXT));
  return copy;
}

Result<StridedCopy> StridedCopy::create(const vk::Context& context, const TensorLayout& layout,
                                        bool unpacks, VkPipelineCache cache) {
  StridedCopy copy;
  SHALE_TRY(const Spirv words, copy.compile(layout, unpacks, {}));
  const VkDescriptorSetLayoutBinding bindings[] = {
      {0, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr},
      {1, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr}};
  const VkDescriptorBindingFlags flags[] = {VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT,
                                            VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT};
  auto flag_info = vk::init<VkDescriptorSetLayoutBindingFlagsCreateInfo>(
      VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_BINDING_FLAGS_CREATE_INFO);
  flag_info.bindingCount = 2;
  flag_info.pBindingFlags = flags;
  auto set_info = vk::init<VkDescriptorSetLayoutCreateInfo>(
      VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  set_info.pNext = &flag_info;
  set_info.flags = VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT;
  set_info.bindingCount = 2;
  set_info.pBindings = bindings;
  SHALE_TRY(copy.set_layout_,
            vk::make(context.vk.CreateDescriptorSetLayout, context.vk.DestroyDescriptorSetLayout,
                     "vkCreateDescriptorSetLayout", context.device, set_info));
  const VkDescriptorSetLayout set_layout = copy.set_layout_.get();
  auto layout_info =
      vk::init<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  layout_info.setLayoutCount = 1;
  layout_info.pSetLayouts = &set_layout;
  SHALE_TRY(copy.layout_,
            vk::make(context.vk.CreatePipelineLayout, context.vk.DestroyPipelineLayout,
                     "vkCreatePipelineLayout", context.device, layout_info));
  SHALE_TRY(copy.pipeline_, create_pipeline(context, words, copy.layout_.get(), cache));
  return copy;
}

Result<StridedCopy::Recorded> StridedCopy::record(const vk::Context& context,
                                                  VkCommandBuffer commands) const {
  Recorded recorded;
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 2};
  auto pool_info =
      vk::init<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  pool_info.flags = VK_DESCRIPTOR_POOL_CREATE_UPDATE_AFTER_BIND_BIT;
  pool_info.maxSets = 1;
  pool_info.poolSizeCount = 1;
  pool_info.pPoolSizes = &size;
  SHALE_TRY(recorded.pool_,
            vk::make(context.vk.CreateDescriptorPool, context.vk.DestroyDescriptorPool,
                     "vkCreateDescriptorPool", context.device, pool_info));
  const VkDescriptorSetLayout set_layout = set_layout_.get();
  auto allocate =
      vk::init<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  allocate.descriptorPool = recorded.pool_.get();
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &set_layout;
  SHALE_TRY_VOID(
      vk::check(context.vk.AllocateDescriptorSets(context.device, &allocate, &recorded.set_),
                "vkAllocateDescriptorSets"));
  context.vk.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_.get());
  context.vk.CmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout_.get(), 0, 1,
                                   &recorded.set_, 0, nullptr);
  context.vk.CmdDispatch(commands, groups_[0], groups_[1], 1);
  return recorded;
}

void StridedCopy::record_bound(const vk::Context& context, VkCommandBuffer commands) const {
  context.vk.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_.get());
  context.vk.CmdDispatch(commands, groups_[0], groups_[1], 1);
}

void StridedCopy::Recorded::bind(const vk::Context& context, VkBuffer tensor,
                                 VkBuffer packed) const {
  const VkDescriptorBufferInfo buffers[] = {{tensor, 0, VK_WHOLE_SIZE}, {packed, 0, VK_WHOLE_SIZE}};
  auto write = vk::init<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
  write.dstSet = set_;
  write.descriptorCount = 2;  // over both bindings
  write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  write.pBufferInfo = buffers;
  context.vk.UpdateDescriptorSets(context.device, 1, &write, 0, nullptr);
}

}  // namespace shale::layer
