#include "tools/reference/nss_v1.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <set>
#include <tuple>

#include "ir/base/float_format.h"
#include "ir/base/half.h"
#include "runtime/frame/camera.h"

namespace shale::nss_v1 {
namespace {

constexpr double kMaxColor = 65504;
constexpr double kNoOvershoot = 0.875;  // of shaders/include/color.glsl
/// Scattered depths are whole numbers of this, up to 1.
constexpr double kDepthSteps = 0x1p31;

using Color = std::array<double, 3>;

struct Texel {
  int x = 0, y = 0;
};
/// In uv of a picture, or a way in uv.
struct Place {
  double x = 0, y = 0;
  bool operator==(const Place&) const = default;
  Place operator-(const Place& b) const { return {x - b.x, y - b.y}; }
};

int width(const Extent& e) { return static_cast<int>(e.width); }
int height(const Extent& e) { return static_cast<int>(e.height); }

double mix(double a, double b, double part) { return a + (b - a) * part; }
double largest(const Color& c) { return std::max({c[0], c[1], c[2]}); }
Color color_at(const Grid& grid, Texel t) {
  const double* c = grid.at(t.x, t.y);
  return {c[0], c[1], c[2]};
}

// ---- what is stored

double as_half(double v) {
  const FloatFormat half = float_format(DType::kFp16);
  return decode_float(half, encode_float(half, v));
}
/// In steps of 1 / `steps`.
double stepped(double v, double steps) { return std::floor(v * steps + 0.5) / steps; }

// ---- what the host gives

Color finite_color(const Color& c) {
  Color result;
  for (size_t i = 0; i < 3; ++i) result[i] = c[i] > 0 ? std::min(c[i], kMaxColor) : 0;  // NaN: 0
  return result;
}

/// NaN counts as the farthest.
double finite_depth(double depth, bool reverse) {
  if (std::isnan(depth)) return reverse ? 0 : 1;
  return std::clamp(depth, 0.0, 1.0);
}
bool closer(double a, double b, bool reverse) { return reverse ? a > b : a < b; }

Place finite_motion(const double* m) {
  const auto finite = [](double v) { return std::isnan(v) ? 0.0 : std::clamp(v, -1.0, 1.0); };
  return {finite(m[0]), finite(m[1])};
}
/// None if it is at most a tenth of a pixel of a picture of this size.
Place long_motion(const double* motion, const Extent& size) {
  const Place m = finite_motion(motion);
  return std::hypot(m.x * size.width, m.y * size.height) <= 0.1 ? Place{} : m;
}

/// The images as they are uploaded: halves, but for depth.
struct Images {
  Grid color, depth, motion;
  double jitter_x = 0, jitter_y = 0, exposure = 1;
  bool reverse = false;
  std::array<double, 4> view{};  ///< depth_to_view

  explicit Images(const SourceFrame& frame)
      : color(grid_of(frame.color, 3)),
        depth(grid_of(frame.depth, 1)),
        motion(grid_of(frame.motion, 2)) {
    const FrameCamera& camera = frame.camera;
    for (Grid* grid : {&color, &motion})
      for (double& v : grid->values)
        v = static_cast<double>(half_to_float(float_to_half(static_cast<float>(v))));
    for (double& d : depth.values) d = finite_depth(d, camera.reverse_depth);
    jitter_x = std::clamp(static_cast<double>(camera.jitter[0]), -0.5, 0.5);
    jitter_y = std::clamp(static_cast<double>(camera.jitter[1]), -0.5, 0.5);
    exposure = static_cast<double>(camera.exposure);
    reverse = camera.reverse_depth;
    const std::array<float, 4> d = depth_to_view({.near_plane = camera.near_plane,
                                                  .far_plane = camera.far_plane,
                                                  .fov_x = camera.fov_x,
                                                  .fov_y = camera.fov_y,
                                                  .reverse = camera.reverse_depth});
    std::copy(d.begin(), d.end(), view.begin());
  }

