#include "runtime/frame/frame_loop.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>

#include "runtime/datagraph/dispatch.h"
#include "runtime/vk/commands.h"

namespace shale {
namespace {

constexpr uint32_t kMaxFramesInFlight = 8;
constexpr uint32_t kMaxPhases = 64;
constexpr VkImageUsageFlags kShaderUsages = VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT;

bool is_host_image(Category category) {
  return category == Category::kImageInput || category == Category::kImageOutput;
}

/// Leads to different images in different frames, so its set depends on the frame.
bool changes_by_frame(const Step& step, const Variant& variant) {
  if (step.is_transfer) return false;  // has no set
  const std::vector<Binding>& bindings = step.dispatch->bindings;
  return std::any_of(bindings.begin(), bindings.end(), [&](const Binding& binding) {
    const Category category = variant.resources[binding.resource].category;
    return is_host_image(category) || category == Category::kImageHistory;
  });
}

/// After how many frames all rings are at the same slots again.
/// Errors: kUnsupported above kMaxPhases.
Result<uint32_t> ring_phases(const Variant& variant) {
  uint32_t phases = 1;
  for (const Resource& resource : variant.resources) {
    if (resource.category != Category::kImageHistory) continue;
    phases = std::lcm(phases, resource.history_depth);
    if (phases > kMaxPhases)
      return unsupported("", "the depths of the histories repeat after more than {} frames",
                         kMaxPhases);
  }
  return phases;
}

}  // namespace

struct FrameLoop::State {
  std::unique_ptr<Kernels> kernels;
  vk::Buffer arena;
  vk::Buffer graph_tensors;                     // inputs and outputs of the graph
  std::vector<uint64_t> offsets;                // of tensors in their buffer, by resource
  std::vector<std::vector<vk::Image>> images;   // own ones, by resource: one, or the ring
  std::vector<std::vector<vk::Buffer>> linear;  // own linear ones, as `images`
  std::vector<VkImageUsageFlags> usages;        // by resource: of images, as steps use them; or 0
  std::vector<ImageView> host_images;           // by resource

  DescriptorSets descriptors;
  std::vector<std::vector<VkDescriptorSet>> sets;  // by slot, then by step
  std::vector<std::vector<size_t>> changing_sets;  // by slot: the indices that are its own
  std::vector<uint64_t> slot_bindings;             // by slot: `bindings` when it was written
  uint64_t bindings = 1;                           // grows with each bind_image

  std::vector<uint8_t> params;  // push constants of the passes
  uint64_t frame = 0;
  bool clear_history = true;

  Result<void> create_tensors();
  Result<void> create_images();
  uint32_t slot_of(uint32_t resource, uint32_t frames_back) const;
  Result<void> create_sets(uint32_t slots);
  void set(const Param& param, std::span<const float> values);
  Target target(const Binding& binding) const;
  void record_clears(VkCommandBuffer commands) const;
  /// Of a ring, what the last frame left.
  template <typename T>
  const T& last(const std::vector<T>& ring) const {
    // `frame` is the next one already; before the first frame every slot is as good.
    return ring[(frame == 0 ? 0 : frame - 1) % ring.size()];
  }
};

FrameLoop::FrameLoop(std::unique_ptr<State> state) : state_(std::move(state)) {}
FrameLoop::FrameLoop(FrameLoop&&) noexcept = default;
FrameLoop& FrameLoop::operator=(FrameLoop&&) noexcept = default;
FrameLoop::~FrameLoop() = default;

Result<FrameLoop> FrameLoop::create(const vk::Context& context, const Package& package,
                                    const FrameLoopOptions& options) {
  if (options.frames_in_flight < 1 || options.frames_in_flight > kMaxFramesInFlight)
    return bad_input("", "{} frames in flight are outside 1..{}", options.frames_in_flight,
                     kMaxFramesInFlight);
  auto state = std::make_unique<State>();
  SHALE_TRY(state->kernels, Kernels::create(context, package, Scope::kFrame, options.cache));
  const Variant& variant = state->kernels->variant();
  SHALE_TRY(const uint32_t phases, ring_phases(variant));
  const size_t count = variant.resources.size();
  state->offsets.resize(count);
  state->images.resize(count);
  state->linear.resize(count);
  state->usages.resize(count);
  state->host_images.resize(count);
  SHALE_TRY_VOID(state->create_tensors());
  SHALE_TRY_VOID(state->create_images());
  SHALE_TRY_VOID(state->create_sets(phases * options.frames_in_flight));
  state->params.resize(param_bytes(variant));
  for (const Param& param : variant.params) state->set(param, param.default_values);
  return FrameLoop(std::move(state));
}

Result<void> FrameLoop::State::create_tensors() {
  const Variant& variant = kernels->variant();
  uint64_t graph_bytes = 0;
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    offsets[i] = resource.offset_bytes;
    if (resource.category != Category::kInput && resource.category != Category::kOutput) continue;
    offsets[i] = graph_bytes;
    graph_bytes = padded_bytes(graph_bytes + resource.size_bytes);
  }
  const auto create = [&](uint64_t bytes) {
    return vk::Buffer::create(kernels->context(), padded_bytes(std::max<uint64_t>(bytes, 1)),
                              kTensorBufferUsage, vk::MemoryKind::kDevice);
  };
  SHALE_TRY(arena, create(variant.arena_bytes));
  SHALE_TRY(graph_tensors, create(graph_bytes));
  return {};
}

