// generic: one invocation per result element, storage buffers; takes every group. The executable
// fallback, and the naive kernel that the fast ones are measured against.
//
// runs: the same for CPU drivers, where a buffer is read and written lane by lane but texels are fetched for all lanes
// at once: an invocation makes the elements of 16 bytes (4, or one) next to each other, reads texels as wide, and stores
// once. Source: ours.
#include <algorithm>
#include <functional>
#include <set>

#include "compiler/kernels/codegen.h"

namespace shale {
namespace {

constexpr int64_t kLocalSize = 64;
constexpr int64_t kMaxGroupsX = 65535;  // Vulkan's guaranteed maxComputeWorkGroupCount

/// Code that leaves the head's result in the locals `h0`, `h1`, ..., one for each element of a run of the
/// result (HeadEmitter::result). What the elements share is written for each, and found to be equal by the driver.
class HeadEmitter {
 public:
  HeadEmitter(Codegen& codegen, const Node& node, const std::vector<Position>& run)
      : c_(codegen), node_(node), run_(run), at_(run[0]) {}

  static std::string result(size_t element) { return fmt::format("h{}", element); }

  std::string emit() {
    switch (node_.op) {
      case Op::kConv2d:
      case Op::kConv3d:
      case Op::kDepthwiseConv2d:
      case Op::kTransposeConv2d: return convolution();
      case Op::kMatmul: return matmul();
      case Op::kAvgPool2d:
      case Op::kMaxPool2d: return pool();
      case Op::kResize: return bilinear();
      case Op::kGather: return gather();
      case Op::kScatter: return scatter();
      case Op::kArgmax: return argmax();
      default: return reduce();
    }
  }

 private:
  const Shape& shape(size_t operand) const { return c_.value(node_.inputs[operand]).type.shape; }
  DType result_dtype() const { return c_.value(node_.output).type.dtype; }
  const char* accumulator() const { return Codegen::register_type(result_dtype()); }
  bool is_real() const { return is_float(c_.value(node_.inputs[0]).type.dtype); }
  std::string zero() const {
    return is_float(result_dtype()) ? "0.0" : Codegen::literal(0, result_dtype());
  }
  static std::string acc(size_t element) { return fmt::format("acc{}", element); }
  /// Text for each element of the run.
  std::string each(const std::function<std::string(size_t element)>& text) const {
    std::string all;
    for (size_t i = 0; i < run_.size(); ++i) all += text(i);
    return all;
  }
  /// A register `acc` of each element with this value.
  std::string start(const std::function<std::string(size_t element)>& value) const {
    return each([&](size_t i) {
      return fmt::format("  {} = {};\n", Codegen::declare(result_dtype(), acc(i)), value(i));
    });
  }
  std::string start(const std::string& value) const {
    return start([&](size_t) { return value; });
  }
  /// The head's results from these expressions; of an FP16 rounded.
  std::string finish(const std::function<std::string(size_t element)>& value) const {
    return each([&](size_t i) {
      return fmt::format("  {} = {};\n", Codegen::declare(result_dtype(), result(i)),
                         Codegen::rounded(value(i), result_dtype()));
    });
  }
  std::string finish() const { return finish(acc); }
  /// What a running max of floats starts from: lost against any number.
  std::string lowest(const char* which) const {
    if (node_.attrs.get(Attr::kNanMode) == kIgnoreNan) return "uintBitsToFloat(0x7fc00000u)";
    return which == std::string_view("max") ? "uintBitsToFloat(0xff800000u)"
                                            : "uintBitsToFloat(0x7f800000u)";
  }
  std::string load(size_t operand, std::vector<std::string> coords) {
    return c_.load(node_.inputs[operand], {.coords = std::move(coords)});
  }
  /// The position with these coordinates whose last one is that of element `i` of the run.
  Position along(size_t i, std::vector<std::string> coords) const {
    Position at = run_[i];
    coords.push_back(at.coords.back());
    at.coords = std::move(coords);
    at.linear.clear();
    return at;
  }
  /// `(x - zp)`, or x alone where the zero point is 0.
  std::string centred(const std::string& x, size_t zp_operand) const {
    const int64_t zp = c_.value(node_.inputs[zp_operand]).constant->get(0);
    return is_real() || zp == 0 ? x : fmt::format("({} - {})", x, Codegen::literal(zp));
  }
  std::string centred(size_t operand, const Position& at, size_t zp_operand) {
    return centred(c_.load(node_.inputs[operand], at), zp_operand);
  }
  static std::string loop(const std::string& name, int64_t count, const std::string& inner,
                          int64_t step = 1) {
    return fmt::format("  for (int {0} = 0; {0} < {1}; {0} += {3}) {{\n{2}  }}\n", name, count,
                       inner, step);
  }
  /// A loop over the last dimension of some operands, in order, `kSummed` elements a turn where they are fetched
  /// together and their number allows.
  std::string loop_along(const std::string& name, int64_t count,
                         const std::function<std::string(const Position& element)>& inner) const {
    const int64_t step = c_.reads_texels() && count % kSummed == 0 ? kSummed : 1;
    std::string body;
    for (const Position& element : Position::run_at({""}, name, step)) body += inner(element);
    return loop(name, count, body, step);
  }
  static constexpr int64_t kSummed = 4;
  /// The position of such an element, after `coords`.
  static Position ending(std::vector<std::string> coords, Position element) {
    coords.push_back(element.coords.back());
    element.coords = std::move(coords);
    return element;
  }

