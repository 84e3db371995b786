#include <algorithm>

#include "compiler/cost/cost.h"
#include "compiler/plan/plan.h"
#include "ir/base/hash.h"
#include "ir/base/parallel.h"

namespace shale {

uint64_t WeightBlob::add(const std::vector<uint8_t>& bytes) {
  const uint64_t hash = stable_hash(bytes);
  const auto [first, last] = offsets_.equal_range(hash);
  for (auto entry = first; entry != last; ++entry) {
    const auto [offset, size] = entry->second;
    if (size == bytes.size() &&
        std::equal(bytes.begin(), bytes.end(), blob.begin() + static_cast<std::ptrdiff_t>(offset)))
      return offset;
  }
  blob.resize((blob.size() + kBufferAlignment - 1) / kBufferAlignment * kBufferAlignment);
  const uint64_t offset = blob.size();
  blob.insert(blob.end(), bytes.begin(), bytes.end());
  offsets_.emplace(hash, std::pair{offset, bytes.size()});
  return offset;
}

std::string unused_dispatch_name(const Plan& plan, std::string name) {
  const auto is_taken = [&](const Segment& segment) {
    return std::any_of(segment.dispatches.begin(), segment.dispatches.end(),
                       [&](const Dispatch& other) { return other.name == name; });
  };
  while (std::any_of(plan.variant.segments.begin(), plan.variant.segments.end(), is_taken))
    name += '#';
  return name;
}

namespace {

const Resource* find_resource(const Plan& plan, std::string_view name) {
  for (const Resource& resource : plan.variant.resources)
    if (resource.name == name) return &resource;
  return nullptr;
}

std::string unused_name(const Plan& plan, std::string name) {
  while (find_resource(plan, name)) name += '#';
  return name;
}

Resource tensor_resource(const Value& value, std::string name, Category category) {
  Resource resource;
  resource.name = std::move(name);
  resource.category = category;
  resource.dtype = value.type.dtype;
  resource.shape = value.type.shape;
  resource.size_bytes = static_cast<uint64_t>(element_count(value.type.shape).value_or(0)) *
                        dtype_info(value.type.dtype).host_bytes;
  return resource;
}

const std::string& interface_name(const PlannedGraph& graph, const std::string& name) {
  const auto renamed = graph.renamed.find(name);
  return renamed == graph.renamed.end() ? name : renamed->second;
}

/// A part's share of a group's cost.
Cost share(Cost cost, double time_us, size_t parts) {
  cost.macs /= parts;
  cost.ops /= parts;
  cost.bytes_written /= parts;
  cost.time_us = time_us;
  return cost;
}

/// Resources of one graph's values, made as the dispatches come to them.
class Tensors {
 public:
  Tensors(Plan& plan, const PlannedGraph& graph, WeightBlob& weights)
      : plan_(plan), graph_(*graph.graph), suffix_(graph.suffix), weights_(weights) {
    const auto known = [&](ValueId id) {
      const Resource* resource = find_resource(plan, interface_name(graph, graph_.value(id).name));
      index_.emplace(id, static_cast<uint32_t>(resource - plan.variant.resources.data()));
    };
    for (const ValueId id : graph_.inputs) known(id);
    for (const ValueId id : graph_.outputs) known(id);
  }

  uint32_t of(ValueId id) {
    const auto found = index_.find(id);
    if (found != index_.end()) return found->second;
    const Value& value = graph_.value(id);
    Resource resource =
        tensor_resource(value, unused_name(plan_, value.name + suffix_),
                        value.is_constant() ? Category::kWeights : Category::kIntermediate);
    if (value.is_constant()) resource.offset_bytes = weights_.add(value.constant->bytes);
    return index_.emplace(id, add(std::move(resource))).first->second;
  }

  /// Constants as one kernel wants them: a tensor of bytes of its own.
  uint32_t packed(const std::vector<uint8_t>& bytes, const std::string& dispatch) {
    Resource resource;
    resource.name = dispatch + "#packed";
    while (graph_.find_value(resource.name) || find_resource(plan_, resource.name))
      resource.name += '#';
    resource.category = Category::kWeights;
    resource.dtype = DType::kInt8;
    resource.shape = {static_cast<int64_t>(bytes.size())};
    resource.size_bytes = bytes.size();
    resource.offset_bytes = weights_.add(bytes);
    return add(std::move(resource));
  }

 private:
  uint32_t add(Resource resource) {
    plan_.variant.resources.push_back(std::move(resource));
    return static_cast<uint32_t>(plan_.variant.resources.size() - 1);
  }