Result<void> FrameLoop::State::create_images() {
  const Variant& variant = kernels->variant();
  for (const Step& step : kernels->steps())
    for (const Binding& binding : step.dispatch->bindings)
      usages[binding.resource] |=
          binding.type == BindingType::kStorageImage ? VK_IMAGE_USAGE_STORAGE_BIT
          : binding.type != BindingType::kTransfer   ? VK_IMAGE_USAGE_SAMPLED_BIT
          : binding.writes                           ? VK_IMAGE_USAGE_TRANSFER_DST_BIT
                                                     : VK_IMAGE_USAGE_TRANSFER_SRC_BIT;
  std::vector<VkImageMemoryBarrier> barriers;
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    if (!is_image(resource.category) || is_host_image(resource.category) || !usages[i]) continue;
    for (uint32_t slot = 0; slot < std::max(resource.history_depth, 1u); ++slot) {
      if (is_linear(resource)) {
        SHALE_TRY(linear[i].emplace_back(),
                  vk::Buffer::create(kernels->context(), padded_bytes(resource.size_bytes),
                                     kTensorBufferUsage, vk::MemoryKind::kDevice));
        continue;
      }
      // A view, which every image gets, needs a usage by shaders.
      const VkImageUsageFlags usage =
          usages[i] & kShaderUsages ? usages[i] : usages[i] | VK_IMAGE_USAGE_SAMPLED_BIT;
      auto image = vk::Image::create(kernels->context(), resource.format,
                                     {resource.width, resource.height}, usage);
      if (!image) {
        image.error().where = fmt::format("image \"{}\"", resource.name);
        return std::move(image.error());
      }
      auto barrier = vk::init<VkImageMemoryBarrier>(VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER);
      barrier.oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
      barrier.newLayout = VK_IMAGE_LAYOUT_GENERAL;
      barrier.srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
      barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
      barrier.image = image->get();
      barrier.subresourceRange = vk::kWholeImage;
      barriers.push_back(barrier);
      images[i].push_back(std::move(*image));
    }
  }
  if (barriers.empty()) return {};
  return vk::submit_and_wait(kernels->context(), [&](VkCommandBuffer commands) {
    vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                         VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, 0, 0, nullptr, 0, nullptr,
                         static_cast<uint32_t>(barriers.size()), barriers.data());
  });
}

Result<void> FrameLoop::State::create_sets(uint32_t slots) {
  // A set for each step that is the same in every frame, then one for each slot of the others.
  std::vector<const Step*> owners;
  std::vector<size_t> fixed;
  sets.resize(slots);
  changing_sets.resize(slots);
  slot_bindings.resize(slots);
  std::vector<std::vector<size_t>> index(slots);  // by slot, then by step
  for (const Step& step : kernels->steps()) {
    if (step.is_transfer) continue;
    const bool changes = changes_by_frame(step, kernels->variant());
    if (!changes) fixed.push_back(owners.size());
    for (uint32_t slot = 0; slot < slots; ++slot) {
      if (changes || slot == 0) owners.push_back(&step);
      index[slot].push_back(owners.size() - 1);
      if (changes) changing_sets[slot].push_back(owners.size() - 1);
    }
  }
  SHALE_TRY(descriptors, DescriptorSets::create(*kernels, owners));
  for (uint32_t slot = 0; slot < slots; ++slot) {
    auto next = index[slot].begin();
    for (const Step& step : kernels->steps())
      sets[slot].push_back(step.is_transfer ? VK_NULL_HANDLE : descriptors[*next++]);
  }
  for (const size_t i : fixed)
    SHALE_TRY_VOID(descriptors.write(i, [&](const Binding& binding) { return target(binding); }));
  return {};
}

