// conv2d_s8_f32exact and conv2d_s8_i32: direct convolution with the weights as literals in the
// code.
//
// Meaning of a workgroup: a strip of 64 tiles of output pixels; one invocation makes all output
// channels of one tile (of the module's slice of channels), kPass sums at a time in registers. A
// tile is one pixel where there are kPass channels; with fewer it is as many pixels as fill kPass
// sums, so that neighbours share their fetches. Input by texel fetches, four channels each where
// the layout allows. Source: ours; figures in compiler/kernels/README.md.
//
// f32exact sums int8 products in float32, exact while every partial sum stays below 2^24; the range
// proof of the actual weights decides. The bias is added as an integer afterwards, so it does not
// count. i32 is the same in int32 arithmetic and needs no proof: TOSA's legal results wrap back
// into range.
#include <algorithm>
#include <set>

#include "compiler/kernels/codegen.h"

namespace shale {
namespace {

constexpr int64_t kFloatExact = int64_t{1} << 24;
constexpr int64_t kPass = 16;  ///< sums kept live
/// Most products in a module: bounds the driver's compile time, which grows faster than the code,
/// and in integer arithmetic much faster (16,500 integer products took it six minutes).
constexpr int64_t kFloatProducts = 9216, kIntegerProducts = 4608;
constexpr int64_t kMaxModules = 64;
constexpr int64_t kLocalX = 64;

const Node& head_of(const GroupProblem& problem) {
  return problem.graph->node(*problem.group.head);
}

/// Channels of every tensor that the convolution reads through its folded views; empty if a view is
/// one that this kernel does not take (a pad of batch or channels, a concat of another axis).
std::vector<int64_t> leaf_channels(const GroupProblem& problem, ValueId id,
                                   const std::vector<std::optional<NodeId>>& producers) {
  const Graph& graph = *problem.graph;
  const std::optional<NodeId> producer = producers[id.index];
  if (!producer || !problem.group.contains(*producer)) return {graph.value(id).type.shape[3]};
  const Node& node = graph.node(*producer);
  std::vector<int64_t> leaves;
  if (node.op == Op::kPad) {
    const std::vector<int64_t> padding = graph.value(node.inputs[1]).constant->ints();
    for (const size_t i : {0u, 1u, 6u, 7u})
      if (padding[i] != 0) return {};
    if (!graph.value(node.inputs[2]).is_constant()) return {};
  } else if (node.op == Op::kConcat) {
    if (node.attrs.get(Attr::kAxis) != 3) return {};
  } else if (node.op != Op::kResize) {
    return {};
  }
  const size_t sources = node.op == Op::kConcat ? node.inputs.size() : 1;
  for (size_t i = 0; i < sources; ++i) {
    const std::vector<int64_t> own = leaf_channels(problem, node.inputs[i], producers);
    if (own.empty()) return {};
    leaves.insert(leaves.end(), own.begin(), own.end());
  }
  return leaves;
}

int64_t products_per_channel(const GroupProblem& problem) {
  const Shape& weight = problem.graph->value(head_of(problem).inputs[1]).type.shape;
  return weight[1] * weight[2] * weight[3];
}

/// Output pixels of an invocation.
struct Tile {
  int64_t height, width;
};

/// `products` are those of one channel of one pixel; a tile multiplies the code, so a module bounds
/// it too.
Tile tile_of(int64_t channels, int64_t products, int64_t most_products) {
  if (channels > 8) return {1, 1};
  const Tile tile = channels > 4    ? Tile{1, 2}
                    : channels > 2  ? Tile{2, 2}
                    : channels == 2 ? Tile{2, 4}
                                    : Tile{4, 4};
  return tile.height * tile.width * channels * products <= most_products ? tile : Tile{1, 1};
}

/// Output channels in a module: as many passes as `most_products` allows, or a part of one, in
/// fours so that results make words; 0 if not even four channels fit.
int64_t channels_per_module(const GroupProblem& problem, int64_t most_products) {
  const int64_t channels = problem.graph->value(problem.group.result).type.shape[3];
  const int64_t fit = most_products / products_per_channel(problem);
  if (fit >= channels) return channels;
  return fit >= kPass ? fit / kPass * kPass : fit / 4 * 4;
}

bool direct_supports(const GroupProblem& problem, const DeviceProfile& profile,
                     int64_t most_products) {
  if (!profile.literal_weights || !problem.group.head) return false;
  const Graph& graph = *problem.graph;
  const Node& node = head_of(problem);
  if (node.op != Op::kConv2d) return false;
  const auto is = [&](size_t operand, DType dtype) {
    return graph.value(node.inputs[operand]).type.dtype == dtype;
  };
  if (!is(0, DType::kInt8) || !is(1, DType::kInt8)) return false;
  if (!graph.value(node.inputs[1]).is_constant() || !graph.value(node.inputs[2]).is_constant())
    return false;
  if (op_kind(graph.node(problem.group.nodes.back())) == OpKind::kView) return false;
  const int64_t channels = graph.value(problem.group.result).type.shape[3];
  const int64_t per_module = channels_per_module(problem, most_products);
  if (per_module == 0 || (channels + per_module - 1) / per_module > kMaxModules) return false;
  const Shape& out = graph.value(node.output).type.shape;
  const Tile tile = tile_of(channels, products_per_channel(problem), most_products);
  const auto fits_grid = [](int64_t extent, int64_t each) {
    return (extent + each - 1) / each <= kMaxWorkgroups;
  };
  if (!fits_grid(out[2], kLocalX * tile.width) || !fits_grid(out[1], tile.height) ||
      !fits_grid(out[0], 1))
    return false;
  const std::vector<std::optional<NodeId>> producers = graph.producers();
  const std::vector<int64_t> leaves = leaf_channels(problem, node.inputs[0], producers);
  if (leaves.empty()) return false;
  const auto fits_texels = [&](ValueId id) {
    const std::optional<NodeId> producer = producers[id.index];
    return (producer && problem.group.contains(*producer)) ||
           element_count(graph.value(id).type.shape).value_or(0) <=
               static_cast<int64_t>(profile.caps.max_texel_elements);
  };
  return std::all_of(problem.group.nodes.begin(), problem.group.nodes.end(), [&](NodeId id) {
    const std::vector<ValueId>& operands = graph.node(id).inputs;
    return id == *problem.group.head ? fits_texels(operands[0])
                                     : std::all_of(operands.begin(), operands.end(), fits_texels);
  });
}

double direct_time_us(const GroupProblem& problem, const DeviceProfile& profile, double share) {
  const Shape& weight = problem.graph->value(head_of(problem).inputs[1]).type.shape;
  // Channel by channel fetches cost about as much as a pass of products each.
  const double overhead = weight[3] % 4 == 0 ? 1.0 : 2.0;
  const double arithmetic =
      2e-3 * static_cast<double>(problem.cost.macs) / (profile.mul_add_gops * share) * overhead;
  const double memory = 1e-3 *
                        static_cast<double>(problem.cost.bytes_read + problem.cost.bytes_written) /
                        profile.bandwidth_gbps;
  return std::max(arithmetic, memory) + profile.launch_us;
}

class DirectEmitter {
 public:
  DirectEmitter(const GroupProblem& problem, bool use_float)
      : problem_(problem),
        graph_(*problem.graph),
        node_(head_of(problem)),
        float_(use_float),
        weight_(*graph_.value(node_.inputs[1]).constant),
        producers_(graph_.producers()) {
    const std::vector<int64_t> leaves = leaf_channels(problem, node_.inputs[0], producers_);
    tile_ = tile_of(graph_.value(node_.output).type.shape[3], products_per_channel(problem),
                    most_products());
    lanes_ =
        std::all_of(leaves.begin(), leaves.end(), [](int64_t c) { return c % 4 == 0; }) ? 4 : 1;
  }

