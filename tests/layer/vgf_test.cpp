// The network of a sandwich as a VGF file on the layer, beside the package that plays the sandwich: frame by frame
// the same bits.
#include "compiler/frontend/vgf/vgf.h"

#include "compiler/frontend/frontend.h"
#include "compiler/frontend/vgf/convert.h"
#include "compiler/frontend/vgf/formats.h"
#include "tests/compiler/graph_support.h"
#include "tests/layer/layer_fixture.h"
#include "tests/support/source_folder.h"
#include "tools/scene/scene.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr Extent kRender{48, 40}, kOutput{96, 80};

/// The module of a file's only segment, with its constants.
SpirvGraphModule module_of(const Vgf& file) {
  EXPECT_EQ(file.segments.size(), 1u);
  const VgfSegment& segment = file.segments.at(0);
  const VgfModule& module = file.modules.at(segment.module);
  EXPECT_EQ(module.type, VgfModuleType::kGraph);
  SpirvGraphModule result{module.words, {}, module.entry_point};
  for (const uint32_t index : segment.constants) {
    const VgfConstant& constant = file.constants.at(index);
    const VgfResource& resource = file.resources.at(constant.resource);
    result.constants.push_back(
        {{dtype_of_vk_format(resource.format), resource.shape}, constant.bytes});
  }
  return result;
}

class VgfLayerTest : public LayerTest {};

TEST_F(VgfLayerTest, TheNetworkOfASandwichIsExactFrameByFrame) {
  const std::string models = source_folder() + "/models/";
  const ToolDevice device = must(ToolDevice::open({}));
  const Sandwich sandwich = must(load_sandwich(models + "nss_v1_high", {}, kRender, kOutput));
  ASSERT_EQ(sandwich.graphs.size(), 1u);
  const std::vector<uint8_t> bytes = must(write_vgf(must(graph_to_vgf(sandwich.graphs[0]))));
  const Graph graph = must(import_model(bytes));
  ClientRun run;
  ASSERT_EQ(run.create(client, graph, module_of(must(read_vgf(bytes))), {}), VK_SUCCESS)
      << client.last_message;

  const std::unique_ptr<Player> player = must(Player::create(device, sandwich.package));
  const Scene scene = must(load_scene(models + "scenes/test/motion.json"));
  SceneOptions options;
  options.render = kRender, options.output = kOutput;
  const std::unique_ptr<SceneSource> source =
      must(SceneSource::create(device.context(), scene, std::move(options)));
  for (uint32_t frame = 0; frame < 3; ++frame) {
    SourceFrame rendered = must(source->frame(frame, false));
    must(player->show(rendered));
    std::vector<Tensor> inputs, expected;
    for (const ValueId id : graph.inputs)
      inputs.push_back(must(player->read_tensor(graph.value(id).name)));
    for (const ValueId id : graph.outputs)
      expected.push_back(must(player->read_tensor(graph.value(id).name)));
    EXPECT_EQ(run.run(inputs), expected) << "frame " << frame;
  }
}

}  // namespace
}  // namespace shale
