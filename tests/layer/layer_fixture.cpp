#include "tests/layer/layer_fixture.h"

#include <cstdlib>
#include <cstring>

#include "compiler/frontend/vgf/formats.h"
#include "tests/compiler/spirv_text.h"

namespace shale {
namespace {

/// Bytes from one index of an axis to the next, with `padding` elements behind each row.
std::vector<int64_t> strides_of(const TensorType& type, int64_t padding) {
  std::vector<int64_t> strides(type.shape.size());
  int64_t next = dtype_info(type.dtype).host_bytes;
  for (size_t i = strides.size(); i-- > 0;) {
    strides[i] = next;
    next *= type.shape[i];
    if (i + 1 == strides.size()) next += padding * dtype_info(type.dtype).host_bytes;
  }
  return strides;
}

/// Calls copy(bytes of a row in packed data, in the tensor) for each row.
template <typename Copy>
void for_each_row(const TensorType& type, const std::vector<int64_t>& strides, const Copy& copy) {
  const int64_t row = type.shape.back() * dtype_info(type.dtype).host_bytes;
  const int64_t rows = *element_count(type.shape) / type.shape.back();
  for (int64_t i = 0; i < rows; ++i) {
    int64_t rest = i, at = 0;
    for (size_t axis = type.shape.size() - 1; axis-- > 0;) {
      at += rest % type.shape[axis] * strides[axis];
      rest /= type.shape[axis];
    }
    copy(i * row, at, row);
  }
}

/// Tensors of the API have an axis at least; a scalar has one of size 1.
TensorType api_type(TensorType type) {
  if (type.shape.empty()) type.shape = {1};
  if (type.dtype == DType::kInt4) type.dtype = DType::kInt8;
  return type;
}

}  // namespace

void ClientRun::destroy() {
  if (!client_) return;
  for (ClientTensor& tensor : tensors) client_destroy_tensor(client_, &tensor);
  tensors.clear();
  client_destroy_graph(client_, &graph);
  client_ = nullptr;
}

VkResult ClientRun::create(const Client& client, const Graph& source, const GraphOptions& options) {
  const auto module = write_spirv_graph(source, {.external_constants = options.external_constants});
  EXPECT_TRUE(module) << module.error().text();
  return module ? create(client, source, *module, options) : VK_ERROR_UNKNOWN;
}

VkResult ClientRun::create(const Client& client, const Graph& source,
                           const SpirvGraphModule& module, const GraphOptions& options) {
  client_ = &client;
  input_count_ = source.inputs.size();
  for (const auto* ids : {&source.inputs, &source.outputs})
    for (const ValueId id : *ids) types_.push_back(api_type(source.value(id).type));
  std::vector<const VkTensorDescriptionARM*> descriptions;
  tensors.reserve(types_.size());
  for (const TensorType& type : types_) {
    const std::vector<int64_t> strides = strides_of(type, options.padding);
    ClientTensor tensor;
    const VkResult result = client_create_tensor(
        client_, static_cast<VkFormat>(vk_format_of_dtype(type.dtype)), options.tiling,
        static_cast<uint32_t>(type.shape.size()), type.shape.data(),
        options.padding > 0 || options.strides ? strides.data() : nullptr, &tensor);
    if (result != VK_SUCCESS) return result;
    ClientTensor& kept = tensors.emplace_back(tensor);
    kept.description.pDimensions = kept.dims;
    if (kept.description.pStrides) kept.description.pStrides = kept.strides;
    descriptions.push_back(&kept.description);
  }
  std::vector<TensorType> constant_types;
  std::vector<VkTensorDescriptionARM> constant_descriptions;
  for (const Tensor& constant : module.constants) constant_types.push_back(api_type(constant.type));
  for (const TensorType& type : constant_types) {
    VkTensorDescriptionARM& description = constant_descriptions.emplace_back();
    description.sType = VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM;
    description.tiling = VK_TENSOR_TILING_LINEAR_ARM;
    description.format = static_cast<VkFormat>(vk_format_of_dtype(type.dtype));
    description.dimensionCount = static_cast<uint32_t>(type.shape.size());
    description.pDimensions = type.shape.data();
    description.usage = VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM;
  }
  auto sparsity = VkDataGraphPipelineConstantTensorSemiStructuredSparsityInfoARM{};
  sparsity.sType =
      VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_CONSTANT_TENSOR_SEMI_STRUCTURED_SPARSITY_INFO_ARM;
  sparsity.zeroCount = 2;
  sparsity.groupSize = 4;
  for (VkTensorDescriptionARM& description : constant_descriptions) {
    if (!options.sparse || description.pDimensions[description.dimensionCount - 1] % 4 != 0)
      continue;
    sparsity.dimension = description.dimensionCount - 1;
    description.pNext = &sparsity;
    break;
  }
  std::vector<ClientConstant> constants;
  for (uint32_t i = 0; i < module.constants.size(); ++i)
    constants.push_back({i, &constant_descriptions[i], module.constants[i].bytes.data()});
  // The last tensor comes first: 2n, 2n - 2, .., 2.
  std::vector<uint32_t> words = module.words, bindings;
  for (size_t i = 0; i < types_.size(); ++i)
    bindings.push_back(static_cast<uint32_t>(options.unordered ? 2 * (types_.size() - i) : i));
  constexpr uint32_t kDecorate = 71, kBinding = 33;
  for (size_t at = 5; at < words.size(); at += std::max(words[at] >> 16, 1u))
    if ((words[at] & 0xffff) == kDecorate && words[at + 2] == kBinding &&
        words[at + 3] < bindings.size())
      words[at + 3] = bindings[words[at + 3]];
  ClientGraphInfo info{};
  info.words = words.data();
  info.word_count = words.size();
  info.chained = options.chained;
  info.bindings = bindings.data();
  info.entry_point = module.entry_point.c_str();
  info.tensor_count = static_cast<uint32_t>(descriptions.size());
  info.descriptions = descriptions.data();
  info.constant_count = static_cast<uint32_t>(constants.size());
  info.constants = constants.data();
  info.flags = options.flags;
  info.cache = options.cache;
  info.set_flags = options.set_flags;
  info.next = options.next;
  const VkResult result = client_create_graph(client_, &info, &graph);
  if (result != VK_SUCCESS) return result;
  if (!graph.set) return VK_SUCCESS;
  std::vector<VkTensorViewARM> views;
  for (const ClientTensor& tensor : tensors) views.push_back(tensor.view);
  client_write_bindings(client_, &graph, static_cast<uint32_t>(views.size()), bindings.data(),
                        views.data());
  return VK_SUCCESS;
}

void ClientRun::write(const std::vector<Tensor>& inputs) {
  ASSERT_EQ(inputs.size(), input_count_);
  for (size_t i = 0; i < inputs.size(); ++i) {
    const ClientTensor& tensor = tensors[i];
    auto* mapped = static_cast<uint8_t*>(tensor.mapped);
    if (!tensor.description.pStrides) {
      std::memcpy(mapped, inputs[i].bytes.data(), inputs[i].bytes.size());
      continue;
    }
    for_each_row(types_[i], {tensor.strides, tensor.strides + types_[i].shape.size()},
                 [&](int64_t packed, int64_t at, int64_t bytes) {
                   std::memcpy(mapped + at, &inputs[i].bytes[static_cast<size_t>(packed)],
                               static_cast<size_t>(bytes));
                 });
  }
}

VkResult ClientRun::submit() {
  return client_submit(
      client_,
      [](VkCommandBuffer commands, void* self) {
        const auto* run = static_cast<const ClientRun*>(self);
        client_record_graph(run->client_, commands, &run->graph);
      },
      this);
}

std::vector<Tensor> ClientRun::read() const {
  std::vector<Tensor> outputs;
  for (size_t i = input_count_; i < tensors.size(); ++i) {
    const ClientTensor& tensor = tensors[i];
    const auto* mapped = static_cast<const uint8_t*>(tensor.mapped);
    Tensor output = Tensor::zeros(types_[i]);
    if (!tensor.description.pStrides)
      std::memcpy(output.bytes.data(), mapped, output.bytes.size());
    else
      for_each_row(types_[i], {tensor.strides, tensor.strides + types_[i].shape.size()},
                   [&](int64_t packed, int64_t at, int64_t bytes) {
                     std::memcpy(&output.bytes[static_cast<size_t>(packed)], mapped + at,
                                 static_cast<size_t>(bytes));
                   });
    outputs.push_back(std::move(output));
  }
  return outputs;
}

std::vector<Tensor> ClientRun::run(const std::vector<Tensor>& inputs) {
  write(inputs);
  EXPECT_EQ(submit(), VK_SUCCESS) << client_->last_message;
  return read();
}

bool validated() { return std::getenv("SHALE_VALIDATED") != nullptr; }

void LayerTest::SetUp() {
  const VkResult result = client_open(&client, nullptr);
  if (result == VK_ERROR_INCOMPATIBLE_DRIVER) GTEST_SKIP() << "there is no Vulkan device";
  ASSERT_EQ(result, VK_SUCCESS);
  is_open = true;
}

void LayerTest::TearDown() {
  if (!is_open) return;
  EXPECT_EQ(client.validation_messages, 0u) << client.last_message;
  for (const HostBuffer& host : buffers_) {
    vkDestroyBuffer(client.device, host.buffer, nullptr);
    vkFreeMemory(client.device, host.memory, nullptr);
  }
  client_close(&client);
  EXPECT_EQ(client.validation_messages, 0u) << client.last_message;
}

HostBuffer LayerTest::host_buffer(VkDeviceSize bytes, VkBufferUsageFlags usage, const void* next) {
  HostBuffer& host = buffers_.emplace_back();
  VkBufferCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO;
  info.pNext = next;
  info.size = bytes;
  info.usage = usage;
  EXPECT_EQ(vkCreateBuffer(client.device, &info, nullptr, &host.buffer), VK_SUCCESS);
  if (!host.buffer) return host;
  VkMemoryRequirements needs;
  vkGetBufferMemoryRequirements(client.device, host.buffer, &needs);
  VkMemoryAllocateFlagsInfo flags{};
  flags.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO;
  flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
  VkMemoryAllocateInfo memory{};
  memory.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
  if (usage & VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT) memory.pNext = &flags;
  memory.allocationSize = needs.size;
  memory.memoryTypeIndex = client_memory_type(
      &client, needs.memoryTypeBits,
      VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
  EXPECT_EQ(vkAllocateMemory(client.device, &memory, nullptr, &host.memory), VK_SUCCESS);
  if (!host.memory) return host;
  EXPECT_EQ(vkBindBufferMemory(client.device, host.buffer, host.memory, 0), VK_SUCCESS);
  EXPECT_EQ(vkMapMemory(client.device, host.memory, 0, VK_WHOLE_SIZE, 0, &host.mapped), VK_SUCCESS);
  return host;
}

ComputePipeline LayerTest::compute_pipeline(VkDescriptorSetLayout set_layout, const char* text,
                                            VkPipelineCreateFlags flags, bool chained) const {
  ComputePipeline made;
  VkPipelineLayoutCreateInfo layout{};
  layout.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  layout.setLayoutCount = 1;
  layout.pSetLayouts = &set_layout;
  EXPECT_EQ(vkCreatePipelineLayout(client.device, &layout, nullptr, &made.layout), VK_SUCCESS);
  const std::vector<uint32_t> words = assemble_spirv(text);
  VkShaderModuleCreateInfo code{};
  code.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
  code.codeSize = 4 * words.size();
  code.pCode = words.data();
  VkComputePipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  info.flags = flags;
  info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
  info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  info.stage.pName = "main";
  info.layout = made.layout;
  if (chained) {
    info.stage.pNext = &code;
  } else {
    EXPECT_EQ(vkCreateShaderModule(client.device, &code, nullptr, &info.stage.module), VK_SUCCESS)
        << client.last_message;
  }
  EXPECT_EQ(
      vkCreateComputePipelines(client.device, VK_NULL_HANDLE, 1, &info, nullptr, &made.pipeline),
      VK_SUCCESS);
  vkDestroyShaderModule(client.device, info.stage.module, nullptr);
  return made;
}

void LayerTest::destroy(const ComputePipeline& made) const {
  vkDestroyPipeline(client.device, made.pipeline, nullptr);
  vkDestroyPipelineLayout(client.device, made.layout, nullptr);
}

}  // namespace shale
