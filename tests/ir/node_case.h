// tests/ir/node_case.h -- graphs of one node, written as a row.
#pragma once

#include "ir/graph/graph.h"

namespace shale {

/// An input of the graph, or a constant if it has data.
struct Operand {
  TensorType type;
  std::optional<std::vector<int64_t>> data;
};

inline Operand input(DType dtype, Shape shape) { return {{dtype, std::move(shape)}, std::nullopt}; }
inline Operand constant(DType dtype, Shape shape, std::vector<int64_t> data) {
  return {{dtype, std::move(shape)}, std::move(data)};
}
/// A list [n].
inline Operand constant(DType dtype, std::vector<int64_t> data) {
  const Shape shape{static_cast<int64_t>(data.size())};
  return constant(dtype, shape, std::move(data));
}
inline Operand dims(std::vector<int64_t> data) { return constant(DType::kShape, std::move(data)); }

struct NodeCase {
  std::string name;
  Op op;
  Attrs attrs;
  std::vector<Operand> operands;  ///< named x0, x1, ... in the graph
  TensorType result;              ///< named y

  Graph graph() const {
    Graph built;
    std::vector<ValueId> ids;
    for (size_t i = 0; i < operands.size(); ++i) {
      const auto& [type, data] = operands[i];
      const std::string value_name = "x" + std::to_string(i);
      ids.push_back(data ? built.add_constant(value_name, Tensor::from_ints(type, *data))
                         : built.add_input(value_name, type));
    }
    built.outputs = {built.add_node(op, attrs, ids, "y", result)};
    return built;
  }
};

using Ints = std::vector<int64_t>;

inline Attrs conv_attrs(Ints pad, Ints stride, Ints dilation, DType acc_type = DType::kInt32) {
  return Attrs()
      .set(Attr::kPad, std::move(pad))
      .set(Attr::kStride, std::move(stride))
      .set(Attr::kDilation, std::move(dilation))
      .set(Attr::kLocalBound, 0)
      .set(Attr::kAccType, static_cast<int64_t>(acc_type));
}

inline Attrs transpose_conv_attrs(Ints out_pad, Ints stride) {
  return Attrs()
      .set(Attr::kOutPad, std::move(out_pad))
      .set(Attr::kStride, std::move(stride))
      .set(Attr::kLocalBound, 0)
      .set(Attr::kAccType, static_cast<int64_t>(DType::kInt32));
}

inline Attrs max_pool_attrs(Ints kernel, Ints stride, Ints pad) {
  return Attrs()
      .set(Attr::kKernel, std::move(kernel))
      .set(Attr::kStride, std::move(stride))
      .set(Attr::kPad, std::move(pad))
      .set(Attr::kNanMode, 1);
}

inline Attrs avg_pool_attrs(Ints kernel, Ints stride, Ints pad) {
  return Attrs()
      .set(Attr::kKernel, std::move(kernel))
      .set(Attr::kStride, std::move(stride))
      .set(Attr::kPad, std::move(pad))
      .set(Attr::kAccType, static_cast<int64_t>(DType::kInt32));
}

inline Attrs axis_attrs(int64_t axis) { return Attrs().set(Attr::kAxis, axis); }
inline Attrs nan_attrs(Attrs attrs = {}) { return attrs.set(Attr::kNanMode, 1); }
inline Attrs clamp_attrs(int64_t min, int64_t max) {
  return nan_attrs(Attrs().set(Attr::kMinVal, min).set(Attr::kMaxVal, max));
}

struct RescaleAttrs {
  bool scale32 = true;
  int64_t rounding_mode = kSingleRound;
  bool per_channel = false;
  bool input_unsigned = false;
  bool output_unsigned = false;

  operator Attrs() const {
    return Attrs()
        .set(Attr::kScale32, scale32)
        .set(Attr::kRoundingMode, rounding_mode)
        .set(Attr::kPerChannel, per_channel)
        .set(Attr::kInputUnsigned, input_unsigned)
        .set(Attr::kOutputUnsigned, output_unsigned);
  }
};

}  // namespace shale
