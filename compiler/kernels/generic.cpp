// generic: one invocation per result element, storage buffers; takes every group. The executable
// fallback, and the naive kernel that the fast ones are measured against.
#include <algorithm>
#include <set>

#include "compiler/kernels/codegen.h"

namespace shale {
namespace {

constexpr int64_t kLocalSize = 64;
constexpr int64_t kMaxGroupsX = 65535;  // Vulkan's guaranteed maxComputeWorkGroupCount

/// Code that leaves the head's result in the local `h`.
class HeadEmitter {
 public:
  HeadEmitter(Codegen& codegen, const Node& node, const Position& at)
      : c_(codegen), node_(node), at_(at) {}

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
  DType result() const { return c_.value(node_.output).type.dtype; }
  const char* accumulator() const { return Codegen::register_type(result()); }
  bool is_real() const { return is_float(c_.value(node_.inputs[0]).type.dtype); }
  std::string zero() const { return is_float(result()) ? "0.0" : Codegen::literal(0, result()); }
  /// A register `acc` with this value.
  std::string start(const std::string& value) const {
    return fmt::format("  {} = {};\n", Codegen::declare(result(), "acc"), value);
  }
  /// The head's result from this expression; of an FP16 one rounded.
  std::string finish(const std::string& value) const {
    return fmt::format("  {} = {};\n", Codegen::declare(result(), "h"),
                       Codegen::rounded(value, result()));
  }
  /// What a running max of floats starts from: lost against any number.
  std::string lowest(const char* which) const {
    if (node_.attrs.get(Attr::kNanMode) == kIgnoreNan) return "uintBitsToFloat(0x7fc00000u)";
    return which == std::string_view("max") ? "uintBitsToFloat(0xff800000u)"
                                            : "uintBitsToFloat(0x7f800000u)";
  }
  std::string load(size_t operand, std::vector<std::string> coords) {
    return c_.load(node_.inputs[operand], {std::move(coords), {}});
  }
  /// `(x - zp)`, or x alone where the zero point is 0.
  std::string centred(size_t operand, std::vector<std::string> coords, size_t zp_operand) {
    const int64_t zp = c_.value(node_.inputs[zp_operand]).constant->get(0);
    const std::string x = load(operand, std::move(coords));
    return is_real() || zp == 0 ? x : fmt::format("({} - {})", x, Codegen::literal(zp));
  }
  static std::string loop(const std::string& name, int64_t count, const std::string& inner) {
    return fmt::format("  for (int {0} = 0; {0} < {1}; ++{0}) {{\n{2}  }}\n", name, count, inner);
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
    const std::string& oc = at_.coords.back();

    std::vector<std::string> in_at{at_.coords[0]};
    std::vector<std::string> tap;
    for (size_t axis = 0; axis < axes; ++axis) {
      in_at.push_back(fmt::format("p{}", axis));
      tap.push_back(fmt::format("k{}", axis));
    }
    std::string product;
    if (depthwise) {
      const int64_t multiplier = weight[3];
      in_at.push_back(fmt::format("({} / {})", oc, multiplier));
      tap.push_back(fmt::format("({} / {})", oc, multiplier));
      tap.push_back(fmt::format("({} % {})", oc, multiplier));
    } else {
      in_at.push_back("c");
      tap.insert(tap.begin(), oc);
      tap.push_back("c");
    }
    product = fmt::format("    acc += {}({}) * {};\n", accumulator(), centred(0, in_at, 3),
                          centred(1, tap, 4));
    std::string code = depthwise ? product : loop("c", weight.back(), product);
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
    const std::string bias = load(2, {shape(2)[0] == 1 ? "0" : oc});
    // Integers start from the bias, which the driver finds no worse; a sum of floats ends with it.
    if (is_real()) return start("0.0") + code + finish("(acc + " + bias + ")");
    return start(bias) + code + finish("acc");
  }

  std::string matmul() {
    const std::vector<std::string>& o = at_.coords;
    const std::string product =
        fmt::format("    acc += {}({}) * {};\n", accumulator(), centred(0, {o[0], o[1], "c"}, 2),
                    centred(1, {o[0], "c", o[2]}, 3));
    return start(zero()) + loop("c", shape(0)[2], product) + finish("acc");
  }