  /// Distance along the view axis, metres.
  double view_z(double depth_value) const {
    const double z = view[1] / (depth_value - view[0]);
    return std::isnan(z) ? 1e8 : std::clamp(z, 0.0, 1e8);
  }
  Color exposed(Texel t) const {
    Color c = finite_color(color_at(color, t));
    for (double& v : c) v = std::min(v * exposure, kMaxColor);
    return c;
  }
  /// Exposed and in the Karis domain.
  Color karis_of(const Color& c) const {
    const double e = std::min(exposure, 1e30), factor = e / (1 + e * largest(c));
    return {c[0] * factor, c[1] * factor, c[2] * factor};
  }
};

Color karis(const Color& c) {
  const double factor = 1 / (1 + largest(c));
  return {c[0] * factor, c[1] * factor, c[2] * factor};
}
Color karis_inverse(const Color& c) {
  const double factor = 1 / (1 - std::min(largest(c), 1 - 1e-7));
  Color result;
  for (size_t i = 0; i < 3; ++i) result[i] = std::min(c[i] * factor, kMaxColor);
  return result;
}

// ---- filters

/// The four texels around a place and their weights.
struct Bilinear {
  Texel base;
  double x = 0, y = 0;  ///< parts of the way to the next texel

  Texel texel(int i) const { return {base.x + i % 2, base.y + i / 2}; }
  double weight(int i) const { return (i % 2 ? x : 1 - x) * (i / 2 ? y : 1 - y); }
};

/// rests: what stands still is read where it lies, in steps of 1/128 texel.
Bilinear bilinear_at(Place uv, const Extent& size, bool rests) {
  double x = uv.x * size.width - 0.5, y = uv.y * size.height - 0.5;
  if (rests) {
    x = stepped(x, 128);
    y = stepped(y, 128);
  }
  return {{static_cast<int>(std::floor(x)), static_cast<int>(std::floor(y))},
          x - std::floor(x),
          y - std::floor(y)};
}

/// Of something of a texel.
template <typename Value>
Color weighed(const Bilinear& b, const Value& value) {
  Color sum{};
  for (int i = 0; i < 4; ++i) {
    const Color c = value(b.texel(i));
    for (size_t k = 0; k < 3; ++k) sum[k] += b.weight(i) * c[k];
  }
  return sum;
}

/// Keys' weights of the texels at -1, 0, 1, 2.
std::array<double, 4> catmull_rom(double f) {
  const double f2 = f * f, f3 = f2 * f;
  return {f2 - 0.5 * (f3 + f), 1.5 * f3 - 2.5 * f2 + 1, 2 * f2 - 1.5 * f3 + 0.5 * f,
          0.5 * (f3 - f2)};
}

/// Five taps instead of sixteen texels: the two middle weights of an axis are one tap between both, the corners are left out.
/// Where a channel leaves [0, kNoOvershoot], all are clamped to the taps. In 0..1.
template <typename Value>
Color catmull_rom_at(const Bilinear& b, const Value& value) {
  const std::array<double, 4> wx = catmull_rom(b.x), wy = catmull_rom(b.y);
  const double in_x = wx[1] + wx[2], in_y = wy[1] + wy[2];
  const double mid_x = wx[2] / in_x, mid_y = wy[2] / in_y;
  const auto tap = [&](int x, int y, double part_x, double part_y) {
    return weighed(Bilinear{{b.base.x + x, b.base.y + y}, part_x, part_y}, value);
  };
  const std::array<Color, 5> taps{tap(0, 0, mid_x, mid_y), tap(-1, 0, 0, mid_y),
                                  tap(2, 0, 0, mid_y), tap(0, -1, mid_x, 0), tap(0, 2, mid_x, 0)};
  const std::array<double, 5> weights{in_x * in_y, wx[0] * in_y, wx[3] * in_y, in_x * wy[0],
                                      in_x * wy[3]};
  double total = 0;
  for (const double w : weights) total += w;
  Color sum{};
  bool beyond = false;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < 5; ++i) sum[c] += weights[i] / total * taps[i][c];
    beyond = beyond || sum[c] < 0 || sum[c] > kNoOvershoot;
  }
  for (size_t c = 0; c < 3; ++c) {
    const auto [low, high] =
        std::minmax({taps[0][c], taps[1][c], taps[2][c], taps[3][c], taps[4][c]});
    sum[c] = std::clamp(beyond ? std::clamp(sum[c], low, high) : sum[c], 0.0, 1.0);
  }
  return sum;
}

