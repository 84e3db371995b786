// ir/reference/interpreter.h -- the executable meaning of every operator, in plain C++.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// Called before each node with its number and the number of nodes; returns false to stop the run.
using InterpreterProgress = std::function<bool(uint32_t node, uint32_t node_count)>;

/// Computes one node from its operand tensors, in operand order. The node must be legal
/// (infer_result). Sums of integers are exact; those of floats are described in real.h. A result that TOSA leaves unpredictable is an error that names
/// the element.
/// Errors: kBadInput with the node's label in `where`.
Result<Tensor> evaluate_node(const Graph& graph, NodeId id,
                             std::span<const Tensor* const> operands);

/// Inputs in graph order are what the graph declares.
/// Errors: kBadInput if their number or an input's type differs from the graph's (BOOL other than 0 and
/// 1, INT4 outside -7..7 and INT48 outside 48 bits included).
Result<void> check_inputs(const Graph& graph, std::span<const Tensor> inputs);

/// Runs a verified graph on inputs in graph order; returns the outputs in graph order.
/// Errors: those of check_inputs and evaluate_node.
Result<std::vector<Tensor>> interpret(const Graph& graph, std::span<const Tensor> inputs,
                                      const InterpreterProgress& progress = {});

}  // namespace shale
