#include "runtime/datagraph/dispatch.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <thread>

#include "ir/base/parallel.h"
#include "ir/package/rank.h"
#include "runtime/vk/commands.h"

namespace shale {
namespace {

/// Modules of so many words in all keep lavapipe busy for some ten seconds.
constexpr size_t kLongCompileWords = 500000;

VkDescriptorType descriptor_type(BindingType type) {
  switch (type) {
    case BindingType::kStorageBuffer: return VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    case BindingType::kUniformTexelBuffer: return VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER;
    case BindingType::kSampledImage: return VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
    case BindingType::kStorageImage: return VK_DESCRIPTOR_TYPE_STORAGE_IMAGE;
    case BindingType::kSampler: return VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
    case BindingType::kTransfer: break;
  }
  return VK_DESCRIPTOR_TYPE_MAX_ENUM;
}

/// Descriptor types by binding number, bytes of push constants: dispatches with equal ones share a
/// layout.
struct LayoutKey {
  std::map<uint32_t, VkDescriptorType> types;
  uint32_t push_bytes = 0;
  auto operator<=>(const LayoutKey&) const = default;
};

LayoutKey layout_key(const Dispatch& dispatch, uint32_t push_bytes) {
  LayoutKey key{{}, push_bytes};
  for (const Binding& binding : dispatch.bindings)
    key.types[binding.binding] = descriptor_type(binding.type);
  return key;
}

/// As BindingType::kSampler says.
Result<vk::SamplerHandle> create_sampler(const vk::Context& context) {
  auto info = vk::init<VkSamplerCreateInfo>(VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO);
  info.magFilter = VK_FILTER_LINEAR;
  info.minFilter = VK_FILTER_LINEAR;
  info.mipmapMode = VK_SAMPLER_MIPMAP_MODE_NEAREST;
  info.addressModeU = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  info.addressModeV = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  info.addressModeW = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  return vk::make(context.vk.CreateSampler, context.vk.DestroySampler, "vkCreateSampler",
                  context.device, info);
}

Result<vk::SetLayoutHandle> create_set_layout(const vk::Context& context, const LayoutKey& key,
                                              VkSampler sampler, bool update_after_bind) {
  std::vector<VkDescriptorSetLayoutBinding> bindings;
  for (const auto& [number, type] : key.types)  // the sampler counts for those that have one
    bindings.push_back({number, type, 1, VK_SHADER_STAGE_COMPUTE_BIT, &sampler});
  auto info = vk::init<VkDescriptorSetLayoutCreateInfo>(
      VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO);
  info.bindingCount = static_cast<uint32_t>(bindings.size());
  info.pBindings = bindings.data();
  auto flag_info = vk::init<VkDescriptorSetLayoutBindingFlagsCreateInfo>(
      VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_BINDING_FLAGS_CREATE_INFO);
  const std::vector<VkDescriptorBindingFlags> flags(bindings.size(),
                                                    VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT);
  flag_info.bindingCount = info.bindingCount;
  flag_info.pBindingFlags = flags.data();
  if (update_after_bind) {
    info.flags = VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT;
    info.pNext = &flag_info;
  }
  return vk::make(context.vk.CreateDescriptorSetLayout, context.vk.DestroyDescriptorSetLayout,
                  "vkCreateDescriptorSetLayout", context.device, info);
}

Result<vk::PipelineLayoutHandle> create_layout(const vk::Context& context,
                                               VkDescriptorSetLayout set_layout,
                                               uint32_t push_bytes) {
  auto info = vk::init<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
  info.setLayoutCount = 1;
  info.pSetLayouts = &set_layout;
  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, push_bytes};
  info.pushConstantRangeCount = push_bytes > 0 ? 1 : 0;
  info.pPushConstantRanges = &range;
  return vk::make(context.vk.CreatePipelineLayout, context.vk.DestroyPipelineLayout,
                  "vkCreatePipelineLayout", context.device, info);
}

}  // namespace

