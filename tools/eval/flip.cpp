// LDR-FLIP. Source: Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom, Fairchild, "FLIP: A
// Difference Evaluator for Alternating Images", HPG 2020. A picture becomes five features a pixel,
// computed row by row from a ring of rows that are filtered along x; the reference's are kept.
#include "tools/eval/flip.h"

#include <array>
#include <cmath>
#include <numbers>

#include "tools/eval/fast_math.h"
#include "tools/eval/filter_rows.h"
#include "tools/eval/parallel.h"
#include "tools/eval/wide.h"

namespace shale {
namespace {

// Colour spaces.

using Matrix = std::array<std::array<double, 3>, 3>;

/// Linear sRGB to XYZ; its row sums are the white point, D65.
constexpr Matrix kRgbToXyz{{
    {10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794},
    {2613072.0 / 12288897, 8788810.0 / 12288897, 887015.0 / 12288897},
    {1425312.0 / 73733382, 8788810.0 / 73733382, 70074185.0 / 73733382},
}};

/// Linear sRGB to XYZ relative to white.
constexpr Matrix relative_matrix() {
  Matrix result = kRgbToXyz;
  for (auto& row : result) {
    const double white = row[0] + row[1] + row[2];
    for (double& value : row) value /= white;
  }
  return result;
}

constexpr Matrix inverse(const Matrix& m) {
  Matrix result{};
  double determinant = 0;
  for (size_t i = 0; i < 3; ++i)
    for (size_t j = 0; j < 3; ++j) {
      const size_t r0 = (j + 1) % 3, r1 = (j + 2) % 3, c0 = (i + 1) % 3, c1 = (i + 2) % 3;
      result[i][j] = m[r0][c0] * m[r1][c1] - m[r0][c1] * m[r1][c0];
      if (i == 0) determinant += result[i][j] * m[j][0];
    }
  for (auto& row : result)
    for (double& value : row) value /= determinant;
  return result;
}

constexpr Matrix kRelative = relative_matrix();
constexpr Matrix kInverse = inverse(kRelative);

inline float along(const std::array<double, 3>& row, float a, float b, float c) {
  return static_cast<float>(row[0]) * a + static_cast<float>(row[1]) * b +
         static_cast<float>(row[2]) * c;
}

/// The cube root of CIELAB with its straight part near 0. t >= 0.
inline float lab_curve(float t) {
  constexpr float kDelta = 6 / 29.0f, kCube = kDelta * kDelta * kDelta;
  const float root = fast_pow(t > kCube ? t : kCube, 1 / 3.0f);
  const float line = t * (1 / (3 * kDelta * kDelta)) + 4 / 29.0f;
  return t > kCube ? root : line;
}

struct Lab {
  float lightness, a, b;
};

/// XYZ relative to white to CIELAB with a and b scaled by 0.01 L (Hunt).
inline Lab hunt_lab(float x, float y, float z) {
  const float fx = lab_curve(x), fy = lab_curve(y), fz = lab_curve(z);
  const float lightness = 116 * fy - 16;
  return {lightness, 0.01f * lightness * (500 * (fx - fy)), 0.01f * lightness * (200 * (fy - fz))};
}

inline float hyab(const Lab& p, const Lab& q) {
  const float a = p.a - q.a, b = p.b - q.b;
  return std::abs(p.lightness - q.lightness) + std::sqrt(a * a + b * b);
}

constexpr float kColourPower = 0.7f;

/// The distance between green and blue, the largest in sRGB, to the power.
float largest_distance() {
  const auto lab_of = [](size_t channel) {
    return hunt_lab(static_cast<float>(kRelative[0][channel]),
                    static_cast<float>(kRelative[1][channel]),
                    static_cast<float>(kRelative[2][channel]));
  };
  return std::pow(hyab(lab_of(1), lab_of(2)), kColourPower);
}

float linear_of_srgb(float value) {
  return value <= 0.04045f ? value / 12.92f : std::pow((value + 0.055f) / 1.055f, 2.4f);
}

/// sRGB decoding by table for values that are 8-bit codes.
class SrgbDecoder {
 public:
  SrgbDecoder() {
    for (uint32_t code = 0; code < 256; ++code)
      table_[code] = linear_of_srgb(static_cast<float>(code) / 255);
  }
  float operator()(float value) const {
    const float scaled = value * 255;
    const auto code = static_cast<int32_t>(scaled + 0.5f);
    const float off = scaled - static_cast<float>(code);
    if (code >= 0 && code < 256 && off < 1e-4f && off > -1e-4f)
      return table_[static_cast<size_t>(code)];
    return linear_of_srgb(value);
  }

