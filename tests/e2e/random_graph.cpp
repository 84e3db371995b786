#include "tests/e2e/random_graph.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "ir/base/half.h"
#include "ir/reference/interpreter.h"
#include "ir/verify/verify.h"

namespace shale {

int64_t Random::between(int64_t min, int64_t max) {
  const uint64_t span = static_cast<uint64_t>(max) - static_cast<uint64_t>(min) + 1;
  return static_cast<int64_t>(static_cast<uint64_t>(min) +
                              (span == 0 ? engine_() : engine_() % span));
}

namespace {

using Ints = std::vector<int64_t>;

constexpr int64_t kMaxTensorElements = 4000;

/// How the elements of one tensor are spread.
struct Spread {
  enum Kind { kWhole, kBits, kLimits, kTiny, kModerate, kExponents, kStrange } kind;
  int64_t bits;
};

Spread random_spread(Random& random, DType dtype) {
  const int64_t bits = dtype_info(dtype).bits;
  if (is_float(dtype)) {
    const int64_t draw = random.between(0, 19);
    return {draw == 0 ? Spread::kStrange : draw < 4 ? Spread::kExponents : Spread::kModerate, 0};
  }
  switch (random.between(0, 9)) {
    case 0: return {Spread::kLimits, 0};
    case 1: return {Spread::kTiny, 0};
    case 2:
    case 3:
    case 4: return {bits <= 8 ? Spread::kWhole : Spread::kBits, random.between(1, bits - 1)};
    default:
      return {bits <= 16 || random.chance(15) ? Spread::kWhole : Spread::kBits,
              random.between(1, 16)};
  }
}

int64_t random_element(Random& random, DType dtype, const Spread& spread) {
  const IntRange range = dtype_range(dtype);
  switch (spread.kind) {
    case Spread::kWhole: return random.between(range.min, range.max);
    case Spread::kBits: {
      const int64_t half = int64_t{1} << (spread.bits - 1);
      return std::clamp(random.between(-half, half - 1), range.min, range.max);
    }
    case Spread::kLimits: return random.pick(Ints{range.min, range.max, 0, range.min, range.max});
    case Spread::kTiny: return std::clamp(random.between(-2, 1), range.min, range.max);
    case Spread::kModerate:
      return real_bits(dtype, static_cast<float>(random.between(-4096, 4096)) / 1024.0f);
    case Spread::kExponents: {
      const int reach = dtype == DType::kFp16 ? 12 : 60;
      return real_bits(dtype, std::ldexp(static_cast<float>(random.between(-2048, 2047)),
                                         static_cast<int>(random.between(-reach, reach / 2)) - 11));
    }
    case Spread::kStrange: {
      const float largest = dtype == DType::kFp16 ? kHalfMax : 0x1.fffffep127f;
      const float subnormal = dtype == DType::kFp16 ? 0x1p-24f : 0x1p-149f;
      const std::vector<float> values{
          INFINITY, -INFINITY,           NAN,  largest, -largest, subnormal, -0.0f,
          0.0f,     1000.0f * subnormal, 1.0f, -1.0f,   0.5f};
      return real_bits(dtype, random.pick(values));
    }
  }
  return 0;
}

class Builder {
 public:
  Builder(uint64_t seed, RandomGraphCounts& counts, bool real)
      : random_(seed), counts_(counts), real_(real), ops_(random_graph_ops(real)) {}

  RandomGraph build() {
    const int64_t wanted = random_.between(1, 8);
    for (int attempt = 0; attempt < 400 && static_cast<int64_t>(graph_.nodes.size()) < wanted;
         ++attempt)
      add_node();
    choose_outputs();
    RandomGraph result{std::move(graph_), {}};
    for (const ValueId id : result.graph.inputs) result.inputs.push_back(tensors_[id.index]);
    return result;
  }

 private:
  /// A drawn node; nothing where the operator does not suit what the graph has.
  struct Draft {
    Attrs attrs;
    std::vector<ValueId> operands;
    DType result = DType::kUnknown;  ///< for CAST, whose target type is the declared one
  };
  using Maybe = std::optional<Draft>;