Result<uint32_t> choose_variant(const Package& package, const DeviceCaps& caps) {
  std::string reasons;
  for (const RankedVariant& ranked : rank_variants(package.variants, caps)) {
    if (ranked.missing.empty()) return ranked.index;
    reasons += fmt::format("{} variant {} \"{}\": {}", reasons.empty() ? "" : ";", ranked.index,
                           package.variants[ranked.index].target, fmt::join(ranked.missing, ", "));
  }
  return device_error(caps.name, "runs no variant of the package:{}", reasons);
}

Result<std::unique_ptr<Kernels>> Kernels::create(const vk::Context& context, const Package& package,
                                                 const Selection& select,
                                                 const PipelineOptions& options) {
  SHALE_TRY_VOID(check_package(package));
  SHALE_TRY(const uint32_t index, choose_variant(package, context.caps));
  const Variant& variant = package.variants[index];
  std::unique_ptr<Kernels> result(new Kernels);
  result->context_ = context;
  result->update_after_bind_ = options.update_after_bind;
  result->variant_ = variant;
  result->variant_.modules.clear();

  SHALE_TRY(const auto programs, select(result->variant_));
  std::vector<Wanted> dispatches;
  std::vector<bool> barriers;
  for (const std::span<const Segment> segments : programs) {
    result->program_begins_.push_back(dispatches.size());
    std::vector<std::vector<Access>> touched;
    for (const Segment& segment : segments) {
      const bool is_graph = segment.kind == SegmentKind::kGraph;
      auto start = segment.start_forms.begin();
      for (const Dispatch& dispatch : segment.dispatches) {
        dispatches.push_back({&segment, &dispatch, is_graph ? 0 : param_bytes(variant)});
        if (start != segment.start_forms.end() && &segment.dispatches[start->dispatch] == &dispatch)
          dispatches.back().start = &(start++)->form;
        touched.push_back(accesses(result->variant_, dispatch));
      }
    }
    std::ranges::copy(plan_barriers(touched), std::back_inserter(barriers));
  }
  result->program_begins_.push_back(dispatches.size());
  SHALE_TRY_VOID(result->create_pipelines(package, variant, dispatches, options));
  for (size_t i = 0; i < barriers.size(); ++i) result->steps_[i].barrier_before = barriers[i];

  if (!package.weights.empty()) {
    SHALE_TRY(result->weights_,
              vk::upload(context, package.weights, padded_bytes(package.weights.size()),
                         kTensorBufferUsage));
  }
  return result;
}

