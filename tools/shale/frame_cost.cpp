#include "tools/shale/frame_cost.h"

#include <algorithm>

#include "compiler/plan/run_pass.h"
#include "compiler/spirv/operations.h"

namespace shale {
namespace {

/// Pixels and bytes of an image or a tensor of the frame.
struct Extent {
  double pixels = 0, bytes = 0;
};

std::optional<Extent> extent_of(const Frame& frame, const std::string& name, FrameExtent render,
                                FrameExtent output, const Graph* graph) {
  for (const FrameImage& image : frame.images) {
    if (image.name != name) continue;
    const FrameExtent extent = image.size(render, output);
    const double pixels = static_cast<double>(extent.width) * extent.height;
    return Extent{pixels, pixels * image_format_info(image.format).texel_bytes};
  }
  const std::optional<ValueId> id = graph ? graph->find_value(name) : std::nullopt;
  if (!id) return std::nullopt;
  const TensorType& type = graph->value(*id).type;
  const double elements = static_cast<double>(element_count(type.shape).value_or(0));
  return Extent{type.shape.size() == 4 ? elements / static_cast<double>(type.shape[3]) : elements,
                elements * dtype_info(type.dtype).host_bytes};
}

}  // namespace

Result<FrameCost> FrameCost::create(const ModelFiles& model, const CompileOptions& options) {
  FrameCost cost(model, options);
  if (!model.frame) return cost;
  CompileOptions gpu = options;
  gpu.targets = {"generic-gpu"};
  gpu.choices.clear();
  gpu.require_proof = false;
  SHALE_TRY(const Compiled compiled, compile_model(model, gpu));
  const Variant& variant = compiled.package.variants.front();
  for (const Segment& segment : variant.segments) {
    if (segment.kind != SegmentKind::kCompute) continue;
    for (const Dispatch& dispatch : segment.dispatches) {
      SHALE_TRY(cost.operations_[dispatch.name],
                spirv_operations(variant.modules[dispatch.module], dispatch.name));
    }
  }
  return cost;
}

Result<std::vector<PassWork>> FrameCost::passes(FrameExtent render, FrameExtent output,
                                                const Graph* graph) const {
  const Frame& frame = *model_->frame;
  std::vector<const FramePromise*> kept;
  if (options_.needs) kept = kept_promises(frame, *options_.needs, render);
  std::vector<FramePass> passes;
  for (const FrameProgram& program : frame.programs) {
    for (RunPass& run : run_passes(program, kept))  // generated ones are next to nothing
      if (!run.pass.shader.empty() && run.runs != Runs::kBroken)
        passes.push_back(std::move(run.pass));
    if (!frame.chosen_by.empty())
      break;  // of programs that a parameter chooses among, a frame runs one
  }
  std::vector<PassWork> works;
  for (const FramePass& pass : passes) {
    PassWork work{.name = pass.name};
    double pixels = 0;
    if (pass.over_size) {
      const FrameExtent grid = (*pass.over_size)(render, output);
      pixels = static_cast<double>(grid.width) * grid.height;
    } else if (const auto over = extent_of(frame, pass.over, render, output, graph)) {
      pixels = over->pixels;
    }
    if (const auto known = operations_.find(pass.name); known != operations_.end())
      work.operations = known->second * pixels;
    const auto add = [&](const std::string& name, int times) -> Result<void> {
      if (name == kBrokenImage) return {};  // a word
      const std::optional<Extent> extent = extent_of(frame, name, render, output, graph);
      if (!extent)
        return bad_input("pass \"" + pass.name + "\"", "there is no image or tensor \"{}\"", name);
      work.bytes += extent->bytes * times;
      return {};
    };
    for (const std::string& name : pass.clears) SHALE_TRY_VOID(add(name, 1));
    for (const FrameBinding& binding : pass.bindings) {
      SHALE_TRY_VOID(add(binding.name, int{binding.reads} + int{binding.writes}));
      for (const FrameImage& image : frame.images)
        if (binding.writes && image.shows == binding.name) SHALE_TRY_VOID(add(image.name, 1));
    }
    works.push_back(std::move(work));
  }
  return works;
}

Result<FrameCost::Modelled> FrameCost::at(const FrameSizes& sizes,
                                          const ModelledDevice& device) const {
  CompileOptions options = options_;
  options.sizes = sizes;
  Modelled modelled;
  std::optional<Graph> shaped;
  if (!model_->bytes.empty()) {
    SHALE_TRY(shaped, shaped_graph(model_->bytes, options));
    SHALE_TRY(const Graph fused, fused_graph(*shaped, options));
    modelled.network = model_network(fused, device);
  }
  std::vector<PassWork> works;
  if (model_->frame) {
    SHALE_TRY(const auto extents, frame_sizes(*model_->frame, sizes));
    SHALE_TRY(works, passes(extents.first, extents.second, shaped ? &*shaped : nullptr));
  }
  modelled.frame = model_frame(works, modelled.network ? &*modelled.network : nullptr, device);
  return modelled;
}

Json passes_json(const ModelledFrame& frame) {
  Json json = Json::array();
  for (const ModelledPass& pass : frame.passes)
    json.push_back({{"name", pass.name},
                    {"memory_mb", 1e-6 * pass.bytes},
                    {"gop", 1e-9 * pass.operations},
                    {"memory_ms", 1e-3 * pass.memory_us},
                    {"compute_ms", 1e-3 * pass.compute_us},
                    {"time_ms", 1e-3 * pass.time_us},
                    {"bound", pass.memory_bound() ? "memory" : "compute"}});
  return json;
}

}  // namespace shale
