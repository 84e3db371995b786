#include "compiler/cost/layers.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <numeric>
#include <set>

#include "ir/base/json.h"

namespace shale {
namespace {

using Json = nlohmann::json;

// Bounds that keep every sum below 2^63; no published network comes near them.
constexpr int64_t kMaxWindow = 1024, kMaxStep = 64, kMaxChannels = 65536, kMaxLayers = 1024,
                  kMaxRatioTerm = 1 << 20;
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
    SHALE_TRY(row.lr_h, sides.integer("h", kMaxLayerSide));
    SHALE_TRY(row.lr_w, sides.integer("w", kMaxLayerSide));
  }
  if (const Json* layers = fields.find("layers")) {
    SHALE_TRY(row.layers,
              read_layers(*layers, fields.where() + ", layers", row.scale, row.input_channels));
  }
  return row;
}

}  // namespace

Result<std::vector<Layer>> parse_layers(std::string_view json, int64_t scale,
                                        int64_t input_channels) {
  SHALE_TRY(const Json list, parse_json<Json>(json));
  return read_layers(list, "layers", scale, input_channels);
}

Result<std::vector<CostRow>> parse_cost_table(std::string_view json) {
  SHALE_TRY(const Json table, parse_json<Json>(json));
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
