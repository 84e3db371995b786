#include "ir/verify/verify.h"

#include <algorithm>
#include <unordered_set>

#include "ir/base/names.h"
#include "ir/verify/rule.h"

namespace shale {
namespace {

constexpr DTypeSet kAct = kI8 | kI16, kInt = kI8 | kI16 | kI32, kActs = kAct | kFloat,
                   kSummed = kActs | kF8, kNumber = kI32 | kFloat, kNumbers = kInt | kFloat,
                   kMoved = kNumbers | kF8, kAny = kBool | kMoved;

/// In the order of ops.def. Types and ranks are those of operand 0.
constexpr auto kRules = std::to_array<OpRule>({
    {Op::kArgmax, rule_argmax, kSummed, 1, 6, {"input"}},
    {Op::kAvgPool2d, rule_pool, kSummed, 4, 4, {"input", "*input_zp", "*output_zp"}},
    {Op::kConv2d, rule_conv, kSummed, 4, 4, {"input", "weight", "bias", "*input_zp", "*weight_zp"}},
    {Op::kConv3d, rule_conv, kSummed, 5, 5, {"input", "weight", "bias", "*input_zp", "*weight_zp"}},
    {Op::kDepthwiseConv2d,
     rule_conv,
     kSummed,
     4,
     4,
     {"input", "weight", "bias", "*input_zp", "*weight_zp"}},
    {Op::kFft2d, rule_fft, kF32, 3, 3, {"input_real", "input_imag"}},
    {Op::kMatmul, rule_matmul, kSummed, 3, 3, {"a", "b", "*a_zp", "*b_zp"}},
    {Op::kMaxPool2d, rule_pool, kSummed, 4, 4, {"input"}},
    {Op::kRfft2d, rule_fft, kF32, 3, 3, {"input_real"}},
    {Op::kTransposeConv2d,
     rule_transpose_conv2d,
     kSummed,
     4,
     4,
     {"input", "weight", "bias", "*input_zp", "*weight_zp"}},
    {Op::kClamp, rule_clamp, kActs, 0, 6, {"input"}},
    {Op::kErf, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kSigmoid, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kTanh, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kAdd, rule_binary, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kArithmeticRightShift, rule_shift, kInt, 0, 6, {"input1", "input2"}},
    {Op::kBitwiseAnd, rule_binary, kInt, 0, 6, {"input1", "input2"}},
    {Op::kBitwiseOr, rule_binary, kInt, 0, 6, {"input1", "input2"}},
    {Op::kBitwiseXor, rule_binary, kInt, 0, 6, {"input1", "input2"}},
    {Op::kIntDiv, rule_intdiv, kI32, 0, 6, {"input1", "input2"}},
    {Op::kLogicalAnd, rule_binary, kBool, 0, 6, {"input1", "input2"}},
    {Op::kLogicalLeftShift, rule_shift, kInt, 0, 6, {"input1", "input2"}},
    {Op::kLogicalRightShift, rule_shift, kInt, 0, 6, {"input1", "input2"}},
    {Op::kLogicalOr, rule_binary, kBool, 0, 6, {"input1", "input2"}},
    {Op::kLogicalXor, rule_binary, kBool, 0, 6, {"input1", "input2"}},
    {Op::kMaximum, rule_binary, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kMinimum, rule_binary, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kMul, rule_mul, kNumbers, 0, 6, {"input1", "input2", "*shift"}},
    {Op::kPow, rule_binary, kFloat, 0, 6, {"input1", "input2"}},
    {Op::kSub, rule_binary, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kTable, rule_table, kAct, 0, 6, {"input", "*table"}},
    {Op::kAbs, rule_unary, kNumber, 0, 6, {"input"}},
    {Op::kBitwiseNot, rule_unary, kInt, 0, 6, {"input"}},
    {Op::kCeil, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kClz, rule_unary, kI32, 0, 6, {"input"}},
    {Op::kCos, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kExp, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kFloor, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kLog, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kLogicalNot, rule_unary, kBool, 0, 6, {"input"}},
    {Op::kNegate, rule_negate, kNumbers, 0, 6, {"input", "*input_zp", "*output_zp"}},
    {Op::kReciprocal, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kRsqrt, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kSin, rule_unary, kFloat, 0, 6, {"input"}},
    {Op::kSelect, rule_select, kBool, 0, 6, {"condition", "on_true", "on_false"}},
    {Op::kEqual, rule_compare, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kGreater, rule_compare, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kGreaterEqual, rule_compare, kNumber, 0, 6, {"input1", "input2"}},
    {Op::kReduceAll, rule_reduce, kBool, 1, 6, {"input"}},
    {Op::kReduceAny, rule_reduce, kBool, 1, 6, {"input"}},
    {Op::kReduceMax, rule_reduce, kNumbers, 1, 6, {"input"}},
    {Op::kReduceMin, rule_reduce, kNumbers, 1, 6, {"input"}},
    {Op::kReduceProduct, rule_reduce, kFloat, 1, 6, {"input"}},
    {Op::kReduceSum, rule_reduce, kNumber, 1, 6, {"input"}},
    {Op::kConcat, rule_concat, kAny, 1, 6, {"input"}},
    {Op::kPad, rule_pad, kAny, 1, 6, {"input", "*padding", "*pad_const"}},
    {Op::kReshape, rule_reshape, kAny, 0, 6, {"input", "*shape"}},
    {Op::kReverse, rule_reverse, kAny, 1, 6, {"input"}},
    {Op::kSlice, rule_slice, kAny, 1, 6, {"input", "*start", "*size"}},
    {Op::kTile, rule_tile, kAny, 1, 6, {"input", "*multiples"}},
    {Op::kTranspose, rule_transpose, kAny, 1, 6, {"input"}},
    {Op::kGather, rule_gather, kMoved, 3, 3, {"values", "indices"}},
    {Op::kScatter, rule_scatter, kMoved, 3, 3, {"values_in", "indices", "input"}},
    {Op::kResize, rule_resize, kActs, 4, 4, {"input", "*scale", "*offset", "*border"}},
    {Op::kCast, rule_cast, kAny, 0, 6, {"input"}},
    {Op::kRescale,
     rule_rescale,
     kInt | kI48,
     0,
     6,
     {"input", "*multiplier", "*shift", "*input_zp", "*output_zp"}},
    {Op::kIdentity, rule_unary, kAny | kI4 | kI48, 0, 6, {"input"}},
});

constexpr bool rows_follow_ops() {
  size_t row = 0;
#define SHALE_OP(enumerator, ...) \
  if (kRules[row++].op != Op::enumerator) return false;
#include "ir/graph/ops.def"
  return row == kRules.size();
}
static_assert(rows_follow_ops());

bool is_open(const TensorType& type) {
  return std::ranges::find(type.shape, kDynamic) != type.shape.end();
}

std::string value_label(const Graph& graph, ValueId id) {
  return fmt::format("value %{} \"{}\"", id.index, graph.value(id).name);
}

/// Elements are in range where the type does not fill its bytes: BOOL, INT4, INT48.
Result<void> check_element_range(const Tensor& tensor, const std::string& where) {
  const DTypeInfo& info = dtype_info(tensor.type.dtype);
  if (info.bits == 8 * info.host_bytes) return {};
  const IntRange range = dtype_range(tensor.type.dtype);
  for (int64_t i = 0; i < tensor.count(); ++i)
    if (const int64_t value = tensor.get(i); value < range.min || value > range.max)
      return bad_input(where, "has {} at element {}, {} is {} to {}", value, i, info.wire,
                       range.min, range.max);
  return {};
}

/// Ids are in range, so that everything after may follow them.
Result<void> check_ids(const Graph& graph, const std::string& where) {
  const auto check = [&](ValueId id, std::string_view what, size_t number) -> Result<void> {
    if (id.index < graph.values.size()) return {};
    return bad_input(where, "{} {} is value %{}, but there are {} values", what, number, id.index,
                     graph.values.size());
  };
  for (size_t i = 0; i < graph.inputs.size(); ++i)
    SHALE_TRY_VOID(check(graph.inputs[i], "input", i));
  for (size_t i = 0; i < graph.outputs.size(); ++i)
    SHALE_TRY_VOID(check(graph.outputs[i], "output", i));
  for (size_t i = 0; i < graph.nodes.size(); ++i) {
    SHALE_TRY_VOID(check(graph.nodes[i].output, "the result of node", i));
    for (const ValueId id : graph.nodes[i].inputs)
      SHALE_TRY_VOID(check(id, "an operand of node", i));
  }
  return {};
}

/// Sees each value where the graph first defines it, and each use after that.
class ValueChecker {
 public:
  ValueChecker(const Graph& graph, OpenSizes open)
      : graph_(graph), open_(open), defined_(graph.values.size()) {}