/// In the ring of an own image, in the frame that is being recorded.
uint32_t FrameLoop::State::slot_of(uint32_t resource, uint32_t frames_back) const {
  // frames_back is below the depth, so the sum never wraps.
  const uint32_t depth = std::max(kernels->variant().resources[resource].history_depth, 1u);
  return static_cast<uint32_t>((frame % depth + depth - frames_back) % depth);
}

/// In the frame that is being recorded.
Target FrameLoop::State::target(const Binding& binding) const {
  const Resource& resource = kernels->variant().resources[binding.resource];
  switch (resource.category) {
    case Category::kInput:
    case Category::kOutput:
      return {.buffer = graph_tensors.get(), .offset = offsets[binding.resource]};
    case Category::kIntermediate:
      return {.buffer = arena.get(), .offset = offsets[binding.resource]};
    case Category::kWeights:
      return {.buffer = kernels->weights(), .offset = offsets[binding.resource]};
    case Category::kImageInput:
    case Category::kImageOutput: {
      const ImageView& host = host_images[binding.resource];
      return {.view = host.view, .image = host.image};
    }
    case Category::kImageInternal:
    case Category::kImageHistory: {
      const uint32_t slot = slot_of(binding.resource, binding.frames_back);
      if (is_linear(resource)) return {.buffer = linear[binding.resource][slot].get()};
      const vk::Image& image = images[binding.resource][slot];
      return {.view = image.view(), .image = image.get()};
    }
  }
  return {};
}

void FrameLoop::State::record_clears(VkCommandBuffer commands) const {
  const VkClearColorValue zero{};
  for (size_t i = 0; i < images.size(); ++i) {
    const Resource& resource = kernels->variant().resources[i];
    // A pass may read what the network gave in the frame before.
    if (resource.category == Category::kOutput)
      vkCmdFillBuffer(commands, graph_tensors.get(), offsets[i], bound_bytes(resource), 0);
    if (resource.category != Category::kImageHistory) continue;
    for (const vk::Buffer& buffer : linear[i])
      vkCmdFillBuffer(commands, buffer.get(), 0, buffer.size_bytes(), 0);
    for (const vk::Image& image : images[i])
      vkCmdClearColorImage(commands, image.get(), VK_IMAGE_LAYOUT_GENERAL, &zero, 1,
                           &vk::kWholeImage);
  }
}

const Variant& FrameLoop::variant() const { return state_->kernels->variant(); }

VkImageUsageFlags FrameLoop::image_usage(std::string_view name) const {
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i)
    if (resources[i].name == name && is_host_image(resources[i].category)) return state_->usages[i];
  return 0;
}

Result<void> FrameLoop::bind_image(std::string_view name, const ImageView& image) {
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i) {
    const Resource& resource = resources[i];
    if (resource.name != name || !is_host_image(resource.category)) continue;
    const std::string where = fmt::format("image \"{}\"", name);
    if (image.view == VK_NULL_HANDLE && (state_->usages[i] & kShaderUsages))
      return bad_input(where, "no view is given");
    if (image.image == VK_NULL_HANDLE && (state_->usages[i] & ~kShaderUsages))
      return bad_input(where, "no VkImage is given, and the package copies it");
    if (image.format != vk::vk_format(resource.format))
      return bad_input(where, "has VkFormat {}, expected {} ({})", static_cast<int>(image.format),
                       static_cast<int>(vk::vk_format(resource.format)),
                       image_format_info(resource.format).name);
    if (image.extent.width != resource.width || image.extent.height != resource.height)
      return bad_input(where, "is {}x{}, expected {}x{}", image.extent.width, image.extent.height,
                       resource.width, resource.height);
    state_->host_images[i] = image;
    ++state_->bindings;  // even for an equal handle: it may be a new view at an old address
    return {};
  }
  return bad_input("", "the package has no input or output image \"{}\"", name);
}

