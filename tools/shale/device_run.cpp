#include "tools/shale/device_run.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <thread>

#include "compiler/passes/pass.h"
#include "ir/base/file.h"
#include "runtime/datagraph/pipeline.h"
#include "runtime/datagraph/session.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/memory.h"
#include "runtime/vk/timestamps.h"
#include "tools/shale/terminal.h"

namespace shale {

namespace {

/// Shaders of so many words in all have kept lavapipe busy for some ten seconds.
constexpr size_t kLongCompileWords = 500000;

}  // namespace

void add_device_options(CLI::App& app, DeviceArguments& device) {
  app.add_option("--device", device.name, "part of the device's name (default: the first device)");
  app.add_option("--cache", device.cache, "file of the pipeline cache");
  app.add_flag("--validation", device.validation,
               "run under the Vulkan validation layer; its messages are failures");
}

namespace {

/// Why the file is none that a cache may replace: it is there, and is something else.
std::optional<std::string> not_a_cache(const std::string& path) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) return std::nullopt;
  if (!std::filesystem::is_regular_file(status)) return "is no regular file";
  const Result<std::vector<uint8_t>> bytes = read_file(path);
  if (!bytes) return bytes.error().message;
  constexpr size_t kMagicBytes = 8;
  const std::vector<uint8_t> empty_cache = vk::write_cache_blob({}, {});
  if (std::equal(bytes->begin(),
                 bytes->begin() + static_cast<ptrdiff_t>(std::min(bytes->size(), kMagicBytes)),
                 empty_cache.begin()))
    return std::nullopt;
  return "holds something else than a pipeline cache";
}

}  // namespace

Result<DeviceCaps> caps_at_hand(const DeviceArguments& arguments) {
  SHALE_TRY(const vk::Instance instance, vk::Instance::create());
  SHALE_TRY(const VkPhysicalDevice physical, instance.find_device(arguments.name));
  return vk::snapshot_caps(physical, instance.functions());
}

Result<ToolDevice> ToolDevice::open(const DeviceArguments& arguments) {
  ToolDevice tool;
  SHALE_TRY(vk::Instance instance, vk::Instance::create({.validation = arguments.validation}));
  tool.instance_ = std::make_unique<vk::Instance>(std::move(instance));
  SHALE_TRY(const VkPhysicalDevice physical, tool.instance_->find_device(arguments.name));
  SHALE_TRY(vk::Device device, vk::Device::create(physical, tool.instance_->functions()));
  tool.device_ = std::make_unique<vk::Device>(std::move(device));
  if (arguments.cache.empty()) return tool;
  if (const std::optional<std::string> why = not_a_cache(arguments.cache)) {
    print_warning(arguments.cache, "the cache is left out: the file " + *why);
    return tool;
  }
  SHALE_TRY(vk::PipelineCache cache, vk::PipelineCache::load(tool.context(), arguments.cache));
  tool.cache_ = std::make_unique<vk::PipelineCache>(std::move(cache));
  tool.cache_file_ = arguments.cache;
  return tool;
}

ToolDevice::~ToolDevice() {
  if (!cache_) return;
  // A result may have got this name in the meantime.
  if (const std::optional<std::string> why = not_a_cache(cache_file_))
    print_warning(cache_file_, "the cache is not written: the file " + *why);
  else if (const Result<void> saved = cache_->save(); !saved)
    print_warning(cache_file_, "the cache is not written: " + saved.error().message);
}

VkPipelineCache ToolDevice::cache() const { return cache_ ? cache_->get() : VK_NULL_HANDLE; }

Result<void> ToolDevice::close() {
  const std::vector<std::string> messages = instance_->take_validation_messages();
  if (!messages.empty()) return device_error("validation", "{}", messages.front());
  return {};
}

std::vector<const Resource*> tensors_of(const Variant& variant, Category category) {
  std::vector<const Resource*> result;
  for (const Resource& resource : variant.resources)
    if (resource.category == category) result.push_back(&resource);
  return result;
}

