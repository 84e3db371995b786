#include "tests/support/float_cases.h"

#include <cmath>
#include <limits>
#include <random>

#include "ir/base/float_format.h"
#include "ir/text/text.h"
#include "ir/verify/verify.h"

namespace shale {
namespace {

/// Values of an input by the beginning of its name.
class Values {
 public:
  Tensor of(const std::string& name, const TensorType& type) {
    Tensor tensor = Tensor::zeros(type);
    const auto is = [&](const char* kind) { return name.starts_with(kind); };
    for (int64_t i = 0; i < tensor.count(); ++i) {
      if (type.dtype == DType::kBool)
        tensor.set(i, static_cast<int64_t>(next(2)));
      else if (is("index"))  // of rows, none twice
        tensor.set(i, i % type.shape[1] * 5 % 7);
      else if (!is_float(type.dtype))
        tensor.set(i, static_cast<int64_t>(random_()) >> next(56));
      else
        tensor.set_real(i, is("plain")  ? uniform(-3, 3)
                           : is("base") ? base()
                           : is("exponent")
                               ? (next(2) == 0 ? std::floor(uniform(-6, 7)) : uniform(-6, 6))
                           : is("factor") ? uniform(0.6, 1.6) * (next(2) == 0 ? -1 : 1)
                           : is("few")    ? few()
                                          : wide(float_format(type.dtype), is("number")));
    }
    return flush_subnormals(std::move(tensor));
  }

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  uint64_t next(uint64_t below) { return random_() % below; }
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(next(1u << 20)) / (1u << 20);
  }
  double few() {
    const double all[] = {-1, -0.0, 0, 1, 2, std::nan(""), kInfinity, -kInfinity};
    return all[next(8)];
  }
  double base() { return next(8) == 0 ? few() : next(3) == 0 ? uniform(-4, 0) : uniform(0, 6); }
  double wide(FloatFormat format, bool only_numbers) {
    const double special[] = {0,
                              -0.0,
                              1,
                              -1,
                              0.5,
                              -0.5,
                              1.5,
                              2.5,
                              0.75,
                              format.largest(),
                              -format.largest(),
                              format.smallest_normal(),
                              kInfinity,
                              -kInfinity,
                              std::nan(""),
                              -std::nan("")};
    if (next(8) == 0) return special[next(only_numbers ? 14 : 16)];
    if (next(3) == 0) return uniform(-10, 10);
    const int span = 2 * format.bias();
    const int exponent = format.lowest() + static_cast<int>(next(static_cast<uint64_t>(span)));
    return uniform(1, 2) * FloatFormat::power(exponent) * (next(2) == 0 ? -1 : 1);
  }

