// A network that works by tiles against the whole one, where a square of its input's area changes from run to run: 0, 5, 25,
// 50 and 100 % of it.
//
//   tiles_bench MODEL.tosa HEIGHT WIDTH [TURNS]
//
// Prints a table in Markdown: the median of the turns, the share of the network's predicted time that ran, and the time
// beside that of the whole network, measured in turns with it.
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "compiler/driver/compile.h"
#include "ir/base/file.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

/// Other codes in a square in the middle of so much of the area; `turn` tells which.
void change(Tensor& input, double part, size_t turn) {
  const Shape& shape = input.type.shape;
  const auto side = [&](int64_t extent) {
    return std::lround(std::sqrt(part) * static_cast<double>(extent));
  };
  const int64_t h = side(shape[1]), w = side(shape[2]), row = shape[2] * shape[3];
  for (int64_t y = (shape[1] - h) / 2; y < (shape[1] + h) / 2; ++y)
    for (int64_t i = (shape[2] - w) / 2 * shape[3]; i < (shape[2] + w) / 2 * shape[3]; ++i)
      input.bytes[static_cast<size_t>(y * row + i)] =
          static_cast<uint8_t>(37 * i + 11 * y + 101 * static_cast<int64_t>(turn));
}

Result<void> bench(const char* path, int64_t height, int64_t width, size_t turns) {
  SHALE_TRY(const std::vector<uint8_t> model, read_file(path));
  CompileOptions options;
  options.expected_runs = kRunsOfFrame;
  SHALE_TRY(Graph graph, shaped_graph(model, options));
  Shape shape = graph.value(graph.inputs.at(0)).type.shape;
  shape.at(1) = height;
  shape.at(2) = width;
  options.passes.input_shapes[graph.value(graph.inputs[0]).name] = shape;
  SHALE_TRY(const ToolDevice device, ToolDevice::open({}));
  options.targets = {"device"};
  options.profiles.emplace("device", profile_from_caps(device.context().caps));
  SHALE_TRY(const Compiled whole, compile(model, options));
  options.tiles = 0;
  SHALE_TRY(const Compiled tiles, compile(model, options));
  std::vector<Tensor> inputs{Tensor::zeros({DType::kInt8, shape})};
  SHALE_TRY(NetworkRun all, NetworkRun::create(device, whole.package, inputs));
  SHALE_TRY(NetworkRun parts, NetworkRun::create(device, tiles.package, inputs));
  SHALE_TRY_VOID(all.run());
  SHALE_TRY_VOID(parts.run());
  fmt::print("{} of {}: arena {} bytes by tiles, {} without\n\n", path, shape_text(shape),
             tiles.package.variants[0].arena_bytes, whole.package.variants[0].arena_bytes);
  fmt::print(
      "| changed | share run | ms | ms without tiles | ratio |\n|---:|---:|---:|---:|---:|\n");
  for (const double part : {0.0, 0.05, 0.25, 0.5, 1.0}) {
    std::vector<double> own, other;
    double share = 0;
    for (size_t turn = 0; turn < turns; ++turn) {
      change(inputs[0], part, turn);
      SHALE_TRY_VOID(all.set_inputs(inputs));
      SHALE_TRY_VOID(parts.set_inputs(inputs));
      SHALE_TRY(const NetworkRun::ChangesRun ran, parts.run_changes());
      SHALE_TRY(const double whole_us, all.measure_whole());
      share = ran.share;
      own.push_back(ran.time_us);
      other.push_back(whole_us);
    }
    const double own_ms = 1e-3 * median(own), other_ms = 1e-3 * median(other);
    fmt::print("| {:.0f} % | {:.1f} % | {:.1f} | {:.1f} | {:.2f} |\n", 100 * part, 100 * share,
               own_ms, other_ms, own_ms / other_ms);
  }
  return {};
}

}  // namespace
}  // namespace shale

int main(int count, char** values) {
  if (count < 4 || count > 5) {
    fmt::print(stderr, "usage: tiles_bench MODEL.tosa HEIGHT WIDTH [TURNS]\n");
    return 2;
  }
  const auto done = shale::bench(values[1], std::atol(values[2]), std::atol(values[3]),
                                 count == 5 ? std::strtoul(values[4], nullptr, 10) : 9);
  if (!done) fmt::print(stderr, "{}\n", done.error().text());
  return done ? 0 : 1;
}
