#include "runtime/datagraph/driver_code.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <thread>
#include <vector>

#include "runtime/datagraph/dispatch.h"
#include "runtime/datagraph/pipeline.h"
#include "runtime/datagraph/session.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/memory.h"
#include "runtime/vk/pipeline_cache.h"

namespace shale {
namespace {

/// One dispatch as a package of its own, with one workgroup.
Package alone(const Variant& variant, const DriverWork& work, uint64_t weight_bytes) {
  Package package;
  package.weights.resize(weight_bytes);
  Variant& only = package.variants.emplace_back();
  only.target = variant.target;
  only.device_class = variant.device_class;
  only.requirements = variant.requirements;
  only.arena_bytes = variant.arena_bytes;
  only.resources = variant.resources;
  for (Resource& resource : only.resources)
    if (!is_image(resource.category)) resource.history_depth = 0;
  only.modules = {*work.words};
  only.programs = {"frame"};
  only.segments = {
      {.name = work.segment->name, .dispatches = {*work.dispatch}, .tiles = work.segment->tiles}};
  Dispatch& own = only.segments.front().dispatches.front();
  own.module = 0;
  own.indirect.reset();  // no other dispatch writes it: the first cell, which a list of zeros names
  own.workgroups = {1, 1, 1};
  return package;
}

/// Compiles, on a device of its own, the works that no other thread takes.
void compile_next(const vk::Context& context, const Variant& variant,
                  std::span<const DriverWork> works, uint64_t weight_bytes,
                  std::atomic<size_t>& next, const std::atomic<bool>& stop) {
  const std::unique_ptr<DriverCode> code = DriverCode::open(context);
  for (size_t i = next++; code && i < works.size() && !stop; i = next++)
    code->compile(variant, works[i], weight_bytes);
}

}  // namespace

struct DriverCode::State {
  vk::Instance instance;
  vk::Device device;

  Result<void> run(const Package& package) const;
};

DriverCode::DriverCode(std::unique_ptr<State> state) : state_(std::move(state)) {}
DriverCode::~DriverCode() = default;

std::unique_ptr<DriverCode> DriverCode::open(const vk::Context& context) {
  const char* off = std::getenv("MESA_SHADER_CACHE_DISABLE");
  if (!context.caps.cpu || (off && *off)) return nullptr;
  Result<vk::Instance> instance = vk::Instance::create();
  if (!instance) return nullptr;
  const Result<std::vector<VkPhysicalDevice>> devices = instance->physical_devices();
  if (!devices) return nullptr;
  const vk::CacheIdentity wanted = vk::cache_identity(context.physical_device, context.vk);
  for (const VkPhysicalDevice physical : *devices) {
    if (vk::cache_identity(physical, instance->functions()) != wanted) continue;
    Result<vk::Device> device = vk::Device::create(physical, instance->functions());
    if (!device) return nullptr;
    return std::unique_ptr<DriverCode>(
        new DriverCode(std::make_unique<State>(State{std::move(*instance), std::move(*device)})));
  }
  return nullptr;
}

Result<void> DriverCode::State::run(const Package& package) const {
  const vk::Context& context = device.context();
  SHALE_TRY(
      const DataGraphPipeline pipeline,
      DataGraphPipeline::create(context, package, {.compile = Compile::kAtOnce, .threads = 1}));
  SHALE_TRY(Session session, Session::create(pipeline));
  SHALE_TRY_VOID(session.allocate_memory());
  std::vector<vk::Buffer> buffers;
  for (const Resource& resource : pipeline.variant().resources) {
    if (!is_graph_tensor(resource.category)) continue;
    SHALE_TRY(buffers.emplace_back(),
              vk::Buffer::create(context, bound_bytes(resource), kTensorBufferUsage,
                                 vk::MemoryKind::kDevice));
    SHALE_TRY_VOID(
        session.bind_tensor(resource.name, {buffers.back().get(), 0, buffers.back().size_bytes()}));
  }
  Result<void> recorded;
  SHALE_TRY_VOID(vk::submit_and_wait(
      context, [&](VkCommandBuffer commands) { recorded = session.record(commands); }));
  return recorded;
}

void DriverCode::compile(const Variant& variant, const DriverWork& work,
                         uint64_t weight_bytes) const {
  (void)state_->run(alone(variant, work, weight_bytes));
}

void compile_ahead(const vk::Context& context, const Variant& variant,
                   std::span<const DriverWork> works, uint64_t weight_bytes, uint32_t threads) {
  std::vector<DriverWork> longer;
  for (const DriverWork& work : works)
    if (work.words->size() >= DriverCode::kShortWords) longer.push_back(work);
  std::atomic<size_t> next = 0;
  const std::atomic<bool> stop = false;
  const auto work = [&] { compile_next(context, variant, longer, weight_bytes, next, stop); };
  std::vector<std::thread> others;
  for (size_t i = 1; i < std::min<size_t>(threads, longer.size()); ++i) others.emplace_back(work);
  work();
  for (std::thread& other : others) other.join();
}

CodeAhead::CodeAhead(const vk::Context& context, const Variant& variant,
                     std::span<const DriverWork> works, uint64_t weight_bytes, uint32_t helpers)
    : end_at_exit_([this] { end(); }) {
  size_t total = 0, before = 0;
  for (const DriverWork& work : works) total += work.words->size();
  for (const DriverWork& work : works) {
    if (before >= total / (helpers + 1)) {
      words_.push_back(*work.words);
      works_.push_back(work);
    }
    before += work.words->size();
  }
  for (size_t i = 0; i < works_.size(); ++i) works_[i].words = &words_[i];
  const auto work = [this, context, &variant, weight_bytes] {
    compile_next(context, variant, works_, weight_bytes, next_, stop_);
  };
  for (size_t i = 0; i < std::min<size_t>(helpers, works_.size()); ++i) threads_.emplace_back(work);
}

CodeAhead::~CodeAhead() = default;

void CodeAhead::end() {
  stop_ = true;
  for (std::thread& thread : threads_)
    if (thread.joinable()) thread.join();
}

}  // namespace shale
