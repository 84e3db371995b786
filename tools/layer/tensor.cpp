#include "tools/layer/tensor.h"

#include <algorithm>
#include <atomic>

#include "compiler/frontend/vgf/formats.h"
#include "tools/layer/chain.h"
#include "tools/layer/commands.h"
#include "tools/layer/graph.h"
#include "tools/layer/tensor_shader.h"

namespace shale::layer {
namespace {

/// The buffer behind a tensor; `external` is where a structure of its chain goes.
Result<VkBufferCreateInfo> buffer_info(const Device& device, const VkTensorCreateInfoARM& info,
                                       const TensorLayout& layout,
                                       VkExternalMemoryBufferCreateInfo& external) {
  if (info.flags & ~VK_TENSOR_CREATE_MUTABLE_FORMAT_BIT_ARM)
    return unsupported("VkTensorCreateInfoARM::flags", "{:#x} has more than the mutable format",
                       info.flags);
  VkBufferCreateInfo buffer{};
  buffer.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO;
  buffer.size = layout.buffer_bytes();
  buffer.usage = tensor_usage(device);
  buffer.sharingMode = info.sharingMode;
  buffer.queueFamilyIndexCount = info.queueFamilyIndexCount;
  buffer.pQueueFamilyIndices = info.pQueueFamilyIndices;
  if (const auto* asked = find_in_chain<VkExternalMemoryTensorCreateInfoARM>(
          info.pNext, VK_STRUCTURE_TYPE_EXTERNAL_MEMORY_TENSOR_CREATE_INFO_ARM);
      asked && asked->handleTypes != 0) {
    external.sType = VK_STRUCTURE_TYPE_EXTERNAL_MEMORY_BUFFER_CREATE_INFO;
    external.handleTypes = asked->handleTypes;
    buffer.pNext = &external;
  }
  return buffer;
}

void memory_requirements(const Device& device, VkBuffer buffer, VkMemoryRequirements2& result) {
  if (auto* dedicated = find_in_chain<VkMemoryDedicatedRequirements>(
          result.pNext, VK_STRUCTURE_TYPE_MEMORY_DEDICATED_REQUIREMENTS))
    dedicated->prefersDedicatedAllocation = dedicated->requiresDedicatedAllocation = VK_FALSE;
  device.context->vk.GetBufferMemoryRequirements(device.handle, buffer, &result.memoryRequirements);
}

void destroy_tensor(Device& device, Tensor* tensor, const VkAllocationCallbacks* allocator) {
  if (tensor->shape.buffer) device.shapes->give_back(tensor->shape);
  device.context->vk.DestroyBuffer(device.handle, tensor->buffer, allocator);
  destroy_object(tensor, allocator);
}

/// Gives a tensor the rows of a linear image: axes are [..., depth, height, width, components].
Result<void> lay_as_image(const Device& device, uint64_t element, TensorLayout& layout) {
  constexpr const char* kWhere = "VkTensorDescriptionARM";
  constexpr VkFormat kFormats[3][4] = {
      {VK_FORMAT_R8_UNORM, VK_FORMAT_R8G8_UNORM, VK_FORMAT_UNDEFINED, VK_FORMAT_R8G8B8A8_UNORM},
      {VK_FORMAT_R16_SFLOAT, VK_FORMAT_R16G16_SFLOAT, VK_FORMAT_UNDEFINED,
       VK_FORMAT_R16G16B16A16_SFLOAT},
      {VK_FORMAT_R32_SFLOAT, VK_FORMAT_R32G32_SFLOAT, VK_FORMAT_UNDEFINED,
       VK_FORMAT_R32G32B32A32_SFLOAT}};
  const size_t rank = layout.dims.size();
  const int64_t components = layout.dims.back();
  const size_t row = element == 1 ? 0 : element == 2 ? 1 : 2;
  const VkFormat format = element > 4 || components > 4
                              ? VK_FORMAT_UNDEFINED
                              : kFormats[row][static_cast<size_t>(components) - 1];
  if (layout.tiling != VK_TENSOR_TILING_OPTIMAL_ARM || rank < 2 || format == VK_FORMAT_UNDEFINED)
    return unsupported(kWhere, "no image has {} components of {} bytes", components, element);
  const auto size = [&](size_t from_end) {
    return from_end <= rank ? static_cast<uint32_t>(layout.dims[rank - from_end]) : 1;
  };
  VkImageCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
  info.imageType = size(4) > 1 ? VK_IMAGE_TYPE_3D : VK_IMAGE_TYPE_2D;
  info.format = format;
  info.extent = {size(2), size(3), size(4)};
  info.mipLevels = info.arrayLayers = 1;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  info.tiling = VK_IMAGE_TILING_LINEAR;
  info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT;
  VkImageFormatProperties limits;
  const VkResult allowed = device.instance->GetPhysicalDeviceImageFormatProperties(
      device.physical->handle, format, info.imageType, info.tiling, info.usage, 0, &limits);
  if (allowed != VK_SUCCESS || info.extent.width > limits.maxExtent.width ||
      info.extent.height > limits.maxExtent.height || info.extent.depth > limits.maxExtent.depth)
    return unsupported(kWhere, "the device has no linear image of {}x{}x{} texels",
                       info.extent.width, info.extent.height, info.extent.depth);
  VkImage image;
  SHALE_TRY_VOID(
      vk::check(device.CreateImage(device.handle, &info, nullptr, &image), "vkCreateImage"));
  const VkImageSubresource whole{VK_IMAGE_ASPECT_COLOR_BIT, 0, 0};
  VkSubresourceLayout rows;
  device.GetImageSubresourceLayout(device.handle, image, &whole, &rows);
  device.DestroyImage(device.handle, image, nullptr);
  if (rank < 3) return {};
  const auto set_stride = [&](size_t axis, int64_t stride) {
    layout.packed = layout.packed && layout.strides[axis] == stride;
    layout.strides[axis] = stride;
  };
  set_stride(rank - 3, static_cast<int64_t>(rows.rowPitch));
  for (size_t axis = rank - 3; axis-- > 0;)
    set_stride(axis, axis + 4 == rank && size(4) > 1
                         ? static_cast<int64_t>(rows.depthPitch)
                         : layout.strides[axis + 1] * layout.dims[axis + 1]);
  return {};
}

/// Axes merged where they lie behind each other in both layouts: what is left to loop over, and the
/// bytes of one run.
struct Runs {
  struct Axis {
    uint64_t size, from, to;  ///< steps in bytes
  };
  std::vector<Axis> axes;  ///< outermost first
  uint64_t run_bytes = 0;
};

Runs merged_runs(const TensorLayout& from, const TensorLayout& to) {
  Runs runs;
  runs.run_bytes = static_cast<uint64_t>(from.strides.back());
  for (size_t i = from.dims.size(); i-- > 0;) {
    const auto size = static_cast<uint64_t>(from.dims[i]);
    const auto a = static_cast<uint64_t>(from.strides[i]), b = static_cast<uint64_t>(to.strides[i]);
    if (size == 1) continue;
    if (runs.axes.empty() && a == runs.run_bytes && b == runs.run_bytes)
      runs.run_bytes *= size;
    else
      runs.axes.insert(runs.axes.begin(), {size, a, b});
  }
  return runs;
}

}  // namespace

VkBufferUsageFlags tensor_usage(const Device& device) {
  return device.descriptor_buffers ? kTensorUsage | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
                                   : kTensorUsage;
}

uint32_t tensor_element_bytes(VkFormat format) {
  switch (static_cast<int>(format)) {
    case VK_FORMAT_R8_UINT:
    case VK_FORMAT_R8_SINT:
    case static_cast<int>(VK_FORMAT_R8_BOOL_ARM): return 1;
    case VK_FORMAT_R16_UINT:
    case VK_FORMAT_R16_SINT:
    case VK_FORMAT_R16_SFLOAT: return 2;
    case VK_FORMAT_R32_UINT:
    case VK_FORMAT_R32_SINT:
    case VK_FORMAT_R32_SFLOAT: return 4;
    case VK_FORMAT_R64_UINT:
    case VK_FORMAT_R64_SINT:
    case VK_FORMAT_R64_SFLOAT: return 8;
    default: return 0;
  }
}

DType graph_dtype(VkFormat format) {
  return tensor_element_bytes(format) == 0 ? DType::kUnknown
                                           : dtype_of_vk_format(static_cast<uint32_t>(format));
}

uint64_t TensorLayout::elements() const {
  uint64_t count = 1;
  for (const int64_t size : dims) count *= static_cast<uint64_t>(size);
  return count;
}

uint64_t TensorLayout::size_bytes() const {
  return static_cast<uint64_t>(strides[0]) * static_cast<uint64_t>(dims[0]);
}

Result<TensorLayout> read_layout(const VkTensorDescriptionARM& description, const Device& device) {
  const char* where = "VkTensorDescriptionARM";
  TensorLayout layout;
  layout.tiling = description.tiling;
  layout.format = description.format;
  layout.usage = description.usage;
  const uint32_t rank = description.dimensionCount;
  const uint64_t most = device.physical->max_tensor_bytes();
  const uint64_t element = tensor_element_bytes(description.format);
  if (element == 0)
    return unsupported(where, "format {} is none of tensors", static_cast<int>(description.format));
  if (description.tiling != VK_TENSOR_TILING_OPTIMAL_ARM &&
      description.tiling != VK_TENSOR_TILING_LINEAR_ARM)
    return unsupported(where, "tiling {} is neither optimal nor linear",
                       static_cast<int>(description.tiling));
  if (rank == 0 || rank > kMaxTensorRank || !description.pDimensions)
    return bad_input(where, "has {} dimensions, expected 1 to {}", rank, kMaxTensorRank);
  if (description.usage == 0) return bad_input(where, "has no usage");
  uint64_t elements = 1;
  layout.dims.assign(description.pDimensions, description.pDimensions + rank);
  for (const int64_t size : layout.dims) {
    if (size < 1 || static_cast<uint64_t>(size) > most / element)
      return bad_input(where, "has a dimension of {}, expected 1 to {}", size, most / element);
    elements *= static_cast<uint64_t>(size);  // both below 2^32
    if (elements > most / element)
      return bad_input(where, "has more than {} elements", most / element);
  }
  layout.strides.resize(rank);
  auto next = static_cast<int64_t>(element);
  for (size_t i = rank; i-- > 0; next *= layout.dims[i]) layout.strides[i] = next;
  if (description.usage & VK_TENSOR_USAGE_IMAGE_ALIASING_BIT_ARM)
    SHALE_TRY_VOID(lay_as_image(device, element, layout));
  if (!description.pStrides) return layout;
  if (description.tiling == VK_TENSOR_TILING_OPTIMAL_ARM)
    return bad_input(where, "has strides, which tensors of optimal tiling have not");
  next = static_cast<int64_t>(element);
  for (size_t i = rank; i-- > 0;) {
    const int64_t stride = description.pStrides[i];
    if (stride < next || static_cast<uint64_t>(stride) > most ||
        stride % static_cast<int64_t>(element) != 0)
      return bad_input(where,
                       "has a stride of {} for axis {}, expected a multiple of {} from {} to {}",
                       stride, i, element, next, most);
    if (i + 1 == rank && stride != next)
      return bad_input(where, "has a stride of {} for the last axis, expected {}", stride, next);
    layout.packed = layout.packed && stride == layout.strides[i];
    layout.strides[i] = stride;
    next = stride * layout.dims[i];  // both below 2^32
  }
  if (static_cast<uint64_t>(next) > most)
    return bad_input(where, "takes {} bytes with its strides, expected at most {}", next, most);
  return layout;
}

Result<ShapeSlot> ShapeSlots::take(const TensorLayout& layout) {
  const std::lock_guard lock(mutex_);
  if (free_.empty()) {
    constexpr uint64_t kSlotBytes = 256;  // the largest alignment that Vulkan allows
    constexpr uint64_t kSlots = 256;
    SHALE_TRY(vk::Buffer buffer,
              vk::Buffer::create(*device_.context, kSlotBytes * kSlots, tensor_usage(device_),
                                 vk::MemoryKind::kUpload));
    for (uint64_t i = kSlots; i-- > 0;)
      free_.push_back({buffer.get(), i * kSlotBytes,
                       reinterpret_cast<uint32_t*>(buffer.mapped().data() + i * kSlotBytes)});
    buffers_.push_back(std::move(buffer));
  }
  const ShapeSlot slot = free_.back();
  free_.pop_back();
  const uint32_t element = tensor_element_bytes(layout.format);
  slot.words[0] = static_cast<uint32_t>(layout.dims.size());
  for (size_t i = 0; i < layout.dims.size(); ++i) {
    slot.words[kFirstSizeWord + i] = static_cast<uint32_t>(layout.dims[i]);
    slot.words[kFirstStrideWord + i] = static_cast<uint32_t>(layout.strides[i] / element);
  }
  return slot;
}

void ShapeSlots::give_back(const ShapeSlot& slot) {
  const std::lock_guard lock(mutex_);
  free_.push_back(slot);
}

void record_copy(const Device& device, VkCommandBuffer commands, VkBuffer from,
                 const TensorLayout& from_layout, VkBuffer to, const TensorLayout& to_layout) {
  const Runs runs = merged_runs(from_layout, to_layout);
  constexpr size_t kMostRegions = 4096;  // of one command
  std::vector<VkBufferCopy> regions;
  std::vector<uint64_t> index(runs.axes.size());
  uint64_t source = 0, target = 0;
  for (bool done = false; !done;) {
    regions.push_back({source, target, runs.run_bytes});
    done = true;
    for (size_t i = runs.axes.size(); i-- > 0;) {
      const Runs::Axis& axis = runs.axes[i];
      source += axis.from, target += axis.to;
      if (++index[i] < axis.size) {
        done = false;
        break;
      }
      index[i] = 0;
      source -= axis.from * axis.size, target -= axis.to * axis.size;
    }
    if (!done && regions.size() < kMostRegions) continue;
    device.context->vk.CmdCopyBuffer(commands, from, to, static_cast<uint32_t>(regions.size()),
                                     regions.data());
    regions.clear();
  }
}

VkResult VKAPI_CALL CreateTensorARM(VkDevice handle, const VkTensorCreateInfoARM* info,
                                    const VkAllocationCallbacks* allocator, VkTensorARM* result) {
  return guarded([&]() -> VkResult {
    static std::atomic<uint64_t> last_id = 0;
    Device& device = device_of(handle);
    *result = VK_NULL_HANDLE;
    Result<TensorLayout> layout = read_layout(*info->pDescription, device);
    if (!layout) return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle), layout.error());
    VkExternalMemoryBufferCreateInfo external{};
    const auto below = buffer_info(device, *info, *layout, external);
    if (!below) return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle), below.error());
    auto* tensor = make_object<Tensor>(
        allocator, Tensor{++last_id, info->flags, *std::move(layout), VK_NULL_HANDLE});
    const VkResult created = guarded([&]() -> VkResult {
      if (device.shapes) {
        const Result<ShapeSlot> taken = device.shapes->take(tensor->layout);
        if (!taken) return device.fail(VK_OBJECT_TYPE_DEVICE, number_of(handle), taken.error());
        tensor->shape = *taken;
      }
      const VkResult made =
          device.context->vk.CreateBuffer(handle, &*below, allocator, &tensor->buffer);
      if (made == VK_SUCCESS) device.tensors_by_id.put(tensor->id, tensor);
      return made;
    });
    if (created == VK_SUCCESS)
      *result = reinterpret_cast<VkTensorARM>(tensor);
    else
      destroy_tensor(device, tensor, allocator);
    return created;
  });
}

