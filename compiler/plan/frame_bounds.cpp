#include "compiler/plan/frame_bounds.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "ir/reference/arith.h"

namespace shale {
namespace {

using Channels = std::vector<IntRange>;

constexpr int kRounds = 64;  ///< until what still grows gets the range of its type

IntRange join(IntRange a, IntRange b) { return {std::min(a.min, b.min), std::max(a.max, b.max)}; }

size_t channel_count(const TensorType& type) {
  return type.shape.empty() ? 1 : static_cast<size_t>(type.shape.back());
}

Channels whole(const TensorType& type) {
  return Channels(channel_count(type), dtype_range(type.dtype));
}

IntRange all_of(const Channels& channels) {
  IntRange all = channels[0];
  for (const IntRange& each : channels) all = join(all, each);
  return all;
}

Channels of_constant(const Tensor& tensor) {
  const size_t count = channel_count(tensor.type);
  Channels channels(count);
  for (int64_t i = 0; i < tensor.count(); ++i) {
    IntRange& channel = channels[static_cast<size_t>(i) % count];
    const int64_t value = tensor.get(i);
    channel =
        static_cast<size_t>(i) < count ? IntRange{value, value} : join(channel, {value, value});
  }
  return channels;
}

/// Follows a graph; nothing is kept between two of them.
class Follower {
 public:
  explicit Follower(const Graph& graph) : graph_(graph), known_(graph.values.size()) {}

  std::vector<Channels> follow(std::span<const Channels> inputs) {
    for (size_t i = 0; i < inputs.size(); ++i) {
      const TensorType& type = graph_.value(graph_.inputs[i]).type;
      known_[graph_.inputs[i].index] = inputs[i].size() == channel_count(type)
                                           ? inputs[i]
                                           : Channels(channel_count(type), all_of(inputs[i]));
    }
    for (const Node& node : graph_.nodes) {
      const TensorType& type = graph_.value(node.output).type;
      known_[node.output.index] =
          is_float(type.dtype) || type.dtype == DType::kShape ? Channels(1) : result(node, type);
    }
    std::vector<Channels> outputs;
    for (const ValueId id : graph_.outputs) outputs.push_back(of(id));
    return outputs;
  }

 private:
  const Channels& of(ValueId id) {
    const Value& value = graph_.value(id);
    if (known_[id.index].empty())
      known_[id.index] = value.is_constant() ? of_constant(*value.constant) : whole(value.type);
    return known_[id.index];
  }
  const Tensor* constant(const Node& node, size_t operand) const {
    const Value& value = graph_.value(node.inputs[operand]);
    return value.is_constant() ? &*value.constant : nullptr;
  }

  Channels result(const Node& node, const TensorType& type) {
    switch (node.op) {
      case Op::kConv2d:
      case Op::kDepthwiseConv2d: return convolved(node, type);
      case Op::kRescale: return rescaled(node, type);
      case Op::kTable: return looked_up(node, type);
      case Op::kClamp: {
        Channels channels = of(node.inputs[0]);
        const int64_t low = node.attrs.get(Attr::kMinVal), high = node.attrs.get(Attr::kMaxVal);
        for (IntRange& each : channels)
          each = {std::clamp(each.min, low, high), std::clamp(each.max, low, high)};
        return channels;
      }
      case Op::kIdentity:
      case Op::kMaxPool2d: return of(node.inputs[0]);
      case Op::kResize:
        return node.attrs.get(Attr::kMode) == kNearest ? of(node.inputs[0]) : whole(type);
      case Op::kPad: {
        Channels channels = of(node.inputs[0]);
        const IntRange padding = all_of(of(node.inputs[2]));
        for (IntRange& each : channels) each = join(each, padding);
        return channels.size() == channel_count(type) ? channels : whole(type);
      }
      case Op::kConcat: {
        if (node.attrs.get(Attr::kAxis) + 1 != static_cast<int64_t>(type.shape.size()))
          return whole(type);
        Channels channels;
        for (const ValueId part : node.inputs)
          channels.insert(channels.end(), of(part).begin(), of(part).end());
        return channels;
      }
      default: return whole(type);
    }
  }