  std::string pool() {
    const bool average = node_.op == Op::kAvgPool2d;
    const std::span<const int64_t> kernel = node_.attrs.list(Attr::kKernel);
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    const std::span<const int64_t> pad = node_.attrs.list(Attr::kPad);
    const IntRange range = dtype_range(result());
    const std::vector<std::string> tap{at_.coords[0], "p0", "p1", at_.coords[3]};
    const std::string larger = is_real() && !average
                                   ? Codegen::extremum(node_, "max", "acc", load(0, tap))
                                   : fmt::format("max(acc, {})", load(0, tap));
    std::string code = average ? fmt::format("    acc += {}; ++count;\n", centred(0, tap, 1))
                               : fmt::format("    acc = {};\n", larger);
    for (size_t axis = 2; axis-- > 0;) {
      const std::string position = fmt::format(
          "    int p{0} = {1} * {2} - {3} + k{0};\n    if (uint(p{0}) >= {4}u) continue;\n", axis,
          at_.coords[axis + 1], stride[axis], pad[2 * axis], shape(0)[axis + 1]);
      code = loop(fmt::format("k{}", axis), kernel[axis], position + code);
    }
    if (!average)
      return start(is_real() ? lowest("max") : std::to_string(range.min)) + code + finish("acc");
    if (is_real())
      return start("0.0") + "  int count = 0;\n" + code + finish("(acc / float(count))");
    c_.use_int64();
    const int64_t zp = c_.value(node_.inputs[2]).constant->get(0);
    return fmt::format(
        "  int acc = 0;\n  int count = 0;\n{}  int h = clamp(average_pool(acc, count) + {}, {}, "
        "{});\n",
        code, Codegen::literal(zp), range.min, range.max);
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
    if (is_real()) {
      for (size_t axis = 0; axis < 2; ++axis)
        code += fmt::format("  precise float d{0} = float(f{0}) / {1}.0, n{0} = 1.0 - d{0};\n",
                            axis, scale[2 * axis]);
      code += start("0.0");
      for (const auto& [y, wy] : {std::pair{"u0", "n0"}, std::pair{"v0", "d0"}})
        for (const auto& [x, wx] : {std::pair{"u1", "n1"}, std::pair{"v1", "d1"}})
          code += fmt::format("  acc += {} * {} * {};\n",
                              load(0, {at_.coords[0], y, x, at_.coords[3]}), wy, wx);
      return code + finish("acc");
    }
    const auto term = [&](const char* y, const char* x, const std::string& weight_y,
                          const std::string& weight_x) {
      return fmt::format("{}({}) * {} * {}", accumulator(),
                         load(0, {at_.coords[0], y, x, at_.coords[3]}), weight_y, weight_x);
    };
    const std::string near_y = fmt::format("({} - f0)", scale[0]),
                      near_x = fmt::format("({} - f1)", scale[2]);
    return code + fmt::format("  {} h = {} + {} + {} + {};\n", accumulator(),
                              term("u0", "u1", near_y, near_x), term("u0", "v1", near_y, "f1"),
                              term("v0", "u1", "f0", near_x), term("v0", "v1", "f0", "f1"));
  }

  std::string gather() {
    // An index outside the values has no result in TOSA; clamped, it cannot read foreign memory.
    const std::string index = load(1, {at_.coords[0], at_.coords[1]});
    return fmt::format("  int k = clamp({}, 0, {});\n  {} h = {};\n", index, shape(0)[1] - 1,
                       accumulator(), load(0, {at_.coords[0], "k", at_.coords[2]}));
  }

  std::string scatter() {
    const std::string take =
        fmt::format("    if ({} == {}) acc = {};\n", load(1, {at_.coords[0], "w"}), at_.coords[1],
                    load(2, {at_.coords[0], "w", at_.coords[2]}));
    return fmt::format("  {0} acc = {1};\n{2}  {0} h = acc;\n", accumulator(), load(0, at_.coords),
                       loop("w", shape(1)[1], take));
  }

  std::string argmax() {
    const size_t axis = static_cast<size_t>(node_.attrs.get(Attr::kAxis));
    std::vector<std::string> coords = at_.coords;
    coords.insert(coords.begin() + static_cast<std::ptrdiff_t>(axis), "k");
    const std::string element = load(0, coords);
    if (is_real()) {
      const bool ignore = node_.attrs.get(Attr::kNanMode) == kIgnoreNan;
      const std::string wins = ignore ? "x > best || (is_nan(best) && !is_nan(x))"
                                      : "!is_nan(best) && (x > best || is_nan(x))";
      return fmt::format(
          "  int h = 0;\n  float best = {};\n{}", lowest("max"),
          loop("k", shape(0)[axis],
               fmt::format("    float x = {};\n    if (k == 0 || {}) {{ best = x; h = k; }}\n",
                           element, wins)));
    }
    return fmt::format(
        "  int h = 0;\n  int best = {};\n{}", dtype_range(c_.value(node_.inputs[0]).type.dtype).min,
        loop("k", shape(0)[axis],
             fmt::format("    int x = {};\n    if (x > best) {{ best = x; h = k; }}\n", element)));
  }

