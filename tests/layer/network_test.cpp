// NSS v1 HIGH at a small size, from SPIR-V through the extensions, against the interpreter and the package.
#include "compiler/driver/compile.h"
#include "ir/base/file.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"
#include "tests/support/source_folder.h"

namespace shale {
namespace {

class NetworkLayerTest : public LayerTest {};

TEST_F(NetworkLayerTest, NssIsExactFrameByFrame) {
  const std::string folder = source_folder() + "/models/nss_v1_high/";
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

}  // namespace
}  // namespace shale
