#include <algorithm>

#include "compiler/cost/cost.h"
#include "compiler/plan/tile_plan.h"
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

  /// What dispatches bind for a graph input from now on.
  void replace(ValueId input, uint32_t resource) { index_[input] = resource; }

  /// A tensor of the segment's own, which no value is.
  uint32_t own(std::string name, DType dtype, Shape shape, Category category) {
    Resource resource = tensor_resource({"", {dtype, std::move(shape)}, {}}, "", category);
    resource.name = std::move(name);
    while (graph_.find_value(resource.name) || find_resource(plan_, resource.name))
      resource.name += '#';
    return add(std::move(resource));
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
    const uint32_t index = own(dispatch + "#packed", DType::kInt8,
                               {static_cast<int64_t>(bytes.size())}, Category::kWeights);
    plan_.variant.resources[index].offset_bytes = weights_.add(bytes);
    return index;
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

Binding buffer_binding(uint32_t number, uint32_t resource, bool reads, bool writes) {
  return {.binding = number,
          .type = BindingType::kStorageBuffer,
          .resource = resource,
          .view_format = ImageFormat::kNone,
          .reads = reads,
          .writes = writes,
          .frames_back = 0};
}

/// Adds to the segment what finds out which cells run, in front of the network's dispatches, and gives these their
/// commands; from then on they read copies of the inputs.
class TileDispatches {
 public:
  TileDispatches(Plan& plan, const PlannedGraph& graph, Tensors& tensors, Segment& segment,
                 const DeviceProfile& profile, std::span<const CommandedDispatch> commanded)
      : plan_(plan),
        graph_(graph),
        tensors_(tensors),
        segment_(segment),
        profile_(profile),
        tiles_(plan_tiles(*graph.graph, commanded)) {}

  void add() {
    const Graph& graph = *graph_.graph;
    const auto words = [&](const char* name, uint32_t count) {
      return kept(name, DType::kInt32, {int64_t{count}});
    };
    const uint32_t changes = words(".changes", tiles_.change_words),
                   work = words(".work", tiles_.work_words);
    segment_.tiles = Tiles{changes, work, *graph_.tile_tolerance};
    std::vector<uint8_t> bytes(tiles_.tables.size() * sizeof(uint32_t));
    for (size_t i = 0; i < bytes.size(); ++i)  // as a device reads them
      bytes[i] = static_cast<uint8_t>(tiles_.tables[i / 4] >> (8 * (i % 4)));
    const uint32_t tables = tensors_.packed(bytes, segment_.name + ".tiles");

    std::vector<uint32_t> now, copies;
    for (const ValueId input : graph.inputs) {
      const TensorType& type = graph.value(input).type;
      now.push_back(tensors_.of(input));
      copies.push_back(kept("." + graph.value(input).name + ".kept", type.dtype, type.shape));
    }
    for (size_t i = 0; i < tiles_.inputs.size(); ++i) {
      const InputTiles& own = tiles_.inputs[i];
      const bool is_int8 = graph.value(graph.inputs[i]).type.dtype == DType::kInt8;
      const std::array<uint32_t, 3> grid{groups(own.columns), static_cast<uint32_t>(own.rows), 1};
      add_dispatch(
          i, "compare", "tiles_compare", grid,
          compare_source(own, is_int8 ? *graph_.tile_tolerance : 0),
          {buffer_binding(0, now[i], true, false), buffer_binding(1, copies[i], true, false),
           buffer_binding(2, changes, true, true)});
    }
    add_dispatch(0, "find", "tiles_find",
                 {groups(tiles_.most_cells), static_cast<uint32_t>(tiles_.lists.size()), 1},
                 find_source(tiles_),
                 {buffer_binding(0, tables, true, false), buffer_binding(1, changes, true, false),
                  buffer_binding(2, work, true, true)});
    for (size_t i = 0; i < tiles_.inputs.size(); ++i) {
      const InputTiles& own = tiles_.inputs[i];
      add_dispatch(
          i, "keep", "tiles_keep", {static_cast<uint32_t>(own.columns * own.rows), 1, 1},
          keep_source(own, tiles_.lists[i]),
          {buffer_binding(0, now[i], true, false), buffer_binding(1, copies[i], false, true),
           buffer_binding(2, work, true, false)});
      segment_.dispatches.back().indirect = IndirectGrid{work, TilePlan::command(i)};
      tensors_.replace(graph.inputs[i], copies[i]);
    }
  }

  uint32_t work() const { return segment_.tiles->work; }
  /// Of the dispatch with this number among those that run by commands.
  IndirectGrid grid(size_t index) const {
    return {work(), TilePlan::command(tiles_.inputs.size() + index)};
  }
  uint32_t list(size_t index) const { return tiles_.lists[tiles_.inputs.size() + index]; }

 private:
  static uint32_t groups(int64_t invocations) {
    return static_cast<uint32_t>((invocations + kTileLocalX - 1) / kTileLocalX);
  }

  uint32_t kept(const std::string& name, DType dtype, Shape shape) {
    const uint32_t index =
        tensors_.own(segment_.name + name, dtype, std::move(shape), Category::kIntermediate);
    plan_.live.emplace(index, LiveInterval{0, kAlways, plan_.variant.resources[index].size_bytes});
    return index;
  }

  void add_dispatch(size_t input, const char* name, const char* kernel,
                    std::array<uint32_t, 3> grid, ModuleSource source,
                    std::vector<Binding> bindings) {
    Dispatch dispatch;
    dispatch.name = dispatch_name(plan_, *graph_.graph, segment_.name + "." + name, input);
    dispatch.kernel = kernel;
    dispatch.workgroups = grid;
    dispatch.bindings = std::move(bindings);
    for (const Binding& binding : dispatch.bindings) {
      const uint64_t bytes = plan_.variant.resources[binding.resource].size_bytes;
      if (binding.reads) dispatch.cost.bytes_read += bytes;
      if (binding.writes) dispatch.cost.bytes_written += bytes;
    }
    WorkTable work{};
    work[Work::kDispatch] = 1;
    work[Work::kByte] = static_cast<double>(dispatch.cost.bytes_read + dispatch.cost.bytes_written);
    dispatch.cost.time_us = work_time_us(work, profile_.ns);
    plan_.work.push_back(work);
    dispatch.module = static_cast<uint32_t>(plan_.sources.size());
    plan_.sources.push_back(std::move(source));
    segment_.dispatches.push_back(std::move(dispatch));
  }

  Plan& plan_;
  const PlannedGraph& graph_;
  Tensors& tensors_;
  Segment& segment_;
  const DeviceProfile& profile_;
  TilePlan tiles_;
};

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
  // A result of which earlier frames' are kept lies elsewhere in every run, so all of it is made.
  const auto is_always_made = [&](const GroupProblem& problem) {
    const Resource* result =
        find_resource(plan, interface_name(graph, graph.graph->value(problem.group.result).name));
    return !graph.tile_tolerance || (result && result->history_depth != 0);
  };
  std::vector<Result<std::vector<KernelSource>>> groups(graph.problems.size(),
                                                        std::vector<KernelSource>{});
  std::vector<Result<std::vector<KernelSource>>> starts = groups;
  parallel_for(groups.size(), [&](size_t i) {
    GroupProblem problem = graph.problems[i];
    if (is_always_made(problem)) problem.cell_rows = 0;
    groups[i] = graph.selection.families[i]->emit(problem, profile);
    if (const KernelFamily* start = graph.selection.start_families[i];
        start && !graph.tile_tolerance)
      starts[i] = start->emit(problem, profile);
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
  std::optional<TileDispatches> tiles;
  if (graph.tile_tolerance) {
    std::vector<CommandedDispatch> commanded;
    for (size_t i = 0; i < groups.size(); ++i)
      if (groups[i] && !is_always_made(graph.problems[i]))
        for (const KernelSource& source : *groups[i])
          commanded.push_back({graph.problems[i].group.result, source.workgroups, source.cells});
    tiles.emplace(plan, graph, tensors, segment, profile, commanded);
    tiles->add();
    number += static_cast<uint32_t>(segment.dispatches.size());
  }
  size_t commands = 0;
  std::map<std::string, uint32_t> known;  // equal sources are compiled once
  for (uint32_t i = 0; i < plan.sources.size(); ++i) known.emplace(plan.sources[i].glsl, i);
  const auto add_kernel = [&](Dispatch& dispatch, KernelSource& source, Defines defines) {
    const std::string key = defines.empty() ? source.glsl : defines[0].second + source.glsl;
    const auto [entry, is_new] = known.try_emplace(key, static_cast<uint32_t>(plan.sources.size()));
    if (is_new)
      plan.sources.push_back({.glsl = std::move(source.glsl),
                              .optimize = source.optimize,
                              .defines = std::move(defines),
                              .where = dispatch.name,
                              .load = {}});
    dispatch.module = entry->second;
    for (uint32_t binding = 0; binding < source.bindings.size(); ++binding) {
      const KernelBinding& from = source.bindings[binding];
      const uint32_t resource = from.is_work ? tiles->work()
                                : from.constant.empty()
                                    ? tensors.of(from.value)
                                    : tensors.packed(from.constant, dispatch.name);
      dispatch.bindings.push_back(planned_binding(binding, from, resource));
    }
  };
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
      Defines defines;
      if (tiles && !is_always_made(problem)) {
        dispatch.indirect = tiles->grid(commands);
        if (source.cells)
          defines.emplace_back("SHALE_LIST", fmt::format("{}", tiles->list(commands)));
        ++commands;
      }
      add_kernel(dispatch, source, std::move(defines));
      for (const Binding& binding : dispatch.bindings) {
        const Resource& bound = plan.variant.resources[binding.resource];
        if (bound.category != Category::kIntermediate) continue;
        uint32_t& last =
            plan.live.try_emplace(binding.resource, LiveInterval{number, number, bound.size_bytes})
                .first->second.last;
        last = graph.tile_tolerance ? kAlways : number;
      }
      ++number;
      segment.dispatches.push_back(std::move(dispatch));
    }
    if (!starts[i]) return starts[i].error();
    // A dispatch for a dispatch: a form in parts would need barriers of its own.
    if (starts[i]->size() == 1 && sources.size() == 1) {
      const KernelFamily& start = *graph.selection.start_families[i];
      const Dispatch& own = segment.dispatches.back();
      Dispatch form;
      form.name = own.name;
      form.kernel = start.name;
      form.workgroups = starts[i]->front().workgroups;
      form.cost = share(problem.cost, work_time_us(start.work(problem, profile), profile.ns), 1);
      add_kernel(form, starts[i]->front(), {});
      segment.start_forms.push_back(
          {static_cast<uint32_t>(segment.dispatches.size() - 1), std::move(form)});
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