Result<void> Kernels::create_pipelines(const Package& package, const Variant& variant,
                                       std::span<const Wanted> dispatches,
                                       const PipelineOptions& options) {
  struct Unique {
    uint32_t module;
    size_t layout;
    const Wanted* first;    // step that it is for
    bool is_early = false;  // a step has nothing else
  };
  std::map<LayoutKey, size_t> layout_index;
  std::map<std::pair<uint32_t, size_t>, size_t> pipeline_index;
  std::vector<Unique> wanted;
  std::vector<std::optional<size_t>> pipeline_of_step;
  std::vector<size_t> pipeline_of_start;
  const auto has_sampler = [](const Wanted& each) {
    return std::ranges::any_of(each.dispatch->bindings, [](const Binding& binding) {
      return binding.type == BindingType::kSampler;
    });
  };
  if (std::ranges::any_of(dispatches, has_sampler)) {
    SHALE_TRY(sampler_, create_sampler(context_));
  }
  /// A step without a pipeline, and the number of that.
  const auto prepare = [&](const Wanted& each,
                           const Dispatch& dispatch) -> Result<std::pair<Step, size_t>> {
    const auto [layout, new_layout] =
        layout_index.try_emplace(layout_key(dispatch, each.push_bytes), layouts_.size());
    if (new_layout) {
      SHALE_TRY(set_layouts_.emplace_back(),
                create_set_layout(context_, layout->first, sampler_.get(), update_after_bind_));
      SHALE_TRY(layouts_.emplace_back(),
                create_layout(context_, set_layouts_.back().get(), each.push_bytes));
    }
    const auto [pipeline, new_pipeline] =
        pipeline_index.try_emplace({dispatch.module, layout->second}, wanted.size());
    if (new_pipeline) wanted.push_back({dispatch.module, layout->second, &each});
    return std::pair{Step{.dispatch = &dispatch,
                          .set_layout = set_layouts_[layout->second].get(),
                          .layout = layouts_[layout->second].get(),
                          .takes_params = each.push_bytes > 0,
                          .segment = each.segment,
                          .is_first = each.dispatch == each.segment->dispatches.data()},
                     pipeline->second};
  };
  for (const Wanted& each : dispatches) {
    if (each.segment->tiles) has_tiles_ = true;
    if (each.segment->kind == SegmentKind::kTransfer) {
      pipeline_of_step.emplace_back();
      steps_.push_back({.dispatch = each.dispatch,
                        .is_transfer = true,
                        .segment = each.segment,
                        .is_first = each.dispatch == each.segment->dispatches.data()});
      has_transfers_ = true;
      continue;
    }
    SHALE_TRY(auto own, prepare(each, *each.dispatch));
    has_indirect_ = has_indirect_ || each.dispatch->indirect;
    if (each.start && options.compile != Compile::kAtOnce) {
      SHALE_TRY(const auto start, prepare(each, *each.start));
      own.first.start = &starts_.emplace_back(start.first);
      pipeline_of_start.push_back(start.second);
      wanted[start.second].is_early = true;
    } else {
      wanted[own.second].is_early = true;
    }
    pipeline_of_step.push_back(own.second);
    steps_.push_back(own.first);
  }

  std::vector<size_t> job_of(wanted.size());
  std::vector<LateJob> jobs;
  std::vector<size_t> order;
  for (size_t i = 0; i < wanted.size(); ++i) {
    if (wanted[i].is_early) {
      order.push_back(i);
      continue;
    }
    const Wanted& of = *wanted[i].first;
    job_of[i] = jobs.size();
    jobs.push_back({.words = variant.modules[wanted[i].module],
                    .layout = layouts_[wanted[i].layout].get(),
                    .segment = of.segment,
                    .dispatch = of.dispatch,
                    .gain_us = of.start->cost.time_us - of.dispatch->cost.time_us});
  }
  // The long ones first, or the last of them would keep one core busy alone.
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return variant.modules[wanted[a].module].size() > variant.modules[wanted[b].module].size();
  });
  const uint32_t half = std::max(std::thread::hardware_concurrency() / 2, 2u),
                 own = options.compile == Compile::kInBackground ? half : 1,
                 threads = options.threads == 0 ? own : options.threads;
  const auto is_of_network = [&](size_t i) {
    return wanted[i].is_early && wanted[i].first->segment->kind == SegmentKind::kGraph;
  };
  const auto work_of = [&](size_t i) {
    const Wanted& of = *wanted[i].first;
    const bool is_own = of.dispatch->module == wanted[i].module;
    return DriverWork{of.segment, is_own ? of.dispatch : of.start,
                      &variant.modules[wanted[i].module]};
  };
  std::vector<DriverWork> long_first, as_run;
  size_t words = 0;
  for (const size_t i : order)
    if (is_of_network(i)) words += long_first.emplace_back(work_of(i)).words->size();
  for (size_t i = 0; i < wanted.size(); ++i)
    if (is_of_network(i)) as_run.push_back(work_of(i));
  if (threads > 1 && words > kLongCompileWords)
    compile_ahead(context_, variant_, long_first, package.weights.size(), threads);
  else if (threads > 1 && words > DriverCode::kShortWords)  // fewer are done before help comes
    ahead_ = std::make_unique<CodeAhead>(
        context_, variant_, as_run, package.weights.size(),
        std::min(threads - 1, static_cast<uint32_t>(words / DriverCode::kShortWords)));
  pipelines_.resize(wanted.size());
  std::vector<Result<void>> outcomes(wanted.size());
  parallel_for(order.size(), [&](size_t n) {
    const size_t i = order[n];
    auto pipeline = create_pipeline(context_, variant.modules[wanted[i].module],
                                    layouts_[wanted[i].layout].get(), options.cache);
    if (pipeline) {
      pipelines_[i] = std::move(*pipeline);
    } else {
      outcomes[i] = std::move(pipeline.error());
    }
  });
  const auto finish = [&](Step& step, size_t pipeline) -> Result<void> {
    Result<void>& outcome = outcomes[pipeline];
    if (!outcome) {
      outcome.error().where =
          fmt::format("dispatch \"{}\": {}", step.dispatch->name, outcome.error().where);
      return std::move(outcome.error());
    }
    step.pipeline = pipelines_[pipeline].get();
    return {};
  };
  for (size_t i = 0; i < starts_.size(); ++i)
    SHALE_TRY_VOID(finish(starts_[i], pipeline_of_start[i]));
  for (size_t i = 0; i < steps_.size(); ++i) {
    if (!pipeline_of_step[i]) continue;
    SHALE_TRY_VOID(finish(steps_[i], *pipeline_of_step[i]));
    steps_[i].late_job = job_of[*pipeline_of_step[i]];
    if (steps_[i].pipeline != VK_NULL_HANDLE) steps_[i].start = nullptr;
  }
  if (jobs.empty()) return {};
  late_ = std::make_unique<LatePipelines>(context_, variant_, package.weights.size(),
                                          std::move(jobs), options.cache,
                                          options.compile == Compile::kInBackground ? threads : 0);
  return {};
}