  void add_node() {
    const size_t values = graph_.values.size(), inputs = graph_.inputs.size();
    // Now and then a node once more, for the pass that merges equal ones.
    const bool repeat = !graph_.nodes.empty() && random_.chance(6);
    const Node repeated = repeat ? random_.pick(graph_.nodes) : Node{};
    const Op op = repeat ? repeated.op : random_op();
    const auto roll_back = [&] {
      graph_.values.resize(values);
      tensors_.resize(values);
      graph_.inputs.resize(inputs);
    };
    Maybe draft = !repeat           ? draw(op)
                  : op == Op::kCast ? draw_cast(repeated.inputs[0])
                                    : Draft{repeated.attrs, repeated.inputs};
    if (!draft) return roll_back();
    const NodeId id{static_cast<uint32_t>(graph_.nodes.size())};
    const ValueId result =
        graph_.add_node(op, std::move(draft->attrs), std::move(draft->operands),
                        fmt::format("v{}", graph_.values.size()), {draft->result, {}});
    tensors_.emplace_back();
    const auto drop = [&](uint64_t& count) {
      ++count;
      graph_.nodes.pop_back();
      roll_back();
    };
    const Result<TensorType> type = infer_result(graph_, id);
    if (!type || element_count(type->shape).value_or(INT64_MAX) > kMaxTensorElements)
      return drop(counts_.illegal);
    graph_.value(result).type = *type;
    std::vector<const Tensor*> operands;
    for (const ValueId operand : graph_.node(id).inputs)
      operands.push_back(&tensors_[operand.index]);
    Result<Tensor> tensor = evaluate_node(graph_, id, operands);
    if (!tensor) return drop(counts_.unpredictable);
    tensors_[result.index] = *std::move(tensor);
    ++counts_.kept;
    ++counts_.ops[op];
  }

  /// Mostly any operator; now and then what real networks have next, so that fusion sees its
  /// patterns.
  Op random_op() {
    if (!graph_.nodes.empty() && random_.chance(45)) {
      const TensorType& last = type(graph_.nodes.back().output);
      if (last.dtype == DType::kInt48) return Op::kRescale;
      if (last.dtype == DType::kInt32)
        return random_.pick(
            std::vector<Op>{Op::kRescale, Op::kRescale, Op::kRescale, Op::kAdd, Op::kMaximum});
      if (is_float(last.dtype) && last.shape.size() == 4)
        return random_.pick(std::vector<Op>{Op::kConv2d, Op::kConv2d, Op::kConv2d, Op::kClamp,
                                            Op::kClamp, Op::kSigmoid, Op::kResize, Op::kPad,
                                            Op::kConcat, Op::kAdd, Op::kMul, Op::kCast,
                                            Op::kDepthwiseConv2d});
      if (last.dtype == DType::kInt8 && last.shape.size() == 4)
        return random_.pick(std::vector<Op>{Op::kConv2d, Op::kConv2d, Op::kConv2d, Op::kClamp,
                                            Op::kTable, Op::kResize, Op::kPad, Op::kConcat,
                                            Op::kRescale, Op::kDepthwiseConv2d});
    }
    if (graph_.nodes.empty() && random_.chance(35)) return Op::kConv2d;
    return random_.pick(ops_);
  }

  Maybe draw(Op op) {
    switch (op) {
      case Op::kArgmax: return draw_axis(op, {DType::kInt8, DType::kInt16});
      case Op::kAvgPool2d:
      case Op::kMaxPool2d: return draw_pool(op);
      case Op::kConv2d:
      case Op::kConv3d:
      case Op::kDepthwiseConv2d: return draw_conv(op);
      case Op::kTransposeConv2d: return draw_transpose_conv();
      case Op::kMatmul: return draw_matmul();
      case Op::kClamp: return draw_clamp();
      case Op::kAdd:
      case Op::kSub:
      case Op::kMaximum:
      case Op::kMinimum:
      case Op::kEqual:
      case Op::kGreater:
      case Op::kGreaterEqual: return draw_binary(op, {DType::kInt32});
      case Op::kBitwiseAnd:
      case Op::kBitwiseOr:
      case Op::kBitwiseXor: return draw_binary(op, kInts);
      case Op::kLogicalAnd:
      case Op::kLogicalOr:
      case Op::kLogicalXor: return draw_binary(op, {DType::kBool});
      case Op::kArithmeticRightShift:
      case Op::kLogicalLeftShift:
      case Op::kLogicalRightShift: return draw_shift(op);
      case Op::kIntDiv: return draw_intdiv();
      case Op::kMul: return draw_mul();
      case Op::kTable: return draw_table();
      case Op::kCeil:
      case Op::kCos:
      case Op::kErf:
      case Op::kExp:
      case Op::kFloor:
      case Op::kLog:
      case Op::kReciprocal:
      case Op::kRsqrt:
      case Op::kSigmoid:
      case Op::kSin:
      case Op::kTanh: return Draft{{}, {pick(kInts)}};
      case Op::kPow: return draw_binary(op, {DType::kInt32});
      case Op::kReduceProduct: return draw_axis(op, {DType::kInt32});
      case Op::kFft2d:
      case Op::kRfft2d: return std::nullopt;  // their shapes are too rare: see float_cases
      case Op::kAbs:
      case Op::kClz: return Draft{{}, {pick({DType::kInt32})}};
      case Op::kBitwiseNot: return Draft{{}, {pick(kInts)}};
      case Op::kLogicalNot: return Draft{{}, {pick({DType::kBool})}};
      case Op::kNegate: {
        const ValueId x = pick(kInts);
        return Draft{{}, {x, zero_point(type(x).dtype), zero_point(type(x).dtype)}};
      }
      case Op::kSelect: return draw_select();
      case Op::kReduceAll:
      case Op::kReduceAny: return draw_axis(op, {DType::kBool});
      case Op::kReduceMax:
      case Op::kReduceMin: return draw_axis(op, kInts);
      case Op::kReduceSum: return draw_axis(op, {DType::kInt32});
      case Op::kReverse: return draw_axis(op, kAny);
      case Op::kConcat: return draw_concat();
      case Op::kPad: return draw_pad();
      case Op::kReshape: return draw_reshape();
      case Op::kSlice: return draw_slice();
      case Op::kTile: return draw_tile();
      case Op::kTranspose: return draw_transpose();
      case Op::kGather:
      case Op::kScatter: return draw_gather(op);
      case Op::kResize: return draw_resize();
      case Op::kCast: return draw_cast(pick_of(real_ ? kCastable : kAny, 0, 6));
      case Op::kRescale: return draw_rescale();
      case Op::kIdentity:
        return Draft{{},
                     {pick({DType::kBool, DType::kInt4, DType::kInt8, DType::kInt16, DType::kInt32,
                            DType::kInt48})}};
    }
    return std::nullopt;
  }

