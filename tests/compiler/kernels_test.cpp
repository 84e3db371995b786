// Every row of kernels.def on every edge shape, on the device and bit for bit against the
// interpreter.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <tuple>

#include "compiler/driver/compile.h"
#include "tests/compiler/conv_case.h"
#include "tests/compiler/graph_support.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

/// The device class that a family is for.
std::string target_of(const std::string& kernel) {
  if (kernel == "conv2d_s8_dot8") return "dot8-gpu";
  const bool is_narrow = kernel == "conv2d_s8_f32exact" || kernel.ends_with("32");
  return is_narrow ? "lavapipe-avx2" : "lavapipe";
}

/// A device for all tests, under the validation layer where there is one.
class EveryKernel : public testing::TestWithParam<std::tuple<std::string, ConvCase>> {
 protected:
  static void SetUpTestSuite() {
    Result<ToolDevice> device = ToolDevice::open({.name = {}, .cache = {}, .validation = true});
    if (!device) {
      std::printf("not validated: %s\n", device.error().text().c_str());
      device = ToolDevice::open({});
    }
    if (device)
      device_ = std::make_unique<ToolDevice>(*std::move(device));
    else
      std::printf("%s\n", device.error().text().c_str());
  }
  static void TearDownTestSuite() { device_.reset(); }

  void SetUp() override {
    if (!device_) GTEST_SKIP() << "no Vulkan device";
  }
  void TearDown() override {
    if (!device_) return;
    for (const std::string& message : device_->take_validation_messages()) ADD_FAILURE() << message;
  }

  /// Compiles for the kernel alone.
  static Compiled compiled_for(const Graph& graph, const std::string& kernel, bool optimize) {
    CompileOptions options;
    options.targets = {target_of(kernel)};
    options.kernels = {kernel};
    options.optimize_spirv = false;
    options.pass_options.optimize = optimize;
    Compiled compiled = must(compile_graph(graph, 0, options));
    // Sums whose weights are not known have no bounds.
    const bool is_known = graph.inputs.size() == 1;
    if (is_known) {
      EXPECT_EQ(compiled.warnings, std::vector<std::string>());
    }
    return compiled;
  }

  static std::vector<std::string> kernels_of(const Compiled& compiled) {
    std::vector<std::string> taken;
    for (const Dispatch& dispatch : compiled.package.variants[0].segments[0].dispatches)
      taken.push_back(dispatch.kernel);
    return taken;
  }

  /// Compiles for the kernel alone and compares with the interpreter; returns the kernels that were
  /// taken.
  static std::vector<std::string> expect_exact(const Graph& graph, const std::string& kernel,
                                               bool optimize) {
    const Compiled compiled = compiled_for(graph, kernel, optimize);
    expect_exact(compiled, graph, kernel, optimize);
    return kernels_of(compiled);
  }
  static void expect_exact(const Compiled& compiled, const Graph& graph, const std::string& kernel,
                           bool optimize) {
    std::optional<NetworkRun> network;
    for (uint64_t seed = 1; seed <= 4; ++seed) {
      std::vector<Tensor> inputs = random_inputs(graph, seed);
      for (Tensor& input : inputs) {
        if (is_float(input.type.dtype)) {
          make_real(input, seed);
          continue;
        }
        // Then at the limits, all at one or each at one of them: the largest magnitudes.
        const IntRange range = dtype_range(input.type.dtype);
        for (int64_t i = 0; seed > 1 && i < input.count(); ++i)
          input.set(i, seed == 2 || (seed == 4 && input.get(i) < 0) ? range.min : range.max);
      }
      const std::vector<Tensor> expected = must(interpret(graph, inputs));
      if (!network)
        network = must(NetworkRun::create(*device_, compiled.package, inputs));
      else
        EXPECT_TRUE(network->set_inputs(inputs));
      EXPECT_TRUE(network->run());
      const std::vector<Tensor> found = network->outputs();
      for (size_t i = 0; i < expected.size(); ++i)
        if (const auto difference = first_difference(one_nan(found[i]), one_nan(expected[i])))
          ADD_FAILURE() << kernel << (optimize ? "" : " without passes") << ", inputs " << seed
                        << ", output " << i << ": " << *difference << "\n"
                        << print_text(compiled.graph);
    }
  }

