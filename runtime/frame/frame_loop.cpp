#include "runtime/frame/frame_loop.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "runtime/datagraph/dispatch.h"
#include "runtime/vk/commands.h"

namespace shale {
namespace {

constexpr uint32_t kMaxFramesInFlight = 8;
/// Of the tensors of all graphs together: keeps sums of stated sizes far from an overflow.
constexpr uint64_t kMaxTensorPoolBytes = uint64_t{1} << 48;
constexpr uint64_t kMaxFrames = uint64_t{1} << 24;  // that are counted; a float holds it
constexpr uint64_t kGridBytes = 3 * sizeof(uint32_t);
constexpr VkImageUsageFlags kShaderUsages = VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT;

/// Leads to different memory in different records, so its set depends on the record.
bool changes(const Step& step, const Variant& variant) {
  if (step.is_transfer) return false;  // has no set
  return std::ranges::any_of(step.dispatch->bindings, [&](const Binding& binding) {
    const Resource& resource = variant.resources[binding.resource];
    return is_host_image(resource.category) || resource.history_depth > 1;
  });
}

VkImageUsageFlags usage_of(const Binding& binding) {
  if (is_sampled(binding.type)) return VK_IMAGE_USAGE_SAMPLED_BIT;
  if (binding.type == BindingType::kStorageImage) return VK_IMAGE_USAGE_STORAGE_BIT;
  if (binding.type != BindingType::kTransfer) return 0;
  return binding.writes ? VK_IMAGE_USAGE_TRANSFER_DST_BIT : VK_IMAGE_USAGE_TRANSFER_SRC_BIT;
}

/// What the records of a program that are in flight keep apart.
struct Slot {
  std::vector<StepSets> sets;       // by step
  std::vector<size_t> own_sets;     // those that no other slot has, as indices of descriptors
  std::vector<uint32_t> positions;  // of the program's histories when own_sets were written
  uint64_t bindings = 0;            // State::bindings when they were written; 0 is never
  vk::Buffer commands;              // of a program that runs in parts: what its indirect_grids held
};

struct Program {
  std::vector<bool> uses, writes;   // by resource
  std::vector<uint32_t> histories;  // resources
  std::vector<Slot> slots;
  uint64_t records = 0;
  bool is_reset = true;  // the next record is the first one since the histories were cleared
  bool runs_all = true;  // in the next record, where there are Tiles
};

}  // namespace

struct FrameLoop::State {
  std::unique_ptr<Kernels> kernels;
  vk::Buffer arena;
  vk::Buffer graph_tensors;                     // inputs and outputs of graphs
  std::vector<uint64_t> offsets;                // of tensors in their buffer, by resource
  std::vector<std::vector<vk::Image>> images;   // own ones, by resource: one, or the ring
  std::vector<std::vector<vk::Buffer>> linear;  // own linear ones, as `images`
  std::vector<VkImageUsageFlags> usages;        // by resource: of images, as steps use them; or 0
  std::vector<ImageView> host_images;           // by resource
  std::vector<uint64_t> written;                // by resource: records that wrote the history

  DescriptorSets descriptors;
  std::vector<Program> programs;
  uint64_t bindings = 1;  // grows with each bind_image

  std::vector<uint8_t> params;  // push constants of the passes
  uint64_t frame = 0;
  uint64_t rendered = 0;  // frames since the histories were cleared
  float time = 1;         // of the picture that is generated
  bool clear_history = true;
  uint32_t chosen = 0, last = 0;  // programs: where a parameter chooses; the one recorded last