// ---- depth

/// The closest and farthest depth of a block, and where the closest is, the first in rows.
struct Block {
  double closest, farthest;
  Texel from;
};
Block block_at(const Form& form, const Images& images, Texel block) {
  const Texel first{block.x * form.block, block.y * form.block};
  const double d = *images.depth.at(first.x, first.y);
  Block result{d, d, first};
  for (int y = first.y; y < std::min(first.y + form.block, height(form.render)); ++y)
    for (int x = first.x; x < std::min(first.x + form.block, width(form.render)); ++x) {
      const double depth = *images.depth.at(x, y);
      if (closer(depth, result.closest, images.reverse)) {
        result.closest = depth;
        result.from = {x, y};
      }
      if (closer(result.farthest, depth, images.reverse)) result.farthest = depth;
    }
  return result;
}

/// The texel of the closest depth in a window of -1 to 2 on both axes: the middle wins a tie, then the first in rows.
Texel closest_around(const Form& form, const Images& images, Texel middle) {
  Texel best = middle;
  for (int y = middle.y - 1; y <= middle.y + 2; ++y)
    for (int x = middle.x - 1; x <= middle.x + 2; ++x)
      if (closer(*images.depth.at(x, y), *images.depth.at(best.x, best.y), images.reverse))
        best = {std::clamp(x, 0, width(form.render) - 1),
                std::clamp(y, 0, height(form.render) - 1)};
  return best;
}

/// 1 where what is seen at view distance z was hidden a frame ago, around b in the scattered depth.
double disoccluded(const Form& form, const Images& images, const Grid& scattered, const Bilinear& b,
                   double z, double tolerance) {
  const double diagonal = std::hypot(form.render.width, form.render.height);
  const double power = mix(1, 3, std::min(diagonal / std::hypot(1920, 1080), 1.0));
  const double separation =
      1.37e-5 * std::sqrt(images.view[2] * images.view[2] + images.view[3] * images.view[3] + 1);
  double kept = 0, total = 0;
  for (int i = 0; i < 4; ++i) {
    const Texel t = b.texel(i);
    const double weight = b.weight(i);
    if (t.x < 0 || t.y < 0 || t.x >= scattered.width || t.y >= scattered.height) {
      total += weight;
      continue;
    }
    const double before = images.view_z(*scattered.at(t.x, t.y));
    if (weight <= 0.1 || z <= before) continue;
    const double needed = separation * diagonal * std::max(z, before) + tolerance;
    kept += weight * std::pow(std::clamp(needed / (z - before), 0.0, 1.0), power);
    total += weight;
  }
  return total > 0 ? std::clamp(1 - kept / total, 0.0, 1.0) : 0;
}

Extent size_of(const Grid& grid) {
  return {static_cast<uint32_t>(grid.width), static_cast<uint32_t>(grid.height)};
}
Place middle_of(Texel t, const Extent& size) {
  return {(t.x + 0.5) / size.width, (t.y + 0.5) / size.height};
}

// ---- instability, nss.md section 2.5

/// (Y, Co, Cg) of the square root.
Color work_color(const Color& exposed) {
  const double r = std::sqrt(exposed[0]), g = std::sqrt(exposed[1]), b = std::sqrt(exposed[2]);
  const double co = r - b, t = b + 0.5 * co, cg = g - t;
  return {t + 0.5 * cg, co, cg};
}
double color_distance(const Color& a, const Color& b) {
  return std::hypot(a[0] - b[0], 1.25 * (a[1] - b[1]), 1.25 * (a[2] - b[2]));
}
double ramp(double x, double low, double high) {
  return std::clamp((x - low) / (high - low), 0.0, 1.0);
}

