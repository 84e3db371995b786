#include "tools/shale/random_inputs.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "ir/graph/op.h"

namespace shale {
namespace {

using Wide = __int128;

/// What values of a tensor may be; wide enough for products and sums of any of them.
struct Interval {
  Wide low = 0, high = 0;
};

Interval of_type(DType dtype) {
  const IntRange range = dtype_range(dtype);
  return {range.min, range.max};
}
Interval both(const Interval& a, const Interval& b) {
  return {std::min(a.low, b.low), std::max(a.high, b.high)};
}
Interval product(const Interval& a, const Interval& b) {
  const Wide corners[] = {a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high};
  return {*std::ranges::min_element(corners), *std::ranges::max_element(corners)};
}
bool inside(const Interval& a, const Interval& b) { return b.low <= a.low && a.high <= b.high; }

Interval of_constant(const Tensor& tensor) {
  if (tensor.count() == 0) return {};
  Interval interval{tensor.get(0), tensor.get(0)};
  for (int64_t i = 1; i < tensor.count(); ++i)
    interval = both(interval, {tensor.get(i), tensor.get(i)});
  return interval;
}

/// An operand that its node is not defined for.
struct Conflict {
  ValueId operand;
  std::optional<Interval> wanted;  ///< what the node asks of it, where that is a fixed interval
  int64_t distinct = 0;            ///< its elements have to differ within rows so long
};

/// The intervals of a graph's values from those of its inputs.
class Intervals {
 public:
  explicit Intervals(const Graph& graph) : graph_(graph), of_(graph.values.size()) {
    for (size_t i = 0; i < graph.values.size(); ++i)
      if (const Value& value = graph.values[i]; value.is_constant() && is_whole(value.type.dtype))
        of_[i] = of_constant(*value.constant);
  }

  /// The first conflict in the order of the nodes.
  std::optional<Conflict> find(const std::vector<Interval>& inputs) {
    for (size_t i = 0; i < inputs.size(); ++i) of_[graph_.inputs[i].index] = inputs[i];
    for (const Node& node : graph_.nodes) {
      const DType result = graph_.value(node.output).type.dtype;
      if (!is_whole(result) || !is_whole(graph_.value(node.inputs[0]).type.dtype)) {
        if (is_whole(result)) of_[node.output.index] = of_type(result);
        continue;
      }
      if (const std::optional<Conflict> conflict = evaluate(node)) return conflict;
    }
    return std::nullopt;
  }

 private:
  static bool is_whole(DType dtype) {
    return is_integer(dtype) || dtype == DType::kBool || dtype == DType::kShape;
  }
  const Shape& shape(const Node& node, size_t operand) const {
    return graph_.value(node.inputs[operand]).type.shape;
  }
  int64_t scalar(const Node& node, size_t operand) const {
    const Value& value = graph_.value(node.inputs[operand]);
    return value.is_constant() ? value.constant->get(0) : 0;
  }

