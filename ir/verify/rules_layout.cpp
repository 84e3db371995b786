// ir/verify/rules_layout.cpp -- reductions, data layout, gather and scatter.
// Source: TOSA 1.0, reduction, data layout, and gather and scatter operators; ARGMAX.
#include "ir/verify/rule.h"

namespace shale {

Result<TensorType> rule_argmax(const RuleContext& node) {
  SHALE_TRY(const size_t axis, node.axis());
  Shape shape = node.shape(0);
  shape.erase(shape.begin() + static_cast<std::ptrdiff_t>(axis));
  return TensorType{DType::kInt32, std::move(shape)};
}

Result<TensorType> rule_reduce(const RuleContext& node) {
  SHALE_TRY(const size_t axis, node.axis());
  TensorType result = node.type(0);
  result.shape[axis] = 1;
  return result;
}

Result<TensorType> rule_concat(const RuleContext& node) {
  SHALE_TRY(const size_t axis, node.axis());
  SHALE_TRY_VOID(node.expect_same_dtype(0));
  TensorType result = node.type(0);
  for (size_t i = 1; i < node.operand_count(); ++i) {
    SHALE_TRY_VOID(node.expect_rank(i, result.shape.size()));
    for (size_t j = 0; j < result.shape.size(); ++j)
      if (j != axis && node.shape(i)[j] != result.shape[j])
        return node.bad("{} has {} on axis {}, expected {} as in {}", node.describe(i),
                        node.shape(i)[j], j, result.shape[j], node.describe(0));
    result.shape[axis] += node.shape(i)[axis];
  }
  return result;
}

Result<TensorType> rule_pad(const RuleContext& node) {
  TensorType result = node.type(0);
  const size_t rank = result.shape.size();
  SHALE_TRY(const auto padding, node.shape_elements(1, 2 * rank, 0, kMaxElements));
  SHALE_TRY_VOID(node.expect_type(2, {result.dtype, {1}}));
  for (size_t i = 0; i < rank; ++i) result.shape[i] += padding[2 * i] + padding[2 * i + 1];
  return result;
}

Result<TensorType> rule_reshape(const RuleContext& node) {
  SHALE_TRY_VOID(node.expect_dtype(1, dtype_bit(DType::kShape)));
  const size_t rank = static_cast<size_t>(node.shape(1)[0]);
  SHALE_TRY(Shape shape, node.shape_elements(1, rank, 1, kMaxElements));
  const int64_t found = *element_count(node.shape(0));
  if (element_count(shape) != found)
    return node.bad("{} has {} elements, which do not fill {}", node.describe(0), found,
                    shape_text(shape));
  return TensorType{node.dtype(0), std::move(shape)};
}

Result<TensorType> rule_reverse(const RuleContext& node) {
  SHALE_TRY_VOID(node.axis());
  return node.type(0);
}

Result<TensorType> rule_slice(const RuleContext& node) {
  const Shape& input = node.shape(0);
  SHALE_TRY(const auto start, node.shape_elements(1, input.size(), 0, kMaxElements));
  SHALE_TRY(Shape size, node.shape_elements(2, input.size(), 1, kMaxElements));
  for (size_t i = 0; i < input.size(); ++i)
    if (start[i] + size[i] > input[i])
      return node.bad("start {} and size {} on axis {} leave {}", start[i], size[i], i,
                      node.describe(0));
  return TensorType{node.dtype(0), std::move(size)};
}

Result<TensorType> rule_tile(const RuleContext& node) {
  TensorType result = node.type(0);
  SHALE_TRY(const auto multiples, node.shape_elements(1, result.shape.size(), 1, kMaxElements));
  for (size_t i = 0; i < multiples.size(); ++i) result.shape[i] *= multiples[i];
  return result;
}

Result<TensorType> rule_transpose(const RuleContext& node) {
  const Shape& input = node.shape(0);
  SHALE_TRY(const auto perms, node.list(Attr::kPerms, input.size(), 0, kInt32Max));
  TensorType result{node.dtype(0), {}};
  std::vector<bool> seen(input.size());
  for (const int64_t axis : perms) {
    if (axis >= static_cast<int64_t>(input.size()) || seen[static_cast<size_t>(axis)])
      return node.bad("perms has {}, expected each axis of {} once", axis, node.describe(0));
    seen[static_cast<size_t>(axis)] = true;
    result.shape.push_back(input[static_cast<size_t>(axis)]);
  }
  return result;
}

namespace {

/// indices [n,w] into values [n,k,c], in range where they are constant.
Result<void> expect_indices(const RuleContext& node) {
  SHALE_TRY_VOID(node.expect_rank(1, 2));
  SHALE_TRY_VOID(node.expect_type(1, {DType::kInt32, {node.shape(0)[0], node.shape(1)[1]}}));
  return node.expect_elements(1, 0, node.shape(0)[1] - 1);
}

}  // namespace

Result<TensorType> rule_gather(const RuleContext& node) {
  SHALE_TRY_VOID(expect_indices(node));
  const Shape& values = node.shape(0);
  return TensorType{node.dtype(0), {values[0], node.shape(1)[1], values[2]}};
}

Result<TensorType> rule_scatter(const RuleContext& node) {
  SHALE_TRY_VOID(expect_indices(node));
  const Shape& values = node.shape(0);
  const int64_t width = node.shape(1)[1];
  SHALE_TRY_VOID(node.expect_type(2, {node.dtype(0), {values[0], width, values[2]}}));
  if (width > values[1])
    return node.bad("{} has {} indices for {} rows, so one repeats", node.describe(1), width,
                    values[1]);
  if (!node.operand(1).is_constant()) return node.type(0);
  const Tensor& indices = *node.operand(1).constant;
  for (int64_t n = 0; n < values[0]; ++n) {
    std::vector<bool> seen(static_cast<size_t>(values[1]));
    for (int64_t w = 0; w < width; ++w) {
      const int64_t index = indices.get(n * width + w);
      if (seen[static_cast<size_t>(index)])
        return node.bad("{} has {} twice in batch {}", node.describe(1), index, n);
      seen[static_cast<size_t>(index)] = true;
    }
  }
  return node.type(0);
}

}  // namespace shale
