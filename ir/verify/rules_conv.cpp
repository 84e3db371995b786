// ir/verify/rules_conv.cpp -- convolutions and matmul. Source: TOSA 1.0, tensor operators.
#include <algorithm>

#include "ir/verify/rule.h"

namespace shale {
namespace {

enum ConvOperand : size_t { kInput, kWeight, kBias, kInputZp, kWeightZp };

struct ConvTypes {
  DType input;
  DType weight;
  DType result;  ///< of the bias too, and of integer accumulators
};
constexpr std::array<ConvTypes, 8> kConvTypes{{
    {DType::kInt8, DType::kInt8, DType::kInt32},
    {DType::kInt8, DType::kInt4, DType::kInt32},
    {DType::kInt16, DType::kInt8, DType::kInt48},
    {DType::kFp8E4M3, DType::kFp8E4M3, DType::kFp16},
    {DType::kFp8E5M2, DType::kFp8E5M2, DType::kFp16},
    {DType::kFp16, DType::kFp16, DType::kFp16},
    {DType::kBf16, DType::kBf16, DType::kBf16},
    {DType::kFp32, DType::kFp32, DType::kFp32},
}};

/// What all convolutions share: types, zero points, channels, bias. Returns the element type of the
/// result.
Result<DType> conv_result_dtype(const RuleContext& node, int64_t weight_channels,
                                int64_t out_channels) {
  const auto row = std::ranges::find_if(kConvTypes, [&](const ConvTypes& types) {
    return types.input == node.dtype(kInput) && types.weight == node.dtype(kWeight);
  });
  if (row == kConvTypes.end())
    return node.bad(
        "{} and {}: expected element types i8 and i8, i8 and i4, i16 and i8, or twice the same "
        "float",
        node.describe(kInput), node.describe(kWeight));
  SHALE_TRY_VOID(node.expect_acc_type(row->input, row->result));
  if (weight_channels != node.shape(kInput).back())
    return node.bad("{} expects {} input channels, found {} in {}", node.describe(kWeight),
                    weight_channels, node.shape(kInput).back(), node.describe(kInput));
  if (node.type(kBias) != TensorType{row->result, {1}})
    SHALE_TRY_VOID(node.expect_type(kBias, {row->result, {out_channels}}));
  SHALE_TRY_VOID(node.expect_zero_point(kInputZp, row->input));
  SHALE_TRY_VOID(node.expect_zero_point(kWeightZp, row->weight));
  return row->result;
}

}  // namespace

Result<TensorType> rule_conv(const RuleContext& node) {
  const bool depthwise = node.op() == Op::kDepthwiseConv2d;
  const Shape& input = node.shape(kInput);
  const Shape& weight = node.shape(kWeight);
  SHALE_TRY_VOID(node.expect_rank(kWeight, input.size()));
  const size_t axes = input.size() - 2;
  // Weights are [oc, (kd,) kh, kw, ic], or [kh, kw, c, m] with output channel c * m_count + m.
  const size_t first_axis = depthwise ? 0 : 1;
  const int64_t out_channels = depthwise ? weight[2] * weight[3] : weight[0];
  SHALE_TRY(const DType dtype,
            conv_result_dtype(node, weight[depthwise ? 2 : axes + 1], out_channels));
  SHALE_TRY(const auto pad, node.list(Attr::kPad, 2 * axes, 0, kMaxKernel));
  SHALE_TRY(const auto stride, node.list(Attr::kStride, axes, 1, kMaxStride));
  SHALE_TRY(const auto dilation, node.list(Attr::kDilation, axes, 1, kMaxKernel));

  Shape result{input[0]};
  for (size_t i = 0; i < axes; ++i) {
    const int64_t kernel = weight[first_axis + i];
    if (dilation[i] * kernel > kMaxKernel)
      return node.beyond("dilation {} times kernel size {} is above {}, the limit of level 8K",
                         dilation[i], kernel, kMaxKernel);
    SHALE_TRY(const int64_t size, node.window_count(i + 1, input[i + 1], pad[2 * i], pad[2 * i + 1],
                                                    (kernel - 1) * dilation[i] + 1, stride[i]));
    result.push_back(size);
  }
  result.push_back(out_channels);
  return TensorType{dtype, result};
}

Result<TensorType> rule_transpose_conv2d(const RuleContext& node) {
  const Shape& input = node.shape(kInput);
  const Shape& weight = node.shape(kWeight);
  SHALE_TRY_VOID(node.expect_rank(kWeight, 4));
  SHALE_TRY(const DType dtype, conv_result_dtype(node, weight[3], weight[0]));
  SHALE_TRY(const auto out_pad, node.list(Attr::kOutPad, 4, -kMaxKernel, kMaxKernel));
  SHALE_TRY(const auto stride, node.list(Attr::kStride, 2, 1, kMaxStride));

  Shape result{input[0]};
  for (size_t i = 0; i < 2; ++i) {
    const int64_t kernel = weight[i + 1];
    if (kernel > kMaxKernel)
      return node.beyond("kernel size {} is above {}, the limit of level 8K", kernel, kMaxKernel);
    for (const int64_t pad : out_pad.subspan(2 * i, 2))
      if (pad <= -kernel)
        return node.bad("out_pad has {}, expected above {} for {}", pad, -kernel,
                        node.describe(kWeight));
    result.push_back((input[i + 1] - 1) * stride[i] + out_pad[2 * i] + out_pad[2 * i + 1] + kernel);
  }
  result.push_back(weight[0]);
  return TensorType{dtype, result};
}

Result<TensorType> rule_matmul(const RuleContext& node) {
  const Shape& a = node.shape(0);
  SHALE_TRY_VOID(node.expect_rank(1, 3));
  const int64_t columns = node.shape(1)[2];
  SHALE_TRY_VOID(node.expect_type(1, {node.dtype(0), {a[0], a[2], columns}}));
  SHALE_TRY_VOID(node.expect_zero_point(2, node.dtype(0)));
  SHALE_TRY_VOID(node.expect_zero_point(3, node.dtype(0)));
  const TensorType result{DType::kInt48, {a[0], a[1], columns}};
  switch (node.dtype(0)) {
    case DType::kInt8: return TensorType{DType::kInt32, result.shape};
    case DType::kInt16: return result;
    case DType::kFp8E4M3:
    case DType::kFp8E5M2: return TensorType{DType::kFp16, result.shape};
    case DType::kFp16:  // alone has two result types, so the declared one decides
      if (node.declared_result().dtype != DType::kFp32)
        return TensorType{DType::kFp16, result.shape};
      [[fallthrough]];
    default: return TensorType{DType::kFp32, result.shape};
  }
}

Result<TensorType> rule_fft(const RuleContext& node) {
  const Shape& input = node.shape(0);
  for (size_t axis = 1; axis < 3; ++axis) {
    if ((input[axis] & (input[axis] - 1)) != 0)
      return node.bad("{} has {} on axis {}, expected a power of two", node.describe(0),
                      input[axis], axis);
    if (input[axis] > kMaxKernel)
      return node.beyond("{} has {} on axis {}, level 8K ends at {}", node.describe(0), input[axis],
                         axis, kMaxKernel);
  }
  if (node.op() == Op::kFft2d) {
    SHALE_TRY_VOID(node.expect_type(1, node.type(0)));
    return node.type(0);
  }
  return TensorType{node.dtype(0), {input[0], input[1], input[2] / 2 + 1}};
}

}  // namespace shale