  Result<void> define(ValueId id, std::string_view as) {
    const Value& value = graph_.value(id);
    const std::string label = value_label(graph_, id);
    if (defined_[id.index]) return bad_input(label, "is defined a second time, as {}", as);
    defined_[id.index] = true;
    if (open_ == OpenSizes::kAllowed && is_open(value.type)) {
      // All but the open sizes.
      TensorType known = value.type;
      std::ranges::replace(known.shape, kDynamic, 1);
      return check_type(known, label);
    }
    SHALE_TRY_VOID(check_type(value.type, label));
    if (value.type.dtype == DType::kShape && !value.is_constant())
      return unsupported(label, "is a shape and {}, expected a constant", as);
    total_bytes_ += type_bytes(value.type);
    if (total_bytes_ > kMaxGraphBytes)
      return unsupported(label, "brings the tensors of the graph to {} bytes, the limit is {}",
                         total_bytes_, kMaxGraphBytes);
    return {};
  }

  /// Constants are defined by their first use: those that nothing uses do not matter.
  Result<void> use(ValueId id, const std::string& user) {
    const Value& value = graph_.value(id);
    if (defined_[id.index]) return {};
    if (!value.is_constant())
      return bad_input(user, "uses {}, which no input, constant or earlier node defines",
                       value_label(graph_, id));
    SHALE_TRY_VOID(define(id, "a constant"));
    SHALE_TRY_VOID(check_data(value, value_label(graph_, id)));
    return check_element_range(*value.constant, value_label(graph_, id));
  }

