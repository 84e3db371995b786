// Convolutions on the device at hand: the fast families against the naive kernel and the mul+add
// roof, in one run; the roof is measured anew around each.
//
//   kernel_bench [--benchmark_repetitions=5 ...]
//
// After the convolutions every class of operators: what selection takes against the naive kernel by turns, with 2 for each
// product, or one for each element of the result. Times are those of processors, so that a machine with other work tells the
// ratios too; the share of the float32 roof and of the rate at which memory is copied stand beside them.
//
// GOP/s counts 2 per multiply-accumulate of the direct form, requantization included, by device
// timestamps. At the end it prints the ratios. A convolution is int8, 3x3, stride 1, padded,
// per-channel requantized and clamped.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstring>
#include <ctime>
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

/// An operator at a size that networks have, in text; its inputs are random.
struct Operator {
  const char* name;
  const char* text;        ///< from the graph's inputs to %y
  double gop;              ///< of a run
  int64_t weights = 0;     ///< elements of an %w that is drawn, of the shape before it
  const char* shape = "";  ///< of %w: "f32[32,3,3,32]"
};
constexpr double kPicture = 960.0 * 540, kHalf = 480.0 * 270;
#define SHALE_CONV "{pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type="
constexpr Operator kOperators[] = {
    {"conv2d fp32 32->32, 480x270",
     "input %x : f32[1,270,480,32] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f32[1,270,480,32]",
     2e-9 * 9 * 32 * 32 * kHalf, 9 * 32 * 32, "f32[32,3,3,32]"},
    {"conv2d fp16 32->32, 480x270",
     "input %x : f16[1,270,480,32] const %b : f16[1] = [0] const %z : f16[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f16[1,270,480,32]",
     2e-9 * 9 * 32 * 32 * kHalf, 9 * 32 * 32, "f16[32,3,3,32]"},
    {"conv2d int16 32->32, 480x270",
     "input %x : i16[1,270,480,32] const %b : i48[1] = [0] const %z : i16[1] = [0] "
     "const %v : i8[1] = [0] const %m : i16[1] = [16384] const %s : i8[1] = [30] "
     "const %o : i48[1] = [0] %a = conv2d %x, %w, %b, %z, %v " SHALE_CONV
     "i48} : i48[1,270,480,32] %y = rescale %a, %m, %s, %o, %z {scale32=false, "
     "rounding_mode=single, per_channel=false, input_unsigned=false, output_unsigned=false} "
     ": i16[1,270,480,32]",
     2e-9 * 9 * 32 * 32 * kHalf, 9 * 32 * 32, "i8[32,3,3,32]"},
    {"conv2d int8, weights not constant, 240x135",
     "input %x : i8[1,135,240,32] input %w : i8[32,3,3,32] const %b : i32[1] = [0] "
     "const %z : i8[1] = [0] %y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "i32} : i32[1,135,240,32]",
     2e-9 * 9 * 32 * 32 * kHalf / 4},
    {"depthwise fp32 32, 480x270",
     "input %x : f32[1,270,480,32] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = depthwise_conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f32[1,270,480,32]",
     2e-9 * 9 * 32 * kHalf, 9 * 32, "f32[3,3,32,1]"},
    {"transpose_conv2d int8 32->32, 2x2, to 480x270",
     "input %x : i8[1,135,240,32] const %b : i32[1] = [0] const %z : i8[1] = [0] "
     "%y = transpose_conv2d %x, %w, %b, %z, %z {out_pad=[0,0,0,0], stride=[2,2], acc_type=i32} "
     ": i32[1,270,480,32]",
     2e-9 * 32 * 32 * kHalf, 4 * 32 * 32, "i8[32,2,2,32]"},
    {"conv3d int8 16->16, 8x60x60",
     "input %x : i8[1,8,60,60,16] const %b : i32[1] = [0] const %z : i8[1] = [0] "
     "%y = conv3d %x, %w, %b, %z, %z {pad=[1,1,1,1,1,1], stride=[1,1,1], dilation=[1,1,1], "
     "acc_type=i32} : i32[1,8,60,60,16]",
     2e-9 * 27 * 16 * 16 * 8 * 3600, 27 * 16 * 16, "i8[16,3,3,3,16]"},
    {"matmul int8 384x384x384",
     "input %a : i8[1,384,384] input %b : i8[1,384,384] const %z : i8[1] = [0] "
     "%y = matmul %a, %b, %z, %z : i32[1,384,384]",
     2e-9 * 384 * 384 * 384},
    {"matmul fp32 384x384x384",
     "input %a : f32[1,384,384] input %b : f32[1,384,384] const %z : f32[1] = [0] "
     "%y = matmul %a, %b, %z, %z : f32[1,384,384]",
     2e-9 * 384 * 384 * 384},
    {"max_pool2d int8 2x2 of 960x540x16",
     "input %x : i8[1,540,960,16] %y = max_pool2d %x {kernel=[2,2], stride=[2,2], "
     "pad=[0,0,0,0]} : i8[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"avg_pool2d int8 2x2 of 960x540x16",
     "input %x : i8[1,540,960,16] const %z : i8[1] = [0] %y = avg_pool2d %x, %z, %z "
     "{kernel=[2,2], stride=[2,2], pad=[0,0,0,0], acc_type=i32} : i8[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"resize bilinear int8 x2 to 960x540x16",
     "input %x : i8[1,270,480,16] const %s : shape[4] = [4,2,4,2] const %o : shape[2] = [-1,-1] "
     "const %b : shape[2] = [1,1] %y = resize %x, %s, %o, %b {mode=bilinear} : i32[1,540,960,16]",
     1e-9 * 16 * kPicture},
    {"add and maximum int32 960x540x4",
     "input %a : i32[1,540,960,4] input %b : i32[1,540,960,4] %s = add %a, %b : i32[1,540,960,4] "
     "%y = maximum %s, %a : i32[1,540,960,4]",
     1e-9 * 4 * kPicture},
    {"rescale int8 960x540x16",
     "input %x : i8[1,540,960,16] const %m : i32[1] = [1073741824] const %s : i8[1] = [31] "
     "const %z : i8[1] = [0] %y = rescale %x, %m, %s, %z, %z {scale32=true, "
     "rounding_mode=single, per_channel=false, input_unsigned=false, output_unsigned=false} "
     ": i8[1,540,960,16]",
     1e-9 * 16 * kPicture},
    {"concat int8 of 16 and 16, 960x540",
     "input %a : i8[1,540,960,16] input %b : i8[1,540,960,16] %y = concat %a, %b {axis=3} "
     ": i8[1,540,960,32]",
     1e-9 * 32 * kPicture},
    {"transpose int8 NHWC to NCHW, 480x270x32",
     "input %x : i8[1,270,480,32] %y = transpose %x {perms=[0,3,1,2]} : i8[1,32,270,480]",
     1e-9 * 32 * kHalf},
    {"reduce_max int8 over 480, 270x480x32",
     "input %x : i8[1,270,480,32] %y = reduce_max %x {axis=2} : i8[1,270,1,32]", 1e-9 * 32 * kHalf},
    {"reduce_sum int32 over channels, 480x270x32",
     "input %x : i32[1,270,480,32] %y = reduce_sum %x {axis=3} : i32[1,270,480,1]",
     1e-9 * 32 * kHalf},
    {"argmax int8 over channels, 480x270x32",
     "input %x : i8[1,270,480,32] %y = argmax %x {axis=3} : i32[1,270,480]", 1e-9 * 32 * kHalf},
    {"gather int8 of 64, 100,000 rows",
     "input %x : i8[1,1000,64] input %i : i32[1,100000] %y = gather %x, %i : i8[1,100000,64]",
     1e-9 * 64 * 100000},
    {"conv2d fp32 16->16, 960x540",
     "input %x : f32[1,540,960,16] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z " SHALE_CONV "f32} : f32[1,540,960,16]",
     2e-9 * 9 * 16 * 16 * kPicture, 9 * 16 * 16, "f32[16,3,3,16]"},
    {"fully connected fp32 512->256, 1024 rows",
     "input %x : f32[1,32,32,512] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=f32} "
     ": f32[1,32,32,256]",
     2e-9 * 1024 * 512 * 256, 512 * 256, "f32[256,1,1,512]"},
    {"fully connected int8 512->256, 1024 rows",
     "input %x : i8[1,32,32,512] const %b : i32[1] = [0] const %z : i8[1] = [0] "
     "%y = conv2d %x, %w, %b, %z, %z {pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} "
     ": i32[1,32,32,256]",
     2e-9 * 1024 * 512 * 256, 512 * 256, "i8[256,1,1,512]"},
    {"depthwise int8 32, 480x270",
     "input %x : i8[1,270,480,32] const %b : i32[1] = [0] const %z : i8[1] = [0] "
     "const %m : i32[1] = [1073741824] const %s : i8[1] = [38] const %o : i32[1] = [0] "
     "%a = depthwise_conv2d %x, %w, %b, %z, %z " SHALE_CONV "i32} : i32[1,270,480,32] "
     "%y = rescale %a, %m, %s, %o, %z {scale32=true, rounding_mode=single, per_channel=false, "
     "input_unsigned=false, output_unsigned=false} : i8[1,270,480,32]",
     2e-9 * 9 * 32 * kHalf, 9 * 32, "i8[3,3,32,1]"},
    {"conv3d fp32 16->16, 8x60x60",
     "input %x : f32[1,8,60,60,16] const %b : f32[1] = [0] const %z : f32[1] = [0] "
     "%y = conv3d %x, %w, %b, %z, %z {pad=[1,1,1,1,1,1], stride=[1,1,1], dilation=[1,1,1], "
     "acc_type=f32} : f32[1,8,60,60,16]",
     2e-9 * 27 * 16 * 16 * 8 * 3600, 27 * 16 * 16, "f32[16,3,3,3,16]"},
    {"matmul fp16 384x384x384",
     "input %a : f16[1,384,384] input %b : f16[1,384,384] const %z : f16[1] = [0] "
     "%y = matmul %a, %b, %z, %z : f32[1,384,384]",
     2e-9 * 384 * 384 * 384},
    {"rfft2d fp32 8x128x128",
     "input %x : f32[8,128,128] %y = rfft2d %x {part=real} : f32[8,128,65]",
     2e-9 * 8 * 128 * 65 * (128 + 2 * 128)},
    {"avg_pool2d fp32 3x3 of 480x270x16",
     "input %x : f32[1,270,480,16] const %z : f32[1] = [0] %y = avg_pool2d %x, %z, %z "
     "{kernel=[3,3], stride=[1,1], pad=[1,1,1,1], acc_type=f32} : f32[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"max_pool2d fp32 2x2 of 960x540x16",
     "input %x : f32[1,540,960,16] %y = max_pool2d %x {kernel=[2,2], stride=[2,2], "
     "pad=[0,0,0,0], nan_mode=propagate} : f32[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"resize nearest int8 x2 to 960x540x16",
     "input %x : i8[1,270,480,16] const %s : shape[4] = [4,2,4,2] const %o : shape[2] = [-1,-1] "
     "const %b : shape[2] = [1,1] %y = resize %x, %s, %o, %b {mode=nearest} : i8[1,540,960,16]",
     1e-9 * 16 * kPicture},
    {"resize bilinear fp32 x2 to 960x540x16",
     "input %x : f32[1,270,480,16] const %s : shape[4] = [4,2,4,2] const %o : shape[2] = [-1,-1] "
     "const %b : shape[2] = [1,1] %y = resize %x, %s, %o, %b {mode=bilinear} : f32[1,540,960,16]",
     1e-9 * 16 * kPicture},
    {"multiply, add, clamp fp32 960x540x4",
     "input %a : f32[1,540,960,4] input %b : f32[1,540,960,4] const %h : i8[1] = [0] "
     "%m = mul %a, %b, %h : f32[1,540,960,4] %s = add %m, %a : f32[1,540,960,4] "
     "%y = clamp %s {min_val=0, max_val=1.0, nan_mode=propagate} : f32[1,540,960,4]",
     1e-9 * 4 * kPicture},
    {"sigmoid fp32 480x270x16", "input %x : f32[1,270,480,16] %y = sigmoid %x : f32[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"exp fp32 480x270x16", "input %x : f32[1,270,480,16] %y = exp %x : f32[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"sin fp32 480x270x16", "input %x : f32[1,270,480,16] %y = sin %x : f32[1,270,480,16]",
     1e-9 * 16 * kHalf},
    {"table int8 960x540x16", "input %x : i8[1,540,960,16] %y = table %x, %w : i8[1,540,960,16]",
     1e-9 * 16 * kPicture, 256, "i8[256]"},
    {"table int16 480x270x16", "input %x : i16[1,270,480,16] %y = table %x, %w : i32[1,270,480,16]",
     1e-9 * 16 * kHalf, 513, "i16[513]"},
    {"transpose fp32 1024x1024",
     "input %x : f32[1024,1024] %y = transpose %x {perms=[1,0]} : "
     "f32[1024,1024]",
     1e-9 * 1024 * 1024},
    {"reduce_sum fp32 over 480, 270x480x32",
     "input %x : f32[1,270,480,32] %y = reduce_sum %x {axis=2} : f32[1,270,1,32]",
     1e-9 * 32 * kHalf},
    {"argmax fp32 over channels, 480x270x32",
     "input %x : f32[1,270,480,32] %y = argmax %x {axis=3, nan_mode=propagate} : i32[1,270,480]",
     1e-9 * 32 * kHalf},
    {"scatter int8 of 64, 1,000 of 4,000 rows",
     "input %x : i8[1,4000,64] input %i : i32[1,1000] input %v : i8[1,1000,64] "
     "%y = scatter %x, %i, %v : i8[1,4000,64]",
     1e-9 * 64 * 4000},
    {"cast fp32 to int8 960x540x4", "input %x : f32[1,540,960,4] %y = cast %x : i8[1,540,960,4]",
     1e-9 * 4 * kPicture},
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
    // Integers repeat, which is less code for literals of them; real numbers do not.
    const bool is_real = c.shape[0] == 'f';
    std::vector<double> values(static_cast<size_t>(c.weights));
    for (double& value : values)
      value = is_real ? static_cast<double>(generator() % 65536) / 32768 - 1
                      : static_cast<double>(generator() % 255) - 127;
    weights = fmt::format("const %w : {} = [{}] ", c.shape, fmt::join(values, ","));
  }
  return parse_text(fmt::format("graph main {{ {}{} return %y }}", weights, c.text));
}