  std::vector<KernelSource> emit() {
    std::vector<KernelSource> sources;
    const int64_t channels = graph_.value(node_.output).type.shape[3];
    const int64_t step = channels_per_module(problem_, most_products());
    for (int64_t first = 0; first < channels; first += step)
      sources.push_back(module(first, std::min(channels, first + step)));
    return sources;
  }

 private:
  int64_t most_products() const { return float_ ? kFloatProducts : kIntegerProducts; }

  KernelSource module(int64_t first, int64_t last) {
    Codegen codegen(problem_);
    functions_.clear();
    const Shape& out = graph_.value(node_.output).type.shape;
    const std::span<const int64_t> pad = node_.attrs.list(Attr::kPad);
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    std::string body = fmt::format(
        "  int x = int(gl_GlobalInvocationID.x) * {};\n  int y = int(gl_GlobalInvocationID.y) * "
        "{};\n"
        "  int n = int(gl_GlobalInvocationID.z);\n  if (x >= {}) return;\n"
        "  int ix = x * {} - {};\n  int iy = y * {} - {};\n",
        tile_.width, tile_.height, out[2], stride[1], pad[2], stride[0], pad[0]);
    for (int64_t pass = first; pass < last; pass += kPass)
      body += channels(codegen, pass, std::min(last, pass + kPass));
    KernelSource source;
    source.glsl = codegen.finish(fmt::format("local_size_x = {}", kLocalX), body);
    const auto groups = [](int64_t extent, int64_t each) {
      return static_cast<uint32_t>((extent + each - 1) / each);
    };
    source.workgroups = {groups(out[2], kLocalX * tile_.width), groups(out[1], tile_.height),
                         static_cast<uint32_t>(out[0])};
    source.bindings = codegen.bindings();
    source.optimize = false;
    return source;
  }

