// ir/verify/rule.h -- what the rule functions share: the table row, checks of operands and attrs.
#pragma once

#include <array>

#include "ir/graph/graph.h"

namespace shale {

/// A set of element types, a bit each.
using DTypeSet = uint32_t;
constexpr DTypeSet dtype_bit(DType dtype) { return DTypeSet{1} << static_cast<uint32_t>(dtype); }
inline constexpr DTypeSet kBool = dtype_bit(DType::kBool), kI4 = dtype_bit(DType::kInt4),
                          kI8 = dtype_bit(DType::kInt8), kI16 = dtype_bit(DType::kInt16),
                          kI32 = dtype_bit(DType::kInt32), kI48 = dtype_bit(DType::kInt48),
                          kF16 = dtype_bit(DType::kFp16), kF32 = dtype_bit(DType::kFp32),
                          kBF16 = dtype_bit(DType::kBf16),
                          kF8 = dtype_bit(DType::kFp8E4M3) | dtype_bit(DType::kFp8E5M2),
                          kFloat = kF16 | kBF16 | kF32;
constexpr bool contains(DTypeSet set, DType dtype) { return (set & dtype_bit(dtype)) != 0; }
/// "bool, i8 or i16".
std::string set_text(DTypeSet set);

/// Limits of level 8K beside kMaxRank and kMaxElements.
/// Source: TOSA 1.0, levels.
inline constexpr int64_t kMaxKernel = 8192, kMaxStride = 8192, kMaxScale = 256;
inline constexpr int64_t kInt32Max = dtype_range(DType::kInt32).max;

class RuleContext;
/// Checks what is special to an operator and returns the type of its result. infer_result has
/// checked before: operand count and levels, operand 0 and constants by the row, scalar attributes.
using RuleFunction = Result<TensorType> (*)(const RuleContext& node);

/// One row of the table in verify.cpp.
struct OpRule {
  Op op;
  RuleFunction rule;
  DTypeSet types;   ///< of operand 0
  size_t min_rank;  ///< of operand 0
  size_t max_rank;
  /// Operand names for messages, a leading * marks those that must be constant; the last one stands
  /// for all that follow.
  std::array<std::string_view, 5> operands;
};

/// One node as its rule sees it; borrows graph and row. Operands are counted from 0.
class RuleContext {
 public:
  RuleContext(const Graph& graph, NodeId id, const OpRule& rule)
      : graph_(graph), id_(id), rule_(rule) {}

  Op op() const { return node().op; }
  size_t operand_count() const { return node().inputs.size(); }
  const Value& operand(size_t i) const { return graph_.value(node().inputs[i]); }
  const TensorType& type(size_t i) const { return operand(i).type; }
  const Shape& shape(size_t i) const { return type(i).shape; }
  DType dtype(size_t i) const { return type(i).dtype; }
  const TensorType& declared_result() const { return graph_.value(node().output).type; }
  const Attrs& attrs() const { return node().attrs; }

  /// `weight "w0" i8[32,3,3,24]`.
  std::string describe(size_t i) const;

  template <typename... Args>
  Error bad(fmt::format_string<Args...> format, Args&&... args) const {
    return bad_input(node_label(graph_, id_), format, std::forward<Args>(args)...);
  }
  template <typename... Args>
  Error beyond(fmt::format_string<Args...> format, Args&&... args) const {
    return shale::unsupported(node_label(graph_, id_), format, std::forward<Args>(args)...);
  }

  /// What holds for all operators: operands, constants, and attributes against the tables.
  Result<void> check_operands() const;
  Result<void> check_attrs() const;

  Result<void> expect_dtype(size_t i, DTypeSet allowed) const;
  Result<void> expect_type(size_t i, const TensorType& expected) const;
  Result<void> expect_rank(size_t i, size_t rank) const;
  /// Operands first, first + 1, ... have the element type of operand `first`.
  Result<void> expect_same_dtype(size_t first) const;
  /// A single element of the type of the tensor that it belongs to, 0 unless that is int8; a float
  /// zero point may be -0.
  Result<void> expect_zero_point(size_t i, DType of) const;
  /// Elements of operand i, if it is constant, are in min..max.
  Result<void> expect_elements(size_t i, int64_t min, int64_t max) const;