  /// The four convolutions differ in how a tap finds its input and its weight.
  std::string convolution() {
    const Shape& in = shape(0);
    const Shape& weight = shape(1);
    const bool depthwise = node_.op == Op::kDepthwiseConv2d;
    const bool transpose = node_.op == Op::kTransposeConv2d;
    const size_t axes = node_.op == Op::kConv3d ? 3 : 2;
    const size_t first_kernel_axis = depthwise ? 0 : 1;
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    const std::span<const int64_t> dilation = node_.attrs.list(Attr::kDilation);
    const std::span<const int64_t> pad = node_.attrs.list(transpose ? Attr::kOutPad : Attr::kPad);

    std::vector<std::string> in_at{at_.coords[0]};
    std::vector<std::string> tap;
    for (size_t axis = 0; axis < axes; ++axis) {
      in_at.push_back(fmt::format("p{}", axis));
      tap.push_back(fmt::format("k{}", axis));
    }
    const auto product = [&](size_t i, const std::string& x, const std::string& w) {
      return fmt::format("    {} += {}({}) * {};\n", acc(i), accumulator(), centred(x, 3),
                         centred(w, 4));
    };
    std::string code;
    if (depthwise) {
      // HWCM, and output channel c * M + m: the last two are one dimension.
      const int64_t multiplier = weight[3];
      const Shape merged{weight[0], weight[1], weight[2] * weight[3]};
      code = each([&](size_t i) {
        Position from = along(i, in_at);
        if (multiplier > 1) {
          from = {.coords = std::move(from.coords)};
          from.coords.back() = fmt::format("({} / {})", from.coords.back(), multiplier);
        }
        return product(i, c_.load(node_.inputs[0], from),
                       c_.load_as(node_.inputs[1], merged, along(i, tap)));
      });
    } else {
      code = loop_along("c", weight.back(), [&](const Position& c) {
        return each([&](size_t i) {
          std::vector<std::string> row = tap;
          row.insert(row.begin(), run_[i].coords.back());
          return product(i, c_.load(node_.inputs[0], ending(in_at, c)),
                         c_.load(node_.inputs[1], ending(row, c)));
        });
      });
    }
    for (size_t axis = axes; axis-- > 0;) {
      const std::string& out = at_.coords[axis + 1];
      std::string position;
      if (transpose) {
        position = fmt::format(
            "    int q{0} = {1} - {2} - k{0};\n    if (q{0} < 0 || q{0} % {3} != 0) continue;\n"
            "    int p{0} = q{0} / {3};\n",
            axis, out, Codegen::literal(pad[2 * axis]), stride[axis]);
      } else {
        position = fmt::format("    int p{0} = {1} * {2} - {3} + k{0} * {4};\n", axis, out,
                               stride[axis], pad[2 * axis], dilation[axis]);
      }
      position += fmt::format("    if (uint(p{0}) >= {1}u) continue;\n", axis, in[axis + 1]);
      code = loop(fmt::format("k{}", axis), weight[first_kernel_axis + axis], position + code);
    }
    const auto bias = [&](size_t i) {
      return shape(2)[0] == 1 ? load(2, {"0"}) : c_.load(node_.inputs[2], along(i, {}));
    };
    // Integers start from the bias, which the driver finds no worse; a sum of floats ends with it.
    if (!is_real()) return start(bias) + code + finish();
    return start("0.0") + code +
           finish([&](size_t i) { return fmt::format("({} + {})", acc(i), bias(i)); });
  }