  std::string reduce() {
    const size_t axis = static_cast<size_t>(node_.attrs.get(Attr::kAxis));
    std::vector<std::string> coords = at_.coords;
    coords[axis] = "k";
    const std::string x = load(0, coords);
    std::string first = zero(), step;
    switch (node_.op) {
      case Op::kReduceSum: step = "acc + " + x; break;
      case Op::kReduceAny: step = "acc | " + x; break;
      case Op::kReduceAll:
        first = "1";
        step = "acc & " + x;
        break;
      case Op::kReduceMax:
        first = is_real() ? lowest("max") : Codegen::literal(dtype_range(result()).min);
        step =
            is_real() ? Codegen::extremum(node_, "max", "acc", x) : fmt::format("max(acc, {})", x);
        break;
      case Op::kReduceMin:
        first = is_real() ? lowest("min") : Codegen::literal(dtype_range(result()).max);
        step =
            is_real() ? Codegen::extremum(node_, "min", "acc", x) : fmt::format("min(acc, {})", x);
        break;
      default: SHALE_CHECK(false && "no reduction");
    }
    return start(first) + loop("k", shape(0)[axis], fmt::format("    acc = {};\n", step)) +
           finish("acc");
  }

  Codegen& c_;
  const Node& node_;
  const Position& at_;
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
void name_coordinates(Position& at, std::string& body) {
  for (size_t i = 0; i < at.coords.size(); ++i) {
    const std::string name = fmt::format("o{}", i);
    if (at.coords[i] == "0") continue;
    body += fmt::format("  int {} = {};\n", name, at.coords[i]);
    at.coords[i] = name;
  }
}

/// One invocation for each element of `shape`, numbered from 0: `body` starts with its position, the
/// names of which are in `at`.
KernelSource grid_over(const Shape& shape, Position& at, std::string& body) {
  const int64_t count = *element_count(shape);
  const int64_t groups = (count + kLocalSize - 1) / kLocalSize;
  const int64_t groups_x = std::min(groups, kMaxGroupsX);
  const int64_t groups_y = (groups + groups_x - 1) / groups_x;
  body = fmt::format(
      "  uint invocation = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * {}u;\n"
      "  if (invocation >= {}u) return;\n  int index = int(invocation);\n",
      groups_x * kLocalSize, count);
  at = Codegen::split("index", shape);
  name_coordinates(at, body);
  KernelSource source;
  source.workgroups = {static_cast<uint32_t>(groups_x), static_cast<uint32_t>(groups_y), 1};
  return source;
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
  at = {{"int(place.z)", "int(place.y)", fmt::format("int(place.x) / {}", shape[3]),
         fmt::format("int(place.x) % {}", shape[3])},
        "index"};
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
    Position at;
    std::string body;
    KernelSource source = grid_over(slab, at, body);
    Position to{at.coords, {}};
    if (begin > 0) to.coords[axis] = fmt::format("({} + {})", at.coords[axis], begin);
    body += codegen.store(node.output, to, codegen.concat(part, at, slab[axis]));
    finish(source, codegen, body);
    sources.push_back(std::move(source));
    begin += slab[axis];
  }
  return sources;
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
  Position at;
  std::string body;
  const Shape& shape = codegen.value(problem.group.result).type.shape;
  std::optional<KernelSource> cells = grid_of_cells(codegen, shape, at, body);
  KernelSource source = cells ? *std::move(cells) : grid_over(shape, at, body);
  if (problem.group.head) {
    const Node& head = problem.graph->node(*problem.group.head);
    body += HeadEmitter(codegen, head, at).emit();
    codegen.locals()[head.output] = "h";
  }
  codegen.epilogue(body, at, "");
  const std::string value =
      op_kind(last) == OpKind::kView ? codegen.view(last, at) : codegen.load(last.output, at);
  body += codegen.store(problem.group.result, at, value);
  finish(source, codegen, body);
  return std::vector<KernelSource>{std::move(source)};
}

}  // namespace shale
