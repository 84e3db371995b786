// The same network by Shale on the device at hand and by XNNPACK on the processor, by turns in one run.
//
//   peer_bench MODEL... [--render WxH] [--repeat N] [--threads N] [--json]
//
// XNNPACK's INT8 is not exact (it requantizes in float32); here it is the time that counts. What it has
// no operator for, nearest upsampling, is a plain copy on the same threads; a CONCAT costs it nothing,
// since its operators write into slices of channels. Both sides take the processor's instructions that
// GALLIUM_OVERRIDE_CPU_CAPS leaves: with "avx" both are without AVX-512.
#include <cpuinfo.h>
#include <xnnpack.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <numeric>
#include <thread>

#include "compiler/driver/compile.h"
#include "runtime/vk/processor.h"
#include "tools/shale/command.h"
#include "tools/shale/device_run.h"
#include "tools/shale/roof.h"

namespace shale {
namespace {

struct Arguments {
  std::vector<std::string> models;
  CompileArguments compile;
  DeviceArguments device;
  uint32_t repeat = 9;
  uint32_t threads = std::max(1u, std::thread::hardware_concurrency());
  bool json = false;
};

struct DeleteOperator {
  void operator()(xnn_operator_t op) const { xnn_delete_operator(op); }
};
using Operator = std::unique_ptr<xnn_operator, DeleteOperator>;
struct DeletePool {
  void operator()(pthreadpool_t pool) const { pthreadpool_destroy(pool); }
};
using Pool = std::unique_ptr<pthreadpool, DeletePool>;

/// Takes from XNNPACK what the driver may not use either. Before xnn_initialize.
void follow_driver_caps() {
  const char* caps = std::getenv("GALLIUM_OVERRIDE_CPU_CAPS");
  if (!caps || !*caps) return;
#if CPUINFO_ARCH_X86_64
  cpuinfo_x86_isa& isa = cpuinfo_isa;
  isa.avx512f = isa.avx512pf = isa.avx512er = isa.avx512cd = isa.avx512dq = isa.avx512bw =
      isa.avx512vl = isa.avx512vnni = isa.avx512vbmi = isa.avx512vbmi2 = false;
  if (std::string_view(caps) == "avx") return;  // Mesa's "avx" is AVX2 where the processor has it
  isa.avx = isa.avx2 = isa.fma3 = isa.f16c = false;
#endif
}

/// The network as XNNPACK operators over NHWC buffers, in INT8 or in float32.
class Peer {
 public:
  /// Errors: kBadInput for an operator that this benchmark does not translate.
  static Result<Peer> create(const Graph& graph, bool int8, pthreadpool_t pool) {
    Peer peer(graph, int8, pool);
    SHALE_TRY_VOID(peer.place());
    for (size_t i = 0; i < graph.nodes.size(); ++i) {
      const NodeId id{static_cast<uint32_t>(i)};
      switch (graph.nodes[i].op) {
        case Op::kConv2d: SHALE_TRY_VOID(peer.add_convolution(id)); break;
        case Op::kTable: SHALE_TRY_VOID(peer.add_table(id)); break;
        case Op::kResize: SHALE_TRY_VOID(peer.add_upsampling(id)); break;
        default: break;  // RESCALE belongs to its convolution, CONCAT is a place
      }
    }
    return peer;
  }

  Result<double> run_ms() {
    const auto begin = std::chrono::steady_clock::now();
    for (const auto& step : steps_)
      if (!step()) return bad_input(graph_->name, "XNNPACK failed to run an operator");
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
        .count();
  }

 private:
  Peer(const Graph& graph, bool int8, pthreadpool_t pool)
      : graph_(&graph), int8_(int8), pool_(pool), element_(int8 ? 1 : 4) {}

  /// Where a value lies: a slice of the channels of a buffer of `stride` channels.
  struct Place {
    std::shared_ptr<std::vector<uint8_t>> bytes;
    size_t channel = 0, stride = 0;
    uint8_t* at(size_t pixel, size_t element) const {
      return bytes->data() + (pixel * stride + channel) * element;
    }
  };

  const Shape& shape(ValueId id) const { return graph_->value(id).type.shape; }
  uint8_t* data(ValueId id) const { return places_[id.index].at(0, element_); }
  size_t stride(ValueId id) const { return places_[id.index].stride; }