  /// acc_type of a convolution or pool over operands of type `of`: INT32 for int8, INT48 for int16 in a
  /// convolution, FP16 for fp8, FP32 for other floats, FP16 too for fp16.
  Result<void> expect_acc_type(DType of, DType integer) const;

  /// Attribute axis, an axis of operand 0.
  Result<size_t> axis() const;
  /// A list attribute of `count` elements, each at least `min` and within `level`.
  Result<std::span<const int64_t>> list(Attr attr, size_t count, int64_t min, int64_t level) const;
  /// A constant shape operand of `count` elements, each in min..max.
  Result<std::vector<int64_t>> shape_elements(size_t i, size_t count, int64_t min,
                                              int64_t max) const;
  /// Operands first to end - 1 broadcast to one shape of their rank.
  Result<Shape> broadcast(size_t first, size_t end) const;
  Result<Shape> broadcast(size_t first) const { return broadcast(first, operand_count()); }
  /// Positions of a window of `span` elements on `extent` elements with pads; must come out exact.
  Result<int64_t> window_count(size_t axis, int64_t extent, int64_t before, int64_t after,
                               int64_t span, int64_t stride) const;

 private:
  const Node& node() const { return graph_.node(id_); }
  std::string_view role(size_t i) const;

  const Graph& graph_;
  NodeId id_;
  const OpRule& rule_;
};

/// Levels and element type of a tensor, or length of a shape value; `where` goes into the error.
Result<void> check_type(const TensorType& type, const std::string& where);
/// Host bytes of a type that check_type accepted.
int64_t type_bytes(const TensorType& type);
/// A constant has the type of its value, and all its bytes.
Result<void> check_data(const Value& value, const std::string& where);

// rules_conv.cpp
Result<TensorType> rule_conv(const RuleContext& node);  ///< conv2d, conv3d, depthwise_conv2d
Result<TensorType> rule_transpose_conv2d(const RuleContext& node);
Result<TensorType> rule_matmul(const RuleContext& node);
Result<TensorType> rule_fft(const RuleContext& node);  ///< fft2d, rfft2d
// rules_elementwise.cpp
Result<TensorType> rule_unary(const RuleContext& node);   ///< the result has the operand's type
Result<TensorType> rule_binary(const RuleContext& node);  ///< the result has the operands' type
Result<TensorType> rule_shift(const RuleContext& node);
Result<TensorType> rule_intdiv(const RuleContext& node);
Result<TensorType> rule_compare(const RuleContext& node);
Result<TensorType> rule_mul(const RuleContext& node);
Result<TensorType> rule_negate(const RuleContext& node);
Result<TensorType> rule_select(const RuleContext& node);
Result<TensorType> rule_clamp(const RuleContext& node);
Result<TensorType> rule_table(const RuleContext& node);
Result<TensorType> rule_cast(const RuleContext& node);
Result<TensorType> rule_rescale(const RuleContext& node);
// rules_image.cpp
Result<TensorType> rule_pool(const RuleContext& node);  ///< avg_pool2d, max_pool2d
Result<TensorType> rule_resize(const RuleContext& node);
// rules_layout.cpp
Result<TensorType> rule_argmax(const RuleContext& node);
Result<TensorType> rule_reduce(const RuleContext& node);
Result<TensorType> rule_concat(const RuleContext& node);
Result<TensorType> rule_pad(const RuleContext& node);
Result<TensorType> rule_reshape(const RuleContext& node);
Result<TensorType> rule_reverse(const RuleContext& node);
Result<TensorType> rule_slice(const RuleContext& node);
Result<TensorType> rule_tile(const RuleContext& node);
Result<TensorType> rule_transpose(const RuleContext& node);
Result<TensorType> rule_gather(const RuleContext& node);
Result<TensorType> rule_scatter(const RuleContext& node);

}  // namespace shale
