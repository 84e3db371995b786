#include "tools/layer/descriptors.h"

#include <algorithm>

#include "tools/layer/barriers.h"
#include "tools/layer/chain.h"
#include "tools/layer/tensor_shader.h"

namespace shale::layer {
namespace {

/// The layout as the device below takes it: bindings of tensors are there, for shaders, or empty.
class LayoutBelow {
 public:
  LayoutBelow(const Device& device, const VkDescriptorSetLayoutCreateInfo& info)
      : bindings_(info.pBindings, info.pBindings + info.bindingCount), chain_(info.pNext) {
    info_ = info;
    // Tensors of graphs in descriptor buffers are read by the layer's own shader.
    const VkShaderStageFlags own_stage =
        info.flags & VK_DESCRIPTOR_SET_LAYOUT_CREATE_DESCRIPTOR_BUFFER_BIT_EXT
            ? VK_SHADER_STAGE_COMPUTE_BIT
            : 0;
    for (VkDescriptorSetLayoutBinding& binding : bindings_)
      if (binding.descriptorType == VK_DESCRIPTOR_TYPE_TENSOR_ARM)
        binding = {binding.binding, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
                   device.tensor_buffers ? kBuffersOfTensor * binding.descriptorCount : 0,
                   device.tensor_buffers ? binding.stageFlags | own_stage : 0, nullptr};
    info_.pBindings = bindings_.data();
    info_.pNext = chain_.next();
  }
  const VkDescriptorSetLayoutCreateInfo* get() const { return &info_; }

