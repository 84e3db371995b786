// generic: one invocation per result element, storage buffers; takes every group. The executable
// fallback, and the naive kernel that the fast ones are measured against.
//
// runs: the same for CPU drivers, where a buffer is read and written lane by lane but texels are fetched for all lanes
// at once: an invocation makes the elements of 16 bytes (4, or one) next to each other, reads texels as wide, and stores
// once. Source: ours.
#include <algorithm>
#include <set>

#include "compiler/kernels/codegen.h"
#include "compiler/kernels/heads.h"

namespace shale {
namespace {

constexpr int64_t kLocalSize = 64;
constexpr int64_t kMaxGroupsX = 65535;  // Vulkan's guaranteed maxComputeWorkGroupCount

}  // namespace

bool generic_supports(const GroupProblem&, const DeviceProfile&) { return true; }

WorkTable generic_work(const GroupProblem& problem, const DeviceProfile&) {
  WorkTable work{};
  work[Work::kDispatch] = 1;
  work[Work::kGenericMac] = static_cast<double>(problem.cost.macs);
  work[Work::kGenericResult] = static_cast<double>(
      element_count(problem.graph->value(problem.group.result).type.shape).value_or(0));
  // It moves these bytes, and some of them more than once.
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

namespace {

/// One local for each dimension keeps the expressions short.
/// The last one may count runs of `length`.
void name_coordinates(Position& at, std::string& body, int64_t length = 1) {
  for (size_t i = 0; i < at.coords.size(); ++i) {
    const bool is_run = length > 1 && i + 1 == at.coords.size();
    if (at.coords[i] == "0" && !is_run) continue;
    const std::string name = fmt::format("o{}", i);
    body += is_run ? fmt::format("  int {} = {} * {};\n", name, at.coords[i], length)
                   : fmt::format("  int {} = {};\n", name, at.coords[i]);
    at.coords[i] = name;
  }
}

/// One invocation for each run of `length` elements of `shape`, numbered from 0: `body` starts with the position of
/// its elements, the names of which are returned.
std::vector<Position> grid_over(const Shape& shape, int64_t length, std::string& body,
                                KernelSource& source) {
  Shape runs = shape;
  if (length > 1) runs.back() /= length;
  const int64_t count = *element_count(runs);
  const int64_t groups = (count + kLocalSize - 1) / kLocalSize;
  const int64_t groups_x = std::min(groups, kMaxGroupsX);
  const int64_t groups_y = (groups + groups_x - 1) / groups_x;
  body = fmt::format(
      "  uint invocation = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * {}u;\n"
      "  if (invocation >= {}u) return;\n  int index = int(invocation);\n",
      groups_x * kLocalSize, count);
  Position at = Codegen::split("index", runs);
  name_coordinates(at, body, length);
  source.workgroups = {static_cast<uint32_t>(groups_x), static_cast<uint32_t>(groups_y), 1};
  if (length == 1) return {at};
  return Position::run_at(at.coords, at.coords.back(), length);
}

/// The same of the cells of a list, each a workgroup's elements of a row by some rows. Nothing where there are no cells.
std::optional<KernelSource> grid_of_cells(Codegen& codegen, const Shape& shape, Position& at,
                                          std::string& body) {
  if (shape.size() != 4) return std::nullopt;
  const int64_t row = shape[2] * shape[3], groups = (row + kLocalSize - 1) / kLocalSize;
  if (std::max({groups, shape[0], shape[1]}) > kMaxWorkgroups) return std::nullopt;
  KernelSource source;
  source.workgroups = {static_cast<uint32_t>(groups), static_cast<uint32_t>(shape[1]),
                       static_cast<uint32_t>(shape[0])};
  const auto column = [&](int64_t i) {
    const int64_t end = std::min((i + 1) * kLocalSize, row);
    return Stretch{i * kLocalSize / shape[3], (end - 1) / shape[3] + 1};
  };
  codegen.take_cells(source, column, 1);
  if (!source.cells) return std::nullopt;
  body = fmt::format(
      "  if (place.x >= {}u || place.y >= {}u) return;\n"
      "  int index = int((place.z * {}u + place.y) * {}u + place.x);\n",
      row, shape[1], shape[1], row);
  at = {.coords = {"int(place.z)", "int(place.y)", fmt::format("int(place.x) / {}", shape[3]),
                   fmt::format("int(place.x) % {}", shape[3])},
        .linear = "index"};
  name_coordinates(at, body);
  return source;
}

void finish(KernelSource& source, const Codegen& codegen, const std::string& body) {
  source.glsl = codegen.finish(fmt::format("local_size_x = {}", kLocalSize), body);
  source.bindings = codegen.bindings();
}

/// A CONCAT alone, as many dispatches as it takes to bind at most `max_buffers` in each: a dispatch
/// makes the slab of the result that its operands fill.
std::vector<KernelSource> concat_in_parts(const GroupProblem& problem, size_t max_buffers) {
  const Node& node = problem.graph->node(problem.group.nodes.front());
  const size_t axis = static_cast<size_t>(node.attrs.get(Attr::kAxis));
  std::vector<KernelSource> sources;
  int64_t begin = 0;
  for (size_t first = 0; first < node.inputs.size();) {
    Node part{.op = Op::kConcat, .attrs = node.attrs, .inputs = {}, .output = node.output};
    std::set<ValueId> distinct;
    Shape slab = problem.graph->value(node.output).type.shape;
    slab[axis] = 0;
    for (; first < node.inputs.size(); ++first) {
      const ValueId operand = node.inputs[first];
      if (distinct.size() + 1 >= max_buffers && !distinct.contains(operand)) break;
      distinct.insert(operand);
      part.inputs.push_back(operand);
      slab[axis] += problem.graph->value(operand).type.shape[axis];
    }
    Codegen codegen(problem);
    std::string body;
    KernelSource source;
    const Position at = grid_over(slab, 1, body, source)[0];
    Position to{.coords = at.coords};
    if (begin > 0) to.coords[axis] = fmt::format("({} + {})", at.coords[axis], begin);
    body += codegen.store(node.output, to, codegen.concat(part, at, slab[axis]));
    finish(source, codegen, body);
    sources.push_back(std::move(source));
    begin += slab[axis];
  }
  return sources;
}

/// The most elements of a run: sums keep one register an element, and a CONCAT of many tensors is written out for each.
int64_t longest_run(const GroupProblem& problem) {
  int64_t most = 16;
  for (const NodeId id : problem.group.nodes) {
    const Node& node = problem.graph->node(id);
    if (node.op == Op::kConcat && node.inputs.size() > 8) most = std::min<int64_t>(most, 4);
  }
  if (!problem.group.head) return most;
  switch (problem.graph->node(*problem.group.head).op) {
    case Op::kConv2d:
    case Op::kConv3d:
    case Op::kTransposeConv2d:
    case Op::kMatmul: return std::min<int64_t>(most, 4);
    default: return most;
  }
}

/// One invocation for `length` elements of the group's result next to each other.
KernelSource emit_runs(const GroupProblem& problem, Codegen& codegen, int64_t length) {
  const Node& last = problem.graph->node(problem.group.nodes.back());
  const Shape& shape = codegen.shape_of(problem.group.result);
  std::string body;
  KernelSource source;
  std::vector<Position> run{{}};
  if (std::optional<KernelSource> cells;
      length == 1 && (cells = grid_of_cells(codegen, shape, run[0], body)))
    source = *std::move(cells);
  else
    run = grid_over(shape, length, body, source);
  if (length > 1) body += fmt::format("  uint none = uint(index >= {});\n", INT32_MAX);
  if (problem.group.head) body += emit_head(codegen, problem.graph->node(*problem.group.head), run);
  std::vector<std::string> values;
  for (size_t i = 0; i < run.size(); ++i) {
    if (problem.group.head)
      codegen.locals()[problem.graph->node(*problem.group.head).output] = head_result(i);
    codegen.epilogue(body, run[i], length > 1 ? fmt::format("_{}", i) : "");
    values.push_back(op_kind(last) == OpKind::kView ? codegen.view(last, run[i])
                                                    : codegen.load(last.output, run[i]));
  }
  body += codegen.store_run(run[0], values);
  finish(source, codegen, body);
  return source;
}

}  // namespace

Result<std::vector<KernelSource>> generic_emit(const GroupProblem& problem,
                                               const DeviceProfile& profile) {
  const size_t max_buffers = std::min(profile.caps.max_storage_buffers, kMaxBindings);
  const Node& last = problem.graph->node(problem.group.nodes.back());
  if (problem.group.nodes.size() == 1 && last.op == Op::kConcat &&
      buffer_count(*problem.graph, problem.group.nodes) > max_buffers)
    return concat_in_parts(problem, max_buffers);
  Codegen codegen(problem);
  return std::vector<KernelSource>{emit_runs(problem, codegen, 1)};
}

bool runs_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  const DeviceCaps& caps = profile.caps;
  return profile.literal_weights &&
         buffer_count(*problem.graph, problem.group.nodes) <=
             std::min<uint64_t>({caps.max_storage_buffers, caps.max_texel_buffers, kMaxBindings});
}

WorkTable runs_work(const GroupProblem& problem, const DeviceProfile& profile) {
  WorkTable work = generic_work(problem, profile);
  std::swap(work[Work::kGenericMac], work[Work::kRunMac]);
  std::swap(work[Work::kGenericResult], work[Work::kRunResult]);
  return work;
}

Result<std::vector<KernelSource>> runs_emit(const GroupProblem& problem,
                                            const DeviceProfile& profile) {
  Codegen codegen(problem);
  codegen.read_as_texels(profile.caps.max_texel_elements);
  if (problem.cell_rows == 0) codegen.flatten_if_elementwise();
  return std::vector<KernelSource>{
      emit_runs(problem, codegen, codegen.run_length(longest_run(problem)))};
}

}  // namespace shale
