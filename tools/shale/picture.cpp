#include "tools/shale/picture.h"

#include <stb/stb_easy_font.h>
#include <stb/stb_image.h>
#include <stb/stb_image_write.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "ir/base/file.h"

namespace shale {
namespace {

constexpr int kMaxSide = 16384;
constexpr int kLobes = 3;

double lanczos(double x) {
  if (std::abs(x) >= kLobes) return 0;
  if (std::abs(x) < 1e-9) return 1;
  const double px = std::numbers::pi * x;
  return kLobes * std::sin(px) * std::sin(px / kLobes) / (px * px);
}

/// Taps of one output coordinate: clamped input positions and normalized weights.
struct Taps {
  uint32_t position[2 * kLobes];
  double weight[2 * kLobes];
};

std::vector<Taps> lanczos_taps(uint32_t from, uint32_t to) {
  std::vector<Taps> taps(to);
  for (uint32_t o = 0; o < to; ++o) {
    const double centre = (o + 0.5) * from / to - 0.5;
    const int first = static_cast<int>(std::floor(centre)) - kLobes + 1;
    double sum = 0;
    for (int t = 0; t < 2 * kLobes; ++t) {
      taps[o].position[t] =
          static_cast<uint32_t>(std::clamp(first + t, 0, static_cast<int>(from) - 1));
      taps[o].weight[t] = lanczos(centre - (first + t));
      sum += taps[o].weight[t];
    }
    for (double& weight : taps[o].weight) weight /= sum;
  }
  return taps;
}

/// White text, its upper left corner at (x, y), `zoom` pixels a font pixel.
void draw_text(Picture& picture, const std::string& text, uint32_t x, uint32_t y, uint32_t zoom) {
  struct Vertex {
    float x, y, z;
    uint8_t colour[4];
  };
  std::vector<Vertex> vertices(270 * (text.size() + 1));
  std::string copy = text;
  const int quads = stb_easy_font_print(0, 0, copy.data(), nullptr, vertices.data(),
                                        static_cast<int>(vertices.size() * sizeof(Vertex)));
  for (int quad = 0; quad < quads; ++quad) {
    const Vertex& low = vertices[static_cast<size_t>(quad) * 4];
    const Vertex& high = vertices[static_cast<size_t>(quad) * 4 + 2];
    const auto scaled = [&](float v, uint32_t offset) {
      return offset + static_cast<uint32_t>(v) * zoom;
    };
    for (uint32_t py = scaled(low.y, y); py < std::min(scaled(high.y, y), picture.height); ++py)
      for (uint32_t px = scaled(low.x, x); px < std::min(scaled(high.x, x), picture.width); ++px)
        std::fill_n(picture.at(px, py), 4, uint8_t{255});
  }
}

}  // namespace

Picture Picture::filled(uint32_t width, uint32_t height, uint8_t grey) {
  Picture picture{width, height, std::vector<uint8_t>(size_t{width} * height * 4, grey)};
  for (size_t i = 3; i < picture.rgba.size(); i += 4) picture.rgba[i] = 255;
  return picture;
}

Result<Picture> load_picture(const std::string& path) {
  SHALE_TRY(const std::vector<uint8_t> bytes, read_file(path));
  const int size =
      static_cast<int>(std::min<size_t>(bytes.size(), std::numeric_limits<int>::max()));
  int width = 0, height = 0, channels = 0;
  if (stbi_info_from_memory(bytes.data(), size, &width, &height, &channels) == 0)
    return bad_input(path, "is no picture: {}", stbi_failure_reason());
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide)
    return bad_input(path, "has {}x{} pixels, expected 1 to {} a side", width, height, kMaxSide);
  stbi_uc* const pixels = stbi_load_from_memory(bytes.data(), size, &width, &height, &channels, 4);
  if (!pixels) return bad_input(path, "cannot be decoded: {}", stbi_failure_reason());
  Picture picture{static_cast<uint32_t>(width), static_cast<uint32_t>(height), {}};
  picture.rgba.assign(pixels,
                      pixels + static_cast<size_t>(width) * static_cast<size_t>(height) * 4);
  stbi_image_free(pixels);
  return picture;
}

