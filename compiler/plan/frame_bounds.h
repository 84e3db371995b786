// compiler/plan/frame_bounds.h -- what the values of histories and of a network's inputs and outputs lie in after any number
// of frames, whatever the host gives.
//
// Passes promise what they write ("bounds" in frame.json), by ranges and by the bounds of what they read; networks are followed
// value by value with an interval for each channel. Both are repeated, from the zeros that histories start with, until nothing
// grows any more: the least fixed point, or the range of the type where it is far away.
#pragma once

#include <span>
#include <vector>

#include "compiler/plan/frame.h"
#include "compiler/plan/plan.h"

namespace shale {

/// Codes by channel, the last dimension: of a graph's outputs for these of its inputs, in their order. A value that an operator
/// may give is never left out; what is not followed has the range of its type.
/// Precondition: as many channels as the inputs have, or one for all.
std::vector<std::vector<IntRange>> graph_bounds(const Graph& graph,
                                                std::span<const std::vector<IntRange>> inputs);

/// Of history images, int8 inputs and outputs of the graphs, as far as they are known, in the order of the resources.
/// Errors: kBadInput, naming the pass, for a contract that names what the pass does not read, or has other channels.
Result<std::vector<ValueBounds>> frame_bounds(const Variant& variant, const Frame& frame,
                                              std::span<const PlannedGraph> graphs);

}  // namespace shale
