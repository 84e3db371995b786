// tools/shale/native.h -- networks on a device's own data graph pipelines (VK_ARM_data_graph).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "ir/graph/graph.h"
#include "ir/graph/tensor.h"
#include "tools/shale/device_run.h"

namespace shale {

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
  /// of linear tiling, and dispatches `repeat` times; returns the outputs of the last time. `inputs` are those
  /// of the graph, in order and of its types. With `median_us`, the median from submission to its end.
  /// Errors: kUnsupported for a tensor that Vulkan has not; kDevice.
  Result<std::vector<Tensor>> run(const Graph& graph, const std::vector<Tensor>& inputs,
                                  uint32_t repeat = 1, double* median_us = nullptr) const;
  std::vector<std::string> take_validation_messages();
  /// Errors: kDevice with the first validation message.
  Result<void> close();

 private:
  struct State;
  explicit NativeDevice(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace shale
