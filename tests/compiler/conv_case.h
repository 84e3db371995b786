// tests/compiler/conv_case.h -- convolutions with what may be fused around them, written as a row.
#pragma once

#include <random>
#include <string>
#include <vector>

#include "ir/graph/graph.h"

namespace shale {

/// What stands between the graph input and the convolution.
enum class Source { kPlain, kPad, kConcat, kResize, kPadOfConcatOfResize, kUpsample };

/// What follows the accumulator.
enum class Epilogue {
  kNone,        ///< the accumulator is the result
  kRescale,     ///< one multiplier for all channels
  kPerChannel,  ///< a multiplier a channel, then a clamp
  kTable,       ///< per channel, then a clamp and a table
  kResidual,    ///< rescaled to int32, added to a second graph input, rescaled to int8
  kInt16,       ///< rescaled to int16
  kQuarters,    ///< a fourth of the sum, many of them halfway between two results
  kQuartersDoubleRound,
};

/// One conv2d, or with `multiplier` depthwise_conv2d, in NHWC; extents are those of the convolution's input.
struct ConvCase {
  std::string name;
  int64_t n = 1, h = 5, w = 7, ic = 4, oc = 8;
  int64_t multiplier = 0;  ///< depthwise: output channels of an input channel, oc = ic * multiplier
  int64_t kh = 3, kw = 3;
  int64_t stride_y = 1, stride_x = 1;
  int64_t dilation_y = 1, dilation_x = 1;
  std::vector<int64_t> pad{1, 1, 1, 1};
  int64_t input_zp = 0, weight_zp = 0;
  Source source = Source::kPlain;
  Epilogue epilogue = Epilogue::kPerChannel;
  bool one_bias = false;
  int64_t largest_bias = 20000;
  int64_t weight_min = -128, weight_max = 127;
  int64_t zero_weights = 0;  ///< about how many of a hundred weights are 0
  /// INT8; INT16, with weights of INT8 and accumulators of INT48; FP32 or FP16, whose `epilogue` is a clamp
  /// or none, and whose weights, bias and values to pad with are the integers divided by 64.
  DType dtype = DType::kInt8;

  bool is_real() const { return is_float(dtype); }
  DType accumulator() const {
    return is_real() ? dtype : dtype == DType::kInt16 ? DType::kInt48 : DType::kInt32;
  }
  /// The code of a number of this case.
  int64_t code(DType of, int64_t number) const {
    return is_float(of) ? real_bits(of, static_cast<float>(number) / 64) : number;
  }

  /// Elements of the graph input, where it is one.
  int64_t input_elements() const {
    switch (source) {
      case Source::kPad: return n * (h - 3) * (w - 1) * ic;
      case Source::kResize:
      case Source::kUpsample: return n * (h / 2) * (w / 3) * ic;
      default: return n * h * w * ic;
    }
  }

  friend void PrintTo(const ConvCase& c, std::ostream* out) { *out << c.name; }

