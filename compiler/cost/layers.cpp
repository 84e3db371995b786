#include "compiler/cost/layers.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>

namespace shale {
namespace {

using Json = nlohmann::json;

// Bounds that keep every sum below 2^63; no published network comes near them.
constexpr int64_t kMaxWindow = 1024, kMaxStep = 64, kMaxChannels = 65536, kMaxLayers = 1024,
                  kMaxRatioTerm = 1 << 20;
constexpr int64_t kMaxSide = 16384;
constexpr uint64_t kMaxGraphParameters = uint64_t{1} << 28;  // they are bytes in memory
constexpr size_t kMaxRows = 10000, kMaxParts = 16;

struct LayerName {
  std::string_view name;  ///< in lower case, without '_' and '-'
  LayerKind kind;
};
constexpr LayerName kLayerNames[] = {
    {"conv2d", LayerKind::kConv},
    {"conv", LayerKind::kConv},
    {"depthwiseconv2d", LayerKind::kConv},
    {"transposeconv2d", LayerKind::kTransposeConv},
    {"transposedconv2d", LayerKind::kTransposeConv},
    {"transposeconv", LayerKind::kTransposeConv},
    {"convtranspose2d", LayerKind::kTransposeConv},
    {"convtranspose", LayerKind::kTransposeConv},
    {"deconv2d", LayerKind::kTransposeConv},
    {"deconv", LayerKind::kTransposeConv},
    {"batchnorm2d", LayerKind::kBatchNorm},
    {"batchnorm", LayerKind::kBatchNorm},
    {"bn", LayerKind::kBatchNorm},
    {"maxpool2d", LayerKind::kMaxPool},
    {"maxpool", LayerKind::kMaxPool},
    {"avgpool2d", LayerKind::kAvgPool},
    {"avgpool", LayerKind::kAvgPool},
    {"averagepool2d", LayerKind::kAvgPool},
    {"upsample", LayerKind::kUpsample},
    {"resize", LayerKind::kUpsample},
    {"depthtospace", LayerKind::kDepthToSpace},
    {"pixelshuffle", LayerKind::kDepthToSpace},
    {"split", LayerKind::kSplit},
    {"chunk", LayerKind::kSplit},
    {"softmaxof", LayerKind::kSoftmax},
    {"softmax", LayerKind::kSoftmax},
    {"weightedsum", LayerKind::kWeightedSum},
    {"reducemax", LayerKind::kReduceMax},
    {"max", LayerKind::kReduceMax},
    {"reducesum", LayerKind::kReduceSum},
    {"sum", LayerKind::kReduceSum},
    {"add", LayerKind::kElementwise},
    {"mul", LayerKind::kElementwise},
    {"multiply", LayerKind::kElementwise},
    {"product", LayerKind::kElementwise},
    {"concat", LayerKind::kElementwise},
};

struct ActivationName {
  std::string_view name;
  Activation activation;
};
constexpr ActivationName kActivationNames[] = {
    {"relu", Activation::kRelu},           {"relu6", Activation::kRelu6},
    {"leakyrelu", Activation::kLeakyRelu}, {"elu", Activation::kElu},
    {"prelu", Activation::kPrelu},         {"tanh", Activation::kTanh},
    {"sigmoid", Activation::kSigmoid},
};

/// "Conv_Transpose2d" and "convtranspose2d" are the same word.
std::string plain_name(const std::string& name) {
  std::string plain;
  for (const char c : name)
    if (c != '_' && c != '-' && c != ' ')
      plain += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return plain;
}

template <typename Row>
const Row* find_name(std::span<const Row> rows, std::string_view name) {
  const auto row = std::ranges::find(rows, name, &Row::name);
  return row == rows.end() ? nullptr : &*row;
}

/// A JSON object with the place that messages name it by. A field that is null counts as absent.
class Fields {
 public:
  Fields(const Json& json, std::string where) : json_(json), where_(std::move(where)) {}

  const std::string& where() const { return where_; }
  const Json* find(const char* key) const {
    const auto found = json_.find(key);
    return found == json_.end() || found->is_null() ? nullptr : &*found;
  }

