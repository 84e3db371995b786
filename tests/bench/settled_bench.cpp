// A sandwich that leaves settled tiles as they are against the whole one, on a scene at rest in which a square of 0, 5, 25, 50
// and 100 % of the picture moves: the same scene, that scrolls by five pixels a frame.
//
//   settled_bench SETTLED WHOLE DATASET.json [TURNS]
//
// Both are packages of `shale compile`, the first one with --tiles.
// The dataset holds a cycle of the jitter of a still scene, with the truth of its first frame. Prints a table in Markdown:
// medians of the turns, of whole frames with their copies; the share of the frame's predicted time that ran; how far the
// picture is from the whole sandwich's. Then, of a cycle of the scene at rest, the PSNR of both; without turns that alone.
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "tools/eval/metrics.h"
#include "tools/eval/tonemap.h"
#include "tools/scene/dataset.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

double sum_ms(const std::vector<DispatchTime>& times) {
  double sum = 0;
  for (const DispatchTime& time : times) sum += 1e-3 * time.time_us;
  return sum;
}

/// So much of the area, in the middle.
Crop square(Extent size, double part) {
  const auto side = [&](uint32_t extent) {
    return static_cast<uint32_t>(std::lround(std::sqrt(part) * extent));
  };
  const uint32_t width = side(size.width), height = side(size.height);
  return {(size.width - width) / 2, (size.height - height) / 2, width, height};
}

void scroll(SourceFrame& frame, const Crop& crop, uint32_t turn) {
  const SourceFrame from = frame;
  const uint32_t width = frame.color.width;
  for (uint32_t y = crop.y; y < crop.y + crop.height; ++y)
    for (uint32_t x = crop.x; x < crop.x + crop.width; ++x) {
      const uint32_t at = (x + 5 * turn) % width;
      std::copy_n(from.color.at(at, y), 3, frame.color.at(x, y));
      *frame.depth.at(x, y) = *from.depth.at(at, y);
      frame.motion.at(x, y)[0] = -5.0f / static_cast<float>(width);
    }
}

Result<void> bench(const char* settled, const char* unsettled, const char* dataset, size_t turns) {
  const DeviceArguments any;
  SHALE_TRY(const ToolDevice device, ToolDevice::open(any));
  SHALE_TRY(const Sandwich whole, load_sandwich(unsettled, {}, {}, {}));
  SHALE_TRY(const Sandwich tiles, load_sandwich(settled, {}, {}, {}));
  SHALE_TRY(const auto all, Player::create(device, whole.package));
  SHALE_TRY(const auto parts, Player::create(device, tiles.package));
  SHALE_TRY(const auto source, DatasetSource::open(dataset));
  std::vector<SourceFrame> frames;
  for (uint32_t i = 0; i < source->frame_count(); ++i) {
    SHALE_TRY(SourceFrame frame, source->frame(i, i == 0));
    frames.push_back(std::move(frame));
  }
  const FloatImage truth = display_image(frames[0].truth, frames[0].camera.exposure);
  const Extent size = parts->render_size();
  struct Shown {
    FloatImage own, other;
    std::vector<DispatchTime> own_times, other_times;
  };
  uint32_t turn = 0;
  const auto show = [&](double part) -> Result<Shown> {
    SourceFrame frame = frames[turn % frames.size()];
    frame.camera.cut = false;
    scroll(frame, square(size, part), turn++);
    SourceFrame other = frame;
    Shown shown;
    SHALE_TRY(shown.own, parts->show(frame, &shown.own_times));
    SHALE_TRY(shown.other, all->show(other, &shown.other_times));
    return shown;
  };
  // Until all rests: a cycle, as many frames as that takes, and some of what is still. The whole one has less to catch up with.
  for (size_t i = 0; i < 2 * frames.size() + 8; ++i, ++turn) {
    SourceFrame frame = frames[turn % frames.size()];
    frame.camera.cut = turn == 0;
    SHALE_TRY(const FloatImage ignored, parts->play(frame));
    if (i < frames.size()) continue;
    frame.camera.cut = i == frames.size();
    SHALE_TRY(const FloatImage other, all->play(frame));
  }
  if (turns == 0) {
    std::vector<double> own_db, other_db;
    for (size_t i = 0; i < frames.size(); ++i) {
      SHALE_TRY(const Shown shown, show(0));
      own_db.push_back(psnr_db(truth, shown.own));
      other_db.push_back(psnr_db(truth, shown.other));
    }
    const double own = mean_psnr_db(own_db), other = mean_psnr_db(other_db);
    fmt::print("{} at rest {:.3f} dB, {:.1f} % run; the whole {:.3f} dB: {:+.3f} dB\n", settled,
               own, 100 * parts->share_run().value_or(1), other, own - other);
    return {};
  }
  fmt::print("{} of {}x{}\n\n", settled, size.width, size.height);
  fmt::print("| moving | share run | ms | ms of the whole | ratio | apart, dB |\n");
  fmt::print("|---:|---:|---:|---:|---:|---:|\n");
  for (const double part : {0.0, 0.05, 0.25, 0.5, 1.0}) {
    std::vector<double> own, other;
    double share = 0, apart = 0;
    for (size_t i = 0; i < turns; ++i) {
      SHALE_TRY(const Shown shown, show(part));
      share = parts->share_run().value_or(1);
      own.push_back(sum_ms(shown.own_times));
      other.push_back(sum_ms(shown.other_times));
      apart = psnr_db(shown.other, shown.own);
    }
    const double own_ms = median(own), other_ms = median(other);
    fmt::print("| {:.0f} % | {:.1f} % | {:.1f} | {:.1f} | {:.2f} | {:.1f} |\n", 100 * part,
               100 * share, own_ms, other_ms, own_ms / other_ms, apart);
    if (part == 0) {
      SHALE_TRY(const Shown rested, show(0));
      for (const DispatchTime& time : rested.own_times)
        fmt::print(stderr, "{:>24} {:8.2f} ms\n", time.name, 1e-3 * time.time_us);
    }
  }
  return {};
}

}  // namespace
}  // namespace shale

int main(int count, char** values) {
  if (count < 4 || count > 5) {
    fmt::print(stderr, "usage: settled_bench SETTLED WHOLE DATASET.json [TURNS]\n");
    return 2;
  }
  const auto done = shale::bench(values[1], values[2], values[3],
                                 count == 5 ? std::strtoul(values[4], nullptr, 10) : 9);
  if (!done) fmt::print(stderr, "{}\n", done.error().text());
  return done ? 0 : 1;
}
