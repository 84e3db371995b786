// tools/shale/picture.h -- 8-bit RGBA pictures: files, plain upscalers to compare with, panels.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "ir/base/result.h"

namespace shale {

struct Picture {
  uint32_t width = 0, height = 0;
  std::vector<uint8_t> rgba;  ///< [height][width][4]

  const uint8_t* at(uint32_t x, uint32_t y) const { return &rgba[(size_t{y} * width + x) * 4]; }
  uint8_t* at(uint32_t x, uint32_t y) { return &rgba[(size_t{y} * width + x) * 4]; }
  static Picture filled(uint32_t width, uint32_t height, uint8_t grey);
};

/// PNG, JPEG, BMP or TGA of 1 to 16384 pixels a side.
/// Errors: kIo, kBadInput naming the file.
Result<Picture> load_picture(const std::string& path);

/// PNG.
/// Errors: kIo.
Result<void> save_png(const std::string& path, const Picture& picture);

/// Every output pixel takes the input pixel that covers its centre.
Picture upscale_nearest(const Picture& picture, uint32_t width, uint32_t height);

/// Lanczos with three lobes, separable, weights normalized, border clamped.
Picture upscale_lanczos(const Picture& picture, uint32_t width, uint32_t height);

/// The part of `picture` from (x, y), each pixel `zoom` times as wide and high.
Picture magnify(const Picture& picture, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                uint32_t zoom);

struct Panel {
  std::string label;
  Picture picture;
};

/// Panels in rows of `columns`, each under its label, on grey.
Picture side_by_side(const std::vector<Panel>& panels, uint32_t columns);

/// Peak signal-to-noise ratio of RGB in dB, peak 255; infinite for equal pictures. Sizes must be
/// equal.
double psnr_db(const Picture& a, const Picture& b);

}  // namespace shale
