// tests/layer/layer_fixture.h -- Shale's graphs given to the client as SPIR-V, and results back.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "ir/graph/graph.h"
#include "tests/layer/client.h"

namespace shale {

struct GraphOptions {
  bool external_constants = true;
  VkTensorTilingARM tiling = VK_TENSOR_TILING_LINEAR_ARM;
  int64_t padding = 0;     ///< elements behind each row of inputs and outputs; 0 gives no strides
  bool strides = false;    ///< says them for packed rows, too
  bool unordered = false;  ///< bindings with gaps, against the order of the tensors
  bool chained = false;    ///< the code comes with the pipeline
  bool sparse = false;     ///< constants may have two zeros of each four elements
  VkPipelineCreateFlags2 flags = 0;
  VkPipelineCache cache = VK_NULL_HANDLE;
  VkDescriptorSetLayoutCreateFlags set_flags = 0;
  void* next = nullptr;
};

/// A graph in the client's hands: module, pipeline, session, and a tensor for each input and output.
class ClientRun {
 public:
  ClientRun() = default;
  ClientRun(const ClientRun&) = delete;
  ClientRun& operator=(const ClientRun&) = delete;
  ~ClientRun() { destroy(); }
  /// Before the client is closed.
  void destroy();

  VkResult create(const Client& client, const Graph& graph, const GraphOptions& options = {});
  VkResult create(const Client& client, const Graph& graph, const SpirvGraphModule& module,
                  const GraphOptions& options);
  void write(const std::vector<Tensor>& inputs);
  VkResult submit();
  std::vector<Tensor> read() const;
  /// All in one; stops the test where something fails.
  std::vector<Tensor> run(const std::vector<Tensor>& inputs);

  ClientGraph graph{};
  std::vector<ClientTensor> tensors;  ///< inputs, then outputs

 private:
  const Client* client_ = nullptr;
  std::vector<TensorType> types_;
  size_t input_count_ = 0;
};

/// A buffer in memory that the host sees; both last until the client is closed.
struct HostBuffer {
  VkBuffer buffer = VK_NULL_HANDLE;
  VkDeviceMemory memory = VK_NULL_HANDLE;
  void* mapped = nullptr;
};

/// A compute pipeline and its layout, of one set.
struct ComputePipeline {
  VkPipelineLayout layout = VK_NULL_HANDLE;
  VkPipeline pipeline = VK_NULL_HANDLE;
};

/// A validation layer that knows the extensions stands above: it says itself what is wrong with a call.
/// tests/drivers/run.sh sets SHALE_VALIDATED.
bool validated();
#define SHALE_SKIP_IF_VALIDATED() \
  if (validated()) GTEST_SKIP() << "calls that are wrong on purpose"

/// A graph of one operator.
inline constexpr const char* kDouble = R"(
graph main {
  input %x : i32[1,9]
  %y = add %x, %x : i32[1,9]
  return %y
}
)";

/// A client per test; skips without a device, fails where validation has spoken.
class LayerTest : public testing::Test {
 protected:
  void SetUp() override;
  void TearDown() override;
  /// Freed by TearDown. Fails the test, and maps nothing, where it cannot be made.
  HostBuffer host_buffer(VkDeviceSize bytes, VkBufferUsageFlags usage, const void* next = nullptr);

  /// Of a shader as SPIR-V text, its code in a module or, if `chained`, with the stage. Fails the test where it cannot be made.
  ComputePipeline compute_pipeline(VkDescriptorSetLayout set_layout, const char* text,
                                   VkPipelineCreateFlags flags = 0, bool chained = false) const;
  void destroy(const ComputePipeline& made) const;

  Client client{};
  bool is_open = false;

 private:
  std::vector<HostBuffer> buffers_;
};

}  // namespace shale
