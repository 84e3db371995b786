// tools/shale/device_run.h -- a device of the tool's own, and networks run on it with host tensors.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "ir/graph/graph.h"
#include "ir/graph/tensor.h"
#include "ir/package/package.h"
#include "ir/reference/bounds.h"
#include "runtime/datagraph/pipeline.h"
#include "runtime/profile/profile.h"
#include "runtime/vk/device.h"
#include "runtime/vk/instance.h"
#include "runtime/vk/pipeline_cache.h"

namespace shale {

/// What --device, --cache and --validation say.
struct DeviceArguments {
  std::string name;         ///< part of the device's name; empty takes the first
  std::string cache;        ///< file of the pipeline cache; empty is none
  bool validation = false;  ///< run under the validation layer
};

/// --device, --cache, --validation.
void add_device_options(CLI::App& app, DeviceArguments& device);

/// What the device can do; it is not opened. Errors: kDevice.
Result<DeviceCaps> caps_at_hand(const DeviceArguments& arguments);

/// Instance, device and pipeline cache with one lifetime. The cache is a help, not a result: at the
/// end, when results are safe, it is written; what goes wrong with it is a warning.
class ToolDevice {
 public:
  /// Errors: kDevice.
  static Result<ToolDevice> open(const DeviceArguments& arguments);
  ToolDevice(ToolDevice&&) = default;
  ToolDevice& operator=(ToolDevice&&) = default;
  ~ToolDevice();

  const vk::Context& context() const { return device_->context(); }
  VkPipelineCache cache() const;
  /// Reports what validation said.
  /// Errors: kDevice with the first validation message.
  Result<void> close();
  std::vector<std::string> take_validation_messages() {
    return instance_->take_validation_messages();
  }

 private:
  ToolDevice() = default;

  std::unique_ptr<vk::Instance> instance_;
  std::unique_ptr<vk::Device> device_;
  std::unique_ptr<vk::PipelineCache> cache_;  ///< null without a file for it
  std::string cache_file_;
};

/// What stands before the first result.
struct StartTimes {
  double create_ms = 0;  ///< pipelines, weights, session
  double first_ms = 0;   ///< first run, in which drivers may go on compiling
  double full_ms =
      0;  ///< from the beginning until a run by all the fast kernels has ended; 0 is not measured
};

/// A package's graph with inputs of its own, ready to be run again and again.
class NetworkRun {
 public:
  /// `device` must outlive the run. With `start`, how long it took to get here.
  /// Errors: kBadInput if the package is broken, kDevice.
  static Result<NetworkRun> create(const ToolDevice& device, const Package& package,
                                   StartTimes* start = nullptr, Compile compile = Compile::kAtOnce);
  /// With inputs, in the order of the graph.
  /// Errors: also kBadInput if inputs do not match the package.
  static Result<NetworkRun> create(const ToolDevice& device, const Package& package,
                                   const std::vector<Tensor>& inputs, StartTimes* start = nullptr,
                                   Compile compile = Compile::kAtOnce);
  /// DataGraphPipeline::finish().
  Result<void> finish();
  /// The variant that the device takes.
  const Variant& variant() const;
  /// Other inputs, for the runs to come. Errors: kBadInput if they do not match the package.
  Result<void> set_inputs(const std::vector<Tensor>& inputs);
  /// Runs once, all of a network that works by tiles too, as measure() and measure_whole() do. Errors: kDevice.
  Result<void> run();
  /// Runs once and measures each dispatch; a driver may compile at the first run.
  Result<std::vector<DispatchTime>> measure();
  /// Runs once and measures the whole in microseconds: between dispatches a driver may take long for
  /// a timestamp.
  Result<double> measure_whole();
  /// A run by what changed since the last one, of a network that works by tiles: microseconds, and
  /// the share_run of its segment.
  /// Errors: as run; kBadInput for other networks.
  struct ChangesRun {
    double time_us, share;
  };
  Result<ChangesRun> run_changes();
  /// Of the last run, in the order of the graph.
  std::vector<Tensor> outputs() const;

 private:
  struct State;
  explicit NetworkRun(std::shared_ptr<State> state) : state_(std::move(state)) {}
  /// Without a word on the terminal, except `compiles` for the first run.
  static Result<NetworkRun> prepare(const vk::Context& context, const Package& package,
                                    VkPipelineCache cache, std::string compiles, Compile compile);
  std::shared_ptr<State> state_;
};

/// Runs a network whose inputs are set `repeat` times, as run_network does.
/// Errors: kDevice; kBadInput if the user interrupts.
Result<std::vector<Tensor>> run_repeatedly(NetworkRun& network, uint32_t repeat,
                                           std::vector<DispatchTime>* times = nullptr,
                                           StartTimes* start = nullptr);

/// Runs the package's graph `repeat` times on the inputs; returns the outputs of the last run. With
/// `times`, the median over the runs of each dispatch, after one run that is not measured; with
/// `start`, how long it took to get there.
/// Errors: as NetworkRun.
Result<std::vector<Tensor>> run_network(const ToolDevice& device, const Package& package,
                                        const std::vector<Tensor>& inputs, uint32_t repeat = 1,
                                        std::vector<DispatchTime>* times = nullptr,
                                        StartTimes* start = nullptr);

/// What a Progress says while a driver compiles the kernels of a variant, at creation or at their first
/// dispatch: how many before the first result, and how long that may take.
std::string driver_compiles(const Variant& variant, Compile compile);

/// Element-wise median over several measured frames; all have the same dispatches.
std::vector<DispatchTime> median_times(const std::vector<std::vector<DispatchTime>>& frames);

/// Inputs or outputs of a variant, in graph order.
std::vector<const Resource*> tensors_of(const Variant& variant, Category category);

/// Gives a graph the input shapes that a package of it was compiled for.
/// Errors: kBadInput.
Result<void> match_shapes(Graph& graph, const Variant& variant);

/// "element 17 at [0,1,1,1]: found 4, expected 5", or nothing if the tensors are equal.
std::optional<std::string> first_difference(const Tensor& found, const Tensor& expected);

/// What an output of a graph on a device has against the interpreter.
struct OutputCheck {
  /// The first difference; of a graph with floats the first element outside its rounding bounds.
  std::optional<std::string> difference;
  std::optional<double> widest;  ///< of those bounds, in the output's values

  /// "equal to the interpreter", or what else holds.
  std::string text() const;
};

/// Errors: as interpret.
Result<std::vector<OutputCheck>> check_outputs(const Graph& graph,
                                               const std::vector<Tensor>& inputs,
                                               const std::vector<Tensor>& outputs,
                                               const InterpreterProgress& progress);

}  // namespace shale
