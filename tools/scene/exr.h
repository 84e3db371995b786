// tools/scene/exr.h -- OpenEXR pictures: the only door to the library, whose exceptions end here.
#pragma once

#include <optional>
#include <string>

#include "tools/scene/frame_source.h"

namespace shale {

/// Most pixels of a picture that is read: 8192 x 8192.
inline constexpr uint64_t kMaxExrPixels = uint64_t{1} << 26;

enum class ExrPrecision { kHalf, kFloat };

/// 1 channel is called R, 2 are R and G, 3 are R, G and B. ZIP compression. Halves: finite values
/// beyond 65504 become 65504. The file is complete or absent.
/// Errors: kIo.
Result<void> write_exr(const std::string& path, const FloatImage& image, ExrPrecision precision);

/// The channels as write_exr calls them, of half or float type; others in the file are ignored. For
/// 1 channel also Z, Y or V, or the only one that the file has; for 2 also X and Y or U and V. `size`
/// is what the picture must have. Values may be anything, NaN included.
/// Errors: kIo; kBadInput naming what was found and expected.
Result<FloatImage> read_exr(const std::string& path, uint32_t channels,
                            std::optional<Extent> size = {});

/// The size of a picture, from its header.
/// Errors: as read_exr.
Result<Extent> exr_size(const std::string& path);

}  // namespace shale
