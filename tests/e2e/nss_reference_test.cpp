// The shaders of NSS v1 against their model in double precision.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/e2e/sandwich_support.h"
#include "tools/eval/tonemap.h"
#include "tools/reference/nss_v1.h"

namespace shale {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// How many values differ, by how much.
struct Departures {
  size_t values = 0, off = 0, beyond = 0;  ///< off: at all; beyond: by more than the tolerance
  double largest = 0;

  void add(double found, double expected, double tolerance) {
    ++values;
    const double d = std::abs(found - expected);
    off += d > 0;
    beyond += !(d <= tolerance);
    largest = std::max(largest, d);
  }
  double share_off() const { return static_cast<double>(off) / static_cast<double>(values); }
  std::string text() const {
    return fmt::format("{} of {} differ, {} beyond the tolerance, by {:.3g} at most", off, values,
                       beyond, largest);
  }
};

struct Setting {
  Kind kind;
  Extent render, output;
};
// Twice the size and ratios of 1.5 and 1.7, sides that nothing divides.
const Setting kSettings[] = {{kKinds[0], {33, 19}, {66, 38}},
                             {kKinds[0], {26, 18}, {39, 27}},
                             {kKinds[1], {33, 19}, {66, 38}},
                             {kKinds[1], {17, 25}, {29, 43}}};

class NssReferenceTest : public SandwichTest {
 protected:
  /// Noise, bad texels in it, and from a cut on two planes of depth, one of them at rest, in light that swings; in either
  /// direction of depth.
  static SourceFrame frame(const Setting& setting, uint32_t index) {
    const bool is_noise = index < 5;
    SourceFrame frame = noise_frame(setting.render, setting.output, is_noise ? index : 5, kSeed);
    frame.camera.jitter = scene_jitter(index, setting.render, setting.output);
    frame.camera.cut = index == 5;
    frame.camera.exposure = is_noise ? std::exp2(static_cast<float>(index) - 2) : 1;
    frame.camera.reverse_depth = !is_noise;
    std::mt19937_64 random(index);
    const float bad[] = {kNan, kInfinity, -kInfinity, -1, 65504, 0, 1e5f, 6e-8f};
    for (FloatImage* image : {&frame.color, &frame.depth, &frame.motion})
      for (float& value : image->values)
        if ((index == 2 || index == 3) && random() % 16 == 0) value = bad[random() % 8];
    for (uint32_t y = 0; y < setting.render.height && !is_noise; ++y)
      for (uint32_t x = 0; x < setting.render.width; ++x) {
        const bool rests = x < setting.render.width / 2;
        *frame.depth.at(x, y) = rests ? 0.2f : 0.3f;
        if (rests) std::fill_n(frame.motion.at(x, y), 2, 0.0f);
        for (int c = 0; c < 3; ++c)
          frame.color.at(x, y)[c] *= 1 + 0.3f * static_cast<float>(index * (x + y) % 3);
      }
    return frame;
  }
  static nss_v1::Form form_of(const Setting& setting, const Player& player) {
    const CompileOptions options =
        options_of(models() + setting.kind.model, setting.render, setting.output);
    return must(nss_v1::form_of(*options.frame, player.variant()));
  }
};

// Between what the shader stores and what the model does lies the rounding of floats, some 2^-22 of a value of about 1. So a
// code is another one, the next, where a value lies as near to the middle between two; so few do. A mean of a kernel's colours
// in 0..1 and that of their squares lose up to 7e-7, which the deviation's root of at least 1e-7 makes 6e-4, and the clamp
// twice that; then a half float may be the next, 2^-10 of a linear colour, a quarter of that of a mapped one. A choice (a depth
// test, a clamp to taps) may fall the other way; then a texel of the network differs by anything.
constexpr double kMappedTolerance = 1.5e-3;
constexpr double kCodesOff = 1e-3, kColorsOff = 0.02, kChoices = 1e-3;

double mapped(double color, const SourceFrame& frame) {
  color *= static_cast<double>(frame.camera.exposure);
  return color / (1 + color);
}

TEST_F(NssReferenceTest, EachPassStoresWhatTheModelDoes) {
  constexpr auto kAsStored = nss_v1::Rounding::kAsStored;
  for (const Setting& setting : kSettings) {
    const auto player = player_of(setting.kind, kSeed, setting.render, setting.output);
    const nss_v1::Form form = form_of(setting, *player);
    const std::string name =
        fmt::format("{} {}x{} to {}x{}", setting.kind.model, setting.render.width,
                    setting.render.height, setting.output.width, setting.output.height);
    // Each pass from the device's own past; and two models that go their own way, with the network's results alone.
    nss_v1::Past past;
    nss_v1::Model stored(form, kAsStored), exact(form, nss_v1::Rounding::kNone);
    Departures codes, states, colors, of_stored, of_exact;
    for (uint32_t t = 0; t < 12; ++t) {
      const SourceFrame frame = this->frame(setting, t);
      if (frame.camera.cut) past = {};
      must(player->play(frame));
      const Tensor input = must(player->read_tensor("input"));
      Tensor temporal = must(player->read_tensor("temporal"));
      const Tensor kernel = must(player->read_tensor("kernel"));
      nss_v1::Grid state = nss_v1::grid_of(must(player->read("state", false)), 4);
      nss_v1::Grid history = nss_v1::grid_of(must(player->read("history", false)), 3);

      const nss_v1::Grid scattered = nss_v1::scatter(form, frame, kAsStored);
      const nss_v1::Grid hidden =
          form.side == 2 ? nss_v1::disocclusion(form, frame, scattered, kAsStored) : nss_v1::Grid{};
      const nss_v1::Pre pre = nss_v1::pre(form, frame, scattered, hidden, past, kAsStored);
      ASSERT_EQ(input.type, pre.input.type);
      for (int64_t i = 0; i < input.count(); ++i)
        codes.add(static_cast<double>(input.get(i)), static_cast<double>(pre.input.get(i)), 1);
      for (size_t i = 0; i < state.values.size(); ++i) {
        states.add(std::round(127 * state.values[i]), std::round(127 * pre.state.values[i]), 1);
        state.values[i] = std::round(127 * state.values[i]) / 127;  // of a float
      }
      const nss_v1::Grid expected =
          nss_v1::post(form, frame, pre.dilated, past, temporal, kernel, kAsStored);
      for (size_t i = 0; i < history.values.size(); ++i)
        colors.add(mapped(history.values[i], frame), mapped(expected.values[i], frame),
                   kMappedTolerance);

      const nss_v1::Network network = [&](const Tensor&) {
        return Result<std::pair<Tensor, Tensor>>(std::pair(temporal, kernel));
      };
      const FloatImage shown = display_image(nss_v1::picture_of(history), frame.camera.exposure);
      for (const auto& [model, departures] :
           {std::pair{&stored, &of_stored}, {&exact, &of_exact}}) {
        const FloatImage other =
            display_image(must(model->play(frame, network)), frame.camera.exposure);
        for (size_t i = 0; i < shown.values.size(); ++i)
          departures->add(255 * static_cast<double>(shown.values[i]),
                          255 * static_cast<double>(other.values[i]), 1.01);
      }
      past = {std::move(history), std::move(state), std::move(temporal)};
    }
    EXPECT_LE(codes.share_off(), kCodesOff) << name << ": codes: " << codes.text();
    EXPECT_LE(states.share_off(), kCodesOff) << name << ": states: " << states.text();
    EXPECT_LE(colors.share_off(), kColorsOff) << name << ": colours: " << colors.text();
    for (const Departures& d : {codes, states, colors, of_stored, of_exact})
      EXPECT_LE(static_cast<double>(d.beyond), kChoices * static_cast<double>(d.values))
          << name << ": " << d.text();
  }
}

TEST_F(NssReferenceTest, OtherPassesHaveNone) {
  for (const auto& [model, why] : {std::pair{"nss_v0_1", "has nss/post_v0_1.comp"},
                                   {"baselines/tss", "has tss/"},
                                   {"qrisp_s_x2", "has several programs"}}) {
    const Frame frame = must(parse_frame(must(read_text(models() + model + "/frame.json"))));
    const auto form = nss_v1::form_of(frame, Variant{});
    ASSERT_FALSE(form) << model;
    EXPECT_NE(form.error().text().find(why), std::string::npos) << form.error().text();
  }
}

}  // namespace
}  // namespace shale
