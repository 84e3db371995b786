#include "compiler/kernels/literal_conv.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace shale {
namespace {

/// Most tiles below each other of an invocation: what two of them read is fetched once, and the
/// registers and caches keep what the loop needs. But workgroups enough, where there are rows, for a
/// few on each core of a small computer.
constexpr int64_t kMostRows = 18, kLeastWorkgroups = 8;

const Node& head_of(const GroupProblem& problem) {
  return problem.graph->node(*problem.group.head);
}

std::string plus(const std::string& base, int64_t offset) {
  if (offset == 0) return base;
  return offset > 0 ? fmt::format("{} + {}", base, offset) : fmt::format("{} - {}", base, -offset);
}

/// Invocations of a workgroup, along x: as many as leave few idle at the end of a row. Lanes come in
/// eights, and small workgroups cost next to nothing on a CPU.
int64_t local_x(int64_t grid_x) {
  for (int64_t local = kLiteralLocalX; local > 8; local /= 2)
    if ((ceil_div(grid_x, local) * local - grid_x) * 32 <= grid_x) return local;
  return 8;
}

}  // namespace

LiteralConv::LiteralConv(const GroupProblem& problem, const DeviceProfile& profile)
    : problem_(problem),
      profile_(profile),
      graph_(*problem.graph),
      node_(head_of(problem)),
      weight_(*graph_.value(node_.inputs[1]).constant),
      taps_(weight_.type.shape),
      producers_(graph_.producers()),
      codegen_(problem),
      element_bytes_(dtype_info(input_dtype()).bits / 8) {
  if (is_depthwise()) taps_ = {taps_[2] * taps_[3], taps_[0], taps_[1], taps_[2]};
  codegen_.read_tables_as_texels();
  const std::vector<int64_t> leaves = leaf_channels(node_.inputs[0]);
  for (const int64_t bytes : {16, 4}) {
    const int64_t lanes = bytes / element_bytes_;
    if (lanes_ == 1 &&
        std::all_of(leaves.begin(), leaves.end(), [&](int64_t c) { return c % lanes == 0; }))
      lanes_ = lanes;
  }
  split_words_ = lanes_ == 1 && element_bytes_ == 1 && leaves.size() == 1 && leaves[0] > 1 &&
                 element_count(leaf().type.shape).value_or(1) % 4 == 0;
  if (split_words_) lanes_ = 4;
}

bool LiteralConv::supports(const GroupProblem& problem, const DeviceProfile& profile,
                           Numbers numbers) {
  if (!profile.literal_weights || !problem.group.head) return false;
  const Graph& graph = *problem.graph;
  const Node& node = head_of(problem);
  if (node.op != Op::kConv2d && node.op != Op::kDepthwiseConv2d) return false;
  const auto is = [&](size_t operand, DType dtype) {
    return graph.value(node.inputs[operand]).type.dtype == dtype;
  };
  switch (numbers) {
    case Numbers::kBytes:
      if (!is(0, DType::kInt8) || (!is(1, DType::kInt8) && !is(1, DType::kInt4))) return false;
      break;
    case Numbers::kWords:
      if (!is(0, DType::kInt16)) return false;
      break;
  }
  const Value& weight = graph.value(node.inputs[1]);
  if (!weight.is_constant() || !graph.value(node.inputs[2]).is_constant()) return false;
  if (op_kind(graph.node(problem.group.nodes.back())) == OpKind::kView) return false;
  const LiteralConv conv(problem, profile);
  if (conv.leaf_channels(node.inputs[0]).empty()) return false;
  const auto fits_texels = [&](ValueId id) {
    return conv.folded(id) || element_count(graph.value(id).type.shape).value_or(0) <=
                                  static_cast<int64_t>(profile.caps.max_texel_elements);
  };
  return std::all_of(problem.group.nodes.begin(), problem.group.nodes.end(), [&](NodeId id) {
    const std::vector<ValueId>& operands = graph.node(id).inputs;
    return id == *problem.group.head ? fits_texels(operands[0])
                                     : std::all_of(operands.begin(), operands.end(), fits_texels);
  });
}

const Node* LiteralConv::folded(ValueId id) const {
  const std::optional<NodeId> producer = producers_[id.index];
  return producer && problem_.group.contains(*producer) ? &graph_.node(*producer) : nullptr;
}

