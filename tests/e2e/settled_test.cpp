// Sandwiches whose passes run only where something happens (compiler/plan/settled.h): while a tile is not settled
// all is what the whole sandwich shows, bit for bit; where it is, what is shown stays close to that, and little runs.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <random>

#include "compiler/driver/compile.h"
#include "ir/base/file.h"
#include "tests/compiler/graph_support.h"
#include "tests/support/source_folder.h"
#include "tests/support/tool_device_test.h"
#include "tools/eval/metrics.h"
#include "tools/shale/player.h"

namespace shale {
namespace {

constexpr uint64_t kSeed = 17;
constexpr uint32_t kCycle = 4;  // frames of the jitter
constexpr uint32_t kUntilSettled = kCycle + 32 + 4;

struct Form {
  std::string model, target;
  std::vector<std::string> kernels;
  FrameExtent render, output;
  double most_at_rest =
      0.4;  ///< share of the predicted time; the rest are copies and looks, much of such a small frame

  friend void PrintTo(const Form& form, std::ostream* out) {
    *out << form.model << " " << form.target;
  }
};

/// A still picture, sampled at the jitter of its frame; things are put onto it.
class Scene {
 public:
  explicit Scene(Extent size) : size_(size) {}

  SourceFrame frame(uint32_t number) const {
    SourceFrame frame;
    frame.camera.fov_x = 1.2f;
    frame.camera.fov_y = 0.8f;
    frame.camera.far_plane = 100;
    frame.camera.exposure = exposure;
    const uint32_t phase = number % kCycle;
    frame.camera.jitter = {phase % 2 == 0 ? -0.25f : 0.25f, phase / 2 == 0 ? -0.25f : 0.25f};
    frame.color = FloatImage{size_.width, size_.height, 3, {}};
    frame.depth = FloatImage{size_.width, size_.height, 1, {}};
    frame.motion = FloatImage{size_.width, size_.height, 2, {}};
    for (uint32_t y = 0; y < size_.height; ++y)
      for (uint32_t x = 0; x < size_.width; ++x) {
        const float u = static_cast<float>(x) + frame.camera.jitter[0],
                    v = static_cast<float>(y) + frame.camera.jitter[1];
        for (const float frequency : {0.11f, 0.07f, 0.05f})
          frame.color.values.push_back(0.4f +
                                       0.2f * std::sin(frequency * u) * std::cos(frequency * v) +
                                       (u > 50.1f && u < 81.9f ? 0.3f : 0.0f));
        frame.depth.values.push_back(0.5f + 0.2f * std::sin(0.01f * (u + v)));
        frame.motion.values.insert(frame.motion.values.end(), {0, 0});
      }
    return frame;
  }

  float exposure = 1;

 private:
  Extent size_;
};

/// Something nearer of another colour, that moves by a pixel a frame.
void put(SourceFrame& frame, Crop at, float shade) {
  for (uint32_t y = at.y; y < std::min(at.y + at.height, frame.color.height); ++y)
    for (uint32_t x = at.x; x < std::min(at.x + at.width, frame.color.width); ++x) {
      std::fill_n(frame.color.at(x, y), 3, shade);
      *frame.depth.at(x, y) = 0.1f;
      frame.motion.at(x, y)[0] = 1.0f / static_cast<float>(frame.color.width);
    }
}

class Settled : public ToolDeviceTest<testing::TestWithParam<Form>> {
 protected:
  Compiled compiled(std::optional<uint32_t> tiles) const {
    const std::string folder = source_folder() + "/models/" + GetParam().model;
    CompileOptions options;
    options.targets = {GetParam().target};
    options.kernels = GetParam().kernels;
    options.frame = must(parse_frame(must(read_text(folder + "/frame.json"))));
    options.load_shader = [folder](const std::string& path) {
      return read_text(folder + "/" + path);
    };
    options.sizes = {GetParam().render, GetParam().output};
    options.tiles = tiles;
    const bool has_network = std::filesystem::exists(folder + "/model.tosa");
    return must(compile(
        has_network ? must(read_file(folder + "/model.tosa")) : std::vector<uint8_t>(), options));
  }

  /// Both players' pictures of a frame.
  void show(const SourceFrame& frame) {
    SourceFrame one = frame, other = frame;
    whole_ = must(all_->show(one));
    own_ = must(parts_->show(other));
    share_ = parts_->share_run().value_or(-1);
  }

