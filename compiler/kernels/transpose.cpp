// transpose: a TRANSPOSE alone that moves the innermost dimension, for CPU drivers. An invocation takes a tile of as many
// rows as a texel has elements, so that both what is read and what is written lies together: where `runs` fetches every
// element by itself, this makes one fetch and one store for each 16 (or 4) bytes. Source: ours.
#include <algorithm>
#include <bit>

#include "compiler/kernels/codegen.h"
#include "ir/base/integer.h"

namespace shale {
namespace {

constexpr int64_t kLocalSize = 64;

/// The permutation as tiles along the two innermost dimensions, the input's and the result's.
struct Blocks {
  size_t in_axis = 0;   ///< of the input, innermost in the result
  size_t out_axis = 0;  ///< of the result, innermost in the input
  int64_t side = 0;     ///< elements of a texel
  int64_t across = 0, down = 0,
          others = 0;  ///< tiles along the result's, the input's innermost; the rest

  /// Invocations of a workgroup. Eight beside each other write 128 bytes; what the reads of a tile bring into the cache
  /// serves those below it. A driver runs lanes that are off, too.
  int64_t high() const {
    return static_cast<int64_t>(std::bit_floor(static_cast<uint64_t>(std::min<int64_t>(down, 8))));
  }
  int64_t wide() const { return kLocalSize / high(); }
  std::array<int64_t, 3> workgroups() const {
    return {ceil_div(across, wide()), ceil_div(down, high()), others};
  }
};

const TensorType& input_type(const GroupProblem& problem, const Node& node) {
  return problem.graph->value(node.inputs[0]).type;
}

std::optional<Blocks> tiles_of(const GroupProblem& problem) {
  if (problem.group.nodes.size() != 1) return std::nullopt;
  const Node& node = problem.graph->node(problem.group.nodes[0]);
  if (node.op != Op::kTranspose || problem.graph->value(node.inputs[0]).is_constant())
    return std::nullopt;
  const TensorType& in = input_type(problem, node);
  const std::span<const int64_t> perms = node.attrs.list(Attr::kPerms);
  const size_t last = perms.size() - 1;
  if (perms.empty() || static_cast<size_t>(perms[last]) == last) return std::nullopt;
  Blocks tiles;
  tiles.in_axis = static_cast<size_t>(perms[last]);
  tiles.out_axis = static_cast<size_t>(std::find(perms.begin(), perms.end(), last) - perms.begin());
  const int64_t bytes = dtype_info(in.dtype).host_bytes;
  const int64_t width = in.shape[tiles.in_axis], height = in.shape[last];
  for (const int64_t side : {16 / bytes, 4 / bytes})
    if (tiles.side == 0 && side > 1 && width % side == 0 && height % side == 0) tiles.side = side;
  if (tiles.side == 0) return std::nullopt;
  tiles.across = width / tiles.side;
  tiles.down = height / tiles.side;
  tiles.others = *element_count(in.shape) / (width * height);
  return tiles;
}

/// Words `rows`, each of `n` elements of the same column of a tile, to `n` words of one row each: the code leaves them in
/// NAME0, NAME1, ...
std::string turned(const std::string& name, const std::vector<std::string>& rows) {
  if (rows.size() == 1) return fmt::format("  uint {}0 = {};\n", name, rows[0]);
  if (rows.size() == 2)
    return fmt::format(
        "  uint {0}0 = ({1} & 0xffffu) | ({2} << 16), {0}1 = ({1} >> 16) | ({2} & 0xffff0000u);\n",
        name, rows[0], rows[1]);
  std::string code;
  for (const auto& [pair, a, b] : {std::tuple{"x", 0, 1}, std::tuple{"y", 2, 3}})
    code += fmt::format(
        "  uint {0}{1}0 = ({2} & 0xff00ffu) | (({3} & 0xff00ffu) << 8),\n"
        "       {0}{1}1 = (({2} >> 8) & 0xff00ffu) | ({3} & 0xff00ff00u);\n",
        name, pair, rows[static_cast<size_t>(a)], rows[static_cast<size_t>(b)]);
  for (int i = 0; i < 2; ++i)
    code += fmt::format(
        "  uint {0}{1} = ({0}x{1} & 0xffffu) | ({0}y{1} << 16), {0}{2} = ({0}x{1} >> 16) | "
        "({0}y{1} & 0xffff0000u);\n",
        name, i, i + 2);
  return code;
}

}  // namespace

bool transpose_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  const std::optional<Blocks> tiles = tiles_of(problem);
  return profile.literal_weights && tiles &&
         std::ranges::max(tiles->workgroups()) <= kMaxWorkgroups &&
         static_cast<uint64_t>(tiles->across * tiles->down * tiles->others * tiles->side) <
             profile.caps.max_texel_elements;
}

