// Convolutions on the device at hand: the fast families against the naive kernel and the mul+add
// roof, in one run; the roof is measured anew around each.
//
//   kernel_bench [--benchmark_repetitions=5 ...]
//
// After the convolutions other operators, of which the naive kernel is `generic`: 2 for each product, or one for each
// element of the result.
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
#include "ir/text/text.h"
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

/// An operator at a size that networks have, in text; its inputs are zeros.
struct Operator {
  const char* name;
  const char* text;        ///< from the graph's inputs to %y
  double gop;              ///< of a run
  const char* kernel;      ///< besides the naive one
  int64_t weights = 0;     ///< elements of an %w that is drawn, of the shape before it
  const char* shape = "";  ///< of %w: "f32[32,3,3,32]"
};
constexpr double kPicture = 960.0 * 540, kHalf = 480.0 * 270;
#define SHALE_CONV "{pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type="
constexpr Operator kOperators[] = {
    {"conv2d fp32 32->32, 480x270",
     "input %x : f32[1,270,480,32] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f32[1,270,480,32]",
     2e-9 * 9 * 32 * 32 * kHalf, "conv2d_real", 9 * 32 * 32, "f32[32,3,3,32]"},
    {"conv2d fp16 32->32, 480x270",
     "input %x : f16[1,270,480,32] const %b : f16[1] = [0] const %z : f16[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f16[1,270,480,32]",
     2e-9 * 9 * 32 * 32 * kHalf, "conv2d_real", 9 * 32 * 32, "f16[32,3,3,32]"},
    {"conv2d int16 32->32, 480x270",
     "input %x : i16[1,270,480,32] const %b : i48[1] = [0] const %z : i16[1] = [0] "
     "const %v : i8[1] = [0] const %m : i16[1] = [16384] const %s : i8[1] = [30] "
     "const %o : i48[1] = [0] %a = conv2d %x, %w, %b, %z, %v " SHALE_CONV
     "i48} : i48[1,270,480,32] %y = rescale %a, %m, %s, %o, %z {scale32=false, "
     "rounding_mode=single, per_channel=false, input_unsigned=false, output_unsigned=false} "
     ": i16[1,270,480,32]",
     2e-9 * 9 * 32 * 32 * kHalf, "conv2d_s16_f64", 9 * 32 * 32, "i8[32,3,3,32]"},
    {"conv2d int8, weights not constant, 240x135",
     "input %x : i8[1,135,240,32] input %w : i8[32,3,3,32] const %b : i32[1] = [0] "
     "const %z : i8[1] = [0] %y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "i32} : i32[1,135,240,32]",
     2e-9 * 9 * 32 * 32 * kHalf / 4, "runs"},
    {"depthwise fp32 32, 480x270",
     "input %x : f32[1,270,480,32] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = depthwise_conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f32[1,270,480,32]",
     2e-9 * 9 * 32 * kHalf, "runs", 9 * 32, "f32[3,3,32,1]"},
    {"transpose_conv2d int8 32->32, 2x2, to 480x270",
     "input %x : i8[1,135,240,32] const %b : i32[1] = [0] const %z : i8[1] = [0] "
     "%y = transpose_conv2d %x, %w, %b, %z, %z {out_pad=[0,0,0,0], stride=[2,2], acc_type=i32} "
     ": i32[1,270,480,32]",
     2e-9 * 32 * 32 * kHalf, "runs", 4 * 32 * 32, "i8[32,2,2,32]"},
    {"conv3d int8 16->16, 8x60x60",
     "input %x : i8[1,8,60,60,16] const %b : i32[1] = [0] const %z : i8[1] = [0] "
     "%y = conv3d %x, %w, %b, %z, %z {pad=[1,1,1,1,1,1], stride=[1,1,1], dilation=[1,1,1], "
     "acc_type=i32} : i32[1,8,60,60,16]",
     2e-9 * 27 * 16 * 16 * 8 * 3600, "runs", 27 * 16 * 16, "i8[16,3,3,3,16]"},
    {"matmul int8 384x384x384",
     "input %a : i8[1,384,384] input %b : i8[1,384,384] const %z : i8[1] = [0] "
     "%y = matmul %a, %b, %z, %z : i32[1,384,384]",
     2e-9 * 384 * 384 * 384, "runs"},
    {"matmul fp32 384x384x384",
     "input %a : f32[1,384,384] input %b : f32[1,384,384] const %z : f32[1] = [0] "
     "%y = matmul %a, %b, %z, %z : f32[1,384,384]",
     2e-9 * 384 * 384 * 384, "runs"},
    {"max_pool2d int8 2x2 of 960x540x16",
     "input %x : i8[1,540,960,16] %y = max_pool2d %x {kernel=[2,2], stride=[2,2], "
     "pad=[0,0,0,0]} : i8[1,270,480,16]",
     1e-9 * 16 * kHalf, "runs"},
    {"avg_pool2d int8 2x2 of 960x540x16",
     "input %x : i8[1,540,960,16] const %z : i8[1] = [0] %y = avg_pool2d %x, %z, %z "
     "{kernel=[2,2], stride=[2,2], pad=[0,0,0,0], acc_type=i32} : i8[1,270,480,16]",
     1e-9 * 16 * kHalf, "runs"},
    {"resize bilinear int8 x2 to 960x540x16",
     "input %x : i8[1,270,480,16] const %s : shape[4] = [4,2,4,2] const %o : shape[2] = [-1,-1] "
     "const %b : shape[2] = [1,1] %y = resize %x, %s, %o, %b {mode=bilinear} : i32[1,540,960,16]",
     1e-9 * 16 * kPicture, "runs"},
    {"add and maximum int32 960x540x4",
     "input %a : i32[1,540,960,4] input %b : i32[1,540,960,4] %s = add %a, %b : i32[1,540,960,4] "
     "%y = maximum %s, %a : i32[1,540,960,4]",
     1e-9 * 4 * kPicture, "runs"},
    {"rescale int8 960x540x16",
     "input %x : i8[1,540,960,16] const %m : i32[1] = [1073741824] const %s : i8[1] = [31] "
     "const %z : i8[1] = [0] %y = rescale %x, %m, %s, %z, %z {scale32=true, "
     "rounding_mode=single, per_channel=false, input_unsigned=false, output_unsigned=false} "
     ": i8[1,540,960,16]",
     1e-9 * 16 * kPicture, "runs"},
    {"concat int8 of 16 and 16, 960x540",
     "input %a : i8[1,540,960,16] input %b : i8[1,540,960,16] %y = concat %a, %b {axis=3} "
     ": i8[1,540,960,32]",
     1e-9 * 32 * kPicture, "runs"},
    {"transpose int8 NHWC to NCHW, 480x270x32",
     "input %x : i8[1,270,480,32] %y = transpose %x {perms=[0,3,1,2]} : i8[1,32,270,480]",
     1e-9 * 32 * kHalf, "runs"},
    {"reduce_max int8 over 480, 270x480x32",
     "input %x : i8[1,270,480,32] %y = reduce_max %x {axis=2} : i8[1,270,1,32]", 1e-9 * 32 * kHalf,
     "runs"},
    {"reduce_sum int32 over channels, 480x270x32",
     "input %x : i32[1,270,480,32] %y = reduce_sum %x {axis=3} : i32[1,270,480,1]",
     1e-9 * 32 * kHalf, "runs"},
    {"argmax int8 over channels, 480x270x32",
     "input %x : i8[1,270,480,32] %y = argmax %x {axis=3} : i32[1,270,480]", 1e-9 * 32 * kHalf,
     "runs"},
    {"gather int8 of 64, 100,000 rows",
     "input %x : i8[1,1000,64] input %i : i32[1,100000] %y = gather %x, %i : i8[1,100000,64]",
     1e-9 * 64 * 100000, "runs"},
};
#undef SHALE_CONV

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