  /// Each weight at the end of its channel's range that adds most, or nothing where padding is.
  Channels convolved(const Node& node, const TensorType& type) {
    const Tensor *weight = constant(node, 1), *bias = constant(node, 2), *zero = constant(node, 3),
                 *weight_zero = constant(node, 4);
    if (!weight || !bias || !zero || !weight_zero) return whole(type);
    const Channels& input = of(node.inputs[0]);
    const size_t count = channel_count(type);
    const bool depthwise = node.op == Op::kDepthwiseConv2d;
    const size_t elements = static_cast<size_t>(weight->count()), taps = elements / count;
    const size_t multiplier = depthwise ? static_cast<size_t>(weight->type.shape.back()) : 1;
    Channels channels(count);
    for (size_t c = 0; c < count; ++c) {
      const int64_t b = bias->get(bias->count() == 1 ? 0 : static_cast<int64_t>(c));
      channels[c] = {b, b};
    }
    for (size_t i = 0; i < elements; ++i) {
      const size_t out = depthwise ? i % count : i / taps;
      const size_t in = depthwise ? out / multiplier : i % input.size();
      const int64_t w = weight->get(static_cast<int64_t>(i)) - weight_zero->get(0);
      const IntRange x = join({input[in].min - zero->get(0), input[in].max - zero->get(0)}, {0, 0});
      channels[out].min += std::min(w * x.min, w * x.max);
      channels[out].max += std::max(w * x.min, w * x.max);
    }
    const IntRange range = dtype_range(type.dtype);
    for (const IntRange& each : channels)
      if (each.min < range.min || each.max > range.max) return whole(type);
    return channels;
  }

  /// Monotone: what the ends become.
  Channels rescaled(const Node& node, const TensorType& type) {
    const Tensor *multiplier = constant(node, 1), *shift = constant(node, 2),
                 *input_zero = constant(node, 3), *output_zero = constant(node, 4);
    if (!multiplier || !shift || !input_zero || !output_zero ||
        node.attrs.flag(Attr::kInputUnsigned) || node.attrs.flag(Attr::kOutputUnsigned))
      return whole(type);
    const bool double_round = node.attrs.get(Attr::kRoundingMode) == kDoubleRound;
    const IntRange range = dtype_range(type.dtype);
    Channels channels = of(node.inputs[0]);
    for (size_t c = 0; c < channels.size(); ++c) {
      const auto i = static_cast<int64_t>(c) % multiplier->count();
      const auto end = [&](int64_t value) -> std::optional<int64_t> {
        value -= input_zero->get(0);
        const auto scaled =
            node.attrs.flag(Attr::kScale32)
                ? apply_scale_32(value, multiplier->get(i), shift->get(i), double_round)
                : apply_scale_16(value, multiplier->get(i), shift->get(i));
        if (!scaled) return std::nullopt;
        return std::clamp(*scaled + output_zero->get(0), range.min, range.max);
      };
      const auto low = end(channels[c].min), high = end(channels[c].max);
      channels[c] = low && high ? IntRange{*low, *high} : range;
    }
    return channels;
  }

  Channels looked_up(const Node& node, const TensorType& type) {
    const Tensor* table = constant(node, 1);
    const DType from = graph_.value(node.inputs[0]).type.dtype;
    if (!table || from != DType::kInt8) return whole(type);
    Channels channels;
    for (const IntRange& each : of(node.inputs[0])) {
      const int64_t first = table->get(each.min + 128);
      IntRange values{first, first};
      for (int64_t code = each.min; code <= each.max; ++code)
        values = join(values, {table->get(code + 128), table->get(code + 128)});
      channels.push_back(values);
    }
    return channels;
  }

  const Graph& graph_;
  std::vector<Channels> known_;  ///< by value; empty is not asked for yet
};

/// A range of real values, or of codes.
struct Range {
  double low = 0, high = 0;
  bool operator==(const Range&) const = default;
};
using Ranges = std::vector<Range>;

/// What a resource can hold; nothing where that says nothing.
std::optional<Range> format_range(const Resource& resource) {
  if (!is_image(resource.category)) {
    if (resource.dtype != DType::kInt8) return std::nullopt;
    return Range{-128, 127};
  }
  switch (resource.format) {
    case ImageFormat::kRgba8Unorm:
    case ImageFormat::kRg8Unorm:
    case ImageFormat::kR8Unorm: return Range{0, 1};
    case ImageFormat::kRgba8Snorm: return Range{-1, 1};
    default: return std::nullopt;
  }
}

size_t channel_count(const Resource& resource) {
  if (is_image(resource.category)) return image_format_info(resource.format).channels;
  return resource.shape.empty() ? 1 : static_cast<size_t>(resource.shape.back());
}

/// The iteration over the programs of a frame.
class Iteration {
 public:
  Iteration(const Variant& variant, const Frame& frame, std::span<const PlannedGraph> graphs)
      : variant_(variant),
        frame_(frame),
        graphs_(graphs),
        state_(variant.resources.size()),
        is_open_(variant.resources.size()) {}