  // Leaves and operands.

  const TensorType& type(ValueId id) const { return graph_.value(id).type; }
  const Tensor& tensor(ValueId id) const { return tensors_[id.index]; }

  ValueId constant(Tensor data) {
    tensors_.push_back(data);
    return graph_.add_constant(fmt::format("c{}", graph_.values.size()), std::move(data));
  }
  ValueId constant(DType dtype, Shape shape, const Ints& values) {
    return constant(Tensor::from_ints({dtype, std::move(shape)}, values));
  }
  ValueId list(const Ints& values) {
    return constant(DType::kShape, {static_cast<int64_t>(values.size())}, values);
  }

  /// A graph input, or a constant of the same data.
  ValueId leaf(Tensor data, int constant_percent) {
    if (random_.chance(constant_percent)) return constant(std::move(data));
    tensors_.push_back(data);
    return graph_.add_input(fmt::format("x{}", graph_.values.size()), data.type);
  }
  ValueId random_leaf(DType dtype, const Shape& shape, int constant_percent = 30) {
    return leaf(random_tensor(random_, {dtype, shape}), constant_percent);
  }
  /// Elements in min..max.
  ValueId bounded_leaf(DType dtype, const Shape& shape, int64_t min, int64_t max) {
    Tensor data = Tensor::zeros({dtype, shape});
    for (int64_t i = 0; i < data.count(); ++i) data.set(i, random_.between(min, max));
    return leaf(std::move(data), 50);
  }

  int64_t random_dim() { return random_.pick(Ints{1, 1, 1, 2, 2, 3, 4, 5, 7, 8}); }
  Shape random_shape(size_t rank) {
    Shape shape;
    int64_t count = 1;
    for (size_t i = 0; i < rank; ++i) {
      int64_t dim = random_dim();
      if (random_.chance(3)) dim = random_.pick(Ints{17, 33, 65, 130});
      if (count * dim > 600) dim = 1;
      count *= dim;
      shape.push_back(dim);
    }
    return shape;
  }
  size_t random_rank(size_t min, size_t max) {
    if (min <= 4 && max >= 4 && random_.chance(50)) return 4;
    return static_cast<size_t>(
        random_.between(static_cast<int64_t>(min), static_cast<int64_t>(max)));
  }

  /// A value of one of the types and a rank in min..max: mostly a late one of the graph, else a
  /// leaf.
  ValueId pick(const std::vector<DType>& integers, size_t min_rank = 0, size_t max_rank = 6) {
    return pick_of(real_ && integers.front() != DType::kBool ? kReals : integers, min_rank,
                   max_rank);
  }
  ValueId pick_of(const std::vector<DType>& dtypes, size_t min_rank, size_t max_rank) {
    std::vector<ValueId> found;
    for (uint32_t i = 0; i < graph_.values.size(); ++i) {
      const Value& value = graph_.values[i];
      const bool fits = std::find(dtypes.begin(), dtypes.end(), value.type.dtype) != dtypes.end() &&
                        value.type.shape.size() >= min_rank && value.type.shape.size() <= max_rank;
      if (fits && (!value.is_constant() || random_.chance(10))) found.push_back({i});
    }
    if (!found.empty() && random_.chance(88))
      return random_.chance(65) ? found.back() : random_.pick(found);
    return random_leaf(random_.pick(dtypes), random_shape(random_rank(min_rank, max_rank)), 12);
  }

  /// A partner of exactly this type: another value of the graph, or a leaf.
  ValueId partner(const TensorType& wanted) {
    std::vector<ValueId> found;
    for (uint32_t i = 0; i < graph_.values.size(); ++i)
      if (graph_.values[i].type == wanted) found.push_back({i});
    if (!found.empty() && random_.chance(40)) return random_.pick(found);
    return random_leaf(wanted.dtype, wanted.shape);
  }