void VKAPI_CALL DestroyTensorARM(VkDevice handle, VkTensorARM which,
                                 const VkAllocationCallbacks* allocator) {
  if (!which) return;
  guarded_void([&] {
    Device& device = device_of(handle);
    Tensor* tensor = tensor_of(which);
    device.tensors_by_id.take(tensor->id);
    forget_tensor(device, tensor->id);
    destroy_tensor(device, tensor, allocator);
  });
}

VkResult VKAPI_CALL CreateTensorViewARM(VkDevice handle, const VkTensorViewCreateInfoARM* info,
                                        const VkAllocationCallbacks* allocator,
                                        VkTensorViewARM* result) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    *result = VK_NULL_HANDLE;
    Tensor* tensor = tensor_of(info->tensor);
    const TensorLayout& layout = tensor->layout;
    const bool mutable_format = tensor->flags & VK_TENSOR_CREATE_MUTABLE_FORMAT_BIT_ARM;
    std::optional<Error> error;
    if (info->flags != 0)
      error = unsupported("VkTensorViewCreateInfoARM::flags", "{:#x} is unknown", info->flags);
    else if (info->format != layout.format &&
             (!mutable_format ||
              tensor_element_bytes(info->format) != tensor_element_bytes(layout.format)))
      error = bad_input("VkTensorViewCreateInfoARM", "format {} does not fit the tensor's, {}",
                        static_cast<int>(info->format), static_cast<int>(layout.format));
    else if (!tensor->bound)
      error = bad_input("VkTensorViewCreateInfoARM", "the tensor has no memory yet");
    if (error) return device.fail(VK_OBJECT_TYPE_TENSOR_ARM, number_of(info->tensor), *error);
    *result = reinterpret_cast<VkTensorViewARM>(
        make_object<TensorView>(allocator, TensorView{tensor->id, info->format}));
    return VK_SUCCESS;
  });
}