struct Instability {
  double visible;
  std::array<double, 4> next;
};
/// around: distances to the four neighbours.
Instability instability(const Color& now, const std::array<double, 4>& around,
                        const std::array<double, 4>& state, bool hidden) {
  const Color before{(state[0] + 1) * 4, state[1] * 8, state[2] * 8};
  const double p = (state[3] + 1) * 0.5;
  const double sum = around[0] + around[1] + around[2] + around[3];
  const double support = (sum - std::ranges::max(around)) / 3;
  const double s = 0.75 * mix(color_distance(now, before), support, 0.3);
  const double recall = ramp(s, 0.065, 0.42), mean = ramp(s, 0.07, 0.23);
  const double entry =
      std::sqrt(recall) * std::sqrt(ramp(std::max(s - p, 0.0), 0.025, 0.16)) * mean;
  const double heat = ramp(p, 0.11, 0.21);
  const double spread = ramp(mix(p, s, 0.3), mix(0.177, 0.157, heat), mix(0.33, 0.305, heat));
  const double held = ramp(p, 0.18, 0.28);
  const double raw = std::max(entry, 0.8 * p * std::max(spread * spread, 0.12 * held * held));
  const double decay = std::max(spread * spread, 0.5 * heat * heat);
  const double rate = raw > p ? mix(0.08, 0.22, std::sqrt(recall * mean)) : mix(0.24, 0.05, decay);
  double value = mix(p, raw, rate), visible = mix(p, value, value > p ? 0.75 : 0.8);
  const bool fresh =
      std::abs(state[0]) + std::abs(state[1]) + std::abs(state[2]) + std::abs(state[3]) < 1e-4;
  if (hidden || fresh) value = visible = 0;
  return {visible, {now[0] / 4 - 1, now[1] / 8, now[2] / 8, 2 * value - 1}};
}

// ---- the network's codes

double real_of(const Tensor& codes, const Quantization& q, int x, int y, int channel) {
  const int64_t h = codes.type.shape[1], w = codes.type.shape[2], c = codes.type.shape[3];
  const int64_t at = std::clamp<int64_t>(y, 0, h - 1) * w + std::clamp<int64_t>(x, 0, w - 1);
  return static_cast<double>(q.scale) *
         static_cast<double>(codes.data<int8_t>()[at * c + channel] - q.zero_point);
}
int64_t code_of(double value, const Quantization& q) {
  const double code = std::floor(value / static_cast<double>(q.scale) + 0.5) + q.zero_point;
  return static_cast<int64_t>(std::clamp(code, -128.0, 127.0));
}

/// Texel of a picture that a texel of its padded form shows: mirrored, as often as needed.
int mirrored(int at, int size) {
  const int turn = at % (2 * size);
  return std::min(turn, 2 * size - 1 - turn);
}

// ---- kernel, nss.md section 3.2

/// The render texels whose samples lie in the cells at -(kernel / 2 - 1) to kernel / 2 around output pixel `at`, by cell
/// offset; along one axis. Sample l lies in cell floor((l + 0.5 + jitter) * size / render), computed in whole numbers.
std::vector<std::pair<int, int>> cells_around(int at, double jitter, int64_t render, int64_t size,
                                              int kernel) {
  const auto j = static_cast<int64_t>(std::floor(jitter * 65536 + 0.5));
  std::vector<std::pair<int, int>> cells;
  const int64_t middle = at * render / size, reach = kernel + 2;
  for (int64_t l = middle - reach; l <= middle + reach; ++l) {
    const int64_t scaled = ((2 * l + 1) * 32768 + j) * size, unit = render * 65536;
    const int64_t cell = (scaled >= 0 ? scaled : scaled - unit + 1) / unit;
    const auto offset = static_cast<int>(cell - at);
    if (offset > -kernel / 2 && offset <= kernel / 2)
      cells.emplace_back(offset, static_cast<int>(l));
  }
  return cells;
}

int closest_texel(int at, double jitter, uint32_t render, uint32_t size) {
  return static_cast<int>(std::floor((at + 0.5) * render / size - jitter));
}

struct Sample {
  int dx, dy;   ///< cell, from the pixel's own
  Texel texel;  ///< not clamped
};
/// The closest `taps` samples in the kernel, then in rows.
std::vector<Sample> samples_around(const Form& form, const Images& images, Texel pixel) {
  const auto columns =
      cells_around(pixel.x, images.jitter_x, width(form.render), width(form.output), form.kernel);
  const auto rows =
      cells_around(pixel.y, images.jitter_y, height(form.render), height(form.output), form.kernel);
  std::vector<Sample> samples;
  for (const auto& row : rows)
    for (const auto& column : columns)
      samples.push_back({column.first, row.first, {column.second, row.second}});
  std::ranges::sort(samples, {}, [](const Sample& s) {
    return std::tuple(s.dx * s.dx + s.dy * s.dy, s.dy, s.dx);
  });
  if (samples.size() > static_cast<size_t>(form.taps))
    samples.resize(static_cast<size_t>(form.taps));
  return samples;
}

}  // namespace