  ValueId zero_point(DType dtype) {
    int64_t value = 0;
    if (dtype == DType::kInt8)
      value = random_.pick(Ints{0, 0, -128, 127, random_.between(-128, 127)});
    return constant(dtype, {1}, {value});
  }

  Attrs nan(Attrs attrs = {}) { return attrs.set(Attr::kNanMode, random_.between(1, 2)); }

  /// A stride under which a window of `span` comes out exact on `room` elements more; 0 if it does
  /// not fit.
  int64_t random_stride(int64_t room) {
    if (room < 0) return 0;
    if (room == 0) return random_.pick(Ints{1, 2, 9, 8192});
    Ints divisors;
    for (int64_t d = 1; d <= room; ++d)
      if (room % d == 0) divisors.push_back(d);
    return random_.chance(50) ? 1 : random_.pick(divisors);
  }

  // Operators.

  Maybe draw_axis(Op op, const std::vector<DType>& dtypes) {
    const ValueId x = pick(dtypes, 1);
    Attrs attrs;
    attrs.set(Attr::kAxis, random_.between(0, static_cast<int64_t>(type(x).shape.size()) - 1));
    const bool has_nan_mode = op == Op::kArgmax || op == Op::kReduceMax || op == Op::kReduceMin;
    return Draft{has_nan_mode ? nan(attrs) : attrs, {x}};
  }

  Maybe draw_pool(Op op) {
    const ValueId x = pick({DType::kInt8, DType::kInt16}, 4, 4);
    Ints kernel, stride, pad;
    for (size_t i = 0; i < 2; ++i) {
      kernel.push_back(random_.pick(Ints{1, 2, 3, 3, 5}));
      pad.push_back(random_.between(0, kernel[i] - 1));
      pad.push_back(random_.between(0, kernel[i] - 1));
      stride.push_back(
          random_stride(type(x).shape[i + 1] + pad[2 * i] + pad[2 * i + 1] - kernel[i]));
      if (stride[i] == 0) return std::nullopt;
    }
    Attrs attrs;
    attrs.set(Attr::kKernel, kernel).set(Attr::kStride, stride).set(Attr::kPad, pad);
    if (op == Op::kMaxPool2d) return Draft{nan(attrs), {x}};
    const DType dtype = type(x).dtype;
    attrs.set(Attr::kAccType, static_cast<int64_t>(accumulator(dtype, DType::kInt32)));
    return Draft{attrs, {x, zero_point(dtype), zero_point(dtype)}};
  }

  /// FP32, or for FP16 that too.
  DType accumulator(DType dtype, DType integer) {
    if (!is_float(dtype)) return integer;
    return random_.chance(50) ? dtype : DType::kFp32;
  }

  /// Weight, bias and the two zero points; the result's element type goes into `acc_type`.
  std::vector<ValueId> conv_operands(ValueId x, Shape weight_shape, int64_t channels,
                                     DType& acc_type) {
    const DType dtype = type(x).dtype;
    if (is_float(dtype)) {
      acc_type = accumulator(dtype, dtype);
      const ValueId weight = random_leaf(dtype, weight_shape, 85);
      const ValueId bias = random_leaf(dtype, {random_.chance(20) ? 1 : channels}, 85);
      return {x, weight, bias, zero_point(dtype), zero_point(dtype)};
    }
    const bool is_int16 = dtype == DType::kInt16;
    acc_type = is_int16 ? DType::kInt48 : DType::kInt32;
    const DType weight_type = !is_int16 && random_.chance(12) ? DType::kInt4 : DType::kInt8;
    const Shape bias_shape{random_.chance(20) ? 1 : channels};
    const ValueId weight = random_leaf(weight_type, weight_shape, 85);
    const ValueId bias = random_leaf(acc_type, bias_shape, 85);
    return {x, weight, bias, zero_point(dtype), zero_point(weight_type)};
  }

