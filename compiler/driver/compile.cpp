#include "compiler/driver/compile.h"

#include <algorithm>
#include <chrono>
#include <set>

#include "compiler/cost/cost.h"
#include "compiler/frontend/frontend.h"
#include "compiler/plan/frame_lowering.h"
#include "compiler/plan/modules.h"
#include "compiler/plan/reach.h"
#include "compiler/target/caps_json.h"
#include "ir/base/hash.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

constexpr const char* kCompilerVersion = "shale 0.2.0";

/// A graph output must be the result of a node of its own: constants, inputs and repeated outputs
/// are copied.
void give_outputs_nodes(Graph& graph) {
  std::set<ValueId> seen(graph.inputs.begin(), graph.inputs.end());
  for (ValueId& output : graph.outputs) {
    if (!seen.contains(output) && !graph.value(output).is_constant()) {
      seen.insert(output);
      continue;
    }
    const Value value = graph.value(output);
    output = graph.add_node(Op::kIdentity, {}, {output}, value.name, value.type);
    seen.insert(output);
  }
}

/// Names the first channels whose accumulator may leave int32; nothing if all are proven.
std::optional<std::string> unproven(const Graph& graph, const GroupProblem& problem) {
  if (!problem.group.head) return std::nullopt;
  const Node& node = graph.node(*problem.group.head);
  if (graph.value(node.output).type.dtype != DType::kInt32) return std::nullopt;
  if (node.op != Op::kConv2d && node.op != Op::kConv3d && node.op != Op::kDepthwiseConv2d &&
      node.op != Op::kTransposeConv2d)
    return std::nullopt;
  const std::string label = node_label(graph, *problem.group.head);
  if (!problem.proof)
    return label + ": weights or bias are no constants, so its accumulators cannot be bounded";
  const IntRange range = dtype_range(DType::kInt32);
  for (size_t c = 0; c < problem.proof->min.size(); ++c)
    if (problem.proof->min[c] < range.min || problem.proof->max[c] > range.max)
      return fmt::format(
          "{}: channel {} may leave int32: its accumulator is only known to lie in {}..{}", label,
          c, problem.proof->min[c], problem.proof->max[c]);
  return std::nullopt;
}

/// Hashes everything that shapes the package and is no model: the same text, the same package.
class Canonical {
 public:
  void add(std::string_view text) {
    text_ += fmt::format("{}:", text.size());
    text_ += text;
  }
  uint64_t hash() const {
    return stable_hash({reinterpret_cast<const uint8_t*>(text_.data()), text_.size()});
  }

 private:
  std::string text_;
};

/// frame.json as parsed, and every shader and include that its passes come from.
/// Errors: those of the loader.
Result<uint64_t> frame_hash(const Frame& frame, const std::vector<Plan>& plans) {
  Canonical all;
  const auto size_text = [](const FrameSize& size) {
    return fmt::format("{} {} {} {}", size.of_output, size.divide[0], size.divide[1],
                       size.multiple);
  };
  for (const FrameImage& image : frame.images)
    all.add(fmt::format("{} {} {} {} {} {}", image.name, int{static_cast<uint8_t>(image.category)},
                        image_format_info(image.format).name, size_text(image.size),
                        image.history_depth, image.shows));
  for (const FrameTensor& tensor : frame.tensors)
    all.add(fmt::format("{} {:.9e} {} {}", tensor.name, tensor.quantization.scale,
                        tensor.quantization.zero_point, tensor.history_depth));
  for (const Param& param : frame.params)
    all.add(fmt::format("{} {} {} {} [{:.9e}]", param.name, param.is_integer, param.offset_bytes,
                        int{static_cast<uint8_t>(param.source)},
                        fmt::join(param.default_values, ",")));
  for (const FrameView& view : frame.views)
    all.add(fmt::format("{} {} {} {} {:.9e} {:.9e}", view.view.title, view.name,
                        view.view.first_channel, view.view.channels, view.view.low,
                        view.view.high));
  for (const Plan& plan : plans) all.add(print_plan(plan));  // programs, passes, what they bind
  for (const Plan& plan : plans)
    for (const ModuleSource& source : plan.sources) {
      if (!source.load) continue;  // a kernel's: it follows from the model and the options
      all.add(source.glsl);
      for (const auto& [name, value] : source.defines) all.add(name + " " + value);
      SHALE_TRY(const std::string text,
                preprocess_glsl(source.glsl, source.defines, source.where, source.load));
      all.add(text);  // includes in it
    }
  return all.hash();
}