  /// Numbers of several magnitudes, none so small that a product becomes subnormal, which drivers may
  /// flush; then some so large that sums are infinite; then infinities among them, and NaN.
  static void make_real(Tensor& tensor, uint64_t seed) {
    std::mt19937_64 random(seed);
    for (int64_t i = 0; i < tensor.count(); ++i) {
      const int exponent = static_cast<int>(random() % 12) - 6 + (seed == 2 ? 12 : 0);
      const float mantissa = 1 + static_cast<float>(random() % 2048) / 2048;
      float value = std::ldexp(random() % 2 ? mantissa : -mantissa, exponent);
      if (seed > 2 && random() % 40 == 0) value = std::numeric_limits<float>::infinity();
      if (seed > 3 && random() % 40 == 0) value = std::numeric_limits<float>::quiet_NaN();
      tensor.set_real(i, value);
    }
  }

  /// With the same bits for every NaN, since TOSA asks for none of them.
  static Tensor one_nan(Tensor tensor) {
    for (int64_t i = 0; is_float(tensor.type.dtype) && i < tensor.count(); ++i)
      if (std::isnan(tensor.real(i))) tensor.set_real(i, std::numeric_limits<float>::quiet_NaN());
    return tensor;
  }

  inline static std::unique_ptr<ToolDevice> device_;
};

/// Whether a family is made for a row.
bool takes(const std::string& kernel, const ConvCase& row) {
  const bool is_plain =
      row.stride_y == 1 && row.stride_x == 1 && row.dilation_y == 1 && row.dilation_x == 1;
  if (kernel == "products") return row.multiplier == 0;  // depthwise stays with runs
  if (kernel == "generic" || kernel == "runs" || kernel == "conv2d_s16_f64" ||
      kernel == "conv2d_s8_i32")
    return true;
  if (row.multiplier > 0 && (kernel == "conv2d_s8_dot8" || kernel == "conv2d_s8_loop" ||
                             kernel.starts_with("conv2d_s8_winograd")))
    return false;
  if (kernel == "conv2d_s8_dot8") return true;
  // Weights of full range leave int8 without their zero point.
  if (kernel == "conv2d_s8_loop") return row.weight_zp == 0;
  if (row.name == "beyond_float") return false;
  // Four parts of 64 channels at full range are too few for float32.
  if (row.name == "winograd_in_parts" && kernel == "conv2d_s8_winograd32") return false;
  if (row.name == "beyond_pair" || row.name == "beyond_winograd")
    return kernel == "conv2d_s8_f32exact";
  if (kernel.starts_with("conv2d_s8_phase")) return row.source == Source::kUpsample && is_plain;
  if (kernel.starts_with("conv2d_s8_winograd")) {
    // Texels in whole words, or that begin within words of a tensor of whole words.
    const bool is_joined =
        row.source == Source::kConcat || row.source == Source::kPadOfConcatOfResize;
    const bool in_words = is_joined
                              ? row.ic % 8 == 0
                              : row.ic % 4 == 0 || (row.ic > 1 && row.input_elements() % 4 == 0);
    return is_plain && row.kh == 3 && row.kw == 3 && in_words;
  }
  return true;
}

