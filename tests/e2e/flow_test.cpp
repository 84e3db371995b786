// The search for optical flow on pictures whose flow is known: shifts, a rotation, occlusion, hints.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "ir/base/file.h"
#include "tests/support/source_folder.h"
#include "tests/support/tool_device_test.h"
#include "tests/support/vulkan_fixture.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr Extent kSize{192, 128};

using Point = std::array<double, 2>;
using Texture = std::function<double(double x, double y)>;

/// Smooth noise of several octaves, 0.05 to 1.
double noise_at(double x, double y) {
  const auto lattice = [](int i, int j, uint32_t octave) {
    uint32_t h = static_cast<uint32_t>(i) * 0x8da6b343u ^ static_cast<uint32_t>(j) * 0xd8163841u ^
                 octave * 0xcb1ab31fu;
    h = (h ^ h >> 13) * 0x5bd1e995u;
    return ((h ^ h >> 15) & 0xffff) / 65535.0;
  };
  double sum = 0, weight = 0;
  for (uint32_t octave = 0; octave < 4; ++octave) {
    const double cell = 40 / std::exp2(octave), u = x / cell, v = y / cell;
    const int i = static_cast<int>(std::floor(u)), j = static_cast<int>(std::floor(v));
    const auto smooth = [](double t) { return t * t * (3 - 2 * t); };
    const double fx = smooth(u - i), fy = smooth(v - j), part = std::exp2(-0.5 * octave);
    sum +=
        part * ((lattice(i, j, octave) * (1 - fx) + lattice(i + 1, j, octave) * fx) * (1 - fy) +
                (lattice(i, j + 1, octave) * (1 - fx) + lattice(i + 1, j + 1, octave) * fx) * fy);
    weight += part;
  }
  return 0.05 + 0.95 * sum / weight;
}

class FlowTest : public ToolDeviceTest<testing::Test> {
 protected:
  static std::unique_ptr<Player> player_of(Extent size) {
    const std::string folder = source_folder() + "/models/baselines/flow/";
    CompileOptions options;
    options.frame = must(parse_frame(must(read_text(folder + "frame.json"))));
    options.load_shader = [folder](const std::string& path) { return read_text(folder + path); };
    options.sizes = {FrameExtent{size.width, size.height}, FrameExtent{size.width, size.height}};
    const Compiled compiled = must(compile_graph(Graph{}, 0, options));
    return must(Player::create(*device_, compiled.package));
  }

  /// What is seen, and the hint: where it was, in pixels.
  static SourceFrame frame_of(Extent size, const Texture& texture, Point motion = {}) {
    SourceFrame frame;
    frame.color = {size.width, size.height, 3, {}};
    frame.motion = {size.width, size.height, 2, {}};
    for (uint32_t y = 0; y < size.height; ++y)
      for (uint32_t x = 0; x < size.width; ++x) {
        frame.color.values.insert(frame.color.values.end(), 3,
                                  static_cast<float>(texture(x + 0.5, y + 0.5)));
        frame.motion.values.push_back(static_cast<float>(motion[0] / size.width));
        frame.motion.values.push_back(static_cast<float>(motion[1] / size.height));
      }
    return frame;
  }

  /// The flow between two pictures in pixels of them, by pixel of the flow: x, y, then nothing.
  static FloatImage flow(const Texture& before, const Texture& after, Point hint = {}) {
    const auto player = player_of(kSize);
    must(player->play(frame_of(kSize, before)));
    FloatImage found = must(player->play(frame_of(kSize, after, hint)));
    for (float& value : found.values) value *= 4;
    return found;
  }

  /// Part of the pixels, at least `border` of the picture's from its edge, within `allowed` of the flow expected.
  static double right(
      const FloatImage& found, const std::function<Point(double x, double y)>& expected,
      double border, double allowed,
      const std::function<bool(double x, double y)>& counts = [](double, double) { return true; }) {
    size_t right = 0, all = 0;
    for (uint32_t j = 0; j < found.height; ++j)
      for (uint32_t i = 0; i < found.width; ++i) {
        const double x = 4 * i + 2, y = 4 * j + 2;
        if (x < border || y < border || x > kSize.width - border || y > kSize.height - border ||
            !counts(x, y))
          continue;
        const Point wanted = expected(x, y);
        ++all;
        right +=
            std::hypot(found.at(i, j)[0] - wanted[0], found.at(i, j)[1] - wanted[1]) <= allowed;
      }
    EXPECT_GT(all, 50u);
    return static_cast<double>(right) / static_cast<double>(all);
  }
};