Grid Grid::zeros(int width, int height, int channels) {
  const size_t count =
      static_cast<size_t>(width) * static_cast<size_t>(height) * static_cast<size_t>(channels);
  return {width, height, channels, std::vector<double>(count)};
}
double* Grid::at(int x, int y) { return &values[static_cast<size_t>((y * width + x) * channels)]; }
const double* Grid::at(int x, int y) const {
  x = std::clamp(x, 0, width - 1);
  y = std::clamp(y, 0, height - 1);
  return &values[static_cast<size_t>((y * width + x) * channels)];
}

Grid grid_of(const FloatImage& image, int channels) {
  Grid grid = Grid::zeros(static_cast<int>(image.width), static_cast<int>(image.height), channels);
  for (uint32_t y = 0; y < image.height; ++y)
    for (uint32_t x = 0; x < image.width; ++x)
      std::copy_n(image.at(x, y), channels, grid.at(static_cast<int>(x), static_cast<int>(y)));
  return grid;
}
FloatImage picture_of(const Grid& grid) {
  FloatImage image{static_cast<uint32_t>(grid.width),
                   static_cast<uint32_t>(grid.height),
                   static_cast<uint32_t>(grid.channels),
                   {}};
  for (const double v : grid.values) image.values.push_back(static_cast<float>(v));
  return image;
}

Result<Form> form_of(const Frame& frame, const Variant& variant) {
  const auto none = [](const std::string& why) {
    return unsupported("", "no reference: only the passes of NSS v1 are modelled, and {}", why);
  };
  if (frame.programs.size() != 1) return none("this sandwich has several programs");
  Form form;
  std::set<std::string> shaders;
  for (const FramePass& pass : frame.programs[0].passes) {
    if (pass.shader.empty()) continue;
    const std::filesystem::path path(pass.shader);
    shaders.insert(path.parent_path().filename().string() + "/" + path.filename().string());
    for (const auto& [name, text] : pass.defines) {
      const double value = std::strtod(text.c_str(), nullptr);
      const auto whole = static_cast<int>(value);
      if (name == "SIDE") form.side = whole;
      if (name == "BLOCK") form.block = whole;
      if (name == "KERNEL") form.kernel = whole;
      if (name == "TAPS") form.taps = whole;
      if (name == "KPN_SHIFT") form.kpn_shift = whole;
      if (name == "CATMULL_ROM") form.catmull_rom = whole != 0;
      if (name == "WEIGHT_FLOOR") form.weight_floor = value;
    }
  }
  std::set<std::string> expected{"nss/scatter.comp", "nss/pre_v1.comp", "nss/post_v1.comp"};
  if (form.side == 2) expected.insert("nss/disocclusion.comp");
  for (const std::string& shader : shaders)
    if (!expected.contains(shader)) return none("this sandwich has " + shader);
  for (const std::string& shader : expected)
    if (!shaders.contains(shader)) return none("this sandwich has no " + shader);
  for (const Resource& resource : variant.resources) {
    const Extent size{resource.width, resource.height};
    if (resource.name == "color") form.render = size;
    if (resource.name == "output") form.output = size;
    Quantization* quantization = resource.name == "input"      ? &form.input
                                 : resource.name == "temporal" ? &form.temporal
                                 : resource.name == "kernel"   ? &form.weights
                                                               : nullptr;
    if (quantization == nullptr) continue;
    if (resource.dtype != DType::kInt8 || !resource.quantization)
      return none("the network's \"" + resource.name + "\" is not of int8 codes here");
    *quantization = *resource.quantization;
    if (resource.name == "input")
      form.padded = {static_cast<uint32_t>(resource.shape[2]),
                     static_cast<uint32_t>(resource.shape[1])};
  }
  const auto side = static_cast<uint32_t>(form.side);
  form.network = {(form.render.width + side - 1) / side, (form.render.height + side - 1) / side};
  return form;
}