 private:
  std::array<float, 256> table_;
};

// Filters.

/// Weights by distance, normalized by the caller; the tail below 1e-9 of the middle is cut.
HalfFilter half_filter(const std::vector<double>& weights, double scale) {
  HalfFilter filter;
  for (const double weight : weights) filter.weights.push_back(static_cast<float>(weight * scale));
  while (filter.weights.size() > 1 && filter.weights.back() < 1e-9f * filter.weights[0])
    filter.weights.pop_back();
  return filter;
}

/// Sum over both sides.
double full_sum(const std::vector<double>& weights) {
  double sum = weights[0];
  for (size_t k = 1; k < weights.size(); ++k) sum += 2 * weights[k];
  return sum;
}

struct Filters {
  HalfFilter y, cx, cz1, cz2;     ///< contrast sensitivity; cz is the sum of two products
  HalfFilter gauss, edge, point;  ///< features: Gaussian, its first and second derivative
  uint32_t radius = 0;            ///< the largest
};

Filters make_filters(double pixels_per_degree) {
  using std::numbers::pi;
  Filters filters;
  // The radius of the widest Gaussian holds for all.
  const auto radius =
      static_cast<int>(std::ceil(3 * std::sqrt(0.04 / (2 * pi * pi)) * pixels_per_degree));
  const auto gaussian = [&](double amplitude, double b) {
    std::vector<double> weights;
    for (int k = 0; k <= radius; ++k) {
      const double x = k / pixels_per_degree;
      weights.push_back(amplitude * std::exp(-pi * pi * x * x / b));
    }
    return weights;
  };
  const std::vector<double> y = gaussian(1, 0.0047), cx = gaussian(1, 0.0053);
  filters.y = half_filter(y, 1 / full_sum(y));
  filters.cx = half_filter(cx, 1 / full_sum(cx));
  // In 2-D a Gaussian weighs a sqrt(pi / b); each of its two passes has the root of that, and the sum
  // over both Gaussians is normalized.
  const std::vector<double> cz1 = gaussian(std::sqrt(34.1 * std::sqrt(pi / 0.04)), 0.04),
                            cz2 = gaussian(std::sqrt(13.5 * std::sqrt(pi / 0.025)), 0.025);
  const double norm = 1 / std::hypot(full_sum(cz1), full_sum(cz2));
  filters.cz1 = half_filter(cz1, norm);
  filters.cz2 = half_filter(cz2, norm);

  const double sigma = 0.5 * 0.082 * pixels_per_degree;
  std::vector<double> gauss, first, second;
  for (int k = 0; k <= static_cast<int>(std::ceil(3 * sigma)); ++k) {
    const double weight = std::exp(-k * k / (2 * sigma * sigma));
    gauss.push_back(weight);
    first.push_back(k * weight);
    second.push_back((k * k / (sigma * sigma) - 1) * weight);
  }
  // Of the derivatives the positive weights sum to 1 and the negative ones to -1.
  double slope = 0, positive = 0, negative = 0;
  for (size_t k = 0; k < second.size(); ++k) {
    slope += first[k];
    (second[k] > 0 ? positive : negative) += (k == 0 ? 1 : 2) * std::abs(second[k]);
  }
  const double gauss_sum = full_sum(gauss);
  filters.edge.odd = true;
  for (size_t k = 0; k < gauss.size(); ++k) {
    filters.gauss.weights.push_back(static_cast<float>(gauss[k] / gauss_sum));
    filters.edge.weights.push_back(static_cast<float>(first[k] / slope));
    filters.point.weights.push_back(
        static_cast<float>(second[k] / (second[k] > 0 ? positive : negative)));
  }
  for (const HalfFilter* filter : {&filters.y, &filters.cx, &filters.cz1, &filters.cz2,
                                   &filters.gauss, &filters.edge, &filters.point})
    filters.radius = std::max(filters.radius, filter->radius());
  return filters;
}

// Features.

/// One row of the five features, to be written or read.
template <typename Value>
struct FeatureRow {
  Value *lightness, *a, *b, *edge, *point;
};

/// Goes down the rows [begin, end) of a picture.
class FeatureWalk {
 public:
  FeatureWalk(const FloatImage& picture, const Filters& filters, const SrgbDecoder& decode,
              uint32_t begin)
      : picture_(picture),
        filters_(filters),
        decode_(decode),
        next_(begin > filters.radius ? begin - filters.radius : 0),
        ring_(kPlanes, 2 * filters.radius + 1, picture.width),
        padded_(3, std::vector<float>(picture.width + 2 * size_t{filters.radius})),
        rows_(2 * size_t{filters.radius} + 1),
        across_(7, std::vector<float>(picture.width)) {}