  /// A buffer for every value that is not 32 bits wide; operands of a CONCAT lie in its result.
  Result<void> place() {
    places_.resize(graph_->values.size());
    const auto reserve = [&](ValueId id) {
      const Shape& s = shape(id);
      if (places_[id.index].bytes) return;
      const auto count = static_cast<size_t>(*element_count(s));
      // XNNPACK reads some bytes past a buffer's end.
      places_[id.index] = {
          std::make_shared<std::vector<uint8_t>>(count * element_ + XNN_EXTRA_BYTES), 0,
          static_cast<size_t>(s.back())};
    };
    for (const Node& node : graph_->nodes) {
      if (node.op != Op::kConcat) continue;
      reserve(node.output);
      size_t channel = 0;
      for (const ValueId operand : node.inputs) {
        if (places_[operand.index].bytes)
          return bad_input(graph_->name, "{}: two CONCATs have one operand",
                           graph_->value(operand).name);
        places_[operand.index] = places_[node.output.index];
        places_[operand.index].channel = channel;
        channel += static_cast<size_t>(shape(operand).back());
      }
    }
    for (const ValueId input : graph_->inputs) reserve(input);
    for (const Node& node : graph_->nodes)
      if (node.op != Op::kConv2d) reserve(node.output);
    return {};
  }

  /// The RESCALE that reads a convolution.
  const Node* rescale_of(ValueId sums) const {
    for (const Node& node : graph_->nodes)
      if (node.op == Op::kRescale && node.inputs[0] == sums) return &node;
    return nullptr;
  }

  Result<void> add(xnn_status created, xnn_operator_t op, xnn_status set_up,
                   const std::string& name) {
    Operator owned(op);
    if (created != xnn_status_success || set_up != xnn_status_success)
      return bad_input(graph_->name, "XNNPACK refuses {} (status {}, {})", name,
                       static_cast<int>(created), static_cast<int>(set_up));
    steps_.push_back(
        [op, pool = pool_] { return xnn_run_operator(op, pool) == xnn_status_success; });
    operators_.push_back(std::move(owned));
    return {};
  }

  Result<void> add_convolution(NodeId id) {
    const Node& node = graph_->node(id);
    const Node* rescale = rescale_of(node.output);
    const std::optional<Tensor>& weights = graph_->value(node.inputs[1]).constant;
    const std::optional<Tensor>& bias = graph_->value(node.inputs[2]).constant;
    if (!rescale || !weights || !bias)
      return bad_input(graph_->name, "{}: expected constant weights and a RESCALE of the sums",
                       node_label(*graph_, id));
    const Shape& x = shape(node.inputs[0]);
    const Shape& w = weights->type.shape;  // OHWI
    const std::span<const int64_t> pad = node.attrs.list(Attr::kPad),
                                   step = node.attrs.list(Attr::kStride),
                                   dilation = node.attrs.list(Attr::kDilation);
    const auto u32 = [](int64_t n) { return static_cast<uint32_t>(n); };
    const auto size = [](int64_t n) { return static_cast<size_t>(n); };
    const auto create = [&](auto function, auto... rest) {
      return function(u32(pad[0]), u32(pad[3]), u32(pad[1]), u32(pad[2]), u32(w[1]), u32(w[2]),
                      u32(step[0]), u32(step[1]), u32(dilation[0]), u32(dilation[1]), 1, size(w[3]),
                      size(w[0]), stride(node.inputs[0]), stride(rescale->output), rest...);
    };
    xnn_operator_t op = nullptr;
    const std::string name = node_label(*graph_, id);
    if (int8_) {
      const Tensor& multiplier = *graph_->value(rescale->inputs[1]).constant;
      const Tensor& shift = *graph_->value(rescale->inputs[2]).constant;
      std::vector<float> scales(size(w[0]));
      for (size_t o = 0; o < scales.size(); ++o) {
        const auto at = static_cast<int64_t>(multiplier.count() == 1 ? 0 : o);
        scales[o] = static_cast<float>(
            std::ldexp(static_cast<double>(multiplier.get(at)), -static_cast<int>(shift.get(at))));
      }
      std::vector<int32_t> sums(size(w[0]));
      for (size_t o = 0; o < sums.size(); ++o)
        sums[o] = static_cast<int32_t>(bias->get(static_cast<int64_t>(bias->count() == 1 ? 0 : o)));
      const auto zero = [&](ValueId of) {
        return static_cast<int8_t>(graph_->value(of).constant->get(0));
      };
      const xnn_status created =
          create(xnn_create_convolution2d_nhwc_qc8, zero(node.inputs[3]), 1.0f, scales.data(),
                 weights->data<int8_t>(), sums.data(), zero(rescale->inputs[4]), 1.0f, int8_t{-128},
                 int8_t{127}, 0u, &op);
      return add(created, op,
                 op ? xnn_setup_convolution2d_nhwc_qc8(
                          op, size(x[0]), size(x[1]), size(x[2]),
                          reinterpret_cast<const int8_t*>(data(node.inputs[0])),
                          reinterpret_cast<int8_t*>(data(rescale->output)), pool_)
                    : created,
                 name);
    }
    // Values keep their size from layer to layer: no infinities, no denormals.
    const float factor = 1.0f / (40.0f * std::sqrt(static_cast<float>(9 * w[3])));
    std::vector<float> kernel(size(weights->count())), sums(size(w[0]), 0.01f);
    for (size_t i = 0; i < kernel.size(); ++i)
      kernel[i] = factor * static_cast<float>(weights->get(static_cast<int64_t>(i)));
    const xnn_status created = create(xnn_create_convolution2d_nhwc_f32, kernel.data(), sums.data(),
                                      -100.0f, 100.0f, 0u, &op);
    return add(created, op,
               op ? xnn_setup_convolution2d_nhwc_f32(
                        op, size(x[0]), size(x[1]), size(x[2]),
                        reinterpret_cast<const float*>(data(node.inputs[0])),
                        reinterpret_cast<float*>(data(rescale->output)), pool_)
                  : created,
               name);
  }

