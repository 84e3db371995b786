// compiler/cost/cost.h -- what a network costs: parameters, MACs, bytes, and a verdict against a
// budget.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "compiler/passes/op_kind.h"
#include "ir/package/package.h"

namespace shale {

/// Multiply-accumulates of one node: taps that fall on padding are counted, as accelerators do.
uint64_t node_macs(const Graph& graph, const Node& node);

/// Integer operations of one node that are no MAC: one per result element of an elementwise
/// operator.
uint64_t node_ops(const Graph& graph, const Node& node);

/// MACs, operations and bytes of a dispatch; time is left 0. Constants that become literals cost
/// nothing.
Cost group_cost(const Graph& graph, const Group& group);

/// Elements of weights and biases of convolutions and MATMUL, a constant of several nodes once;
/// multipliers, shifts, tables and zero points are no parameters, nor is a bias of a single zero.
uint64_t parameter_count(const Graph& graph);

/// Figures of one operator kind or of the whole graph.
struct OpCost {
  uint64_t nodes = 0, parameters = 0, macs = 0, ops = 0, bytes_read = 0, bytes_written = 0;
};
/// Per operator name, each node as a dispatch of its own.
std::map<std::string, OpCost> cost_by_operator(const Graph& graph);

/// Counter operations of SRPO's table 1 ("counter_A"): a convolution counts its MACs and one per
/// output for its bias, ReLU one per output, an upsampling layer one per output, a transposed
/// convolution is charged per output position, pooling one per input; everything else is free.
/// Every CLAMP is taken for a ReLU; one that an exporter folded into the zero point of a RESCALE
/// leaves no trace and is not counted.
/// Source: tests/golden/cost_tables.json, conventions.counter_A.
uint64_t counter_operations(const Graph& graph);

/// The frame budget: passes and network together.
struct Budget {
  double frame_ms = 4.0;
  double passes_ms = 1.4;
  double tops = 10.0;       ///< peak of the device, 1e12 operations a second, 2 per MAC
  double efficiency = 0.5;  ///< share of the peak that the network is assumed to reach
};

struct Verdict {
  double network_ms = 0;     ///< at the assumed efficiency
  double available_gop = 0;  ///< at full efficiency; below 0 if the passes alone exceed the frame
  double required_efficiency =
      0;  ///< above 1: does not fit whatever the efficiency; infinite if no time is left
  double required_tops = 0;  ///< at the assumed efficiency; infinite if no time is left
  double headroom_ms = 0;    ///< negative if it does not fit
  bool fits = false;
};

/// `tops` and `efficiency` must be above 0.
Verdict judge(uint64_t macs, const Budget& budget);

}  // namespace shale