  /// Sets the result's interval, if the node is defined for its operands.
  std::optional<Conflict> evaluate(const Node& node) {
    const auto in = [&](size_t operand) -> const Interval& {
      return of_[node.inputs[operand].index];
    };
    const TensorType& type = graph_.value(node.output).type;
    const Interval whole = of_type(type.dtype);
    const auto give = [&](const Interval& interval) {
      of_[node.output.index] = interval;
      return std::optional<Conflict>();
    };
    /// A result that has to be in its type.
    const auto check = [&](const Interval& interval, size_t operand = 0) {
      if (!inside(interval, whole)) return std::optional(Conflict{node.inputs[operand], {}});
      return give(interval);
    };
    const auto demand = [&](size_t operand, const Interval& wanted) {
      return inside(in(operand), wanted) ? std::nullopt
                                         : std::optional(Conflict{node.inputs[operand], wanted});
    };
    /// Sums of `count` products and the bias, with zero points.
    const auto sums = [&](Wide count, size_t bias) {
      const Interval a{in(0).low - scalar(node, bias), in(0).high - scalar(node, bias)};
      const Interval b{in(1).low - scalar(node, bias + 1), in(1).high - scalar(node, bias + 1)};
      const Interval one = both(product(a, b), {});
      return Interval{count * one.low, count * one.high};
    };
    const auto plus = [](const Interval& a, const Interval& b) {
      return Interval{a.low + b.low, a.high + b.high};
    };
    const DType from = graph_.value(node.inputs[0]).type.dtype;
    switch (node.op) {
      case Op::kAdd: return check(plus(in(0), in(1)));
      case Op::kSub: return check({in(0).low - in(1).high, in(0).high - in(1).low});
      case Op::kMul: {
        const int64_t shift = scalar(node, 2);
        if (from == DType::kInt32 && shift == 0) return give(whole);  // the low bits, by definition
        const Interval exact = product(in(0), in(1));
        if (from != DType::kInt32) return check(exact);
        const Wide round = Wide{1} << (shift - 1);
        return check({(exact.low + round) >> shift, (exact.high + round) >> shift});
      }
      case Op::kIntDiv:
        if (auto conflict = demand(1, {1, whole.high})) return conflict;
        return give(both(in(0), {}));
      case Op::kArithmeticRightShift:
      case Op::kLogicalLeftShift:
      case Op::kLogicalRightShift:
        if (auto conflict = demand(1, {0, Wide{dtype_info(from).bits} - 1})) return conflict;
        return give(whole);
      case Op::kMaximum:
        return give({std::max(in(0).low, in(1).low), std::max(in(0).high, in(1).high)});
      case Op::kMinimum:
        return give({std::min(in(0).low, in(1).low), std::min(in(0).high, in(1).high)});
      case Op::kAbs: {
        const Interval folded = both(in(0), {-in(0).high, -in(0).low});
        return check({0, folded.high});
      }
      case Op::kNegate: {
        const Wide zero = Wide{scalar(node, 1)} + scalar(node, 2);
        const Interval exact{zero - in(0).high, zero - in(0).low};
        return from == DType::kInt32 ? check(exact) : give(whole);
      }
      case Op::kClamp: {
        const Wide low = node.attrs.get(Attr::kMinVal), high = node.attrs.get(Attr::kMaxVal);
        return give({std::clamp(in(0).low, low, high), std::clamp(in(0).high, low, high)});
      }
      case Op::kReduceSum: {
        const Wide count = shape(node, 0)[static_cast<size_t>(node.attrs.get(Attr::kAxis))];
        return check({count * in(0).low, count * in(0).high});
      }
      case Op::kConv2d:
      case Op::kConv3d:
      case Op::kTransposeConv2d:
      case Op::kDepthwiseConv2d: {
        // Weights are [oc, kh, kw, ic], of depthwise [kh, kw, c, m].
        const bool is_depthwise = node.op == Op::kDepthwiseConv2d;
        Wide count = 1;
        for (size_t i = is_depthwise ? 0 : 1; i < (is_depthwise ? 2 : shape(node, 1).size()); ++i)
          count *= shape(node, 1)[i];
        return check(plus(sums(count, 3), in(2)));
      }
      case Op::kMatmul: return check(sums(shape(node, 0)[2], 2));
      case Op::kAvgPool2d: return give(whole);
      case Op::kRescale: {
        if (node.attrs.flag(Attr::kInputUnsigned)) return give(whole);
        const Interval value{in(0).low - scalar(node, 3), in(0).high - scalar(node, 3)};
        const bool scale32 = node.attrs.flag(Attr::kScale32);
        const Interval& multiplier = in(1);
        const Interval int32 = of_type(DType::kInt32);
        const Wide least_shift = std::max<Wide>(in(2).low, 1);
        const Wide half = Wide{1} << (least_shift - 1);
        if (scale32 && (!inside(value, int32) || !inside(value, {-half, half - 1})))
          return Conflict{node.inputs[0], {}};
        const Interval exact = both(product(value, multiplier), {});
        const Wide slack = Wide{1} << 30;  // of rounding and the output's zero point
        const Interval scaled{(exact.low >> least_shift) - 2, (exact.high >> least_shift) + 2};
        const Interval bound = scalar(node, 4) == 0 && from != DType::kInt48
                                   ? Interval{int32.low - 2, int32.high + 2}
                                   : Interval{int32.low + slack, int32.high - slack};
        if (!inside(scaled, bound)) return Conflict{node.inputs[0], {}};
        return give(whole);
      }
      case Op::kGather:
        if (auto conflict = demand(1, {0, Wide{shape(node, 0)[1]} - 1})) return conflict;
        return give(in(0));
      case Op::kScatter: {
        auto conflict = demand(1, {0, Wide{shape(node, 0)[1]} - 1});
        if (conflict) {
          conflict->distinct = shape(node, 1)[1];
          return conflict;
        }
        return give(both(in(0), in(2)));
      }
      case Op::kResize: {
        // Bilinear results keep the scale of both directions.
        const Value& scale = graph_.value(node.inputs[1]);
        if (type.dtype == from || !scale.is_constant()) return give(in(0));
        const Wide factor = Wide{scale.constant->get(0)} * scale.constant->get(2);
        return check(
            {factor * std::min<Wide>(in(0).low, 0), factor * std::max<Wide>(in(0).high, 0)});
      }
      case Op::kCast: return give(inside(in(0), whole) ? in(0) : whole);
      case Op::kSelect: return give(both(in(1), in(2)));
      case Op::kPad: return give(both(in(0), in(2)));
      case Op::kConcat: {
        Interval all = in(0);
        for (size_t i = 1; i < node.inputs.size(); ++i) all = both(all, in(i));
        return give(all);
      }
      case Op::kTable: return give(whole);
      case Op::kMaxPool2d:
      case Op::kReduceMax:
      case Op::kReduceMin:
      case Op::kReshape:
      case Op::kReverse:
      case Op::kSlice:
      case Op::kTile:
      case Op::kTranspose:
      case Op::kIdentity: return give(in(0));
      case Op::kArgmax: {
        const Wide count = shape(node, 0)[static_cast<size_t>(node.attrs.get(Attr::kAxis))];
        return give({0, count - 1});
      }
      case Op::kClz: return give({0, 32});
      default: return give(whole);  // of bits and truths: any of them can be
    }
  }