 private:
  std::vector<VkDescriptorSetLayoutBinding> bindings_;
  ChainCopy chain_;
  VkDescriptorSetLayoutCreateInfo info_;
};

/// Where a write or copy that runs over the end of a binding goes on; true if there is a place.
bool settle(const std::map<uint32_t, std::vector<uint64_t>>& tensors, uint32_t& binding,
            uint32_t& element) {
  auto at = tensors.find(binding);
  while (at != tensors.end() && element >= at->second.size()) {
    element -= static_cast<uint32_t>(at->second.size());
    if (++at != tensors.end()) binding = at->first;
  }
  return at != tensors.end();
}

/// Copies tensor descriptors, or none if that is no copy of such; what is to copy below goes to `below`.
void copy_tensors(Device& device, const VkCopyDescriptorSet& copy,
                  std::vector<VkCopyDescriptorSet>& below) {
  const auto from = device.sets.find(copy.srcSet);
  const auto to = device.sets.find(copy.dstSet);
  if (!from || !to || !from->tensors.contains(copy.srcBinding) ||
      !to->tensors.contains(copy.dstBinding)) {
    below.push_back(copy);
    return;
  }
  VkCopyDescriptorSet one = copy;
  uint32_t from_element = copy.srcArrayElement, to_element = copy.dstArrayElement;
  for (uint32_t i = 0; i < copy.descriptorCount; ++i, ++from_element, ++to_element) {
    if (!settle(from->tensors, one.srcBinding, from_element) ||
        !settle(to->tensors, one.dstBinding, to_element))
      break;
    const uint64_t tensor = from->tensors[one.srcBinding][from_element];
    to->tensors[one.dstBinding][to_element] = tensor;
    if (!device.tensor_buffers || (!tensor && !device.null_descriptors)) continue;
    one.srcArrayElement = kBuffersOfTensor * from_element;
    one.dstArrayElement = kBuffersOfTensor * to_element;
    one.descriptorCount = kBuffersOfTensor;
    below.push_back(one);
  }
}

SetLayout read_set_layout(const VkDescriptorSetLayoutCreateInfo& info) {
  SetLayout layout;
  layout.in_descriptor_buffer =
      info.flags & VK_DESCRIPTOR_SET_LAYOUT_CREATE_DESCRIPTOR_BUFFER_BIT_EXT;
  layout.is_pushed = info.flags & VK_DESCRIPTOR_SET_LAYOUT_CREATE_PUSH_DESCRIPTOR_BIT_KHR;
  const auto* flags = find_in_chain<VkDescriptorSetLayoutBindingFlagsCreateInfo>(
      info.pNext, VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_BINDING_FLAGS_CREATE_INFO);
  for (uint32_t i = 0; i < info.bindingCount; ++i) {
    const VkDescriptorSetLayoutBinding& binding = info.pBindings[i];
    const VkDescriptorBindingFlags own =
        flags && i < flags->bindingCount ? flags->pBindingFlags[i] : 0;
    layout.bindings[binding.binding] = {
        binding.descriptorType, binding.descriptorCount,
        (own & VK_DESCRIPTOR_BINDING_VARIABLE_DESCRIPTOR_COUNT_BIT) != 0, binding.stageFlags};
    if (binding.descriptorType == VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER_DYNAMIC ||
        binding.descriptorType == VK_DESCRIPTOR_TYPE_STORAGE_BUFFER_DYNAMIC)
      layout.has_dynamic = true;
    if (binding.descriptorType != VK_DESCRIPTOR_TYPE_TENSOR_ARM) continue;
    layout.has_tensors = true;
    if (own & VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT) layout.update_after_bind = true;
  }
  return layout;
}

/// As PipelineLayout has it; empty where the device or the layout does not allow it.
vk::PipelineLayoutHandle layout_with_flow(const Device& device,
                                          const VkPipelineLayoutCreateInfo& info,
                                          const PipelineLayout& layout) {
  const auto fits = [](const std::shared_ptr<SetLayout>& set) {
    return set && !set->in_descriptor_buffer && !set->is_pushed && !set->has_dynamic;
  };
  if (!device.optical_flow || info.pushConstantRangeCount > 0 ||
      info.setLayoutCount >= device.physical->limits.maxBoundDescriptorSets ||
      !std::all_of(layout.sets.begin(), layout.sets.end(), fits))
    return {};
  std::vector<VkDescriptorSetLayout> sets(info.pSetLayouts, info.pSetLayouts + info.setLayoutCount);
  sets.push_back(device.flow_set_layout.get());
  VkPipelineLayoutCreateInfo more = info;
  more.setLayoutCount = static_cast<uint32_t>(sets.size());
  more.pSetLayouts = sets.data();
  VkPipelineLayout made = VK_NULL_HANDLE;
  if (device.CreatePipelineLayout(device.handle, &more, nullptr, &made) != VK_SUCCESS) return {};
  return vk::PipelineLayoutHandle(device.handle, made, device.DestroyPipelineLayout);
}

void forget_sets(Device& device, Pool& pool) {
  const std::lock_guard lock(pool.mutex);
  for (const VkDescriptorSet set : pool.sets) device.sets.take(set);
  pool.sets.clear();
}

}  // namespace

uint32_t SetLayout::varying_scale(const Device& device) const {
  for (const auto& [number, binding] : bindings)
    if (binding.varies && binding.type == VK_DESCRIPTOR_TYPE_TENSOR_ARM)
      return device.tensor_buffers ? kBuffersOfTensor : 0;
  return 1;
}

Set::Set(const SetLayout& layout, uint32_t varying) : update_after_bind(layout.update_after_bind) {
  for (const auto& [number, binding] : layout.bindings)
    if (binding.type == VK_DESCRIPTOR_TYPE_TENSOR_ARM)
      tensors[number].resize(binding.varies ? std::min(varying, binding.count) : binding.count);
}

SplitWrites::SplitWrites(const Device& device, std::span<const VkWriteDescriptorSet> writes,
                         const SetOf& set_of) {
  for (const VkWriteDescriptorSet& write : writes) {
    if (write.descriptorType != VK_DESCRIPTOR_TYPE_TENSOR_ARM) {
      below_.push_back(write);
      translate_layouts(below_.back());
      continue;
    }
    const auto* list = find_in_chain<VkWriteDescriptorSetTensorARM>(
        write.pNext, VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM);
    if (!list) continue;
    Set* set = set_of(write);
    uint32_t binding = write.dstBinding, element = write.dstArrayElement;
    const uint32_t count = std::min(write.descriptorCount, list->tensorViewCount);
    for (uint32_t i = 0; i < count && (!set || settle(set->tensors, binding, element));
         ++i, ++element) {
      const VkTensorViewARM view = list->pTensorViews ? list->pTensorViews[i] : VK_NULL_HANDLE;
      const Tensor* tensor = view ? device.tensors_by_id.find(view_of(view)->tensor) : nullptr;
      if (set) set->tensors[binding][element] = tensor ? tensor->id : 0;
      if (!device.tensor_buffers || (!tensor && !device.null_descriptors)) continue;
      constexpr VkDescriptorBufferInfo kNone{VK_NULL_HANDLE, 0, VK_WHOLE_SIZE};
      const auto& buffers = buffers_.emplace_back(
          tensor ? std::vector<VkDescriptorBufferInfo>{{tensor->buffer, 0, VK_WHOLE_SIZE},
                                                       {tensor->shape.buffer, tensor->shape.offset,
                                                        kShapeWords * sizeof(uint32_t)}}
                 : std::vector<VkDescriptorBufferInfo>{kNone, kNone});
      VkWriteDescriptorSet below = write;
      below.pNext = nullptr;
      below.dstBinding = binding;
      below.dstArrayElement = kBuffersOfTensor * element;
      below.descriptorCount = kBuffersOfTensor;
      below.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
      below.pBufferInfo = buffers.data();
      below_.push_back(below);
    }
  }
}

void SplitWrites::translate_layouts(VkWriteDescriptorSet& write) {
  switch (write.descriptorType) {
    case VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER:
    case VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE:
    case VK_DESCRIPTOR_TYPE_STORAGE_IMAGE:
    case VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT: break;
    default: return;
  }
  const std::span<const VkDescriptorImageInfo> images(write.pImageInfo, write.descriptorCount);
  if (std::none_of(images.begin(), images.end(), [](const VkDescriptorImageInfo& image) {
        return image.imageLayout == VK_IMAGE_LAYOUT_TENSOR_ALIASING_ARM;
      }))
    return;
  auto& copy = images_.emplace_back(images.begin(), images.end());
  for (VkDescriptorImageInfo& image : copy) image.imageLayout = layout_below(image.imageLayout);
  write.pImageInfo = copy.data();
}

template <typename T>
const T* TemplateWrites::gather(std::vector<std::vector<T>>& lists,
                                const VkDescriptorUpdateTemplateEntry& entry, const void* data) {
  std::vector<T>& list = lists.emplace_back(entry.descriptorCount);
  for (uint32_t i = 0; i < entry.descriptorCount; ++i)
    std::memcpy(&list[i], static_cast<const char*>(data) + entry.offset + i * entry.stride,
                sizeof(T));
  return list.data();
}

TemplateWrites::TemplateWrites(const UpdateTemplate& update, VkDescriptorSet set,
                               const void* data) {
  for (const VkDescriptorUpdateTemplateEntry& entry : update.entries) {
    if (entry.descriptorCount == 0) continue;
    VkWriteDescriptorSet write{};
    write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write.dstSet = set;
    write.dstBinding = entry.dstBinding;
    write.dstArrayElement = entry.dstArrayElement;
    write.descriptorCount = entry.descriptorCount;
    write.descriptorType = entry.descriptorType;
    switch (static_cast<int>(entry.descriptorType)) {
      case VK_DESCRIPTOR_TYPE_SAMPLER:
      case VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER:
      case VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE:
      case VK_DESCRIPTOR_TYPE_STORAGE_IMAGE:
      case VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT:
        write.pImageInfo = gather(images_, entry, data);
        break;
      case VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER:
      case VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER:
        write.pTexelBufferView = gather(texels_, entry, data);
        break;
      case VK_DESCRIPTOR_TYPE_INLINE_UNIFORM_BLOCK: {
        auto& block =
            inlines_.emplace_back(std::make_unique<VkWriteDescriptorSetInlineUniformBlock>());
        block->sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_INLINE_UNIFORM_BLOCK;
        block->dataSize = entry.descriptorCount;
        block->pData = static_cast<const char*>(data) + entry.offset;
        write.pNext = block.get();
        break;
      }
      case static_cast<int>(VK_DESCRIPTOR_TYPE_TENSOR_ARM): {
        auto& tensor = tensors_.emplace_back(std::make_unique<VkWriteDescriptorSetTensorARM>());
        tensor->sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET_TENSOR_ARM;
        tensor->tensorViewCount = entry.descriptorCount;
        tensor->pTensorViews = gather(views_, entry, data);
        write.pNext = tensor.get();
        break;
      }
      default: write.pBufferInfo = gather(buffers_, entry, data);
    }
    writes_.push_back(write);
  }
}

VkResult VKAPI_CALL CreateDescriptorSetLayout(VkDevice handle,
                                              const VkDescriptorSetLayoutCreateInfo* info,
                                              const VkAllocationCallbacks* allocator,
                                              VkDescriptorSetLayout* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    auto layout = std::make_shared<SetLayout>(read_set_layout(*info));
    const LayoutBelow below(device, *info);
    const VkResult created = device.CreateDescriptorSetLayout(
        handle, layout->has_tensors ? below.get() : info, allocator, result);
    if (created == VK_SUCCESS) device.set_layouts.put(*result, std::move(layout));
    return created;
  });
}