  std::string matmul() {
    const std::vector<std::string>& o = at_.coords;
    return start(zero()) +
           loop_along("c", shape(0)[2],
                      [&](const Position& c) {
                        return each([&](size_t i) {
                          return fmt::format("    {} += {}({}) * {};\n", acc(i), accumulator(),
                                             centred(0, ending({o[0], o[1]}, c), 2),
                                             centred(1, along(i, {o[0], c.coords.back()}), 3));
                        });
                      }) +
           finish();
  }

  std::string pool() {
    const bool average = node_.op == Op::kAvgPool2d;
    const std::span<const int64_t> kernel = node_.attrs.list(Attr::kKernel);
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    const std::span<const int64_t> pad = node_.attrs.list(Attr::kPad);
    const IntRange range = dtype_range(result_dtype());
    const auto tap = [&](size_t i) { return along(i, {at_.coords[0], "p0", "p1"}); };
    std::string code = each([&](size_t i) {
      if (average) return fmt::format("    {} += {};\n", acc(i), centred(0, tap(i), 1));
      const std::string x = c_.load(node_.inputs[0], tap(i));
      return fmt::format("    {} = {};\n", acc(i),
                         is_real() ? Codegen::extremum(node_, "max", acc(i), x)
                                   : fmt::format("max({}, {})", acc(i), x));
    });
    if (average) code += "    ++count;\n";
    for (size_t axis = 2; axis-- > 0;) {
      const std::string position = fmt::format(
          "    int p{0} = {1} * {2} - {3} + k{0};\n    if (uint(p{0}) >= {4}u) continue;\n", axis,
          at_.coords[axis + 1], stride[axis], pad[2 * axis], shape(0)[axis + 1]);
      code = loop(fmt::format("k{}", axis), kernel[axis], position + code);
    }
    if (!average)
      return start(is_real() ? lowest("max") : std::to_string(range.min)) + code + finish();
    if (is_real())
      return start("0.0") + "  int count = 0;\n" + code +
             finish([](size_t i) { return fmt::format("({} / float(count))", acc(i)); });
    c_.use_int64();
    const int64_t zp = c_.value(node_.inputs[2]).constant->get(0);
    // Whatever the result is, its sum is an int.
    std::string sums, results;
    for (size_t i = 0; i < run_.size(); ++i) {
      sums += fmt::format("  int {} = 0;\n", acc(i));
      results += fmt::format("  int {} = clamp(average_pool({}, count) + {}, {}, {});\n", result(i),
                             acc(i), Codegen::literal(zp), range.min, range.max);
    }
    return "  int count = 0;\n" + sums + code + results;
  }