  Graph graph() const {
    Graph g;
    std::mt19937_64 random(static_cast<uint64_t>(((h * 31 + w) * 31 + ic) * 31 + oc));
    const auto draw = [&](int64_t min, int64_t max) {
      return min + static_cast<int64_t>(random() % static_cast<uint64_t>(max - min + 1));
    };
    const auto tensor = [&](DType of, Shape shape, int64_t min, int64_t max) {
      Tensor t = Tensor::zeros({of, std::move(shape)});
      for (int64_t i = 0; i < t.count(); ++i) t.set(i, code(of, draw(min, max)));
      return t;
    };
    const auto scalar = [&](const char* label, DType of, int64_t value) {
      return g.add_constant(label, Tensor::from_ints({of, {1}}, std::vector<int64_t>{value}));
    };
    const ValueId x = conv_input(g);
    const bool is_depthwise = multiplier > 0;
    const DType weight_dtype = is_real() ? dtype : DType::kInt8;
    Tensor weights =
        tensor(weight_dtype, is_depthwise ? Shape{kh, kw, ic, multiplier} : Shape{oc, kh, kw, ic},
               weight_min, weight_max);
    for (int64_t i = 0; i < weights.count(); ++i)
      if (draw(0, 99) < zero_weights) weights.set(i, 0);
    const ValueId weight = g.add_constant("w", std::move(weights));
    const ValueId bias = g.add_constant(
        "b", tensor(accumulator(), {one_bias ? 1 : oc}, -largest_bias, largest_bias));
    const ValueId zp = scalar("zp", dtype, input_zp), wzp = scalar("wzp", weight_dtype, weight_zp);
    Attrs attrs;
    attrs.set(Attr::kPad, pad).set(Attr::kStride, std::vector<int64_t>{stride_y, stride_x});
    attrs.set(Attr::kDilation, std::vector<int64_t>{dilation_y, dilation_x});
    attrs.set(Attr::kLocalBound, 0)
        .set(Attr::kAccType, static_cast<int64_t>(is_real() ? DType::kFp32 : accumulator()));
    const int64_t oh = (h - 1 + pad[0] + pad[1] - (kh - 1) * dilation_y) / stride_y + 1;
    const int64_t ow = (w - 1 + pad[2] + pad[3] - (kw - 1) * dilation_x) / stride_x + 1;
    const Shape out{n, oh, ow, oc};
    ValueId last = g.add_node(is_depthwise ? Op::kDepthwiseConv2d : Op::kConv2d, attrs,
                              {x, weight, bias, zp, wzp}, "acc", {accumulator(), out});

    const auto rescale = [&](ValueId from, DType to, bool per_channel, int64_t low_shift,
                             int64_t high_shift, int64_t out_zp, int64_t least_multiplier = 1 << 30,
                             int64_t most_multiplier = INT32_MAX, int64_t rounding = kSingleRound) {
      const int64_t channels = per_channel ? oc : 1;
      const DType in = g.value(from).type.dtype;
      // INT48 takes multipliers of 16 bits, for the same product.
      const bool is_short = in == DType::kInt48;
      const ValueId m = g.add_constant(
          "m", is_short ? tensor(DType::kInt16, {channels}, least_multiplier >> 16,
                                 most_multiplier >> 16)
                        : tensor(DType::kInt32, {channels}, least_multiplier, most_multiplier));
      const int64_t shorter = is_short ? 16 : 0;
      const ValueId s = g.add_constant(
          "s", tensor(DType::kInt8, {channels}, low_shift - shorter, high_shift - shorter));
      const ValueId in_zero = scalar("z", in, 0), out_zero = scalar("oz", to, out_zp);
      Attrs a;
      a.set(Attr::kScale32, is_short ? 0 : 1)
          .set(Attr::kRoundingMode, rounding)
          .set(Attr::kPerChannel, per_channel);
      a.set(Attr::kInputUnsigned, 0).set(Attr::kOutputUnsigned, 0);
      return g.add_node(Op::kRescale, a, {from, m, s, in_zero, out_zero}, "q", {to, out});
    };
    const auto clamp = [&](ValueId from, int64_t low, int64_t high) {
      Attrs a;
      a.set(Attr::kMinVal, low).set(Attr::kMaxVal, high).set(Attr::kNanMode, 1);
      return g.add_node(Op::kClamp, a, {from}, "clamped", g.value(from).type);
    };
    if (is_real()) {
      if (epilogue != Epilogue::kNone) last = clamp(last, code(dtype, -120), code(dtype, 100000));
      g.outputs = {last};
      return g;
    }
    switch (epilogue) {
      case Epilogue::kNone: break;
      case Epilogue::kRescale: last = rescale(last, DType::kInt8, false, 38, 42, -7); break;
      case Epilogue::kPerChannel:
        last = clamp(rescale(last, DType::kInt8, true, 36, 42, -128), -120, 100);
        break;
      case Epilogue::kTable: {
        last = clamp(rescale(last, DType::kInt8, true, 36, 42, 3), -100, 127);
        const ValueId table = g.add_constant("table", tensor(DType::kInt8, {256}, -128, 127));
        last = g.add_node(Op::kTable, {}, {last, table}, "looked_up", {DType::kInt8, out});
        break;
      }
      case Epilogue::kResidual: {
        last = rescale(last, DType::kInt32, true, 34, 36, 0);
        const ValueId other =
            rescale(g.add_input("skip", {DType::kInt8, out}), DType::kInt32, false, 24, 24, 0);
        last = g.add_node(Op::kAdd, {}, {last, other}, "sum", {DType::kInt32, out});
        last = clamp(rescale(last, DType::kInt8, false, 38, 38, 1), -128, 90);
        break;
      }
      case Epilogue::kInt16: last = rescale(last, DType::kInt16, true, 33, 36, 0); break;
      case Epilogue::kQuarters:
        last = rescale(last, DType::kInt8, true, 32, 32, -7, 1 << 30, 1 << 30);
        break;
      case Epilogue::kQuartersDoubleRound:
        last = rescale(last, DType::kInt8, true, 32, 32, -7, 1 << 30, 1 << 30, kDoubleRound);
        break;
    }
    g.outputs = {last};
    return g;
  }