void Kernels::barrier(VkCommandBuffer commands) const {
  VkPipelineStageFlags stages = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
  VkAccessFlags reads = VK_ACCESS_SHADER_READ_BIT, writes = VK_ACCESS_SHADER_WRITE_BIT;
  if (has_tiles_) {
    stages |= VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT;
    reads |= VK_ACCESS_INDIRECT_COMMAND_READ_BIT;
  }
  if (has_transfers_ || has_tiles_) {
    stages |= VK_PIPELINE_STAGE_TRANSFER_BIT;
    reads |= VK_ACCESS_TRANSFER_READ_BIT;
    writes |= VK_ACCESS_TRANSFER_WRITE_BIT;
  }
  if (has_indirect_) {
    stages |= VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT;
    reads |= VK_ACCESS_INDIRECT_COMMAND_READ_BIT;
  }
  vk::memory_barrier(context_, commands, stages, writes, stages, reads | writes);
}

bool Kernels::record_upload(VkCommandBuffer commands) const {
  if (!weights_.staging || upload_recorded_.test_and_set()) return false;
  vk::record_upload(context_, commands, weights_);
  vk::memory_barrier(context_, commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                     VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                     VK_ACCESS_SHADER_READ_BIT);
  return true;
}

uint64_t Kernels::tensor_alignment() const {
  return std::max(context_.limits.minStorageBufferOffsetAlignment,
                  context_.limits.minTexelBufferOffsetAlignment);
}