TEST_P(EveryKernel, MatchesTheInterpreterExactly) {
  const auto& [kernel, row] = GetParam();
  const Graph graph = row.graph();
  ASSERT_TRUE(verify(graph)) << error_text(verify(graph)) << "\n" << print_text(graph);
  const Compiled compiled = compiled_for(graph, kernel, true);
  const std::vector<std::string> taken = kernels_of(compiled);
  const bool is_taken = std::ranges::find(taken, kernel) != taken.end();
  EXPECT_EQ(is_taken, takes(kernel, row));
  if (!is_taken) return;  // the generic kernel has these rows as its own
  expect_exact(compiled, graph, kernel, true);
  // How many modules is the family's affair, but here one is not enough for integer literals.
  const bool is_split =
      kernel == "conv2d_s8_i32" && taken.front() == kernel &&
      (row.name == "several_modules" || row.name == "ic32_of_concat" || row.name == "looped_rows");
  EXPECT_EQ(taken.size() > 1, is_split);
  // Without passes the kernel itself has zero points and pads.
  if (row.input_zp != 0 || row.weight_zp != 0) expect_exact(graph, kernel, false);
}

/// Types that a family multiplies.
std::vector<DType> types_of(std::string_view kernel) {
  if (kernel == "conv2d_s16_f64") return {DType::kInt16};
  if (kernel == "products") return {DType::kFp32, DType::kFp16};
  if (kernel == "transpose") return {};
  if (kernel == "runs") return {DType::kInt8, DType::kInt16, DType::kFp32, DType::kFp16};
  return {DType::kInt8};
}

std::vector<std::tuple<std::string, ConvCase>> every_case() {
  std::vector<std::tuple<std::string, ConvCase>> cases;
  for (const KernelFamily& family : all_kernels())
    if (family.name != "conv2d_s8_coopmat")  // no CPU driver has its matrices: see coopmat_test
      for (const DType dtype : types_of(family.name))
        for (const ConvCase& row : edge_cases_of(dtype)) cases.emplace_back(family.name, row);
  return cases;
}

INSTANTIATE_TEST_SUITE_P(Kernels, EveryKernel, testing::ValuesIn(every_case()),
                         [](const testing::TestParamInfo<EveryKernel::ParamType>& test) {
                           return replaced(
                               std::get<0>(test.param) + "_" + std::get<1>(test.param).name, "-",
                               "minus");
                         });

/// Graphs that a family by name has to take. `;` ends a line.
class Named : public EveryKernel {};

TEST_P(Named, MatchesTheInterpreterExactly) {
  const auto& [kernel, row] = GetParam();
  const Graph graph =
      graph_of(fmt::format("graph main {{ {} return %y }}", replaced(row.name, ";", "\n")));
  ASSERT_TRUE(verify(graph)) << error_text(verify(graph));
  const std::vector<std::string> taken = expect_exact(graph, kernel, true);
  EXPECT_EQ(static_cast<size_t>(std::ranges::count(taken, kernel)), taken.size());
}

