#include "ir/verify/verify.h"

#include <gtest/gtest.h>

#include <functional>
#include <set>

#include "tests/ir/node_case.h"

namespace shale {
namespace {

constexpr DType kBool = DType::kBool, kI4 = DType::kInt4, kI8 = DType::kInt8, kI16 = DType::kInt16,
                kI32 = DType::kInt32, kI48 = DType::kInt48;
const Operand kZero8 = constant(kI8, {0}), kZero16 = constant(kI16, {0}),
              kZero32 = constant(kI32, {0});

NodeCase binary(Op op, DType type, DType result) {
  return {std::string(op_info(op).name),
          op,
          {},
          {input(type, {2, 1, 3}), input(type, {1, 4, 3})},
          {result, {2, 4, 3}}};
}

NodeCase unary(Op op, DType type, Attrs attrs = {}) {
  return {
      std::string(op_info(op).name), op, std::move(attrs), {input(type, {2, 3})}, {type, {2, 3}}};
}

NodeCase reduce(Op op, DType type, Attrs attrs) {
  return {std::string(op_info(op).name),
          op,
          std::move(attrs),
          {input(type, {2, 3, 4})},
          {type, {2, 1, 4}}};
}

/// At least one legal node of every operator.
std::vector<NodeCase> legal_cases() {
  const Attrs plain = conv_attrs({1, 1, 1, 1}, {1, 1}, {1, 1});
  const Operand image = input(kI8, {1, 8, 6, 3});
  std::vector<NodeCase> cases{
      {"argmax", Op::kArgmax, nan_attrs(axis_attrs(1)), {input(kI8, {2, 3, 4})}, {kI32, {2, 4}}},
      {"argmax_to_scalar", Op::kArgmax, nan_attrs(axis_attrs(0)), {input(kI16, {5})}, {kI32, {}}},
      unary(Op::kSigmoid, DType::kFp16),
      unary(Op::kErf, DType::kFp32),
      unary(Op::kTanh, DType::kBf16),
      unary(Op::kCeil, DType::kFp32),
      unary(Op::kCos, DType::kFp16),
      unary(Op::kExp, DType::kBf16),
      unary(Op::kFloor, DType::kFp32),
      unary(Op::kLog, DType::kFp16),
      unary(Op::kReciprocal, DType::kFp32),
      unary(Op::kRsqrt, DType::kFp16),
      unary(Op::kSin, DType::kFp32),
      binary(Op::kPow, DType::kFp32, DType::kFp32),
      reduce(Op::kReduceProduct, DType::kFp32, axis_attrs(1)),
      {"fft2d",
       Op::kFft2d,
       Attrs().set(Attr::kInverse, 0).set(Attr::kLocalBound, 0).set(Attr::kPart, 1),
       {input(DType::kFp32, {2, 8, 4}), input(DType::kFp32, {2, 8, 4})},
       {DType::kFp32, {2, 8, 4}}},
      {"rfft2d",
       Op::kRfft2d,
       Attrs().set(Attr::kLocalBound, 0).set(Attr::kPart, 0),
       {input(DType::kFp32, {2, 8, 4})},
       {DType::kFp32, {2, 8, 3}}},
      {"avg_pool2d",
       Op::kAvgPool2d,
       avg_pool_attrs({3, 2}, {1, 2}, {1, 1, 0, 0}),
       {image, constant(kI8, {-128}), constant(kI8, {127})},
       {kI8, {1, 8, 3, 3}}},
      {"max_pool2d",
       Op::kMaxPool2d,
       max_pool_attrs({2, 2}, {2, 2}, {0, 0, 0, 0}),
       {image},
       {kI8, {1, 4, 3, 3}}},
      {"conv2d",
       Op::kConv2d,
       plain,
       {image, input(kI8, {5, 3, 3, 3}), input(kI32, {5}), constant(kI8, {-128}),
        constant(kI8, {127})},
       {kI32, {1, 8, 6, 5}}},
      {"conv2d_stride_dilation",
       Op::kConv2d,
       conv_attrs({0, 1, 0, 0}, {2, 1}, {2, 1}),
       {image, input(kI8, {5, 3, 1, 3}), input(kI32, {1}), kZero8, kZero8},
       {kI32, {1, 3, 6, 5}}},
      {"conv2d_i4",
       Op::kConv2d,
       plain,
       {image, input(kI4, {5, 3, 3, 3}), input(kI32, {1}), kZero8, constant(kI4, {0})},
       {kI32, {1, 8, 6, 5}}},
      {"conv2d_i16",
       Op::kConv2d,
       conv_attrs({1, 1, 1, 1}, {1, 1}, {1, 1}, kI48),
       {input(kI16, {1, 8, 6, 3}), input(kI8, {5, 3, 3, 3}), input(kI48, {1}), kZero16,
        constant(kI8, {3})},
       {kI48, {1, 8, 6, 5}}},
      {"conv3d",
       Op::kConv3d,
       conv_attrs({0, 0, 1, 1, 1, 1}, {1, 1, 1}, {1, 1, 1}),
       {input(kI8, {1, 4, 8, 6, 3}), input(kI8, {5, 2, 3, 3, 3}), input(kI32, {5}), kZero8, kZero8},
       {kI32, {1, 3, 8, 6, 5}}},
      {"depthwise_conv2d",
       Op::kDepthwiseConv2d,
       plain,
       {image, input(kI8, {3, 3, 3, 2}), input(kI32, {6}), kZero8, kZero8},
       {kI32, {1, 8, 6, 6}}},
      {"transpose_conv2d",
       Op::kTransposeConv2d,
       transpose_conv_attrs({-1, 0, 0, 2}, {2, 2}),
       {image, input(kI8, {5, 2, 2, 3}), input(kI32, {5}), kZero8, kZero8},
       {kI32, {1, 15, 14, 5}}},
      {"matmul",
       Op::kMatmul,
       {},
       {input(kI8, {2, 3, 4}), input(kI8, {2, 4, 5}), kZero8, kZero8},
       {kI32, {2, 3, 5}}},
      {"matmul_i16",
       Op::kMatmul,
       {},
       {input(kI16, {2, 3, 4}), input(kI16, {2, 4, 5}), kZero16, kZero16},
       {kI48, {2, 3, 5}}},
      {"clamp_i8", Op::kClamp, clamp_attrs(-128, 127), {image}, image.type},
      {"clamp_one_value", Op::kClamp, clamp_attrs(-32768, -32768), {input(kI16, {})}, {kI16, {}}},
      {"table_i8", Op::kTable, {}, {image, constant(kI8, Ints(256, 1))}, image.type},
      {"table_i16", Op::kTable, {}, {input(kI16, {4}), constant(kI16, Ints(513, 1))}, {kI32, {4}}},
      {"mul_i8", Op::kMul, {}, {image, input(kI8, {1, 1, 1, 3}), kZero8}, {kI32, {1, 8, 6, 3}}},
      {"mul_i32",
       Op::kMul,
       {},
       {input(kI32, {2}), input(kI32, {1}), constant(kI8, {63})},
       {kI32, {2}}},
      {"shift_by_constant",
       Op::kArithmeticRightShift,
       Attrs().set(Attr::kRound, 1),
       {input(kI8, {2}), constant(kI8, {0, 7})},
       {kI8, {2}}},
      {"divide_by_constant",
       Op::kIntDiv,
       {},
       {input(kI32, {2}), constant(kI32, {-1, 7})},
       {kI32, {2}}},
      {"negate_i8",
       Op::kNegate,
       {},
       {image, constant(kI8, {-128}), constant(kI8, {127})},
       image.type},
      {"negate_i32", Op::kNegate, {}, {input(kI32, {}), kZero32, kZero32}, {kI32, {}}},
      {"select",
       Op::kSelect,
       {},
       {input(kBool, {2, 1, 1}), input(kI16, {1, 3, 1}), input(kI16, {1, 1, 4})},
       {kI16, {2, 3, 4}}},
      {"select_bool",
       Op::kSelect,
       {},
       {input(kBool, {}), input(kBool, {}), input(kBool, {})},
       {kBool, {}}},
      {"concat",
       Op::kConcat,
       axis_attrs(1),
       {input(kI8, {2, 3}), input(kI8, {2, 1}), input(kI8, {2, 4})},
       {kI8, {2, 8}}},
      {"pad",
       Op::kPad,
       {},
       {input(kI8, {2, 3}), dims({1, 0, 0, 2}), constant(kI8, {-7})},
       {kI8, {3, 5}}},
      {"reshape", Op::kReshape, {}, {input(kBool, {2, 3}), dims({3, 1, 2})}, {kBool, {3, 1, 2}}},
      {"reshape_to_scalar", Op::kReshape, {}, {input(kI8, {1, 1}), dims({})}, {kI8, {}}},
      {"reshape_of_scalar", Op::kReshape, {}, {input(kI8, {}), dims({1})}, {kI8, {1}}},
      {"reverse", Op::kReverse, axis_attrs(0), {image}, image.type},
      {"slice", Op::kSlice, {}, {input(kI8, {4, 5}), dims({1, 0}), dims({3, 5})}, {kI8, {3, 5}}},
      {"tile", Op::kTile, {}, {input(kI8, {4, 5}), dims({1, 3})}, {kI8, {4, 15}}},
      {"transpose",
       Op::kTranspose,
       Attrs().set(Attr::kPerms, Ints{2, 0, 1}),
       {input(kI8, {4, 5, 6})},
       {kI8, {6, 4, 5}}},
      {"gather", Op::kGather, {}, {input(kI8, {2, 3, 4}), input(kI32, {2, 5})}, {kI8, {2, 5, 4}}},
      {"gather_constant",
       Op::kGather,
       {},
       {input(kI8, {2, 3, 4}), constant(kI32, {2, 2}, {0, 2, 2, 2})},
       {kI8, {2, 2, 4}}},
      {"scatter",
       Op::kScatter,
       {},
       {input(kI8, {2, 3, 4}), constant(kI32, {2, 2}, {0, 2, 2, 0}), input(kI8, {2, 2, 4})},
       {kI8, {2, 3, 4}}},
      {"resize_nearest",
       Op::kResize,
       Attrs().set(Attr::kMode, kNearest),
       {image, dims({2, 1, 3, 1}), dims({0, 0}), dims({1, 2})},
       {kI8, {1, 16, 18, 3}}},
      {"resize_bilinear",
       Op::kResize,
       Attrs().set(Attr::kMode, kBilinear),
       {image, dims({4, 2, 4, 2}), dims({-1, -1}), dims({1, 1})},
       {kI32, {1, 16, 12, 3}}},
      {"resize_bilinear_i16",
       Op::kResize,
       Attrs().set(Attr::kMode, kBilinear),
       {input(kI16, {1, 1, 1, 1}), dims({1, 1, 1, 1}), dims({0, 0}), dims({0, 0})},
       {kI48, {1, 1, 1, 1}}},
      {"rescale",
       Op::kRescale,
       RescaleAttrs{.per_channel = true},
       {input(kI32, {2, 3}), constant(kI32, {0, 1, INT32_MAX}), constant(kI8, {2, 62, 30}), kZero32,
        constant(kI8, {-128})},
       {kI8, {2, 3}}},
      {"rescale_i48",
       Op::kRescale,
       RescaleAttrs{.scale32 = false},
       {input(kI48, {2, 3}), constant(kI16, {32767}), constant(kI8, {20}), constant(kI48, {0}),
        kZero16},
       {kI16, {2, 3}}},
      {"rescale_unsigned_i16",
       Op::kRescale,
       RescaleAttrs{.input_unsigned = true},
       {input(kI16, {2, 3}), constant(kI32, {1}), constant(kI8, {20}), constant(kI16, {-32768}),
        constant(kI8, {9})},
       {kI8, {2, 3}}},
      {"identity_i4", Op::kIdentity, {}, {input(kI4, {3})}, {kI4, {3}}},
      {"identity_i48", Op::kIdentity, {}, {input(kI48, {})}, {kI48, {}}},
      unary(Op::kAbs, kI32),
      unary(Op::kBitwiseNot, kI16),
      unary(Op::kClz, kI32),
      unary(Op::kLogicalNot, kBool),
      reduce(Op::kReduceAll, kBool, axis_attrs(1)),
      reduce(Op::kReduceAny, kBool, axis_attrs(1)),
      reduce(Op::kReduceMax, kI8, nan_attrs(axis_attrs(1))),
      reduce(Op::kReduceMin, kI16, nan_attrs(axis_attrs(1))),
      reduce(Op::kReduceSum, kI32, axis_attrs(1)),
  };
  for (const Op op : {Op::kAdd, Op::kSub, Op::kIntDiv}) cases.push_back(binary(op, kI32, kI32));
  for (const Op op : {Op::kMaximum, Op::kMinimum}) {
    cases.push_back(binary(op, kI32, kI32));
    cases.back().attrs = nan_attrs();
  }
  for (const Op op : {Op::kBitwiseAnd, Op::kBitwiseOr, Op::kBitwiseXor, Op::kLogicalLeftShift,
                      Op::kLogicalRightShift})
    cases.push_back(binary(op, kI16, kI16));
  for (const Op op : {Op::kLogicalAnd, Op::kLogicalOr, Op::kLogicalXor})
    cases.push_back(binary(op, kBool, kBool));
  for (const Op op : {Op::kEqual, Op::kGreater, Op::kGreaterEqual})
    cases.push_back(binary(op, kI32, kBool));
  const std::vector<DType> castable{kBool, kI8, kI16, kI32};
  for (const DType from : castable)
    for (const DType to : castable)
      if (from != to) cases.push_back({"cast", Op::kCast, {}, {input(from, {2})}, {to, {2}}});
  return cases;
}

NodeCase legal_case(const std::string& name) {
  for (NodeCase& node : legal_cases())
    if (node.name == name) return node;
  ADD_FAILURE() << "no legal case " << name;
  return {};
}

/// The message of the error, or "accepted".
std::string outcome(const Result<void>& result) {
  return result ? "accepted" : result.error().text();
}

TEST(Verify, AcceptsLegalNodesOfEveryOperator) {
  std::set<Op> seen;
  for (const NodeCase& node : legal_cases()) {
    const Graph graph = node.graph();
    const auto inferred = infer_result(graph, {0});
    ASSERT_TRUE(inferred) << node.name << ": " << inferred.error().text();
    EXPECT_EQ(type_text(*inferred), type_text(node.result)) << node.name;
    EXPECT_EQ(outcome(verify(graph)), "accepted") << node.name;
    seen.insert(node.op);
  }
  for (const OpInfo& info : all_ops()) EXPECT_TRUE(seen.contains(info.op)) << info.name;
}

TEST(Verify, RefusesAnotherResultTypeThanTheInferred) {
  for (NodeCase node : legal_cases()) {
    node.result.shape.push_back(1);
    EXPECT_NE(outcome(verify(node.graph())).find("the result is declared as"), std::string::npos)
        << node.name;
  }
}

TEST(Verify, RefusesEveryOperatorWithoutOneOfItsAttributes) {
  for (const NodeCase& node : legal_cases())
    for (const Attr missing : op_info(node.op).attrs) {
      NodeCase changed = node;
      changed.attrs = {};
      for (const Attr attr : op_info(node.op).attrs) {
        const auto values = node.attrs.list(attr);
        if (attr != missing) changed.attrs.set(attr, Ints(values.begin(), values.end()));
      }
      EXPECT_NE(outcome(verify(changed.graph())).find("lacks the attribute"), std::string::npos)
          << node.name << " " << attr_info(missing).name;
    }
}

TEST(Verify, RefusesAttributesWithTooManyOrTooFewValues) {
  for (const NodeCase& node : legal_cases())
    for (const Attr attr : op_info(node.op).attrs)
      for (const int change : {-1, 1}) {
        NodeCase changed = node;
        const auto values = node.attrs.list(attr);
        Ints resized(values.begin(), values.end());
        resized.resize(static_cast<size_t>(static_cast<int>(resized.size()) + change), 1);
        changed.attrs.set(attr, resized);
        EXPECT_NE(outcome(verify(changed.graph())).find(" values, expected "), std::string::npos)
            << node.name << " " << attr_info(attr).name;
      }
}

TEST(Verify, RefusesOperandsThatMustBeConstantAndAreNot) {
  // Constants in these legal cases that may as well vary at run time.
  const std::set<std::string> free_to_vary{"shift_by_constant", "divide_by_constant",
                                           "gather_constant", "scatter"};
  for (const NodeCase& node : legal_cases())
    for (size_t i = 0; i < node.operands.size(); ++i) {
      if (!node.operands[i].data || free_to_vary.contains(node.name)) continue;
      NodeCase changed = node;
      changed.operands[i].data = std::nullopt;
      const auto inferred = infer_result(changed.graph(), {0});
      ASSERT_FALSE(inferred) << node.name << " operand " << i;
      EXPECT_EQ(inferred.error().code, ErrorCode::kUnsupported) << node.name;
      EXPECT_NE(inferred.error().message.find("EXT-DYNAMIC"), std::string::npos) << node.name;
    }
}

TEST(Verify, RefusesWrongOperandCounts) {
  for (const NodeCase& node : legal_cases()) {
    NodeCase changed = node;
    changed.operands.resize(op_info(node.op).max_operands + 1, node.operands.back());
    EXPECT_NE(outcome(verify(changed.graph())).find(" operands, expected "), std::string::npos)
        << node.name;
    changed.operands.clear();
    EXPECT_NE(outcome(verify(changed.graph())).find("has 0 operands"), std::string::npos)
        << node.name;
  }
}

struct Refusal {
  std::string legal;  ///< name of the case that is changed
  std::function<void(NodeCase&)> change;
  std::string message;  ///< part of it
};

/// Operand i gets another type, and zeroes if it was constant.
auto type(size_t i, DType dtype, Shape shape) {
  return [=](NodeCase& node) {
    Operand& operand = node.operands[i];
    operand.type = {dtype, shape};
    if (operand.data) operand.data->assign(static_cast<size_t>(*element_count(shape)), 0);
  };
}
auto data(size_t i, Ints values) {
  return [=](NodeCase& node) { node.operands[i].data = values; };
}
auto operand(size_t i, Operand replacement) {
  return [=](NodeCase& node) { node.operands[i] = replacement; };
}
auto attr(Attr name, Ints values) {
  return [=](NodeCase& node) { node.attrs.set(name, values); };
}

std::vector<Refusal> refusals() {
  const int64_t huge = INT64_MAX;
  return {
      {"argmax", attr(Attr::kAxis, {3}), "axis is 3, expected 0 to 2"},
      {"argmax", attr(Attr::kAxis, {-1}), "axis is -1"},
      {"argmax", attr(Attr::kAxis, {huge}), "axis is 9223372036854775807"},
      {"argmax", attr(Attr::kNanMode, {3}), "nan_mode is 3, expected 0 to 2"},
      {"argmax", type(0, kI32, {2, 3, 4}), "expected i8, i16, f32, f16"},
      {"argmax", type(0, kI8, {}), "has rank 0, expected 1 to 6"},
      {"argmax", [](NodeCase& node) { node.attrs.set(Attr::kRound, 0); },
       "has no use for the attribute round"},

      {"avg_pool2d", attr(Attr::kKernel, {0, 2}), "kernel has 0 at 0"},
      {"avg_pool2d", attr(Attr::kKernel, {3, 8193}), "kernel has 8193 at 1, level 8K ends at 8192"},
      {"avg_pool2d", attr(Attr::kStride, {1, 0}), "stride has 0 at 1"},
      {"avg_pool2d", attr(Attr::kStride, {8193, 1}), "stride has 8193 at 0, level 8K"},
      {"avg_pool2d", attr(Attr::kPad, {1, 3, 0, 0}), "below the kernel size 3"},
      {"avg_pool2d", attr(Attr::kPad, {1, -1, 0, 0}), "pad has -1 at 1"},
      {"avg_pool2d", attr(Attr::kStride, {1, 3}), "stride 3 does not divide 4 on axis 2"},
      {"avg_pool2d", attr(Attr::kKernel, {11, 2}), "the window spans 11 on axis 1"},
      {"avg_pool2d", attr(Attr::kAccType, {6}), "acc_type is INT48, expected INT32"},
      {"avg_pool2d", attr(Attr::kAccType, {99}), "acc_type is 99"},
      {"avg_pool2d", type(1, kI16, {1}),
       "input_zp \"x1\" i16[1] has the wrong type, expected i8[1]"},
      {"avg_pool2d", type(2, kI8, {2}), "output_zp \"x2\" i8[2] has the wrong type"},
      {"max_pool2d", type(0, kI32, {1, 8, 6, 3}), "expected i8, i16, f32, f16"},
      {"max_pool2d", type(0, kI8, {8, 6, 3}), "has rank 3, expected 4"},

      {"conv2d", attr(Attr::kPad, {1, 1, -1, 1}), "pad has -1 at 2"},
      {"conv2d", attr(Attr::kPad, {1, 1, 1, huge}), "pad has 9223372036854775807 at 3"},
      {"conv2d", attr(Attr::kPad, {8193, 1, 1, 1}), "pad has 8193 at 0, level 8K"},
      {"conv2d", attr(Attr::kDilation, {1, 0}), "dilation has 0 at 1"},
      {"conv2d", attr(Attr::kDilation, {2731, 1}), "dilation 2731 times kernel size 3"},
      {"conv2d", attr(Attr::kStride, {3, 1}), "stride 3 does not divide 7"},
      {"conv2d", type(0, kI8, {1, 8, 6, 4}),
       "weight \"x1\" i8[5,3,3,3] expects 3 input channels, found 4"},
      {"conv2d", type(1, kI16, {5, 3, 3, 3}), "expected element types"},
      {"conv2d", type(1, kI8, {5, 3, 3}), "weight \"x1\" i8[5,3,3] has rank 3, expected 4"},
      {"conv2d", type(2, kI32, {4}), "expected i32[5]"},
      {"conv2d", type(2, kI8, {5}), "expected i32[5]"},
      {"conv2d", attr(Attr::kAccType, {6}), "acc_type is INT48, expected INT32"},
      {"conv2d", attr(Attr::kLocalBound, {2}), "local_bound is 2, expected 0 to 1"},
      {"conv2d_i16", data(3, {1}), "input_zp \"x3\" i16[1] is 1, expected 0"},
      {"conv2d_i4", data(4, {1}), "weight_zp \"x4\" i4[1] is 1, expected 0"},
      {"conv3d", type(0, kI8, {1, 8, 6, 3}), "has rank 4, expected 5"},
      {"depthwise_conv2d", type(1, kI8, {3, 3, 2, 3}), "expects 2 input channels, found 3"},
      {"depthwise_conv2d", type(2, kI32, {3}), "expected i32[6]"},
      {"transpose_conv2d", attr(Attr::kOutPad, {-2, 0, 0, 0}), "out_pad has -2, expected above -2"},
      {"transpose_conv2d", attr(Attr::kOutPad, {0, 0, 0, 8193}), "level 8K"},
      {"transpose_conv2d", attr(Attr::kStride, {0, 1}), "stride has 0"},
      {"transpose_conv2d", type(1, kI8, {5, 8193, 1, 3}), "kernel size 8193 is above 8192"},
      {"matmul", type(1, kI8, {1, 4, 5}), "expected i8[2,4,5]"},
      {"matmul", type(1, kI16, {2, 4, 5}), "expected i8[2,4,5]"},
      {"matmul_i16", data(3, {1}), "b_zp \"x3\" i16[1] is 1, expected 0"},

      {"clamp_i8", attr(Attr::kMinVal, {128}), "min_val is 128, expected -128 to 127"},
      {"clamp_i8", attr(Attr::kMaxVal, {-129}), "max_val is -129"},
      {"clamp_one_value", attr(Attr::kMinVal, {-32767}), "min_val -32767 is above max_val -32768"},
      {"clamp_i8", type(0, kI32, {2}), "expected i8, i16, f32, f16"},
      {"table_i8", type(1, kI8, {255}), "expected i8[256]"},
      {"table_i16", type(1, kI16, {512}), "expected i16[513]"},
      {"table_i16", [](NodeCase& node) { (*node.operands[1].data)[7] = -32767; },
       "slope of 32768 from element 7 on"},

      {"add", type(0, kI8, {2, 1, 3}), "expected i32"},
      {"add", type(1, kI16, {1, 4, 3}), "expected i32"},
      {"add", type(1, kI32, {4, 3}), "has rank 2, expected 3"},
      {"add", type(1, kI32, {1, 4, 2}), "axis 2 has 2 and 3"},
      {"equal", type(0, kI8, {2, 1, 3}), "expected i32"},
      {"logical_and", type(0, kI8, {2, 1, 3}), "expected bool"},
      {"bitwise_and", type(1, kI8, {1, 4, 3}), "expected i16"},
      {"shift_by_constant", data(1, {0, 8}),
       "input2 \"x1\" i8[2] has 8 at element 1, expected 0 to 7"},
      {"shift_by_constant", data(1, {-1, 0}), "has -1 at element 0"},
      {"shift_by_constant", attr(Attr::kRound, {2}), "round is 2"},
      {"divide_by_constant", data(1, {1, 0}), "has 0 at element 1: division by zero"},
      {"mul_i8", data(2, {1}), "shift \"x2\" i8[1] has 1 at element 0, expected 0 to 0"},
      {"mul_i32", data(2, {64}), "expected 0 to 63"},
      {"mul_i32", data(2, {-1}), "expected 0 to 63"},
      {"mul_i32", type(1, kI16, {1}), "expected i32"},
      {"mul_i32", type(2, kI32, {1}), "expected i8[1]"},
      {"negate_i32", data(1, {1}), "input_zp \"x1\" i32[1] is 1, expected 0"},
      {"negate_i8", type(2, kI8, {}), "expected i8[1]"},
      {"abs", type(0, kI8, {2}), "expected i32"},
      {"select", type(0, kI8, {2, 1, 1}), "expected bool"},
      {"select", type(2, kI32, {1, 1, 4}), "expected i16"},
      {"select", type(2, kI16, {1, 4}), "has rank 2, expected 3"},
      {"select", type(1, kI48, {1, 3, 1}), "expected bool, i8, i16, i32, f32, f16"},
      {"cast", [](NodeCase& node) { node.result.dtype = kI48; }, "casts input"},
      {"cast", [](NodeCase& node) { node.result.dtype = node.operands[0].type.dtype; },
       "casts input"},

      {"reduce_sum", type(0, kI16, {2, 3, 4}), "expected i32"},
      {"reduce_all", type(0, kI8, {2, 3, 4}), "expected bool"},
      {"reduce_max", attr(Attr::kAxis, {3}), "axis is 3"},
      {"concat", type(1, kI16, {2, 1}), "expected i8"},
      {"concat", type(1, kI8, {3, 1}), "has 3 on axis 0, expected 2"},
      {"concat", type(1, kI8, {2, 1, 1}), "has rank 3, expected 2"},
      {"pad", data(1, {1, 0, -1, 2}), "padding \"x1\" shape[4] has -1 at element 2"},
      {"pad", data(1, {huge, huge, huge, huge}), "padding"},
      {"pad", data(1, {kMaxElements, kMaxElements, 0, 0}), "level 8K ends at 2147483647 elements"},
      {"pad", operand(1, dims({1, 0, 0})), "expected shape[4]"},
      {"pad", type(2, kI16, {1}), "expected i8[1]"},
      {"reshape", data(1, {3, 1, 3}), "has 6 elements, which do not fill [3,1,3]"},
      {"reshape", data(1, {3, -1, 2}), "shape \"x1\" shape[3] has -1"},
      {"reshape", data(1, {kMaxElements, kMaxElements, 2}), "which do not fill"},
      {"reshape", operand(1, constant(kI32, {3, 2})), "expected shape"},
      {"reverse", attr(Attr::kAxis, {4}), "axis is 4"},
      {"slice", data(1, {2, 0}), "start 2 and size 3 on axis 0"},
      {"slice", data(1, {-1, 0}), "start \"x1\" shape[2] has -1"},
      {"slice", data(1, {huge, 0}), "start"},
      {"slice", data(2, {0, 1}), "size \"x2\" shape[2] has 0"},
      {"slice", operand(2, dims({1})), "expected shape[2]"},
      {"tile", data(1, {0, 1}), "multiples \"x1\" shape[2] has 0"},
      {"tile", data(1, {kMaxElements, kMaxElements}), "level 8K ends at 2147483647 elements"},
      {"transpose", attr(Attr::kPerms, {2, 0, 2}), "perms has 2"},
      {"transpose", attr(Attr::kPerms, {3, 0, 1}), "perms has 3"},
      {"transpose", attr(Attr::kPerms, {-1, 0, 1}), "perms has -1"},
      {"gather_constant", data(1, {0, 3, 2, 2}), "has 3 at element 1, expected 0 to 2"},
      {"gather_constant", data(1, {0, 0, -1, 2}), "has -1 at element 2"},
      {"gather", type(1, kI32, {1, 5}), "expected i32[2,5]"},
      {"gather", type(1, kI8, {2, 5}), "expected i32[2,5]"},
      {"gather", type(0, kBool, {2, 3, 4}), "expected i8, i16, i32, f32, f16"},
      {"scatter", data(1, {0, 2, 2, 2}), "has 2 twice in batch 1"},
      {"scatter", data(1, {0, 3, 2, 0}), "has 3 at element 1"},
      {"scatter", type(2, kI8, {2, 3, 4}), "expected i8[2,2,4]"},
      {"scatter",
       [](NodeCase& node) {
         node.operands[1] = input(kI32, {2, 4});
         node.operands[2] = input(kI8, {2, 4, 4});
       },
       "has 4 indices for 3 rows"},

      {"resize_nearest", attr(Attr::kMode, {0}), "mode is 0, expected 1 to 2"},
      {"resize_nearest", data(1, {0, 1, 3, 1}), "scale \"x1\" shape[4] has 0"},
      {"resize_nearest", data(1, {2, 1, 3, -1}), "scale \"x1\" shape[4] has -1"},
      {"resize_nearest", data(1, {2049, 2049, 3, 1}), "numerator 2049"},
      {"resize_nearest", data(1, {2, 32, 3, 1}), "2/32 on axis 1, expected above 1/16"},
      {"resize_nearest", data(1, {2, 1, 257, 1}), "level 8K ends at 256"},
      {"resize_nearest", data(2, {-3, 0}), "offset \"x2\" shape[2] has -3 on axis 1"},
      {"resize_nearest", data(2, {0, 48}), "has 48 on axis 2, expected -3 to 47"},
      {"resize_nearest", data(2, {0, huge}), "offset"},
      {"resize_nearest", data(3, {2, 0}), "has 2 on axis 1, expected -32 to 1"},
      {"resize_nearest", data(3, {-33, 0}), "border"},
      {"resize_bilinear", data(3, {0, 1}), "expected a multiple of 2"},
      {"resize_nearest", type(0, kI8, {1, 16384, 1, 1}), "expected at most 16383"},
      {"resize_nearest", type(0, kI8, {1, 10000, 1, 1}), "the result has 20000 elements"},
      {"resize_nearest", type(0, kI32, {1, 8, 6, 3}), "expected i8, i16, f32, f16"},
      {"resize_nearest", operand(2, dims({0})), "expected shape[2]"},

      {"rescale", data(1, {0, -1, 1}), "multiplier \"x1\" i32[3] has -1 at element 1"},
      {"rescale", data(2, {2, 1, 30}), "shift \"x2\" i8[3] has 1 at element 1, expected 2 to 62"},
      {"rescale", data(2, {63, 2, 30}), "has 63 at element 0"},
      {"rescale", type(1, kI32, {2}), "expected i32[3]"},
      {"rescale", type(2, kI8, {1}), "expected i8[3]"},
      {"rescale", type(2, kI16, {3}), "expected i8[3]"},
      {"rescale", attr(Attr::kScale32, {0}), "expected i16[3]"},
      {"rescale", attr(Attr::kPerChannel, {0}), "expected i32[1]"},
      {"rescale", attr(Attr::kRoundingMode, {0}), "rounding_mode is 0, expected 1 to 3"},
      {"rescale", attr(Attr::kRoundingMode, {4}), "rounding_mode is 4"},
      {"rescale", attr(Attr::kInputUnsigned, {1}), "with an unsigned side, expected i8 and i16"},
      {"rescale", attr(Attr::kOutputUnsigned, {1}), "with an unsigned side"},
      {"rescale", data(3, {1}), "input_zp \"x3\" i32[1] is 1, expected 0"},
      {"rescale", type(0, kI32, {}), "has rank 0"},
      {"rescale", type(4, kI48, {1}), "expected i8, i16 or i32"},
      {"rescale_i48", attr(Attr::kScale32, {1}), "needs scale32 = 0"},
      {"rescale_i48", attr(Attr::kRoundingMode, {kDoubleRound}), "needs scale32 = 1"},
      {"rescale_i48", attr(Attr::kInputUnsigned, {1}), "with an unsigned side"},
      {"rescale_unsigned_i16", data(3, {-32767}), "is 32769 unsigned, expected 0 or 32768"},
      {"rescale_unsigned_i16", attr(Attr::kOutputUnsigned, {1}), "both set"},
      {"rescale_unsigned_i16", attr(Attr::kInputUnsigned, {0}), "is -32768, expected 0"},

      {"identity_i48", type(0, DType::kUnknown, {}), "has no element type"},
      {"identity_i48", type(0, DType::kShape, {3}), "expected bool"},
      {"identity_i48", type(0, kI8, {1, 1, 1, 1, 1, 1, 1}), "level 8K ends at rank 6"},
      {"identity_i48", operand(0, input(kI8, {65536, 32768})), "level 8K ends at 2147483647"},
      {"identity_i48", operand(0, input(kI8, {3, 0})), "dimensions must be at least 1"},
      {"identity_i48", operand(0, input(kI8, {3, -2})), "dimensions must be at least 1"},
      {"identity_i48", operand(0, input(kI8, {3, kDynamic})), "all dimensions must be known"},
      {"identity_i48", operand(0, constant(kI8, {4}, {1, 2, 3})), "has 3 bytes of data"},
  };
}

TEST(Verify, RefusesIllegalNodes) {
  for (const Refusal& refusal : refusals()) {
    NodeCase node = legal_case(refusal.legal);
    refusal.change(node);
    const auto inferred = infer_result(node.graph(), {0});
    const std::string text =
        inferred ? "accepted as " + type_text(*inferred) : inferred.error().text();
    EXPECT_NE(text.find(refusal.message), std::string::npos)
        << refusal.legal << " should say: " << refusal.message << "\nbut says: " << text;
    EXPECT_FALSE(verify(node.graph())) << refusal.legal << ": " << refusal.message;
  }
}

/// x -> abs -> y, an i32[4] each.
Graph small_graph() {
  Graph graph;
  const ValueId x = graph.add_input("x", {kI32, {4}});
  graph.outputs = {graph.add_node(Op::kAbs, {}, {x}, "y", {kI32, {4}})};
  return graph;
}

TEST(Verify, RefusesGraphsThatAreNotWellFormed) {
  struct Row {
    std::function<void(Graph&)> change;
    std::string message;
  };
  const Tensor four = Tensor::from_ints({kI32, {4}}, Ints{1, 2, 3, 4});
  const std::vector<Row> rows{
      {[](Graph&) {}, "accepted"},
      {[](Graph& g) { g.outputs.clear(); }, "accepted"},
      {[](Graph& g) { g.outputs.push_back(g.inputs[0]); }, "accepted"},
      {[&](Graph& g) { g.outputs.push_back(g.add_constant("c", four)); }, "accepted"},
      {[](Graph& g) {
         g.add_value("unused", {DType::kFp32, {0}});
       },
       "accepted"},
      {[](Graph& g) { g.values[1].name = "x"; }, "has a name that another value has"},
      {[](Graph& g) { g.values[1].name = ""; }, "has an empty name"},
      {[](Graph& g) { g.values[1].name = "a\xff"; }, "has a name with bytes that are no UTF-8"},
      {[](Graph& g) { g.name = "\xed\xa0\x80"; }, "has a name with bytes that are no UTF-8"},
      {[](Graph& g) { g.nodes[0].inputs[0] = {9}; }, "is value %9, but there are 2 values"},
      {[](Graph& g) { g.nodes[0].output = {}; }, "the result of node 0"},
      {[](Graph& g) { g.inputs[0] = {2}; }, "input 0 is value %2"},
      {[](Graph& g) { g.outputs[0] = {2}; }, "output 0 is value %2"},
      {[](Graph& g) { g.nodes[0].inputs[0] = {1}; }, "which no input, constant or earlier node"},
      {[](Graph& g) { g.inputs.clear(); }, "uses value %0 \"x\", which no input"},
      {[](Graph& g) { g.inputs.push_back(g.inputs[0]); }, "is defined a second time"},
      {[](Graph& g) { g.nodes.push_back(g.nodes[0]); }, "is defined a second time"},
      {[](Graph& g) { g.nodes[0].output = g.inputs[0]; }, "is defined a second time"},
      {[&](Graph& g) { g.values[0].constant = four; }, "is a graph input and a constant"},
      {[&](Graph& g) { g.values[1].constant = four; }, "its result is a constant"},
      {[](Graph& g) { g.values[0].type.shape[0] = kDynamic; }, "this input needs a shape"},
      {[](Graph& g) { g.values[1].type.shape[0] = kDynamic; }, "declared as i32[?]"},
      {[](Graph& g) {
         g.outputs[0] = g.add_value("loose", {kI32, {4}});
       },
       "which no input"},
      {[](Graph& g) { g.outputs[0] = g.add_shape("s", {1}); }, "is a shape and a graph output"},
      {[](Graph& g) {
         g.add_input("s", {DType::kShape, {2}});
       },
       "expected a constant"},
      {[](Graph& g) {
         g.outputs.push_back(g.add_constant("b", {{kBool, {2}}, {1, 2}}));
       },
       "has 2 at element 1, BOOL is 0 to 1"},
      {[](Graph& g) {
         g.outputs.push_back(g.add_constant("b", {{kI4, {2}}, {0xf8, 0}}));
       },
       "has -8 at element 0, INT4 is -7 to 7"},
      {[](Graph& g) {
         g.outputs.push_back(
             g.add_constant("b", Tensor::from_ints({kI48, {1}}, Ints{int64_t{1} << 47})));
       },
       "has 140737488355328 at element 0"},
      {[](Graph& g) {
         g.outputs.push_back(g.add_constant("b", {{kI32, {2}}, {1, 2}}));
       },
       "has 2 bytes of data, i32[2] needs 8"},
      {[&](Graph& g) {
         const ValueId c = g.add_constant("c", four);
         g.value(c).type = {kI32, {2}};
         g.outputs.push_back(c);
       },
       "but its constant is i32[4]"},
      {[](Graph& g) {
         for (int i = 0; i < 9; ++i) g.add_input("big", {kI32, {kMaxElements}});
       },
       "the limit is 68719476736"},
  };
  for (const Row& row : rows) {
    Graph graph = small_graph();
    row.change(graph);
    EXPECT_NE(outcome(verify(graph)).find(row.message), std::string::npos)
        << "should say: " << row.message << "\nbut says: " << outcome(verify(graph));
  }
}

TEST(Verify, NamesTheNodeInErrors) {
  Graph graph = small_graph();
  graph.values[0].type.dtype = kI8;
  EXPECT_EQ(outcome(verify(graph)),
            "node %0 \"y\" (abs): input \"x\" i8[4] has the wrong element type, expected i32, f32, "
            "f16 or bf16");
}

TEST(Verify, RefusesMoreThan64TensorsInAConcat) {
  NodeCase node = legal_case("concat");
  node.operands.resize(65, node.operands[1]);
  EXPECT_NE(outcome(verify(node.graph())).find("has 65 operands, expected 1 to 64"),
            std::string::npos);
}

}  // namespace
}  // namespace shale