  Maybe draw_conv(Op op) {
    const size_t axes = op == Op::kConv3d ? 3 : 2;
    const ValueId x =
        pick({DType::kInt8, DType::kInt8, DType::kInt8, DType::kInt16}, axes + 2, axes + 2);
    const Shape& in = type(x).shape;
    Ints kernel, stride, pad, dilation;
    for (size_t i = 0; i < axes; ++i) {
      kernel.push_back(random_.pick(Ints{1, 1, 2, 3, 3, axes == 2 ? 5 : 2}));
      dilation.push_back(random_.pick(Ints{1, 1, 1, 2, 3}));
      const bool padded = random_.chance(60);
      pad.push_back(padded ? random_.between(0, 4) : 0);
      pad.push_back(padded ? random_.between(0, 4) : 0);
      stride.push_back(random_stride(in[i + 1] + pad[2 * i] + pad[2 * i + 1] -
                                     (kernel[i] - 1) * dilation[i] - 1));
      if (stride[i] == 0) return std::nullopt;
    }
    const int64_t in_channels = in.back();
    Shape weight = kernel;
    int64_t channels = random_.pick(Ints{1, 2, 3, 4, 5, 8, 16, 17});
    if (op == Op::kDepthwiseConv2d) {
      const int64_t multiplier = random_.between(1, 3);
      weight.insert(weight.end(), {in_channels, multiplier});
      channels = in_channels * multiplier;
    } else {
      weight.insert(weight.begin(), channels);
      weight.push_back(in_channels);
    }
    if (element_count(weight).value_or(INT64_MAX) > 3000) return std::nullopt;
    DType acc_type;
    const std::vector<ValueId> operands = conv_operands(x, weight, channels, acc_type);
    Attrs attrs;
    attrs.set(Attr::kPad, pad).set(Attr::kStride, stride).set(Attr::kDilation, dilation);
    attrs.set(Attr::kLocalBound, random_.between(0, 1))
        .set(Attr::kAccType, static_cast<int64_t>(acc_type));
    return Draft{attrs, operands};
  }

  Maybe draw_transpose_conv() {
    const ValueId x = pick({DType::kInt8, DType::kInt8, DType::kInt16}, 4, 4);
    const int64_t channels = random_.pick(Ints{1, 2, 3, 5});
    Shape weight{channels};
    Ints out_pad, stride;
    for (size_t i = 0; i < 2; ++i) {
      weight.push_back(random_.between(1, 4));
      out_pad.push_back(random_.between(1 - weight.back(), 3));
      out_pad.push_back(random_.between(1 - weight.back(), 3));
      stride.push_back(random_.between(1, 3));
    }
    weight.push_back(type(x).shape.back());
    DType acc_type;
    const std::vector<ValueId> operands = conv_operands(x, weight, channels, acc_type);
    Attrs attrs;
    attrs.set(Attr::kOutPad, out_pad).set(Attr::kStride, stride);
    attrs.set(Attr::kLocalBound, 0).set(Attr::kAccType, static_cast<int64_t>(acc_type));
    return Draft{attrs, operands};
  }

  Maybe draw_matmul() {
    const ValueId a = pick({DType::kInt8, DType::kInt16}, 3, 3);
    const TensorType& left = type(a);
    const ValueId b = partner({left.dtype, {left.shape[0], left.shape[2], random_dim()}});
    const DType dtype = type(a).dtype;
    return Draft{{},
                 {a, b, zero_point(dtype), zero_point(dtype)},
                 is_float(dtype) && random_.chance(50) ? DType::kFp32 : DType::kUnknown};
  }

  Maybe draw_clamp() {
    const ValueId x = pick({DType::kInt8, DType::kInt16});
    if (is_float(type(x).dtype)) {
      float ends[2] = {-INFINITY, INFINITY};
      for (float& end : ends)
        if (random_.chance(60)) end = static_cast<float>(random_.between(-8, 8)) / 4.0f;
      if (ends[0] > ends[1]) std::swap(ends[0], ends[1]);
      return Draft{nan(Attrs()
                           .set(Attr::kMinVal, real_bits(type(x).dtype, ends[0]))
                           .set(Attr::kMaxVal, real_bits(type(x).dtype, ends[1]))),
                   {x}};
    }
    const IntRange range = dtype_range(type(x).dtype);
    int64_t low = random_.chance(30) ? range.min : random_.between(range.min, range.max);
    int64_t high = random_.chance(30) ? range.max : random_.between(range.min, range.max);
    if (low > high) std::swap(low, high);
    return Draft{nan(Attrs().set(Attr::kMinVal, low).set(Attr::kMaxVal, high)), {x}};
  }

  /// A shape that broadcasts with `shape`: some axes shrink to 1, axes of size 1 may grow.
  Shape broadcast_partner(Shape shape) {
    int64_t count = *element_count(shape);
    for (int64_t& dim : shape) {
      if (random_.chance(25)) {
        dim = 1;
      } else if (dim == 1 && random_.chance(20) && count * 3 < 600) {
        dim = 3;
        count *= 3;
      }
    }
    return shape;
  }

  ValueId broadcasting(ValueId with) {
    const TensorType wanted = type(with);
    std::vector<ValueId> found;
    for (uint32_t i = 0; i < graph_.values.size(); ++i) {
      const TensorType& other = graph_.values[i].type;
      bool fits = other.dtype == wanted.dtype && other.shape.size() == wanted.shape.size();
      for (size_t axis = 0; fits && axis < wanted.shape.size(); ++axis)
        fits = other.shape[axis] == wanted.shape[axis] || other.shape[axis] == 1 ||
               wanted.shape[axis] == 1;
      if (fits) found.push_back({i});
    }
    if (!found.empty() && random_.chance(50)) return random_.pick(found);
    return random_leaf(wanted.dtype, broadcast_partner(wanted.shape));
  }