Result<void> save_png(const std::string& path, const Picture& picture) {
  if ((4 * uint64_t{picture.width} + 1) * picture.height >
      INT32_MAX)  // what the encoder counts with
    return unsupported(path, "a picture of {}x{} pixels is too large to be written as PNG",
                       picture.width, picture.height);
  std::vector<uint8_t> bytes;
  const auto append = [](void* context, void* data, int size) {
    auto* const to = static_cast<std::vector<uint8_t>*>(context);
    const auto* const from = static_cast<const uint8_t*>(data);
    to->insert(to->end(), from, from + size);
  };
  if (stbi_write_png_to_func(append, &bytes, static_cast<int>(picture.width),
                             static_cast<int>(picture.height), 4, picture.rgba.data(),
                             static_cast<int>(picture.width * 4)) == 0)
    return io_error(path, "the picture cannot be encoded");
  return write_file(path, bytes);
}

Picture upscale_nearest(const Picture& picture, uint32_t width, uint32_t height) {
  Picture result = Picture::filled(width, height, 0);
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      std::copy_n(picture.at(static_cast<uint32_t>((x + 0.5) * picture.width / width),
                             static_cast<uint32_t>((y + 0.5) * picture.height / height)),
                  4, result.at(x, y));
  return result;
}

Picture upscale_lanczos(const Picture& picture, uint32_t width, uint32_t height) {
  const std::vector<Taps> columns = lanczos_taps(picture.width, width),
                          rows = lanczos_taps(picture.height, height);
  std::vector<double> wide(size_t{width} * picture.height * 3);
  for (uint32_t y = 0; y < picture.height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      for (uint32_t c = 0; c < 3; ++c)
        for (int t = 0; t < 2 * kLobes; ++t)
          wide[(size_t{y} * width + x) * 3 + c] +=
              columns[x].weight[t] * picture.at(columns[x].position[t], y)[c];
  Picture result = Picture::filled(width, height, 0);
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      for (uint32_t c = 0; c < 3; ++c) {
        double sum = 0;
        for (int t = 0; t < 2 * kLobes; ++t)
          sum += rows[y].weight[t] * wide[(size_t{rows[y].position[t]} * width + x) * 3 + c];
        result.at(x, y)[c] = static_cast<uint8_t>(std::clamp(std::lround(sum), 0l, 255l));
      }
  return result;
}

Picture magnify(const Picture& picture, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                uint32_t zoom) {
  Picture result = Picture::filled(width * zoom, height * zoom, 0);
  for (uint32_t oy = 0; oy < result.height; ++oy)
    for (uint32_t ox = 0; ox < result.width; ++ox)
      std::copy_n(picture.at(std::min(x + ox / zoom, picture.width - 1),
                             std::min(y + oy / zoom, picture.height - 1)),
                  4, result.at(ox, oy));
  return result;
}

Picture side_by_side(const std::vector<Panel>& panels, uint32_t columns) {
  constexpr uint32_t kLabel = 28, kGap = 8, kZoom = 2;
  uint32_t width = 0, height = 0;
  for (const Panel& panel : panels) {
    width = std::max(width, panel.picture.width);
    height = std::max(height, panel.picture.height);
  }
  const uint32_t rows = (static_cast<uint32_t>(panels.size()) + columns - 1) / columns;
  Picture result =
      Picture::filled(columns * (width + kGap) + kGap, rows * (height + kLabel + kGap), 48);
  for (uint32_t i = 0; i < panels.size(); ++i) {
    const uint32_t left = kGap + i % columns * (width + kGap),
                   top = i / columns * (height + kLabel + kGap);
    draw_text(result, panels[i].label, left, top + 6, kZoom);
    const Picture& picture = panels[i].picture;
    for (uint32_t y = 0; y < picture.height; ++y)
      std::copy_n(picture.at(0, y), size_t{picture.width} * 4, result.at(left, top + kLabel + y));
  }
  return result;
}

double psnr_db(const Picture& a, const Picture& b) {
  double sum = 0;
  for (size_t i = 0; i < a.rgba.size(); ++i) {
    if (i % 4 == 3) continue;
    const double difference = static_cast<double>(a.rgba[i]) - b.rgba[i];
    sum += difference * difference;
  }
  const double mean = sum / (static_cast<double>(a.width) * a.height * 3);
  return mean == 0 ? std::numeric_limits<double>::infinity()
                   : 10 * std::log10(255.0 * 255.0 / mean);
}

}  // namespace shale