  std::string bilinear() {
    const std::vector<int64_t> scale = c_.value(node_.inputs[1]).constant->ints();
    const std::vector<int64_t> offset = c_.value(node_.inputs[2]).constant->ints();
    std::string code;
    for (size_t axis = 0; axis < 2; ++axis)
      code += fmt::format(
          "  int s{0} = {1} * {2} + {3};\n  int q{0} = (s{0} + {4}) / {4} - 1;\n  int f{0} = s{0} "
          "- q{0} * {4};\n"
          "  int u{0} = max(q{0}, 0);\n  int v{0} = min(q{0} + 1, {5});\n",
          axis, at_.coords[axis + 1], scale[2 * axis + 1], Codegen::literal(offset[axis]),
          scale[2 * axis], shape(0)[axis + 1] - 1);
    const auto texel = [&](size_t i, const char* y, const char* x) {
      return c_.load(node_.inputs[0], along(i, {at_.coords[0], y, x}));
    };
    if (is_real()) {
      for (size_t axis = 0; axis < 2; ++axis)
        code += fmt::format("  precise float d{0} = float(f{0}) / {1}.0, n{0} = 1.0 - d{0};\n",
                            axis, scale[2 * axis]);
      code += start("0.0");
      for (const auto& [y, wy] : {std::pair{"u0", "n0"}, std::pair{"v0", "d0"}})
        for (const auto& [x, wx] : {std::pair{"u1", "n1"}, std::pair{"v1", "d1"}})
          for (size_t i = 0; i < run_.size(); ++i)
            code += fmt::format("  {} += {} * {} * {};\n", acc(i), texel(i, y, x), wy, wx);
      return code + finish();
    }
    const std::string near_y = fmt::format("({} - f0)", scale[0]),
                      near_x = fmt::format("({} - f1)", scale[2]);
    return code + each([&](size_t i) {
             const auto term = [&](const char* y, const char* x, const std::string& weight_y,
                                   const std::string& weight_x) {
               return fmt::format("{}({}) * {} * {}", accumulator(), texel(i, y, x), weight_y,
                                  weight_x);
             };
             return fmt::format("  {} {} = {} + {} + {} + {};\n", accumulator(), result(i),
                                term("u0", "u1", near_y, near_x), term("u0", "v1", near_y, "f1"),
                                term("v0", "u1", "f0", near_x), term("v0", "v1", "f0", "f1"));
           });
  }

  std::string gather() {
    // An index outside the values has no result in TOSA; clamped, it cannot read foreign memory.
    return fmt::format("  int k = clamp({}, 0, {});\n", load(1, {at_.coords[0], at_.coords[1]}),
                       shape(0)[1] - 1) +
           each([&](size_t i) {
             return fmt::format("  {} {} = {};\n", accumulator(), result(i),
                                c_.load(node_.inputs[0], along(i, {at_.coords[0], "k"})));
           });
  }

  std::string scatter() {
    const std::string take = each([&](size_t i) {
      return fmt::format("    {} = {};\n", acc(i),
                         c_.load(node_.inputs[2], along(i, {at_.coords[0], "w"})));
    });
    return each([&](size_t i) {
             return fmt::format("  {} {} = {};\n", accumulator(), acc(i),
                                c_.load(node_.inputs[0], run_[i]));
           }) +
           loop("w", shape(1)[1],
                fmt::format("    if ({} == {}) {{\n{}    }}\n", load(1, {at_.coords[0], "w"}),
                            at_.coords[1], take)) +
           each([&](size_t i) {
             return fmt::format("  {} {} = {};\n", accumulator(), result(i), acc(i));
           });
  }

  std::string argmax() {
    const size_t axis = static_cast<size_t>(node_.attrs.get(Attr::kAxis));
    const bool ignore = is_real() && node_.attrs.get(Attr::kNanMode) == kIgnoreNan;
    const std::string first =
        is_real() ? lowest("max")
                  : Codegen::literal(dtype_range(c_.value(node_.inputs[0]).type.dtype).min);
    const char* type = is_real() ? "float" : "int";
    const auto step = [&](size_t i, const Position& element, const std::string& k) {
      const std::string best = fmt::format("best{}", i), x = "x";
      const std::string wins = !is_real() ? "x > " + best
                               : ignore
                                   ? fmt::format("x > {0} || (is_nan({0}) && !is_nan(x))", best)
                                   : fmt::format("!is_nan({0}) && (x > {0} || is_nan(x))", best);
      return fmt::format("    {{\n    {} x = {};\n    if ({}{}) {{ {} = x; {} = {}; }}\n    }}\n",
                         type, c_.load(node_.inputs[0], element), is_real() ? k + " == 0 || " : "",
                         wins, best, result(i), k);
    };
    std::string code = each([&](size_t i) {
      return fmt::format("  int {} = 0;\n  {} best{} = {};\n", result(i), type, i, first);
    });
    return code + over(axis, [&](size_t i, const Position& element, const std::string& k) {
             return step(i, element, k);
           });
  }

