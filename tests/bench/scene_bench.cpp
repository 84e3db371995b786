// The scene renderer on the device at hand: primitives, and meshes with textures by the hundred thousand.
//
//   scene_bench [--benchmark_filter=garden ...]
//
// A frame of 480x270 without truth: a primary ray a pixel, and from what it hits a ray to the sun and to every
// light near by. "rays" counts the primary ones alone, a second of wall time; "triangles" those of the models and
// "drawn" those that stand in the scene, "MB" and "textures_MB" what lies of them in the device's memory.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include "runtime/vk/device.h"
#include "tools/scene/scene_source.h"
#include "tools/shale/device_run.h"

namespace shale {
namespace {

void render(benchmark::State& state, const std::string& file) {
  const Result<ToolDevice> device = ToolDevice::open({});
  if (!device) return state.SkipWithError(device.error().text().c_str());
  Result<Scene> scene = load_scene(file);
  // Models lie in packages that need not be installed: the error says which.
  if (!scene) return state.SkipWithError(scene.error().text().c_str());
  double own = 0, drawn = 0;
  for (const SceneModel& model : scene->models)
    own += static_cast<double>(model.mesh.triangles.size());
  for (const Instance& instance : scene->instances)
    drawn += static_cast<double>(scene->models[instance.model].mesh.triangles.size());
  const Result<ModelBuffers> buffers = model_buffers(scene->models);
  if (!buffers) return state.SkipWithError(buffers.error().text().c_str());
  const double geometry = 4e-6 * static_cast<double>(buffers->geometry.size()),
               textures = 4e-6 * static_cast<double>(buffers->texels.size());
  SceneOptions options;
  options.render = options.output = {480, 270};
  Result<std::unique_ptr<SceneSource>> source =
      SceneSource::create(device->context(), *std::move(scene), options);
  if (!source) return state.SkipWithError(source.error().text().c_str());
  if (const auto first = (*source)->frame(0, false); !first)  // the driver compiles
    return state.SkipWithError(first.error().text().c_str());
  uint32_t frame = 0;
  for (auto _ : state)
    benchmark::DoNotOptimize((*source)->frame(++frame % (*source)->frame_count(), false));
  state.counters["rays"] = benchmark::Counter(480.0 * 270 * static_cast<double>(state.iterations()),
                                              benchmark::Counter::kIsRate);
  state.counters["triangles"] = own;
  state.counters["drawn"] = drawn;
  state.counters["MB"] = geometry;
  state.counters["textures_MB"] = textures;
}

}  // namespace
}  // namespace shale

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  for (const char* name : {"train/city", "test/motion", "train/garden", "train/winter_wood",
                           "test/park", "test/bedroom", "test/level"})
    benchmark::RegisterBenchmark(
        name,
        [name](benchmark::State& state) {
          shale::render(state, fmt::format("{}/models/scenes/{}.json", SHALE_SOURCE_DIR, name));
        })
        ->UseRealTime()
        ->Unit(benchmark::kMillisecond)
        ->Iterations(5);
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