int64_t LiteralConv::weight(int64_t oc, int64_t ky, int64_t kx, int64_t c) const {
  const int64_t zero_point = graph_.value(node_.inputs[4]).constant->get(0);
  if (!is_depthwise())
    return weight_.get(((oc * taps_[1] + ky) * taps_[2] + kx) * taps_[3] + c) - zero_point;
  // HWCM, and output channel c * M + m.
  return c == read_by(oc, oc + 1)[0]
             ? weight_.get((ky * taps_[2] + kx) * taps_[0] + oc) - zero_point
             : 0;
}

std::array<int64_t, 2> LiteralConv::read_by(int64_t first, int64_t last) const {
  if (!is_depthwise()) return {0, taps_[3]};
  const int64_t multiplier = taps_[0] / taps_[3];
  return {first / multiplier, (last - 1) / multiplier + 1};
}

/// Channels of every tensor that the convolution reads through its folded views; empty if a view is
/// one that fetches cannot follow (a pad of batch or channels, a concat of another axis).
std::vector<int64_t> LiteralConv::leaf_channels(ValueId id) const {
  const Node* view = folded(id);
  if (!view) return {graph_.value(id).type.shape[3]};
  std::vector<int64_t> leaves;
  if (view->op == Op::kPad) {
    const std::vector<int64_t> padding = graph_.value(view->inputs[1]).constant->ints();
    for (const size_t i : {0u, 1u, 6u, 7u})
      if (padding[i] != 0) return {};
    if (!graph_.value(view->inputs[2]).is_constant()) return {};
  } else if (view->op == Op::kConcat) {
    if (view->attrs.get(Attr::kAxis) != 3) return {};
  } else if (view->op != Op::kResize) {
    return {};
  }
  const size_t sources = view->op == Op::kConcat ? view->inputs.size() : 1;
  for (size_t i = 0; i < sources; ++i) {
    const std::vector<int64_t> own = leaf_channels(view->inputs[i]);
    if (own.empty()) return {};
    leaves.insert(leaves.end(), own.begin(), own.end());
  }
  return leaves;
}

const Value& LiteralConv::leaf() const {
  ValueId id = node_.inputs[0];
  while (const Node* view = folded(id)) id = view->inputs[0];
  return graph_.value(id);
}

std::string LiteralConv::fetch(ValueId id, int64_t c, const std::string& y, const std::string& x,
                               int64_t outside) {
  const std::string name = fmt::format("fetch{}_{}", id.index, c);
  if (functions_.emplace(name).second) {
    const Shape& shape = graph_.value(id).type.shape;
    const std::string body = inside(id, c);
    // Without a branch, both sides of which a CPU driver runs anyway: equal fetches of several passes
    // are then found to be one.
    codegen_.add_function(
        fmt::format("{0} {1}(int n, int y, int x, uint outside) {{\n"
                    "  bool inside = uint(y) < {2}u && uint(x) < {3}u;\n"
                    "  y = inside ? y : 0;\n  x = inside ? x : 0;\n"
                    "  {0} texel = {4};\n  return inside ? texel : {0}(outside);\n}}\n\n",
                    texel_type(), name, shape[1], shape[2], body));
  }
  uint32_t word = static_cast<uint32_t>(outside);
  if (element_bytes_ == 1) word = static_cast<uint32_t>(outside + 128) & 255u;
  if (element_bytes_ == 2) word &= 0xffffu;
  if (lanes_ > 1)
    word *= element_bytes_ == 1 ? 0x01010101u : element_bytes_ == 2 ? 0x00010001u : 1u;
  return fmt::format("{}(n, {}, {}, {}u)", name, y, x, word);
}