  Plan& plan_;
  const Graph& graph_;
  const std::string& suffix_;
  WeightBlob& weights_;
  std::map<ValueId, uint32_t> index_;
};

std::string dispatch_name(const Plan& plan, const Graph& graph, const std::string& result,
                          size_t part) {
  std::string name = part == 0 ? result : fmt::format("{}#{}", result, part);
  while (part > 0 && graph.find_value(name)) name += '#';  // a value may be called so
  return unused_dispatch_name(plan, std::move(name));
}

Binding planned_binding(uint32_t number, const KernelBinding& from, uint32_t resource) {
  return {.binding = number,
          .type = from.type,
          .resource = resource,
          .view_format =
              from.type == BindingType::kUniformTexelBuffer ? from.view_format : ImageFormat::kNone,
          .reads = !from.writes,
          .writes = from.writes,
          .frames_back = 0};
}

}  // namespace

Result<void> plan_interface(Plan& plan, const PlannedGraph& graph) {
  const auto add = [&](ValueId id, Category category) -> Result<void> {
    const Value& value = graph.graph->value(id);
    Resource resource = tensor_resource(value, interface_name(graph, value.name), category);
    Resource* known = nullptr;
    for (Resource& other : plan.variant.resources)
      if (other.name == resource.name) known = &other;
    if (!known) {
      plan.variant.resources.push_back(std::move(resource));
      return {};
    }
    const std::string where = fmt::format("graph \"{}\", tensor \"{}\"", graph.name, resource.name);
    if (known->dtype != resource.dtype || known->shape != resource.shape)
      return bad_input(where, "is {}{}, but {}{} in another graph of the package",
                       dtype_info(resource.dtype).name, shape_text(resource.shape),
                       dtype_info(known->dtype).name, shape_text(known->shape));
    if (category == Category::kOutput) {
      if (known->category == Category::kOutput && !graph.is_alternative)
        return bad_input(where, "is an output of two graphs of the package");
      known->category = Category::kOutput;  // one graph gives what the other takes
    }
    return {};
  };
  for (const ValueId id : graph.graph->inputs) SHALE_TRY_VOID(add(id, Category::kInput));
  for (const ValueId id : graph.graph->outputs) SHALE_TRY_VOID(add(id, Category::kOutput));
  return {};
}

Result<void> plan_graph(Plan& plan, const PlannedGraph& graph, uint32_t program,
                        const DeviceProfile& profile, WeightBlob& weights) {
  std::vector<Result<std::vector<KernelSource>>> groups(graph.problems.size(),
                                                        std::vector<KernelSource>{});
  parallel_for(groups.size(), [&](size_t i) {
    groups[i] = graph.selection.families[i]->emit(graph.problems[i], profile);
  });
  Segment segment;
  segment.name = graph.name;
  const auto is_taken = [&](const Segment& before) { return before.name == segment.name; };
  const bool graph_was_planned =  // for another program, or in another place
      std::any_of(plan.variant.segments.begin(), plan.variant.segments.end(), is_taken);
  while (std::any_of(plan.variant.segments.begin(), plan.variant.segments.end(), is_taken))
    segment.name += '#';
  segment.kind = SegmentKind::kGraph;
  segment.program = program;
  uint32_t number = 0;  // of the dispatch, all programs counted through
  for (const Segment& before : plan.variant.segments)
    number += static_cast<uint32_t>(before.dispatches.size());
  Tensors tensors(plan, graph, weights);
  std::map<std::string, uint32_t> known;  // equal sources are compiled once
  for (uint32_t i = 0; i < plan.sources.size(); ++i) known.emplace(plan.sources[i].glsl, i);
  for (size_t i = 0; i < groups.size(); ++i) {
    if (!groups[i]) return groups[i].error();
    const GroupProblem& problem = graph.problems[i];
    const KernelFamily& family = *graph.selection.families[i];
    std::vector<KernelSource>& sources = *groups[i];
    WorkTable work = family.work(problem, profile);
    work[Work::kDispatch] = static_cast<double>(sources.size());
    for (double& amount : work) amount /= static_cast<double>(sources.size());
    for (size_t part = 0; part < sources.size(); ++part) {
      KernelSource& source = sources[part];
      Dispatch dispatch;
      dispatch.name = dispatch_name(
          plan, *graph.graph, graph.graph->value(problem.group.result).name + graph.suffix, part);
      dispatch.kernel = family.name;
      dispatch.workgroups = source.workgroups;
      dispatch.cost = share(problem.cost, work_time_us(work, profile.ns), sources.size());
      plan.work.push_back(work);
      const auto [entry, is_new] =
          known.try_emplace(source.glsl, static_cast<uint32_t>(plan.sources.size()));
      if (is_new)
        plan.sources.push_back({.glsl = std::move(source.glsl),
                                .optimize = source.optimize,
                                .defines = {},
                                .where = dispatch.name,
                                .load = {}});
      dispatch.module = entry->second;
      for (uint32_t binding = 0; binding < source.bindings.size(); ++binding) {
        const KernelBinding& from = source.bindings[binding];
        const uint32_t resource = from.constant.empty()
                                      ? tensors.of(from.value)
                                      : tensors.packed(from.constant, dispatch.name);
        dispatch.bindings.push_back(planned_binding(binding, from, resource));
        const Resource& bound = plan.variant.resources[resource];
        if (bound.category == Category::kIntermediate)
          plan.live.try_emplace(resource, LiveInterval{number, number, bound.size_bytes})
              .first->second.last = number;
      }
      ++number;
      segment.dispatches.push_back(std::move(dispatch));
    }
    if (problem.proof && !graph_was_planned) plan.variant.proofs.push_back(*problem.proof);
  }
  plan.variant.segments.push_back(std::move(segment));
  return {};
}

void place_intermediates(Plan& plan) {
  std::vector<LiveInterval> intervals;
  for (const auto& [resource, interval] : plan.live) intervals.push_back(interval);
  const MemoryPlan places = plan_memory(intervals, kBufferAlignment);
  size_t i = 0;
  for (const auto& [resource, interval] : plan.live)
    plan.variant.resources[resource].offset_bytes = places.offsets[i++];
  plan.variant.arena_bytes = places.arena_bytes;
  plan.arena_lower_bound_bytes = places.lower_bound_bytes;
}

}  // namespace shale
