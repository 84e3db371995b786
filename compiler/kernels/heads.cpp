// Heads of `generic` and `runs`: sums, pools, reductions and lookups, an element or a run of them an invocation.
#include "compiler/kernels/heads.h"

#include <algorithm>
#include <bit>
#include <functional>

namespace shale {
namespace {

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
  /// A loop over the last dimension of some operands, in order, up to `most` elements a turn where they are fetched
  /// together and their number allows.
  std::string loop_along(const std::string& name, int64_t count,
                         const std::function<std::string(const Position& element)>& inner,
                         int64_t most = kSummed) const {
    int64_t step = c_.reads_texels() ? most : 1;
    while (step > 1 && (count % step != 0 || step % kSummed != 0)) step /= 2;
    std::string body;
    for (const Position& element : Position::run_at({""}, name, step)) body += inner(element);
    return loop(name, count, body, step);
  }
  static constexpr int64_t kSummed = 4;
  static constexpr int64_t kReduced = 32;   ///< of a reduction to one element
  static constexpr int64_t kUnrolled = 16;  ///< the most taps that are written one by one
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
    const auto bias = [&](size_t i) {
      return shape(2)[0] == 1 ? load(2, {"0"}) : c_.load(node_.inputs[2], along(i, {}));
    };
    // Integers start from the bias, which the driver finds no worse; a sum of floats ends with it.
    const auto whole = [&](const std::string& sums) {
      if (!is_real()) return start(bias) + sums + finish();
      return start("0.0") + sums +
             finish([&](size_t i) { return fmt::format("({} + {})", acc(i), bias(i)); });
    };
    if (depthwise) {
      // HWCM, and output channel c * M + m: the last two are one dimension.
      const int64_t multiplier = weight[3];
      const Shape merged{weight[0], weight[1], weight[2] * weight[3]};
      const auto operands = [&](size_t i, const std::vector<std::string>& position,
                                const std::vector<std::string>& at_tap) {
        Position from = along(i, position);
        if (multiplier > 1) {
          from = {.coords = std::move(from.coords)};
          from.coords.back() = fmt::format("({} / {})", from.coords.back(), multiplier);
        }
        return std::pair{c_.load(node_.inputs[0], from),
                         c_.load_as(node_.inputs[1], merged, along(i, at_tap))};
      };
      if (c_.reads_texels() && weight[0] * weight[1] <= kUnrolled) {
        std::array<std::vector<Tap>, 2> taps;
        std::string declared;
        for (size_t axis = 0; axis < 2; ++axis)
          taps[axis] = taps_of(axis,
                               {in[axis + 1], c_.value(node_.output).type.shape[axis + 1],
                                weight[axis], stride[axis], pad[2 * axis], dilation[axis]},
                               declared);
        return whole(declared + each_tap(taps, [&](const std::vector<std::string>& position,
                                                   const std::string& inside, size_t y, size_t x) {
                       return each([&](size_t i) {
                         const auto [value, w] =
                             operands(i, {at_.coords[0], position[0], position[1]},
                                      {std::to_string(y), std::to_string(x)});
                         // A tap outside adds 0 whatever the weight is, infinite ones included.
                         return fmt::format(
                             "    {} += {};\n", acc(i),
                             if_inside(inside, fmt::format("{}({}) * {}", accumulator(),
                                                           centred(value, 3), centred(w, 4))));
                       });
                     }));
      }
      code = each([&](size_t i) {
        const auto [x, w] = operands(i, in_at, tap);
        return product(i, x, w);
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
    return whole(code);
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

  /// A tap of a window along one axis, written out: the locals that hold its position, clamped to the input, and whether
  /// it lies inside; empty where it always does.
  struct Tap {
    std::string position, inside;
  };
  struct Axis {
    int64_t in, out, kernel, stride, before, dilation = 1;
    bool reaches_out(int64_t tap) const {
      const int64_t first = tap * dilation - before;
      return first < 0 || (out - 1) * stride + first >= in;
    }
  };
  /// The taps of the axis that `at_` calls coordinate `axis` + 1; the code declares them.
  std::vector<Tap> taps_of(size_t axis, const Axis& a, std::string& code) const {
    std::vector<Tap> taps;
    for (int64_t k = 0; k < a.kernel; ++k) {
      Tap tap{fmt::format("p{}_{}", axis, k), {}};
      const std::string own = fmt::format("{} * {} + {}", at_.coords[axis + 1], a.stride,
                                          Codegen::literal(k * a.dilation - a.before));
      if (a.reaches_out(k)) {
        tap.inside = fmt::format("i{}_{}", axis, k);
        code += fmt::format("  bool {} = uint({}) < {}u;\n", tap.inside, own, a.in);
        code += fmt::format("  int {} = clamp({}, 0, {});\n", tap.position, own, a.in - 1);
      } else {
        code += fmt::format("  int {} = {};\n", tap.position, own);
      }
      taps.push_back(std::move(tap));
    }
    return taps;
  }
  /// `text` of each tap of a window: its position and when it counts, "" for always.
  static std::string each_tap(
      const std::array<std::vector<Tap>, 2>& taps,
      const std::function<std::string(const std::vector<std::string>& position,
                                      const std::string& inside, size_t y, size_t x)>& text) {
    std::string code;
    for (size_t y = 0; y < taps[0].size(); ++y)
      for (size_t x = 0; x < taps[1].size(); ++x) {
        const std::string &row = taps[0][y].inside, &column = taps[1][x].inside;
        code += text({taps[0][y].position, taps[1][x].position},
                     row.empty()      ? column
                     : column.empty() ? row
                                      : fmt::format("{} && {}", row, column),
                     y, x);
      }
    return code;
  }

  /// What a tap adds to a sum: 0 where it lies outside.
  std::string if_inside(const std::string& inside, const std::string& term) const {
    return inside.empty() ? term : fmt::format("mix({}, {}, {})", zero(), term, inside);
  }

  std::string pool() {
    const bool average = node_.op == Op::kAvgPool2d;
    const std::span<const int64_t> kernel = node_.attrs.list(Attr::kKernel);
    const std::span<const int64_t> stride = node_.attrs.list(Attr::kStride);
    const std::span<const int64_t> pad = node_.attrs.list(Attr::kPad);
    const IntRange range = dtype_range(result_dtype());
    const auto count_tap = [&](size_t i, const std::vector<std::string>& position,
                               const std::string& inside) {
      const Position tap = along(i, {at_.coords[0], position[0], position[1]});
      if (average) {
        return fmt::format("    {} += {};\n", acc(i), if_inside(inside, centred(0, tap, 1)));
      }
      const std::string x = c_.load(node_.inputs[0], tap);
      return fmt::format("    {} = {};\n", acc(i),
                         is_real() ? Codegen::extremum(node_, "max", acc(i), x)
                                   : fmt::format("max({}, {})", acc(i), x));
    };
    std::string code, before;
    std::array<Axis, 2> axes{};
    for (size_t axis = 0; axis < 2; ++axis)
      axes[axis] = {shape(0)[axis + 1], c_.value(node_.output).type.shape[axis + 1], kernel[axis],
                    stride[axis], pad[2 * axis]};
    if (c_.reads_texels() && kernel[0] * kernel[1] <= kUnrolled) {
      std::array<std::vector<Tap>, 2> taps;
      std::string count;
      for (size_t axis = 0; axis < 2; ++axis) {
        taps[axis] = taps_of(axis, axes[axis], before);
        std::string inside;
        for (const Tap& tap : taps[axis])
          if (!tap.inside.empty()) inside += fmt::format(" + int({})", tap.inside);
        const auto whole = std::count_if(taps[axis].begin(), taps[axis].end(),
                                         [](const Tap& tap) { return tap.inside.empty(); });
        count += fmt::format("{}({}{})", count.empty() ? "" : " * ", whole, inside);
      }
      before += fmt::format("  int count = {};\n", count);
      // A tap outside is clamped to one inside, which a maximum may see twice.
      code += each_tap(taps, [&](const std::vector<std::string>& position,
                                 const std::string& inside, size_t, size_t) {
        return each([&](size_t i) { return count_tap(i, position, inside); });
      });
    } else {
      before = "  int count = 0;\n";
      code = each([&](size_t i) { return count_tap(i, {"p0", "p1"}, ""); });
      if (average) code += "    ++count;\n";
      for (size_t axis = 2; axis-- > 0;) {
        const std::string position = fmt::format(
            "    int p{0} = {1} * {2} - {3} + k{0};\n    if (uint(p{0}) >= {4}u) continue;\n", axis,
            at_.coords[axis + 1], stride[axis], pad[2 * axis], shape(0)[axis + 1]);
        code = loop(fmt::format("k{}", axis), kernel[axis], position + code);
      }
    }
    if (!average)
      return before + start(is_real() ? lowest("max") : std::to_string(range.min)) + code +
             finish();
    if (is_real())
      return before + start("0.0") + code +
             finish([](size_t i) { return fmt::format("({} / float(count))", acc(i)); });
    const int64_t zp = c_.value(node_.inputs[2]).constant->get(0);
    // Whatever the result is, its sum is an int.
    std::string sums, results;
    for (size_t i = 0; i < run_.size(); ++i) {
      sums += fmt::format("  int {} = 0;\n", acc(i));
      results += fmt::format("  int {} = clamp({} + {}, {}, {});\n", result(i),
                             averaged(acc(i), axes), Codegen::literal(zp), range.min, range.max);
    }
    return before + sums + code + results;
  }

  /// The sum of a window of integers divided by the number of its taps inside.
  std::string averaged(const std::string& sum, const std::array<Axis, 2>& axes) {
    const bool is_whole = std::all_of(axes.begin(), axes.end(), [](const Axis& axis) {
      return !axis.reaches_out(0) && !axis.reaches_out(axis.kernel - 1);
    });
    if (!is_whole || !c_.reads_texels()) {
      c_.use_int64();
      return fmt::format("average_pool({}, count)", sum);
    }
    // TOSA 1.0, reciprocal_scale, of a number that is known.
    const int64_t n = axes[0].kernel * axes[1].kernel;
    const int64_t k = std::bit_width(static_cast<uint64_t>(n - 1));
    const int64_t multiplier = (((int64_t{1} << 30) + 1) << k) / n;
    const int64_t widest = n * 2 * -dtype_range(c_.value(node_.inputs[0]).type.dtype).min;
    return Codegen::scaled(sum, {-widest, widest}, multiplier, 30 + k);
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
    // Of a pixel, for all its channels.
    const std::string near_y = fmt::format("({} - f0)", scale[0]),
                      near_x = fmt::format("({} - f1)", scale[2]);
    const char* const type = accumulator();
    code += fmt::format(
        "  {0} w0 = {0}({1}) * {2}, w1 = {0}({1}) * f1, w2 = {0}(f0) * {2}, w3 = {0}(f0) * f1;\n",
        type, near_y, near_x);
    return code + each([&](size_t i) {
             const auto term = [&](const char* y, const char* x, const char* weight) {
               return fmt::format("{}({}) * {}", type, texel(i, y, x), weight);
             };
             return fmt::format("  {} {} = {} + {} + {} + {};\n", type, result(i),
                                term("u0", "u1", "w0"), term("u0", "v1", "w1"),
                                term("v0", "u1", "w2"), term("v0", "v1", "w3"));
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
      const std::string best = fmt::format("best{}", i);
      std::string wins = !is_real() ? "x > " + best
                         : ignore   ? fmt::format("x > {0} || (is_nan({0}) && !is_nan(x))", best)
                                    : fmt::format("!is_nan({0}) && (x > {0} || is_nan(x))", best);
      if (is_real()) wins = fmt::format("{} == 0 || ({})", k, wins);
      // Both sides of a branch cost a CPU driver more than two selects.
      return fmt::format(
          "    {{\n    {0} x = {1};\n    bool wins = {2};\n    {3} = mix({3}, x, wins);\n"
          "    {4} = mix({4}, {5}, wins);\n    }}\n",
          type, c_.load(node_.inputs[0], element), wins, best, result(i), k);
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
    return is_last ? loop_along("k", in[axis], all, run_.size() == 1 ? kReduced : kSummed)
                   : loop("k", in[axis], all({.coords = {"k"}}));
  }

  Codegen& c_;
  const Node& node_;
  const std::vector<Position>& run_;
  const Position& at_;  ///< the first of the run: the coordinates before the last are those of all
};

}  // namespace

std::string head_result(size_t element) { return HeadEmitter::result(element); }

std::string emit_head(Codegen& codegen, const Node& node, const std::vector<Position>& run) {
  return HeadEmitter(codegen, node, run).emit();
}

}  // namespace shale