/// The same where row y and column x are inside the value.
std::string LiteralConv::inside(ValueId id, int64_t c) {
  const Node* view = folded(id);
  const Shape& shape = graph_.value(id).type.shape;
  if (!view) {
    const ImageFormat format = is_wide()                      ? ImageFormat::kRgba32Uint
                               : lanes_ * element_bytes_ == 4 ? ImageFormat::kR32Uint
                               : element_bytes_ == 2          ? ImageFormat::kR16Uint
                                                              : ImageFormat::kR8Sint;
    const size_t binding = codegen_.bind(id, BindingType::kUniformTexelBuffer, format, false);
    if (split_words_) return split_word(binding, shape, c);
    const std::string texel =
        fmt::format("texelFetch(t{}, ((n * {} + y) * {} + x) * {} + {})", binding, shape[1],
                    shape[2], shape[3] / lanes_, c / lanes_);
    if (format == ImageFormat::kR8Sint) return fmt::format("uint({}.x + 128)", texel);
    return fmt::format("{}{}{}", texel, is_wide() ? "" : ".x",
                       element_bytes_ == 1 ? " ^ 0x80808080u" : "");
  }
  const auto numbers = [&](size_t index) {
    return graph_.value(view->inputs[index]).constant->ints();
  };
  if (view->op == Op::kPad) {
    const std::vector<int64_t> padding = numbers(1);
    return fetch(view->inputs[0], c, fmt::format("y - {}", padding[2]),
                 fmt::format("x - {}", padding[4]), graph_.value(view->inputs[2]).constant->get(0));
  }
  if (view->op == Op::kConcat) {
    for (const ValueId part : view->inputs) {
      const int64_t channels = graph_.value(part).type.shape[3];
      if (c < channels) return inside(part, c);
      c -= channels;
    }
  }
  const Shape& from = graph_.value(view->inputs[0]).type.shape;
  const std::vector<int64_t> scale = numbers(1), offset = numbers(2);
  const auto source = [&](const char* o, size_t axis) {
    return fmt::format("nearest({}, {}, {}, {}, {})", o, scale[2 * axis], scale[2 * axis + 1],
                       Codegen::literal(offset[axis]), from[axis + 1]);
  };
  return fetch(view->inputs[0], c, source("y", 0), source("x", 1), -128);
}

std::string LiteralConv::split_word(size_t binding, const Shape& shape, int64_t c) {
  if (functions_.emplace("joined").second)
    codegen_.add_function(
        "uint joined(uint low, uint high, int first) {\n  int shift = (first & 3) * 8;\n"
        "  return ((low >> shift) | ((high << 1) << (31 - shift))) ^ 0x80808080u;\n}\n\n");
  const std::string first =
      fmt::format("((n * {} + y) * {} + x) * {}", shape[1], shape[2], shape[3]);
  const auto word = [&](int64_t next) {
    const std::string at = fmt::format("({} >> 2) + {}", first, c / 4 + next);
    // The last bytes of a texel may all lie in its last word, which may be the tensor's.
    const bool is_beyond = next == 1 && c + 4 >= shape[3];
    return fmt::format(
        "texelFetch(t{}, {}).x", binding,
        is_beyond ? fmt::format("min({}, {})", at, element_count(shape).value_or(0) / 4 - 1) : at);
  };
  return fmt::format("joined({}, {}, {})", word(0), word(1), first);
}

std::string LiteralConv::byte(size_t index, int64_t c, int shift) const {
  std::string word = texel(index, c);
  const int64_t lane = c % lanes_, left = shift - 8 * (lane % 4);
  if (lanes_ == 16) word += fmt::format(".{}", "xyzw"[static_cast<size_t>(lane / 4)]);
  const std::string moved = left > 0   ? fmt::format("({} << {})", word, left)
                            : left < 0 ? fmt::format("({} >> {})", word, -left)
                                       : word;
  // Nothing but the byte is left where it reaches an end of the word.
  return lanes_ == 1 || left == 24 || left == -24
             ? moved
             : fmt::format("({} & {}u)", moved, uint32_t{255} << shift);
}

std::string LiteralConv::number(size_t index, int64_t c) const {
  if (element_bytes_ == 1) return byte(index, c);
  std::string word = texel(index, c);
  const int64_t at = c % lanes_ * element_bytes_;
  if (is_wide()) word += fmt::format(".{}", "xyzw"[static_cast<size_t>(at / 4)]);
  const bool is_upper = at % 4 != 0;
  return fmt::format("(int({}) >> 16)", is_upper ? word : word + " << 16");
}

std::string LiteralConv::split(const std::string& sum, int shift) {
  // Adding and taking off 1.5 * 2^52 rounds to an integer. In a function, since `precise` would go on
  // to everything that the sum is made from.
  if (functions_.emplace("integer").second) {
    const std::string large = double_literal(1.5 * std::ldexp(1.0, 52));
    codegen_.add_function(
        fmt::format("double integer(double value) {{\n  precise double rounded = value + {0};\n"
                    "  rounded -= {0};\n  return rounded;\n}}\n\n",
                    large));
  }
  return fmt::format("  double {0}_1 = integer({0} * {1}), {0}_0 = {0} - {0}_1 * {2};\n", sum,
                     double_literal(std::ldexp(1.0, -shift)),
                     double_literal(std::ldexp(1.0, shift)));
}

