// The TOSA reference model's cases as SPIR-V graphs through the extensions: expected results bit for bit, invalid
// graphs refused.
#include <filesystem>
#include <nlohmann/json.hpp>

#include "compiler/frontend/frontend.h"
#include "ir/base/file.h"
#include "ir/verify/verify.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"
#include "tools/shale/npy.h"

namespace shale {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

std::vector<fs::path> cases_below(const fs::path& root) {
  std::vector<fs::path> cases;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root))
    if (entry.path().filename() == "desc.json") cases.push_back(entry.path().parent_path());
  std::sort(cases.begin(), cases.end());
  return cases;
}

std::vector<Tensor> arrays(const fs::path& folder, const Json& description, const char* key,
                           const Graph& graph, const std::vector<ValueId>& ids) {
  std::vector<Tensor> tensors;
  for (const ValueId id : ids)
    for (const Json& entry : description.at(key))
      if (entry.at("name") == graph.value(id).name)
        tensors.push_back(must(read_npy((folder / entry.at("file").get<std::string>()).string(),
                                        graph.value(id).type)));
  return tensors;
}

class GoldenLayerTest : public LayerTest {
 protected:
  const fs::path root = fs::path(SHALE_BINARY_DIR) / "golden" / "tosa";
};

TEST_F(GoldenLayerTest, EveryCaseIsExact) {
  size_t passed = 0;
  for (const fs::path& folder : cases_below(root)) {
    const Json description = Json::parse(must(read_text((folder / "desc.json").string())));
    if (description.at("expect") != "accept") continue;
    SCOPED_TRACE(folder.string());
    const Graph graph = must(import_model(must(read_file((folder / "graph.tosa").string()))));
    // The extensions have no tensors of rank 0 and none of no elements.
    const auto written = write_spirv_graph(graph, {.external_constants = passed % 2 == 0});
    ASSERT_TRUE(written) << error_text(written);
    ClientRun run;
    ASSERT_EQ(run.create(client, graph, *written, {}), VK_SUCCESS) << client.last_message;
    const auto outputs = run.run(arrays(folder, description, "inputs", graph, graph.inputs));
    const auto expected = arrays(folder, description, "outputs", graph, graph.outputs);
    ASSERT_EQ(outputs.size(), expected.size());
    for (size_t i = 0; i < outputs.size(); ++i) EXPECT_EQ(outputs[i].bytes, expected[i].bytes) << i;
    ++passed;
  }
  EXPECT_GT(passed, 600u);
  EXPECT_EQ(client.other_messages, 0u) << client.last_message;
}

TEST_F(GoldenLayerTest, EveryInvalidGraphIsRefused) {
  SHALE_SKIP_IF_VALIDATED();
  size_t refused = 0;
  for (const fs::path& folder : cases_below(root / "invalid")) {
    SCOPED_TRACE(folder.string());
    // What TOSA's own file format cannot hold never becomes a module.
    const Result<Graph> graph = import_model(must(read_file((folder / "graph.tosa").string())));
    if (!graph) continue;
    ASSERT_FALSE(verify(*graph));
    const auto written = write_spirv_graph(*graph, {.external_constants = true, .verified = false});
    if (!written) continue;
    ClientRun run;
    EXPECT_LT(run.create(client, *graph, *written, {}), 0);
    EXPECT_EQ(run.graph.pipeline, VkPipeline{VK_NULL_HANDLE});
    ++refused;
  }
  EXPECT_GT(refused, 20u);
}

}  // namespace
}  // namespace shale
