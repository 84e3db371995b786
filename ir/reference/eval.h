// ir/reference/eval.h -- what the evaluation functions share.
#pragma once

#include <array>
#include <cstring>
#include <functional>

#include "ir/graph/graph.h"
#include "ir/reference/arith.h"

namespace shale {

/// "[0,0,1,5]": the index of an element of a row-major tensor.
std::string coordinates_text(const Shape& shape, int64_t element);

/// One legal node with its operand tensors; borrows both.
class Eval {
 public:
  Eval(const Graph& graph, NodeId id, std::span<const Tensor* const> operands)
      : graph_(graph), id_(id), operands_(operands) {}

  Op op() const { return graph_.node(id_).op; }
  const Attrs& attrs() const { return graph_.node(id_).attrs; }
  size_t operand_count() const { return operands_.size(); }
  const Tensor& in(size_t i) const { return *operands_[i]; }
  const Shape& shape(size_t i) const { return in(i).type.shape; }
  /// The single element of a zero point, shift or pad value.
  int64_t scalar(size_t i) const { return in(i).get(0); }
  const TensorType& result_type() const { return graph_.value(graph_.node(id_).output).type; }

  template <typename... Args>
  Error error(fmt::format_string<Args...> format, Args&&... args) const {
    return bad_input(node_label(graph_, id_), format, std::forward<Args>(args)...);
  }
  /// An element of the result for which TOSA gives none: `element 17 [0,0,1,5]: ...`.
  template <typename... Args>
  Error unpredictable(int64_t element, fmt::format_string<Args...> format, Args&&... args) const {
    return error("element {} {}: {}", element, coordinates_text(result_type().shape, element),
                 fmt::format(format, std::forward<Args>(args)...));
  }
  Error out_of_range(int64_t element, int64_t value) const {
    return unpredictable(element, "the result {} is outside {}", value,
                         dtype_info(result_type().dtype).wire);
  }

 private:
  const Graph& graph_;
  NodeId id_;
  std::span<const Tensor* const> operands_;
};

using EvalFunction = Result<Tensor> (*)(const Eval& node);

/// Elements to step over for one more along each axis of a row-major tensor.
Shape row_major_strides(const Shape& shape);
/// The same to read `shape` as if broadcast: 0 along axes of size 1.
Shape broadcast_strides(const Shape& shape);

/// Visits every index of `shape` in row-major order: body(element, offsets) with the offset into
/// each of N strided views, until it returns false.
template <size_t N, typename Body>
void for_each_index(const Shape& shape, const std::array<Shape, N>& strides,
                    std::array<int64_t, N> offsets, Body&& body) {
  Shape index(shape.size(), 0);
  int64_t count = 1;
  for (const int64_t dim : shape) count *= dim;
  for (int64_t element = 0; element < count; ++element) {
    if (!body(element, offsets)) return;
    for (size_t axis = shape.size(); axis-- > 0;) {
      for (size_t n = 0; n < N; ++n) offsets[n] += strides[n][axis];
      if (++index[axis] < shape[axis]) break;
      for (size_t n = 0; n < N; ++n) offsets[n] -= strides[n][axis] * shape[axis];
      index[axis] = 0;
    }
  }
}

/// A tensor seen as [outer, dim, inner] around one axis.
struct AxisView {
  int64_t outer = 1;
  int64_t dim = 1;
  int64_t inner = 1;
  AxisView(const Shape& shape, size_t axis);
};

/// Computes items begin to end - 1 in order, up to the first error.
using RangeBody = std::function<Result<void>(int64_t begin, int64_t end)>;

/// Splits 0..count-1 into contiguous ranges, one a processor, and runs the body on all at once.
/// `item_cost` is roughly the operations of an item; little work stays on one thread.
/// Returns the error of the lowest range, so the outcome does not depend on timing.
Result<void> parallel_for(int64_t count, int64_t item_cost, const RangeBody& body);

// eval_conv.cpp
Result<Tensor> eval_conv(const Eval& node);  ///< all four convolutions
Result<Tensor> eval_matmul(const Eval& node);
// eval_elementwise.cpp
Result<Tensor> eval_unary(const Eval& node);
Result<Tensor> eval_binary(const Eval& node);  ///< two operands, or three with the shift of MUL
Result<Tensor> eval_select(const Eval& node);
Result<Tensor> eval_rescale(const Eval& node);
// eval_layout.cpp
Result<Tensor> eval_argmax(const Eval& node);
Result<Tensor> eval_reduce(const Eval& node);
Result<Tensor> eval_concat(const Eval& node);
Result<Tensor> eval_pad(const Eval& node);
Result<Tensor> eval_reshape(const Eval& node);
Result<Tensor> eval_reverse(const Eval& node);
Result<Tensor> eval_slice(const Eval& node);
Result<Tensor> eval_tile(const Eval& node);
Result<Tensor> eval_transpose(const Eval& node);
Result<Tensor> eval_gather(const Eval& node);
Result<Tensor> eval_scatter(const Eval& node);
// eval_resize_pool.cpp
Result<Tensor> eval_pool(const Eval& node);
Result<Tensor> eval_resize(const Eval& node);

}  // namespace shale