  std::mt19937_64 random_{24};
};

/// {0} is the type.
std::vector<std::pair<std::string, std::string>> groups(const std::string& t) {
  const bool narrow = t.starts_with("f8"), is_f32 = t == "f32";
  const std::string sum = narrow ? "f16" : t, accumulator = narrow ? "f16" : "f32";
  std::vector<std::pair<std::string, std::string>> all;
  const auto add = [&](const std::string& name, const std::string& text) {
    all.emplace_back(name + "_" + t, fmt::format(fmt::runtime(text), fmt::arg("t", t),
                                                 fmt::arg("s", sum), fmt::arg("acc", accumulator)));
  };
  std::string text = "input %wide : {t}[16,24] const %zero : {t}[1] = [0]\n", results;
  for (const char* op : {"abs", "ceil", "cos", "erf", "exp", "floor", "log", "reciprocal", "rsqrt",
                         "sigmoid", "sin", "tanh"}) {
    text += fmt::format("%{0} = {0} %wide : {{t}}[16,24]\n", op);
    results += fmt::format("%{}, ", op);
  }
  if (!narrow)
    add("functions", text + "%negate = negate %wide, %zero, %zero : {t}[16,24]\nreturn " + results +
                         "%negate\n");
  if (!narrow)
    add("binary", R"(input %wide : {t}[16,24] input %wide_2 : {t}[16,24] input %wide_row : {t}[1,24]
input %base : {t}[16,24] input %exponent : {t}[16,24] input %few : {t}[16,24] input %few_2 : {t}[16,24]
input %flag : bool[16,1] const %shift : i8[1] = [0]
%add = add %wide, %wide_2 : {t}[16,24]
%sub = sub %wide, %wide_row : {t}[16,24]
%mul = mul %wide_row, %wide_2, %shift : {t}[16,24]
%pow = pow %base, %exponent : {t}[16,24]
%pow_2 = pow %few, %few_2 : {t}[16,24]
%max_1 = maximum %wide, %few {{nan_mode=propagate}} : {t}[16,24]
%max_2 = maximum %wide, %few {{nan_mode=ignore}} : {t}[16,24]
%min_1 = minimum %wide, %few {{nan_mode=propagate}} : {t}[16,24]
%min_2 = minimum %wide, %few {{nan_mode=ignore}} : {t}[16,24]
%equal = equal %few, %few_2 : bool[16,24]
%greater = greater %few, %few_2 : bool[16,24]
%greater_equal = greater_equal %few, %few_2 : bool[16,24]
%select = select %flag, %wide, %wide_row : {t}[16,24]
%clamp_1 = clamp %wide {{min_val=-1.5, max_val=2, nan_mode=propagate}} : {t}[16,24]
%clamp_2 = clamp %wide {{min_val=-1.5, max_val=2, nan_mode=ignore}} : {t}[16,24]
return %add, %sub, %mul, %pow, %pow_2, %max_1, %max_2, %min_1, %min_2, %equal, %greater, %greater_equal, %select, %clamp_1, %clamp_2
)");
  text =
      "input %wide : {t}[16,24] input %number : {t}[16,24] input %int : i32[16,24] "
      "input %short : i16[16,24] input %byte : i8[16,24]\n";
  results.clear();
  const auto cast = [&](const char* from, const std::string& from_type, const std::string& to) {
    const std::string name = "to_" + to + "_from_" + from_type;
    text += fmt::format("%{} = cast %{} : {}[16,24]\n", name, from, to);
    results += (results.empty() ? "%" : ", %") + name;
  };
  if (!narrow)
    for (const auto& [name, type] : {std::pair{"byte", "i8"}, {"short", "i16"}, {"int", "i32"}}) {
      cast(name, type, t);
      cast("number", t, type);
    }
  for (const char* to : {"f32", "f16", "bf16", "f8e4m3", "f8e5m2"}) {
    const bool to_narrow = std::string_view(to).starts_with("f8");
    const bool both_16 = !narrow && !to_narrow && !is_f32 && std::string_view(to) != "f32";
    if (t != to && !(narrow && to_narrow) && !both_16) cast("wide", t, to);
  }
  add("cast", text + "return " + results + "\n");
  if (!narrow)
    add("reduce",
        R"(input %plain : {t}[3,16,8] input %wide : {t}[3,16,8] input %factor : {t}[3,16,8]
%sum_1 = reduce_sum %plain {{axis=1}} : {t}[3,1,8]
%sum_2 = reduce_sum %plain {{axis=2}} : {t}[3,16,1]
%product_1 = reduce_product %factor {{axis=1}} : {t}[3,1,8]
%product_2 = reduce_product %factor {{axis=2}} : {t}[3,16,1]
%max_1 = reduce_max %wide {{axis=1, nan_mode=propagate}} : {t}[3,1,8]
%max_2 = reduce_max %wide {{axis=2, nan_mode=ignore}} : {t}[3,16,1]
%min_1 = reduce_min %wide {{axis=2, nan_mode=propagate}} : {t}[3,16,1]
%min_2 = reduce_min %wide {{axis=1, nan_mode=ignore}} : {t}[3,1,8]
return %sum_1, %sum_2, %product_1, %product_2, %max_1, %max_2, %min_1, %min_2
)");
  add("search", R"(input %few : {t}[3,16,8] input %wide : {t}[1,6,9,4]
%arg_1 = argmax %few {{axis=1, nan_mode=propagate}} : i32[3,8]
%arg_2 = argmax %few {{axis=2, nan_mode=ignore}} : i32[3,16]
%pool_1 = max_pool2d %wide {{kernel=[3,2], stride=[1,2], pad=[1,1,1,0], nan_mode=propagate}} : {t}[1,6,5,4]
%pool_2 = max_pool2d %wide {{kernel=[2,3], stride=[2,3], pad=[0,0,0,0], nan_mode=ignore}} : {t}[1,3,3,4]
return %arg_1, %arg_2, %pool_1, %pool_2
)");
  add("sums",
      R"(input %plain : {t}[1,6,7,4] input %plain_volume : {t}[1,3,4,4,2] input %plain_w : {t}[5,3,3,4]
input %plain_dw : {t}[3,2,4,2] input %plain_3d : {t}[3,2,2,2,2] input %plain_a : {t}[2,5,8] input %plain_b : {t}[2,8,6]
input %plain_bias : {s}[5] const %none : {s}[1] = [0] const %zero : {t}[1] = [0]
%conv2d = conv2d %plain, %plain_w, %plain_bias, %zero, %zero {{pad=[1,1,1,1], stride=[1,2], dilation=[1,1], acc_type={acc}}} : {s}[1,6,4,5]
%conv2d_local = conv2d %plain, %plain_w, %none, %zero, %zero {{pad=[0,0,1,1], stride=[1,1], dilation=[2,2], local_bound=true, acc_type={acc}}} : {s}[1,2,5,5]
%depthwise = depthwise_conv2d %plain, %plain_dw, %none, %zero, %zero {{pad=[1,1,1,0], stride=[1,1], dilation=[1,1], acc_type={acc}}} : {s}[1,6,7,8]
%transposed = transpose_conv2d %plain, %plain_w, %plain_bias, %zero, %zero {{out_pad=[0,0,-1,0], stride=[2,1], acc_type={acc}}} : {s}[1,13,8,5]
%conv3d = conv3d %plain_volume, %plain_3d, %none, %zero, %zero {{pad=[0,0,1,1,0,0], stride=[1,1,1], dilation=[1,1,1], acc_type={acc}}} : {s}[1,2,5,3,3]
%pool = avg_pool2d %plain, %zero, %zero {{kernel=[3,2], stride=[1,1], pad=[1,1,1,0], acc_type={acc}}} : {t}[1,6,7,4]
)" +
          std::string(t == "bf16"
                          ? "%matmul = matmul %plain_a, %plain_b, %zero, %zero : f32[2,5,6]\n"
                          : "%matmul = matmul %plain_a, %plain_b, %zero, %zero : {s}[2,5,6]\n") +
          "return %conv2d, %conv2d_local, %depthwise, %transposed, %conv3d, %pool, %matmul\n");
  if (t == "f16")
    add("sums_16",
        R"(input %plain : f16[1,6,7,4] input %plain_w : f16[5,3,3,4] input %plain_bias : f16[5]
input %plain_a : f16[2,5,8] input %plain_b : f16[2,8,6] const %zero : f16[1] = [0]
%conv2d = conv2d %plain, %plain_w, %plain_bias, %zero, %zero {{pad=[1,1,1,1], stride=[1,1], dilation=[1,1], acc_type=f16}} : f16[1,6,7,5]
%pool = avg_pool2d %plain, %zero, %zero {{kernel=[2,2], stride=[1,1], pad=[1,0,1,0], acc_type=f16}} : f16[1,6,7,4]
%matmul = matmul %plain_a, %plain_b, %zero, %zero : f32[2,5,6]
return %conv2d, %pool, %matmul
)");
  if (!narrow)
    add("resize",
        R"(input %plain : {t}[1,5,6,3] const %up : shape[4] = [4,2,4,2] const %offset : shape[2] = [-1,-1]
const %border : shape[2] = [1,1] const %odd : shape[4] = [7,3,5,4] const %none : shape[2] = [0,0] const %rest : shape[2] = [2,3]
%nearest = resize %plain, %up, %offset, %border {{mode=nearest}} : {t}[1,10,12,3]
%bilinear = resize %plain, %up, %offset, %border {{mode=bilinear}} : {t}[1,10,12,3]
%bilinear_odd = resize %plain, %odd, %none, %rest {{mode=bilinear}} : {t}[1,11,8,3]
return %nearest, %bilinear, %bilinear_odd
)");
  add("layout", R"(input %wide : {t}[2,7,4] input %wide_2 : {t}[2,3,4] input %index : i32[2,3]
const %padding : shape[6] = [0,0,1,2,0,4] const %pad_value : {t}[1] = [1.5] const %flat : shape[1] = [56]
const %start : shape[3] = [1,2,0] const %size : shape[3] = [1,4,4] const %multiples : shape[3] = [1,2,2]
%concat = concat %wide, %wide_2 {{axis=1}} : {t}[2,10,4]
%pad = pad %wide, %padding, %pad_value : {t}[2,10,8]
%reshape = reshape %wide, %flat : {t}[56]
%reverse = reverse %wide {{axis=2}} : {t}[2,7,4]
%slice = slice %wide, %start, %size : {t}[1,4,4]
%tile = tile %wide, %multiples : {t}[2,14,8]
%transpose = transpose %wide {{perms=[2,0,1]}} : {t}[4,2,7]
%gather = gather %wide, %index : {t}[2,3,4]
%scatter = scatter %wide, %index, %wide_2 : {t}[2,7,4]
%identity = identity %wide : {t}[2,7,4]
return %concat, %pad, %reshape, %reverse, %slice, %tile, %transpose, %gather, %scatter, %identity
)");
  if (is_f32)
    add("fourier",
        R"(input %plain : f32[2,8,16] input %plain_i : f32[2,8,16] input %plain_flat : f32[1,1,4]
%real = fft2d %plain, %plain_i {{part=real}} : f32[2,8,16]
%imag = fft2d %plain, %plain_i {{part=imag}} : f32[2,8,16]
%inverse_real = fft2d %plain, %plain_i {{inverse=true, local_bound=true, part=real}} : f32[2,8,16]
%inverse_imag = fft2d %plain, %plain_i {{inverse=true, local_bound=true, part=imag}} : f32[2,8,16]
%half_real = rfft2d %plain {{part=real}} : f32[2,8,9]
%half_imag = rfft2d %plain {{local_bound=true, part=imag}} : f32[2,8,9]
%flat_imag = rfft2d %plain_flat {{local_bound=true, part=imag}} : f32[1,1,3]
return %real, %imag, %inverse_real, %inverse_imag, %half_real, %half_imag, %flat_imag
)");
  return all;
}

}  // namespace