  Result<std::string> text(const char* key, std::optional<std::string> absent = {}) const {
    const Json* field = find(key);
    if (!field && absent) return *absent;
    if (!field || !field->is_string()) return bad_input(where_, "\"{}\" must be a text", key);
    return field->get<std::string>();
  }

  Result<bool> flag(const char* key, bool absent) const {
    const Json* field = find(key);
    if (!field) return absent;
    if (!field->is_boolean()) return bad_input(where_, "\"{}\" must be true or false", key);
    return field->get<bool>();
  }

  Result<double> number(const char* key, double absent) const {
    const Json* field = find(key);
    if (!field) return absent;
    const double value = field->is_number() ? field->get<double>() : -1;
    if (!(value >= 0 && value <= 1e15))
      return bad_input(where_, "\"{}\" must be a number of at least 0", key);
    return value;
  }

  Result<int64_t> integer(const char* key, int64_t high, std::optional<int64_t> absent = {}) const {
    const Json* field = find(key);
    if (!field && absent) return *absent;
    if (!field) return bad_input(where_, "\"{}\" is missing", key);
    return integer_of(*field, key, high);
  }

  /// A number, or [h,w].
  Result<void> pair(const char* key, int64_t high, std::optional<int64_t> absent,
                    int64_t (&out)[2]) const {
    const Json* field = find(key);
    if (field && field->is_array()) {
      if (field->size() != 2) return bad_input(where_, "\"{}\" must be a number or [h,w]", key);
      for (size_t i = 0; i < 2; ++i) {
        SHALE_TRY(out[i], integer_of((*field)[i], key, high));
      }
      return {};
    }
    SHALE_TRY(out[0], integer(key, high, absent));
    out[1] = out[0];
    return {};
  }

 private:
  Result<int64_t> integer_of(const Json& field, const char* key, int64_t high) const {
    if (!field.is_number_integer()) return bad_input(where_, "\"{}\" must be an integer", key);
    const bool huge =
        field.is_number_unsigned() && field.get<uint64_t>() > static_cast<uint64_t>(high);
    const int64_t value = huge ? 0 : field.get<int64_t>();
    if (huge || value < 1 || value > high)
      return bad_input(where_, "\"{}\" must be 1 to {}", key, high);
    return value;
  }

  const Json& json_;
  std::string where_;
};

Ratio reduced(int64_t num, int64_t den) {
  const int64_t divisor = std::gcd(num, den);
  return {num / divisor, den / divisor};
}

Grid scaled(const Grid& grid, const int64_t (&num)[2], const int64_t (&den)[2]) {
  return {reduced(grid.h.num * num[0], grid.h.den * den[0]),
          reduced(grid.w.num * num[1], grid.w.den * den[1])};
}

/// Reads one layer after another, keeping track of grid and channels.
class LayerReader {
 public:
  LayerReader(int64_t scale, int64_t channels) : scale_(scale), channels_(channels) {}

  Result<Layer> read(const Json& json, const std::string& list, size_t index) {
    const std::string number = fmt::format("{}[{}]", list, index);
    if (!json.is_object()) return bad_input(number, "a layer must be an object");
    SHALE_TRY(const std::string op, Fields(json, number).text("op"));
    const Fields fields(json, fmt::format("{} ({})", number, op));
    Layer layer;
    layer.op = op;
    SHALE_TRY_VOID(read_kind(fields, layer));
    SHALE_TRY_VOID(read_sizes(fields, layer));
    SHALE_TRY_VOID(read_channels(fields, layer));
    SHALE_TRY_VOID(place(fields, layer));
    grid_ = layer.out;
    channels_ = layer.out_channels;
    return layer;
  }

 private:
  static bool is_conv(const Layer& layer) {
    return layer.kind == LayerKind::kConv || layer.kind == LayerKind::kTransposeConv;
  }