  Maybe draw_binary(Op op, const std::vector<DType>& dtypes) {
    const ValueId a = pick(dtypes);
    const ValueId b = broadcasting(a);
    const bool has_nan_mode = op == Op::kMaximum || op == Op::kMinimum;
    return Draft{has_nan_mode ? nan() : Attrs(),
                 random_.chance(50) ? std::vector{a, b} : std::vector{b, a}};
  }

  Maybe draw_shift(Op op) {
    const ValueId a = pick(kInts);
    const DType dtype = type(a).dtype;
    const ValueId b =
        bounded_leaf(dtype, broadcast_partner(type(a).shape), 0, dtype_info(dtype).bits - 1);
    Attrs attrs;
    if (op == Op::kArithmeticRightShift) attrs.set(Attr::kRound, random_.between(0, 1));
    return Draft{attrs, {a, b}};
  }

  Maybe draw_intdiv() {
    const ValueId a = pick({DType::kInt32});
    Tensor divisor = random_tensor(random_, {DType::kInt32, broadcast_partner(type(a).shape)});
    for (int64_t i = 0; i < divisor.count(); ++i)
      if (divisor.get(i) == 0) divisor.set(i, random_.pick(Ints{1, -1, 3, INT32_MIN}));
    return Draft{{}, {a, leaf(std::move(divisor), 50)}};
  }

  Maybe draw_mul() {
    const ValueId a = pick(kInts);
    const ValueId b = broadcasting(a);
    const int64_t shift =
        type(a).dtype == DType::kInt32 ? random_.pick(Ints{0, 0, 1, 2, 15, 31, 32, 33, 62, 63}) : 0;
    return Draft{{}, {a, b, constant(DType::kInt8, {1}, {shift})}};
  }

  Maybe draw_table() {
    const ValueId x = pick({DType::kInt8, DType::kInt16});
    if (type(x).dtype == DType::kInt8)
      return Draft{{}, {x, constant(random_tensor(random_, {DType::kInt8, {256}}))}};
    // Neighbours differ by what int16 holds.
    Tensor table = random_tensor(random_, {DType::kInt16, {513}});
    for (int64_t i = 0; i < table.count(); ++i) table.set(i, table.get(i) / 2);
    return Draft{{}, {x, constant(std::move(table))}};
  }

  Maybe draw_select() {
    const ValueId condition = pick({DType::kBool});
    const Shape shape = type(condition).shape;
    const DType dtype = random_.pick(real_ ? kReals : kAny);
    return Draft{{},
                 {condition, partner({dtype, broadcast_partner(shape)}), partner({dtype, shape})}};
  }

  Maybe draw_concat() {
    const ValueId x = pick(kAny, 1);
    const size_t axis =
        static_cast<size_t>(random_.between(0, static_cast<int64_t>(type(x).shape.size()) - 1));
    std::vector<ValueId> operands{x};
    for (int64_t more = random_.between(0, 3); more > 0; --more) {
      TensorType other = type(x);
      if (random_.chance(60)) other.shape[axis] = random_dim();
      operands.insert(operands.begin() + random_.between(0, static_cast<int64_t>(operands.size())),
                      partner(other));
    }
    return Draft{Attrs().set(Attr::kAxis, static_cast<int64_t>(axis)), operands};
  }

  Maybe draw_pad() {
    const ValueId x = pick(kAny, 1);
    Ints padding;
    for (size_t i = 0; i < 2 * type(x).shape.size(); ++i)
      padding.push_back(random_.chance(60) ? 0 : random_.between(1, 3));
    const DType dtype = type(x).dtype;
    const IntRange range = dtype_range(dtype);
    const int64_t value =
        is_float(dtype)
            ? random_element(random_, dtype, random_spread(random_, dtype))
            : random_.pick(Ints{0, range.min, range.max, random_.between(range.min, range.max)});
    return Draft{{}, {x, list(padding), constant(type(x).dtype, {1}, {value})}};
  }

  Maybe draw_reshape() {
    const ValueId x = pick(kAny);
    int64_t rest = *element_count(type(x).shape);
    const size_t rank = static_cast<size_t>(random_.between(rest == 1 ? 0 : 1, 6));
    Shape shape(rank, 1);
    for (int64_t factor = 2; rest > 1; ++factor)
      while (rest % factor == 0) {
        shape[static_cast<size_t>(random_.between(0, static_cast<int64_t>(rank) - 1))] *= factor;
        rest /= factor;
      }
    return Draft{{}, {x, list(shape)}};
  }

  Maybe draw_slice() {
    const ValueId x = pick(kAny, 1);
    Ints start, size;
    for (const int64_t dim : type(x).shape) {
      start.push_back(random_.chance(40) ? 0 : random_.between(0, dim - 1));
      size.push_back(random_.chance(40) ? dim - start.back()
                                        : random_.between(1, dim - start.back()));
    }
    return Draft{{}, {x, list(start), list(size)}};
  }

