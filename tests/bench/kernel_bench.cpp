// Convolutions on the device at hand: the fast families against the naive kernel and the mul+add
// roof, in one run; the roof is measured anew around each.
//
//   kernel_bench [--benchmark_repetitions=5 ...]
//
// GOP/s counts 2 per multiply-accumulate of the direct form, requantization included, by device
// timestamps. At the end it prints the ratios. A convolution is int8, 3x3, stride 1, padded,
// per-channel requantized and clamped.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <map>
#include <random>
#include <vector>

#include "compiler/driver/compile.h"
#include "tools/shale/roof.h"

namespace shale {
namespace {

struct Case {
  const char* name;
  int64_t in, out, height, width;  ///< of the convolution's result
  int64_t most;                    ///< largest weight
  bool upsampled;                  ///< by 2, before the convolution
  bool depthwise = false;
};
/// Weights of the whole range for the direct kernels; smaller ones, as training gives, where the
/// proof of Winograd's sums asks for them.
constexpr Case kCases[] = {{"16->16", 16, 16, 540, 960, 127, false},
                           {"32->32", 32, 32, 540, 960, 127, false},
                           {"64->64", 64, 64, 270, 480, 127, false},
                           {"32->32, small weights", 32, 32, 540, 960, 30, false},
                           {"48->16, small weights", 48, 16, 540, 960, 30, false},
                           {"32->16 over nearest x2", 32, 16, 540, 960, 127, true},
                           {"depthwise 32", 32, 32, 540, 960, 127, false, true},
                           {"depthwise 144", 144, 144, 56, 56, 127, false, true}};
constexpr std::string_view kKernels[] = {
    "generic",           "conv2d_s8_i32",        "conv2d_s8_f32exact",
    "conv2d_s8_f64pair", "conv2d_s8_winograd",   "conv2d_s8_phase",
    "conv2d_s8_loop",    "conv2d_s8_winograd32", "conv2d_s8_phase32"};

bool is_for(const Case& c, std::string_view kernel) {
  if (kernel == "conv2d_s8_loop" && c.depthwise) return false;
  if (kernel.starts_with("conv2d_s8_winograd")) return c.most < 127;
  if (kernel.starts_with("conv2d_s8_phase")) return c.upsampled;
  return kernel != "conv2d_s8_i32" || c.most == 127;
}

std::string rate_name(const Case& c, std::string_view kernel) {
  return fmt::format("{}/{}", c.name, kernel);
}

Shape input_shape(const Case& c) {
  return c.upsampled ? Shape{1, c.height / 2, c.width / 2, c.in}
                     : Shape{1, c.height, c.width, c.in};
}

/// Weights, bias and scales are random but typical.
Graph convolution(const Case& c) {
  std::mt19937_64 generator(1);
  const auto uniform = [&](int64_t low, int64_t high) {
    return low + static_cast<int64_t>(generator() % static_cast<uint64_t>(high - low + 1));
  };
  const auto constant = [&](Graph& graph, const char* name, DType dtype, Shape shape, int64_t low,
                            int64_t high) {
    Tensor tensor = Tensor::zeros({dtype, std::move(shape)});
    for (int64_t i = 0; i < tensor.count(); ++i) tensor.set(i, uniform(low, high));
    return graph.add_constant(name, std::move(tensor));
  };
  Graph graph;
  const Shape shape{1, c.height, c.width, c.out};
  ValueId x = graph.add_input("x", {DType::kInt8, input_shape(c)});
  if (c.upsampled) {
    const ValueId scale = graph.add_shape("scale", {4, 2, 4, 2}),
                  offset = graph.add_shape("offset", {-1, -1}),
                  border = graph.add_shape("border", {1, 1});
    x = graph.add_node(Op::kResize, Attrs().set(Attr::kMode, kNearest), {x, scale, offset, border},
                       "resized", {DType::kInt8, {1, c.height, c.width, c.in}});
  }
  const ValueId w =
      constant(graph, "w", DType::kInt8,
               c.depthwise ? Shape{3, 3, c.in, 1} : Shape{c.out, 3, 3, c.in}, -c.most, c.most);
  const ValueId b = constant(graph, "b", DType::kInt32, {c.out}, -20000, 20000);
  const ValueId zp = constant(graph, "zp", DType::kInt8, {1}, -128, -128);
  const ValueId zero = constant(graph, "zero", DType::kInt8, {1}, 0, 0);
  const ValueId zero32 = constant(graph, "zero32", DType::kInt32, {1}, 0, 0);
  const ValueId m =
      constant(graph, "m", DType::kInt32, {c.out}, int64_t{1} << 30, (int64_t{1} << 31) - 1);
  const ValueId s = constant(graph, "s", DType::kInt8, {c.out}, 39, 40);
  Attrs conv;
  conv.set(Attr::kPad, std::vector<int64_t>{1, 1, 1, 1})
      .set(Attr::kStride, std::vector<int64_t>{1, 1});
  conv.set(Attr::kDilation, std::vector<int64_t>{1, 1}).set(Attr::kLocalBound, 0);
  conv.set(Attr::kAccType, static_cast<int64_t>(DType::kInt32));
  const ValueId acc = graph.add_node(c.depthwise ? Op::kDepthwiseConv2d : Op::kConv2d, conv,
                                     {x, w, b, zp, zero}, "acc", {DType::kInt32, shape});
  Attrs rescale;
  rescale.set(Attr::kScale32, 1).set(Attr::kRoundingMode, kSingleRound).set(Attr::kPerChannel, 1);
  rescale.set(Attr::kInputUnsigned, 0).set(Attr::kOutputUnsigned, 0);
  const ValueId y =
      graph.add_node(Op::kRescale, rescale, {acc, m, s, zero32, zp}, "y", {DType::kInt8, shape});
  graph.outputs = {y};
  return graph;
}

const ToolDevice& device() {
  static const ToolDevice tool = [] {
    Result<ToolDevice> opened = ToolDevice::open({});
    if (!opened) {
      fmt::print(stderr, "error: {}\n", opened.error().text());
      std::exit(3);
    }
    return *std::move(opened);
  }();
  return tool;
}

/// GOP/s of every run by name, for the table of ratios.
std::map<std::string, std::vector<double>>& rates() {
  static std::map<std::string, std::vector<double>> all;
  return all;
}

/// The float32 mul+add roof around each run, by name.
std::map<std::string, double>& roofs() {
  static std::map<std::string, double> all;
  return all;
}

/// 0 if the benchmark was not run.
double median_rate(const std::string& name) {
  std::vector<double> values = rates()[name];
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

/// One iteration is the median of `repeat` runs: pipelines are made once.
void measure(benchmark::State& state, const std::string& name, const Package& package,
             const std::vector<Tensor>& inputs, double gop, uint32_t repeat) {
  for (auto _ : state) {
    const Result<RoofedTimes> measured = measure_under_roof(device(), package, inputs, repeat);
    if (!measured) return state.SkipWithError(measured.error().text().c_str());
    roofs()[name] = measured->roof;
    const double seconds = 1e-6 * measured->whole_us;
    state.SetIterationTime(seconds);
    rates()[name].push_back(gop / seconds);
  }
  state.counters["GOP/s"] = benchmark::Counter(gop * static_cast<double>(state.iterations()),
                                               benchmark::Counter::kIsRate);
}

void bench_convolution(benchmark::State& state, const Case& c, const std::string& kernel) {
  CompileOptions options;
  options.kernels = {kernel};
  options.targets = {"device"};  // as many live sums as this processor has registers for
  options.profiles.emplace("device", profile_from_caps(device().context().caps));
  Result<Compiled> compiled = compile_graph(convolution(c), 0, options);
  if (!compiled) return state.SkipWithError(compiled.error().text().c_str());
  const Variant& variant = compiled->package.variants[0];
  if (variant.segments[0].dispatches[0].kernel != kernel)
    return state.SkipWithError("another kernel was chosen");
  const Tensor x = Tensor::zeros({DType::kInt8, input_shape(c)});
  const double gop =
      2e-9 * static_cast<double>(9 * (c.depthwise ? 1 : c.in) * c.out * c.height * c.width);
  measure(state, rate_name(c, kernel), compiled->package, {x}, gop, kernel == "generic" ? 1 : 9);
}

/// One line for each kernel of each case, as Markdown.
void print_ratios() {
  fmt::print(
      "\n{}, {}\n\n| convolution | kernel | GOP/s | times naive | roof | of roof |\n"
      "|---|---|---:|---:|---:|---:|\n",
      device().context().caps.name, device().context().caps.driver);
  for (const Case& c : kCases)
    for (const std::string_view kernel : kKernels) {
      const std::string name = rate_name(c, kernel);
      const double rate = median_rate(name), naive = median_rate(rate_name(c, "generic"));
      if (rate > 0)
        fmt::print("| {}, {}x{} | {} | {:.1f} | {} | {:.1f} | {:.0f} % |\n", c.name, c.width,
                   c.height, kernel, rate, naive > 0 ? fmt::format("{:.1f}", rate / naive) : "",
                   roofs()[name], 100 * rate / roofs()[name]);
    }
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  using shale::Case;
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  for (const Case& c : shale::kCases)
    for (const std::string_view kernel : shale::kKernels)
      if (shale::is_for(c, kernel))
        benchmark::RegisterBenchmark(shale::rate_name(c, kernel).c_str(),
                                     [&c, kernel](benchmark::State& state) {
                                       shale::bench_convolution(state, c, std::string(kernel));
                                     })
            ->UseManualTime()
            ->Unit(benchmark::kMillisecond)
            ->Iterations(1);
  benchmark::RunSpecifiedBenchmarks();
  shale::print_ratios();
  return 0;
}