  std::unique_ptr<Player> all_, parts_;
  FloatImage whole_, own_;
  double share_ = 0;
};

TEST_P(Settled, TilesStayAsTheyAreUntilSomethingHappens) {
  const Compiled whole = compiled({}), tiles = compiled(1);
  for (const std::string& line :
       missing(device_->context().caps, tiles.package.variants[0].requirements))
    GTEST_SKIP() << line;
  all_ = must(Player::create(*device_, whole.package));
  parts_ = must(Player::create(*device_, tiles.package));
  Scene scene(all_->render_size());
  uint32_t number = 0;
  const auto play_still = [&](uint32_t count) {
    for (uint32_t i = 0; i < count; ++i) show(scene.frame(number++));
  };
  for (; number < kCycle + 16; ++number) {
    show(scene.frame(number));
    ASSERT_EQ(own_.values, whole_.values) << "frame " << number;
    EXPECT_GT(share_, 0.6) << "frame " << number;  // the network may find less
  }
  play_still(kUntilSettled);
  const double at_rest = share_;
  EXPECT_LT(at_rest, GetParam().most_at_rest);
  const FloatImage rested = own_;
  FloatImage mean = own_;
  std::fill(mean.values.begin(), mean.values.end(), 0.0f);
  double nearest = 0;
  for (uint32_t i = 0; i < kCycle; ++i) {  // in each image of the rings
    play_still(1);
    EXPECT_EQ(own_.values, rested.values);
    EXPECT_DOUBLE_EQ(share_, at_rest);
    const double apart = psnr_db(whole_, own_);
    EXPECT_GT(apart, 45);
    nearest = std::max(nearest, apart);
    for (size_t k = 0; k < mean.values.size(); ++k)
      mean.values[k] += whole_.values[k] / static_cast<float>(kCycle);
  }
  // It is nearer to the mean of what the whole sandwich goes on through than to any of these.
  EXPECT_GT(psnr_db(mean, own_), nearest + 0.5);

  // Things that pass through, and come to lie somewhere.
  std::mt19937_64 random(kSeed);
  const auto below = [&](uint32_t limit) { return static_cast<uint32_t>(random() % limit); };
  const Extent size = all_->render_size();
  for (uint32_t i = 0; i < 6; ++i) {
    SourceFrame frame = scene.frame(number++);
    const Crop at{i < 3 ? 5 + i : below(size.width), i < 3 ? 7 : below(size.height), 9, 6};
    put(frame, at, 0.9f);
    show(frame);
    EXPECT_GT(share_, at_rest) << i;
    EXPECT_LT(share_, 1) << i;
    EXPECT_GT(psnr_db(whole_, own_), 40) << i;
    // What the whole sandwich shows of the thing, to a code or two: all around it runs.
    for (uint32_t y = at.y; y < std::min(at.y + at.height, size.height); ++y) {
      const uint32_t ox = at.x * all_->output_size().width / size.width,
                     oy = y * all_->output_size().height / size.height;
      EXPECT_NEAR(own_.at(ox, oy)[0], whole_.at(ox, oy)[0], 0.03) << i;
    }
  }
  // Where they were all is as it was, and everything settles again.
  play_still(2 * kUntilSettled);
  EXPECT_DOUBLE_EQ(share_, at_rest);
  EXPECT_GT(psnr_db(whole_, own_), 45);

  // Other parameters: all of it is looked at anew.
  scene.exposure = 1.25f;
  play_still(1);
  EXPECT_GT(share_, 0.6);
  play_still(kUntilSettled + kCycle);
  EXPECT_DOUBLE_EQ(share_, at_rest);

  // And a cut is the first frame of all, to the bit.
  SourceFrame cut = scene.frame(number++);
  cut.camera.cut = true;
  show(cut);
  EXPECT_EQ(own_.values, whole_.values);
  EXPECT_DOUBLE_EQ(share_, 1);
  play_still(3);
  EXPECT_EQ(own_.values, whole_.values);
}

const std::vector<std::string> kPlain{"conv2d_s8_loop", "generic"};

INSTANTIATE_TEST_SUITE_P(
    Forms, Settled,
    testing::Values(Form{"nss_v1_low", "lavapipe", kPlain, {200, 70}, {400, 140}},
                    Form{"baselines/tss", "lavapipe", {}, {200, 70}, {400, 140}, 0.7},
                    Form{"nss_v1_low", "dot8-gpu", {}, {131, 45}, {197, 67}}));

}  // namespace
}  // namespace shale