  /// A table of 256 is XNNPACK's sigmoid, itself a table.
  Result<void> add_table(NodeId id) {
    const Node& node = graph_->node(id);
    const auto channels = static_cast<size_t>(shape(node.output).back());
    const size_t pixels = static_cast<size_t>(*element_count(shape(node.output))) / channels;
    xnn_operator_t op = nullptr;
    xnn_status created, set_up;
    if (int8_) {
      created = xnn_create_sigmoid_nc_qs8(channels, stride(node.inputs[0]), stride(node.output), 0,
                                          0.1f, -128, 1.0f / 256, -128, 127, 0, &op);
      set_up = op ? xnn_setup_sigmoid_nc_qs8(op, pixels,
                                             reinterpret_cast<const int8_t*>(data(node.inputs[0])),
                                             reinterpret_cast<int8_t*>(data(node.output)), pool_)
                  : created;
    } else {
      created =
          xnn_create_sigmoid_nc_f32(channels, stride(node.inputs[0]), stride(node.output), 0, &op);
      set_up = op ? xnn_setup_sigmoid_nc_f32(op, pixels,
                                             reinterpret_cast<const float*>(data(node.inputs[0])),
                                             reinterpret_cast<float*>(data(node.output)), pool_)
                  : created;
    }
    return add(created, op, set_up, node_label(*graph_, id));
  }

  Result<void> add_upsampling(NodeId id) {
    const Node& node = graph_->node(id);
    const Shape &x = shape(node.inputs[0]), &y = shape(node.output);
    const int64_t factor = y[1] / x[1];
    if (node.attrs.get(Attr::kMode) != kNearest || y[1] != factor * x[1] || y[2] != factor * x[2])
      return bad_input(graph_->name, "{}: expected nearest upsampling by a whole factor",
                       node_label(*graph_, id));
    const Place from = places_[node.inputs[0].index], to = places_[node.output.index];
    const auto rows = static_cast<size_t>(y[0] * y[1]), width = static_cast<size_t>(y[2]),
               by = static_cast<size_t>(factor), channels = static_cast<size_t>(y[3]);
    steps_.push_back([=, pool = pool_, element = element_] {
      pthreadpool_parallelize_1d(
          pool,
          [&](size_t row) {
            for (size_t i = 0; i < width; ++i)
              std::memcpy(to.at(row * width + i, element),
                          from.at(row / by * (width / by) + i / by, element), channels * element);
          },
          rows);
      return true;
    });
    return {};
  }