  static Result<void> read_kind(const Fields& fields, Layer& layer) {
    const std::string name = plain_name(layer.op);
    if (const auto* known = find_name<LayerName>(kLayerNames, name)) {
      layer.kind = known->kind;
    } else if (const auto* activation = find_name<ActivationName>(kActivationNames, name)) {
      layer.kind = LayerKind::kActivation;
      layer.activation = activation->activation;
      return {};
    } else {
      return unsupported(fields.where(), "\"{}\" is no operator that can be counted", layer.op);
    }
    SHALE_TRY(const std::string act, fields.text("act", "none"));
    const std::string plain = plain_name(act);
    if (plain == "none" || plain == "linear" || plain == "identity") return {};
    const auto* activation = find_name<ActivationName>(kActivationNames, plain);
    if (!activation)
      return unsupported(fields.where(), "\"{}\" is no activation that can be counted", act);
    layer.activation = activation->activation;
    return {};
  }

  static Result<void> read_sizes(const Fields& fields, Layer& layer) {
    switch (layer.kind) {
      case LayerKind::kConv:
      case LayerKind::kTransposeConv: {
        SHALE_TRY_VOID(fields.pair("k", kMaxWindow, {}, layer.kernel));
        SHALE_TRY_VOID(fields.pair("stride", kMaxStep, 1, layer.stride));
        SHALE_TRY(layer.bias, fields.flag("bias", true));
        return {};
      }
      case LayerKind::kMaxPool:
      case LayerKind::kAvgPool:
        SHALE_TRY_VOID(fields.pair("k", kMaxStep, {}, layer.kernel));
        std::ranges::copy(layer.kernel, layer.stride);
        if (fields.find("stride"))
          SHALE_TRY_VOID(fields.pair("stride", kMaxStep, {}, layer.stride));
        return {};
      case LayerKind::kUpsample: {
        SHALE_TRY(const std::string mode, fields.text("mode", "nearest"));
        if (mode != "nearest" && mode != "bilinear" && mode != "bicubic")
          return unsupported(fields.where(), "\"{}\" is no mode of upsampling that can be counted",
                             mode);
        layer.nearest = mode == "nearest";
        SHALE_TRY(layer.factor, fields.integer("factor", kMaxStep));
        return {};
      }
      case LayerKind::kDepthToSpace: {
        SHALE_TRY(layer.factor, fields.integer("factor", kMaxStep));
        return {};
      }
      case LayerKind::kBatchNorm: {
        SHALE_TRY(layer.affine, fields.flag("affine", true));
        return {};
      }
      case LayerKind::kSplit: return read_parts(fields, layer);
      case LayerKind::kSoftmax: {
        SHALE_TRY(const std::string product, fields.text("arg", ""));
        for (size_t start = 0; start < product.size();) {
          const size_t end = std::min(product.find('*', start), product.size());
          std::string name = product.substr(start, end - start);
          std::erase(name, ' ');
          if (name.empty() || layer.of.size() == kMaxParts)
            return bad_input(fields.where(), "\"arg\" is \"{}\", expected names joined by *",
                             product);
          layer.of.push_back(std::move(name));
          start = end + 1;
        }
        return {};
      }
      default: return {};
    }
  }

  static Result<void> read_parts(const Fields& fields, Layer& layer) {
    const Json* parts = fields.find("parts");
    const Error error =
        bad_input(fields.where(), "\"parts\" must be a list of 1 to {} names", kMaxParts);
    if (!parts || !parts->is_array() || parts->empty() || parts->size() > kMaxParts) return error;
    for (const Json& part : *parts) {
      if (!part.is_string()) return error;
      layer.parts.push_back(part.get<std::string>());
    }
    return {};
  }