std::string driver_compiles(const Variant& variant, Compile compile) {
  std::set<uint32_t> late;
  for (const Segment& segment : variant.segments)
    for (const StartForm& start : segment.start_forms)
      late.insert(compile == Compile::kAtOnce ? start.form.module
                                              : segment.dispatches[start.dispatch].module);
  const size_t count = variant.modules.size() - late.size();
  size_t words = 0;
  for (uint32_t i = 0; i < variant.modules.size(); ++i)
    if (!late.contains(i)) words += variant.modules[i].size();
  return fmt::format(
      "the driver compiles {} shader{} ({} kB){}", count, count == 1 ? "" : "s", words * 4 / 1000,
      words > kLongCompileWords ? ", which may take a minute where its cache has not got them"
                                : "");
}

std::vector<DispatchTime> median_times(const std::vector<std::vector<DispatchTime>>& frames) {
  if (frames.empty()) return {};
  std::vector<DispatchTime> median = frames[0];
  for (size_t i = 0; i < median.size(); ++i) {
    std::vector<double> values;
    for (const std::vector<DispatchTime>& frame : frames)
      if (i < frame.size()) values.push_back(frame[i].time_us);  // programs may take turns
    std::nth_element(values.begin(),
                     values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
    median[i].time_us = values[values.size() / 2];
  }
  return median;
}

namespace {

using Clock = std::chrono::steady_clock;

double since_ms(Clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
}

}  // namespace

/// In the order of construction: a session needs its pipeline.
struct NetworkRun::State {
  const vk::Context& context;
  DataGraphPipeline pipeline;
  Session session;
  vk::Timestamps timestamps, whole;
  std::string compiles;  ///< what the first run waits for; empty after it
  std::vector<vk::Buffer> inputs = {}, outputs = {};
  vk::Buffer command_copy = {};  ///< of the last run by changes

  std::span<const Segment> segments() const { return {&pipeline.graph(), 1}; }
  /// With the times of all dispatches, of the whole, or neither.
  Result<void> submit(vk::Timestamps* each, vk::Timestamps* all) {
    Result<void> recorded;
    std::optional<Progress> first;
    if (const std::string label = std::exchange(compiles, {}); !label.empty()) first.emplace(label);
    SHALE_TRY_VOID(vk::submit_and_wait(context, [&](VkCommandBuffer commands) {
      if (all) all->start(commands);
      recorded = session.record(commands, each);
      if (all) all->mark(commands);
      vk::memory_barrier(context, commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                         VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                         VK_ACCESS_HOST_READ_BIT);
    }));
    return recorded;
  }
};

Result<NetworkRun> NetworkRun::create(const ToolDevice& device, const Package& package,
                                      StartTimes* start, Compile compile) {
  const Clock::time_point begin = Clock::now();
  const std::string compiles = driver_compiles(package.variants.front(), compile);
  Progress progress(compiles);
  SHALE_TRY(NetworkRun run,
            prepare(device.context(), package, device.cache(), "first run, " + compiles, compile));
  if (start) start->create_ms = since_ms(begin);
  return run;
}

Result<NetworkRun> NetworkRun::prepare(const vk::Context& context, const Package& package,
                                       VkPipelineCache cache, std::string compiles,
                                       Compile compile) {
  DataGraphPipelineOptions options{
      .cache = cache, .compile = compile, .threads = std::thread::hardware_concurrency()};
  const Variant& first = package.variants.front();
  // Networks that a parameter chooses among differ in their weights alone.
  if (!first.chosen_by.empty())
    options.graph =
        std::find_if(first.segments.begin(), first.segments.end(), [](const Segment& segment) {
          return segment.kind == SegmentKind::kGraph;
        })->name;
  SHALE_TRY(DataGraphPipeline pipeline, DataGraphPipeline::create(context, package, options));
  SHALE_TRY(Session session, Session::create(pipeline));
  SHALE_TRY_VOID(session.allocate_memory());
  SHALE_TRY(vk::Timestamps timestamps,
            vk::Timestamps::create(context, interval_count({&pipeline.graph(), 1})));
  SHALE_TRY(vk::Timestamps whole, vk::Timestamps::create(context, 1));
  const auto state =
      std::make_shared<State>(State{context, std::move(pipeline), std::move(session),
                                    std::move(timestamps), std::move(whole), std::move(compiles)});

  constexpr VkBufferUsageFlags kUsage =
      VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT;
  const std::vector<const Resource*> in = tensors_of(state->pipeline.variant(), Category::kInput);
  const auto add = [&](const Resource& resource, vk::MemoryKind kind,
                       std::vector<vk::Buffer>& buffers) -> Result<void> {
    const uint64_t size = bound_bytes(resource);
    SHALE_TRY(vk::Buffer buffer, vk::Buffer::create(context, size, kUsage, kind));
    SHALE_TRY_VOID(state->session.bind_tensor(resource.name, {buffer.get(), 0, size}));
    buffers.push_back(std::move(buffer));
    return {};
  };
  for (const Resource* resource : in)
    SHALE_TRY_VOID(add(*resource, vk::MemoryKind::kUpload, state->inputs));
  for (const Resource* resource : tensors_of(state->pipeline.variant(), Category::kOutput))
    SHALE_TRY_VOID(add(*resource, vk::MemoryKind::kReadback, state->outputs));
  return NetworkRun(state);
}

Result<NetworkRun> NetworkRun::create(const ToolDevice& device, const Package& package,
                                      const std::vector<Tensor>& inputs, StartTimes* start,
                                      Compile compile) {
  SHALE_TRY(NetworkRun run, create(device, package, start, compile));
  SHALE_TRY_VOID(run.set_inputs(inputs));
  return run;
}

Result<void> NetworkRun::finish() { return state_->pipeline.finish(); }

const Variant& NetworkRun::variant() const { return state_->pipeline.variant(); }

Result<void> NetworkRun::set_inputs(const std::vector<Tensor>& inputs) {
  const std::vector<const Resource*> in = tensors_of(state_->pipeline.variant(), Category::kInput);
  if (in.size() != inputs.size())
    return bad_input("", "found {} inputs, the network has {}", inputs.size(), in.size());
  for (size_t i = 0; i < in.size(); ++i) {
    if (inputs[i].type.dtype != in[i]->dtype || inputs[i].type.shape != in[i]->shape)
      return bad_input("input \"" + in[i]->name + "\"", "found {}, expected {}",
                       type_text(inputs[i].type), type_text({in[i]->dtype, in[i]->shape}));
    std::copy(inputs[i].bytes.begin(), inputs[i].bytes.end(), state_->inputs[i].mapped().begin());
  }
  return {};
}

Result<void> NetworkRun::run() {
  state_->session.run_all();
  return state_->submit(nullptr, nullptr);
}

Result<NetworkRun::ChangesRun> NetworkRun::run_changes() {
  SHALE_TRY(const TensorView commands, state_->session.commands());
  if (!state_->command_copy) {
    SHALE_TRY(state_->command_copy,
              vk::Buffer::create(state_->context, commands.size_bytes,
                                 VK_BUFFER_USAGE_TRANSFER_DST_BIT, vk::MemoryKind::kReadback));
  }
  SHALE_TRY_VOID(state_->submit(nullptr, &state_->whole));
  SHALE_TRY(const std::vector<double> times, state_->whole.read_us());
  SHALE_TRY_VOID(vk::submit_and_wait(state_->context, [&](VkCommandBuffer recorded) {
    vk::memory_barrier(state_->context, recorded, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                       VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_READ_BIT);
    const VkBufferCopy copy{commands.offset, 0, commands.size_bytes};
    state_->context.vk.CmdCopyBuffer(recorded, commands.buffer, state_->command_copy.get(), 1,
                                     &copy);
    vk::memory_barrier(state_->context, recorded, VK_PIPELINE_STAGE_TRANSFER_BIT,
                       VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
                       VK_ACCESS_HOST_READ_BIT);
  }));
  const std::span<const uint32_t> words(
      reinterpret_cast<const uint32_t*>(state_->command_copy.mapped().data()),
      commands.size_bytes / sizeof(uint32_t));
  const Segment& graph = state_->pipeline.graph();
  std::vector<uint32_t> ran;
  for (const IndirectGrid& grid : indirect_grids({&graph, 1}))
    ran.insert(ran.end(), words.begin() + grid.first, words.begin() + grid.first + 3);
  return ChangesRun{times.front(), share_run({&graph, 1}, ran)};
}

Result<std::vector<DispatchTime>> NetworkRun::measure() {
  state_->session.run_all();
  SHALE_TRY_VOID(state_->submit(&state_->timestamps, nullptr));
  return measured_times(state_->timestamps, state_->segments());
}

Result<double> NetworkRun::measure_whole() {
  state_->session.run_all();
  SHALE_TRY_VOID(state_->submit(nullptr, &state_->whole));
  SHALE_TRY(const std::vector<double> times, state_->whole.read_us());
  return times.front();
}

std::vector<Tensor> NetworkRun::outputs() const {
  std::vector<Tensor> outputs;
  for (const Resource* resource : tensors_of(state_->pipeline.variant(), Category::kOutput)) {
    Tensor tensor{{resource->dtype, resource->shape}, {}};
    const std::span<uint8_t> mapped = state_->outputs[outputs.size()].mapped();
    tensor.bytes.assign(mapped.begin(),
                        mapped.begin() + static_cast<std::ptrdiff_t>(resource->size_bytes));
    outputs.push_back(std::move(tensor));
  }
  return outputs;
}

Result<std::vector<Tensor>> run_network(const ToolDevice& device, const Package& package,
                                        const std::vector<Tensor>& inputs, uint32_t repeat,
                                        std::vector<DispatchTime>* times, StartTimes* start) {
  SHALE_TRY(NetworkRun network, NetworkRun::create(device, package, inputs, start));
  return run_repeatedly(network, repeat, times, start);
}

Result<std::vector<Tensor>> run_repeatedly(NetworkRun& network, uint32_t repeat,
                                           std::vector<DispatchTime>* times, StartTimes* start) {
  const Clock::time_point first = Clock::now();
  SHALE_TRY_VOID(network.run());
  if (start) start->first_ms = since_ms(first);
  std::vector<std::vector<DispatchTime>> measured;
  Progress progress("running");
  for (uint32_t i = times ? 0 : 1; i < repeat; ++i) {
    if (!progress.step(i, repeat)) return bad_input("", "interrupted after {} runs", i);
    if (!times) {
      SHALE_TRY_VOID(network.run());
      continue;
    }
    SHALE_TRY(std::vector<DispatchTime> frame, network.measure());
    measured.push_back(std::move(frame));
  }
  if (times) *times = median_times(measured);
  return network.outputs();
}

Result<void> match_shapes(Graph& graph, const Variant& variant) {
  PassContext context;
  for (const Resource* resource : tensors_of(variant, Category::kInput))
    context.input_shapes[resource->name] = resource->shape;
  const Result<Change> change = run_pass(*find_pass("infer-shapes"), graph, context);
  if (!change) return change.error();
  return {};
}

std::optional<std::string> first_difference(const Tensor& found, const Tensor& expected) {
  if (found.type != expected.type)
    return fmt::format("found {}, expected {}", type_text(found.type), type_text(expected.type));
  for (int64_t i = 0; i < expected.count(); ++i) {
    if (found.get(i) == expected.get(i)) continue;
    Shape at(expected.type.shape.size());
    int64_t rest = i;
    for (size_t axis = at.size(); axis-- > 0;) {
      at[axis] = rest % expected.type.shape[axis];
      rest /= expected.type.shape[axis];
    }
    return fmt::format("element {} at {}: found {}, expected {}", i, shape_text(at), found.get(i),
                       expected.get(i));
  }
  return std::nullopt;
}

std::string OutputCheck::text() const {
  if (difference) return fmt::format("differs from ({}) the interpreter", *difference);
  if (!widest) return "equal to the interpreter";
  return fmt::format("within the rounding bounds of the interpreter, at most {:.3g} wide", *widest);
}

Result<std::vector<OutputCheck>> check_outputs(const Graph& graph,
                                               const std::vector<Tensor>& inputs,
                                               const std::vector<Tensor>& outputs,
                                               const InterpreterProgress& progress) {
  std::vector<OutputCheck> checks;
  if (has_reals(graph)) {
    SHALE_TRY(const std::vector<Bounds> bounds, interpret_bounds(graph, inputs, progress));
    for (size_t i = 0; i < outputs.size(); ++i)
      checks.push_back({first_outside(outputs[i], bounds[i]), widest(bounds[i])});
  } else {
    SHALE_TRY(const std::vector<Tensor> expected, interpret(graph, inputs, progress));
    for (size_t i = 0; i < outputs.size(); ++i)
      checks.push_back({first_difference(outputs[i], expected[i]), std::nullopt});
  }
  return checks;
}

}  // namespace shale