void VKAPI_CALL DestroyTensorViewARM(VkDevice, VkTensorViewARM view,
                                     const VkAllocationCallbacks* allocator) {
  if (view) destroy_object(view_of(view), allocator);
}

void VKAPI_CALL GetTensorMemoryRequirementsARM(VkDevice handle,
                                               const VkTensorMemoryRequirementsInfoARM* info,
                                               VkMemoryRequirements2* result) {
  memory_requirements(device_of(handle), tensor_of(info->tensor)->buffer, *result);
}

void VKAPI_CALL GetDeviceTensorMemoryRequirementsARM(
    VkDevice handle, const VkDeviceTensorMemoryRequirementsARM* info,
    VkMemoryRequirements2* result) {
  guarded_void([&] {
    const Device& device = device_of(handle);
    VkTensorARM tensor;
    result->memoryRequirements = {};
    if (CreateTensorARM(handle, info->pCreateInfo, nullptr, &tensor) != VK_SUCCESS) return;
    memory_requirements(device, tensor_of(tensor)->buffer, *result);
    DestroyTensorARM(handle, tensor, nullptr);
  });
}

VkResult VKAPI_CALL BindTensorMemoryARM(VkDevice handle, uint32_t count,
                                        const VkBindTensorMemoryInfoARM* infos) {
  return guarded([&]() -> VkResult {
    Device& device = device_of(handle);
    VkResult first_failure = VK_SUCCESS;
    for (uint32_t i = 0; i < count; ++i) {
      Tensor* tensor = tensor_of(infos[i].tensor);
      VkResult result = VK_SUCCESS;
      if (tensor->bound)
        result =
            device.fail(VK_OBJECT_TYPE_TENSOR_ARM, number_of(infos[i].tensor),
                        bad_input("vkBindTensorMemoryARM", "the tensor has its memory already"));
      else
        result = device.context->vk.BindBufferMemory(handle, tensor->buffer, infos[i].memory,
                                                     infos[i].memoryOffset);
      tensor->bound = tensor->bound || result == VK_SUCCESS;
      if (first_failure == VK_SUCCESS) first_failure = result;
    }
    return first_failure;
  });
}

