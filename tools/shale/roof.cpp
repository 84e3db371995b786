#include "tools/shale/roof.h"

#include <algorithm>
#include <optional>

#include "compiler/spirv/check.h"
#include "compiler/spirv/glsl.h"

namespace shale {
namespace {

constexpr uint32_t kLocal = 64;

/// A kernel that reads `x` and writes `y`, and what it does once for each invocation.
struct Probe {
  std::string body;  ///< statements; `x` is a varying int, the result goes to `r` (int)
  double work = 0;   ///< operations or bytes of an invocation
  uint32_t groups = 8192;
  bool texels = false;  ///< reads x through a texel buffer of 16 bytes a texel
  bool wide = false;    ///< stores four times four of r
  std::string declarations;
};

/// `sums` accumulators in a loop of `steps`, each updated `unroll` times by `update`, where {0} is the
/// accumulator's number and {1} a literal; x changes between updates, so that nothing folds.
Probe arithmetic(const char* type, const char* update, const char* change, int sums, int unroll,
                 double work_per_update) {
  constexpr int kSteps = 256;
  Probe probe;
  probe.body = fmt::format("  {0} v = {0}(x);\n", type);
  for (int i = 0; i < sums; ++i) probe.body += fmt::format("  {0} a{1} = {0}({1});\n", type, i);
  probe.body += fmt::format("  for (int k = 0; k < {}; ++k) {{\n", kSteps / unroll);
  for (int j = 0; j < unroll; ++j) {
    for (int i = 0; i < sums; ++i)
      probe.body += "    " + fmt::format(fmt::runtime(update), i, 37 + i + sums * (j % 4)) + ";\n";
    probe.body += fmt::format("    {};\n", change);
  }
  probe.body += "  }\n  int r = 0";
  for (int i = 0; i < sums; ++i) probe.body += fmt::format(" + int(a{})", i);
  probe.body += ";\n";
  probe.work = work_per_update * sums * (kSteps / unroll) * unroll;
  return probe;
}

constexpr int64_t kInputWords = 1 << 20;

Result<NetworkRun> prepare(const ToolDevice& device, const Probe& probe) {
  const std::string source =
      "#version 450\n#extension GL_EXT_spirv_intrinsics : enable\n" + probe.declarations +
      fmt::format(
          "layout(local_size_x = {}) in;\n"
          "layout(set = 0, binding = 0, std430) writeonly buffer Y {{ {} y[]; }};\n{}",
          kLocal, probe.wide ? "ivec4" : "int",
          probe.texels ? "layout(set = 0, binding = 1) uniform usamplerBuffer v;\n"
                       : "layout(set = 0, binding = 1, std430) readonly buffer X { ivec4 "
                         "v[]; };\n") +
      "void main() {\n  int id = int(gl_GlobalInvocationID.x);\n" +
      (probe.texels ? "  int x = id;\n" : "  int x = v[id & 3].x + id;\n") + probe.body +
      (probe.wide ? "  for (int i = 0; i < 4; ++i) y[4 * id + i] = ivec4(r, r + 1, r + i, i);\n}\n"
                  : "  y[id] = r;\n}\n");
  SHALE_TRY(const Spirv words, compile_glsl(source, {}, "roof"));
  SHALE_TRY(const SpirvNeeds needs, spirv_needs(words, "roof"));
  Package package;
  Variant variant;
  variant.target = "roof";
  Resource x, y;
  x.name = "x", x.category = Category::kInput;
  x.dtype = DType::kInt8, x.shape = {4 * kInputWords}, x.size_bytes = 4 * kInputWords;
  y.name = "y", y.category = Category::kOutput, y.dtype = DType::kInt32;
  const int64_t results = int64_t{probe.groups} * kLocal * (probe.wide ? 16 : 1);
  y.shape = {results}, y.size_bytes = static_cast<uint64_t>(4 * results);
  variant.resources = {x, y};
  variant.modules = {words};
  Dispatch dispatch;
  dispatch.name = "y";
  dispatch.kernel = "roof";
  dispatch.workgroups = {probe.groups, 1, 1};
  dispatch.bindings = {
      {0, BindingType::kStorageBuffer, 1, ImageFormat::kNone, false, true, 0},
      {1, probe.texels ? BindingType::kUniformTexelBuffer : BindingType::kStorageBuffer, 0,
       probe.texels ? ImageFormat::kRgba32Uint : ImageFormat::kNone, true, false, 0}};
  variant.segments = {{"graph", SegmentKind::kGraph, {dispatch}}};
  variant.requirements = binding_requirements(variant);
  variant.requirements.features = needs.features;
  variant.requirements.workgroup_invocations = kLocal;
  package.variants = {variant};
  return NetworkRun::create(device, package, {Tensor::zeros({x.dtype, x.shape})});
}

/// Operations or bytes of a run.
double total_work(const Probe& probe) { return probe.work * probe.groups * kLocal; }

/// Median rate in operations or bytes per nanosecond, after one run that is not measured.
Result<double> median_rate(NetworkRun& run, double work, uint32_t repeat) {
  SHALE_TRY_VOID(run.run());
  std::vector<std::vector<DispatchTime>> measured;
  for (uint32_t i = 0; i < repeat; ++i) {
    SHALE_TRY(std::vector<DispatchTime> times, run.measure());
    measured.push_back(std::move(times));
  }
  return 1e-3 * work / std::max(median_times(measured)[0].time_us, 1e-3);
}

/// The best rate of several probes of one thing, in operations or bytes per nanosecond.
Result<double> best_rate(const ToolDevice& device, const std::vector<Probe>& probes,
                         uint32_t repeat) {
  double best = 0;
  for (const Probe& probe : probes) {
    SHALE_TRY(NetworkRun run, prepare(device, probe));
    SHALE_TRY(const double rate, median_rate(run, total_work(probe), repeat));
    best = std::max(best, rate);
  }
  return best;
}

std::vector<Probe> mul_add_probes() {
  return {arithmetic("float", "a{0} += v * {1}.0", "v += 1.0", 12, 4, 2),
          arithmetic("float", "a{0} += v * {1}.0", "v += 1.0", 16, 16, 2),
          arithmetic("float", "a{0} = a{0} * v + {1}.0", "v *= 0.5", 16, 4, 2)};
}

std::vector<Probe> fetch_probes() {
  constexpr int kReads = 64;
  Probe fetch{
      .body = "  uvec4 s = uvec4(0);\n", .work = 16.0 * kReads, .texels = true, .declarations = {}};
  for (int i = 0; i < kReads; ++i)
    fetch.body += fmt::format("  s += texelFetch(v, (x + {}) & 0x3ffff);\n", 61 * i);
  fetch.body += "  int r = int(s.x + s.y + s.z + s.w);\n";
  return {fetch};
}

std::vector<Probe> store_probes() {
  return {{.body = "  int r = x;\n", .work = 64, .wide = true, .declarations = {}}};
}

}  // namespace

Result<RoofProbe> RoofProbe::create(const ToolDevice& device, RoofKind kind) {
  constexpr uint32_t kTries = 5;
  std::optional<RoofProbe> best;
  double best_rate = 0;
  for (const Probe& probe : kind == RoofKind::kMulAdd  ? mul_add_probes()
                            : kind == RoofKind::kFetch ? fetch_probes()
                                                       : store_probes()) {
    SHALE_TRY(NetworkRun run, prepare(device, probe));
    SHALE_TRY(const double rate, median_rate(run, total_work(probe), kTries));
    if (rate > best_rate) best = RoofProbe(std::move(run), total_work(probe)), best_rate = rate;
  }
  SHALE_CHECK(best);  // rates are above 0
  return *std::move(best);
}

Result<double> RoofProbe::measure() {
  SHALE_TRY(const std::vector<DispatchTime> times, run_.measure());
  return 1e-3 * work_ / std::max(times[0].time_us, 1e-3);
}

Result<std::vector<Roof>> measure_roofs(const ToolDevice& device, uint32_t repeat) {
  std::vector<Roof> roofs;
  const auto add = [&](const char* name, const char* unit,
                       const std::vector<Probe>& probes) -> Result<void> {
    SHALE_TRY(const double rate, best_rate(device, probes, repeat));
    roofs.push_back({name, rate, unit});
    return {};
  };
  SHALE_TRY(const double mul_add, best_rate(device, mul_add_probes(), repeat));
  roofs.push_back({"f32 mul+add", mul_add, "GOP/s"});
  SHALE_TRY_VOID(add("f32 fma", "GOP/s",
                     {arithmetic("float", "a{0} = fma(v, {1}.0, a{0})", "v += 1.0", 12, 4, 2),
                      arithmetic("float", "a{0} = fma(v, {1}.0, a{0})", "v += 1.0", 16, 16, 2)}));
  SHALE_TRY_VOID(add("i32 mul+add", "GOP/s",
                     {arithmetic("int", "a{0} += v * {1}", "v = v * v + 77", 12, 4, 2),
                      arithmetic("int", "a{0} = a{0} * v + {1}", "v ^= 5", 12, 4, 2)}));
  if (device.context().caps.features.has(Feature::kDotProduct8)) {
    Probe dot =
        arithmetic("int", "a{0} += dot8(v, {1} * 0x01030507, 0)", "v = v * 5 + 77", 12, 4, 8);
    // Source: SPIR-V 1.6, OpSDot with the packed format 0.
    dot.declarations =
        "spirv_instruction(extensions = [\"SPV_KHR_integer_dot_product\"], capabilities = [6018, "
        "6019], id = 4450)\nint dot8(int a, int b, spirv_literal int format);\n";
    SHALE_TRY_VOID(add("int8 dot product", "GOP/s", {dot}));
  }
  SHALE_TRY_VOID(add("texel fetch", "GB/s", fetch_probes()));
  constexpr int kReads = 64;
  Probe read{.body = "  ivec4 s = ivec4(0);\n", .work = 16.0 * kReads, .declarations = {}};
  for (int i = 0; i < kReads; ++i)
    read.body += fmt::format("  s += v[(x + {}) & 0x3ffff];\n", 61 * i);
  read.body += "  int r = s.x + s.y + s.z + s.w;\n";
  SHALE_TRY_VOID(add("storage buffer read", "GB/s", {read}));
  SHALE_TRY_VOID(add("storage buffer store", "GB/s", store_probes()));
  return roofs;
}

Result<RoofedTimes> measure_under_roof(const ToolDevice& device, const Package& package,
                                       const std::vector<Tensor>& inputs, uint32_t repeat) {
  SHALE_TRY(NetworkRun network, NetworkRun::create(device, package, inputs));
  SHALE_TRY_VOID(network.run());
  SHALE_TRY(RoofProbe probe, RoofProbe::create(device));
  std::vector<std::vector<DispatchTime>> frames;
  std::vector<double> roofs, wholes;
  for (uint32_t i = 0; i < repeat; ++i) {
    SHALE_TRY(const double before, probe.measure());
    SHALE_TRY(std::vector<DispatchTime> frame, network.measure());
    SHALE_TRY(const double whole, network.measure_whole());
    SHALE_TRY(const double after, probe.measure());
    frames.push_back(std::move(frame));
    wholes.push_back(whole);
    roofs.push_back((before + after) / 2);
  }
  const auto median = [](std::vector<double> values) {
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
  };
  RoofedTimes result;
  result.roof = median(roofs);
  const auto [lowest, highest] = std::minmax_element(roofs.begin(), roofs.end());
  result.roof_swing = *highest / *lowest;
  for (size_t i = 0; i < frames.size(); ++i) {
    for (DispatchTime& time : frames[i]) time.time_us *= roofs[i] / result.roof;
    wholes[i] *= roofs[i] / result.roof;
  }
  result.whole_us = median(wholes);
  result.times = median_times(frames);
  result.outputs = network.outputs();
  return result;
}

}  // namespace shale