  const Graph& graph_;
  std::vector<Interval> of_;  ///< by value
};

bool is_view(Op op) {
  return op == Op::kReshape || op == Op::kReverse || op == Op::kSlice || op == Op::kTranspose ||
         op == Op::kIdentity || op == Op::kTile || op == Op::kConcat;
}

/// The graph inputs that a value comes from, by number; `is_direct` where only views lie between.
struct Source {
  size_t input;
  bool is_direct;
};
std::vector<Source> sources_of(const Graph& graph, ValueId value) {
  const std::vector<std::optional<NodeId>> producers = graph.producers();
  std::vector<std::optional<bool>> seen(graph.values.size());  // direct or not
  std::vector<std::pair<ValueId, bool>> waiting{{value, true}};
  std::vector<Source> sources;
  while (!waiting.empty()) {
    const auto [id, is_direct] = waiting.back();
    waiting.pop_back();
    if (seen[id.index] && (*seen[id.index] || !is_direct)) continue;
    seen[id.index] = is_direct;
    if (const std::optional<NodeId> producer = producers[id.index]) {
      const Node& node = graph.node(*producer);
      for (const ValueId operand : node.inputs)
        waiting.push_back({operand, is_direct && is_view(node.op)});
    }
  }
  for (size_t i = 0; i < graph.inputs.size(); ++i)
    if (seen[graph.inputs[i].index]) sources.push_back({i, *seen[graph.inputs[i].index]});
  return sources;
}

/// Half of it, around what is nearest to 0 in it.
Interval halved(const Interval& interval) {
  const Wide centre = std::clamp<Wide>(0, interval.low, interval.high);
  return {centre - (centre - interval.low) / 2, centre + (interval.high - centre) / 2};
}

}  // namespace

RandomRange type_range(DType dtype) {
  if (is_float(dtype)) return {-4, 4};
  const IntRange range = dtype_range(dtype);
  return {static_cast<double>(range.min), static_cast<double>(range.max)};
}

Result<std::vector<RandomRange>> legal_ranges(const Graph& graph, const GivenRanges& given) {
  std::vector<Interval> intervals;
  std::vector<RandomRange> ranges;
  std::vector<bool> is_fixed;
  for (const ValueId id : graph.inputs) {
    const DType dtype = graph.value(id).type.dtype;
    ranges.push_back(type_range(dtype));
    is_fixed.push_back(is_float(dtype));
    intervals.push_back(is_float(dtype) ? Interval{} : of_type(dtype));
  }
  for (const auto& [name, range] : given) {
    const auto found = std::ranges::find_if(
        graph.inputs, [&, &wanted = name](ValueId id) { return graph.value(id).name == wanted; });
    if (found == graph.inputs.end())
      return bad_input("--range", "\"{}\" names no input of the network", name);
    const size_t i = static_cast<size_t>(found - graph.inputs.begin());
    const DType dtype = graph.value(*found).type.dtype;
    const auto [low, high] = range;
    const bool is_real = is_float(dtype);
    const RandomRange most = is_real ? RandomRange{-3e38, 3e38} : type_range(dtype);
    if (!(low <= high) || low < most.low || high > most.high ||
        (!is_real && (low != std::floor(low) || high != std::floor(high))))
      return bad_input("--range", "{} to {} is no range of {} for input \"{}\"", low, high,
                       dtype_info(dtype).name, name);
    ranges[i] = {low, high};
    is_fixed[i] = true;
    if (!is_real) intervals[i] = {static_cast<int64_t>(low), static_cast<int64_t>(high)};
  }
  Intervals values(graph);
  // Each round takes at least a bit from one input; a conflict that no input can mend stays.
  while (const std::optional<Conflict> conflict = values.find(intervals)) {
    bool changed = false;
    for (const auto& [input, is_direct] : sources_of(graph, conflict->operand)) {
      if (is_fixed[input]) continue;
      const Interval before = intervals[input];
      Interval after = halved(before);
      if (conflict->wanted && is_direct) {
        after = {std::max(before.low, conflict->wanted->low),
                 std::min(before.high, conflict->wanted->high)};
        if (after.low > after.high) continue;
        ranges[input].distinct = std::max(ranges[input].distinct, conflict->distinct);
      }
      changed |= after.low != before.low || after.high != before.high;
      intervals[input] = after;
    }
    if (!changed) break;
  }
  for (size_t i = 0; i < ranges.size(); ++i)
    if (!is_fixed[i]) {
      ranges[i].low = static_cast<double>(intervals[i].low);
      ranges[i].high = static_cast<double>(intervals[i].high);
    }
  return ranges;
}

Tensor random_tensor(const TensorType& type, const RandomRange& range, std::mt19937_64& generator) {
  Tensor tensor = Tensor::zeros(type);
  if (is_float(type.dtype)) {
    const double step = (range.high - range.low) / 8192;
    for (int64_t i = 0; i < tensor.count(); ++i)
      tensor.set_real(
          i, static_cast<float>(range.low + static_cast<double>(generator() % 8193) * step));
    return tensor;
  }
  const int64_t low = static_cast<int64_t>(range.low);
  const uint64_t span = static_cast<uint64_t>(static_cast<int64_t>(range.high) - low) + 1;
  // Without a value twice: the row is the beginning of a shuffle of all values.
  const int64_t row = range.distinct;
  const bool distinct = row > 0 && span >= static_cast<uint64_t>(row);
  std::vector<int64_t> deck;
  for (int64_t i = 0; i < tensor.count(); ++i) {
    if (!distinct) {
      tensor.set(i, low + static_cast<int64_t>(generator() % span));
      continue;
    }
    const size_t at = static_cast<size_t>(i % row);
    if (at == 0) {
      deck.resize(static_cast<size_t>(span));
      for (size_t k = 0; k < deck.size(); ++k) deck[k] = low + static_cast<int64_t>(k);
    }
    std::swap(deck[at], deck[at + generator() % (deck.size() - at)]);
    tensor.set(i, deck[at]);
  }
  return tensor;
}

}  // namespace shale