  Maybe draw_tile() {
    const ValueId x = pick(kAny, 1);
    Ints multiples;
    for (size_t i = 0; i < type(x).shape.size(); ++i)
      multiples.push_back(random_.chance(60) ? 1 : random_.between(1, 3));
    return Draft{{}, {x, list(multiples)}};
  }

  Maybe draw_transpose() {
    const ValueId x = pick(kAny, 1);
    Ints perms;
    for (int64_t i = 0; i < static_cast<int64_t>(type(x).shape.size()); ++i)
      perms.insert(perms.begin() + random_.between(0, i), i);
    return Draft{Attrs().set(Attr::kPerms, perms), {x}};
  }

  Maybe draw_gather(Op op) {
    const ValueId values = pick(kInts, 3, 3);
    const Shape shape = type(values).shape;
    const int64_t rows = shape[1];
    const int64_t width = op == Op::kGather ? random_dim() : random_.between(1, rows);
    Tensor indices = Tensor::zeros({DType::kInt32, {shape[0], width}});
    for (int64_t n = 0; n < shape[0]; ++n) {
      Ints order;
      for (int64_t i = 0; i < rows; ++i) order.insert(order.begin() + random_.between(0, i), i);
      for (int64_t w = 0; w < width; ++w)
        indices.set(n * width + w, op == Op::kGather ? random_.between(0, rows - 1)
                                                     : order[static_cast<size_t>(w)]);
    }
    std::vector<ValueId> operands{values, leaf(std::move(indices), 50)};
    if (op == Op::kScatter)
      operands.push_back(partner({type(values).dtype, {shape[0], width, shape[2]}}));
    return Draft{{}, operands};
  }

  Maybe draw_resize() {
    const ValueId x = pick({DType::kInt8, DType::kInt8, DType::kInt16}, 4, 4);
    Ints scale, offset, border;
    for (size_t i = 0; i < 2; ++i) {
      const int64_t extent = type(x).shape[i + 1];
      const bool large = random_.chance(15);
      const int64_t n = large ? random_.between(100, 2048) : random_.pick(Ints{1, 2, 2, 3, 4, 5});
      const int64_t d = large ? random_.between(n / 4 + 1, 16 * n - 1)
                              : random_.between(1, std::min<int64_t>(16 * n - 1, 5));
      const int64_t last = (extent - 1) * n;
      int64_t off =
          random_.chance(40) ? 0 : random_.between(-n, std::min(16 * n - 1, last + n - 1));
      int64_t edge = random_.chance(30) ? n - 1 : random_.between(-n, n - 1);
      if (last - off + edge < 0) off = -n;
      const int64_t room = last - off + edge;
      edge -= ((room % d) + d) % d;
      scale.insert(scale.end(), {n, d});
      offset.push_back(off);
      border.push_back(edge);
    }
    return Draft{Attrs().set(Attr::kMode, random_.chance(60) ? kNearest : kBilinear),
                 {x, list(scale), list(offset), list(border)}};
  }

  Maybe draw_cast(ValueId x) {
    std::vector<DType> others = kAny;
    if (real_) {
      others = {DType::kFp32, DType::kFp16,  DType::kFp32, DType::kFp16,
                DType::kInt8, DType::kInt16, DType::kInt32};
    }
    std::erase(others, type(x).dtype);
    return Draft{{}, {x}, random_.pick(others)};
  }