/// Canonical text of the options that shape the package.
/// Errors: those of frame_hash.
Result<std::string> options_text(const CompileOptions& options, const std::vector<Plan>& plans) {
  std::string text = fmt::format("targets=[{}] optimize={} kernels=[{}] spirv_opt={}",
                                 fmt::join(options.targets, ","), options.pass_options.optimize,
                                 fmt::join(options.kernels, ","), options.optimize_spirv);
  if (!options.prefer.empty()) text += " prefer=" + options.prefer;
  if (options.tiles) text += fmt::format(" tiles={}", *options.tiles);
  for (const auto& [target, constants] : options.constants) {
    Canonical numbers;
    for (const double ns : constants.ns) numbers.add(fmt::format("{:.17g}", ns));
    text += fmt::format(" constants:{}={:016x}", target, numbers.hash());
  }
  for (const auto& [target, profile] : options.profiles) {
    Canonical caps;
    caps.add(caps_json(profile.caps));
    text += fmt::format(" caps:{}={:016x}", target, caps.hash());
  }
  if (options.start_us != kStartUs) text += fmt::format(" start={:g}", options.start_us);
  if (options.expected_runs) text += fmt::format(" runs={:g}", *options.expected_runs);
  for (const auto& [name, kernel] : options.choices) text += fmt::format(" {}:{}", name, kernel);
  for (const auto& [name, shape] : options.passes.input_shapes)
    text += fmt::format(" {}={}", name, shape_text(shape));
  if (options.frame) {
    SHALE_TRY(const uint64_t hash, frame_hash(*options.frame, plans));
    text += fmt::format(" frame={:016x}", hash);
  }
  return text;
}

/// The name in the frame of an input or output of the graph of a file.
std::string frame_name(const Frame& frame, const std::string& file, const std::string& name) {
  for (const FrameProgram& program : frame.programs)
    for (const FramePass& pass : program.passes)
      if (pass.graph == file)
        if (const auto renamed = pass.tensors.find(name); renamed != pass.tensors.end())
          return renamed->second;
  return name;
}

/// Shapes of the graph's inputs whose sizes follow from the frame, beside those that the options give.
/// Errors: kBadInput if such an input is no picture, or its shape was asked for otherwise too.
Result<std::map<std::string, Shape>> input_shapes(const Graph& graph, const std::string& file,
                                                  const CompileOptions& options) {
  std::map<std::string, Shape> shapes = options.passes.input_shapes;
  if (!options.frame) return shapes;
  SHALE_TRY(const auto sizes, frame_sizes(*options.frame, options.sizes));
  for (const ValueId id : graph.inputs) {
    const Value& input = graph.value(id);
    const std::string name = frame_name(*options.frame, file, input.name);
    for (const FrameTensor& tensor : options.frame->tensors) {
      if (tensor.name != name || !tensor.size) continue;
      if (input.type.shape.size() != 4)
        return bad_input("frame.tensors", "the network has no NHWC input \"{}\"", tensor.name);
      if (options.passes.input_shapes.contains(input.name))
        return bad_input(
            "--input-shape",
            "the size of \"{}\" follows from the frame: use --render and --output-size",
            tensor.name);
      const FrameExtent extent = (*tensor.size)(sizes.first, sizes.second);
      Shape shape = input.type.shape;
      shape[1] = extent.height;
      shape[2] = extent.width;
      shapes[input.name] = std::move(shape);
    }
  }
  return shapes;
}

/// Every tensor of the frame that has a size is an input of a graph.
Result<void> check_sized_tensors(const std::vector<Graph>& graphs,
                                 const std::vector<std::string>& files, const Frame& frame) {
  for (const FrameTensor& tensor : frame.tensors) {
    bool is_input = !tensor.size;
    for (size_t i = 0; i < graphs.size() && !is_input; ++i)
      for (const ValueId id : graphs[i].inputs)
        is_input = is_input || frame_name(frame, files[i], graphs[i].value(id).name) == tensor.name;
    if (!is_input)
      return bad_input("frame.tensors", "the network has no NHWC input \"{}\"", tensor.name);
  }
  return {};
}

/// Graphs of SPIR-V take their shapes while they are read.
Result<Graph> imported(std::span<const uint8_t> model, const CompileOptions& options) {
  ImportOptions import = options.import;
  import.input_shapes = options.passes.input_shapes;
  return import_model(model, import);
}

