// Convolutions on the device at hand: the fast families against the naive kernel and the mul+add
// roof, in one run.
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
#include "compiler/spirv/glsl.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

struct Case {
  int64_t channels, height, width;
};
constexpr Case kCases[] = {{16, 540, 960}, {32, 540, 960}, {64, 270, 480}};

/// Weights, bias and scales are random but typical: weights use the whole int8 range.
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
  const Shape shape{1, c.height, c.width, c.channels};
  const ValueId x = graph.add_input("x", {DType::kInt8, shape});
  const ValueId w = constant(graph, "w", DType::kInt8, {c.channels, 3, 3, c.channels}, -127, 127);
  const ValueId b = constant(graph, "b", DType::kInt32, {c.channels}, -20000, 20000);
  const ValueId zp = constant(graph, "zp", DType::kInt8, {1}, -128, -128);
  const ValueId zero = constant(graph, "zero", DType::kInt8, {1}, 0, 0);
  const ValueId zero32 = constant(graph, "zero32", DType::kInt32, {1}, 0, 0);
  const ValueId m =
      constant(graph, "m", DType::kInt32, {c.channels}, int64_t{1} << 30, (int64_t{1} << 31) - 1);
  const ValueId s = constant(graph, "s", DType::kInt8, {c.channels}, 39, 40);
  Attrs conv;
  conv.set(Attr::kPad, std::vector<int64_t>{1, 1, 1, 1})
      .set(Attr::kStride, std::vector<int64_t>{1, 1});
  conv.set(Attr::kDilation, std::vector<int64_t>{1, 1}).set(Attr::kLocalBound, 0);
  conv.set(Attr::kAccType, static_cast<int64_t>(DType::kInt32));
  const ValueId acc =
      graph.add_node(Op::kConv2d, conv, {x, w, b, zp, zero}, "acc", {DType::kInt32, shape});
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

