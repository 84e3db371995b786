// tools/eval/filter_rows.h -- separable filters a row at a time, in plain loops over floats.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace shale {

/// A 1-D filter that is its own mirror image, or minus that. weights[k] is for distance k; the
/// weight at -k is the same, or minus it if `odd` (then weights[0] is 0).
struct HalfFilter {
  std::vector<float> weights;
  bool odd = false;

  uint32_t radius() const { return static_cast<uint32_t>(weights.size()) - 1; }
};

/// out[x] = sum of weight(k) * centre[x + k]. `centre` has radius() valid floats before it and
/// after its end.
void filter_along(const float* centre, uint32_t width, const HalfFilter& filter, float* out);

/// out[x] = sum of weight(k) * rows[radius() + k][x].
void filter_across(const float* const* rows, uint32_t width, const HalfFilter& filter, float* out);

/// The last rows of some planes, found by their number. Rows may have a border on both sides.
class RowRing {
 public:
  RowRing(uint32_t planes, uint32_t rows, uint32_t width)
      : rows_(rows), width_(width), values_(std::size_t{planes} * rows * width) {}

  float* row(uint32_t plane, uint32_t y) {
    return &values_[(std::size_t{plane} * rows_ + y % rows_) * width_];
  }

 private:
  uint32_t rows_, width_;
  std::vector<float> values_;
};

}  // namespace shale
