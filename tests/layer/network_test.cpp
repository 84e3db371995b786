// NSS v1 HIGH at a small size, from SPIR-V through the extensions, against the interpreter and the package.
#include "compiler/driver/compile.h"
#include "ir/base/file.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"

namespace shale {
namespace {

class NetworkLayerTest : public LayerTest {};

TEST_F(NetworkLayerTest, NssIsExactFrameByFrame) {
  const std::string folder = std::string(SHALE_SOURCE_DIR) + "/models/nss_v1_high/";
  const std::vector<uint8_t> model = must(read_file(folder + "model.tosa"));
  CompileOptions options;
  for (const Graph known = must(import_model(model)); const ValueId id : known.inputs) {
    Shape shape = known.value(id).type.shape;
    ASSERT_EQ(shape.size(), 4u);
    shape[1] = 32, shape[2] = 48;
    options.passes.input_shapes[known.value(id).name] = shape;
  }
  const Graph graph = must(shaped_graph(model, options));
  ClientRun run;
  ASSERT_EQ(run.create(client, graph, {.tiling = VK_TENSOR_TILING_OPTIMAL_ARM}), VK_SUCCESS)
      << client.last_message;
  for (const uint64_t frame : {1, 2, 3}) {
    const std::vector<Tensor> inputs = random_inputs(graph, frame);
    EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs))) << "frame " << frame;
  }
}

TEST_F(NetworkLayerTest, StartsOnKernelsThatAreThereSoonAndGoesOnTheSame) {
  ConvCase row{.name = "heavy", .h = 24, .w = 24, .ic = 32, .oc = 32};
  row.weight_min = -20, row.weight_max = 20;
  const Graph graph = row.graph();
  VkDataGraphPipelineCompilerControlCreateInfoARM control{};
  control.sType = VK_STRUCTURE_TYPE_DATA_GRAPH_PIPELINE_COMPILER_CONTROL_CREATE_INFO_ARM;
  for (const char* vendor : {"expected-runs=1e9", "expected-runs=1e9,compile=at-once"}) {
    control.pVendorOptions = vendor;
    ClientRun run;
    ASSERT_EQ(run.create(client, graph, {.next = &control}), VK_SUCCESS) << client.last_message;
    for (const uint64_t frame : {1, 2, 3}) {
      const std::vector<Tensor> inputs = random_inputs(graph, frame);
      EXPECT_EQ(run.run(inputs), must(interpret(graph, inputs))) << vendor << ", frame " << frame;
    }
  }
}

}  // namespace
}  // namespace shale
