// shale compare: two forms of a network side by side in the interpreter, tensor by tensor.
//
// Tensors are matched by name. Codes mean numbers by quantization.json beside the model file. Each
// network is run twice on the same inputs. On its own: the signal-to-noise ratio, which gathers all
// that went before. And in lockstep: after every matched tensor both go on from the same value, A's as
// the coarser of the two types holds it, so that the noise of a tensor is that of its own layer alone.
//
// Where both networks have the same tensors of the same types, a layer departs by any difference in
// lockstep. Else by noise in a channel that is above both
//   - the signal less 20 dB (40 dB between floats), the channel's or the mean channel's, whichever is
//     more: a multiplier that is wrong by a share d leaves -20 log10(d) dB, so 10 % (1 %) are found, while
//     weights of 8 bits leave about 40 dB of what is summed, which in a quiet channel may be more than
//     the sum;
//   - four steps of the coarser type, squared: rounding both sides to it costs a sixth of one, and a
//     layer that hardly moves has no ratio to speak of.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <random>
#include <set>

#include "compiler/frontend/frontend.h"
#include "compiler/passes/pass.h"
#include "ir/base/file.h"
#include "ir/reference/interpreter.h"
#include "ir/verify/verify.h"
#include "tools/shale/command.h"
#include "tools/shale/npy.h"
#include "tools/shale/random_inputs.h"

