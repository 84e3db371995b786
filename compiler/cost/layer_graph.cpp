// A list of layers as an INT8 TOSA graph.
#include <algorithm>
#include <cmath>

#include "compiler/cost/layers.h"

namespace shale {
namespace {

constexpr uint64_t kMaxGraphParameters = uint64_t{1} << 28;  // they are bytes in memory

/// Builds the INT8 graph; `current_` is the value that the last layer made.
class GraphBuilder {
 public:
  GraphBuilder(const std::string& name, int64_t lr_h, int64_t lr_w) : lr_h_(lr_h), lr_w_(lr_w) {
    graph_.name = name;
  }

  Result<Graph> build(std::span<const Layer> layers) {
    for (size_t i = 0; i < layers.size(); ++i) {
      const std::string where = fmt::format("layers[{}] ({})", i, layers[i].op);
      prefix_ = fmt::format("layer{}", i);
      SHALE_TRY(const Shape shape, shape_at(layers[i].in, layers[i].in_channels, where));
      take(shape);
      SHALE_TRY_VOID(add(layers[i], where));
    }
    if (!current_) return bad_input("layers", "the list is empty");
    graph_.outputs.push_back(*current_);
    return std::move(graph_);
  }

 private:
  const Shape& shape(ValueId id) const { return graph_.value(id).type.shape; }

  Result<Shape> shape_at(const Grid& grid, int64_t channels, const std::string& where) const {
    const int64_t h = lr_h_ * grid.h.num, w = lr_w_ * grid.w.num;
    if (h < 1 || w < 1 || h % grid.h.den != 0 || w % grid.w.den != 0)
      return bad_input(where, "{}x{} pixels do not give a whole number of positions", lr_h_, lr_w_);
    Shape shape{1, h / grid.h.den, w / grid.w.den, channels};
    if (!element_count(shape))
      return unsupported(where, "{} is above {} elements", shape_text(shape), kMaxElements);
    return shape;
  }

  /// Makes `current_` a value of this shape, by further inputs where the layers before do not give
  /// it.
  void take(const Shape& wanted) {
    const auto input = [&](int64_t channels) {
      return graph_.add_input(prefix_ + "/input",
                              {DType::kInt8, {1, wanted[1], wanted[2], channels}});
    };
    if (!current_) {
      current_ = input(wanted[3]);
    } else if (shape(*current_)[1] != wanted[1] || shape(*current_)[2] != wanted[2]) {
      graph_.outputs.push_back(*current_);
      current_ = input(wanted[3]);
    } else if (const int64_t missing = wanted[3] - shape(*current_)[3]; missing > 0) {
      const ValueId side = input(missing);
      current_ = node(Op::kConcat, Attrs().set(Attr::kAxis, 3), {*current_, side}, "concat",
                      {DType::kInt8, wanted});
    } else if (missing < 0) {
      current_ = slice(*current_, 0, wanted[3]);
    }
  }

  Result<void> add(const Layer& layer, const std::string& where) {
    switch (layer.kind) {
      case LayerKind::kConv:
      case LayerKind::kTransposeConv: SHALE_TRY_VOID(add_conv(layer, where)); break;
      case LayerKind::kMaxPool:
      case LayerKind::kAvgPool: SHALE_TRY_VOID(add_pool(layer, where)); break;
      case LayerKind::kUpsample:
        if (!layer.nearest) return no_form(where);
        SHALE_TRY_VOID(add_upsample(layer, where));
        break;
      case LayerKind::kDepthToSpace: SHALE_TRY_VOID(add_depth_to_space(layer, where)); break;
      case LayerKind::kSplit: {
        const ValueId whole = *current_;
        parts_.clear();
        for (const std::string& part : layer.parts)
          parts_.push_back(
              {part, slice(whole, static_cast<int64_t>(parts_.size()) * layer.out_channels,
                           layer.out_channels)});
        current_ = parts_.front().second;
        break;
      }
      case LayerKind::kSoftmax: SHALE_TRY_VOID(add_softmax(layer, where)); break;
      case LayerKind::kWeightedSum: SHALE_TRY_VOID(add_weighted_sum(where)); break;
      case LayerKind::kReduceMax:
        current_ = node(Op::kReduceMax, Attrs().set(Attr::kAxis, 3).set(Attr::kNanMode, 1),
                        {*current_}, "max", {DType::kInt8, with_channels(*current_, 1)});
        break;
      case LayerKind::kReduceSum:
        current_ = to_int8(sum(to_int32(*current_)), 30 + bits(shape(*current_)[3]));
        break;
      case LayerKind::kActivation: break;
      case LayerKind::kBatchNorm:
      case LayerKind::kElementwise: return no_form(where);
    }
    return add_activation(layer, where);
  }

