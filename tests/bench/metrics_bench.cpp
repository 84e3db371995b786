// Quality metrics of 1920x1080 pictures, on one core and on two.
//
//   metrics_bench [--benchmark_filter=flip ...]
#include <benchmark/benchmark.h>

#include <cmath>

#include "tools/eval/html_report.h"
#include "tools/eval/sequence.h"
#include "tools/eval/tonemap.h"

namespace shale {
namespace {

constexpr uint32_t kWidth = 1920, kHeight = 1080;

/// Smooth waves and noise of `amplitude` codes.
FloatImage picture(uint32_t seed, uint32_t amplitude) {
  FloatImage image{kWidth, kHeight, 3, std::vector<float>(size_t{kWidth} * kHeight * 3)};
  uint32_t state = seed;
  for (uint32_t y = 0; y < kHeight; ++y)
    for (uint32_t x = 0; x < kWidth; ++x)
      for (uint32_t c = 0; c < 3; ++c) {
        state = state * 1664525 + 1013904223;
        const float wave = std::sin(0.02f * static_cast<float>(x + 40 * c)) *
                           std::cos(0.015f * static_cast<float>(y));
        const float noise = static_cast<float>((state >> 16) % (amplitude + 1));
        image.at(x, y)[c] = std::round(110 + 70 * wave + noise) / 255;
      }
  return image;
}

const FloatImage& reference_picture() {
  static const FloatImage kPicture = picture(1, 20);
  return kPicture;
}

const FloatImage& test_picture() {
  static const FloatImage kPicture = picture(2, 28);
  return kPicture;
}

MetricOptions options(const benchmark::State& state) {
  MetricOptions options;
  options.threads = static_cast<uint32_t>(state.range(0));
  return options;
}

void psnr(benchmark::State& state) {
  for (auto _ : state)
    benchmark::DoNotOptimize(psnr_db(reference_picture(), test_picture(), options(state).threads));
}

void ssim_all_variants(benchmark::State& state) {
  for (auto _ : state)
    benchmark::DoNotOptimize(ssim(reference_picture(), test_picture(), options(state).threads));
}

/// The reference's side, once for all pictures compared with it; copies the picture too.
void flip_prepare(benchmark::State& state) {
  for (auto _ : state) {
    const PreparedReference prepared(reference_picture(), options(state));
    benchmark::DoNotOptimize(prepared.flip_features().edge.data());
  }
}

void flip_of_a_prepared_reference(benchmark::State& state) {
  MetricOptions only = options(state);
  only.psnr = only.ssim = false;
  const PreparedReference prepared(reference_picture(), only);
  FloatImage map;
  for (auto _ : state) benchmark::DoNotOptimize(compare(prepared, test_picture(), &map));
}

/// One step of IF-SSIM alone: the reference's warp and masks, and one method.
void if_ssim_step(benchmark::State& state) {
  SequenceOptions sequence;
  sequence.frame = options(state);
  sequence.frame.psnr = sequence.frame.ssim = sequence.frame.flip = false;
  const FloatImage motion{kWidth, kHeight, 2,
                          std::vector<float>(size_t{kWidth} * kHeight * 2, 0.001f)};
  const FloatImage depth{kWidth, kHeight, 1, std::vector<float>(size_t{kWidth} * kHeight, 0.3f)};
  ReferenceTrack track(sequence);
  SequenceEvaluator evaluator(sequence);
  for (auto _ : state) {
    const Result<void> advanced =
        track.advance({.display = reference_picture(), .motion = &motion, .depth = &depth});
    const Result<FrameMetrics> added = evaluator.add(test_picture(), track);
    if (!advanced || !added) return state.SkipWithError("refused");
  }
}

void tone_map(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(display_image(test_picture(), 2.5f));
}

void png_of_a_picture(benchmark::State& state) {
  const Picture shown = to_picture(test_picture());
  size_t bytes = 0;
  for (auto _ : state) bytes = encode_png(shown).bytes.size();
  state.counters["bytes"] = static_cast<double>(bytes);
}

BENCHMARK(psnr)->Arg(1)->Arg(2)->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(ssim_all_variants)->Arg(1)->Arg(2)->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(flip_prepare)->Arg(1)->Arg(2)->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(flip_of_a_prepared_reference)
    ->Arg(1)
    ->Arg(2)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(if_ssim_step)->Arg(1)->Arg(2)->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(tone_map)->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(png_of_a_picture)->UseRealTime()->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace shale

BENCHMARK_MAIN();