namespace shale {
namespace {

namespace fs = std::filesystem;

constexpr double kDepartDb = 20, kDepartRealDb = 40;
constexpr double kDepartSteps = 4;

struct Arguments {
  std::string a, b, precision_a = "int8", precision_b = "int8";
  std::vector<std::string> input_sets, input_shapes;
  uint64_t seed = 1;
  bool json = false;
};

/// real = scale * (code - zero_point).
struct Meaning {
  double scale = 1;
  double zero_point = 0;
  bool operator==(const Meaning&) const = default;
};

struct Network {
  std::string path;
  Graph graph;
  std::map<std::string, Meaning> meanings;
};

/// What quantization.json beside a model file says of it; nothing where there is none.
/// Errors: kIo, kBadInput naming the field.
Result<std::map<std::string, Meaning>> read_meanings(const std::string& model) {
  std::map<std::string, Meaning> meanings;
  const std::string path = (fs::path(model).parent_path() / "quantization.json").string();
  std::error_code ignored;
  if (!fs::exists(path, ignored)) return meanings;
  SHALE_TRY(const Json json, read_json(path));
  if (!json.is_object() || json.value("schema", Json()) != "shale-quantization/1" ||
      !json.contains("files") || !json["files"].is_object())
    return bad_input(path, "expected schema shale-quantization/1 with files");
  const std::string file = fs::path(model).filename().string();
  if (!json["files"].contains(file)) return meanings;
  if (!json["files"][file].is_object())
    return bad_input(path, "files.{}: expected an object", file);
  for (const auto& [name, entry] : json["files"][file].items()) {
    const auto number = [&](const char* key) {
      return entry.is_object() && entry.contains(key) && entry[key].is_number()
                 ? entry[key].get<double>()
                 : std::numeric_limits<double>::quiet_NaN();
    };
    const Meaning meaning{number("scale"), number("zero_point")};
    if (!(meaning.scale > 0) || !std::isfinite(meaning.scale) ||
        !(std::fabs(meaning.zero_point) <= 65536))
      return bad_input(path, "files.{}.{}: expected a scale above 0 and a zero_point", file, name);
    meanings[name] = meaning;
  }
  return meanings;
}

Result<Network> load(const std::string& path, const std::string& precision,
                     const std::map<std::string, Shape>& shapes) {
  SHALE_TRY(const ModelFiles model, load_model(path, "", precision));
  if (model.bytes.empty()) return bad_input(model.path, "has no network");
  Network network{model.path, {}, {}};
  Result<Graph> graph = import_model(model.bytes);
  if (!graph) return in_file(model.path, graph.error());
  network.graph = *std::move(graph);
  PassContext context;
  for (const ValueId id : network.graph.inputs)
    if (const auto shape = shapes.find(network.graph.value(id).name); shape != shapes.end())
      context.input_shapes.insert(*shape);
  const Result<Change> sized = run_pass(*find_pass("infer-shapes"), network.graph, context);
  if (!sized) return in_file(model.path, sized.error());
  const Result<void> verified = verify(network.graph);
  if (!verified) return in_file(model.path, verified.error());
  SHALE_TRY(network.meanings, read_meanings(model.path));
  return network;
}

/// Waves, edges and some noise, over the whole of the range; the same for a seed everywhere.
Tensor structured_tensor(const TensorType& type, const RandomRange& range,
                         std::mt19937_64& generator) {
  if (range.distinct > 0) return random_tensor(type, range, generator);
  Tensor tensor = Tensor::zeros(type);
  const Shape& shape = type.shape;
  const int64_t channels = shape.empty() ? 1 : shape.back();
  const int64_t width = shape.size() < 2 ? 1 : shape[shape.size() - 2];
  const auto uniform = [&] { return static_cast<double>(generator() >> 11) * 0x1p-53; };
  struct Wave {
    double x, y, phase;
    int64_t block;
  };
  std::vector<Wave> waves;
  for (int64_t c = 0; c < channels; ++c)
    waves.push_back({0.05 + 0.4 * uniform(), 0.05 + 0.4 * uniform(), 6.28 * uniform(),
                     3 + static_cast<int64_t>(10 * uniform())});
  const double middle = is_float(type.dtype) ? 0 : 0.5 * range.low + 0.5 * range.high;
  const double reach = is_float(type.dtype) ? 1 : range.high - middle;
  for (int64_t i = 0; i < tensor.count(); ++i) {
    const Wave& wave = waves[static_cast<size_t>(i % channels)];
    const int64_t x = i / channels % width, y = i / channels / width;
    const double edge = (x / wave.block + y / wave.block) % 2 == 0 ? 0.3 : -0.3;
    const double value = 0.5 * std::sin(wave.x * static_cast<double>(x) + wave.phase) *
                             std::cos(wave.y * static_cast<double>(y)) +
                         edge + 0.4 * (uniform() - 0.5);
    const double real = middle + reach * std::clamp(value, -1.0, 1.0);
    if (is_float(type.dtype))
      tensor.set_real(i, static_cast<float>(real));
    else
      tensor.set(i, static_cast<int64_t>(std::floor(real)));
  }
  return tensor;
}

using Tensors = std::map<std::string, Tensor>;

/// Results of the nodes in `wanted`, by name; after one that `forced` has too, the network goes on
/// from that.
Result<Tensors> run(const Network& network, const std::vector<Tensor>& inputs,
                    const std::set<std::string>& wanted, const Tensors& forced,
                    Progress& progress) {
  const Graph& graph = network.graph;
  if (Result<void> checked = check_inputs(graph, inputs); !checked)
    return in_file(network.path, checked.error());
  std::vector<Tensor> owned(graph.values.size());
  std::vector<const Tensor*> tensors(graph.values.size());
  for (size_t i = 0; i < graph.values.size(); ++i)
    if (graph.values[i].is_constant()) tensors[i] = &*graph.values[i].constant;
  for (size_t i = 0; i < inputs.size(); ++i) tensors[graph.inputs[i].index] = &inputs[i];
  std::vector<uint32_t> uses = graph.use_counts();
  Tensors results;
  for (uint32_t i = 0; i < graph.nodes.size(); ++i) {
    const Node& node = graph.nodes[i];
    if (!progress.step(i, graph.nodes.size())) return bad_input("", "interrupted");
    std::vector<const Tensor*> operands;
    for (const ValueId id : node.inputs) operands.push_back(tensors[id.index]);
    Result<Tensor> result = evaluate_node(graph, {i}, operands);
    if (!result) return in_file(network.path, result.error());
    const std::string& name = graph.value(node.output).name;
    owned[node.output.index] = *std::move(result);
    tensors[node.output.index] = &owned[node.output.index];
    if (wanted.contains(name)) results[name] = owned[node.output.index];
    if (const auto other = forced.find(name); other != forced.end())
      tensors[node.output.index] = &other->second;
    for (const ValueId id : node.inputs)
      if (--uses[id.index] == 0) owned[id.index] = Tensor{};
  }
  return results;
}

/// A tensor's elements as numbers.
struct Form {
  DType dtype;
  Meaning meaning;

