// tools/shale/native.h -- networks on a device's own data graph pipelines (VK_ARM_data_graph).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "ir/graph/graph.h"
#include "ir/graph/tensor.h"
#include "tools/shale/device_run.h"

namespace shale {

/// A graph on a NativeDevice, which must outlive it, with tensors of its own: ready to be run again and again.
class NativeNetwork {
 public:
  NativeNetwork(NativeNetwork&&) noexcept;
  ~NativeNetwork();

  /// Records and dispatches once; microseconds to the end of the work. Errors: kDevice.
  Result<double> run();
  /// Of the last run, in the order of the graph.
  std::vector<Tensor> outputs() const;

 private:
  friend class NativeDevice;
  struct State;
  explicit NativeNetwork(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

/// A device that has VK_ARM_tensors and VK_ARM_data_graph, by its driver or by a layer, opened as any program
/// would: nothing of Shale's kernels is used.
class NativeDevice {
 public:
  /// Takes the name and the validation of the arguments; the first device with the extensions where no
  /// name is given.
  /// Errors: kDevice, naming what the device lacks.
  static Result<NativeDevice> open(const DeviceArguments& arguments);
  NativeDevice(NativeDevice&&) noexcept;
  NativeDevice& operator=(NativeDevice&&) noexcept;
  ~NativeDevice();

  const std::string& name() const;
  /// Writes the graph as a SPIR-V module (its constants beside it), makes pipeline, session and tensors
  /// of linear tiling. `inputs` are those of the graph, in order and of its types.
  /// Errors: kUnsupported for a tensor that Vulkan has not; kDevice.
  Result<NativeNetwork> load(const Graph& graph, const std::vector<Tensor>& inputs) const;
  /// load(), and `repeat` runs; returns the outputs of the last one. With `median_us`, the median over the runs;
  /// with `start`, how long load() and the first run took.
  /// Errors: those of load(); kBadInput if the user interrupts.
  Result<std::vector<Tensor>> run(const Graph& graph, const std::vector<Tensor>& inputs,
                                  uint32_t repeat = 1, double* median_us = nullptr,
                                  StartTimes* start = nullptr) const;
  std::vector<std::string> take_validation_messages();
  /// Errors: kDevice with the first validation message.
  Result<void> close();

 private:
  friend class NativeNetwork;
  struct State;
  explicit NativeDevice(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace shale