  static Error no_form(const std::string& where) {
    return unsupported(where, "has no INT8 graph; it can only be counted");
  }

  /// Smallest b with 2^b >= count.
  static int64_t bits(int64_t count) {
    int64_t result = 0;
    while ((int64_t{1} << result) < count) ++result;
    return result;
  }

  Shape with_channels(ValueId id, int64_t channels) const {
    Shape result = shape(id);
    result.back() = channels;
    return result;
  }

  ValueId node(Op op, Attrs attrs, std::vector<ValueId> operands, const char* name,
               TensorType type) {
    return graph_.add_node(op, std::move(attrs), std::move(operands), prefix_ + "/" + name,
                           std::move(type));
  }

  ValueId constant(const char* name, DType dtype, const std::vector<int64_t>& values) {
    const Shape list{static_cast<int64_t>(values.size())};
    return graph_.add_constant(prefix_ + "/" + name, Tensor::from_ints({dtype, list}, values));
  }

  /// Small values with a mean near 0, the same in every run.
  ValueId weights(Shape weight_shape) {
    Tensor tensor = Tensor::zeros({DType::kInt8, std::move(weight_shape)});
    for (int64_t i = 0; i < tensor.count(); ++i) tensor.set(i, i * 7 % 15 - 7);
    return graph_.add_constant(prefix_ + "/weights", std::move(tensor));
  }

  /// Without a bias TOSA takes a single zero.
  ValueId bias(const Layer& layer) {
    std::vector<int64_t> values{0};
    if (layer.bias) {
      values.resize(static_cast<size_t>(layer.out_channels));
      for (size_t i = 0; i < values.size(); ++i) values[i] = i % 2 == 0 ? 8 : -8;
    }
    return constant("bias", DType::kInt32, values);
  }

  /// Multiplies by 2^(30 - shift).
  ValueId rescale(ValueId id, DType to, int64_t shift) {
    const Attrs attrs = Attrs()
                            .set(Attr::kScale32, 1)
                            .set(Attr::kRoundingMode, kSingleRound)
                            .set(Attr::kPerChannel, 0)
                            .set(Attr::kInputUnsigned, 0)
                            .set(Attr::kOutputUnsigned, 0);
    const DType from = graph_.value(id).type.dtype;
    return node(Op::kRescale, attrs,
                {id, constant("multiplier", DType::kInt32, {int64_t{1} << 30}),
                 constant("shift", DType::kInt8, {shift}), constant("input_zp", from, {0}),
                 constant("output_zp", to, {0})},
                "rescale", {to, shape(id)});
  }
  ValueId to_int8(ValueId id, int64_t shift) { return rescale(id, DType::kInt8, shift); }
  ValueId to_int32(ValueId id) { return rescale(id, DType::kInt32, 30); }

  /// By channel, int32.
  ValueId sum(ValueId id) {
    return node(Op::kReduceSum, Attrs().set(Attr::kAxis, 3), {id}, "sum",
                {DType::kInt32, with_channels(id, 1)});
  }

  ValueId product(ValueId a, ValueId b) {
    const int64_t channels = std::max(shape(a)[3], shape(b)[3]);
    return node(Op::kMul, {}, {a, b, constant("mul_shift", DType::kInt8, {0})}, "mul",
                {DType::kInt32, with_channels(a, channels)});
  }

  template <typename Function>
  ValueId table(ValueId id, const char* name, Function function) {
    std::vector<int64_t> values;
    for (int64_t i = -128; i < 128; ++i)
      values.push_back(
          std::clamp<int64_t>(std::llround(function(static_cast<double>(i))), -128, 127));
    return node(Op::kTable, {}, {id, constant("table", DType::kInt8, values)}, name,
                {DType::kInt8, shape(id)});
  }

  ValueId slice(ValueId id, int64_t first, int64_t channels) {
    const Shape result = with_channels(id, channels);
    const ValueId start = graph_.add_shape(prefix_ + "/start", {0, 0, 0, first});
    const ValueId size = graph_.add_shape(prefix_ + "/size", result);
    return node(Op::kSlice, {}, {id, start, size}, "slice", {DType::kInt8, result});
  }

