#include "runtime/datagraph/pipeline.h"

#include "runtime/datagraph/dispatch.h"

namespace shale {

namespace {

/// Errors: as DataGraphPipeline::create says.
Result<const Segment*> find_graph(const Variant& variant, const std::string& name) {
  const Segment* found = nullptr;
  for (const Segment& segment : variant.segments) {
    if (segment.kind != SegmentKind::kGraph || (!name.empty() && segment.name != name)) continue;
    if (found)
      return bad_input("",
                       "the package has several networks, such as \"{}\" and \"{}\", and none is "
                       "named",
                       found->name, segment.name);
    found = &segment;
  }
  if (!found && !name.empty()) return bad_input("", "the package has no network \"{}\"", name);
  if (!found) return bad_input("", "the package has no network, only passes");
  for (const Dispatch& dispatch : found->dispatches)
    for (const Binding& binding : dispatch.bindings)
      if (variant.resources[binding.resource].history_depth != 0)
        return unsupported(fmt::format("tensor \"{}\"", variant.resources[binding.resource].name),
                           "is a history, which only a frame loop keeps");
  return found;
}

}  // namespace

Result<DataGraphPipeline> DataGraphPipeline::create(const vk::Context& device,
                                                    const Package& package,
                                                    const DataGraphPipelineOptions& options) {
  const Segment* graph = nullptr;
  const auto select = [&](const Variant& variant) -> Result<std::vector<std::span<const Segment>>> {
    SHALE_TRY(graph, find_graph(variant, options.graph));
    return std::vector{std::span(graph, 1)};
  };
  SHALE_TRY(auto kernels, Kernels::create(device, package, select,
                                          {options.cache, options.compile, options.threads,
                                           options.update_after_bind}));
  return DataGraphPipeline(std::move(kernels), graph);
}

DataGraphPipeline::DataGraphPipeline(std::unique_ptr<Kernels> kernels, const Segment* graph)
    : kernels_(std::move(kernels)), graph_(graph) {}
DataGraphPipeline::DataGraphPipeline(DataGraphPipeline&&) noexcept = default;
DataGraphPipeline& DataGraphPipeline::operator=(DataGraphPipeline&&) noexcept = default;
DataGraphPipeline::~DataGraphPipeline() = default;

const Variant& DataGraphPipeline::variant() const { return kernels_->variant(); }

const Segment& DataGraphPipeline::graph() const { return *graph_; }

size_t DataGraphPipeline::kernels_left() const { return kernels_->left(); }

Result<bool> DataGraphPipeline::compile_one() { return kernels_->compile_one(); }

Result<void> DataGraphPipeline::finish() { return kernels_->finish(); }

void DataGraphPipeline::release_staging() { kernels_->release_staging(); }

}  // namespace shale
