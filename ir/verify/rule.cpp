#include "ir/verify/rule.h"

#include <algorithm>

namespace shale {

std::string set_text(DTypeSet set) {
  std::string text;
  for (const DTypeInfo& info : kDTypes) {
    if (!contains(set, info.dtype)) continue;
    set &= ~dtype_bit(info.dtype);
    if (!text.empty()) text += set == 0 ? " or " : ", ";
    text += info.name;
  }
  return text;
}

namespace {

/// Values that a scalar attribute of this kind can have.
IntRange attr_range(Attr attr, DType operand) {
  switch (attr_info(attr).kind) {
    case AttrKind::kBool: return {0, 1};
    case AttrKind::kElement: return dtype_range(operand);
    case AttrKind::kDType: return {0, static_cast<int64_t>(kDTypes.size()) - 1};
    // Without effect on integers, so unknown is no fault there.
    case AttrKind::kNanMode: return {is_float(operand) ? kPropagateNan : 0, kIgnoreNan};
    case AttrKind::kResizeMode: return {kNearest, kBilinear};
    case AttrKind::kPart: return {0, 1};
    case AttrKind::kRoundingMode: return {kSingleRound, kDoubleRound};
    default: return dtype_range(DType::kInt32);
  }
}

}  // namespace

Result<void> check_type(const TensorType& type, const std::string& where) {
  if (type.dtype == DType::kUnknown) return bad_input(where, "has no element type");
  if (type.dtype == DType::kShape) {
    if (type.shape.size() != 1 || type.shape[0] < 0 || type.shape[0] > kMaxElements)
      return bad_input(where, "is {}, a shape value is a list", type_text(type));
    return {};
  }
  if (static_cast<int64_t>(type.shape.size()) > kMaxRank)
    return unsupported(where, "is {} of rank {}, level 8K ends at rank {}", type_text(type),
                       type.shape.size(), kMaxRank);
  if (std::ranges::find(type.shape, kDynamic) != type.shape.end())
    return bad_input(where, "is {}, all dimensions must be known", type_text(type));
  if (std::ranges::any_of(type.shape, [](int64_t dim) { return dim < 1; }))
    return bad_input(where, "is {}, dimensions must be at least 1", type_text(type));
  if (!element_count(type.shape))
    return unsupported(where, "is {}, level 8K ends at {} elements", type_text(type), kMaxElements);
  return {};
}

int64_t type_bytes(const TensorType& type) {
  const int64_t count = type.dtype == DType::kShape ? type.shape[0] : *element_count(type.shape);
  return count * dtype_info(type.dtype).host_bytes;
}

Result<void> check_data(const Value& value, const std::string& where) {
  if (!value.is_constant()) return {};
  const Tensor& tensor = *value.constant;
  if (tensor.type != value.type)
    return bad_input(where, "is {}, but its constant is {}", type_text(value.type),
                     type_text(tensor.type));
  if (static_cast<int64_t>(tensor.bytes.size()) != type_bytes(value.type))
    return bad_input(where, "has {} bytes of data, {} needs {}", tensor.bytes.size(),
                     type_text(value.type), type_bytes(value.type));
  return {};
}

std::string_view RuleContext::role(size_t i) const {
  std::string_view last;
  for (size_t at = 0; at <= i && at < rule_.operands.size(); ++at)
    if (!rule_.operands[at].empty()) last = rule_.operands[at];
  return last;
}

std::string RuleContext::describe(size_t i) const {
  std::string_view name = role(i);
  if (name.starts_with('*')) name.remove_prefix(1);
  return fmt::format("{} \"{}\" {}", name, operand(i).name, type_text(type(i)));
}

Result<void> RuleContext::check_operands() const {
  const OpInfo& info = op_info(op());
  if (operand_count() < info.min_operands || operand_count() > info.max_operands) {
    if (info.min_operands == info.max_operands)
      return bad("has {} operands, expected {}", operand_count(), info.min_operands);
    return bad("has {} operands, expected {} to {}", operand_count(), info.min_operands,
               info.max_operands);
  }
  for (size_t i = 0; i < operand_count(); ++i) {
    SHALE_TRY_VOID(check_type(type(i), node_label(graph_, id_) + ": " + describe(i)));
    SHALE_TRY_VOID(check_data(operand(i), node_label(graph_, id_) + ": " + describe(i)));
    if (role(i).starts_with('*') && !operand(i).is_constant())
      return beyond("{} is not constant, which needs the extension EXT-DYNAMIC", describe(i));
  }
  SHALE_TRY_VOID(expect_dtype(0, rule_.types));
  const size_t rank = shape(0).size();
  if (rank < rule_.min_rank || rank > rule_.max_rank) {
    if (rule_.min_rank == rule_.max_rank)
      return bad("{} has rank {}, expected {}", describe(0), rank, rule_.min_rank);
    return bad("{} has rank {}, expected {} to {}", describe(0), rank, rule_.min_rank,
               rule_.max_rank);
  }
  return {};
}

Result<void> RuleContext::check_attrs() const {
  const std::vector<Attr>& expected = op_info(op()).attrs;
  for (const AttrInfo& info : all_attrs()) {
    const bool wanted = std::ranges::find(expected, info.attr) != expected.end();
    if (wanted != attrs().has(info.attr))
      return bad("{} attribute {}", wanted ? "lacks the" : "has no use for the", info.name);
    if (!wanted || info.kind == AttrKind::kIntList) continue;
    if (attrs().list(info.attr).size() != 1)
      return bad("{} has {} values, expected 1", info.name, attrs().list(info.attr).size());
    const IntRange range = attr_range(info.attr, dtype(0));
    const int64_t value = attrs().get(info.attr);
    if (value < range.min || value > range.max)
      return bad("{} is {}, expected {} to {}", info.name, value, range.min, range.max);
  }
  return {};
}

Result<void> RuleContext::expect_dtype(size_t i, DTypeSet allowed) const {
  if (contains(allowed, dtype(i))) return {};
  return bad("{} has the wrong element type, expected {}", describe(i), set_text(allowed));
}

Result<void> RuleContext::expect_type(size_t i, const TensorType& expected) const {
  if (type(i) == expected) return {};
  return bad("{} has the wrong type, expected {}", describe(i), type_text(expected));
}

Result<void> RuleContext::expect_rank(size_t i, size_t rank) const {
  if (shape(i).size() == rank) return {};
  return bad("{} has rank {}, expected {}", describe(i), shape(i).size(), rank);
}

Result<void> RuleContext::expect_same_dtype(size_t first) const {
  for (size_t i = first + 1; i < operand_count(); ++i)
    SHALE_TRY_VOID(expect_dtype(i, dtype_bit(dtype(first))));
  return {};
}

Result<void> RuleContext::expect_zero_point(size_t i, DType of) const {
  SHALE_TRY_VOID(expect_type(i, {of, {1}}));
  const int64_t zero_point = operand(i).constant->get(0);
  if (zero_point == 0 || of == DType::kInt8) return {};
  if (is_float(of)) {
    const float real = operand(i).constant->real(0);
    if (real == 0) return {};
    return bad("{} is {}, expected 0: only int8 tensors have a zero point", describe(i), real);
  }
  return bad("{} is {}, expected 0: only int8 tensors have a zero point", describe(i), zero_point);
}

Result<void> RuleContext::expect_elements(size_t i, int64_t min, int64_t max) const {
  if (!operand(i).is_constant()) return {};
  const Tensor& tensor = *operand(i).constant;
  for (int64_t at = 0; at < tensor.count(); ++at)
    if (const int64_t value = tensor.get(at); value < min || value > max)
      return bad("{} has {} at element {}, expected {} to {}", describe(i), value, at, min, max);
  return {};
}

Result<void> RuleContext::expect_acc_type(DType of, DType integer) const {
  const DType acc_type = static_cast<DType>(attrs().get(Attr::kAccType));
  const DType expected = is_float8(of) ? DType::kFp16 : is_float(of) ? DType::kFp32 : integer;
  if (acc_type == expected || (of == DType::kFp16 && acc_type == DType::kFp16)) return {};
  return bad("acc_type is {}, expected {}{} for {}", dtype_info(acc_type).wire,
             of == DType::kFp16 ? "FP16 or " : "", dtype_info(expected).wire, describe(0));
}

Result<size_t> RuleContext::axis() const {
  const int64_t axis = attrs().get(Attr::kAxis);
  if (axis < 0 || axis >= static_cast<int64_t>(shape(0).size()))
    return bad("axis is {}, expected 0 to {} for {}", axis, shape(0).size() - 1, describe(0));
  return static_cast<size_t>(axis);
}

Result<std::span<const int64_t>> RuleContext::list(Attr attr, size_t count, int64_t min,
                                                   int64_t level) const {
  const std::span<const int64_t> values = attrs().list(attr);
  const std::string_view name = attr_info(attr).name;
  if (values.size() != count)
    return bad("{} has {} values, expected {}", name, values.size(), count);
  for (size_t i = 0; i < count; ++i) {
    if (values[i] < min || values[i] > kInt32Max)
      return bad("{} has {} at {}, expected {} to {}", name, values[i], i, min, level);
    if (values[i] > level)
      return beyond("{} has {} at {}, level 8K ends at {}", name, values[i], i, level);
  }
  return values;
}

Result<std::vector<int64_t>> RuleContext::shape_elements(size_t i, size_t count, int64_t min,
                                                         int64_t max) const {
  SHALE_TRY_VOID(expect_type(i, {DType::kShape, {static_cast<int64_t>(count)}}));
  SHALE_TRY_VOID(expect_elements(i, min, max));
  return operand(i).constant->ints();
}

Result<Shape> RuleContext::broadcast(size_t first, size_t end) const {
  Shape result = shape(first);
  for (size_t i = first + 1; i < end; ++i) {
    SHALE_TRY_VOID(expect_rank(i, result.size()));
    for (size_t axis = 0; axis < result.size(); ++axis) {
      const int64_t dim = shape(i)[axis];
      if (dim != result[axis] && dim != 1 && result[axis] != 1)
        return bad("{} does not broadcast with {}: axis {} has {} and {}", describe(i),
                   describe(first), axis, dim, result[axis]);
      result[axis] = std::max(result[axis], dim);
    }
  }
  return result;
}

Result<int64_t> RuleContext::window_count(size_t axis, int64_t extent, int64_t before,
                                          int64_t after, int64_t span, int64_t stride) const {
  const int64_t room = extent + before + after - span;
  if (room < 0)
    return bad("the window spans {} on axis {}, but {} with pad {} and {} has only {}", span, axis,
               describe(0), before, after, extent + before + after);
  if (room % stride != 0)
    return bad("stride {} does not divide {} on axis {} of {}: pad {} and {}, window {}", stride,
               room, axis, describe(0), before, after, span);
  return room / stride + 1;
}

}  // namespace shale
