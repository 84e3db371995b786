// tests/support/small_packages.h -- hand-made packages whose results are known by plain arithmetic.
#pragma once

#include <cstdint>
#include <vector>

#include "ir/package/package.h"

namespace shale {

/// Extent of the tensors i8[1,h,w,4] and of the images below.
inline constexpr uint32_t kSmallWidth = 16;
inline constexpr uint32_t kSmallHeight = 8;
inline constexpr uint32_t kSmallBytes = kSmallWidth * kSmallHeight * 4;

/// Four dispatches "scale", "pair", "double", "sum" from "x" to "y", with weights, a texel buffer,
/// a shader used twice, and an arena in which the third result takes the place of the first.
Package small_graph();
/// What it computes: y of an x of kSmallBytes.
std::vector<int8_t> small_graph_result(const std::vector<int8_t>& x);

/// Pre-pass "pre", network "scale", post-pass "post" from image "color" to image "shown" (both
/// rgba8_unorm), with the internal image "blend" and the history "history" (r32_uint) of depth 3.
Package small_frame();

/// small_frame and a second program, "again", that only fills "blend" (and "x"), with what the next
/// frame would fill it: from the same history, which it only reads.
Package small_frame_again();

/// Two programs of one graph each on one history of tensors, "y" of depth 3: "frame" writes
/// y = x * weight of the channel and s = y + y of two records before; "between" z = y + y of the
/// record before. "x" is filled by the host.
Package small_programs();

/// A pass that shows image "color" by a sampler halfway between four texels, in image "shown".
Package small_filter();

/// The same frames in plain C++.
class SmallFrameModel {
 public:
  /// `color` and the result are kSmallBytes of RGBA.
  std::vector<uint8_t> next(const std::vector<uint8_t>& color);
  void reset_history();
  /// What is in "blend" next time.
  std::vector<uint32_t> blend() const;

 private:
  static constexpr size_t kPixels = kSmallWidth * kSmallHeight;
  std::vector<uint32_t> last_ = std::vector<uint32_t>(kPixels);
  std::vector<uint32_t> before_ = std::vector<uint32_t>(kPixels);
};

}  // namespace shale