  std::string reduce() {
    const size_t axis = static_cast<size_t>(node_.attrs.get(Attr::kAxis));
    std::string first = node_.op == Op::kReduceAll       ? "1"
                        : node_.op == Op::kReduceProduct ? "1.0"
                                                         : zero();
    std::function<std::string(const std::string& a, const std::string& x)> step;
    const auto infix = [](const char* symbol) {
      return [symbol](const std::string& a, const std::string& x) {
        return fmt::format("{} {} {}", a, symbol, x);
      };
    };
    const auto extreme = [&](const char* which, int64_t limit) {
      first = is_real() ? lowest(which) : Codegen::literal(limit);
      step = [this, which](const std::string& a, const std::string& x) {
        return is_real() ? Codegen::extremum(node_, which, a, x)
                         : fmt::format("{}({}, {})", which, a, x);
      };
    };
    switch (node_.op) {
      case Op::kReduceSum: step = infix("+"); break;
      case Op::kReduceProduct: step = infix("*"); break;
      case Op::kReduceAny: step = infix("|"); break;
      case Op::kReduceAll: step = infix("&"); break;
      case Op::kReduceMax: extreme("max", dtype_range(result_dtype()).min); break;
      case Op::kReduceMin: extreme("min", dtype_range(result_dtype()).max); break;
      default: SHALE_CHECK(false && "no reduction");
    }
    return start(first) +
           over(axis,
                [&](size_t i, const Position& element, const std::string&) {
                  return fmt::format("    {} = {};\n", acc(i),
                                     step(acc(i), c_.load(node_.inputs[0], element)));
                }) +
           finish();
  }

  /// A loop over `axis` of operand 0, in order: `text` of an element of the run, the element of the operand and its
  /// coordinate along the axis. The result lacks that dimension (ARGMAX) or has it as 1.
  std::string over(
      size_t axis,
      const std::function<std::string(size_t, const Position&, const std::string&)>& text) const {
    const Shape& in = shape(0);
    const bool is_last = axis + 1 == in.size();
    const auto element = [&](size_t i, const Position& k) {
      std::vector<std::string> coords = run_[i].coords;
      if (coords.size() < in.size())
        coords.insert(coords.begin() + static_cast<std::ptrdiff_t>(axis), k.coords.back());
      else
        coords[axis] = k.coords.back();
      Position at = is_last ? k : run_[i];
      at.coords = std::move(coords);
      at.linear.clear();
      return text(i, at, k.coords.back());
    };
    const auto all = [&](const Position& k) {
      return each([&](size_t i) { return element(i, k); });
    };
    return is_last ? loop_along("k", in[axis], all) : loop("k", in[axis], all({.coords = {"k"}}));
  }

  Codegen& c_;
  const Node& node_;
  const std::vector<Position>& run_;
  const Position& at_;  ///< the first of the run: the coordinates before the last are those of all
};

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
  const Shape& shape = codegen.value(problem.group.result).type.shape;
  std::string body;
  KernelSource source;
  std::vector<Position> run{{}};
  if (std::optional<KernelSource> cells;
      length == 1 && (cells = grid_of_cells(codegen, shape, run[0], body)))
    source = *std::move(cells);
  else
    run = grid_over(shape, length, body, source);
  if (length > 1) body += fmt::format("  uint none = uint(index >= {});\n", INT32_MAX);
  if (problem.group.head)
    body += HeadEmitter(codegen, problem.graph->node(*problem.group.head), run).emit();
  std::vector<std::string> values;
  for (size_t i = 0; i < run.size(); ++i) {
    if (problem.group.head)
      codegen.locals()[problem.graph->node(*problem.group.head).output] = HeadEmitter::result(i);
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
  return std::vector<KernelSource>{
      emit_runs(problem, codegen, codegen.run_length(longest_run(problem)))};
}

}  // namespace shale