Grid scatter(const Form& form, const SourceFrame& frame, Rounding rounding) {
  const Images images(frame);
  const int w = (width(form.render) + form.block - 1) / form.block,
            h = (height(form.render) + form.block - 1) / form.block;
  Grid result = Grid::zeros(w, h, 1);
  std::fill(result.values.begin(), result.values.end(), images.reverse ? 0 : 1);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const Block block = block_at(form, images, {x, y});
      const Place moved = long_motion(images.motion.at(block.from.x, block.from.y), form.render);
      const double depth = rounding == Rounding::kNone
                               ? block.closest
                               : std::floor(block.closest * kDepthSteps) / kDepthSteps;
      const Bilinear b =
          bilinear_at(middle_of({x, y}, size_of(result)) - moved, size_of(result), false);
      for (int i = 0; i < 4; ++i) {
        const Texel to = b.texel(i);
        if (b.weight(i) <= 0.1 || to.x < 0 || to.y < 0 || to.x >= w || to.y >= h) continue;
        double& there = *result.at(to.x, to.y);
        if (closer(depth, there, images.reverse)) there = depth;
      }
    }
  return result;
}

Grid disocclusion(const Form& form, const SourceFrame& frame, const Grid& scattered,
                  Rounding rounding) {
  const Images images(frame);
  Grid result = Grid::zeros(scattered.width, scattered.height, 1);
  for (int y = 0; y < result.height; ++y)
    for (int x = 0; x < result.width; ++x) {
      const Block block = block_at(form, images, {x, y});
      const Place moved = long_motion(images.motion.at(block.from.x, block.from.y), form.render);
      const Bilinear b = bilinear_at(middle_of({x, y}, size_of(result)) - moved, size_of(result),
                                     moved == Place{});
      const double z = images.view_z(block.closest);
      const double value =
          disoccluded(form, images, scattered, b, z, images.view_z(block.farthest) - z);
      *result.at(x, y) = rounding == Rounding::kNone ? value : stepped(value, 255);
    }
  return result;
}