  bool operator==(const Form&) const = default;
  bool is_real() const { return is_float(dtype); }
  double step() const { return is_real() ? 0 : meaning.scale; }
  double number(const Tensor& tensor, int64_t i) const {
    if (is_real()) return static_cast<double>(tensor.real(i));
    return meaning.scale * (static_cast<double>(tensor.get(i)) - meaning.zero_point);
  }
  /// The nearest that this form has.
  void store(Tensor& tensor, int64_t i, double number) const {
    if (is_real()) return tensor.set_real(i, static_cast<float>(number));
    const IntRange range = dtype_range(dtype);
    const double code = std::nearbyint(number / meaning.scale + meaning.zero_point);
    tensor.set(i, std::isnan(code)
                      ? 0
                      : static_cast<int64_t>(std::clamp(code, static_cast<double>(range.min),
                                                        static_cast<double>(range.max))));
  }
};

/// A tensor that both networks have, and what was found of it over all input sets.
struct Pair {
  std::string name;
  Shape shape;
  Form a, b;
  bool exact = false;  ///< both networks compute alike, so any difference counts
  // On their own.
  double signal = 0, noise = 0;  ///< sums of squares
  double largest = -1;
  int64_t largest_at = 0;
  size_t largest_set = 0;
  std::array<std::array<int64_t, 2>, 2>
      saturated{};  ///< of a and b: at the minimum, at the maximum
  int64_t count = 0;
  // In lockstep, by channel.
  std::vector<double> own_signal{}, own_noise{};