Result<DescriptorSets> DescriptorSets::create(const Kernels& kernels,
                                              std::span<const Step* const> steps) {
  DescriptorSets result;
  result.kernels_ = &kernels;
  result.steps_.assign(steps.begin(), steps.end());
  result.sets_.resize(steps.size());
  result.texel_views_.resize(steps.size());
  if (steps.empty()) return result;

  std::map<VkDescriptorType, uint32_t> counts;
  std::vector<VkDescriptorSetLayout> layouts;
  for (const Step* step : steps) {
    for (const Binding& binding : step->dispatch->bindings) ++counts[descriptor_type(binding.type)];
    layouts.push_back(step->set_layout);
  }
  std::vector<VkDescriptorPoolSize> sizes;
  for (const auto& [type, count] : counts) sizes.push_back({type, count});
  // A pool must offer something, even if no dispatch binds anything.
  if (sizes.empty()) sizes.push_back({VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1});
  const vk::Context& context = kernels.context();
  auto pool_info =
      vk::init<VkDescriptorPoolCreateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO);
  if (kernels.update_after_bind())
    pool_info.flags = VK_DESCRIPTOR_POOL_CREATE_UPDATE_AFTER_BIND_BIT;
  pool_info.maxSets = static_cast<uint32_t>(steps.size());
  pool_info.poolSizeCount = static_cast<uint32_t>(sizes.size());
  pool_info.pPoolSizes = sizes.data();
  SHALE_TRY(result.pool_,
            vk::make(context.vk.CreateDescriptorPool, context.vk.DestroyDescriptorPool,
                     "vkCreateDescriptorPool", context.device, pool_info));
  auto set_info =
      vk::init<VkDescriptorSetAllocateInfo>(VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO);
  set_info.descriptorPool = result.pool_.get();
  set_info.descriptorSetCount = static_cast<uint32_t>(layouts.size());
  set_info.pSetLayouts = layouts.data();
  SHALE_TRY_VOID(
      vk::check(context.vk.AllocateDescriptorSets(context.device, &set_info, result.sets_.data()),
                "vkAllocateDescriptorSets"));
  return result;
}

Result<void> DescriptorSets::write(size_t index, const TargetOf& target) {
  const vk::Context& context = kernels_->context();
  const std::vector<Binding>& bindings = steps_[index]->dispatch->bindings;
  std::vector<VkDescriptorBufferInfo> buffers(bindings.size());
  std::vector<VkDescriptorImageInfo> images(bindings.size());
  std::vector<vk::BufferViewHandle> views;
  std::vector<VkBufferView> texels(bindings.size());
  std::vector<VkWriteDescriptorSet> writes;
  for (size_t i = 0; i < bindings.size(); ++i) {
    const Binding& binding = bindings[i];
    const Resource& resource = kernels_->variant().resources[binding.resource];
    const Target to = target(binding);
    buffers[i] = {to.buffer, to.offset, bound_bytes(resource)};
    images[i] = {VK_NULL_HANDLE, to.view, VK_IMAGE_LAYOUT_GENERAL};
    if (binding.type == BindingType::kUniformTexelBuffer) {
      auto info = vk::init<VkBufferViewCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_VIEW_CREATE_INFO);
      info.buffer = to.buffer;
      info.format = vk::vk_format(binding.view_format);
      info.offset = to.offset;
      info.range = resource.size_bytes;
      SHALE_TRY(views.emplace_back(),
                vk::make(context.vk.CreateBufferView, context.vk.DestroyBufferView,
                         "vkCreateBufferView", context.device, info));
      texels[i] = views.back().get();
    }
    auto write = vk::init<VkWriteDescriptorSet>(VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET);
    write.dstSet = sets_[index];
    write.dstBinding = binding.binding;
    write.descriptorCount = 1;
    write.descriptorType = descriptor_type(binding.type);
    write.pBufferInfo = &buffers[i];
    write.pImageInfo = &images[i];
    write.pTexelBufferView = &texels[i];
    writes.push_back(write);
  }
  context.vk.UpdateDescriptorSets(context.device, static_cast<uint32_t>(writes.size()),
                                  writes.data(), 0, nullptr);
  texel_views_[index] = std::move(views);
  return {};
}