  Result<void> create_tensors();
  Result<void> create_images();
  void create_programs();
  Result<void> create_sets(uint32_t frames_in_flight);
  Result<void> create_command_copies();
  std::span<const Segment> segments(const Program& program) const {
    return program_segments(kernels->variant(), static_cast<uint32_t>(&program - programs.data()));
  }
  uint32_t position(const Program& program, uint32_t resource, uint32_t frames_back) const;
  Result<void> update_sets(const Program& program, Slot& slot);
  void set(const Param& param, std::span<const float> values);
  Target target(const Program& program, const Binding& binding) const;
  void record_start(VkCommandBuffer commands) const;
  void record_clears(VkCommandBuffer commands) const;
  void copy_commands(VkCommandBuffer commands, const Program& program, const Slot& slot) const;
  Result<void> record(uint32_t index, VkCommandBuffer commands, vk::Timestamps* timestamps);
  bool generates(uint32_t program) const {
    const std::optional<Generator>& generator = kernels->variant().generator;
    return generator && generator->program == program;
  }
  /// Bytes from one slot of a tensor's ring to the next.
  uint64_t slot_bytes(const Resource& tensor) const { return padded_bytes(tensor.size_bytes); }
  /// The position of what was written last; of what is no history, 0.
  size_t newest(size_t resource) const {
    const uint32_t depth = kernels->variant().resources[resource].history_depth;
    return depth == 0 ? 0 : (written[resource] + depth - 1) % depth;
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
  const auto all_programs =
      [](const Variant& variant) -> Result<std::vector<std::span<const Segment>>> {
    std::vector<std::span<const Segment>> programs;
    for (uint32_t i = 0; i < variant.programs.size(); ++i)
      programs.push_back(program_segments(variant, i));
    return programs;
  };
  auto state = std::make_unique<State>();
  SHALE_TRY(state->kernels, Kernels::create(context, package, all_programs,
                                            {options.cache, options.compile, options.threads}));
  const Variant& variant = state->kernels->variant();
  const size_t count = variant.resources.size();
  state->offsets.resize(count);
  state->images.resize(count);
  state->linear.resize(count);
  state->usages.resize(count);
  state->host_images.resize(count);
  state->written.resize(count);
  state->create_programs();
  SHALE_TRY_VOID(state->create_tensors());
  SHALE_TRY_VOID(state->create_images());
  SHALE_TRY_VOID(state->create_sets(options.frames_in_flight));
  SHALE_TRY_VOID(state->create_command_copies());
  state->params.resize(param_bytes(variant));
  for (const Param& param : variant.params) state->set(param, param.default_values);
  return FrameLoop(std::move(state));
}

void FrameLoop::State::create_programs() {
  const std::vector<Resource>& resources = kernels->variant().resources;
  programs.resize(kernels->program_count());
  for (size_t p = 0; p < programs.size(); ++p) {
    Program& program = programs[p];
    program.uses.resize(resources.size());
    program.writes.resize(resources.size());
    for (const Step& step : kernels->steps(p))
      for (const Binding& binding : step.dispatch->bindings) {
        program.uses[binding.resource] = true;
        if (binding.writes) program.writes[binding.resource] = true;
        usages[binding.resource] |= usage_of(binding);
      }
    for (uint32_t i = 0; i < resources.size(); ++i)
      if (program.uses[i] && resources[i].history_depth != 0) program.histories.push_back(i);
  }
}

Result<void> FrameLoop::State::create_tensors() {
  const Variant& variant = kernels->variant();
  uint64_t graph_bytes = 0;
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    offsets[i] = resource.offset_bytes;
    if (!is_graph_tensor(resource.category)) continue;
    offsets[i] = graph_bytes;
    graph_bytes += slot_bytes(resource) * std::max(resource.history_depth, 1u);
    if (graph_bytes > kMaxTensorPoolBytes)
      return device_error("", "inputs and outputs of more than {} bytes do not fit any device",
                          kMaxTensorPoolBytes);
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
  for (size_t i = 0; i < variant.resources.size(); ++i) {
    const Resource& resource = variant.resources[i];
    const bool used =
        std::ranges::any_of(programs, [&](const Program& program) { return program.uses[i]; });
    if (!is_image(resource.category) || is_host_image(resource.category) || !used) continue;
    for (uint32_t slot = 0; slot < std::max(resource.history_depth, 1u); ++slot) {
      if (is_linear(resource)) {
        SHALE_TRY(linear[i].emplace_back(),
                  vk::Buffer::create(kernels->context(), padded_bytes(resource.size_bytes),
                                     kTensorBufferUsage | VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT,
                                     vk::MemoryKind::kDevice));
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
      images[i].push_back(std::move(*image));
    }
  }
  return {};
}

Result<void> FrameLoop::State::create_sets(uint32_t frames_in_flight) {
  // A set for each step that is the same in every record, then one for each slot of the others.
  std::vector<const Step*> owners;
  std::vector<std::pair<size_t, const Program*>> fixed;
  std::vector<std::pair<VkDescriptorSet*, size_t>> places;
  for (size_t p = 0; p < programs.size(); ++p) {
    Program& program = programs[p];
    const std::span<const Step> steps = kernels->steps(p);
    program.slots.resize(frames_in_flight);
    for (Slot& slot : program.slots) slot.sets.resize(steps.size());
    for (size_t i = 0; i < steps.size(); ++i) {
      if (steps[i].is_transfer) continue;
      for (const Step* step : {&steps[i], steps[i].start}) {
        if (!step) continue;
        const bool own = changes(*step, kernels->variant());
        if (!own) fixed.emplace_back(owners.size(), &program);
        for (Slot& slot : program.slots) {
          if (own || &slot == &program.slots[0]) owners.push_back(step);
          if (own) slot.own_sets.push_back(owners.size() - 1);
          places.emplace_back(step == &steps[i] ? &slot.sets[i].own : &slot.sets[i].start,
                              owners.size() - 1);
        }
      }
    }
  }
  SHALE_TRY(descriptors, DescriptorSets::create(*kernels, owners));
  for (const auto& [set, index] : places) *set = descriptors[index];
  for (const auto& [index, program] : fixed)
    SHALE_TRY_VOID(descriptors.write(
        index, [&, of = program](const Binding& binding) { return target(*of, binding); }));
  return {};
}

Result<void> FrameLoop::State::create_command_copies() {
  for (Program& program : programs) {
    const size_t grids = indirect_grids(segments(program)).size();
    // Those of a promise choose between forms, which says nothing of how much ran.
    if (grids == 0 ||
        (kernels->variant().promise &&
         std::ranges::none_of(segments(program), [](const Segment& each) { return !!each.tiles; })))
      continue;
    for (Slot& slot : program.slots) {
      SHALE_TRY(slot.commands,
                vk::Buffer::create(kernels->context(), grids * kGridBytes,
                                   VK_BUFFER_USAGE_TRANSFER_DST_BIT, vk::MemoryKind::kReadback));
    }
  }
  return {};
}

/// In the ring of a history, in the record of `program` that is being made; 0 of all else.
uint32_t FrameLoop::State::position(const Program& program, uint32_t resource,
                                    uint32_t frames_back) const {
  const uint32_t depth = kernels->variant().resources[resource].history_depth;
  if (depth == 0) return 0;
  // frames_back is below the depth, so the sum never wraps.
  const uint32_t back = frames_back + (program.writes[resource] ? 0 : 1);
  return static_cast<uint32_t>((written[resource] % depth + depth - back) % depth);
}

/// In the record of `program` that is being made.
Target FrameLoop::State::target(const Program& program, const Binding& binding) const {
  const uint32_t index = binding.resource;
  const Resource& resource = kernels->variant().resources[index];
  const uint32_t slot = position(program, index, binding.frames_back);
  switch (resource.category) {
    case Category::kInput:
    case Category::kOutput:
      return {.buffer = graph_tensors.get(),
              .offset = offsets[index] + slot * slot_bytes(resource)};
    case Category::kIntermediate: return {.buffer = arena.get(), .offset = offsets[index]};
    case Category::kWeights: return {.buffer = kernels->weights(), .offset = offsets[index]};
    case Category::kImageInput:
    case Category::kImageOutput:
      return {.view = host_images[index].view, .image = host_images[index].image};
    case Category::kImageInternal:
    case Category::kImageHistory:
      if (is_linear(resource)) return {.buffer = linear[index][slot].get()};
      return {.view = images[index][slot].view(), .image = images[index][slot].get()};
  }
  return {};
}

/// The slot's last record is at least frames_in_flight back, so the device is done with its sets.
Result<void> FrameLoop::State::update_sets(const Program& program, Slot& slot) {
  std::vector<uint32_t> positions;
  for (const uint32_t resource : program.histories)
    positions.push_back(position(program, resource, 0));
  if (slot.bindings == bindings && slot.positions == positions) return {};
  slot.bindings = 0;  // until all are written
  for (const size_t i : slot.own_sets)
    SHALE_TRY_VOID(
        descriptors.write(i, [&](const Binding& binding) { return target(program, binding); }));
  slot.bindings = bindings;
  slot.positions = std::move(positions);
  return {};
}

/// What has to be done once.
void FrameLoop::State::record_start(VkCommandBuffer commands) const {
  kernels->record_upload(commands);
  std::vector<VkImageMemoryBarrier> barriers;
  for (const std::vector<vk::Image>& ring : images)
    for (const vk::Image& image : ring) {
      auto barrier = vk::init<VkImageMemoryBarrier>(VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER);
      barrier.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT |
                              VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
      barrier.oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
      barrier.newLayout = VK_IMAGE_LAYOUT_GENERAL;
      barrier.srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
      barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
      barrier.image = image.get();
      barrier.subresourceRange = vk::kWholeImage;
      barriers.push_back(barrier);
    }
  if (barriers.empty()) return;
  kernels->context().vk.CmdPipelineBarrier(
      commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
      VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0, nullptr, 0,
      nullptr, static_cast<uint32_t>(barriers.size()), barriers.data());
}

void FrameLoop::State::record_clears(VkCommandBuffer commands) const {
  constexpr VkPipelineStageFlags kCompute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                                 kTransfer = VK_PIPELINE_STAGE_TRANSFER_BIT;
  constexpr VkAccessFlags kShader = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT,
                          kWrites = VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
  const vk::Context& context = kernels->context();
  const VkClearColorValue zero{};
  vk::memory_barrier(context, commands, kCompute | kTransfer, kWrites, kTransfer,
                     VK_ACCESS_TRANSFER_WRITE_BIT);
  for (size_t i = 0; i < images.size(); ++i) {
    const Resource& resource = kernels->variant().resources[i];
    const uint32_t depth = resource.history_depth;
    // A pass may read what the network gave in the frame before.
    if (resource.category == Category::kOutput || (is_graph_tensor(resource.category) && depth))
      for (uint32_t slot = 0; slot < std::max(depth, 1u); ++slot)
        context.vk.CmdFillBuffer(commands, graph_tensors.get(),
                                 offsets[i] + slot * slot_bytes(resource), bound_bytes(resource),
                                 0);
    if (resource.category != Category::kImageHistory) continue;
    for (const vk::Buffer& buffer : linear[i])
      context.vk.CmdFillBuffer(commands, buffer.get(), 0, buffer.size_bytes(), 0);
    for (const vk::Image& image : images[i])
      context.vk.CmdClearColorImage(commands, image.get(), VK_IMAGE_LAYOUT_GENERAL, &zero, 1,
                                    &vk::kWholeImage);
  }
  vk::memory_barrier(context, commands, kCompute | kTransfer, kWrites, kCompute, kShader);
}

void FrameLoop::State::copy_commands(VkCommandBuffer commands, const Program& program,
                                     const Slot& slot) const {
  kernels->barrier(commands);
  uint64_t at = 0;
  for (const IndirectGrid& grid : indirect_grids(segments(program))) {
    const Target words = target(program, {.resource = grid.resource});
    const VkBufferCopy copy{words.offset + grid.first * sizeof(uint32_t), at, kGridBytes};
    kernels->context().vk.CmdCopyBuffer(commands, words.buffer, slot.commands.get(), 1, &copy);
    at += kGridBytes;
  }
  vk::memory_barrier(kernels->context(), commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                     VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                     VK_ACCESS_HOST_READ_BIT);
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
  if (param.name == kernels->variant().chosen_by)
    chosen = chosen_program(kernels->variant(), values);
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

void FrameLoop::reset_history() {
  state_->clear_history = true;
  state_->rendered = 0;
  for (Program& program : state_->programs) program.is_reset = program.runs_all = true;
}

std::optional<uint32_t> FrameLoop::next_program() const {
  if (variant().generator) return 1 - variant().generator->program;
  if (state_->programs.size() > 1 && variant().chosen_by.empty()) return std::nullopt;
  return state_->chosen;
}

Result<void> FrameLoop::record(VkCommandBuffer commands, vk::Timestamps* timestamps) {
  const std::optional<uint32_t> program = next_program();
  if (!program)
    return bad_input("", "the package has {} programs, and none is named", state_->programs.size());
  return record(*program, commands, timestamps);
}

Result<void> FrameLoop::record(std::string_view program, VkCommandBuffer commands,
                               vk::Timestamps* timestamps) {
  const std::vector<std::string>& names = variant().programs;
  const auto found = std::ranges::find(names, program);
  if (found == names.end()) return bad_input("", "the package has no program \"{}\"", program);
  return record(static_cast<uint32_t>(found - names.begin()), commands, timestamps);
}

Result<void> FrameLoop::record(uint32_t program, VkCommandBuffer commands,
                               vk::Timestamps* timestamps) {
  if (program >= state_->programs.size())
    return bad_input("", "the package has no program {}, there are {}", program,
                     state_->programs.size());
  if (state_->generates(program))
    return bad_input("", "program \"{}\" makes pictures between frames: it needs a time",
                     variant().programs[program]);
  return state_->record(program, commands, timestamps);
}

Result<void> FrameLoop::generate(float time, VkCommandBuffer commands, vk::Timestamps* timestamps) {
  const std::optional<Generator>& generator = variant().generator;
  if (!generator) return bad_input("", "the package has no program that generates pictures");
  if (!(time > generator->after && time <= generator->until))
    return bad_input("",
                     "a picture at time {} is asked for, the package takes times above {} up to {}",
                     time, generator->after, generator->until);
  if (state_->rendered == 0)
    return bad_input("", "no frame was rendered since the histories were reset");
  state_->time = time;
  return state_->record(generator->program, commands, timestamps);
}

Result<void> FrameLoop::State::record(uint32_t index, VkCommandBuffer commands,
                                      vk::Timestamps* timestamps) {
  const Variant& variant = kernels->variant();
  Program& program = programs[index];
  const std::span<const Step> steps = kernels->steps(index);
  for (size_t i = 0; i < variant.resources.size(); ++i)
    if (program.uses[i] && is_host_image(variant.resources[i].category) &&
        host_images[i].format == VK_FORMAT_UNDEFINED)
      return bad_input(fmt::format("image \"{}\"", variant.resources[i].name), "is not bound yet");
  SHALE_TRY_VOID(check_timestamps(timestamps, steps.size()));
  Slot& slot = program.slots[program.records % program.slots.size()];
  // The slot was used in the first record of all or later, and that is finished.
  if (program.records >= program.slots.size()) kernels->release_staging();
  SHALE_TRY_VOID(update_sets(program, slot));

  // From here on nothing fails.
  if (frame == 0) record_start(commands);
  const bool makes_picture = generates(index);
  if (!makes_picture) rendered = std::min(rendered + 1, kMaxFrames);
  for (const Param& param : variant.params) {
    if (param.source == ParamSource::kReset) set(param, std::array{program.is_reset ? 1.0f : 0.0f});
    if (param.source == ParamSource::kTime) set(param, std::array{makes_picture ? time : 1.0f});
    if (param.source == ParamSource::kFrames) set(param, std::array{static_cast<float>(rendered)});
  }
  if (clear_history) record_clears(commands);
  clear_history = false;
  program.is_reset = false;
  if (!variant.chosen_by.empty())  // the programs are forms of one frame
    for (Program& other : programs) other.is_reset = false;
  kernels->barrier(commands);
  record_steps(
      commands, *kernels, steps, slot.sets, params,
      [&](const Binding& binding) { return target(program, binding); }, program.runs_all,
      timestamps);
  if (slot.commands) copy_commands(commands, program, slot);
  for (Program& other : programs)
    for (size_t i = 0; i < variant.resources.size(); ++i)
      if (program.writes[i] && other.writes[i] && is_graph_tensor(variant.resources[i].category))
        other.runs_all = true;
  program.runs_all = false;
  // The host waits for shaders, whatever wrote its images.
  if (kernels->has_transfers()) kernels->barrier(commands);
  for (const uint32_t resource : program.histories)
    if (program.writes[resource]) ++written[resource];
  ++program.records;
  last = index;
  ++frame;
  return {};
}

std::optional<double> FrameLoop::share_run(uint32_t records_ago) const {
  const Program& program = state_->programs[state_->last];
  if (records_ago >= program.slots.size() || records_ago >= program.records) return std::nullopt;
  const Slot& slot = program.slots[(program.records - 1 - records_ago) % program.slots.size()];
  if (!slot.commands) return std::nullopt;
  const std::span<const uint8_t> bytes = slot.commands.mapped();
  return shale::share_run(
      state_->segments(program),
      {reinterpret_cast<const uint32_t*>(bytes.data()), bytes.size() / sizeof(uint32_t)});
}

uint64_t FrameLoop::frame() const { return state_->frame; }
size_t FrameLoop::kernels_left() const { return state_->kernels->left(); }
Result<bool> FrameLoop::compile_one() { return state_->kernels->compile_one(); }
Result<void> FrameLoop::finish() { return state_->kernels->finish(); }

MemoryUse FrameLoop::memory_use() const {
  const vk::Upload& weights = state_->kernels->weight_memory();
  MemoryUse use{.weights = weights.buffer.memory_bytes(),
                .arena = state_->arena.memory_bytes(),
                .tensors = state_->graph_tensors.memory_bytes(),
                .staging = weights.staging.memory_bytes()};
  for (const std::vector<vk::Image>& ring : state_->images)
    for (const vk::Image& image : ring) use.images += image.memory_bytes();
  for (const std::vector<vk::Buffer>& ring : state_->linear)
    for (const vk::Buffer& buffer : ring) use.images += buffer.memory_bytes();
  return use;
}

Result<TensorView> FrameLoop::tensor(std::string_view name) const {
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i) {
    const Resource& resource = resources[i];
    if (resource.name != name) continue;
    const size_t slot = state_->newest(i);
    if (is_graph_tensor(resource.category))
      return TensorView{state_->graph_tensors.get(),
                        state_->offsets[i] + slot * state_->slot_bytes(resource),
                        bound_bytes(resource)};
    if (!state_->linear[i].empty())
      return TensorView{state_->linear[i][slot].get(), 0, resource.size_bytes};
  }
  return bad_input("", "the network has no input or output \"{}\"", name);
}

Result<VkImage> FrameLoop::image(std::string_view name) const {
  const std::vector<Resource>& resources = variant().resources;
  for (size_t i = 0; i < resources.size(); ++i)
    if (resources[i].name == name && !state_->images[i].empty())
      return state_->images[i][state_->newest(i)].get();
  return bad_input("", "the frame loop has no image \"{}\"", name);
}

}  // namespace shale