void VKAPI_CALL DestroyDescriptorSetLayout(VkDevice handle, VkDescriptorSetLayout layout,
                                           const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    device.set_layouts.take(layout);
    device.DestroyDescriptorSetLayout(handle, layout, allocator);
  });
}

void VKAPI_CALL GetDescriptorSetLayoutSupport(VkDevice handle,
                                              const VkDescriptorSetLayoutCreateInfo* info,
                                              VkDescriptorSetLayoutSupport* support) {
  guarded_void([&] {
    const Device& device = device_of(handle);
    const LayoutBelow below(device, *info);
    device.GetDescriptorSetLayoutSupport(handle, below.get(), support);
    auto* varying = find_in_chain<VkDescriptorSetVariableDescriptorCountLayoutSupport>(
        support->pNext, VK_STRUCTURE_TYPE_DESCRIPTOR_SET_VARIABLE_DESCRIPTOR_COUNT_LAYOUT_SUPPORT);
    if (const uint32_t scale = read_set_layout(*info).varying_scale(device); varying && scale > 1)
      varying->maxVariableDescriptorCount /= scale;
  });
}

VkResult VKAPI_CALL CreatePipelineLayout(VkDevice handle, const VkPipelineLayoutCreateInfo* info,
                                         const VkAllocationCallbacks* allocator,
                                         VkPipelineLayout* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    auto layout = std::make_shared<PipelineLayout>();
    VkResult created = device.CreatePipelineLayout(handle, info, allocator, result);
    if (created != VK_SUCCESS) return created;
    for (uint32_t i = 0; i < info->setLayoutCount; ++i)
      layout->sets.push_back(info->pSetLayouts[i] ? device.set_layouts.find(info->pSetLayouts[i])
                                                  : nullptr);
    layout->has_push_constants = info->pushConstantRangeCount > 0;
    const bool in_buffers = std::any_of(
        layout->sets.begin(), layout->sets.end(),
        [](const auto& set) { return set && set->has_tensors && set->in_descriptor_buffer; });
    if (device.descriptor_buffers && in_buffers) {
      VkPipelineLayout own = VK_NULL_HANDLE;
      created = device.CreatePipelineLayout(handle, info, nullptr, &own);
      if (created != VK_SUCCESS) {
        device.DestroyPipelineLayout(handle, *result, allocator);
        *result = VK_NULL_HANDLE;
        return created;
      }
      layout->own = vk::PipelineLayoutHandle(handle, own, device.DestroyPipelineLayout);
    }
    layout->with_flow = layout_with_flow(device, *info, *layout);
    device.layouts.put(*result, std::move(layout));
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyPipelineLayout(VkDevice handle, VkPipelineLayout layout,
                                      const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    device.layouts.take(layout);
    device.DestroyPipelineLayout(handle, layout, allocator);
  });
}