  Result<void> read_channels(const Fields& fields, Layer& layer) const {
    const char* const key = is_conv(layer) ? "cin" : "channels";
    layer.in_channels = channels_;
    if (channels_ < 1 || fields.find(key)) {
      SHALE_TRY(layer.in_channels, fields.integer(key, kMaxChannels));
    }
    const int64_t in = layer.in_channels;
    int64_t divisor = 1;
    switch (layer.kind) {
      case LayerKind::kConv:
      case LayerKind::kTransposeConv: {
        SHALE_TRY(layer.out_channels, fields.integer("cout", kMaxChannels));
        const int64_t usual = plain_name(layer.op).starts_with("depthwise") ? in : 1;
        SHALE_TRY(layer.groups, fields.integer("groups", kMaxChannels, usual));
        if (in % layer.groups != 0 || layer.out_channels % layer.groups != 0)
          return bad_input(fields.where(),
                           "{} groups do not divide {} input and {} output channels", layer.groups,
                           in, layer.out_channels);
        return {};
      }
      case LayerKind::kWeightedSum:
      case LayerKind::kReduceMax:
      case LayerKind::kReduceSum: layer.out_channels = 1; return {};
      case LayerKind::kDepthToSpace: divisor = layer.factor * layer.factor; break;
      case LayerKind::kSplit: divisor = static_cast<int64_t>(layer.parts.size()); break;
      default: break;
    }
    if (in % divisor != 0)
      return bad_input(fields.where(), "{} channels are no multiple of {}", in, divisor);
    layer.out_channels = in / divisor;
    return {};
  }

  /// Grids of input and output. "at" decides only where the grid so far is neither.
  Result<void> place(const Fields& fields, Layer& layer) const {
    const bool grows = layer.kind == LayerKind::kTransposeConv;
    const int64_t factor[2] = {layer.factor, layer.factor}, one[2] = {1, 1};
    const auto& up = grows ? layer.stride : factor;
    const auto& down = grows ? one : layer.stride;
    layer.in = grid_;
    layer.out = scaled(layer.in, up, down);
    SHALE_TRY(const std::string at, fields.text("at", ""));
    if (!at.empty()) {
      if (at != "lr" && at != "hr")
        return bad_input(fields.where(), "\"at\" is \"{}\", expected \"lr\" or \"hr\"", at);
      if (at == "hr" && scale_ < 1)
        return bad_input(fields.where(), "\"at\" is \"hr\", but the scale is not given");
      const Ratio side{at == "hr" ? scale_ : 1, 1};
      const Grid named{side, side};
      if (layer.in != named && layer.out != named) {
        layer.out = named;
        layer.in = scaled(named, down, up);
      }
    }
    for (const Ratio& ratio : {layer.in.h, layer.in.w, layer.out.h, layer.out.w})
      if (ratio.num > kMaxRatioTerm || ratio.den > kMaxRatioTerm)
        return bad_input(fields.where(), "the grid is {}/{} of the input, which is beyond {}",
                         ratio.num, ratio.den, kMaxRatioTerm);
    return {};
  }