constexpr std::array<std::string_view, 2> kNamed[] = {
    // Tiles that fill their rows and columns and some that do not, runs of sums that are longer than a float is exact, and
    // zero points.
    {"products",
     "input %a : i8[2,5,9] input %b : i8[2,9,6] const %p : i8[1] = [-128] const %q : i8[1] = [127];"
     "%y = matmul %a, %b, %p, %q : i32[2,5,6]"},
    {"products",
     "input %a : i8[1,3,1500] input %b : i8[1,1500,32] const %z : i8[1] = [0];"
     "%y = matmul %a, %b, %z, %z : i32[1,3,32]"},
    {"products",
     "input %a : f32[1,17,40] input %b : f32[1,40,48] const %z : f32[1] = [0];"
     "%y = matmul %a, %b, %z, %z : f32[1,17,48]"},
    {"products",
     "input %a : f16[2,4,7] input %b : f16[2,7,12] const %z : f16[1] = [0];"
     "%y = matmul %a, %b, %z, %z : f32[2,4,12]"},
    {"products",
     "input %x : i8[2,5,7,16] input %w : i8[6,3,3,16] const %b : i32[1] = [5];"
     "const %p : i8[1] = [-128] const %q : i8[1] = [3] %y = conv2d %x, %w, %b, %p, %q "
     "{pad=[1,1,2,0], stride=[2,1], dilation=[1,1], acc_type=i32} : i32[2,3,7,6]"},
    {"products",
     "input %x : i8[1,3,4,260] input %w : i8[17,1,2,260] const %b : i32[1] = [0];"
     "const %p : i8[1] = [-128] const %q : i8[1] = [127] %y = conv2d %x, %w, %b, %p, %q "
     "{pad=[0,0,0,0], stride=[1,1], dilation=[1,1], acc_type=i32} : i32[1,3,3,17]"},
    {"products",
     "input %x : f32[1,1,4,5,1] input %w : f32[3,1,2,2,1];"
     "const %b : f32[3] = [1.5,-2.0,0.25] const %z : f32[1] = [0];"
     "%y = conv3d %x, %w, %b, %z, %z {pad=[0,0,0,0,0,0], stride=[1,1,1], dilation=[1,1,1], "
     "acc_type=f32} : f32[1,1,3,4,3]"},
    {"products",
     "input %x : i8[1,3,5,6,8] input %w : i8[4,2,3,3,8] const %b : i32[4] = [1,-2,3,-4];"
     "const %p : i8[1] = [7] const %q : i8[1] = [0] %y = conv3d %x, %w, %b, %p, %q "
     "{pad=[1,0,1,1,1,1], stride=[1,2,1], dilation=[1,1,1], acc_type=i32} : i32[1,3,3,6,4]"},
    // Windows that reach out of the picture on each side, or on none, written out or in loops.
    {"runs",
     "input %x : i8[1,7,9,16] %y = max_pool2d %x {kernel=[3,2], stride=[2,1], pad=[1,1,1,0]} : "
     "i8[1,4,9,16]"},
    {"runs",
     "input %x : i8[2,6,8,4] %y = max_pool2d %x {kernel=[2,2], stride=[2,2], pad=[0,0,0,0]} : "
     "i8[2,3,4,4]"},
    {"runs",
     "input %x : i8[1,9,9,8] %y = max_pool2d %x {kernel=[5,5], stride=[1,1], pad=[2,2,2,2]} : "
     "i8[1,9,9,8]"},
    {"runs",
     "input %x : f32[1,5,6,8] %y = max_pool2d %x {kernel=[3,3], stride=[1,1], pad=[1,1,1,1], "
     "nan_mode=propagate} : f32[1,5,6,8]"},
    {"runs",
     "input %x : f16[1,5,6,8] %y = max_pool2d %x {kernel=[3,3], stride=[1,1], pad=[1,1,1,1], "
     "nan_mode=ignore} : f16[1,5,6,8]"},
    {"runs",
     "input %x : i8[1,6,8,16] const %p : i8[1] = [-128] const %q : i8[1] = [3];"
     "%y = avg_pool2d %x, %p, %q {kernel=[2,2], stride=[2,2], pad=[0,0,0,0], acc_type=i32} : "
     "i8[1,3,4,16]"},
    {"runs",
     "input %x : i8[1,5,8,4] const %p : i8[1] = [7] const %q : i8[1] = [-1];"
     "%y = avg_pool2d %x, %p, %q {kernel=[3,4], stride=[1,2], pad=[1,2,2,2], acc_type=i32} : "
     "i8[1,6,5,4]"},
    {"runs",
     "input %x : i16[1,12,12,4] const %z : i16[1] = [0];"
     "%y = avg_pool2d %x, %z, %z {kernel=[12,11], stride=[1,1], pad=[0,0,0,0], acc_type=i32} : "
     "i16[1,1,2,4]"},
    {"runs",
     "input %x : i16[1,4,6,2] const %z : i16[1] = [0];"
     "%y = avg_pool2d %x, %z, %z {kernel=[3,3], stride=[1,1], pad=[0,0,0,0], acc_type=i32} : "
     "i16[1,2,4,2]"},
    {"runs",
     "input %x : f32[1,5,6,4] const %z : f32[1] = [0] %y = avg_pool2d %x, %z, %z {kernel=[3,3], "
     "stride=[1,1], "
     "pad=[1,1,1,1], acc_type=f32} : f32[1,5,6,4]"},
    {"runs",
     "input %x : f32[1,6,7,8] input %w : f32[3,3,8,1] const %b : f32[1] = [0.5] const %z : f32[1] "
     "= [0];"
     "%y = depthwise_conv2d %x, %w, %b, %z, %z {pad=[1,1,1,1], stride=[1,1], dilation=[1,1], "
     "acc_type=f32} "
     ": f32[1,6,7,8]"},
    {"runs",
     "input %x : i8[1,8,9,4] input %w : i8[3,2,4,2] const %b : i32[1] = [5] const %p : i8[1] = "
     "[-128];"
     "const %q : i8[1] = [3] %y = depthwise_conv2d %x, %w, %b, %p, %q {pad=[2,3,0,1], "
     "stride=[2,2], "
     "dilation=[2,1], acc_type=i32} : i32[1,5,5,8]"},
    {"runs",
     "input %x : i8[1,9,9,4] input %w : i8[5,5,4,1] const %b : i32[1] = [0] const %z : i8[1] = [0];"
     "%y = depthwise_conv2d %x, %w, %b, %z, %z {pad=[2,2,2,2], stride=[1,1], dilation=[1,1], "
     "acc_type=i32} "
     ": i32[1,9,9,4]"},
    // Turns of 32 elements and of fewer.
    {"runs", "input %x : i8[1,3,5,64] %y = argmax %x {axis=3} : i32[1,3,5]"},
    {"runs", "input %x : i8[1,3,5,20] %y = argmax %x {axis=3} : i32[1,3,5]"},
    {"runs", "input %x : i8[1,3,5,7] %y = argmax %x {axis=3} : i32[1,3,5]"},
    {"runs", "input %x : i8[1,6,5,8] %y = argmax %x {axis=1} : i32[1,5,8]"},
    {"runs", "input %x : f32[1,3,5,32] %y = argmax %x {axis=3, nan_mode=propagate} : i32[1,3,5]"},
    {"runs", "input %x : f32[1,3,5,12] %y = argmax %x {axis=3, nan_mode=ignore} : i32[1,3,5]"},
    {"runs",
     "input %a : i8[1,3,5,32] %x = cast %a : i32[1,3,5,32] %y = reduce_sum %x {axis=3} : "
     "i32[1,3,5,1]"},
    {"runs", "input %x : f32[1,3,5,48] %y = reduce_sum %x {axis=3} : f32[1,3,5,1]"},
    {"runs",
     "input %x : i8[1,4,5,16] const %s : shape[4] = [16,1,3,2] const %o : shape[2] = [0,-1];"
     "const %b : shape[2] = [0,1] %y = resize %x, %s, %o, %b {mode=bilinear} : i32[1,49,8,16]"},
    // Elements that are taken as one row, and some that cannot be.
    {"runs", "input %a : i32[1,4,4,3] input %b : i32[1,4,4,3] %y = maximum %a, %b : i32[1,4,4,3]"},
    {"runs", "input %a : i32[1,4,4,3] input %b : i32[1,1,1,3] %y = maximum %a, %b : i32[1,4,4,3]"},
    {"runs",
     "input %a : i32[1,4,4,3] const %b : i32[1,1,1,1] = [5] %y = maximum %a, %b : i32[1,4,4,3]"},
    {"runs", "input %a : f32[3,5,3] %y = cast %a : i8[3,5,3]"},
    {"runs", "input %a : f32[2,16,3] %y = cast %a : i16[2,16,3]"},
    {"runs",
     "input %a : f32[7] const %b : f32[7] = [1,-2,3,-4,5,-6,7] %y = maximum %a, %b "
     "{nan_mode=propagate} : f32[7]"},
    {"runs",
     "input %a : f32[2,4,2] const %b : f32[2,4,2] = [1,-2,3,-4,5,-6,7,8,9,10,11,12,13,14,15,16];"
     "%y = minimum %a, %b {nan_mode=ignore} : f32[2,4,2]"},
    {"runs",
     "input %a : i8[1,2,8,3] const %m : i32[3] = [1073741824,1431655765,2000000000] const %s : "
     "i8[3] = [31,33,30];"
     "const %z : i8[1] = [-3] %y = rescale %a, %m, %s, %z, %z {scale32=true, rounding_mode=single, "
     "per_channel=true, "
     "input_unsigned=false, output_unsigned=false} : i8[1,2,8,3]"},
    // Tiles of 16, 8, 4 and 2 elements; more rows than columns, and other dimensions before, between and behind.
    {"transpose", "input %x : i8[1,5,16,32] %y = transpose %x {perms=[0,3,1,2]} : i8[1,32,5,16]"},
    {"transpose", "input %x : i8[2,32,6,16] %y = transpose %x {perms=[0,2,3,1]} : i8[2,6,16,32]"},
    {"transpose", "input %x : i8[3,4,5,12] %y = transpose %x {perms=[3,2,0,1]} : i8[12,5,3,4]"},
    {"transpose", "input %x : i16[7,16,24] %y = transpose %x {perms=[0,2,1]} : i16[7,24,16]"},
    {"transpose", "input %x : f16[6,10] %y = transpose %x {perms=[1,0]} : f16[10,6]"},
    {"transpose", "input %x : f32[12,3,20] %y = transpose %x {perms=[2,1,0]} : f32[20,3,12]"},
    {"transpose",
     "input %x : i32[2,3,8,2,4] %y = transpose %x {perms=[1,4,3,0,2]} : i32[3,4,2,2,8]"},
    {"transpose", "input %x : i8[272,144] %y = transpose %x {perms=[1,0]} : i8[144,272]"},
};