std::string LiteralConv::double_literal(double value) {
  const uint64_t bits = std::bit_cast<uint64_t>(value);
  return value == std::trunc(value) && std::abs(value) < std::ldexp(1.0, 53)
             ? fmt::format("{:.1f}lf", value)
             : fmt::format("packDouble2x32(uvec2({}u, {}u))", bits & 0xffffffffu, bits >> 32);
}

int64_t LiteralConv::offset(int64_t oc) const {
  const Shape& taps = weight_shape();
  const int64_t correction = element_bytes_ == 1 ? 128 + input_zero_point() : 0;
  const Tensor& bias = *graph_.value(node_.inputs[2]).constant;
  int64_t offset = bias.get(bias.count() == 1 ? 0 : oc);
  const auto [from, to] = read_by(oc, oc + 1);
  for (int64_t k = 0; correction != 0 && k < taps[1] * taps[2]; ++k)
    for (int64_t c = from; c < to; ++c)
      offset -= correction * weight(oc, k / taps[2], k % taps[2], c);
  return offset;
}

std::optional<LiteralConv::Scale> LiteralConv::scale_in_doubles(int64_t oc, int64_t added) const {
  if (!problem_.proof) return std::nullopt;
  const auto& nodes = problem_.group.nodes;
  const auto after = std::find_if(nodes.begin(), nodes.end(), [&](NodeId id) {
    const Node& node = graph_.node(id);
    return node.op == Op::kRescale && node.inputs[0] == node_.output;
  });
  const auto reads_sum = [&](NodeId id) {
    const std::vector<ValueId>& inputs = graph_.node(id).inputs;
    return std::find(inputs.begin(), inputs.end(), node_.output) != inputs.end();
  };
  if (after == nodes.end() || std::count_if(nodes.begin(), nodes.end(), reads_sum) > 1)
    return std::nullopt;
  const Node& node = graph_.node(*after);
  const auto constant = [&](size_t operand) {
    const Tensor& tensor = *graph_.value(node.inputs[operand]).constant;
    return tensor.get(tensor.count() == 1 ? 0 : oc);
  };
  const DType to = graph_.value(node.output).type.dtype;
  if ((to != DType::kInt8 && to != DType::kInt16) || node.attrs.flag(Attr::kInputUnsigned) ||
      node.attrs.flag(Attr::kOutputUnsigned) ||
      node.attrs.get(Attr::kRoundingMode) != kSingleRound || constant(3) != 0)
    return std::nullopt;
  const int64_t multiplier = constant(1), shift = constant(2), zero_point = constant(4),
                half = to == DType::kInt8 ? 128 : 32768,
                low = problem_.proof->min[static_cast<size_t>(oc)],
                high = problem_.proof->max[static_cast<size_t>(oc)];
  constexpr int64_t kExact = int64_t{1} << 53, kWord = int64_t{1} << 31;
  if (multiplier < 0 || shift < 1 || shift > 44 ||
      std::max({std::abs(low), std::abs(high), std::abs(added)}) >= kWord)
    return std::nullopt;
  // The result times 2^shift, before the shift: all of it an integer that a double holds.
  const int64_t constant_part =
      added * multiplier + (int64_t{1} << (shift - 1)) + ((half + zero_point) << shift);
  for (const int64_t sum : {low - added, high - added})
    if (std::abs(sum) >= kExact / std::max<int64_t>(multiplier, 1) ||
        std::abs(sum * multiplier + constant_part) >= kExact ||
        std::abs(sum * multiplier + constant_part) >> shift >= kWord)
      return std::nullopt;
  if (std::abs(constant_part) >= kExact) return std::nullopt;
  const double unit = std::ldexp(1.0, -static_cast<int>(shift));
  return Scale{node.output, static_cast<double>(multiplier) * unit,
               static_cast<double>(constant_part) * unit, half};
}