namespace {

void record_transfer(VkCommandBuffer commands, const Dispatch& transfer, const Kernels& kernels,
                     const TargetOf& target) {
  const vk::Functions& vk = kernels.context().vk;
  const Target first = target(transfer.bindings[0]);
  const Resource& image = kernels.variant().resources[transfer.bindings[0].resource];
  if (transfer.kernel == kClearKernel) {
    const VkClearColorValue zero{};
    if (first.buffer)
      vk.CmdFillBuffer(commands, first.buffer, first.offset, image.size_bytes, 0);
    else
      vk.CmdClearColorImage(commands, first.image, VK_IMAGE_LAYOUT_GENERAL, &zero, 1,
                            &vk::kWholeImage);
    return;
  }
  const Target to = target(transfer.bindings[1]);
  VkBufferImageCopy copy{};
  copy.bufferOffset = first.buffer ? first.offset : to.offset;
  copy.bufferRowLength = linear_pitch(image.format, image.width);
  copy.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
  copy.imageExtent = {image.width, image.height, 1};
  if (first.buffer)
    vk.CmdCopyBufferToImage(commands, first.buffer, to.image, VK_IMAGE_LAYOUT_GENERAL, 1, &copy);
  else
    vk.CmdCopyImageToBuffer(commands, first.image, VK_IMAGE_LAYOUT_GENERAL, to.buffer, 1, &copy);
}

/// What the segment's Tiles ask for before its first dispatch.
void record_tiles(VkCommandBuffer commands, const Tiles& tiles, const Kernels& kernels,
                  const TargetOf& target, bool runs_all) {
  kernels.barrier(commands);
  for (const uint32_t resource : {tiles.changes, tiles.work}) {
    const Target to = target({.resource = resource});
    kernels.context().vk.CmdFillBuffer(commands, to.buffer, to.offset,
                                       bound_bytes(kernels.variant().resources[resource]),
                                       runs_all && resource == tiles.changes ? UINT32_MAX : 0);
  }
  kernels.barrier(commands);
}

}  // namespace

Result<void> check_timestamps(const vk::Timestamps* timestamps, size_t steps) {
  if (timestamps && timestamps->intervals() < steps)
    return bad_input("", "the timestamps hold {} intervals, {} dispatches need one each",
                     timestamps->intervals(), steps);
  return {};
}

void record_steps(VkCommandBuffer commands, const Kernels& kernels, std::span<const Step> steps,
                  std::span<const StepSets> sets, std::span<const uint8_t> params,
                  const TargetOf& target, bool runs_all, vk::Timestamps* timestamps) {
  const vk::Functions& vk = kernels.context().vk;
  if (timestamps) timestamps->start(commands);
  if (kernels.late()) kernels.late()->note_record();
  bool may_take = true;
  for (size_t i = 0; i < steps.size(); ++i) {
    const Step& own = steps[i];
    const VkPipeline late =
        own.start ? kernels.late()->take(own.late_job, may_take) : VkPipeline{VK_NULL_HANDLE};
    const bool is_start = own.start && late == VK_NULL_HANDLE;
    const Step& step = is_start ? *own.start : own;
    const std::optional<Tiles>& tiles = step.segment->tiles;
    if (tiles && own.is_first)
      record_tiles(commands, *tiles, kernels, target, runs_all);
    else if (own.barrier_before)
      kernels.barrier(commands);
    if (step.is_transfer) {
      record_transfer(commands, *step.dispatch, kernels, target);
      if (timestamps) timestamps->mark(commands);
      continue;
    }
    vk.CmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE,
                       late != VK_NULL_HANDLE ? late : step.pipeline);
    vk.CmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, step.layout, 0, 1,
                             is_start ? &sets[i].start : &sets[i].own, 0, nullptr);
    if (step.takes_params)
      vk.CmdPushConstants(commands, step.layout, VK_SHADER_STAGE_COMPUTE_BIT, 0,
                          static_cast<uint32_t>(params.size()), params.data());
    if (const std::optional<IndirectGrid>& indirect = step.dispatch->indirect) {
      const Target words = target(Binding{.resource = indirect->resource});
      vk.CmdDispatchIndirect(commands, words.buffer,
                             words.offset + sizeof(uint32_t) * indirect->first);
    } else {
      const std::array<uint32_t, 3>& grid = step.dispatch->workgroups;
      vk.CmdDispatch(commands, grid[0], grid[1], grid[2]);
    }
    if (timestamps) timestamps->mark(commands);
  }
}

}  // namespace shale
