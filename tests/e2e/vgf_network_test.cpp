// A network in the form in which NSS v0.1.1 is shipped: a VGF file whose module knows only the ranks
// of its activations, whose resource table leaves height and width open, with constants partly in the
// module, and the last upsampling written once for each head. Source: nss.md section 1.4.
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <regex>
#include <set>

#include "compiler/driver/compile.h"
#include "compiler/frontend/spirv_graph/spirv_graph.h"
#include "compiler/frontend/vgf/convert.h"
#include "ir/base/file.h"
#include "ir/binary/tosa.h"
#include "tests/compiler/graph_support.h"
#include "tests/compiler/spirv_text.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

/// Each reader of the value after the first gets a RESIZE of its own.
Graph with_repeated_resize(Graph graph, const std::string& name) {
  const ValueId shared = *graph.find_value(name);
  std::vector<Node> nodes;
  Node resize;
  bool first = true;
  for (Node node : std::vector<Node>(graph.nodes)) {
    if (node.output == shared) resize = node;
    if (node.inputs[0] == shared) {
      if (!first) {
        Node again = resize;
        again.output = graph.add_value(name, graph.value(shared).type);
        node.inputs[0] = again.output;
        nodes.push_back(again);
      }
      first = false;
    }
    nodes.push_back(node);
  }
  graph.nodes = std::move(nodes);
  return graph;
}

/// The module with tensors of rank 4 known by their rank alone, where they are no constants; types
/// that become equal are one.
std::vector<uint32_t> with_ranks_alone(const std::vector<uint32_t>& words) {
  const std::string text = spirv_text(words);
  std::map<std::string, std::string> constant_of;  // integer constants by id
  std::set<std::string> kept;                      // types of constants
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    std::smatch m;
    if (std::regex_match(line, m, std::regex("(%\\d+) = OpConstant %\\d+ (\\d+)")))
      constant_of[m[1].str()] = m[2].str();
    if (std::regex_search(line, m,
                          std::regex("= (?:OpGraphConstantARM|OpConstantComposite|OpConstantNull|"
                                     "OpConstantCompositeReplicateEXT) (%\\d+)")))
      kept.insert(m[1].str());
  }
  std::map<std::string, std::string> first_of, renamed;
  std::string result;
  std::istringstream again(text);
  for (std::string line; std::getline(again, line);) {
    std::smatch m;
    if (std::regex_match(line, m, std::regex("(%\\d+) = OpTypeTensorARM (%\\d+) (%\\d+) %\\d+")) &&
        constant_of[m[3].str()] == "4" && !kept.contains(m[1].str())) {
      const std::string kind = m[2].str() + " " + m[3].str();
      const auto [entry, is_new] = first_of.try_emplace(kind, m[1].str());
      renamed[m[1].str()] = entry->second;
      if (is_new) result += m[1].str() + " = OpTypeTensorARM " + kind + "\n";
      continue;
    }
    result += line + "\n";
  }
  std::string unified;
  const std::regex id("%\\d+");
  auto at = std::sregex_iterator(result.begin(), result.end(), id);
  size_t end = 0;
  for (; at != std::sregex_iterator(); ++at) {
    const size_t from = static_cast<size_t>(at->position());
    const auto name = renamed.find(at->str());
    unified += result.substr(end, from - end) + (name == renamed.end() ? at->str() : name->second);
    end = from + static_cast<size_t>(at->length());
  }
  return assemble_spirv(unified + result.substr(end));
}

std::vector<uint8_t> shipped_file(const Graph& graph) {
  Vgf vgf = must(graph_to_vgf(graph));
  vgf.modules[0].words = with_ranks_alone(vgf.modules[0].words);
  for (VgfResource& resource : vgf.resources)
    if (resource.category != VgfCategory::kConstant)
      resource.shape[1] = resource.shape[2] = std::numeric_limits<int64_t>::min();
  return must(write_vgf(vgf));
}

TEST(VgfNetwork, ShapedLikeTheShippedNssCompilesToItsConvolutionsAndRunsExactly) {
  const std::string folder = SHALE_SOURCE_DIR "/models/nss_v0_1/";
  const Graph original = must(read_tosa(must(read_file(folder + "model.tosa"))));
  // The value that the six heads read.
  const auto is_resize = [](const Node& node) { return node.op == Op::kResize; };
  const auto last = std::find_if(original.nodes.rbegin(), original.nodes.rend(), is_resize);
  ASSERT_NE(last, original.nodes.rend());
  const Graph repeated = with_repeated_resize(original, original.value(last->output).name);
  ASSERT_EQ(repeated.nodes.size(), 52u);
  EXPECT_EQ(std::count_if(repeated.nodes.begin(), repeated.nodes.end(), is_resize), 8);
  ASSERT_TRUE(verify(repeated));
  const std::vector<uint8_t> file = shipped_file(repeated);

  const Graph open = must(import_model(file));
  EXPECT_EQ(open.nodes.size(), 52u);
  EXPECT_EQ(open.value(open.inputs[0]).type.shape, (Shape{1, kDynamic, kDynamic, 12}));

  CompileOptions options;
  options.kernels = {"generic"};  // code that the driver compiles at once
  options.passes.input_shapes["input"] = {1, 64, 64, 12};
  const Compiled compiled = must(compile(file, options));
  size_t convolutions = 0, others = 0;
  for (const Dispatch& dispatch : compiled.package.variants[0].segments[0].dispatches)
    ++(dispatch.cost.macs > 0 ? convolutions : others);
  EXPECT_LE(convolutions, 18u);
  EXPECT_EQ(others, 0u) << "the resize of the six heads, folded into each";

  const Graph small = must(shaped_graph(must(read_file(folder + "model.tosa")), options));
  const std::vector<Tensor> inputs = random_inputs(small, 7);
  const std::vector<Tensor> expected = must(interpret(small, inputs));
  ToolDevice device = must(ToolDevice::open({.name = {}, .cache = {}, .validation = true}));
  const std::vector<Tensor> found = must(run_network(device, compiled.package, inputs));
  ASSERT_EQ(found.size(), 6u);
  EXPECT_TRUE(found == expected);
  const Result<void> silent = device.close();
  EXPECT_TRUE(silent) << error_text(silent);
}

}  // namespace
}  // namespace shale
