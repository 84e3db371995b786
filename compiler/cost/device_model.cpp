#include "compiler/cost/device_model.h"

#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include "compiler/cost/cost.h"
#include "compiler/plan/memory.h"

namespace shale {
namespace {

double bytes_of(const Value& value) {
  return static_cast<double>(element_count(value.type.shape).value_or(0)) *
         dtype_info(value.type.dtype).host_bytes;
}

/// By the type that the products are made of; groups without products count as INT8.
Precision precision_of(const Graph& graph, const Group& group) {
  const NodeId node = group.head.value_or(group.nodes.back());
  const DType dtype = graph.value(graph.node(node).inputs[0]).type.dtype;
  switch (dtype) {
    case DType::kInt16: return Precision::kInt16;
    case DType::kFp16:
    case DType::kBf16: return Precision::kFp16;
    case DType::kFp32: return Precision::kFp32;
    default: return Precision::kInt8;
  }
}

/// Windows of the head along rows and columns; single positions for what has none.
std::pair<TapWindow, TapWindow> windows(const Graph& graph, const Node& node) {
  const auto list = [&](Attr attr, size_t i) {
    return node.attrs.has(attr) ? node.attrs.list(attr)[i] : int64_t{1};
  };
  const auto both = [&](int64_t rows, int64_t columns) {
    return std::pair<TapWindow, TapWindow>{
        {rows, list(Attr::kStride, 0), list(Attr::kDilation, 0)},
        {columns, list(Attr::kStride, 1), list(Attr::kDilation, 1)}};
  };
  if (node.op == Op::kConv2d || node.op == Op::kDepthwiseConv2d) {
    const Shape& taps = graph.value(node.inputs[1]).type.shape;
    return node.op == Op::kConv2d ? both(taps[1], taps[2]) : both(taps[0], taps[1]);
  }
  if (node.op == Op::kAvgPool2d || node.op == Op::kMaxPool2d)
    return both(list(Attr::kKernel, 0), list(Attr::kKernel, 1));
  return {};
}

/// Values that the group reads from memory, and of them the constants.
struct Reads {
  std::set<ValueId> activations, constants;
};
Reads reads_of(const Graph& graph, const Group& group) {
  Reads reads;
  std::set<ValueId> made;
  for (const NodeId id : group.nodes) {
    for (const ValueId input : graph.node(id).inputs) {
      const Value& value = graph.value(input);
      if (value.type.dtype == DType::kShape || made.contains(input)) continue;
      (value.is_constant() ? reads.constants : reads.activations).insert(input);
    }
    made.insert(graph.node(id).output);
  }
  return reads;
}

}  // namespace

ModelledDevice with_options(const ModelledDevice& device, const ModelOptions& options) {
  ModelledDevice changed = device;
  const auto set = [](Constant& constant, double value) {
    if (value > 0) constant.value = value, constant.source = "given";
  };
  set(changed.tops, options.tops);
  set(changed.efficiency, options.efficiency);
  set(changed.memory_gbps, options.memory_gbps);
  set(changed.cache_bytes, options.cache_bytes);
  return changed;
}

double ModelledDispatch::intensity() const {
  const double operations = static_cast<double>(2 * macs + ops);
  return memory_bytes > 0 ? operations / memory_bytes : std::numeric_limits<double>::infinity();
}

ModelledNetwork model_network(const Graph& graph, const ModelledDevice& device) {
  ModelledNetwork network;
  const std::vector<Group> groups = collect_groups(graph);
  std::set<ValueId> outside(graph.inputs.begin(), graph.inputs.end());
  outside.insert(graph.outputs.begin(), graph.outputs.end());
  const auto in_memory = [&](ValueId id) {
    return outside.contains(id) || 2 * bytes_of(graph.value(id)) > device.cache_bytes.value;
  };
  std::map<ValueId, LiveInterval> live;
  for (uint32_t i = 0; i < groups.size(); ++i) {
    const Group& group = groups[i];
    const Node& shown = graph.node(group.head.value_or(group.nodes.back()));
    const Value& result = graph.value(group.result);
    const Cost cost = group_cost(graph, group);
    const Reads reads = reads_of(graph, group);
    ModelledDispatch dispatch;
    dispatch.name = result.name;
    dispatch.op = op_info(shown.op).name;
    dispatch.precision = precision_of(graph, group);
    dispatch.macs = cost.macs;
    dispatch.ops = cost.ops;

    double read_bytes = 0, constant_bytes = 0;
    for (const ValueId id : reads.activations) read_bytes += bytes_of(graph.value(id));
    for (const ValueId id : reads.constants) constant_bytes += bytes_of(graph.value(id));
    const double written = bytes_of(result);
    const Shape& made = graph.value(shown.output).type.shape;
    if (made.size() == 4) {
      const auto [rows, columns] = windows(graph, shown);
      const double positions = static_cast<double>(made[0] * made[1] * made[2]);
      const double inputs = static_cast<double>(made[0]) *
                            static_cast<double>(window_input(made[1], rows)) *
                            static_cast<double>(window_input(made[2], columns));
      dispatch.tile = choose_tile({.height = made[1],
                                   .width = made[2],
                                   .rows = rows,
                                   .columns = columns,
                                   .input_bytes = read_bytes / inputs,
                                   .output_bytes = written / positions,
                                   .fixed_bytes = constant_bytes},
                                  device.cache_bytes.value);
    }
    dispatch.bytes = read_bytes * dispatch.tile.halo + constant_bytes + written;
    dispatch.memory_bytes = constant_bytes + (in_memory(group.result) ? written : 0);
    for (const ValueId id : reads.activations)
      if (in_memory(id)) dispatch.memory_bytes += bytes_of(graph.value(id)) * dispatch.tile.halo;

    const size_t precision = static_cast<size_t>(dispatch.precision);
    const double products = static_cast<double>(cost.macs), others = static_cast<double>(cost.ops);
    dispatch.product_us =
        2e-6 * products /
        (device.tops.value * device.efficiency.value * device.rate.at(precision).value);
    dispatch.compute_us = dispatch.product_us + 1e-3 * others / device.other_gops.value;
    dispatch.memory_us = 1e-3 * dispatch.memory_bytes / device.memory_gbps.value;
    dispatch.dispatch_us = device.dispatch_us.value;
    dispatch.time_us = std::max(dispatch.compute_us, dispatch.memory_us) + dispatch.dispatch_us;
    dispatch.energy_uj =
        1e-6 * (products * device.product_pj.at(precision).value + others * device.other_pj.value +
                dispatch.memory_bytes * device.memory_pj.value +
                (dispatch.bytes - dispatch.memory_bytes) * device.cache_pj.value);

    const auto touch = [&](ValueId id) {
      if (outside.contains(id)) return;
      const uint64_t size = static_cast<uint64_t>(bytes_of(graph.value(id)));
      live.try_emplace(id, LiveInterval{i, i, size}).first->second.last = i;
    };
    for (const ValueId id : reads.activations) touch(id);
    touch(group.result);
    network.macs += dispatch.macs;
    network.time_us += dispatch.time_us;
    network.energy_uj += dispatch.energy_uj;
    network.memory_bytes += dispatch.memory_bytes;
    network.dispatches.push_back(std::move(dispatch));
  }
  std::vector<LiveInterval> intervals;
  for (const auto& [id, interval] : live) {
    intervals.push_back(interval);
    for (uint32_t i = interval.first; i <= interval.last; ++i)
      network.dispatches[i].live_bytes += interval.size_bytes;
  }
  const MemoryPlan plan = plan_memory(intervals, kBufferAlignment);
  network.arena_bytes = plan.arena_bytes;
  network.arena_lower_bound_bytes = plan.lower_bound_bytes;
  return network;
}

}  // namespace shale
