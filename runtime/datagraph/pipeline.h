// runtime/datagraph/pipeline.h -- the network of a package, compiled for a device.
//
// The object model is that of VK_ARM_data_graph (section 11 of its reference): a pipeline is made
// once and shared; a session is one execution context with memory that its user provides; a session
// is recorded into the user's command buffers. Here everything runs as compute shaders.
#pragma once

#include <vulkan/vulkan.h>

#include <memory>
#include <string>

#include "ir/package/package.h"
#include "runtime/vk/device.h"

namespace shale {

class Kernels;

/// When the pipelines are made for which start forms stand in (StartForm in package.h). A record takes for each dispatch
/// what is there by then, at most one pipeline more than the record before; results are the same, bit for bit.
enum class Compile : uint8_t {
  kAtOnce,        ///< before create() returns; no start form serves
  kInBackground,  ///< by threads that the object owns and ends, which begin with the second record or 5 s after create()
  kByHost,        ///< by compile_one(), on threads of the host's
};

struct DataGraphPipelineOptions {
  /// Where compiled pipelines are looked up and left, such as vk::PipelineCache::get(). Not owned; must outlive the object.
  VkPipelineCache cache = VK_NULL_HANDLE;
  /// Name of the graph segment; may be left out where there is only one.
  std::string graph = {};
  Compile compile = Compile::kAtOnce;
  /// Of the runtime's own, for drivers on the CPU with devices of its own (driver_code.h). 0 is none, but in the background, where
  /// it is half of the processors, at least 2. All but one help to compile the first run's kernels, from create() on.
  uint32_t threads = 0;
  /// Sessions may be pointed at other tensors when they are recorded (Session::update). The device must have enabled
  /// descriptorBindingStorageBufferUpdateAfterBind and descriptorBindingUniformTexelBufferUpdateAfterBind.
  bool update_after_bind = false;
};

/// Pipelines and weights of a graph segment of one variant. Must outlive its sessions; its device
/// must outlive it. May be used from many threads. Its end waits for pipelines that are being made in the background, but
/// for no others.
class DataGraphPipeline {
 public:
  /// Takes the best variant that the device meets (rank.h); `package` may go afterwards. Submits nothing.
  /// Errors: kBadInput if check_package refuses the package, or the variant has no such graph, or
  /// several and none is named; kUnsupported if the graph has histories, which only frame loops
  /// keep; kDevice if the device meets no variant (what is missing is told for each), is out of
  /// memory, or refuses a shader.
  static Result<DataGraphPipeline> create(const vk::Context& device, const Package& package,
                                          const DataGraphPipelineOptions& options = {});
  DataGraphPipeline(DataGraphPipeline&&) noexcept;
  DataGraphPipeline& operator=(DataGraphPipeline&&) noexcept;
  ~DataGraphPipeline();

  /// The chosen variant, without the words of its modules.
  const Variant& variant() const;
  /// The segment that sessions run.
  const Segment& graph() const;

  /// Pipelines that are not there yet; of those that the driver refused, for which start forms go on to serve, too.
  size_t kernels_left() const;
  /// Makes one of them on this thread; false if there is none that nobody makes. Any thread may call it.
  /// Errors: kDevice.
  Result<bool> compile_one();
  /// Returns when all are there, with this thread's help if no others are at work; later records take all of them.
  /// Errors: kDevice, what was refused first.
  Result<void> finish();

  /// Frees the host's copy of the weights, if there is one. The first recorded work must have been
  /// finished by the device, and no other thread may use the pipeline meanwhile. Without it the
  /// copy stays as long as the pipeline.
  void release_staging();

 private:
  friend class Session;
  DataGraphPipeline(std::unique_ptr<Kernels> kernels, const Segment* graph);

  std::unique_ptr<Kernels> kernels_;
  const Segment* graph_;  // of the kernels' variant
};

}  // namespace shale