  int64_t scale_, channels_;
  Grid grid_;
};

Result<std::vector<Layer>> read_layers(const Json& json, const std::string& where, int64_t scale,
                                       int64_t channels) {
  if (!json.is_array() || json.size() > static_cast<size_t>(kMaxLayers))
    return bad_input(where, "must be a list of at most {} layers", kMaxLayers);
  LayerReader reader(scale, channels);
  std::vector<Layer> layers;
  for (size_t i = 0; i < json.size(); ++i) {
    SHALE_TRY(Layer layer, reader.read(json[i], where, i));
    layers.push_back(std::move(layer));
  }
  return layers;
}

Result<Json> parse_json(std::string_view text) {
  Json json = Json::parse(text, nullptr, false);
  if (json.is_discarded()) return bad_input("", "is no JSON");
  return json;
}

/// "8.43K", "1.2M", "36", or an integer.
Result<Stated> stated_number(const Json& json, const std::string& where) {
  const Error error =
      bad_input(where, "\"params_stated\" must be an integer or a text like \"8.43K\"");
  if (json.is_number_integer()) {
    if (json.get<double>() < 0) return error;
    return Stated{json.dump(), json.get<double>(), 0};
  }
  if (!json.is_string()) return error;
  Stated stated{json.get<std::string>(), 0, 0.5};
  double unit = 1;
  size_t digits = 0, at = 0;
  bool after_point = false;
  for (; at < stated.text.size(); ++at) {
    const char c = stated.text[at];
    if (c == '.' && !after_point) {
      after_point = true;
    } else if (std::isdigit(static_cast<unsigned char>(c)) != 0 && ++digits <= 15) {
      stated.value = 10 * stated.value + (c - '0');
      if (after_point) unit /= 10;
    } else {
      break;
    }
  }
  const std::string suffix = stated.text.substr(at);
  if (digits == 0 || (suffix != "" && suffix != "K" && suffix != "M" && suffix != "G"))
    return error;
  if (suffix != "") unit *= suffix == "K" ? 1e3 : suffix == "M" ? 1e6 : 1e9;
  stated.value *= unit;
  stated.half_unit = unit / 2;
  return stated;
}

Result<CostRow> read_row(const Json& json, size_t index) {
  const std::string number = fmt::format("rows[{}]", index);
  if (!json.is_object()) return bad_input(number, "must be an object");
  CostRow row;
  SHALE_TRY(row.id, Fields(json, number).text("id"));
  const Fields fields(json, fmt::format("row \"{}\"", row.id));
  SHALE_TRY(row.kind, fields.text("kind", ""));
  SHALE_TRY(row.paper, fields.text("paper", ""));
  SHALE_TRY(row.network, fields.text("network", row.id));
  if (row.is_timing()) return row;
  if (fields.find("scale")) {
    SHALE_TRY(row.scale, fields.integer("scale", kMaxStep));
  }
  if (fields.find("input_channels")) {
    SHALE_TRY(row.input_channels, fields.integer("input_channels", kMaxChannels));
  }
  SHALE_TRY(const std::string convention, fields.text("convention", "mac"));
  if (convention != "mac" && convention != "counter_A")
    return unsupported(fields.where(),
                       "\"convention\" is \"{}\", expected \"mac\" or \"counter_A\"", convention);
  row.convention = convention == "mac" ? Convention::kMac : Convention::kCounterA;
  if (const Json* stated = fields.find("params_stated")) {
    SHALE_TRY(row.parameters_stated, stated_number(*stated, fields.where()));
  }
  if (fields.find("flops_stated_g")) {
    SHALE_TRY(row.giga_stated, fields.number("flops_stated_g", 0));
  }
  SHALE_TRY(row.tolerance_giga, fields.number("tolerance_g", row.tolerance_giga));
  if (const Json* size = fields.find("resolution_reproducing")) {
    const Fields sides(*size, fields.where() + ", \"resolution_reproducing\"");
    if (!size->is_object())
      return bad_input(sides.where(), "must be an object with \"h\" and \"w\"");
    SHALE_TRY(row.lr_h, sides.integer("h", kMaxSide));
    SHALE_TRY(row.lr_w, sides.integer("w", kMaxSide));
  }
  if (const Json* layers = fields.find("layers")) {
    SHALE_TRY(row.layers,
              read_layers(*layers, fields.where() + ", layers", row.scale, row.input_channels));
  }
  return row;
}

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

Result<std::vector<Layer>> parse_layers(std::string_view json, int64_t scale,
                                        int64_t input_channels) {
  SHALE_TRY(const Json list, parse_json(json));
  return read_layers(list, "layers", scale, input_channels);
}

LayerCounts count_layers(std::span<const Layer> layers) {
  LayerCounts counts;
  for (const Layer& layer : layers) {
    const double in = layer.in.area(), out = layer.out.area();
    const double elements = out * static_cast<double>(layer.out_channels);
    switch (layer.kind) {
      case LayerKind::kConv:
      case LayerKind::kTransposeConv: {
        const int64_t weights = layer.kernel[0] * layer.kernel[1] * layer.in_channels /
                                layer.groups * layer.out_channels;
        counts.parameters += static_cast<uint64_t>(weights + (layer.bias ? layer.out_channels : 0));
        // The work of a transposed convolution is at its input positions; the counter charges its
        // output.
        const double positions = layer.kind == LayerKind::kTransposeConv ? in : out;
        (positions > 1 ? counts.macs_hr : counts.macs_lr) +=
            positions * static_cast<double>(weights);
        counts.counter_macs += out * static_cast<double>(weights);
        if (layer.bias) counts.counter_bias += elements;
        break;
      }
      case LayerKind::kBatchNorm:
        if (layer.affine) counts.parameters += 2 * static_cast<uint64_t>(layer.out_channels);
        counts.counter_other += (layer.affine ? 2 : 1) * elements;
        break;
      case LayerKind::kMaxPool:
      case LayerKind::kAvgPool:
        counts.counter_other += in * static_cast<double>(layer.in_channels);
        break;
      case LayerKind::kUpsample: counts.counter_upsample += elements; break;
      default: break;  // free
    }
    switch (layer.activation) {
      case Activation::kPrelu:
        counts.parameters += static_cast<uint64_t>(layer.out_channels);
        [[fallthrough]];
      case Activation::kRelu:
      case Activation::kRelu6:
      case Activation::kLeakyRelu:
      case Activation::kElu: counts.counter_activation += elements; break;
      case Activation::kNone:
      case Activation::kTanh:
      case Activation::kSigmoid: break;
    }
  }
  return counts;
}

Result<Graph> graph_of_layers(const std::string& name, std::span<const Layer> layers, int64_t lr_h,
                              int64_t lr_w) {
  if (lr_h < 1 || lr_w < 1 || lr_h > kMaxSide || lr_w > kMaxSide)
    return bad_input("", "{}x{} pixels, expected 1 to {} a side", lr_h, lr_w, kMaxSide);
  if (const uint64_t count = count_layers(layers).parameters; count > kMaxGraphParameters)
    return unsupported("", "{} parameters, a graph is built for up to {}", count,
                       kMaxGraphParameters);
  return GraphBuilder(name, lr_h, lr_w).build(layers);
}

std::string_view agreement_text(Agreement agreement) {
  switch (agreement) {
    case Agreement::kNotStated: return "not stated";
    case Agreement::kReproduced: return "reproduced";
    case Agreement::kDiffers: return "differs";
    case Agreement::kNoResolution: return "no resolution";
  }
  return "";
}

RowCheck check_row(const CostRow& row) {
  RowCheck check;
  if (row.layers.empty()) return check;
  check.counts = count_layers(row.layers);
  const double per_pixel =
      row.convention == Convention::kMac ? check.counts.macs() : check.counts.counter_operations();
  check.giga = 1e-9 * per_pixel * static_cast<double>(row.lr_h) * static_cast<double>(row.lr_w);
  // Decimal figures are not exact in binary; the slack is far below their last digit.
  const auto judge = [](double computed, double stated, double tolerance) {
    return std::abs(computed - stated) <= tolerance + 1e-9 * stated ? Agreement::kReproduced
                                                                    : Agreement::kDiffers;
  };
  if (row.parameters_stated)
    check.parameters = judge(static_cast<double>(check.counts.parameters),
                             row.parameters_stated->value, row.parameters_stated->half_unit);
  if (row.giga_stated)
    check.giga_agreement = row.lr_h == 0 ? Agreement::kNoResolution
                                         : judge(check.giga, *row.giga_stated, row.tolerance_giga);
  return check;
}

Result<std::vector<CostRow>> parse_cost_table(std::string_view json) {
  SHALE_TRY(const Json table, parse_json(json));
  if (!table.is_object()) return bad_input("", "is no JSON object of schema \"cost-tables/1\"");
  const Fields fields(table, "");
  SHALE_TRY(const std::string schema, fields.text("schema"));
  if (schema != "cost-tables/1")
    return unsupported("", "\"schema\" is \"{}\", expected \"cost-tables/1\"", schema);
  const Json* list = fields.find("rows");
  if (!list || !list->is_array() || list->size() > kMaxRows)
    return bad_input("", "\"rows\" must be a list of at most {} rows", kMaxRows);
  std::vector<CostRow> rows;
  std::set<std::string> ids;
  for (size_t i = 0; i < list->size(); ++i) {
    SHALE_TRY(CostRow row, read_row((*list)[i], i));
    if (!ids.insert(row.id).second)
      return bad_input(fmt::format("rows[{}]", i), "the id \"{}\" is used twice", row.id);
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace shale