  /// Features of row y; y goes up by one from `begin`.
  void row(uint32_t y, const FeatureRow<float>& out) {
    const uint32_t last = picture_.height - 1;
    for (const uint32_t needed = std::min(y + filters_.radius, last); next_ <= needed; ++next_)
      filter_row(next_);
    enum { kFy, kFcx, kFcz1, kFcz2, kDx, kDy, kDdx };
    const auto across = [&](size_t to, Plane plane, const HalfFilter& filter) {
      const int radius = static_cast<int>(filter.radius());
      for (int k = -radius; k <= radius; ++k) {
        const int64_t from = std::clamp<int64_t>(int64_t{y} + k, 0, last);
        rows_[static_cast<size_t>(k + radius)] = ring_.row(plane, static_cast<uint32_t>(from));
      }
      filter_across(rows_.data(), picture_.width, filter, across_[to].data());
    };
    across(kFy, kY, filters_.y);
    across(kFcx, kCx, filters_.cx);
    across(kFcz1, kCz1, filters_.cz1);
    across(kFcz2, kCz2, filters_.cz2);
    colours(across_[kFy].data(), across_[kFcx].data(), across_[kFcz1].data(), across_[kFcz2].data(),
            picture_.width, out);
    across(kDx, kEdge, filters_.gauss);
    across(kDy, kGauss, filters_.edge);
    magnitudes(across_[kDx].data(), across_[kDy].data(), picture_.width, out.edge);
    across(kDdx, kPoint, filters_.gauss);
    across(kDy, kGauss, filters_.point);
    magnitudes(across_[kDdx].data(), across_[kDy].data(), picture_.width, out.point);
  }

 private:
  enum Plane : uint32_t { kY, kCx, kCz1, kCz2, kGauss, kEdge, kPoint, kPlanes };

  /// Decodes row y and filters it along x.
  void filter_row(uint32_t y) {
    const uint32_t width = picture_.width, radius = filters_.radius;
    const float* const rgb = picture_.at(0, y);
    float *const py = &padded_[0][radius], *const pcx = &padded_[1][radius],
                 *const pcz = &padded_[2][radius];
    for (uint32_t x = 0; x < width; ++x) {
      const float r = decode_(rgb[3 * x]), g = decode_(rgb[3 * x + 1]), b = decode_(rgb[3 * x + 2]);
      py[x] = along(kRelative[1], r, g, b);
      pcx[x] = along(kRelative[0], r, g, b) - py[x];
      pcz[x] = py[x] - along(kRelative[2], r, g, b);
    }
    for (std::vector<float>& plane : padded_) {
      std::fill_n(plane.begin(), radius, plane[radius]);
      std::fill_n(plane.begin() + radius + width, radius, plane[radius + width - 1]);
    }
    filter_along(py, width, filters_.y, ring_.row(kY, y));
    filter_along(pcx, width, filters_.cx, ring_.row(kCx, y));
    filter_along(pcz, width, filters_.cz1, ring_.row(kCz1, y));
    filter_along(pcz, width, filters_.cz2, ring_.row(kCz2, y));
    filter_along(py, width, filters_.gauss, ring_.row(kGauss, y));
    filter_along(py, width, filters_.edge, ring_.row(kEdge, y));
    filter_along(py, width, filters_.point, ring_.row(kPoint, y));
  }

  /// Opponent colours, filtered, to what the screen can show and on to CIELAB.
  SHALE_WIDE static void colours(const float* __restrict y, const float* __restrict cx,
                                 const float* __restrict cz1, const float* __restrict cz2,
                                 uint32_t width, const FeatureRow<float>& out) {
    float* const __restrict lightness = out.lightness, * const __restrict a = out.a, * const __restrict b = out.b;
    for (uint32_t i = 0; i < width; ++i) {
      const float px = y[i] + cx[i], py = y[i], pz = y[i] - (cz1[i] + cz2[i]);
      const auto shown = [](float value) {
        value = value > 0 ? value : 0;
        return value < 1 ? value : 1;
      };
      const float red = shown(along(kInverse[0], px, py, pz)),
                  green = shown(along(kInverse[1], px, py, pz)),
                  blue = shown(along(kInverse[2], px, py, pz));
      const Lab lab =
          hunt_lab(along(kRelative[0], red, green, blue), along(kRelative[1], red, green, blue),
                   along(kRelative[2], red, green, blue));
      lightness[i] = lab.lightness;
      a[i] = lab.a;
      b[i] = lab.b;
    }
  }

