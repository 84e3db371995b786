// ir/verify/rules_image.cpp -- pools and resize. Source: TOSA 1.0, tensor and image operators.
#include <algorithm>

#include "ir/verify/rule.h"

namespace shale {

Result<TensorType> rule_pool(const RuleContext& node) {
  const Shape& input = node.shape(0);
  if (node.op() == Op::kAvgPool2d) {
    SHALE_TRY_VOID(node.expect_zero_point(1, node.dtype(0)));
    SHALE_TRY_VOID(node.expect_zero_point(2, node.dtype(0)));
    SHALE_TRY_VOID(node.expect_acc_type(node.dtype(0), DType::kInt32));
  }
  SHALE_TRY(const auto kernel, node.list(Attr::kKernel, 2, 1, kMaxKernel));
  SHALE_TRY(const auto stride, node.list(Attr::kStride, 2, 1, kMaxStride));
  SHALE_TRY(const auto pad, node.list(Attr::kPad, 4, 0, kMaxKernel));

  Shape result{input[0]};
  for (size_t i = 0; i < 2; ++i) {
    // A pad below the kernel size leaves an element of the input in every window.
    if (std::max(pad[2 * i], pad[2 * i + 1]) >= kernel[i])
      return node.bad("pad {} and {} on axis {}, expected below the kernel size {}", pad[2 * i],
                      pad[2 * i + 1], i + 1, kernel[i]);
    SHALE_TRY(const int64_t size, node.window_count(i + 1, input[i + 1], pad[2 * i], pad[2 * i + 1],
                                                    kernel[i], stride[i]));
    result.push_back(size);
  }
  result.push_back(input[3]);
  return TensorType{node.dtype(0), result};
}

Result<TensorType> rule_resize(const RuleContext& node) {
  constexpr int64_t kMaxExtent = 16383, kMaxNumerator = 2048, kMaxRatio = 16;
  const Shape& input = node.shape(0);
  SHALE_TRY(const auto scale, node.shape_elements(1, 4, 1, kMaxNumerator * kMaxRatio));
  SHALE_TRY(const auto offset, node.shape_elements(2, 2, -kInt32Max, kInt32Max));
  SHALE_TRY(const auto border, node.shape_elements(3, 2, -kInt32Max, kInt32Max));

  Shape result{input[0]};
  for (size_t i = 0; i < 2; ++i) {
    const int64_t n = scale[2 * i], d = scale[2 * i + 1], extent = input[i + 1];
    if (n > kMaxNumerator)
      return node.bad("{}: numerator {} on axis {}, expected 1 to {}", node.describe(1), n, i + 1,
                      kMaxNumerator);
    if (d >= kMaxRatio * n)
      return node.bad("{}: {}/{} on axis {}, expected above 1/{}", node.describe(1), n, d, i + 1,
                      kMaxRatio);
    if (n / d > kMaxScale)
      return node.beyond("{}: {}/{} on axis {}, level 8K ends at {}", node.describe(1), n, d, i + 1,
                         kMaxScale);
    if (offset[i] < -n || offset[i] >= kMaxRatio * n)
      return node.bad("{} has {} on axis {}, expected {} to {}", node.describe(2), offset[i], i + 1,
                      -n, kMaxRatio * n - 1);
    if (border[i] < -kMaxRatio * n || border[i] >= n)
      return node.bad("{} has {} on axis {}, expected {} to {}", node.describe(3), border[i], i + 1,
                      -kMaxRatio * n, n - 1);
    if (extent > kMaxExtent)
      return node.bad("{}: axis {} has {} elements, expected at most {}", node.describe(0), i + 1,
                      extent, kMaxExtent);
    const int64_t room = (extent - 1) * n - offset[i] + border[i];
    if (room < 0 || room % d != 0)
      return node.bad("axis {}: ({} - 1) * {} - ({}) + ({}) is {}, expected a multiple of {}",
                      i + 1, extent, n, offset[i], border[i], room, d);
    if (room / d + 1 > kMaxExtent)
      return node.bad("axis {}: the result has {} elements, expected at most {}", i + 1,
                      room / d + 1, kMaxExtent);
    result.push_back(room / d + 1);
  }
  result.push_back(input[3]);
  DType dtype = node.dtype(0);
  if (node.attrs().get(Attr::kMode) == kBilinear && !is_float(dtype))
    dtype = dtype == DType::kInt8 ? DType::kInt32 : DType::kInt48;
  return TensorType{dtype, result};
}

}  // namespace shale