Result<Graph> operator_graph(const Operator& c) {
  std::string weights;
  if (c.weights > 0) {
    std::mt19937_64 generator(1);
    std::vector<int64_t> values(static_cast<size_t>(c.weights));
    for (int64_t& value : values) value = static_cast<int64_t>(generator() % 255) - 127;
    weights = fmt::format("const %w : {} = [{}] ", c.shape, fmt::join(values, ","));
  }
  return parse_text(fmt::format("graph main {{ {}{} return %y }}", weights, c.text));
}

void bench_operator(benchmark::State& state, const Operator& c, const std::string& kernel) {
  CompileOptions options;
  options.kernels = {kernel};
  options.targets = {"device"};
  options.profiles.emplace("device", profile_from_caps(device().context().caps));
  const Result<Graph> graph = operator_graph(c);
  if (!graph) return state.SkipWithError(graph.error().text().c_str());
  Result<Compiled> compiled = compile_graph(*graph, 0, options);
  if (!compiled) return state.SkipWithError(compiled.error().text().c_str());
  if (compiled->package.variants[0].segments[0].dispatches[0].kernel != kernel)
    return state.SkipWithError("another kernel was chosen");
  std::vector<Tensor> inputs;
  for (const ValueId id : graph->inputs) inputs.push_back(Tensor::zeros(graph->value(id).type));
  measure(state, fmt::format("{}/{}", c.name, kernel), compiled->package, inputs, c.gop,
          kernel == "generic" ? 1 : 9);
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
  fmt::print(
      "\n| operator | kernel | ms | G/s | times naive | roof |\n|---|---|---:|---:|---:|---:|\n");
  for (const Operator& c : kOperators) {
    const std::string name = fmt::format("{}/{}", c.name, c.kernel);
    const double rate = median_rate(name), naive = median_rate(fmt::format("{}/generic", c.name));
    if (rate > 0 && naive > 0)
      fmt::print("| {} | {} | {:.2f} | {:.2f} | {:.1f} | {:.1f} |\n", c.name, c.kernel,
                 1e3 * c.gop / rate, rate, rate / naive, roofs()[name]);
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
  for (const shale::Operator& c : shale::kOperators)
    for (const std::string kernel : {"generic", c.kernel})
      benchmark::RegisterBenchmark(
          fmt::format("{}/{}", c.name, kernel).c_str(),
          [&c, kernel](benchmark::State& state) { shale::bench_operator(state, c, kernel); })
          ->UseManualTime()
          ->Unit(benchmark::kMillisecond)
          ->Iterations(1);
  benchmark::RunSpecifiedBenchmarks();
  shale::print_ratios();
  return 0;
}
