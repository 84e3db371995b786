// tools/eval/tonemap.h -- from linear HDR to what a display shows; the same for every picture that is
// compared, shown or written.
#pragma once

#include <cmath>

#include "tools/scene/frame_source.h"
#include "tools/shale/picture.h"

namespace shale {

/// Reinhard's x / (1 + x), then the sRGB curve. Negative values and NaN give 0, +infinity gives 1.
inline float display_value(float exposed_linear) {
  if (!(exposed_linear > 0)) return 0;
  if (std::isinf(exposed_linear)) return 1;
  const float mapped = exposed_linear / (1 + exposed_linear);
  return mapped <= 0.0031308f ? 12.92f * mapped : 1.055f * std::pow(mapped, 1 / 2.4f) - 0.055f;
}

/// display_value of linear times exposure, rounded to 8 bits: every value is k / 255.
/// Takes 3 channels or more; gives the first 3.
FloatImage display_image(const FloatImage& linear, float exposure);

/// RGB in [0, 1] and opaque 8-bit RGBA into each other. From floats it rounds; 1 channel gives grey.
Picture to_picture(const FloatImage& display);
FloatImage to_float_image(const Picture& picture);

}  // namespace shale
