#include "runtime/datagraph/session.h"

#include "runtime/datagraph/dispatch.h"

namespace shale {

struct Session::State {
  const Kernels* kernels = nullptr;
  vk::MemoryHandle own_memory;  // freed after the arena; empty if the user brought the memory
  vk::BufferHandle arena;       // empty if the graph needs none
  VkMemoryRequirements arena_requirements{};
  bool arena_bound = false;
  std::vector<VkBuffer> buffers;  // by resource; null until bound
  std::vector<uint64_t> offsets;  // of the tensor in its buffer, by resource
  DescriptorSets descriptors;
  size_t set_count = 0;
  std::vector<StepSets> sets;  // by step
  bool descriptors_written = false;
  bool runs_all = true;  // in the next record, where there are Tiles

  TargetOf target() const {
    return [this](const Binding& binding) {
      return Target{.buffer = buffers[binding.resource], .offset = offsets[binding.resource]};
    };
  }
};

Session::Session(std::unique_ptr<State> state) : state_(std::move(state)) {}
Session::Session(Session&&) noexcept = default;
Session& Session::operator=(Session&&) noexcept = default;
Session::~Session() = default;

Result<Session> Session::create(const DataGraphPipeline& pipeline) {
  auto state = std::make_unique<State>();
  const Kernels& kernels = *pipeline.kernels_;
  const Variant& variant = kernels.variant();
  state->kernels = &kernels;
  state->buffers.resize(variant.resources.size());
  state->offsets.resize(variant.resources.size());
  std::vector<const Step*> steps;
  for (const Step& step : kernels.steps(0)) {
    steps.push_back(&step);
    if (step.start) steps.push_back(step.start);
  }
  SHALE_TRY(state->descriptors, DescriptorSets::create(kernels, steps));
  state->set_count = steps.size();
  size_t set = 0;
  for (const Step& step : kernels.steps(0)) {
    StepSets& own = state->sets.emplace_back(StepSets{state->descriptors[set++]});
    if (step.start) own.start = state->descriptors[set++];
  }

  if (variant.arena_bytes > 0) {
    const vk::Context& context = kernels.context();
    auto info = vk::init<VkBufferCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO);
    info.size = padded_bytes(variant.arena_bytes);
    info.usage = kTensorBufferUsage;
    SHALE_TRY(state->arena, vk::make(context.vk.CreateBuffer, context.vk.DestroyBuffer,
                                     "vkCreateBuffer", context.device, info));
    context.vk.GetBufferMemoryRequirements(context.device, state->arena.get(),
                                           &state->arena_requirements);
  }
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    if (resource.category == Category::kIntermediate) state->buffers[i] = state->arena.get();
    if (resource.category == Category::kWeights) state->buffers[i] = kernels.weights();
    state->offsets[i] = resource.offset_bytes;
  }
  return Session(std::move(state));
}

std::vector<BindPoint> Session::memory_requirements() const {
  if (!state_->arena) return {};
  return {{"arena", state_->arena_requirements}};
}

Result<void> Session::bind_memory(VkDeviceMemory memory, uint64_t offset) {
  if (!state_->arena) return bad_input("arena", "the graph needs no memory");
  if (state_->arena_bound) return bad_input("arena", "has its memory already");
  if (offset % state_->arena_requirements.alignment != 0)
    return bad_input("arena", "offset {} is no multiple of {}", offset,
                     state_->arena_requirements.alignment);
  const vk::Context& context = state_->kernels->context();
  SHALE_TRY_VOID(
      vk::check(context.vk.BindBufferMemory(context.device, state_->arena.get(), memory, offset),
                "vkBindBufferMemory"));
  state_->arena_bound = true;
  return {};
}

Result<void> Session::allocate_memory() {
  if (!state_->arena) return {};
  if (state_->arena_bound) return bad_input("arena", "has its memory already");
  SHALE_TRY(state_->own_memory, vk::allocate(state_->kernels->context(), state_->arena_requirements,
                                             vk::MemoryKind::kDevice));
  return bind_memory(state_->own_memory.get(), 0);
}

uint64_t Session::tensor_alignment() const { return state_->kernels->tensor_alignment(); }

Result<void> Session::bind_tensor(std::string_view name, const TensorView& tensor) {
  const std::vector<Resource>& resources = state_->kernels->variant().resources;
  for (size_t i = 0; i < resources.size(); ++i) {
    const Resource& resource = resources[i];
    if (resource.name != name) continue;
    const std::string where = fmt::format("tensor \"{}\"", name);
    if (resource.category != Category::kInput && resource.category != Category::kOutput)
      return bad_input(where, "is neither input nor output");
    if (tensor.buffer == VK_NULL_HANDLE) return bad_input(where, "no buffer is given");
    if (tensor.size_bytes < bound_bytes(resource))
      return bad_input(where, "{} bytes are given, expected at least {}", tensor.size_bytes,
                       bound_bytes(resource));
    if (tensor.offset % tensor_alignment() != 0)
      return bad_input(where, "offset {} is no multiple of {}", tensor.offset, tensor_alignment());
    state_->buffers[i] = tensor.buffer;
    state_->offsets[i] = tensor.offset;
    state_->descriptors_written = false;
    state_->runs_all = true;
    return {};
  }
  return bad_input("", "the network has no input or output \"{}\"", name);
}

Result<void> Session::update() {
  if (state_->descriptors_written) return {};
  const Kernels& kernels = *state_->kernels;
  if (state_->arena && !state_->arena_bound) return bad_input("arena", "has no memory yet");
  for (const Step& step : kernels.steps(0))
    for (const Binding& binding : step.dispatch->bindings)
      if (state_->buffers[binding.resource] == VK_NULL_HANDLE)
        return bad_input(
            fmt::format("tensor \"{}\"", kernels.variant().resources[binding.resource].name),
            "is not bound yet");
  for (size_t i = 0; i < state_->set_count; ++i)
    SHALE_TRY_VOID(state_->descriptors.write(i, state_->target()));
  state_->descriptors_written = true;
  return {};
}

Result<void> Session::record(VkCommandBuffer commands, vk::Timestamps* timestamps) {
  const Kernels& kernels = *state_->kernels;
  const std::span<const Step> steps = kernels.steps(0);
  SHALE_TRY_VOID(check_timestamps(timestamps, steps.size()));
  if (!state_->descriptors_written && !kernels.update_after_bind()) SHALE_TRY_VOID(update());
  kernels.record_upload(commands);
  record_steps(commands, kernels, steps, state_->sets, {}, state_->target(), state_->runs_all,
               timestamps);
  state_->runs_all = false;
  return {};
}

void Session::run_all() { state_->runs_all = true; }

Result<TensorView> Session::commands() const {
  const Segment* segment = state_->kernels->steps(0).front().segment;
  if (!segment->tiles) return bad_input("", "the graph does not work by tiles");
  if (!state_->arena_bound) return bad_input("arena", "has no memory yet");
  return TensorView{state_->arena.get(), state_->offsets[segment->tiles->work],
                    state_->kernels->variant().resources[segment->tiles->work].size_bytes};
}

}  // namespace shale