TEST_F(FlowTest, NothingMovesWithoutAPastOrMotion) {
  const auto player = player_of(kSize);
  for (int i = 0; i < 3; ++i)
    for (const float value : must(player->play(frame_of(kSize, noise_at))).values)
      ASSERT_EQ(value, 0) << "frame " << i;
}

TEST_F(FlowTest, ShiftsAreFound) {
  // Of the last one the coarsest level, 6x4 pixels, sees one pixel of motion; a third of the picture leaves its neighbours.
  const struct {
    Point shift;
    double part;
  } kCases[] = {
      {{4, 0}, 0.95}, {{-8, 4}, 0.95}, {{3, -2}, 0.92}, {{13.5, 6.25}, 0.95}, {{-31, 18}, 0.55}};
  for (const auto& [shift, part] : kCases) {
    const FloatImage found = flow(
        noise_at, [&, at = shift](double x, double y) { return noise_at(x - at[0], y - at[1]); });
    EXPECT_GT(right(
                  found, [at = shift](double, double) { return at; }, 40, 1),
              part)
        << shift[0] << ", " << shift[1];
  }
}

TEST_F(FlowTest, ARotationIsFound) {
  const double angle = 0.06, c = std::cos(angle), s = std::sin(angle);
  const double mx = kSize.width / 2.0, my = kSize.height / 2.0;
  const FloatImage found = flow(noise_at, [&](double x, double y) {
    return noise_at(mx + c * (x - mx) + s * (y - my), my - s * (x - mx) + c * (y - my));
  });
  EXPECT_GT(
      right(
          found,
          [&](double x, double y) {
            return Point{(c - 1) * (x - mx) - s * (y - my), s * (x - mx) + (c - 1) * (y - my)};
          },
          20, 1),
      0.85);
}

TEST_F(FlowTest, AThingMovesOverWhatStands) {
  const auto picture = [](double left) {
    return [left](double x, double y) {
      return x >= left && x < left + 64 && y >= 32 && y < 96 ? noise_at(x - left + 500, y + 300)
                                                             : noise_at(x, y);
    };
  };
  const FloatImage found = flow(picture(48), picture(60));
  const auto inside = [](double x, double y, double by) {
    return x >= 48 + by && x < 112 - by && y >= 32 + by && y < 96 - by;
  };
  EXPECT_GT(right(
                found,
                [](double, double) {
                  return Point{12, 0};
                },
                0, 1, [&](double x, double y) { return inside(x, y, 12); }),
            0.97);
  EXPECT_GT(right(
                found,
                [](double, double) {
                  return Point{0, 0};
                },
                8, 1, [&](double x, double y) { return !inside(x, y, -28); }),
            0.97);
}

TEST_F(FlowTest, AHintLeadsWhereTheSearchDoesNot) {
  const Point shift{44, 12};  // of a picture so fine that the coarse levels hold nothing of it
  const Texture fine = [](double x, double y) { return noise_at(8 * x, 8 * y); };
  const Texture after = [&](double x, double y) { return fine(x - shift[0], y - shift[1]); };
  const auto expected = [&](double, double) { return shift; };
  EXPECT_LT(right(flow(fine, after), expected, 48, 1), 0.9);
  EXPECT_GT(right(flow(fine, after, shift), expected, 48, 1), 0.93);
  // A wrong hint does no harm.
  const Point small{8, 0};
  EXPECT_GT(
      right(
          flow(noise_at, [&](double x, double y) { return noise_at(x - small[0], y - small[1]); },
               {-60, 20}),
          [&](double, double) { return small; }, 40, 1),
      0.97);
}

TEST_F(FlowTest, AnyPictureHasAFlow) {
  for (const Extent size : {Extent{1, 1}, Extent{3, 2}, Extent{37, 19}, Extent{64, 33}}) {
    const auto player = player_of(size);
    for (int i = 0; i < 3; ++i) {
      SourceFrame frame =
          frame_of(size, [&](double x, double y) { return noise_at(x + 7 * i, y); }, {1e6, -1e6});
      for (size_t k = 0; k < frame.color.values.size(); k += 5)
        frame.color.values[k] = k % 2 ? std::numeric_limits<float>::quiet_NaN()
                                      : std::numeric_limits<float>::infinity();
      frame.motion.values[0] = std::numeric_limits<float>::quiet_NaN();
      for (const float value : must(player->play(frame)).values) ASSERT_TRUE(std::isfinite(value));
    }
  }
}

}  // namespace
}  // namespace shale
