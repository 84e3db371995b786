#include "runtime/datagraph/pipeline.h"

#include <algorithm>

#include "runtime/datagraph/dispatch.h"

namespace shale {

Result<DataGraphPipeline> DataGraphPipeline::create(const vk::Context& device,
                                                    const Package& package,
                                                    const DataGraphPipelineOptions& options) {
  const auto has_graph = [](const Variant& variant) {
    return std::any_of(variant.segments.begin(), variant.segments.end(),
                       [](const Segment& s) { return s.kind == SegmentKind::kGraph; });
  };
  if (!std::all_of(package.variants.begin(), package.variants.end(), has_graph))
    return bad_input("", "the package has no network, only passes");
  SHALE_TRY(auto kernels, Kernels::create(device, package, Scope::kGraph, options.cache));
  return DataGraphPipeline(std::move(kernels));
}

DataGraphPipeline::DataGraphPipeline(std::unique_ptr<Kernels> kernels)
    : kernels_(std::move(kernels)) {}
DataGraphPipeline::DataGraphPipeline(DataGraphPipeline&&) noexcept = default;
DataGraphPipeline& DataGraphPipeline::operator=(DataGraphPipeline&&) noexcept = default;
DataGraphPipeline::~DataGraphPipeline() = default;

const Variant& DataGraphPipeline::variant() const { return kernels_->variant(); }

const Segment& DataGraphPipeline::graph() const {
  const std::vector<Segment>& segments = variant().segments;
  return *std::find_if(segments.begin(), segments.end(),
                       [](const Segment& segment) { return segment.kind == SegmentKind::kGraph; });
}

}  // namespace shale