  Result<std::vector<ValueBounds>> run() {
    // What a pass may find that nobody wrote yet.
    for (size_t i = 0; i < state_.size(); ++i)
      if (is_bounded(variant_.resources[i]))
        state_[i] = Ranges(channel_count(variant_.resources[i]), Range{});
    for (int round = 0;; ++round) {
      grew_ = false;
      is_last_ = round == kRounds;
      for (const FrameProgram& program : frame_.programs)
        for (const FramePass& pass : program.passes)
          SHALE_TRY_VOID(pass.graph.empty() ? add_pass(pass) : add_graph(pass));
      if (!grew_) break;
    }
    std::vector<ValueBounds> bounds;
    for (size_t i = 0; i < state_.size(); ++i) {
      if (!is_bounded(variant_.resources[i]) || is_open_[i]) continue;
      ValueBounds of{static_cast<uint32_t>(i), {}, {}};
      const bool is_one = std::all_of(state_[i].begin(), state_[i].end(),
                                      [&](const Range& each) { return each == state_[i][0]; });
      for (const Range& each : state_[i]) {
        of.low.push_back(static_cast<float>(each.low));
        of.high.push_back(static_cast<float>(each.high));
        if (is_one) break;
      }
      bounds.push_back(std::move(of));
    }
    return bounds;
  }

 private:
  static bool is_bounded(const Resource& resource) {
    return (resource.category == Category::kImageHistory &&
            resource.format != ImageFormat::kR32Uint) ||
           ((resource.category == Category::kInput || resource.category == Category::kOutput) &&
            resource.dtype == DType::kInt8);
  }
  std::optional<size_t> index_of(const std::string& name) const {
    for (size_t i = 0; i < variant_.resources.size(); ++i)
      if (variant_.resources[i].name == name) return i;
    return std::nullopt;
  }

  void grow(size_t index, size_t channel, Range by) {
    Range& range = state_[index][channel];
    const Range joined{std::min(range.low, by.low), std::max(range.high, by.high)};
    if (joined == range || is_open_[index]) return;
    const std::optional<Range> whole = format_range(variant_.resources[index]);
    // Far from a fixed point: all that the type can hold, or nothing is known.
    is_open_[index] = is_last_ && !whole;
    range = is_last_ && whole ? *whole : joined;
    grew_ = true;
  }

  Result<Range> part_range(const FramePass& pass, const BoundPart& part, const std::string& where) {
    if (part.of.empty()) return Range{part.low, part.high};
    const auto binding = std::find_if(
        pass.bindings.begin(), pass.bindings.end(),
        [&](const FrameBinding& each) { return each.reads && each.handle == part.of; });
    if (binding == pass.bindings.end())
      return bad_input(where, "the bounds name \"{}\", which the pass does not read", part.of);
    const std::optional<size_t> index = index_of(binding->name);
    if (!index || state_[*index].empty())
      return bad_input(where, "the bounds name \"{}\", of which none are known", part.of);
    const Ranges& ranges = state_[*index];
    if (part.channel && *part.channel >= ranges.size())
      return bad_input(where, "the bounds name channel {} of \"{}\", which has {}", *part.channel,
                       part.of, ranges.size());
    Range range = ranges[part.channel.value_or(0)];
    for (size_t c = 0; !part.channel && c < ranges.size(); ++c)
      range = {std::min(range.low, ranges[c].low), std::max(range.high, ranges[c].high)};
    const Resource& resource = variant_.resources[*index];
    if (const std::optional<Quantization>& q = resource.quantization)
      range = {static_cast<double>(q->scale) * (range.low - q->zero_point),
               static_cast<double>(q->scale) * (range.high - q->zero_point)};
    return range;
  }