  int64_t weight(int64_t oc, int64_t ky, int64_t kx, int64_t c) const {
    const Shape& shape = weight_.type.shape;
    return weight_.get(((oc * shape[1] + ky) * shape[2] + kx) * shape[3] + c) -
           graph_.value(node_.inputs[4]).constant->get(0);
  }

  /// The tap that makes output pixel `out` read input offset `in` along an axis, or nothing.
  static std::optional<int64_t> tap(int64_t in, int64_t out, int64_t stride, int64_t dilation,
                                    int64_t taps) {
    const int64_t distance = in - out * stride;
    if (distance < 0 || distance % dilation != 0 || distance / dilation >= taps)
      return std::nullopt;
    return distance / dilation;
  }

  /// Input offsets along an axis that any tap of any pixel of the tile reads, each once and in
  /// order: with a large stride or dilation they are few in a wide span.
  static std::set<int64_t> offsets(int64_t pixels, int64_t stride, int64_t taps, int64_t dilation) {
    std::set<int64_t> result;
    for (int64_t pixel = 0; pixel < pixels; ++pixel)
      for (int64_t tap = 0; tap < taps; ++tap) result.insert(pixel * stride + tap * dilation);
    return result;
  }

  /// Code for output channels [first, last) of the invocation's tile.
  std::string channels(Codegen& codegen, int64_t first, int64_t last) {
    const Shape& shape = weight_.type.shape;
    const char* scalar = float_ ? "float" : "int";
    const int64_t input_zp = graph_.value(node_.inputs[3]).constant->get(0);
    const std::span<const int64_t> dilation = node_.attrs.list(Attr::kDilation);
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    std::string text = "  {\n";
    for (int64_t pixel = 0; pixel < tile_.height * tile_.width; ++pixel)
      for (int64_t oc = first; oc < last; ++oc)
        text += fmt::format("  {} a{}_{} = {};\n", scalar, pixel, oc - first, float_ ? "0.0" : "0");
    text += lanes_ == 4 ? fmt::format("  {} t;\n", float_ ? "vec4" : "ivec4")
                        : fmt::format("  {} t;\n", scalar);
    for (const int64_t row : offsets(tile_.height, stride[0], shape[1], dilation[0]))
      for (const int64_t column : offsets(tile_.width, stride[1], shape[2], dilation[1]))
        for (int64_t c = 0; c < shape[3]; c += lanes_) {
          const std::string terms = products(first, last, row, column, c);
          if (terms.empty()) continue;
          text += fmt::format("  t = {}({});\n", lanes_ == 4 ? (float_ ? "vec4" : "ivec4") : scalar,
                              fetch(codegen, node_.inputs[0], c, fmt::format("iy + {}", row),
                                    fmt::format("ix + {}", column), input_zp)) +
                  terms;
        }
    for (int64_t j = 0; j < tile_.height; ++j)
      for (int64_t i = 0; i < tile_.width; ++i) results(codegen, text, first, last, j, i);
    return text + "  }\n";
  }