  ValueId reshape(ValueId id, const Shape& to) {
    return node(Op::kReshape, {}, {id, graph_.add_shape(prefix_ + "/shape", to)}, "reshape",
                {DType::kInt8, to});
  }

  static Result<std::vector<int64_t>> same_pad(const Layer& layer, const std::string& where) {
    std::vector<int64_t> pad;
    for (size_t axis = 0; axis < 2; ++axis) {
      const int64_t total = layer.kernel[axis] - layer.stride[axis];
      if (total < 0)
        return unsupported(where, "a stride above the kernel size has no INT8 graph here");
      pad.push_back(total / 2);
      pad.push_back(total - total / 2);
    }
    return pad;
  }

  Result<void> add_conv(const Layer& layer, const std::string& where) {
    const int64_t kh = layer.kernel[0], kw = layer.kernel[1], ic = layer.in_channels,
                  oc = layer.out_channels;
    const bool transposed = layer.kind == LayerKind::kTransposeConv;
    const bool depthwise = !transposed && layer.groups > 1 && layer.groups == ic;
    if (layer.groups > 1 && !depthwise) return no_form(where);
    Attrs attrs;
    attrs.set(Attr::kStride, {layer.stride[0], layer.stride[1]}).set(Attr::kLocalBound, 0);
    attrs.set(Attr::kAccType, static_cast<int64_t>(DType::kInt32));
    if (transposed) {
      std::vector<int64_t> pad;
      for (size_t axis = 0; axis < 2; ++axis) {
        const int64_t before = -((layer.kernel[axis] - layer.stride[axis] + 1) / 2);
        pad.push_back(before);
        pad.push_back(layer.stride[axis] - layer.kernel[axis] - before);
      }
      attrs.set(Attr::kOutPad, pad);
    } else {
      SHALE_TRY(std::vector<int64_t> pad, same_pad(layer, where));
      attrs.set(Attr::kPad, std::move(pad)).set(Attr::kDilation, {1, 1});
    }
    SHALE_TRY(const Shape out, shape_at(layer.out, oc, where));
    const ValueId weight = weights(depthwise ? Shape{kh, kw, ic, oc / ic} : Shape{oc, kh, kw, ic});
    const Op op = transposed  ? Op::kTransposeConv2d
                  : depthwise ? Op::kDepthwiseConv2d
                              : Op::kConv2d;
    const ValueId accumulator =
        node(op, attrs,
             {*current_, weight, bias(layer), constant("input_zp", DType::kInt8, {0}),
              constant("weight_zp", DType::kInt8, {0})},
             "conv", {DType::kInt32, out});
    current_ = to_int8(accumulator, 32 + bits(kh * kw * ic / layer.groups));
    return {};
  }

  Result<void> add_pool(const Layer& layer, const std::string& where) {
    SHALE_TRY(std::vector<int64_t> pad, same_pad(layer, where));
    SHALE_TRY(const Shape out, shape_at(layer.out, layer.out_channels, where));
    Attrs attrs;
    attrs.set(Attr::kKernel, {layer.kernel[0], layer.kernel[1]})
        .set(Attr::kStride, {layer.stride[0], layer.stride[1]});
    attrs.set(Attr::kPad, std::move(pad));
    if (layer.kind == LayerKind::kMaxPool) {
      current_ = node(Op::kMaxPool2d, attrs.set(Attr::kNanMode, 1), {*current_}, "max_pool",
                      {DType::kInt8, out});
    } else {
      attrs.set(Attr::kAccType, static_cast<int64_t>(DType::kInt32));
      current_ = node(Op::kAvgPool2d, attrs,
                      {*current_, constant("input_zp", DType::kInt8, {0}),
                       constant("output_zp", DType::kInt8, {0})},
                      "avg_pool", {DType::kInt8, out});
    }
    return {};
  }

  /// Every input element factor x factor times: TOSA rounds to the nearest input, so positions are
  /// shifted by half an output element.
  Result<void> add_upsample(const Layer& layer, const std::string& where) {
    SHALE_TRY(const Shape out, shape_at(layer.out, layer.out_channels, where));
    const int64_t n = 2 * layer.factor, edge = layer.factor - 1;
    const ValueId scale = graph_.add_shape(prefix_ + "/scale", {n, 2, n, 2});
    const ValueId offset = graph_.add_shape(prefix_ + "/offset", {-edge, -edge});
    const ValueId border = graph_.add_shape(prefix_ + "/border", {edge, edge});
    current_ = node(Op::kResize, Attrs().set(Attr::kMode, kNearest),
                    {*current_, scale, offset, border}, "upsample", {DType::kInt8, out});
    return {};
  }

