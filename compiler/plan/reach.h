// compiler/plan/reach.h -- the part of a network's inputs that a part of a value is made from.
#pragma once

#include <vector>

#include "compiler/kernels/kernel.h"

namespace shale {

inline constexpr size_t kRowAxis = 1, kColumnAxis = 2;

/// Rows or columns of a value NHWC [n,h,w,c]; 1 for values of another rank.
int64_t extent_along(const Graph& graph, ValueId value, size_t axis);

/// Positions along `axis` of each graph input, in the order of Graph::inputs, from which positions `part` of the value
/// are made: at least these, all channels and images; empty where there are none. Constants reach nothing. Exact for what
/// convolutions, pools, resizes, pads and concats read; what mixes positions in another way reaches the whole axis.
std::vector<Stretch> reach(const Graph& graph, ValueId value, size_t axis, Stretch part);

}  // namespace shale