void VKAPI_CALL CmdCopyTensorARM(VkCommandBuffer commands, const VkCopyTensorInfoARM* info) {
  record_guarded(commands, [&](Device& device) -> Result<void> {
    const Tensor& from = *tensor_of(info->srcTensor);
    const Tensor& to = *tensor_of(info->dstTensor);
    if (from.layout.dims != to.layout.dims ||
        tensor_element_bytes(from.layout.format) != tensor_element_bytes(to.layout.format))
      return bad_input("vkCmdCopyTensorARM", "the tensors differ in shape or size of elements");
    if (!from.bound || !to.bound)
      return bad_input("vkCmdCopyTensorARM", "a tensor has no memory yet");
    if (info->regionCount != 1)
      return bad_input("vkCmdCopyTensorARM", "has {} regions, expected 1", info->regionCount);
    const VkTensorCopyARM& region = info->pRegions[0];
    for (uint32_t i = 0; i < region.dimensionCount; ++i)
      if ((region.pSrcOffset && region.pSrcOffset[i] != 0) ||
          (region.pDstOffset && region.pDstOffset[i] != 0) ||
          (region.pExtent && (i >= from.layout.dims.size() ||
                              region.pExtent[i] != static_cast<uint64_t>(from.layout.dims[i]))))
        return bad_input("vkCmdCopyTensorARM", "copies a part, expected the whole tensor");
    record_copy(device, commands, from.buffer, from.layout, to.buffer, to.layout);
    return {};
  });
}

// Tensors that could be captured would need the address of their shape to be captured, too.
static VkResult no_capture(VkDevice handle, VkObjectType type, uint64_t object) {
  return device_of(handle).fail(type, object,
                                unsupported("opaque capture descriptor data",
                                            "tensors are made without the flag for capture"));
}

VkResult VKAPI_CALL GetTensorOpaqueCaptureDescriptorDataARM(
    VkDevice handle, const VkTensorCaptureDescriptorDataInfoARM* info, void*) {
  return guarded(
      [&] { return no_capture(handle, VK_OBJECT_TYPE_TENSOR_ARM, number_of(info->tensor)); });
}

VkResult VKAPI_CALL GetTensorViewOpaqueCaptureDescriptorDataARM(
    VkDevice handle, const VkTensorViewCaptureDescriptorDataInfoARM* info, void*) {
  return guarded([&] {
    return no_capture(handle, VK_OBJECT_TYPE_TENSOR_VIEW_ARM, number_of(info->tensorView));
  });
}

}  // namespace shale::layer