  Result<void> add_depth_to_space(const Layer& layer, const std::string& where) {
    SHALE_TRY(const Shape out, shape_at(layer.out, layer.out_channels, where));
    const Shape& from = shape(*current_);
    const int64_t h = from[1], w = from[2], f = layer.factor, c = layer.out_channels;
    const ValueId split = reshape(*current_, {1, h, w, c, f, f});
    const ValueId turned = node(Op::kTranspose, Attrs().set(Attr::kPerms, {0, 1, 4, 2, 5, 3}),
                                {split}, "transpose", {DType::kInt8, {1, h, f, w, f, c}});
    current_ = reshape(turned, out);
    return {};
  }

  std::optional<ValueId> part(std::string_view name) const {
    const auto found = std::ranges::find(
        parts_, name, [](const auto& entry) -> std::string_view { return entry.first; });
    return found == parts_.end() ? std::nullopt : std::optional(found->second);
  }

  /// exp(x) times the reciprocal of the sum of exp(x), both from tables.
  Result<void> add_softmax(const Layer& layer, const std::string& where) {
    std::optional<ValueId> argument;
    for (const std::string& name : layer.of) {
      const std::optional<ValueId> factor = part(name);
      if (!factor) return bad_input(where, "\"{}\" is no part of the split before", name);
      argument = argument ? to_int8(product(*argument, *factor), 37) : *factor;
    }
    const ValueId x = argument.value_or(*current_);
    const ValueId exps =
        table(x, "exp", [](double value) { return 127 * std::exp((value - 127) / 32); });
    const ValueId total = to_int8(sum(to_int32(exps)), 30 + bits(shape(x)[3]));
    const ValueId reciprocal =
        table(total, "reciprocal", [](double value) { return value < 1 ? 127 : 127 / value; });
    current_ = to_int8(product(exps, reciprocal), 37);
    return {};
  }

  /// The part named "value", else the first one, weighted by the softmax before.
  Result<void> add_weighted_sum(const std::string& where) {
    if (parts_.empty())
      return bad_input(where, "there is no split before that tells what is summed");
    const ValueId value = part("value").value_or(parts_.front().second);
    if (shape(value) != shape(*current_))
      return bad_input(where, "weights {} and values {} differ", shape_text(shape(*current_)),
                       shape_text(shape(value)));
    current_ = to_int8(sum(product(value, *current_)), 37);
    return {};
  }

  Result<void> add_activation(const Layer& layer, const std::string& where) {
    const auto clamp = [&](int64_t high) {
      const Attrs attrs =
          Attrs().set(Attr::kMinVal, 0).set(Attr::kMaxVal, high).set(Attr::kNanMode, 1);
      current_ = node(Op::kClamp, attrs, {*current_}, "relu", {DType::kInt8, shape(*current_)});
    };
    switch (layer.activation) {
      case Activation::kNone: return {};
      case Activation::kRelu: clamp(127); return {};
      case Activation::kRelu6: clamp(96); return {};  // 6 at a scale of 1/16
      case Activation::kTanh:
        current_ =
            table(*current_, "tanh", [](double value) { return 128 * std::tanh(value / 32); });
        return {};
      case Activation::kSigmoid:
        current_ = table(*current_, "sigmoid",
                         [](double value) { return 256 / (1 + std::exp(-value / 16)) - 128; });
        return {};
      default: return no_form(where);
    }
  }

  int64_t lr_h_, lr_w_;
  Graph graph_;
  std::optional<ValueId> current_;
  std::vector<std::pair<std::string, ValueId>> parts_;  ///< of the last split
  std::string prefix_;
};

}  // namespace

Result<Graph> graph_of_layers(const std::string& name, std::span<const Layer> layers, int64_t lr_h,
                              int64_t lr_w) {
  if (lr_h < 1 || lr_w < 1 || lr_h > kMaxLayerSide || lr_w > kMaxLayerSide)
    return bad_input("", "{}x{} pixels, expected 1 to {} a side", lr_h, lr_w, kMaxLayerSide);
  if (const uint64_t count = count_layers(layers).parameters; count > kMaxGraphParameters)
    return unsupported("", "{} parameters, a graph is built for up to {}", count,
                       kMaxGraphParameters);
  return GraphBuilder(name, lr_h, lr_w).build(layers);
}

}  // namespace shale