VkResult VKAPI_CALL CreateDescriptorPool(VkDevice handle, const VkDescriptorPoolCreateInfo* info,
                                         const VkAllocationCallbacks* allocator,
                                         VkDescriptorPool* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    std::vector<VkDescriptorPoolSize> sizes;
    for (uint32_t i = 0; i < info->poolSizeCount; ++i)
      if (info->pPoolSizes[i].type != VK_DESCRIPTOR_TYPE_TENSOR_ARM)
        sizes.push_back(info->pPoolSizes[i]);
      else if (device.tensor_buffers)
        sizes.push_back({VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
                         kBuffersOfTensor * info->pPoolSizes[i].descriptorCount});
    // A pool must offer something.
    if (sizes.empty()) sizes.push_back({VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1});
    const ChainCopy chain(info->pNext);
    VkDescriptorPoolCreateInfo below = *info;
    below.pNext = chain.next();
    below.poolSizeCount = static_cast<uint32_t>(sizes.size());
    below.pPoolSizes = sizes.data();
    const VkResult created = device.CreateDescriptorPool(handle, &below, allocator, result);
    if (created == VK_SUCCESS) device.pools.put(*result, std::make_shared<Pool>());
    return created;
  });
}

VkResult VKAPI_CALL ResetDescriptorPool(VkDevice handle, VkDescriptorPool pool,
                                        VkDescriptorPoolResetFlags flags) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    if (const auto known = device.pools.find(pool)) forget_sets(device, *known);
    return device.ResetDescriptorPool(handle, pool, flags);
  });
}