std::vector<std::tuple<std::string, ConvCase>> every_named() {
  std::vector<std::tuple<std::string, ConvCase>> cases;
  for (const auto& [kernel, text] : kNamed)
    cases.emplace_back(kernel, ConvCase{.name = std::string(text)});
  return cases;
}

INSTANTIATE_TEST_SUITE_P(Kernels, Named, testing::ValuesIn(every_named()),
                         [](const testing::TestParamInfo<Named::ParamType>& test) {
                           return fmt::format("{}_{}", std::get<0>(test.param), test.index);
                         });

/// Values of 8 and 16 bits scaled by every shift, the smallest and the largest multiplier, halves among the results.
TEST_F(EveryKernel, ScalesSmallValuesExactly) {
  if (!device_) GTEST_SKIP() << "no Vulkan device";
  std::string text = "graph main { input %x : i16[1,1,1,64]\nconst %z : i16[1] = [0]\n";
  std::vector<std::string> results;
  for (const int64_t shift : {17, 18, 30, 31, 32, 38, 45, 46, 47, 60, 62})
    for (const int64_t multiplier :
         {int64_t{1} << 30, int64_t{INT32_MAX}, int64_t{1'431'655'765}}) {
      const size_t i = results.size();
      results.push_back(fmt::format("%y{}", i));
      text += fmt::format(
          "const %m{0} : i32[1] = [{1}] const %s{0} : i8[1] = [{2}]\n%y{0} = rescale %x, %m{0}, "
          "%s{0}, %z, %z "
          "{{scale32=true, rounding_mode=single, per_channel=false, input_unsigned=false, "
          "output_unsigned=false}} "
          ": i16[1,1,1,64]\n",
          i, multiplier, shift);
    }
  const Graph graph = graph_of(fmt::format("{} return {} }}", text, fmt::join(results, ", ")));
  ASSERT_TRUE(verify(graph)) << error_text(verify(graph));
  expect_exact(graph, "runs", true);
}

/// Every step of the ladder of scales in one convolution, a channel each: multipliers at both ends, shifts from 2 to 62, and
/// sums as large as a shift takes. `bias` stands on the channels whose shift takes any sum.
Graph ladder(int64_t input_zp, int64_t output_zp, int64_t bias) {
  constexpr int64_t kInputs = 4, kTaps = 3 * 3 * kInputs, kLargest = kTaps * 255;
  std::vector<int64_t> weights, biases, multipliers, shifts;
  std::mt19937_64 random(7);
  for (const int64_t shift : {2, 3, 10, 15, 20, 31, 32, 38, 46, 60, 62})
    for (const int64_t multiplier : {int64_t{1} << 30, int64_t{INT32_MAX}}) {
      const int64_t most = shift < 32 ? (int64_t{1} << (shift - 1)) - 1 : INT32_MAX;
      const int64_t largest_weight = std::min<int64_t>(most / kLargest, 127);
      for (int64_t i = 0; i < kTaps; ++i)
        weights.push_back(static_cast<int64_t>(random() % 255) % (2 * largest_weight + 1) -
                          largest_weight);
      const int64_t rest = most - largest_weight * kLargest;
      const int64_t own = shift < 32 ? std::min<int64_t>(rest, 20000) : bias;
      biases.push_back(multiplier == INT32_MAX ? own : -own);
      multipliers.push_back(multiplier);
      shifts.push_back(shift);
    }
  const size_t oc = shifts.size();
  return graph_of(fmt::format(
      R"(graph main {{
  input %x : i8[1,5,7,4]
  const %w : i8[{0},3,3,4] = [{1}]
  const %b : i32[{0}] = [{2}]
  const %zp : i8[1] = [{3}]
  const %wzp : i8[1] = [0]
  const %m : i32[{0}] = [{4}]
  const %s : i8[{0}] = [{5}]
  const %z : i32[1] = [0]
  const %oz : i8[1] = [{6}]
  %acc = conv2d %x, %w, %b, %zp, %wzp {{pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type=i32}} : i32[1,5,7,{0}]
  %q = rescale %acc, %m, %s, %z, %oz {{scale32=true, rounding_mode=single, per_channel=true, input_unsigned=false, output_unsigned=false}} : i8[1,5,7,{0}]
  return %q
}})",
      oc, fmt::join(weights, ","), fmt::join(biases, ","), input_zp, fmt::join(multipliers, ","),
      fmt::join(shifts, ","), output_zp));
}

class EveryScale : public EveryKernel {};

TEST_P(EveryScale, MatchesTheInterpreterExactly) {
  const auto& [kernel, row] = GetParam();
  const std::vector<std::string> taken = expect_exact(ladder(-128, 127, 20000), kernel, true);
  EXPECT_EQ(std::ranges::find(taken, kernel) != taken.end(), takes(kernel, row));
  // With the largest shift half of the product is left: results next to 0, on either side of the middle.
  expect_exact(ladder(127, -128, int64_t{1} << 30), kernel, true);
}

std::vector<std::tuple<std::string, ConvCase>> every_scale() {
  std::vector<std::tuple<std::string, ConvCase>> cases;
  for (const KernelFamily& family : all_kernels())
    if (family.name != "conv2d_s8_coopmat")
      for (const DType dtype : types_of(family.name))
        if (dtype == DType::kInt8) cases.emplace_back(family.name, ConvCase{.name = "scales"});
  return cases;
}

INSTANTIATE_TEST_SUITE_P(Kernels, EveryScale, testing::ValuesIn(every_scale()),
                         [](const testing::TestParamInfo<EveryScale::ParamType>& test) {
                           return std::get<0>(test.param);
                         });

}  // namespace
}  // namespace shale
