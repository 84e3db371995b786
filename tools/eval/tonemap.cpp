#include "tools/eval/tonemap.h"

#include <algorithm>

#include "tools/eval/fast_math.h"
#include "tools/eval/parallel.h"
#include "tools/eval/wide.h"

namespace shale {
namespace {

/// display_value * 255 to about 1e-4, for x in [0, 1e30].
inline float quick_code(float x) {
  const float mapped = x / (1 + x);
  const float curve = 1.055f * fast_pow(mapped > 1e-6f ? mapped : 1e-6f, 1 / 2.4f) - 0.055f;
  return 255 * (mapped <= 0.0031308f ? 12.92f * mapped : curve);
}

/// Codes of a row; where the quick value lies close to a rounding boundary the exact one decides.
SHALE_WIDE void display_codes(const float* __restrict exposed, float* __restrict codes,
                              size_t count) {
  for (size_t i = 0; i < count; ++i) {
    float x = exposed[i] > 0 ? exposed[i] : 0;  // NaN too
    x = x < 1e30f ? x : 1e30f;
    codes[i] = quick_code(x);
  }
  for (size_t i = 0; i < count; ++i) {
    constexpr float kDoubt = 2e-3f;
    const float below = std::floor(codes[i]), part = codes[i] - below;
    codes[i] = std::abs(part - 0.5f) < kDoubt ? std::round(255 * display_value(exposed[i]))
                                              : below + (part > 0.5f ? 1.0f : 0.0f);
  }
}

}  // namespace

FloatImage display_image(const FloatImage& linear, float exposure) {
  SHALE_CHECK(linear.channels >= 3);
  FloatImage result{linear.width, linear.height, 3,
                    std::vector<float>(size_t{linear.width} * linear.height * 3)};
  parallel_rows(linear.height, 0, [&](uint32_t begin, uint32_t end) {
    const size_t count = size_t{linear.width} * 3;
    std::vector<float> exposed(count);
    for (uint32_t y = begin; y < end; ++y) {
      const float* const from = linear.at(0, y);
      for (size_t x = 0; x < linear.width; ++x)
        for (size_t c = 0; c < 3; ++c)
          exposed[3 * x + c] = from[linear.channels * x + c] * exposure;
      float* const to = result.at(0, y);
      display_codes(exposed.data(), to, count);
      for (size_t i = 0; i < count; ++i) to[i] /= 255;
    }
  });
  return result;
}

Picture to_picture(const FloatImage& display) {
  SHALE_CHECK(display.channels == 1 || display.channels >= 3);
  Picture picture = Picture::filled(display.width, display.height, 0);
  const size_t pixels = size_t{display.width} * display.height;
  for (size_t i = 0; i < pixels; ++i)
    for (size_t c = 0; c < 3; ++c) {
      const float value = display.values[i * display.channels + (display.channels == 1 ? 0 : c)];
      picture.rgba[4 * i + c] =
          static_cast<uint8_t>(std::clamp(value > 0 ? value : 0, 0.0f, 1.0f) * 255 + 0.5f);
    }
  return picture;
}

FloatImage to_float_image(const Picture& picture) {
  const size_t pixels = size_t{picture.width} * picture.height;
  FloatImage image{picture.width, picture.height, 3, std::vector<float>(pixels * 3)};
  for (size_t i = 0; i < pixels; ++i)
    for (size_t c = 0; c < 3; ++c)
      image.values[3 * i + c] = static_cast<float>(picture.rgba[4 * i + c]) / 255;
  return image;
}

}  // namespace shale
