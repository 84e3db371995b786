// compiler/plan/plan.h -- what will run on one target, as plain data that prints.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "compiler/kernels/select.h"
#include "compiler/plan/memory.h"
#include "compiler/spirv/glsl.h"
#include "ir/package/package.h"

namespace shale {

/// A shader to be compiled.
struct ModuleSource {
  std::string glsl;
  OptimizeBy optimize = OptimizeBy::kSpirvOpt;
  Defines defines;
  std::string where;           ///< names it in messages
  IncludeLoader load;          ///< beside shaders/include
  std::string accessors = {};  ///< of a pass: what `load` gives for them
};

/// LiveInterval::last of what has to keep its place for good.
inline constexpr uint32_t kAlways = UINT32_MAX - 1;

/// A variant whose modules are still sources: Dispatch::module counts `sources`. Everything else is final: resources with
/// their places, programs, segments, grids, bindings, costs.
struct Plan {
  Variant variant;
  std::vector<ModuleSource> sources;
  /// Of each resource in the arena: the first and the last dispatch that touches it, all programs counted through.
  std::map<uint32_t, LiveInterval> live;
  std::vector<WorkTable> work;  ///< of each dispatch of the graphs
  uint64_t arena_lower_bound_bytes = 0;
};

/// Weight blob under construction, shared by the variants; equal tensors lie there once.
class WeightBlob {
 public:
  /// Offset of these bytes, a multiple of kBufferAlignment.
  uint64_t add(const std::vector<uint8_t>& bytes);

  std::vector<uint8_t> blob;

 private:
  std::multimap<uint64_t, std::pair<uint64_t, size_t>> offsets_;
};

/// A network of a package: its graph after the passes, its groups as the target can bind them, and their kernels.
struct PlannedGraph {
  std::string name;  ///< of its segment
  const Graph* graph = nullptr;
  std::vector<GroupProblem> problems = {};
  Selection selection = {};
  /// Names of graph inputs and outputs in the package, where they differ from those in the graph.
  std::map<std::string, std::string> renamed = {};
  /// One of several of which a frame runs one: its outputs may be those of the others. `suffix` tells its dispatches from
  /// theirs.
  bool is_alternative = false;
  std::string suffix = {};
  /// Work by tiles, with this Tiles::tolerance; the problems ask for cells.
  std::optional<uint32_t> tile_tolerance = {};
};

/// Adds the inputs and outputs of a graph as resources. One that another graph of the package has under the same name is
/// the same tensor.
/// Errors: kBadInput if it has another type there, or is an output of both.
Result<void> plan_interface(Plan& plan, const PlannedGraph& graph);

/// Appends a graph's dispatches, a kGraph segment of `program`: kernels, grids, bindings, weights, intermediates.
/// Behind plan_interface.
/// Errors: those of the kernel families.
Result<void> plan_graph(Plan& plan, const PlannedGraph& graph, uint32_t program,
                        const DeviceProfile& profile, WeightBlob& weights);

/// `name`, or with '#' behind it what no dispatch of the plan is called: measured times are joined by it.
std::string unused_dispatch_name(const Plan& plan, std::string name);

/// Gives the tensors of the arena their places.
void place_intermediates(Plan& plan);

/// The plan as text: resources, programs, dispatches with kernel, grid, bindings and defines, live ranges; no sources.
std::string print_plan(const Plan& plan);

}  // namespace shale