Pre pre(const Form& form, const SourceFrame& frame, const Grid& scattered, const Grid& disoccluded_,
        const Past& past, Rounding rounding) {
  const Images images(frame);
  const bool reset = past.history.empty();
  const bool is_double =
      form.output.width == 2 * form.render.width && form.output.height == 2 * form.render.height;
  const int w = width(form.network), h = height(form.network);
  Grid channels = Grid::zeros(w, h, 12), states = Grid::zeros(w, h, 4);
  Pre result;
  result.dilated = Grid::zeros(width(form.render), height(form.render), 2);
  for (int y = 0; y < result.dilated.height; ++y)
    for (int x = 0; x < result.dilated.width; ++x) {
      const Texel from = closest_around(form, images, {x, y});
      std::copy_n(std::as_const(images.motion).at(from.x, from.y), 2, result.dilated.at(x, y));
    }
  // Current colour without jitter, exposed.
  const auto current = [&](Texel t) {
    t = {std::clamp(t.x, 0, w - 1), std::clamp(t.y, 0, h - 1)};
    const Place jitter{images.jitter_x / form.render.width, images.jitter_y / form.render.height};
    return weighed(bilinear_at(middle_of(t, form.network) - jitter, form.render, false),
                   [&](Texel at) { return images.exposed(at); });
  };
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const Place uv = middle_of({x, y}, form.network);
      // Each render texel of the network's is reprojected for itself; the closest of them leads the rest.
      Color warped{};
      Place moved;
      double nearest = 0;
      for (int lane = 0; lane < form.side * form.side; ++lane) {
        const Texel at{std::min(form.side * x + lane % form.side, width(form.render) - 1),
                       std::min(form.side * y + lane / form.side, height(form.render) - 1)};
        const Place lane_moved = long_motion(result.dilated.at(at.x, at.y), form.render);
        const Texel from = closest_around(form, images, at);
        const double depth = *images.depth.at(from.x, from.y);
        if (lane == 0 || closer(depth, nearest, images.reverse)) {
          nearest = depth;
          moved = lane_moved;
        }
        if (reset) continue;
        const Bilinear b = bilinear_at(middle_of(at, form.render) - lane_moved, form.output,
                                       lane_moved == Place{} && is_double);
        const Color c =
            images.karis_of(weighed(b, [&](Texel t) { return color_at(past.history, t); }));
        for (size_t k = 0; k < 3; ++k) warped[k] += c[k] / (form.side * form.side);
      }
      const bool rests = moved == Place{};
      const bool hidden =
          form.side == 1 ? disoccluded(form, images, scattered,
                                       bilinear_at(uv - moved, size_of(scattered), rests),
                                       images.view_z(nearest), 0) > 0.01
                         : weighed(bilinear_at(uv, size_of(disoccluded_), false), [&](Texel t) {
                             return Color{*std::as_const(disoccluded_).at(t.x, t.y), 0, 0};
                           })[0] > 0.01;
      // Feedback and state: texels of the padded picture around the place.
      std::array<double, 4> fed{}, state{};
      const Bilinear b = bilinear_at(uv - moved, form.network, rests);
      for (int i = 0; i < 4 && !reset; ++i) {
        const Texel t = b.texel(i);
        for (int c = 0; c < 4; ++c) {
          const auto k = static_cast<size_t>(c);
          if (!hidden) fed[k] += b.weight(i) * real_of(past.temporal, form.temporal, t.x, t.y, c);
          state[k] += b.weight(i) * past.state.at(t.x, t.y)[c];
        }
      }
      const Color now = current({x, y}), work = work_color(now), shown = karis(now);
      const auto to = [&](int dx, int dy) {
        return color_distance(work, work_color(current({x + dx, y + dy})));
      };
      const Instability flicker =
          instability(work, {to(0, -1), to(0, 1), to(1, 0), to(-1, 0)}, state, hidden);
      const double unit = std::hypot(1.0 / form.render.width, 1.0 / form.render.height);
      const double length = std::clamp(std::hypot(moved.x, moved.y), unit, 200 * unit);
      const std::array<double, 12> all{warped[0],
                                       warped[1],
                                       warped[2],
                                       shown[0],
                                       shown[1],
                                       shown[2],
                                       std::sqrt((length - unit) / (199 * unit)),
                                       fed[0],
                                       fed[1],
                                       fed[2],
                                       fed[3],
                                       flicker.visible};
      std::copy(all.begin(), all.end(), channels.at(x, y));
      for (size_t c = 0; c < 4; ++c) {
        const double value = std::clamp(flicker.next[c], -1.0, 1.0);
        states.at(x, y)[c] = rounding == Rounding::kNone ? value : stepped(value, 127);
      }
    }
  // The padding shows the picture mirrored.
  result.state = Grid::zeros(width(form.padded), height(form.padded), 4);
  result.input = Tensor::zeros({DType::kInt8, {1, form.padded.height, form.padded.width, 12}});
  int64_t index = 0;
  for (int y = 0; y < height(form.padded); ++y)
    for (int x = 0; x < width(form.padded); ++x) {
      const Texel from{mirrored(x, w), mirrored(y, h)};
      std::copy_n(states.at(from.x, from.y), 4, result.state.at(x, y));
      for (int c = 0; c < 12; ++c)
        result.input.set(index++, code_of(channels.at(from.x, from.y)[c], form.input));
    }
  return result;
}