  /// What the texel at (row, column) of the tile's input, channels from `c` on, adds to the sums.
  std::string products(int64_t first, int64_t last, int64_t row, int64_t column, int64_t c) const {
    const Shape& shape = weight_.type.shape;
    const std::span<const int64_t> dilation = node_.attrs.list(Attr::kDilation);
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    std::string text;
    for (int64_t pixel = 0; pixel < tile_.height * tile_.width; ++pixel) {
      const std::optional<int64_t> ky =
          tap(row, pixel / tile_.width, stride[0], dilation[0], shape[1]);
      const std::optional<int64_t> kx =
          tap(column, pixel % tile_.width, stride[1], dilation[1], shape[2]);
      if (!ky || !kx) continue;
      for (int64_t oc = first; oc < last; ++oc) {
        std::string sum;
        for (int64_t lane = 0; lane < lanes_; ++lane) {
          const int64_t w = weight(oc, *ky, *kx, c + lane);
          if (w == 0) continue;
          const std::string x = lanes_ == 4 ? fmt::format("t.{}", "xyzw"[lane]) : "t";
          sum += fmt::format("{}{} * {}", sum.empty() ? "" : " + ", x,
                             float_ ? fmt::format("{}.0", w) : std::to_string(w));
        }
        if (!sum.empty()) text += fmt::format("  a{}_{} += {};\n", pixel, oc - first, sum);
      }
    }
    return text;
  }

  /// Bias, fused elementwise nodes and stores of pixel (j, i) of the tile.
  void results(Codegen& codegen, std::string& text, int64_t first, int64_t last, int64_t j,
               int64_t i) {
    const Shape& shape = weight_.type.shape;
    const Shape& out = graph_.value(node_.output).type.shape;
    const int64_t pixel = j * tile_.width + i;
    const int64_t input_zp = graph_.value(node_.inputs[3]).constant->get(0);
    const Tensor& bias = *graph_.value(node_.inputs[2]).constant;
    const std::string y = j == 0 ? "y" : fmt::format("(y + {})", j),
                      x = i == 0 ? "x" : fmt::format("(x + {})", i);
    // The last tiles of a row or column may reach beyond the result.
    text += fmt::format("  if ({} < {} && {} < {}) {{\n", x, out[2], y, out[1]);
    // Four int8 results make a word of the result buffer where channels allow it.
    const bool words =
        graph_.value(problem_.group.result).type.dtype == DType::kInt8 && out[3] % 4 == 0;
    std::string word;
    for (int64_t oc = first; oc < last; ++oc) {
      // Raw bytes were multiplied: zp * sum(w) comes off here, and a padded tap reads zp.
      int64_t offset = bias.get(bias.count() == 1 ? 0 : oc);
      for (int64_t k = 0; input_zp != 0 && k < shape[1] * shape[2] * shape[3]; ++k)
        offset -=
            input_zp * weight(oc, k / (shape[2] * shape[3]), k / shape[3] % shape[2], k % shape[3]);
      const std::string suffix = fmt::format("_{}_{}", pixel, oc - first);
      text += fmt::format("  int h{0} = int(a{1}_{2}) + {3};\n", suffix, pixel, oc - first,
                          Codegen::literal(static_cast<int32_t>(static_cast<uint64_t>(offset))));
      codegen.locals()[node_.output] = "h" + suffix;
      const Position at{{"n", y, x, std::to_string(oc)}, {}};
      codegen.epilogue(text, at, suffix);
      const std::string value = codegen.load(problem_.group.result, at);
      if (!words) {
        text += codegen.store(problem_.group.result, at, value);
      } else if (oc % 4 < 3) {
        word += fmt::format("(({} & 255) << {}) | ", value, 8 * (oc % 4));
      } else {
        const size_t binding = codegen.bind(problem_.group.result, BindingType::kStorageBuffer,
                                            ImageFormat::kRgba8Sint, true);
        text += fmt::format("  b{}.d[((n * {} + {}) * {} + {}) * {} + {}] = uint({}({} << 24));\n",
                            binding, out[1], y, out[2], x, out[3] / 4, oc / 4, word, value);
        word.clear();
      }
    }
    text += "  }\n";
  }

