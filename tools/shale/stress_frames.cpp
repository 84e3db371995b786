#include "tools/shale/stress_frames.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "tools/eval/tonemap.h"
#include "tools/scene/scene_source.h"

namespace shale {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kLargestHalf = 65504;
constexpr uint32_t kLeastCycle = 32;
constexpr uint32_t kBadOf100 = 1;

/// Of a texel in a frame, evenly spread.
uint32_t hash(uint32_t x, uint32_t y, uint32_t frame) {
  uint32_t h = x * 0x9e3779b1u ^ y * 0x85ebca77u ^ frame * 0xc2b2ae3du;
  h = (h ^ (h >> 15)) * 0x2c1b3c6du;
  h = (h ^ (h >> 12)) * 0x297a2d39u;
  return h ^ (h >> 15);
}

template <typename Value>
void fill(FloatImage& image, const Value& value) {
  for (uint32_t y = 0; y < image.height; ++y)
    for (uint32_t x = 0; x < image.width; ++x)
      std::fill_n(image.at(x, y), image.channels, value(x, y));
}

void fill_with(FloatImage& image, float value) {
  fill(image, [&](uint32_t, uint32_t) { return value; });
}

float checkered(uint32_t x, uint32_t y, float even, float odd) { return (x + y) % 2 ? odd : even; }

void spoil(SourceFrame& frame, uint32_t x, uint32_t y) {
  for (FloatImage* image : {&frame.color, &frame.depth, &frame.motion})
    std::fill_n(image->at(x, y), image->channels, kNan);
}

template <uint32_t of_100>
void spoil_some(SourceFrame& frame) {
  for (uint32_t y = 0; y < frame.color.height; ++y)
    for (uint32_t x = 0; x < frame.color.width; ++x)
      if (hash(x, y, 0) % 100 < of_100) spoil(frame, x, y);
}

using For = Fault::For;
constexpr Fault kFaults[] = {
    {"colour", "0", For::kAny, [](SourceFrame& f) { fill_with(f.color, 0); }},
    {"colour", "denormal, 1e-40", For::kLinear, [](SourceFrame& f) { fill_with(f.color, 1e-40f); }},
    {"colour", "1e-7", For::kLinear, [](SourceFrame& f) { fill_with(f.color, 1e-7f); }},
    {"colour", "1", For::kAny, [](SourceFrame& f) { fill_with(f.color, 1); }},
    {"colour", "10000", For::kLinear, [](SourceFrame& f) { fill_with(f.color, 1e4f); }},
    {"colour", "65504", For::kLinear, [](SourceFrame& f) { fill_with(f.color, kLargestHalf); }},
    {"colour", "infinity", For::kLinear, [](SourceFrame& f) { fill_with(f.color, kInfinity); }},
    {"colour", "NaN", For::kLinear, [](SourceFrame& f) { fill_with(f.color, kNan); }},
    {"colour", "-1", For::kLinear, [](SourceFrame& f) { fill_with(f.color, -1); }},
    {"colour", "-infinity", For::kLinear, [](SourceFrame& f) { fill_with(f.color, -kInfinity); }},
    {"colour", "rows of 0 and 1", For::kAny,
     [](SourceFrame& f) {
       fill(f.color, [](uint32_t, uint32_t y) { return y % 2 ? 1.0f : 0.0f; });
     }},
    {"colour", "checkered 0 and 1", For::kAny,
     [](SourceFrame& f) {
       fill(f.color, [](uint32_t x, uint32_t y) { return checkered(x, y, 0, 1); });
     }},
    {"colour", "checkered 0 and 65504", For::kLinear,
     [](SourceFrame& f) {
       fill(f.color, [](uint32_t x, uint32_t y) { return checkered(x, y, 0, kLargestHalf); });
     }},
    {"exposure", "1e-6", For::kLinear, [](SourceFrame& f) { f.camera.exposure = 1e-6f; }},
    {"exposure", "0.001", For::kLinear, [](SourceFrame& f) { f.camera.exposure = 1e-3f; }},
    {"exposure", "1000", For::kLinear, [](SourceFrame& f) { f.camera.exposure = 1e3f; }},
    {"exposure", "1e6", For::kLinear, [](SourceFrame& f) { f.camera.exposure = 1e6f; }},
    {"depth", "0", For::kTemporal, [](SourceFrame& f) { fill_with(f.depth, 0); }},
    {"depth", "1", For::kTemporal, [](SourceFrame& f) { fill_with(f.depth, 1); }},
    {"depth", "NaN", For::kTemporal, [](SourceFrame& f) { fill_with(f.depth, kNan); }},
    {"depth", "infinity", For::kTemporal, [](SourceFrame& f) { fill_with(f.depth, kInfinity); }},
    {"depth", "-1", For::kTemporal, [](SourceFrame& f) { fill_with(f.depth, -1); }},
    {"depth", "checkered 0 and 1", For::kTemporal,
     [](SourceFrame& f) {
       fill(f.depth, [](uint32_t x, uint32_t y) { return checkered(x, y, 0, 1); });
     }},
    {"depth", "the other direction", For::kTemporal,
     [](SourceFrame& f) { f.camera.reverse_depth = !f.camera.reverse_depth; }},
    {"depth", "near plane 0.0001", For::kTemporal,
     [](SourceFrame& f) { f.camera.near_plane = 1e-4f; }},
    {"depth", "near plane 10", For::kTemporal, [](SourceFrame& f) { f.camera.near_plane = 10; }},
    {"motion", "half a texel", For::kTemporal,
     [](SourceFrame& f) { fill_with(f.motion, 0.5f / static_cast<float>(f.motion.width)); }},
    {"motion", "a picture", For::kTemporal, [](SourceFrame& f) { fill_with(f.motion, 1); }},
    {"motion", "10000 pictures", For::kTemporal, [](SourceFrame& f) { fill_with(f.motion, 1e4f); }},
    {"motion", "NaN", For::kTemporal, [](SourceFrame& f) { fill_with(f.motion, kNan); }},
    {"motion", "infinity", For::kTemporal, [](SourceFrame& f) { fill_with(f.motion, kInfinity); }},
    {"motion", "checkered a quarter", For::kTemporal,
     [](SourceFrame& f) {
       fill(f.motion, [](uint32_t x, uint32_t y) { return checkered(x, y, -0.25f, 0.25f); });
     }},
    {"jitter", "-0.5, -0.5", For::kTemporal,
     [](SourceFrame& f) {
       f.camera.jitter = {-0.5f, -0.5f};
     }},
    {"jitter", "0.5, 0.5", For::kTemporal,
     [](SourceFrame& f) {
       f.camera.jitter = {0.5f, 0.5f};
     }},
    {"texels", "one NaN", For::kTemporal,
     [](SourceFrame& f) {
       const auto [x, y] = spoilt_texel({f.color.width, f.color.height});
       spoil(f, x, y);
     }},
    {"texels", "1 % NaN", For::kTemporal, spoil_some<kBadOf100>},
    {"texels", "all NaN", For::kTemporal, spoil_some<100>},
    {"cut", "each frame", For::kAny, [](SourceFrame& f) { f.camera.cut = true; }},
};

}  // namespace