  Maybe draw_rescale() {
    const ValueId x =
        pick({DType::kInt8, DType::kInt16, DType::kInt32, DType::kInt32, DType::kInt48});
    const DType from = type(x).dtype;
    const DType to =
        random_.pick(std::vector{DType::kInt8, DType::kInt8, DType::kInt16, DType::kInt32});
    const bool scale32 = from != DType::kInt48 && random_.chance(75);
    const auto narrow = [](DType dtype) { return dtype == DType::kInt8 || dtype == DType::kInt16; };
    const bool input_unsigned = narrow(from) && narrow(to) && random_.chance(25);
    const bool output_unsigned =
        narrow(from) && narrow(to) && !input_unsigned && random_.chance(25);
    const bool per_channel = !type(x).shape.empty() && random_.chance(45);
    const int64_t channels = per_channel ? type(x).shape.back() : 1;
    // What a multiplier and a shift may be depends on the largest value; mostly they fit, or are
    // extreme.
    int64_t largest = 1;
    for (int64_t i = 0; i < tensor(x).count(); ++i)
      largest = std::max(largest, std::abs(tensor(x).get(i)));
    int64_t bits = 1;
    while (bits < 48 && (int64_t{1} << bits) <= largest) ++bits;
    if (narrow(from))
      bits = std::max<int64_t>(bits, input_unsigned ? dtype_info(from).bits : 2) + 1;
    Ints multiplier, shift;
    const bool extreme = random_.chance(20);
    for (int64_t c = 0; c < channels; ++c) {
      const int64_t top = scale32 ? INT32_MAX : INT16_MAX;
      multiplier.push_back(extreme             ? random_.pick(Ints{0, 1, top, top, top / 2 + 1})
                           : random_.chance(5) ? 0
                                               : random_.between(top / 2 + 1, top));
      const int64_t width = scale32 ? 31 : 15;
      const int64_t least = std::clamp<int64_t>(std::max(bits + 1, bits + width - 31), 2, 62);
      shift.push_back(extreme ? random_.pick(Ints{2, least, 31, 32, 33, 62})
                              : random_.between(least, std::min<int64_t>(
                                                           62, std::max(least, bits + width - 4))));
    }
    const auto zero = [&](DType dtype, bool is_unsigned) {
      if (is_unsigned && dtype == DType::kInt16)
        return constant(dtype, {1}, {random_.chance(50) ? 0 : -32768});
      return zero_point(dtype);
    };
    Attrs attrs;
    attrs.set(Attr::kScale32, scale32).set(Attr::kPerChannel, per_channel);
    attrs.set(Attr::kRoundingMode, random_.between(1, scale32 ? 3 : 2));
    attrs.set(Attr::kInputUnsigned, input_unsigned).set(Attr::kOutputUnsigned, output_unsigned);
    const ValueId m = constant(scale32 ? DType::kInt32 : DType::kInt16, {channels}, multiplier);
    const ValueId s = constant(DType::kInt8, {channels}, shift);
    const ValueId in_zp = zero(from, input_unsigned);
    return Draft{attrs, {x, m, s, in_zp, zero(to, output_unsigned)}};
  }

  /// Every result that nobody reads, some that somebody reads, now and then an input, a constant, a
  /// repeat.
  void choose_outputs() {
    const std::vector<uint32_t> uses = graph_.use_counts();
    std::vector<ValueId> leaves = graph_.inputs;
    for (uint32_t i = 0; i < graph_.values.size(); ++i)
      if (graph_.values[i].is_constant() && graph_.values[i].type.dtype != DType::kShape)
        leaves.push_back({i});
    for (const Node& node : graph_.nodes)
      if (uses[node.output.index] == 0 || random_.chance(12)) graph_.outputs.push_back(node.output);
    if (!leaves.empty() && (graph_.outputs.empty() || random_.chance(4)))
      graph_.outputs.push_back(random_.pick(leaves));
    if (graph_.outputs.empty()) graph_.outputs.push_back(random_leaf(DType::kInt8, {1}, 0));
    if (random_.chance(4)) graph_.outputs.push_back(graph_.outputs.front());
  }

  inline static const std::vector<DType> kInts{DType::kInt8, DType::kInt16, DType::kInt32};
  inline static const std::vector<DType> kAny{DType::kBool, DType::kInt8, DType::kInt16,
                                              DType::kInt32};

  inline static const std::vector<DType> kReals{DType::kFp32, DType::kFp16};
  inline static const std::vector<DType> kCastable{DType::kFp32, DType::kFp16, DType::kInt8,
                                                   DType::kInt16, DType::kInt32};

  Random random_;
  RandomGraphCounts& counts_;
  bool real_;
  std::vector<Op> ops_;
  Graph graph_;
  std::vector<Tensor> tensors_;  ///< data of each value
};

}  // namespace

Tensor random_tensor(Random& random, const TensorType& type) {
  const Spread spread = random_spread(random, type.dtype);
  Tensor tensor = Tensor::zeros(type);
  for (int64_t i = 0; i < tensor.count(); ++i)
    tensor.set(i, random_element(random, type.dtype, spread));
  return tensor;
}

std::vector<Op> random_graph_ops(bool real) {
  std::vector<Op> ops;
  for (const OpInfo& info : all_ops()) ops.push_back(info.op);
  const auto drop = [&](std::initializer_list<Op> list) {
    for (const Op op : list) std::erase(ops, op);
  };
  drop({Op::kFft2d, Op::kRfft2d});
  if (real)
    drop({Op::kArithmeticRightShift, Op::kBitwiseAnd, Op::kBitwiseNot, Op::kBitwiseOr,
          Op::kBitwiseXor, Op::kClz, Op::kIntDiv, Op::kLogicalLeftShift, Op::kLogicalRightShift,
          Op::kRescale, Op::kTable, Op::kLogicalAnd, Op::kLogicalOr, Op::kLogicalXor,
          Op::kLogicalNot, Op::kReduceAll, Op::kReduceAny});
  else
    drop({Op::kCeil, Op::kCos, Op::kErf, Op::kExp, Op::kFloor, Op::kLog, Op::kPow, Op::kReciprocal,
          Op::kReduceProduct, Op::kRsqrt, Op::kSigmoid, Op::kSin, Op::kTanh});
  return ops;
}

RandomGraph random_graph(uint64_t seed, RandomGraphCounts& counts, bool real) {
  return Builder(seed, counts, real).build();
}

}  // namespace shale