  /// Call of the function that fetches `lanes_` channels from `c` on of value `id` at row y, column
  /// x; outside the value it gives `outside`.
  std::string fetch(Codegen& codegen, ValueId id, int64_t c, const std::string& y,
                    const std::string& x, int64_t outside) {
    const std::string name = fmt::format("fetch{}_{}", id.index, c);
    if (functions_.emplace(name).second) {
      const Shape& shape = graph_.value(id).type.shape;
      const char* type = lanes_ == 4 ? "ivec4" : "int";
      const std::string body = inside(codegen, id, c);
      codegen.add_function(fmt::format(
          "{0} {1}(int n, int y, int x, int outside) {{\n"
          "  if (uint(y) < {2}u && uint(x) < {3}u) return {4};\n  return {0}(outside);\n}}\n\n",
          type, name, shape[1], shape[2], body));
    }
    return fmt::format("{}(n, {}, {}, {})", name, y, x, outside);
  }

  /// The same where row y and column x are inside the value.
  std::string inside(Codegen& codegen, ValueId id, int64_t c) {
    const std::optional<NodeId> producer = producers_[id.index];
    const Shape& shape = graph_.value(id).type.shape;
    if (!producer || !problem_.group.contains(*producer)) {
      const size_t binding =
          codegen.bind(id, BindingType::kUniformTexelBuffer,
                       lanes_ == 4 ? ImageFormat::kRgba8Sint : ImageFormat::kR8Sint, false);
      return fmt::format("texelFetch(t{}, ((n * {} + y) * {} + x) * {} + {}){}", binding, shape[1],
                         shape[2], shape[3] / lanes_, c / lanes_, lanes_ == 4 ? "" : ".x");
    }
    const Node& node = graph_.node(*producer);
    const auto ints = [&](size_t index) {
      return graph_.value(node.inputs[index]).constant->ints();
    };
    if (node.op == Op::kPad) {
      const std::vector<int64_t> padding = ints(1);
      return fetch(codegen, node.inputs[0], c, fmt::format("y - {}", padding[2]),
                   fmt::format("x - {}", padding[4]),
                   graph_.value(node.inputs[2]).constant->get(0));
    }
    if (node.op == Op::kConcat) {
      for (const ValueId part : node.inputs) {
        const int64_t channels = graph_.value(part).type.shape[3];
        if (c < channels) return inside(codegen, part, c);
        c -= channels;
      }
    }
    const Shape& from = graph_.value(node.inputs[0]).type.shape;
    const std::vector<int64_t> scale = ints(1), offset = ints(2);
    const auto source = [&](const char* o, size_t axis) {
      return fmt::format("nearest({}, {}, {}, {}, {})", o, scale[2 * axis], scale[2 * axis + 1],
                         Codegen::literal(offset[axis]), from[axis + 1]);
    };
    return fetch(codegen, node.inputs[0], c, source("y", 0), source("x", 1), 0);
  }

  const GroupProblem& problem_;
  const Graph& graph_;
  const Node& node_;
  bool float_;
  const Tensor& weight_;
  std::vector<std::optional<NodeId>> producers_;
  Tile tile_{1, 1};
  int64_t lanes_ = 1;  ///< channels of a fetch
  std::set<std::string> functions_;
};

}  // namespace

bool conv2d_f32exact_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  if (!direct_supports(problem, profile, kFloatProducts) || !problem.proof) return false;
  return std::all_of(problem.proof->magnitude.begin(), problem.proof->magnitude.end(),
                     [](int64_t bound) { return bound < kFloatExact; });
}

double conv2d_f32exact_time_us(const GroupProblem& problem, const DeviceProfile& profile) {
  return direct_time_us(problem, profile, profile.literal_share);
}

Result<std::vector<KernelSource>> conv2d_f32exact_emit(const GroupProblem& problem,
                                                       const DeviceProfile&) {
  return DirectEmitter(problem, true).emit();
}

bool conv2d_i32_supports(const GroupProblem& problem, const DeviceProfile& profile) {
  return direct_supports(problem, profile, kIntegerProducts);
}

double conv2d_i32_time_us(const GroupProblem& problem, const DeviceProfile& profile) {
  return direct_time_us(problem, profile, profile.integer_share);
}

Result<std::vector<KernelSource>> conv2d_i32_emit(const GroupProblem& problem,
                                                  const DeviceProfile&) {
  return DirectEmitter(problem, false).emit();
}

}  // namespace shale