void FrameLoop::State::set(const Param& param, std::span<const float> values) {
  for (size_t i = 0; i < values.size(); ++i) {
    const int32_t whole = static_cast<int32_t>(param.is_integer ? values[i] : 0.0f);
    std::memcpy(&params[param.offset_bytes + 4 * i],
                param.is_integer ? static_cast<const void*>(&whole) : &values[i], 4);
  }
}

Result<void> FrameLoop::set_param(std::string_view name, std::span<const float> values) {
  for (const Param& param : variant().params) {
    if (param.name != name || param.source != ParamSource::kHost) continue;
    const std::string where = fmt::format("parameter \"{}\"", name);
    if (values.size() != param.components)
      return bad_input(where, "{} values are given, expected {}", values.size(), param.components);
    for (const float value : values)
      if (!std::isfinite(value) ||
          (param.is_integer && (value != std::floor(value) || std::abs(value) > 16777216.0f)))
        return bad_input(where, "{} is no {}", value,
                         param.is_integer ? "exact integer" : "finite number");
    state_->set(param, values);
    return {};
  }
  return bad_input("", "the package has no parameter \"{}\"", name);
}

void FrameLoop::reset_history() { state_->clear_history = true; }

Result<void> FrameLoop::record(VkCommandBuffer commands, vk::Timestamps* timestamps) {
  State& state = *state_;
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i)
    if (is_host_image(resources[i].category) && state.usages[i] &&
        state.host_images[i].format == VK_FORMAT_UNDEFINED)
      return bad_input(fmt::format("image \"{}\"", resources[i].name), "is not bound yet");

  // The slot's last frame is at least frames_in_flight back, so the device is done with its sets.
  const size_t slot = state.frame % state.sets.size();
  if (state.slot_bindings[slot] != state.bindings) {
    for (const size_t i : state.changing_sets[slot])
      SHALE_TRY_VOID(state.descriptors.write(
          i, [&](const Binding& binding) { return state.target(binding); }));
    state.slot_bindings[slot] = state.bindings;
  }

  constexpr VkPipelineStageFlags kCompute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
  constexpr VkAccessFlags kUse = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT;
  for (const Param& param : variant().params)
    if (param.source == ParamSource::kReset)
      state.set(param, std::array{state.clear_history ? 1.0f : 0.0f});
  if (state.clear_history) {
    constexpr VkPipelineStageFlags kTransfer = VK_PIPELINE_STAGE_TRANSFER_BIT;
    vk::memory_barrier(commands, kCompute, VK_ACCESS_SHADER_WRITE_BIT, kTransfer,
                       VK_ACCESS_TRANSFER_WRITE_BIT);
    state.record_clears(commands);
    vk::memory_barrier(commands, kCompute | kTransfer,
                       VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT, kCompute, kUse);
    state.clear_history = false;
  }
  state.kernels->barrier(commands);
  record_steps(
      commands, *state.kernels, state.sets[slot], state.params,
      [&](const Binding& binding) { return state.target(binding); }, timestamps);
  // The host waits for shaders, whatever wrote its images.
  if (state.kernels->has_transfers()) state.kernels->barrier(commands);
  ++state.frame;
  return {};
}

uint64_t FrameLoop::frame() const { return state_->frame; }

Result<TensorView> FrameLoop::tensor(std::string_view name) const {
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i) {
    const Resource& resource = resources[i];
    if (resource.name == name &&
        (resource.category == Category::kInput || resource.category == Category::kOutput))
      return TensorView{state_->graph_tensors.get(), state_->offsets[i], bound_bytes(resource)};
    if (resource.name == name && !state_->linear[i].empty())
      return TensorView{state_->last(state_->linear[i]).get(), 0, resource.size_bytes};
  }
  return bad_input("", "the network has no input or output \"{}\"", name);
}

Result<VkImage> FrameLoop::image(std::string_view name) const {
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i) {
    if (resources[i].name != name || state_->images[i].empty()) continue;
    return state_->last(state_->images[i]).get();
  }
  return bad_input("", "the frame loop has no image \"{}\"", name);
}

}  // namespace shale