/// Runs the passes; `compiled` gets their timings.
Result<void> run_passes(Graph& graph, const std::string& file, const CompileOptions& options,
                        Compiled& compiled) {
  PassContext context = options.passes;
  SHALE_TRY(context.input_shapes, input_shapes(graph, file, options));
  SHALE_TRY(const std::vector<PassTiming> timings,
            run_pipeline(graph, context, options.pass_options));
  compiled.timings.insert(compiled.timings.end(), timings.begin(), timings.end());
  give_outputs_nodes(graph);
  return {};
}

/// Rows that cells of the group's result should have, or 0 for none: many small ones where the picture is large, since
/// a cell runs whole for one changed tile, but rows below each other share what they fetch (RESULTS.md).
int64_t rows_of_cells(const Graph& graph, const Group& group, const DeviceProfile& profile) {
  constexpr int64_t kInputRows = 32;
  // One buffer more holds the list.
  if (buffer_count(graph, group.nodes) >= profile.caps.max_storage_buffers) return 0;
  int64_t input_rows = 1;
  for (const ValueId input : graph.inputs)
    input_rows = std::max(input_rows, extent_along(graph, input, kRowAxis));
  return std::max<int64_t>(kInputRows * extent_along(graph, group.result, kRowAxis) / input_rows,
                           1);
}

/// The groups as the profile can bind them.
/// Errors: kBadInput for an accumulator that is not bounded, where that is asked for.
Result<std::vector<GroupProblem>> group_problems(const Graph& graph, const DeviceProfile& profile,
                                                 const CompileOptions& options,
                                                 std::vector<std::string>& warnings) {
  std::vector<GroupProblem> problems;
  for (Group& group : collect_groups(graph, profile.caps.max_storage_buffers)) {
    GroupProblem problem{.graph = &graph, .group = std::move(group), .proof = {}, .cost = {}};
    problem.proof = prove_ranges(graph, problem.group);
    problem.cost = group_cost(graph, problem.group);
    if (options.tiles) problem.cell_rows = rows_of_cells(graph, problem.group, profile);
    if (std::optional<std::string> message = unproven(graph, problem)) {
      if (options.require_proof) return bad_input("--require-proof", "{}", *message);
      if (std::find(warnings.begin(), warnings.end(), *message) == warnings.end())
        warnings.push_back(*std::move(message));
    }
    problems.push_back(std::move(problem));
  }
  return problems;
}

/// The profile of a target, with the constants of the device at hand where they are given.
Result<DeviceProfile> profile_of(const std::string& target, const CompileOptions& options) {
  const auto given = options.profiles.find(target);
  const DeviceProfile* profile =
      given != options.profiles.end() ? &given->second : find_profile(target);
  if (!profile) {
    std::string known;
    for (const DeviceProfile& each : known_profiles())
      known += (known.empty() ? "" : ", ") + std::string(each.name);
    return bad_input("--target", "\"{}\" is unknown, expected one of: {}", target, known);
  }
  DeviceProfile own = *profile;
  if (const auto measured = options.constants.find(std::string(own.name));
      measured != options.constants.end())
    own.ns = measured->second.ns, own.roof_gops = measured->second.roof_gops;
  return own;
}

/// A graph's segment, the names of its inputs and outputs in the package, its groups and their kernels.
Result<PlannedGraph> planned_graph(const Graph& graph, const std::string& file,
                                   const DeviceProfile& profile, const CompileOptions& options,
                                   std::vector<std::string>& warnings) {
  PlannedGraph planned{.name = "graph", .graph = &graph};
  planned.tile_tolerance = options.tiles;
  // What the passes leave as it was is so to the bit.
  if (options.tiles && options.frame && options.frame->settles) planned.tile_tolerance = 0;
  SHALE_TRY(planned.problems, group_problems(graph, profile, options, warnings));
  // A frame runs one of the programs that a parameter chooses among.
  const bool is_chosen = options.frame && !options.frame->chosen_by.empty();
  const double runs = is_chosen ? kRunsOfFrame / static_cast<double>(options.frame->programs.size())
                                : (options.frame ? kRunsOfFrame : kRunsOfNetwork);
  SHALE_TRY(planned.selection,
            select_kernels(planned.problems, profile,
                           {.expected_runs = options.expected_runs.value_or(runs),
                            .allowed = options.kernels,
                            .prefer = options.prefer,
                            .choices = options.choices,
                            .start_us = options.start_us}));
  if (!options.frame) return planned;
  for (size_t i = 0; i < options.frame->programs.size(); ++i)
    for (const FramePass& pass : options.frame->programs[i].passes)
      if (pass.graph == file) {
        planned.name = pass.name;
        planned.renamed.insert(pass.tensors.begin(), pass.tensors.end());
        planned.is_alternative = is_chosen;
        if (is_chosen && i > 0) planned.suffix = fmt::format("_{}", i);
      }
  return planned;
}