void VKAPI_CALL DestroyDescriptorPool(VkDevice handle, VkDescriptorPool pool,
                                      const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    if (const auto known = device.pools.take(pool)) forget_sets(device, *known);
    device.DestroyDescriptorPool(handle, pool, allocator);
  });
}

VkResult VKAPI_CALL AllocateDescriptorSets(VkDevice handle, const VkDescriptorSetAllocateInfo* info,
                                           VkDescriptorSet* results) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    constexpr VkStructureType kVarying =
        VK_STRUCTURE_TYPE_DESCRIPTOR_SET_VARIABLE_DESCRIPTOR_COUNT_ALLOCATE_INFO;
    using Varying = VkDescriptorSetVariableDescriptorCountAllocateInfo;
    const auto* varying = find_in_chain<Varying>(info->pNext, kVarying);
    std::vector<std::shared_ptr<SetLayout>> layouts;
    std::vector<uint32_t> counts, counts_below;
    for (uint32_t i = 0; i < info->descriptorSetCount; ++i) {
      const auto& layout = layouts.emplace_back(device.set_layouts.find(info->pSetLayouts[i]));
      counts.push_back(varying && i < varying->descriptorSetCount ? varying->pDescriptorCounts[i]
                                                                  : 0);
      counts_below.push_back(counts.back() * (layout ? layout->varying_scale(device) : 1));
    }
    ChainCopy chain(info->pNext);
    if (auto* copy = chain.find<Varying>(kVarying); copy && copy->descriptorSetCount > 0)
      copy->pDescriptorCounts = counts_below.data();
    VkDescriptorSetAllocateInfo below = *info;
    below.pNext = chain.next();
    const VkResult allocated = device.AllocateDescriptorSets(handle, &below, results);
    if (allocated != VK_SUCCESS) return allocated;
    const auto pool = device.pools.find(info->descriptorPool);
    for (uint32_t i = 0; i < info->descriptorSetCount; ++i) {
      const auto& layout = layouts[i];
      if (!pool || !layout || !layout->has_tensors) continue;
      device.sets.put(results[i], std::make_shared<Set>(*layout, counts[i]));
      const std::lock_guard lock(pool->mutex);
      pool->sets.insert(results[i]);
    }
    return VK_SUCCESS;
  });
}