int64_t LiteralConv::stored_together(int64_t first, int64_t last) const {
  const DType dtype = graph_.value(problem_.group.result).type.dtype;
  for (const int64_t bytes : {16, 4}) {
    const int64_t width = bytes / dtype_info(dtype).host_bytes;
    if (dtype != DType::kInt48 && width > 0 && out()[3] % width == 0 && first % width == 0 &&
        last % width == 0)
      return width;
  }
  return 1;
}

void LiteralConv::results(std::string& text, int64_t first, int64_t last, const std::string& y,
                          const std::string& x, const Sums& sums, const std::string& suffix) {
  const ValueId result = problem_.group.result;
  const int64_t channels = out()[3];
  // The last tiles of a row or column may reach beyond the result.
  text += fmt::format("  if ({} < {} && {} < {}) {{\n", x, out()[2], y, out()[1]);
  // Results are stored as wide as they lie together: stores cost by their number.
  const int64_t width = stored_together(first, last);
  const DType dtype = graph_.value(result).type.dtype,
              sum_dtype = graph_.value(node_.output).type.dtype;
  std::vector<std::string> words, parts;
  for (int64_t oc = first; oc < last; ++oc) {
    const std::string own = fmt::format("{}_{}", suffix, oc);
    const Position at{{"n", y, x, std::to_string(oc)}, {}};
    const std::string sum = sums.expression(oc);
    std::optional<Scale> scale;
    const int64_t added = offset(oc) + (sums.less.empty() ? 0 : sums.less[static_cast<size_t>(oc)]);
    if (sums.floating && profile_.caps.features.has(Feature::kFloat64))
      scale = scale_in_doubles(oc, added);
    if (scale) {
      // Above 0 truncation is the floor that the shift means, and below 0 all becomes 0.
      text += fmt::format(
          "  double h{0} = double({1}) * {2} + {3};\n  int u{0} = clamp(int(h{0}), 0, {4});\n", own,
          sum, double_literal(scale->factor), double_literal(scale->constant), 2 * scale->half - 1);
      codegen_.locals()[scale->output] = fmt::format("(u{} - {})", own, scale->half);
    } else {
      const int64_t wrapped =
          sum_dtype == DType::kInt48 ? added : static_cast<int32_t>(static_cast<uint64_t>(added));
      text += fmt::format("  {0} h{1} = {0}({2}) + {3};\n", Codegen::register_type(sum_dtype), own,
                          sum, Codegen::literal(wrapped, sum_dtype));
      codegen_.locals()[node_.output] = "h" + own;
    }
    codegen_.epilogue(text, at, own, scale ? std::optional(scale->output) : std::nullopt);
    const std::string value = codegen_.load(result, at);
    if (width == 1) {
      text += codegen_.store(result, at, value);
      continue;
    }
    parts.push_back(value);
    if (static_cast<uint32_t>(parts.size()) * dtype_info(dtype).host_bytes == 4) {
      words.push_back(Codegen::packed_word(dtype, parts));
      parts.clear();
    }
    if ((oc + 1) % width != 0) continue;
    const bool wide = words.size() == 4;
    text +=
        fmt::format("  b{}.d[((n * {} + {}) * {} + {}) * {} + {}] = {}({});\n",
                    codegen_.bind(result, BindingType::kStorageBuffer,
                                  wide ? ImageFormat::kRgba32Uint : ImageFormat::kR32Uint, true),
                    out()[1], y, out()[2], x, channels / width, oc / width, wide ? "uvec4" : "uint",
                    fmt::join(words, ", "));
    words.clear();
  }
  text += "  }\n";
}

std::optional<size_t> Tiling::below(size_t index) const {
  const std::array<int64_t, 2> same{texels[index][0] + step_y, texels[index][1]};
  const auto at = std::find(texels.begin(), texels.end(), same);
  if (at == texels.end()) return std::nullopt;
  return static_cast<size_t>(at - texels.begin());
}

std::array<int64_t, 2> LiteralConv::tiles(const Tiling& tiling) const {
  return {ceil_div(out()[1], tiling.tile_height), ceil_div(out()[2], tiling.tile_width)};
}

int64_t literal_lanes(int64_t grid_x) { return ceil_div(grid_x, 8) * 8; }

int64_t LiteralConv::row_parts(const Tiling& tiling) const {
  const auto [height, width] = tiles(tiling);
  if (problem_.cell_rows != 0) return ceil_div(height, cell_tiles(tiling));
  const int64_t columns = out()[0] * ceil_div(width, local_x(width));
  return std::min(std::max(ceil_div(height, kMostRows), ceil_div(kLeastWorkgroups, columns)),
                  height);
}