/// What runs on one target.
Result<Plan> plan_target(std::span<const PlannedGraph> graphs, const DeviceProfile& profile,
                         const CompileOptions& options, WeightBlob& weights) {
  Plan plan;
  plan.variant.target = profile.name;
  plan.variant.device_class = profile.device_class;
  if (options.frame) {
    SHALE_TRY(const auto sizes, frame_sizes(*options.frame, options.sizes));
    std::vector<const FramePromise*> kept;
    if (options.needs) kept = kept_promises(*options.frame, *options.needs, sizes.first);
    SHALE_TRY_VOID(lower_frame(plan, graphs,
                               {*options.frame, sizes.first, sizes.second, options.load_shader,
                                profile, kept, options.tiles},
                               weights));
  } else {
    plan.variant.programs = {"frame"};
    SHALE_TRY_VOID(plan_interface(plan, graphs[0]));
    SHALE_TRY_VOID(plan_graph(plan, graphs[0], 0, profile, weights));
  }
  place_intermediates(plan);
  return plan;
}

/// The files of the frame's graphs; one without a name where there is no frame.
std::vector<std::string> files_of(const CompileOptions& options) {
  return options.frame ? graph_files(*options.frame) : std::vector<std::string>{""};
}

/// A graph as it came, with the hash of its file.
struct LoadedGraph {
  Graph graph;
  uint64_t hash = 0;
};

/// Graphs after the passes, and what is made of them for each target.
struct Prepared {
  std::vector<Graph> graphs;
  std::vector<DeviceProfile> profiles;
  std::vector<Plan> plans;
  WeightBlob weights;
};

/// `compiled` gets warnings, timings and selections.
Result<Prepared> plan_all(std::vector<LoadedGraph> loaded, const CompileOptions& options,
                          Compiled& compiled) {
  if (options.tiles && *options.tiles > kMaxTileTolerance)
    return bad_input("--tiles", "a tolerance of {} codes is above {}", *options.tiles,
                     kMaxTileTolerance);
  for (const std::string& kernel : options.kernels)
    if (!find_kernel(kernel)) return bad_input("--kernels", "\"{}\" is no kernel family", kernel);
  const std::vector<std::string> files = files_of(options);
  if (loaded.size() != files.size())
    return bad_input("frame", "has {} graphs, {} are given", files.size(), loaded.size());
  Prepared all;
  for (size_t i = 0; i < loaded.size(); ++i) {
    SHALE_TRY_VOID(run_passes(loaded[i].graph, files[i], options, compiled));
    all.graphs.push_back(std::move(loaded[i].graph));
  }
  if (options.frame) SHALE_TRY_VOID(check_sized_tensors(all.graphs, files, *options.frame));
  std::map<std::string, size_t> refused;  // choices, by how many targets
  for (const std::string& target : options.targets) {
    SHALE_TRY(const DeviceProfile profile, profile_of(target, options));
    std::vector<PlannedGraph> planned;
    Selection selection;
    for (size_t i = 0; i < all.graphs.size(); ++i) {
      SHALE_TRY(PlannedGraph graph,
                planned_graph(all.graphs[i], files[i], profile, options, compiled.warnings));
      selection.add(graph.selection);
      planned.push_back(std::move(graph));
    }
    for (const auto& [name, why] : selection.refused)
      if (++refused[name] == options.targets.size()) return bad_input("--choices", "{}", why);
    if (!selection.refused.empty())
      compiled.warnings.push_back(
          fmt::format("target {}: {} of the choices are left to selection, {}", target,
                      selection.refused.size(), selection.refused.begin()->second));
    compiled.selections.push_back(std::move(selection));
    SHALE_TRY(Plan plan, plan_target(planned, profile, options, all.weights));
    if (options.needs && !plan.variant.promise && all.plans.empty())
      compiled.warnings.push_back(
          "nothing can be left out: the sandwich has no promise that the needs keep");
    all.plans.push_back(std::move(plan));
    all.profiles.push_back(profile);
  }
  return all;
}