VkResult VKAPI_CALL FreeDescriptorSets(VkDevice handle, VkDescriptorPool pool, uint32_t count,
                                       const VkDescriptorSet* sets) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    const auto known = device.pools.find(pool);
    for (uint32_t i = 0; i < count && known; ++i) {
      device.sets.take(sets[i]);
      const std::lock_guard lock(known->mutex);
      known->sets.erase(sets[i]);
    }
    return device.FreeDescriptorSets(handle, pool, count, sets);
  });
}

void VKAPI_CALL UpdateDescriptorSets(VkDevice handle, uint32_t write_count,
                                     const VkWriteDescriptorSet* writes, uint32_t copy_count,
                                     const VkCopyDescriptorSet* copies) {
  guarded_void([&] {
    Device& device = device_of(handle);
    std::vector<VkCopyDescriptorSet> copies_below;
    const std::span<const VkWriteDescriptorSet> all(writes, write_count);
    std::vector<std::shared_ptr<Set>> held;
    const SplitWrites split(device, all, [&](const VkWriteDescriptorSet& write) {
      return held.emplace_back(device.sets.find(write.dstSet)).get();
    });
    for (const VkCopyDescriptorSet& copy : std::span(copies, copy_count))
      copy_tensors(device, copy, copies_below);
    device.UpdateDescriptorSets(handle, static_cast<uint32_t>(split.below().size()),
                                split.below().data(), static_cast<uint32_t>(copies_below.size()),
                                copies_below.data());
  });
}