 private:
  ValueId conv_input(Graph& g) const {
    const auto pad_node = [&](ValueId from) {
      Shape shape = g.value(from).type.shape;
      shape[1] += 3;
      shape[2] += 1;
      const ValueId padding = g.add_shape("padding", {0, 0, 1, 2, 1, 0, 0, 0});
      const ValueId value = g.add_constant(
          "pad_value", Tensor::from_ints({dtype, {1}}, std::vector<int64_t>{code(dtype, -77)}));
      return g.add_node(Op::kPad, {}, {from, padding, value}, "padded", {dtype, shape});
    };
    // By 2 and 3; centred texels are repeated in blocks.
    const auto resize_node = [&](ValueId from, bool is_centred = false) {
      Shape shape = g.value(from).type.shape;
      shape[1] *= 2;
      shape[2] *= 3;
      const ValueId scale = g.add_shape("scale", is_centred ? std::vector<int64_t>{4, 2, 6, 2}
                                                            : std::vector<int64_t>{2, 1, 3, 1}),
                    offset = g.add_shape("offset", is_centred ? std::vector<int64_t>{-1, -2}
                                                              : std::vector<int64_t>{0, 0});
      const ValueId border = g.add_shape("border", {1, 2});
      return g.add_node(Op::kResize, Attrs().set(Attr::kMode, kNearest),
                        {from, scale, offset, border}, "resized", {dtype, shape});
    };
    const auto concat_node = [&](const std::vector<ValueId>& parts) {
      Shape shape = g.value(parts[0]).type.shape;
      shape[3] = 0;
      for (const ValueId part : parts) shape[3] += g.value(part).type.shape[3];
      return g.add_node(Op::kConcat, Attrs().set(Attr::kAxis, 3), parts, "joined", {dtype, shape});
    };
    const auto input = [&](const char* label, int64_t height, int64_t width, int64_t channels) {
      return g.add_input(label, {dtype, {n, height, width, channels}});
    };
    switch (source) {
      case Source::kPlain: return input("x", h, w, ic);
      case Source::kPad: return pad_node(input("x", h - 3, w - 1, ic));
      case Source::kConcat:
        return concat_node({input("x", h, w, ic / 2), input("x2", h, w, ic - ic / 2)});
      case Source::kResize: return resize_node(input("x", h / 2, w / 3, ic));
      case Source::kUpsample: return resize_node(input("x", h / 2, w / 3, ic), true);
      case Source::kPadOfConcatOfResize: {
        const ValueId small = resize_node(input("x", (h - 3) / 2, (w - 1) / 3, ic / 2));
        return pad_node(concat_node({small, input("x2", h - 3, w - 1, ic - ic / 2)}));
      }
    }
    return {};
  }
};

/// Convolutions at the edges of what the kernels distinguish.
inline std::vector<ConvCase> edge_conv_cases() {
  std::vector<ConvCase> cases;
  for (const int64_t ic : {1, 3, 4, 5, 8})
    cases.push_back({.name = "ic" + std::to_string(ic), .ic = ic});
  for (const int64_t oc : {1, 2, 5, 16, 17, 40})
    cases.push_back({.name = "oc" + std::to_string(oc), .oc = oc});
  for (const int64_t zp : {-128, 0, 127}) {
    cases.push_back({.name = "zp" + std::to_string(zp), .input_zp = zp});
    cases.push_back(
        {.name = "zp" + std::to_string(zp) + "_not_padded", .pad = {0, 0, 0, 0}, .input_zp = zp});
    cases.push_back({.name = "zp_of_weights" + std::to_string(zp), .input_zp = 9, .weight_zp = zp});
  }
  cases.push_back({.name = "one_by_one", .kh = 1, .kw = 1, .pad = {0, 0, 0, 0}});
  cases.push_back({.name = "one_pixel",
                   .h = 1,
                   .w = 1,
                   .ic = 1,
                   .oc = 1,
                   .kh = 1,
                   .kw = 1,
                   .pad = {0, 0, 0, 0}});
  cases.push_back({.name = "one_pixel_padded", .h = 1, .w = 1, .pad = {1, 1, 1, 1}, .input_zp = 5});
  cases.push_back({.name = "one_row", .h = 1, .w = 130, .kh = 1, .kw = 5, .pad = {0, 0, 2, 2}});
  cases.push_back({.name = "one_column", .h = 70, .w = 1, .kh = 5, .kw = 1, .pad = {2, 2, 0, 0}});
  cases.push_back({.name = "width_of_a_workgroup", .h = 2, .w = 64});
  cases.push_back({.name = "width_past_a_workgroup", .h = 2, .w = 65});
  cases.push_back({.name = "whole_image", .h = 5, .w = 7, .kh = 5, .kw = 7, .pad = {0, 0, 0, 0}});
  cases.push_back({.name = "kernel_in_the_padding",
                   .h = 2,
                   .w = 2,
                   .kh = 3,
                   .kw = 3,
                   .pad = {4, 3, 5, 4},
                   .input_zp = -3});
  cases.push_back(
      {.name = "stride2", .h = 6, .w = 8, .stride_y = 2, .stride_x = 2, .pad = {0, 1, 1, 0}});
  cases.push_back({.name = "stride_y3_x1", .h = 10, .w = 5, .stride_y = 3, .pad = {1, 1, 1, 1}});
  cases.push_back({.name = "stride_past_the_kernel",
                   .h = 9,
                   .w = 9,
                   .kh = 1,
                   .kw = 1,
                   .stride_y = 4,
                   .stride_x = 8,
                   .pad = {0, 0, 0, 0}});
  cases.push_back(
      {.name = "dilation", .h = 9, .w = 9, .dilation_y = 2, .dilation_x = 3, .pad = {2, 2, 3, 3}});
  cases.push_back({.name = "dilation_and_stride",
                   .h = 9,
                   .w = 8,
                   .stride_y = 2,
                   .dilation_y = 3,
                   .dilation_x = 2,
                   .pad = {2, 2, 0, 1},
                   .input_zp = 4});
  cases.push_back({.name = "asymmetric_pads", .pad = {0, 2, 3, 1}, .input_zp = -100});
  cases.push_back({.name = "even_kernel", .kh = 2, .kw = 4, .pad = {1, 0, 2, 1}});
  cases.push_back({.name = "batch2", .n = 2});
  cases.push_back({.name = "batch3_ic3", .n = 3, .ic = 3, .oc = 5});
  cases.push_back({.name = "one_bias", .one_bias = true});
  cases.push_back({.name = "accumulator_out", .epilogue = Epilogue::kNone});
  cases.push_back({.name = "accumulator_out_oc5", .oc = 5, .epilogue = Epilogue::kNone});
  cases.push_back({.name = "one_multiplier", .epilogue = Epilogue::kRescale});
  cases.push_back({.name = "table", .epilogue = Epilogue::kTable});
  cases.push_back({.name = "table_oc17", .oc = 17, .epilogue = Epilogue::kTable});
  cases.push_back({.name = "residual", .epilogue = Epilogue::kResidual});
  cases.push_back({.name = "residual_oc5", .oc = 5, .epilogue = Epilogue::kResidual});
  cases.push_back({.name = "int16_out", .epilogue = Epilogue::kInt16});
  cases.push_back({.name = "pad_folded", .h = 8, .input_zp = -77, .source = Source::kPad});
  cases.push_back(
      {.name = "pad_folded_other_value", .h = 8, .input_zp = 30, .source = Source::kPad});
  cases.push_back({.name = "concat_folded", .ic = 8, .source = Source::kConcat});
  cases.push_back({.name = "concat_folded_odd", .ic = 7, .source = Source::kConcat});
  cases.push_back(
      {.name = "resize_folded", .h = 6, .w = 9, .input_zp = 2, .source = Source::kResize});
  cases.push_back(
      {.name = "resize_folded_ic3", .h = 6, .w = 9, .ic = 3, .source = Source::kResize});
  cases.push_back({.name = "pad_of_concat_of_resize",
                   .n = 2,
                   .h = 7,
                   .w = 10,
                   .ic = 8,
                   .input_zp = -128,
                   .source = Source::kPadOfConcatOfResize});
  cases.push_back({.name = "pad_of_concat_of_resize_odd",
                   .h = 7,
                   .w = 10,
                   .ic = 5,
                   .oc = 17,
                   .source = Source::kPadOfConcatOfResize,
                   .epilogue = Epilogue::kTable});
  cases.push_back({.name = "upsampled", .h = 6, .w = 9, .ic = 16, .source = Source::kUpsample});
  cases.push_back({.name = "upsampled_padded_far",
                   .n = 2,
                   .h = 4,
                   .w = 6,
                   .oc = 17,
                   .kh = 4,
                   .pad = {3, 1, 2, 0},
                   .input_zp = -128,
                   .source = Source::kUpsample});
  cases.push_back({.name = "upsampled_ic3_oc4",
                   .h = 2,
                   .w = 3,
                   .ic = 3,
                   .oc = 4,
                   .input_zp = 40,
                   .source = Source::kUpsample,
                   .epilogue = Epilogue::kTable});
  // Rounding, above and below 0.
  for (const bool double_round : {false, true})
    cases.push_back(
        {.name = double_round ? "quarters_double_round" : "quarters",
         .input_zp = 3,
         .epilogue = double_round ? Epilogue::kQuartersDoubleRound : Epilogue::kQuarters,
         .largest_bias = 100,
         .weight_min = -1,
         .weight_max = 1});
  // A bias that leaves no room for the scaled sum in a double.
  cases.push_back({.name = "large_bias", .oc = 17, .largest_bias = 50000000});
  // Fetches of 16 channels, and stores of as many.
  cases.push_back({.name = "ic16_oc32",
                   .h = 6,
                   .w = 66,
                   .ic = 16,
                   .oc = 32,
                   .input_zp = -128,
                   .zero_weights = 75});
  cases.push_back({.name = "ic32_of_concat",
                   .n = 2,
                   .ic = 32,
                   .oc = 20,
                   .input_zp = -128,
                   .source = Source::kConcat,
                   .epilogue = Epilogue::kTable,
                   .weight_min = -30,
                   .weight_max = 30});
  // Texels that begin within words, of tensors of whole words: also the last bytes of the last word, and not.
  for (const int64_t ic : {2, 3, 5, 6, 7, 22})
    cases.push_back({.name = "within_words_ic" + std::to_string(ic),
                     .n = 2,
                     .w = 8,
                     .ic = ic,
                     .input_zp = -128});
  cases.push_back({.name = "within_words_padded",
                   .h = 8,
                   .w = 9,
                   .ic = 6,
                   .input_zp = 30,
                   .source = Source::kPad});
  cases.push_back({.name = "within_words_upsampled",
                   .h = 8,
                   .w = 12,
                   .ic = 3,
                   .input_zp = 2,
                   .source = Source::kUpsample});
  cases.push_back(
      {.name = "within_words_resized", .h = 8, .w = 6, .ic = 5, .source = Source::kResize});
  cases.push_back({.name = "within_words_looped_rows",
                   .h = 197,
                   .w = 12,
                   .ic = 7,
                   .oc = 17,
                   .input_zp = 5,
                   .epilogue = Epilogue::kTable});
  // Winograd's sums of two tiles fit a double in parts of the channels, or not even so.
  cases.push_back({.name = "winograd_in_parts", .ic = 64, .oc = 1});
  cases.push_back({.name = "winograd_in_two_parts", .ic = 24, .oc = 21, .input_zp = -128});
  cases.push_back({.name = "beyond_winograd", .ic = 128, .oc = 1});
  // So high that an invocation goes over several rows, the last one over fewer.
  cases.push_back(
      {.name = "looped_rows", .h = 197, .w = 9, .ic = 32, .oc = 40, .zero_weights = 85});
  cases.push_back({.name = "looped_rows_of_batch",
                   .n = 3,
                   .h = 70,
                   .w = 70,
                   .oc = 5,
                   .input_zp = -128,
                   .source = Source::kPad});
  cases.push_back({.name = "looped_rows_stride_and_dilation",
                   .h = 211,
                   .w = 5,
                   .ic = 3,
                   .stride_y = 2,
                   .dilation_y = 2,
                   .pad = {3, 1, 0, 2},
                   .input_zp = 17});
  cases.push_back({.name = "looped_rows_upsampled",
                   .h = 200,
                   .w = 6,
                   .ic = 8,
                   .oc = 17,
                   .input_zp = -3,
                   .source = Source::kUpsample});
  // Few channels: an invocation makes a tile of pixels, which overlap by stride and dilation.
  cases.push_back({.name = "tile_oc1_stride2",
                   .h = 11,
                   .w = 13,
                   .oc = 1,
                   .stride_y = 2,
                   .stride_x = 2,
                   .input_zp = -5});
  cases.push_back({.name = "tile_oc2_dilation",
                   .h = 7,
                   .w = 12,
                   .oc = 2,
                   .dilation_y = 3,
                   .dilation_x = 2,
                   .pad = {3, 3, 2, 2}});
  cases.push_back({.name = "tile_oc3_stride_and_dilation",
                   .h = 10,
                   .w = 9,
                   .oc = 3,
                   .stride_y = 3,
                   .stride_x = 2,
                   .dilation_y = 2,
                   .pad = {0, 1, 1, 1}});
  cases.push_back({.name = "tile_oc4_past_the_kernel",
                   .h = 9,
                   .w = 11,
                   .oc = 4,
                   .kh = 1,
                   .kw = 2,
                   .stride_y = 4,
                   .stride_x = 3,
                   .pad = {0, 0, 0, 0},
                   .epilogue = Epilogue::kTable});
  cases.push_back({.name = "tile_oc2_one_pixel",
                   .h = 1,
                   .w = 1,
                   .oc = 2,
                   .stride_y = 8192,
                   .stride_x = 8192,
                   .epilogue = Epilogue::kResidual});
  // More output channels than a module holds; zeros keep the modules small.
  cases.push_back(
      {.name = "several_modules", .h = 2, .w = 3, .ic = 36, .oc = 40, .zero_weights = 95});
  // Products that leave the room of one tile of two in a double, and the integers that float32 holds.
  for (const int64_t ic : {300, 1028})
    cases.push_back({.name = ic == 300 ? "beyond_pair" : "beyond_float",
                     .h = 1,
                     .w = 2,
                     .ic = ic,
                     .oc = 1,
                     .kh = 1,
                     .kw = 1,
                     .pad = {0, 0, 0, 0},
                     .epilogue = Epilogue::kNone,
                     .weight_min = -128,
                     .weight_max = -128});
  return cases;
}

/// The same of depthwise convolutions: what a pass reads begins and ends between texels.
inline std::vector<ConvCase> edge_depthwise_cases() {
  std::vector<ConvCase> cases;
  for (const int64_t ic : {1, 3, 4, 16, 20, 48})
    cases.push_back(
        {.name = "depthwise_ic" + std::to_string(ic), .ic = ic, .oc = ic, .multiplier = 1});
  cases.push_back(
      {.name = "depthwise_multiplier3", .ic = 12, .oc = 36, .multiplier = 3, .input_zp = -7});
  cases.push_back({.name = "depthwise_stride2",
                   .n = 2,
                   .h = 10,
                   .w = 12,
                   .ic = 40,
                   .oc = 40,
                   .multiplier = 1,
                   .stride_y = 2,
                   .stride_x = 2,
                   .pad = {0, 1, 0, 1},
                   .input_zp = -128,
                   .epilogue = Epilogue::kTable});
  cases.push_back({.name = "depthwise_5x5_looped_rows",
                   .h = 150,
                   .w = 9,
                   .ic = 36,
                   .oc = 36,
                   .multiplier = 1,
                   .kh = 5,
                   .kw = 5,
                   .pad = {2, 2, 2, 2},
                   .input_zp = 4,
                   .weight_zp = 3});
  cases.push_back({.name = "depthwise_of_concat",
                   .h = 7,
                   .w = 10,
                   .ic = 8,
                   .oc = 16,
                   .multiplier = 2,
                   .source = Source::kPadOfConcatOfResize});
  cases.push_back({.name = "depthwise_upsampled",
                   .h = 6,
                   .w = 9,
                   .ic = 24,
                   .oc = 24,
                   .multiplier = 1,
                   .source = Source::kUpsample});
  return cases;
}

/// All of them in a type. Others than INT8 have no zero points, and of the epilogues those to the type itself.
inline std::vector<ConvCase> edge_cases_of(DType dtype) {
  std::vector<ConvCase> cases = edge_conv_cases();
  for (const ConvCase& row : edge_depthwise_cases()) cases.push_back(row);
  if (dtype == DType::kInt8) return cases;
  std::erase_if(cases, [](const ConvCase& row) { return row.name.starts_with("zp"); });
  for (ConvCase& row : cases) {
    row.dtype = dtype;
    row.name += "_" + std::string(dtype_info(dtype).name);
    row.input_zp = row.weight_zp = 0;
    if (row.epilogue != Epilogue::kNone) row.epilogue = Epilogue::kInt16;
  }
  return cases;
}

}  // namespace shale