  SHALE_WIDE static void magnitudes(const float* __restrict x, const float* __restrict y,
                                    uint32_t width, float* __restrict out) {
    for (uint32_t i = 0; i < width; ++i) out[i] = std::sqrt(x[i] * x[i] + y[i] * y[i]);
  }

  const FloatImage& picture_;
  const Filters& filters_;
  const SrgbDecoder& decode_;
  uint32_t next_;  ///< first row that is not in the ring yet
  RowRing ring_;
  std::vector<std::vector<float>> padded_;
  std::vector<const float*> rows_;
  std::vector<std::vector<float>> across_;
};

/// One row of the map; returns its sum.
SHALE_WIDE double difference_row(const FeatureRow<float>& p, const FeatureRow<const float>& q,
                                 uint32_t width, float largest, float* __restrict out) {
  constexpr float kKnee = 0.4f, kKneeValue = 0.95f;
  const float knee = kKnee * largest;
  for (uint32_t i = 0; i < width; ++i) {
    const float distance = hyab({p.lightness[i], p.a[i], p.b[i]}, {q.lightness[i], q.a[i], q.b[i]});
    constexpr float kTiny = 1e-20f;  // where the power is taken to be 0
    const float power = fast_pow(distance > kTiny ? distance : kTiny, kColourPower);
    const float below = power * (kKneeValue / knee);
    const float above = kKneeValue + (power - knee) * ((1 - kKneeValue) / (largest - knee));
    const float colour = power < knee ? below : above;
    const float edge = std::abs(p.edge[i] - q.edge[i]), point = std::abs(p.point[i] - q.point[i]);
    const float feature =
        std::sqrt((edge > point ? edge : point) * (1 / std::numbers::sqrt2_v<float>));
    const float difference = fast_pow(colour, 1 - feature);
    out[i] = distance > kTiny ? (difference < 1 ? difference : 1) : 0;
  }
  double sum = 0;
  for (uint32_t i = 0; i < width; ++i) sum += out[i];
  return sum;
}

}  // namespace

FlipFeatures flip_features(const FloatImage& picture, double pixels_per_degree, uint32_t threads) {
  const size_t pixels = size_t{picture.width} * picture.height;
  FlipFeatures features{std::vector<float>(pixels), std::vector<float>(pixels),
                        std::vector<float>(pixels), std::vector<float>(pixels),
                        std::vector<float>(pixels)};
  const Filters filters = make_filters(pixels_per_degree);
  const SrgbDecoder decode;
  parallel_rows(picture.height, threads, [&](uint32_t begin, uint32_t end) {
    FeatureWalk walk(picture, filters, decode, begin);
    for (uint32_t y = begin; y < end; ++y) {
      const size_t at = size_t{y} * picture.width;
      walk.row(y, {&features.lightness[at], &features.a[at], &features.b[at], &features.edge[at],
                   &features.point[at]});
    }
  });
  return features;
}

double flip_difference(const FlipFeatures& reference, const FloatImage& test,
                       double pixels_per_degree, uint32_t threads, FloatImage* map) {
  const Filters filters = make_filters(pixels_per_degree);
  const SrgbDecoder decode;
  const float largest = largest_distance();
  const uint32_t width = test.width;
  if (map) *map = {width, test.height, 1, std::vector<float>(size_t{width} * test.height)};
  std::vector<double> sums(test.height);
  parallel_rows(test.height, threads, [&](uint32_t begin, uint32_t end) {
    FeatureWalk walk(test, filters, decode, begin);
    std::vector<float> features(5 * size_t{width}), row(width);
    float* const at = features.data();
    const FeatureRow<float> mine{at, at + width, at + 2 * size_t{width}, at + 3 * size_t{width},
                                 at + 4 * size_t{width}};
    for (uint32_t y = begin; y < end; ++y) {
      walk.row(y, mine);
      const size_t first = size_t{y} * width;
      sums[y] =
          difference_row(mine,
                         {&reference.lightness[first], &reference.a[first], &reference.b[first],
                          &reference.edge[first], &reference.point[first]},
                         width, largest, map ? map->at(0, y) : row.data());
    }
  });
  double sum = 0;
  for (const double value : sums) sum += value;
  return sum / (static_cast<double>(width) * test.height);
}

}  // namespace shale