std::vector<FloatCase> float_cases() {
  std::vector<FloatCase> cases;
  Values values;
  for (const char* type : {"f32", "f16", "bf16", "f8e4m3", "f8e5m2"})
    for (const auto& [name, text] : groups(type)) {
      Result<Graph> graph = parse_text("graph main {\n" + text + "}\n");
      if (graph) {
        if (Result<void> legal = verify(*graph); !legal) graph = std::move(legal.error());
      }
      if (!graph) {
        fmt::print(stderr, "{}: {}\n", name, graph.error().text());
        std::abort();  // the table is wrong
      }
      graph->compact();
      std::vector<Tensor> inputs;
      for (const ValueId id : graph->inputs)
        inputs.push_back(values.of(graph->value(id).name, graph->value(id).type));
      cases.push_back({name, *std::move(graph), std::move(inputs)});
    }
  return cases;
}

std::vector<std::vector<Precision>> output_precision(const Graph& graph,
                                                     const std::vector<Tensor>& inputs) {
  std::vector<const Tensor*> known(graph.values.size());
  for (size_t i = 0; i < graph.values.size(); ++i)
    if (graph.values[i].is_constant()) known[i] = &*graph.values[i].constant;
  for (size_t i = 0; i < inputs.size(); ++i) known[graph.inputs[i].index] = &inputs[i];
  const std::vector<std::optional<NodeId>> producers = graph.producers();
  std::vector<std::vector<Precision>> all;
  for (const ValueId output : graph.outputs) {
    std::vector<const Tensor*> operands;
    for (const ValueId id : graph.node(*producers[output.index]).inputs)
      operands.push_back(known[id.index]);
    Result<std::vector<Precision>> expected =
        node_precision(graph, *producers[output.index], operands);
    SHALE_CHECK(expected);
    all.push_back(*std::move(expected));
  }
  return all;
}

}  // namespace shale