/// Random numbers of the whole range of small types; int32 are indices below 1,000.
Tensor random_input(const TensorType& type) {
  Tensor tensor = Tensor::zeros(type);
  std::mt19937 generator(1);
  for (int64_t i = 0; i < tensor.count(); ++i) {
    if (is_float(type.dtype))
      tensor.set_real(i, static_cast<float>(generator() % 4096) / 1024.0f - 2.0f);
    else if (type.dtype == DType::kInt32)
      tensor.set(i, generator() % 1000);
    else
      tensor.set(
          i, dtype_range(type.dtype).min +
                 static_cast<int64_t>(generator() % (uint32_t{1} << dtype_info(type.dtype).bits)));
  }
  return tensor;
}

/// Seconds of all processors that this process has had: what others take from them does not count.
double processor_seconds() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// GB that a processor copies in a second, read and written, beyond its caches.
double memory_rate() {
  constexpr size_t kBytes = size_t{128} << 20;
  static std::vector<char> from(kBytes, 1), to(kBytes, 2);
  const double start = processor_seconds();
  std::memcpy(to.data(), from.data(), kBytes);
  return 2e-9 * static_cast<double>(kBytes) / (processor_seconds() - start);
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

/// What was measured of an operator.
struct Measured {
  std::string kernels;                    ///< that were chosen
  double seconds = 0, naive_seconds = 0;  ///< of a processor, for a run
  // The roofs of a processor, meanwhile: arithmetic, memory, the driver's fetches and stores.
  double gops = 0, gbytes = 0, fetched = 0, stored = 0;
  double read_gb = 0, written_gb = 0;  ///< inputs and constants, results, each once
};
std::map<std::string, Measured>& measured() {
  static std::map<std::string, Measured> all;
  return all;
}

Result<Compiled> compile_operator(const Graph& graph, bool is_naive) {
  CompileOptions options;
  if (is_naive) options.kernels = {"generic"};
  options.expected_runs = 1000;
  options.targets = {"device"};
  options.profiles.emplace("device", profile_from_caps(device().context().caps));
  return compile_graph(graph, 0, options);
}

/// The kernels that are chosen for 1,000 runs and the naive ones by turns, the roofs around each.
Result<Measured> measure_operator(const Operator& c) {
  Measured found;
  SHALE_TRY(const Graph graph, operator_graph(c));
  SHALE_TRY(const Compiled chosen, compile_operator(graph, false));
  SHALE_TRY(const Compiled naive, compile_operator(graph, true));
  std::map<std::string, int> names;
  for (const Segment& segment : chosen.package.variants[0].segments)
    for (const Dispatch& dispatch : segment.dispatches) ++names[dispatch.kernel];
  for (const auto& [name, count] : names)
    found.kernels += fmt::format("{}{}{}", found.kernels.empty() ? "" : ", ", name,
                                 count > 1 ? fmt::format(" ({})", count) : "");
  std::vector<Tensor> inputs;
  const auto gb = [&](ValueId id) {
    const TensorType& type = graph.value(id).type;
    return 1e-9 * static_cast<double>(element_count(type.shape).value_or(0) *
                                      dtype_info(type.dtype).host_bytes);
  };
  for (const ValueId id : graph.inputs) {
    inputs.push_back(random_input(graph.value(id).type));
    found.read_gb += gb(id);
  }
  for (const ValueId id : graph.outputs) found.written_gb += gb(id);
  SHALE_TRY(NetworkRun fast, NetworkRun::create(device(), chosen.package, inputs));
  SHALE_TRY(NetworkRun slow, NetworkRun::create(device(), naive.package, inputs));
  static Result<RoofProbe> roofs[] = {RoofProbe::create(device()),
                                      RoofProbe::create(device(), RoofKind::kFetch),
                                      RoofProbe::create(device(), RoofKind::kStore)};
  for (const Result<RoofProbe>& roof : roofs)
    if (!roof) return roof.error();
  const auto seconds = [](NetworkRun& run) -> Result<double> {
    const double start = processor_seconds();
    SHALE_TRY_VOID(run.run());
    return processor_seconds() - start;
  };
  SHALE_TRY_VOID(fast.run());
  const bool is_long = c.gop > 1;  // the driver's own time does not show there
  if (!is_long) SHALE_TRY_VOID(slow.run());
  std::vector<double> ours, theirs, gbytes, rates[std::size(roofs)];
  for (int turn = 0; turn < (is_long ? 1 : 3); ++turn) {
    SHALE_TRY(const double slow_seconds, seconds(slow));
    theirs.push_back(slow_seconds);
    for (int i = 0; i < 3; ++i) {
      SHALE_TRY(const double fast_seconds, seconds(fast));
      ours.push_back(fast_seconds);
    }
    for (size_t i = 0; i < std::size(roofs); ++i) {
      const double start = processor_seconds();
      SHALE_TRY_VOID(roofs[i]->measure());
      rates[i].push_back(1e-9 * roofs[i]->work() / (processor_seconds() - start));
    }
    gbytes.push_back(memory_rate());
  }
  found.seconds = median(ours);
  found.naive_seconds = median(theirs);
  found.gops = median(rates[0]);
  found.fetched = median(rates[1]);
  found.stored = median(rates[2]);
  found.gbytes = median(gbytes);
  return found;
}

void bench_operator(benchmark::State& state, const Operator& c) {
  for (auto _ : state) {
    const Result<Measured> found = measure_operator(c);
    if (!found) return state.SkipWithError(found.error().text().c_str());
    state.SetIterationTime(found->seconds);
    measured()[c.name] = *found;
  }
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
      "\nMilliseconds of one processor.\n\n| operator | kernel | ms | naive | times naive | G/s | "
      "of "
      "roof | GB/s | of memory roof | of fetches and stores |\n"
      "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|\n");
  for (const Operator& c : kOperators) {
    const auto found = measured().find(c.name);
    if (found == measured().end()) continue;
    const Measured& m = found->second;
    const double gops = c.gop / m.seconds, gbytes = (m.read_gb + m.written_gb) / m.seconds;
    fmt::print(
        "| {} | {} | {:.1f} | {:.1f} | {:.1f} | {:.2f} | {:.0f} % | {:.1f} | {:.0f} % | {:.0f} % "
        "|\n",
        c.name, m.kernels, 1e3 * m.seconds, 1e3 * m.naive_seconds, m.naive_seconds / m.seconds,
        gops, 100 * gops / m.gops, gbytes, 100 * gbytes / m.gbytes,
        100 * (m.read_gb / m.fetched + m.written_gb / m.stored) / m.seconds);
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
    benchmark::RegisterBenchmark(c.name,
                                 [&c](benchmark::State& state) { shale::bench_operator(state, c); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond)
        ->Iterations(1);
  benchmark::RunSpecifiedBenchmarks();
  shale::print_ratios();
  return 0;
}