 private:
  const Graph& graph_;
  const OpenSizes open_;
  std::vector<bool> defined_;
  int64_t total_bytes_ = 0;
};

}  // namespace

bool accepts(Op op, DType dtype) { return contains(kRules[static_cast<size_t>(op)].types, dtype); }

Result<TensorType> infer_result(const Graph& graph, NodeId id) {
  const OpRule& rule = kRules[static_cast<size_t>(graph.node(id).op)];
  const RuleContext node(graph, id, rule);
  SHALE_TRY_VOID(node.check_operands());
  SHALE_TRY_VOID(node.check_attrs());
  SHALE_TRY(TensorType result, rule.rule(node));
  if (auto checked = check_type(result, node_label(graph, id)); !checked) {
    checked.error().message.insert(0, "the result ");
    return checked.error();
  }
  return result;
}

Result<void> verify(const Graph& graph, OpenSizes open) {
  const std::string graph_label = fmt::format("graph \"{}\"", graph.name);
  if (const std::string_view fault = name_fault(graph.name); !fault.empty())
    return bad_input("graph", "has a name with {}", fault);
  SHALE_TRY_VOID(check_ids(graph, graph_label));

  std::unordered_set<std::string_view> names;
  for (uint32_t i = 0; i < graph.values.size(); ++i) {
    const std::string& name = graph.values[i].name;
    if (name.empty()) return bad_input(value_label(graph, {i}), "has an empty name");
    if (const std::string_view fault = name_fault(name); !fault.empty())
      return bad_input(value_label(graph, {i}), "has a name with {}", fault);
    if (!names.insert(name).second)
      return bad_input(value_label(graph, {i}), "has a name that another value has");
  }

  ValueChecker values(graph, open);
  for (const ValueId id : graph.inputs) {
    const Value& value = graph.value(id);
    if (value.is_constant())
      return bad_input(value_label(graph, id), "is a graph input and a constant");
    if (open == OpenSizes::kRefused && is_open(value.type))
      return bad_input(value_label(graph, id),
                       "is {}: this input needs a shape before the graph can be used",
                       type_text(value.type));
    SHALE_TRY_VOID(values.define(id, "a graph input"));
  }
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    const std::string label = node_label(graph, {i});
    if (graph.value(node.output).is_constant()) return bad_input(label, "its result is a constant");
    for (const ValueId id : node.inputs) SHALE_TRY_VOID(values.use(id, label));
    const bool checks =
        open == OpenSizes::kRefused || (!is_open(graph.value(node.output).type) &&
                                        std::ranges::none_of(node.inputs, [&](ValueId id) {
                                          return is_open(graph.value(id).type);
                                        }));
    if (!checks) {
      SHALE_TRY_VOID(values.define(node.output, "the result of " + label));
      continue;
    }
    SHALE_TRY(const TensorType inferred, infer_result(graph, {i}));
    if (const TensorType& declared = graph.value(node.output).type; declared != inferred)
      return bad_input(label, "the result is declared as {}, expected {}", type_text(declared),
                       type_text(inferred));
    SHALE_TRY_VOID(values.define(node.output, "the result of " + label));
  }
  for (const ValueId id : graph.outputs) {
    SHALE_TRY_VOID(values.use(id, graph_label));
    if (graph.value(id).type.dtype == DType::kShape)
      return unsupported(value_label(graph, id), "is a shape and a graph output");
  }
  return {};
}

}  // namespace shale