WorkTable transpose_work(const GroupProblem& problem, const DeviceProfile&) {
  WorkTable work{};
  work[Work::kDispatch] = 1;
  // A tile stores as many texels as it has elements across.
  work[Work::kRunResult] =
      static_cast<double>(*element_count(problem.graph->value(problem.group.result).type.shape)) *
      4 / static_cast<double>(tiles_of(problem)->side);
  work[Work::kByte] = static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written);
  return work;
}

Result<std::vector<KernelSource>> transpose_emit(const GroupProblem& problem,
                                                 const DeviceProfile&) {
  const Node& node = problem.graph->node(problem.group.nodes[0]);
  const Blocks tiles = *tiles_of(problem);
  const Shape& in = input_type(problem, node).shape;
  const Shape& out = problem.graph->value(node.output).type.shape;
  const std::span<const int64_t> perms = node.attrs.list(Attr::kPerms);
  const int64_t bytes = dtype_info(input_type(problem, node).dtype).host_bytes;
  const int64_t words = tiles.side * bytes / 4;
  const ImageFormat format = words == 4 ? ImageFormat::kRgba32Uint : ImageFormat::kR32Uint;
  Codegen codegen(problem);
  const size_t from = codegen.bind(node.inputs[0], BindingType::kUniformTexelBuffer, format, false);
  const size_t to = codegen.bind(node.output, BindingType::kStorageBuffer, format, true);

  // Where the tile begins, in the result's coordinates.
  std::vector<std::string> at(out.size(), "0");
  std::string rest = "int(gl_GlobalInvocationID.z)";
  for (size_t axis = out.size(); axis-- > 0;) {
    if (axis == tiles.out_axis || axis + 1 == out.size() || out[axis] == 1) continue;
    at[axis] = fmt::format("({} % {})", rest, out[axis]);
    rest = fmt::format("({} / {})", rest, out[axis]);
  }
  std::string body = fmt::format(
      "  int across = int(gl_GlobalInvocationID.x), down = int(gl_GlobalInvocationID.y);\n"
      "  if (across >= {} || down >= {}) return;\n"
      "  uint none = uint(across >= {});\n",
      tiles.across, tiles.down, INT32_MAX);
  const auto texel = [&](const Shape& shape, std::vector<std::string> coords) {
    Shape texels = shape;
    texels.back() /= tiles.side;
    return Codegen::linear({.coords = std::move(coords)}, texels);
  };
  for (int64_t i = 0; i < tiles.side; ++i) {
    std::vector<std::string> row(in.size());
    for (size_t axis = 0; axis < out.size(); ++axis)
      row[static_cast<size_t>(perms[axis])] = at[axis];
    row[tiles.in_axis] = fmt::format("(across * {} + {})", tiles.side, i);
    row.back() = "down";
    body += fmt::format("  uvec4 r{} = uvec4(texelFetch(t{}, {}));\n", i, from, texel(in, row));
  }
  // Four bytes, two halves or one word of each row become a word of each of as many results.
  const int64_t in_word = 4 / bytes;
  for (int64_t word = 0; word < words; ++word)
    for (int64_t block = 0; block < words; ++block) {
      std::vector<std::string> rows;
      for (int64_t i = 0; i < in_word; ++i)
        rows.push_back(fmt::format("r{}.{}", block * in_word + i, "xyzw"[word]));
      body += turned(fmt::format("w{}_{}_", word, block), rows);
    }
  for (int64_t i = 0; i < tiles.side; ++i) {
    std::vector<std::string> stored;
    for (int64_t block = 0; block < words; ++block)
      stored.push_back(fmt::format("max(w{}_{}_{}, none)", i / in_word, block, i % in_word));
    std::vector<std::string> row = at;
    row[tiles.out_axis] = fmt::format("(down * {} + {})", tiles.side, i);
    row.back() = "across";
    body += fmt::format("  b{}.d[{}] = {}({});\n", to, texel(out, row),
                        words == 4 ? "uvec4" : "uint", fmt::join(stored, ", "));
  }
  KernelSource source;
  for (size_t axis = 0; axis < 3; ++axis)
    source.workgroups[axis] = static_cast<uint32_t>(tiles.workgroups()[axis]);
  source.glsl = codegen.finish(
      fmt::format("local_size_x = {}, local_size_y = {}", tiles.wide(), tiles.high()), body);
  source.bindings = codegen.bindings();
  return std::vector<KernelSource>{std::move(source)};
}

}  // namespace shale