  const Form& coarse() const {
    if (a.step() != b.step()) return a.step() > b.step() ? a : b;
    return a.dtype == DType::kFp16 ? a : b;
  }
};

double decibels(double signal, double noise) { return 10 * std::log10(signal / noise); }

/// 10 log10 of the ratio, infinite where there is no noise.
double snr(const Pair& pair) { return decibels(pair.signal, pair.noise); }

struct Verdict {
  double worst_db =
      std::numeric_limits<double>::infinity();  ///< of the channel that departs, or the worst
  int64_t channel = -1;
  bool departs = false;
};

Verdict judge(const Pair& pair) {
  Verdict verdict;
  const size_t channels = pair.own_noise.size();
  double mean = 0;
  for (const double signal : pair.own_signal) mean += signal / static_cast<double>(channels);
  const double elements = static_cast<double>(pair.count) / static_cast<double>(channels);
  const double step = pair.coarse().step();
  const double floor = pair.exact ? 0 : kDepartSteps * kDepartSteps * step * step * elements;
  const double bar = step == 0 ? kDepartRealDb : kDepartDb;
  for (size_t c = 0; c < channels; ++c) {
    const double noise = pair.own_noise[c];
    if (!(noise > floor) && !std::isnan(noise)) continue;
    const double db = std::isnan(noise) ? -std::numeric_limits<double>::infinity()
                                        : decibels(std::max(mean, pair.own_signal[c]), noise);
    if (db >= verdict.worst_db) continue;
    verdict.worst_db = db;
    verdict.channel = static_cast<int64_t>(c);
  }
  verdict.departs = verdict.channel >= 0 && (pair.exact || verdict.worst_db < bar);
  return verdict;
}

/// The tensors that both have and that can be compared, in A's order; the names of the others.
std::vector<Pair> match(const Network& a, const Network& b, std::vector<std::string>& skipped) {
  const auto results = [](const Graph& graph) {
    std::map<std::string, TensorType> types;
    for (const Node& node : graph.nodes)
      types[graph.value(node.output).name] = graph.value(node.output).type;
    return types;
  };
  const std::map<std::string, TensorType> in_b = results(b.graph);
  const bool exact = results(a.graph) == in_b;
  std::vector<Pair> pairs;
  for (const Node& node : a.graph.nodes) {
    const Value& value = a.graph.value(node.output);
    const auto other = in_b.find(value.name);
    if (other == in_b.end()) continue;
    const auto meaning = [&](const Network& network, DType dtype) -> std::optional<Meaning> {
      const auto found = network.meanings.find(value.name);
      if (is_float(dtype) || found == network.meanings.end())
        return is_float(dtype) ? std::optional(Meaning{}) : std::nullopt;
      return found->second;
    };
    std::optional<Meaning> of_a = meaning(a, value.type.dtype),
                           of_b = meaning(b, other->second.dtype);
    const bool same = value.type.dtype == other->second.dtype;
    if (same && (exact || !of_a || !of_b)) of_a = of_b = of_a.value_or(Meaning{});
    if (value.type.shape != other->second.shape || !of_a || !of_b) {
      skipped.push_back(value.name);
      continue;
    }
    Pair pair{.name = value.name,
              .shape = value.type.shape,
              .a = {value.type.dtype, *of_a},
              .b = {other->second.dtype, *of_b},
              .exact = exact};
    const size_t channels = pair.shape.empty() ? 1 : static_cast<size_t>(pair.shape.back());
    pair.own_signal.resize(channels);
    pair.own_noise.resize(channels);
    pairs.push_back(std::move(pair));
  }
  return pairs;
}

void count_saturated(const Tensor& tensor, std::array<int64_t, 2>& counts) {
  const DType dtype = tensor.type.dtype;
  for (int64_t i = 0; i < tensor.count(); ++i) {
    if (is_float(dtype)) {
      const float infinite = std::numeric_limits<float>::infinity();
      counts[0] += tensor.real(i) == -infinite;
      counts[1] += tensor.real(i) == infinite;
    } else {
      counts[0] += tensor.get(i) == dtype_range(dtype).min;
      counts[1] += tensor.get(i) == dtype_range(dtype).max;
    }
  }
}

void add_own_run(Pair& pair, const Tensor& a, const Tensor& b, size_t set) {
  for (int64_t i = 0; i < a.count(); ++i) {
    const double x = pair.a.number(a, i), error = pair.b.number(b, i) - x;
    // Equal infinities and NaN against NaN are no error.
    const bool same = pair.a == pair.b && a.get(i) == b.get(i);
    pair.signal += std::isfinite(x) ? x * x : 0;
    if (same) continue;
    pair.noise += error * error;
    if (!(std::fabs(error) <= pair.largest)) {
      pair.largest = std::fabs(error);
      pair.largest_at = i;
      pair.largest_set = set;
    }
  }
  pair.count += a.count();
  count_saturated(a, pair.saturated[0]);
  count_saturated(b, pair.saturated[1]);
}

void add_lockstep(Pair& pair, const Tensor& a, const Tensor& b) {
  const Form& coarse = pair.coarse();
  Tensor one = Tensor::zeros({coarse.dtype, {1}});
  const auto seen = [&](double number) {
    coarse.store(one, 0, number);
    return coarse.number(one, 0);
  };
  for (int64_t i = 0; i < a.count(); ++i) {
    if (pair.a == pair.b && a.get(i) == b.get(i)) {
      const double x = pair.a.number(a, i);
      pair.own_signal[static_cast<size_t>(i) % pair.own_signal.size()] +=
          std::isfinite(x) ? x * x : 0;
      continue;
    }
    const size_t channel = static_cast<size_t>(i) % pair.own_signal.size();
    const double x = seen(pair.a.number(a, i)), error = seen(pair.b.number(b, i)) - x;
    pair.own_signal[channel] += x * x;
    pair.own_noise[channel] += error * error;
  }
}

Result<std::vector<std::vector<Tensor>>> input_sets(const Arguments& arguments,
                                                    const Graph& graph) {
  std::vector<std::vector<Tensor>> sets;
  if (arguments.input_sets.empty()) {
    std::mt19937_64 generator(arguments.seed);
    std::vector<Tensor>& set = sets.emplace_back();
    SHALE_TRY(const std::vector<RandomRange> ranges, legal_ranges(graph, {}));
    for (size_t i = 0; i < graph.inputs.size(); ++i)
      set.push_back(structured_tensor(graph.value(graph.inputs[i]).type, ranges[i], generator));
  }
  for (const std::string& text : arguments.input_sets) {
    const std::vector<std::string> files = CLI::detail::split(text, ',');
    if (files.size() != graph.inputs.size())
      return bad_input("--inputs", "\"{}\" has {} files, the network {} inputs", text, files.size(),
                       graph.inputs.size());
    std::vector<Tensor>& set = sets.emplace_back();
    for (size_t i = 0; i < files.size(); ++i) {
      SHALE_TRY(Tensor tensor, read_npy(files[i], graph.value(graph.inputs[i]).type));
      set.push_back(std::move(tensor));
    }
  }
  return sets;
}

/// Shapes of the inputs by name: as asked for, else those of the first input set.
Result<std::map<std::string, Shape>> shapes(const Arguments& arguments, const Graph& graph) {
  std::map<std::string, Shape> result;
  if (!arguments.input_sets.empty()) {
    const std::vector<std::string> files = CLI::detail::split(arguments.input_sets[0], ',');
    for (size_t i = 0; i < std::min(files.size(), graph.inputs.size()); ++i) {
      SHALE_TRY(result[graph.value(graph.inputs[i]).name], npy_shape(files[i]));
    }
  }
  for (const std::string& text : arguments.input_shapes) {
    SHALE_TRY(auto shape, parse_input_shape(text));
    result[shape.first] = shape.second;
  }
  return result;
}

/// The inputs of both are the same, so that one set does for both.
Result<void> check_interfaces(const Network& a, const Network& b) {
  const auto list = [](const Graph& graph) {
    std::string text;
    for (const ValueId id : graph.inputs)
      text += fmt::format("{}\"{}\" {}", text.empty() ? "" : ", ", graph.value(id).name,
                          type_text(graph.value(id).type));
    return text;
  };
  if (list(a.graph) == list(b.graph)) return {};
  return bad_input(b.path, "has the inputs {}, expected those of {}: {}", list(b.graph), a.path,
                   list(a.graph));
}

std::string db_text(double db) {
  return std::isinf(db) && db > 0 ? "equal" : fmt::format("{:.1f}", db);
}

std::string percent(int64_t part, int64_t whole) {
  return part == 0
             ? "-"
             : fmt::format("{:.3g}%", 100 * static_cast<double>(part) / static_cast<double>(whole));
}

Shape coordinates(const Shape& shape, int64_t element) {
  Shape at(shape.size());
  for (size_t axis = at.size(); axis-- > 0;) {
    at[axis] = element % shape[axis];
    element /= shape[axis];
  }
  return at;
}

Json pair_json(const Pair& pair, const Verdict& verdict) {
  const auto finite = [](double value) {
    return std::isfinite(value) ? Json(value) : Json(nullptr);
  };
  Json json{{"name", pair.name},
            {"a", dtype_info(pair.a.dtype).name},
            {"b", dtype_info(pair.b.dtype).name},
            {"snr_db", finite(snr(pair))},
            {"equal", pair.largest < 0 || pair.largest == 0}};
  if (pair.largest > 0 || std::isnan(pair.largest))
    json["largest_error"] = {{"value", finite(pair.largest)},
                             {"at", coordinates(pair.shape, pair.largest_at)},
                             {"set", pair.largest_set}};
  json["own_snr_db"] = finite(verdict.worst_db);
  if (verdict.channel >= 0) json["channel"] = verdict.channel;
  for (size_t side = 0; side < 2; ++side)
    json[side == 0 ? "saturated_a" : "saturated_b"] = {
        {"min", static_cast<double>(pair.saturated[side][0]) / static_cast<double>(pair.count)},
        {"max", static_cast<double>(pair.saturated[side][1]) / static_cast<double>(pair.count)}};
  json["departs"] = verdict.departs;
  return json;
}

void print(const std::vector<Pair>& pairs, const std::vector<Verdict>& verdicts) {
  fmt::print("{:<24} {:<9} {:>8} {:>9} {:>12}  {:<18} {:>8} {:>8} {:>8} {:>8}\n", "tensor", "types",
             "SNR dB", "own dB", "max error", "at", "A min", "A max", "B min", "B max");
  for (size_t i = 0; i < pairs.size(); ++i) {
    const Pair& pair = pairs[i];
    const bool differs = pair.largest > 0 || std::isnan(pair.largest);
    fmt::print("{:<24} {:<9} {:>8} {:>9} {:>12}  {:<18} {:>8} {:>8} {:>8} {:>8}{}\n", pair.name,
               fmt::format("{}/{}", dtype_info(pair.a.dtype).name, dtype_info(pair.b.dtype).name),
               differs ? db_text(snr(pair)) : "equal",
               verdicts[i].channel < 0 ? "-" : db_text(verdicts[i].worst_db),
               differs ? fmt::format("{:.6g}", pair.largest) : "-",
               differs ? shape_text(coordinates(pair.shape, pair.largest_at)) : "",
               percent(pair.saturated[0][0], pair.count), percent(pair.saturated[0][1], pair.count),
               percent(pair.saturated[1][0], pair.count), percent(pair.saturated[1][1], pair.count),
               verdicts[i].departs ? "  departs" : "");
  }
}

Result<int> compare(const Arguments& arguments) {
  SHALE_TRY(const Network unsized, load(arguments.a, arguments.precision_a, {}));
  SHALE_TRY(const auto input_shapes, shapes(arguments, unsized.graph));
  SHALE_TRY(const Network a, load(arguments.a, arguments.precision_a, input_shapes));
  SHALE_TRY(const Network b, load(arguments.b, arguments.precision_b, input_shapes));
  SHALE_TRY_VOID(check_interfaces(a, b));
  SHALE_TRY(const std::vector<std::vector<Tensor>> sets, input_sets(arguments, a.graph));
  std::vector<std::string> skipped;
  std::vector<Pair> pairs = match(a, b, skipped);
  if (pairs.empty())
    return bad_input(b.path, "has no layer result of the same name, shape and known scale as {}",
                     a.path);
  std::set<std::string> names;
  for (const Pair& pair : pairs) names.insert(pair.name);
  Progress progress("interpreting");
  for (size_t set = 0; set < sets.size(); ++set) {
    Tensors from_a, from_b;
    SHALE_TRY(const Tensors own_a, run(a, sets[set], names, {}, progress));
    {
      SHALE_TRY(const Tensors own_b, run(b, sets[set], names, {}, progress));
      for (Pair& pair : pairs) add_own_run(pair, own_a.at(pair.name), own_b.at(pair.name), set);
    }
    for (const Pair& pair : pairs) {
      const Tensor& value = own_a.at(pair.name);
      Tensor common = Tensor::zeros({pair.coarse().dtype, value.type.shape});
      Tensor& for_a = from_a[pair.name] = Tensor::zeros({pair.a.dtype, value.type.shape});
      Tensor& for_b = from_b[pair.name] = Tensor::zeros({pair.b.dtype, value.type.shape});
      if (pair.a == pair.b) {
        for_a = for_b = value;
        continue;
      }
      for (int64_t i = 0; i < value.count(); ++i) {
        pair.coarse().store(common, i, pair.a.number(value, i));
        const double number = pair.coarse().number(common, i);
        pair.a.store(for_a, i, number);
        pair.b.store(for_b, i, number);
      }
    }
    SHALE_TRY(const Tensors step_a, run(a, sets[set], names, from_a, progress));
    SHALE_TRY(const Tensors step_b, run(b, sets[set], names, from_b, progress));
    for (Pair& pair : pairs) add_lockstep(pair, step_a.at(pair.name), step_b.at(pair.name));
  }

  std::vector<Verdict> verdicts;
  for (const Pair& pair : pairs) verdicts.push_back(judge(pair));
  const auto first = std::ranges::find_if(verdicts, &Verdict::departs);
  const int exit = first == verdicts.end() ? kDone : kRefused;
  const size_t at = static_cast<size_t>(first - verdicts.begin());
  if (arguments.json) {
    Json json{{"a", a.path}, {"b", b.path}, {"sets", sets.size()}, {"tensors", Json::array()}};
    for (size_t i = 0; i < pairs.size(); ++i)
      json["tensors"].push_back(pair_json(pairs[i], verdicts[i]));
    json["not_compared"] = skipped;
    json["first_departure"] = exit == kDone ? Json(nullptr) : Json(pairs[at].name);
    print_json(json);
    return exit;
  }
  fmt::print("A {}\nB {}\n{} input set{}\n", a.path, b.path, sets.size(),
             sets.size() == 1 ? "" : "s");
  print(pairs, verdicts);
  if (!skipped.empty())
    fmt::print("not compared, of other shapes or unknown scale: {}\n", fmt::join(skipped, ", "));
  if (exit == kDone)
    fmt::print("no layer departs\n");
  else
    fmt::print("the first layer that departs: {}, channel {}\n", pairs[at].name, first->channel);
  return exit;
}

}  // namespace

Action add_compare(CLI::App& app) {
  auto arguments = std::make_shared<Arguments>();
  app.add_option("a", arguments->a, "model file or model folder")->required();
  app.add_option("b", arguments->b, "model file or model folder to hold against it")->required();
  for (const auto& [flag, precision] : {std::pair{"--precision-a", &arguments->precision_a},
                                        std::pair{"--precision-b", &arguments->precision_b}})
    app.add_option(flag, *precision, "which network of that folder")
        ->check(CLI::IsMember({"int8", "int16", "fp16", "fp32"}))
        ->capture_default_str();
  app.add_option("--inputs", arguments->input_sets,
                 "input sets: a .npy file each, or one for each graph input as A.npy,B.npy");
  app.add_option("--random", arguments->seed,
                 "seed of a structured random input, where none is given")
      ->capture_default_str();
  app.add_option("--input-shape", arguments->input_shapes,
                 "shape of a graph input, NAME=N,H,W,C (again for each input)")
      ->allow_extra_args(false);
  app.add_flag("--json", arguments->json, "print the comparison as JSON");
  app.footer(
      "Exit code 1 if a layer departs.\n"
      "Example: shale compare models/srpo_x2 models/srpo_x2 --precision-a fp32 --inputs "
      "models/srpo_x2/golden/input.npy");
  return [arguments] { return compare(*arguments); };
}

}  // namespace shale