std::string_view course_name(Course course) {
  constexpr std::string_view kNames[] = {"still", "moving",   "blinking",
                                         "cuts",  "exposure", "1 % NaN"};
  return kNames[static_cast<size_t>(course)];
}

std::span<const Fault> faults() { return kFaults; }

void Relight::apply(std::span<SourceFrame> frames, bool display) const {
  for (uint32_t i = 0; i < frames.size(); ++i) {
    FloatImage& color = frames[i].color;
    for (uint32_t row = y;
         (frame == kAllFrames || frame == i) && row < std::min(color.height, y + kBlock); ++row)
      for (uint32_t column = x; column < std::min(color.width, x + kBlock); ++column)
        for (int c = 0; c < 3; ++c) {
          float& value = color.at(column, row)[c];
          value = std::min(std::ldexp(value, stops), display ? 1.0f : kLargestHalf);
        }
  }
}

std::array<uint32_t, 2> spoilt_texel(Extent render) {
  return {render.width / 2, render.height / 2};
}

uint32_t StressFrames::cycle() const {
  const uint32_t phases = jitter_phases(render_, output_, pattern_);
  return (kLeastCycle + phases - 1) / phases * phases;
}

SourceFrame StressFrames::frame(Course course, uint32_t index) const {
  const uint32_t in_cycle = index % cycle();
  const double turn = 2 * std::numbers::pi / cycle(), angle = turn * in_cycle;
  SourceFrame frame;
  FrameCamera& camera = frame.camera;
  camera.fov_x = 1.2f;
  camera.fov_y = 0.8f;
  camera.far_plane = 100;
  camera.jitter = scene_jitter(index, render_, output_, pattern_);
  camera.cut = course == Course::kCuts;
  if (course == Course::kExposure)
    camera.exposure = static_cast<float>(std::exp2(5 * std::sin(angle)));
  const bool dark = course == Course::kBlinking && in_cycle >= cycle() / 2;
  // The square's middle in uv, and its way since the frame before.
  const bool moves = course == Course::kMoving;
  const auto middle = [&](double at) {
    return std::array{0.5 + 0.25 * std::cos(at), 0.5 + 0.25 * std::sin(at)};
  };
  const std::array<double, 2> now = middle(moves ? angle : 0),
                              before = middle(moves ? angle - turn : 0);
  frame.color = {render_.width, render_.height, 3, {}};
  frame.depth = {render_.width, render_.height, 1, {}};
  frame.motion = {render_.width, render_.height, 2, {}};
  for (uint32_t y = 0; y < render_.height; ++y)
    for (uint32_t x = 0; x < render_.width; ++x) {
      const double u = (x + 0.5 + static_cast<double>(camera.jitter[0])) / render_.width,
                   v = (y + 0.5 + static_cast<double>(camera.jitter[1])) / render_.height;
      const bool square = std::abs(u - now[0]) < 0.12 && std::abs(v - now[1]) < 0.16;
      const bool lamp = std::hypot(u - 0.2, (v - 0.25) * 0.6) < 0.05;
      const bool tile =
          (static_cast<int>(std::floor(u * 16)) + static_cast<int>(std::floor(v * 9))) % 2;
      std::array<double, 3> color{0.1 + 0.8 * u, 0.2 + 0.5 * v, tile ? 0.6 : 0.3};
      if (square) color = {1.5 * (tile ? 1 : 0.4), 0.3, 0.1};
      if (lamp) color = {20, 16, 8};
      for (const double c : color) {
        const auto value = static_cast<float>(dark ? 0.1 * c : c);
        frame.color.values.push_back(display_ ? display_value(value) : value);
      }
      frame.depth.values.push_back(square ? 0.9f : 0.98f);
      for (const size_t axis : {0u, 1u})
        frame.motion.values.push_back(square ? static_cast<float>(now[axis] - before[axis]) : 0.0f);
      if (course == Course::kNan && hash(x, y, in_cycle) % 100 < kBadOf100) spoil(frame, x, y);
    }
  return frame;
}

}  // namespace shale
