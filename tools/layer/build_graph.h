// tools/layer/build_graph.h -- a data graph pipeline's create info as plain data, and its package.
#pragma once

#include "tools/layer/graph.h"

namespace shale::layer {

/// Everything that shapes a pipeline, checked as far as that goes without reading the graph.
struct GraphSource {
  struct Resource {
    uint32_t set = 0, binding = 0;
    TensorLayout layout;
  };
  struct Constant {
    uint32_t id = 0;
    TensorLayout layout;
    std::vector<uint8_t> bytes;  ///< packed
  };
  std::vector<uint32_t> words;  ///< specialized
  std::string entry_point;
  std::vector<Resource> resources;
  std::vector<Constant> constants;
  double expected_runs = 0;
};

/// Reads a create info that has a shader module.
/// Errors: kBadInput for what breaks a rule, kUnsupported for what is not reported as supported.
Result<GraphSource> read_source(Device& device, const VkDataGraphPipelineCreateInfoARM& info,
                                const VkDataGraphPipelineShaderModuleCreateInfoARM& module);

/// What the create info or the environment asks for: by default in the background.
Compile compile_when(const VkDataGraphPipelineCreateInfoARM& info);

/// Equal for what makes equal packages and layouts on the device with this layer.
Identifier identify(const Device& device, const GraphSource& source);

/// Compiles the graph for the device. Each input and output of the package carries in its name where
/// its descriptor is and how its tensor lies (graph_tensors), so that the package alone makes a pipeline.
/// `log` gets what there is to tell.
/// Errors: those of frontend, verifier and compiler; kBadInput where module and resources differ.
Result<Package> compile_source(const Device& device, const GraphSource& source, std::string& log);

/// Inputs and outputs of a package of compile_source.
/// Errors: kBadInput for a package of other origin.
Result<std::vector<GraphTensor>> graph_tensors(const Variant& variant);

}  // namespace shale::layer