Grid post(const Form& form, const SourceFrame& frame, const Grid& dilated, const Past& past,
          const Tensor& temporal, const Tensor& kernel, Rounding rounding) {
  const Images images(frame);
  const bool reset = past.history.empty();
  const int cells_x = static_cast<int>(kernel.type.shape[2]),
            cells_y = static_cast<int>(kernel.type.shape[1]);
  const int first = 1 - form.kernel / 2;
  const auto sample_of = [&](Texel t) {
    return images.karis_of(finite_color(color_at(images.color, t)));
  };
  const auto past_texel = [&](Texel t) { return images.karis_of(color_at(past.history, t)); };
  Grid result = Grid::zeros(width(form.output), height(form.output), 3);
  for (int y = 0; y < result.height; ++y)
    for (int x = 0; x < result.width; ++x) {
      const Place uv = middle_of({x, y}, form.output);
      // Samples of this frame around the pixel, weighed as the network says.
      double weights = 0;
      Color mean{}, squares{};
      std::optional<Color> centre;
      for (const Sample& sample : samples_around(form, images, {x, y})) {
        const Texel at{std::clamp(sample.texel.x, 0, width(form.render) - 1),
                       std::clamp(sample.texel.y, 0, height(form.render) - 1)};
        const double weight =
            std::max(real_of(kernel, form.weights, std::min(at.x >> form.kpn_shift, cells_x - 1),
                             std::min(at.y >> form.kpn_shift, cells_y - 1),
                             (sample.dy - first) + form.kernel * (sample.dx - first)),
                     form.weight_floor);
        const Color c = sample_of(at);
        weights += weight;
        for (size_t k = 0; k < 3; ++k) {
          mean[k] += weight * c[k];
          squares[k] += weight * c[k] * c[k];
        }
        if (sample.dx == 0 && sample.dy == 0) centre = c;
      }
      if (weights == 0) {
        mean =
            sample_of({closest_texel(x, images.jitter_x, form.render.width, form.output.width),
                       closest_texel(y, images.jitter_y, form.render.height, form.output.height)});
        for (size_t k = 0; k < 3; ++k) squares[k] = mean[k] * mean[k];
        weights = 1;
      }
      for (size_t k = 0; k < 3; ++k) {
        mean[k] /= weights;
        squares[k] /= weights;
      }
      Color mixed = mean;
      if (!reset) {
        // The history where the pixel was, clamped to mean and deviation as the network says.
        const Texel texel{(2 * x + 1) * width(form.render) / (2 * width(form.output)),
                          (2 * y + 1) * height(form.render) / (2 * height(form.output))};
        const Place moved = long_motion(dilated.at(texel.x, texel.y), form.output);
        const Place before = uv - moved;
        const Bilinear b = bilinear_at(before, form.output, moved == Place{});
        const Color history =
            form.catmull_rom ? catmull_rom_at(b, past_texel) : weighed(b, past_texel);
        const Bilinear p = bilinear_at(uv, form.network, false);
        std::array<double, 3> parameter{};
        for (int i = 0; i < 4; ++i)
          for (int c = 0; c < 3; ++c)
            parameter[static_cast<size_t>(c)] +=
                p.weight(i) * real_of(temporal, form.temporal, p.texel(i).x, p.texel(i).y, c);
        const double toward = parameter[0] * parameter[0],
                     away = (1 - parameter[0]) * (1 - parameter[0]);
        const bool on_screen = before.x >= 0 && before.x < 1 && before.y >= 0 && before.y < 1;
        const double theta = on_screen ? toward / (toward + away) : 0;
        for (size_t k = 0; k < 3; ++k) {
          const double sigma = 2 * parameter[2] *
                               std::sqrt(std::max(std::abs(squares[k] - mean[k] * mean[k]), 1e-7));
          const double rectified = std::min(std::max(history[k], mean[k] - sigma), mean[k] + sigma);
          mixed[k] = mix(rectified, history[k], theta);
          if (centre) mixed[k] = mix(mixed[k], (*centre)[k], 0.35 * parameter[1] + 0.05);
        }
      }
      const Color linear = karis_inverse(mixed);
      for (size_t k = 0; k < 3; ++k) {
        const double value = std::min(linear[k] / images.exposure, kMaxColor);
        result.at(x, y)[k] = rounding == Rounding::kNone ? value : as_half(value);
      }
    }
  return result;
}

Result<FloatImage> Model::play(const SourceFrame& frame, const Network& network) {
  if (frame.camera.cut) reset();
  const Grid scattered = scatter(form_, frame, rounding_);
  const Grid hidden = form_.side == 2 ? disocclusion(form_, frame, scattered, rounding_) : Grid{};
  Pre before = pre(form_, frame, scattered, hidden, past_, rounding_);
  SHALE_TRY(auto outputs, network(before.input));
  auto& [temporal, kernel] = outputs;
  Grid history = post(form_, frame, before.dilated, past_, temporal, kernel, rounding_);
  past_ = {std::move(history), std::move(before.state), std::move(temporal)};
  return picture_of(past_.history);
}

}  // namespace shale::nss_v1