  const Graph* graph_;
  bool int8_;
  pthreadpool_t pool_;
  size_t element_;
  std::vector<Place> places_;
  std::vector<Operator> operators_;
  std::vector<std::function<bool()>> steps_;
};

struct Spread {
  std::vector<double> values;
  Json json() const {
    std::vector<double> sorted = values;
    std::sort(sorted.begin(), sorted.end());
    return {{"median_ms", sorted[sorted.size() / 2]},
            {"least_ms", sorted.front()},
            {"most_ms", sorted.back()}};
  }
};

Result<Json> compare(const Arguments& arguments, const ToolDevice& device, pthreadpool_t pool,
                     const std::string& path) {
  SHALE_TRY(const ModelFiles model,
            load_model(path, arguments.compile.frame, arguments.compile.precision));
  SHALE_TRY(const CompileOptions options, arguments.compile.options(model));
  SHALE_TRY(const Graph graph, shaped_graph(model.bytes, options));
  SHALE_TRY(const Compiled compiled, compile_model(model, options));
  SHALE_TRY(NetworkRun network, NetworkRun::create(device, compiled.package));
  SHALE_TRY(Peer int8, Peer::create(graph, true, pool));
  SHALE_TRY(Peer fp32, Peer::create(graph, false, pool));
  SHALE_TRY(RoofProbe probe, RoofProbe::create(device));
  Spread shale_ms, int8_ms, fp32_ms;
  std::vector<double> roofs;
  for (uint32_t i = 0; i <= arguments.repeat; ++i) {  // the first turn warms caches and compiles
    if (interrupted()) return bad_input("", "interrupted");
    SHALE_TRY(const double a, network.measure_whole());
    SHALE_TRY(const double b, int8.run_ms());
    SHALE_TRY(const double c, fp32.run_ms());
    SHALE_TRY(const double roof, probe.measure());
    if (i == 0) continue;
    shale_ms.values.push_back(1e-3 * a);
    int8_ms.values.push_back(b);
    fp32_ms.values.push_back(c);
    roofs.push_back(roof);
  }
  std::sort(roofs.begin(), roofs.end());
  Json json{{"model", model.name},
            {"target", compiled.package.variants.front().target},
            {"roof_gop_per_s", roofs[roofs.size() / 2]},
            {"shale", shale_ms.json()},
            {"xnnpack_int8", int8_ms.json()},
            {"xnnpack_fp32", fp32_ms.json()}};
  json["times_xnnpack_int8"] =
      json["shale"]["median_ms"].get<double>() / json["xnnpack_int8"]["median_ms"].get<double>();
  return json;
}

Result<int> run(const Arguments& arguments) {
  if (!cpuinfo_initialize())
    return Error{ErrorCode::kDevice, "", "cpuinfo does not know the processor"};
  follow_driver_caps();
  if (xnn_initialize(nullptr) != xnn_status_success)
    return Error{ErrorCode::kDevice, "", "XNNPACK does not run on this processor"};
  SHALE_TRY(ToolDevice device, ToolDevice::open(arguments.device));
  const Pool pool(pthreadpool_create(arguments.threads));
  const DeviceCaps& caps = device.context().caps;
  Json json{{"device", caps.name},
            {"driver", caps.driver},
            {"processor", vk::processor_model()},
            {"threads", arguments.threads},
            {"models", Json::array()}};
  for (const std::string& path : arguments.models) {
    SHALE_TRY(Json one, compare(arguments, device, pool.get(), path));
    json["models"].push_back(std::move(one));
  }
  SHALE_TRY_VOID(device.close());
  if (arguments.json) {
    print_json(json);
    return kDone;
  }
  fmt::print(
      "{} ({}) on {}, medians of {} turns (least to most), ms\n\n"
      "| network | target | roof | Shale | XNNPACK int8 | XNNPACK fp32 | Shale / int8 |\n"
      "|---|---|---:|---:|---:|---:|---:|\n",
      caps.name, caps.driver, vk::processor_model(), arguments.repeat);
  const auto spread = [](const Json& times) {
    return fmt::format("{:.1f} ({:.1f} - {:.1f})", times["median_ms"].get<double>(),
                       times["least_ms"].get<double>(), times["most_ms"].get<double>());
  };
  for (const Json& one : json["models"])
    fmt::print("| {} | {} | {:.1f} | {} | {} | {} | {:.2f} |\n", one["model"].get<std::string>(),
               one["target"].get<std::string>(), one["roof_gop_per_s"].get<double>(),
               spread(one["shale"]), spread(one["xnnpack_int8"]), spread(one["xnnpack_fp32"]),
               one["times_xnnpack_int8"].get<double>());
  return kDone;
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  using namespace shale;
  CLI::App app{"Networks by Shale and by XNNPACK, by turns"};
  Arguments arguments;
  app.add_option("models", arguments.models, "model folders or .tosa files")->required();
  app.add_option("--repeat", arguments.repeat, "turns; times are the median")
      ->check(CLI::Range(1, 10000));
  app.add_option("--threads", arguments.threads,
                 "threads of XNNPACK; all of the machine by default")
      ->check(CLI::Range(1, 256));
  arguments.compile.add_to(app, &arguments.device);
  add_device_options(app, arguments.device);
  app.add_flag("--json", arguments.json, "print the result as JSON");
  app.footer("Example: peer_bench models/nss_v1_high models/nss_v0_1 --render 960x540");
  CLI11_PARSE(app, argc, argv);
  const Result<int> result = run(arguments);
  if (result) return *result;
  print_error(result.error());
  return kRefused;
}