Result<Compiled> compile_loaded(std::vector<LoadedGraph> loaded, const CompileOptions& options) {
  Compiled compiled;
  uint64_t model_hash = 0;
  for (const LoadedGraph& each : loaded)
    model_hash = model_hash == 0 ? each.hash : model_hash * 0x9e3779b97f4a7c15u ^ each.hash;
  SHALE_TRY(Prepared all, plan_all(std::move(loaded), options, compiled));
  SHALE_TRY(std::string described, options_text(options, all.plans));
  compiled.package.provenance = {model_hash, options.model_name, kCompilerVersion,
                                 std::move(described)};
  const auto start = std::chrono::steady_clock::now();
  for (size_t i = 0; i < all.plans.size(); ++i) {
    Plan& plan = all.plans[i];
    // Drivers of CPUs optimize with LLVM: spirv-opt takes seconds there and gives nothing.
    const DeviceCaps& caps = all.profiles[i].caps;
    SHALE_TRY_VOID(build_modules(plan, {.optimize = options.optimize_spirv,
                                        .forward = caps.cpu,
                                        .validate_always = options.pass_options.verify_each,
                                        .subgroup_size = caps.subgroup_size,
                                        .progress = options.progress}));
    for (const std::string& line : missing(caps, plan.variant.requirements))
      compiled.warnings.push_back(fmt::format("target {}: {}", plan.variant.target, line));
    compiled.arena_lower_bound_bytes =
        std::max(compiled.arena_lower_bound_bytes, plan.arena_lower_bound_bytes);
    compiled.work.push_back(std::move(plan.work));
    compiled.package.variants.push_back(std::move(plan.variant));
  }
  const std::chrono::duration<double, std::milli> elapsed =
      std::chrono::steady_clock::now() - start;
  compiled.kernels_ms = elapsed.count();
  compiled.package.weights = std::move(all.weights.blob);
  SHALE_TRY_VOID(
      check_package(compiled.package));  // names, for one, come from the model as they are
  for (size_t i = 0; i < all.graphs.size(); ++i)
    (i == 0 ? compiled.graph : compiled.further_graphs.emplace_back()) = std::move(all.graphs[i]);
  return compiled;
}

/// All graphs of a model: `model` is the first of them.
Result<std::vector<LoadedGraph>> load_graphs(std::span<const uint8_t> model,
                                             const CompileOptions& options) {
  std::vector<LoadedGraph> loaded;
  for (const std::string& file : files_of(options)) {
    std::vector<uint8_t> bytes;
    if (!loaded.empty()) {
      if (!options.load_model) return bad_input(file, "cannot be read: no loader is given");
      SHALE_TRY(bytes, options.load_model(file));
    }
    const std::span<const uint8_t> own = loaded.empty() ? model : std::span<const uint8_t>(bytes);
    LoadedGraph each;
    SHALE_TRY(each.graph, imported(own, options));
    each.hash = stable_hash(own);
    loaded.push_back(std::move(each));
  }
  return loaded;
}

}  // namespace

Result<Graph> shaped_graph(std::span<const uint8_t> model, const CompileOptions& options) {
  SHALE_TRY(Graph graph, imported(model, options));
  PassContext context = options.passes;
  const std::vector<std::string> files = files_of(options);
  SHALE_TRY(context.input_shapes, input_shapes(graph, files.empty() ? "" : files[0], options));
  const Result<Change> shapes = run_pass(*find_pass("infer-shapes"), graph, context);
  if (!shapes) return shapes.error();
  SHALE_TRY_VOID(verify(graph));
  return graph;
}

Result<Graph> fused_graph(Graph graph, const CompileOptions& options) {
  const auto timings = run_pipeline(graph, {}, options.pass_options);
  if (!timings) return timings.error();
  give_outputs_nodes(graph);
  return graph;
}

Result<Compiled> compile(std::span<const uint8_t> model, const CompileOptions& options) {
  SHALE_TRY(std::vector<LoadedGraph> loaded, load_graphs(model, options));
  return compile_loaded(std::move(loaded), options);
}

Result<Compiled> compile_graph(Graph graph, uint64_t model_hash, const CompileOptions& options) {
  std::vector<LoadedGraph> loaded;
  if (!files_of(options).empty()) loaded.push_back({std::move(graph), model_hash});
  return compile_loaded(std::move(loaded), options);
}

Result<std::vector<std::string>> plan_texts(std::span<const uint8_t> model,
                                            const CompileOptions& options) {
  SHALE_TRY(std::vector<LoadedGraph> loaded, load_graphs(model, options));
  Compiled compiled;
  SHALE_TRY(const Prepared all, plan_all(std::move(loaded), options, compiled));
  std::vector<std::string> texts;
  for (const Plan& plan : all.plans) texts.push_back(print_plan(plan));
  return texts;
}

}  // namespace shale
