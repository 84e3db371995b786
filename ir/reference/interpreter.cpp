#include "ir/reference/interpreter.h"

#include "ir/reference/real.h"

namespace shale {
namespace {

/// A switch, so that the compiler names an operator that has no row.
EvalFunction eval_function(Op op) {
  switch (op) {
    case Op::kConv2d:
    case Op::kConv3d:
    case Op::kDepthwiseConv2d:
    case Op::kTransposeConv2d: return eval_conv;
    case Op::kMatmul: return eval_matmul;
    case Op::kAvgPool2d:
    case Op::kMaxPool2d: return eval_pool;
    case Op::kResize: return eval_resize;
    case Op::kAbs:
    case Op::kBitwiseNot:
    case Op::kCast:
    case Op::kClamp:
    case Op::kClz:
    case Op::kIdentity:
    case Op::kLogicalNot:
    case Op::kNegate:
    case Op::kTable: return eval_unary;
    case Op::kCeil:
    case Op::kCos:
    case Op::kErf:
    case Op::kExp:
    case Op::kFloor:
    case Op::kLog:
    case Op::kReciprocal:
    case Op::kRsqrt:
    case Op::kSigmoid:
    case Op::kSin:
    case Op::kTanh: return eval_real_unary;
    case Op::kPow: return eval_real_binary;
    case Op::kReduceProduct: return eval_real_terms;
    case Op::kFft2d:
    case Op::kRfft2d: return eval_real_fft;
    case Op::kAdd:
    case Op::kArithmeticRightShift:
    case Op::kBitwiseAnd:
    case Op::kBitwiseOr:
    case Op::kBitwiseXor:
    case Op::kEqual:
    case Op::kGreater:
    case Op::kGreaterEqual:
    case Op::kIntDiv:
    case Op::kLogicalAnd:
    case Op::kLogicalLeftShift:
    case Op::kLogicalOr:
    case Op::kLogicalRightShift:
    case Op::kLogicalXor:
    case Op::kMaximum:
    case Op::kMinimum:
    case Op::kMul:
    case Op::kSub: return eval_binary;
    case Op::kSelect: return eval_select;
    case Op::kRescale: return eval_rescale;
    case Op::kArgmax: return eval_argmax;
    case Op::kReduceAll:
    case Op::kReduceAny:
    case Op::kReduceMax:
    case Op::kReduceMin:
    case Op::kReduceSum: return eval_reduce;
    case Op::kConcat: return eval_concat;
    case Op::kPad: return eval_pad;
    case Op::kReshape: return eval_reshape;
    case Op::kReverse: return eval_reverse;
    case Op::kSlice: return eval_slice;
    case Op::kTile: return eval_tile;
    case Op::kTranspose: return eval_transpose;
    case Op::kGather: return eval_gather;
    case Op::kScatter: return eval_scatter;
  }
  check_failed("every operator has an evaluation function", __FILE__, __LINE__);
}

/// For nodes with a float operand or result; null for those that only move elements about.
EvalFunction real_evaluation(const Node& node) {
  switch (node.op) {
    case Op::kConv2d:
    case Op::kConv3d:
    case Op::kDepthwiseConv2d:
    case Op::kTransposeConv2d:
    case Op::kMatmul: return eval_real_sums;
    case Op::kAvgPool2d:
    case Op::kMaxPool2d:
    case Op::kReduceMax:
    case Op::kReduceMin:
    case Op::kReduceSum: return eval_real_terms;
    case Op::kResize: return node.attrs.get(Attr::kMode) == kBilinear ? eval_real_terms : nullptr;
    case Op::kArgmax: return eval_real_argmax;
    case Op::kAbs:
    case Op::kCast:
    case Op::kClamp:
    case Op::kNegate: return eval_real_unary;
    case Op::kAdd:
    case Op::kEqual:
    case Op::kGreater:
    case Op::kGreaterEqual:
    case Op::kMaximum:
    case Op::kMinimum:
    case Op::kMul:
    case Op::kSub: return eval_real_binary;
    default: return nullptr;
  }
}

Result<void> check_input(const Value& value, const Tensor& tensor) {
  const std::string where = fmt::format("input \"{}\"", value.name);
  if (tensor.type != value.type)
    return bad_input(where, "is {}, expected {}", type_text(tensor.type), type_text(value.type));
  const int64_t bytes = *element_count(value.type.shape) * tensor.host_bytes();
  if (static_cast<int64_t>(tensor.bytes.size()) != bytes)
    return bad_input(where, "has {} bytes, expected {}", tensor.bytes.size(), bytes);
  const DTypeInfo& info = dtype_info(value.type.dtype);
  if (info.bits == 8 * info.host_bytes) return {};  // the type fills its bytes
  const IntRange range = dtype_range(value.type.dtype);
  for (int64_t i = 0; i < tensor.count(); ++i)
    if (!in_range(tensor.get(i), range))
      return bad_input(where, "has {} at {}, {} is {} to {}", tensor.get(i),
                       coordinates_text(value.type.shape, i), info.wire, range.min, range.max);
  return {};
}

}  // namespace

Result<Tensor> evaluate_node(const Graph& graph, NodeId id,
                             std::span<const Tensor* const> operands) {
  const Node& node = graph.node(id);
  SHALE_CHECK(operands.size() == node.inputs.size());
  EvalFunction function = nullptr;
  if (is_float(operands[0]->type.dtype) || is_float(graph.value(node.output).type.dtype))
    function = real_evaluation(node);
  return (function ? function : eval_function(node.op))(Eval(graph, id, operands));
}

Result<void> check_inputs(const Graph& graph, std::span<const Tensor> inputs) {
  if (inputs.size() != graph.inputs.size())
    return bad_input(fmt::format("graph \"{}\"", graph.name), "got {} inputs, expected {}",
                     inputs.size(), graph.inputs.size());
  for (size_t i = 0; i < inputs.size(); ++i)
    SHALE_TRY_VOID(check_input(graph.value(graph.inputs[i]), inputs[i]));
  return {};
}

Result<std::vector<Tensor>> interpret(const Graph& graph, std::span<const Tensor> inputs,
                                      const InterpreterProgress& progress) {
  SHALE_TRY_VOID(check_inputs(graph, inputs));
  std::vector<const Tensor*> tensors(graph.values.size());
  for (size_t i = 0; i < graph.values.size(); ++i)
    if (graph.values[i].is_constant()) tensors[i] = &*graph.values[i].constant;
  for (size_t i = 0; i < inputs.size(); ++i) tensors[graph.inputs[i].index] = &inputs[i];

  // Results live until their last use, so a deep network of whole frames fits in memory.
  std::vector<Tensor> results(graph.values.size());
  std::vector<uint32_t> uses = graph.use_counts();
  const auto release = [&](ValueId id) {
    if (--uses[id.index] == 0) results[id.index] = Tensor{};
  };
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    if (progress && !progress(i, static_cast<uint32_t>(graph.nodes.size())))
      return bad_input(node_label(graph, {i}), "the run was stopped before this node");
    std::vector<const Tensor*> operands;
    for (const ValueId id : node.inputs) operands.push_back(tensors[id.index]);
    SHALE_TRY(results[node.output.index], evaluate_node(graph, {i}, operands));
    tensors[node.output.index] = &results[node.output.index];
    ++uses[node.output.index];  // released at once, so that a result without users goes too
    release(node.output);
    for (const ValueId id : node.inputs) release(id);
  }

  std::vector<Tensor> outputs;
  for (const ValueId id : graph.outputs) outputs.push_back(*tensors[id.index]);
  return outputs;
}

}  // namespace shale
