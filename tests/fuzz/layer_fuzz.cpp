// Modules of any content given to vkCreateDataGraphPipelinesARM of the layer, through the loader: refused with an
// error, or a pipeline. Nothing is dispatched.
#include <cstdlib>
#include <cstring>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/formats.h"
#include "tests/layer/client.h"

namespace {

Client client;

VkTensorDescriptionARM description_of(const shale::TensorType& type) {
  VkTensorDescriptionARM description{};
  description.sType = VK_STRUCTURE_TYPE_TENSOR_DESCRIPTION_ARM;
  description.tiling = VK_TENSOR_TILING_LINEAR_ARM;
  description.format = static_cast<VkFormat>(shale::vk_format_of_dtype(type.dtype));
  description.dimensionCount = static_cast<uint32_t>(type.shape.size());
  description.pDimensions = type.shape.data();
  description.usage = VK_TENSOR_USAGE_DATA_GRAPH_BIT_ARM;
  return description;
}

/// The first entry point, or nothing: then names and tensors are made up.
shale::SpirvEntryPoint entry_of(std::span<const uint8_t> module) {
  auto entries = shale::list_spirv_entry_points(module);
  return entries ? std::move(entries->front()) : shale::SpirvEntryPoint{};
}

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  setenv("VK_LAYER_PATH", SHALE_LAYER_FOLDER, 1);
  setenv("VK_INSTANCE_LAYERS", "VK_LAYER_SHALE_data_graph", 1);
  setenv("SHALE_LAYER_CACHE", "off", 1);
  setenv("SHALE_LAYER_OPTIONS", "expected-runs=1",
         1);  // kernels of little code: more modules a second
  if (client_open(&client, nullptr) != VK_SUCCESS) std::abort();
  return 0;
}

/// lavapipe 22.3 leaks 48 bytes of its own with some compute pipelines.
extern "C" const char* __lsan_default_suppressions() { return "leak:libvulkan_lvp.so\n"; }

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  shale::SpirvEntryPoint entry = entry_of({data, size});
  std::vector<shale::TensorType> types, constant_types = entry.constant_types;
  uint32_t binding = 0;
  for (auto* slots : {&entry.inputs, &entry.outputs})
    for (const shale::SpirvEntryPoint::Slot& slot : *slots) {
      if (slot.set != 0 || slot.binding != binding++)
        return 0;  // the client's descriptors are 0, 1, ..
      types.push_back(slot.type);
      for (int64_t& axis : types.back().shape)
        if (axis == shale::kDynamic) axis = 4;
    }
  std::vector<VkTensorDescriptionARM> descriptions;
  for (const shale::TensorType& type : types) descriptions.push_back(description_of(type));
  std::vector<const VkTensorDescriptionARM*> pointers;
  for (const VkTensorDescriptionARM& description : descriptions) pointers.push_back(&description);
  std::vector<VkTensorDescriptionARM> constant_descriptions;
  std::vector<std::vector<uint8_t>> bytes;
  int64_t total = 0;
  for (shale::TensorType& type : constant_types) {
    for (int64_t& axis : type.shape)
      if (axis == shale::kDynamic) axis = 4;
    const auto count = shale::element_count(type.shape);
    total += count ? *count * shale::dtype_info(type.dtype).host_bytes : 1 << 21;
    if (total > 1 << 20) return 0;
    bytes.push_back(shale::Tensor::zeros(type).bytes);
    for (size_t i = 0; i < bytes.back().size(); i += 3) bytes.back()[i] = 1;
  }
  for (const shale::TensorType& type : constant_types)
    constant_descriptions.push_back(description_of(type));
  std::vector<ClientConstant> constants;
  for (size_t i = 0; i < bytes.size(); ++i)
    constants.push_back({entry.constant_ids[i], &constant_descriptions[i], bytes[i].data()});
  std::vector<uint32_t> words(size / 4);
  if (!words.empty()) std::memcpy(words.data(), data, 4 * words.size());
  // Only what the layer takes as a graph: other modules are the driver's.
  if (words.size() < 7 || words[5] >> 16 != 2) return 0;
  words[5] = 2u << 16 | 17;
  words[6] = 4191;
  ClientGraphInfo info{};
  info.words = words.data();
  info.word_count = words.size();
  info.entry_point = entry.name.empty() ? "main" : entry.name.c_str();
  info.tensor_count = static_cast<uint32_t>(pointers.size());
  info.descriptions = pointers.data();
  info.constant_count = static_cast<uint32_t>(constants.size());
  info.constants = constants.data();
  info.flags = VK_PIPELINE_CREATE_DISABLE_OPTIMIZATION_BIT;
  ClientGraph graph;
  if (client_create_graph(&client, &info, &graph) == VK_SUCCESS)
    client_destroy_graph(&client, &graph);
  // lavapipe frees destroyed pipelines with the next submission.
  VkSubmitInfo nothing{};
  nothing.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO;
  vkQueueSubmit(client.queue, 1, &nothing, VK_NULL_HANDLE);
  vkQueueWaitIdle(client.queue);
  return 0;
}