int64_t LiteralConv::cell_tiles(const Tiling& tiling) const {
  return std::max<int64_t>(problem_.cell_rows / tiling.tile_height, 1);
}

double LiteralConv::fetches(const Tiling& tiling, std::array<int64_t, 2> channels) const {
  const double starts =  // of a part, for each row
      static_cast<double>(row_parts(tiling)) / static_cast<double>(tiles(tiling)[0]);
  double count = 0;
  for (size_t i = 0; i < tiling.texels.size(); ++i) count += tiling.below(i) ? starts : 1.0;
  const int64_t words = ceil_div(channels[1], lanes_) - channels[0] / lanes_;
  return count * static_cast<double>(split_words_ ? 2 * words : words);
}

std::string LiteralConv::over_rows(const Tiling& tiling, const std::string& body,
                                   std::array<int64_t, 2> channels) {
  const int64_t height = tiles(tiling)[0], parts = row_parts(tiling);
  const bool loop = parts < height;
  std::string before, each, after;
  for (size_t i = 0; i < tiling.texels.size(); ++i) {
    const auto [row, column] = tiling.texels[i];
    const std::optional<size_t> next = loop ? tiling.below(i) : std::nullopt;
    for (int64_t c = channels[0] / lanes_ * lanes_; c < channels[1]; c += lanes_) {
      (next ? before : each) +=
          fmt::format("  {} {} = {};\n", texel_type(), texel(i, c),
                      fetch(tiling.source, c, plus("iy", row), plus("ix", column), tiling.outside));
      if (next) after += fmt::format("  {} = {};\n", texel(i, c), texel(*next, c));
    }
  }
  // Unsigned: both factors may have 16 bits.
  const auto border = [&](const char* part) {
    if (!loop) return std::string("y");
    if (problem_.cell_rows != 0)
      return fmt::format("int(min({} * {}u, {}u))", part, cell_tiles(tiling), height);
    return fmt::format("int({} * {}u / {}u)", part, height, parts);
  };
  const std::string start = fmt::format("  {{\n  int row = {}, iy = row * {}, ix = x * {};\n",
                                        border("uint(y)"), tiling.step_y, tiling.step_x);
  if (!loop) return start + each + body + "  }\n";
  // Left at its end: after a condition at its start CPU drivers run the body once more, for no lane.
  return start + before + "  for (;;) {\n" + each + body + after +
         fmt::format("  ++row;\n  iy += {};\n  if (row >= {}) break;\n  }}\n  }}\n", tiling.step_y,
                     border("uint(y + 1)"));
}

int64_t LiteralConv::channels_per_loop(int64_t channels) const {
  const int64_t loops = ceil_div(channels, profile_.most_sums);
  return ceil_div(ceil_div(channels, loops), 4) * 4;
}

bool LiteralConv::fits_grid(const Tiling& tiling) const {
  const auto [height, width] = tiles(tiling);
  return ceil_div(width, local_x(width)) <= kMaxWorkgroups && height <= kMaxWorkgroups &&
         out()[0] <= kMaxWorkgroups;
}

KernelSource LiteralConv::finish(const Tiling& tiling, const std::string& body) {
  const int64_t width = tiles(tiling)[1], local = local_x(width);
  KernelSource source;
  source.workgroups = {static_cast<uint32_t>(ceil_div(width, local)),
                       static_cast<uint32_t>(row_parts(tiling)), static_cast<uint32_t>(out()[0])};
  const int64_t wide = local * tiling.tile_width;
  const auto column = [&](int64_t i) { return Stretch{i * wide, (i + 1) * wide}; };
  codegen_.take_cells(source, column, cell_tiles(tiling) * tiling.tile_height);
  source.glsl = codegen_.finish(
      fmt::format("local_size_x = {}", local),
      fmt::format("  int x = int({0}.x);\n  int y = int({0}.y);\n  int n = int({0}.z);\n"
                  "  if (x >= {1}) return;\n  uint none = uint(x >= {2});\n",
                  codegen_.invocation(), width, INT32_MAX) +
          body);
  source.bindings = codegen_.bindings();
  source.optimize = OptimizeBy::kForwarding;
  return source;
}

}  // namespace shale