  Result<void> add_pass(const FramePass& pass) {
    const std::string where = "pass \"" + pass.name + "\"";
    for (const FrameBinding& binding : pass.bindings) {
      if (!binding.writes) continue;
      const std::optional<size_t> index = index_of(binding.name);
      if (!index || !is_bounded(variant_.resources[*index])) continue;
      const Resource& resource = variant_.resources[*index];
      const std::optional<Range> format = format_range(resource);
      const auto contract =
          std::find_if(pass.bounds.begin(), pass.bounds.end(),
                       [&](const BoundContract& each) { return each.name == binding.name; });
      if (contract == pass.bounds.end()) {
        if (!format) is_open_[*index] = true;
        for (size_t c = 0; format && c < state_[*index].size(); ++c) grow(*index, c, *format);
        continue;
      }
      const size_t channels = state_[*index].size();
      if (contract->channels.size() != 1 && contract->channels.size() != channels)
        return bad_input(where, "the bounds of \"{}\" are of {} channels, expected 1 or {}",
                         binding.name, contract->channels.size(), channels);
      for (size_t c = 0; c < channels; ++c) {
        std::optional<Range> all;
        for (const BoundPart& part : contract->channels[contract->channels.size() == 1 ? 0 : c]) {
          SHALE_TRY(const Range range, part_range(pass, part, where));
          all = all ? Range{std::min(all->low, range.low), std::max(all->high, range.high)} : range;
        }
        Range range = *all;
        if (const std::optional<Quantization>& q = resource.quantization)
          range = {std::floor(range.low / static_cast<double>(q->scale) + 0.5) + q->zero_point,
                   std::floor(range.high / static_cast<double>(q->scale) + 0.5) + q->zero_point};
        if (format)
          range = {std::clamp(range.low, format->low, format->high),
                   std::clamp(range.high, format->low, format->high)};
        grow(*index, c, range);
      }
    }
    return {};
  }

  Result<void> add_graph(const FramePass& pass) {
    const std::vector<std::string> files = graph_files(frame_);
    const PlannedGraph& planned = graphs_[static_cast<size_t>(
        std::find(files.begin(), files.end(), pass.graph) - files.begin())];
    const Graph& graph = *planned.graph;
    const auto resource_of = [&](ValueId id) {
      const std::string& name = graph.value(id).name;
      const auto renamed = planned.renamed.find(name);
      return index_of(renamed == planned.renamed.end() ? name : renamed->second);
    };
    std::vector<Channels> inputs;
    for (const ValueId id : graph.inputs) {
      const std::optional<size_t> index = resource_of(id);
      Channels channels = whole(graph.value(id).type);
      if (index && !state_[*index].empty() && !is_float(graph.value(id).type.dtype))
        for (size_t c = 0; c < channels.size(); ++c)
          channels[c] = {static_cast<int64_t>(state_[*index][c].low),
                         static_cast<int64_t>(state_[*index][c].high)};
      inputs.push_back(std::move(channels));
    }
    const std::vector<Channels> outputs = graph_bounds(graph, inputs);
    for (size_t i = 0; i < outputs.size(); ++i) {
      const std::optional<size_t> index = resource_of(graph.outputs[i]);
      if (!index || state_[*index].empty()) continue;
      for (size_t c = 0; c < state_[*index].size(); ++c) {
        const IntRange& range = outputs[i][outputs[i].size() == state_[*index].size() ? c : 0];
        grow(*index, c, {static_cast<double>(range.min), static_cast<double>(range.max)});
      }
    }
    return {};
  }

  const Variant& variant_;
  const Frame& frame_;
  std::span<const PlannedGraph> graphs_;
  std::vector<Ranges> state_;  ///< by resource; codes of tensors; empty of what is not followed
  std::vector<bool> is_open_;  ///< by resource: nothing bounds it
  bool grew_ = false, is_last_ = false;
};

}  // namespace

std::vector<std::vector<IntRange>> graph_bounds(const Graph& graph,
                                                std::span<const std::vector<IntRange>> inputs) {
  return Follower(graph).follow(inputs);
}

Result<std::vector<ValueBounds>> frame_bounds(const Variant& variant, const Frame& frame,
                                              std::span<const PlannedGraph> graphs) {
  return Iteration(variant, frame, graphs).run();
}

}  // namespace shale