VkResult VKAPI_CALL CreateDescriptorUpdateTemplate(VkDevice handle,
                                                   const VkDescriptorUpdateTemplateCreateInfo* info,
                                                   const VkAllocationCallbacks* allocator,
                                                   VkDescriptorUpdateTemplate* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    auto update = std::make_shared<UpdateTemplate>();
    update->entries.assign(info->pDescriptorUpdateEntries,
                           info->pDescriptorUpdateEntries + info->descriptorUpdateEntryCount);
    update->point = info->pipelineBindPoint;
    const bool tensors = std::any_of(
        update->entries.begin(), update->entries.end(),
        [](const auto& entry) { return entry.descriptorType == VK_DESCRIPTOR_TYPE_TENSOR_ARM; });
    // One with tensors is the layer's: its address is the handle.
    if (!tensors) {
      const VkResult created =
          device.CreateDescriptorUpdateTemplate(handle, info, allocator, &update->below);
      if (created != VK_SUCCESS) return created;
      *result = update->below;
    } else {
      *result = reinterpret_cast<VkDescriptorUpdateTemplate>(update.get());
    }
    device.templates.put(*result, std::move(update));
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyDescriptorUpdateTemplate(VkDevice handle, VkDescriptorUpdateTemplate which,
                                                const VkAllocationCallbacks* allocator) {
  guarded_void([&] {
    Device& device = device_of(handle);
    const auto update = device.templates.take(which);
    if (!update || update->below) device.DestroyDescriptorUpdateTemplate(handle, which, allocator);
  });
}

void VKAPI_CALL UpdateDescriptorSetWithTemplate(VkDevice handle, VkDescriptorSet set,
                                                VkDescriptorUpdateTemplate which,
                                                const void* data) {
  guarded_void([&] {
    Device& device = device_of(handle);
    const auto update = device.templates.find(which);
    if (!update || update->below)
      return device.UpdateDescriptorSetWithTemplate(handle, set, which, data);
    const TemplateWrites writes(*update, set, data);
    UpdateDescriptorSets(handle, static_cast<uint32_t>(writes.writes().size()),
                         writes.writes().data(), 0, nullptr);
  });
}

/// A tensor's descriptor is those of its two buffers, one behind the other.
static Result<void> write_tensor_descriptor(const Device& device,
                                            const VkDescriptorGetInfoEXT& info, size_t bytes,
                                            void* result) {
  const size_t each = device.physical->storage_descriptor_bytes;
  const auto* of = find_in_chain<VkDescriptorGetTensorInfoARM>(
      info.pNext, VK_STRUCTURE_TYPE_DESCRIPTOR_GET_TENSOR_INFO_ARM);
  if (!device.descriptor_buffers)
    return bad_input("vkGetDescriptorEXT", "descriptorBufferTensorDescriptors is not enabled");
  if (!of) return bad_input("vkGetDescriptorEXT", "has no VkDescriptorGetTensorInfoARM");
  if (bytes < kBuffersOfTensor * each)
    return bad_input("vkGetDescriptorEXT", "has {} bytes for a tensor, expected {}", bytes,
                     kBuffersOfTensor * each);
  VkDescriptorAddressInfoEXT buffers[kBuffersOfTensor]{};
  if (of->tensorView) {
    const Tensor* found = device.tensors_by_id.find(view_of(of->tensorView)->tensor);
    if (!found) return bad_input("vkGetDescriptorEXT", "the view's tensor was destroyed");
    const Tensor& tensor = *found;
    const auto address = [&](VkBuffer buffer) {
      VkBufferDeviceAddressInfo which{};
      which.sType = VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO;
      which.buffer = buffer;
      return device.GetBufferDeviceAddress(device.handle, &which);
    };
    buffers[0].address = address(tensor.buffer);
    buffers[0].range = tensor.layout.buffer_bytes();
    buffers[1].address = address(tensor.shape.buffer) + tensor.shape.offset;
    buffers[1].range = kShapeWords * sizeof(uint32_t);
  }
  for (uint32_t i = 0; i < kBuffersOfTensor; ++i) {
    buffers[i].sType = VK_STRUCTURE_TYPE_DESCRIPTOR_ADDRESS_INFO_EXT;
    VkDescriptorGetInfoEXT below{};
    below.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_GET_INFO_EXT;
    below.type = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    below.data.pStorageBuffer = of->tensorView ? &buffers[i] : nullptr;
    device.GetDescriptorEXT(device.handle, &below, each, static_cast<char*>(result) + i * each);
  }
  return {};
}

void VKAPI_CALL GetDescriptorEXT(VkDevice handle, const VkDescriptorGetInfoEXT* info, size_t bytes,
                                 void* result) {
  guarded_void([&] {
    Device& device = device_of(handle);
    VkDescriptorGetInfoEXT below = *info;
    VkDescriptorImageInfo image;
    const auto known_below = [&](const VkDescriptorImageInfo*& member) {
      if (!member) return;
      image = *member;
      image.imageLayout = layout_below(image.imageLayout);
      member = &image;
    };
    switch (static_cast<int>(info->type)) {
      case static_cast<int>(VK_DESCRIPTOR_TYPE_TENSOR_ARM):
        if (const Result<void> written = write_tensor_descriptor(device, *info, bytes, result);
            !written)
          device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle), written.error());
        return;
      case VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER:
        known_below(below.data.pCombinedImageSampler);
        break;
      case VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT:
        known_below(below.data.pInputAttachmentImage);
        break;
      case VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE: known_below(below.data.pSampledImage); break;
      case VK_DESCRIPTOR_TYPE_STORAGE_IMAGE: known_below(below.data.pStorageImage); break;
      default: break;
    }
    device.GetDescriptorEXT(handle, &below, bytes, result);
  });
}

}  // namespace shale::layer
