#include "runtime/datagraph/late_pipelines.h"

#include <algorithm>
#include <chrono>
#include <numeric>

#include "runtime/datagraph/driver_code.h"

namespace shale {
namespace {

/// Start forms of a network like NSS v1 HIGH take lavapipe 3 s on two cores.
constexpr std::chrono::seconds kFirstResult{5};
/// With the second record, the first one's result is there or near.
constexpr uint64_t kRecordsBefore = 2;

}  // namespace

Result<vk::PipelineHandle> create_pipeline(const vk::Context& context, const Spirv& words,
                                           VkPipelineLayout layout, VkPipelineCache cache,
                                           VkPipelineCreateFlags flags) {
  auto module_info =
      vk::init<VkShaderModuleCreateInfo>(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
  module_info.codeSize = words.size() * sizeof(uint32_t);
  module_info.pCode = words.data();
  SHALE_TRY(const auto module,
            vk::make(context.vk.CreateShaderModule, context.vk.DestroyShaderModule,
                     "vkCreateShaderModule", context.device, module_info));
  auto info = vk::init<VkComputePipelineCreateInfo>(VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO);
  info.flags = flags;
  info.layout = layout;
  info.stage = vk::init<VkPipelineShaderStageCreateInfo>(
      VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO);
  info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  info.stage.module = module.get();
  info.stage.pName = "main";
  VkPipeline pipeline = VK_NULL_HANDLE;
  SHALE_TRY_VOID(vk::check(
      context.vk.CreateComputePipelines(context.device, cache, 1, &info, nullptr, &pipeline),
      "vkCreateComputePipelines"));
  return vk::PipelineHandle(context.device, pipeline, context.vk.DestroyPipeline);
}

LatePipelines::LatePipelines(const vk::Context& context, const Variant& variant,
                             uint64_t weight_bytes, std::vector<LateJob> jobs,
                             VkPipelineCache cache, size_t threads)
    : context_(context),
      variant_(variant),
      weight_bytes_(weight_bytes),
      cache_(cache),
      jobs_(std::move(jobs)),
      order_(jobs_.size()),
      made_(jobs_.size()),
      left_(jobs_.size()),
      end_at_exit_([this] { end(); }) {
  std::iota(order_.begin(), order_.end(), size_t{0});
  const auto worth = [&](size_t job) {
    return jobs_[job].gain_us / static_cast<double>(jobs_[job].words.size());
  };
  std::stable_sort(order_.begin(), order_.end(),
                   [&](size_t a, size_t b) { return worth(a) > worth(b); });
  for (size_t i = 0; i < std::min(threads, jobs_.size()); ++i)
    threads_.emplace_back([this] { work(); });
}

LatePipelines::~LatePipelines() = default;

void LatePipelines::end() {
  stop_ = true;
  begin();
  for (std::thread& thread : threads_)
    if (thread.joinable()) thread.join();
}

void LatePipelines::note_record() {
  const std::lock_guard lock(mutex_);
  if (++records_ == kRecordsBefore) begin_.notify_all();
}

void LatePipelines::begin() {
  const std::lock_guard lock(mutex_);
  records_ = kRecordsBefore;
  begin_.notify_all();
}

VkPipeline LatePipelines::take(size_t job, bool& may_take) {
  Made& made = made_[job];
  const VkPipeline pipeline = made.pipeline;
  if (pipeline == VK_NULL_HANDLE || made.taken) return pipeline;
  if (!may_take) return VK_NULL_HANDLE;
  may_take = false;
  made.taken = true;
  return pipeline;
}

std::optional<size_t> LatePipelines::next_job() {
  const std::lock_guard lock(mutex_);
  if (stop_ || next_ == order_.size()) return std::nullopt;
  ++working_;
  return order_[next_++];
}

Result<void> LatePipelines::compile(size_t job, std::unique_ptr<DriverCode>& code) {
  LateJob& own = jobs_[job];
  Made& made = made_[job];
  if (own.words.size() >= DriverCode::kShortWords) {
    if (!code) code = DriverCode::open(context_);
    if (code) code->compile(variant_, {own.segment, own.dispatch, &own.words}, weight_bytes_);
    if (stop_) return {};
  }
  Result<vk::PipelineHandle> pipeline = create_pipeline(context_, own.words, own.layout, cache_);
  own.words = {};
  if (pipeline) {
    made.handle = std::move(*pipeline);
    made.pipeline = made.handle.get();
  } else {
    pipeline.error().where =
        fmt::format("dispatch \"{}\": {}", own.dispatch->name, pipeline.error().where);
  }
  const std::lock_guard lock(mutex_);
  --working_;
  if (pipeline)
    --left_;
  else if (first_error_)
    first_error_ = pipeline.error();
  all_made_.notify_all();
  if (!pipeline) return std::move(pipeline.error());
  return {};
}

void LatePipelines::work() {
  {
    std::unique_lock lock(mutex_);
    begin_.wait_for(lock, kFirstResult, [&] { return records_ >= kRecordsBefore; });
  }
  std::unique_ptr<DriverCode> code;
  while (const std::optional<size_t> job = next_job()) (void)compile(*job, code);
}

Result<bool> LatePipelines::compile_one() {
  const std::optional<size_t> job = next_job();
  if (!job) return false;
  std::unique_ptr<DriverCode> code;
  SHALE_TRY_VOID(compile(*job, code));
  return true;
}

Result<void> LatePipelines::finish() {
  begin();
  std::unique_ptr<DriverCode> code;
  // Threads of our own have the processors already.
  if (threads_.empty())
    while (const std::optional<size_t> job = next_job()) (void)compile(*job, code);
  std::unique_lock lock(mutex_);
  all_made_.wait(lock, [&] { return next_ == order_.size() && working_ == 0; });
  for (Made& made : made_)
    if (made.pipeline.load() != VK_NULL_HANDLE) made.taken = true;
  return first_error_;
}

}  // namespace shale