/// 0 if the benchmark was not run.
double median_rate(const std::string& name) {
  std::vector<double> values = rates()[name];
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

void measure(benchmark::State& state, const std::string& name, const Package& package,
             const std::vector<Tensor>& inputs, double gop) {
  for (auto _ : state) {
    std::vector<DispatchTime> times;
    const auto outputs = run_network(device(), package, inputs, 1, &times);
    if (!outputs) {
      state.SkipWithError(outputs.error().text().c_str());
      return;
    }
    double seconds = 0;
    for (const DispatchTime& time : times) seconds += 1e-6 * time.time_us;
    state.SetIterationTime(seconds);
    rates()[name].push_back(gop / seconds);
  }
  state.counters["GOP/s"] = benchmark::Counter(gop * static_cast<double>(state.iterations()),
                                               benchmark::Counter::kIsRate);
}

void bench_convolution(benchmark::State& state, const Case& c, const std::string& kernel) {
  CompileOptions options;
  options.kernels = {kernel};
  Result<Compiled> compiled = compile_graph(convolution(c), 0, options);
  if (!compiled) return state.SkipWithError(compiled.error().text().c_str());
  const Variant& variant = compiled->package.variants[0];
  if (variant.segments[0].dispatches[0].kernel != kernel)
    return state.SkipWithError("another kernel was chosen");
  const Tensor x = Tensor::zeros({DType::kInt8, {1, c.height, c.width, c.channels}});
  const double gop = 2e-9 * static_cast<double>(9 * c.channels * c.channels * c.height * c.width);
  measure(state, fmt::format("{}/{}", kernel, c.channels), compiled->package, {x}, gop);
}

/// The roof of a direct convolution: multiply and add in registers, 16 independent sums.
void bench_roof(benchmark::State& state) {
  constexpr int kGroups = 4096, kLocal = 64, kSteps = 256;
  std::string body;
  for (int i = 0; i < 16; ++i) body += fmt::format("  float a{0} = x + {0}.0;\n", i);
  body += fmt::format("  for (int k = 0; k < {}; ++k) {{\n", kSteps);
  for (int i = 0; i < 16; ++i) body += fmt::format("    a{0} = a{0} * x + 0.{0}1;\n", i);
  body += "  }\n  float sum = 0.0";
  for (int i = 0; i < 16; ++i) body += fmt::format(" + a{}", i);
  const std::string source =
      "#version 450\nlayout(local_size_x = 64) in;\nlayout(set = 0, binding = 0, std430) writeonly "
      "buffer Y { int y[]; };\n"
      "layout(set = 0, binding = 1, std430) readonly buffer X { int v[]; };\nvoid main() {\n"
      "  float x = float(v[gl_GlobalInvocationID.x & 3u]);\n" +
      body + ";\n  y[gl_GlobalInvocationID.x] = int(sum);\n}\n";
  Result<Spirv> words = compile_glsl(source, {}, "roof");
  if (!words) return state.SkipWithError(words.error().text().c_str());
  Package package;
  Variant variant;
  variant.target = "roof";
  Resource x, y;
  x.name = "x", x.category = Category::kInput, x.dtype = DType::kInt32, x.shape = {4},
  x.size_bytes = 16;
  y.name = "y", y.category = Category::kOutput, y.dtype = DType::kInt32,
  y.shape = {kGroups * kLocal}, y.size_bytes = 4 * kGroups * kLocal;
  variant.resources = {x, y};
  variant.modules = {*words};
  variant.requirements.workgroup_invocations = kLocal;
  variant.requirements.storage_buffers = 2;
  variant.requirements.storage_range_bytes = y.size_bytes;
  Dispatch dispatch;
  dispatch.name = "y";
  dispatch.kernel = "roof";
  dispatch.workgroups = {kGroups, 1, 1};
  dispatch.bindings = {{0, BindingType::kStorageBuffer, 1, ImageFormat::kNone, false, true, 0},
                       {1, BindingType::kStorageBuffer, 0, ImageFormat::kNone, true, false, 0}};
  variant.segments = {{"graph", SegmentKind::kGraph, {dispatch}}};
  package.variants = {variant};
  measure(state, "roof", package, {Tensor::zeros({DType::kInt32, {4}})},
          2e-9 * kGroups * kLocal * kSteps * 16);
}

void print_ratios() {
  const double roof = median_rate("roof");
  fmt::print(
      "\n{}: median GOP/s of each, ratio to the naive kernel, share of the mul+add roof ({:.1f} "
      "GFLOP/s)\n",
      device().context().caps.name, roof);
  for (const Case& c : kCases) {
    const double naive = median_rate(fmt::format("generic/{}", c.channels));
    for (const char* kernel : {"generic", "conv2d_s8_i32", "conv2d_s8_f32exact"}) {
      const double rate = median_rate(fmt::format("{}/{}", kernel, c.channels));
      if (rate > 0)
        fmt::print(
            "  3x3 {0:>2}->{0:<2} {1:>3}x{2:<3}  {3:<20} {4:>8.2f} GOP/s {5:>7.1f}x {6:>6.1f} %\n",
            c.channels, c.width, c.height, kernel, rate, rate / naive, 100 * rate / roof);
    }
  }
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  using shale::Case;
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RegisterBenchmark("roof/f32_mul_add", shale::bench_roof)
      ->UseManualTime()
      ->Iterations(7);
  for (const Case& c : shale::kCases)
    for (const char* kernel : {"generic", "conv2d_s8_i32", "conv2d_s8_f32exact"})
      benchmark::RegisterBenchmark(
          fmt::format("conv3x3/{}/{}x{}x{}", kernel, c.channels, c.width, c.height).c_str(),
          [&c, kernel = std::string(kernel)](benchmark::State& state) {
            shale::bench_convolution(state, c, kernel);
          })
          ->UseManualTime()
          ->Unit(benchmark::kMillisecond)
          ->Iterations(kernel == std::string("generic") ? 3 : 7);
  benchmark::RunSpecifiedBenchmarks();
  shale::print_ratios();
  return 0;
}
