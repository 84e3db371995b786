// ir/verify/verify.h -- the rules of TOSA 1.0: which graphs are legal, and which type a node's
// result has.
#pragma once

#include "ir/graph/graph.h"

namespace shale {

/// Largest sum of host bytes of all tensors of a graph, so that sizes in a file cannot ask for more
/// memory than any machine that runs this has.
inline constexpr int64_t kMaxGraphBytes = int64_t{1} << 36;

/// Checks operands, attributes, zero points and level limits (8K) of one node by the rule of its
/// operator, and returns the type that its result must have. Operand shapes must be known (no
/// kDynamic). Constant operands whose value TOSA leaves unpredictable (a negative multiplier, a
/// shift outside its range, a gather index outside the values) are refused too. Ids must be in
/// range, and so must elements of BOOL, INT4 and INT48 constants; verify checks both.
/// Errors:
/// kBadInput or kUnsupported with the node's label in `where`.
/// Source: TOSA 1.0, chapter 2; levels,
/// section 1.7.
Result<TensorType> infer_result(const Graph& graph, NodeId id);

/// True if the operator takes a first operand of this type.
bool accepts(Op op, DType dtype);

enum class OpenSizes {
  kRefused,  ///< the first input that needs a shape is named
  kAllowed   ///< nodes with an open operand or result are not checked by their rule
};

/// Checks the whole graph: names unique, not empty and without control characters, ids in range,
/// producers before consumers, one producer a value, constants complete and in range, inputs not
/// constant, every node by its rule, declared result types equal to the inferred ones.
Result<void> verify(const Graph& graph, OpenSizes open = OpenSizes::kRefused);

}  // namespace shale
